"""Compiled loops of an update: single entries of compressed rows, and searches that stay near where they begin."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]
Integers = NDArray[np.int64]


@njit(cache=True)
def find_entries(indptr: Indices, indices: Indices, rows: Integers, columns: Integers) -> Integers:
    """Where the entries of rows and columns are stored; -1 for none."""
    found = np.full(len(rows), -1)
    for k in range(len(rows)):
        for entry in range(indptr[rows[k]], indptr[rows[k] + 1]):
            if indices[entry] == columns[k]:
                found[k] = entry
    return found


@njit(cache=True)
def first_neighbours(indptr: Indices, indices: Indices, data: Floats, rows: Integers) -> Integers:
    """The first neighbour that every row still has; -1 for none."""
    found = np.full(len(rows), -1)
    for k in range(len(rows)):
        for entry in range(indptr[rows[k]], indptr[rows[k] + 1]):
            if found[k] < 0 and data[entry] > 0.0:
                found[k] = indices[entry]
    return found


@njit(cache=True)
def sum_rows(indptr: Indices, data: Floats, rows: Integers, unit: float) -> tuple[Floats, Floats]:
    """Sums of rows, in doubles and as the board stores them: rounded to single precision, in units."""
    total, stored = np.zeros(len(rows)), np.zeros(len(rows))
    for k in range(len(rows)):
        for entry in range(indptr[rows[k]], indptr[rows[k] + 1]):
            total[k] += data[entry]
            stored[k] += np.float64(np.float32(data[entry] / unit))
    return total, stored


@njit(cache=True)
def _root(parent: Integers, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True)
def stay_together(
    indptr: Indices, indices: Indices, data: Floats, seeds: Integers, low: Floats, high: Floats, needed: Integers,
    most: int, label: Indices,
) -> bool:  # fmt: skip
    """Whether rows are found to be connected to each other, and to the rails they need, within ``most`` steps.

    ``needed`` holds the smallest number of contacts with the low and the high rail that must be found; ``label`` is
    zero for all rows.
    """
    queue = np.empty(most + len(seeds), np.int64)
    parent = np.arange(len(seeds))
    end, apart = 0, len(seeds)
    contacts = np.zeros(2, np.int64)
    for k in range(len(seeds)):
        queue[end] = seeds[k]
        label[seeds[k]] = k + 1
        end += 1
    begin = 0
    while begin < end:
        row = queue[begin]
        begin += 1
        contacts[0] += low[row] > 0
        contacts[1] += high[row] > 0
        for entry in range(indptr[row], indptr[row + 1]):
            there = indices[entry]
            if data[entry] == 0.0:
                continue
            if label[there] > 0:
                a, b = _root(parent, label[row] - 1), _root(parent, label[there] - 1)
                if a != b:
                    parent[max(a, b)] = min(a, b)
                    apart -= 1
            elif end < len(queue):
                label[there] = label[row]
                queue[end] = there
                end += 1
        if apart <= 1 and contacts[0] >= needed[0] and contacts[1] >= needed[1]:
            return True
    return False


@njit(cache=True)
def gather(indptr: Indices, indices: Indices, data: Floats, seeds: Integers, most: int, number: Indices) -> Integers:
    """At most ``most`` rows nearest to the seeds, in ascending order; ``number`` comes zero and counts them from 1."""
    queue = np.empty(most, np.int64)
    end, begin = 0, 0
    for k in range(len(seeds)):
        if number[seeds[k]] == 0 and end < most:
            number[seeds[k]] = 1
            queue[end] = seeds[k]
            end += 1
    while begin < end < most:
        row = queue[begin]
        begin += 1
        for entry in range(indptr[row], indptr[row + 1]):
            there = indices[entry]
            if data[entry] > 0.0 and number[there] == 0 and end < most:
                number[there] = 1
                queue[end] = there
                end += 1
    rows = np.sort(queue[:end])
    for k in range(end):
        number[rows[k]] = k + 1
    return rows


@njit(cache=True)
def cut_out(
    indptr: Indices, indices: Indices, data: Floats, excess: Floats, rows: Integers, number: Indices, b: Floats,
    x: Floats,
) -> tuple[Indices, Indices, Floats, Floats, Floats]:  # fmt: skip
    """Compressed rows among some rows, their conductance to all other rows, and the residual ``b - A x`` at them."""
    count = len(rows)
    starts = np.zeros(count + 1, np.int32)
    columns = np.empty(count * 8, np.int32)
    inner = np.empty(count * 8)
    outward, residual = np.zeros(count), np.empty(count)
    size = 0
    for k in range(count):
        row = rows[k]
        left = b[row] - excess[row] * x[row]
        for entry in range(indptr[row], indptr[row + 1]):
            there = indices[entry]
            left += data[entry] * (x[there] - x[row])
            if number[there] == 0:
                outward[k] += data[entry]
            elif data[entry] > 0.0:
                columns[size], inner[size] = number[there] - 1, data[entry]
                size += 1
        residual[k] = left
        starts[k + 1] = size
    return starts, columns[:size], inner[:size], outward, residual
