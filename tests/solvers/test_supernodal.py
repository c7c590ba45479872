"""Supernodal factors: order, pattern and accuracy of solutions, compared with mpmath, numpy and dense elimination.

Tests internals: `resgrid.circuit.equations`, `resgrid.solvers.factors`, `resgrid.solvers.laplacian`,
`resgrid.solvers.method_choice`, `resgrid.solvers.ordering_kernels`, `resgrid.solvers.supernodal`,
`resgrid.solvers.supernodal_factors`, `resgrid.solvers.symbolic`.
"""

from __future__ import annotations

from collections.abc import Callable

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import sparse
from support.spaces import serpentine, space_of

import resgrid as rg
from resgrid.circuit.equations import Equations, assemble
from resgrid.solvers.factors import DirectFactor, factor_direct
from resgrid.solvers.laplacian import Laplacian, Rows
from resgrid.solvers.method_choice import factor_laplacian
from resgrid.solvers.ordering_kernels import minimum_fill, quotient_graph
from resgrid.solvers.supernodal import factor_supernodes
from resgrid.solvers.supernodal_factors import SupernodalFactors
from resgrid.solvers.symbolic import Symbolic, order_by_distance, order_by_fill

ORDERS = pytest.mark.parametrize("order", [order_by_distance, order_by_fill])


Order = Callable[[Laplacian], Symbolic | None]


def irregular_system(size: int, seed: int) -> Equations:
    """A tree with some loops and conductances over 24 orders of magnitude, between two rails."""
    rng = np.random.default_rng(seed)
    tree = [(int(rng.integers(max(1, k - 3), k)), k) for k in range(2, size)]
    loops = [(k, k + 2) for k in range(2, size - 2) if rng.random() < 0.3]
    ties = [(0, 1), (size, size - 1)] + [(size, k) for k in range(1, size - 1) if rng.random() < 0.1]
    pairs = np.array(tree + loops + ties)
    conductance = 10.0 ** rng.uniform(-12, 12, len(pairs))
    return assemble(rg.Netlist(size + 1, pairs, conductance, np.array([[size, 0]]), np.array([1.0])))


def exact_solution(system: Equations, rhs: np.ndarray | list[mpmath.mpf], digits: int = 80) -> list[mpmath.mpf]:
    """The solution by mpmath, in the given number of digits."""
    with mpmath.workdps(digits):
        matrix = mpmath.matrix(-system.laplacian.edges.toarray())
        for i in range(system.size):
            matrix[i, i] = mpmath.mpf(float(system.laplacian.ground[i])) - sum(matrix[i, :])
        return list(mpmath.lu_solve(matrix, mpmath.matrix(rhs)))


@ORDERS
@settings(max_examples=60)
@given(st.integers(3, 24), st.integers(0, 2**32 - 1))
def test_solutions_are_accurate_for_all_conductances(order: Order, size: int, seed: int) -> None:
    system = irregular_system(size, seed)
    factors = factor_supernodes(system.laplacian, order(system.laplacian))
    rhs = np.random.default_rng(seed).random(system.size)
    m, e = factors.substitute(rhs, np.zeros(system.size, dtype=np.int64))
    for value, exponent, expected in zip(m, e, exact_solution(system, rhs), strict=True):
        with mpmath.workdps(80):
            error = abs(mpmath.ldexp(mpmath.mpf(float(value)), 256 * int(exponent)) / expected - 1)
        assert error < 1e-15 * (20 + 5 * size)


@ORDERS
@pytest.mark.parametrize("unit", [2.0**-530, 2.0**500, 2.0**900])
def test_solutions_do_not_depend_on_the_unit_of_conductance(order: Order, unit: float) -> None:
    system = assemble(rg.compile_space(space_of(serpentine(5, 20, 2))))
    plain, rhs = system.laplacian, system.laplacian.ground
    scaled = Laplacian(plain.ground * unit, compressed=Rows.of(plain.edges * unit))
    expected = factor_supernodes(plain, order(plain)).solve(rhs)
    np.testing.assert_allclose(factor_supernodes(scaled, order(scaled)).solve(rhs * unit), expected, rtol=1e-14)


