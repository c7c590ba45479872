"""Compiled loops that order the nodes of a graph: breadth first, so that neighbours lie together, or by least degree.

Approximate minimum degree (Amestoy, Davis & Duff 1996): the graph of what is left is never formed.  It is kept as a
quotient graph: a row that has been eliminated stands, as an *element*, for the clique of the rows that it was joined
to; rows with the same neighbours are merged, and one of them stands for all.

Numba takes seconds to import: only functions that are about to solve import this module.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import inlined, kernel, makes_arrays
from resgrid.solvers.machine import prefetch

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]
Singles = NDArray[np.float32]

AHEAD = 16
"""Rows by which what they hold is asked for ahead, where they are not taken in their order."""


@kernel
def far_share(indptr: Indices, indices: Indices) -> float:
    """Share of a sample of neighbours that are numbered far apart: by more than a sixteenth of all."""
    n = len(indptr) - 1
    far, entries = 0, 0
    for i in range(0, n, max(1, n // 2000)):
        for k in range(indptr[i], indptr[i + 1]):
            far += abs(indices[k] - i) > n // 16
            entries += 1
    return far / max(entries, 1)


def breadth_first(indptr: Indices, indices: Indices, root: int = 0) -> Indices:
    """The nodes by their distance from a root, other parts behind: neighbours together (Cuthill & McKee 1969)."""
    n = len(indptr) - 1
    order = np.empty(n + 1, dtype=np.int32)
    _walk(indptr, indices, root, order, np.zeros(n, dtype=np.uint8))
    return order[:n]


@kernel
def _walk(indptr: Indices, indices: Indices, root: int, order: Indices, seen: NDArray[np.uint8]) -> None:
    """Number the nodes as they are reached.  Shapes: `order` (n + 1,), `seen` (n,): comes as 0."""
    size = 0
    for other in range(-1, len(seen)):
        first = root if other < 0 else other
        if seen[first]:
            continue
        seen[first] = 1
        order[size] = first
        head = size
        size += 1
        while head < size:
            i = order[head]
            head += 1
            for k in range(indptr[i], indptr[i + 1]):
                j = indices[k]
                order[size] = j
                size += 1 - seen[j]
                seen[j] = 1


@kernel
@makes_arrays
def renumber(
    indptr: Indices, indices: Indices, conductance: Floats, leak: Floats, unit: float
) -> tuple[tuple[Indices, Indices, Singles, Floats], Indices]:
    """The same graph with its nodes numbered breadth first, written as they are reached, and their numbers (n,).

    Conductances come out in units.
    """
    n, entries = len(leak), len(indices)
    number, order = np.full(n, -1, np.int32), np.zeros(n + AHEAD, np.int32)
    new_indptr, new_indices = np.zeros(n + 1, np.int32), np.empty(entries, np.int32)
    new_conductance, new_leak = np.empty(entries, np.float32), np.empty(n)
    reached, root, size = 0, 0, 0
    for place in range(n):
        if place == reached:
            while number[root] >= 0:
                root += 1
            number[root], order[reached] = reached, root
            reached += 1
        i, ahead = order[place], indptr[order[place + AHEAD]]
        prefetch(indices, ahead)
        prefetch(conductance, ahead)
        new_leak[place] = leak[i]
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            order[reached] = j
            known = number[j] >= 0
            number[j] = number[j] if known else reached
            reached += not known
            new_indices[size] = number[j]
            new_conductance[size] = conductance[k] / unit
            size += 1
        new_indptr[place + 1] = size
    return (new_indptr, new_indices, new_conductance, new_leak), number


class Quotient(NamedTuple):
    """The quotient graph, and rows by their degree.

    `near` (entries,): from `start[i]` on what row ``i`` is joined to: elements, so many as `elements[i]`, then rows;
    `length[i]` in all; `weight` (n,): how many rows a row stands for; 0 for none, negative within the newest element;
    `into` (n,): the row that a row was merged into; ``-1 - k`` for the ``k``-th element; `first, last` (n,): where the
    members of an element begin and end in a list of all; `degree` (n,): of elements how many rows these stand for, of
    rows how many they would join; `outside, stamp` (n,): of elements what lies outside the newest one, and of which
    element that was told last; `head, after, before` (n,): rows by their degree, as linked lists; `bucket, chain, key`
    (n,): rows of the newest element by a hash of what they are joined to; `mark` (n,).
    """

    start: Indices
    near: Indices
    elements: Indices
    length: Indices
    weight: Indices
    into: Indices
    first: Indices
    last: Indices
    degree: Indices
    outside: Indices
    stamp: Indices
    head: Indices
    after: Indices
    before: Indices
    bucket: Indices
    chain: Indices
    key: Indices
    mark: Indices


def quotient_graph(indptr: Indices, indices: Indices) -> Quotient:
    """The quotient graph before elimination, of a graph of rows `indptr` (n + 1,)."""
    n = len(indptr) - 1
    none, zero = np.full((7, n), -1, dtype=np.int32), np.zeros((7, n), dtype=np.int32)
    elements, first, last, degree, outside, key, mark = zero
    into, stamp, head, after, before, bucket, chain = none
    return Quotient(
        indptr, indices.copy(), elements, np.diff(indptr), np.ones(n, dtype=np.int32), into, first, last, degree,
        outside, stamp, head, after, before, bucket, chain, key, mark,
    )  # fmt: skip


@kernel
@makes_arrays
def minimum_degree(q: Quotient, dense: int, most: float, most_members: int, step: Indices) -> bool:
    """Eliminate all rows, one of least degree after another; rows of more than ``dense`` neighbours come last.

    Shapes: `step` (n,): when every row is eliminated; rows that were merged have the same number.  Returns whether the
    factors have at most so many entries, and elements so many members.
    """
    n, least, size, k, tag = len(step), 0, 0, 0, 0
    left, entries = n, 0.0
    members = np.empty(6 * n, np.int32)
    for i in range(n):
        if q.length[i] > dense:
            q.weight[i], q.into[i] = 0, -1 - n
            left -= 1
        else:
            _link(q, i, q.length[i])
    while left > 0:
        while q.head[least] < 0:
            least += 1
        p = q.head[least]
        _unlink(q, p)
        if size + n > most_members:
            return False
        members = with_room(members, size, n)
        begin, end = size, _gather(q, members, p, size)
        left -= q.weight[p]
        total = _weigh(q, members, begin, end, k)
        end, gone = _prune(q, members, p, begin, end)
        left, total = left - gone, total - gone
        entries += (q.weight[p] + gone) * (total + 0.5 * (q.weight[p] + gone))
        if entries > most:
            return False
        tag = _merge_alike(q, members, begin, end, tag)
        size = begin
        for r in range(begin, end):
            i = members[r]
            if q.weight[i] < 0:
                q.weight[i] = -q.weight[i]
                d = min(q.degree[i] + total, left) - q.weight[i]
                _link(q, i, d)
                least = min(least, d)
                members[size] = i
                size += 1
        q.first[p], q.last[p], q.degree[p], q.weight[p], q.into[p] = begin, size, total, 0, -1 - k
        k += 1
    for i in range(n):
        j = i
        while q.into[j] >= 0:
            j = q.into[j]
        q.into[i] = q.into[j]
        step[i] = -1 - q.into[j]
    return True


@inlined
def _link(q: Quotient, i: int, degree: int) -> None:
    """Put a row in front of those of its degree."""
    other = q.head[degree]
    q.degree[i], q.after[i], q.before[i], q.head[degree] = degree, other, -1, i
    if other >= 0:
        q.before[other] = i


@inlined
def _unlink(q: Quotient, i: int) -> None:
    """Take a row from among those of its degree."""
    before, after = q.before[i], q.after[i]
    if after >= 0:
        q.before[after] = before
    if before >= 0:
        q.after[before] = after
    else:
        q.head[q.degree[i]] = after


@inlined
@makes_arrays
def with_room(numbers: Indices, size: int, more: int) -> Indices:
    """A list of so many numbers, with room for more behind them."""
    if size + more <= len(numbers):
        return numbers
    longer = np.empty(2 * len(numbers) + more, np.int32)
    for k in range(size):
        longer[k] = numbers[k]
    return longer


@inlined
def _gather(q: Quotient, members: Indices, p: int, size: int) -> int:
    """Make an element of a row: all that it is joined to, elements absorbed; returns where its members end."""
    begin, q.weight[p] = q.start[p], -q.weight[p]
    for s in range(begin, begin + q.length[p]):
        x = q.near[s]
        if s >= begin + q.elements[p]:
            if q.weight[x] > 0:
                q.weight[x], members[size] = -q.weight[x], x
                size += 1
                _unlink(q, x)
            continue
        for r in range(q.first[x], q.last[x]):
            i = members[r]
            if q.weight[i] > 0:
                q.weight[i], members[size] = -q.weight[i], i
                size += 1
                _unlink(q, i)
        q.last[x] = q.first[x]
    q.weight[p] = -q.weight[p]
    return size


@inlined
def _weigh(q: Quotient, members: Indices, begin: int, end: int, k: int) -> int:
    """How many rows a new element holds, and how many rows of others lie outside it; returns the former."""
    total = 0
    for r in range(begin, end):
        i = members[r]
        total -= q.weight[i]
        for s in range(q.start[i], q.start[i] + q.elements[i]):
            e = q.near[s]
            if q.stamp[e] != k:
                q.stamp[e], q.outside[e] = k, q.degree[e]
            q.outside[e] += q.weight[i]
    return total


@inlined
def _prune(q: Quotient, members: Indices, p: int, begin: int, end: int) -> tuple[int, int]:
    """Join the members of a new element to it, instead of to each other and to elements within it.

    Members that are joined to nothing else are eliminated along with it.  Returns where the others end, and how many
    rows were eliminated.
    """
    kept, gone, n = begin, 0, len(q.weight)
    for r in range(begin, end):
        i = members[r]
        first, at, degree, key = q.start[i], q.start[i], 0, 0
        inner, last = first + q.elements[i], first + q.length[i]
        for s in range(first, inner):
            e = q.near[s]
            if q.last[e] > q.first[e]:
                if q.outside[e] > 0:
                    q.near[at], degree, key = e, degree + q.outside[e], key + e
                    at += 1
                else:
                    q.last[e] = q.first[e]
        inner = at
        for s in range(first + q.elements[i], last):
            j = q.near[s]
            if q.weight[j] > 0 and j != p:
                q.near[at], degree, key = j, degree + q.weight[j], key + j
                at += 1
        if degree == 0:
            gone -= q.weight[i]
            q.weight[i], q.into[i] = 0, p
            continue
        q.near[at], q.near[inner], q.near[first] = q.near[inner], q.near[first], p
        q.elements[i], q.length[i] = inner + 1 - first, at + 1 - first
        q.degree[i] = min(q.degree[i], degree)
        key %= n
        q.key[i], q.chain[i], q.bucket[key] = key, q.bucket[key], i
        members[kept] = i
        kept += 1
    return kept, gone


@inlined
def _merge_alike(q: Quotient, members: Indices, begin: int, end: int, tag: int) -> int:
    """Merge members of an element that are joined to the same rows and elements; returns the last mark given."""
    for r in range(begin, end):
        a = q.bucket[q.key[members[r]]]
        q.bucket[q.key[members[r]]] = -1
        while a >= 0:
            if q.weight[a] != 0 and q.chain[a] >= 0:
                tag += 1
                for s in range(q.start[a], q.start[a] + q.length[a]):
                    q.mark[q.near[s]] = tag
                b = q.chain[a]
                while b >= 0:
                    if q.weight[b] != 0 and _alike(q, a, b, tag):
                        q.weight[a], q.weight[b], q.into[b] = q.weight[a] + q.weight[b], 0, a
                    b = q.chain[b]
            a = q.chain[a]
    return tag


@inlined
def _alike(q: Quotient, a: int, b: int, tag: int) -> bool:
    """Whether a row is joined to all that another one is, which is marked."""
    if q.length[a] != q.length[b] or q.elements[a] != q.elements[b]:
        return False
    s, end = q.start[b], q.start[b] + q.length[b]
    while s < end and q.mark[q.near[s]] == tag:
        s += 1
    return bool(s == end)
