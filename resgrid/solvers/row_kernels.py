"""Compiled loops that bring a netlist's conductances into compressed rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import inner, kernel, makes_arrays

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]


@kernel
def conductances_by_row(
    pairs: Indices, conductance: Floats, row: Indices, indptr: Indices, indices: Indices, data: Floats, place: Indices
) -> bool:
    """Symmetric compressed rows of the conductances between rows, parallel resistors summed, and no diagonal.

    Rows are filled with lower neighbours from the front and with upper ones from behind: where a grid's resistors come
    axis by axis, they are sorted then.  Returns whether they are.

    Shapes: `indptr` (n + 1,), comes as 0; `indices, data` (2 m,): room for all entries; `place` (2, n).
    """
    size, front, back = len(indptr) - 1, place[0], place[1]
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0 and j >= 0 and i != j:
            indptr[i + 1] += 1
            indptr[j + 1] += 1
    for i in range(size):
        front[i] = indptr[i]
        indptr[i + 1] += indptr[i]
        back[i] = indptr[i + 1]
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0 and j >= 0 and i != j:
            lower, upper = (i, j) if i < j else (j, i)
            back[lower] -= 1
            indices[back[lower]], data[back[lower]] = upper, conductance[k]
            indices[front[upper]], data[front[upper]] = lower, conductance[k]
            front[upper] += 1
    if _ascending(indptr, indices):
        return True
    _unite(indptr, indices, data, front)
    return False


@inner
def _ascending(indptr: Indices, indices: Indices) -> bool:
    """Whether every row is sorted, and no column there twice."""
    ascending = True
    for i in range(len(indptr) - 1):
        for k in range(indptr[i] + 1, indptr[i + 1]):
            ascending &= indices[k - 1] < indices[k]
    return ascending


@inner
def _unite(indptr: Indices, indices: Indices, data: Floats, place: Indices) -> None:
    """Sum entries of one column and close the gaps, in place; ``place`` (n,) is room."""
    for i in range(len(place)):
        place[i] = -1
    size, end = 0, indptr[0]
    for i in range(len(indptr) - 1):
        begin, end = end, indptr[i + 1]
        indptr[i] = size
        for k in range(begin, end):
            column = indices[k]
            if place[column] >= indptr[i]:
                data[place[column]] += data[k]
            else:
                place[column], indices[size], data[size] = size, column, data[k]
                size += 1
    indptr[len(indptr) - 1] = size


@kernel
def transpose(
    indptr: Indices, indices: Indices, data: Floats, place: Indices, columns: Indices, values: Floats
) -> None:
    """Transpose a structurally symmetric matrix: the same one, if it is symmetric, with every row sorted by column.

    Shapes: `indices, data, columns, values` (entries,); `place` (n,): where every row begins; is moved on.
    """
    for i in range(len(place)):
        for k in range(indptr[i], indptr[i + 1]):
            at = place[indices[k]]
            columns[at], values[at] = i, data[k]
            place[indices[k]] = at + 1


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
def count_edges(pairs: Indices, conductance: Floats, row: Indices) -> tuple[int, float, float, float]:
    """How many conductances there are between rows, their smallest, their largest and their sum."""
    count, smallest, largest, total = 0, np.inf, 0.0, 0.0
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0 and j >= 0 and i != j:
            count += 1
            g = conductance[k]
            smallest, largest, total = min(smallest, g), max(largest, g), total + g
    return count, smallest, largest, total


@kernel
def weak_pairs(pairs: Indices, conductance: Floats, row: Indices, strongest: Floats, weak: float) -> int:
    """Count the conductances below ``weak`` times the strongest one at either of their rows.

    Shapes: `strongest` (n,): room, comes as 0.
    """
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0 and j >= 0 and i != j:
            strongest[i], strongest[j] = max(strongest[i], conductance[k]), max(strongest[j], conductance[k])
    count = 0
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0 and j >= 0 and i != j and conductance[k] < weak * max(strongest[i], strongest[j]):
            count += 1
    return count


@kernel
@makes_arrays
def weak_entries(indptr: Indices, indices: Indices, data: Floats, weak: float) -> int:
    """The same for compressed rows, where every conductance stands twice."""
    strongest, count = np.zeros(len(indptr) - 1), 0
    for i in range(len(strongest)):
        for k in range(indptr[i], indptr[i + 1]):
            strongest[i] = max(strongest[i], data[k])
    for i in range(len(strongest)):
        for k in range(indptr[i], indptr[i + 1]):
            count += data[k] < weak * max(strongest[i], strongest[indices[k]])
    return count
