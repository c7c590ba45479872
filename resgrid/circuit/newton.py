"""Newton's method for nonlinear resistors, ``I = I0 tanh(dV / V0)``.

The operating point minimises the co-content (Millar 1951), the sum of ``integral of I dV`` over all elements minus what
the current sources put in.  Every branch is monotone, so the co-content is convex and every Newton step solves an
M-matrix, that of the circuit's differential conductances ``I0 / V0 sech^2(dV / V0)``.

At its operating point a nonlinear resistor carries what a linear one of its *secant* conductance ``I / dV`` would.  So
the answer is read off the linear circuit of those, with all that solving a linear circuit promises: it keeps its last
digits, has no local minimum, and its field is direction-safe.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.equations import Equations, assemble
from resgrid.circuit.saturation import refuse_saturated_cut
from resgrid.errors import AccuracyError
from resgrid.netlist import Netlist, add_elements, crossed_by, select_elements
from resgrid.solvers.choose import factor_laplacian

MOST_STEPS = 200
_EPS = float(np.finfo(np.float64).eps)
_FLOOR = 1e-15
"""Least differential conductance, as a share of the one at 0 V: what keeps the matrix regular in saturation."""

_NEGLIGIBLE = 1e-9
"""Largest violation of Kirchhoff's current law at the end, as a share of the largest current."""

_WORTHWHILE = 0.05
"""Share of a Newton step from which nothing else is tried."""

_SHORTER, _SHORTEST = 0.125, 1e-30
_ROUNDING = 1e-12
"""Rise of the co-content, as a share of the sum of its parts, that may be rounding."""

