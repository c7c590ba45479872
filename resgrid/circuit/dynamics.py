"""A netlist with capacitors as the linear system ``C x' + G x = b``, reduced to the voltages that sources leave free.

Nodes tied by voltage sources share a row, as in an operating point.  ``G + s C`` with ``s >= 0`` is then a nodal matrix
of its own, in which a capacitor is a resistor of conductance ``s`` times its capacitance (the companion model of
Nagel 1975, section 4.3), so that every method that solves operating points solves implicit time steps too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from resgrid.circuit.equations import grid_of
from resgrid.circuit.sources import SourceForest, tie_sources
from resgrid.errors import CircuitError, InputError
from resgrid.netlist import GROUND, Netlist
from resgrid.solvers.choose import factor_laplacian
from resgrid.solvers.factors.factor import Factor
from resgrid.solvers.laplacian import Laplacian


@dataclass(frozen=True, eq=False)
class Dynamics:
    """The equations ``C x' + G x = b`` of a netlist; node voltages are ``fixed + x[row]``.

    `row` (nodes,): row of every node, -1 for rails and floating nodes; nodes tied by floating sources share a row;
    `fixed` (nodes,): voltage of rails, and of other nodes above their row, in volts; NaN where a node floats;
    `conductance`: ``G``, in siemens; `capacitance`: ``C``, in farads; rows without capacitance are algebraic; `drive`
    (n,): ``b``: current that sources feed into every row, in amperes; `floating`: nodes that no resistor, capacitor
    or voltage source ties to ground.
    """

    netlist: Netlist
    row: NDArray[np.int64]
    fixed: NDArray[np.float64]
    conductance: Laplacian
    capacitance: Laplacian
    drive: NDArray[np.float64]
    floating: NDArray[np.int64]
    forest: SourceForest

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self.drive)

    def imbalance(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """``b - G x``: the current that charges every row, in amperes, shape (n,); formed from differences."""
        return np.asarray((self.drive - self.conductance.ground * x) - self.conductance.between(x))

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
        return np.asarray(np.bincount(self.row[nodes[inside]], amount[inside], self.size), dtype=np.float64)


def dynamics_of(netlist: Netlist) -> Dynamics:
    """Set up the equations of a netlist with capacitors."""
    require_linear(netlist)
    forest = tie_sources(netlist)
    held = forest.root == forest.root[GROUND]
    floats = _floating(netlist, held)
    _check_fed(netlist, floats)
    row = np.full(netlist.node_count, -1, dtype=np.int64)
    free = ~held & ~floats
    _, row[free] = np.unique(forest.root[free], return_inverse=True)
    fixed = np.where(floats, np.nan, forest.offset)
    size = int(row.max(initial=-1)) + 1
    through = netlist.conductance * np.subtract(*fixed[netlist.resistor_nodes.T])
    ends, amps = np.concatenate([netlist.resistor_nodes, netlist.current_nodes]), [through, netlist.current_amps]
    a, b = ends.T
    flow = np.concatenate(amps)
    grid = grid_of(netlist)
    grid = None if grid is None else grid.of_rows(row.astype(np.int32))
    conductance = _laplacian(netlist.resistor_nodes, netlist.conductance, row, size)
    count = netlist.node_count
    into = np.bincount(b, flow, count) - np.bincount(a, flow, count)
    return Dynamics(
        netlist=netlist,
        row=row,
        fixed=fixed,
        conductance=replace(conductance, grid=grid, dimensions=2 if grid is None else grid.dimensions),
        capacitance=_laplacian(netlist.capacitor_nodes, netlist.capacitance, row, size),
        drive=np.bincount(row[free], into[free], size).astype(np.float64),
        floating=np.flatnonzero(floats),
        forest=forest,
    )


def factor_resolvent(dynamics: Dynamics, rate: float, method: str = "auto") -> Factor:
    """Factor ``G + rate C``."""
    G, C = dynamics.conductance, dynamics.capacitance
    if rate == 0.0:
        require_grounded(dynamics)
    edges = sparse.csr_array(G.edges + rate * C.edges) if rate else G.edges
    matrix = Laplacian(G.ground + rate * C.ground, compressed=edges, grid=G.grid, dimensions=G.dimensions)
    return factor_laplacian(matrix, method)


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


def _laplacian(ends: NDArray[np.int32], value: NDArray[np.float64], row: NDArray[np.int64], size: int) -> Laplacian:
    rows = row[ends]
    present = value > 0
    inner = (rows >= 0).all(axis=1) & (rows[:, 0] != rows[:, 1]) & present
    a, b = rows[inner].astype(np.int32).T
    v = value[inner]
    entries = (np.concatenate([v, v]), (np.concatenate([a, b]), np.concatenate([b, a])))
    border = ((rows >= 0).sum(axis=1) == 1) & present
    ground = np.bincount(rows[border].max(axis=1), value[border], size).astype(np.float64)
    return Laplacian(ground, compressed=sparse.coo_array(entries, shape=(size, size)).tocsr())


def _floating(netlist: Netlist, held: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Nodes of the parts, joined by any passive element or voltage source, that have no rail."""
    ends = np.concatenate(
        [netlist.resistor_nodes, netlist.capacitor_nodes[netlist.capacitance > 0], netlist.source_nodes]
    )
    count = netlist.node_count
    graph = sparse.coo_array((np.ones(len(ends), dtype=np.int8), tuple(ends.T)), shape=(count, count))
    number, part = connected_components(graph, directed=False)
    has_rail = np.bincount(part, held, number) > 0
    return np.asarray(~has_rail[part])


def _check_fed(netlist: Netlist, floats: NDArray[np.bool_]) -> None:
    fed = netlist.current_nodes[netlist.current_amps != 0].ravel()
    stuck = fed[floats[fed]]
    if stuck.size:
        raise CircuitError(
            f"a current source feeds node {netlist.node_name(int(stuck.min()))}, which nothing ties to ground: its "
            "voltage has no bound, or none that is known; add a resistor or capacitor to a rail, or remove the source"
        )
