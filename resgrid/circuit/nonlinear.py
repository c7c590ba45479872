"""The operating point of a circuit with nonlinear resistors, ``I = I0 tanh(dV / V0)``, by Newton's method.

The operating point minimises the co-content (Millar 1951), the sum of ``integral of I dV`` over all elements minus what
the current sources put in.  Every branch is monotone, so the co-content is convex and every Newton step solves an
M-matrix, that of the circuit's differential conductances ``I0 / V0 sech^2(dV / V0)``.

At its operating point a nonlinear resistor carries what a linear one of its *secant* conductance ``I / dV`` would.  So
the answer is read off the linear circuit of those, with all that solving a linear circuit promises: it keeps its last
digits, has no local minimum, and its field is direction-safe.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.circuit.equations import Equations, assemble
from resgrid.circuit.linear import solve_linear
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.readout import DIRECTION_RESIDUAL
from resgrid.circuit.saturation import refuse_saturated_cut
from resgrid.errors import AccuracyError
from resgrid.netlist import Netlist, add_elements, crossed_by, select_elements
from resgrid.solvers.choose import factor_laplacian
from resgrid.solvers.monitor import Progress

_MANY_STEPS, MOST_STEPS = 20, 200
"""Steps after which a cut may be overloaded, and at most."""

_EPS = float(np.finfo(np.float64).eps)
_FLOOR = 1e-15
"""Least differential conductance, as a share of the one at 0 V: what keeps the matrix regular in saturation."""

_NEGLIGIBLE = 1e-9
"""Largest violation of Kirchhoff's current law at the end, as a share of the largest current."""

_WORTHWHILE = 0.05
"""Share of a Newton step from which nothing else is tried."""

_SHORTER, _SHORTEST = 0.7, 1e-30
_ROUNDING = 1e-12
"""Rise of the co-content, as a share of the sum of its parts, that may be rounding."""

_SATURATED = 14.0
"""``dV / V0`` from which the current of a nonlinear resistor is hard to tell from its ``I0``: then 1 in 1e12."""

_SHARE_NOISE = 1e-13
"""Relative error of nonlinear currents; near saturation it makes much of the drop uncertain."""

_SETTLED = 1e-13
_MOST_PASSES = 8


def solve_nonlinear(
    netlist: Netlist, *, accuracy: str, method: str, rtol: float, progress: Progress | None = None
) -> OperatingPoint:
    """Find the operating point of a netlist with nonlinear resistors; the rest of `resgrid.solve`.

    Newton's method gives voltages to the rounding of doubles; the linear circuit of the secant conductances at them
    gives the answer with its last digits, and better secants, until these rest.
    """
    try:
        return _settled(netlist, accuracy=accuracy, method=method, rtol=rtol, progress=progress)
    except AccuracyError:
        # Voltages without bound look like any other failure until the flow through the circuit is asked.
        refuse_saturated_cut(netlist, assemble(linear_netlist(netlist, netlist.nonlinear_current)))
        raise


def _settled(netlist: Netlist, *, accuracy: str, method: str, rtol: float, progress: Progress | None) -> OperatingPoint:
    start = time.perf_counter()
    voltage = newton(netlist, method=method).voltage
    seconds = time.perf_counter() - start
    secant = secant_conductance(netlist, _drops(netlist, voltage))
    best: OperatingPoint | None = None
    least = np.inf
    for _ in range(_MOST_PASSES):
        chords = linear_netlist(netlist, secant)
        point = solve_linear(chords, accuracy=accuracy, method=method, rtol=rtol, progress=progress)
        drop = point.resistor_current[len(netlist.conductance) :] / secant
        better = secant_conductance(netlist, drop)
        change = float(np.abs(better / secant - 1).max())
        if not change < least:
            break
        best, least, secant = point, change, better
        if change <= _SETTLED:
            break
    assert best is not None
    answer = _in_place(netlist, best, least, seconds)
    if least > DIRECTION_RESIDUAL:
        raise AccuracyError(
            f"the currents of nonlinear resistors are settled to {least:.1e} only: V0 is too small beside the "
            "voltages of the circuit to tell the drop across a resistor",
            answer,
        )
    return answer


