"""Waves over a board: passes in which red cells go ahead of black ones, so that faces are read once.

They go ahead by as many places as there are between neighbours, and red values are only kept in a window around the
places that a wave has come to.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from resgrid.jit import ZERO, inner, inner_fast
from resgrid.solvers.multigrid.board_passes import (
    Board,
    Floats,
    Indices,
    Integers,
    Reals,
    Singles,
    blocks_of,
    draw,
    extent,
    into_black,
    into_red,
    relax,
    spread,
)

_ROOM = 4
"""Of a window, in units of what is kept and a block; so seldom it is moved."""


class _Wave(NamedTuple):
    """The red values around the places that a wave has come to.

    `linked`: what links draw into red cells; behind the wave, the red values where they begin; `at` (3,): place of
    the first of the red values, the next link to draw, and the next to note a red value of; `kept`: how many values
    behind a block may still be asked for; `ahead`: how many blocks red cells go ahead of black ones, so that all
    neighbours of these are there.
    """

    red: Reals
    linked: Reals
    at: Integers
    kept: int
    ahead: int


@inner
def _begin_wave(board: Board) -> _Wave:
    ahead = -(-board.margin // board.block)
    kept = ahead * board.block + board.margin
    red = np.zeros(_ROOM * (kept + board.block), board.black_degree.dtype)
    return _Wave(red, np.empty(len(board.links), red.dtype), np.array([board.margin - kept, 0, 0]), kept, ahead)


@inner
def _make_room(board: Board, wave: _Wave, block: int) -> int:
    """Make room for a block of red values; returns where among them it begins."""
    begin = board.margin + block * board.block
    if begin + board.block - wave.at[0] > len(wave.red):
        behind = begin - wave.kept - wave.at[0]
        for k in range(wave.kept):
            wave.red[k] = wave.red[behind + k]
        wave.at[0] = begin - wave.kept
    return int(begin - wave.at[0])


@inner
def _lead(board: Board, wave: _Wave, x: Reals, block: int) -> None:
    """``red = G x / degree`` on a block, zero behind the last one."""
    to = _draw_into_red(board, wave, x, block)
    if block < blocks_of(board):
        begin, count = extent(board, block)
        _scale(board.red_inverse, begin, count, wave.red, to)
        _note(board, wave, begin, to)


@inner
def _draw_into_red(board: Board, wave: _Wave, x: Reals, block: int) -> int:
    """``red = G x`` on a block, zero behind the last one; returns where among the red values it begins."""
    to = _make_room(board, wave, block)
    if block >= blocks_of(board):
        for k in range(to, to + board.block):
            wave.red[k] = 0.0
        return to
    begin, count = extent(board, block)
    into_red(board, x, block, wave.red, to)
    while wave.at[1] < len(board.links) and board.link_red[wave.at[1]] < begin + count:
        wave.red[to + board.link_red[wave.at[1]] - begin] += wave.linked[wave.at[1]]
        wave.at[1] += 1
    return to


@inner
def _note(board: Board, wave: _Wave, begin: int, to: int) -> None:
    """Note the red values of a block where links begin."""
    while wave.at[2] < wave.at[1]:
        wave.linked[wave.at[2]] = wave.red[to + board.link_red[wave.at[2]] - begin]
        wave.at[2] += 1


@inner_fast
def _scale(inverse: Reals, begin: int, count: int, value: Reals, to: int) -> None:
    """``value = inverse * value``, the value from place ``to`` on."""
    at, v_at = np.uint64(begin), np.uint64(to)
    for i in range(count):
        k = np.uint64(i)
        value[v_at + k] *= inverse[at + k]


@njit(cache=True, nogil=True)
def restrict(board: Board, aggregate: Indices, weight: Singles, z: Singles, coarse: Singles) -> None:
    """Let the red cells follow the black values ``z``, and sum the black residual into the next level.

    ``aggregate`` leads from a black place to its node there; from unused places to node 0, which nothing belongs to.
    ``weight`` is what a black place counts for, and takes from its node; where it is empty, it is 1.
    """
    total = np.empty(board.block, board.red_inverse.dtype)
    for node in range(len(coarse)):
        coarse[node] = 0.0
    wave = _begin_wave(board)
    draw(board, z, wave.linked)
    for step in range(blocks_of(board) + wave.ahead):
        _lead(board, wave, z, step)
        if step >= wave.ahead:
            begin, count = extent(board, step - wave.ahead)
            into_black(board, wave.red, wave.at[0], step - wave.ahead, total, ZERO)
            _add_to_nodes(aggregate, weight, begin, count, total, coarse)
    for m in range(len(board.links)):
        share = weight[board.link_black[m]] if len(weight) > 0 else np.float32(1.0)
        coarse[aggregate[board.link_black[m]]] += share * board.links[m] * wave.linked[m]
    coarse[0] = 0.0


@inner
def _add_to_nodes(aggregate: Indices, weight: Singles, begin: int, count: int, total: Reals, coarse: Singles) -> None:
    at = np.uint64(begin)
    if len(weight) > 0:
        for i in range(count):
            k = np.uint64(i)
            coarse[np.uint32(aggregate[at + k])] += weight[at + k] * total[k]
        return
    for i in range(count):
        k = np.uint64(i)
        coarse[np.uint32(aggregate[at + k])] += total[k]


@inner
def _add_from_nodes(aggregate: Indices, weight: Singles, begin: int, count: int, coarse: Singles, z: Singles) -> None:
    at = np.uint64(begin)
    if len(weight) > 0:
        for i in range(count):
            k = at + np.uint64(i)
            z[k] += weight[k] * coarse[np.uint32(aggregate[k])]
        return
    for i in range(count):
        k = at + np.uint64(i)
        z[k] += coarse[np.uint32(aggregate[k])]


@njit(cache=True, nogil=True)
def prolong_and_multiply(
    board: Board, exact: Board, aggregate: Indices, weight: Singles, coarse: Singles, r: Singles, s: Singles,
    z: Singles, w: Singles,
) -> tuple[float, float, float]:  # fmt: skip
    """Finish the preconditioner's answer ``z`` to ``r``, and form ``w = S z``; returns ``z.r``, ``z.w`` and ``z.s``.

    The next level's answer is added to ``z``, the red cells follow, and the black ones are relaxed.  S is the Schur
    complement of the black cells of ``exact``, which is the same board with a diagonal in a precision of its own.

    The waves of both follow as close upon each other as neighbours allow; where there are links, one after the other.
    """
    first, second = _begin_wave(board), _begin_wave(exact)
    blocks, ahead = blocks_of(board), first.ahead
    before, between = (ahead, 3 * ahead) if len(board.links) == 0 else (blocks, 2 * blocks + ahead)
    total = np.empty(board.block, board.red_inverse.dtype)
    product = np.empty(len(total), exact.black_degree.dtype)
    zr, zw, zs = 0.0, 0.0, 0.0
    for step in range(between + blocks + ahead):
        if step < blocks:
            begin, count = extent(board, step)
            _add_from_nodes(aggregate, weight, begin, count, coarse, z)
        if step == before:
            draw(board, z, first.linked)
        if step == between:
            _relax_links(board, first.linked, z)
            draw(exact, z, second.linked)
        if before <= step < before + blocks + ahead:
            _lead(board, first, z, step - before)
        if before + ahead <= step < before + blocks + ahead:
            begin, count = extent(board, step - before - ahead)
            into_black(board, first.red, first.at[0], step - before - ahead, total, ZERO)
            relax(board.black_inverse, r, begin, count, total, z)
        if between <= step:
            _lead(exact, second, z, step - between)
        if between + ahead <= step:
            begin, count = extent(exact, step - between - ahead)
            into_black(exact, second.red, second.at[0], step - between - ahead, product, ZERO)
            a, b, c = _products(exact.black_degree, z, r, s, begin, count, product, w)
            zr, zw, zs = zr + a, zw + b, zs + c
    return zr, zw - _multiply_links(exact, second.linked, z, w), zs


@inner
def _relax_links(board: Board, linked: Singles, z: Singles) -> None:
    for m in range(len(board.links)):
        black = board.link_black[m]
        z[black] += board.black_inverse[black] * board.links[m] * linked[m]


@inner
def _multiply_links(board: Board, linked: Reals, z: Singles, w: Singles) -> float:
    """Take what links draw off the product; returns by how much ``z.w`` becomes less."""
    less = 0.0
    for m in range(len(board.links)):
        black, drawn = board.link_black[m], board.links[m] * linked[m]
        w[black] -= drawn
        less += z[black] * drawn
    return less


@inner_fast
def _products(
    degree: Reals, z: Singles, r: Singles, s: Singles, begin: int, count: int, total: Reals, w: Singles
) -> tuple[float, float, float]:
    """``w = degree z - total`` on a block, and its share of ``z.r``, ``z.w`` and ``z.s``."""
    a, b, c = 0.0, 0.0, 0.0
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        one = np.float64(z[k])
        v = degree[k] * one - total[np.uint64(i)]
        w[k] = v
        a += one * r[k]
        b += one * v
        c += one * s[k]
    return a, b, c


@njit(cache=True, nogil=True)
def black_residual(board: Board, b: Floats, x: Floats, r: Floats) -> float:
    """Relax the red cells exactly, and form the residual at the black ones; ``b`` and ``x`` of shape (2, places).

    Returns its norm.
    """
    blocks, squares = blocks_of(board), 0.0
    r[: board.margin] = 0.0
    r[len(r) - board.margin :] = 0.0
    total = np.empty(board.block)
    wave = _begin_wave(board)
    draw(board, x[1], wave.linked)
    for step in range(blocks + wave.ahead):
        to = _draw_into_red(board, wave, x[1], step)
        if step < blocks:
            begin, count = extent(board, step)
            _relax_both(board.red_inverse, b[0], begin, count, wave.red, to, x[0])
            _note(board, wave, begin, to)
        if step >= wave.ahead:
            begin, count = extent(board, step - wave.ahead)
            into_black(board, wave.red, wave.at[0], step - wave.ahead, total, ZERO)
            squares += _subtract(board.black_degree, b[1], x[1], begin, count, total, r)
    if len(board.links) == 0:
        return math.sqrt(squares)
    for m in range(len(board.links)):
        r[board.link_black[m]] += board.links[m] * wave.linked[m]
    return math.sqrt(_squares(r))


@njit(cache=True, nogil=True)
def residual_at_rest(board: Board, b: Floats, x: Floats, r: Floats) -> float:
    """The same from ``x = 0`` on: only conductances at red cells that are fed are read."""
    for k in range(x.shape[1]):
        x[0, k] = board.red_inverse[k] * b[0, k]
        r[k] = b[1, k]
    for block in range(blocks_of(board)):
        begin, count = extent(board, block)
        if np.any(x[0, begin : begin + count]):
            for q in range(len(board.distance)):
                spread(board.faces, q, begin, board.distance[q], count, x[0], r)
    for m in range(len(board.links)):
        r[board.link_black[m]] += board.links[m] * x[0, board.link_red[m]]
    return math.sqrt(_squares(r))


@inner_fast
def _squares(r: Floats) -> float:
    total = 0.0
    for k in range(len(r)):
        total += r[k] * r[k]
    return total


@inner_fast
def _relax_both(inverse: Reals, fed: Reals, begin: int, count: int, drawn: Reals, to: int, red: Reals) -> None:
    """``red = inverse (fed + drawn)``, put in place of what is drawn too."""
    at, d_at = np.uint64(begin), np.uint64(to)
    for i in range(count):
        k = np.uint64(i)
        v = inverse[at + k] * (fed[at + k] + drawn[d_at + k])
        red[at + k] = v
        drawn[d_at + k] = v


@inner_fast
def _subtract(degree: Reals, b: Reals, x: Reals, begin: int, count: int, total: Reals, r: Reals) -> float:
    """``r = b + total - degree x`` on a block; returns its squares, summed."""
    squares = 0.0
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        v = b[k] + (total[np.uint64(i)] - degree[k] * x[k])
        r[k] = v
        squares += v * v
    return squares
