"""Compiled loops for many chips of one grid: the conductances of the next chip, and its conjugate gradients.

They release the interpreter's lock, so that threads solve chips side by side.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.nodal.multigrid.checkerboard_kernels import (
    Board,
    add_black,
    advance,
    black_residual,
    multiply,
    prolong,
    restrict,
)
from resgrid.nodal.multigrid.kernels import Stack, cycle

Floats = NDArray[np.float64]
Unsigned = NDArray[np.uint32]
Integers = NDArray[np.int64]

_BURST = 1e-5
_LEAST_GAIN = 0.5
_ROUNDING = 2.0**-52


@njit(cache=True, nogil=True)
def refill(
    indptr: Unsigned, conductance: Floats, excess: Floats, face: Integers, place: Integers, unit: float, board: Board,
    inverse: Floats,
) -> float:  # fmt: skip
    """Write the conductances of a chip onto the board; returns its largest diagonal entry, in siemens.

    ``face`` says where an entry of a red row belongs: its face, or -1 less its wrap.
    """
    faces, scale = board.faces, 1.0 / unit
    largest = 0.0
    for i in range(len(place)):
        here = place[i]
        true, stored = excess[i], excess[i] * scale
        for k in range(indptr[i], indptr[i + 1]):
            single = np.float32(conductance[k] * scale)
            true += conductance[k]
            stored += single
            if here < 0:
                if face[k] >= 0:
                    faces[face[k], -1 - here] = single
                else:
                    board.wrap_conductance[-1 - face[k]] = single
        largest = max(largest, true)
        if here < 0:
            inverse[i] = 1.0 / true
            board.red_inverse[-1 - here] = 1.0 / stored
        else:
            board.black_degree[here] = stored
            board.black_inverse[here] = np.float32(1.0 / stored)
    return largest


@njit(cache=True, nogil=True)
def solve_board(
    board: Board, stack: Stack, indptr: Unsigned, indices: Unsigned, conductance: Floats, excess: Floats,
    inverse: Floats, place: Integers, reach: int, unit: float, degree: float, b: Floats, rtol: float, most: int,
    x: Floats, doubles: Floats, singles: NDArray[np.float32],
) -> float:  # fmt: skip
    """Improve ``x`` until the residual is ``rtol |b|`` or rounding forbids more; returns the norm of the residual.

    As `resgrid.nodal.multigrid.iteration`, in one piece.  ``doubles`` and ``singles`` are work space of 6 and 2 rows
    of places.
    """
    r, correction, p, s, w, double = doubles[0], doubles[1], doubles[2], doubles[3], doubles[4], doubles[5]
    z, red = singles[0], singles[1]
    doubles[:] = 0.0
    singles[:] = 0.0
    wanted, energy, last = rtol * math.sqrt(np.dot(b, b)), 0.0, np.inf
    while True:
        size = black_residual(indptr, indices, conductance, excess, inverse, place, reach, b, x, r)
        goal = max(wanted, _ROUNDING * degree * math.sqrt(np.dot(x, x)))
        if not (size > goal and size < _LEAST_GAIN * last and most > 0):
            return size
        gain = max(_BURST, 0.8 * goal / size)
        for k in range(len(r)):
            correction[k] = 0.0
            r[k] /= size
            z[k] = np.float32(board.black_inverse[k] * r[k])
        left = 1.0
        while left > gain and most > 0:
            _precondition(board, stack, r, red, z)
            zr, zw, zs = multiply(board, z, r, s, double, w)
            beta = -zs / energy if energy > 0.0 else 0.0
            energy = zw + beta * zs
            if not energy > 0.0:
                break
            left = math.sqrt(advance(board, z, w, p, s, correction, r, beta, zr / energy))
            most -= 1
        add_black(place, correction, size / unit, x)
        last = size


@njit(cache=True, nogil=True)
def _precondition(board: Board, stack: Stack, r: Floats, red: NDArray[np.float32], z: NDArray[np.float32]) -> None:
    first = stack.first[1]
    restrict(board, z, red, stack.b[:first])
    cycle(stack, 0.25, 1)
    prolong(board, stack.x[:first], r, red, z)
