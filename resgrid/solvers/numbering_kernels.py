"""Compiled loops that number the nodes of a graph anew, so that neighbours lie together in memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import kernel

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]


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
def renumber(
    indptr: Indices, indices: Indices, conductance: Floats, leak: Floats, order: Indices
) -> tuple[Indices, Indices, Floats, Floats]:
    """The same graph with its nodes in another order."""
    n = len(order)
    rank = np.empty(n, np.int32)
    for place in range(n):
        rank[order[place]] = place
    new_indptr, new_leak = np.zeros(n + 1, np.int32), np.empty(n)
    new_indices, new_conductance = np.empty_like(indices), np.empty_like(conductance)
    size = 0
    for place in range(n):
        i = order[place]
        new_leak[place] = leak[i]
        for k in range(indptr[i], indptr[i + 1]):
            new_indices[size] = rank[indices[k]]
            new_conductance[size] = conductance[k]
            size += 1
        new_indptr[place + 1] = size
    return new_indptr, new_indices, new_conductance, new_leak