def small_signal(op: OperatingPoint) -> Netlist:
    """The linear circuit that small signals see around an operating point.

    Parameters
    ----------
    op : OperatingPoint

    Returns
    -------
    Netlist
        The same nodes, sources and capacitors; every nonlinear resistor is a resistor of its differential conductance
        ``dI / dV``, appended to the resistors.

    Examples
    --------
    >>> netlist = rg.Netlist(
    ...     3, [[1, 2]], [1e-3], source_nodes=[[1, 0]], source_volts=[0.2],
    ...     nonlinear_nodes=[[2, 0]], nonlinear_current=[1e-3], nonlinear_voltage=[0.1],
    ... )
    >>> rg.small_signal(rg.solve(netlist)).conductance.round(6)
    array([0.001  , 0.00967])
    """
    netlist = op.netlist
    if not netlist.nonlinear_nodes.size:
        return netlist
    return linear_netlist(netlist, differential_conductance(netlist, nonlinear_drops(op)))


def nonlinear_drops(point: OperatingPoint) -> NDArray[np.float64]:
    """Voltages across the nonlinear resistors, as their currents tell them, or the node voltages where these tell more.

    Returns (nonlinear resistors,).
    """
    netlist = point.netlist
    scale, share = netlist.nonlinear_voltage, np.abs(point.nonlinear_amps) / netlist.nonlinear_current
    largest = np.abs(np.nan_to_num(point.voltage)[netlist.nonlinear_nodes]).max(axis=1, initial=0.0)
    saturated = (share > 0.5) & (_SHARE_NOISE * scale > np.finfo(np.float64).eps * largest * (1.0 - share))
    told = np.sign(point.nonlinear_amps) * scale * np.arctanh(np.where(saturated, 0.0, share))
    return np.where(saturated, _drops(netlist, point.voltage), told)


def _drops(netlist: Netlist, voltage: NDArray[np.float64]) -> NDArray[np.float64]:
    first, second = voltage[netlist.nonlinear_nodes].T
    return np.asarray(np.nan_to_num(first - second))


def _in_place(netlist: Netlist, point: OperatingPoint, change: float, seconds: float) -> OperatingPoint:
    """The operating point of the linear circuit as that of the nonlinear one."""
    m, log = len(netlist.conductance), point.resistor_log_current
    return dataclasses.replace(
        point,
        netlist=netlist,
        entry_error=np.inf,
        ammeters=point.readings.of_first(m, max(point.kcl_residual, change)),
        nonlinear_amps=point.resistor_current[m:],
        nonlinear_log_amps=log[m:],
        nonlinear_direction=point.resistor_direction[m:],
        method=f"newton, {point.method}",
        seconds={"newton": seconds, **point.seconds},
    )


@dataclass(frozen=True, eq=False)
class NewtonSolution:
    """Where Newton's method ended, and the way there.

    `voltage` (nodes,): node voltages above ground, in volts; NaN where a node floats; `residual`: largest violation
    of Kirchhoff's current law before every step and after the last one, in amperes; `step`: share of every Newton
    step that was taken; 1 for a full one, 0 where secants took its place.
    """

    voltage: NDArray[np.float64]
    residual: tuple[float, ...]
    step: tuple[float, ...]


