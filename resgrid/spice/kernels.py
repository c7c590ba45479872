"""Compiled loops over the elements of a deck."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def left_over(ends: NDArray[np.int64], volts: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Voltage by which each source contradicts those before it: a union-find whose links carry voltages.

    Parameters
    ----------
    ends : ndarray of int64, shape (s, 2)
        Plus and minus node of every source.
    volts : ndarray of float64, shape (s,)
    count : int
        Number of nodes.

    Returns
    -------
    ndarray of float64, shape (s,)
        In volts; NaN for sources that close no loop.
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
