"""RC circuits: the linear system ``C x' + G x = b`` of a netlist with capacitors, and its initial state.

Nodes joined by voltage sources share a row, as in an operating point.  For ``s >= 0``, ``G + s C`` is again a nodal
matrix, in which a capacitor is a resistor of conductance ``s`` times its capacitance (the companion model of
Nagel 1975, section 4.3).  The solvers for operating points therefore solve implicit time steps, too.

At time 0+ capacitors keep their charge.  Write ``x = E_c y + N z``: the columns of ``N`` are a basis of the null space
of ``C``, and those of ``E_c`` are unit vectors of rows whose block ``C_cc`` of ``C`` is regular.  The charges ``q``
determine ``y`` by ``C_cc y = q``.  Kirchhoff's current law for the components that no capacitor connects to a known
voltage determines ``z`` by ``N^T G N z = N^T (b - G E_c y)``.  Both matrices are nodal and are assembled as such, so
that a small conductance between a component and a rail is not lost to rounding beside large conductances inside the
component.

The energy that the sources deliver until time ``t`` is ``t W^T G_n W + W^T C_n (V(t) - V(0))``, with the matrices
``G_n`` and ``C_n`` of all nodes.  By Tellegen's theorem the source currents may be weighted by any voltages ``W`` that
agree with the sources.  The mean voltages are chosen, for which the remaining terms vanish.  Both terms are computed
from voltage differences across elements.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.circuit.equations import (
    across,
    components_of,
    contacts_of,
    injected_into_rows,
    matrix_of,
    refuse_floating_currents,
    sum_by_row,
)
from resgrid.circuit.sources import SourceForest, tie_sources
from resgrid.core.netlist import Netlist
from resgrid.core.regions import label_components
from resgrid.errors import AccuracyError, CircuitError, InputError
from resgrid.solvers.factors import Factor
from resgrid.solvers.laplacian import EdgeList, Laplacian, Rows
from resgrid.solvers.method_choice import factor_laplacian
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.refinement import CERTAIN, corrected, imbalance, is_answer, minus, quotient, scaled_currents
from resgrid.solvers.scaled import Scaled

_EPS = float(np.finfo(np.float64).eps)
_LARGEST_ERROR = 1e-6
"""Largest accepted error of a voltage at time 0+, as a fraction of the largest voltage."""

_MOST_CORRECTIONS = 5

_SLOPE_RTOL = 1e-3
"""Normwise backward error of the time derivatives of the voltages, which determine only the first time step."""


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Equations ``C x' + G x = b`` of a netlist; the node voltages are ``fixed + x[row]``.

    A row is an unknown voltage with its equation; nodes joined by floating sources (sources that no chain of sources
    connects to ground) share a row.  `netlist`: the circuit; `row` (nodes,): row of every node, -1 for rails and
    floating nodes; `fixed` (nodes,): voltage of a rail, or offset of another node from its row, in volts; NaN for a
    floating node; `conductance`: ``G``, in siemens; `capacitance`: ``C``, in farads; rows without capacitance are
    algebraic; `drive` (n,): ``b``, the current from sources into every row, in amperes; `forest`: spanning forest of
    the voltage sources; `branches`: incidence matrix (m, n) and conductances (m,) of ``G``.
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
        """Number of rows (unknown voltages)."""
        return len(self.drive)

    def imbalance(self, x: NDArray[np.float64], drive: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Return ``drive - G x``, the current that charges every row, in amperes, (n,), from voltage differences.

        ``G``: conductance matrix; `x` (n,): voltages of the rows in volts; `drive` (n,) or number: currents from
        sources into the rows, in amperes.
        """
        incidence, value = self.branches
        return np.asarray((drive - self.conductance.ground * x) - incidence.T @ (value * (incidence @ x)))

    @property
    def is_capacitance_diagonal(self) -> bool:
        """Whether every capacitor is connected to a rail, so that the capacitance matrix ``C`` is diagonal."""
        return not len(self.capacitance.as_rows().indices)

    @cached_property
    def null_space(self) -> sparse.csr_array:
        """Basis ``N`` of the null space of the capacitance matrix ``C``, shape (n, components), with entries 0 and 1.

        A column is a component of rows that capacitors connect to each other, but not to a known voltage.  A row
        without capacitance is a component of its own.
        """
        component = label_components(self.capacitance.edges)
        is_free = np.bincount(component, self.capacitance.ground > 0) == 0
        rows = np.flatnonzero(is_free[component])
        entries = (np.ones(len(rows)), (rows, (np.cumsum(is_free) - 1)[component[rows]]))
        return sparse.coo_array(entries, shape=(self.size, int(is_free.sum()))).tocsr()

    @cached_property
    def charged(self) -> NDArray[np.bool_]:
        """Mask (n,) of the rows of a positive definite block ``C_cc`` of the capacitance matrix ``C``.

        The mask leaves out one row of every component that capacitors connect, but not to a known voltage.  A row
        without capacitance is such a component.
        """
        columns = sparse.csc_array(self.null_space)
        charged = np.ones(self.size, dtype=np.bool_)
        charged[columns.indices[columns.indptr[:-1]]] = False
        return charged

    @cached_property
    def capacitance_factor(self) -> Factor | None:
        """Factors of ``C_cc``, the block of the capacitance matrix for the rows `charged`; None if there are none."""
        return factor_laplacian(self.capacitance.within(self.charged), "auto") if self.charged.any() else None

    @cached_property
    def null_space_factor(self) -> Factor | None:
        """Factors of ``N^T G N``: conductance matrix ``G``, basis ``N`` of the null space of the capacitance matrix.

        None if the null space is empty.
        """
        if not self.null_space.shape[1]:
            return None
        return factor_laplacian(self.conductance.grouped(sparse.csr_array(self.null_space.T)), "auto")

    def voltage(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the node voltages in volts, (nodes,); `x` (n,): voltages of the rows in volts."""
        return np.asarray(self.fixed + np.append(x, 0.0)[self.row])

    def state(self, voltage: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the voltages of the rows in volts, (n,); the first node of a row determines the value.

        `voltage` (nodes,): node voltages in volts.
        """
        nodes = np.flatnonzero(self.row >= 0)[::-1]  # reversed: the last assignment to a row wins
        x = np.empty(self.size)
        x[self.row[nodes]] = voltage[nodes] - self.fixed[nodes]
        return x

    def at_nodes(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return row values at the nodes, (nodes,): 0 on rails, NaN at floating nodes.

        `value` (n,): value of every row.
        """
        return np.where(np.isnan(self.fixed), np.nan, np.append(value, 0.0)[self.row])

    def injection(self, nodes: NDArray[np.int64], amount: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the sum of the amounts at the nodes of every row, (n,); nodes without a row are left out.

        `nodes` (k,): node of every amount; `amount` (k,): amounts, such as currents in amperes or charges in coulombs.
        """
        inside = self.row[nodes] >= 0
        return sum_by_row(self.row[nodes[inside]], amount[inside], self.size)


def dynamics_of(netlist: Netlist) -> Dynamics:
    """Return the equations ``C x' + G x = b`` of a netlist with capacitors.

    ``C``, ``G`` (n, n): capacitance and conductance matrix; ``x`` (n,): unknown voltages; ``b`` (n,): currents from
    sources.  Raise InputError for a netlist with nonlinear resistors, and CircuitError for contradictory sources or for
    source currents into a floating component.
    """
    if not isinstance(netlist, Netlist):
        raise InputError(f"netlist is of type {type(netlist).__name__}; give a resgrid.Netlist")
    if netlist.nonlinear_current.size:
        raise InputError(
            f"the netlist has {len(netlist.nonlinear_current)} nonlinear resistors, but this analysis is linear; "
            "use resgrid.circuit.linearize(operating_point)"
        )
    forest = tie_sources(netlist)
    charged = netlist.capacitance > 0
    capacitors, capacitance = netlist.capacitor_nodes[charged], netlist.capacitance[charged]
    elements = np.concatenate([netlist.resistor_nodes, capacitors])
    elements.flags.writeable = False
    components = components_of(netlist, elements, forest)
    refuse_floating_currents(netlist, components)
    size, row = components.rows(~components.floating, forest)
    fixed = np.where((row < 0) & (components.of_node >= 0), np.nan, forest.offsets[0])

    def laplacian(ends: NDArray[np.int32], value: NDArray[np.float64]) -> tuple[Laplacian, NDArray[np.float64]]:
        contacts = contacts_of(ends, np.arange(len(ends), dtype=np.int32), row, forest)
        matrix, feed = matrix_of(netlist, EdgeList(ends, value, row), contacts, size)
        return matrix.with_rows(), feed

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
    """Return the factors of ``G + rate C``, for normwise and componentwise solves.

    `dynamics`: equations ``C x' + G x = b`` with the capacitance matrix ``C`` and the conductance matrix ``G``; `rate`:
    in 1/s, such as the inverse of a time step; `method`: "auto", "direct" or "multigrid".  Raise CircuitError if the
    rate is 0 and ``G`` is singular.
    """
    G, C = dynamics.conductance, dynamics.capacitance
    if rate == 0.0:
        require_grounded(dynamics)
        return factor_laplacian(G, method)
    ground = G.ground + rate * C.ground
    if dynamics.is_capacitance_diagonal:
        return factor_laplacian(replace(G, ground=ground), method)
    grid = None if G.grid is None else G.grid.of_rows(dynamics.row)
    edges = sparse.csr_array(G.edges + rate * C.edges)
    whole = Laplacian(ground, compressed=Rows.of(edges), grid=grid, dimensions=G.dimensions)
    return factor_laplacian(whole, method)


def require_grounded(dynamics: Dynamics) -> None:
    """Raise CircuitError if no path of resistors connects some row to a rail: its time constant would be infinite.

    `dynamics`: equations ``C x' + G x = b``; a row is an unknown voltage.
    """
    G = dynamics.conductance
    component = label_components(G.edges)
    is_floating = np.bincount(component, G.ground > 0) == 0
    if is_floating.any():
        row = int(np.argmax(is_floating[component]))
        node = dynamics.netlist.node_name(int(np.argmax(dynamics.row == row)))
        raise CircuitError(
            f"node {node} is tied to no rail by resistors: it never settles (its slowest time constant is infinite); "
            "add a resistor to a rail, or remove the node and all that is connected to it"
        )


def initial_state(dynamics: Dynamics, before: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the voltages of the rows at time 0+, in volts, (n,), just after the sources are switched on.

    `before` (nodes,): node voltages before time 0, in volts.  The charge on the capacitors at every node, or at nodes
    joined by voltage sources, is continuous, since all currents are finite.  The voltages of nodes without capacitance
    follow from Kirchhoff's current law.  Raise AccuracyError if rounding leaves the voltages undetermined.
    """
    netlist, groups, charged = dynamics.netlist, dynamics.null_space, dynamics.charged
    x = dynamics.state(before)
    x = np.asarray(x - groups @ (groups.T @ np.where(charged, 0.0, x)))  # free components start from 0 V
    held, now = (across(volts, netlist.capacitor_nodes) for volts in (before, dynamics.voltage(x)))
    missing, (first, second) = netlist.capacitance * (held - now), netlist.capacitor_nodes.T
    charge = (dynamics.injection(first, missing) - dynamics.injection(second, missing))[charged]
    if dynamics.capacitance_factor is not None:
        rounding = _offset_rounding(dynamics, dynamics.capacitance_factor)
        x[charged] += _solve_componentwise(dynamics.capacitance_factor, charge, rounding)
    if dynamics.null_space_factor is None:
        return x
    nodes, amps = netlist.current_nodes.ravel().astype(np.int64), np.repeat(np.abs(netlist.current_amps), 2)
    several, summed = (groups.T @ dynamics.injection(nodes, each) for each in (np.ones(len(nodes)), amps))
    rounding = _offset_rounding(dynamics, dynamics.null_space_factor) + _EPS * np.where(several > 1.0, summed, 0.0)
    current = groups.T @ dynamics.imbalance(x, dynamics.drive)
    return np.asarray(x + groups @ _solve_componentwise(dynamics.null_space_factor, current, rounding))


def slope(dynamics: Dynamics, current: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the time derivatives of the voltages of the rows, in V/s, (n,), with errors of about 0.1 %.

    `dynamics`: equations ``C x' + G x = b``; `current` (n,): current ``b - G x`` that charges every row, in amperes.
    """
    charged, groups, v = dynamics.charged, dynamics.null_space, np.zeros(dynamics.size)
    if dynamics.capacitance_factor is not None:
        v[charged] = dynamics.capacitance_factor.solve(current[charged], rtol=_SLOPE_RTOL)
    if dynamics.null_space_factor is not None:
        v += groups @ dynamics.null_space_factor.solve(groups.T @ dynamics.imbalance(v, 0.0), rtol=_SLOPE_RTOL)
    return v


def _offset_rounding(dynamics: Dynamics, factors: Factor) -> NDArray[np.float64]:
    """Return the rounding errors, (n,) in amperes, of a right-hand side, caused by the voltages of floating sources.

    A floating source (without a chain of sources to ground) gives its node a voltage offset from the row of the node.
    `dynamics`: equations with the offsets; `factors`: factors of the matrix of the right-hand side, of size n.
    """
    return np.asarray(_EPS * dynamics.forest.largest_offset * factors.laplacian.diagonal)


def _solve_componentwise(
    factors: Factor, drive: NDArray[np.float64], rounding: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the solution (n,) for a right-hand side of both signs; errors are small relative to the largest entry.

    `factors`: factors of the matrix ``A``; `drive` (n,): right-hand side; `rounding` (n,): bound on the error of
    `drive`. Raise AccuracyError if the error may exceed 1e-6 of the largest entry.

    The positive and the negative part of the right-hand side are solved for separately.  If the two solutions nearly
    cancel, their difference is corrected: ``A^-1`` has no negative entry, so that ``A^-1 |r|`` bounds the error, with
    the residual ``r``, and the solutions for both parts of ``r`` are the correction.
    """
    watch, x, error_bound = ProgressMonitor(), Scaled.of(np.zeros(len(drive))), 0.0
    parts = _solve_residual(factors, drive, np.zeros(len(drive)), x, watch)
    x = best = minus(*parts)
    cancelled = quotient(parts, x)
    if cancelled > 1.0 and watch.bound * cancelled > CERTAIN:
        error_bound = np.inf
        for _ in range(_MOST_CORRECTIONS):
            parts = _solve_residual(factors, drive, rounding, x, watch)
            found = 2.0 * quotient(parts, x)
            if not found < error_bound:
                break
            best, error_bound = x, found
            if error_bound <= CERTAIN:
                break
            x = minus(x, minus(*parts[::-1]))
    if error_bound > _LARGEST_ERROR or not is_answer(watch.error, watch.bound):
        raise AccuracyError(
            "the voltages at 0+ are not determined in double precision: currents of both signs nearly cancel, or "
            "conductances and capacitances span too many orders of magnitude (errors may reach "
            f"{max(error_bound, watch.error):.1e} of the largest voltage); check the elements that tie the circuit to "
            "its rails"
        )
    return best.plain


def _solve_residual(
    factors: Factor, drive: NDArray[np.float64], rounding: NDArray[np.float64], x: Scaled, watch: ProgressMonitor
) -> list[Scaled]:
    """Return the solutions for the positive and for the negative part of the residual ``drive - A x``, (n,) each.

    `factors`: factors of ``A``; `drive` (n,): right-hand side; `rounding` (n,): bound on the error of `drive`, which is
    added to both parts; `x` (n,): approximate solution; `watch`: records progress and error bounds.
    """
    laplacian, r, e = factors.laplacian, np.empty(len(drive)), np.zeros(len(drive), dtype=np.int64)
    zeros = e.copy()
    imbalance(laplacian.graph, scaled_currents(drive), x, (r, e), exact=True)
    parts = [Scaled(np.maximum(sign * r, 0.0), np.zeros_like(r), np.where(sign * r > 0.0, e, 0)) for sign in (1, -1)]
    parts = [corrected(part, rounding, zeros) for part in parts]
    return [factors.solve_nonnegative(part, watch=watch)[0] if part.hi.any() else part for part in parts]


def energy_delivered(
    dynamics: Dynamics, time: float, change: NDArray[np.float64], integral: NDArray[np.float64]
) -> float:
    """Return the energy that all sources have delivered since 0+, in joules; floating components are not counted.

    `time`: time since 0+ in seconds; `change` (n,): change of the voltages of the rows since 0+, in volts; `integral`
    (n,): time integral of the voltages of the rows since 0+, in volt seconds.
    """
    if not time > 0.0:
        return 0.0
    netlist, mean = dynamics.netlist, dynamics.voltage(integral / time)
    heat = netlist.conductance * across(mean, netlist.resistor_nodes) ** 2
    moved = netlist.capacitance * across(dynamics.at_nodes(change), netlist.capacitor_nodes)
    return float(time * heat.sum() + moved @ across(mean, netlist.capacitor_nodes))
