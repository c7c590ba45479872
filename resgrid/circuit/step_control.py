"""Steps as long as a tolerance allows: each is compared with two halves.

The first step comes from the derivatives at 0+, which a linear circuit tells exactly.  Sources are constant from then
on, so that every mode is excited at 0+ and only dies out: a first step that is short enough for all that matters is
what later ones grow from, and no mode is ever jumped over.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.charges import Charges
from resgrid.circuit.dynamics import Dynamics
from resgrid.circuit.stepping import Solve, State, advance, check_steps
from resgrid.errors import AccuracyError

_ORDER = {"backward_euler": 1, "trapezoidal": 2, "tr-bdf2": 2}
_EPS = float(np.finfo(np.float64).eps)

_SHARE = 0.5
"""Largest share of the tolerance that one step may use up by its own estimate."""

_REACH = {"backward_euler": 2.0, "trapezoidal": 4.0}
"""Tolerances whose power ``(p + 1) / p`` one step of order ``p`` may use up: the errors of ``N`` steps add, and ``N``
grows as their ``-1 / (p + 1)``-th power.  The factor is what a decay leaves of them.  Errors of TR-BDF2 are
extrapolated away to leading order (which the trapezoidal rule, not being L-stable, would not survive)."""

_LEAST_SHARE = 16 * _EPS
_FUTILE = 8
"""Halvings in a row that do not halve the error, after which it is rounding."""


def controlled_steps(
    charges: Charges, method: str, x: NDArray[np.float64], times: NDArray[np.float64], tolerance: float, solve: Solve
) -> Iterator[State]:
    """States at times, by steps of ``2**k`` seconds; the halves are kept.  Shapes: `x` (n,), `times` (t,)."""
    dynamics, order = charges.dynamics, _ORDER[method]
    share = _share(method, tolerance)
    low, high = _range(dynamics, x)
    end = float(times[-1])
    exponent = _first_exponent(charges, x, order, share, high - low, end)
    integral = np.zeros_like(x)
    now, taken, futile, before = 0.0, 0, 0, np.inf
    waiting = times.tolist()
    while waiting:
        while waiting and waiting[0] <= now:
            yield x, integral, taken
            waiting.pop(0)
        if not waiting:
            return
        h = 2.0**exponent
        whole, at_once = advance(dynamics, method, x, h, solve)
        half, first = advance(dynamics, method, x, h / 2, solve)
        after, second = advance(dynamics, method, half, h / 2, solve)
        increment = first + second
        reached = _range(dynamics, half) if now + h / 2 <= end else (low, high)
        lowest, highest = min(low, reached[0]), max(high, reached[1])
        target = share * (highest - lowest)
        error = float(np.abs(whole - after).max(initial=0.0)) / (2**order - 1)
        if before < np.inf:
            futile = futile + 1 if error > 0.5 * before else 0
        before = np.inf
        if error > target:
            if futile >= _FUTILE or now + h / 4 == now:
                raise AccuracyError(
                    f"the voltages cannot be followed from {now:.3g} s on to tolerance = {tolerance:g}: rounding "
                    f"leaves {error:.1e} V of every step, however short; give a larger tolerance, or a step"
                )
            exponent, before = exponent - 1, error
            continue
        low, high = lowest, highest
        if method == "tr-bdf2":
            after = after + (after - whole) / (2**order - 1)
            increment = increment + (increment - at_once) / (2**order - 1)
        taken += 2
        check_steps(taken)
        while waiting and waiting[0] < now + h:
            part = (waiting.pop(0) - now) / h
            yield *_between(x, half, after, integral, part, h), taken
        x, integral, now = after, integral + increment, now + h
        if error * 2.0 ** (order + 1) * 1.5 <= target and h <= end - now:
            exponent, futile = exponent + 1, 0


def _share(method: str, tolerance: float) -> float:
    """Share of the largest voltage difference that one step may be off by, by its own estimate."""
    share = _SHARE * tolerance
    if method in _REACH:
        order = _ORDER[method]
        share = min(share, (_REACH[method] * tolerance) ** ((order + 1) / order))
    if share < _LEAST_SHARE:
        raise AccuracyError(
            f"rounding does not allow tolerance = {tolerance:g} by method = {method!r}, which takes too many steps for "
            "it; use method = 'tr-bdf2', or a larger tolerance"
        )
    return share


def _range(dynamics: Dynamics, x: NDArray[np.float64]) -> tuple[float, float]:
    """Lowest and highest node voltage, rails included."""
    volts = dynamics.voltage(x)
    return float(np.nanmin(volts)), float(np.nanmax(volts))


def _first_exponent(
    charges: Charges, x: NDArray[np.float64], order: int, share: float, span: float, longest: float
) -> int:
    """Power of two, in seconds, of a step with ``h**(p + 1) |x^(p + 1)|`` a share of the largest voltage difference.

    That is the error of a step of order ``p`` but for its constant (Hairer, Norsett & Wanner 1993, section II.4).  In a
    circuit at 0 V the first step itself makes the largest difference, ``h |x'|``.
    """
    current, logs = charges.dynamics.imbalance(x), []
    for _ in range(order + 1):
        slope = charges.slope(current)
        size = float(np.abs(slope).max(initial=0.0))
        if not 0.0 < size < np.inf:
            break
        logs.append(np.log(size))
        current = -charges.dynamics.conductance.times(slope / size)
    steps = [np.log(max(longest, np.finfo(np.float64).tiny))]
    if len(logs) == order + 1:
        at_rest = (np.log(share) + logs[0] - sum(logs)) / order
        steps.append(max(at_rest, (np.log(share * span) - sum(logs)) / (order + 1)) if span > 0.0 else at_rest)
    return int(np.floor(min(steps) / np.log(2.0)))


def _between(
    x: NDArray[np.float64],
    half: NDArray[np.float64],
    after: NDArray[np.float64],
    integral: NDArray[np.float64],
    part: float,
    h: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """State and integral within a step, on the parabola through its beginning, middle and end."""
    slope, bend = 4.0 * half - 3.0 * x - after, 2.0 * (x - 2.0 * half + after)
    state = x + part * (slope + part * bend)
    return state, integral + h * part * (x + part * (slope / 2.0 + part * bend / 3.0))
