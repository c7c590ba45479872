"""Time integration of circuits with memristors, with error control.

Steps of the Rosenbrock method end at the output times, at the corners of the waveform, and where a state reaches or
leaves a limit, so that the right-hand sides are smooth within every step.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.stepping import check_steps
from resgrid.circuit.transients.memristive_equations import MemristiveEquations, Point
from resgrid.circuit.transients.rosenbrock import ORDER, advance
from resgrid.circuit.transients.stamps import Vector
from resgrid.circuit.transients.waveforms import Drive, drive_at, next_corner
from resgrid.errors import AccuracyError
from resgrid.solvers.progress import Progress

_STEP_SHARE = 0.1
"""Largest estimated error of one step, as a fraction of the tolerance of the whole integration."""

_FIRST = 1e-3
"""Length of the first step, as a fraction of the time until the fastest state would have crossed its range."""

_GROWTH = 2.0
"""Largest product of the length of a step and the growth rate of a state at constant voltages."""

_LEAST_STEP = 1e-24
"""Smallest length of a step, as a fraction of the present time, below which the integration fails.

At time 0 the length proposed for the first step takes the place of the present time.  The end time would be a wrong
scale: states may change in a small fraction of a long transient.

Steps far below the resolution of the time are useful: a state is integrated over the length of the step, and close to a
limit it can change much in so short a time.
"""


class _Attempt(NamedTuple):
    """Result of one attempted step.

    `point`: unknowns after the step; `drift` (m,): drifts (time derivatives of the coordinates of the states) at the
    end of the step, in 1/s, 0 for states at rest; `error`: estimated error, 1 at the tolerance; `shorter`: length in
    seconds of a step that ends where a state reaches a limit or leaves it, None for a step that may be accepted.
    """

    point: Point
    drift: Vector
    error: float
    shorter: float | None


@dataclass(eq=False)
class Integration:
    """Time integration of one circuit.

    `equations`: the equations; `corners` (n, 2): corners of the waveform, times in seconds and factors; `tolerance`:
    error of the whole integration in states, and in voltages as a fraction of `span`; `end`: end time in seconds;
    `progress`: function called after every step; `steps`: number of accepted steps; `switched` (m,): first times of the
    state 0.5, in seconds, NaN before; `span`: largest voltage between two nodes so far, in volts.
    """

    equations: MemristiveEquations
    corners: NDArray[np.float64]
    tolerance: float
    end: float
    progress: Progress | None
    steps: int = 0
    switched: Vector = field(default_factory=lambda: np.empty(0))
    span: float = 0.0
    _began: float = field(default_factory=time.perf_counter)

    def states(self, start: Point, when: Vector) -> Iterator[Point]:
        """Yield the unknowns at every output time; `start`: unknowns at 0+; `when` (t,): output times in seconds."""
        self.switched = np.where(start.state == self.equations.coordinates.half, 0.0, np.nan)
        now, at, h = 0.0, start, np.inf
        for target in when.tolist():
            while now < target:
                now, at, h = self._step(now, at, h, min(target, next_corner(self.corners, now)))
                self._report(now)
            yield at

    def _step(self, now: float, at: Point, h: float, until: float) -> tuple[float, Point, float]:
        """Take one accepted step.

        Return the time and the unknowns after the step, and the proposed length of the next step.

        `now`: time in seconds; `at`: unknowns; `h`: proposed length in seconds, infinite for the first step; `until`:
        latest end of the step, in seconds.
        """
        drive = drive_at(self.corners, now, until)
        self._note_span(at, drive.value)
        drift = self._drift(at, drive)
        moving = self.equations.coordinates.can_move(at.state, drift)
        proposed = h if np.isfinite(h) else self._first_length(drift)
        used = min(proposed, self._longest(at, drive, drift, moving))
        least = _LEAST_STEP * (now or min(used, self.end))
        while True:
            is_last = used >= (until - now) * (1 - 1e-10)
            used = until - now if is_last else used
            tried = self._attempt(at, used, drive, moving, drift)
            pressed = self.equations.coordinates.pressed(at.state, tried.point.state) & (moving > 0)
            if tried.error > 1:
                proposed = used = used * _factor(tried.error)
            elif pressed.any():
                moving = np.where(pressed, 0.0, moving)
            elif tried.shorter is not None:
                used = tried.shorter
            else:
                break
            if used < least:
                raise AccuracyError(
                    f"the states after {now:.3g} s cannot be computed to tolerance = {self.tolerance:g}: the steps "
                    "become too short; choose a larger tolerance"
                )
        self.steps += 1
        check_steps(self.steps)
        self._note_switches(now, used, (at.state, tried.point.state), (drift * moving, tried.drift))
        after = until if is_last else now + used
        grown = used * _factor(tried.error)
        restored = self.equations.restore(tried.point, drive_at(self.corners, after).value)
        return after, restored, grown if used >= proposed else max(grown, proposed)

    def _first_length(self, drift: Vector) -> float:
        """Return the length of the first step, in seconds.

        `drift` (m,): time derivatives of the coordinates of states, in 1/s.
        """
        fastest = float(np.abs(drift).max(initial=0.0))
        return _FIRST * min(self.end, 1 / fastest if fastest > 0 else np.inf)

    def _longest(self, at: Point, drive: Drive, drift: Vector, moving: Vector) -> float:
        """Return the largest length of a step, in seconds: until a state reaches a limit, and short for fast growth.

        The limits of a state are 0 and 1.  `at`: unknowns; `drive`: waveform; `drift` (m,): time derivatives of the
        coordinates of states, in 1/s; `moving` (m,): 0 for states at rest.
        """
        growth = self.equations.largest_growth(at, drive, moving)
        ahead = self.equations.coordinates.time_to_limit(at.state, drift, moving)
        return min(ahead, _GROWTH / growth if growth > 0 else np.inf)

    def _attempt(self, at: Point, h: float, drive: Drive, moving: Vector, drift: Vector) -> _Attempt:
        """Return the result of a step of length `h` from the unknowns `at`.

        `drive`: waveform; `moving` (m,): 0 for states at rest; `drift` (m,): drifts before the step, in 1/s.
        """
        coordinates = self.equations.coordinates
        with np.errstate(all="ignore"):  # a step that is too long may pass a negative resistance
            point, error = advance(self.equations, at, h, drive, moving)
            final = self._drift(point, Drive(drive.value + h * drive.slope, drive.slope))
        largest = max(
            coordinates.steepest * float(np.abs(error.state).max(initial=0.0)),
            float(np.abs(error.voltage).max(initial=0.0)) / (self.span or 1.0),
        )
        if not (np.isfinite(largest) and np.isfinite(final).all()):
            return _Attempt(point, final, np.inf, None)
        shorter = coordinates.step_to_limit(at.state, point.state, drift, final, moving, h)
        return _Attempt(point, final * moving, largest / (_STEP_SHARE * self.tolerance), shorter)

    def _drift(self, at: Point, drive: Drive) -> Vector:
        """Return the time derivatives of the coordinates of all states in 1/s, (m,), as if none rested at a limit."""
        return self.equations.slope(at, drive, np.ones_like(at.state)).state

    def _note_span(self, at: Point, value: float) -> None:
        """Update `span`, the largest voltage between two nodes, with that of `at`; `value`: waveform of the sources."""
        volts = self.equations.at_nodes(at.voltage, value)
        self.span = max(self.span, float(np.nanmax(volts) - np.nanmin(volts)))

    def _note_switches(self, now: float, h: float, ends: tuple[Vector, Vector], drifts: tuple[Vector, Vector]) -> None:
        """Record the first time at which the state of every memristor is 0.5, by cubic Hermite interpolation in a step.

        `now`, `h`: beginning and length of the step, in seconds; `ends`, `drifts`: transformed states of the memristors
        (``coordinates.half`` stands for the state 0.5) and their time derivatives in 1/s, before and after the step.
        """
        x0, x1 = (end - self.equations.coordinates.half for end in ends)
        crossing = np.flatnonzero(np.isnan(self.switched) & (np.sign(x0) * np.sign(x1) <= 0) & (x0 != x1))
        if not crossing.size:
            return
        x0, x1, d0, d1 = x0[crossing], x1[crossing], h * drifts[0][crossing], h * drifts[1][crossing]
        low, high = np.zeros(len(crossing)), np.ones(len(crossing))
        for _ in range(50):
            s = (low + high) / 2
            x = x0 + s * (d0 + s * (3 * (x1 - x0) - 2 * d0 - d1 + s * (d0 + d1 - 2 * (x1 - x0))))
            has_passed = (x > 0) == (x1 > x0)
            low, high = np.where(has_passed, low, s), np.where(has_passed, s, high)
        self.switched[crossing] = now + h * (low + high) / 2

    def _report(self, now: float) -> None:
        """Call the progress function; `now`: time reached, in seconds."""
        if self.progress is not None:
            left = max(self.end - now, 0.0) / self.end
            elapsed = time.perf_counter() - self._began
            self.progress(self.steps, left, elapsed * left / (1 - left) if left < 1 else None)


def _factor(error: float) -> float:
    """Return the ratio of the next to the present length of a step; `error`: estimated error, 1 at the tolerance."""
    if not np.isfinite(error):
        return 0.1
    return float(np.clip(0.9 * max(error, 1e-10) ** (-1 / ORDER), 0.1, 4.0))
