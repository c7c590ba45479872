"""Power and droop, against conservation of energy and the formula of each resistor."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.circuits import ladder, random_grid
from support.dynamics import small_scene

import resgrid as rg


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), drive=st.booleans())
def test_delivered_power_equals_dissipated_power(seed: int, drive: bool) -> None:
    op = rg.solve(random_grid(seed, drive=drive))
    result = rg.study(op).power()
    delivered = sum(rail.watts for rail in result.rails) + result.current_sources
    assert delivered == pytest.approx(result.total, rel=1e-9)
    assert result.total == pytest.approx(op.power)
    assert result.node.sum() == pytest.approx(result.total)
    across = np.subtract(*op.voltage[op.netlist.resistor_nodes.T])
    assert result.resistor == pytest.approx(op.netlist.conductance * across**2)
    worst = result.worst(5)
    assert (np.diff(result.resistor[worst]) <= 0).all()
    assert result.resistor[worst[0]] == result.resistor.max()


@pytest.mark.parametrize("rails", ["merged", "cells"])
def test_power_is_reported_per_rail(rails: str) -> None:
    result = rg.study(rg.solve(small_scene(rails=rails))).power()
    obstacle, goal = result.rails
    assert (obstacle.name, obstacle.volts, goal.name, goal.volts) == ("obstacle", 1.0, "goal_0", 0.0)
    assert obstacle.watts == pytest.approx(result.total)
    assert obstacle.amps == pytest.approx(-goal.amps)
    assert result.largest_droop == 0.0


def test_droop_equals_the_voltage_across_a_series_resistor_of_the_rail() -> None:
    netlist = small_scene(rails="cells")
    goal = netlist.cells.node[11, 2]
    which = int(np.flatnonzero(netlist.source_nodes[:, 0] == goal)[0])
    sources = netlist.source_nodes.copy()
    sources[which, 0] = netlist.node_count
    drooping = netlist.replace(
        node_count=netlist.node_count + 1,
        source_nodes=sources,
        resistor_nodes=np.append(netlist.resistor_nodes, [[netlist.node_count, goal]], axis=0),
        conductance=np.append(netlist.conductance, 1e-3),
        cell_map=None,
    )
    volts = rg.solve(drooping).voltage[goal]
    import dataclasses

    cell_map = dataclasses.replace(
        netlist.cells,
        resistor_face=np.append(netlist.cells.resistor_face, -1),
        resistor_upward=np.append(netlist.cells.resistor_upward, True),
    )
    result = rg.study(rg.solve(drooping.replace(cell_map=cell_map))).power()
    assert volts > 0.01
    assert result.droop[goal] == pytest.approx(volts) == pytest.approx(result.largest_droop)


def test_cell_heat_sums_to_the_total_power() -> None:
    op = rg.solve(small_scene(rails="cells"))
    result = rg.study(op).power()
    heat = result.cell_heat
    edge = result.node[op.netlist.cells.obstacle_node]
    assert np.nansum(heat) + edge == pytest.approx(result.total)
    assert np.unravel_index(np.nanargmax(heat), heat.shape)[0] in {10, 11, 12}


def test_power_json_values_add_up() -> None:
    data = rg.study(rg.solve(ladder())).power().to_json()
    assert data["power"]["unit"] == "W"
    assert data["power_node_1"]["value"] + data["power_current_sources"]["value"] == pytest.approx(
        data["power"]["value"]
    )
    assert data["hottest"][0]["power"] == data["hottest_resistor"]["value"]


def test_cell_heat_of_a_netlist_without_cells_raises_input_error() -> None:
    with pytest.raises(rg.InputError, match="not compiled"):
        _ = rg.study(rg.solve(ladder())).power().cell_heat


def test_power_includes_nonlinear_resistors() -> None:
    netlist = rg.Netlist(
        3, [[2, 0]], [1e-4], source_nodes=[[1, 0]], source_volts=[1.0],
        nonlinear_nodes=[[1, 2]], nonlinear_current=[1e-4], nonlinear_voltage=[0.5],
    )  # fmt: skip
    op = rg.solve(netlist)
    result = rg.study(op).power()
    assert result.total == pytest.approx(op.power) == pytest.approx(result.rails[0].watts)
    assert result.nonlinear[0] == pytest.approx((1 - op.voltage[2]) * op.voltage[2] * 1e-4)
