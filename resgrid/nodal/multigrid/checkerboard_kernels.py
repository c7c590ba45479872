"""Compiled passes over a checkerboard: the first level of a grid, in single precision, red cells eliminated.

Red cells have an even sum of indices, black cells an odd one; every resistor joins a red cell to a black one.  Each
colour has flat arrays of its own: a row of cells along the last axis fills ``width`` places, so that all neighbours
lie at the same distance for all red cells, but for one, which lies a place before or after, by the row's parity.
All passes run over blocks of whole rows, which stay in the first cache, and over one face of all their cells after
the other, which fills the vector registers whatever the dimension.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Indices = NDArray[np.int32]
Unsigned = NDArray[np.uint32]
Integers = NDArray[np.int64]
Reals = NDArray[np.floating[Any]]

_FAST = {"contract", "reassoc", "nsz", "arcp"}


class Board(NamedTuple):
    """A grid by colour.  Arrays over places have shape (places,), with unused margins before and behind.

    Attributes
    ----------
    faces : ndarray of float32, shape (2 ndim, places)
        Conductance from a red cell to the black one at ``distance``, the last face's at ``aside``; 0 for none.
    distance : ndarray of int64, shape (2 ndim - 1,)
        From a red place to the black place across each face but the last.
    aside : ndarray of int64, shape (rows,)
        The same across the last face: -1 or 1.
    width, margin, block : int
        Places a row, the last of which is left empty; places before the first row; rows that a pass takes at a time.
    wrap_red, wrap_black, wrap_conductance : ndarray
        The resistors that close periodic axes: places and conductances, in the order of their red places.
    wrap_order : ndarray of int64
        Their order by black places.
    red_inverse, black_degree : ndarray of float64
        Reciprocal of the diagonal at red cells, the diagonal at black ones; 0 where there is no unknown.
    black_inverse : ndarray of float32
    aggregate : ndarray of int32
        Node of the first coarse level that a black cell belongs to, -1 where there is no unknown.
    """

    faces: Singles
    distance: Integers
    aside: Integers
    width: int
    margin: int
    block: int
    wrap_red: Integers
    wrap_black: Integers
    wrap_conductance: Singles
    wrap_order: Integers
    red_inverse: Floats
    black_degree: Floats
    black_inverse: Singles
    aggregate: Indices


@njit(cache=True, fastmath=_FAST)
def _sum_pair(g: Singles, x: Reals, h: Singles, y: Reals, total: Reals) -> None:
    one = total.dtype.type(1.0)  # products are formed in the precision of the sum
    for k in range(len(total)):
        total[k] += (one * g[k]) * x[k] + (one * h[k]) * y[k]


@njit(cache=True, fastmath=_FAST)
def _sum_one(g: Singles, x: Reals, total: Reals) -> None:
    one = total.dtype.type(1.0)
    for k in range(len(total)):
        total[k] += (one * g[k]) * x[k]


@njit(cache=True, fastmath=_FAST)
def into_red(board: Board, x: Reals, row: int, wrap: int, total: Reals) -> int:
    """``total = sum_j g_ij x_j`` at the red cells of a block of rows; returns the next wrap."""
    faces, distance, width = board.faces, board.distance, board.width
    begin = board.margin + row * width
    end = begin + len(total)
    for k in range(len(total)):
        total[k] = 0.0
    for q in range(0, len(distance) - 1, 2):
        d, e = distance[q], distance[q + 1]
        _sum_pair(faces[q, begin:end], x[begin + d : end + d], faces[q + 1, begin:end], x[begin + e : end + e], total)
    last, used = len(distance), width - 1
    _sum_one(faces[last - 1, begin:end], x[begin:end], total)
    for i in range(len(total) // width):
        at = begin + i * width
        there = at + board.aside[row + i]
        _sum_one(faces[last, at : at + used], x[there : there + used], total[i * width : i * width + used])
    while wrap < len(board.wrap_red) and board.wrap_red[wrap] < end:
        total[board.wrap_red[wrap] - begin] += board.wrap_conductance[wrap] * x[board.wrap_black[wrap]]
        wrap += 1
    return wrap


@njit(cache=True, fastmath=_FAST)
def into_black(board: Board, x: Reals, row: int, wrap: int, total: Reals) -> int:
    """``total = sum_j g_ij x_j`` at the black cells of a block of rows; returns the next wrap."""
    faces, distance, width = board.faces, board.distance, board.width
    begin = board.margin + row * width
    end = begin + len(total)
    for k in range(len(total)):
        total[k] = 0.0
    for q in range(0, len(distance) - 1, 2):
        a, b = begin - distance[q], end - distance[q]
        c, d = begin - distance[q + 1], end - distance[q + 1]
        _sum_pair(faces[q, a:b], x[a:b], faces[q + 1, c:d], x[c:d], total)
    last, used = len(distance), width - 1
    _sum_one(faces[last - 1, begin:end], x[begin:end], total)
    for i in range(len(total) // width):
        there = begin + i * width - board.aside[row + i]
        _sum_one(faces[last, there : there + used], x[there : there + used], total[i * width : i * width + used])
    while wrap < len(board.wrap_order) and board.wrap_black[board.wrap_order[wrap]] < end:
        k = board.wrap_order[wrap]
        total[board.wrap_black[k] - begin] += board.wrap_conductance[k] * x[board.wrap_red[k]]
        wrap += 1
    return wrap


@njit(cache=True, nogil=True)
def restrict(board: Board, y: Singles, red: Singles, coarse: Singles) -> None:
    """Relax the red cells after the black values ``y``, and sum the black residual into the first coarse level."""
    _relax_red(board, y, red)
    rows, width = len(board.aside), board.width
    scratch = np.empty(board.block * width, np.float32)
    for node in range(len(coarse)):
        coarse[node] = 0.0
    wrap = 0
    for row in range(0, rows, board.block):
        total = scratch[: min(board.block, rows - row) * width]
        wrap = into_black(board, red, row, wrap, total)
        begin = board.margin + row * width
        for k in range(len(total)):
            node = board.aggregate[begin + k]
            if node >= 0:
                coarse[node] += total[k]


@njit(cache=True, nogil=True)
def prolong(board: Board, coarse: Singles, r: Floats, red: Singles, z: Singles) -> None:
    """Add the coarse answer to the black values ``z``, relax the red cells, then the black ones."""
    for k in range(len(z)):
        node = board.aggregate[k]
        if node >= 0:
            z[k] += coarse[node]
    _relax_red(board, z, red)
    rows, width = len(board.aside), board.width
    scratch = np.empty(board.block * width, np.float32)
    wrap = 0
    for row in range(0, rows, board.block):
        total = scratch[: min(board.block, rows - row) * width]
        wrap = into_black(board, red, row, wrap, total)
        begin = board.margin + row * width
        end = begin + len(total)
        _relax(board.black_inverse[begin:end], r[begin:end], total, z[begin:end])


@njit(cache=True)
def _relax_red(board: Board, z: Singles, red: Singles) -> None:
    """``red = G z / degree``: nothing is fed into red cells."""
    rows, width = len(board.aside), board.width
    scratch = np.empty(board.block * width, np.float32)
    wrap = 0
    for row in range(0, rows, board.block):
        total = scratch[: min(board.block, rows - row) * width]
        wrap = into_red(board, z, row, wrap, total)
        begin = board.margin + row * width
        end = begin + len(total)
        _scale(board.red_inverse[begin:end], total, red[begin:end])


@njit(cache=True, fastmath=_FAST)
def _relax(inverse: Singles, r: Floats, total: Singles, z: Singles) -> None:
    for k in range(len(total)):
        z[k] = inverse[k] * (r[k] + total[k])


@njit(cache=True, nogil=True, fastmath=_FAST)
def multiply(board: Board, z: Singles, r: Floats, s: Floats, red: Floats, w: Floats) -> tuple[float, float, float]:
    """``w = S z`` with the Schur complement S of the black cells, in double; returns ``z.r``, ``z.w`` and ``z.s``."""
    rows, width = len(board.aside), board.width
    scratch = np.empty(board.block * width)
    wrap = 0
    for row in range(0, rows, board.block):
        total = scratch[: min(board.block, rows - row) * width]
        wrap = into_red(board, z, row, wrap, total)
        begin = board.margin + row * width
        _scale(board.red_inverse[begin : begin + len(total)], total, red[begin:])
    zr, zw, zs = 0.0, 0.0, 0.0
    wrap = 0
    for row in range(0, rows, board.block):
        total = scratch[: min(board.block, rows - row) * width]
        wrap = into_black(board, red, row, wrap, total)
        begin = board.margin + row * width
        end = begin + len(total)
        _remainder(board.black_degree[begin:end], z[begin:end], total, w[begin:end])
        a, b, c = _products(z[begin:end], r[begin:end], w[begin:end], s[begin:end])
        zr, zw, zs = zr + a, zw + b, zs + c
    return zr, zw, zs


@njit(cache=True, fastmath=_FAST)
def _scale(inverse: Floats, total: Reals, red: Reals) -> None:
    for k in range(len(total)):
        red[k] = inverse[k] * total[k]


@njit(cache=True, fastmath=_FAST)
def _remainder(degree: Floats, z: Singles, total: Floats, w: Floats) -> None:
    for k in range(len(total)):
        w[k] = degree[k] * z[k] - total[k]


@njit(cache=True, fastmath=_FAST)
def _products(z: Singles, r: Floats, w: Floats, s: Floats) -> tuple[float, float, float]:
    a, b, c = 0.0, 0.0, 0.0
    for k in range(len(z)):
        a += z[k] * r[k]
        b += z[k] * w[k]
        c += z[k] * s[k]
    return a, b, c


@njit(cache=True, nogil=True)
def advance(
    board: Board, z: Singles, w: Floats, p: Floats, s: Floats, x: Floats, r: Floats, beta: float, alpha: float
) -> float:
    """One step of flexible conjugate gradients; leaves the next relaxed residual ``r / degree`` in ``z``; ``|r|^2``."""
    chunk = board.block * board.width
    total = 0.0
    for begin in range(board.margin, len(r) - board.margin, chunk):
        end = min(begin + chunk, len(r) - board.margin)
        total += _step(
            board.black_inverse[begin:end], z[begin:end], w[begin:end], p[begin:end], s[begin:end], x[begin:end],
            r[begin:end], beta, alpha,
        )  # fmt: skip
    return total


@njit(cache=True, fastmath=_FAST)
def _step(
    inverse: Singles, z: Singles, w: Floats, p: Floats, s: Floats, x: Floats, r: Floats, beta: float, alpha: float
) -> float:
    for k in range(len(z)):
        p[k] = z[k] + beta * p[k]
    for k in range(len(z)):
        x[k] += alpha * p[k]
    for k in range(len(z)):
        s[k] = w[k] + beta * s[k]
    total = 0.0
    for k in range(len(z)):
        v = r[k] - alpha * s[k]
        r[k] = v
        z[k] = inverse[k] * v
        total += v * v
    return total


@njit(cache=True, nogil=True)
def black_residual(
    indptr: Unsigned,
    indices: Unsigned,
    conductance: Floats,
    excess: Floats,
    inverse: Floats,
    place: Integers,
    reach: int,
    b: Floats,
    x: Floats,
    r: Floats,
) -> float:
    """Relax the red cells exactly, and form the residual at the black ones, differences first; returns its norm.

    No row has neighbours further than ``reach`` behind it, so that one sweep does both.
    """
    n = len(x)
    squares = 0.0
    for ahead in range(n + reach):
        if ahead < n and place[ahead] < 0:
            total = b[ahead]
            for k in range(indptr[ahead], indptr[ahead + 1]):
                total += conductance[k] * x[indices[k]]
            x[ahead] = total * inverse[ahead]
        i = ahead - reach
        if i >= 0 and place[i] >= 0:
            total = b[i] - excess[i] * x[i]
            for k in range(indptr[i], indptr[i + 1]):
                total += conductance[k] * (x[indices[k]] - x[i])
            r[place[i]] = total
            squares += total * total
    return math.sqrt(squares)


@njit(cache=True, nogil=True)
def add_black(place: Integers, correction: Floats, scale: float, x: Floats) -> None:
    """``x += scale * correction`` at the black cells."""
    for i in range(len(x)):
        if place[i] >= 0:
            x[i] += scale * correction[place[i]]
