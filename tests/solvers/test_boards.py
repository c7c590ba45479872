"""Stencils of grid levels, compared with dense algebra: residuals, Schur complements, aggregates, coarse levels.

Tests internals: `resgrid._internal.jit`, `resgrid.circuit.equations`, `resgrid.solvers.laplacian`,
`resgrid.solvers.multigrid`, `resgrid.solvers.multigrid.graph_coarsening`,
`resgrid.solvers.multigrid.grid_coarsening`, `resgrid.solvers.multigrid.grid_level`,
`resgrid.solvers.multigrid.hierarchy`, `resgrid.solvers.multigrid.krylov`, `resgrid.solvers.multigrid.levels`.
"""

from typing import Any

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from support.levels import cells_of, matrix_of, preconditioned
from support.spaces import space_of, spaces

import resgrid as rg
from resgrid._internal.jit import ZERO, kernel
from resgrid.circuit.equations import Equations, assemble
from resgrid.solvers.laplacian import Graph, Grid
from resgrid.solvers.multigrid import cycle
from resgrid.solvers.multigrid.graph_coarsening import pack_graphs
from resgrid.solvers.multigrid.grid_coarsening import coarsen
from resgrid.solvers.multigrid.grid_level import Level, compensated, in_single, lay_out, stencil_of, to_graph
from resgrid.solvers.multigrid.hierarchy import GridProblem, build_hierarchy
from resgrid.solvers.multigrid.krylov import black_residual
from resgrid.solvers.multigrid.levels import Finest, Levels

BOUNDARIES = st.sampled_from(["dirichlet", "neumann"])


def system_and_level(
    space: rg.ConfigurationSpace, boundary: str, spread: float, seed: int
) -> tuple[Equations, Level] | None:
    """System and stencil of a space with random conductances; None for undriven spaces or without a stencil."""
    try:
        netlist = rg.compile_space(space, boundary=boundary)
        factors = np.exp(np.random.default_rng(seed).normal(0.0, spread, len(netlist.conductance)))
        system = assemble(netlist.replace(conductance=netlist.conductance * factors))
    except rg.CircuitError:
        return None
    made = lay_out(
        system.netlist.resistor_nodes,
        system.netlist.conductance,
        system.unknown,
        Grid(system.netlist.cells.node, ()).of_rows(system.unknown).vertex,
        system.laplacian.ground,
        1.0,
    )
    return None if made is None else (system, made[0])


def coarse_levels(level: Level, split: bool) -> list[Level]:
    """Return a level and all coarser levels."""
    levels = [level]
    while levels[-1].size > 3 and min(levels[-1].lattice.shape) > 1:
        made = coarsen(levels[-1], split=split)
        if made is None or made[0].size == levels[-1].size:
            break
        levels.append(made[0])
    return levels


def problem_above_one_node(finest: Finest) -> GridProblem:
    """A finest level with one coarse node, whose voltage is 1."""
    alone = Graph(np.zeros(2, np.int32), np.empty(0, np.int32), np.empty(0), np.ones(1))
    room = np.zeros((2, 2, len(finest.aggregate)))
    problem = GridProblem(finest, Levels((), pack_graphs([alone], [])[0]), *room)
    problem.work.x[:] = [0.0, 1.0]
    return problem


@kernel
def ascend(table: NDArray[Any], state: NDArray[np.int64]) -> tuple[float, float, float]:
    """Ascend to the finest level."""
    return cycle.ascend_grid(table, state, ZERO, ZERO)


@settings(max_examples=60)
@given(spaces(max_cells=12), BOUNDARIES, st.integers(1, 40), st.integers(0, 2**16))
def test_schur_complements_equal_those_of_dense_elimination(
    space: rg.ConfigurationSpace, boundary: str, block: int, seed: int
) -> None:
    made = system_and_level(space, boundary, 0.3, seed)
    if made is None:
        return
    for level in coarse_levels(made[1], split=False):
        matrix, used = matrix_of(level)
        slots = level.lattice.slots
        red, black = used < slots, used >= slots
        if not red.any() or not black.any():
            continue
        pivots = matrix[np.ix_(red, red)]
        assert np.array_equal(pivots, np.diag(pivots.diagonal()))
        schur = matrix[np.ix_(black, black)] - matrix[np.ix_(black, red)] @ (
            matrix[np.ix_(red, black)] / pivots.diagonal()[:, None]
        )
        rng = np.random.default_rng(seed)
        z, r, s = np.zeros((3, slots), dtype=np.float32)
        here = used[black] - slots
        z[here], r[here], s[here] = rng.normal(size=(3, len(here)))
        stencil = in_single(stencil_of(level))._replace(block=block)
        stencil = stencil._replace(black_degree=compensated(level, stencil))
        relaxed = z[here] + 1.0
        to_one = np.zeros(slots, dtype=np.int32)
        to_one[here] = 1
        finest = Finest(stencil_of(level), stencil, to_one)
        problem = problem_above_one_node(finest)
        v, w = problem.vectors, problem.vectors.w
        v.before[:], v.r[:], v.s[:] = z, r, s
        problem.set_output(z)
        zr, zw, zs = ascend(problem.table, problem.state)
        size = np.abs(schur).sum(axis=1).max() * np.abs(z).max()
        degree = matrix.diagonal()[black]
        relaxed += (r[here] - schur @ relaxed) / degree
        np.testing.assert_allclose(z[here], relaxed, rtol=0, atol=1e-5 * np.abs(z).max())
        np.testing.assert_allclose(w[here], schur @ z[here].astype(float), rtol=0, atol=1e-6 * size)
        wide, product = z[here].astype(float), schur @ z[here].astype(float)
        assert zr == pytest.approx(wide @ r[here], rel=1e-6, abs=1e-6 * np.abs(wide).sum())
        assert zw == pytest.approx(wide @ product, rel=1e-6, abs=1e-6 * size * np.abs(wide).sum())
        assert zs == pytest.approx(wide @ s[here], rel=1e-6, abs=1e-6 * np.abs(wide).sum())


