"""The K-cycle over a packed hierarchy: red-black grids, then graphs in compressed rows (Notay & Vassilevski 2008).

One visit of a level smooths, restricts the residual, and takes the answer of the levels below for a direction.  The
K-cycle makes of it one or two steps of flexible conjugate gradients.  A red-black grid is solved for its black nodes
alone: red ones are eliminated exactly on the way down and put back on the way up.
"""

from __future__ import annotations

import numpy as np

from resgrid.jit import ZERO, inner, kernel
from resgrid.solvers.multigrid import atomics, slabs
from resgrid.solvers.multigrid.graph_sweeps import (
    Graphs,
    Work,
    ascend_graph,
    descend_graph,
    multiply_after,
    multiply_graph,
    solve_coarsest,
)
from resgrid.solvers.multigrid.levels import CHUNK, combine, keep_step, second_step, take_step
from resgrid.solvers.multigrid.red_black import Floats, Integers, Singles
from resgrid.solvers.multigrid.slabs import Table
from resgrid.solvers.multigrid.subnormals import flush_subnormals, restore_subnormals

ENOUGH = 0.07
"""Residual after the first step of a K-cycle on the first coarse level that spares the second."""


def precondition_graph(
    graphs: Graphs, work: Work, ground: Floats, r: Singles, s: Singles, z: Singles, w: Singles
) -> tuple[float, float, float]:
    """Precondition the residual ``r`` of a netlist, and multiply: ``w = A z``; returns ``z.r, z.w, z.s``.

    ``ground`` (n,): from every node of the first graph to known voltages.
    """
    b, x, only = work.b[1:], work.x[1:], len(graphs.first) == 2
    b[: len(r)] = r
    if only:
        run_cycle(graphs, work, ENOUGH, 0)
    else:
        descend_graph(graphs, 0, b, x)
        run_cycle(graphs, work, ENOUGH, 1)
        ascend_graph(graphs, 0, b, x, work.w)
    z[:] = x[: len(r)]
    return multiply_graph(graphs, ground, z, r, s, w)


def run_cycle(graphs: Graphs, work: Work, stop: float, top: int) -> None:
    """Approximate ``x = A^-1 b`` on level ``top`` of a netlist's graphs by K-cycles.

    The second step is spared where the first has brought the residual under ``stop`` times the right-hand side, twice
    that on every level further down; an infinite ``stop`` spares both.
    """
    _run_cycle(graphs, work, stop, top, len(graphs.first) > 2 or None, None)


def precondition_grid(
    table: Table, state: Integers, graphs: Graphs, work: Work, stop: float
) -> tuple[float, float, float]:
    """Precondition a residual over a grid's black cells, and multiply by their Schur complement.

    Returns ``z.r, z.w, z.s``, of the finest level's vectors.  ``stop``: as of `run_cycle`; others may help
    (`slabs.help_sweep`).
    """
    return _precondition_grid(table, state, graphs, work, stop, len(graphs.first) > 2 or None)


@kernel
def _precondition_grid(
    table: Table, state: Integers, graphs: Graphs, work: Work, stop: float, on_graphs: bool | None
) -> tuple[float, float, float]:
    flags = flush_subnormals()
    slabs.begin(table, state)
    _run_within(graphs, work, stop, 0, on_graphs, (table, state))
    products = slabs.finish(table, state, ZERO, ZERO)
    atomics.end_jobs(state)
    restore_subnormals(flags)
    return products


@inner
def _run_within(
    graphs: Graphs, work: Work, stop: float, top: int, on_graphs: bool | None, on_grids: tuple[Table, Integers] | None
) -> None:
    """`run_cycle`, on the grids below the finest one as well.

    Where there are no grids, or no graphs but the last one, None: their visits are not compiled then.  The recursion is
    written as a loop, since compiled recursive functions cannot be kept on disk.
    """
    flags = flush_subnormals()
    count = len(on_grids[0]) - 1 if on_grids is not None else 0
    last, b, x = count + len(graphs.first) - 2, work.b[1:], work.x[1:]
    visits, first_steps = np.zeros(last + 1, np.int64), np.zeros((last + 1, 2))
    level = top
    while level >= top:
        if level == last:
            solve_coarsest(graphs, b, x)
            level -= 1
            continue
        visit, enough = (visits[level], first_steps[level]), stop * (1 << (level - top))
        done = True
        if level >= count:
            if on_graphs is not None:
                done = _visit_graph(graphs, (b, x, work.c, work.v, work.w), level - count, visit, enough)
        elif on_grids is not None:
            done = slabs.visit_grid(on_grids[0], on_grids[1], level + 1, visit, enough)
        visits[level] = 0 if done else visits[level] + 1
        level += -1 if done else 1
    restore_subnormals(flags)


_run_cycle = kernel(_run_within)


@inner
def _visit_graph(
    graphs: Graphs, vectors: tuple[Singles, Singles, Singles, Singles, Singles], level: int,
    visit: tuple[int, Floats], stop: float,
) -> bool:  # fmt: skip
    """As `slabs.visit_grid`, of a graph; ``vectors``: as of `Work`, from the first node on."""
    b, x, c, v, w = vectors
    if visit[0] > 0:
        a, e = graphs.first[level], graphs.first[level + 1]
        r, z, of = b[a:e], x[a:e], v[a:e]
        ascend_graph(graphs, level, b, x, w)
        products = multiply_after(graphs, level, r, z, w, of, of if visit[0] == 1 else w[a:e])
        if _step(visit, stop, products, r, z, c[a:e], of):
            return True
    descend_graph(graphs, level, b, x)
    return False


@inner
def _step(
    visit: tuple[int, Floats], stop: float, products: tuple[float, float, float], r: Singles, z: Singles, c: Singles,
    v: Singles,
) -> bool:  # fmt: skip
    """A step of the K-cycle along ``z``; returns whether it was the last one, which leaves the answer in ``z``."""
    count, first = visit
    if count == 1:
        first[0], first[1] = products[0], products[1]
        return stop == np.inf or _first_step(r, z, c, v, stop, first[0], first[1])
    rest, product, gamma = products
    on_c, on_z = second_step(first[0], first[1], rest, product, gamma)
    combine(z, c, np.float32(on_c), np.float32(on_z), ZERO, len(z), z)
    return True


@inner
def _first_step(r: Singles, z: Singles, c: Singles, v: Singles, stop: float, alpha: float, energy: float) -> bool:
    """First step of the K-cycle along ``z``, whose product is ``v``; returns whether it suffices.

    Leaves the answer in ``z``, or else the direction in ``c`` and the residual in ``r``.
    """
    if not energy > 0.0:
        return True
    step, before, after = np.float32(alpha / energy), 0.0, 0.0
    for begin in range(0, len(r), CHUNK):
        old, new = take_step(r, v, step, begin, min(begin + CHUNK, len(r)))
        before, after = before + old, after + new
    enough = not after > stop * stop * before
    keep_step(z, c, step, enough, ZERO, len(z))
    return enough
