"""Settling: the time and the energy that a chip needs until its voltages have settled."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import Count, Positive
from resgrid.chip.figures_of_merit import Figure, Result
from resgrid.chip.modal_response import SPAN, ExponentialSum, motions
from resgrid.chip.time_constants import (
    LinearMap,
    accurate_solver,
    fastest_time_constant,
    laplacian_root,
    require_charge,
    slowest_modes,
)
from resgrid.circuit.dynamics import (
    Dynamics,
    dynamics_of,
    energy_delivered,
    factor_resolvent,
    initial_state,
)
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import solve as solve_circuit
from resgrid.circuit.transients.linear import initial_voltages
from resgrid.core.netlist import Netlist
from resgrid.errors import AccuracyError, InputError

Floats = NDArray[np.float64]

_FINENESS = 0.005
"""Largest error of a computed deviation from the final voltage, as a fraction of the half width of the settling band.
"""

_STEPS = 64
"""Number of times in one window (interval of times with one sum of exponentials) at which deviations are compared with
the settling band.
"""
_POINTS = 256
"""Maximum number of points of the settling curve."""
_FEWEST_POINTS = 32
"""Minimum number of points of the settling curve."""
_MOST_VALUES = 3e7
"""Maximum number of deviations that are computed for the settling curve: number of points times number of unknown
voltages.
"""


@dataclass(frozen=True, eq=False, repr=False)
class Settling(Result):
    """Approach of the node voltages to the operating point after the sources are switched at time 0.

    Returned by `resgrid.chip.Study.settling`.

    Attributes
    ----------
    netlist : Netlist
        The chip.
    bits : int
        Resolution that defines a settled voltage: from the settling time on, the voltage differs from its final value
        by at most half a step of a converter of `bits` bits, ``span / 2**(bits + 1)``.
    span : float
        Range of the converter, in volts.
    time_constants : ndarray of float64, shape (k,)
        Slowest time constants of the circuit, slowest first, in seconds: eigenvalues of ``C v = tau G v``, with
        multiplicity, for the capacitance matrix ``C`` and the conductance matrix ``G``.  In circuits of more than 200
        unknown voltages, those below 1e-12 of the slowest are left out, because rounding would decide them.
    mode : ndarray of float64, shape (nodes,)
        Shape of the slowest mode, scaled to the largest magnitude 1: voltages that decay everywhere as ``exp(-t /
        tau)``; 0 on rails, NaN at a node without any connection to a rail.
    fastest : float
        Shortest time constant, in seconds; with a relative error of up to 1 % in circuits of more than 200 unknown
        voltages.
    node_time : ndarray of float64, shape (nodes,)
        Settling time of every node, in seconds; 0 on rails, NaN where a node floats.  The time is exact for a tolerance
        that differs from the half step of the converter by at most 0.5 %.
    bound : float
        Upper bound of the settling time from the slowest time constant alone, in seconds
        (`resgrid.chip.settling.settling_bound`).
    energy : float
        Energy that all sources deliver until all nodes have settled, in joules.
    power : float
        Power that all sources deliver after settling, in watts.
    final : ndarray of float64, shape (nodes,)
        Final voltages, in volts; NaN where a node floats.
    times : ndarray of float64, shape (t,)
        Times of the settling curve, in seconds: 0, then a geometric sequence that ends when the last node has settled,
        or later.
    distance : ndarray of float64, shape (t,)
        Largest distance of any node from its final voltage at each of the `times`, in volts.
    settle_time : float
        Settling time of the last node, in seconds.
    figures : mapping of str to Figure
        Figures of merit by name.

    Examples
    --------
    >>> settling = rg.study(rg.read_scene("examples/scenes/lesson.toml"), rg.Chip(capacitance="100f")).settling()
    >>> f"{settling.settle_time:.3g} s", f"{settling.bound:.3g} s", f"{settling.energy:.3g} J"
    ('1.13e-08 s', '1.35e-08 s', '7.7e-12 J')
    >>> slowest = int(np.nanargmax(settling.node_time))
    >>> settling.netlist.node_name(slowest), f"{settling.time_constants[0]:.3g} s"
    ('n_3_6', '1.41e-09 s')
    """

    netlist: Netlist
    bits: int
    span: float
    time_constants: NDArray[np.float64]
    mode: NDArray[np.float64]
    fastest: float
    node_time: NDArray[np.float64]
    bound: float
    energy: float
    power: float
    final: NDArray[np.float64]
    times: NDArray[np.float64]
    distance: NDArray[np.float64]

    @property
    def settle_time(self) -> float:
        """Settling time of the last node, in seconds."""
        return float(np.nanmax(self.node_time))

    @property
    def figures(self) -> Mapping[str, Figure]:
        """Figures of merit by name: time constants, settling time, energy and power.

        ``slowest_time_constant``, ``fastest_time_constant``, ``settle_time`` and its upper bound ``settle_bound``, in
        seconds; ``energy_per_plan``: energy from switching to settling, in joules; ``power``: power of the settled
        circuit, in watts.
        """
        half = f"half a step of a {self.bits}-bit converter ({self.span / 2 ** (self.bits + 1):.3g} V)"
        return {
            "slowest_time_constant": Figure(
                float(self.time_constants[0]), "s", "largest eigenvalue of C v = tau G v: the slowest mode"
            ),
            "fastest_time_constant": Figure(self.fastest, "s", "smallest eigenvalue of C v = tau G v other than 0"),
            "settle_time": Figure(
                self.settle_time, "s", f"time after which every node stays within {half} of its final voltage"
            ),
            "settle_bound": Figure(
                self.bound,
                "s",
                "upper bound of the settling time from the slowest time constant, for this change of the scene",
            ),
            "energy_per_plan": Figure(
                self.energy, "J", "energy that all sources deliver from switching until every node has settled"
            ),
            "power": Figure(self.power, "W", "power that all sources deliver once the grid has settled"),
        }

    def to_json(self) -> dict[str, Any]:
        """Return the result as a dictionary for JSON.

        Keys: the names of `figures`, each with a dictionary of ``value``, ``unit`` and ``definition``; ``bits``:
        resolution that defines a settled voltage; ``time_constants``: the slowest time constants in seconds, largest
        first.
        """
        return {**super().to_json(), "bits": self.bits, "time_constants": self.time_constants.tolist()}


def analyse_settling(
    netlist: Netlist,
    *,
    bits: Annotated[int, Ge(1), Le(24)] | None = None,
    initial: OperatingPoint | ArrayLike | None = None,
    modes: Count = 6,
    span: Positive | None = None,
    method: str = "auto",
) -> Settling:
    """Compute the settling time and the energy of a netlist after its sources are switched on at time 0, as a Settling.

    `bits`: resolution that defines a settled voltage (within half a step of a converter), None for 10; `initial`:
    voltages before time 0, None for discharged capacitors; `modes`: number of slow time constants to compute; `span`:
    range of the converter in volts, None for the largest difference of final voltages; `method`: linear solver, a
    method of `resgrid.solve`.  Raises CircuitError if a part of the circuit never settles.
    """
    bits = 10 if bits is None else bits
    dynamics = dynamics_of(netlist)
    require_charge(dynamics)
    factors = factor_resolvent(dynamics, 0.0, method)
    solve = accurate_solver(factors, dynamics.capacitance)
    slow = slowest_modes(dynamics, modes, solve)
    fastest = float(slow.tau[-1]) if slow.whole else fastest_time_constant(dynamics)
    final = dynamics.state(solve_circuit(netlist, method=method).voltage)
    settled = dynamics.voltage(final)
    span = _largest_difference(settled) if span is None else float(span)
    deviation = initial_state(dynamics, initial_voltages(dynamics.netlist, initial)) - final
    # Scale by a power of two near the largest deviation, so that squares do not overflow.
    unit = float(2.0 ** np.floor(np.log2(np.abs(deviation).max(initial=0.0) or 1.0)))
    band = span / 2.0 ** (bits + 1) / unit
    if band == 0.0:
        raise InputError(f"span = {span} V is negligible for voltages that change by {unit:.1e} V; give a larger span")
    bound = settling_bound(dynamics, solve, deviation / unit, float(slow.tau[0]), band)
    window = motions(dynamics, slow, deviation / unit, _FINENESS * band, method)
    row_time, end, times, distance = _walk_back(deviation / unit, window, bound, fastest, band)
    last = float(row_time.max(initial=0.0))
    mode = slow.shape[:, 0]
    across = np.subtract(*settled[netlist.resistor_nodes.T])
    with np.errstate(over="ignore"):
        power = float(np.nansum(netlist.conductance * across * across))
    return Settling(
        netlist=netlist,
        bits=bits,
        span=span,
        time_constants=slow.tau[:modes],
        mode=dynamics.at_nodes(mode / mode[np.argmax(np.abs(mode))]),
        fastest=fastest,
        node_time=dynamics.at_nodes(row_time),
        bound=bound,
        energy=_within_range("energy", _energy(dynamics, solve, final, deviation, unit * end, last)),
        power=_within_range("power", power),
        final=settled,
        times=times,
        distance=unit * distance,
    )


def _largest_difference(settled: Floats) -> float:
    """Return the largest difference of two final voltages, in volts; `settled` (nodes,): final voltages, in volts.

    Raises InputError if the difference is 0, AccuracyError if it overflows.
    """
    with np.errstate(over="ignore"):
        reach = float(np.nanmax(settled) - np.nanmin(settled))
    if not np.isfinite(reach):
        raise AccuracyError("the span of the final voltages overflows; give smaller voltages")
    if reach == 0.0:
        raise InputError("all final voltages are equal, which leaves the span undefined; give span in volts")
    return reach


def settling_bound(dynamics: Dynamics, solve: LinearMap, deviation: Floats, tau: float, band: float) -> float:
    """Return a time, in seconds, after which all unknown voltages stay within a band around their final values.

    In the norms ``sqrt(y^T C y)`` and ``sqrt(y^T G y)`` every deviation ``y`` decays at least as ``exp(-t / tau)``.
    The first norm is used if every row with a capacitance has a capacitance to a rail.  No voltage then exceeds the
    norm over the root of the smallest capacitance to a rail, which is a lower bound of the eigenvalues of C; voltages
    of rows without capacitance lie between the others.  Otherwise the second norm is used: voltage ``i`` is at most
    the norm times the root of ``(G^-1)_ii``, which is at most ``(G^-1 1)_i``.

    `dynamics`: circuit equations ``C x' + G x = b``, one row for each unknown voltage; `solve`: function that
    multiplies a vector by ``G^-1``; `deviation` (n,): voltages at time 0 minus their final values; `tau`: slowest time
    constant, in seconds; `band`: half width of the band, in the unit of `deviation`.
    """
    stiffness = dynamics.capacitance.ground[dynamics.charged]
    if (stiffness > 0).all():
        norm, reach = dynamics.capacitance, 1.0 / np.sqrt(float(stiffness.min()))
    else:
        norm, reach = dynamics.conductance, float(np.sqrt(solve(np.ones(dynamics.size)).max()))
    largest = float(np.linalg.norm(laplacian_root(norm) @ deviation)) * reach
    return 0.0 if largest <= band else tau * float(np.log(largest / band))


def _walk_back(
    deviation: Floats, window: Callable[[float, float], ExponentialSum], bound: float, fastest: float, band: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Find the time after which each voltage stays within a band, window by window from an upper bound back to time 0.

    Returns that time for every unknown voltage, shape (n,), 0 for a voltage that is always within the band; the
    deviations of all voltages at the largest of these times, shape (n,); and the settling curve: times, shape (t,),
    with the largest magnitude of a deviation at each, shape (t,).

    `deviation` (n,): voltages at time 0 minus their final values; `window`: function from the first and last time of a
    window (interval of times) to the deviations in between, a sum of exponentials; `bound`: time after which all
    voltages lie within the band; `fastest`: shortest time constant; `band`: half width of the band around the final
    voltages, in the unit of `deviation`.  All times are in seconds.
    """
    from resgrid.chip.kernels import last_outside

    row_time = np.zeros(len(deviation))
    if bound == 0.0:
        return row_time, deviation, np.zeros(1), np.abs(deviation).max(initial=0.0, keepdims=True)
    end, last, curve = deviation, bound, None
    rows = np.arange(len(deviation))
    while last > 0.0 and (rows.size or curve is None):
        first = last / SPAN if last > fastest else 0.0
        motion = window(first, last)
        times = np.geomspace(first or last / SPAN, last, _STEPS)
        times = times if first else np.append(0.0, times)
        last_outside(np.ascontiguousarray(motion.shape), motion.weight, motion.rate, times, band, rows, row_time)
        settled = float(row_time.max(initial=0.0))
        if settled > 0.0 and end is deviation:
            end, curve = motion.at(np.array([settled]))[0], None
        if curve is None:
            curve = _curve(motion, deviation, first or last / SPAN, last)
        rows, last = rows[row_time[rows] == 0.0], first
    assert curve is not None
    return row_time, end, *curve


