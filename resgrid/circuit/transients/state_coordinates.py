"""Coordinates ``s`` in which the states of memristors are integrated, ``ds/dt = k i phi(s)``, and their limits.

Here ``k`` is the rate of the law, in 1/C, and ``i`` the current through the memristor, in amperes.  With the
rectangular window ``s`` is the state ``x`` itself and ``phi = 1``; a state that reaches 0 or 1 rests there until the
current changes its direction.  With the Joglekar window ``s = log(x / (1 - x))``.  The window ``1 - (2 x - 1)**(2 p)``
equals ``4 x (1 - x)`` times the sum of ``(2 x - 1)**(2 j)`` for ``j`` from 0 to ``p - 1``.  The factor ``phi`` is that
sum times 4: it has no zero, and the distance to a limit keeps its relative accuracy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from resgrid.circuit.transients.memristors import Memristor
from resgrid.circuit.transients.stamps import Vector

_AT_LIMIT = 1e-12
"""Distance to 0 or 1 below which a state is at this limit."""


class Coordinates(NamedTuple):
    """Coordinates of the states of memristors, for one law: the state itself or, without limits, its logit.

    `has_limits`: whether the coordinate is the state, with the limits 0 and 1; `half`: coordinate of the state 0.5;
    `steepest`: largest derivative of a state with respect to its coordinate; `exponent`: exponent of the window.
    """

    has_limits: bool
    half: float
    steepest: float
    exponent: int

    @classmethod
    def of(cls, law: Memristor) -> Coordinates:
        """Return the coordinates for the window of a law: the state (rectangular), or its logit (Joglekar)."""
        return cls(True, 0.5, 1.0, 0) if law.window == "rectangular" else cls(False, 0.0, 0.25, law.exponent)

    def from_state(self, state: Vector) -> Vector:
        """Return the coordinates (m,) of states (m,): the states themselves, or their logits."""
        return state.copy() if self.has_limits else np.asarray(logit(state))

    def to_state(self, s: Vector) -> Vector:
        """Return the states (m,) of coordinates (m,); slightly outside of [0, 1] within a step that passes a limit."""
        return s if self.has_limits else np.asarray(expit(s))

    def state_slope(self, s: Vector) -> Vector:
        """Return the derivatives of the states with respect to the coordinates, (m,)."""
        return np.ones_like(s) if self.has_limits else np.asarray(expit(s) * expit(-s))

    def mobility(self, s: Vector) -> Vector:
        """Return the factors ``phi`` (m,), without unit, in ``ds/dt = k i phi(s)``.

        ``k``: rate of the law, in 1/C; ``i``: current in amperes; `s` (m,): coordinates of the states.
        """
        if self.has_limits:
            return np.ones_like(s)
        away = 2 * np.asarray(expit(s)) - 1
        return np.asarray(4 * sum(away ** (2 * j) for j in range(self.exponent)))

    def mobility_slope(self, s: Vector) -> Vector:
        """Return the derivatives of the factors ``phi`` in ``ds/dt = k i phi(s)`` with respect to ``s``, (m,)."""
        if self.exponent < 2:
            return np.zeros_like(s)
        away = 2 * np.asarray(expit(s)) - 1
        bend = sum(2 * j * away ** (2 * j - 1) for j in range(1, self.exponent))
        return np.asarray(8 * bend * self.state_slope(s))

    def can_move(self, s: Vector, drift: Vector) -> Vector:
        """Return 0 for states that rest at a limit, and 1 for others, (m,).

        `s` (m,): coordinates; `drift` (m,): their time derivatives, in 1/s.
        """
        if not self.has_limits:
            return np.ones_like(s)
        rests = ((s <= _AT_LIMIT) & (drift < 0)) | ((s >= 1 - _AT_LIMIT) & (drift > 0))
        return np.where(rests, 0.0, 1.0)

    def time_to_limit(self, s: Vector, drift: Vector, moving: Vector) -> float:
        """Return the time in seconds until the first state reaches a limit at constant drifts, infinite without one.

        `s` (m,): coordinates; `drift` (m,): their time derivatives, in 1/s; `moving` (m,): 0 for states that rest at a
        limit.
        """
        if not self.has_limits:
            return np.inf
        ways = np.where(drift > 0, 1 - s, s)
        heading = (moving > 0) & (drift != 0) & (ways > _AT_LIMIT)
        return float(np.min(ways[heading] / np.abs(drift[heading]), initial=np.inf))

    def pressed(self, before: Vector, after: Vector) -> NDArray[np.bool_]:
        """Return the mask (m,) of states that begin a step at a limit and end it outside of this limit.

        `before`, `after` (m,): coordinates before and after the step.
        """
        low, high = _outside(after)
        return self.has_limits & ((low & (before <= _AT_LIMIT)) | (high & (before >= 1 - _AT_LIMIT)))

    def step_to_limit(
        self, before: Vector, after: Vector, drift: Vector, final: Vector, moving: Vector, h: float
    ) -> float | None:
        """Return the length of a step that ends at the first limit that a state passes in a step, None without one.

        A step also ends where a state that rests at a limit begins to leave it.  `before`, `after` (m,): coordinates;
        `drift`, `final` (m,): drifts at both ends, in 1/s; `moving` (m,): 0 for states at rest; `h`: length in seconds.
        """
        if not self.has_limits:
            return None
        low, high = _outside(after)
        passed = (moving > 0) & (low | high)
        distance = np.where(high, 1 - before, -before)[passed] / (after - before)[passed]
        inward = np.where(before > self.half, -final, final)
        leaving = (moving == 0) & (inward * h > _AT_LIMIT)
        resting = np.where(before > self.half, -drift, drift)[leaving]
        turning = np.clip(resting / (resting - inward[leaving]), 0.1, 0.9)
        part = np.concatenate([distance, turning])
        return h * float(part.min()) if part.size else None


def _outside(s: Vector) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the masks (m,) of states below 0 and above 1."""
    return s < -_AT_LIMIT, s > 1 + _AT_LIMIT
