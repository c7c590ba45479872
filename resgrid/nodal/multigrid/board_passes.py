"""Compiled passes over a board: a grid by colour, every resistor between a red cell and a black one.

Red cells have an even sum of indices, black cells an odd one.  Each colour has flat arrays of its own: a row of cells
along the last axis fills ``width`` places, so that all neighbours lie at the same distance for all red cells, but for
one, which lies a place before or after, by the row's parity.  All passes run over blocks of whole rows, which stay in
the first cache, and over one face of all their cells after the other, which fills the vector registers whatever the
dimension.  What fits no face, a resistor that closes a ring or leads to a node beside the grid, is a link.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.nodal.multigrid.compiled import FAST, ZERO, inner, inner_fast

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Indices = NDArray[np.int32]
Integers = NDArray[np.int64]
Reals = NDArray[np.floating[Any]]


class Board(NamedTuple):
    """A grid of conductances by colour, in single or in double precision.

    Arrays over places have shape (places,), with unused margins before and behind.

    Attributes
    ----------
    faces : ndarray of float, shape (2 ndim, places)
        Conductance from a red cell to the black one at ``distance``, the last face's at ``aside``; 0 for none.
    distance : ndarray of int64, shape (2 ndim - 1,)
        From a red place to the black place across each face but the last.
    aside : ndarray of int64, shape (rows,)
        The same across the last face: -1 or 1.
    width, margin, block : int
        Places a row, the last of which is left empty; places before the first row; rows that a pass takes at a time.
    link_red, link_black : ndarray of int32
        Places that links join, in the order of their red places.
    links : ndarray of float
        Their conductances.
    red_inverse, black_inverse, black_degree : ndarray of float
        Reciprocals of the diagonal at red and at black cells, and the latter; 0 where there is no unknown.
    """

    faces: Reals
    distance: Integers
    aside: Integers
    width: int
    margin: int
    block: int
    link_red: Indices
    link_black: Indices
    links: Reals
    red_inverse: Reals
    black_inverse: Reals
    black_degree: Reals


@inner_fast
def _product(g: Reals, q: int, at: int, x: Reals, there: int, count: int, total: Reals, to: int) -> None:
    """``total = g x`` over ``count`` places, in the precision of the total.

    Without signs, no index is asked whether it counts from the end.
    """
    face, g_at, x_at, t_at = np.uint64(q), np.uint64(at), np.uint64(there), np.uint64(to)
    for i in range(count):
        k = np.uint64(i)
        total[t_at + k] = total.dtype.type(g[face, g_at + k]) * x[x_at + k]


@inner_fast
def _add_product(g: Reals, q: int, at: int, x: Reals, there: int, count: int, total: Reals, to: int) -> None:
    face, g_at, x_at, t_at = np.uint64(q), np.uint64(at), np.uint64(there), np.uint64(to)
    for i in range(count):
        k = np.uint64(i)
        total[t_at + k] += total.dtype.type(g[face, g_at + k]) * x[x_at + k]


@inner_fast
def into_red(board: Board, x: Reals, block: int, total: Reals, to: int) -> None:
    """``total = sum_j g_ij x_j`` across the faces of the red cells of a block of rows, from place ``to`` on."""
    row, begin, count = extent(board, block)
    last, width = len(board.distance), board.width
    _product(board.faces, last - 1, begin, x, begin, count, total, to)
    for q in range(last - 1):
        _add_product(board.faces, q, begin, x, begin + board.distance[q], count, total, to)
    for i in range(count // width):
        at = begin + i * width
        _add_product(board.faces, last, at, x, at + board.aside[row + i], width - 1, total, to + i * width)


@inner_fast
def into_black(board: Board, x: Reals, first: int, block: int, total: Reals, to: int) -> None:
    """``total = sum_j g_ij x_j`` across the faces of the black cells of a block of rows, from place ``to`` on.

    ``x`` begins at place ``first``.
    """
    row, begin, count = extent(board, block)
    last, width = len(board.distance), board.width
    _product(board.faces, last - 1, begin, x, begin - first, count, total, to)
    for q in range(last - 1):
        there = begin - board.distance[q]
        _add_product(board.faces, q, there, x, there - first, count, total, to)
    for i in range(count // width):
        there = begin + i * width - board.aside[row + i]
        _add_product(board.faces, last, there, x, there - first, width - 1, total, to + i * width)


@inner
def extent(board: Board, block: int) -> tuple[int, int, int]:
    """First row of a block, its first place, and how many places it has."""
    row = block * board.block
    return row, board.margin + row * board.width, min(board.block, len(board.aside) - row) * board.width


@inner
def row_blocks(board: Board) -> int:
    """How many blocks of rows there are."""
    return -(-len(board.aside) // board.block)


@inner_fast
def relax(inverse: Reals, fed: Reals, begin: int, count: int, total: Reals, value: Reals) -> None:
    """``value = inverse (fed + total)`` on a block."""
    at = np.uint64(begin)
    for i in range(count):
        k = np.uint64(i)
        value[at + k] = inverse[at + k] * (fed[at + k] + total[k])


@inner
def draw(board: Board, x: Reals, drawn: Reals) -> None:
    """What every link draws into its red cell."""
    for k in range(len(drawn)):
        drawn[k] = drawn.dtype.type(board.links[k]) * x[board.link_black[k]]


@inner
def relax_red(board: Board, fed: Reals, black: Reals, red: Reals) -> None:
    """``red = (fed + G black) / degree``."""
    total = np.empty(board.block * board.width, board.faces.dtype)
    drawn, link = np.empty(len(board.links), total.dtype), ZERO
    draw(board, black, drawn)
    for block in range(row_blocks(board)):
        _, begin, count = extent(board, block)
        into_red(board, black, block, total, ZERO)
        while link < len(drawn) and board.link_red[link] < begin + count:
            total[board.link_red[link] - begin] += drawn[link]
            link += 1
        relax(board.red_inverse, fed, begin, count, total, red)


@inner
def add_into_black(board: Board, red: Reals, fed: Reals, total: Reals) -> None:
    """``total = fed + G red`` at the black cells."""
    for block in range(row_blocks(board)):
        _, begin, count = extent(board, block)
        into_black(board, red, ZERO, block, total, begin)
        for k in range(begin, begin + count):
            total[k] += fed[k]
    for m in range(len(board.links)):
        total[board.link_black[m]] += board.links[m] * red[board.link_red[m]]


@njit(cache=True, nogil=True)
def begin_burst(inverse: Singles, size: float, residual: Floats, r: Singles, z: Singles) -> None:
    """Divide the residual by its norm, and relax it."""
    for k in range(len(r)):
        r[k] = residual[k] / size
        z[k] = inverse[k] * r[k]


@njit(cache=True, nogil=True, fastmath=FAST)
def advance(inverse: Singles, w: Singles, s: Singles, r: Singles, z: Singles, beta: float, alpha: float) -> float:
    """One step of flexible conjugate gradients: ``s = w + beta s``, ``r -= alpha s``; returns ``|r|^2``.

    Leaves the relaxed residual in ``z``.
    """
    total = 0.0
    for k in range(len(r)):
        product = w[k] + beta * s[k]
        s[k] = product
        v = np.float32(r[k] - alpha * product)
        r[k] = v
        z[k] = inverse[k] * v
        total += np.float64(v) * np.float64(v)
    return total


@njit(cache=True, nogil=True, fastmath=FAST)
def gather_steps(
    z: Singles, on_x: Floats, before_x: float, on_p: Floats, before_p: float, size: float, p: Floats, x: Floats
) -> None:
    """Add ``size`` times what the steps have gone to ``x``, and leave the last direction in ``p``.

    Both are sums of preconditioned residuals, the rows of ``z``, and of the direction ``p`` before them.
    """
    for k in range(len(x)):
        ahead, far = before_p * p[k], before_x * p[k]
        for j in range(len(z)):
            one = np.float64(z[j, k])
            ahead += on_p[j] * one
            far += on_x[j] * one
        p[k] = ahead
        x[k] += size * far


@njit(cache=True, nogil=True)
def largest_step(z: Singles, on_p: Floats, before_p: float, p: Floats) -> float:
    """Largest entry of the last direction, as of `gather_steps`."""
    most = 0.0
    for k in range(len(p)):
        ahead = before_p * p[k]
        for j in range(len(z)):
            ahead += on_p[j] * z[j, k]
        most = max(most, abs(ahead))
    return most
