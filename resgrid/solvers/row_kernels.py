"""Compiled loops that bring a netlist's conductances into compressed rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import inner, kernel

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]

_FEW, _MANY = 5, 16
"""Entries of a row between which comparing all with all sorts them quickest."""


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
def sort_rows(indptr: Indices, indices: Indices, data: Floats) -> None:
    """Sort every row by column, in place."""
    column, value = np.empty(_MANY, np.int32), np.empty(_MANY)
    for i in range(len(indptr) - 1):
        begin, end = indptr[i], indptr[i + 1]
        if _FEW < end - begin <= _MANY:
            _sort_by_rank(indices, data, begin, end, column, value)
        else:
            sort_row(indices, data, begin, end)


@inner
def _sort_by_rank(indices: Indices, data: Floats, begin: int, end: int, column: Indices, value: Floats) -> None:
    """As `sort_row`, every entry put where its rank says: no branch depends on the columns."""
    for k in range(begin, end):
        rank = 0
        for other in range(begin, end):
            rank += (indices[other] < indices[k]) | ((indices[other] == indices[k]) & (other < k))
        column[rank] = indices[k]
        value[rank] = data[k]
    for k in range(begin, end):
        indices[k] = column[k - begin]
        data[k] = value[k - begin]


@inner
def sort_row(indices: Indices, data: Floats, begin: int, end: int) -> None:
    """Sort the entries ``begin ... end`` by column, in place (Shell 1959: insertion in ever smaller steps)."""
    step = 1
    while 3 * step + 1 < end - begin:
        step = 3 * step + 1
    while step > 0:
        for k in range(begin + step, end):
            column, value = indices[k], data[k]
            place = k - step
            while place >= begin and indices[place] > column:
                indices[place + step] = indices[place]
                data[place + step] = data[place]
                place -= step
            indices[place + step] = column
            data[place + step] = value
        step //= 3


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
def weak_pairs(pairs: Indices, conductance: Floats, row: Indices, size: int, weak: float) -> int:
    """Count the conductances below ``weak`` times the strongest one at either of their rows."""
    strongest = np.zeros(size)
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
def weak_share(indptr: Indices, indices: Indices, conductance: Floats, weak: float) -> float:
    """Share of conductances below ``weak`` times the strongest one at either of their ends."""
    n = len(indptr) - 1
    strongest = np.zeros(n)
    for i in range(n):
        for k in range(indptr[i], indptr[i + 1]):
            strongest[i] = max(strongest[i], conductance[k])
    count = 0
    for i in range(n):
        for k in range(indptr[i], indptr[i + 1]):
            if conductance[k] < weak * max(strongest[i], strongest[indices[k]]):
                count += 1
    return count / max(len(indices), 1)
