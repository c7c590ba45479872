"""How long a chip takes to plan, and what a plan costs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import Count, Positive
from resgrid.chip.figures_of_merit import Figure, Result
from resgrid.chip.modal_response import SPAN, Motion, motions
from resgrid.chip.time_constants import (
    Solver,
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
from resgrid.circuit.transients import initial_voltages
from resgrid.core.netlist import Netlist
from resgrid.errors import AccuracyError, InputError

Floats = NDArray[np.float64]

_FINENESS = 0.005
"""Accuracy of deviations, relative to the band."""

_STEPS = 64
_POINTS = 256
_FEWEST_POINTS = 32
_MOST_VALUES = 3e7


@dataclass(frozen=True, eq=False, repr=False)
class Settling(Result):
    """How the node voltages approach the operating point after the sources are switched at time 0.

    Attributes
    ----------
    netlist : Netlist
        The chip.
    bits : int
        Settled means: no node is further from its final voltage than half a step of a converter of so many bits,
        ``span / 2**(bits + 1)``, and none leaves that band again.
    span : float
        Range of the converter, in volts.
    time_constants : ndarray of float64, shape (k,)
        Slowest time constants of the circuit, slowest first, in seconds: eigenvalues of ``C v = tau G v``, each as
        often as it occurs.  In circuits of more than 200 rows those below 1e-12 of the slowest are left out, since
        rounding would decide them.
    mode : ndarray of float64, shape (nodes,)
        Shape of the slowest mode: voltages that fall everywhere as ``exp(-t / tau)``; largest magnitude 1; 0 on rails,
        NaN where a node floats.
    fastest : float
        Shortest time constant, in seconds; to 1 % in circuits of more than 200 rows.
    node_time : ndarray of float64, shape (nodes,)
        When every node has settled, in seconds; 0 on rails, NaN where a node floats.  It holds for a band that is
        right to 0.5 %, or better where the circuit has no more than 200 rows.
    bound : float
        Time by which the slowest time constant alone guarantees that all have settled, in seconds.
        (`resgrid.chip.settling.settling_bound`).
    energy : float
        Energy that all sources deliver until all nodes have settled, in joules.
    power : float
        Power that they deliver from then on, in watts.
    final : ndarray of float64, shape (nodes,)
        Final voltages, in volts; NaN where a node floats.
    times : ndarray of float64, shape (t,)
        In seconds: 0, then by equal ratios until the last node has settled, or later.
    distance : ndarray of float64, shape (t,)
        Largest distance of a node from its final voltage at those times, in volts.
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
        """When the last node has settled, in seconds."""
        return float(np.nanmax(self.node_time))

    @property
    def figures(self) -> Mapping[str, Figure]:
        """The figures of merit by name, with units and definitions."""
        half = f"half a step of a {self.bits}-bit converter ({self.span / 2 ** (self.bits + 1):.3g} V)"
        return {
            "slowest_time_constant": Figure(
                float(self.time_constants[0]), "s", "largest eigenvalue of C v = tau G v: the last thing to settle"
            ),
            "fastest_time_constant": Figure(self.fastest, "s", "smallest eigenvalue of C v = tau G v other than 0"),
            "settle_time": Figure(
                self.settle_time, "s", f"time after switching from which every node stays within {half} of its end"
            ),
            "settle_bound": Figure(
                self.bound,
                "s",
                "time by which the slowest time constant guarantees the same for this change of the scene",
            ),
            "energy_per_plan": Figure(
                self.energy, "J", "energy that all sources deliver from switching until every node has settled"
            ),
            "power": Figure(self.power, "W", "power that all sources deliver once the grid has settled"),
        }

    def to_json(self) -> dict[str, Any]:
        """The figures and the slowest time constants, as plain values."""
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
    """How long the chip takes to settle after its supplies are switched on, and what a plan costs.

    `bits`: how well, 1 to 24, by default the converter's, or 10; `span`: range of the converter, in volts, without a
    chip's description the largest difference of final voltages; `initial`: voltages of all nodes, or the operating
    point, before the switch (as in `resgrid.circuit.transient`; by default all capacitors are discharged); `modes`: how
    many slow time constants to find; `method`: as in `resgrid.solve`.

    A part of the circuit that never settles is a CircuitError; conductances that span so many decades that rounding
    decides the slowest time constant, and figures beyond what doubles hold, are AccuracyErrors.
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
    reach = _reach(settled) if span is None else float(span)
    deviation = initial_state(dynamics, initial_voltages(dynamics.netlist, initial)) - final
    # In units of a power of two near the largest deviation no square runs out of range.
    unit = float(2.0 ** np.floor(np.log2(np.abs(deviation).max(initial=0.0) or 1.0)))
    band = reach / 2.0 ** (bits + 1) / unit
    if band == 0.0:
        raise InputError(f"span = {reach} V is nothing beside voltages that move by {unit:.1e} V; give a larger one")
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
        span=reach,
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


def _reach(settled: Floats) -> float:
    """Largest difference of final voltages."""
    with np.errstate(over="ignore"):
        reach = float(np.nanmax(settled) - np.nanmin(settled))
    if not np.isfinite(reach):
        raise AccuracyError("the span of the final voltages is beyond what doubles hold; give smaller voltages")
    if reach == 0.0:
        raise InputError("every node ends at the same voltage: there is no span to settle within; give span in volts")
    return reach


def settling_bound(dynamics: Dynamics, solve: Solver, deviation: Floats, tau: float, band: float) -> float:
    """Time after which ``exp(-t / tau)`` leaves no row outside a band.

    In the norms ``sqrt(y^T C y)`` and ``sqrt(y^T G y)`` every deviation ``y`` falls at least as ``exp(-t / tau)``.  A
    voltage is at most the first over the root of the smallest eigenvalue of C, which is at least the smallest
    capacitance to a rail, where every row has one or lies between others; and always at most the second times the root
    of its ``(G^-1)_ii``, which is at most its ``(G^-1 1)_i``.

    Shapes: `deviation` (n,).
    """
    stiffness = dynamics.capacitance.ground[dynamics.charged]
    if (stiffness > 0).all():
        norm, reach = dynamics.capacitance, 1.0 / np.sqrt(float(stiffness.min()))
    else:
        norm, reach = dynamics.conductance, float(np.sqrt(solve(np.ones(dynamics.size)).max()))
    largest = float(np.linalg.norm(laplacian_root(norm) @ deviation)) * reach
    return 0.0 if largest <= band else tau * float(np.log(largest / band))


def _walk_back(
    deviation: Floats, window: Callable[[float, float], Motion], bound: float, fastest: float, band: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """From when on every row stays within a band, from the bound back to time 0, a window of times at a time.

    Returns that time, shape (n,); the deviations when the last row is inside, shape (n,); and times, shape (t,), with
    the largest deviation at each.
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


def _curve(motion: Motion, deviation: Floats, first: float, last: float) -> tuple[Floats, Floats]:
    """Time 0 and times of a window, and the largest deviation at them."""
    count = int(np.clip(_MOST_VALUES / len(deviation), _FEWEST_POINTS, _POINTS))
    times = np.geomspace(first, last, count)
    parts = [np.abs(motion.at(part)).max(axis=1) for part in np.array_split(times, _FEWEST_POINTS)]
    return np.append(0.0, times), np.concatenate([np.abs(deviation).max(keepdims=True), *parts])


def _energy(dynamics: Dynamics, solve: Solver, final: Floats, start: Floats, end: Floats, time: float) -> float:
    """Energy that the sources deliver while the deviation goes from start to end: its integral is G^-1 C of the way."""
    if time == 0.0:
        return 0.0
    integral = final * time + solve(dynamics.capacitance.matrix @ (start - end))
    with np.errstate(over="ignore", invalid="ignore"):
        return energy_delivered(dynamics, time, end - start, integral)


def _within_range(name: str, value: float) -> float:
    if not np.isfinite(value):
        raise AccuracyError(
            f"the {name} is beyond what doubles hold; give voltages and conductances in smaller numbers"
        )
    return value
