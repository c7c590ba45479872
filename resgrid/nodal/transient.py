"""How a netlist with capacitors moves in time: implicit steps, each one solution of a nodal system.

The three methods are backward Euler, the trapezoidal rule (both as in Nagel 1975, chapter 4) and TR-BDF2 (Bank,
Coughran, Fichtner, Grosse, Rose & Smith 1985), whose two stages share a matrix at ``gamma = 2 - sqrt(2)``.  All are
A-stable, so that a step is limited by accuracy alone; backward Euler and TR-BDF2 also damp what is too fast for the
step (L-stable).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.errors import BudgetError, CircuitError, InputError
from resgrid.netlist import Netlist
from resgrid.nodal.dynamics import Dynamics, dynamics_of, factor_resolvent
from resgrid.nodal.energy import energy_meter
from resgrid.nodal.factors.factor import Factor
from resgrid.nodal.initial import initial_state
from resgrid.nodal.operating_point import OperatingPoint

METHODS = ("backward_euler", "trapezoidal", "tr-bdf2")

_ROOT2 = float(np.sqrt(2.0))
_ORDER = {"backward_euler": 1, "trapezoidal": 2, "tr-bdf2": 2}
_MOST_STEPS = 10_000_000
_KEPT = 4
_RTOL = 1e-11
_SHARE = {"backward_euler": 0.02, "trapezoidal": 0.02, "tr-bdf2": 0.5}
"""Share of the tolerance that one step may use up by its own estimate: errors of many steps add, but those of TR-BDF2
are extrapolated away to leading order (which the trapezoidal rule, not being L-stable, would not survive)."""

Solve = Callable[[float, NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Transient:
    """Voltages of a netlist over time.

    Attributes
    ----------
    netlist : Netlist
        The circuit.
    times : ndarray of float64, shape (t,)
        In seconds; at time 0 the state is that of 0+, when the sources already act.
    voltage : ndarray of float64, shape (t, nodes)
        Node voltages above ground, in volts; NaN where a node floats.
    energy : ndarray of float64, shape (t,)
        Energy that all sources have delivered since 0+, in joules.
    stored : ndarray of float64, shape (t,)
        Energy in the capacitors, in joules.
    steps : int
        Steps of integration.
    factorisations : int
        How many matrices were factored.
    method : str
        The method of integration.
    """

    netlist: Netlist
    times: NDArray[np.float64]
    voltage: NDArray[np.float64]
    energy: NDArray[np.float64]
    stored: NDArray[np.float64]
    steps: int
    factorisations: int
    method: str

    def __post_init__(self) -> None:
        for array in (self.times, self.voltage, self.energy, self.stored):
            array.flags.writeable = False


@dataclass(frozen=True, eq=False)
class TransientStepper:
    """A netlist made ready for steps of one length.

    Attributes
    ----------
    dynamics : Dynamics
        Its equations.
    step : float
        In seconds.
    method : str
        The method of integration.
    """

    dynamics: Dynamics
    step: float
    method: str
    _solve: Solve = field(repr=False)

    def start(self, initial: OperatingPoint | ArrayLike | None = None) -> NDArray[np.float64]:
        """Node voltages at time 0+, shape (nodes,), in volts; ``initial`` as in `transient`."""
        return self.dynamics.voltage(initial_state(self.dynamics, initial))

    def advance(self, voltage: NDArray[np.float64]) -> NDArray[np.float64]:
        """Node voltages one step after ``voltage``, which `start` or `advance` returned; shape (nodes,), in volts."""
        x, _ = _advance(self.dynamics, self.method, self.dynamics.state(voltage), self.step, self._solve)
        return self.dynamics.voltage(x)


def transient(
    netlist: Netlist,
    times: ArrayLike,
    *,
    initial: OperatingPoint | ArrayLike | None = None,
    step: float | None = None,
    tolerance: float = 1e-6,
    method: str = "tr-bdf2",
    solver: str = "auto",
) -> Transient:
    """Follow the voltages of a netlist after its sources are switched on at time 0.

    Parameters
    ----------
    netlist : Netlist
        With capacitors; nodes without any follow the others at once.
    times : array_like of float, shape (t,)
        When to report, in seconds, ascending, none negative.
    initial : OperatingPoint or array_like of float, shape (nodes,), optional
        Node voltages before time 0: they say how the capacitors are charged.  An operating point of another scene on
        the same grid is carried over cell by cell; a cell that had no voltage counts as 0 V.  None: all capacitors
        are discharged (SPICE's UIC without initial conditions).
    step : float, optional
        Length of a step in seconds; every interval between times is divided evenly into steps no longer than this.
        None: chosen as the answer needs, in powers of two, by comparing each step with two halves.
    tolerance : float
        Without ``step``: wanted accuracy of every voltage, relative to the largest voltage difference that occurs.
    method : {"tr-bdf2", "trapezoidal", "backward_euler"}
        Method of integration.  The trapezoidal rule of fixed step begins with four backward Euler steps of half the
        length (Rannacher 1984), which damp what it would let ring.
    solver : {"auto", "direct", "multigrid"}
        Method for the linear systems, as in `resgrid.solve`.

    Returns
    -------
    Transient

    Raises
    ------
    InputError
        If an argument is not admissible or the netlist holds nonlinear elements.
    CircuitError
        If the netlist contradicts itself.
    BudgetError
        If it would take more than ten million steps.
    """
    when = _checked_times(times)
    _check_options(step, tolerance, method)
    dynamics = dynamics_of(netlist)
    cache = _Resolvents(dynamics, solver)
    x = initial_state(dynamics, initial)
    meter = energy_meter(dynamics)
    voltage = np.empty((len(when), netlist.node_count))
    energy, stored = np.empty(len(when)), np.empty(len(when))
    if step is not None:
        states = _fixed(dynamics, method, x, when, step, cache)
    else:
        states = _controlled(dynamics, method, x, when, tolerance, cache)
    steps = 0
    for number, (state, integral, taken) in enumerate(states):
        voltage[number] = dynamics.voltage(state)
        energy[number] = meter.delivered(when[number], state - x, integral)
        stored[number] = meter.stored(voltage[number])
        steps = taken
    return Transient(netlist, when, voltage, energy, stored, steps, cache.made, method)


def transient_stepper(
    netlist: Netlist, step: float, *, method: str = "tr-bdf2", solver: str = "auto"
) -> TransientStepper:
    """Make a netlist ready for many steps of one length, for callers that do something between steps.

    Parameters
    ----------
    netlist : Netlist
        With capacitors.
    step : float
        In seconds.
    method : {"tr-bdf2", "trapezoidal", "backward_euler"}
    solver : {"auto", "direct", "multigrid"}

    Returns
    -------
    TransientStepper

    Raises
    ------
    InputError, CircuitError
        As `transient`.
    """
    _check_options(step, 0.5, method)
    dynamics = dynamics_of(netlist)
    return TransientStepper(dynamics, step, method, _Resolvents(dynamics, solver))


class _Resolvents:
    """Solves ``(G + rate C) x = rhs``; the factors of the last few rates are kept."""

    def __init__(self, dynamics: Dynamics, solver: str) -> None:
        self._dynamics, self._solver = dynamics, solver
        self._factors: dict[float, Factor] = {}
        self.made = 0

    def __call__(self, rate: float, rhs: NDArray[np.float64]) -> NDArray[np.float64]:
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


def _advance(
    dynamics: Dynamics, method: str, x: NDArray[np.float64], h: float, solve: Solve
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """State after a step, and the integral of the state over it (the method's own, so that charges balance)."""
    C, b = dynamics.capacitance.matrix, dynamics.drive
    if method == "backward_euler":
        after = solve(1.0 / h, C @ x / h + b)
        return after, h * after
    if method == "trapezoidal":
        middle = solve(2.0 / h, 2.0 / h * (C @ x) + b)
        return 2.0 * middle - x, h * middle
    rate = (2.0 + _ROOT2) / h
    between = 2.0 * solve(rate, rate * (C @ x) + b) - x
    past = 0.5 * (_ROOT2 + 1.0) * between - 0.5 * (_ROOT2 - 1.0) * x
    after = solve(rate, rate * (C @ past) + b)
    return after, h * (_ROOT2 / 4.0 * (x + between) + (1.0 - _ROOT2 / 2.0) * after)


_State = tuple[NDArray[np.float64], NDArray[np.float64], int]
"""State, its integral since 0+, and the number of steps taken."""


def _fixed(
    dynamics: Dynamics, method: str, x: NDArray[np.float64], times: NDArray[np.float64], step: float, solve: Solve
) -> Iterator[_State]:
    integral = np.zeros_like(x)
    taken, now = 0, 0.0
    for time in times.tolist():
        _check_steps(taken + (time - now) / step)
        count = int(np.ceil((time - now) / step * (1.0 - 1e-12)))
        h = (time - now) / max(count, 1)
        for _ in range(count):
            damped = method == "trapezoidal" and taken < 2
            for length in (h / 2, h / 2) if damped else (h,):
                x, part = _advance(dynamics, "backward_euler" if damped else method, x, length, solve)
                integral = integral + part
            taken += 1
        now = time
        yield x, integral, taken


def _controlled(
    dynamics: Dynamics, method: str, x: NDArray[np.float64], times: NDArray[np.float64], tolerance: float, solve: Solve
) -> Iterator[_State]:
    """Steps of ``2**k`` seconds, each compared with two halves; the halves are kept."""
    order = _ORDER[method]
    target = _SHARE[method] * tolerance * _span(dynamics, x, solve)
    exponent = _first_exponent(dynamics, times, tolerance)
    integral = np.zeros_like(x)
    now, taken = 0.0, 0
    waiting = times.tolist()
    while waiting:
        while waiting and waiting[0] <= now:
            yield x, integral, taken
            waiting.pop(0)
        if not waiting:
            return
        h = 2.0**exponent
        whole, at_once = _advance(dynamics, method, x, h, solve)
        half, first = _advance(dynamics, method, x, h / 2, solve)
        after, second = _advance(dynamics, method, half, h / 2, solve)
        increment = first + second
        error = float(np.abs(whole - after).max(initial=0.0)) / (2**order - 1)
        if error > target and now + h / 2 > now:
            exponent -= 1
            continue
        if method == "tr-bdf2":
            after = after + (after - whole) / (2**order - 1)
            increment = increment + (increment - at_once) / (2**order - 1)
        taken += 2
        _check_steps(taken)
        while waiting and waiting[0] < now + h:
            part = (waiting.pop(0) - now) / h
            yield *_between(x, half, after, integral, part, h), taken
        x, integral, now = after, integral + increment, now + h
        if error * 2.0 ** (order + 1) * 1.5 < target:
            exponent += 1


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


def _span(dynamics: Dynamics, x: NDArray[np.float64], solve: Solve) -> float:
    """Largest voltage difference between rails, the state at 0+ and the operating point (if there is one)."""
    states = [x]
    with suppress(CircuitError):  # a part that only capacitors hold has no operating point
        states.append(solve(0.0, dynamics.drive))
    volts = np.concatenate([dynamics.voltage(state) for state in states])
    span = float(np.nanmax(volts) - np.nanmin(volts))
    return span if span > 0 else 1.0


def _first_exponent(dynamics: Dynamics, times: NDArray[np.float64], tolerance: float) -> int:
    """Power of two, in seconds, of a first step that resolves the fastest node."""
    C, G = dynamics.capacitance.diagonal, dynamics.conductance.diagonal
    live = (C > 0) & (G > 0)
    fastest = float((C[live] / G[live]).min()) if live.any() else np.inf
    longest = max(float(times[-1]), np.finfo(np.float64).tiny)
    return int(np.floor(np.log2(min(fastest * tolerance ** (1 / 3), longest))))


def _checked_times(times: ArrayLike) -> NDArray[np.float64]:
    try:
        when = np.array(times, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("times must be numbers, in seconds") from error
    if when.ndim != 1 or not len(when):
        raise InputError(f"times has shape {when.shape}; give at least one time, in a row")
    if not (np.isfinite(when).all() and (when >= 0).all() and (np.diff(when) >= 0).all()):
        raise InputError("times must be finite, at least 0 and ascending, in seconds")
    return when


def _check_options(step: float | None, tolerance: float, method: str) -> None:
    if method not in METHODS:
        raise InputError(f"method = {method!r} is unknown; it may be one of {', '.join(METHODS)}")
    if step is not None and not (np.isfinite(step) and step > 0):
        raise InputError(f"step = {step} must be positive and finite, in seconds")
    if not 1e-12 <= tolerance < 1:
        raise InputError(f"tolerance = {tolerance} must lie between 1e-12 and 1")


def _check_steps(count: float) -> None:
    if count > _MOST_STEPS:
        raise BudgetError(
            f"this takes more than {_MOST_STEPS:,} steps; give a longer step, a shorter time or a larger tolerance"
        )
