"""Gradients: central differences in mpmath at 40 to 1100 digits, exact fractions, laws, and rejected inputs."""

from __future__ import annotations

from fractions import Fraction

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from support.fractions_solver import solve_exactly
from support.mpmath_circuits import all_elements, comb, differences, largest_error
from support.spaces import rough_space

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
    level = st.floats(-3, 3).map(lambda value: round(value, 9))  # below 1e-308, doubles lose digits
    pairs = [(node, draw(st.integers(0, node - 1))) for node in range(1, nodes)]
    pairs += draw(st.lists(st.tuples(st.integers(0, nodes - 1), st.integers(0, nodes - 1)), max_size=6))
    conductance = [draw(siemens) for _ in range(len(pairs) + 1)]
    return rg.Netlist(
        nodes + 1, [*pairs, (nodes, draw(st.integers(1, nodes - 1)))], conductance,
        source_nodes=[(1, 0), (nodes, 2)], source_volts=[draw(level), draw(level)],
        current_nodes=[(0, draw(st.integers(1, nodes - 1)))], current_amps=[draw(level)],
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
@pytest.mark.quick_cases(1)
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
        ("at = \\[\\] names no place", op, "voltage", {"at": []}),
        ("weights = \\[nan\\] must be finite numbers", op, "voltage", {"at": 3, "weights": np.nan}),
        ("leaves no choice of places", op, np.zeros(7), {"at": 3}),
        ("leave out at, weights, cost and cells", op, np.zeros(7), {"cells": True}),
        ("of shape \\(3,\\) must be 7 finite numbers", op, [1.0, 2.0, 3.0], {}),
        ("weights has shape \\(3,\\); give one number for each", op, "voltage", {"at": [3, 4], "weights": [1, 2, 3]}),
        ("the circuit has no node 99", op, "voltage", {"at": 99}),
        ("node node_1 has the log_drop -inf", op, "log_drop", {"at": 1}),
        ("no log_drop: exactly two known voltages", open_, "log_drop", {"at": (1,), "cells": True}),
        ("no log_drop: exactly two known voltages", open_, "collision_probability", {"at": (1,), "cells": True}),
        ("cell \\(4,\\) is free, but has no path to a goal and", open_, "voltage", {"at": (4,), "cells": True}),
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
    with pytest.raises(rg.InputError, match="the seeds are missing; give voltage or log_drop"):
        rg.circuit.pullback(op)


@pytest.mark.parametrize("ends", [(1, 2), (2, 1)])
def test_floating_sources_beside_unequal_conductances_keep_small_derivatives(ends: tuple[int, int]) -> None:
    netlist = rg.Netlist(3, [(1, 0), (2, 0)], [1.9e-12, 70.0], source_nodes=[ends], source_volts=[0.5])
    found = rg.gradient(rg.solve(netlist), "voltage", at=2)
    assert found.voltage == pytest.approx((ends[0] - ends[1]) * 1.9e-12 / (70.0 + 1.9e-12), rel=1e-12, abs=0.0)


def test_floating_sources_at_different_depths_have_derivatives_of_different_scales() -> None:
    """A ladder with a drop of 1e-401 and ammeters at three depths, whose derivatives are exact powers of its ratio."""
    ratio, pairs, siemens, last, ammeters = 1e20, [], [], 2, []
    for step in range(20):
        if step in (1, 10, 18):
            ammeters.append((last + 1, last))
            pairs, siemens, last = [*pairs, (last, 1)], [*siemens, ratio], last + 1
        pairs, siemens, last = [*pairs, (last, last + 1), (last + 1, 1)], [*siemens, 1.0, ratio], last + 1
    netlist = rg.Netlist(
        last + 1, pairs, siemens, source_nodes=[(1, 0), (2, 0), *ammeters], source_volts=[1.0, 0.25, 0.0, 0.0, 0.0]
    )
    found = rg.gradient(rg.solve(netlist), "log_drop", at=last)
    assert found.voltage == pytest.approx([-np.inf, -4 / 3, -8e20 / 3, -16e200 / 3, -np.inf], rel=1e-12)


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
    space = rough_space((60, 50))
    op = rg.solve(rg.compile_space(space, resistance=1.0))
    place = tuple(np.argwhere(space.goal_connected & (space.cell == rg.Cell.FREE))[-1].tolist())
    direct, multigrid = (
        rg.gradient(op, "log_drop", at=place, cells=True, method=method) for method in ("direct", "multigrid")
    )
    largest = np.abs(direct.conductance).max()
    np.testing.assert_allclose(multigrid.conductance, direct.conductance, rtol=1e-6, atol=1e-12 * largest)


def test_places_are_nodes_names_masks_and_cells() -> None:
    netlist = rg.compile_space(rough_space((5, 4)))
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


def test_a_mask_of_cells_counts_every_cell_of_a_merged_rail() -> None:
    space = rg.ConfigurationSpace([rg.Axis("x", 0.0, 5.0, 5)], [2, 0, 1, 1, 0])
    op = rg.solve(rg.compile_space(space))
    mask, several = (rg.gradient(op, "voltage", at=at, cells=True) for at in (np.arange(5) % 4 >= 2, [(2,), (3,)]))
    assert mask.value == several.value == 2.0
    assert mask.voltage.tolist() == several.voltage.tolist()


def test_weights_of_both_signs_give_the_difference_of_two_gradients() -> None:
    space = rough_space((160, 150), seed=1)
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
