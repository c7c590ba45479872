"""Compiled passes over a board: a grid by colour, every resistor between a red cell and a black one.

Red cells have an even sum of indices, black cells an odd one.  Each colour has flat arrays of its own: a row of cells
along the last axis fills ``width`` places, so that all neighbours lie at the same distance for all red cells, but for
one, which lies a place before or after, by the row's parity.  All passes run over blocks of whole rows, which stay in
the first cache, and over one face of all their cells after the other, which fills the vector registers whatever the
dimension.  What fits no face, a resistor that closes a ring or leads to a node beside the grid, is a link.
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
Integers = NDArray[np.int64]
Reals = NDArray[np.floating[Any]]

FAST = {"contract", "reassoc", "nsz", "arcp"}


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
    link_order : ndarray of int32
        Their order by black places.
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
    link_order: Indices
    links: Reals
    red_inverse: Reals
    black_inverse: Reals
    black_degree: Reals


@njit(cache=True, fastmath=FAST)
def _product(g: Reals, q: int, at: int, x: Reals, there: int, count: int, total: Reals, to: int) -> None:
    """``total = g x`` over ``count`` places; without signs, no index is asked whether it counts from the end."""
    face, g_at, x_at, t_at = np.uint64(q), np.uint64(at), np.uint64(there), np.uint64(to)
    for i in range(count):
        k = np.uint64(i)
        total[t_at + k] = g[face, g_at + k] * x[x_at + k]


@njit(cache=True, fastmath=FAST)
def _add_product(g: Reals, q: int, at: int, x: Reals, there: int, count: int, total: Reals, to: int) -> None:
    face, g_at, x_at, t_at = np.uint64(q), np.uint64(at), np.uint64(there), np.uint64(to)
    for i in range(count):
        k = np.uint64(i)
        total[t_at + k] += g[face, g_at + k] * x[x_at + k]


@njit(cache=True, fastmath=FAST)
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


@njit(cache=True, fastmath=FAST)
def into_black(board: Board, x: Reals, block: int, total: Reals, to: int) -> None:
    """``total = sum_j g_ij x_j`` across the faces of the black cells of a block of rows, from place ``to`` on."""
    row, begin, count = extent(board, block)
    last, width = len(board.distance), board.width
    _product(board.faces, last - 1, begin, x, begin, count, total, to)
    for q in range(last - 1):
        there = begin - board.distance[q]
        _add_product(board.faces, q, there, x, there, count, total, to)
    for i in range(count // width):
        there = begin + i * width - board.aside[row + i]
        _add_product(board.faces, last, there, x, there, width - 1, total, to + i * width)


@njit(cache=True)
def extent(board: Board, block: int) -> tuple[int, int, int]:
    """First row of a block, its first place, and how many places it has."""
    row = block * board.block
    return row, board.margin + row * board.width, min(board.block, len(board.aside) - row) * board.width


@njit(cache=True)
def row_blocks(board: Board) -> tuple[int, int]:
    """How many blocks of rows there are, and how many blocks a neighbour may lie ahead."""
    blocks = -(-len(board.aside) // board.block)
    return blocks, (board.margin + board.block * board.width - 1) // (board.block * board.width)


@njit(cache=True)
def drawn_from_black(board: Board, x: Reals) -> Reals:
    """What every link draws into its red cell."""
    drawn = np.empty(len(board.links), board.links.dtype)
    for k in range(len(drawn)):
        drawn[k] = board.links[k] * x[board.link_black[k]]
    return drawn


@njit(cache=True)
def link_into_red(board: Board, drawn: Reals, begin: int, count: int, link: int, total: Reals) -> int:
    """Add what links draw into the red cells of a block; returns the next link."""
    while link < len(drawn) and board.link_red[link] < begin + count:
        total[board.link_red[link] - begin] += drawn[link]
        link += 1
    return link


@njit(cache=True, fastmath=FAST)
def scale(inverse: Reals, begin: int, count: int, total: Reals, to: int, value: Reals) -> None:
    """``value = inverse * total``, the total from place ``to`` on."""
    at, t_at = np.uint64(begin), np.uint64(to)
    for i in range(count):
        k = np.uint64(i)
        value[at + k] = inverse[at + k] * total[t_at + k]


@njit(cache=True, fastmath=FAST)
def _relax(inverse: Reals, fed: Reals, begin: int, count: int, total: Reals, value: Reals) -> None:
    at = np.uint64(begin)
    for i in range(count):
        k = np.uint64(i)
        value[at + k] = inverse[at + k] * (fed[at + k] + total[k])


@njit(cache=True, nogil=True)
def restrict(board: Board, aggregate: Indices, z: Singles, red: Singles, coarse: Singles) -> None:
    """Let the red cells follow the black values ``z``, and sum the black residual into the next level.

    ``aggregate`` leads from a black place to its node there; from unused places to node 0, which nothing belongs to.
    As in the other passes, the red cells go ahead by as many rows as there are between neighbours, so that the faces
    are read once; links are seen to at either end.
    """
    total = np.empty(board.block * board.width, np.float32)
    drawn, link = drawn_from_black(board, z), 0
    coarse[:] = 0.0
    blocks, ahead = row_blocks(board)
    for block in range(blocks + ahead):
        if block < blocks:
            _, begin, count = extent(board, block)
            into_red(board, z, block, total, 0)
            link = link_into_red(board, drawn, begin, count, link, total)
            scale(board.red_inverse, begin, count, total, 0, red)
        if block >= ahead:
            into_black(board, red, block - ahead, total, 0)
            _, begin, count = extent(board, block - ahead)
            at = np.uint64(begin)
            for i in range(count):
                k = np.uint64(i)
                coarse[np.uint32(aggregate[at + k])] += total[k]
    for m in range(len(board.links)):
        coarse[aggregate[board.link_black[m]]] += board.links[m] * red[board.link_red[m]]
    coarse[0] = 0.0


@njit(cache=True, nogil=True)
def prolong(board: Board, aggregate: Indices, coarse: Singles, f: Singles, red: Singles, z: Singles) -> None:
    """Add the next level's answer to the black values ``z``, let the red cells follow, then relax the black ones."""
    for k in range(len(z)):
        z[k] += coarse[np.uint32(aggregate[k])]
    total = np.empty(board.block * board.width, np.float32)
    drawn, link = drawn_from_black(board, z), 0
    blocks, ahead = row_blocks(board)
    for block in range(blocks + ahead):
        if block < blocks:
            _, begin, count = extent(board, block)
            into_red(board, z, block, total, 0)
            link = link_into_red(board, drawn, begin, count, link, total)
            scale(board.red_inverse, begin, count, total, 0, red)
        if block >= ahead:
            into_black(board, red, block - ahead, total, 0)
            _, begin, count = extent(board, block - ahead)
            _relax(board.black_inverse, f, begin, count, total, z)
    for m in range(len(board.links)):
        black = board.link_black[m]
        z[black] += board.black_inverse[black] * board.links[m] * red[board.link_red[m]]