@ORDERS
@settings(max_examples=25)
@given(st.integers(3, 24), st.integers(0, 2**32 - 1))
def test_solutions_are_accurate_for_extremely_different_right_hand_sides(order: Order, size: int, seed: int) -> None:
    system = irregular_system(size, seed)
    rng = np.random.default_rng(seed)
    m, e = np.where(rng.random(system.size) < 0.3, 0.0, rng.random(system.size)), rng.integers(-40, 1, system.size)
    m[rng.integers(system.size)] = 1.0
    solution, scale = factor_supernodes(system.laplacian, order(system.laplacian)).substitute(m, e)
    with mpmath.workdps(4000):
        injected = [mpmath.ldexp(mpmath.mpf(float(a)), 256 * int(b)) for a, b in zip(m, e, strict=True)]
    for value, exponent, expected in zip(solution, scale, exact_solution(system, injected, 4000), strict=True):
        with mpmath.workdps(80):
            error = abs(mpmath.ldexp(mpmath.mpf(float(value)), 256 * int(exponent)) / expected - 1)
        assert error < 1e-15 * (20 + 5 * size)


@ORDERS
@pytest.mark.parametrize("alone", [[], [3], [7, 8], [0, 4, 8]])
def test_isolated_grounded_rows_agree_with_numpy(order: Order, alone: list[int]) -> None:
    rng = np.random.default_rng(5)
    coupling = np.triu(rng.random((9, 9)), 1)
    coupling[alone] = coupling[:, alone] = 0.0
    coupling[rng.random((9, 9)) < 0.5] = 0.0
    coupling += coupling.T
    ground, rhs = rng.uniform(0.5, 2.0, 9), rng.random(9)
    laplacian = Laplacian(ground, compressed=Rows.of(sparse.csr_array(coupling)))
    expected = np.linalg.solve(np.diag(coupling.sum(axis=1) + ground) - coupling, rhs)
    np.testing.assert_allclose(factor_supernodes(laplacian, order(laplacian)).solve(rhs), expected, rtol=1e-13)


def test_solutions_that_underflow_within_a_supernode_are_accurate() -> None:
    """Every node is grounded by 1e20 S and coupled by 1e-20 S, so that each potential is 1e-40 of the preceding one."""
    size = 40
    along, held = np.stack([np.arange(1, size + 1), np.arange(2, size + 2)], axis=1), np.zeros((size, 2), dtype=int)
    held[:, 1] = np.arange(1, size + 1)
    conductance = np.repeat([1e-20, 1e20], size)
    netlist = rg.Netlist(
        size + 2, np.concatenate([along, held]), conductance, np.array([[size + 1, 0]]), np.array([1.0])
    )
    system = assemble(netlist)
    factors = factor_direct(system.laplacian)
    assert factors.factors.symbolic.widths.max() > 5
    for end in (0, size - 1):
        rhs = np.zeros(size)
        rhs[end] = 1e-20
        m, e = factors.factors.substitute(rhs, np.zeros(size, dtype=np.int64))
        for value, exponent, expected in zip(m, e, exact_solution(system, rhs, 2000), strict=True):
            with mpmath.workdps(80):
                assert abs(mpmath.ldexp(mpmath.mpf(float(value)), 256 * int(exponent)) / expected - 1) < 1e-13


def dense_factor(factors: SupernodalFactors) -> np.ndarray:
    """The unit lower triangular factor, NaN outside the pattern of the supernodes."""
    first, start, rows, offset = factors.symbolic.nodes
    lower = np.full((first[-1], first[-1]), np.nan)
    for node in range(len(first) - 1):
        inside = rows[start[node] : start[node + 1]]
        columns = np.arange(first[node], first[node + 1])
        assert np.array_equal(inside[: len(columns)], columns)
        assert np.all(np.diff(inside) > 0)
        block = factors.values[offset[node] : offset[node + 1]].reshape(len(columns), len(inside))
        assert np.all(np.tril(block.T, -1) == block.T)
        lower[np.ix_(inside, columns)] = -block.T
    np.fill_diagonal(lower, 1.0)
    return lower


