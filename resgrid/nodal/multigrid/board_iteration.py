"""Flexible conjugate gradients on the black cells of a grid.

They run in double precision, preconditioned in single precision, until the recursive residual is small enough; then
the true one is formed, and if rounding has parted them, the next burst begins with it, search directions kept.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.multigrid import board_passes as passes
from resgrid.nodal.multigrid.board_cycle import Boards, cycle_boards
from resgrid.nodal.multigrid.grid_hierarchy import GridLevels
from resgrid.nodal.multigrid.kernels import norm
from resgrid.nodal.multigrid.stack import own_work
from resgrid.nodal.multigrid.stopping import DRIFT, LEAST_GAIN, MOST_ITERATIONS, ErrorBound
from resgrid.nodal.watch import Watch

_ROUNDING = 2.0**-52
_ENOUGH = 0.25
"""Residual after the first step of a K-cycle that spares the second."""

_SAFETY = 0.8


def iterate_on_board(
    levels: GridLevels,
    b: NDArray[np.float64],
    rtol: float,
    guess: NDArray[np.float64] | None,
    watch: Watch,
) -> tuple[NDArray[np.float64], float]:
    """As `resgrid.nodal.multigrid.iteration.iterate`, over the black cells of a grid."""
    error = ErrorBound(guess, rtol)
    true, unit = levels.true, levels.unit
    places = len(true.black_degree)
    x, currents = np.zeros((2, 2 * places))
    currents[levels.place] = b / unit
    x[levels.place] = 0.0 if guess is None else guess
    x, currents = x.reshape(2, places), currents.reshape(2, places)
    burst = _Burst(levels, error, watch)
    last, left = np.inf, MOST_ITERATIONS
    wanted, rounding = rtol * norm(b) / unit, _ROUNDING * _largest_degree(true)
    while True:
        size = passes.black_residual(true, currents, x, burst.r)
        goal = max(wanted, rounding * math.hypot(norm(x[0]), norm(x[1])))
        error.small &= size <= max(DRIFT * burst.left * last, goal)
        if error.small or not (size > goal and size < LEAST_GAIN * last and left > 0):
            return x.ravel()[levels.place], size * unit
        if not math.isfinite(last):
            watch.begin(size * unit, goal * unit)
        left -= burst.run(x, size, _SAFETY * goal / size, left)
        last = size


def _largest_degree(board: passes.Board) -> float:
    """Largest diagonal entry."""
    red = board.red_inverse
    return max(float(board.black_degree.max()), 1.0 / float(red.min(initial=np.inf, where=red > 0)))


class _Burst:
    """Some steps on the black cells; search directions outlive a burst."""

    def __init__(self, levels: GridLevels, error: ErrorBound, watch: Watch) -> None:
        self._levels, self._boards, self._stack = levels, _own_vectors(levels.boards), own_work(levels.stack)
        places = len(levels.aggregate)
        self._z, self._f, self._red = np.zeros((3, places), dtype=np.float32)
        self.r, self._p, self._s, self._w = np.zeros((4, places))
        self._energy = 0.0
        self._error, self._watch = error, watch
        self._begin = 2 * int(self._boards.places[1]) if len(self._boards.width) else 1 + len(self._stack.b)
        self._first = 0
        self.left = 1.0

    def run(self, x: NDArray[np.float64], size: float, gain: float, most: int) -> int:
        """Reduce the residual ``r``, of norm ``size``, by a factor ``gain``; returns the steps taken."""
        board, true, levels = self._levels.board, self._levels.true, self._levels
        passes.begin_burst(board.black_inverse, size, self.r, self._f, self._z)
        self.left, steps = 1.0, 0
        while self.left > gain and steps < most and not self._error.small:
            self._precondition()
            zr, zw, zs = passes.multiply(true, self._z, self.r, self._s, x[0], self._w)
            beta = -zs / self._energy if self._energy > 0.0 else 0.0
            self._energy = zw + beta * zs
            if not self._energy > 0.0:
                break
            alpha = zr / self._energy
            self.left = math.sqrt(
                passes.advance(
                    board.black_inverse, board.block * board.width, self._w, self._p, self._s, x[1], self.r, self._f,
                    self._z, beta, alpha, size,
                )
            )  # fmt: skip
            self._error.moved(self._p, alpha * size, alpha * zr * size * size * levels.unit)
            self._watch.step(self.left * size * levels.unit)
            steps += 1
        return steps

    def _precondition(self) -> None:
        levels, boards = self._levels, self._boards
        first = 2 * int(boards.places[1]) if len(boards.width) else len(boards.b)
        passes.restrict(levels.board, levels.aggregate, self._z, self._red, boards.b[:first])
        cycle_boards(boards, self._stack, _ENOUGH, self._first)
        passes.prolong(levels.board, levels.aggregate, boards.x[:first], self._f, self._red, self._z)


def _own_vectors(boards: Boards) -> Boards:
    """The same boards with work space of their own, so that one hierarchy can serve several solves at a time."""
    vectors = {name: np.zeros_like(getattr(boards, name)) for name in ("b", "x", "f", "z", "v", "c", "red")}
    return boards._replace(**vectors)
