"""Gradients: central differences in mpmath at 40 to 1100 digits, exact fractions, laws, and rejected inputs."""

from __future__ import annotations

from fractions import Fraction

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from support.fractions_solver import solve_exactly
from support.mpmath_circuits import all_elements, comb, differences, largest_error, node_voltages

import resgrid as rg


def random_circuit(seed: int, nodes: int = 9, decades: float = 6.0) -> rg.Netlist:
    """Connected circuit with grounded, chained and floating voltage sources, and current sources of both signs."""
    rng = np.random.default_rng(seed)
    tree = [(node, int(rng.integers(node))) for node in range(1, nodes)]
    extra = [tuple(rng.choice(nodes, 2, replace=False).tolist()) for _ in range(nodes)]
    pairs = [(nodes, 0), (nodes + 1, nodes), (nodes + 2, 2), (nodes, 1), (nodes + 1, 3), (nodes + 2, 4)]
    pairs = np.array([*tree, *extra, *pairs[3:]])
    return rg.Netlist(
        nodes + 3, pairs, 10.0 ** rng.uniform(-decades / 2, decades / 2, len(pairs)),
        source_nodes=[(nodes, 0), (nodes + 1, nodes), (nodes + 2, 2)], source_volts=rng.normal(size=3),
        current_nodes=[(0, 5), (6, 1), (2, 0)], current_amps=rng.normal(size=3),
    )  # fmt: skip


