"""The K-cycle over red-black grids, then over graphs in compressed rows (Notay & Vassilevski 2008).

A level is visited up to three times per cycle. One visit smooths, restricts the residual to the next coarser level, and
uses the solution of the coarser levels as a search direction. The K-cycle combines one or two such directions by
flexible conjugate gradients. A red-black grid is solved for its black nodes only: red nodes are eliminated exactly
before the restriction, and back-substituted afterwards.

Sweeps over grids run slab by slab (a range of cells), on one thread or several (`sweeps`). One thread leads; the others
process slabs of large levels (`resgrid.solvers.llvm_intrinsics`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import ZERO, inner, kernel
from resgrid.solvers import llvm_intrinsics
from resgrid.solvers.llvm_intrinsics import doubles, flush_subnormals, restore_subnormals, singles
from resgrid.solvers.multigrid import sweeps
from resgrid.solvers.multigrid.graph_sweeps import (
    Graphs,
    SweepBuffers,
    ascend_graph,
    descend_graph,
    solve_coarsest,
)
from resgrid.solvers.multigrid.levels import Row, combine, copy, slab_of, take_step
from resgrid.solvers.multigrid.sweeps import (
    BACK_SUBSTITUTE,
    CLEAR,
    COMBINE,
    ELIMINATE,
    MULTIPLY,
    PROLONG,
    RELAX,
    RESTRICT,
    STEP,
)
from resgrid.solvers.scaled import Floats, Integers, Singles

Table = NDArray[Any]
"""Records of the grids of a hierarchy, finest first, shape (levels,), of the data type `levels.GRID`."""

ENOUGH = 0.07
"""Ratio of residual norms after and before the first step of the K-cycle below which the second step is skipped.