def _curve(motion: ExponentialSum, deviation: Floats, first: float, last: float) -> tuple[Floats, Floats]:
    """Return the settling curve: times in seconds, and the largest magnitude of a deviation at each, shape (t,) each.

    The times are 0 and a geometric sequence from `first` to `last` (seconds).  `motion`: deviations as a sum of
    exponentials; `deviation` (n,): voltages at time 0 minus their final values, in the unit of the result.
    """
    count = int(np.clip(_MOST_VALUES / len(deviation), _FEWEST_POINTS, _POINTS))
    times = np.geomspace(first, last, count)
    parts = [np.abs(motion.at(part)).max(axis=1) for part in np.array_split(times, _FEWEST_POINTS)]
    return np.append(0.0, times), np.concatenate([np.abs(deviation).max(keepdims=True), *parts])


def _energy(dynamics: Dynamics, solve: LinearMap, final: Floats, start: Floats, end: Floats, time: float) -> float:
    """Return the energy that the sources deliver while the deviation changes from `start` to `end`, in joules.

    The integral of the deviation over time is ``G^-1 C (start - end)``.  `dynamics`: circuit equations; `solve`:
    function that multiplies a vector by ``G^-1``; `final` (n,): final voltages of the rows; `start, end` (n,):
    deviations from the final voltages at the beginning and the end of the interval, in volts; `time`: duration of the
    interval, in seconds.
    """
    if time == 0.0:
        return 0.0
    integral = final * time + solve(dynamics.capacitance.matrix @ (start - end))
    with np.errstate(over="ignore", invalid="ignore"):
        return energy_delivered(dynamics, time, end - start, integral)


def _within_range(name: str, value: float) -> float:
    """Return `value` unchanged; raise AccuracyError if it is not finite.

    `name`: name of the quantity for the message.
    """
    if not np.isfinite(value):
        raise AccuracyError(f"the {name} overflows; give smaller voltages and conductances")
    return value
