"""Orders of the rows of a matrix: neighbours together, or so that its factors fill little.

Approximate minimum fill (Rothberg & Eisenstat 1998) by approximate degrees (Amestoy, Davis & Duff 1996): the graph of
what is left is never formed.  It is kept as a quotient graph: a row that has been eliminated stands, as an *element*,
for the clique of the rows that it was joined to.  Rows with the same neighbours leave together: once one is eliminated,
the others are joined to nothing but its element.

Numba takes seconds to import: only functions that are about to solve import this module.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from resgrid._internal.jit import inlined, interruptible, kernel
from resgrid.solvers.llvm_intrinsics import prefetch
from resgrid.solvers.scaled import Floats, Indices, Singles

_WAITS, _JOINS = -1, -2
"""In place of its step of elimination: of a row that is not eliminated, and of one that joins the newest element."""

_SAMPLE = 8000
"""Entries that tell how far apart neighbours are numbered."""


def far_share(indptr: Indices, indices: Indices) -> float:
    """Share of a sample of neighbours that are numbered far apart: by more than a sixteenth of all."""
    some = np.arange(0, len(indices), 1 + len(indices) // _SAMPLE)
    apart = np.abs(indices[some] - (np.searchsorted(indptr, some, side="right") - 1))
    return float(np.count_nonzero(apart > len(indptr) // 16)) / max(len(some), 1)


@interruptible
@kernel
def renumber(
    indptr: Indices, indices: Indices, conductance: Singles, leak: Floats
) -> tuple[tuple[Indices, Indices, Singles, Floats], Indices]:
    """The same graph, its nodes numbered breadth first and written as they are reached, and their numbers (n,).

    So neighbours lie together (Cuthill & McKee 1969).
    """
    n, entries = len(leak), len(indices)
    number, order = np.full(n, -1, np.int32), np.empty(n + 1, np.int32)
    new_indptr, new_indices = np.zeros(n + 1, np.int32), np.empty(entries, np.int32)
    new_conductance, new_leak = np.empty(entries, np.float32), np.empty(n)
    reached, root, size = 0, 0, 0
    for place in range(n):
        if place == reached:
            while number[root] >= 0:
                root += 1
            number[root], order[reached] = reached, root
            reached += 1
        i = order[place]
        new_leak[place] = leak[i]
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            order[reached] = j
            prefetch(indices, indptr[j])
            prefetch(conductance, indptr[j])
            known = number[j] >= 0
            number[j] = number[j] if known else reached
            reached += not known
            new_indices[size] = number[j]
            new_conductance[size] = conductance[k]
            size += 1
        new_indptr[place + 1] = size
    return (new_indptr, new_indices, new_conductance, new_leak), number


class Quotient(NamedTuple):
    """The quotient graph, and rows by what their elimination would fill.

    `near` (entries,): from `start[i]` on what row ``i`` is joined to: elements, so many as `elements[i]`, then rows;
    `length[i]` in all; `first, last` (n,): where the members of an element begin and end in a list of all; `degree`
    (n,): of elements how many members they had, of rows twice the root of what they fill; `outside, stamp` (n,): of
    elements how many lie outside the newest one, and of which element that was told last; `head, after, before` (n,):
    rows by their `degree`, as linked lists.
    """

    start: Indices
    near: Indices
    elements: Indices
    length: Indices
    first: Indices
    last: Indices
    degree: Indices
    outside: Indices
    stamp: Indices
    head: Indices
    after: Indices
    before: Indices


def quotient_graph(indptr: Indices, indices: Indices) -> Quotient:
    """The quotient graph before elimination, of a graph of rows `indptr` (n + 1,)."""
    n = len(indptr) - 1
    elements, first, last, degree, outside = np.zeros((5, n), dtype=np.int32)
    lists = np.full((4, n), -1, dtype=np.int32)
    return Quotient(indptr, indices.copy(), elements, np.diff(indptr), first, last, degree, outside, *lists)


@kernel
def minimum_fill(
    q: Quotient, place: Indices, kept: int, dense: int, most: float, most_members: int, step: Indices
) -> bool:
    """Eliminate all rows, those that are not kept first, then one that fills least after another.

    Rows of more than ``dense`` neighbours come last.

    Shapes: `place` (n,): not below ``kept`` for rows that are not kept; `step` (n,): when every row is eliminated;
    those that are along with another have the same number.  Returns whether the factors have at most so many entries,
    and elements so many members.
    """
    n, least, size, k = len(step), 0, 0, 0
    left, entries = n, 0.0
    members = np.empty(6 * n, np.int32)
    for i in range(n):
        step[i] = _WAITS
        if place[i] < kept and q.length[i] > dense:
            step[i] = n
            left -= 1
        else:
            _link(q, i, q.length[i] if place[i] < kept else 0)
    while left > 0:
        while q.head[least] < 0:
            least += 1
        p = q.head[least]
        _unlink(q, p)
        if size + n > most_members:
            return False
        members = with_room(members, size, n)
        step[p] = k
        end = _gather(q, members, step, p, size)
        _count_outside(q, members, size, end, k)
        joined = end - size
        end = _prune(q, members, step, p, size, end)
        total = end - size
        gone = 1 + joined - total
        left -= gone
        entries += gone * (total + 0.5 * gone)
        if entries > most:
            return False
        for r in range(size, end):
            i = members[r]
            # Of d rows joined anew c are joined already: (d^2 - c^2) / 2 entries fill.
            step[i], filled = _WAITS, float(q.degree[i]) * (q.degree[i] + 2 * total)
            degree = min(int(2.0 * math.sqrt(filled)), n - 1)
            _link(q, i, degree)
            least = min(least, degree)
        q.first[p], q.last[p], q.degree[p] = size, end, total
        size = end
        k += 1
    return True


@inlined
def _link(q: Quotient, i: int, degree: int) -> None:
    """Put a row in front of those that fill as much."""
    other = q.head[degree]
    q.degree[i], q.after[i], q.before[i], q.head[degree] = degree, other, -1, i
    if other >= 0:
        q.before[other] = i


@inlined
def _unlink(q: Quotient, i: int) -> None:
    """Take a row from among those that fill as much."""
    before, after = q.before[i], q.after[i]
    if after >= 0:
        q.before[after] = before
    if before >= 0:
        q.after[before] = after
    else:
        q.head[q.degree[i]] = after


@inlined
def with_room(numbers: Indices, size: int, more: int) -> Indices:
    """A list of so many numbers, with room for more behind them."""
    if size + more <= len(numbers):
        return numbers
    longer = np.empty(2 * len(numbers) + more, np.int32)
    for k in range(size):
        longer[k] = numbers[k]
    return longer


@inlined
def _gather(q: Quotient, members: Indices, step: Indices, p: int, size: int) -> int:
    """Make an element of a row: all that it is joined to, elements absorbed; returns where its members end."""
    for s in range(q.start[p], q.start[p] + q.length[p]):
        x, inside = q.near[s], s < q.start[p] + q.elements[p]
        first, last = (q.first[x], q.last[x]) if inside else (0, 1)
        for r in range(first, last):
            i = members[r] if inside else x
            if step[i] == _WAITS:
                step[i], members[size] = _JOINS, i
                size += 1
                _unlink(q, i)
        if inside:
            q.last[x] = q.first[x]
    return size


@inlined
def _count_outside(q: Quotient, members: Indices, begin: int, end: int, k: int) -> None:
    """How many members of other elements lie outside the newest one, the ``k``-th."""
    for r in range(begin, end):
        i = members[r]
        for s in range(q.start[i], q.start[i] + q.elements[i]):
            e = q.near[s]
            if q.stamp[e] != k:
                q.stamp[e], q.outside[e] = k, q.degree[e]
            q.outside[e] -= 1


@inlined
def _prune(q: Quotient, members: Indices, step: Indices, p: int, begin: int, end: int) -> int:
    """Join the members of a new element to it, instead of to each other and to elements within it.

    Members that are joined to nothing else are eliminated along with it.  Returns where the others end.
    """
    kept = begin
    for r in range(begin, end):
        i = members[r]
        first, at, degree, elements = q.start[i], q.start[i], 0, 0
        inner, last = first + q.elements[i], first + q.length[i]
        for s in range(first, last):
            x, more = q.near[s], 0
            if s >= inner:
                more = 1 if step[x] == _WAITS else 0
            elif q.last[x] > q.first[x]:
                more = q.outside[x]
                q.last[x] = q.last[x] if more > 0 else q.first[x]
            if more > 0:
                q.near[at], degree = x, degree + more
                at += 1
                elements += s < inner
        if degree == 0:
            step[i] = step[p]
            continue
        inner = first + elements
        q.near[at], q.near[inner], q.near[first] = q.near[inner], q.near[first], p
        q.elements[i], q.length[i], q.degree[i] = elements + 1, at + 1 - first, degree
        members[kept] = i
        kept += 1
    return kept