The ratio applies to the first coarse level, and doubles from level to level.
"""


def precondition_graph(
    graphs: Graphs, work: SweepBuffers, r: Singles, s: Singles, z: Singles, w: Singles
) -> tuple[float, float, float]:
    """Precondition the residual ``r`` of a netlist into ``z``; set ``w = A z``; return ``z.r``, ``z.w`` and ``z.s``.

    The results are inner products; ``A`` is the matrix of the finest level. `graphs`: levels of the netlist, finest
    first; `work`: work arrays; `r, s` (n,): residual, and ``A`` times the last search direction, in the node order of
    the finest level; `z, w` (n,): receive the preconditioned residual and its product.
    """
    b, x = work.b[1:], work.x[1:]
    b[: len(r)] = r
    descend_graph(graphs, 0, b, x)
    run_cycle(graphs, work, ENOUGH, 1)
    products = ascend_graph(graphs, 0, b, x, s, work.change, w)
    z[:] = x[: len(r)]
    return products


def run_cycle(graphs: Graphs, work: SweepBuffers, stop: float, top: int) -> None:
    """Approximate ``x = A^-1 b`` on level ``top`` of a netlist by K-cycles; ``b`` and ``x`` are arrays of ``work``.

    `graphs`: levels of the netlist, finest first; `work`: work arrays of all levels; `stop`: ratio of the residual
    norms after and before the first step of level ``top`` below which the second step is skipped; this ratio doubles
    from level to level. With an infinite ``stop`` the solution of the next level is used directly, as in a V-cycle.
    """
    _run_cycle(graphs, work, stop, top, len(graphs.first) > 2 or None, None)


def precondition_grid(
    table: Table, state: Integers, graphs: Graphs, work: SweepBuffers, stop: float
) -> tuple[float, float, float]:
    """Precondition the residual ``r`` of a grid's black cells into ``z``, set ``w = S z``, return ``z.r, z.w, z.s``.

    ``S`` is the Schur complement of the black cells. The vectors ``r``, ``s``, ``z`` and ``w`` of the finest level are
    found through the addresses in the first record of ``table``; ``s`` is ``S`` times the last search direction.

    `table`: records of the grids; `state`: array by which the threads share out the work (`help_sweep`), fields as in
    `resgrid.solvers.llvm_intrinsics`; `graphs`: levels below the grids; `work`: work arrays of the graphs; `stop`:
    ratio of the residual norms after and before the first step of a K-cycle on the first coarse level below which the
    second step is skipped.
    """
    return _precondition_grid(table, state, graphs, work, stop, len(graphs.first) > 2 or None)


@kernel
def _precondition_grid(
    table: Table, state: Integers, graphs: Graphs, work: SweepBuffers, stop: float, on_graphs: bool | None
) -> tuple[float, float, float]:
    """Precondition the black residual ``r`` by one multigrid cycle; return ``z.r, z.w, z.s`` of the finest grid.

    ``z`` is the correction, ``w`` the product of the matrix with ``z``, and ``s`` the product with the last search
    direction.

    `table`: records of the grids; `state`: array by which the threads share out the work; `graphs, work`: graphs below
    the grids and their work arrays; `stop`: ratio of the residual norms after and before the first step of a K-cycle on
    the first coarse level below which the second step is skipped; `on_graphs`: True, or None if there is one graph
    only, to omit the code that cycles over graphs.
    """
    flags = flush_subnormals()
    _restrict_finest(table, state)
    _run_within(graphs, work, stop, 0, on_graphs, (table, state))
    products = ascend_grid(table, state, ZERO, ZERO)
    llvm_intrinsics.end_jobs(state)
    restore_subnormals(flags)
    return products


@inner
def _run_within(
    graphs: Graphs,
    work: SweepBuffers,
    stop: float,
    top: int,
    on_graphs: bool | None,
    on_grids: tuple[Table, Integers] | None,
) -> None:
    """Run K-cycles on the grids below the finest one, and on the graphs below the grids.

    `graphs, work`: graphs and their work arrays; `stop`: ratio of the residual norms after and before the first step on
    level ``top`` below which the second step is skipped, doubled from level to level; `top`: first level, counted from
    0 over the coarse grids and then the graphs; `on_grids`: records of all grids, and array shared with the helper
    threads; `on_graphs`: True, or None.

    ``on_grids`` is None if there are no grids, ``on_graphs`` if there are no graphs except the coarsest: the code for
    these levels is then not compiled. The recursion is written as a loop, since numba cannot cache recursive functions.
    """
    flags = flush_subnormals()
    count = len(on_grids[0]) - 1 if on_grids is not None else 0
    last, b, x = count + len(graphs.first) - 2, work.b[1:], work.x[1:]
    visits, first_steps, level = work.visits, work.first_steps, top
    for number in range(last + 1):
        visits[number] = 0
    while level >= top:
        if level == last:
            solve_coarsest(graphs, b, x)
            level -= 1
            continue
        visit, enough = (visits[level], first_steps[level]), stop * (1 << (level - top))
        done = True
        if level >= count:
            if on_graphs is not None:
                done = _visit_graph(graphs, (b, x, work.c, work.v, work.w, work.change), level - count, visit, enough)
        elif on_grids is not None:
            done = _visit_grid(on_grids[0], on_grids[1], level + 1, visit, enough)
        visits[level] = 0 if done else visits[level] + 1
        level += -1 if done else 1
    restore_subnormals(flags)


_run_cycle = kernel(_run_within)


@inner
def _visit_graph(
    graphs: Graphs, vectors: tuple[Singles, Singles, Singles, Singles, Singles, Singles], level: int,
    visit: tuple[int, Floats], stop: float,
) -> bool:  # fmt: skip
    """Process a graph when the K-cycle reaches it, up to three times; return whether the graph's solution is complete.

    The first time `x` is relaxed from zero, and the residual is restricted to the next level. Later the next level's
    solution is prolonged and relaxed to a search direction in `x`. After a first step that reduces the residual too
    little, relaxation and restriction are repeated for a second direction. On completion `x` holds the solution.

    `graphs, level`: all graphs, and index of this one; `vectors` (nodes,): `b, x, c, v, w, change`, over the nodes of
    all graphs: right-hand side, from which the first step is subtracted; solution; first search direction; products of
    the matrix with the first and the second direction; changes of `x` by the last sweep. `b, x` are given without their
    unused entry 0. `visit`: number of times that the cycle has returned to this graph from the next level, and work
    array (2,) for the products of the first step; `stop`: ratio of the residual norms after and before the first step
    below which the second step is skipped.
    """
    b, x, c, v, w, change = vectors
    if visit[0] > 0:
        a, e = graphs.first[level], graphs.first[level + 1]
        r, z, first, product = b[a:e], x[a:e], c[a:e], v[a:e]
        products = ascend_graph(graphs, level, b, x, product, change, product if visit[0] == 1 else w[a:e])
        continues, (on_c, on_z) = _step(visit, products, stop)
        if continues:
            before, after = take_step(r, product, np.float32(on_c), ZERO, len(r))
            copy(z, ZERO, len(z), first)
            continues = after > stop * stop * before
        if not continues:
            combine(z, first, np.float32(on_c), np.float32(on_z), ZERO, len(z), z)
            return True
    descend_graph(graphs, level, b, x)
    return False


@inner
def _step(
    visit: tuple[int, Floats], products: tuple[float, float, float], stop: float
) -> tuple[bool, tuple[float, float]]:
    """Compute a step of the K-cycle of one level (Notay & Vassilevski 2008).

    `visit`: number of times that the cycle has returned to this level from the next one (1: first direction, 2:
    second), and work array (2,) for the products of the first step; `products`: ``z.r, z.A z, z.s`` of the new
    direction ``z``, where ``s`` is the product of the matrix with the first direction; `stop`: ratio of residual norms
    after and before the first step below which the second step is skipped, infinite to use the first direction with the
    coefficient 1.

    Returns whether to continue with a second step, and two numbers: the length of the first step and 0 to continue,
    otherwise the coefficients of the first and the second direction in the solution.
    """
    (count, first), (rest, product, gamma) = visit, products
    if count > 1:
        alpha, energy = first[0], first[1]
        second = product - gamma * gamma / energy
        step = rest / second if second > 0.0 else 0.0
        return False, ((alpha - gamma * step) / energy, step)
    first[0], first[1] = rest, product
    if product > 0.0 and stop < np.inf:
        return True, (rest / product, 0.0)
    return False, (0.0, 1.0)


@inner
def _sweep(table: Table, state: Integers, kind: int, number: int, visit: int) -> tuple[float, float, float]:
    """Sweep over a level, with other threads if it is divided into slabs; return three sums over its blocks of cells.

    `table, number`: records of the grids, and index of the level in them; `state`: array shared with the helper
    threads; `kind`: kind of the sweep, a constant of `sweeps`; `visit`: number of times that the K-cycle has returned
    to this level from the next one. After `MULTIPLY` the sums are the inner products ``z.r, z.w, z.s`` (correction with
    residual, with product, and with the first product of the K-cycle); after `STEP` the squared residual norms before
    and after the step, and 0; else they have no meaning. Couplings (edges that cross no face) are added after all
    slabs.
    """
    level, part = table[number], ZERO
    if level.parts > 1:
        llvm_intrinsics.announce(state, kind, number, visit, level.parts)
        part = llvm_intrinsics.claim(state)
    while part >= 0:
        _sweep_slab(level, kind, visit, part)
        part = -1
        if level.parts > 1:
            llvm_intrinsics.finish(state)
            part = llvm_intrinsics.claim(state)
    if level.parts > 1:
        llvm_intrinsics.wait_for(state, level.parts)
    first, second, third = 0.0, 0.0, 0.0
    if kind >= STEP:
        sums = doubles(level.sums, 3 * level.blocks)
        for k in range(0, len(sums), 3):
            first, second, third = first + sums[k], second + sums[k + 1], third + sums[k + 2]
    if ELIMINATE <= kind <= RELAX or kind == MULTIPLY:
        second -= sweeps.add_couplings(level, kind, singles(_product(level, visit), level.slots))
    return first, second, third


@inner
def _product(level: Row, visit: int) -> int:
    """Return the address of the array that receives the product of the matrix with the correction ``z`` of a level.

    `level`: record of the grid; `visit`: number of times that the K-cycle has returned to this level from the next one.
    The first product (1) is kept in the field ``s``; other products go to the field ``w``.
    """
    return int(level.s if visit == 1 else level.w)


@kernel
def help_sweep(table: Table, state: Integers) -> None:
    """Process slabs on a helper thread until the leading thread signals that no sweep follows.

    `table`: records of the grids; `state`: array shared by the threads, which contains the kind of the present sweep,
    the index of its level, and the number of times that the K-cycle has returned to this level.
    """
    flags = flush_subnormals()
    while True:
        part = llvm_intrinsics.await_part(state)
        if part < 0:
            break
        _sweep_slab(
            table[state[llvm_intrinsics.LEVEL]], state[llvm_intrinsics.KIND], state[llvm_intrinsics.VISIT], part
        )
        llvm_intrinsics.finish(state)
    restore_subnormals(flags)


@inner
def _sweep_slab(level: Row, kind: int, visit: int, part: int) -> None:
    """Sweep over one slab, a range of cells, of a level.

    `CLEAR`, `ELIMINATE` and `STEP` also set this slab's part of the next level's right-hand side to 0. `level`: record
    of the grid; `kind`: kind of the sweep, a constant of `sweeps`; `visit`: number of times that the K-cycle has
    returned to this level from the next one; `part`: number of the slab, from 0.
    """
    slab, parts = slab_of(level, part), level.parts
    if kind == CLEAR or kind == ELIMINATE or kind == STEP:  # noqa: PLR1714, SIM109 (compiles in half the time)
        below_rhs = singles(level.below_rhs, level.below_slots)
        for k in range(part * len(below_rhs) // parts, (part + 1) * len(below_rhs) // parts):
            below_rhs[k] = 0.0
    if ELIMINATE <= kind <= RELAX:
        sweeps.sweep_black(level, kind, slab)
    elif kind == MULTIPLY:
        sweeps.multiply(level, slab, singles(_product(level, visit), level.slots))
    elif kind == BACK_SUBSTITUTE:
        sweeps.back_substitute(level, slab)
    elif kind > CLEAR:
        sweeps.update_slots(level, kind, slab)


@inner
def _visit_grid(table: Table, state: Integers, number: int, visit: tuple[int, Floats], stop: float) -> bool:
    """Process a grid when the K-cycle reaches it, up to three times; return whether the grid's solution is complete.

    The first time red nodes are eliminated. Later the solution of the next level is prolonged and relaxed to a search
    direction. Unless the solution is complete, the residual is then relaxed (a Jacobi step from zero), and what remains
    of the residual is restricted to the next level.

    `table, number`: records of the grids, and index of the level in them; `state`: array shared with the helper
    threads; `visit`: number of times that the cycle has returned to this grid from the next level, and work array (2,)
    for the products of the first step; `stop`: ratio of the residual norms after and before the first step below which
    the second step is skipped.
    """
    count, continues = visit[0], True
    if count == 0:
        _sweep(table, state, ELIMINATE, number, count)
    else:
        products, coefficients = ascend_grid(table, state, number, count), doubles(table[number].coefficients, 2)
        continues, (coefficients[0], coefficients[1]) = _step(visit, products, stop)
        if continues:
            before, after, _ = _sweep(table, state, STEP, number, count)
            continues = after > stop * stop * before
        if not continues:
            _sweep(table, state, COMBINE, number, count)
    _sweep(table, state, RESTRICT if continues else BACK_SUBSTITUTE, number, count)
    return not continues


@inner
def ascend_grid(table: Table, state: Integers, number: int, visit: int) -> tuple[float, float, float]:
    """Prolong the next level's solution to a grid, relax, and multiply by the matrix; return ``z.r, z.w, z.s``.

    `table, number`: records of the grids, and index of the level in them; `state`: array shared with the helper
    threads; `visit`: number of times that the K-cycle has returned to this level from the next one. ``z`` is the
    relaxed correction, ``w`` the product, ``r`` the residual; ``s`` is the product of the matrix with the previous
    direction.
    """
    for kind in (PROLONG, RELAX):
        _sweep(table, state, kind, number, visit)
    return _sweep(table, state, MULTIPLY, number, visit)


@inner
def _restrict_finest(table: Table, state: Integers) -> None:
    """Restrict the residual of the finest grid, after its relaxation by a Jacobi step, to the next level.

    `table`: records of the grids, finest first; `state`: array shared with the helper threads.
    """
    for kind in (CLEAR, RESTRICT):
        _sweep(table, state, kind, ZERO, ZERO)
