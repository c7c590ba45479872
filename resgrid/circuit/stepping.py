"""Implicit steps in time of one length each, every one of them one or two solutions of a nodal system.

The three methods are backward Euler, the trapezoidal rule (both as in Nagel 1975, chapter 4) and TR-BDF2 (Bank,
Coughran, Fichtner, Grosse, Rose & Smith 1985), whose two stages share a matrix at ``gamma = 2 - sqrt(2)``.  All are
A-stable, so that a step is limited by accuracy alone; backward Euler and TR-BDF2 also damp what is too fast for the
step (L-stable).

A step solves for what it changes: ``(G + rate C) d = b - G x``, the currents that are out of balance on the right.
They vanish as the circuit settles, whereas ``rate C x`` grows as steps shrink, and what rounding leaves of its sum over
nodes that capacitors join would be charge that comes from nowhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.dynamics import Dynamics, factor_resolvent
from resgrid.errors import BudgetError
from resgrid.solvers.factors.factor import Factor

METHODS = ("backward_euler", "trapezoidal", "tr-bdf2")

_ROOT2 = float(np.sqrt(2.0))
_MOST_STEPS = 10_000_000
_KEPT = 4
_RTOL = 1e-11

Solve = Callable[[float, NDArray[np.float64]], NDArray[np.float64]]

State = tuple[NDArray[np.float64], NDArray[np.float64], int]
"""State, its integral since 0+, and the number of steps taken."""


class Resolvents:
    """Solves ``(G + rate C) x = rhs``; the factors of the last few rates are kept.

    `made`: how many matrices were factored.
    """

    def __init__(self, dynamics: Dynamics, solver: str) -> None:
        self._dynamics, self._solver = dynamics, solver
        self._factors: dict[float, Factor] = {}
        self.made = 0

    def __call__(self, rate: float, rhs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Solve for one right-hand side."""
        if not len(rhs):
            return rhs
        factors = self._factors.pop(rate, None)
        if factors is None:
            factors = factor_resolvent(self._dynamics, rate, self._solver)
            self.made += 1
            while len(self._factors) >= _KEPT:
                del self._factors[next(iter(self._factors))]
        self._factors[rate] = factors
        return factors.solve(rhs, rtol=_RTOL)


def advance(
    dynamics: Dynamics, method: str, x: NDArray[np.float64], h: float, solve: Solve
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Make one step.  Shapes: `x` (n,); returns `after` (n,), `integral` (n,)."""
    if method == "backward_euler":
        after = x + solve(1.0 / h, dynamics.imbalance(x))
        return after, h * after
    if method == "trapezoidal":
        half = solve(2.0 / h, dynamics.imbalance(x))
        return x + 2.0 * half, h * (x + half)
    rate = (2.0 + _ROOT2) / h
    half = solve(rate, dynamics.imbalance(x))
    between, past = x + 2.0 * half, x + (_ROOT2 + 1.0) * half
    after = past + solve(rate, dynamics.imbalance(past))
    return after, h * (_ROOT2 / 4.0 * (x + between) + (1.0 - _ROOT2 / 2.0) * after)


def advance_by_sums(dynamics: Dynamics, x: NDArray[np.float64], h: float, solve: Solve) -> NDArray[np.float64]:
    """State after one step of backward Euler, found without a subtraction where every capacitor goes to a rail.

    Voltages of one sign that span many decades keep their relative accuracy then, each of them.  Nothing is lost by
    rounding either, for ``rate C x`` holds nothing that would have to cancel.
    """
    return solve(1.0 / h, dynamics.capacitance.diagonal * x / h + dynamics.drive)


def fixed_steps(
    dynamics: Dynamics, method: str, x: NDArray[np.float64], times: NDArray[np.float64], step: float, solve: Solve
) -> Iterator[State]:
    """States at times, every interval between them divided evenly into steps no longer than ``step``.

    The trapezoidal rule begins with four backward Euler steps of half the length (Rannacher 1984).
    """
    integral = np.zeros_like(x)
    taken, now = 0, 0.0
    for time in times.tolist():
        check_steps(taken + (time - now) / step)
        count = int(np.ceil((time - now) / step * (1.0 - 1e-12)))
        h = (time - now) / max(count, 1)
        for _ in range(count):
            damped = method == "trapezoidal" and taken < 2
            for length in (h / 2, h / 2) if damped else (h,):
                x, part = advance(dynamics, "backward_euler" if damped else method, x, length, solve)
                integral = integral + part
            taken += 1
        now = time
        yield x, integral, taken


def check_steps(count: float) -> None:
    """Refuse too many steps."""
    if count > _MOST_STEPS:
        raise BudgetError(
            f"this takes more than {_MOST_STEPS:,} steps; give a longer step, a shorter time or a larger tolerance"
        )