def schur_complement(system: Equations, gone: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Schur complement of the kept rows after elimination of the others, no two of which are neighbours."""
    coupling = system.laplacian.edges.toarray()
    assert not coupling[np.ix_(gone, gone)].any()
    pivot = system.laplacian.ground[gone] + coupling[gone].sum(axis=1)
    shares = coupling[np.ix_(kept, gone)] / pivot
    joined = coupling[np.ix_(kept, kept)] + shares @ coupling[np.ix_(gone, kept)]
    excess = system.laplacian.ground[kept] + shares @ system.laplacian.ground[gone]
    np.fill_diagonal(joined, 0.0)
    return np.diag(joined.sum(axis=1) + excess) - joined


@ORDERS
@settings(max_examples=60)
@given(st.integers(3, 60), st.integers(0, 2**32 - 1))
def test_factors_reproduce_the_matrix_with_the_fill_of_elimination(order: Order, size: int, seed: int) -> None:
    system = irregular_system(size, seed)
    symbolic = order(system.laplacian)
    assert symbolic is not None
    kept, gone = np.split(symbolic.order, [symbolic.kept])
    assert np.array_equal(symbolic.order[symbolic.place], np.arange(system.size))
    factors = factor_supernodes(system.laplacian, symbolic)
    assert np.all(factors.pivot > 0)
    matrix = schur_complement(system, gone, kept)
    lower = dense_factor(factors)
    dense = np.nan_to_num(lower)
    product = (dense * factors.pivot[: len(kept)]) @ dense.T
    np.testing.assert_allclose(product, matrix, rtol=1e-12, atol=1e-12 * np.abs(matrix).max())
    filled = matrix != 0
    for k in range(len(kept)):
        later = np.flatnonzero(filled[k + 1 :, k]) + k + 1
        filled[np.ix_(later, later)] = True
    assert np.array_equal(dense != 0, np.tril(filled))
    above = symbolic.widths * (symbolic.widths - 1) // 2
    assert symbolic.entries - above.sum() <= 1.25 * np.tril(filled).sum() + 25 * len(symbolic.widths)


def test_factors_do_not_depend_on_the_length_of_elimination_stretches(monkeypatch: pytest.MonkeyPatch) -> None:
    system = irregular_system(200, 7)
    whole = factor_supernodes(system.laplacian)
    monkeypatch.setattr("resgrid.solvers.supernodal._STRETCH", 3)
    parts = factor_supernodes(system.laplacian)
    assert np.array_equal(whole.values, parts.values)
    assert np.array_equal(whole.pivot, parts.pivot)


def test_only_corridors_are_ordered_by_distance() -> None:
    corridor = assemble(rg.compile_space(space_of(serpentine(9, 60, 3)), boundary="neumann"))
    narrow = order_by_distance(corridor.laplacian)
    assert narrow is not None
    assert narrow.entries < 8 * corridor.size
    plane = np.zeros((600, 600), dtype=np.uint8)
    plane[300, 300] = 2
    assert order_by_distance(assemble(rg.compile_space(space_of(plane))).laplacian) is None
    ends = np.random.default_rng(5).integers(1, 2001, (4000, 2))
    pairs = np.concatenate([ends[ends[:, 0] != ends[:, 1]], [[0, 1]]])
    tangle = assemble(rg.Netlist(2001, pairs, np.ones(len(pairs)), current_nodes=[[0, 2]], current_amps=[1.0]))
    assert order_by_distance(tangle.laplacian) is None
    assert factor_direct(tangle.laplacian).factors.symbolic.entries > 60 * tangle.size


def test_a_hub_is_not_eliminated_first() -> None:
    """Elimination of the hub would couple all its neighbours, which needs 80 GB."""
    leaves = np.arange(2, 100_002)
    spokes, ring = np.stack([np.ones_like(leaves), leaves], axis=1), np.stack([leaves[:-1], leaves[1:]], axis=1)
    pairs = np.concatenate([spokes, ring, [[0, 2]]])
    netlist = rg.Netlist(100_002, pairs, np.ones(len(pairs)), current_nodes=[[0, 50_000]], current_amps=[1.0])
    system = assemble(netlist)
    narrow = order_by_distance(system.laplacian)
    assert narrow is not None
    hub = int(system.unknown[1])
    assert narrow.place[hub] < narrow.kept
    x = factor_direct(system.laplacian).solve(system.drive, rtol=1e-12)
    residual = system.drive - (system.laplacian.diagonal * x - system.laplacian.edges @ x)
    assert np.all(np.abs(residual) <= 1e-12 * system.laplacian.diagonal * np.abs(x).max())


def test_potentials_below_the_range_of_doubles_need_no_refinement() -> None:
    system = assemble(rg.compile_space(space_of(serpentine(21, 400, 1))))
    assert system.rails is not None
    factors = factor_direct(system.laplacian)
    m, e = factors.factors.substitute(system.rails.to_low, np.zeros(system.size, dtype=np.int64))
    refined, error = factors.solve_nonnegative(system.rails.to_low)
    assert e.min() < -10
    assert np.array_equal(e, refined.exponent)
    np.testing.assert_allclose(m, refined.hi, rtol=1e-15 * system.size, atol=0)
    assert error < 1e-25


def test_a_part_without_ground_raises_accuracy_error() -> None:
    system = irregular_system(8, 1)
    system.laplacian.ground[:] = 0.0
    with pytest.raises(rg.AccuracyError, match="orders of magnitude"):
        factor_direct(system.laplacian)


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_solutions_of_a_large_maze_do_not_depend_on_the_order(boundary: str) -> None:
    system = assemble(rg.compile_space(space_of(serpentine(61, 400, 1)), boundary=boundary))
    for accuracy in ("direction", "normwise"):
        assert factor_laplacian(system.laplacian, "auto", accuracy=accuracy).name == "direct"
    rhs = np.maximum(system.drive, 0.0) if system.rails is None else system.rails.to_low
    logs = [
        DirectFactor(system.laplacian, factor_supernodes(system.laplacian, order(system.laplacian)))
        .solve_nonnegative(rhs)[0]
        .log
        for order in (order_by_distance, order_by_fill)
    ]
    np.testing.assert_allclose(*logs, atol=1e-9)


@pytest.mark.parametrize("shape", [(150, 160), (20, 20, 20)])
def test_the_order_by_fill_meets_nested_dissection_bounds(shape: tuple[int, ...]) -> None:
    """George & Liu (1981): ``n log n`` entries of planes, ``n^(4/3)`` of volumes, a few times."""
    cell = np.zeros(shape, dtype=np.uint8)
    cell[(0,) * len(shape)] = 2
    laplacian = assemble(rg.compile_space(space_of(cell))).laplacian
    n = laplacian.size
    allowed = 2.0 * n * np.log2(n) if len(shape) == 2 else 6.0 * n ** (4 / 3)
    symbolic = order_by_fill(laplacian)
    assert symbolic is not None
    assert symbolic.entries < allowed
    assert order_by_fill(laplacian, 0.5 * symbolic.entries) is None


@given(st.integers(3, 400), st.integers(0, 2**32 - 1))
def test_elimination_steps_are_consecutive(size: int, seed: int) -> None:
    laplacian = irregular_system(size, seed).laplacian
    symbolic = order_by_fill(laplacian)
    assert symbolic is not None
    rows, n, kept = laplacian.graph, laplacian.size, symbolic.kept
    step = np.empty(n, dtype=np.int32)
    assert minimum_fill(quotient_graph(rows.indptr, rows.indices), symbolic.place, kept, n, np.inf, 2**31 - 1, step)
    assert np.array_equal(np.unique(step), np.arange(len(np.unique(step))))
    assert np.array_equal(np.sort(step[symbolic.order[kept:]]), np.arange(n - kept))


def test_an_order_with_many_element_members_gives_accurate_factors() -> None:
    """On a graph without good separators the elements have many more members than there are rows."""
    size = 3000
    ends = np.random.default_rng(5).integers(1, size + 1, (3 * size, 2))
    pairs = np.concatenate([ends[ends[:, 0] != ends[:, 1]], [[0, 1]]])
    system = assemble(rg.Netlist(size + 1, pairs, np.ones(len(pairs)), current_nodes=[[0, 2]], current_amps=[1.0]))
    factors = factor_supernodes(system.laplacian, order_by_fill(system.laplacian))
    x = factors.solve(system.drive)
    residual = system.drive - (system.laplacian.diagonal * x - system.laplacian.edges @ x)
    assert np.abs(residual).max() < 1e-12 * np.abs(x).max()