@njit(cache=True, nogil=True)
def multiply(board: Board, z: Singles, r: Reals, s: Reals, red: Reals, w: Reals) -> tuple[float, float, float]:
    """``w = S z`` with the Schur complement S of the black cells; returns ``z.r``, ``z.w`` and ``z.s``.

    It is formed in the precision of the board.
    """
    total = np.empty(board.block * board.width, board.faces.dtype)
    drawn, link = drawn_from_black(board, z), 0
    zr, zw, zs = 0.0, 0.0, 0.0
    blocks, ahead = row_blocks(board)
    for block in range(blocks + ahead):
        if block < blocks:
            _, begin, count = extent(board, block)
            into_red(board, z, block, total, 0)
            link = link_into_red(board, drawn, begin, count, link, total)
            scale(board.red_inverse, begin, count, total, 0, red)
        if block >= ahead:
            _, begin, count = extent(board, block - ahead)
            into_black(board, red, block - ahead, w, begin)
            a, b, c = _products(board.black_degree, z, r, s, begin, count, w)
            zr, zw, zs = zr + a, zw + b, zs + c
    for m in range(len(board.links)):
        black, drawn_here = board.link_black[m], board.links[m] * red[board.link_red[m]]
        w[black] -= drawn_here
        zw -= z[black] * drawn_here
    return zr, zw, zs


