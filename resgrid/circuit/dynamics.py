"""A netlist with capacitors as the linear system ``C x' + G x = b``, reduced to the voltages that sources leave free.

Nodes tied by voltage sources share a row, as in an operating point.  ``G + s C`` with ``s >= 0`` is then a nodal matrix
of its own, in which a capacitor is a resistor of conductance ``s`` times its capacitance (the companion model of
Nagel 1975, section 4.3), so that every method that solves operating points solves implicit time steps too.

At 0+ capacitors keep their charge, and everything else follows.  With ``x = E_c y + N z``, ``C N = 0``, charges give
``y`` by ``C_cc y = q``, and Kirchhoff's law for the parts that capacitors leave loose gives ``z`` by
``N^T G N z = N^T (b - G E_c y)``.  Both are nodal matrices, assembled and solved as such: a part of strong conductances
keeps its weak ties to what holds it.

The energy that sources deliver until ``t`` is ``t W^T G_n W + W^T C_n (V(t) - V(0))``: by Tellegen's theorem their
currents may be weighted by any voltages ``W`` that they allow, and the mean voltages make the rest vanish (``G_n`` and
``C_n`` are the matrices of all nodes).  Differences across elements tell both, none of them counted from ground.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from resgrid.circuit.equations import contacts_of, grid_of, injected_into_rows, number_rows, parts_of, sum_by_row
from resgrid.circuit.sources import SourceForest, tie_sources
from resgrid.errors import AccuracyError, CircuitError, InputError
from resgrid.netlist import Netlist
from resgrid.solvers.choose import factor_laplacian
from resgrid.solvers.extended import Scaled
from resgrid.solvers.factor import Factor
from resgrid.solvers.laplacian import EdgeList, Laplacian, Rows
from resgrid.solvers.monitor import Watch
from resgrid.solvers.refine import CERTAIN, is_answer, minus, quotient

_EPS = float(np.finfo(np.float64).eps)
_DOUBT = 1e-6
"""Largest share of the largest voltage by which any may be off at 0+."""

_MOST_CORRECTIONS = 5

_ROUGH = 1e-3
"""Backward error that is enough of slopes."""


@dataclass(frozen=True, eq=False)
class Dynamics:
    """The equations ``C x' + G x = b`` of a netlist; node voltages are ``fixed + x[row]``.

    `row` (nodes,): row of every node, -1 for rails and floating nodes; nodes tied by floating sources share a row;
    `fixed` (nodes,): voltage of rails, and of other nodes above their row, in volts; NaN where a node floats;
    `conductance`: ``G``, in siemens; `capacitance`: ``C``, in farads; rows without capacitance are algebraic; `drive`
    (n,): ``b``: current that sources feed into every row, in amperes; `floating`: nodes that no resistor, capacitor
    or voltage source ties to ground; `branches`: of ``G``: (m, n) and (m,).
    """

    netlist: Netlist
    row: NDArray[np.int32]
    fixed: NDArray[np.float64]
    conductance: Laplacian
    capacitance: Laplacian
    drive: NDArray[np.float64]
    floating: NDArray[np.int64]
    forest: SourceForest
    branches: tuple[sparse.csr_array, NDArray[np.float64]]

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self.drive)

    def imbalance(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """``b - G x``: the current that charges every row, in amperes, shape (n,); formed from differences."""
        return np.asarray((self.drive - self.conductance.ground * x) - self.leaving(x))

    def conducted(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """``G x``: the current that leaves every row, in amperes, shape (n,); formed from differences."""
        return np.asarray(self.conductance.ground * x + self.leaving(x))

    def leaving(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """What of it goes to other rows."""
        incidence, value = self.branches
        return np.asarray(incidence.T @ (value * (incidence @ x)))

    @property
    def apart(self) -> bool:
        """Whether every capacitor goes to a rail."""
        return not len(self.capacitance.as_rows().indices)

    def voltage(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Node voltages of a state, in volts; shape (nodes,)."""
        return np.asarray(self.fixed + np.append(x, 0.0)[self.row])

    def state(self, voltage: NDArray[np.float64]) -> NDArray[np.float64]:
        """State of node voltages, in volts, shape (n,); of nodes that share a row, the first one's."""
        nodes = np.flatnonzero(self.row >= 0)
        rows, first = np.unique(self.row[nodes], return_index=True)
        x = np.empty(self.size)
        x[rows] = voltage[nodes[first]] - self.fixed[nodes[first]]
        return x

    def at_nodes(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values of rows at nodes, shape (nodes,): 0 on rails, NaN where a node floats."""
        return np.where(np.isnan(self.fixed), np.nan, np.append(value, 0.0)[self.row])

    def injection(self, nodes: NDArray[np.int64], amount: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sum amounts given at nodes over rows, shape (n,); what reaches rails is left out."""
        inside = self.row[nodes] >= 0
        return sum_by_row(self.row[nodes[inside]], amount[inside], self.size)


def dynamics_of(netlist: Netlist) -> Dynamics:
    """Set up the equations of a netlist with capacitors."""
    require_linear(netlist)
    forest = tie_sources(netlist)
    charged = netlist.capacitance > 0
    capacitors, capacitance = netlist.capacitor_nodes[charged], netlist.capacitance[charged]
    elements = np.concatenate([netlist.resistor_nodes, capacitors])
    elements.flags.writeable = False
    parts = parts_of(netlist, elements, forest)
    size, row, _, _, floating = number_rows(parts, ~parts.floating, forest)
    fixed, grid = forest.offset, grid_of(netlist)
    fixed[floating] = np.nan

    def laplacian(ends: NDArray[np.int32], value: NDArray[np.float64]) -> tuple[Laplacian, NDArray[np.float64]]:
        contacts = contacts_of(ends, np.arange(len(ends), dtype=np.int32), row, forest)
        ground, dimensions = contacts.ground(value, size), 2 if grid is None else grid.dimensions
        made = Laplacian(ground, EdgeList(ends, value, row), grid=grid, dimensions=dimensions)
        return made.with_rows(), contacts.feed(value, size)

    conductance, feed = laplacian(netlist.resistor_nodes, netlist.conductance)
    return Dynamics(
        netlist=netlist,
        row=row,
        fixed=fixed,
        conductance=conductance,
        capacitance=laplacian(capacitors, capacitance)[0],
        drive=feed + injected_into_rows(netlist, row, size),
        floating=floating,
        forest=forest,
        branches=conductance.branches,
    )


def factor_resolvent(dynamics: Dynamics, rate: float, method: str = "auto") -> Factor:
    """Factor ``G + rate C``, for answers of either accuracy."""
    G, C = dynamics.conductance, dynamics.capacitance
    if rate == 0.0:
        require_grounded(dynamics)
        return factor_laplacian(G, method, both=True)
    ground = G.ground + rate * C.ground
    if dynamics.apart:
        return factor_laplacian(replace(G, ground=ground), method, both=True)
    grid = None if G.grid is None else G.grid.of_rows(dynamics.row)
    edges = sparse.csr_array(G.edges + rate * C.edges)
    whole = Laplacian(ground, compressed=Rows.of(edges), grid=grid, dimensions=G.dimensions)
    return factor_laplacian(whole, method, both=True)


def require_linear(netlist: Netlist) -> None:
    """Refuse a netlist with nonlinear elements, and what is no netlist."""
    if not isinstance(netlist, Netlist):
        raise InputError(f"the netlist is {type(netlist).__name__}, not resgrid.Netlist")
    count = len(netlist.nonlinear_current)
    if count:
        raise InputError(
            f"the netlist holds {count} nonlinear resistors, and this analysis is of linear circuits; "
            "give it resgrid.small_signal(operating_point)"
        )


def require_grounded(dynamics: Dynamics) -> None:
    """Refuse a circuit of which a part is tied to no rail by resistors."""
    G = dynamics.conductance
    number, part = connected_components(G.edges, directed=False)
    loose = np.bincount(part, G.ground > 0, number) == 0
    if loose.any():
        row = int(np.argmax(loose[part]))
        node = dynamics.netlist.node_name(int(np.argmax(dynamics.row == row)))
        raise CircuitError(
            f"node {node} is tied to no rail by resistors: it never settles (its slowest time constant is infinite); "
            "add a resistor to a rail, or leave the part out"
        )


@dataclass(frozen=True, eq=False)
class ChargeBasis:
    """Coordinates in which only those with charge move: ``x = E_c y + N z``, ``C N = 0``.

    `charged` (n,): rows that keep their coordinate ``y``; the matrix ``C`` between them is positive definite;
    `spread` (n, loose): ``N``: one column for every part of rows that capacitors join to each other, but to no node
    of known voltage; a row without capacitance is such a part of its own.
    """

    charged: NDArray[np.bool_]
    spread: sparse.csr_array


def charge_basis(dynamics: Dynamics) -> ChargeBasis:
    """Tell the coordinates that hold charge from those that follow at once."""
    C, n = dynamics.capacitance, dynamics.size
    number, part = connected_components(C.edges, directed=False)
    loose = np.bincount(part, C.ground > 0, number) == 0
    _, first = np.unique(part, return_index=True)
    charged = np.ones(n, dtype=np.bool_)
    charged[first[loose]] = False
    rows = np.flatnonzero(loose[part])
    column = (np.cumsum(loose) - 1)[part[rows]]
    entries = (np.ones(len(rows)), (rows, column))
    return ChargeBasis(charged, sparse.coo_array(entries, shape=(n, int(loose.sum()))).tocsr())


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
            v += groups @ self.loose.solve(-(groups.T @ self.dynamics.conducted(v)), rtol=_ROUGH)
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
        loose = factor_laplacian(dynamics.conductance.grouped(sparse.csr_array(basis.spread.T)), "auto")
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


def initial_state(charges: Charges, before: NDArray[np.float64]) -> NDArray[np.float64]:
    """State at time 0+, (n,), when the sources of the netlist act at once on node voltages ``before`` (nodes,).

    Finite currents move no charge in no time: at every node (or nodes joined by voltage sources) the charge on the
    capacitors is that of the voltages before.  Nodes without capacitance take the voltage at which Kirchhoff's current
    law holds.
    """
    dynamics, netlist, basis = charges.dynamics, charges.dynamics.netlist, charges.basis
    x = dynamics.state(before)
    x = np.asarray(x - basis.spread @ (basis.spread.T @ np.where(basis.charged, 0.0, x)))  # loose parts from 0 V on
    held, now = (volts[netlist.capacitor_nodes] for volts in (before, dynamics.voltage(x)))
    missing = netlist.capacitance * np.nan_to_num((held[:, 0] - held[:, 1]) - (now[:, 0] - now[:, 1]))
    first, second = netlist.capacitor_nodes.T
    charge = dynamics.injection(first, missing) - dynamics.injection(second, missing)
    return charges.followed(x + charges.voltages(charge))


def energy_delivered(
    dynamics: Dynamics, time: float, change: NDArray[np.float64], integral: NDArray[np.float64]
) -> float:
    """Energy that all sources have delivered since 0+, in joules; floating parts count nothing.

    Shapes: `change` (n,): of the state, `integral` (n,).
    """
    if not time > 0.0:
        return 0.0
    netlist, mean = dynamics.netlist, dynamics.voltage(integral / time)
    heat = netlist.conductance * _across(mean, netlist.resistor_nodes) ** 2
    moved = netlist.capacitance * _across(dynamics.at_nodes(change), netlist.capacitor_nodes)
    return float(time * heat.sum() + moved @ _across(mean, netlist.capacitor_nodes))


def energy_stored(netlist: Netlist, voltage: NDArray[np.float64]) -> float:
    """Energy in the capacitors at node voltages, in joules."""
    return float(0.5 * np.sum(netlist.capacitance * _across(voltage, netlist.capacitor_nodes) ** 2))


def _across(voltage: NDArray[np.float64], nodes: NDArray[np.int32]) -> NDArray[np.float64]:
    """Voltage across elements, 0 where it floats."""
    first, second = voltage[nodes.T]
    return np.asarray(np.nan_to_num(first - second))
