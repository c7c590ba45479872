"""Compiled loops over the elements of a deck."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def left_over(ends: NDArray[np.int64], volts: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Voltage by which each source contradicts those before it: a union-find whose links carry voltages.

    Shapes: `ends` (s, 2), `volts` (s,); returns (s,).
    """
    parent = np.arange(count)
    above = np.zeros(count)
    size = np.ones(count, dtype=np.int64)
    rest = np.full(len(volts), np.nan)
    root = np.zeros(2, dtype=np.int64)
    height = np.zeros(2)
    for source in range(len(volts)):
        for side in range(2):
            node, total = ends[source, side], 0.0
            while parent[node] != node:
                total += above[node]
                node = parent[node]
            root[side], height[side] = node, total
            node = ends[source, side]
            while parent[node] != root[side] and node != root[side]:
                up, step = parent[node], above[node]
                parent[node], above[node] = root[side], total
                total -= step
                node = up
        if root[0] == root[1]:
            rest[source] = height[0] - height[1] - volts[source]
            continue
        step = volts[source] + height[1] - height[0]  # of the plus root over the minus root
        if size[root[0]] <= size[root[1]]:
            parent[root[0]], above[root[0]] = root[1], step
            size[root[1]] += size[root[0]]
        else:
            parent[root[1]], above[root[1]] = root[0], -step
            size[root[0]] += size[root[1]]
    return rest


@njit(cache=True)
def strip_leaves(indptr: NDArray[np.int32], indices: NDArray[np.int32], degree: NDArray[np.int64]) -> None:
    """Take away nodes with one neighbour, again and again; ``degree`` ends as that of the rest, 0 for those taken."""
    queue = np.flatnonzero(degree == 1)
    stack = np.empty(len(degree), dtype=np.int64)
    top = len(queue)
    stack[:top] = queue
    while top:
        top -= 1
        node = stack[top]
        if degree[node] != 1:
            continue
        degree[node] = 0
        for k in range(indptr[node], indptr[node + 1]):
            other = indices[k]
            if degree[other] > 0:
                degree[other] -= 1
                if degree[other] == 1:
                    stack[top] = other
                    top += 1
