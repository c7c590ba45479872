"""The state just after time 0: capacitors keep their charge, everything else follows.

In the coordinates ``x = E_c y + N z`` of `resgrid.circuit.dynamics.ChargeBasis` charges give ``y`` by ``C_cc y = q``,
and Kirchhoff's law for the parts that capacitors leave loose gives ``z`` by ``N^T G N z = N^T (b - G E_c y)``.  Both
are nodal matrices, assembled and solved as such: a part of strong conductances keeps its weak ties to what holds it.
"""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from resgrid.circuit.dynamics import ChargeBasis, Dynamics, charge_basis
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.errors import AccuracyError, InputError
from resgrid.netlist import CellMap, Netlist
from resgrid.solvers.choose import factor_laplacian
from resgrid.solvers.extended import Scaled
from resgrid.solvers.factor import Factor
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.monitor import Watch
from resgrid.solvers.refine import CERTAIN, is_answer, minus, quotient

_EPS = float(np.finfo(np.float64).eps)
_DOUBT = 1e-6
"""Largest share of the largest voltage by which any may be off at 0+."""

_MOST_CORRECTIONS = 5

_ROUGH = 1e-3
"""Backward error that is enough of slopes."""


@dataclass(frozen=True, eq=False)
class Charges:
    """A circuit's charges, and the voltages that belong to them.

    `basis`: coordinates that hold charge, and those that follow; `held`: factors of ``C_cc``; None where every
    capacitor goes to a rail, or there is none; `loose`: factors of ``N^T G N``; None where nothing is loose.
    """

    dynamics: Dynamics
    basis: ChargeBasis
    held: Factor | None
    loose: Factor | None

    def voltages(self, charge: NDArray[np.float64]) -> NDArray[np.float64]:
        """What charges make of a circuit at 0 V, in volts, shape (n,); 0 in coordinates that hold none."""
        charged, x = self.basis.charged, np.zeros(self.dynamics.size)
        if self.held is None:
            x[charged] = charge[charged] / self.dynamics.capacitance.ground[charged]
        elif charge[charged].any():
            x[charged] = _entrywise(self.held, charge[charged], self._lift(self.held))
        return x

    def followed(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """The state with the charges of ``x`` at which Kirchhoff's law holds for every loose part, in volts."""
        if self.loose is None:
            return x
        groups, netlist = self.basis.spread, self.dynamics.netlist
        drive = groups.T @ self.dynamics.imbalance(x)
        nodes, amps = netlist.current_nodes.ravel().astype(np.int64), np.repeat(netlist.current_amps, 2)
        into = sparse.csr_array(groups.T)
        several = into @ self.dynamics.injection(nodes, np.ones(len(nodes))) > 1.0
        summed = np.where(several, into @ self.dynamics.injection(nodes, np.abs(amps)), 0.0)
        rounding = self._lift(self.loose) + _EPS * summed
        return np.asarray(x + groups @ _entrywise(self.loose, drive, rounding))

    def slope(self, current: NDArray[np.float64]) -> NDArray[np.float64]:
        """How fast voltages rise when currents charge the rows, in V/s, shape (n,); to some 0.1 %."""
        charged, groups, v = self.basis.charged, self.basis.spread, np.zeros(self.dynamics.size)
        if self.held is None:
            v[charged] = current[charged] / self.dynamics.capacitance.ground[charged]
        else:
            v[charged] = self.held.solve(current[charged], rtol=_ROUGH)
        if self.loose is not None:
            v += groups @ self.loose.solve(-(groups.T @ self.dynamics.branches.times(v)), rtol=_ROUGH)
        return v

    def _lift(self, factors: Factor) -> NDArray[np.float64]:
        """What floating sources may round off the drive of every row of a matrix, shape (n,)."""
        return np.asarray(_EPS * self.dynamics.forest.lift * factors.laplacian.diagonal)


def charges_of(dynamics: Dynamics) -> Charges:
    """Factor what tells a circuit's voltages from its charges."""
    basis = charge_basis(dynamics)
    held = loose = None
    if not dynamics.apart and basis.charged.any():
        held = factor_laplacian(dynamics.capacitance.within(basis.charged), "auto")
    if basis.spread.shape[1]:
        loose = factor_laplacian(dynamics.conductance.grouped(basis.spread), "auto")
    return Charges(dynamics, basis, held, loose)


def _entrywise(factors: Factor, drive: NDArray[np.float64], rounding: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve for a right-hand side of both signs, each entry right beside the largest one.

    Shapes: `drive` (n,); `rounding` (n,): what it may be off by; returns (n,).
    """
    watch, doubt = Watch(), 0.0
    parts = [np.maximum(sign * drive, 0.0) for sign in (1.0, -1.0)]
    rising, falling = (
        factors.solve_nonnegative(part, watch=watch)[0] if part.any() else Scaled.of(part) for part in parts
    )
    x = minus(rising, falling)
    if all(part.any() for part in parts) and watch.bound * quotient([rising, falling], x) > CERTAIN:
        x, doubt = _refined(factors, drive, rounding, x)
    if doubt > _DOUBT or not is_answer(watch.error, watch.bound):
        raise AccuracyError(
            "the voltages at 0+ cannot be told: currents of both signs nearly cancel, or conductances and capacitances "
            f"span too many decades (voltages may be off by {max(doubt, watch.error):.1e} of the largest); check what "
            "ties the circuit to its rails"
        )
    return x.plain


def _refined(
    factors: Factor, drive: NDArray[np.float64], rounding: NDArray[np.float64], x: Scaled
) -> tuple[Scaled, float]:
    """Make a difference better; returns what it may be off by at most, relative to its largest entry.

    ``A^-1`` has no negative entry: the error is at most ``A^-1 |r|``, with the residual ``r``, and what ``A^-1`` makes
    of both signs of it corrects the difference.
    """
    best, doubt = x, np.inf
    for _ in range(_MOST_CORRECTIONS):
        rise, fall = (factors.solve_nonnegative(part)[0] for part in _residual(factors.laplacian, drive, rounding, x))
        found = 2.0 * quotient([rise, fall], x)
        if not found < doubt:
            break
        best, doubt = x, found
        if doubt <= CERTAIN:
            break
        x = minus(x, minus(fall, rise))
    return best, float(doubt)


def _residual(
    laplacian: Laplacian, drive: NDArray[np.float64], rounding: NDArray[np.float64], x: Scaled
) -> tuple[Scaled, Scaled]:
    """The residual's positive part, and what is negative of it; both with what the drive's own rounding may hide."""
    from resgrid.solvers.extended_kernels import correct
    from resgrid.solvers.refine import imbalance, scaled_currents

    r, e = np.empty(laplacian.size), np.empty(laplacian.size, dtype=np.int64)
    imbalance(laplacian.conductances, scaled_currents(drive), x, (r, e), exact=True)
    none = np.zeros_like(e)
    parts = [Scaled(np.maximum(sign * r, 0.0), np.zeros_like(r), np.where(sign * r > 0.0, e, 0)) for sign in (1, -1)]
    for part in parts:
        correct(part, rounding, none, part)
    return parts[0], parts[1]


def initial_state(charges: Charges, initial: OperatingPoint | ArrayLike | None) -> NDArray[np.float64]:
    """State at time 0+, when the sources of the netlist act at once.

    Finite currents move no charge in no time: at every node (or nodes joined by voltage sources) the charge on the
    capacitors is that of the initial voltages.  Nodes without capacitance take the voltage at which Kirchhoff's
    current law holds.

    Shapes: `initial` (nodes,); returns (n,).
    """
    dynamics, netlist = charges.dynamics, charges.dynamics.netlist
    before = np.zeros(netlist.node_count) if initial is None else _voltages(netlist, initial)
    x = _without_loose(charges, dynamics.state(before))
    held, now = (volts[netlist.capacitor_nodes] for volts in (before, dynamics.voltage(x)))
    missing = netlist.capacitance * np.nan_to_num((held[:, 0] - held[:, 1]) - (now[:, 0] - now[:, 1]))
    first, second = netlist.capacitor_nodes.T
    charge = dynamics.injection(first, missing) - dynamics.injection(second, missing)
    return charges.followed(x + charges.voltages(charge))


def _without_loose(charges: Charges, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """The state, every loose part shifted so that its first row is at 0 V."""
    groups, charged = charges.basis.spread, charges.basis.charged
    first = np.where(charged, 0.0, x)
    return np.asarray(x - groups @ (groups.T @ first))


def real_numbers(values: ArrayLike, message: str) -> NDArray[np.float64]:
    """A new array of real numbers."""
    try:
        given: np.ndarray[Any, Any] = np.ma.asanyarray(values)
        real = given.dtype.kind in "biuf" or all(isinstance(value, Real) for value in given.flat)
        if not real or np.ma.is_masked(given):
            raise InputError(message)
        return np.array(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(message) from error


def _voltages(netlist: Netlist, initial: OperatingPoint | ArrayLike) -> NDArray[np.float64]:
    if isinstance(initial, OperatingPoint):
        old, new = initial.netlist.cell_map, netlist.cell_map
        if old is not None and new is not None:
            return np.nan_to_num(_carried_over(initial, old, netlist, new), nan=0.0)
        initial = np.nan_to_num(initial.voltage, nan=0.0)
    volts = real_numbers(initial, "initial must be an operating point or one number per node")
    if volts.shape != (netlist.node_count,):
        raise InputError(f"initial has shape {volts.shape}, but the netlist has {netlist.node_count} nodes")
    if not np.isfinite(volts).all():
        node = netlist.node_name(int(np.argmin(np.isfinite(volts))))
        raise InputError(f"the initial voltage of node {node} is not finite")
    return volts


def _carried_over(point: OperatingPoint, old: CellMap, netlist: Netlist, new: CellMap) -> NDArray[np.float64]:
    """Old voltages at the nodes of a new scene: cell by cell, and rail by rail."""
    if old.space.shape != new.space.shape:
        raise InputError(
            f"initial is of a grid of {old.space.shape} cells, but this netlist has {new.space.shape}; "
            "it must be the operating point of the same chip with another scene"
        )
    before = np.zeros(netlist.node_count)
    if netlist.node_count == point.netlist.node_count and old.wiring.rails == new.wiring.rails == "cells":
        before[:] = point.voltage
    had = (new.node >= 0) & (old.node >= 0)
    before[new.node[had]] = point.voltage[old.node[had]]
    pairs = [(new.obstacle_node, old.obstacle_node), *zip(new.goal_nodes, old.goal_nodes, strict=False)]
    for here, there in pairs:
        if here >= 0 and there >= 0:
            before[here] = point.voltage[there]
    return before
