"""Implicit time integration of RC circuits, with fixed steps or with error control.

The three methods are backward Euler, the trapezoidal rule (both as in Nagel 1975, chapter 4) and TR-BDF2 (Bank,
Coughran, Fichtner, Grosse, Rose & Smith 1985), whose two stages have the same matrix for ``gamma = 2 - sqrt(2)``.  All
are A-stable, so that only accuracy limits the step.  Backward Euler and TR-BDF2 are also L-stable: they damp modes that
are faster than the step.

A step solves for the change ``d`` of the state: ``(G + rate C) d = b - G x``, with the KCL residual on the right.  The
residual vanishes as the circuit settles.  The usual term ``rate C x`` grows as steps shrink, and its rounding errors,
summed over nodes that capacitors connect, would act as spurious charge.

With error control, every step is compared with two steps of half the length.  The length of the first step follows from
the derivatives at 0+, which are known exactly for a linear circuit.  The sources are constant after 0+: every mode is
excited at 0+ and decays.  Steps therefore start short enough for the fast modes and grow, and no mode is skipped.
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
"""Largest normwise backward error of every linear solve within a time step."""

Factors = Callable[[float], Factor]
"""Function that takes a rate in 1/s and returns the factors of ``G + rate C`` (conductance, capacitance matrix)."""

State = NDArray[np.float64]
"""State of an integration, shape (2, n): voltages of the rows in volts, and their time integrals in volt seconds since
0+.
"""


def rate_of(method: Method, h: float) -> float:
    """Return the factor ``rate`` in the matrix ``G + rate C`` of a step, in 1/s, equal for both stages of TR-BDF2.

    ``G``, ``C``: conductance and capacitance matrix; `method`: ``"backward_euler"``, ``"trapezoidal"`` or
    ``"tr-bdf2"``; `h`: length of the step in seconds.
    """
    return {"backward_euler": 1.0, "trapezoidal": 2.0, "tr-bdf2": 2.0 + _ROOT2}[method] / h


def advance(dynamics: Dynamics, method: Method, state: State, h: float, factors: Factors) -> State:
    """Return the state after one step: voltages of the rows in volts, and their time integrals since 0+, shape (2, n).

    `dynamics`: equations of the circuit; `method`: ``"backward_euler"``, ``"trapezoidal"`` or ``"tr-bdf2"``; `state`
    (2, n): state before the step; `h`: length of the step in seconds; `factors`: function that returns the factors of
    ``G + rate C`` for a rate in 1/s.
    """
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
    """Yield the state (2, n) at every output time, and the number of steps until then.

    A state holds the voltages of the rows in volts and their time integrals since 0+.  `dynamics`: equations of the
    circuit; `method`: ``"backward_euler"``, ``"trapezoidal"`` or ``"tr-bdf2"``; `state` (2, n): state at 0+; `times`
    (t,): output times in seconds; `step`: largest length of a step in seconds; `factors`: function that returns the
    factors of ``G + rate C`` for a rate in 1/s.

    Every interval between output times is divided into equal steps.  The trapezoidal rule starts with four backward
    Euler steps of half the length (Rannacher 1984).
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
    """Raise BudgetError if `count`, the number of time steps, exceeds ten million."""
    if count > _MOST_STEPS:
        raise BudgetError(
            f"the integration needs more than {_MOST_STEPS:,} steps; choose a longer step, a shorter time or a larger "
            "tolerance"
        )


_ORDER = {"backward_euler": 1, "trapezoidal": 2, "tr-bdf2": 2}
_EPS = float(np.finfo(np.float64).eps)

_MOST_OF_TOLERANCE = 0.5
"""Largest estimated error of one step, as a fraction of the tolerance of the whole integration."""

_ACCUMULATION = {"backward_euler": 2.0, "trapezoidal": 4.0, "tr-bdf2": np.inf}
"""Factor ``c`` in the largest estimated error of a step of order ``p``, ``(c tolerance)**((p + 1) / p)``, by method.

The errors ``e`` of ``N`` steps add up, and ``N`` is proportional to ``e**(-1 / (p + 1))``.  The factor accounts for the
decay of earlier errors.  It is infinite for TR-BDF2, whose leading error is removed by extrapolation: only
`_MOST_OF_TOLERANCE` then limits the error of a step.  The trapezoidal rule is not L-stable, and extrapolation would
make it unstable.
"""

_LEAST_ERROR = 16 * _EPS
"""Smallest limit on the error of one step that exceeds rounding errors.

It is a fraction of the largest voltage between two nodes since 0+.  A tolerance that requires less raises
AccuracyError.
"""

_MOST_HALVINGS = 30
"""Number of consecutive halvings of a step after which the remaining error counts as a rounding error.

A further halving raises AccuracyError.
"""


