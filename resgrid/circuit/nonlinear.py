"""The operating point of a circuit with nonlinear resistors, ``I = I0 tanh(dV / V0)``, by Newton's method.

The operating point minimises the co-content (Millar 1951), the sum of ``integral of I dV`` over all elements minus what
the current sources put in.  Every branch is monotone, so the co-content is convex and every Newton step solves an
M-matrix, that of the circuit's differential conductances ``I0 / V0 sech^2(dV / V0)``.

At its operating point a nonlinear resistor carries what a linear one of its *secant* conductance ``I / dV`` would.  So
the answer is read off the linear circuit of those, with all that solving a linear circuit promises: it keeps its last
digits, has no local minimum, and its field is direction-safe.

A nonlinear resistor carries less than its ``I0``: there is an operating point if and only if no set of nodes is fed
more than the resistors around it can carry (Ford & Fulkerson 1956).  Where one is, voltages rise without bound, and the
nodes above one of these voltages, or below, are such a set: the co-content falls along the voltages, and it is an
integral over those sets (coarea formula; Strang 1983).
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
"""Steps after which a cut may be overloaded, and at most."""

_EPS = float(np.finfo(np.float64).eps)
_FLOOR = 1e-15
"""Least differential conductance, as a share of the one at 0 V: what keeps the matrix regular in saturation."""

_NEGLIGIBLE = 1e-9
"""Largest violation of Kirchhoff's current law at the end, as a share of the largest current."""

_WORTHWHILE = 0.05
"""Share of a Newton step below which steps of the secants take turns with such steps."""

_SHORTER, _SHORTEST = 0.7, 1e-30

_SATURATED = 14.0
"""``dV / V0`` from which the current of a nonlinear resistor is hard to tell from its ``I0``: then 1 in 1e12."""

_MARGIN = 1e-12
"""Share of what a cut carries, below which doubles do not tell what is left of it."""

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
    start = time.perf_counter()
    voltage = newton(netlist, method=method).voltage
    seconds = time.perf_counter() - start
    law = _Law.of(netlist)
    secant = law.secant(across(voltage, netlist.nonlinear_nodes))
    best: OperatingPoint | None = None
    least = np.inf
    for _ in range(_MOST_PASSES):
        chords = linear_netlist(netlist, secant)
        point = solve_linear(chords, accuracy=accuracy, method=method, rtol=rtol, progress=progress)
        better = law.secant(point.resistor_current[len(netlist.conductance) :] / secant)
        change = float(np.abs(better / secant - 1).max())
        if not change < least:
            break
        best, least, secant = point, change, better
        if change <= _SETTLED:
            break
    assert best is not None
    m, read, (amps, exponent) = len(netlist.conductance), best.readings, best.readings.scaled
    answer = dataclasses.replace(
        best,
        netlist=netlist,
        entry_error=np.inf,
        ammeters=read._replace(
            resistor_current=read.resistor_current[:m],
            scaled=(amps[:m], exponent[:m]),
            kcl_residual=max(read.kcl_residual, least),
        ),
        nonlinear_amps=read.resistor_current[m:],
        nonlinear_log_amps=best.resistor_log_current[m:],
        nonlinear_direction=best.resistor_direction[m:],
        method=f"newton, {best.method}",
        seconds={"newton": seconds, **best.seconds},
    )
    if least > DIRECTION_RESIDUAL:
        raise AccuracyError(
            f"the currents of nonlinear resistors are settled to {least:.1e} only: V0 is too small beside the "
            "voltages of the circuit to tell the drop across a resistor",
            answer,
        )
    return answer


