"""The levels of a changed circuit: the first one patched, the coarse ones kept as they are, to precondition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.multigrid.checkerboard_kernels import Board
from resgrid.nodal.multigrid.hierarchy import Hierarchy
from resgrid.nodal.system import NodalSystem
from resgrid.nodal.update.change import Change


def patch_levels(hierarchy: Hierarchy, board: Board, system: NodalSystem, change: Change) -> Hierarchy:
    """Take the resistors between separated rows off the board, and renew the diagonals of both.

    Parameters
    ----------
    hierarchy : Hierarchy
        Of the circuit before, with a board.
    board : Board
    system : NodalSystem
        After the change.
    change : Change

    Returns
    -------
    Hierarchy
    """
    place = hierarchy.place
    faces, wrap_conductance = board.faces.copy(), board.wrap_conductance.copy()
    red, black = _by_colour(place, change.pairs)
    face = _faces(board, red, black)
    on_board = face >= 0
    faces[face[on_board], red[on_board]] = 0.0
    for here, there in zip(red[~on_board], black[~on_board], strict=True):
        wrap_conductance[(board.wrap_red == here) & (board.wrap_black == there)] = 0.0
    patched = board._replace(
        faces=faces,
        wrap_conductance=wrap_conductance,
        red_inverse=board.red_inverse.copy(),
        black_degree=board.black_degree.copy(),
        black_inverse=board.black_inverse.copy(),
        aggregate=board.aggregate.copy(),
    )
    touched = np.unique(np.concatenate([change.pairs.ravel(), change.pinned]))
    _renew_diagonal(patched, system, place, touched, hierarchy.unit)
    alone = place[change.pinned]
    patched.aggregate[alone[alone >= 0]] = -1
    return replace(hierarchy, board=patched)


def _by_colour(place: NDArray[np.int64], pairs: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Red and black places of pairs of rows."""
    first, second = place[pairs[:, 0]], place[pairs[:, 1]]
    return np.where(first < 0, -1 - first, -1 - second), np.where(first < 0, second, first)


def _faces(board: Board, red: NDArray[np.int64], black: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the face between two places; -1 where a ring closes."""
    away = black - red
    face = np.full(len(red), -1)
    face[away == board.aside[(red - board.margin) // board.width]] = len(board.distance)
    for number, distance in enumerate(board.distance.tolist()):
        face[away == distance] = number
    return face


def _renew_diagonal(
    board: Board, system: NodalSystem, place: NDArray[np.int64], rows: NDArray[np.int64], unit: float
) -> None:
    from resgrid.nodal.update import kernels

    _, stored = kernels.sum_rows(system.coupling.indptr, system.coupling.data, rows, unit)
    degree = stored + system.excess[rows] / unit
    red = place[rows] < 0
    board.red_inverse[-1 - place[rows[red]]] = 1.0 / degree[red]
    board.black_degree[place[rows[~red]]] = degree[~red]
    board.black_inverse[place[rows[~red]]] = 1.0 / degree[~red]


def coordinates(
    hierarchy: Hierarchy, board: Board, rows: NDArray[np.int64], shape: tuple[int, ...]
) -> NDArray[np.int32]:
    """Where rows lie on the grid, read off their places; shape (rows, ndim)."""
    place = hierarchy.place[rows]
    black = place >= 0
    line, along = np.divmod(np.where(black, place, -1 - place) - board.margin, board.width)
    column = 2 * along + ((board.aside[line] > 0) != black)
    return np.ascontiguousarray(np.stack([*np.unravel_index(line, shape[:-1]), column], axis=1), dtype=np.int32)
