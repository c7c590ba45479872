"""How long a chip takes to plan, and what a plan costs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.device.motion import free_motion
from resgrid.device.reading import Reading, json_form
from resgrid.device.spectrum import fastest_time_constant, slowest_modes
from resgrid.errors import InputError
from resgrid.netlist import Netlist
from resgrid.nodal.dynamics import Dynamics, charge_basis, dynamics_of, factor_resolvent
from resgrid.nodal.energy import energy_meter
from resgrid.nodal.factors.factor import Factor
from resgrid.nodal.initial import initial_state
from resgrid.nodal.operating_point import OperatingPoint

_POINTS = 256
_MOST_VALUES = 3e7
_RTOL = 1e-12
_FINENESS = 0.005
"""Accuracy of voltages, relative to what counts as settled."""


@dataclass(frozen=True, eq=False)
class Settling:
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
        Slowest time constants of the circuit, slowest first, in seconds: eigenvalues of ``C v = tau G v``.
    mode : ndarray of float64, shape (nodes,)
        Shape of the slowest mode: voltages that fall everywhere as ``exp(-t / tau)``; largest magnitude 1; 0 on rails,
        NaN where a node floats.
    fastest : float
        Shortest time constant, in seconds.
    node_time : ndarray of float64, shape (nodes,)
        When every node has settled, in seconds; 0 on rails, NaN where a node floats.
    bound : float
        Time by which the slowest time constant alone guarantees that all have settled, in seconds.
    energy : float
        Energy that all sources deliver until all nodes have settled, in joules.
    power : float
        Power that they deliver from then on, in watts.
    final : ndarray of float64, shape (nodes,)
        Final voltages, in volts; NaN where a node floats.
    times : ndarray of float64, shape (t,)
        In seconds, from 0 until past the time to settle.
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

    def __post_init__(self) -> None:
        for array in (self.time_constants, self.mode, self.node_time, self.final, self.times, self.distance):
            array.flags.writeable = False

    @property
    def settle_time(self) -> float:
        """When the last node has settled, in seconds."""
        return float(np.nanmax(self.node_time))

    @property
    def readings(self) -> Mapping[str, Reading]:
        """The figures, with units and definitions."""
        half = f"half a step of a {self.bits}-bit converter ({self.span / 2 ** (self.bits + 1):.3g} V)"
        return {
            "slowest_time_constant": Reading(
                float(self.time_constants[0]), "s", "largest eigenvalue of C v = tau G v: the last thing to settle"
            ),
            "fastest_time_constant": Reading(self.fastest, "s", "smallest eigenvalue of C v = tau G v other than 0"),
            "settle_time": Reading(
                self.settle_time, "s", f"time after switching from which every node stays within {half} of its end"
            ),
            "settle_bound": Reading(
                self.bound,
                "s",
                "time by which the slowest time constant guarantees the same for this change of the scene",
            ),
            "energy_per_plan": Reading(
                self.energy, "J", "energy that all sources deliver from switching until every node has settled"
            ),
            "power": Reading(self.power, "W", "power that all sources deliver once the grid has settled"),
        }

    def to_json(self) -> dict[str, Any]:
        """The readings and the slowest time constants, as plain values."""
        return {**json_form(self.readings), "bits": self.bits, "time_constants": self.time_constants.tolist()}


def analyse_settling(
    netlist: Netlist,
    *,
    bits: int = 10,
    initial: OperatingPoint | ArrayLike | None = None,
    modes: int = 6,
    span: float | None = None,
    method: str = "auto",
) -> Settling:
    """Find out how long a netlist with capacitors takes to settle.

    Parameters
    ----------
    netlist : Netlist
        With capacitors and an operating point.
    bits : int
        How well, 1 to 24.
    initial : OperatingPoint or array_like of float, shape (nodes,), optional
        Before the switch, as in `resgrid.transient`; None: all capacitors discharged.
    modes : int
        How many slow time constants to find.
    span : float, optional
        Range of the converter, in volts; by default the largest difference of final voltages.
    method : {"auto", "direct", "multigrid"}
        As in `resgrid.solve`.

    Returns
    -------
    Settling

    Raises
    ------
    InputError
        If an argument is not admissible or there is no capacitance.
    CircuitError
        If a part of the circuit never settles.
    """
    if not 1 <= bits <= 24:
        raise InputError(f"bits = {bits}, but settling is judged at 1 to 24 bits")
    if span is not None and not (np.isfinite(span) and span > 0):
        raise InputError(f"span = {span} must be positive and finite, in volts")
    dynamics = dynamics_of(netlist)
    tau, mode = slowest_modes(dynamics, modes, method)
    factors = factor_resolvent(dynamics, 0.0, method)
    final = factors.solve(dynamics.drive, rtol=_RTOL)
    settled = dynamics.voltage(final)
    reach = float(np.nanmax(settled) - np.nanmin(settled)) if span is None else float(span)
    if reach == 0.0:
        raise InputError("every node ends at the same voltage: there is no span to settle within; give span in volts")
    band = reach / 2.0 ** (bits + 1)
    start = initial_state(dynamics, initial)
    bound = _bound(dynamics, start - final, float(tau[0]), band)
    times, deviation = _approach(dynamics, factors, start - final, bound, _FINENESS * band)
    row_time = _last_crossing(times, np.abs(deviation), band)
    last = float(row_time.max(initial=0.0))
    end = start - final if last == 0.0 else _at(times, deviation, last)
    return Settling(
        netlist=netlist,
        bits=bits,
        span=reach,
        time_constants=tau,
        mode=dynamics.at_nodes(mode[:, 0] / mode[np.argmax(np.abs(mode[:, 0])), 0]),
        fastest=fastest_time_constant(dynamics),
        node_time=dynamics.at_nodes(row_time),
        bound=bound,
        energy=_energy(dynamics, factors, final, start - final, end, last),
        power=_power(netlist, settled),
        final=settled,
        times=times,
        distance=np.abs(deviation).max(axis=1),
    )


def _approach(
    dynamics: Dynamics, factors: Factor, deviation: NDArray[np.float64], bound: float, accuracy: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times up to the bound, and every row's distance from its end at them."""
    if bound == 0.0:
        return np.zeros(1), deviation[None]
    times = np.linspace(0.0, bound, int(np.clip(_MOST_VALUES / dynamics.size, 32, _POINTS)))
    motion = free_motion(dynamics, factors, deviation, accuracy, float(times[1]))
    return times, np.concatenate([deviation[None], motion.at(times[1:])])