@njit(cache=True, fastmath=FAST)
def _products(
    degree: Reals, z: Singles, r: Reals, s: Reals, begin: int, count: int, w: Reals
) -> tuple[float, float, float]:
    """``w = degree z - w`` on a block, and its share of ``z.r``, ``z.w`` and ``z.s``."""
    a, b, c = 0.0, 0.0, 0.0
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        one = np.float64(z[k])
        v = degree[k] * one - w[k]
        w[k] = v
        a += one * r[k]
        b += one * v
        c += one * s[k]
    return a, b, c


@njit(cache=True)
def relax_red(board: Board, fed: Reals, black: Reals, red: Reals) -> None:
    """``red = (fed + G black) / degree``."""
    total = np.empty(board.block * board.width, board.faces.dtype)
    drawn, link = drawn_from_black(board, black), 0
    for block in range(row_blocks(board)[0]):
        _, begin, count = extent(board, block)
        into_red(board, black, block, total, 0)
        link = link_into_red(board, drawn, begin, count, link, total)
        _relax(board.red_inverse, fed, begin, count, total, red)


@njit(cache=True)
def add_into_black(board: Board, red: Reals, fed: Reals, total: Reals) -> None:
    """``total = fed + G red`` at the black cells."""
    for block in range(row_blocks(board)[0]):
        _, begin, count = extent(board, block)
        into_black(board, red, block, total, begin)
        for k in range(begin, begin + count):
            total[k] += fed[k]
    for m in range(len(board.links)):
        total[board.link_black[m]] += board.links[m] * red[board.link_red[m]]


@njit(cache=True, nogil=True)
def black_residual(board: Board, b: Floats, x: Floats, r: Floats) -> float:
    """Relax the red cells exactly, and form the residual at the black ones; ``b`` and ``x`` of shape (2, places).

    Returns its norm.
    """
    relax_red(board, b[0], x[1], x[0])
    add_into_black(board, x[0], b[1], r)
    return math.sqrt(_subtract(board.black_degree, x[1], r))


@njit(cache=True, fastmath=FAST)
def _subtract(degree: Floats, x: Floats, r: Floats) -> float:
    squares = 0.0
    for k in range(len(r)):
        v = r[k] - degree[k] * x[k]
        r[k] = v
        squares += v * v
    return squares


@njit(cache=True, nogil=True)
def begin_burst(inverse: Singles, size: float, r: Floats, f: Singles, z: Singles) -> None:
    """Divide the residual ``r`` by its norm, and relax it."""
    for k in range(len(r)):
        r[k] /= size
        f[k] = r[k]
        z[k] = inverse[k] * f[k]


@njit(cache=True, nogil=True)
def advance(
    inverse: Singles, chunk: int, w: Floats, p: Floats, s: Floats, x: Floats, r: Floats, f: Singles, z: Singles,
    beta: float, alpha: float, size: float,
) -> float:  # fmt: skip
    """One step of flexible conjugate gradients, ``size`` times of which goes into ``x``; returns ``|r|^2``.

    Leaves the next residual in ``f``, and relaxed in ``z``.
    """
    total = 0.0
    for begin in range(0, len(r), chunk):
        end = min(begin + chunk, len(r))
        total += _step(
            inverse[begin:end], w[begin:end], p[begin:end], s[begin:end], x[begin:end], r[begin:end], f[begin:end],
            z[begin:end], beta, alpha, alpha * size,
        )  # fmt: skip
    return total


@njit(cache=True, fastmath=FAST)
def _step(
    inverse: Singles, w: Floats, p: Floats, s: Floats, x: Floats, r: Floats, f: Singles, z: Singles, beta: float,
    alpha: float, far: float,
) -> float:  # fmt: skip
    for k in range(len(z)):
        p[k] = z[k] + beta * p[k]
    for k in range(len(z)):
        x[k] += far * p[k]
    for k in range(len(z)):
        s[k] = w[k] + beta * s[k]
    total = 0.0
    for k in range(len(z)):
        v = r[k] - alpha * s[k]
        r[k] = v
        f[k] = v
        z[k] = inverse[k] * f[k]
        total += v * v
    return total
