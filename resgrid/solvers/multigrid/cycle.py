"""The K-cycle over a packed hierarchy: red-black grids, then graphs in compressed rows (Notay & Vassilevski 2008).

One visit of a level smooths, restricts the residual, and takes the answer of the levels below for a direction.  The
K-cycle makes of it one or two steps of flexible conjugate gradients.  A red-black grid is solved for its black nodes
alone: red ones are eliminated exactly on the way down and put back on the way up.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from resgrid.jit import ZERO, inner, inner_fast
from resgrid.solvers.multigrid.graph_sweeps import Graphs, ascend_graph, descend_graph, solve_coarsest
from resgrid.solvers.multigrid.red_black import (
    Floats,
    Indices,
    Integers,
    Singles,
    Stencil,
    add_into_black,
    relax_red,
)
from resgrid.solvers.multigrid.subnormals import flush_subnormals, restore_subnormals
from resgrid.solvers.multigrid.sweeps import prolong_and_multiply, restrict

CHUNK = 2048
"""Slots over which sums are taken before they are added to others: the same whoever takes them."""


class Grids(NamedTuple):
    """Coarse red-black grids in single precision, one behind the other.

    Places of level ``l`` stand at ``slots[l] ... slots[l + 1]``, its couplings and faces at the corresponding stretches
    of their arrays (`Stencil`).

    `slots, first_off` (levels + 1,); `margin, block` (levels,); `distance` (levels, 2 ndim); `aggregate`: node of
    the next level that a black slot belongs to: its slot there, red ones first; of a graph, counted from 1; 0 for
    none; `weight`: what it takes from there; empty where that is all (`resgrid.solvers.multigrid.h_transform`).
    """

    slots: Integers
    first_off: Integers
    margin: Integers
    block: Integers
    distance: Integers
    faces: Singles
    couplings: Singles
    off_red: Indices
    off_black: Indices
    red_inverse: Singles
    black_inverse: Singles
    black_degree: Singles
    aggregate: Indices
    weight: Singles


class Work(NamedTuple):
    """Work space of one solve.

    `b, x`: currents and voltages: of both colours of all grids, of nothing at one slot, of all graphs' nodes; `f,
    z`: right-hand side and answer of the grids' black slots; `c, v, w`: first direction and products, of the grids'
    black slots, then of the graphs' nodes.
    """

    b: Singles
    x: Singles
    f: Singles
    z: Singles
    c: Singles
    v: Singles
    w: Singles


class Levels(NamedTuple):
    """A packed hierarchy, coarse grids first, graphs below; a netlist's first graph is its finest level."""

    grids: Grids
    graphs: Graphs
    work: Work


class Finest(NamedTuple):
    """The finest level: of a grid with the way to the next one; of a netlist, what its first graph leaves open.

    `stencil, exact`: in single precision, and with a diagonal that makes up for it (`grid_level.compensated`);
    `aggregate, weight` (slots,): as of `Grids`; `ground` (n,): from every node of a netlist's first graph to known
    voltages, in units; empty for a grid, as all others are for a netlist.
    """

    stencil: Stencil
    exact: Stencil
    aggregate: Indices
    weight: Singles
    ground: Floats


class _Vectors(NamedTuple):
    """Right-hand side, answer, first direction and products of one level's nodes (of a grid: of its black ones)."""

    r: Singles
    z: Singles
    c: Singles
    v: Singles
    w: Singles


@inner
def precondition(
    finest: Finest, levels: Levels, stop: float, r: Singles, s: Singles, z: Singles, w: Singles
) -> tuple[float, float, float]:
    """Precondition the residual ``r``, relaxed in ``z``, and multiply: ``w = A z``; returns ``z.r, z.w, z.s``.

    Of a grid, all vectors are over its black cells, and the matrix is their Schur complement.
    """
    flags = flush_subnormals()
    if len(finest.ground) > 0:
        products = _precondition_graph(finest.ground, levels, stop, r, s, z, w)
    else:
        grids, graphs, work = levels
        size = 2 * grids.slots[1] if len(grids.margin) > 0 else 1 + graphs.first[1]
        restrict(finest.stencil, finest.aggregate, finest.weight, z, work.b[:size])
        run_cycle(levels, stop, ZERO)
        products = prolong_and_multiply(
            finest.stencil, finest.exact, finest.aggregate, finest.weight, work.x[:size], r, s, z, w
        )
    restore_subnormals(flags)
    return products


@inner
def _precondition_graph(
    ground: Floats, levels: Levels, stop: float, r: Singles, s: Singles, z: Singles, w: Singles
) -> tuple[float, float, float]:
    graphs, n = levels.graphs, len(r)
    b, x = levels.work.b[1:], levels.work.x[1:]
    for i in range(n):
        b[i] = r[i]
    if len(graphs.first) == 2:
        solve_coarsest(graphs, b, x)
    else:
        descend_graph(graphs, ZERO, b, x)
        run_cycle(levels, stop, ZERO + 1)
        ascend_graph(graphs, ZERO, b, x, levels.work.w)
    for i in range(n):
        z[i] = x[i]
    return _multiply_graph(graphs, ground, z, r, s, w)


@inner_fast
def _multiply_graph(
    graphs: Graphs, ground: Floats, z: Singles, r: Singles, s: Singles, w: Singles
) -> tuple[float, float, float]:
    """``w = A z`` in double precision, differences first; ``z.r``, ``z.w`` and ``z.s``."""
    row, g, j = graphs.indptr, graphs.conductance, graphs.indices
    zr, zw, zs = 0.0, 0.0, 0.0
    for i in range(len(r)):
        zi = np.float64(z[i])
        total = ground[i] * zi
        for k in range(row[i], row[i + 1]):
            total += np.float64(g[k]) * (zi - np.float64(z[j[k]]))
        w[i] = total
        zr += zi * r[i]
        zw += zi * total
        zs += zi * s[i]
    return zr, zw, zs


@inner
def run_cycle(levels: Levels, stop: float, top: int) -> None:
    """Approximate ``x = A^-1 b`` on level ``top`` by K-cycles.

    The second step is spared where the first has brought the residual under ``stop`` times the right-hand side, twice
    that on every level further down; an infinite ``stop`` spares both.  The recursion is written as a loop, since
    compiled recursive functions cannot be kept on disk.
    """
    grids, graphs, work = levels
    count = len(grids.margin)
    last = count + len(graphs.first) - 2
    begin = 2 * grids.slots[count] + 1
    b, x = work.b[begin:], work.x[begin:]
    visits = np.zeros(last + 1, np.int64)
    alpha, energy = np.zeros(last + 1), np.zeros(last + 1)
    level = top
    while level >= top:
        graph = level - count
        if level == last:
            solve_coarsest(graphs, b, x)
            level -= 1
            continue
        of, done = _vectors(levels, level), False
        if visits[level] == 0 and graph < 0:
            _eliminate_red(levels, level, of.w)
        elif visits[level] == 1:
            alpha[level], energy[level], _ = _ascend(levels, level, of.v, of.v)
            done = np.isinf(stop) or _first_step(of, stop * 2.0 ** (level - top), alpha[level], energy[level])
        elif visits[level] == 2:
            _second_step(of, alpha[level], energy[level], *_ascend(levels, level, of.v, of.w))
            done = True
        if not done:
            _descend(levels, level)
            visits[level] += 1
            level += 1
            continue
        if graph < 0:
            _put_red_back(levels, level)
        visits[level] = 0
        level -= 1


@inner
def _vectors(levels: Levels, level: int) -> _Vectors:
    grids, graphs, work = levels
    graph, slots = level - len(grids.margin), grids.slots[len(grids.margin)]
    if graph < 0:
        a, e = grids.slots[level], grids.slots[level + 1]
        return _Vectors(work.f[a:e], work.z[a:e], work.c[a:e], work.v[a:e], work.w[a:e])
    a, e = graphs.first[graph], graphs.first[graph + 1]
    i, k, m, n = 2 * slots + 1 + a, 2 * slots + 1 + e, slots + a, slots + e
    return _Vectors(work.b[i:k], work.x[i:k], work.c[m:n], work.v[m:n], work.w[m:n])


@inner
def _descend(levels: Levels, level: int) -> None:
    """Relax from zero, and sum the residual into the next level's right-hand side."""
    grids, graphs, work = levels
    count, of = len(grids.margin), _vectors(levels, level)
    if level >= count:
        begin = 2 * grids.slots[count] + 1
        descend_graph(graphs, level - count, work.b[begin:], work.x[begin:])
        return
    stencil, (a, e) = _stencil(grids, level), (grids.slots[level], grids.slots[level + 1])
    _times(stencil.black_inverse, of.r, of.z)
    restrict(stencil, grids.aggregate[a:e], grids.weight[a:e], of.z, work.b[2 * e : _end_below(levels, level)])


@inner
def _ascend(levels: Levels, level: int, s: Singles, y: Singles) -> tuple[float, float, float]:
    """Add the next level's answer to ``z``, relax, and multiply: ``y = A z``; returns ``z.r, z.y, z.s``."""
    grids, graphs, work = levels
    count, of = len(grids.margin), _vectors(levels, level)
    if level >= count:
        begin, after = 2 * grids.slots[count] + 1, grids.slots[count]
        ascend_graph(graphs, level - count, work.b[begin:], work.x[begin:], work.w[after:])
        return _multiply_after(graphs, level - count, of, work.w[after:], s, y)
    stencil, (a, e) = _stencil(grids, level), (grids.slots[level], grids.slots[level + 1])
    coarse = work.x[2 * e : _end_below(levels, level)]
    return prolong_and_multiply(stencil, stencil, grids.aggregate[a:e], grids.weight[a:e], coarse, of.r, s, of.z, y)


@inner
def _end_below(levels: Levels, level: int) -> int:
    """Behind the last node of the level below a grid."""
    grids, graphs, _ = levels
    count = len(grids.margin)
    if level + 1 < count:
        return int(2 * grids.slots[level + 2])
    return int(2 * grids.slots[count] + 1 + graphs.first[1])


def stencil_at(grids: Grids, level: int) -> Stencil:
    """One of the grids."""
    sides = grids.distance.shape[1]
    a, e = grids.slots[level], grids.slots[level + 1]
    k, m = grids.first_off[level], grids.first_off[level + 1]
    return Stencil(
        grids.faces[sides * a : sides * e].reshape((sides, e - a)),
        grids.distance[level],
        grids.margin[level],
        grids.block[level],
        grids.off_red[k:m],
        grids.off_black[k:m],
        grids.couplings[k:m],
        grids.red_inverse[a:e],
        grids.black_inverse[a:e],
        grids.black_degree[a:e],
    )


_stencil = inner(stencil_at)


@inner
def _eliminate_red(levels: Levels, level: int, red: Singles) -> None:
    """Eliminate the red nodes: ``f`` is what the black ones are due."""
    grids, work = levels.grids, levels.work
    a, e, stencil = grids.slots[level], grids.slots[level + 1], _stencil(grids, level)
    _times(stencil.red_inverse, work.b[2 * a : a + e], red)
    add_into_black(stencil, red, work.b[a + e : 2 * e], work.f[a:e])


@inner
def _put_red_back(levels: Levels, level: int) -> None:
    """Voltages of the black nodes, and of the red ones that follow."""
    grids, work = levels.grids, levels.work
    a, e = grids.slots[level], grids.slots[level + 1]
    for k in range(e - a):
        work.x[a + e + k] = work.z[a + k]
    relax_red(_stencil(grids, level), work.b[2 * a : a + e], work.z[a:e], work.x[2 * a : a + e])


@inner_fast
def _times(a: Singles, b: Singles, product: Singles) -> None:
    for k in range(len(product)):
        product[k] = a[k] * b[k]


@inner
def _first_step(of: _Vectors, stop: float, alpha: float, energy: float) -> bool:
    """First step of the K-cycle along ``z``, whose product is ``v``; returns whether it suffices.

    Leaves the answer in ``z``, or else the direction in ``c`` and the residual in ``r``.
    """
    if not energy > 0.0:
        return True
    step, before, after = np.float32(alpha / energy), 0.0, 0.0
    for begin in range(0, len(of.r), CHUNK):
        old, new = take_step(of.r, of.v, step, begin, min(begin + CHUNK, len(of.r)))
        before, after = before + old, after + new
    enough = not after > stop * stop * before
    keep_step(of.z, of.c, step, enough, ZERO, len(of.z))
    return enough


@inner_fast
def take_step(r: Singles, v: Singles, step: np.float32, begin: int, end: int) -> tuple[float, float]:
    """``r -= step v`` on some slots; returns the squares before and after, summed."""
    before, after = 0.0, 0.0
    for k in range(begin, end):
        old = r[k]
        new = old - step * v[k]
        r[k] = new
        before += np.float64(old) * np.float64(old)
        after += np.float64(new) * np.float64(new)
    return before, after


@inner_fast
def keep_step(z: Singles, c: Singles, step: np.float32, enough: bool, begin: int, end: int) -> None:
    """Where the first step is enough, ``z = step z``, the answer; else ``c = z``, its direction; on some slots."""
    for k in range(begin, end):
        if enough:
            z[k] = step * z[k]
        else:
            c[k] = z[k]


@inner
def _second_step(of: _Vectors, alpha: float, energy: float, rest: float, product: float, gamma: float) -> None:
    """Second step, along ``z`` made conjugate to the first direction ``c``; leaves the answer in ``z``."""
    on_c, on_z = _shares_of_both(alpha, energy, rest, product, gamma)
    combine(of.z, of.c, np.float32(on_c), np.float32(on_z), ZERO, len(of.z))


def second_step(alpha: float, energy: float, rest: float, product: float, gamma: float) -> tuple[float, float]:
    """Shares of both directions in the answer."""
    second = product - gamma * gamma / energy
    step = rest / second if second > 0.0 else 0.0
    return (alpha - gamma * step) / energy, step


_shares_of_both = inner(second_step)


@inner_fast
def combine(z: Singles, c: Singles, on_c: np.float32, on_z: np.float32, begin: int, end: int) -> None:
    """``z = on_c c + on_z z`` on some slots."""
    for k in range(begin, end):
        z[k] = on_c * c[k] + on_z * z[k]


@inner
def _multiply_after(
    graphs: Graphs, level: int, of: _Vectors, change: Singles, s: Singles, y: Singles
) -> tuple[float, float, float]:
    """``y = A z`` behind the way up, which leaves ``change``; returns ``z.r, z.y, z.s``; ``y`` may be ``change``.

    What the backward sweep leaves over of a row is due to the changes of earlier rows, which came after it.
    """
    begin, end = graphs.first[level], graphs.first[level + 1]
    g, j, z, r = graphs.conductance, graphs.indices, of.z, of.r
    row, middle = graphs.indptr[begin:end], graphs.middle[begin:end]
    n, zr, zy, zs = len(z), 0.0, 0.0, 0.0
    for back in range(n):
        at = np.uint32(n - 1 - back)
        total = np.float32(0.0)
        for k in range(row[at], middle[at]):
            total += g[k] * change[j[k]]
        one = np.float64(z[at])
        zs += one * np.float64(s[at])
        y[at] = r[at] - total
        zr += one * np.float64(r[at])
        zy += one * np.float64(y[at])
    return zr, zy, zs
