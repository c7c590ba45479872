"""The operating point of a circuit with nonlinear resistors, ``I = I0 tanh(dV / V0)``, by Newton's method.

The operating point minimises the co-content (Millar 1951): the sum of ``integral of I dV`` over all elements, minus the
sum of source current times voltage.  Every branch current increases with its voltage, so that the co-content is convex.
Every Newton step solves a linear system with an M-matrix: the matrix of the linear circuit of the differential
conductances ``I0 / V0 sech^2(dV / V0)``.

At the operating point a nonlinear resistor carries the same current as a linear resistor of the *secant* conductance
``I / dV``.  The result is therefore the operating point of the linear circuit of secant conductances, and is as
accurate as the operating point of any linear circuit: the potential has no local minimum and is direction-safe.

A nonlinear resistor carries less than ``I0``.  An operating point exists if and only if the current injected into any
set of nodes is less than the sum of ``I0`` of the resistors that leave the set (Ford & Fulkerson 1956).  Otherwise the
Newton iterates grow without bound, and a set that violates the condition is the set of nodes above, or below, one of
their voltages: the co-content decreases along the iterates, and it is an integral over these sets (coarea formula;
Strang 1983).
"""

from __future__ import annotations

import dataclasses
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.circuit.equations import Equations, across, assemble
from resgrid.circuit.linear import solve_linear
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.postprocess import DIRECTION_RESIDUAL
from resgrid.core.netlist import Netlist, add_elements, crossed_by, select_elements
from resgrid.errors import AccuracyError, CircuitError
from resgrid.solvers.method_choice import factor_laplacian
from resgrid.solvers.progress import Progress

_MANY_STEPS, MOST_STEPS = 20, 200
"""Number of Newton steps after which overloaded cuts are searched for, and largest number of Newton steps.

An overloaded cut is a set of nonlinear resistors that cannot carry the current of the sources; it raises CircuitError.
"""

_EPS = float(np.finfo(np.float64).eps)
_FLOOR = 1e-15
"""Smallest slope in Newton's steps, as a fraction of the conductance at 0 V; keeps the matrix regular."""

_LEAST = 5e-324
"""Smallest positive double: smallest differential conductance, in siemens."""

_NEGLIGIBLE = 1e-9
"""Largest violation of KCL at convergence, as a fraction of the largest resistor or injected current."""

_WORTHWHILE = 0.05
"""Smallest useful step length, as a fraction of a Newton step; a shorter step is replaced by a secant step."""

_SHORTER, _SHORTEST = 0.7, 1e-30
"""Factor by which a step is shortened, and smallest step length as a fraction of a Newton step."""

_SATURATED = 14.0
"""Ratio ``dV / V0`` above which a nonlinear resistor counts as saturated: its current is within 1e-12 of ``I0``."""

_MARGIN = 1e-12
"""Relative rounding error of the capacity of a cut, which is the sum of ``I0`` of the resistors in the cut."""

_CURRENT_ROUNDING = 1e-13
"""Relative rounding error of nonlinear currents; near saturation a voltage computed from the current is uncertain."""

_SETTLED = 1e-13
_MOST_PASSES = 8