def controlled_steps(
    dynamics: Dynamics, method: Method, state: State, times: NDArray[np.float64], tolerance: float, factors: Factors
) -> Iterator[tuple[State, int]]:
    """Yield the state (2, n) at every output time, and the number of steps until then, with error control.

    A state holds the voltages of the rows in volts and their time integrals since 0+.  `dynamics`: equations of the
    circuit; `method`: ``"backward_euler"``, ``"trapezoidal"`` or ``"tr-bdf2"``; `state` (2, n): state at 0+; `times`
    (t,): output times in seconds; `tolerance`: largest error of a voltage at any time, accumulated over all steps,
    as a fraction of the voltage range; `factors`: function that returns the factors of ``G + rate C`` for a rate
    in 1/s.

    The voltage range is the highest minus the lowest voltage of any node, rails included, from 0+ until the step.
    Steps have ``2**k`` seconds, with an integer ``k``.  The solution after two half steps is used.  Raise AccuracyError
    if rounding errors exceed the tolerance.
    """
    order, step_rtol, end = _ORDER[method], _step_tolerance(method, tolerance), float(times[-1])
    low, high = _range(dynamics, state)
    exponent = _first_exponent(dynamics, state[0], order, step_rtol, high - low, end)
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
            target = step_rtol * (highest - lowest)
            change = (after - whole) / (2**order - 1)
            error = float(np.abs(change[0]).max(initial=0.0))
            if error > target:
                if halved >= _MOST_HALVINGS or now + h / 4 == now:
                    raise AccuracyError(
                        f"the voltages after {now:.3g} s cannot be computed to tolerance = {tolerance:g}: every step "
                        f"has a rounding error of {error:.1e} V, however short it is; choose a larger tolerance, or "
                        "a fixed step"
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


def _step_tolerance(method: str, tolerance: float) -> float:
    """Return the largest accepted error estimate of one step, as a fraction of the voltage range.

    The voltage range is the highest minus the lowest node voltage since 0+.  `method`: integration method; `tolerance`:
    largest error of the whole integration, as a fraction of the voltage range.  Raise AccuracyError if rounding errors
    of steps would exceed the tolerance.
    """
    accumulated = float((_ACCUMULATION[method] * tolerance) ** (1.0 + 1.0 / _ORDER[method]))
    step_rtol = min(_MOST_OF_TOLERANCE * tolerance, accumulated)
    if step_rtol < _LEAST_ERROR:
        raise AccuracyError(
            f"tolerance = {tolerance:g} is out of reach for method = {method!r}: the rounding errors of its many steps "
            "add up to more; use method = 'tr-bdf2', or a larger tolerance"
        )
    return step_rtol


def _range(dynamics: Dynamics, state: State) -> tuple[float, float]:
    """Return the lowest and the highest node voltage of a state, rails included, in volts.

    `state` (2, n): voltages of the rows in volts, and their time integrals, of which the first are used.
    """
    volts = dynamics.voltage(state[0])
    return float(np.nanmin(volts)), float(np.nanmax(volts))


def _first_exponent(
    dynamics: Dynamics, x: NDArray[np.float64], order: int, step_rtol: float, span: float, longest: float
) -> int:
    """Return the exponent ``k`` of the first step of ``2**k`` seconds.

    `dynamics`: equations of the circuit; `x` (n,): voltages of the rows at 0+; `order`: order ``p`` of the method;
    `step_rtol`: largest error of a step, relative to `span`; `span`: highest minus lowest node voltage at 0+, in volts;
    `longest`: longest step in seconds.

    The step ``h`` satisfies ``h**(p + 1) |x^(p + 1)| = step_rtol span``, with the derivative of order ``p + 1``: the
    error of a step of order ``p`` without its constant (Hairer, Norsett & Wanner 1993, section II.4).  For ``span =
    0``, as in a circuit at 0 V, the largest voltage after the first step, ``h |x'|``, replaces `span`.
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
        from_zero = (np.log(step_rtol) + logs[0] - sum(logs)) / order
        steps.append(max(from_zero, (np.log(step_rtol * span) - sum(logs)) / (order + 1)) if span > 0.0 else from_zero)
    return int(np.floor(min(steps) / np.log(2.0)))


def _between(before: State, half: State, after: State, part: float, h: float) -> State:
    """Return the state inside a step by quadratic interpolation of the states `before`, `half` (midpoint) and `after`.

    A state (2, n) holds the voltages of the rows in volts and their time integrals.  `part`: time since the beginning
    of the step, as a fraction of the step; `h`: length of the step in seconds.
    """
    x, integral = before
    slope, bend = 4.0 * half[0] - 3.0 * x - after[0], 2.0 * (x - 2.0 * half[0] + after[0])
    moved = part * (slope / 2.0 + part * bend / 3.0)
    return np.stack([x + part * (slope + part * bend), integral + h * part * (x + moved)])
