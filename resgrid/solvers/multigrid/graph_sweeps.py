"""Gauss-Seidel smoothing of graphs, with restriction and prolongation, and the solve on the coarsest graph."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import inner_fast, kernel
from resgrid.solvers.llvm_intrinsics import flush_subnormals, restore_subnormals
from resgrid.solvers.scaled import Floats, Integers, Singles

Unsigned = NDArray[np.uint32]
"""Array of unsigned indices; compiled code does not check them for negative values, which Python counts from the end.
"""


_MOST_LEVELS = 64
"""Maximum number of levels of a hierarchy that the work arrays serve: coarse grids and graphs together."""


class Graphs(NamedTuple):
    """All graphs of a hierarchy in concatenated compressed rows, without diagonals.

    Conductances are divided by the conductance ``hierarchy.unit``. Nodes and entries are counted from 0 over all
    levels: level ``l`` has the nodes ``first[l]`` to ``first[l + 1] - 1``.

    `first` (levels + 1,): first node of every level; `indptr` (nodes + 1,): begin of every row; `middle` (nodes,):
    begin of the neighbours with higher numbers in a row; `indices, conductance` (entries,): neighbours and
    conductances; `leak` (nodes,): conductance to known voltages; `degree, inverse` (nodes,): diagonal and its
    reciprocal; `aggregate` (nodes,): node of the next level to which each node belongs; `coarsest` (n, n): inverse of
    the matrix of the last level with n nodes; shape (0, 0) if the reciprocal diagonal is used instead.
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
    """Work arrays of one solve, over the nodes of all graphs of a hierarchy.

    `b, x` (1 + nodes,): right-hand sides and solutions; entry 0 belongs to no node; `c` (nodes,): first search
    direction of a K-cycle; `v, w` (nodes,): products of the matrix with the first and the second direction; `change`
    (nodes,): changes of the solutions by the last sweep; `visits` (levels,): number of times that the present K-cycle
    has returned to every level; `first_steps` (levels, 2): inner products of the first step of the K-cycle on every
    level.
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
    """Return new work arrays for the graphs of a hierarchy.

    Concurrent solves with one hierarchy need separate work arrays.
    """
    nodes = int(graphs.first[-1])
    (b, x), (c, v, w, change) = np.zeros((2, 1 + nodes), dtype=np.float32), np.zeros((4, nodes), dtype=np.float32)
    return SweepBuffers(b, x, c, v, w, change, np.zeros(_MOST_LEVELS, dtype=np.int64), np.zeros((_MOST_LEVELS, 2)))


@kernel
def descend_graph(graphs: Graphs, level: int, b: Singles, x: Singles) -> None:
    """Relax a level by Gauss-Seidel from zero, and sum the residual into the next level's right-hand side.

    `graphs, level`: all graphs, and index of this one, 0 for the finest; `b, x` (nodes,): right-hand sides and
    solutions of all levels, modified. After the sweep the residual of row ``i`` is ``sum_{j > i} g_ij x_j``, from
    neighbours with higher numbers only. Loops run over slices from zero on: compiled code then omits checks for
    negative indices.
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
    """Add the next level's solution to ``x``, relax in reverse order, and set ``y = A x``; return ``x.b, x.y, x.s``.

    ``A`` is the matrix of this level. The product is computed from differences. After the sweep the residual of a row
    comes from the rounding of its own voltage and from the later changes of rows with lower numbers (Eisenstat 1981).

    `graphs, level`: all graphs, and index of this one, 0 for the finest; `b, x, change` (nodes,): right-hand sides,
    solutions, and changes of the solutions in the last sweep, of all levels; `x` and `change` are overwritten on this
    level; `s` (nodes of the level,): vector of ``x.s``, such as the product of ``A`` with the previous search
    direction; `y` (nodes of the level,): receives the product.  The inner products are over this level.
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
    """Set ``y_i -= sum_{j < i} g_ij change_j`` on one level; return the inner products ``x.b``, ``x.y``, ``x.s``.

    The subtraction completes ``y = A x``, and ``x.y`` contains the completed ``y``.  `graphs`: all graphs; `earlier`:
    begin and end of the entries of the neighbours ``j < i`` in every row, shape (nodes of the level,) each; `change`
    (nodes,): changes of the solution in the last sweep, of all nodes; `x, b, s, y` (nodes of the level,): solution;
    right-hand side; vector of ``x.s``, such as the product of ``A`` with the previous search direction; and product,
    completed in place.
    """
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
    """Multiply the last level's right-hand side by the inverse of the level's matrix, or of its diagonal.

    `graphs`: all graphs; `b, x` (nodes,): right-hand sides and solutions of all levels; the last level of ``x`` is
    written.
    """
    begin = graphs.first[len(graphs.first) - 2]
    own, mine, inverse = x[begin:], b[begin:], graphs.coarsest
    for i in range(len(graphs.inverse) - begin):
        total = np.float32(0.0)
        for j in range(len(inverse)):
            total += inverse[i, j] * mine[j]
        own[i] = total if len(inverse) > 0 else mine[i] * graphs.inverse[begin + i]
