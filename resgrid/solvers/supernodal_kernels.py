"""Compiled loops of the supernodal elimination of an M-matrix, ``P A P^T = L D L^T``, and of substitution.

A *supernode* is a run of columns of ``L`` that are kept as one dense block over the rows that any of them has entries
in, its own first (Ashcraft & Grimes 1989).  Elimination then adds up dense columns, for the most part.  All numbers are
positive; those of substitution are scaled (`resgrid.solvers.extended_kernels`).

Numba takes seconds to import: only functions that are about to solve import this module.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import ZERO, inlined, inner_fast, kernel
from resgrid.solvers.extended_kernels import _add_product, _canonical, _shift
from resgrid.solvers.laplacian import Conductances
from resgrid.solvers.symbolic_kernels import Pattern

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Indices = NDArray[np.int32]

_LEAST, _MOST = 2.0**-700, 2.0**700
"""Range in which a sum of doubles has lost nothing that counts to underflow, and overflows nowhere."""


class Supernodes(NamedTuple):
    """Supernodes of a unit lower triangular matrix.

    `first` (supernodes + 1,): their first columns, and ``n``; `start` (supernodes + 1,): where their rows begin in
    ``rows``; `rows`: their rows, ascending: first those of their own columns; `offset` (supernodes + 1,): where their
    entries begin among the values: column by column, all as long as there are rows.
    """

    first: Indices
    start: Indices
    rows: Indices
    offset: Integers


class Reduced(NamedTuple):
    """Where odd-even reduction has left every row.

    `place` (n,): of a row that is kept in the order of elimination; -1 for the others; `pivot` (n,): of the others, in
    siemens.
    """

    place: Indices
    pivot: Floats


class Entries(NamedTuple):
    """The entries of the factors; a share is that of a conductance in its pivot.

    `values`: the entries of ``-L`` below the diagonal, supernode by supernode: shares that go to later rows. What
    stands above the diagonal is 0; `pivot, grounded` (n,): ``D`` in siemens, and the shares that go to the ground.
    """

    values: Floats
    pivot: Floats
    grounded: Floats


class Workspace(NamedTuple):
    """Where elimination keeps what it is at.

    `node_of` (n,): supernode of every column; `waiting, following` (supernodes,): lists of the supernodes that are next
    to be added to one: the first, and the one after each; -1 at the end; `after` (supernodes,): which of their rows
    that one begins at; `place` (n,): places of the rows of the supernode that is being eliminated; `column`: as long as
    the longest one; `weight` (columns,): as the widest one.
    """

    node_of: Indices
    waiting: Indices
    following: Indices
    after: Indices
    place: Indices
    column: Floats
    weight: Floats


@kernel
def eliminate(
    matrix: Conductances, pattern: Pattern, nodes: Supernodes, entries: Entries, work: Workspace, begin: int, end: int
) -> bool:
    """Factor some supernodes in order, in sums, products and quotients of positive numbers alone.

    A row that is eliminated joins those it was joined to, and the ground, by ``c_i c_j / d``; its pivot ``d`` is the
    sum of its conductances to later rows and to the ground, never a difference (Grassmann, Taksar & Heyman 1985).  So
    every entry is right to some roundings, whatever the conductances.
    """
    for node in range(begin, end):
        _load(matrix, pattern, nodes, entries, work, node)
        other = work.waiting[node]
        while other >= 0:
            following = work.following[other]
            _update(nodes, entries, work, other, node)
            _wait(nodes, work, other)
            other = following
        if not _eliminate_within(nodes, entries, work, node):
            return False
        work.after[node] = nodes.start[node] + nodes.first[node + 1] - nodes.first[node]
        _wait(nodes, work, node)
    return True


@inlined
def _wait(nodes: Supernodes, work: Workspace, node: int) -> None:
    """Have a supernode wait for the one that its next row belongs to."""
    after = work.after[node]
    if after < nodes.start[node + 1]:
        target = work.node_of[nodes.rows[after]]
        work.following[node] = work.waiting[target]
        work.waiting[target] = node


@inlined
def _load(
    matrix: Conductances, pattern: Pattern, nodes: Supernodes, entries: Entries, work: Workspace, node: int
) -> None:
    """Fill a supernode with the conductances of the matrix."""
    indptr, indices, data, ground = matrix
    order, rank = pattern.order, pattern.rank
    values, place = entries.values, work.place
    first, base = nodes.first[node], nodes.offset[node]
    length = nodes.start[node + 1] - nodes.start[node]
    for i in range(base, nodes.offset[node + 1]):
        values[np.uint64(i)] = 0.0
    for r in range(length):
        place[nodes.rows[nodes.start[node] + r]] = r
    for k in range(first, nodes.first[node + 1]):
        entries.grounded[k] = ground[order[k]]
        for entry in range(indptr[order[k]], indptr[order[k] + 1]):
            row = rank[indices[entry]]
            if row > k:
                values[base + (k - first) * length + place[row]] = data[entry]


@inlined
def _update(nodes: Supernodes, entries: Entries, work: Workspace, other: int, node: int) -> None:
    """Add what an eliminated supernode joins the columns of a later one to; moves on to its first row behind them."""
    rows, place, weight, values = nodes.rows, work.place, work.weight, entries.values
    begin, end = work.after[other], nodes.start[other + 1]
    first, columns = nodes.first[other], nodes.first[other + 1] - nodes.first[other]
    apart = end - nodes.start[other]
    source = nodes.offset[other] + begin - nodes.start[other]
    length = nodes.start[node + 1] - nodes.start[node]
    follow_on = place[rows[end - 1]] - place[rows[begin]] == end - 1 - begin
    at = begin
    while at < end and rows[at] < nodes.first[node + 1]:
        here, left = source + at - begin, end - at - 1
        there = nodes.offset[node] + place[rows[at]] * (length + 1)
        _weigh(entries, first, columns, here, apart, rows[at], weight)
        if follow_on:
            _add_columns(values, there + 1, values, here + 1, apart, weight, columns, left)
        else:
            for i in range(left):
                work.column[i] = 0.0
            _add_columns(work.column, ZERO, values, here + 1, apart, weight, columns, left)
            there -= place[rows[at]]
            for i in range(left):
                values[there + place[rows[at + 1 + i]]] += work.column[i]
        at += 1
    work.after[other] = at


@inlined
def _weigh(entries: Entries, first: int, columns: int, here: int, apart: int, row: int, weight: Floats) -> None:
    """Conductances from eliminated columns to a row, which their shares count by; adds what goes to the ground."""
    values, pivot, grounded = entries
    total = 0.0
    for k in range(columns):
        w = pivot[first + k] * values[here + k * apart]
        weight[k] = w
        total += w * grounded[first + k]
    grounded[row] += total


@inlined
def _eliminate_within(nodes: Supernodes, entries: Entries, work: Workspace, node: int) -> bool:
    """Eliminate the columns of a supernode that everything before has been added to."""
    values, pivot, grounded = entries
    first, base, width = nodes.first[node], nodes.offset[node], nodes.first[node + 1] - nodes.first[node]
    length, weight = nodes.start[node + 1] - nodes.start[node], work.weight
    for c in range(width):
        k, below, end = first + c, base + c * length + c + 1, base + (c + 1) * length
        _weigh(entries, first, c, base + c, length, k, weight)
        _add_columns(values, below, values, base + c + 1, length, weight, c, end - below)
        total = grounded[k] + _sum(values, below, end)
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
def _sum(values: Floats, begin: int, end: int) -> float:
    total = 0.0
    for i in range(begin, end):
        total += values[np.uint64(i)]
    return total


@inner_fast
def _add_columns(
    target: Floats, there: int, values: Floats, here: int, apart: int, weight: Floats, columns: int, count: int
) -> None:
    """Add columns of values that begin ``apart``, by their weights, four at a time."""
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
def substitute(
    whole: Conductances, reduced: Reduced, nodes: Supernodes, values: Floats, pivot: Floats, m: Floats, e: Integers,
    kept_m: Floats, kept_e: Integers, column: Floats,
) -> None:  # fmt: skip
    """Solve for all rows in place, in scaled numbers: reduce, ``L D L^T x = b`` for the rows kept, put the others back.

    Within a supernode numbers have one exponent in common, the largest; where a sum leaves the range of doubles so, the
    supernode is gone through again number by number.

    Shapes: `m, e` (n,); `kept_m, kept_e` (kept,) and `column` (longest supernode,): room.
    """
    _feed_kept(whole, reduced, m, e, kept_m, kept_e)
    for node in range(len(nodes.first) - 1):
        _forward(nodes, values, kept_m, kept_e, column, node)
    for k in range(len(kept_m)):
        kept_m[k], kept_e[k] = _canonical(kept_m[k] / pivot[k], kept_e[k])
    for node in range(len(nodes.first) - 2, -1, -1):
        _backward(nodes, values, kept_m, kept_e, column, node)
    _put_back(whole, reduced, kept_m, kept_e, m, e)


@inlined
def _feed_kept(whole: Conductances, reduced: Reduced, m: Floats, e: Integers, kept_m: Floats, kept_e: Integers) -> None:
    """What is fed into the rows kept once the others are eliminated, ``b_i += g_ik b_k / d_k``."""
    place, pivot = reduced
    for i in range(len(place)):
        m[i], e[i] = _canonical(m[i], e[i])
        if place[i] >= 0:
            kept_m[place[i]], kept_e[place[i]] = m[i], e[i]
    for i in range(len(place)):
        if place[i] >= 0 or m[i] == 0.0:
            continue
        for entry in range(whole.indptr[i], whole.indptr[i + 1]):
            k, share = place[whole.indices[entry]], whole.edges[entry] / pivot[i]
            kept_m[k], kept_e[k] = _add_product(kept_m[k], kept_e[k], share, m[i], e[i])
    for k in range(len(kept_m)):
        kept_m[k], kept_e[k] = _canonical(kept_m[k], kept_e[k])


@inlined
def _put_back(whole: Conductances, reduced: Reduced, kept_m: Floats, kept_e: Integers, m: Floats, e: Integers) -> None:
    """Solve for all rows from those kept, ``x_k = (b_k + sum g_ki x_i) / d_k``, in place of what is fed into them."""
    place, pivot = reduced
    for i in range(len(place)):
        if place[i] >= 0:
            m[i], e[i] = kept_m[place[i]], kept_e[place[i]]
            continue
        value, scale = _canonical(m[i] / pivot[i], e[i])
        for entry in range(whole.indptr[i], whole.indptr[i + 1]):
            k, share = place[whole.indices[entry]], whole.edges[entry] / pivot[i]
            value, scale = _add_product(value, scale, share, kept_m[k], kept_e[k])
        m[i], e[i] = _canonical(value, scale)


@inlined
def _forward(nodes: Supernodes, values: Floats, m: Floats, e: Integers, column: Floats, node: int) -> None:
    """Spread what is fed into the columns of a supernode over its rows."""
    begin, base = nodes.start[node], nodes.offset[node]
    length, columns = nodes.start[node + 1] - begin, nodes.first[node + 1] - nodes.first[node]
    fed = 0
    while fed < columns and m[nodes.rows[begin + fed]] == 0.0:
        fed += 1
    if fed == columns:
        return
    common = _align(nodes.rows, begin, fed, length, m, e, column)
    for c in range(fed, columns):
        _add_times(column, values, base + c * length, c + 1, length, column[c])
    if _smallest(column, fed, length) >= _LEAST:
        for r in range(fed, length):
            row = nodes.rows[begin + r]
            m[row], e[row] = _canonical(column[r], common)
        return
    for c in range(fed, columns):
        value, scale = m[nodes.rows[begin + c]], e[nodes.rows[begin + c]]
        for r in range(c + 1, length):
            row = nodes.rows[begin + r]
            t, te = _add_product(m[row], e[row], values[base + c * length + r], value, scale)
            m[row], e[row] = _canonical(t, te)


@inlined
def _backward(nodes: Supernodes, values: Floats, m: Floats, e: Integers, column: Floats, node: int) -> None:
    """Solve for the rows of a supernode's columns, from those of the later ones."""
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
        value, scale = m[first + c], e[first + c]
        for r in range(c + 1, length):
            row = nodes.rows[begin + r]
            value, scale = _add_product(value, scale, values[base + c * length + r], m[row], e[row])
        m[first + c], e[first + c] = _canonical(value, scale)


