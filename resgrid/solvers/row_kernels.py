"""Compiled loops that bring a netlist's conductances into compressed rows, and multiply by them."""

from __future__ import annotations

import math

import numpy as np

from resgrid.jit import inner, kernel, makes_arrays
from resgrid.solvers.extended import Floats, Indices


@kernel
@makes_arrays
def conductances_by_row(
    pairs: Indices, conductance: Floats, row: Indices, indptr: Indices, indices: Indices, data: Floats
) -> None:
    """Symmetric compressed rows of the conductances between rows, sorted, parallel resistors summed, and no diagonal.

    Rows are filled with lower neighbours from the front and with upper ones from behind: where a grid's resistors come
    axis by axis, they are sorted then.

    Shapes: `indptr` (n + 1,), comes as 0; `indices, data` (2 m,): room for all entries.
    """
    size = len(indptr) - 1
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0 and j >= 0 and i != j:
            indptr[i + 1] += 1
            indptr[j + 1] += 1
    for i in range(size):
        indptr[i + 1] += indptr[i]
    front, back = indptr[:-1].copy(), indptr[1:].copy()
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0 and j >= 0 and i != j:
            lower, upper = min(i, j), max(i, j)
            back[lower] -= 1
            indices[back[lower]], data[back[lower]] = upper, conductance[k]
            indices[front[upper]], data[front[upper]] = lower, conductance[k]
            front[upper] += 1
    descents = 0
    for i in range(size):
        for k in range(indptr[i] + 1, indptr[i + 1]):
            descents += indices[k] <= indices[k - 1]
    if descents > 0:
        _sort_and_sum(indptr, indices, data)


@inner
@makes_arrays
def _sort_and_sum(indptr: Indices, indices: Indices, data: Floats) -> None:
    """Sort symmetric rows, by writing them as columns, row by row, and sum what stands twice."""
    size, end, fill, columns, values = (
        len(indptr) - 1,
        0,
        indptr[:-1].copy(),
        np.empty_like(indices),
        np.empty_like(data),
    )
    for i in range(size):
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            columns[fill[j]], values[fill[j]] = i, data[k]
            fill[j] += 1
    for i in range(size):
        begin, indptr[i] = indptr[i], end
        for k in range(begin, indptr[i + 1]):
            if k > begin and columns[k] == indices[end - 1]:
                data[end - 1] += values[k]
            else:
                indices[end], data[end] = columns[k], values[k]
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


@kernel
def row_residual(
    matrix: tuple[Indices, Indices, Floats, Floats], slot: Indices, b: Floats, x: Floats, r: Floats
) -> float:
    """``r = b - A x``, differences first, every row put at its slot; ``b, x`` (n,) by rows; returns ``|r|``."""
    indptr, indices, conductance, ground = matrix
    total = 0.0
    for i in range(len(slot)):
        v = b[i] - ground[i] * x[i]
        for k in range(indptr[i], indptr[i + 1]):
            v += conductance[k] * (x[np.uint32(indices[k])] - x[i])
        r[slot[i]] = v
        total += v * v
    return math.sqrt(total)
