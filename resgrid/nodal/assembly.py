"""Compiled loops over a netlist's resistors: connected parts, conductances by rows, plain currents."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]
Integers = NDArray[np.int64]


@njit(cache=True)
def find(parent: Indices, node: int) -> int:
    """Root of a node in a union-find, whose trees have their smallest node as root; halves the way there."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@njit(cache=True)
def join(parent: Indices, a: int, b: int) -> None:
    """Make one tree of the trees of two nodes."""
    a, b = find(parent, a), find(parent, b)
    if a != b:
        parent[max(a, b)] = min(a, b)


@njit(cache=True)
def connected_parts(pairs: Integers, ties: Integers, held: NDArray[np.bool_]) -> tuple[int, Indices]:
    """Number the parts that resistors and floating sources join; nodes that are held join nothing."""
    count = len(held)
    parent = np.arange(count).astype(np.int32)
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        if not held[a] and not held[b]:
            join(parent, a, b)
    for k in range(len(ties)):
        join(parent, ties[k, 0], ties[k, 1])
    part = np.empty(count, np.int32)
    number = 0
    for node in range(count):
        root = find(parent, node)
        if root == node:
            part[node] = number
            number += 1
        else:
            part[node] = part[root]
    return number, part


@njit(cache=True)
def known_range(pairs: Integers, known: Floats, part: Indices, lowest: Floats, highest: Floats) -> None:
    """Widen every part's range of known voltages that its resistors reach, in place."""
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        if np.isnan(known[a]) == np.isnan(known[b]):
            continue
        if np.isnan(known[b]):
            a, b = b, a
        lowest[part[a]] = min(lowest[part[a]], known[b])
        highest[part[a]] = max(highest[part[a]], known[b])


@njit(cache=True)
def mark_fed(pairs: Integers, amps: Floats, known: Floats, part: Indices, fed: NDArray[np.bool_]) -> None:
    """Mark the parts that current sources feed, in place."""
    for k in range(len(pairs)):
        if amps[k] == 0.0:
            continue
        for end in range(2):
            if np.isnan(known[pairs[k, end]]):
                fed[part[pairs[k, end]]] = True


@njit(cache=True)
def add_injected(pairs: Integers, amps: Floats, row: Integers, injected: Floats) -> None:
    """Add the currents of current sources to the rows they lead to, and take them from those they come from."""
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0:
            injected[i] -= amps[k]
        if j >= 0:
            injected[j] += amps[k]


@njit(cache=True)
def contacts(pairs: Integers, row: Integers) -> tuple[Integers, Integers, Integers]:
    """Resistors with just one end on a row: their numbers, that end, and the other."""
    count = 0
    for k in range(len(pairs)):
        if (row[pairs[k, 0]] >= 0) != (row[pairs[k, 1]] >= 0):
            count += 1
    number, inner, outer = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    at = 0
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        if (row[a] >= 0) == (row[b] >= 0):
            continue
        number[at] = k
        inner[at], outer[at] = (a, b) if row[a] >= 0 else (b, a)
        at += 1
    return number, inner, outer


@njit(cache=True)
def add_conductances(pairs: Integers, conductance: Floats, row: Integers, degree: Floats) -> None:
    """Add the conductances between different rows to both rows' degree."""
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0 and j >= 0 and i != j:
            degree[i] += conductance[k]
            degree[j] += conductance[k]


@njit(cache=True)
def conductances_by_row(
    pairs: Integers, conductance: Floats, row: Integers, size: int
) -> tuple[Indices, Indices, Floats]:
    """Symmetric compressed rows of the conductances between rows: sorted, parallel resistors summed, no diagonal."""
    indptr = np.zeros(size + 1, np.int32)
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0 and j >= 0 and i != j:
            indptr[i + 1] += 1
            indptr[j + 1] += 1
    for i in range(size):
        indptr[i + 1] += indptr[i]
    indices = np.empty(indptr[size], np.int32)
    data = np.empty(indptr[size])
    fill = indptr[:-1].copy()
    for k in range(len(pairs)):
        i, j = row[pairs[k, 0]], row[pairs[k, 1]]
        if i >= 0 and j >= 0 and i != j:
            indices[fill[i]], data[fill[i]] = j, conductance[k]
            indices[fill[j]], data[fill[j]] = i, conductance[k]
            fill[i] += 1
            fill[j] += 1
    return _closed_up(indptr, fill, indices, data)


@njit(cache=True)
def _closed_up(indptr: Indices, fill: Indices, indices: Indices, data: Floats) -> tuple[Indices, Indices, Floats]:
    """Sort every row, sum entries of one column, and close the gaps, in place."""
    size = 0
    for i in range(len(fill)):
        begin, end = indptr[i], fill[i]
        sort_row(indices, data, begin, end)
        indptr[i] = size
        for k in range(begin, end):
            if size > indptr[i] and indices[size - 1] == indices[k]:
                data[size - 1] += data[k]
            else:
                indices[size] = indices[k]
                data[size] = data[k]
                size += 1
    indptr[len(fill)] = size
    return indptr, indices[:size], data[:size]


@njit(cache=True)
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


@njit(cache=True)
def plain_currents(
    pairs: Integers, conductance: Floats, height: Floats, amps: Floats, outflow: Floats, through: Floats
) -> float:
    """Currents into ``amps``, added to the nodes' outflow and through-current; returns the power.

    Nothing flows from or to a node whose height is NaN.
    """
    power = 0.0
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        drop = height[a] - height[b]
        if math.isnan(drop):
            drop = 0.0
        flow = conductance[k] * drop
        amps[k] = flow
        outflow[a] += flow
        outflow[b] -= flow
        through[a] += abs(flow)
        through[b] += abs(flow)
        power += flow * drop
    return power


@njit(cache=True)
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
