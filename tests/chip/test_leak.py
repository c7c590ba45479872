"""Leaks on chips: effects, seeds, transients, converters, and messages of forms without a leak resistor.

Tests internals: `resgrid.chip.report`, `resgrid.chip.time_constants`, `resgrid.circuit.dynamics`, `resgrid.core`,
`resgrid.spice.write.tiles`.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from support.dynamics import with_capacitors

import resgrid as rg
from resgrid.chip.report import _by_boundary
from resgrid.chip.time_constants import slowest_modes
from resgrid.circuit.dynamics import dynamics_of
from resgrid.core.random_sites import resistor_sites, site_count
from resgrid.core.regions import face_counts
from resgrid.spice.write.tiles import tiles_of

LEAK = 0.3


def lesson() -> rg.ConfigurationSpace:
    return rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))


def leaks(netlist: rg.Netlist) -> NDArray[np.bool_]:
    return netlist.cells.leak_cell >= 0


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_a_seed_draws_the_same_grid_with_and_without_leaks(boundary: str) -> None:
    chip = rg.Chip(mismatch=0.02, seed=5)
    plain, leaking = (rg.study(lesson(), chip, boundary=boundary, leak=leak) for leak in (0.0, LEAK))
    one = dict(zip(plain.netlist.cells.resistor_face.tolist(), plain.netlist.conductance.tolist(), strict=True))
    face = leaking.netlist.cells.resistor_face
    for number, conductance in zip(face.tolist(), leaking.netlist.conductance.tolist(), strict=True):
        assert number < 0 or one[number] == conductance
    own = leaks(leaking.netlist)
    ratio = leaking.netlist.conductance[own] / leaking.ideal.conductance[own]
    assert len(np.unique(ratio)) == len(leaking.netlist.cells.free_node)
    assert 0.01 < ratio.std() < 0.03
    samples = leaking.conductances([5, 6])[1]
    assert np.array_equal(samples[0], leaking.netlist.conductance)
    assert not np.any(samples[1] == samples[0])


def test_effects_of_values_apply_to_leaks_and_switches_between_cells_do_not() -> None:
    space = lesson()
    rounded = rg.study(space, rg.Chip(preferred="E6"), leak=0.31).netlist
    assert np.unique(1.0 / rounded.conductance[leaks(rounded)]).tolist() == pytest.approx([33e3])
    switched = rg.study(space, rg.Chip(internodal_switch_on=1e3), leak=LEAK)
    own = leaks(switched.netlist)
    assert np.array_equal(switched.netlist.conductance[own], switched.ideal.conductance[own])
    sloped = rg.study(space, rg.Chip(gradient="10 %"), leak=LEAK).netlist
    x = sloped.cells.leak_cell[leaks(sloped)] // 8
    expected = 10e3 / LEAK * (1.0 + 0.1 * ((x + 0.5) / 8 - 0.5))
    np.testing.assert_allclose(1.0 / sloped.conductance[leaks(sloped)], expected, rtol=1e-12)
    hot = rg.study(space, rg.Chip(tc1=1e-3, temperature=127.0), leak=LEAK).netlist
    np.testing.assert_allclose(1.0 / hot.conductance[leaks(hot)], 1.1 * 10e3 / LEAK, rtol=1e-12)


def test_a_leak_hangs_on_the_local_node_of_a_rail_with_resistance() -> None:
    study = rg.study(lesson(), rg.Chip(rail_resistance=1.0), leak=LEAK)
    netlist = study.netlist
    cells, own = netlist.cells, leaks(netlist)
    assert np.array_equal(netlist.resistor_nodes[own, 1], cells.rail_nodes["obstacle"].ravel()[cells.leak_cell[own]])
    field = rg.field(rg.solve(netlist))
    assert np.nanmax(field.potential[field.space.goal_connected]) < 1.0
    ideal = rg.field(rg.solve(study.ideal))
    np.testing.assert_allclose(field.potential, ideal.potential, atol=2e-3)


@pytest.mark.parametrize("chip", [rg.Chip(rail_resistance=1e3), rg.Chip(rail_resistance=1e3, saturation_voltage=1e4)])
@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_every_leak_draws_its_current_through_the_resistance_of_the_rail(boundary: str, chip: rg.Chip) -> None:
    """Open obstacles have no contacts with the rail, and saturating leaks are not among the linear resistors."""
    netlist = rg.study(lesson(), chip, boundary=boundary, leak=LEAK).netlist
    cells = netlist.cells
    ends, face = netlist.resistor_nodes, cells.resistor_face
    if chip.saturation_voltage:
        ends, face = netlist.nonlinear_nodes, cells.nonlinear_face
    own = face < -1
    assert np.count_nonzero(own) == 56
    assert np.array_equal(ends[own, 1], cells.rail_nodes["obstacle"].ravel()[-2 - face[own]])
    drop = 1.0 - rg.solve(netlist).voltage[cells.rail_nodes["obstacle"]]
    assert 0.01 < np.max(drop) < 1.0


def test_cells_without_a_path_leak_where_open_switches_give_them_nodes() -> None:
    """A cut-off free cell is at the obstacle rail, since its leak conducts far more than the open switches around."""
    cell = [[2, 0, 1, 0, 0]]
    space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 1.0, 1), rg.Axis("y", 0.0, 5.0, 5)], cell)
    chip = rg.Chip(internodal_switch_on=1.0, internodal_switch_off=1e9)
    netlist = rg.study(space, chip, boundary="neumann", leak=LEAK).netlist
    voltage = rg.solve(netlist).voltage[netlist.cells.node[0]]
    np.testing.assert_allclose(voltage[3:], 1.0, rtol=0, atol=1e-4)
    assert voltage[1] < 0.5


def test_open_and_shorted_leaks() -> None:
    space = lesson()
    opened = rg.study(space, rg.Chip(defects=rg.chip.Defects(open_density=0.2)), leak=LEAK).netlist
    assert 0 < np.count_nonzero(leaks(opened)) < 56
    result = rg.study(space, rg.Chip(readout=rg.chip.Readout(bits=10)), leak=LEAK).faults()
    assert result.examined == 144 + 56


def test_saturating_leaks_have_the_small_signal_of_linear_ones() -> None:
    linear, saturating = (
        rg.solve(rg.study(lesson(), rg.Chip(saturation_voltage=volts), leak=LEAK).netlist) for volts in (None, 1e4)
    )
    assert saturating.netlist.nonlinear_nodes.shape == (200, 2)
    nodes = linear.netlist.cells.free_node
    np.testing.assert_allclose(saturating.voltage[nodes], linear.voltage[nodes], rtol=0, atol=1e-8)
    ends = rg.field(saturating), rg.field(linear)
    for axis in range(2):
        np.testing.assert_allclose(ends[0].face_current(axis), ends[1].face_current(axis), rtol=0, atol=1e-7)


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_a_leak_shifts_every_rate_of_a_chip_with_equal_capacitors(boundary: str) -> None:
    """With ``C`` at every node, a leak adds ``leak h^2 / (R C)`` to every rate ``1 / tau``."""
    netlists = [rg.compile_space(lesson(), boundary=boundary, leak=leak) for leak in (0.0, LEAK)]
    rates = [1.0 / slowest_modes(dynamics_of(with_capacitors(netlist, 1e-12)), 6).tau for netlist in netlists]
    np.testing.assert_allclose(rates[1][:6] - rates[0][:6], LEAK / (10e3 * 1e-12), rtol=1e-8)


def test_converters_of_other_boundaries_include_the_leak() -> None:
    space = lesson()
    found = _by_boundary(rg.study(space, leak=LEAK))
    assert set(found) == {"dirichlet", "neumann"}
    for boundary, result in found.items():
        own = rg.study(space, boundary=boundary, leak=LEAK).adc_resolution(span=1.0)
        np.testing.assert_array_equal(result.cell_bits, own.cell_bits)


def test_studies_name_the_leak_and_its_analyses_run() -> None:
    chip = rg.Chip(mismatch=0.01, capacitance=1e-12, readout=rg.chip.Readout(bits=12))
    study = rg.study(rg.read_scene("examples/scenes/lesson.toml").replace(leak=0.05), chip)
    assert "leak 0.05" in repr(study)
    assert ("leak", "0.05", "of every free cell to the obstacle rail, in 1 / (unit of the axes)^2") in study.parameters
    op = rg.solve(study.netlist)
    assert abs(study.power().total - op.power) < 1e-9 * op.power
    assert study.settling().figures
    assert study.noise().figures
    assert study.sensitivity().figures
    assert 0.0 < study.yields(trials=20).overall.value <= 1.0


def test_tiles_boards_and_layouts_reject_leaks() -> None:
    switches = {
        f"{kind}_switch_{end}": ohms for kind in ("goal", "obstacle") for end, ohms in (("on", 10.0), ("off", 1e9))
    }
    chip = rg.Chip(**switches)
    netlist = rg.study(lesson(), chip, leak=LEAK).netlist
    with pytest.raises(rg.InputError, match="a tile has no leak resistor"):
        tiles_of(netlist, chip)
    with pytest.raises(rg.InputError, match="for which a board has no place; set leak = 0"):
        rg.hardware.build_board(lesson(), leak=LEAK)
    with pytest.raises(rg.InputError, match="which a layout does not draw; set leak = 0"):
        rg.hardware.build_layout(lesson(), "toy:poly", leak=LEAK)


def test_leaky_switches_are_a_leak() -> None:
    """Open switches to the obstacle rail with ``R_off`` are the leak ``R / (R_off h^2)``."""
    space = lesson()
    leak = rg.field(rg.solve(rg.compile_space(space, leak=10e3 / 40e3)))
    switches = rg.field(rg.solve(rg.study(space, rg.Chip(obstacle_switch_off=40e3)).netlist))
    own = space.goal_connected
    np.testing.assert_allclose(switches.potential[own], leak.potential[own], rtol=1e-12)


def test_sites_of_leaks_follow_the_faces() -> None:
    netlist = rg.compile_space(lesson(), leak=LEAK)
    faces = sum(face_counts((8, 8)))
    assert site_count(netlist) == faces + 64
    own = leaks(netlist)
    assert np.array_equal(resistor_sites(netlist)[0][own], faces + netlist.cells.leak_cell[own])