def newton(netlist: Netlist, *, method: str = "auto") -> NewtonSolution:
    """Find the node voltages of a circuit with nonlinear resistors.

    Damped: a step is shortened until the co-content falls along all of it.  Where little of it would be left, deep in
    saturation, a step with the secant conductances may be better: it minimises a quadratic above the co-content that
    touches it (as iteratively reweighted least squares do), so that the co-content falls as well.
    """
    circuit = _Circuit.of(netlist)
    x = np.zeros(circuit.system.size)
    residuals: list[float] = []
    steps: list[float] = []
    while len(steps) < MOST_STEPS:
        excess = circuit.excess(x)
        residuals.append(float(np.abs(excess).max(initial=0.0)))
        if residuals[-1] <= _NEGLIGIBLE * circuit.largest_current(x) and np.all(np.abs(excess) <= circuit.rounding(x)):
            if np.abs(circuit.ratio(x)).max(initial=0.0) > _SATURATED:
                refuse_saturated_cut(netlist, circuit.system)
            return NewtonSolution(circuit.system.voltages(x), tuple(residuals), tuple(steps))
        move, share = _step(circuit, x, excess, method)
        x = x + move
        steps.append(share)
        if len(steps) == _MANY_STEPS:
            refuse_saturated_cut(netlist, circuit.system)
        if share > 0.0 and np.abs(move).max() <= 4 * _EPS * share * np.abs(x).max():
            return NewtonSolution(circuit.system.voltages(x), tuple(residuals), tuple(steps))
    raise AccuracyError(
        f"Newton's method did not converge in {MOST_STEPS} steps: Kirchhoff's current law is still violated by "
        f"{residuals[-1]:.1e} A",
        NewtonSolution(circuit.system.voltages(x), tuple(residuals), tuple(steps)),
    )


def linear_netlist(netlist: Netlist, conductance: NDArray[np.float64]) -> Netlist:
    """Put a linear resistor in the place of every nonlinear one.  Shapes: `conductance` (nonlinear resistors,)."""
    ends, crossed = netlist.nonlinear_nodes, crossed_by(netlist, "nonlinear resistor")
    joined = add_elements(netlist, "resistor", ends, conductance, **crossed)
    return select_elements(joined, "nonlinear resistor", np.zeros(len(ends), dtype=np.bool_))


def secant_conductance(netlist: Netlist, drop: NDArray[np.float64]) -> NDArray[np.float64]:
    """Conductance ``I0 tanh(dV / V0) / dV`` of every nonlinear resistor.

    Shapes: `drop` (nonlinear resistors,); returns (nonlinear resistors,).
    """
    x = np.abs(drop / netlist.nonlinear_voltage)
    small = x < 1e-4
    ratio = np.where(small, 1 - x * x / 3, np.tanh(x) / np.where(small, 1.0, x))
    return np.asarray(_slope_at_zero(netlist) * ratio)


def differential_conductance(netlist: Netlist, drop: NDArray[np.float64]) -> NDArray[np.float64]:
    """Conductance ``dI / dV = I0 / V0 sech^2(dV / V0)`` of every nonlinear resistor: what a small signal sees.

    Shapes: `drop` (nonlinear resistors,); returns (nonlinear resistors,).
    """
    decay = np.exp(-2 * np.abs(drop / netlist.nonlinear_voltage))
    return np.asarray(_slope_at_zero(netlist) * np.maximum(4 * decay / (1 + decay) ** 2, _FLOOR))


def _slope_at_zero(netlist: Netlist) -> NDArray[np.float64]:
    return np.asarray(netlist.nonlinear_current / netlist.nonlinear_voltage)


Law = Callable[[Netlist, NDArray[np.float64]], NDArray[np.float64]]
"""Conductances of nonlinear resistors at the voltages across them."""


