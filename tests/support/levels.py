"""Multigrid levels as dense matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.multigrid.grid_level import Level, to_graph
from resgrid.solvers.multigrid.hierarchy import GridProblem, Hierarchy


def matrix_of(level: Level) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the dense nodal matrix of a level, red nodes first, and the slots of its nodes."""
    graph, number = to_graph(level)
    matrix = np.zeros((graph.size, graph.size))
    row = np.repeat(np.arange(graph.size), np.diff(graph.indptr))
    matrix[row, graph.indices] = -graph.conductance
    matrix += np.diag(graph.leak - matrix.sum(axis=1))
    return matrix, np.flatnonzero(number >= 0)


def cells_of(level: Level) -> NDArray[np.int64]:
    """Return the cell indices of a level's nodes in the order of its graph, shape (nodes, ndim)."""
    lattice = level.lattice
    used = np.flatnonzero(level.degree.ravel())
    parts = []
    for colour in range(2):
        slot = used[(used >= lattice.slots) == (colour == 1)] - colour * lattice.slots
        on_grid = slot[slot < lattice.first_extra]
        extra = np.unravel_index(level.extra_cell[colour], lattice.shape)
        cells = zip(lattice.cells_at(colour, on_grid), extra, strict=True)
        parts.append(np.stack([np.concatenate(pair) for pair in cells], axis=1))
    return np.concatenate(parts)


def preconditioned(hierarchy: Hierarchy, r: NDArray[np.float32]) -> NDArray[np.float64]:
    """Apply a linear cycle (without the Krylov steps of the K-cycle) to a residual of the finest level."""
    assert hierarchy.grid is not None
    problem, z = GridProblem(hierarchy.grid, hierarchy.levels, *np.zeros((2, 2, len(r)))), np.empty_like(r)
    problem.vectors.r[:], problem.vectors.before[:] = r, hierarchy.grid.stencil.black_inverse * r
    problem.precondition(z, np.inf)
    return z.astype(np.float64)
