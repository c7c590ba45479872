"""Gauss-Seidel over packed graphs: the way down from a level to the next, the way up, and the last one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import inner, inner_fast, kernel, kernel_fast
from resgrid.solvers.machine import flush_subnormals, restore_subnormals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Singles = NDArray[np.float32]
Unsigned = NDArray[np.uint32]
"""Indices without a sign: compiled code need not ask whether one counts from the end."""


_MOST_LEVELS = 64
"""Of a hierarchy: nobody has nodes for more."""


class Graphs(NamedTuple):
    """Graphs in compressed rows, without diagonal, one behind the other; nodes and entries count over all levels.

    Nodes of level ``l`` stand at ``first[l] ... first[l + 1]``.

    `first` (levels + 1,); `indptr` (nodes + 1,); `middle` (nodes,): where in a row the neighbours begin that come
    after it; `indices, conductance` (entries,); `inverse` (nodes,): of the diagonal; `aggregate` (nodes,): node of the
    next level; `coarsest`: inverse of the last level's matrix; empty where its diagonal must do.
    """

    first: Integers
    indptr: Unsigned
    middle: Unsigned
    indices: Unsigned
    conductance: Singles
    inverse: Singles
    aggregate: Unsigned
    coarsest: Singles


class Work(NamedTuple):
    """Work space of one solve, over the nodes of all graphs.

    `b, x` (1 + nodes,): currents and voltages, behind those of nothing; `c, v, w` (nodes,): first direction, and
    products; `visits` (levels,), `first_steps` (levels, 2): of a K-cycle, how often it has come to every level, and
    what the first step there was made of.
    """

    b: Singles
    x: Singles
    c: Singles
    v: Singles
    w: Singles
    visits: Integers
    first_steps: Floats


def work_space(graphs: Graphs) -> Work:
    """Work space of its own, so that one hierarchy can serve several solves at a time."""
    nodes = int(graphs.first[-1])
    (b, x), (c, v, w) = np.zeros((2, 1 + nodes), dtype=np.float32), np.zeros((3, nodes), dtype=np.float32)
    return Work(b, x, c, v, w, np.zeros(_MOST_LEVELS, dtype=np.int64), np.zeros((_MOST_LEVELS, 2)))


@kernel
def descend_graph(graphs: Graphs, level: int, b: Singles, x: Singles) -> None:
    """Gauss-Seidel from zero, and the residual summed into the next level's right-hand side.

    After the sweep row ``i`` lacks only its later neighbours: its residual is ``sum_{j > i} g_ij x_j``.  Loops run
    over parts of arrays from zero on: a counter that is never negative needs no check.
    """
    flags = flush_subnormals()
    begin, end = graphs.first[level], graphs.first[level + 1]
    for node in range(end, graphs.first[level + 2]):
        b[node] = 0.0
    g, j = graphs.conductance, graphs.indices
    row, middle = graphs.indptr[begin : end + 1], graphs.middle[begin:end]
    own, mine, inverse, aggregate = x[begin:end], b[begin:end], graphs.inverse[begin:end], graphs.aggregate[begin:end]
    for i in range(len(own)):
        s = np.float32(0.0)
        for k in range(row[i], middle[i]):
            s += g[k] * x[j[k]]
        own[i] = (mine[i] + s) * inverse[i]
    for i in range(len(own)):
        s = np.float32(0.0)
        for k in range(middle[i], row[i + 1]):
            s += g[k] * x[j[k]]
        b[aggregate[i]] += s
    restore_subnormals(flags)


@kernel
def ascend_graph(graphs: Graphs, level: int, b: Singles, x: Singles, w: Singles) -> None:
    """Add the next level's answer, then Gauss-Seidel in the reverse order; ``w`` keeps the changes."""
    flags = flush_subnormals()
    begin, end = graphs.first[level], graphs.first[level + 1]
    g, j = graphs.conductance, graphs.indices
    own, mine, inverse, change = x[begin:end], b[begin:end], graphs.inverse[begin:end], w[begin:end]
    aggregate, row, after = graphs.aggregate[begin:end], graphs.indptr[begin:end], graphs.indptr[begin + 1 : end + 1]
    n = len(own)
    for i in range(n):
        own[i] += x[aggregate[i]]
    for back in range(n):
        at = np.uint32(n - 1 - back)
        s = np.float32(0.0)
        for k in range(row[at], after[at]):
            s += g[k] * x[j[k]]
        new = (mine[at] + s) * inverse[at]
        change[at] = new - own[at]
        own[at] = new
    restore_subnormals(flags)


@inner_fast
def solve_coarsest(graphs: Graphs, b: Singles, x: Singles) -> None:
    """The inverse of the last level's matrix times its right-hand side; without one, that of the diagonal."""
    begin = graphs.first[len(graphs.first) - 2]
    own, mine, inverse = x[begin:], b[begin:], graphs.coarsest
    for i in range(len(graphs.inverse) - begin):
        total = np.float32(0.0)
        for j in range(len(inverse)):
            total += inverse[i, j] * mine[j]
        own[i] = total if len(inverse) > 0 else mine[i] * graphs.inverse[begin + i]


@kernel
def ascend_and_multiply(
    graphs: Graphs, ground: Floats, b: Singles, x: Singles, s: Singles, change: Singles, w: Singles
) -> tuple[float, float, float]:
    flags = flush_subnormals()
    n = len(s)
    g, j = graphs.conductance, graphs.indices
    inverse, aggregate, row = graphs.inverse[:n], graphs.aggregate[:n], graphs.indptr[: n + 1]
    middle = graphs.middle[:n]
    z, r = x[:n], b[:n]
    for i in range(n):
        z[i] += x[aggregate[i]]
    for back in range(n):
        i = np.uint32(n - 1 - back)
        zi = z[i]
        left = np.float32(0.0)
        for k in range(row[i], row[i + np.uint32(1)]):
            left += g[k] * (z[j[k]] - zi)
        left += r[i] - np.float32(ground[i] * zi)
        new = zi + left * inverse[i]
        moved = new - zi
        z[i], change[i] = new, moved
        w[i] = left - moved / inverse[i] if inverse[i] > 0 else np.float32(0.0)
    zr, zw, zs = 0.0, 0.0, 0.0
    for i in range(n):
        total = np.float32(0.0)
        for k in range(row[i], middle[i]):
            total += g[k] * change[j[k]]
        zi, new = np.float64(z[i]), r[i] - w[i] - total
        w[i] = new
        zr += zi * r[i]
        zw += zi * new
        zs += zi * s[i]
    restore_subnormals(flags)
    return zr, zw, zs


@kernel_fast
def multiply_graph(
    graphs: Graphs, ground: Floats, z: Singles, r: Singles, s: Singles, w: Singles
) -> tuple[float, float, float]:
    """``w = A z`` in double precision, differences first; ``z.r``, ``z.w`` and ``z.s``."""
    flags = flush_subnormals()
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
    restore_subnormals(flags)
    return zr, zw, zs


@inner
def multiply_after(
    graphs: Graphs, level: int, r: Singles, z: Singles, change: Singles, s: Singles, y: Singles
) -> tuple[float, float, float]:
    """``y = A z`` behind the way up, which leaves ``change``; returns ``z.r, z.y, z.s``; ``y`` may be ``change``.

    What the backward sweep leaves over of a row is due to the changes of earlier rows, which came after it.
    """
    begin, end = graphs.first[level], graphs.first[level + 1]
    g, j = graphs.conductance, graphs.indices
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
