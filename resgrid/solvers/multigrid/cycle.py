"""The K-cycle: visits of red-black grids, then of graphs in compressed rows (Notay & Vassilevski 2008).

One visit of a level smooths, restricts the residual, and uses the solution of the lower levels as a search direction.
The K-cycle combines one or two such directions by flexible conjugate gradients. A red-black grid is solved for its
black nodes only: red nodes are eliminated exactly on the way down, and back-substituted on the way up.

Sweeps over grids run slab by slab, on one thread or several (`sweeps`). One thread leads; the others process slabs of
large levels (`resgrid.solvers.llvm_intrinsics`).
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
"""Rows of `levels.GRID`, shape (levels,)."""

ENOUGH = 0.07
"""Relative residual after the first step of a K-cycle on the first coarse level that skips the second step."""


def precondition_graph(
    graphs: Graphs, work: SweepBuffers, r: Singles, s: Singles, z: Singles, w: Singles
) -> tuple[float, float, float]:
    """Precondition the residual ``r`` of a netlist, and multiply: ``w = A z``; returns ``z.r, z.w, z.s``."""
    b, x = work.b[1:], work.x[1:]
    b[: len(r)] = r
    descend_graph(graphs, 0, b, x)
    run_cycle(graphs, work, ENOUGH, 1)
    products = ascend_graph(graphs, 0, b, x, s, work.change, w)
    z[:] = x[: len(r)]
    return products


def run_cycle(graphs: Graphs, work: SweepBuffers, stop: float, top: int) -> None:
    """Approximate ``x = A^-1 b`` on level ``top`` of a netlist's graphs by K-cycles.

    The second step is skipped if the first reduces the residual below ``stop`` times the right-hand side, and below
    twice that fraction on every further level down. An infinite ``stop`` skips both.
    """
    _run_cycle(graphs, work, stop, top, len(graphs.first) > 2 or None, None)


def precondition_grid(
    table: Table, state: Integers, graphs: Graphs, work: SweepBuffers, stop: float
) -> tuple[float, float, float]:
    """Precondition the residual of a grid's black cells, and multiply by their Schur complement.

    Returns ``z.r, z.w, z.s`` of the finest level's vectors. ``stop``: relative residual that skips second steps (see
    `run_cycle`). Other threads may help (`help_sweep`).
    """
    return _precondition_grid(table, state, graphs, work, stop, len(graphs.first) > 2 or None)


@kernel
def _precondition_grid(
    table: Table, state: Integers, graphs: Graphs, work: SweepBuffers, stop: float, on_graphs: bool | None
) -> tuple[float, float, float]:
    """Precondition as `precondition_grid` describes; ``on_graphs`` None omits the code for visits of graphs."""
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
    """Run K-cycles on graphs, and on the grids below the finest one.

    ``on_grids`` or ``on_graphs`` is None if there are no grids, or no graphs except the coarsest: their visits are then
    not compiled. The recursion is written as a loop, since numba cannot cache recursive functions.
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
    """Process a graph at its first, second or third visit in a K-cycle; returns whether its solution is complete.

    ``vectors``: arrays of `SweepBuffers`, from the first node on; ``visit``: number of the visit, and products of the
    first step.
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
    """Compute the step of a K-cycle (Notay & Vassilevski 2008).

    Returns whether the first step is to be taken, and its length; otherwise the coefficients of the first and the
    second direction in the solution.
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
    """Sweep over a level, with other threads if it is divided into slabs; returns sums over its slabs.

    Couplings are added after all slabs.
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
    """Return the address of the array that receives the product with the matrix in a visit of a level."""
    return int(level.s if visit == 1 else level.w)


@kernel
def help_sweep(table: Table, state: Integers) -> None:
    """Process slabs for the leading thread until no job follows."""
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
    """Sweep over slab ``part`` of a level; ``kind`` is one of `sweeps.CLEAR` ...; ``visit``: number in the K-cycle."""
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
    """Process a grid at its first, second or third visit in a K-cycle; returns whether its solution is complete.

    At the first visit red nodes are eliminated. At later visits the next level's solution is a search direction. Unless
    the grid is solved, its relaxed residual is restricted to the next level.
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
    """Add the next level's solution to that of level ``number``, relax, and multiply; returns ``z.r, z.w, z.s``."""
    for kind in (PROLONG, RELAX):
        _sweep(table, state, kind, number, visit)
    return _sweep(table, state, MULTIPLY, number, visit)


@inner
def _restrict_finest(table: Table, state: Integers) -> None:
    """Restrict the finest level's relaxed residual."""
    for kind in (CLEAR, RESTRICT):
        _sweep(table, state, kind, ZERO, ZERO)