@settings(max_examples=60)
@given(spaces(max_cells=12), BOUNDARIES, st.integers(0, 2**16))
def test_products_of_a_constant_equal_the_leak_despite_rounding(
    space: rg.ConfigurationSpace, boundary: str, seed: int
) -> None:
    made = system_and_level(space, boundary, 1.0, seed)
    if made is None:
        return
    for level in coarse_levels(made[1], split=False):
        matrix, used = matrix_of(level)
        slots, ends = level.lattice.slots, (level.edges.off_red, level.edges.off_black)
        black = used >= slots
        schur = matrix[np.ix_(black, black)] - matrix[np.ix_(black, ~black)] @ np.linalg.solve(
            matrix[np.ix_(~black, ~black)], matrix[np.ix_(~black, black)]
        )
        stencil = in_single(stencil_of(level))
        red, far = np.nonzero(stencil.faces)[::-1], level.lattice.distance
        there = np.concatenate([red[0] + far[red[1]], ends[1]])
        here, g = (
            np.concatenate([red[0], ends[0]]),
            np.concatenate([stencil.faces[red[::-1]], stencil.couplings]).astype(float),
        )
        share = stencil.red_inverse * np.bincount(here, g, slots)
        left = compensated(level, stencil) - np.bincount(there, g * share[here], slots)
        degree = matrix.diagonal()[black]
        np.testing.assert_array_less(
            np.abs(left[used[black] - slots] - schur.sum(axis=1)), 1e-6 * schur.sum(axis=1) + 1e-13 * degree
        )


@settings(max_examples=60)
@given(spaces(max_cells=12), BOUNDARIES, st.integers(1, 40), st.integers(0, 2**16))
def test_residuals_equal_those_of_the_dense_matrix(
    space: rg.ConfigurationSpace, boundary: str, block: int, seed: int
) -> None:
    made = system_and_level(space, boundary, 1.0, seed)
    if made is None:
        return
    for level in coarse_levels(made[1], split=False):
        matrix, used = matrix_of(level)
        slots = level.lattice.slots
        rng = np.random.default_rng(seed)
        x, b = np.zeros((2, 2 * slots))
        x[used], b[used] = rng.normal(size=(2, len(used)))
        r = np.ones(slots)
        x = x.reshape(2, slots)
        norm = black_residual(stencil_of(level)._replace(block=block), b.reshape(2, slots), x, r)
        assert not r[: level.lattice.margin].any()
        assert not r[-level.lattice.margin :].any()
        residual = b[used] - matrix @ x.ravel()[used]
        size = np.abs(matrix).sum(axis=1).max() * np.abs(x).max() + np.abs(b).max()
        black = used >= slots
        np.testing.assert_allclose(r[used[black] - slots], residual[black], rtol=0, atol=1e-13 * size)
        np.testing.assert_allclose(residual[~black], 0.0, atol=1e-13 * size)
        assert norm == pytest.approx(np.linalg.norm(residual[black]), rel=1e-12, abs=1e-13 * size)


@settings(max_examples=60)
@given(spaces(max_cells=12), BOUNDARIES, st.integers(0, 2**16))
def test_aggregates_are_the_connected_components_of_blocks(
    space: rg.ConfigurationSpace, boundary: str, seed: int
) -> None:
    check_aggregates(space, boundary, seed)


def test_components_on_a_ring_of_two_blocks_are_not_merged() -> None:
    """On a ring of two blocks two conductances join the same cells, which must not merge four cells."""
    walls = "002000020100 000010110100 000110010000 100100010000"
    cell = np.array([list(row) for row in walls.split()], dtype=np.uint8).reshape(4, 4, 3)
    axes = [rg.Axis("x", 0.0, 2.0, 4, periodic=True), rg.Axis("y", 0.0, 8.0, 4), rg.Axis("z", 0.0, 1.5, 3)]
    check_aggregates(rg.ConfigurationSpace(axes, cell), "dirichlet", 0)


