"""Implicit steps in time of one length each, every one of them one or two solutions of a nodal system.

The three methods are backward Euler, the trapezoidal rule (both as in Nagel 1975, chapter 4) and TR-BDF2 (Bank,
Coughran, Fichtner, Grosse, Rose & Smith 1985), whose two stages share a matrix at ``gamma = 2 - sqrt(2)``.  All are
A-stable, so that a step is limited by accuracy alone; backward Euler and TR-BDF2 also damp what is too fast for the
step (L-stable).

A step solves for what it changes: ``(G + rate C) d = b - G x``, the currents that are out of balance on the right.
They vanish as the circuit settles, whereas ``rate C x`` grows as steps shrink, and what rounding leaves of its sum over
nodes that capacitors join would be charge that comes from nowhere.

Where no step is given, steps are as long as a tolerance allows: each is compared with two halves.  The first one comes
from the derivatives at 0+, which a linear circuit tells exactly.  Sources are constant from then on, so that every mode
is excited at 0+ and only dies out: a first step that is short enough for all that matters is what later ones grow from,
and no mode is ever jumped over.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.dynamics import Dynamics, slope
from resgrid.errors import AccuracyError, BudgetError
from resgrid.solvers.factors import Factor

Method = Literal["backward_euler", "trapezoidal", "tr-bdf2"]

_ROOT2 = float(np.sqrt(2.0))
_MOST_STEPS = 10_000_000
RTOL = 1e-11
"""Normwise backward error of every solution within a step."""

Factors = Callable[[float], Factor]
"""Factors of ``G + rate C``, by the rate."""

State = NDArray[np.float64]
"""Voltages of the rows, and their integrals since 0+; shape (2, n)."""


def rate_of(method: Method, h: float) -> float:
    """What capacitances count by in the matrix of a step, in 1/s; either stage of TR-BDF2 has the same."""
    return {"backward_euler": 1.0, "trapezoidal": 2.0, "tr-bdf2": 2.0 + _ROOT2}[method] / h


def advance(dynamics: Dynamics, method: Method, state: State, h: float, factors: Factors) -> State:
    """Make one step."""
    if not dynamics.size:
        return state
    (x, integral), factor = state, factors(rate_of(method, h))
    half = factor.solve(dynamics.imbalance(x, dynamics.drive), rtol=RTOL)
    if method != "tr-bdf2":
        return np.stack([x + (1.0 if method == "backward_euler" else 2.0) * half, integral + h * (x + half)])
    between, past = x + 2.0 * half, x + (_ROOT2 + 1.0) * half
    after = past + factor.solve(dynamics.imbalance(past, dynamics.drive), rtol=RTOL)
    return np.stack([after, integral + h * (_ROOT2 / 4.0 * (x + between) + (1.0 - _ROOT2 / 2.0) * after)])


def fixed_steps(
    dynamics: Dynamics, method: Method, state: State, times: NDArray[np.float64], step: float, factors: Factors
) -> Iterator[tuple[State, int]]:
    """States at times, and steps until then; intervals are divided evenly into steps no longer than ``step``.

    The trapezoidal rule begins with four backward Euler steps of half the length (Rannacher 1984).
    """
    taken, now = 0, 0.0
    for time in times.tolist():
        check_steps(taken + (time - now) / step)
        count = int(np.ceil((time - now) / step * (1.0 - 1e-12)))
        h = (time - now) / max(count, 1)
        for _ in range(count):
            if method == "trapezoidal" and taken < 2:
                middle = advance(dynamics, "backward_euler", state, h / 2, factors)
                state = advance(dynamics, "backward_euler", middle, h / 2, factors)
            else:
                state = advance(dynamics, method, state, h, factors)
            taken += 1
        now = time
        yield state, taken


def check_steps(count: float) -> None:
    """Refuse too many steps."""
    if count > _MOST_STEPS:
        raise BudgetError(
            f"this takes more than {_MOST_STEPS:,} steps; give a longer step, a shorter time or a larger tolerance"
        )


_ORDER = {"backward_euler": 1, "trapezoidal": 2, "tr-bdf2": 2}
_EPS = float(np.finfo(np.float64).eps)

_SHARE = 0.5
"""Largest share of the tolerance that one step may use up by its own estimate."""

_REACH = {"backward_euler": 2.0, "trapezoidal": 4.0, "tr-bdf2": np.inf}
"""Tolerances whose power ``(p + 1) / p`` one step of order ``p`` may use up: the errors of ``N`` steps add, and ``N``
grows as their ``-1 / (p + 1)``-th power.  The factor is what a decay leaves of them.  Errors of TR-BDF2 are
extrapolated away to leading order (which the trapezoidal rule, not being L-stable, would not survive)."""

_LEAST_SHARE = 16 * _EPS
_FUTILE = 30
"""Halvings in a row that leave too much of an error, after which it is rounding."""


def controlled_steps(
    dynamics: Dynamics, method: Method, state: State, times: NDArray[np.float64], tolerance: float, factors: Factors
) -> Iterator[tuple[State, int]]:
    """States at times, and steps until then, each of ``2**k`` seconds; the halves are kept.  Shapes: `times` (t,)."""
    order, share, end = _ORDER[method], _share(method, tolerance), float(times[-1])
    low, high = _range(dynamics, state)
    exponent = _first_exponent(dynamics, state[0], order, share, high - low, end)
    since = now = 0.0
    taken = halved = 0
    for time in times.tolist():
        while now < time:
            h = 2.0**exponent
            whole = advance(dynamics, method, state, h, factors)
            half = advance(dynamics, method, state, h / 2, factors)
            after = advance(dynamics, method, half, h / 2, factors)
            reached = _range(dynamics, half) if now + h / 2 <= end else (low, high)
            lowest, highest = min(low, reached[0]), max(high, reached[1])
            target = share * (highest - lowest)
            change = (after - whole) / (2**order - 1)
            error = float(np.abs(change[0]).max(initial=0.0))
            if error > target:
                if halved >= _FUTILE or now + h / 4 == now:
                    raise AccuracyError(
                        f"the voltages cannot be followed from {now:.3g} s on to tolerance = {tolerance:g}: rounding "
                        f"leaves {error:.1e} V of every step, however short; give a larger tolerance, or a step"
                    )
                exponent, halved = exponent - 1, halved + 1
                continue
            low, high, halved = lowest, highest, 0
            before, state = state, after + change if method == "tr-bdf2" else after
            taken += 2
            check_steps(taken)
            since, now = now, now + h
            if error * 2.0 ** (order + 1) * 1.5 <= target and h <= end - now:
                exponent += 1
        yield state if time == now else _between(before, half, state, (time - since) / h, h), taken


def _share(method: str, tolerance: float) -> float:
    """Share of the largest voltage difference that one step may be off by, by its own estimate."""
    share = min(_SHARE * tolerance, float((_REACH[method] * tolerance) ** (1.0 + 1.0 / _ORDER[method])))
    if share < _LEAST_SHARE:
        raise AccuracyError(
            f"rounding does not allow tolerance = {tolerance:g} by method = {method!r}, which takes too many steps for "
            "it; use method = 'tr-bdf2', or a larger tolerance"
        )
    return share


def _range(dynamics: Dynamics, state: State) -> tuple[float, float]:
    """Lowest and highest node voltage, rails included."""
    volts = dynamics.voltage(state[0])
    return float(np.nanmin(volts)), float(np.nanmax(volts))


def _first_exponent(
    dynamics: Dynamics, x: NDArray[np.float64], order: int, share: float, span: float, longest: float
) -> int:
    """Power of two, in seconds, of a step with ``h**(p + 1) |x^(p + 1)|`` a share of the largest voltage difference.

    That is the error of a step of order ``p`` but for its constant (Hairer, Norsett & Wanner 1993, section II.4).  In a
    circuit at 0 V the first step itself makes the largest difference, ``h |x'|``.
    """
    current, logs = dynamics.imbalance(x, dynamics.drive), []
    for _ in range(order + 1):
        rise = slope(dynamics, current)
        size = float(np.abs(rise).max(initial=0.0))
        if not 0.0 < size < np.inf:
            break
        logs.append(np.log(size))
        current = dynamics.imbalance(rise / size, 0.0)
    steps = [np.log(max(longest, np.finfo(np.float64).tiny))]
    if len(logs) == order + 1:
        at_rest = (np.log(share) + logs[0] - sum(logs)) / order
        steps.append(max(at_rest, (np.log(share * span) - sum(logs)) / (order + 1)) if span > 0.0 else at_rest)
    return int(np.floor(min(steps) / np.log(2.0)))


def _between(before: State, half: State, after: State, part: float, h: float) -> State:
    """The state within a step, on the parabola through its beginning, middle and end."""
    x, integral = before
    slope, bend = 4.0 * half[0] - 3.0 * x - after[0], 2.0 * (x - 2.0 * half[0] + after[0])
    moved = part * (slope / 2.0 + part * bend / 3.0)
    return np.stack([x + part * (slope + part * bend), integral + h * part * (x + moved)])
