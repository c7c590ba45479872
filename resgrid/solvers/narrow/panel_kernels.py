"""Compiled loops over panels: the elimination of narrow circuits.

A *panel* is a run of columns of ``L`` that are kept as one dense block over the rows that any of them has entries in,
its own first (supernodes; Ashcraft & Grimes 1989).  Elimination then adds up dense columns, for the most part.

Numba takes seconds to import: only functions that are about to solve import this module.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import ZERO, inlined, inner_fast

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Indices = NDArray[np.int32]


class Panels(NamedTuple):
    """Panels of a unit lower triangular matrix.

    `first` (panels + 1,): their first columns, and ``n``; `start` (panels + 1,): where their rows begin in ``rows``;
    `rows`: their rows, ascending: first those of their own columns; `offset` (panels + 1,): where their entries begin
    among the values: column by column, all as long as there are rows.
    """

    first: Indices
    start: Indices
    rows: Indices
    offset: Integers


class Matrix(NamedTuple):
    """A nodal system in the order of its elimination.

    `indptr, indices, data`: conductances between rows by rows, in siemens; `excess` (n,): conductances to the rails,
    in siemens; `order, rank` (n,): row of every number, and number of every row.
    """

    indptr: Indices
    indices: Indices
    data: Floats
    excess: Floats
    order: Indices
    rank: Indices


class Entries(NamedTuple):
    """The entries of the factors; a share is that of a conductance in its pivot.

    `values`: the entries of ``-L`` below the diagonal, panel by panel: shares that go to later rows. What stands
    above the diagonal is 0; `pivot, to_rails` (n,): ``D`` in siemens, and the shares that go to the rails.
    """

    values: Floats
    pivot: Floats
    to_rails: Floats


class Bench(NamedTuple):
    """Where elimination keeps what it is at.

    `panel_of` (n,); `waiting, following` (panels,): lists of the panels that are next to be added to a panel: the
    first, and the one after each; -1 at the end; `after` (panels,): which of their rows that panel begins at; `place`
    (n,): places of the rows of the panel that is being eliminated; `column`: as long as the longest panel; `weight`
    (columns,); `weights` (columns, 4): as long as the widest panel.
    """

    panel_of: Indices
    waiting: Indices
    following: Indices
    after: Indices
    place: Indices
    column: Floats
    weight: Floats
    weights: Floats


@njit(cache=True, nogil=True)
def eliminate(matrix: Matrix, panels: Panels, entries: Entries, bench: Bench, begin: int, end: int) -> bool:
    """Factor some panels in order, in sums, products and quotients of positive numbers alone.

    A row that is eliminated joins those it was joined to, and the rails, by ``c_i c_j / d``; its pivot ``d`` is the sum
    of its conductances to later rows and to the rails, never a difference (Grassmann, Taksar & Heyman 1985).  So every
    entry is right to some roundings, whatever the conductances.
    """
    for panel in range(begin, end):
        _lay_out(matrix, panels, entries, bench, panel)
        other = bench.waiting[panel]
        while other >= 0:
            following = bench.following[other]
            _join(panels, entries, bench, other, panel)
            _queue(panels, bench, other)
            other = following
        if not _eliminate_within(panels, entries, bench, panel):
            return False
        bench.after[panel] = panels.start[panel] + panels.first[panel + 1] - panels.first[panel]
        _queue(panels, bench, panel)
    return True


@inlined
def _queue(panels: Panels, bench: Bench, panel: int) -> None:
    """Have a panel wait for the one that its next row belongs to."""
    after = bench.after[panel]
    if after < panels.start[panel + 1]:
        target = bench.panel_of[panels.rows[after]]
        bench.following[panel] = bench.waiting[target]
        bench.waiting[target] = panel


@inlined
def _lay_out(matrix: Matrix, panels: Panels, entries: Entries, bench: Bench, panel: int) -> None:
    """Fill a panel with the conductances of the circuit."""
    indptr, indices, data, excess, order, rank = matrix
    values, place = entries.values, bench.place
    first, base = panels.first[panel], panels.offset[panel]
    length = panels.start[panel + 1] - panels.start[panel]
    for i in range(base, panels.offset[panel + 1]):
        values[np.uint64(i)] = 0.0
    for r in range(length):
        place[panels.rows[panels.start[panel] + r]] = r
    for k in range(first, panels.first[panel + 1]):
        entries.to_rails[k] = excess[order[k]]
        for entry in range(indptr[order[k]], indptr[order[k] + 1]):
            row = rank[indices[entry]]
            if row > k:
                values[base + (k - first) * length + place[row]] = data[entry]


@inlined
def _join(panels: Panels, entries: Entries, bench: Bench, other: int, panel: int) -> None:
    """Add what an eliminated panel joins the columns of a later one to; moves on to its first row behind them."""
    rows, place, weight = panels.rows, bench.place, bench.weight
    values, pivot, to_rails = entries
    begin, end = bench.after[other], panels.start[other + 1]
    first, columns = panels.first[other], panels.first[other + 1] - panels.first[other]
    apart = end - panels.start[other]
    source = panels.offset[other] + begin - panels.start[other]
    length = panels.start[panel + 1] - panels.start[panel]
    follow_on = place[rows[end - 1]] - place[rows[begin]] == end - 1 - begin
    at = begin
    while at < end and rows[at] < panels.first[panel + 1]:
        here, left = source + at - begin, end - at - 1
        there = panels.offset[panel] + place[rows[at]] * (length + 1)
        if follow_on and left > 2 and rows[at + 3] < panels.first[panel + 1]:
            # The same rows for all four: what that adds above the diagonal is cleared when they are eliminated.
            _weigh_four(values, pivot, to_rails, first, columns, here, apart, rows[at], bench.weights)
            _add_to_four(values, there + 1, length, here + 1, apart, bench.weights, columns, left)
            at += 4
            continue
        _weigh(values, pivot, to_rails, first, columns, here, apart, rows[at], weight)
        if follow_on:
            _add_columns(values, there + 1, values, here + 1, apart, weight, columns, left)
        else:
            for i in range(left):
                bench.column[i] = 0.0
            _add_columns(bench.column, ZERO, values, here + 1, apart, weight, columns, left)
            there -= place[rows[at]]
            for i in range(left):
                values[there + place[rows[at + 1 + i]]] += bench.column[i]
        at += 1
    bench.after[other] = at


@inlined
def _weigh(
    values: Floats, pivot: Floats, to_rails: Floats, first: int, columns: int, here: int, apart: int, row: int,
    weight: Floats,
) -> None:  # fmt: skip
    """Conductances from eliminated columns to a row, which their shares count by; adds what goes to the rails."""
    total = 0.0
    for k in range(columns):
        weight[k] = pivot[first + k] * values[here + k * apart]
        total += weight[k] * to_rails[first + k]
    to_rails[row] += total


@inlined
def _weigh_four(
    values: Floats, pivot: Floats, to_rails: Floats, first: int, columns: int, here: int, apart: int, row: int,
    weights: Floats,
) -> None:  # fmt: skip
    """The same for four rows, one behind the other."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for k in range(columns):
        own, rails, at = pivot[first + k], to_rails[first + k], here + k * apart
        w, x, y, z = own * values[at], own * values[at + 1], own * values[at + 2], own * values[at + 3]
        weights[k, 0], weights[k, 1], weights[k, 2], weights[k, 3] = w, x, y, z
        a, b, c, d = a + w * rails, b + x * rails, c + y * rails, d + z * rails
    to_rails[row] += a
    to_rails[row + 1] += b
    to_rails[row + 2] += c
    to_rails[row + 3] += d


@inlined
def _eliminate_within(panels: Panels, entries: Entries, bench: Bench, panel: int) -> bool:
    """Eliminate the columns of a panel that everything before has been added to.

    Four at a time receive all that comes before the first of them; only the others among the four are left then.
    """
    values, pivot, to_rails = entries
    first, base, width = panels.first[panel], panels.offset[panel], panels.first[panel + 1] - panels.first[panel]
    length, weight, done = panels.start[panel + 1] - panels.start[panel], bench.weight, 0
    for c in range(width):
        k, below, end = first + c, base + c * length + c + 1, base + (c + 1) * length
        if c % 4 == 0:
            done = 0
            if 0 < c <= width - 4:
                _weigh_four(values, pivot, to_rails, first, c, base + c, length, k, bench.weights)
                _add_to_four(values, below, length, base + c + 1, length, bench.weights, c, end - below)
                done = c
        _weigh(values, pivot, to_rails, first + done, c - done, base + done * length + c, length, k, weight)
        _add_columns(values, below, values, base + done * length + c + 1, length, weight, c - done, end - below)
        total = to_rails[k] + _sum(values, below, end)
        if not (total > 0.0 and math.isfinite(total)):
            return False
        pivot[k] = total
        to_rails[k] /= total
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
