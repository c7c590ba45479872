"""Compiled loops that bring a netlist's conductances into compressed rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import inner, kernel, makes_arrays

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]


@kernel
@makes_arrays
def conductances_by_row(
    pairs: Indices, conductance: Floats, row: Indices, indptr: Indices, indices: Indices, data: Floats
) -> None:
    """Symmetric compressed rows of the conductances between rows, sorted, parallel resistors summed, and no diagonal.

    Shapes: `indptr` (n + 1,), comes as 0; `indices, data` (2 m,): room for all entries.
    """
    size, end = len(indptr) - 1, 0
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0 and j >= 0 and i != j:
            indptr[i + 1] += 1
            indptr[j + 1] += 1
    for i in range(size):
        indptr[i + 1] += indptr[i]
    place, columns, values = indptr[:-1].copy(), np.empty_like(indices), np.empty_like(data)
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0 and j >= 0 and i != j:
            columns[place[i]], values[place[i]] = j, conductance[k]
            columns[place[j]], values[place[j]] = i, conductance[k]
            place[i] += 1
            place[j] += 1
    place[:] = indptr[:-1]
    for i in range(size):  # transposed, so that the entries of every row come in order
        for k in range(indptr[i], indptr[i + 1]):
            j, at = columns[k], place[columns[k]]
            if at > indptr[j] and indices[at - 1] == i:
                data[at - 1] += values[k]
            else:
                indices[at], data[at], place[j] = i, values[k], at + 1
    for i in range(size):  # and the gaps that parallel resistors leave are closed
        begin, indptr[i] = indptr[i], end
        for k in range(begin, place[i]):
            indices[end], data[end] = indices[k], data[k]
            end += 1
    indptr[size] = end


@inner
def find(parent: Indices, node: int) -> int:
    """Root of a node in a union-find, whose trees have their smallest node as root; halves the way there."""
    above = parent[node]
    while above != node:
        top = parent[above]
        if top != above:
            parent[node] = top
        node, above = top, parent[top]
    return node


@inner
def join(parent: Indices, a: int, b: int) -> None:
    """Make one tree of the trees of two nodes."""
    a, b = find(parent, a), find(parent, b)
    if a != b:
        parent[max(a, b)] = min(a, b)


@kernel
def add_conductances(pairs: Indices, conductance: Floats, row: Indices, degree: Floats) -> None:
    """Add the conductances between different rows to both rows' degree."""
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0 and j >= 0 and i != j:
            degree[i] += conductance[k]
            degree[j] += conductance[k]


@kernel
def compare_edges(
    pairs: Indices, conductance: Floats, row: Indices, strongest: Floats, weak: float
) -> tuple[int, float, float, float, int]:
    """How many conductances there are between rows, their smallest, their largest, their sum, and how many are weak.

    Weak ones are below ``weak`` times the strongest one at either of their rows.

    Shapes: `strongest` (n,): room, comes as 0.
    """
    count, smallest, largest, total, feeble = 0, np.inf, 0.0, 0.0, 0
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0 and j >= 0 and i != j:
            count += 1
            g = conductance[k]
            smallest, largest, total = min(smallest, g), max(largest, g), total + g
            strongest[i], strongest[j] = max(strongest[i], g), max(strongest[j], g)
    if smallest < weak * largest:
        for k in range(len(pairs)):
            i, j = row[pairs[k, 0]], row[pairs[k, 1]]
            if i >= 0 and j >= 0 and i != j and conductance[k] < weak * max(strongest[i], strongest[j]):
                feeble += 1
    return count, smallest, largest, total, feeble