@st.composite
def random_ladders(draw: st.DrawFn) -> rg.Netlist:
    """Circuits of up to seven nodes with conductances of any magnitude, one grounded and one floating source."""
    nodes = draw(st.integers(3, 6))
    siemens = st.floats(-9, 9).map(lambda power: 10.0**power)
    pairs = [(node, draw(st.integers(0, node - 1))) for node in range(1, nodes)]
    pairs += draw(st.lists(st.tuples(st.integers(0, nodes - 1), st.integers(0, nodes - 1)), max_size=6))
    conductance = [draw(siemens) for _ in range(len(pairs) + 1)]
    return rg.Netlist(
        nodes + 1, [*pairs, (nodes, draw(st.integers(1, nodes - 1)))], conductance,
        source_nodes=[(1, 0), (nodes, 2)], source_volts=[draw(st.floats(-2, 2)), draw(st.floats(-2, 2))],
        current_nodes=[(0, draw(st.integers(1, nodes - 1)))], current_amps=[draw(st.floats(-3, 3))],
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_derivatives_of_random_circuits_equal_differences_in_mpmath(seed: int) -> None:
    netlist = random_circuit(seed)
    weights = np.random.default_rng(seed).normal(size=netlist.node_count) * (np.arange(netlist.node_count) % 3 == 0)
    found, every = rg.gradient(rg.solve(netlist), weights), all_elements(netlist)
    wanted = differences(netlist, lambda v: sum(w * x for w, x in zip(weights.tolist(), v, strict=True)), every, 60)
    assert largest_error(found, wanted, every, 60) < 1e-12
    assert found.value == pytest.approx(weights @ rg.solve(netlist).voltage, rel=1e-12)


@pytest.mark.parametrize(("ratio", "digits"), [(1.0, 40), (3e2, 120), (1e30, 1100)])
def test_derivatives_of_deep_drops_are_accurate_relative_to_themselves(ratio: float, digits: int) -> None:
    netlist = comb(12, ratio)
    op, node, every = rg.solve(netlist), 14, {"conductance": range(24), "voltage": [1]}
    assert op.log_drop is not None and (ratio < 1e30 or op.log_drop[node] < -820)  # 1e-356
    functions = {
        "voltage": lambda v: v[node],
        "log_drop": lambda v: mp.log(1 - v[node]),
        "collision_probability": lambda v: v[node],
    }
    for of, function in functions.items():
        found = rg.gradient(op, of, at=node)  # type: ignore[arg-type]
        assert largest_error(found, differences(netlist, function, every, digits), every, digits) < 1e-12
    assert rg.gradient(op, "log_drop", at=node).value == op.log_drop[node]


def test_log_drops_of_many_depths_share_one_adjoint_solve() -> None:
    netlist = comb(12, 1e30)
    op, every = rg.solve(netlist), {"conductance": range(24)}
    seed = np.zeros(netlist.node_count)
    seed[[3, 8, 14]] = 1.0, 2.0, 0.5
    found = rg.circuit.pullback(op, log_drop=seed)
    assert op.log_drop is not None and found.value == pytest.approx(seed[3:] @ op.log_drop[3:], rel=1e-14)
    wanted = differences(netlist, lambda v: sum(seed[n] * mp.log(1 - v[n]) for n in (3, 8, 14)), every, 1100)
    assert largest_error(found, wanted, every, 1100) < 1e-12


def space_of(shape: tuple[int, ...], periodic: bool = False, seed: int = 0) -> rg.ConfigurationSpace:
    """A small space with obstacles, two goals, unequal cells and a conductivity map."""
    rng = np.random.default_rng(seed)
    cell = (rng.random(shape) < 0.15).astype(np.uint8)
    cell[(0,) * len(shape)] = rg.Cell.GOAL
    cell[tuple(size // 2 for size in shape)] = rg.Cell.GOAL
    cell[tuple(size // 2 - 1 for size in shape)] = rg.Cell.FREE
    axes = [rg.Axis("xyz"[n], 0.0, 1.0 + n, size, periodic=periodic and n == 0) for n, size in enumerate(shape)]
    return rg.ConfigurationSpace(axes, cell, conductivity=rng.uniform(0.2, 5.0, shape))


@pytest.mark.parametrize("shape", [(5, 4), (2, 3, 3)])
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
def test_derivatives_with_respect_to_conductivities_equal_differences(
    shape: tuple[int, ...], periodic: bool, options: rg.WiringOptions
) -> None:
    space = space_of(shape, periodic)
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
    space = space_of((12, 9))
    op = rg.solve(rg.compile_space(space, resistance=1.0))
    found = rg.gradient(op, "log_drop", at=(8, 6), cells=True)
    assert found.conductivity is not None and found.conductivity.any()
    assert abs(np.sum(found.conductivity * space.conductivity)) < 1e-12
    assert abs(found.conductance @ op.netlist.conductance) < 1e-12


@pytest.mark.parametrize(
    "options", [{"boundary": "neumann"}, {"edge": "open"}, {"boundary": "wall", "wall_resistance": 2.0}]
)
def test_path_costs_equal_expected_times_and_their_differences(options: rg.WiringOptions) -> None:
    space = space_of((5, 5))
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


@given(random_ladders())
def test_derivatives_equal_differences_of_exact_fractions(netlist: rg.Netlist) -> None:
    node = netlist.node_count - 1
    found = rg.gradient(rg.solve(netlist), "voltage", at=node)

    def exact(**changes: object) -> Fraction:
        point = solve_exactly(netlist.replace(**changes))
        assert point is not None and point.voltage[node] is not None
        return point.voltage[node]

    for name, field in (("conductance", "conductance"), ("voltage", "source_volts"), ("current", "current_amps")):
        values = getattr(netlist, field)
        for number, value in enumerate(values.tolist()):
            ends = []
            for sign in (1, -1):
                moved = values.copy()
                moved[number] = value + sign * 2.0**-20 * (abs(value) or 1.0)
                ends.append((exact(**{field: moved}), Fraction(moved[number])))
            wanted = float((ends[0][0] - ends[1][0]) / (ends[0][1] - ends[1][1]))
            largest = float(np.abs(getattr(found, name)).max())
            assert getattr(found, name)[number] == pytest.approx(wanted, rel=1e-9, abs=1e-14 * largest)


def test_derivatives_at_nonlinear_resistors_equal_differences_of_operating_points() -> None:
    netlist = rg.Netlist(
        4, [[1, 2], [3, 0]], [1e-3, 2e-3], source_nodes=[[1, 0]], source_volts=[0.3], current_nodes=[[0, 3]],
        current_amps=[1e-4], nonlinear_nodes=[[2, 3], [2, 0]], nonlinear_current=[1e-3, 4e-4],
        nonlinear_voltage=[0.1, 0.2],
    )  # fmt: skip
    found = rg.gradient(rg.solve(netlist), "voltage", at=[2, 3], weights=[1.0, -3.0])
    assert found.conductivity is None
    fields = {
        "conductance": "conductance", "voltage": "source_volts", "current": "current_amps",
        "nonlinear_current": "nonlinear_current", "nonlinear_voltage": "nonlinear_voltage",
    }  # fmt: skip
    for name, field in fields.items():
        values = getattr(netlist, field)
        for number, value in enumerate(values.tolist()):
            ends = []
            for sign in (1, -1):
                moved = values.copy()
                moved[number] += sign * 1e-5 * value
                ends.append(rg.solve(netlist.replace(**{field: moved})).voltage @ [0, 0, 1, -3])
            assert getattr(found, name)[number] == pytest.approx((ends[0] - ends[1]) / (2e-5 * value), rel=1e-6)


def test_parts_without_current_or_ground_have_their_derivatives() -> None:
    netlist = rg.Netlist(
        8, [[1, 2], [2, 0], [3, 4], [5, 6], [6, 7]], [1.0, 3.0, 5.0, 2.0, 2.0], source_nodes=[[1, 0], [3, 0]],
        source_volts=[2.0, 7.0], current_nodes=[[5, 7]], current_amps=[1.0],
    )  # fmt: skip
    op = rg.solve(netlist)
    found = rg.gradient(op, [0, 0, 1, 0, 10, 0, 0, 0])
    np.testing.assert_allclose(found.conductance, [0.375, -0.125, 0, 0, 0], rtol=1e-14)
    np.testing.assert_allclose(found.voltage, [0.25, 10.0], rtol=1e-14)
    assert found.current.tolist() == [0.0] and np.isnan(found.injection[5:]).all()
    known = rg.gradient(op, "voltage", at=[0, 1, 3])
    assert known.value == 9.0 and known.voltage.tolist() == [1.0, 1.0] and not known.conductance.any()


def test_sources_in_a_loop_have_no_derivative() -> None:
    netlist = rg.Netlist(3, [[1, 2], [2, 0]], [1.0, 1.0], source_nodes=[[1, 0], [1, 0]], source_volts=[2.0, 2.0])
    with pytest.warns(UserWarning, match="form loops"):
        op = rg.solve(netlist)
    with pytest.warns(UserWarning, match="form loops"):
        found = rg.gradient(op, "voltage", at=2)
    assert np.isnan(found.voltage).all() and found.conductance.tolist() == [0.5, -0.5]


def test_rejected_inputs_name_the_remedy() -> None:
    op = rg.solve(comb(4, 1.0))
    space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 6.0, 6)], [2, 0, 0, 1, 0, 1])
    open_ = rg.solve(rg.compile_space(space, boundary="neumann"))
    start = rg.solve(rg.compile_space(space, boundary="neumann", drive="start", start=(2,)))
    floating = rg.solve(rg.Netlist(4, [[1, 0], [2, 3]], [1.0, 1.0], source_nodes=[[1, 0]], source_volts=[1.0]))
    cases: list[tuple[str, object, object, dict[str, object]]] = [
        ("of = 'volts' must be 'voltage' or 'log_drop'", op, "volts", {"at": 3}),
        ("at is missing: give a node", op, "voltage", {}),
        ("leaves no choice of places", op, np.zeros(7), {"at": 3}),
        ("of shape \\(3,\\) must be 7 finite numbers", op, [1.0, 2.0, 3.0], {}),
        ("weights has shape \\(3,\\); give one number for each", op, "voltage", {"at": [3, 4], "weights": [1, 2, 3]}),
        ("the circuit has no node 99", op, "voltage", {"at": 99}),
        ("node node_1 has the log_drop -inf", op, "log_drop", {"at": 1}),
        ("no log_drop: exactly two known voltages", open_, "log_drop", {"at": (1,), "cells": True}),
        ("no log_drop: exactly two known voltages", open_, "collision_probability", {"at": (1,), "cells": True}),
        ("cell \\(4,\\) has no node", open_, "voltage", {"at": (4,), "cells": True}),
        ("node node_2 floats", floating, "voltage", {"at": 2}),
        ("not compiled from a space", op, "path_cost", {"at": 3}),
        ("leave out cost, or choose of = 'path_cost'", op, "voltage", {"at": 3, "cost": [1.0]}),
        ("one finite number of at least 0 per cell", open_, "path_cost", {"at": (1,), "cells": True, "cost": [1.0]}),
        ("a start-driven circuit absorbs walks", start, "path_cost", {"at": (1,), "cells": True}),
        ("method = 'fast' is unknown", op, "voltage", {"at": 3, "method": "fast"}),
        ("op = <a Netlist> must be an OperatingPoint", op.netlist, "voltage", {"at": 3}),
    ]  # fmt: skip
    for message, point, of, options in cases:
        with pytest.raises(rg.InputError, match=message):
            rg.gradient(point, of, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("leak", [0.0, 1e-3, 40.0])
@pytest.mark.parametrize("of", ["voltage", "log_drop", "path_cost", "path_cost_given_success"])
@pytest.mark.parametrize("options", [{}, {"rails": "cells", "supply": -3.0}, {"boundary": "neumann"}], ids=str)
def test_derivatives_with_respect_to_leaks_equal_differences(leak: float, of: str, options: rg.WiringOptions) -> None:
    space, place = space_of((5, 4)), (1, 1)
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
    netlist = rg.compile_space(space_of((4, 4)))
    with pytest.raises(rg.InputError, match=r"conductance has shape \(3,\); give one derivative per resistor"):
        rg.circuit.conductivity_gradient(netlist, np.ones(3))
    with pytest.raises(rg.InputError, match="not compiled from a space"):
        rg.circuit.conductivity_gradient(comb(4, 1.0), np.ones(8))


@pytest.mark.parametrize("siemens", [(1e-15, 1e15, 1e-15, 2e-15), (1e12, 1e-12, 1e12, 1e-12), (1.0, 1e-30, 1e30, 1.0)])
def test_conductances_of_any_ratio_have_accurate_derivatives(siemens: tuple[float, ...]) -> None:
    """A ladder whose currents are tiny differences of large ones."""
    rng = np.random.default_rng(3)
    pairs = [(1, 2), (2, 3), (3, 4), (4, 0), (2, 0), (3, 0), (1, 3), (2, 4)]
    netlist = rg.Netlist(
        5, pairs, np.resize(siemens, 8) * rng.uniform(0.5, 2, 8), source_nodes=[(1, 0)], source_volts=[1.0],
        current_nodes=[(0, 3)], current_amps=[-0.3 * max(siemens)],
    )  # fmt: skip
    found, every = rg.gradient(rg.solve(netlist), "voltage", at=[2, 4], weights=[1.0, -1.0]), all_elements(netlist)
    wanted = differences(netlist, lambda v: v[2] - v[4], every, 300)
    assert largest_error(found, wanted, every, 300) < 1e-9


def test_the_multigrid_method_gives_the_derivatives_of_the_direct_method() -> None:
    space = space_of((60, 50))
    op = rg.solve(rg.compile_space(space, resistance=1.0))
    place = tuple(np.argwhere(space.goal_connected & (space.cell == rg.Cell.FREE))[-1].tolist())
    direct, multigrid = (
        rg.gradient(op, "log_drop", at=place, cells=True, method=method) for method in ("direct", "multigrid")
    )
    largest = np.abs(direct.conductance).max()
    np.testing.assert_allclose(multigrid.conductance, direct.conductance, rtol=1e-6, atol=1e-12 * largest)


def test_places_are_nodes_names_masks_and_cells() -> None:
    netlist = rg.compile_space(space_of((5, 4)))
    op, node = rg.solve(netlist), netlist.cells.node
    mask = np.zeros((5, 4), dtype=bool)
    mask[1, 1] = mask[3, 2] = True
    wanted = rg.gradient(op, "voltage", at=[int(node[1, 1]), int(node[3, 2])])
    others = [
        rg.gradient(op, "voltage", at=netlist.names_of(node[[1, 3], [1, 2]])),
        rg.gradient(op, "voltage", at=np.isin(np.arange(netlist.node_count), node[mask])),
        rg.gradient(op, "voltage", at=[(1, 1), (3, 2)], cells=True),
        rg.gradient(op, "voltage", at=np.array([[1, 1], [3, 2]]), cells=True),
        rg.gradient(op, "voltage", at=mask, cells=True),
        rg.gradient(op, "voltage", at=(int(node[1, 1]), int(node[3, 2]))),
        rg.gradient(op, "voltage", at=[(1, 1), (3, 2), (1, 1)], weights=[3.0, 1.0, -2.0], cells=True),
    ]
    for other in others:
        assert other.value == pytest.approx(wanted.value, rel=1e-15)
        np.testing.assert_allclose(other.conductance, wanted.conductance, rtol=1e-12)


def test_weights_of_both_signs_give_the_difference_of_two_gradients() -> None:
    space = space_of((160, 150), seed=1)
    op = rg.solve(rg.compile_space(space, resistance=1.0))
    assert op.netlist.node_count > 20_000
    rng = np.random.default_rng(0)
    nodes = rng.choice(op.netlist.cells.free_node[space.goal_connected[space.cell == rg.Cell.FREE]], 40)
    seed = np.zeros(op.netlist.node_count)
    seed[nodes] = rng.normal(size=40)
    both, rising, falling = (
        rg.circuit.pullback(op, log_drop=part) for part in (seed, np.maximum(seed, 0), np.maximum(-seed, 0))
    )
    wanted = rising.conductance - falling.conductance
    np.testing.assert_allclose(both.conductance, wanted, rtol=1e-7, atol=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize("options", [{"edge": "open"}, {"boundary": "wall", "wall_resistance": 2.0, "supply": -3.0}])
def test_path_costs_given_success_equal_conditional_times_and_their_differences(options: rg.WiringOptions) -> None:
    space = space_of((5, 5))
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