@dataclass(frozen=True, eq=False)
class _Circuit:
    """Kirchhoff's current law for the rows of a nodal system, each element with its own law; linear resistors first.

    `incidence` (elements, n): from rows to what they add to the voltages across elements; `lift` (elements,): these
    voltages where all rows are 0.
    """

    netlist: Netlist
    system: Equations
    incidence: sparse.csr_array
    lift: NDArray[np.float64]

    @classmethod
    def of(cls, netlist: Netlist) -> _Circuit:
        system = assemble(linear_netlist(netlist, _slope_at_zero(netlist)))
        heights = np.nan_to_num(system.heights(np.zeros(system.size)))
        ends = np.concatenate([netlist.resistor_nodes, netlist.nonlinear_nodes])
        element, end = np.nonzero(system.unknown[ends] >= 0)
        entries = (1.0 - 2.0 * end, (element, system.unknown[ends][element, end]))
        incidence = sparse.coo_array(entries, shape=(len(ends), system.size)).tocsr()
        return cls(netlist, system, incidence, heights[ends[:, 0]] - heights[ends[:, 1]])

    def drops(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Voltage across every element."""
        return np.asarray(self.incidence @ x + self.lift)

    def ratio(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """``dV / V0`` of every nonlinear resistor."""
        return np.asarray(self.drops(x)[len(self.netlist.conductance) :] / self.netlist.nonlinear_voltage)

    def amps(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Current through every element."""
        g = self.netlist.conductance
        return np.append(g * self.drops(x)[: len(g)], self.netlist.nonlinear_current * np.tanh(self.ratio(x)))

    def siemens(self, x: NDArray[np.float64], law: Law) -> NDArray[np.float64]:
        """Conductance of every element by a law of the nonlinear ones."""
        g = self.netlist.conductance
        return np.append(g, law(self.netlist, self.drops(x)[len(g) :]))

    def excess(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Current that leaves every row beyond what is fed in."""
        return np.asarray(self.incidence.T @ self.amps(x) - self.system.injected)

    def rounding(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """How much of the excess may be rounding."""
        touched = abs(self.incidence)
        reach = touched @ np.abs(x) + np.abs(self.lift)
        error = self.siemens(x, differential_conductance) * reach + np.abs(self.amps(x))
        return np.asarray(4 * _EPS * (touched.T @ error + np.abs(self.system.injected)))

    def largest_current(self, x: NDArray[np.float64]) -> float:
        """Largest current that an element carries or a source feeds in."""
        return float(max(np.abs(part).max(initial=0.0) for part in (self.amps(x), self.system.injected)))

    def content(self, x: NDArray[np.float64]) -> tuple[float, float]:
        """The co-content in watts, and the sum of its parts' magnitudes."""
        netlist, ratio = self.netlist, np.abs(self.ratio(x))
        log_cosh = ratio + np.log1p(np.exp(-2 * ratio)) - np.log(2.0)
        with np.errstate(over="ignore"):
            stored = float(0.5 * netlist.conductance @ self.drops(x)[: len(netlist.conductance)] ** 2)
        stored += float((netlist.nonlinear_current * netlist.nonlinear_voltage) @ log_cosh)
        fed = self.system.injected * x
        return stored - float(fed.sum()), stored + float(np.abs(fed).sum())

    def move(self, x: NDArray[np.float64], excess: NDArray[np.float64], law: Law, method: str) -> NDArray[np.float64]:
        """What takes the excess away if conductances stay as they are."""
        matrix, _ = self.system.with_conductance(self.siemens(x, law), self.system.found_contacts())
        return factor_laplacian(matrix, method).solve(-excess, rtol=1e-8)


def _step(
    circuit: _Circuit, x: NDArray[np.float64], excess: NDArray[np.float64], method: str
) -> tuple[NDArray[np.float64], float]:
    """What to move by, and the share of a Newton step that it is: 0 for a step of the secants."""
    here, size = circuit.content(x)
    choices: list[tuple[float, NDArray[np.float64], float]] = []
    with suppress(AccuracyError):  # differential conductances that vanish can leave the matrix singular
        direction = circuit.move(x, excess, differential_conductance, method)
        share = _share(circuit, x, direction, excess)
        there = circuit.content(x + share * direction)[0]
        if share >= _WORTHWHILE and there <= here + _ROUNDING * size:
            return share * direction, share
        choices.append((there, share * direction, share))
    move = circuit.move(x, excess, secant_conductance, method)
    choices.append((circuit.content(x + move)[0], move, 0.0))
    _, move, share = min(choices, key=lambda choice: choice[0])
    return move, share


def _share(
    circuit: _Circuit, x: NDArray[np.float64], direction: NDArray[np.float64], excess: NDArray[np.float64]
) -> float:
    """How much of a Newton step to take: all of it unless the co-content, convex along it, rises before its end."""

    def slope(share: float) -> float:
        return float(circuit.excess(x + share * direction) @ direction)

    first, share = abs(float(excess @ direction)), 1.0
    while slope(share) > 0.1 * first and share > _SHORTEST:
        share *= _SHORTER
    return share