def check_aggregates(space: rg.ConfigurationSpace, boundary: str, seed: int) -> None:
    made = system_and_level(space, boundary, 0.0, seed)
    if made is None:
        return
    level = made[1]
    for _ in range(3):
        result = coarsen(level, split=False)
        if result is None or level.size < 3:
            return
        coarse, target = result
        graph, number = to_graph(level)
        row = np.repeat(np.arange(graph.size), np.diff(graph.indptr))
        shrinks = [n > m for n, m in zip(level.lattice.shape, coarse.lattice.shape, strict=True)]
        block = cells_of(level) >> np.array(shrinks, dtype=np.int64)
        inside = np.all(block[row] == block[graph.indices], axis=1)
        parts = nx.Graph()
        parts.add_nodes_from(range(graph.size))
        parts.add_edges_from(zip(row[inside].tolist(), graph.indices[inside].tolist(), strict=True))
        node = target.ravel()[number >= 0]
        expected = {frozenset(part) for part in nx.connected_components(parts)}
        assert {frozenset(np.flatnonzero(node == one).tolist()) for one in np.unique(node)} == expected
        assert coarse.size == len(expected)
        level = coarse


@settings(max_examples=40)
@given(spaces(max_cells=14), BOUNDARIES, st.integers(0, 2**16))
def test_coarse_levels_have_the_couplings_of_their_resistors_only(
    space: rg.ConfigurationSpace, boundary: str, seed: int
) -> None:
    made = system_and_level(space, boundary, 0.0, seed)
    result = None if made is None else coarsen(made[1], split=False)
    if made is None or result is None:
        return
    level, (coarse, target) = made[1], result
    fine, number = to_graph(level)
    small, slot = to_graph(coarse)
    node = slot[target.ravel()[number >= 0]]
    row = np.repeat(np.arange(fine.size), np.diff(fine.indptr))
    joined = {(a, b) for a, b in zip(node[row].tolist(), node[fine.indices].tolist(), strict=True) if a != b}
    there = np.repeat(np.arange(small.size), np.diff(small.indptr))
    assert set(zip(there.tolist(), small.indices.tolist(), strict=True)) == joined
    tied = np.unique(node[fine.leak > 0])
    np.testing.assert_array_equal(np.flatnonzero(small.leak > 0), tied)
    assert np.all(small.leak[tied] <= np.bincount(node, fine.leak, small.size)[tied] * (1 + 1e-12))


def test_coarse_levels_of_an_open_grid_keep_the_conductance() -> None:
    cell = np.zeros((64, 64), dtype=np.uint8)
    cell[0, 0] = 2
    made = system_and_level(space_of(cell), "neumann", 0.0, 1)
    assert made is not None
    unit = made[0].netlist.conductance.mean()
    for level in coarse_levels(made[1], split=False)[:4]:
        inner = level.edges.faces[level.edges.faces > 0] / unit
        assert np.median(inner) == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("shape", [(40, 40), (40, 64), (12, 13, 14)])
def test_the_preconditioner_is_symmetric_and_positive(shape: tuple[int, ...]) -> None:
    cell = (np.random.default_rng(7).random(shape) < 0.2).astype(np.uint8)
    cell[(0,) * len(shape)] = 2
    system = assemble(rg.compile_space(space_of(cell), boundary="neumann"))
    hierarchy = build_hierarchy(system.laplacian)
    assert hierarchy.grid is not None
    assert len(hierarchy.levels.grids) > 0
    used = hierarchy.grid.true.black_degree > 0
    a, b = (np.random.default_rng(1).normal(size=(2, len(used))) * used).astype(np.float32)
    left, right = b @ preconditioned(hierarchy, a), a @ preconditioned(hierarchy, b)
    assert left == pytest.approx(right, rel=1e-4)
    assert a @ preconditioned(hierarchy, a) > 0


def test_problems_share_conductances_but_not_work_arrays() -> None:
    cell = np.zeros((40, 40), dtype=np.uint8)
    cell[0, 0] = 2
    hierarchy = build_hierarchy(assemble(rg.compile_space(space_of(cell), boundary="neumann")).laplacian)
    assert hierarchy.grid is not None
    rooms = np.zeros((2, 2, 2, len(hierarchy.grid.aggregate)))
    both = [GridProblem(hierarchy.grid, hierarchy.levels, *room) for room in rooms]
    one, other = (problem.table for problem in both)
    assert not np.any(one["red_rhs"][1:] == other["red_rhs"][1:])
    assert np.array_equal(one["faces"], other["faces"])