def _at(times: NDArray[np.float64], deviation: NDArray[np.float64], time: float) -> NDArray[np.float64]:
    after = int(np.clip(np.searchsorted(times, time), 1, len(times) - 1))
    part = (time - times[after - 1]) / (times[after] - times[after - 1])
    return np.asarray((1.0 - part) * deviation[after - 1] + part * deviation[after])


def _energy(
    dynamics: Dynamics,
    factors: Factor,
    final: NDArray[np.float64],
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    time: float,
) -> float:
    """Energy that the sources deliver while the deviation goes from start to end: its integral is G^-1 C of the way."""
    integral = final * time
    if time > 0.0:
        integral = integral + factors.solve(dynamics.capacitance.matrix @ (start - end), rtol=_RTOL)
    return energy_meter(dynamics).delivered(time, end - start, integral)


def _bound(dynamics: Dynamics, deviation: NDArray[np.float64], tau: float, band: float) -> float:
    """Time after which ``exp(-t / tau)`` leaves no node outside the band.

    In the norm ``sqrt(y^T C y)`` every deviation ``y`` falls at least as ``exp(-t / tau)``; a voltage is at most that
    norm over the root of the smallest eigenvalue of C, which is at least the smallest capacitance to a rail; and the
    voltages of nodes without capacitance lie between others.
    """
    C = dynamics.capacitance
    charged = charge_basis(dynamics).charged
    norm = float(np.sqrt(max(deviation @ (C.matrix @ deviation), 0.0)))
    stiffness = C.excess[charged]
    smallest = float(stiffness.min()) if (stiffness > 0).all() else _smallest_eigenvalue(C.matrix[charged][:, charged])
    return tau * max(float(np.log(max(norm, 1e-300) / (np.sqrt(smallest) * band))), 0.0)


def _smallest_eigenvalue(matrix: Any) -> float:
    from scipy.sparse.linalg import eigsh

    if matrix.shape[0] <= 200:
        return float(np.linalg.eigvalsh(matrix.toarray())[0])
    return float(eigsh(matrix.tocsc(), 1, sigma=0.0, return_eigenvectors=False)[0])


def _last_crossing(times: NDArray[np.float64], distance: NDArray[np.float64], band: float) -> NDArray[np.float64]:
    """When every column last falls below the band, between samples as an exponential."""
    outside = distance > band
    moved = outside.any(axis=0)
    last = len(times) - 1 - np.argmax(outside[::-1], axis=0)
    before = np.minimum(last, len(times) - 2) if len(times) > 1 else last
    column = np.arange(distance.shape[1])
    result = np.zeros(distance.shape[1])
    if len(times) > 1:
        high, low = (np.log(np.maximum(distance[row, column], 1e-300)) for row in (before, before + 1))
        with np.errstate(invalid="ignore", divide="ignore"):
            part = np.clip((high - np.log(band)) / (high - low), 0.0, 1.0)
        result = np.where(moved, times[before] + part * (times[before + 1] - times[before]), 0.0)
    return result


def _power(netlist: Netlist, voltage: NDArray[np.float64]) -> float:
    across = np.subtract(*voltage[netlist.resistor_nodes.T])
    return float(np.nansum(netlist.conductance * across * across))
