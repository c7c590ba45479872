"""Subtraction-free supernodal factors ``P A P^T = L D L^T`` of an M-matrix (GTH).

Every entry is accurate to a few rounding errors, whatever the conductances (Grassmann, Taksar & Heyman 1985; O'Cinneide
1993). Substitution is done in numbers with separate exponents (`resgrid.solvers.scaled_kernels`).

The import of numba takes seconds: only functions that are about to solve import this module.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from resgrid._internal.jit import ZERO, inlined, inner_fast, kernel
from resgrid.errors import AccuracyError
from resgrid.solvers.laplacian import Graph, Laplacian
from resgrid.solvers.scaled import Floats, Indices, Integers, Numbers, unscaled
from resgrid.solvers.scaled_kernels import NO_EXPONENT, _add_product, _canonical, _shift
from resgrid.solvers.symbolic import Supernodes, Symbolic, order_rows

_STRETCH = 2_000
"""Number of supernodes that one call of the factorization kernel eliminates; Ctrl-C is handled between two calls."""

_LEAST, _MOST = 2.0**-300, 2.0**700
"""Smallest and largest magnitude of a sum of doubles in which no term overflows or underflows significantly.

Beyond these limits substitution is repeated with one exponent per number.
"""


class SupernodalFactors(NamedTuple):
    """Factors ``L D L^T`` of a matrix with ``n`` rows, and their elimination order.

    `symbolic`: elimination order and sparsity pattern; `matrix`: the factored matrix, in siemens; `values` (entries,):
    entries of ``-L``, supernode by supernode and column by column. An entry below the diagonal is the fraction of a
    current into its column that elimination passes on to its row; entries above the diagonal are 0. `pivot` (n,):
    diagonal of ``D``, in siemens, in elimination order; `largest`: largest diagonal entry of the matrix, in siemens.
    """

    symbolic: Symbolic
    matrix: Graph
    values: Floats
    pivot: Floats
    largest: float

    def substitute(self, m: Floats, e: Integers) -> Numbers:
        """Return the solution of ``A x = b``, by forward and back substitution, in numbers with separate exponents.

        `m, e` (n,): mantissas and exponents of ``b = m * 2**(256 e)``, which are not modified. Returns mantissas and
        exponents of ``x``, (n,) each.
        """
        by = self.symbolic
        x, exponent, column = m.take(by.order), e.take(by.order), np.empty(by.lengths.max(initial=0))
        substitute(self, x, exponent, column)
        return x.take(by.place), exponent.take(by.place)

    def solve(self, rhs: Floats) -> Floats:
        """Return ``x`` (n,), in volts, of ``A x = rhs``; every entry is accurate if ``rhs`` (n,) is nonnegative."""
        m, e = self.substitute(rhs, np.zeros(len(rhs), dtype=np.int64))
        return unscaled(m, e)


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
    """Append supernode ``node`` to the linked list of the supernode that contains the next row it updates."""
    after = work.after[node]
    if after < nodes.start[node + 1]:
        target = work.node_of[nodes.rows[after]]
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
        w, s = weight[k], np.uint64(here + k * apart)
        for each in range(count):
            target[t + np.uint64(each)] += w * values[s + np.uint64(each)]
        k += 1


@kernel
def substitute(factors: SupernodalFactors, m: Floats, e: Integers, column: Floats) -> None:
    """Solve ``A x = b`` in place, in numbers with separate exponents, ``m * 2**(256 e)``.

    Rows that odd-even reduction has eliminated are reduced first and restored last; ``L D L^T x = b`` is solved for the
    others in between. Within a supernode all numbers have a common exponent, the largest one. If a number then falls
    below the range of safe doubles, the supernode is repeated with one exponent per number.

    `m, e` (n,): mantissas and exponents of ``b``, then of ``x``, in elimination order; `column` (rows of the longest
    supernode,): work array.
    """
    (order, place, nodes), (indptr, indices, edges, _), values, pivot, _ = factors
    n, kept = len(order), nodes.first[-1]
    for k in range(n):
        m[k], e[k] = _canonical(m[k], e[k])
    for k in range(kept, n):
        for entry in range(indptr[order[k]], indptr[order[k] + 1]):
            _add_fraction(m, e, place[indices[entry]], edges[entry] / pivot[k], k)
    for node in range(len(nodes.first) - 1):
        _forward(nodes, values, m, e, column, node)
    for k in range(n):
        m[k], e[k] = _canonical(m[k] / pivot[k], e[k])
    for node in range(len(nodes.first) - 2, -1, -1):
        _backward(nodes, values, m, e, column, node)
    for k in range(kept, n):
        for entry in range(indptr[order[k]], indptr[order[k] + 1]):
            _add_fraction(m, e, k, edges[entry] / pivot[k], place[indices[entry]])


@inlined
def _add_fraction(m: Floats, e: Integers, to: int, fraction: float, of: int) -> None:
    """Add ``fraction`` times number ``of`` to number ``to``, in place; numbers are ``m[k] * 2**(256 e[k])``."""
    value, scale = _add_product(m[to], e[to], fraction, m[of], e[of])
    m[to], e[to] = _canonical(value, scale)


@inlined
def _forward(nodes: Supernodes, values: Floats, m: Floats, e: Integers, column: Floats, node: int) -> None:
    """Forward substitution in supernode ``node``: distribute the currents into its columns over its rows, in place.

    `nodes`: supernodes of ``L``; `values`: entries of ``-L``; `m, e` (n,): mantissas and exponents of currents;
    `column`: work array.
    """
    begin, base, first = nodes.start[node], nodes.offset[node], nodes.first[node]
    length, columns = nodes.start[node + 1] - begin, nodes.first[node + 1] - first
    first_nonzero = 0
    while first_nonzero < columns and m[first + first_nonzero] == 0.0:
        first_nonzero += 1
    if first_nonzero == columns:
        return
    common = _align(nodes.rows, begin, first_nonzero, length, m, e, column)
    for c in range(first_nonzero, columns):
        below = base + c * length + c + 1
        _add_columns(column, c + 1, values, below, length, column[c:], 1, length - c - 1)
    plain = True
    for r in range(first_nonzero, length):
        plain = plain and abs(column[r]) >= _LEAST
    if plain:
        for r in range(first_nonzero, length):
            row = nodes.rows[begin + r]
            m[row], e[row] = _canonical(column[r], common)
        return
    for c in range(first_nonzero, columns):
        for r in range(c + 1, length):
            _add_fraction(m, e, nodes.rows[begin + r], values[base + c * length + r], first + c)


@inlined
def _backward(nodes: Supernodes, values: Floats, m: Floats, e: Integers, column: Floats, node: int) -> None:
    """Back substitution in supernode ``node``: compute the values of its columns from those of later rows, in place.

    `nodes`: supernodes of ``L``; `values`: entries of ``-L``; `m, e` (n,): mantissas and exponents of the solution;
    `column`: work array.
    """
    begin, base, first = nodes.start[node], nodes.offset[node], nodes.first[node]
    length, columns = nodes.start[node + 1] - begin, nodes.first[node + 1] - first
    common = _align(nodes.rows, begin, ZERO, length, m, e, column)
    plain = True
    for c in range(columns - 1, -1, -1):
        column[c] += _product(column, values, base + c * length, c + 1, length)
        plain = plain and _LEAST <= abs(column[c]) <= _MOST
    if plain:
        for c in range(columns):
            m[first + c], e[first + c] = _canonical(column[c], common)
        return
    for c in range(columns - 1, -1, -1):
        for r in range(c + 1, length):
            _add_fraction(m, e, first + c, values[base + c * length + r], nodes.rows[begin + r])


@inlined
def _align(rows: Indices, begin: int, skipped: int, length: int, m: Floats, e: Integers, column: Floats) -> int:
    """Convert the numbers of rows ``rows[begin + r]`` to doubles ``column[r]``; return their common exponent.

    `r` runs from ``skipped`` to ``length - 1``; numbers are ``m * 2**(256 e)``; the common exponent is the largest.
    """
    common = NO_EXPONENT
    for r in range(skipped, length):
        row = rows[begin + r]
        if m[row] != 0.0 and e[row] > common:
            common = int(e[row])
    for r in range(skipped, length):
        row = rows[begin + r]
        column[r] = _shift(m[row], e[row] - common)
    return common


@inner_fast
def _product(column: Floats, values: Floats, base: int, begin: int, end: int) -> float:
    """Return the inner product of ``column[begin:end]`` and ``values[base + begin:base + end]``."""
    total, b = 0.0, np.uint64(base)
    for each in range(begin, end):
        i = np.uint64(each)
        total += column[i] * values[b + i]
    return total
