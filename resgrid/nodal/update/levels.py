"""The levels of a changed circuit: the first one patched; the coarse ones are kept, but for their ties to the rails.

What is tied to a rail anew holds the coarse nodes around it, too: left out, the iteration takes twice as long.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.multigrid.checkerboard_kernels import Board
from resgrid.nodal.multigrid.hierarchy import Hierarchy
from resgrid.nodal.multigrid.kernels import Stack
from resgrid.nodal.system import NodalSystem
from resgrid.nodal.update.change import Change

_BLOCK_RESISTANCE = 0.125
"""Resistance on the way through a block of four to a point in it, in units of the mean resistance around."""


def patch_levels(
    hierarchy: Hierarchy, board: Board, before: NodalSystem, system: NodalSystem, change: Change
) -> Hierarchy:
    """Take the resistors between separated rows off the board, and renew the diagonals of both.

    Parameters
    ----------
    hierarchy : Hierarchy
        Of the circuit before, with a board.
    board : Board
    before, system : NodalSystem
        Before and after the change.
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
    near = np.setdiff1d(change.pairs, change.pinned)
    leak = (system.excess[near] - before.excess[near]) / hierarchy.unit
    stack = _tie(hierarchy.stack, _aggregates(patched, place, system, near), leak)
    return replace(hierarchy, board=patched, stack=stack)


def _aggregates(
    board: Board, place: NDArray[np.int64], system: NodalSystem, rows: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Node of the first coarse level that rows belong to; of a red row, the one of a black neighbour; -1 for none."""
    from resgrid.nodal.update import kernels

    coupling = system.coupling
    black = kernels.first_neighbours(coupling.indptr, coupling.indices, coupling.data, rows)
    black = np.where(place[rows] >= 0, rows, black)
    return np.where(black >= 0, board.aggregate[np.maximum(place[black], 0)], -1).astype(np.int64)


def _tie(stack: Stack, nodes: NDArray[np.int64], leak: NDArray[np.float64]) -> Stack:
    """Tie nodes of the first level, and the coarser ones they belong to, to the rails by so much more.

    From level to level the way to a point takes its share of the block's own resistance (as in
    `aggregation.lengthen`).  Where a level is left by elimination, the tie ends: it only preconditions.
    """
    nodes, leak = nodes[(nodes >= 0) & (leak > 0)], leak[(nodes >= 0) & (leak > 0)]
    if not len(nodes):
        return stack
    diagonal, inverse, coarsest = stack.diagonal.copy(), stack.inverse.copy(), stack.coarsest
    last = len(stack.first) - 2
    for level in range(last + 1):
        nodes, member = np.unique(nodes, return_inverse=True)
        leak = np.asarray(np.bincount(member, leak), dtype=np.float64)
        if level == last:
            coarsest = _hold(coarsest, nodes - stack.first[level], leak)
        diagonal[nodes] += leak
        inverse[nodes] = 1.0 / diagonal[nodes]
        if level == last or stack.eliminated[level + 1] > stack.eliminated[level]:
            break
        begin, end = stack.indptr[nodes].astype(np.int64), stack.indptr[nodes + 1].astype(np.int64)
        # The diagonal is little more than the sum of the conductances.
        mean = stack.diagonal[nodes] / np.maximum(end - begin, 1)
        leak = 1.0 / (1.0 / leak + _BLOCK_RESISTANCE / mean)
        nodes = stack.aggregate[nodes].astype(np.int64)
    return stack._replace(diagonal=diagonal, inverse=inverse, coarsest=coarsest)


def _hold(inverse: NDArray[np.float32], nodes: NDArray[np.int64], leak: NDArray[np.float64]) -> NDArray[np.float32]:
    """The inverse after diagonal entries have grown (Sherman & Morrison 1950)."""
    after = inverse.astype(np.float64)
    for node, amount in zip(nodes, leak, strict=True):
        column = after[:, node].copy()
        after -= np.outer(column, after[node] / (1.0 / amount + column[node]))
    return after.astype(np.float32)


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
