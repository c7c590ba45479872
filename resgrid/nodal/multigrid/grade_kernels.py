"""Compiled loops that put a grid's conductances in proportion to a height."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import ZERO, inlined, inner, inner_fast
from resgrid.nodal.multigrid.board_passes import (
    Board,
    Floats,
    Indices,
    Integers,
    Reals,
    add_into_black,
    blocks_of,
    extent,
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


class _Basins(NamedTuple):
    """What leads up to where: potentials, those of the highest neighbours, what is astray, and a queue of such places.

    All over the places of both colours.
    """

    x: Floats
    highest: Floats
    wrong: NDArray[np.bool_]
    queue: Indices


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
    places, highest = x.shape[1], _highest_around(board, x)
    wrong = np.zeros(x.shape, np.bool_)
    basins = _Basins(x.ravel(), highest.ravel(), wrong.ravel(), np.empty(x.size, np.int32))
    fed, high, tail = currents.ravel(), _HIGH * x.max(), ZERO
    for here in range(x.size):
        if not basins.x[here] > 0.0:
            basins.wrong[here] = True
        elif not (basins.highest[here] > basins.x[here] or fed[here] > 0.0 or basins.x[here] >= high):
            tail = _queue(basins, here, tail)
    head = ZERO
    while head < tail:
        while head < tail:
            tail = _follow_down(board, places, basins, basins.queue[head], tail)
            head += 1
        for m in range(len(board.links)):
            red, black = board.link_red[m], places + board.link_black[m]
            if basins.wrong[red] and _leads_over(basins, black, red):
                tail = _queue(basins, black, tail)
            if basins.wrong[black] and _leads_over(basins, red, black):
                tail = _queue(basins, red, tail)
    return wrong


@inner
def _highest_around(board: Board, x: Floats) -> Floats:
    """The highest neighbour's potential at every place."""
    highest = np.zeros_like(x)
    (red, black), (over_red, over_black) = x, highest
    for block in range(blocks_of(board)):
        begin, count = extent(board, block)
        for q in range(len(board.distance)):
            there = begin + board.distance[q]
            _raise(board.faces, q, begin, black, there, count, over_red, begin)
            _raise(board.faces, q, begin, red, begin, count, over_black, there)
    for m in range(len(board.links)):
        k, there = board.link_red[m], board.link_black[m]
        over_red[k], over_black[there] = max(over_red[k], black[there]), max(over_black[there], red[k])
    return highest


@inner_fast
def _raise(g: Reals, q: int, at: int, x: Floats, there: int, count: int, over: Floats, to: int) -> None:
    """``over = max(over, x)`` where a face conducts."""
    face, begin, source, target = np.uint64(q), np.uint64(at), np.uint64(there), np.uint64(to)
    for i in range(count):
        k = np.uint64(i)
        value = x[source + k] if g[face, begin + k] > 0.0 else 0.0
        over[target + k] = value if value > over[target + k] else over[target + k]


@inner
def _follow_down(board: Board, places: int, basins: _Basins, here: int, tail: int) -> int:
    """Queue the neighbours across faces whose way up leads over a place; returns the queue's end."""
    red = here < places
    for q in range(len(board.distance)):
        k = here if red else here - places - board.distance[q]
        if board.margin <= k < places - board.margin and board.faces[q, k] > 0.0:
            there = places + k + board.distance[q] if red else k
            if _leads_over(basins, there, here):
                tail = _queue(basins, there, tail)
    return tail


@inlined
def _leads_over(basins: _Basins, place: int, neighbour: int) -> bool:
    """Whether the way up from a place that is not queued leads over a neighbour."""
    up = basins.x[neighbour]
    return not basins.wrong[place] and basins.highest[place] == up and up > basins.x[place]


@inlined
def _queue(basins: _Basins, place: int, tail: int) -> int:
    basins.wrong[place] = True
    basins.queue[tail] = place
    return tail + 1
