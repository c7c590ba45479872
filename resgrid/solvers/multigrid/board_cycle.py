"""The cycle over coarse boards as one compiled loop.

A board is solved for its black nodes alone: red ones are eliminated exactly on the way down and put back on the way up.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from resgrid.jit import inner, inner_fast
from resgrid.solvers.multigrid.board_passes import (
    Board,
    Floats,
    Indices,
    Integers,
    Singles,
    add_into_black,
    relax_red,
)
from resgrid.solvers.multigrid.waves import prolong_and_multiply, restrict


class Boards(NamedTuple):
    """Coarse boards in single precision, one behind the other, with work space.

    Places of level ``l`` stand at ``places[l] ... places[l + 1]``, its links and faces at the corresponding
    stretches of their arrays; arrays over both colours have room for twice as many.

    `size`: nodes of the first level below the board that it preconditions: places of both colours, or a graph's
    nodes; `nodes`: nodes of the graph below the boards; `places, first_link` (levels + 1,); `margin, block`
    (levels,); `distance` (levels, 2 ndim); `aggregate`: node of the next level that a black place belongs to; graph
    nodes count from 1; `weight`: what it takes from there; empty where that is all
    (`resgrid.solvers.multigrid.graded`); `b, x`: currents and voltages of both colours, and of the graph's nodes behind
    them; `f, z, v, c, red`: work space over places: right-hand side and answer of the black nodes, products, first
    direction, red values. All work space, from ``b`` on, is empty but where a solve has given the boards its own;
    `visits` (levels + 2,): how often every level has been visited, and where an interrupted cycle goes on; `energy,
    alpha` (levels + 1,): products of the first steps.
    """

    size: int
    nodes: int
    places: Integers
    first_link: Integers
    margin: Integers
    block: Integers
    distance: Integers
    faces: Singles
    links: Singles
    link_red: Indices
    link_black: Indices
    red_inverse: Singles
    black_inverse: Singles
    black_degree: Singles
    aggregate: Indices
    weight: Singles
    b: Singles
    x: Singles
    f: Singles
    z: Singles
    v: Singles
    c: Singles
    red: Singles
    visits: Integers
    energy: Floats
    alpha: Floats


@inner
def _board(boards: Boards, level: int) -> Board:
    """One of the boards."""
    sides = boards.distance.shape[1]
    a, e = boards.places[level], boards.places[level + 1]
    k, m = boards.first_link[level], boards.first_link[level + 1]
    return Board(
        boards.faces[sides * a : sides * e].reshape((sides, e - a)),
        boards.distance[level],
        boards.margin[level],
        boards.block[level],
        boards.link_red[k:m],
        boards.link_black[k:m],
        boards.links[k:m],
        boards.red_inverse[a:e],
        boards.black_inverse[a:e],
        boards.black_degree[a:e],
    )


@inner
def _fold(board: Board, b: Singles, red: Singles, f: Singles, z: Singles) -> None:
    """Eliminate the red nodes: ``f`` is what the black ones are due, ``z`` its relaxation."""
    places = len(red)
    _times(board.red_inverse, b[:places], red)
    add_into_black(board, red, b[places:], f)
    _times(board.black_inverse, f, z)


@inner_fast
def _times(a: Singles, b: Singles, product: Singles) -> None:
    for k in range(len(product)):
        product[k] = a[k] * b[k]


@inner_fast
def _take_off(f: Singles, step: float, v: Singles) -> tuple[float, float]:
    """``f -= step v``; returns its squares before and after, summed."""
    before, after, share = 0.0, 0.0, np.float32(step)
    for k in range(len(f)):
        old = f[k]
        new = old - share * v[k]
        f[k] = new
        before += np.float64(old) * np.float64(old)
        after += np.float64(new) * np.float64(new)
    return before, after


@inner_fast
def _relax_anew(inverse: Singles, f: Singles, z: Singles, c: Singles) -> None:
    """``c = z`` and ``z = inverse f``."""
    for k in range(len(z)):
        c[k] = z[k]
        z[k] = inverse[k] * f[k]


@inner_fast
def _combine(a: float, x: Singles, b: float, y: Singles, out: Singles) -> None:
    one, other = np.float32(a), np.float32(b)
    for k in range(len(out)):
        out[k] = one * x[k] + other * y[k]


@inner
def _first_step(
    board: Board, stop: float, alpha: float, energy: float, f: Singles, z: Singles, c: Singles, v: Singles
) -> bool:
    """First step of the K-cycle along ``z``, whose product is ``v``; returns whether it suffices.

    Leaves the answer in ``z``, or else the direction in ``c`` and the relaxed residual in ``z``.
    """
    if not energy > 0.0:
        return True
    step = alpha / energy
    before, after = _take_off(f, step, v)
    if not after > stop * stop * before:
        _combine(step, z, 0.0, z, z)
        return True
    _relax_anew(board.black_inverse, f, z, c)
    return False


@inner
def _second_step(
    energy: float, alpha: float, rest: float, product: float, gamma: float, c: Singles, z: Singles
) -> None:
    """Second step, along ``z`` made conjugate to the first direction ``c``; leaves the answer in ``z``."""
    second = product - gamma * gamma / energy
    step = rest / second if second > 0.0 else 0.0
    _combine((alpha - gamma * step) / energy, c, step, z, z)


@inner
def _put_back(board: Board, b: Singles, z: Singles, x: Singles) -> None:
    """Voltages of the black nodes, and of the red ones that follow."""
    places = len(z)
    for k in range(places):
        x[places + k] = z[k]
    relax_red(board, b[:places], z, x[:places])


@njit(cache=True, nogil=True)
def cycle_boards(boards: Boards, coarsest: Singles, stop: float, first: int) -> bool:
    """Approximate ``x = A^-1 b`` on the first coarse level, by K-cycles from level ``first`` on.

    The K-cycle takes one or two steps of flexible conjugate gradients, each preconditioned by the cycle below; the
    second is spared where the first has brought the residual under ``stop`` times the right-hand side, twice that on
    every level further down (Notay & Vassilevski 2008).

    ``coarsest`` is the inverse of the matrix below the boards.  Where it is empty, graphs are there: the cycle returns
    False whenever they are to answer, and goes on when it is called again; it returns True when it is done.
    """
    count = len(boards.margin)
    visits, energy, alpha = boards.visits, boards.energy, boards.alpha
    level = visits[count + 1]
    while level >= 0:
        if level == count:
            nodes = 2 * boards.places[count] + 1
            if len(coarsest) > 0:
                _solve_coarsest(coarsest, boards.b[nodes:], boards.x[nodes:])
            elif visits[count] == 0:
                visits[count], visits[count + 1] = 1, count
                return False
            visits[count] = 0
            level -= 1
            continue
        board = _board(boards, level)
        a, e = boards.places[level], boards.places[level + 1]
        begin, below = 2 * a, 2 * e
        beyond = len(boards.b) if level + 1 == count else 2 * boards.places[level + 2]
        f, z, v, c, red = boards.f[a:e], boards.z[a:e], boards.v[a:e], boards.c[a:e], boards.red[a:e]
        aggregate, weight = boards.aggregate[a:e], boards.weight[a:e]
        b, x = boards.b[begin:below], boards.x[begin:below]
        visit, done = visits[level], False
        if visit == 0:
            _fold(board, b, red, f, z)
        elif visit == 1:
            alpha[level], energy[level], _ = prolong_and_multiply(
                board, board, aggregate, weight, boards.x[below:beyond], f, f, z, v
            )
            done = level < first or _first_step(board, stop * 2.0**level, alpha[level], energy[level], f, z, c, v)
        else:
            rest, product, gamma = prolong_and_multiply(
                board, board, aggregate, weight, boards.x[below:beyond], f, v, z, red
            )
            _second_step(energy[level], alpha[level], rest, product, gamma, c, z)
            done = True
        if done:
            _put_back(board, b, z, x)
            visits[level] = 0
            level -= 1
        else:
            visits[level] += 1
            restrict(board, aggregate, weight, z, boards.b[below:beyond])
            level += 1
    visits[count + 1] = 0
    return True


@inner_fast
def _solve_coarsest(inverse: Singles, b: Singles, x: Singles) -> None:
    for i in range(len(x)):
        total = np.float32(0.0)
        for j in range(len(b)):
            total += inverse[i, j] * b[j]
        x[i] = total
