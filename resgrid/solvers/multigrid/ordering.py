"""Compiled loops that lay out the rows of one level: their order, and where in a row the later ones begin."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inner

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Indices = NDArray[np.int32]
Unsigned = NDArray[np.uint32]

_LONG = 31
"""Longer rows count as one length."""

_COLOURS = 64
_ONE = np.uint64(1)


@njit(cache=True)
def inverse_of(order: Indices) -> Indices:
    """Where every element of a permutation stands."""
    rank = np.empty(len(order), np.int32)
    for place in range(len(order)):
        rank[order[place]] = place
    return rank


@njit(cache=True)
def order_by_colour(indptr: Indices, indices: Indices, window: int) -> Indices:
    """The nodes by colour; in windows of each colour by the length of their rows, then by how many come before.

    Colours are given greedily in the order of the nodes: each takes the first that its neighbours do not have.  From
    the 64th on neighbours may share one.
    """
    n = len(indptr) - 1
    colour, of_colour = _colours(indptr, indices)
    key, start = np.empty(n, np.int32), np.zeros((_LONG + 1) ** 2 + 1, np.int32)
    for i in range(n):
        earlier = 0
        for k in range(indptr[i], indptr[i + 1]):
            earlier += colour[indices[k]] < colour[i]
        key[i] = min(indptr[i + 1] - indptr[i], _LONG) * (_LONG + 1) + min(earlier, _LONG)
        start[key[i] + 1] += 1
    by_length = _sorted(np.arange(n).astype(np.int32), key, start)
    base = np.zeros(_COLOURS + 1, np.int64)
    for c in range(_COLOURS):
        base[c + 1] = base[c] + (of_colour[c] + window - 1) // window
    start, met = np.zeros(base[_COLOURS] + 1, np.int32), np.zeros(_COLOURS, np.int64)
    for i in range(n):
        key[i] = base[colour[i]] + met[colour[i]] // window
        met[colour[i]] += 1
        start[key[i] + 1] += 1
    return _sorted(by_length, key, start)


@njit(cache=True)
def _colours(indptr: Indices, indices: Indices) -> tuple[Indices, NDArray[np.int64]]:
    """Greedy colours, and how many nodes have each."""
    n = len(indptr) - 1
    bit = np.zeros(n, np.uint64)
    colour, count = np.empty(n, np.int32), np.zeros(_COLOURS, np.int64)
    for i in range(n):
        taken = np.uint64(0)
        for k in range(indptr[i], indptr[i + 1]):
            taken |= bit[indices[k]]
        bit[i] = ~taken & (taken + _ONE)
        c, rest = 0, bit[i] >> _ONE
        while rest:
            rest >>= _ONE
            c += 1
        colour[i] = c
        count[c] += 1
    return colour, count


@inner
def _sorted(nodes: Indices, key: Indices, start: Indices) -> Indices:
    """Nodes by key, those of one key in their order; ``start[k + 1]`` says how many there are of key ``k``."""
    for k in range(len(start) - 1):
        start[k + 1] += start[k]
    out = np.empty(len(nodes), np.int32)
    for place in range(len(nodes)):
        i = nodes[place]
        out[start[key[i]]] = i
        start[key[i]] += 1
    return out


@njit(cache=True)
def lay_rows(
    indptr: Indices, indices: Indices, conductance: Floats, leak: Floats, order: Indices, rank: Indices, first: int,
    entry: int, out_indptr: Unsigned, middle: Unsigned, out_indices: Unsigned, out_conductance: Singles,
    inverse: Singles, diagonal: Singles,
) -> None:  # fmt: skip
    """Write the rows of a level behind those before it: earlier neighbours first, the others from ``middle`` on."""
    begin = entry
    for place in range(len(order)):
        i = order[place]
        end = begin + indptr[i + 1] - indptr[i]
        out_indptr[first + place] = begin
        front, back, degree = begin, end - 1, leak[i]
        for k in range(indptr[i], indptr[i + 1]):
            neighbour = rank[indices[k]]
            degree += conductance[k]
            earlier = neighbour < place
            at = front if earlier else back
            front += earlier
            back -= not earlier
            out_indices[at] = first + neighbour
            out_conductance[at] = conductance[k]
        middle[first + place] = front
        diagonal[first + place] = degree
        inverse[first + place] = 1.0 / degree if degree > 0.0 else 0.0
        begin = end
    out_indptr[first + len(order)] = begin


@njit(cache=True)
def lay_aggregates(target: Indices, order: Indices, rank: Indices, first: int, aggregate: Unsigned) -> None:
    """Where the aggregates of a level's rows stand; 0 for eliminated ones."""
    for place in range(len(order)):
        to = target[order[place]]
        aggregate[place] = first + rank[to] if to >= 0 else 0


@njit(cache=True)
def red_end(indptr: Indices, indices: Indices) -> int:
    """Behind the last of the first nodes, where these and the others have no neighbours among themselves; else -1."""
    n = len(indptr) - 1
    red = n
    for i in range(n):
        for k in range(indptr[i], indptr[i + 1]):
            if indices[k] > i:
                red = min(red, indices[k])
    for i in range(n):
        for k in range(indptr[i], indptr[i + 1]):
            if (i < red) == (indices[k] < red):
                return -1
    return red


@njit(cache=True)
def inverse_matrix(indptr: Indices, indices: Indices, conductance: Floats, leak: Floats) -> Singles:
    """Inverse of a level's matrix, its diagonal a little larger so that it has one; pivots in order, for M-matrices."""
    n = len(leak)
    a = np.zeros((n, n))
    for i in range(n):
        degree = leak[i]
        for k in range(indptr[i], indptr[i + 1]):
            degree += conductance[k]
            a[i, indices[k]] -= conductance[k]
        a[i, i] += degree * (1.0 + 1e-7)
    for p in range(n):
        pivot = 1.0 / a[p, p] if a[p, p] > 0.0 else 0.0
        a[p, p] = 1.0
        for j in range(n):
            a[p, j] *= pivot
        for i in range(n):
            factor = a[i, p]
            if i == p or factor == 0.0:
                continue
            a[i, p] = 0.0
            for j in range(n):
                a[i, j] -= factor * a[p, j]
    return a.astype(np.float32)
