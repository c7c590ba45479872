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
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from resgrid.circuit.equations import (
    across,
    contacts_of,
    injected_into_rows,
    matrix_of,
    parts_of,
    refuse_floating_currents,
    sum_by_row,
)
from resgrid.circuit.sources import SourceForest, tie_sources
from resgrid.core.netlist import Netlist
from resgrid.errors import AccuracyError, CircuitError, InputError
from resgrid.solvers.factors import Factor
from resgrid.solvers.laplacian import EdgeList, Laplacian, Rows
from resgrid.solvers.method_choice import factor_laplacian
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.refinement import CERTAIN, corrected, imbalance, is_answer, minus, quotient, scaled_currents
from resgrid.solvers.scaled import Scaled

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
    (n,): ``b``: current that sources feed into every row, in amperes; `branches`: of ``G``: (m, n) and (m,).
    """

    netlist: Netlist
    row: NDArray[np.int32]
    fixed: NDArray[np.float64]
    conductance: Laplacian
    capacitance: Laplacian
    drive: NDArray[np.float64]
    forest: SourceForest
    branches: tuple[sparse.csr_array, NDArray[np.float64]]

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self.drive)

    def imbalance(self, x: NDArray[np.float64], drive: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """``drive - G x``: the current that charges every row, in amperes, shape (n,); formed from differences."""
        incidence, value = self.branches
        return np.asarray((drive - self.conductance.ground * x) - incidence.T @ (value * (incidence @ x)))

    @property
    def apart(self) -> bool:
        """Whether every capacitor goes to a rail."""
        return not len(self.capacitance.as_rows().indices)

    @cached_property
    def spread(self) -> sparse.csr_array:
        """``N``, (n, loose): one column for every part of rows that capacitors join to no node of known voltage.

        A row without capacitance is such a part of its own.
        """
        number, part = connected_components(self.capacitance.edges, directed=False)
        loose = np.bincount(part, self.capacitance.ground > 0, number) == 0
        rows = np.flatnonzero(loose[part])
        entries = (np.ones(len(rows)), (rows, (np.cumsum(loose) - 1)[part[rows]]))
        return sparse.coo_array(entries, shape=(self.size, int(loose.sum()))).tocsr()

    @cached_property
    def charged(self) -> NDArray[np.bool_]:
        """Rows that keep their coordinate ``y``, (n,): all but one of every loose part; ``C_cc`` is definite."""
        parts = sparse.csc_array(self.spread)
        charged = np.ones(self.size, dtype=np.bool_)
        charged[parts.indices[parts.indptr[:-1]]] = False
        return charged

    @cached_property
    def held(self) -> Factor | None:
        """Factors of ``C_cc``; None where there is no capacitor."""
        return factor_laplacian(self.capacitance.within(self.charged), "auto") if self.charged.any() else None

    @cached_property
    def loose(self) -> Factor | None:
        """Factors of ``N^T G N``; None where nothing is loose."""
        if not self.spread.shape[1]:
            return None
        return factor_laplacian(self.conductance.grouped(sparse.csr_array(self.spread.T)), "auto")

    def voltage(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Node voltages of a state, in volts; shape (nodes,)."""
        return np.asarray(self.fixed + np.append(x, 0.0)[self.row])

    def state(self, voltage: NDArray[np.float64]) -> NDArray[np.float64]:
        """State of node voltages, in volts, shape (n,); of nodes that share a row, the first one's."""
        nodes = np.flatnonzero(self.row >= 0)[::-1]  # of several, the last one written counts
        x = np.empty(self.size)
        x[self.row[nodes]] = voltage[nodes] - self.fixed[nodes]
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
    if not isinstance(netlist, Netlist):
        raise InputError(f"the netlist is {type(netlist).__name__}, not resgrid.Netlist")
    if netlist.nonlinear_current.size:
        raise InputError(
            f"the netlist holds {len(netlist.nonlinear_current)} nonlinear resistors, and this analysis is of linear "
            "circuits; give it resgrid.circuit.linearize(operating_point)"
        )
    forest = tie_sources(netlist)
    charged = netlist.capacitance > 0
    capacitors, capacitance = netlist.capacitor_nodes[charged], netlist.capacitance[charged]
    elements = np.concatenate([netlist.resistor_nodes, capacitors])
    elements.flags.writeable = False
    parts = parts_of(netlist, elements, forest)
    refuse_floating_currents(netlist, parts)
    size, row = parts.rows(~parts.floating, forest)
    fixed = np.where((row < 0) & (parts.of_node >= 0), np.nan, forest.offsets[0])

    def laplacian(ends: NDArray[np.int32], value: NDArray[np.float64]) -> tuple[Laplacian, NDArray[np.float64]]:
        contacts = contacts_of(ends, np.arange(len(ends), dtype=np.int32), row, forest)
        made, feed = matrix_of(netlist, EdgeList(ends, value, row), contacts, size)
        return made.with_rows(), feed

    conductance, feed = laplacian(netlist.resistor_nodes, netlist.conductance)
    return Dynamics(
        netlist=netlist,
        row=row,
        fixed=fixed,
        conductance=conductance,
        capacitance=laplacian(capacitors, capacitance)[0],
        drive=feed + injected_into_rows(netlist, row, size),
        forest=forest,
        branches=conductance.branches,
    )