_SATURATED = 14.0
"""``dV / V0`` from which the current of a nonlinear resistor is hard to tell from its ``I0``: then 1 in 1e12."""


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
    circuit = _Circuit.of(netlist, assemble(linear_netlist(netlist, _slope_at_zero(netlist))))
    x = np.zeros(circuit.system.size)
    residuals: list[float] = []
    steps: list[float] = []
    while len(steps) < MOST_STEPS:
        d = circuit.drops(x)
        excess, noise = circuit.excess(x, d)
        residuals.append(float(np.abs(excess).max(initial=0.0)))
        if np.all(np.abs(excess) <= noise) and residuals[-1] <= _NEGLIGIBLE * circuit.largest_current(d):
            if circuit.saturation(d) > _SATURATED:
                refuse_saturated_cut(netlist, circuit.system)
            return NewtonSolution(circuit.voltage(x), tuple(residuals), tuple(steps))
        try:
            move, share = _step(circuit, x, excess, method)
        except AccuracyError:
            refuse_saturated_cut(netlist, circuit.system)
            raise
        x = x + move
        steps.append(share)
        if len(steps) in {20, MOST_STEPS}:
            refuse_saturated_cut(netlist, circuit.system)
        if share > 0.0 and np.abs(move).max() <= 4 * _EPS * share * np.abs(x).max():
            return NewtonSolution(circuit.voltage(x), tuple(residuals), tuple(steps))
    raise AccuracyError(
        f"Newton's method did not converge in {MOST_STEPS} steps: Kirchhoff's current law is still violated by "
        f"{residuals[-1]:.1e} A",
        NewtonSolution(circuit.voltage(x), tuple(residuals), tuple(steps)),
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


@dataclass(frozen=True, eq=False)
class _Circuit:
    """Kirchhoff's current law for the rows of a nodal system, each element with its own law.

    `ends` (resistors + nonlinear resistors, 2): their nodes; `offset` (nodes,): voltage above the reference where all
    rows are 0, in volts; 0 where a node floats.
    """

    netlist: Netlist
    system: Equations
    ends: NDArray[np.int64]
    offset: NDArray[np.float64]

    @classmethod
    def of(cls, netlist: Netlist, system: Equations) -> _Circuit:
        fixed = np.nan_to_num(system.known_voltages() - system.reference)
        offset = np.where(system.unknown >= 0, system.forest.offset, fixed)
        return cls(netlist, system, np.concatenate([netlist.resistor_nodes, netlist.nonlinear_nodes]), offset)

    def height(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Voltage above the reference, shape (nodes,)."""
        unknown = self.system.unknown
        return self.offset + np.where(unknown >= 0, x[unknown] if len(x) else 0.0, 0.0)

    def voltage(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Node voltages above ground."""
        solved = self.system.unknown >= 0
        return np.where(solved, self.system.reference + self.height(x), self.system.known_voltages())

    def drops(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Voltage across every element, shape (resistors + nonlinear resistors,)."""
        height = self.height(x)
        return np.asarray(height[self.ends[:, 0]] - height[self.ends[:, 1]])

    def slopes(self, d: NDArray[np.float64]) -> NDArray[np.float64]:
        """Differential conductance of every element."""
        m = len(self.netlist.conductance)
        return np.append(self.netlist.conductance, differential_conductance(self.netlist, d[m:]))

    def excess(self, x: NDArray[np.float64], d: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Current that leaves every row beyond what is fed in, and how much of it may be rounding."""
        netlist, m = self.netlist, len(self.netlist.conductance)
        tanh = netlist.nonlinear_current * np.tanh(d[m:] / netlist.nonlinear_voltage)
        amps = np.append(netlist.conductance * d[:m], tanh)
        high = np.abs(self.height(x))
        error = 4 * _EPS * (self.slopes(d) * (high[self.ends[:, 0]] + high[self.ends[:, 1]]) + np.abs(amps))
        excess, noise = -self.system.injected, 4 * _EPS * np.abs(self.system.injected)
        for end, sign in zip(self.ends.T, (1.0, -1.0), strict=True):
            row = self.system.unknown[end]
            solved = row >= 0
            excess = excess + sign * np.bincount(row[solved], amps[solved], len(excess))
            noise = noise + np.bincount(row[solved], error[solved], len(excess))
        return excess, noise

    def largest_current(self, d: NDArray[np.float64]) -> float:
        """Largest current that an element carries or a source feeds in."""
        m = len(self.netlist.conductance)
        linear = self.netlist.conductance * np.abs(d[:m])
        tanh = self.netlist.nonlinear_current * np.tanh(np.abs(d[m:]) / self.netlist.nonlinear_voltage)
        return float(max(linear.max(initial=0.0), tanh.max(initial=0.0), np.abs(self.system.injected).max(initial=0.0)))

    def saturation(self, d: NDArray[np.float64]) -> float:
        """Largest ``dV / V0`` across a nonlinear resistor."""
        return float(np.abs(d[len(self.netlist.conductance) :] / self.netlist.nonlinear_voltage).max(initial=0.0))

    def content(self, x: NDArray[np.float64]) -> tuple[float, float]:
        """The co-content in watts, and the sum of its parts' magnitudes."""
        d, netlist, m = self.drops(x), self.netlist, len(self.netlist.conductance)
        ratio = np.abs(d[m:] / netlist.nonlinear_voltage)
        log_cosh = ratio + np.log1p(np.exp(-2 * ratio)) - np.log(2.0)
        with np.errstate(over="ignore"):
            stored = float(0.5 * np.sum(netlist.conductance * d[:m] ** 2))
        stored += float(np.sum(netlist.nonlinear_current * netlist.nonlinear_voltage * log_cosh))
        fed = self.system.injected * x
        return stored - float(fed.sum()), stored + float(np.abs(fed).sum())

    def secants(self, d: NDArray[np.float64]) -> NDArray[np.float64]:
        """Secant conductance of every element."""
        m = len(self.netlist.conductance)
        return np.append(self.netlist.conductance, secant_conductance(self.netlist, d[m:]))


def _step(
    circuit: _Circuit, x: NDArray[np.float64], excess: NDArray[np.float64], method: str
) -> tuple[NDArray[np.float64], float]:
    """What to move by, and the share of a Newton step that it is: 0 for a step of the secants."""
    d = circuit.drops(x)
    here, size = circuit.content(x)
    choices: list[tuple[float, NDArray[np.float64], float]] = []
    try:
        direction = factor_laplacian(circuit.system.with_conductance(circuit.slopes(d))[0], method).solve(
            -excess, rtol=1e-8
        )
        share = _share(circuit, x, direction, excess)
        there = circuit.content(x + share * direction)[0]
        if share >= _WORTHWHILE and there <= here + _ROUNDING * size:
            return share * direction, share
        choices.append((there, share * direction, share))
    except AccuracyError:  # differential conductances that vanish can leave the matrix singular
        pass
    matrix, _ = circuit.system.with_conductance(circuit.secants(d))
    move = factor_laplacian(matrix, method).solve(-excess, rtol=1e-8)
    choices.append((circuit.content(x + move)[0], move, 0.0))
    _, move, share = min(choices, key=lambda choice: choice[0])
    return move, share


def _share(
    circuit: _Circuit, x: NDArray[np.float64], direction: NDArray[np.float64], excess: NDArray[np.float64]
) -> float:
    """How much of a Newton step to take: all of it unless the co-content, convex along it, rises before its end."""

    def slope(share: float) -> float:
        there = x + share * direction
        return float(circuit.excess(there, circuit.drops(there))[0] @ direction)

    first = abs(float(excess @ direction))
    if slope(1.0) <= 0.1 * first:
        return 1.0
    high, low = 1.0, _SHORTER
    while slope(low) > 0 and low > _SHORTEST:
        high, low = low, low * _SHORTER
    while high - low > 0.1 * low:
        middle = 0.5 * (low + high)
        here = slope(middle)
        if -0.5 * first <= here <= 0:
            return middle
        low, high = (middle, high) if here < 0 else (low, middle)
    return low
