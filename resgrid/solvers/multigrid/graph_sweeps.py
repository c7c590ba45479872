"""Gauss-Seidel over packed graphs: the way down from a level to the next, the way up, and the last one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import inner_fast, kernel
from resgrid.solvers.llvm_intrinsics import flush_subnormals, restore_subnormals
from resgrid.solvers.scaled import Floats, Integers, Singles

Unsigned = NDArray[np.uint32]
"""Indices without a sign: compiled code need not ask whether one counts from the end."""


_MOST_LEVELS = 64
"""Of a hierarchy: nobody has nodes for more."""


class Graphs(NamedTuple):
    """Graphs in compressed rows, without diagonal, one behind the other; nodes and entries count over all levels.

    Nodes of level ``l`` stand at ``first[l] ... first[l + 1]``.

    `first` (levels + 1,); `indptr` (nodes + 1,); `middle` (nodes,): where in a row the neighbours begin that come
    after it; `indices, conductance` (entries,); `leak` (nodes,): to known voltages; `degree, inverse` (nodes,):
    the diagonal, and of it; `aggregate` (nodes,): node of the next level; `coarsest`: inverse of the last level's
    matrix; empty where its diagonal must do.
    """

    first: Integers
    indptr: Unsigned
    middle: Unsigned
    indices: Unsigned
    conductance: Singles
    leak: Singles
    degree: Singles
    inverse: Singles
    aggregate: Unsigned
    coarsest: Singles


class SweepBuffers(NamedTuple):
    """Work space of one solve, over the nodes of all graphs.

    `b, x` (1 + nodes,): currents and voltages, behind those of nothing; `c, v, w` (nodes,): first direction, and
    products; `change` (nodes,): of the last sweep; `visits` (levels,), `first_steps` (levels, 2): of a K-cycle, how
    often it has come to every level, and what the first step there was made of.
    """

    b: Singles
    x: Singles
    c: Singles
    v: Singles
    w: Singles
    change: Singles
    visits: Integers
    first_steps: Floats


def work_space(graphs: Graphs) -> SweepBuffers:
    """Work space of its own, so that one hierarchy can serve several solves at a time."""
    nodes = int(graphs.first[-1])
    (b, x), (c, v, w, change) = np.zeros((2, 1 + nodes), dtype=np.float32), np.zeros((4, nodes), dtype=np.float32)
    return SweepBuffers(b, x, c, v, w, change, np.zeros(_MOST_LEVELS, dtype=np.int64), np.zeros((_MOST_LEVELS, 2)))


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
def ascend_graph(
    graphs: Graphs, level: int, b: Singles, x: Singles, s: Singles, change: Singles, y: Singles
) -> tuple[float, float, float]:
    """Add the next level's answer, then Gauss-Seidel in the reverse order; ``y = A x``; returns ``x.b, x.y, x.s``.

    Rows are differences first.  What the sweep leaves over of a row is due to the rounding of its own voltage and to
    the changes of earlier rows, which came after it (Eisenstat 1981).  Shapes: `s, y` (nodes of the level,).
    """
    flags = flush_subnormals()
    begin, end = graphs.first[level], graphs.first[level + 1]
    g, j = graphs.conductance, graphs.indices
    own, mine, inverse, changed = x[begin:end], b[begin:end], graphs.inverse[begin:end], change[begin:end]
    aggregate, leak, degree = graphs.aggregate[begin:end], graphs.leak[begin:end], graphs.degree[begin:end]
    row, after, n = graphs.indptr[begin:end], graphs.indptr[begin + 1 : end + 1], len(s)
    for i in range(n):
        own[i] += x[aggregate[i]]
    for back in range(n):
        at = np.uint32(n - 1 - back)
        old, left = own[at], np.float32(0.0)
        for k in range(row[at], after[at]):
            left += g[k] * (x[j[k]] - old)
        left += mine[at] - leak[at] * old
        new = old + left * inverse[at]
        own[at], changed[at] = new, new - old
        y[at] = mine[at] - left + degree[at] * (new - old)
    products = _subtract_changes(graphs, (row, graphs.middle[begin:end]), change, own, mine, s, y)
    restore_subnormals(flags)
    return products


@inner_fast
def _subtract_changes(
    graphs: Graphs, earlier: tuple[Unsigned, Unsigned], change: Singles, x: Singles, b: Singles, s: Singles, y: Singles
) -> tuple[float, float, float]:
    """``y -= sum_{j < i} g_ij change_j``; returns ``x.b, x.y, x.s``; ``earlier``: where such begin and end in a row."""
    g, j, (begin, end) = graphs.conductance, graphs.indices, earlier
    xb, xy, xs = 0.0, 0.0, 0.0
    for i in range(len(y)):
        total = np.float32(0.0)
        for k in range(begin[i], end[i]):
            total += g[k] * change[j[k]]
        product, one = y[i] - total, np.float64(x[i])
        xs += one * np.float64(s[i])
        y[i] = product
        xb += one * np.float64(b[i])
        xy += one * np.float64(product)
    return xb, xy, xs


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
