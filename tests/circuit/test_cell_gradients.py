"""Gradients with respect to conductivities, leaks and costs of cells: differences, mpmath, and laws of random walks."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from support.mpmath_circuits import comb, differences, largest_error, node_voltages
from support.spaces import rough_space

import resgrid as rg


@pytest.mark.parametrize("shape", [(4, 3), (2, 2, 3)])
@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize(
    "options",
    [
        {"edge": "open"}, {"rails": "cells"}, {"boundary": "wall", "wall_resistance": 0.7, "rails": "cells"},
        {"boundary": "neumann"}, {"boundary": "wall", "wall_resistance": 3.0, "supply": -2.0, "goal_voltage": 0.5},
        {"boundary": "neumann", "drive": "start"},
    ],
    ids=["open", "cells", "wall", "neumann", "low obstacles", "start"],
)  # fmt: skip
@pytest.mark.quick_cases(8)
def test_derivatives_with_respect_to_conductivities_equal_differences(
    shape: tuple[int, ...], periodic: bool, options: rg.WiringOptions
) -> None:
    space = rough_space(shape, periodic)
    if periodic:
        options = {**options, "edge": ["periodic", *["obstacle"] * (len(shape) - 1)]}
    if options.get("drive") == "start":
        options = {**options, "start": np.argwhere(space.goal_connected & (space.cell == rg.Cell.FREE))[-1].tolist()}
    netlist = rg.compile_space(space, resistance=1.0, **options)
    place = tuple(size // 2 - 1 for size in shape)
    found = rg.gradient(rg.solve(netlist), "voltage", at=place, cells=True)
    assert found.conductivity is not None and not found.conductivity.flags.writeable
    node, wanted = netlist.cells.node[place], np.zeros(shape)

    def volts(conductivity: np.ndarray) -> float:
        changed = rg.ConfigurationSpace(space.axes, space.cell, conductivity=conductivity)
        return float(rg.solve(rg.compile_space(changed, resistance=1.0, **options)).voltage[node])

    for cell in np.ndindex(shape):
        step = np.zeros(shape)
        step[cell] = 1e-4 * space.conductivity[cell]
        ends = [volts(space.conductivity + factor * step) for factor in (2, 1, -1, -2)]
        wanted[cell] = (8 * (ends[1] - ends[2]) - (ends[0] - ends[3])) / (12 * step[cell])
    np.testing.assert_allclose(found.conductivity, wanted, rtol=1e-6, atol=1e-8 * np.abs(wanted).max())


def test_conductivities_have_degree_zero_in_dirichlet_voltages() -> None:
    space = rough_space((12, 9))
    op = rg.solve(rg.compile_space(space, resistance=1.0))
    found = rg.gradient(op, "log_drop", at=(8, 6), cells=True)
    assert found.conductivity is not None and found.conductivity.any()
    assert abs(np.sum(found.conductivity * space.conductivity)) < 1e-12
    assert abs(found.conductance @ op.netlist.conductance) < 1e-12


@pytest.mark.parametrize(
    "options", [{"boundary": "neumann"}, {"edge": "open"}, {"boundary": "wall", "wall_resistance": 2.0}]
)
def test_path_costs_equal_expected_times_and_their_differences(options: rg.WiringOptions) -> None:
    space = rough_space((5, 5))
    netlist = rg.compile_space(space, resistance=3.0, **options)
    op, place = rg.solve(netlist), (2, 2)
    found = rg.gradient(op, "path_cost", at=place, cells=True)
    times = rg.planning.collision_probability(netlist).time
    assert found.value == pytest.approx(times[place], rel=1e-12)
    assert found.cost is not None and found.cost.sum() == pytest.approx(times[place], rel=1e-12)
    cost = np.random.default_rng(1).uniform(0, 1, space.shape)
    weighted = rg.gradient(op, "path_cost", at=place, cost=cost, cells=True)
    assert weighted.value == pytest.approx(np.sum(cost * found.cost), rel=1e-12)
    assert not weighted.voltage.any() and not weighted.current.any()
    free = netlist.cells.free_node
    driven = netlist.replace(
        source_volts=0 * netlist.source_volts,
        current_nodes=np.stack([0 * free, free], 1),
        current_amps=cost.ravel()[netlist.cell_of_node()[free]] / 3.0,
    )
    some = {"conductance": range(0, len(netlist.conductance), 4)}
    wanted = differences(driven, lambda v: v[netlist.cells.node[place]], some, 50)
    assert largest_error(weighted, wanted, some, 50) < 1e-11


@pytest.mark.parametrize("leak", [0.0, 1e-3, 40.0])
@pytest.mark.parametrize("of", ["voltage", "log_drop", "path_cost", "path_cost_given_success"])
@pytest.mark.parametrize("options", [{}, {"rails": "cells", "supply": -3.0}, {"boundary": "neumann"}], ids=str)
def test_derivatives_with_respect_to_leaks_equal_differences(leak: float, of: str, options: rg.WiringOptions) -> None:
    space, place = rough_space((5, 4)), (1, 1)
    if not leak and options.get("boundary") == "neumann":
        driven = rg.gradient(rg.solve(rg.compile_space(space, **options)), "voltage", at=place, cells=True)
        assert driven.leak is None
        return

    def found(leak: float) -> rg.circuit.Gradient:
        netlist = rg.compile_space(space, resistance=7.0, leak=leak, **options)
        return rg.gradient(rg.solve(netlist), of, at=place, cells=True)  # type: ignore[arg-type]

    step = 1e-2 * leak or 1e-4
    values = [found(leak + factor * step).value for factor in ((0, 1, 2, 3) if leak == 0 else (-2, -1, 1, 2))]
    stencil = (-11 / 6, 3, -3 / 2, 1 / 3) if leak == 0 else (1 / 12, -2 / 3, 2 / 3, -1 / 12)
    here = found(leak).leak
    assert here is not None and not here[space.cell != rg.Cell.FREE].any()
    assert here.sum() == pytest.approx(np.dot(stencil, values) / step, rel=1e-6)


def test_leaks_of_deep_drops_have_the_derivatives_of_leak_resistors() -> None:
    cell = np.ones((3, 200), dtype=np.uint8)
    cell[1, 1:], cell[1, 0] = rg.Cell.FREE, rg.Cell.GOAL
    space = rg.ConfigurationSpace([rg.Axis("x", 0, 3, 3), rg.Axis("y", 0, 200, 200)], cell)
    place = (1, 199)
    without, tiny = (
        rg.gradient(rg.solve(rg.compile_space(space, leak=leak)), "log_drop", at=place, cells=True)
        for leak in (0.0, 1e-13)
    )
    assert without.value < -250 and without.leak is not None and tiny.leak is not None
    np.testing.assert_allclose(without.leak, tiny.leak, rtol=1e-9)
    assert -without.leak.sum() > 50  # the expected time of a walk to the goal, in units of R C


def test_the_chain_rule_needs_one_derivative_per_resistor() -> None:
    netlist = rg.compile_space(rough_space((4, 4)))
    with pytest.raises(rg.InputError, match=r"conductance has shape \(3,\); give one derivative per resistor"):
        rg.circuit.conductivity_gradient(netlist, np.ones(3))
    with pytest.raises(rg.InputError, match="not compiled from a space"):
        rg.circuit.conductivity_gradient(comb(4, 1.0), np.ones(8))


@pytest.mark.parametrize("options", [{"edge": "open"}, {"boundary": "wall", "wall_resistance": 2.0, "supply": -3.0}])
def test_path_costs_given_success_equal_conditional_times_and_their_differences(options: rg.WiringOptions) -> None:
    space = rough_space((5, 5))
    netlist = rg.compile_space(space, resistance=3.0, **options)
    op, places = rg.solve(netlist), [(2, 2), (1, 1)]
    times = rg.planning.collision_probability(netlist).time_given_success
    plain = rg.gradient(op, "path_cost_given_success", at=places, weights=[2.0, -0.5], cells=True)
    assert plain.value == pytest.approx(2 * times[places[0]] - 0.5 * times[places[1]], rel=1e-12)
    cost = np.random.default_rng(1).uniform(0, 1, space.shape)
    found = rg.gradient(op, "path_cost_given_success", at=places, weights=[2.0, -0.5], cost=cost, cells=True)
    assert plain.cost is not None and found.value == pytest.approx(np.sum(cost * plain.cost), rel=1e-12)
    free, node = netlist.cells.free_node, netlist.cells.node
    walked = netlist.replace(current_nodes=np.stack([0 * free, free], 1), current_amps=np.zeros(free.size))
    amps = cost.ravel()[netlist.cell_of_node()[free]] / 3.0
    high, low = netlist.cells.wiring.high, netlist.cells.wiring.goal_voltage

    def expected(conductance: list[object]) -> object:
        volts = node_voltages(netlist, conductance, netlist.source_volts.tolist(), [])
        u = [(high - v) / mp.mpf(high - low) for v in volts]
        drive = [u[n] * mp.mpf(float(a)) for n, a in zip(free.tolist(), amps, strict=True)]
        paid = node_voltages(walked, conductance, [0] * len(netlist.source_volts), drive)
        return sum(w * paid[n] / u[n] for w, n in zip((2, mp.mpf(-0.5)), (int(node[p]) for p in places), strict=True))

    with mp.workdps(50):
        for k in range(0, len(netlist.conductance), 5):
            ends = []
            for sign in (1, -1):
                changed = [mp.mpf(float(g)) for g in netlist.conductance]
                changed[k] *= 1 + sign * mp.mpf(10) ** -17
                ends.append(expected(changed))
            wanted = (ends[0] - ends[1]) / (2 * mp.mpf(10) ** -17 * mp.mpf(float(netlist.conductance[k])))
            assert found.conductance[k] == pytest.approx(float(wanted), rel=1e-10, abs=1e-14)


def test_path_costs_of_deep_corridors_have_degree_minus_one() -> None:
    cell = np.ones((3, 300), dtype=np.uint8)
    cell[1, 1:], cell[1, 0] = rg.Cell.FREE, rg.Cell.GOAL
    axes = [rg.Axis("x", 0, 3, 3), rg.Axis("y", 0, 300, 300)]
    space = rg.ConfigurationSpace(axes, cell, np.random.default_rng(0).uniform(0.5, 2, cell.shape))
    op, place = rg.solve(rg.compile_space(space)), (1, 299)
    assert op.log_drop is not None and op.log_drop[op.netlist.cells.node[place]] < -380
    found = rg.gradient(op, "path_cost_given_success", at=place, cells=True)
    walk = rg.planning.collision_probability(op)
    assert found.value == pytest.approx(walk.time_given_success[place], rel=1e-10)
    assert found.conductance @ op.netlist.conductance == pytest.approx(-found.value, rel=1e-10)
    assert found.leak is not None and found.leak.sum() < 0  # minus the variance of the time: fast walks survive
    drop = rg.gradient(op, "log_drop", at=place, cells=True)
    assert drop.leak is not None
    np.testing.assert_allclose(found.cost, -drop.leak, rtol=1e-9)  # both are the expected times in the cells
