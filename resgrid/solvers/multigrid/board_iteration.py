"""Flexible conjugate gradients on the black cells of a grid.

They run in bursts of at most five digits: after each the true residual is formed in double precision, and the next
begins with it, search directions kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.monitor import Watch
from resgrid.solvers.multigrid import board_passes as passes, waves
from resgrid.solvers.multigrid.grid_levels import GridLevels, cycle_levels, own_vectors
from resgrid.solvers.multigrid.hierarchy import Hierarchy
from resgrid.solvers.multigrid.kernels import norm
from resgrid.solvers.multigrid.place_kernels import put_at_places, take_from_places
from resgrid.solvers.multigrid.stack import own_work
from resgrid.solvers.multigrid.stopping import DRIFT, LEAST_GAIN, MOST_ITERATIONS, ErrorBound
from resgrid.solvers.multigrid.subnormals import subnormals_as_zero

_ROUNDING = 2.0**-52
_ENOUGH = 0.07
"""Residual after the first step of a K-cycle on the first coarse level that spares the second."""

_BURST = 1e-5
"""Gain of a burst from its largest residual on: vectors in single precision allow no more."""

_TOLD = 5e-7
"""Gain below which the residual that recursion leaves is rounding of single precision."""

_DEPTH = 3
"""Steps that are kept before they are gone."""

_LIFT = 2.0**64
"""Norm of a residual that is graded: it falls by as many decades as single precision spans."""

_SMOOTH = 0.1
"""Share of the residual allowed that a guess may leave: its error is smooth, and large beside its residual."""

_SAFETY = 0.95
"""The recursive residual is brought below the goal by this factor."""


def iterate_on_board(
    hierarchy: Hierarchy,
    grid: GridLevels,
    b: NDArray[np.float64],
    rtol: float,
    guess: NDArray[np.float64] | None,
    watch: Watch,
) -> tuple[NDArray[np.float64], float]:
    """As `resgrid.solvers.multigrid.iteration.iterate`, over the black cells of a grid."""
    unit, place = hierarchy.unit, grid.place
    places = len(grid.aggregate)
    x, currents = np.zeros((2, 2 * places))
    put_at_places(place, b, 1.0 / unit, currents)
    if guess is not None:
        put_at_places(place, guess, 1.0, x)
    equations = _Equations(currents.reshape(2, places), rtol * norm(b) / unit, at_rest=guess is None)
    size = _converge(hierarchy, grid, equations, x.reshape(2, places), ErrorBound(guess, rtol), watch)
    del equations, currents
    return take_from_places(place, x), size * unit


@dataclass(frozen=True, eq=False)
class _Equations:
    """Currents into the places of both colours, shape (2, places), and the residual that is small enough.

    ``at_rest`` says whether the iteration begins at 0.
    """

    currents: NDArray[np.float64]
    wanted: float
    at_rest: bool


def _converge(
    hierarchy: Hierarchy,
    grid: GridLevels,
    equations: _Equations,
    x: NDArray[np.float64],
    error: ErrorBound,
    watch: Watch,
) -> float:
    """Improve ``x`` in place until the residual is small enough or rounding forbids more; returns its norm."""
    burst = _Burst(hierarchy, grid, error, watch)
    last, left, unit = np.inf, MOST_ITERATIONS, hierarchy.unit
    rounding = _ROUNDING * grid.largest_degree
    while True:
        at_rest = equations.at_rest and not math.isfinite(last)
        residual = waves.residual_at_rest if at_rest else waves.black_residual
        size = residual(grid.true, equations.currents, x, burst.residual)
        goal = equations.wanted if equations.at_rest or math.isfinite(last) else _SMOOTH * equations.wanted
        if size > goal and not at_rest:
            goal = max(goal, rounding * math.hypot(norm(x[0]), norm(x[1])))
        error.small &= size <= max(DRIFT * burst.left * last, goal)
        if error.small or not (size > goal and size < LEAST_GAIN * last and left > 0):
            return size
        if not math.isfinite(last):
            watch.begin(size * unit, goal * unit)
        if size > DRIFT * burst.left * last or burst.left < _TOLD:
            burst.forget()
        left -= burst.run(x, size, _SAFETY * goal / size, left)
        last = size


class _Burst:
    """Some steps on the black cells; search directions outlive a burst.

    Vectors are in single precision, but for the answer: it is summed from the preconditioned residuals at the end,
    so that what the recursive residual stands for is known to all digits.
    """

    def __init__(self, hierarchy: Hierarchy, grid: GridLevels, error: ErrorBound, watch: Watch) -> None:
        self._grid, self._boards, self._stack = grid, own_vectors(grid.boards), own_work(hierarchy.stack)
        self._unit = hierarchy.unit
        self._lift = _LIFT if len(grid.weight) else 1.0
        places = len(grid.aggregate)
        self._p = np.zeros(places)
        self._s, self._w = np.zeros((2, places), dtype=np.float32)
        self._r, self._z = np.empty(places, dtype=np.float32), np.empty((_DEPTH, places), dtype=np.float32)
        # Between bursts, the true residual stands where the last steps will be kept.
        self.residual = self._z[-2:].reshape(-1).view(np.float64)
        self._on_x, self._on_p = np.zeros((2, _DEPTH + 1))
        self._on_p[-1] = 1.0
        self._count = 0
        self._energy = 0.0
        self._error, self._watch = error, watch
        self.left = 1.0

    def forget(self) -> None:
        """Drop the last direction: a residual that is not what recursion left is not orthogonal to it."""
        self._energy = 0.0

    def run(self, x: NDArray[np.float64], size: float, gain: float, most: int) -> int:
        """Reduce the residual, of norm ``size``, by a factor ``gain``; returns the steps taken.

        Vectors are in units of ``one`` times the conductances'.
        """
        board = self._grid.board
        one = size / self._lift
        passes.begin_burst(board.black_inverse, one, self.residual, self._r, self._z[0])
        self.left, peak, steps = 1.0, 1.0, 0
        while self.left > max(gain, _BURST * peak) and steps < most and not self._error.small:
            zr, zw, zs = self._precondition(self._z[self._count])
            beta = -zs / self._energy if self._energy > 0.0 else 0.0
            self._energy = zw + beta * zs
            if not self._energy > 0.0:
                break
            alpha = zr / self._energy
            self._note(beta, alpha)
            self._error.moved(alpha * zr * one * one, partial(self._step, abs(alpha) * one))
            if self._count == _DEPTH:
                self._gather(x[1], one)
            inverse, z = board.black_inverse, self._z[self._count]
            self.left = math.sqrt(passes.advance(inverse, self._w, self._s, self._r, z, beta, alpha)) / self._lift
            peak = max(peak, self.left)
            self._watch.step(self.left * size * self._unit)
            steps += 1
        self._gather(x[1], one)
        return steps

    def _precondition(self, z: NDArray[np.float32]) -> tuple[float, float, float]:
        """Precondition the residual, relaxed in ``z``, and multiply: ``w = S z``; returns ``z.r, z.w, z.s``."""
        grid, boards = self._grid, self._boards
        with subnormals_as_zero():
            waves.restrict(grid.board, grid.aggregate, grid.weight, z, boards.b[: boards.size])
            cycle_levels(boards, self._stack, _ENOUGH)
            return waves.prolong_and_multiply(
                grid.board, grid.exact, grid.aggregate, grid.weight, boards.x[: boards.size],
                self._r, self._s, z, self._w,
            )  # fmt: skip

    def _note(self, beta: float, alpha: float) -> None:
        """Note a step ``alpha`` along the direction ``z + beta p``."""
        self._on_p *= beta
        self._on_p[self._count] = 1.0
        self._on_x += alpha * self._on_p
        self._count += 1

    def _step(self, factor: float) -> float:
        """Largest move of a voltage, so many times that of the last direction."""
        return factor * float(passes.largest_step(self._z[: self._count], *self._used(self._on_p), self._p))

    def _used(self, shares: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        return shares[: self._count], float(shares[-1])

    def _gather(self, x: NDArray[np.float64], size: float) -> None:
        """Go the steps noted."""
        passes.gather_steps(self._z[: self._count], *self._used(self._on_x), *self._used(self._on_p), size, self._p, x)
        self._on_x[:], self._on_p[:], self._count = 0.0, 0.0, 0
        self._on_p[-1] = 1.0
