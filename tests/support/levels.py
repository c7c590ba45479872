"""Levels of multigrid as dense matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.multigrid.boards import Level, to_graph


def matrix_of(level: Level) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The dense nodal matrix of a level over its nodes, red ones first, and their places."""
    graph, number = to_graph(level)
    matrix = np.zeros((graph.size, graph.size))
    row = np.repeat(np.arange(graph.size), np.diff(graph.indptr))
    matrix[row, graph.indices] = -graph.conductance
    matrix += np.diag(graph.leak - matrix.sum(axis=1))
    return matrix, np.flatnonzero(number >= 0)
