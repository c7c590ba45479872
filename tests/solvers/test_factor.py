"""Arguments of factors: shapes, finite numbers, tolerances; pickling and independence of earlier solves.

Tests internals: `resgrid.solvers.factors`, `resgrid.solvers.scaled`.
"""

from __future__ import annotations

import pickle
from dataclasses import fields

import numpy as np
import pytest
from support.spaces import serpentine, space_of

import resgrid as rg
from resgrid.solvers.factors import Factor
from resgrid.solvers.scaled import Scaled


def open_netlist(*shape: int) -> rg.Netlist:
    cell = np.zeros(shape, dtype=np.uint8)
    cell[0, 0], cell[-1, -1] = 2, 1
    return rg.compile_space(space_of(cell))


FACTORS = {
    "direct": lambda: rg.factorize(open_netlist(24, 30), method="direct"),
    "direct, in space": lambda: rg.factorize(open_netlist(12, 13, 14), method="direct"),
    "multigrid": lambda: rg.factorize(open_netlist(24, 30), method="multigrid"),
    "direct, in a corridor": lambda: rg.factorize(rg.compile_space(space_of(serpentine(3, 30, 1)))),
}


@pytest.fixture(scope="module", params=FACTORS)
def factors(request: pytest.FixtureRequest) -> Factor:
    return FACTORS[request.param]()


@pytest.mark.parametrize("shape", [7, 10_000, "2d"])
def test_right_hand_sides_and_guesses_of_a_wrong_shape_raise_input_error(factors: Factor, shape: int | str) -> None:
    n = factors.system.size
    wrong = np.ones((n, 1)) if shape == "2d" else np.ones(shape)
    with pytest.raises(rg.InputError, match=rf"rhs has shape .*, but there are {n} rows"):
        factors.solve(wrong)
    with pytest.raises(rg.InputError, match=rf"guess has shape .*, but there are {n} rows"):
        factors.solve(np.ones(n), guess=wrong)
    with pytest.raises(rg.InputError, match=rf"rhs has shape .*, but there are {n} rows"):
        factors.factors.solve_nonnegative(wrong)


def test_invalid_right_hand_sides_and_tolerances_raise_input_error(factors: Factor) -> None:
    n = factors.system.size
    for wrong in (["one"] * n, np.ones(n) + 1j, None):
        with pytest.raises(rg.InputError, match=r"rhs (must be an array of real numbers|has shape)"):
            factors.solve(wrong)
    for bad in (np.nan, np.inf):
        rhs = np.ones(n)
        rhs[3] = bad
        with pytest.raises(rg.InputError, match=rf"rhs\[3\] is {bad}; it must be finite"):
            factors.solve(rhs)
        with pytest.raises(rg.InputError, match=r"guess\[3\]"):
            factors.solve(np.ones(n), guess=rhs)
    for rtol in (0.0, 1.0, -1e-8, np.nan):
        with pytest.raises(rg.InputError, match="must be a number between 0 and 1"):
            factors.solve(np.ones(n), rtol=rtol)
    negative = np.ones(n)
    negative[5] = -1e-300
    for rhs in (negative, Scaled.of(negative)):
        with pytest.raises(rg.InputError, match=r"rhs\[5\] = -1e-300 is negative"):
            factors.factors.solve_nonnegative(rhs)


def test_lists_integers_and_strided_arrays_are_accepted(factors: Factor) -> None:
    n = factors.system.size
    amps = np.arange(2.0 * n)[::2]
    x = factors.solve(np.ascontiguousarray(amps))
    for same in (amps, amps.tolist(), amps.astype(np.int64)):
        np.testing.assert_array_equal(factors.solve(same), x)
    entrywise, _ = factors.factors.solve_nonnegative(amps)
    np.testing.assert_allclose(entrywise.plain, x, rtol=1e-8, atol=1e-8 * x.max())


def test_the_best_result_of_accuracy_error_is_complete() -> None:
    maze = np.pad(np.zeros((20, 20), dtype=np.uint8), ((0, 0), (0, 60)), constant_values=1)
    maze[10, 20:], maze[0, 0] = 0, 2
    netlist = rg.compile_space(
        space_of(maze, conductivity=10.0 ** np.random.default_rng(1).uniform(-9, 9, maze.shape)), boundary="neumann"
    )
    factors = rg.factorize(netlist, method="multigrid")
    with pytest.raises(rg.AccuracyError) as failure:
        factors.solve(factors.system.drive, rtol=1e-20)
    assert np.shape(failure.value.best) == (factors.system.size,)
    with pytest.raises(rg.AccuracyError) as failure:
        rg.solve(netlist, method="multigrid", accuracy="normwise", rtol=1e-20)
    assert isinstance(failure.value.best, rg.OperatingPoint)
    assert failure.value.best.voltage.shape == (netlist.node_count,)


@pytest.mark.parametrize("method", ["direct", "multigrid"])
@pytest.mark.parametrize("density", [0.1, 0.38])
def test_pickled_factors_give_the_same_results(method: str, density: float) -> None:
    cell = (np.random.default_rng(1).random((60, 60)) < density).astype(np.uint8)
    cell[20:22, 20:22] = 2, 0
    factors = rg.factorize(rg.compile_space(space_of(cell)), method=method)
    rhs = factors.system.drive
    if factors.factors.name == "direct":
        np.testing.assert_array_equal(pickle.loads(pickle.dumps(factors)).solve(rhs), factors.solve(rhs))
    else:
        np.testing.assert_allclose(pickle.loads(pickle.dumps(factors)).solve(rhs), factors.solve(rhs), atol=1e-8)


def irregular_network(nodes: int, seed: int) -> rg.Netlist:
    """A chain with random resistors across it over twelve orders of magnitude, two current and two voltage sources."""
    rng = np.random.default_rng(seed)
    chain = np.stack([np.arange(nodes - 1), np.arange(1, nodes)], axis=1)
    across = rng.integers(0, nodes, (3 * nodes, 2))
    ends = np.concatenate([chain, across[across[:, 0] != across[:, 1]]])
    return rg.Netlist(
        nodes, ends, 10.0 ** rng.uniform(-9, 3, len(ends)), source_nodes=[[nodes - 1, 0], [nodes // 2, 0]],
        source_volts=[1.0, 0.3], current_nodes=[[0, 3], [5, 7]], current_amps=[1e-3, 2e-3],
    )  # fmt: skip


@pytest.mark.parametrize("method", ["direct", "multigrid"])
def test_results_do_not_depend_on_earlier_solves(method: str) -> None:
    factors = rg.factorize(irregular_network(600, 1), method=method)
    rhs = np.ones(factors.system.size)
    first = factors.solve(rhs)
    factors.factors.solve_nonnegative(rhs)
    np.testing.assert_array_equal(factors.solve(rhs), first)


@pytest.mark.parametrize("method", ["direct", "multigrid"])
def test_factors_and_systems_have_no_hidden_attributes(method: str) -> None:
    """Frozen dataclasses must not store caches outside their fields."""
    corridor = np.zeros((60, 8), dtype=np.uint8)
    corridor[0, 0] = 2
    for netlist in (rg.compile_space(space_of(corridor)), irregular_network(600, 0)):
        factors = rg.factorize(netlist, method=method)
        rhs = np.ones(factors.system.size)
        factors.solve(rhs)
        factors.factors.solve_nonnegative(rhs)
        rails = [factors.system.rails] if factors.system.rails is not None else []
        for value in (factors, factors.factors, factors.system, factors.system.laplacian, *rails):
            assert set(vars(value)) == {field.name for field in fields(value)}
