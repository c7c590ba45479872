"""Subtraction-free supernodal factorization ``P A P^T = L D L^T`` of an M-matrix (GTH).

Every entry is accurate to a few rounding errors, whatever the conductances (Grassmann, Taksar & Heyman 1985; O'Cinneide
1993). `resgrid.solvers.supernodal_factors` solves equations with the factors, by substitution.

The import of numba takes seconds: only functions that are about to solve import this module.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from resgrid._internal.jit import ZERO, inlined, inner_fast, kernel
from resgrid.errors import AccuracyError
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.scaled import Floats, Indices
from resgrid.solvers.supernodal_factors import SupernodalFactors, add_column
from resgrid.solvers.symbolic import Supernodes, Symbolic, order_rows

_STRETCH = 2_000
"""Number of supernodes that one call of the factorization kernel eliminates; Ctrl-C is handled between two calls."""


def factor_supernodes(laplacian: Laplacian, symbolic: Symbolic | None = None) -> SupernodalFactors:
    """Return the factors of a matrix; raise AccuracyError if a pivot is not a positive finite double.

    `symbolic`: elimination order of a matrix with the sparsity pattern of this one; None to compute an order.
    """
    matrix, symbolic = laplacian.graph, symbolic or order_rows(laplacian)
    widths, size = symbolic.widths, symbolic.kept
    count = len(widths)
    sums = np.add.reduceat(np.append(matrix.conductance, 0.0), matrix.indptr[:-1])
    diagonal = matrix.leak + np.where(np.diff(matrix.indptr) > 0, sums, 0.0)
    pivot, largest = np.append(np.empty(size), diagonal[symbolic.order[size:]]), float(diagonal.max(initial=0.0))
    factors = SupernodalFactors(symbolic, matrix, np.empty(symbolic.entries), pivot, largest)
    waiting, following, after = np.full((3, count), -1, dtype=np.int32)
    work = Workspace(
        np.repeat(np.arange(count, dtype=np.int32), widths), waiting, following, after, np.empty(size, dtype=np.int32),
        np.empty(size), np.empty(symbolic.lengths.max(initial=0)), np.empty(widths.max(initial=0)),
    )  # fmt: skip
    in_range = bool(np.isfinite(pivot[size:]).all())
    # Supernodes are eliminated in batches, so that Ctrl-C is handled in between.
    for begin in range(0, count, _STRETCH):
        in_range = in_range and eliminate(factors, work, begin, min(begin + _STRETCH, count))
    if not in_range:
        raise AccuracyError(
            "a pivot left the range of doubles: the conductances span too many orders of magnitude for a direct "
            "solution; check the largest and the smallest conductance"
        )
    return factors


class Workspace(NamedTuple):
    """Work arrays of the factorization.

    `node_of` (columns,): supernode of every column; `waiting` (supernodes,): first of the earlier supernodes that will
    update a supernode, in a linked list; `following` (supernodes,): next supernode in the list, -1 at the end; `after`
    (supernodes,): index into ``nodes.rows`` of the first row that a supernode has not updated yet; `at` (columns,):
    position of a row in the current supernode; `grounded` (columns,): conductance of a column to the ground (all nodes
    of known voltage), in siemens, and after the elimination of the column divided by the pivot; `column` (rows of the
    longest supernode,), `weight` (columns of the widest supernode,): buffers.
    """

    node_of: Indices
    waiting: Indices
    following: Indices
    after: Indices
    at: Indices
    grounded: Floats
    column: Floats
    weight: Floats


@kernel
def eliminate(factors: SupernodalFactors, work: Workspace, begin: int, end: int) -> bool:
    """Factor the supernodes ``begin`` to ``end - 1`` into ``factors``; return whether all pivots are valid.

    A valid pivot is positive and finite. Elimination of a row adds ``c_i c_j / d`` between its neighbours, with
    conductances ``c`` to them and the pivot ``d``, and likewise between each neighbour and the ground. The pivot is the
    sum of the row's conductances to later rows and to the ground, never a difference (Grassmann, Taksar & Heyman 1985).
    Every entry is therefore accurate to a few rounding errors, whatever the conductances. `work`: work arrays,
    modified.
    """
    nodes = factors.symbolic.nodes
    for node in range(begin, end):
        _load(factors, work, node)
        other = work.waiting[node]
        while other >= 0:
            following = work.following[other]
            _update(factors, work, other, node)
            _wait(nodes, work, other)
            other = following
        if not _eliminate_within(factors, work, node):
            return False
        work.after[node] = nodes.start[node] + nodes.first[node + 1] - nodes.first[node]
        _wait(nodes, work, node)
    return True


@inlined
def _wait(nodes: Supernodes, work: Workspace, node: int) -> None:
    """Insert supernode ``node`` into the linked list of the supernode whose columns contain the next row to update.

    The next row is number ``work.after[node]`` in ``nodes.rows``; nothing happens if it lies beyond the rows of
    ``node``. `nodes`: supernodes; `work`: work arrays, whose lists are updated.
    """
    after, end = work.after[node], nodes.start[node + 1]
    target = work.node_of[nodes.rows[min(after, end - 1)]]
    if after < end:
        work.following[node] = work.waiting[target]
        work.waiting[target] = node


@inlined
def _load(factors: SupernodalFactors, work: Workspace, node: int) -> None:
    """Write the conductances ``g_ij + sum_k g_ik g_kj / d_k`` of supernode ``node`` to ``factors.values``.

    The sum is over the rows ``k`` that odd-even reduction has eliminated, with pivots ``d_k``. Conductances to the
    ground are written to ``work.grounded``.
    """
    (order, place, nodes), (indptr, indices, edges, ground), values, pivot, _ = factors
    at, kept = work.at, len(work.at)
    length = nodes.start[node + 1] - nodes.start[node]
    for i in range(nodes.offset[node], nodes.offset[node + 1]):
        values[np.uint64(i)] = 0.0
    for r in range(length):
        at[nodes.rows[nodes.start[node] + r]] = r
    for k in range(nodes.first[node], nodes.first[node + 1]):
        base, total = nodes.offset[node] + (k - nodes.first[node]) * length, ground[order[k]]
        for entry in range(indptr[order[k]], indptr[order[k] + 1]):
            j, first, last, fraction = indices[entry], entry, entry + 1, 1.0
            if place[j] >= kept:
                first, last, fraction = indptr[j], indptr[j + 1], edges[entry] / pivot[place[j]]
                total += fraction * ground[j]
            for other in range(first, last):
                row = place[indices[other]]
                if row > k:
                    values[base + at[row]] += fraction * edges[other]
        work.grounded[k] = total


@inlined
def _update(factors: SupernodalFactors, work: Workspace, other: int, node: int) -> None:
    """Add the contribution of the eliminated supernode ``other`` to the columns of the later supernode ``node``.

    ``work.after[other]`` is advanced to the first row of ``other`` beyond the columns of ``node``.
    """
    nodes, values, at = factors.symbolic.nodes, factors.values, work.at
    rows = nodes.rows
    begin, end = work.after[other], nodes.start[other + 1]
    first, columns = nodes.first[other], nodes.first[other + 1] - nodes.first[other]
    apart = end - nodes.start[other]
    source = nodes.offset[other] + begin - nodes.start[other]
    length = nodes.start[node + 1] - nodes.start[node]
    follow_on = at[rows[end - 1]] - at[rows[begin]] == end - 1 - begin
    r = begin
    while r < end and rows[r] < nodes.first[node + 1]:
        here, left = source + r - begin, end - r - 1
        there = nodes.offset[node] + at[rows[r]] * length
        _weigh(factors, work, first, columns, here, apart, rows[r])
        if follow_on:
            _add_columns(values, there + at[rows[r]] + 1, values, here + 1, apart, work.weight, columns, left)
        else:
            for i in range(left):
                work.column[i] = 0.0
            _add_columns(work.column, ZERO, values, here + 1, apart, work.weight, columns, left)
            for i in range(left):
                values[there + at[rows[r + 1 + i]]] += work.column[i]
        r += 1
    work.after[other] = r


@inlined
def _weigh(
    factors: SupernodalFactors, work: Workspace, first: int, columns: int, here: int, apart: int, row: int
) -> None:
    """Write the conductances from eliminated columns to ``row``, in siemens, into ``work.weight``.

    The ground conductance that the elimination of the columns gives the row is added to ``work.grounded[row]``.

    `first, columns`: first column, and number of columns; `here`: index of the first column's entry in the row among
    the values; `apart`: increment of this index from a column to the next.
    """
    total = 0.0
    for k in range(columns):
        w = factors.pivot[first + k] * factors.values[here + k * apart]
        work.weight[k] = w
        total += w * work.grounded[first + k]
    work.grounded[row] += total


@inlined
def _eliminate_within(factors: SupernodalFactors, work: Workspace, node: int) -> bool:
    """Eliminate the columns of supernode ``node``; return whether all of its pivots are positive and finite.

    All updates by earlier supernodes must have been added before.
    """
    nodes, values, pivot, grounded = factors.symbolic.nodes, factors.values, factors.pivot, work.grounded
    first, base, width = nodes.first[node], nodes.offset[node], nodes.first[node + 1] - nodes.first[node]
    length = nodes.start[node + 1] - nodes.start[node]
    for c in range(width):
        k, below, end = first + c, base + c * length + c + 1, base + (c + 1) * length
        _weigh(factors, work, first, c, base + c, length, k)
        _add_columns(values, below, values, base + c + 1, length, work.weight, c, end - below)
        total = grounded[k] + range_sum(values, below, end)
        if not (total > 0.0 and math.isfinite(total)):
            return False
        pivot[k] = total
        grounded[k] /= total
        for i in range(base + c * length, below):
            values[np.uint64(i)] = 0.0
        for i in range(below, end):
            values[np.uint64(i)] /= total
    return True


@inner_fast
def range_sum(values: Floats, begin: int, end: int) -> float:
    """Return the sum of ``values[begin:end]``."""
    total = 0.0
    for i in range(begin, end):
        total += values[np.uint64(i)]
    return total


@inner_fast
def _add_columns(
    target: Floats, there: int, values: Floats, here: int, apart: int, weight: Floats, columns: int, count: int
) -> None:
    """Add ``sum_{k < columns} weight[k] values[here + k apart + i]`` to ``target[there + i]`` for all ``i < count``."""
    t, k = np.uint64(there), 0
    while k + 4 <= columns:
        w0, w1, w2, w3 = weight[k], weight[k + 1], weight[k + 2], weight[k + 3]
        s0, s1 = np.uint64(here + k * apart), np.uint64(here + (k + 1) * apart)
        s2, s3 = np.uint64(here + (k + 2) * apart), np.uint64(here + (k + 3) * apart)
        for each in range(count):
            i = np.uint64(each)
            target[t + i] += (w0 * values[s0 + i] + w1 * values[s1 + i]) + (w2 * values[s2 + i] + w3 * values[s3 + i])
        k += 4
    while k < columns:
        add_column(target, there, values, here + k * apart, weight[k], count)
        k += 1