def linearize(op: OperatingPoint) -> Netlist:
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
    >>> rg.circuit.linearize(rg.solve(netlist)).conductance.round(6)
    array([0.001  , 0.00967])
    """
    netlist = op.netlist
    if not netlist.nonlinear_nodes.size:
        return netlist
    return linear_netlist(netlist, _Law.of(netlist).differential(nonlinear_drops(op)))


def nonlinear_drops(point: OperatingPoint) -> NDArray[np.float64]:
    """Voltages across the nonlinear resistors, as their currents tell them, or the node voltages where these tell more.

    Returns (nonlinear resistors,).
    """
    netlist = point.netlist
    scale, share = netlist.nonlinear_voltage, np.abs(point.nonlinear_amps) / netlist.nonlinear_current
    largest = np.abs(np.nan_to_num(point.voltage)[netlist.nonlinear_nodes]).max(axis=1, initial=0.0)
    saturated = (share > 0.5) & (_SHARE_NOISE * scale > np.finfo(np.float64).eps * largest * (1.0 - share))
    told = np.sign(point.nonlinear_amps) * scale * np.arctanh(np.where(saturated, 0.0, share))
    return np.where(saturated, across(point.voltage, netlist.nonlinear_nodes), told)


class NewtonSolution(NamedTuple):
    """Where Newton's method ended, and the way there.

    `voltage` (nodes,): node voltages above ground, in volts; NaN where a node floats; `residual`: largest violation
    of Kirchhoff's current law before every step and after the last one, in amperes; `step`: share of every Newton
    step that was taken; 1 for a full one, 0 where secants took its place.
    """

    voltage: NDArray[np.float64]
    residual: list[float]
    step: list[float]


def newton(netlist: Netlist, *, method: str = "auto") -> NewtonSolution:
    """Find the node voltages of a circuit with nonlinear resistors.

    Damped: a step is shortened until the co-content falls along all of it.  Where little of it is left, deep in
    saturation, steps with the secant conductances take turns with such steps: they minimise a quadratic above the
    co-content that touches it (as iteratively reweighted least squares do), so that the co-content falls as well.
    """
    circuit = _NonlinearCircuit.of(netlist, method)
    x, at_rest = np.zeros(circuit.system.size), False
    residuals: list[float] = []
    steps: list[float] = []
    while True:
        drop = circuit.drops(x)
        excess = circuit.excess(drop)
        residuals.append(float(np.abs(excess).max(initial=0.0)))
        done = at_rest or circuit.obeys_kcl(x, drop, excess)
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
            move, share = circuit.step(x, drop, excess, _SHORTEST if 0.0 in steps[-1:] else _WORTHWHILE)
        except AccuracyError:  # voltages without bound look like any other failure
            circuit.refuse_overloaded_cut(netlist, x)
            raise
        x = x + move
        steps.append(share)
        at_rest = share > 0.0 and bool(np.abs(move).max() <= 4 * _EPS * share * np.abs(x).max())


def linear_netlist(netlist: Netlist, conductance: NDArray[np.float64]) -> Netlist:
    """Put a linear resistor in the place of every nonlinear one.  Shapes: `conductance` (nonlinear resistors,)."""
    ends, crossed = netlist.nonlinear_nodes, crossed_by(netlist, "nonlinear resistor")
    joined = add_elements(netlist, "resistor", ends, conductance, **crossed)
    return select_elements(joined, "nonlinear resistor", np.zeros(len(ends), dtype=np.bool_))


class _Law(NamedTuple):
    """Resistors of ``G V0 tanh(dV / V0)`` amperes; `siemens` (m,): ``G``; `volts` (m,): ``V0``, infinite if linear."""

    siemens: NDArray[np.float64]
    volts: NDArray[np.float64]

    @classmethod
    def of(cls, netlist: Netlist) -> _Law:
        """The law of the nonlinear resistors."""
        return cls(netlist.nonlinear_current / netlist.nonlinear_voltage, netlist.nonlinear_voltage)

    def secant(self, drop: NDArray[np.float64]) -> NDArray[np.float64]:
        """Conductance ``I / dV`` of every resistor, shape (m,)."""
        x = np.abs(drop / self.volts)
        small = x < 1e-4
        return np.asarray(self.siemens * np.where(small, 1 - x * x / 3, np.tanh(x) / np.where(small, 1.0, x)))

    def differential(self, drop: NDArray[np.float64]) -> NDArray[np.float64]:
        """Conductance ``dI / dV = G sech^2(dV / V0)`` of every resistor, shape (m,): what a small signal sees."""
        decay = np.exp(-2 * np.abs(drop / self.volts))
        return np.asarray(self.siemens * np.maximum(4 * decay / (1 + decay) ** 2, _FLOOR))


@dataclass(frozen=True, eq=False)
class _NonlinearCircuit:
    """Kirchhoff's current law for the rows of a nodal system, each element with its own law; linear resistors first.

    `method`: how linear systems are solved; `incidence` (elements, n): from rows to what they add to the voltages
    across elements; `lift` (elements,): these voltages where all rows are 0.
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
        """Voltage across every element."""
        return np.asarray(self.incidence @ x + self.lift)

    def excess(self, drop: NDArray[np.float64]) -> NDArray[np.float64]:
        """Current that leaves every row beyond what is fed in."""
        return np.asarray(self.incidence.T @ (self.law.secant(drop) * drop) - self.system.injected)

    def obeys_kcl(self, x: NDArray[np.float64], drop: NDArray[np.float64], excess: NDArray[np.float64]) -> bool:
        """Whether the excess is nothing beside the largest current, and everywhere what rounding may make of none."""
        amps, fed = np.abs(self.law.secant(drop) * drop), np.abs(self.system.injected)
        largest, touched = max(amps.max(initial=0.0), fed.max(initial=0.0)), abs(self.incidence)
        error = self.law.differential(drop) * (touched @ np.abs(x) + np.abs(self.lift)) + amps
        rounding = 4 * _EPS * (touched.T @ error + fed)
        return bool(np.all(np.abs(excess) <= np.minimum(rounding, _NEGLIGIBLE * largest)))

    def step(
        self, x: NDArray[np.float64], drop: NDArray[np.float64], excess: NDArray[np.float64], least: float
    ) -> tuple[NDArray[np.float64], float]:
        """What to move by, and which share of a Newton step it is: the least or more; 0 for a step of the secants."""
        with suppress(AccuracyError):  # differential conductances that vanish can leave the matrix singular
            direction, share = self.move(excess, self.law.differential(drop)), 1.0
            # All of it unless the co-content, convex along it, rises before its end.
            rise = 0.1 * abs(float(excess @ direction))
            while self.excess(self.drops(x + share * direction)) @ direction > rise and share >= least:
                share *= _SHORTER
            if share >= least:
                return share * direction, share
        return self.move(excess, self.law.secant(drop)), 0.0

    def move(self, excess: NDArray[np.float64], conductance: NDArray[np.float64]) -> NDArray[np.float64]:
        """What takes the excess away if conductances stay as they are."""
        matrix, _ = self.system.with_conductance(conductance)
        return factor_laplacian(matrix, self.method).solve(-excess, rtol=1e-8)

    def refuse_overloaded_cut(self, netlist: Netlist, x: NDArray[np.float64]) -> None:
        """Refuse a circuit whose current sources exceed what a cut through nonlinear resistors can carry.

        Cuts between the rows above some voltage and all others are asked, and those below one.  Shapes: `x` (n,).
        """
        volts, rank = np.unique(np.append(x, 0.0), return_inverse=True)  # the last row is that of the rails
        count, rows = len(volts), self.system.unknown[self.system.netlist.resistor_nodes]
        if count < 2:
            return
        below, above = np.sort(rank[rows], axis=1).T
        limit = np.append(np.zeros(len(netlist.conductance)), netlist.nonlinear_current)

        def crossing(weight: NDArray[np.float64]) -> NDArray[np.float64]:
            """Sum over the elements that join what lies up to each voltage, but the last, to what lies above."""
            return np.cumsum(np.bincount(below, weight, count) - np.bincount(above, weight, count))[:-1]

        fed = np.cumsum(np.bincount(rank[:-1], self.system.injected, count))
        surplus = np.where(np.arange(count - 1) < rank[-1], -fed[:-1], fed[-1] - fed[:-1])
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
        close = "" if amps >= capacity else "may be no operating point, so close are the resistors to I0"
        raise CircuitError(
            f"there {close or 'is no operating point'}: the current sources drive {amps:.6g} A through the "
            f"{len(cutting)} nonlinear resistors around {np.count_nonzero(within)} nodes (such as "
            f"{netlist.node_name(int(np.argmax(within)))}), but these (such as the one between {names[0]} and "
            f"{names[1]}) carry less than {capacity:.6g} A, the sum of their I0; feed less current, or raise I0"
        )