def solve_nonlinear(
    netlist: Netlist, *, accuracy: str, method: str, rtol: float, progress: Progress | None = None
) -> OperatingPoint:
    """Return the operating point of a netlist with nonlinear resistors.

    `accuracy`: ``"direction"`` (componentwise) or ``"normwise"``; `method` of the linear solves: ``"auto"``,
    ``"direct"`` or ``"multigrid"``; `rtol`: largest backward error for ``"normwise"``; `progress`: function called
    after every iteration with the number of iterations, the relative residual norm, and the estimated remaining seconds
    or None.  Raise CircuitError if current sources exceed the capacity of nonlinear resistors, and AccuracyError
    without convergence.

    Newton's method computes the voltages to the rounding of doubles.  Then the linear circuit of secant conductances is
    solved repeatedly, with conductances updated from the branch currents, until the conductances no longer change.
    """
    start = time.perf_counter()
    voltage = newton(netlist, method=method).voltage
    seconds = time.perf_counter() - start
    law = _Law.of(netlist)
    secant = law.secant(across(voltage, netlist.nonlinear_nodes))
    best: OperatingPoint | None = None
    least = np.inf
    for _ in range(_MOST_PASSES):
        linear = linear_netlist(netlist, secant)
        point = solve_linear(linear, accuracy=accuracy, method=method, rtol=rtol, progress=progress)
        updated = law.secant(point.resistor_current[len(netlist.conductance) :] / secant)
        change = float(np.abs(updated / secant - 1).max())
        if not change < least:
            break
        best, least, secant = point, change, updated
        if change <= _SETTLED:
            break
    assert best is not None
    m, currents, (amps, exponent) = len(netlist.conductance), best.readings, best.readings.scaled
    answer = dataclasses.replace(
        best,
        netlist=netlist,
        entry_error=np.inf,
        _currents=currents._replace(
            resistor_current=currents.resistor_current[:m],
            scaled=(amps[:m], exponent[:m]),
            kcl_residual=max(currents.kcl_residual, least),
        ),
        nonlinear_amps=currents.resistor_current[m:],
        nonlinear_log_amps=best.resistor_log_current[m:],
        nonlinear_direction=best.resistor_direction[m:],
        method=f"newton, {best.method}",
        seconds={"newton": seconds, **best.seconds},
    )
    if least > DIRECTION_RESIDUAL:
        raise AccuracyError(
            f"the currents of nonlinear resistors converged to a relative error of only {least:.1e}: V0 is too small "
            "compared with the voltages of the circuit to resolve the voltage across a resistor; use a larger V0",
            answer,
        )
    return answer


def linearize(op: OperatingPoint) -> Netlist:
    """Return the small-signal circuit: the linearization of a circuit around an operating point.

    Parameters
    ----------
    op : OperatingPoint
        The operating point to linearize around.

    Returns
    -------
    Netlist
        Circuit with the same nodes, sources and capacitors.  Every nonlinear resistor becomes a resistor of its
        differential conductance ``dI / dV``, in siemens, at least 5e-324 S; these resistors follow the linear ones.

    Examples
    --------
    >>> netlist = rg.Netlist(
    ...     3, [[1, 2]], [1e-3], source_nodes=[[1, 0]], source_volts=[0.2],
    ...     nonlinear_nodes=[[2, 0]], nonlinear_current=[1e-3], nonlinear_voltage=[0.1],
    ... )
    >>> rg.circuit.linearize(rg.solve(netlist)).conductance.round(6)
    array([0.001  , 0.00967])
    """
    netlist = op.netlist
    if not netlist.nonlinear_nodes.size:
        return netlist
    return linear_netlist(netlist, _Law.of(netlist).differential(nonlinear_drops(op)))


def nonlinear_drops(point: OperatingPoint) -> NDArray[np.float64]:
    """Return the voltages across the nonlinear resistors of an operating point, in volts, (nonlinear resistors,).

    A voltage is that of the first node minus that of the second.  It is computed from the current, or near saturation
    from the node voltages, whichever is more accurate.
    """
    netlist = point.netlist
    scale, fraction = netlist.nonlinear_voltage, np.abs(point.nonlinear_amps) / netlist.nonlinear_current
    largest = np.abs(np.nan_to_num(point.voltage)[netlist.nonlinear_nodes]).max(axis=1, initial=0.0)
    from_current_error, from_voltage_error = _CURRENT_ROUNDING * scale, np.finfo(np.float64).eps * largest
    saturated = (fraction > 0.5) & (from_current_error > from_voltage_error * (1.0 - fraction))
    from_current = np.sign(point.nonlinear_amps) * scale * np.arctanh(np.where(saturated, 0.0, fraction))
    return np.where(saturated, across(point.voltage, netlist.nonlinear_nodes), from_current)


