"""The K-cycle over a packed hierarchy: red-black grids, then graphs in compressed rows (Notay & Vassilevski 2008).

One visit of a level smooths, restricts the residual, and takes the answer of the levels below for a direction.  The
K-cycle makes of it one or two steps of flexible conjugate gradients.  A red-black grid is solved for its black nodes
alone: red ones are eliminated exactly on the way down and put back on the way up.

Sweeps over grids run slab by slab, on one thread or several (`sweeps`): one thread leads, and the others help where
there is a part to be done (`resgrid.solvers.llvm_intrinsics`).
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
    CLEAR,
    COMBINE,
    ELIMINATE,
    MULTIPLY,
    PUT_BACK,
    RAISE,
    RELAX,
    RESTRICT,
    TAKE,
)
from resgrid.solvers.scaled import Floats, Integers, Singles

Table = NDArray[Any]
"""Rows of `levels.GRID`, shape (levels,)."""

ENOUGH = 0.07
"""Residual after the first step of a K-cycle on the first coarse level that spares the second."""


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

    The second step is spared where the first has brought the residual under ``stop`` times the right-hand side, twice
    that on every level further down; an infinite ``stop`` spares both.
    """
    _run_cycle(graphs, work, stop, top, len(graphs.first) > 2 or None, None)


def precondition_grid(
    table: Table, state: Integers, graphs: Graphs, work: SweepBuffers, stop: float
) -> tuple[float, float, float]:
    """Precondition a residual over a grid's black cells, and multiply by their Schur complement.

    Returns ``z.r, z.w, z.s``, of the finest level's vectors.  ``stop``: as of `run_cycle`; others may help
    (`help_sweep`).
    """
    return _precondition_grid(table, state, graphs, work, stop, len(graphs.first) > 2 or None)


@kernel
def _precondition_grid(
    table: Table, state: Integers, graphs: Graphs, work: SweepBuffers, stop: float, on_graphs: bool | None
) -> tuple[float, float, float]:
    flags = flush_subnormals()
    _begin(table, state)
    _run_within(graphs, work, stop, 0, on_graphs, (table, state))
    products = finish_grid(table, state, ZERO, ZERO)
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
    """`run_cycle`, on the grids below the finest one as well.

    Where there are no grids, or no graphs but the last one, None: their visits are not compiled then.  The recursion is
    written as a loop, since compiled recursive functions cannot be kept on disk.
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
    """As `_visit_grid`, of a graph; ``vectors``: as of `SweepBuffers`, from the first node on."""
    b, x, c, v, w, change = vectors
    if visit[0] > 0:
        a, e = graphs.first[level], graphs.first[level + 1]
        r, z, first, product = b[a:e], x[a:e], c[a:e], v[a:e]
        products = ascend_graph(graphs, level, b, x, product, change, product if visit[0] == 1 else w[a:e])
        going_on, (on_c, on_z) = _step(visit, products, stop)
        if going_on:
            before, after = take_step(r, product, np.float32(on_c), ZERO, len(r))
            copy(z, ZERO, len(z), first)
            going_on = after > stop * stop * before
        if not going_on:
            combine(z, first, np.float32(on_c), np.float32(on_z), ZERO, len(z), z)
            return True
    descend_graph(graphs, level, b, x)
    return False


@inner
def _step(
    visit: tuple[int, Floats], products: tuple[float, float, float], stop: float
) -> tuple[bool, tuple[float, float]]:
    """Of a K-cycle (Notay & Vassilevski 2008): whether its first step is to be taken, or else it ends, and shares.

    These are what the first and the second direction have in the answer.
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
    """Sweep over a level, together with whoever helps where it is cut; returns what is summed over its slabs.

    What couplings carry follows behind all slabs.
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
    if kind >= TAKE:
        sums = doubles(level.sums, 3 * level.blocks)
        for k in range(0, len(sums), 3):
            first, second, third = first + sums[k], second + sums[k + 1], third + sums[k + 2]
    if ELIMINATE <= kind <= RELAX or kind == MULTIPLY:
        second -= sweeps.follow_couplings(level, kind, singles(_product(level, visit), level.slots))
    return first, second, third


@inner
def _product(level: Row, visit: int) -> int:
    """Where the product of a visit's answer goes."""
    return int(level.s if visit == 1 else level.w)


@kernel
def help_sweep(table: Table, state: Integers) -> None:
    """Sweep over slabs for the thread that leads, until it has no more."""
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
    """A slab's part of a sweep."""
    slab, parts = slab_of(level, part), level.parts
    if kind == CLEAR or kind == ELIMINATE or kind == TAKE:  # noqa: PLR1714, SIM109 (compiles in half the time)
        below_fed = singles(level.below_fed, level.below_slots)
        for k in range(part * len(below_fed) // parts, (part + 1) * len(below_fed) // parts):
            below_fed[k] = 0.0
    if ELIMINATE <= kind <= RELAX:
        sweeps.feed_black(level, kind, slab)
    elif kind == MULTIPLY:
        sweeps.multiply(level, slab, singles(_product(level, visit), level.slots))
    elif kind == PUT_BACK:
        sweeps.put_back(level, slab)
    elif kind > CLEAR:
        sweeps.pass_over(level, kind, slab)


@inner
def _visit_grid(table: Table, state: Integers, number: int, visit: tuple[int, Floats], stop: float) -> bool:
    """Come to a grid for the first, second or third time; returns whether it is solved, or the next level is due.

    Coming from above, red nodes are eliminated; from below, the next level's answer is a direction; each time the level
    is relaxed from zero, and the residual summed into the next level.
    """
    count, going_on = visit[0], True
    if count == 0:
        _sweep(table, state, ELIMINATE, number, count)
    else:
        products, shares = finish_grid(table, state, number, count), doubles(table[number].shares, 2)
        going_on, (shares[0], shares[1]) = _step(visit, products, stop)
        if going_on:
            before, after, _ = _sweep(table, state, TAKE, number, count)
            going_on = after > stop * stop * before
        if not going_on:
            _sweep(table, state, COMBINE, number, count)
    _sweep(table, state, RESTRICT if going_on else PUT_BACK, number, count)
    return not going_on


@inner
def finish_grid(table: Table, state: Integers, number: int, visit: int) -> tuple[float, float, float]:
    """Add the next level's answer, relax, and multiply; returns ``z.r``, ``z.w`` and ``z.s``."""
    for kind in (RAISE, RELAX):
        _sweep(table, state, kind, number, visit)
    return _sweep(table, state, MULTIPLY, number, visit)


@inner
def _begin(table: Table, state: Integers) -> None:
    """Restrict the finest level's relaxed residual."""
    for kind in (CLEAR, RESTRICT):
        _sweep(table, state, kind, ZERO, ZERO)
