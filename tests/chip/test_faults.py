"""Shorts and opens: as dense as asked, and what is left of the chip.

Tests internals: `resgrid.chip.effects.spread`, `resgrid.chip.effects.values`.
"""

from __future__ import annotations

import numpy as np
import pytest
from support.spaces import space_of

import resgrid as rg
from resgrid.chip.effects.spread import Faults
from resgrid.chip.effects.values import Saturation


def room(boundary: str = "dirichlet") -> rg.Netlist:
    cell = np.zeros((8, 10), dtype=np.uint8)
    cell[2:5, 6], cell[6, 1] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    return rg.compile_space(space_of(cell), boundary=boundary, rails="cells")


def test_faults_are_nested_and_as_dense_as_asked() -> None:
    netlist = rg.compile_space(space_of(np.pad([[2]], 60)), rails="cells")
    few, many = Faults(0.01, 0.02, 1.0, 7).places(netlist), Faults(0.05, 0.1, 1.0, 7).places(netlist)
    for a, b, share in ((few[0], many[0], 0.05), (few[1], many[1], 0.1)):
        assert np.all(b[a])
        assert b.mean() == pytest.approx(share, rel=0.1)
    made = Faults(0.05, 0.1, 2.0, 7).apply(netlist)
    face = netlist.cells.resistor_face
    assert len(made.conductance) == len(face) - many[0][face].sum()
    assert (made.conductance == 0.5).sum() == many[1][face].sum()


def test_everything_open_leaves_nodes_without_a_voltage() -> None:
    netlist = room("neumann")
    cut = Faults(open_density=1.0).apply(netlist)
    assert not cut.conductance.size
    assert not cut.current_nodes.size
    partly = Faults(open_density=0.55, seed=2).apply(netlist)
    point = rg.solve(partly)
    assert point.floating.size
    assert {
        str(rg.streamline(rg.field(point), cell=c).outcome) for c in np.argwhere(netlist.cells.space.cell == 0)
    } == {
        "reached",
        "no_current",
    }


def test_a_shorted_saturating_resistor_is_linear() -> None:
    netlist = Faults(0.1, 0.2, 3.0, 1).apply(Saturation(0.2).apply(room()))
    assert np.all(netlist.conductance == 1 / 3.0)
    assert len(netlist.conductance) + len(netlist.nonlinear_current) < len(room().conductance)
    linear = Faults(0.1, 0.2, 3.0, 1).apply(room())
    shorts = {tuple(sorted(pair)) for pair in linear.resistor_nodes[linear.conductance > 0.1].tolist()}
    assert shorts == {tuple(sorted(pair)) for pair in netlist.resistor_nodes.tolist()}


def test_a_cell_that_opens_cut_off_is_still_fed_where_a_load_ties_it_to_ground() -> None:
    chip = rg.Chip(readout=rg.chip.Readout(input_resistance=5e5), defects=rg.chip.Defects(open_density=1.0))
    netlist = rg.study(space_of([2, 0, 0]), chip, boundary="neumann").netlist
    volts = rg.solve(netlist).voltage[netlist.cells.node]
    np.testing.assert_allclose(volts, [0.0, 5e5 * 1.0 / 10e3 / 3, 5e5 * 1.0 / 10e3 / 3], rtol=1e-12)


def test_resistors_are_opened_one_by_one():
    axes = [rg.Axis("a", 0.0, 5.0, 5, periodic=True), rg.Axis("b", 0.0, 4.0, 4)]
    cell = np.zeros((5, 4), dtype=np.uint8)
    cell[2, 2] = rg.Cell.GOAL
    netlist = rg.compile_space(rg.ConfigurationSpace(axes, cell), rails="cells")
    node = netlist.cells.node
    for place, ends in {
        (3, 1, 0): {node[2, 1], node[3, 1]},
        (0, 1, 0): {node[4, 1], node[0, 1]},
        (5, 1, 0): {node[4, 1], node[0, 1]},  # a ring's last face is its first
        (1, 3, 1): {node[1, 2], node[1, 3]},
        (1, 4, 1): {node[1, 3], netlist.cells.obstacle_node},
    }.items():
        cut = rg.chip.build_chip(netlist, rg.Chip(defects=rg.chip.Defects(open_at=[place])))
        gone = set(map(frozenset, netlist.resistor_nodes.tolist())) - set(map(frozenset, cut.resistor_nodes.tolist()))
        assert gone == {frozenset(ends)}
    for place in ((5, 4, 0), (1, 5, 1), (1, 1, 2), (1, 1)):
        with pytest.raises(rg.InputError, match="open_at"):
            Faults(open_at=(place,)).apply(netlist)
