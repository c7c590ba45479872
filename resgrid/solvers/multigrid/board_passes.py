"""Compiled passes over a board: a grid by colour, every resistor between a red cell and a black one.

Red cells have an even sum of indices, black cells an odd one.  Each colour has a flat array of its own, in which the
black neighbour across a face lies at the same distance for all red cells (`resgrid.solvers.multigrid.lattice`).  All
passes run over blocks of places, which stay in the first cache, and over some faces of all their cells after others,
which fills the vector registers whatever the dimension.  What fits no face, a resistor that closes a ring or leads to a
node beside the grid, is a link.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import ZERO, inner, inner_fast

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Indices = NDArray[np.int32]
Integers = NDArray[np.int64]
Reals = NDArray[np.floating[Any]]


class Board(NamedTuple):
    """A grid of conductances by colour, in single or in double precision.

    Arrays over places have shape (places,), with unused margins before and behind.

    `faces` (2 ndim, places): conductance from a red cell to the black one at ``distance``; 0 for none; `distance` (2
    ndim,): from a red place to the black place across each face; `margin, block`: places before the first cell; how
    many a pass takes at a time; `link_red, link_black`: places that links join, in the order of their red places;
    `links`: their conductances; `red_inverse, black_inverse, black_degree`: reciprocals of the diagonal at red and at
    black cells, and the latter; 0 where there is no unknown.
    """

    faces: Reals
    distance: Integers
    margin: int
    block: int
    link_red: Indices
    link_black: Indices
    links: Reals
    red_inverse: Reals
    black_inverse: Reals
    black_degree: Reals


@inner_fast
def _four_products(
    g: Reals, at: tuple[int, int, int, int], x: Reals, there: tuple[int, int, int, int], count: int, total: Reals,
    to: int,
) -> None:  # fmt: skip
    """``total = g x`` across the first four faces over ``count`` places, in the precision of the total.

    Conductances begin ``at``, values of ``x`` ``there``.  Without signs, no index is asked whether it counts from the
    end.
    """
    real, t_at = total.dtype.type, np.uint64(to)
    a, b, c, d = np.uint64(at[0]), np.uint64(at[1]), np.uint64(at[2]), np.uint64(at[3])
    i, j, m, n = np.uint64(there[0]), np.uint64(there[1]), np.uint64(there[2]), np.uint64(there[3])
    for here in range(count):
        k = np.uint64(here)
        total[t_at + k] = (
            real(g[np.uint64(0), a + k]) * x[i + k]
            + real(g[np.uint64(1), b + k]) * x[j + k]
            + real(g[np.uint64(2), c + k]) * x[m + k]
            + real(g[np.uint64(3), d + k]) * x[n + k]
        )


@inner_fast
def _add_two_products(
    g: Reals, q: int, at: tuple[int, int], x: Reals, there: tuple[int, int], count: int, total: Reals, to: int
) -> None:
    """The same across faces ``q`` and ``q + 1``, added."""
    real, t_at = total.dtype.type, np.uint64(to)
    face, other, a, b = np.uint64(q), np.uint64(q + 1), np.uint64(at[0]), np.uint64(at[1])
    i, j = np.uint64(there[0]), np.uint64(there[1])
    for here in range(count):
        k = np.uint64(here)
        total[t_at + k] += real(g[face, a + k]) * x[i + k] + real(g[other, b + k]) * x[j + k]


@inner
def into_red(board: Board, x: Reals, block: int, total: Reals, to: int) -> None:
    """``total = sum_j g_ij x_j`` across the faces of the red cells of a block, from place ``to`` on."""
    (begin, count), away = extent(board, block), board.distance
    there = (begin + away[0], begin + away[1], begin + away[2], begin + away[3])
    _four_products(board.faces, (begin, begin, begin, begin), x, there, count, total, to)
    for q in range(4, len(away), 2):
        pair = (begin + away[q], begin + away[q + 1])
        _add_two_products(board.faces, q, (begin, begin), x, pair, count, total, to)


@inner
def into_black(board: Board, x: Reals, first: int, block: int, total: Reals, to: int) -> None:
    """``total = sum_j g_ij x_j`` across the faces of the black cells of a block, from place ``to`` on.

    ``x`` begins at place ``first``.
    """
    (begin, count), away = extent(board, block), board.distance
    a, b, c, d = begin - away[0], begin - away[1], begin - away[2], begin - away[3]
    there = (a - first, b - first, c - first, d - first)
    _four_products(board.faces, (a, b, c, d), x, there, count, total, to)
    for q in range(4, len(away), 2):
        a, b = begin - away[q], begin - away[q + 1]
        _add_two_products(board.faces, q, (a, b), x, (a - first, b - first), count, total, to)


@inner_fast
def spread(g: Reals, q: int, begin: int, away: int, count: int, x: Reals, total: Reals) -> None:
    """Add ``g x`` across a face to the black neighbours of some red cells."""
    face, red, black = np.uint64(q), np.uint64(begin), np.uint64(begin + away)
    for i in range(count):
        k = np.uint64(i)
        total[black + k] += g[face, red + k] * x[red + k]


@inner
def extent(board: Board, block: int) -> tuple[int, int]:
    """First place of a block, and how many it has."""
    begin = board.margin + block * board.block
    return begin, min(board.block, board.faces.shape[1] - board.margin - begin)


@inner
def blocks_of(board: Board) -> int:
    """How many blocks there are."""
    return int(-(-(board.faces.shape[1] - 2 * board.margin) // board.block))


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
    total = np.empty(board.block, board.faces.dtype)
    drawn, link = np.empty(len(board.links), total.dtype), ZERO
    draw(board, black, drawn)
    for block in range(blocks_of(board)):
        begin, count = extent(board, block)
        into_red(board, black, block, total, ZERO)
        while link < len(drawn) and board.link_red[link] < begin + count:
            total[board.link_red[link] - begin] += drawn[link]
            link += 1
        relax(board.red_inverse, fed, begin, count, total, red)


@inner
def add_into_black(board: Board, red: Reals, fed: Reals, total: Reals) -> None:
    """``total = fed + G red`` at the black cells."""
    for block in range(blocks_of(board)):
        begin, count = extent(board, block)
        into_black(board, red, ZERO, block, total, begin)
        for k in range(begin, begin + count):
            total[k] += fed[k]
    for m in range(len(board.links)):
        total[board.link_black[m]] += board.links[m] * red[board.link_red[m]]


@inner
def place_of(number: int, margin: int, places: int) -> int:
    """Place of a numbered cell, as `resgrid.solvers.multigrid.lattice.Lattice.place`."""
    return (number & 1) * places + margin + (number >> 1)