def factor_resolvent(dynamics: Dynamics, rate: float, method: str = "auto") -> Factor:
    """Factor ``G + rate C``, for answers of either accuracy."""
    G, C = dynamics.conductance, dynamics.capacitance
    if rate == 0.0:
        require_grounded(dynamics)
        return factor_laplacian(G, method)
    ground = G.ground + rate * C.ground
    if dynamics.apart:
        return factor_laplacian(replace(G, ground=ground), method)
    grid = None if G.grid is None else G.grid.of_rows(dynamics.row)
    edges = sparse.csr_array(G.edges + rate * C.edges)
    whole = Laplacian(ground, compressed=Rows.of(edges), grid=grid, dimensions=G.dimensions)
    return factor_laplacian(whole, method)


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


def initial_state(dynamics: Dynamics, before: NDArray[np.float64]) -> NDArray[np.float64]:
    """State at time 0+, (n,), when the sources of the netlist act at once on node voltages ``before`` (nodes,).

    Finite currents move no charge in no time: at every node (or nodes joined by voltage sources) the charge on the
    capacitors is that of the voltages before.  Nodes without capacitance take the voltage at which Kirchhoff's current
    law holds.
    """
    netlist, groups, charged = dynamics.netlist, dynamics.spread, dynamics.charged
    x = dynamics.state(before)
    x = np.asarray(x - groups @ (groups.T @ np.where(charged, 0.0, x)))  # loose parts from 0 V on
    held, now = (across(volts, netlist.capacitor_nodes) for volts in (before, dynamics.voltage(x)))
    missing, (first, second) = netlist.capacitance * (held - now), netlist.capacitor_nodes.T
    charge = (dynamics.injection(first, missing) - dynamics.injection(second, missing))[charged]
    if dynamics.held is not None:
        x[charged] += _entrywise(dynamics.held, charge, _lift(dynamics, dynamics.held))
    if dynamics.loose is None:
        return x
    nodes, amps = netlist.current_nodes.ravel().astype(np.int64), np.repeat(np.abs(netlist.current_amps), 2)
    several, summed = (groups.T @ dynamics.injection(nodes, each) for each in (np.ones(len(nodes)), amps))
    rounding = _lift(dynamics, dynamics.loose) + _EPS * np.where(several > 1.0, summed, 0.0)
    current = groups.T @ dynamics.imbalance(x, dynamics.drive)
    return np.asarray(x + groups @ _entrywise(dynamics.loose, current, rounding))


