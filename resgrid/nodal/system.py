"""Nodal analysis: which voltages are unknown, and the equations that hold them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.errors import CircuitError
from resgrid.netlist import GROUND, Layout, Netlist
from resgrid.nodal.sources import SourceForest, tie_sources


@dataclass(frozen=True, eq=False)
class Rails:
    """The two voltages that a circuit with two rails hangs between.

    Attributes
    ----------
    high, low : float
        Voltages in volts; ``high`` is the obstacle rail (or the driven start) where there is a layout.
    to_high, to_low : ndarray of float64, shape (n,)
        Conductance from every row to either rail, in siemens.
    """

    high: float
    low: float
    to_high: NDArray[np.float64]
    to_low: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NodalSystem:
    """The reduced nodal equations of a netlist, off-diagonals and row excess kept apart.

    Row ``i`` says ``sum_j g_ij (x_i - x_j) + excess_i x_i = b_i``: a symmetric positive definite M-matrix
    whenever every connected part holds a node of known voltage.

    Attributes
    ----------
    forest : SourceForest
        How the voltage sources tie the nodes.
    unknown : ndarray of int64, shape (nodes,)
        Row of every node that is solved for, -1 elsewhere; nodes tied by floating sources share a row.
    excess : ndarray of float64, shape (n,)
        Conductance from every row to nodes of known voltage, in siemens.
    feed : ndarray of float64, shape (n,)
        Current that the known voltages drive into every row, measured from `reference`, in amperes.
    injected : ndarray of float64, shape (n,)
        Current that current sources drive into every row, in amperes.
    reference : float
        The lowest known voltage in contact with the rows, in volts.
    rails : Rails or None
        The two rails, if the known voltages take just two values and nothing else drives the circuit.
    known : ndarray of float64, shape (nodes,)
        Voltages known beforehand, in volts: rails, and parts that a single rail holds; NaN elsewhere.
    undriven : ndarray of int64
        Nodes of those parts.
    floating : ndarray of int64
        Nodes that nothing ties to ground.
    derived : scipy.sparse.csr_array or None, shape (n, n)
        The `coupling` of a system that was derived from another one; None where the netlist's resistors make it.
    """

    netlist: Netlist
    forest: SourceForest
    unknown: NDArray[np.int64]
    excess: NDArray[np.float64]
    feed: NDArray[np.float64]
    injected: NDArray[np.float64]
    reference: float
    rails: Rails | None
    known: NDArray[np.float64]
    undriven: NDArray[np.int64]
    floating: NDArray[np.int64]
    derived: sparse.csr_array | None = None

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self.excess)

    @cached_property
    def coupling(self) -> sparse.csr_array:
        """The positive conductances ``g_ij`` between rows, in siemens, shape (n, n); symmetric, no diagonal.

        Compressed rows, made when first asked for: a grid's multigrid and its normwise answer do without.
        """
        if self.derived is not None:
            return self.derived
        from resgrid.nodal.assembly import conductances_by_row

        netlist, size = self.netlist, self.size
        indptr, indices, data = conductances_by_row(netlist.resistor_nodes, netlist.conductance, self.unknown, size)
        coupling = sparse.csr_array((data, indices, indptr), shape=(size, size))
        coupling.has_sorted_indices = coupling.has_canonical_format = True
        return coupling

    @cached_property
    def degree(self) -> NDArray[np.float64]:
        """Diagonal of the matrix, in siemens, shape (n,): all conductances at a row, summed."""
        if self.derived is not None:
            return np.asarray(self.derived.sum(axis=1) + self.excess, dtype=np.float64)
        from resgrid.nodal.assembly import add_conductances

        degree = self.excess.copy()
        add_conductances(self.netlist.resistor_nodes, self.netlist.conductance, self.unknown, degree)
        return degree


@dataclass(frozen=True, eq=False)
class _Parts:
    """Connected parts of the unknown nodes, and what holds each."""

    of_node: NDArray[np.int32]
    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    fed: NDArray[np.bool_]

    @property
    def floating(self) -> NDArray[np.bool_]:
        return ~np.isfinite(self.lowest)

    @property
    def driven(self) -> NDArray[np.bool_]:
        return ~self.floating & (self.fed | (self.highest > self.lowest))


def assemble(netlist: Netlist) -> NodalSystem:
    """Set up the nodal equations.

    Sources are merged first; parts that nothing ties to ground, and parts that a single rail holds at its own voltage,
    are set apart: only what is driven is left to be solved.

    Parameters
    ----------
    netlist : Netlist

    Returns
    -------
    NodalSystem

    Raises
    ------
    CircuitError
        If voltage sources contradict each other, a current source feeds a part that floats, or nothing is driven.
    """
    forest = tie_sources(netlist)
    held = forest.root == forest.root[GROUND]
    known = np.where(held, forest.offset, np.nan)
    parts = _parts(netlist, forest, known)
    _check_driven(netlist, known, parts)
    driven_node = parts.driven[parts.of_node] & ~held
    undriven_node = ~parts.driven[parts.of_node] & ~parts.floating[parts.of_node] & ~held
    known[undriven_node] = parts.lowest[parts.of_node][undriven_node]
    unknown = np.full(netlist.node_count, -1, dtype=np.int64)
    unknown[driven_node] = _numbered(forest.root[driven_node], netlist.node_count)
    offset = np.where(driven_node, forest.offset, 0.0)
    contact = _contacts(netlist, unknown, known)
    reference = float(contact.volts.min(initial=np.inf)) if contact.volts.size else 0.0
    size = int(unknown.max(initial=-1)) + 1
    internal_feed = _offset_feed(netlist, unknown, offset, size)
    height = contact.volts - reference - offset[contact.node]
    injected = _injected(netlist, unknown, size)
    plain = not injected.any() and not offset.any()
    return NodalSystem(
        netlist=netlist,
        forest=forest,
        unknown=unknown,
        excess=_sum_by(contact.row, contact.conductance, size),
        feed=internal_feed + _sum_by(contact.row, contact.conductance * height, size),
        injected=injected,
        reference=reference,
        rails=_rails(netlist.layout, contact, size) if plain else None,
        known=known,
        undriven=np.flatnonzero(undriven_node),
        floating=np.flatnonzero(parts.floating[parts.of_node] & ~held),
    )


def _numbered(roots: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Number the roots that occur, in ascending order: the rows."""
    occurs = np.zeros(count, dtype=np.bool_)
    occurs[roots] = True
    return np.asarray(np.cumsum(occurs)[roots] - 1, dtype=np.int64)