class NewtonSolution(NamedTuple):
    """Result and history of Newton's method.

    `voltage` (nodes,): node voltages above ground, in volts; NaN where a node floats; `residual`: largest violation of
    Kirchhoff's current law in amperes, before every step and after the last step; `step`: length of every step as a
    fraction of the Newton step; 1 for a full step, 0 for a secant step.
    """

    voltage: NDArray[np.float64]
    residual: list[float]
    step: list[float]


def newton(netlist: Netlist, *, method: str = "auto") -> NewtonSolution:
    """Return the node voltages of a circuit with nonlinear resistors, from a damped Newton method.

    `method` of the linear solves: ``"auto"``, ``"direct"`` or ``"multigrid"``.  A step is shortened until the
    co-content decreases along the whole step.  If the steps become very short, deep in saturation, they alternate with
    steps that use the secant conductances.  A secant step minimises a quadratic upper bound of the co-content that
    touches it at the current voltages, as in iteratively reweighted least squares.

    Raise CircuitError if the current sources exceed the capacity of a cut, the sum of ``I0`` of the resistors in the
    cut, and AccuracyError without convergence.
    """
    circuit = _NonlinearCircuit.of(netlist, method)
    x, stalled = np.zeros(circuit.system.size), False
    residuals: list[float] = []
    steps: list[float] = []
    while True:
        drop = circuit.drops(x)
        excess = circuit.excess(drop)
        residuals.append(float(np.abs(excess).max(initial=0.0)))
        done = stalled or circuit.obeys_kcl(x, drop, excess)
        saturated = np.abs(drop / circuit.law.volts).max(initial=0.0) > _SATURATED
        if len(steps) in (_MANY_STEPS, MOST_STEPS) or (done and saturated):
            circuit.refuse_overloaded_cut(netlist, x)
        if done or len(steps) == MOST_STEPS:
            found = NewtonSolution(circuit.system.voltages(x), residuals, steps)
            if done:
                return found
            raise AccuracyError(
                f"Newton's method did not converge in {MOST_STEPS} steps: Kirchhoff's current law is still violated by "
                f"{residuals[-1]:.1e} A",
                found,
            )
        try:
            move, length = circuit.step(x, drop, excess, _SHORTEST if 0.0 in steps[-1:] else _WORTHWHILE)
        except AccuracyError:  # the reason may be an overloaded cut, for which voltages grow without bound
            circuit.refuse_overloaded_cut(netlist, x)
            raise
        x = x + move
        steps.append(length)
        stalled = length > 0.0 and bool(np.abs(move).max() <= 4 * _EPS * length * np.abs(x).max())


def linear_netlist(netlist: Netlist, conductance: NDArray[np.float64]) -> Netlist:
    """Return the netlist with every nonlinear resistor replaced by a linear one, appended to the resistors.

    `conductance` (nonlinear resistors,): conductances of the new resistors, in siemens.
    """
    ends, crossed = netlist.nonlinear_nodes, crossed_by(netlist, "nonlinear resistor")
    joined = add_elements(netlist, "resistor", ends, conductance, **crossed)
    return select_elements(joined, "nonlinear resistor", np.zeros(len(ends), dtype=np.bool_))


