"""Compiled loops of the supernodal elimination of an M-matrix, ``P A P^T = L D L^T``, in positive numbers alone.

A *supernode* is a run of columns of ``L`` that are kept as one dense block over the rows that any of them has entries
in, its own first (Ashcraft & Grimes 1989).  Elimination then adds up dense columns, for the most part.

Numba takes seconds to import: only functions that are about to solve import this module.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import ZERO, inlined, inner_fast, kernel
from resgrid.solvers.odd_even_kernels import Rows
from resgrid.solvers.symbolic_kernels import Pattern

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Indices = NDArray[np.int32]


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
    the longest one; `weight` (columns,); `weights` (columns, 4): as long as the widest one.
    """

    node_of: Indices
    waiting: Indices
    following: Indices
    after: Indices
    place: Indices
    column: Floats
    weight: Floats
    weights: Floats


@kernel
def eliminate(
    matrix: Rows, pattern: Pattern, nodes: Supernodes, entries: Entries, work: Workspace, begin: int, end: int
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
def _load(matrix: Rows, pattern: Pattern, nodes: Supernodes, entries: Entries, work: Workspace, node: int) -> None:
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
    rows, place, weight = nodes.rows, work.place, work.weight
    values, pivot, grounded = entries
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
        if follow_on and left > 2 and rows[at + 3] < nodes.first[node + 1]:
            # The same rows for all four: what that adds above the diagonal is cleared when they are eliminated.
            _weigh_four(values, pivot, grounded, first, columns, here, apart, rows[at], work.weights)
            _add_to_four(values, there + 1, length, here + 1, apart, work.weights, columns, left)
            at += 4
            continue
        _weigh(values, pivot, grounded, first, columns, here, apart, rows[at], weight)
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
def _weigh(
    values: Floats, pivot: Floats, grounded: Floats, first: int, columns: int, here: int, apart: int, row: int,
    weight: Floats,
) -> None:  # fmt: skip
    """Conductances from eliminated columns to a row, which their shares count by; adds what goes to the ground."""
    total = 0.0
    for k in range(columns):
        weight[k] = pivot[first + k] * values[here + k * apart]
        total += weight[k] * grounded[first + k]
    grounded[row] += total


@inlined
def _weigh_four(
    values: Floats, pivot: Floats, grounded: Floats, first: int, columns: int, here: int, apart: int, row: int,
    weights: Floats,
) -> None:  # fmt: skip
    """The same for four rows, one behind the other."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for k in range(columns):
        own, rails, at = pivot[first + k], grounded[first + k], here + k * apart
        w, x, y, z = own * values[at], own * values[at + 1], own * values[at + 2], own * values[at + 3]
        weights[k, 0], weights[k, 1], weights[k, 2], weights[k, 3] = w, x, y, z
        a, b, c, d = a + w * rails, b + x * rails, c + y * rails, d + z * rails
    grounded[row] += a
    grounded[row + 1] += b
    grounded[row + 2] += c
    grounded[row + 3] += d


@inlined
def _eliminate_within(nodes: Supernodes, entries: Entries, work: Workspace, node: int) -> bool:
    """Eliminate the columns of a supernode that everything before has been added to.

    Four at a time receive all that comes before the first of them; only the others among the four are left then.
    """
    values, pivot, grounded = entries
    first, base, width = nodes.first[node], nodes.offset[node], nodes.first[node + 1] - nodes.first[node]
    length, weight, done = nodes.start[node + 1] - nodes.start[node], work.weight, 0
    for c in range(width):
        k, below, end = first + c, base + c * length + c + 1, base + (c + 1) * length
        if c % 4 == 0:
            done = 0
            if 0 < c <= width - 4:
                _weigh_four(values, pivot, grounded, first, c, base + c, length, k, work.weights)
                _add_to_four(values, below, length, base + c + 1, length, work.weights, c, end - below)
                done = c
        _weigh(values, pivot, grounded, first + done, c - done, base + done * length + c, length, k, weight)
        _add_columns(values, below, values, base + done * length + c + 1, length, weight, c - done, end - below)
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


@inner_fast
def _add_to_four(
    values: Floats, there: int, beside: int, here: int, apart: int, weights: Floats, columns: int, count: int
) -> None:
    """Add columns to four that begin ``beside`` each other, by the weights of each, four at a time."""
    t0, t1 = np.uint64(there), np.uint64(there + beside)
    t2, t3, k = np.uint64(there + 2 * beside), np.uint64(there + 3 * beside), 0
    while k + 4 <= columns:
        a0, a1, a2, a3 = weights[k, 0], weights[k + 1, 0], weights[k + 2, 0], weights[k + 3, 0]
        b0, b1, b2, b3 = weights[k, 1], weights[k + 1, 1], weights[k + 2, 1], weights[k + 3, 1]
        c0, c1, c2, c3 = weights[k, 2], weights[k + 1, 2], weights[k + 2, 2], weights[k + 3, 2]
        d0, d1, d2, d3 = weights[k, 3], weights[k + 1, 3], weights[k + 2, 3], weights[k + 3, 3]
        s0, s1 = np.uint64(here + k * apart), np.uint64(here + (k + 1) * apart)
        s2, s3 = np.uint64(here + (k + 2) * apart), np.uint64(here + (k + 3) * apart)
        for each in range(count):
            i = np.uint64(each)
            u, v, w, x = values[s0 + i], values[s1 + i], values[s2 + i], values[s3 + i]
            values[t0 + i] += (a0 * u + a1 * v) + (a2 * w + a3 * x)
            values[t1 + i] += (b0 * u + b1 * v) + (b2 * w + b3 * x)
            values[t2 + i] += (c0 * u + c1 * v) + (c2 * w + c3 * x)
            values[t3 + i] += (d0 * u + d1 * v) + (d2 * w + d3 * x)
        k += 4
    while k < columns:
        a, b, c, d, s = weights[k, 0], weights[k, 1], weights[k, 2], weights[k, 3], np.uint64(here + k * apart)
        for each in range(count):
            i = np.uint64(each)
            u = values[s + i]
            values[t0 + i] += a * u
            values[t1 + i] += b * u
            values[t2 + i] += c * u
            values[t3 + i] += d * u
        k += 1