def _parts(netlist: Netlist, forest: SourceForest, known: NDArray[np.float64]) -> _Parts:
    from resgrid.nodal.assembly import connected_parts, known_range, mark_fed

    number, of_node = connected_parts(netlist.resistor_nodes, _floating_ties(netlist, known), ~np.isnan(known))
    lowest, highest = np.full(number, np.inf), np.full(number, -np.inf)
    known_range(netlist.resistor_nodes, known, of_node, lowest, highest)
    fed = np.zeros(number, dtype=np.bool_)
    mark_fed(netlist.current_nodes, netlist.current_amps, known, of_node, fed)
    fed[of_node[np.flatnonzero((forest.offset != 0) & np.isnan(known))]] = True
    return _Parts(of_node, lowest, highest, fed)


def _floating_ties(netlist: Netlist, known: NDArray[np.float64]) -> NDArray[np.int64]:
    """Voltage sources between nodes of unknown voltage join them into one part."""
    return netlist.source_nodes[np.isnan(known[netlist.source_nodes]).all(axis=1)]


def _check_driven(netlist: Netlist, known: NDArray[np.float64], parts: _Parts) -> None:
    if np.any(parts.fed & parts.floating):
        fed = netlist.current_nodes[netlist.current_amps != 0].ravel()
        stuck = fed[np.isnan(known[fed]) & parts.floating[parts.of_node[fed]]]
        raise CircuitError(
            f"a current source feeds node {netlist.node_name(int(stuck.min()))}, which nothing ties to ground: "
            "its voltage has no bound; add a resistor to a rail or remove the source"
        )
    if parts.driven.any():
        return
    ends = known[netlist.resistor_nodes]
    if not np.any(np.abs(ends[:, 0] - ends[:, 1]) > 0):
        raise CircuitError(
            "nothing is driven: no part of the circuit touches two rails or is fed a current, so that nothing flows; "
            "add a second rail (an obstacle, an edge that counts as one), open a way to the goal, or add a drive"
        )


@dataclass(frozen=True, eq=False)
class _Contacts:
    """Resistors from a row to a node of known voltage."""

    row: NDArray[np.int64]
    node: NDArray[np.int64]
    conductance: NDArray[np.float64]
    volts: NDArray[np.float64]


def _contacts(netlist: Netlist, unknown: NDArray[np.int64], known: NDArray[np.float64]) -> _Contacts:
    from resgrid.nodal.assembly import contacts

    number, inner, outer = contacts(netlist.resistor_nodes, unknown)
    return _Contacts(unknown[inner], inner, netlist.conductance[number], known[outer])


def _offset_feed(
    netlist: Netlist, unknown: NDArray[np.int64], offset: NDArray[np.float64], size: int
) -> NDArray[np.float64]:
    """What the offsets of floating sources drive through the conductances between rows."""
    if not offset.any():
        return np.zeros(size)
    rows = unknown[netlist.resistor_nodes]
    inner = (rows >= 0).all(axis=1) & (rows[:, 0] != rows[:, 1])
    a, b = rows[inner].T
    step = netlist.conductance[inner] * np.subtract(*offset[netlist.resistor_nodes[inner]].T)
    return _sum_by(b, step, size) - _sum_by(a, step, size)


def _injected(netlist: Netlist, unknown: NDArray[np.int64], size: int) -> NDArray[np.float64]:
    from resgrid.nodal.assembly import add_injected

    injected = np.zeros(size)
    add_injected(netlist.current_nodes, netlist.current_amps, unknown, injected)
    return injected


def _rails(layout: Layout | None, contact: _Contacts, size: int) -> Rails | None:
    low, high = float(contact.volts.min(initial=np.inf)), float(contact.volts.max(initial=-np.inf))
    if not low < high or not np.all((contact.volts == low) | (contact.volts == high)):
        return None
    if layout is not None and layout.supply < 0:
        low, high = high, low
    at_high = contact.volts == high
    return Rails(
        high=high,
        low=low,
        to_high=_sum_by(contact.row, contact.conductance * at_high, size),
        to_low=_sum_by(contact.row, contact.conductance * ~at_high, size),
    )


def _sum_by(row: NDArray[np.integer[Any]], amount: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    return np.asarray(np.bincount(row, amount, size), dtype=np.float64)