class _Law(NamedTuple):
    """Characteristic ``I = G V0 tanh(dV / V0)`` of m resistors, with the current ``I`` and the voltage ``dV``.

    `siemens` (m,): conductance ``G`` at 0 V, in siemens; `volts` (m,): ``V0`` in volts, infinite for a linear resistor.
    """

    siemens: NDArray[np.float64]
    volts: NDArray[np.float64]

    @classmethod
    def of(cls, netlist: Netlist) -> _Law:
        """Return the characteristic of the nonlinear resistors of a netlist."""
        return cls(netlist.nonlinear_current / netlist.nonlinear_voltage, netlist.nonlinear_voltage)

    def secant(self, drop: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the secant conductances ``I / dV`` in siemens, (m,); `drop` (m,): voltages ``dV`` in volts."""
        x = np.abs(drop / self.volts)
        small = x < 1e-4
        return np.asarray(self.siemens * np.where(small, 1 - x * x / 3, np.tanh(x) / np.where(small, 1.0, x)))

    def differential(self, drop: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the differential conductances ``dI / dV`` in siemens, (m,); `drop` (m,): voltages ``dV`` in volts.

        A conductance below the range of doubles is the smallest double.
        """
        decay = np.exp(-np.abs(drop / self.volts))
        slope = self.siemens * decay * (4 * decay / (1 + decay * decay) ** 2)
        return np.asarray(np.maximum(slope, _LEAST))

    def newton_slope(self, drop: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return differential conductances in siemens, (m,), which are at least 1e-15 of the conductances at 0 V.

        `drop` (m,): voltages ``dV`` in volts.
        """
        return np.maximum(self.differential(drop), _FLOOR * self.siemens)


@dataclass(frozen=True, eq=False)
class _NonlinearCircuit:
    """Kirchhoff's current law for the rows of the nodal equations; elements are first linear, then nonlinear resistors.

    `law`: characteristics of all resistors; `system`: equations of the circuit linearized at 0 V; `method`: method of
    the linear solves; `incidence` (elements, n): matrix that maps row voltages to voltages across elements (first node
    minus second); `lift` (elements,): voltages across elements in volts for rows at 0 V.
    """

    law: _Law
    system: Equations
    method: str
    incidence: sparse.csr_array
    lift: NDArray[np.float64]

    @classmethod
    def of(cls, netlist: Netlist, method: str) -> _NonlinearCircuit:
        own = _Law.of(netlist)
        system = assemble(linear_netlist(netlist, own.siemens))
        siemens, ends = system.netlist.conductance, system.netlist.resistor_nodes
        law = _Law(siemens, np.append(np.full(len(netlist.conductance), np.inf), own.volts))
        rows = system.unknown[ends]
        element, end = np.nonzero(rows >= 0)
        entries = (1.0 - 2.0 * end, (element, rows[element, end]))
        incidence = sparse.coo_array(entries, shape=(len(ends), system.size)).tocsr()
        return cls(law, system, method, incidence, across(system.heights(np.zeros(system.size)), ends))

    def drops(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return voltages across elements, first node minus second, in volts, (elements,); `x` (n,): row voltages."""
        return np.asarray(self.incidence @ x + self.lift)

    def excess(self, drop: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the resistor currents out of every row minus the injected current of the row, in amperes, (n,).

        `drop` (elements,): voltages across the elements in volts.
        """
        return np.asarray(self.incidence.T @ (self.law.secant(drop) * drop) - self.system.injected)

    def obeys_kcl(self, x: NDArray[np.float64], drop: NDArray[np.float64], excess: NDArray[np.float64]) -> bool:
        """Return whether every row violates KCL by at most its rounding error and 1e-9 of the largest current.

        `x` (n,): voltages of the rows; `drop` (elements,): voltages across elements, in volts; `excess` (n,):
        violations in amperes.
        """
        amps, injected = np.abs(self.law.secant(drop) * drop), np.abs(self.system.injected)
        largest, touched = max(amps.max(initial=0.0), injected.max(initial=0.0)), abs(self.incidence)
        error = self.law.newton_slope(drop) * (touched @ np.abs(x) + np.abs(self.lift)) + amps
        rounding = 4 * _EPS * (touched.T @ error + injected)
        return bool(np.all(np.abs(excess) <= np.minimum(rounding, _NEGLIGIBLE * largest)))

    def step(
        self, x: NDArray[np.float64], drop: NDArray[np.float64], excess: NDArray[np.float64], least: float
    ) -> tuple[NDArray[np.float64], float]:
        """Return the change of the row voltages, in volts, (n,), and its length as a fraction of the Newton step.

        `x` (n,), `drop` (elements,): voltages of rows and across elements, in volts; `excess` (n,): violations of KCL
        in amperes; `least`: smallest accepted length of a Newton step; a secant step, for which the returned length is
        0, replaces shorter steps.
        """
        with suppress(AccuracyError):  # the matrix can be singular if differential conductances vanish
            direction, length = self.move(excess, self.law.newton_slope(drop)), 1.0
            # The co-content is convex along the step: shorten it if the slope is positive at its end.
            rise = 0.1 * abs(float(excess @ direction))
            while self.excess(self.drops(x + length * direction)) @ direction > rise and length >= least:
                length *= _SHORTER
            if length >= least:
                return length * direction, length
        return self.move(excess, self.law.secant(drop)), 0.0

    def move(self, excess: NDArray[np.float64], conductance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the change of the row voltages (n,), in volts, that cancels the KCL violations in a linear circuit.

        `excess` (n,): violations in amperes; `conductance` (elements,): conductances of the linear circuit in siemens.
        """
        matrix, _ = self.system.with_conductance(conductance)
        return factor_laplacian(matrix, self.method).solve(-excess, rtol=1e-8)

    def refuse_overloaded_cut(self, netlist: Netlist, x: NDArray[np.float64]) -> None:
        """Raise CircuitError if the current sources exceed the capacity of a cut through nonlinear resistors.

        The capacity is the sum of the currents ``I0`` of the resistors in the cut.  The cuts separate the rows above,
        or below, each voltage of `x` (n,), in volts, from all other rows.
        """
        volts, rank = np.unique(np.append(x, 0.0), return_inverse=True)  # the last entry stands for the rails
        count, rows = len(volts), self.system.unknown[self.system.netlist.resistor_nodes]
        if count < 2:
            return
        below, above = np.sort(rank[rows], axis=1).T
        limit = np.append(np.zeros(len(netlist.conductance)), netlist.nonlinear_current)

        def crossing(weight: NDArray[np.float64]) -> NDArray[np.float64]:
            """Return the total weight of the elements that cross each cut, (count - 1,).

            Cut ``i`` separates the rows with the ``i + 1`` lowest distinct voltages from all others; `weight`
            (elements,): weight of an element, such as the current limit.
            """
            return np.cumsum(np.bincount(below, weight, count) - np.bincount(above, weight, count))[:-1]

        injected = np.cumsum(np.bincount(rank[:-1], self.system.injected, count))
        surplus = np.where(np.arange(count - 1) < rank[-1], -injected[:-1], injected[-1] - injected[:-1])
        surplus -= crossing(limit) * (1 - _MARGIN)
        surplus[crossing((limit == 0).astype(np.float64)) > 0] = -np.inf
        if surplus.max(initial=-np.inf) == -np.inf:
            return
        cut = int(np.argmax(surplus))
        inside = (rank <= cut) == (cut < rank[-1])
        cutting = np.flatnonzero(np.not_equal(*inside[rows.T]))
        amps, capacity = abs(float(self.system.injected[inside[:-1]].sum())), float(limit[cutting].sum())
        if not cutting.size or amps < capacity * (1 - _MARGIN):
            return
        names = netlist.names_of(self.system.netlist.resistor_nodes[cutting[0]])
        within = inside[self.system.unknown]
        close = "" if amps >= capacity else "may be no operating point, because the currents are so close to I0"
        raise CircuitError(
            f"there {close or 'is no operating point'}: the current sources drive {amps:.6g} A through the "
            f"{len(cutting)} nonlinear resistors around {np.count_nonzero(within)} nodes (such as "
            f"{netlist.node_name(int(np.argmax(within)))}), but these (such as the one between {names[0]} and "
            f"{names[1]}) carry less than {capacity:.6g} A, the sum of their I0; inject less current, or raise I0"
        )
