"""Nodal analysis: reduction of a netlist to linear equations (rows) for the unknown node voltages."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.sources import SourceForest, tie_sources
from resgrid.core.drive_checks import NO_DRIVE, ONE_VOLTAGE
from resgrid.core.netlist import GROUND, Netlist
from resgrid.errors import CircuitError
from resgrid.solvers.laplacian import EdgeList, Grid, Laplacian, Rails

_MANY = 20_000
"""Largest number of current sources at ground for which their sum, the current into ground, is rounded only once."""

ALWAYS_RECOVERED = 500
"""Largest number of nodes for which currents of circuits without cells are always recomputed by iterative correction.

The correction keeps the digits that voltage differences lose to cancellation.  For so few nodes it takes milliseconds.
"""


def sum_by_row(row: NDArray[np.int32], values: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Return the sum of the values of every row, (n,).

    `row` (k,): row of every value; `values` (k,): values, such as currents in amperes; `size`: number of rows n.
    """
    return np.asarray(np.bincount(row, values, size), dtype=np.float64)


def across(voltage: NDArray[np.float64], ends: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return the voltages across elements, first end minus second, in volts, (m,); 0 if an end floats.

    `voltage` (nodes,): node voltages in volts, NaN if a node floats; `ends` (m, 2): nodes of the elements.
    """
    first, second = voltage[ends.T]
    return np.asarray(np.nan_to_num(first - second))


class RailContacts(NamedTuple):
    """Connections of rows (unknown voltages) to known voltages, and between rows whose nodes have voltage offsets.

    Floating sources (without a chain of sources to ground) give a node a voltage offset from its row. `element`, `row`
    (c,): resistor and row of every contact; `volts` (c,): voltage at the other end of the resistor above the lowest
    known voltage (for contacts between rows: offset of the other end minus that of this end); `ties`: number of
    contacts with nodes of known voltage, which come first; the others lead to other rows.
    """

    element: NDArray[np.int32]
    row: NDArray[np.int32]
    volts: NDArray[np.float64]
    ties: int


@dataclass(frozen=True, eq=False)
class Equations:
    """Reduced nodal equations of a netlist, ``laplacian @ x = drive``, for voltages ``x`` in volts above `reference`.

    A row is an unknown voltage with its equation: Kirchhoff's current law at one node, or at nodes that floating
    sources (sources without a chain of sources to ground) join.

    `netlist`: the circuit; `forest`: spanning forest of the voltage sources; `unknown` (nodes,): row of every node with
    an unknown voltage, -1 for others; nodes joined by floating sources share a row; `laplacian` (n, n): conductances
    between the rows, and from rows to nodes of known voltage; `laplacian.rails` is set if the known voltages have
    exactly two values and there is no other drive; `contacts`: resistors from rows to known voltages, or between rows
    with voltage offsets; `feed` (n,): current from the known voltages, above `reference`, into every row, in amperes;
    `injected` (n,): current from current sources into every row, in amperes; both are read-only views of one zero if
    all entries are 0; `reference`: the lowest known voltage in contact with the rows, in volts; `undriven`: nodes of
    components without current, which touch a single known voltage; `undriven_volts`: voltages of the nodes `undriven`;
    `floating`: nodes without a path of resistors or sources to ground.
    """

    netlist: Netlist
    forest: SourceForest
    unknown: NDArray[np.int32]
    laplacian: Laplacian
    contacts: RailContacts
    feed: NDArray[np.float64]
    injected: NDArray[np.float64]
    reference: float
    undriven: NDArray[np.int64]
    undriven_volts: NDArray[np.float64]
    floating: NDArray[np.int64]

    @property
    def size(self) -> int:
        """Number of rows (unknown voltages)."""
        return self.laplacian.size

    @property
    def rails(self) -> Rails | None:
        """The two rails and their contacts with rows; None unless exactly two known voltages drive the rows."""
        return self.laplacian.rails

    def known_voltages(self) -> NDArray[np.float64]:
        """Return a new array (nodes,) of known voltages in V: rails and components without current; NaN elsewhere."""
        forest = self.forest
        known = np.full(forest.count, np.nan)
        held = forest.base == GROUND
        known[forest.order[held]] = forest.height[held]
        known[self.undriven] = self.undriven_volts
        return known

    def heights(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the voltages of all nodes above the lowest known voltage, in volts, (nodes,), NaN if floating.

        `x` (n,): voltages of the rows above the lowest known voltage (``self.reference``), in volts.
        """
        own = np.where(self.unknown >= 0, self.forest.offsets[0], self.known_voltages() - self.reference)
        return np.asarray(own + np.append(x, 0.0)[self.unknown])

    def voltages(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the voltages of all nodes above ground, in volts, (nodes,), NaN if floating.

        `x` (n,): voltages of the rows above the lowest known voltage (``self.reference``), in volts.
        """
        return self.above_ground(self.heights(x))

    def above_ground(self, heights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the voltages of all nodes above ground, in volts, (nodes,), NaN if floating.

        `heights` (nodes,): voltages above the lowest known one, in volts.  Known voltages are returned without
        rounding.
        """
        if self.reference == 0.0:
            return heights
        return np.where(self.unknown >= 0, self.reference + heights, self.known_voltages())

    def with_conductance(self, conductance: NDArray[np.float64]) -> tuple[Laplacian, NDArray[np.float64]]:
        """Return the matrix for other conductances, and the currents (n,) from known voltages into the rows.

        `conductance` (resistors,): conductances in siemens. The currents are in amperes.
        """
        listed = EdgeList(self.netlist.resistor_nodes, conductance, self.unknown)
        return matrix_of(self.netlist, listed, self.contacts, self.size)

    @property
    def drive(self) -> NDArray[np.float64]:
        """Right-hand side: currents that known voltages and current sources drive into the rows, in amperes, (n,)."""
        if not self.injected.any():
            return self.feed
        return self.feed + self.injected if self.feed.any() else self.injected


@dataclass(frozen=True, eq=False)
class Components:
    """Connected components of the nodes whose voltage no chain of sources fixes, with the known voltages they touch.

    `of_node` (nodes,): component of every node, -1 for nodes of known voltage; `lowest`, `highest` (components,): range
    of the known voltages that the elements of a component touch, in volts; inf and -inf if there are none; `has_drive`
    (components,): whether current sources or offsets of floating voltage sources drive the component; `contacts` (c,):
    the elements between components and nodes of known voltage.
    """

    of_node: NDArray[np.int32]
    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    has_drive: NDArray[np.bool_]
    contacts: NDArray[np.int32]

    @property
    def floating(self) -> NDArray[np.bool_]:
        """Whether a component touches no known voltage, shape (components,)."""
        return ~np.isfinite(self.lowest)

    @property
    def driven(self) -> NDArray[np.bool_]:
        """Whether current flows in a component, shape (components,)."""
        return ~self.floating & (self.has_drive | (self.highest > self.lowest))

    def rows(self, solved: NDArray[np.bool_], forest: SourceForest) -> tuple[int, NDArray[np.int32]]:
        """Return the number of rows, and the row of every node (nodes,), -1 without a row.

        `solved` (components,): whether to solve for a component; `forest`: spanning forest of the voltage sources.  A
        row is a node of these components, or a set of nodes that sources join.
        """
        component = self.of_node
        solved_for = component >= 0 if solved.all() else np.append(solved, False)[component]
        tied = bool(np.any(forest.base != GROUND))
        row = np.cumsum(solved_for & (forest.root == np.arange(forest.count)) if tied else solved_for, dtype=np.int32)
        size = int(row[-1])
        row -= 1
        return size, np.where(solved_for, row[forest.root] if tied else row, np.int32(-1))


def assemble(netlist: Netlist) -> Equations:
    """Return the nodal equations of the operating point of a netlist with linear resistors.

    Voltage sources are eliminated first.  Floating components, and components that touch a single known voltage, carry
    no current and get no rows.  Raise CircuitError if there is no operating point.
    """
    forest, ends = tie_sources(netlist), netlist.resistor_nodes
    components = components_of(netlist, ends, forest)
    refuse_floating_currents(netlist, components, unless_balanced=True)
    size, unknown = components.rows(components.driven, forest)
    lifted = bool(np.any((unknown[forest.order] >= 0) & (forest.height != 0)))
    candidates = np.arange(len(ends), dtype=np.int32) if lifted else components.contacts
    contacts = contacts_of(ends, candidates, unknown, forest)
    reference = float(components.lowest[components.driven].min()) if size else 0.0
    injected = injected_into_rows(netlist, unknown, size)
    volts = contacts.volts[: contacts.ties] if size else _between_rails(netlist, forest.offsets[0], components)
    low, high = float(volts.min(initial=np.inf)), float(volts.max(initial=-np.inf))
    has_two_rails = low < high and np.all((volts == low) | (volts == high)) and not lifted and not injected.any()
    if netlist.space_map is not None and netlist.space_map.wiring.supply < 0:  # the obstacle rail is the lower one
        low, high = high, low
    siemens, at_high = netlist.conductance[contacts.element], contacts.volts == high
    leak = _leak_of(netlist)
    rails = Rails(high, low, size, contacts.row, siemens, at_high, leak) if has_two_rails else None
    listed = EdgeList(ends, netlist.conductance, unknown)
    contacts.volts[: contacts.ties] -= reference
    laplacian, feed = matrix_of(netlist, listed, contacts, size, rails)
    other = np.flatnonzero((unknown < 0) & (components.of_node >= 0))
    touched_volts = components.lowest[components.of_node[other]]
    floats = np.isinf(touched_volts)
    return Equations(
        netlist=netlist,
        forest=forest,
        unknown=unknown,
        laplacian=laplacian,
        contacts=contacts,
        feed=_without_memory(feed, size),
        injected=_without_memory(injected, size),
        reference=reference,
        undriven=other[~floats],
        undriven_volts=touched_volts[~floats],
        floating=other[floats],
    )


def matrix_of(
    netlist: Netlist, listed: EdgeList, contacts: RailContacts, size: int, rails: Rails | None = None
) -> tuple[Laplacian, NDArray[np.float64]]:
    """Return the matrix of elements between nodes of a netlist, and the currents (n,) from known voltages.

    `listed`: elements with nodes and conductances; `contacts`: contacts among the elements; `size`: number of rows n;
    `rails`: the rails, None unless exactly two drive the circuit.  The currents, in amperes, are those that contacts
    drive into every row. The matrix contains the grid of cells if the netlist has one.
    """
    siemens, ties = listed.conductance[contacts.element], slice(contacts.ties)
    ground = sum_by_row(contacts.row[ties], siemens[ties], size)
    feed = sum_by_row(contacts.row, siemens * contacts.volts, size)
    if netlist.cell_map is None:
        dimensions = 2 if netlist.lattice_map is None else netlist.lattice_map.space.ndim
        return Laplacian(ground, listed, dimensions=dimensions, rails=rails), feed
    grid = Grid(netlist.cell_map.node, tuple(axis.periodic for axis in netlist.cell_map.space.axes))
    return Laplacian(ground, listed, grid=grid, dimensions=grid.dimensions, rails=rails), feed


def components_of(netlist: Netlist, elements: NDArray[np.int32], forest: SourceForest) -> Components:
    """Return the components of nodes that elements and voltage sources connect.

    `elements` (m, 2): nodes of the elements; `forest`: spanning forest of the voltage sources.
    """
    from resgrid.circuit.kernels import merge_components, number_components

    component = np.arange(netlist.node_count, dtype=np.int32)
    component[forest.order[forest.base == GROUND]] = -1
    buffer = np.empty(max(len(elements), len(netlist.source_nodes)), dtype=np.int32)
    contacts = buffer[: merge_components(elements, component, buffer)].copy()
    merge_components(netlist.source_nodes, component, buffer)
    count = number_components(component)
    ends = np.take(elements, contacts, axis=0)
    inside = component[ends]
    outer_node, touching = ends[inside < 0], inside.max(axis=1)
    lowest, highest = _range(forest.offsets[0][outer_node], touching, count)
    has_drive = np.zeros(count + 1, dtype=np.bool_)  # the last entry is for nodes of known voltage
    for end in netlist.current_nodes.T:
        has_drive[np.take(component, end)[netlist.current_amps != 0]] = True
    has_drive[component[forest.order[(forest.base != GROUND) & (forest.height != 0)]]] = True
    has_drive = has_drive[:count]
    if forest.rounding.any():  # different exact voltages may have equal doubles
        nodes, place = np.unique(outer_node, return_inverse=True)
        rounded = forest.offsets[0][nodes].tolist()
        exact = [forest.exact.get(node, volts) for node, volts in zip(nodes.tolist(), rounded, strict=True)]
        rank = {volts: number for number, volts in enumerate(sorted(set(exact)))}
        least, most = _range(np.array([rank[volts] for volts in exact], dtype=np.float64)[place], touching, count)
        has_drive |= most > least
    return Components(component, lowest, highest, has_drive, contacts)


def refuse_floating_currents(netlist: Netlist, components: Components, *, unless_balanced: bool = False) -> None:
    """Raise CircuitError if current sources drive a floating component.

    `components`: components of the netlist; `unless_balanced`: whether to accept a component if its source currents add
    up to 0.
    """
    if not np.any(components.has_drive & components.floating):
        return
    node, amps = netlist.current_nodes.T.ravel(), np.outer([-1.0, 1.0], netlist.current_amps).ravel()
    own = components.of_node[node]
    into = (own >= 0) & components.floating[own] & (amps != 0.0)
    for component in np.unique(own[into]).tolist():
        here = into & (own == component)
        total = math.fsum(amps[here].tolist())
        if total or not unless_balanced:
            name = netlist.node_name(int(node[here].min()))
            raise CircuitError(
                f"current sources inject {total:g} A into node {name} and the nodes connected to it, but no resistor "
                "or voltage source ties these to ground, so that their voltages are unbounded or undetermined; add a "
                "resistor to a rail or remove a source"
            )


def _range(values: NDArray[np.float64], group: NDArray[np.int32], count: int) -> NDArray[np.float64]:
    """Return the minimum and the maximum of every group of values, shape (2, count); inf and -inf for an empty group.

    `values` (k,): the values; `group` (k,): group of every value; `count`: number of groups.
    """
    lowest, highest = found = np.array([[np.inf], [-np.inf]]).repeat(count, axis=1)
    np.minimum.at(lowest, group, values)
    np.maximum.at(highest, group, values)
    return found


def contacts_of(
    ends: NDArray[np.int32], candidates: NDArray[np.int32], unknown: NDArray[np.int32], forest: SourceForest
) -> RailContacts:
    """Return the contacts among some elements: connections of rows to known voltages or to rows with voltage offsets.

    `ends` (m, 2): nodes of all elements; `candidates` (k,): indices of the candidates; `unknown` (nodes,): row of every
    node, -1 without a row; `forest`: spanning forest of the voltage sources, with the voltage offset of every node.
    """
    first, second = np.take(ends, candidates, axis=0).T
    i, j = np.take(unknown, first), np.take(unknown, second)
    offset = forest.offsets[0]
    volts = np.take(offset, second) - np.take(offset, first)
    tied, joined = (i < 0) != (j < 0), np.flatnonzero((i >= 0) & (j >= 0) & (i != j) & (volts != 0))
    return RailContacts(
        element=np.concatenate([candidates[tied], candidates[joined], candidates[joined]]),
        row=np.concatenate([np.maximum(i, j)[tied], i[joined], j[joined]]),
        volts=np.concatenate([np.where(i >= 0, volts, -volts)[tied], volts[joined], -volts[joined]]),
        ties=int(np.count_nonzero(tied)),
    )


def injected_into_rows(netlist: Netlist, unknown: NDArray[np.int32], size: int) -> NDArray[np.float64]:
    """Return the sum of the source currents into every row, in amperes, (n,).

    `unknown` (nodes,): row of every node, -1 without a row; `size`: number of rows n.  Sums of more than two currents,
    which may nearly cancel, are rounded once.
    """
    taken, fed = (np.take(unknown, end) for end in netlist.current_nodes.T)
    row = np.concatenate([taken[taken >= 0], fed[fed >= 0]])
    amps = np.concatenate([-netlist.current_amps[taken >= 0], netlist.current_amps[fed >= 0]])
    injected, count = sum_by_row(row, amps, size), np.bincount(row, minlength=size)
    if count.max(initial=0) > 2:
        several = np.flatnonzero(count[row] > 2)
        several = several[np.argsort(row[several], kind="stable")]
        ends = np.cumsum(count[count > 2])[:-1]
        injected[count > 2] = [math.fsum(part) for part in np.split(amps[several], ends)]
    return injected


def injected_currents(netlist: Netlist) -> NDArray[np.float64]:
    """Return the sum of the source currents into every node, ground included, in amperes, shape (nodes,)."""
    unknown, (taken, fed) = np.arange(netlist.node_count, dtype=np.int32), netlist.current_nodes.T
    unknown[GROUND] = -1
    injected, amps = injected_into_rows(netlist, unknown, netlist.node_count), netlist.current_amps
    amps = np.concatenate([amps[fed == GROUND], -amps[taken == GROUND]])
    injected[GROUND] = amps.sum() if len(amps) > _MANY else math.fsum(amps.tolist())
    return injected


def _leak_of(netlist: Netlist) -> float:
    """Return the nominal conductance of the leak of every free cell, in siemens; 0 without cells or without a leak."""
    cells = netlist.cell_map
    return 0.0 if cells is None else cells.wiring.leak_conductance(cells.space.spacing)


def _without_memory(currents: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Return the currents (n,), or a read-only view of a single zero, shape (n,), if all of them are zero.

    `size`: number of rows n.
    """
    return currents if currents.any() else np.broadcast_to(0.0, size)


def _between_rails(netlist: Netlist, volts: NDArray[np.float64], components: Components) -> NDArray[np.float64]:
    """Return the known voltages at the ends of resistors between two different known voltages, in volts, (k, 2).

    `volts` (nodes,): known voltages in volts.  Raise CircuitError if there is no such resistor and the netlist comes
    from a space; in other circuits all currents are 0 A.
    """
    ends = np.where(components.of_node < 0, volts, np.nan)[netlist.resistor_nodes]
    ends = ends[np.abs(ends[:, 0] - ends[:, 1]) > 0]
    if not ends.size and netlist.space_map is not None:
        raise CircuitError(NO_DRIVE if netlist.space_map.wiring.has_islands else ONE_VOLTAGE)
    if not ends.size and components.floating.all() and np.count_nonzero(components.of_node < 0) == 1:
        raise CircuitError(
            "no resistor or voltage source touches ground, node 0, so that no voltage is known; connect one to node 0"
        )
    return np.asarray(ends)