@inlined
def _align(rows: Indices, begin: int, skipped: int, length: int, m: Floats, e: Integers, column: Floats) -> int:
    """Write some rows as doubles; returns the largest of their exponents, which is common to all then."""
    common, found = int(e[rows[begin + skipped]]), m[rows[begin + skipped]] != 0.0
    for r in range(skipped + 1, length):
        row = rows[begin + r]
        if m[row] != 0.0 and (not found or e[row] > common):
            common, found = int(e[row]), True
    for r in range(skipped, length):
        row = rows[begin + r]
        column[r] = _shift(m[row], e[row] - common)
    return common


@inner_fast
def _smallest(column: Floats, begin: int, end: int) -> float:
    least = np.inf
    for i in range(begin, end):
        least = min(least, abs(column[np.uint64(i)]))
    return least


@inner_fast
def _add_times(column: Floats, values: Floats, base: int, begin: int, end: int, value: float) -> None:
    b = np.uint64(base)
    for each in range(begin, end):
        i = np.uint64(each)
        column[i] += value * values[b + i]


@inner_fast
def _product(column: Floats, values: Floats, base: int, begin: int, end: int) -> float:
    total, b = 0.0, np.uint64(base)
    for each in range(begin, end):
        i = np.uint64(each)
        total += column[i] * values[b + i]
    return total
