"""Compiled loops that put a grid's conductances in proportion to a height."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inlined, inner
from resgrid.nodal.multigrid.board_passes import (
    Board,
    Floats,
    Indices,
    Integers,
    Reals,
    add_into_black,
    relax_red,
)

_HIGH = 0.1
"""Share of the highest potential that is a source's."""


@njit(cache=True)
def transform(board: Board, height: Floats, faces: Floats, leak: Floats) -> None:
    """Fill ``faces`` with ``g_ij h_i h_j``, and ``leak``, shape (2, places), with ``h_i (A h)_i``; links left out.

    ``leak`` comes as what links draw, ``sum_j g_ij h_j``.
    """
    margin, places = board.margin, board.faces.shape[1]
    red, black = height
    for k in range(margin, places - margin):
        drawn = 0.0
        for q in range(len(board.distance)):
            g, there = board.faces[q, k], k + board.distance[q]
            faces[q, k] = g * red[k] * black[there]
            drawn += g * black[there]
            leak[1, there] += g * red[k]
        leak[0, k] += drawn
    for k in range(places):
        degree = 1.0 / board.red_inverse[k] if board.red_inverse[k] > 0.0 else 0.0
        leak[0, k] = red[k] * (degree * red[k] - leak[0, k])
        leak[1, k] = black[k] * (board.black_degree[k] * black[k] - leak[1, k])


@njit(cache=True)
def scale_faces(faces: Floats, distance: Integers, margin: int, scale: Floats, scaled: Reals) -> None:
    """``scaled = t_i g_ij t_j`` over all faces."""
    for q in range(len(distance)):
        away = distance[q]
        for k in range(margin, faces.shape[1] - margin):
            scaled[q, k] = faces[q, k] * scale[0, k] * scale[1, k + away]


@njit(cache=True)
def smooth(board: Board, currents: Floats, x: Floats, sweeps: int) -> None:
    """Gauss-Seidel by colour, in place: positive numbers stay positive; ``currents`` and ``x`` of shape (2, places)."""
    for _ in range(sweeps):
        relax_red(board, currents[0], x[1], x[0])
        add_into_black(board, x[0], currents[1], x[1])
        for k in range(x.shape[1]):
            x[1, k] = x[1, k] / board.black_degree[k] if board.black_degree[k] > 0.0 else 0.0


@njit(cache=True)
def astray(board: Board, currents: Floats, x: Floats) -> NDArray[np.bool_]:
    """Places from which the way up does not lead to where currents come in, as it does on the solution.

    Parameters
    ----------
    board : Board
    currents, x : ndarray of float64, shape (2, places)

    Returns
    -------
    ndarray of bool, shape (2, places)
        Also where there is no unknown.
    """
    up = _steepest(board, x)
    fed, flat, wrong = currents.ravel(), x.ravel(), np.zeros(x.shape, np.bool_)
    high = _HIGH * flat.max()
    flags = wrong.ravel()
    for here in range(len(up)):
        top = here
        while up[top] != top:
            up[top] = up[up[top]]
            top = up[top]
        up[here] = top
        flags[here] = not (flat[here] > 0.0 and (fed[top] > 0.0 or flat[top] >= high))
    return wrong


@inner
def _steepest(board: Board, x: Floats) -> Indices:
    """The highest neighbour of every place, red ones first, if it is higher than the place itself."""
    margin, places = board.margin, x.shape[1]
    red, black = x
    up, highest, most = np.arange(2 * places).astype(np.int32), red.copy(), black.copy()
    for k in range(margin, places - margin):
        for q in range(len(board.distance)):
            if board.faces[q, k] > 0.0:
                _climb(red, black, k, k + board.distance[q], highest, most, up)
    for m in range(len(board.links)):
        _climb(red, black, board.link_red[m], board.link_black[m], highest, most, up)
    return up


@inlined
def _climb(red: Floats, black: Floats, k: int, there: int, highest: Floats, most: Floats, up: Indices) -> None:
    """Note either end of a conductance as the other's highest neighbour, if it is."""
    if black[there] > highest[k]:
        highest[k], up[k] = black[there], len(red) + there
    if red[k] > most[there]:
        most[there], up[len(red) + there] = red[k], k