def slope(dynamics: Dynamics, current: NDArray[np.float64]) -> NDArray[np.float64]:
    """How fast voltages rise when currents charge the rows, in V/s, shape (n,); to some 0.1 %."""
    charged, groups, v = dynamics.charged, dynamics.spread, np.zeros(dynamics.size)
    if dynamics.held is not None:
        v[charged] = dynamics.held.solve(current[charged], rtol=_ROUGH)
    if dynamics.loose is not None:
        v += groups @ dynamics.loose.solve(groups.T @ dynamics.imbalance(v, 0.0), rtol=_ROUGH)
    return v


def _lift(dynamics: Dynamics, factors: Factor) -> NDArray[np.float64]:
    """What floating sources may round off the drive of every row of a matrix, shape (n,)."""
    return np.asarray(_EPS * dynamics.forest.lift * factors.laplacian.diagonal)


def _entrywise(factors: Factor, drive: NDArray[np.float64], rounding: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve for a right-hand side of both signs, each entry right beside the largest one.

    Where both solutions nearly cancel, their difference is corrected.  ``A^-1`` has no negative entry: the error is at
    most ``A^-1 |r|``, with the residual ``r``, and what ``A^-1`` makes of both signs of it is the correction.

    Shapes: `drive` (n,); `rounding` (n,): what it may be off by; returns (n,).
    """
    watch, x, doubt = ProgressMonitor(), Scaled.of(np.zeros(len(drive))), 0.0
    parts = _of_residual(factors, drive, np.zeros(len(drive)), x, watch)
    x = best = minus(*parts)
    cancelled = quotient(parts, x)
    if cancelled > 1.0 and watch.bound * cancelled > CERTAIN:
        doubt = np.inf
        for _ in range(_MOST_CORRECTIONS):
            parts = _of_residual(factors, drive, rounding, x, watch)
            found = 2.0 * quotient(parts, x)
            if not found < doubt:
                break
            best, doubt = x, found
            if doubt <= CERTAIN:
                break
            x = minus(x, minus(*parts[::-1]))
    if doubt > _DOUBT or not is_answer(watch.error, watch.bound):
        raise AccuracyError(
            "the voltages at 0+ cannot be told: currents of both signs nearly cancel, or conductances and capacitances "
            f"span too many decades (voltages may be off by {max(doubt, watch.error):.1e} of the largest); check what "
            "ties the circuit to its rails"
        )
    return best.plain


def _of_residual(
    factors: Factor, drive: NDArray[np.float64], rounding: NDArray[np.float64], x: Scaled, watch: ProgressMonitor
) -> list[Scaled]:
    """Solutions for the residual's positive part, and for what is negative of it; both with what rounding may hide."""
    laplacian, r, e = factors.laplacian, np.empty(len(drive)), np.zeros(len(drive), dtype=np.int64)
    none = e.copy()
    imbalance(laplacian.graph, scaled_currents(drive), x, (r, e), exact=True)
    parts = [Scaled(np.maximum(sign * r, 0.0), np.zeros_like(r), np.where(sign * r > 0.0, e, 0)) for sign in (1, -1)]
    parts = [corrected(part, rounding, none) for part in parts]
    return [factors.solve_nonnegative(part, watch=watch)[0] if part.hi.any() else part for part in parts]


def energy_delivered(
    dynamics: Dynamics, time: float, change: NDArray[np.float64], integral: NDArray[np.float64]
) -> float:
    """Energy that all sources have delivered since 0+, in joules; floating parts count nothing.

    Shapes: `change` (n,): of the state, `integral` (n,).
    """
    if not time > 0.0:
        return 0.0
    netlist, mean = dynamics.netlist, dynamics.voltage(integral / time)
    heat = netlist.conductance * across(mean, netlist.resistor_nodes) ** 2
    moved = netlist.capacitance * across(dynamics.at_nodes(change), netlist.capacitor_nodes)
    return float(time * heat.sum() + moved @ across(mean, netlist.capacitor_nodes))
