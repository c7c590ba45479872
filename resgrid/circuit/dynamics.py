"""A netlist with capacitors as the linear system ``C x' + G x = b``, reduced to the voltages that sources leave free.

Nodes tied by voltage sources share a row, as in an operating point.  ``G + s C`` with ``s >= 0`` is then a nodal matrix
of its own, in which a capacitor is a resistor of conductance ``s`` times its capacitance (the companion model of
Nagel 1975, section 4.3), so that every method that solves operating points solves implicit time steps too.

Energy is told by how far the state has moved and by its integral: no power needs to be integrated. By Tellegen's
theorem the sources deliver what resistors and capacitors take up, and so they do when the currents are weighted by
any other voltages ``W`` that the same sources allow: with node voltages ``V = W + P y`` (``P`` from rows to nodes)
the power is ``W^T G_n V + W^T C_n V' + y^T P^T I``, ``G_n`` and ``C_n`` being the matrices of all nodes and ``I`` the
currents fed in. For ``W`` the mean voltages are taken, whose ``y`` has no integral. What is left is the power that
resistors turn into heat at the mean voltages, and the charge that every capacitor takes up, brought there against its
mean voltage: differences across elements, none of which is counted from ground.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from resgrid.circuit.equations import contacts_of, grid_of, injected_into_rows, number_rows, parts_of, sum_by_row
from resgrid.circuit.sources import SourceForest, tie_sources
from resgrid.errors import CircuitError, InputError
from resgrid.netlist import Netlist
from resgrid.solvers.choose import factor_laplacian
from resgrid.solvers.factor import Factor
from resgrid.solvers.laplacian import Branches, EdgeList, Laplacian, Rows


@dataclass(frozen=True, eq=False)
class Dynamics:
    """The equations ``C x' + G x = b`` of a netlist; node voltages are ``fixed + x[row]``.

    `row` (nodes,): row of every node, -1 for rails and floating nodes; nodes tied by floating sources share a row;
    `fixed` (nodes,): voltage of rails, and of other nodes above their row, in volts; NaN where a node floats;
    `conductance`: ``G``, in siemens; `capacitance`: ``C``, in farads; rows without capacitance are algebraic; `drive`
    (n,): ``b``: current that sources feed into every row, in amperes; `floating`: nodes that no resistor, capacitor
    or voltage source ties to ground; `branches`: of ``G``.
    """

    netlist: Netlist
    row: NDArray[np.int32]
    fixed: NDArray[np.float64]
    conductance: Laplacian
    capacitance: Laplacian
    drive: NDArray[np.float64]
    floating: NDArray[np.int64]
    forest: SourceForest
    branches: Branches

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self.drive)

    def imbalance(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """``b - G x``: the current that charges every row, in amperes, shape (n,); formed from differences."""
        return np.asarray((self.drive - self.conductance.ground * x) - self.branches.between(x))

    @property
    def apart(self) -> bool:
        """Whether every capacitor goes to a rail."""
        return not len(self.capacitance.as_rows().indices)

    def voltage(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Node voltages of a state, in volts; shape (nodes,)."""
        solved = self.row >= 0
        volts = self.fixed.copy()
        volts[solved] += x[self.row[solved]]
        return volts

    def state(self, voltage: NDArray[np.float64]) -> NDArray[np.float64]:
        """State of node voltages, in volts, shape (n,); of nodes that share a row, the first one's."""
        nodes = np.flatnonzero(self.row >= 0)
        rows, first = np.unique(self.row[nodes], return_index=True)
        x = np.empty(self.size)
        x[rows] = voltage[nodes[first]] - self.fixed[nodes[first]]
        return x

    def at_nodes(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values of rows at nodes, shape (nodes,): 0 on rails, NaN where a node floats."""
        result = np.where(np.isnan(self.fixed), np.nan, 0.0)
        solved = self.row >= 0
        result[solved] = value[self.row[solved]]
        return result

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
