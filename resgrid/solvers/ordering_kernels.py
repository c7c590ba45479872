"""Kernels that order the rows of a matrix: breadth first for fast memory access, by minimum fill for elimination.

Approximate minimum fill (Rothberg & Eisenstat 1998) by approximate degrees (Amestoy, Davis & Duff 1996). The remaining
graph is never formed but kept as a quotient graph: an eliminated row becomes an *element*, which represents the clique
of its former neighbours. Indistinguishable rows are eliminated together: after the elimination of one, the element is
the only neighbour of the others.

The import of numba takes seconds: only functions that are about to solve import this module.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from resgrid._internal.jit import inlined, interruptible, kernel
from resgrid.solvers.llvm_intrinsics import prefetch
from resgrid.solvers.scaled import Floats, Indices, Singles

_WAITS, _JOINS = -1, -2
"""States of rows without an elimination step: the row is not eliminated yet; it belongs to the newest element.

An element of the quotient graph stands for an eliminated row and joins its former neighbours.
"""

_SAMPLE = 8000
"""Approximate number of matrix entries that `far_fraction` samples."""


def far_fraction(indptr: Indices, indices: Indices) -> float:
    """Return the fraction of sampled pairs of neighbours with row numbers more than a sixteenth of all rows apart.

    `indptr` (n + 1,), `indices` (entries,): compressed rows of the neighbours of every row.
    """
    some = np.arange(0, len(indices), 1 + len(indices) // _SAMPLE)
    apart = np.abs(indices[some] - (np.searchsorted(indptr, some, side="right") - 1))
    return float(np.count_nonzero(apart > len(indptr) // 16)) / max(len(some), 1)


@interruptible
@kernel
def renumber(
    indptr: Indices, indices: Indices, conductance: Singles, leak: Floats
) -> tuple[tuple[Indices, Indices, Singles, Floats], Indices]:
    """Return a graph renumbered breadth first (Cuthill & McKee 1969), and the new number of every node, shape (n,).

    `indptr` (n + 1,), `indices, conductance` (entries,), `leak` (n,): compressed rows of the conductances between
    nodes, and conductances to known voltages. The returned graph has the same four arrays. Neighbours are then close in
    memory. Rows are written in the order in which their nodes are reached.
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
    """The quotient graph of an elimination (George & Liu 1981), and linked lists of its rows by degree.

    An element is an eliminated row; its members are the remaining rows that its elimination has joined to each other.

    `near` (entries,): neighbours of row ``i`` from index `start[i]` on: first `elements[i]` elements, then rows,
    `length[i]` neighbours altogether; `first, last` (n,): begin and end of an element's members in the list of all
    members; `degree` (n,): number of members of an element; for a remaining row, ``2 sqrt(2 f)`` rounded down, for an
    approximate fill of ``f`` entries below the diagonal (at the start, the number of neighbours); `outside` (n,):
    number of an element's members that are not members of the newest element; `stamp` (n,): elimination step in which
    `outside` was last computed; `head` (n,): first row of the list of each degree, -1 for an empty list; `after,
    before` (n,): successor and predecessor of a row in its list, -1 at the ends.
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
    """Return the quotient graph before the first elimination.

    `indptr` (n + 1,), `indices` (entries,): compressed rows of the neighbours of every row.
    """
    n = len(indptr) - 1
    elements, first, last, degree, outside = np.zeros((5, n), dtype=np.int32)
    lists = np.full((4, n), -1, dtype=np.int32)
    return Quotient(indptr, indices.copy(), elements, np.diff(indptr), first, last, degree, outside, *lists)


@kernel
def minimum_fill(
    q: Quotient, place: Indices, kept: int, dense: int, most: float, most_members: int, step: Indices
) -> bool:
    """Eliminate the rows in order of approximate least fill; return False if `most` or `most_members` is exceeded.

    Rows with ``place[i] >= kept``, which odd-even reduction eliminates, come first; rows with more than ``dense``
    neighbours come last.

    `q`: quotient graph before elimination, modified; `place` (n,): position of every row after odd-even reduction;
    `kept`: number of rows that odd-even reduction leaves; `most`: limit on the entries of the factors; `most_members`:
    limit on the total number of members of all elements; `step` (n,): receives the elimination step of every row, equal
    for rows that are eliminated together, incomplete if a limit is exceeded.
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
            # Elimination joins d rows, of which c are joined already: (d^2 - c^2) / 2 entries of fill.
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
    """Insert row ``i`` of the quotient graph ``q`` at the head of the linked list of rows with degree ``degree``."""
    other = q.head[degree]
    q.degree[i], q.after[i], q.before[i], q.head[degree] = degree, other, -1, i
    if other >= 0:
        q.before[other] = i


@inlined
def _unlink(q: Quotient, i: int) -> None:
    """Remove row ``i`` of the quotient graph ``q`` from the linked list of rows with the degree of row ``i``."""
    before, after = q.before[i], q.after[i]
    if after >= 0:
        q.before[after] = before
    if before >= 0:
        q.after[before] = after
    else:
        q.head[q.degree[i]] = after


@inlined
def with_room(numbers: Indices, size: int, more: int) -> Indices:
    """Return an array that begins with ``numbers[:size]`` and has at least `more` free entries after them."""
    if size + more <= len(numbers):
        return numbers
    longer = np.empty(2 * len(numbers) + more, np.int32)
    for k in range(size):
        longer[k] = numbers[k]
    return longer


@inlined
def _gather(q: Quotient, members: Indices, step: Indices, p: int, size: int) -> int:
    """Turn row ``p`` into an element, append its members to ``members`` from index ``size`` on, and return their end.

    The members are the remaining neighbours of ``p`` and the members of its neighbouring elements, which are emptied.
    `q`: quotient graph; `step` (n,): elimination step of every row, or negative (-1: not eliminated, -2: a member).
    """
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
    """Count, for every element next to the newest one, the members that the newest element lacks, into ``q.outside``.

    `q`: quotient graph; `members[begin:end]`: members of the newest element; `k`: elimination step of the newest
    element.
    """
    for r in range(begin, end):
        i = members[r]
        for s in range(q.start[i], q.start[i] + q.elements[i]):
            e = q.near[s]
            if q.stamp[e] != k:
                q.stamp[e], q.outside[e] = k, q.degree[e]
            q.outside[e] -= 1


@inlined
def _prune(q: Quotient, members: Indices, step: Indices, p: int, begin: int, end: int) -> int:
    """Connect the members of the new element ``p`` to it, and return the end of its remaining members in ``members``.

    Edges that lie inside the element are removed. Members without other neighbours are eliminated together with ``p``.

    `q`: quotient graph; `members[begin:end]`: the members, compacted in place; `step` (n,): elimination step of every
    row, or negative (-1: not eliminated, -2: a member of ``p``).
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
