"""Compiled loops for many chips of one grid: the conductances of the next chip, and its conjugate gradients.

They release the interpreter's lock, so that threads solve chips side by side.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.solvers.multigrid.board_cycle import Boards, cycle_boards
from resgrid.solvers.multigrid.board_passes import (
    Board,
    Singles,
    advance,
    begin_burst,
    gather_steps,
)
from resgrid.solvers.multigrid.board_setup import compensate
from resgrid.solvers.multigrid.waves import black_residual, prolong_and_multiply, restrict

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]
Integers = NDArray[np.int64]

_LEAST_GAIN = 0.5
_ROUNDING = 2.0**-52
_SAFETY = 0.8
_BURST = 1e-6
_ENOUGH = 0.07
_TOLD = 5e-7


@njit(cache=True, nogil=True)
def refill(
    indptr: Indices, conductance: Floats, excess: Floats, face: Integers, place: Indices, unit: float, true: Board,
    board: Board, exact: Board, leak: Floats,
) -> float:  # fmt: skip
    """Write the conductances of a chip onto its boards; returns its largest diagonal entry, in units.

    ``face`` says where an entry of a red row belongs: its face, or -1 less its link; ``leak`` of shape (2, places)
    receives what leads to the rails.
    """
    scale, largest, places, leaks = 1.0 / unit, 0.0, len(true.black_degree), leak.ravel()
    for i in range(len(place)):
        here, degree = place[i], excess[i] * scale
        leaks[here] = degree
        for k in range(indptr[i], indptr[i + 1]):
            g = conductance[k] * scale
            degree += g
            if here < places:
                if face[k] >= 0:
                    true.faces[face[k], here] = g
                    board.faces[face[k], here] = g
                else:
                    true.links[-1 - face[k]] = g
                    board.links[-1 - face[k]] = g
        largest = max(largest, degree)
        if here < places:
            true.red_inverse[here] = 1.0 / degree
            board.red_inverse[here] = 1.0 / degree
        else:
            true.black_degree[here - places] = degree
            board.black_inverse[here - places] = 1.0 / degree
    compensate(
        board.faces, board.distance, board.margin, board.link_red, board.link_black, board.links, board.red_inverse,
        leak, exact.black_degree,
    )  # fmt: skip
    return largest


@njit(cache=True, nogil=True)
def solve_board(
    true: Board, board: Board, exact: Board, aggregate: Indices, boards: Boards, coarsest: Singles, place: Indices,
    b: Floats, largest: float, ordinary: float, rtol: float, most: int, start: Floats, solution: Floats,
    vectors: Floats, singles: Singles, z: Singles,
) -> tuple[float, float]:  # fmt: skip
    """Solve from a start until the residual is ``rtol |b|`` or rounding forbids more; returns the norms of both.

    As `resgrid.solvers.multigrid.board_iteration`, in one piece, and with all steps of a burst kept.  ``largest`` is
    the largest diagonal entry; a row whose own exceeds an ``ordinary`` one counts for so much less in ``|b|``.
    ``vectors`` and ``singles`` are work space of three times two and of three rows of places, ``z`` of one more than
    steps are kept.
    """
    x, currents, residual, p = vectors[0], vectors[1], vectors[2, 0], vectors[2, 1]
    r, s, w = singles[0], singles[1], singles[2]
    p[:], s[:] = 0.0, 0.0
    flat_x, flat_b, squares = x.ravel(), currents.ravel(), 0.0
    for i in range(len(place)):
        flat_x[place[i]] = start[i]
        flat_b[place[i]] = b[i]
        black = place[i] - len(true.black_degree)
        degree = true.black_degree[black] if black >= 0 else 1.0 / true.red_inverse[place[i]]
        share = b[i] * min(1.0, ordinary / degree)
        squares += share * share
    depth, energy, last = len(z) - 1, 0.0, np.inf
    on_x, on_p = np.zeros(depth), np.zeros(depth)
    wanted, rounding = rtol * math.sqrt(squares), _ROUNDING * largest
    while True:
        size = black_residual(true, currents, x, residual)
        goal = max(wanted, rounding * math.sqrt(np.dot(flat_x, flat_x)))
        if not (size > goal and size < _LEAST_GAIN * last and most > 0):
            break
        begin_burst(board.black_inverse, size, residual, r, z[0])
        left, count, before_x, before_p = 1.0, 0, 0.0, 1.0
        gain, peak = _SAFETY * goal / size, 1.0
        while left > max(gain, _BURST * peak) and most > 0 and count < depth:
            restrict(board, aggregate, boards.weight, z[count], boards.b[: boards.size])
            cycle_boards(boards, coarsest, _ENOUGH, 0)
            zr, zw, zs = prolong_and_multiply(
                board, exact, aggregate, boards.weight, boards.x[: boards.size], r, s, z[count], w
            )
            beta = -zs / energy if energy > 0.0 else 0.0
            energy = zw + beta * zs
            if not energy > 0.0:
                break
            on_p[:count] *= beta
            on_p[count], before_p = 1.0, beta * before_p
            count += 1
            on_x[:count] += zr / energy * on_p[:count]
            before_x += zr / energy * before_p
            left = math.sqrt(advance(board.black_inverse, w, s, r, z[count], beta, zr / energy))
            peak = max(peak, left)
            most -= 1
        gather_steps(z[:count], on_x, before_x, on_p, before_p, size, p, x[1])
        on_x[:] = 0.0
        last = size
        if left < _TOLD:
            energy = 0.0
    for i in range(len(place)):
        solution[i] = flat_x[place[i]]
    return size, wanted
