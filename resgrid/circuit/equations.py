"""Nodal analysis: which voltages are unknown, and the equations that hold them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.sources import SourceForest, tie_sources
from resgrid.core.netlist import GROUND, Netlist
from resgrid.errors import CircuitError
from resgrid.solvers.laplacian import EdgeList, Grid, Laplacian, Rails

_MANY = 20_000
"""Current sources at ground from which on these are not summed exactly: a grid has one for every cell."""


def sum_by_row(row: NDArray[np.int32], values: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Sums of the values (k,) that belong to every row, shape (n,)."""
    return np.asarray(np.bincount(row, values, size), dtype=np.float64)


def across(voltage: NDArray[np.float64], ends: NDArray[np.int32]) -> NDArray[np.float64]:
    """Voltages of elements' first ends above their second ones, (m,); 0 where one floats.  Shapes: `ends` (m, 2)."""
    first, second = voltage[ends.T]
    return np.asarray(np.nan_to_num(first - second))


class RailContacts(NamedTuple):
    """Through which elements known voltages drive the rows, and where floating sources lift one end over the other.

    `element, row` (c,); `volts` (c,): what the row sees behind the element, in volts, above the reference of equations
    that have one; the first `ties` lead to nodes of known voltage, the others from row to row.
    """

    element: NDArray[np.int32]
    row: NDArray[np.int32]
    volts: NDArray[np.float64]
    ties: int


@dataclass(frozen=True, eq=False)
class Equations:
    """The reduced nodal equations of a netlist: ``laplacian @ x = drive``, heights ``x`` above `reference`.

    `forest`: how the voltage sources tie the nodes; `unknown` (nodes,): row of every node that is solved for, -1
    elsewhere; nodes tied by floating sources share a row; `laplacian` (n, n): conductances between the rows, and from
    them to nodes of known voltage; it tells the two rails apart, if the known voltages take just two values and
    nothing else drives the circuit; `contacts`: the resistors of which `feed` and ground conductances are made;
    `feed` (n,): current that the known voltages drive into every row, measured from `reference`, in amperes; read-only
    where there is none; `injected` (n,): current that current sources drive into every row, in amperes, likewise;
    `reference`: the lowest known voltage in contact with the rows, in volts; `undriven`: nodes of parts that a single
    rail holds; `undriven_volts`: their voltages; `floating`: nodes that nothing ties to ground.
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
        """Number of rows."""
        return self.laplacian.size

    @property
    def rails(self) -> Rails | None:
        """The two rails that the circuit hangs between, if it does."""
        return self.laplacian.rails

    def known_voltages(self) -> NDArray[np.float64]:
        """Voltages known beforehand, in volts, (nodes,): rails, and `undriven` nodes; NaN elsewhere.  A new array."""
        forest = self.forest
        known = np.full(forest.count, np.nan)
        held = forest.base == GROUND
        known[forest.order[held]] = forest.height[held]
        known[self.undriven] = self.undriven_volts
        return known

    def heights(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Heights of all nodes above `reference`, in volts, (nodes,), from those of the rows; NaN where one floats."""
        own = np.where(self.unknown >= 0, self.forest.offsets[0], self.known_voltages() - self.reference)
        return np.asarray(own + np.append(x, 0.0)[self.unknown])

    def voltages(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """As `above_ground`, from the heights of the rows, (n,)."""
        return self.above_ground(self.heights(x))

    def above_ground(self, heights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Voltages of all nodes above ground from their heights, (nodes,): known ones as given; NaN if one floats."""
        if self.reference == 0.0:
            return heights
        return np.where(self.unknown >= 0, self.reference + heights, self.known_voltages())

    def with_conductance(self, conductance: NDArray[np.float64]) -> tuple[Laplacian, NDArray[np.float64]]:
        """The matrix of the same circuit with other conductances, and their `feed`.  Shapes: (resistors,)."""
        listed = EdgeList(self.netlist.resistor_nodes, conductance, self.unknown)
        return matrix_of(self.netlist, listed, self.contacts, self.size)

    @property
    def drive(self) -> NDArray[np.float64]:
        """All that drives the rows, in amperes, shape (n,): feed and injected currents together."""
        if not self.injected.any():
            return self.feed
        return self.feed + self.injected if self.feed.any() else self.injected


@dataclass(frozen=True, eq=False)
class Parts:
    """Connected parts of the nodes that no source ties to ground, and what holds each part.

    `of_node` (nodes,): number of every node's part, -1 for nodes tied to ground; `lowest, highest` (parts,): the
    range of known voltages that a part's elements reach, in volts; infinite where they reach none; `fed` (parts,):
    whether current sources or the offsets of floating voltage sources drive it; `contacts` (c,): the elements
    between parts and nodes tied to ground.
    """

    of_node: NDArray[np.int32]
    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    fed: NDArray[np.bool_]
    contacts: NDArray[np.int32]

    @property
    def floating(self) -> NDArray[np.bool_]:
        """Whether a part reaches no known voltage, shape (parts,)."""
        return ~np.isfinite(self.lowest)

    @property
    def driven(self) -> NDArray[np.bool_]:
        """Whether anything flows in a part, shape (parts,)."""
        return ~self.floating & (self.fed | (self.highest > self.lowest))

    def rows(self, solved: NDArray[np.bool_], forest: SourceForest) -> tuple[int, NDArray[np.int32]]:
        """Number the rows of some parts (parts,): one for every node, or for all that sources tie together.

        Returns how many there are, and `unknown` (nodes,).
        """
        part = self.of_node
        solved_for = part >= 0 if solved.all() else np.append(solved, False)[part]
        tied = bool(np.any(forest.base != GROUND))
        row = np.cumsum(solved_for & (forest.root == np.arange(forest.count)) if tied else solved_for, dtype=np.int32)
        size = int(row[-1])
        row -= 1
        return size, np.where(solved_for, row[forest.root] if tied else row, np.int32(-1))


def assemble(netlist: Netlist) -> Equations:
    """Set up the nodal equations of an operating point.

    Sources are merged first; parts that nothing ties to ground, and parts that a single rail holds at its own voltage,
    are set apart: only what is driven is left to be solved.
    """
    forest, ends = tie_sources(netlist), netlist.resistor_nodes
    parts = parts_of(netlist, ends, forest)
    refuse_floating_currents(netlist, parts, unless_balanced=True)
    size, unknown = parts.rows(parts.driven, forest)
    lifted = bool(np.any((unknown[forest.order] >= 0) & (forest.height != 0)))
    some = np.arange(len(ends), dtype=np.int32) if lifted else parts.contacts
    contacts = contacts_of(ends, some, unknown, forest)
    reference = float(parts.lowest[parts.driven].min()) if size else 0.0
    injected = injected_into_rows(netlist, unknown, size)
    volts = contacts.volts[: contacts.ties] if size else _between_rails(netlist, forest.offsets[0], parts)
    low, high = float(volts.min(initial=np.inf)), float(volts.max(initial=-np.inf))
    plain = low < high and np.all((volts == low) | (volts == high)) and not lifted and not injected.any()
    if netlist.cell_map is not None and netlist.cell_map.wiring.supply < 0:  # the obstacles are on the lower one
        low, high = high, low
    siemens, at_high = netlist.conductance[contacts.element], contacts.volts == high
    rails = Rails(high, low, size, contacts.row, siemens, at_high) if plain else None
    listed = EdgeList(ends, netlist.conductance, unknown)
    contacts.volts[: contacts.ties] -= reference
    laplacian, feed = matrix_of(netlist, listed, contacts, size, rails)
    other = np.flatnonzero((unknown < 0) & (parts.of_node >= 0))
    at_rest = parts.lowest[parts.of_node[other]]
    floats = np.isinf(at_rest)
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
        undriven_volts=at_rest[~floats],
        floating=other[floats],
    )


def matrix_of(
    netlist: Netlist, listed: EdgeList, contacts: RailContacts, size: int, rails: Rails | None = None
) -> tuple[Laplacian, NDArray[np.float64]]:
    """The matrix for elements between a netlist's nodes, on the grid whose cells these are, if there is one.

    Returns `feed` (n,), too: what contacts drive into every row, in amperes.
    """
    siemens, ties = listed.conductance[contacts.element], slice(contacts.ties)
    ground = sum_by_row(contacts.row[ties], siemens[ties], size)
    feed = sum_by_row(contacts.row, siemens * contacts.volts, size)
    if netlist.cell_map is None:
        return Laplacian(ground, listed, rails=rails), feed
    grid = Grid(netlist.cell_map.node, tuple(axis.periodic for axis in netlist.cell_map.space.axes))
    return Laplacian(ground, listed, grid=grid, dimensions=grid.dimensions, rails=rails), feed


def parts_of(netlist: Netlist, elements: NDArray[np.int32], forest: SourceForest) -> Parts:
    """Find the parts that elements and voltage sources join.  Shapes: `elements` (m, 2)."""
    from resgrid.circuit.kernels import join_parts, number_parts

    part = np.arange(netlist.node_count, dtype=np.int32)
    part[forest.order[forest.base == GROUND]] = -1
    room = np.empty(max(len(elements), len(netlist.source_nodes)), dtype=np.int32)
    contacts = room[: join_parts(elements, part, room)].copy()
    join_parts(netlist.source_nodes, part, room)
    number = number_parts(part)
    ends = np.take(elements, contacts, axis=0)
    here = part[ends]
    tied, held = ends[here < 0], here.max(axis=1)
    offset, rest = forest.offsets
    lowest, highest = _range(offset[tied], held, number)
    fed = np.zeros(number + 1, dtype=np.bool_)  # the last one for what is tied to ground
    for end in netlist.current_nodes.T:
        fed[np.take(part, end)[netlist.current_amps != 0]] = True
    fed[part[forest.order[(forest.base != GROUND) & (forest.height != 0)]]] = True
    fed = fed[:number]
    if forest.rest.any():
        least, most = _range(rest[tied], held, number)
        fed |= most > least
    return Parts(part, lowest, highest, fed, contacts)


def refuse_floating_currents(netlist: Netlist, parts: Parts, *, unless_balanced: bool = False) -> None:
    """Raise CircuitError if current sources feed a floating part; or only if the sum of their currents is not zero."""
    if not np.any(parts.fed & parts.floating):
        return
    node, amps = netlist.current_nodes.T.ravel(), np.outer([-1.0, 1.0], netlist.current_amps).ravel()
    own = parts.of_node[node]
    into = (own >= 0) & parts.floating[own] & (amps != 0.0)
    for part in np.unique(own[into]).tolist():
        here = into & (own == part)
        total = math.fsum(amps[here].tolist())
        if total or not unless_balanced:
            name = netlist.node_name(int(node[here].min()))
            raise CircuitError(
                f"current sources feed node {name} and the nodes joined to it, {total:g} A in sum, which nothing ties "
                "to ground: their voltages have no bound, or none that is known; add a resistor to a rail or remove a "
                "source"
            )


def _range(values: NDArray[np.float64], group: NDArray[np.int32], count: int) -> NDArray[np.float64]:
    """The least and the greatest value (k,) of every group, shape (2, groups); infinite where there is none."""
    lowest, highest = found = np.array([[np.inf], [-np.inf]]).repeat(count, axis=1)
    np.minimum.at(lowest, group, values)
    np.maximum.at(highest, group, values)
    return found


def contacts_of(
    ends: NDArray[np.int32], some: NDArray[np.int32], unknown: NDArray[np.int32], forest: SourceForest
) -> RailContacts:
    """Look at some of the elements.  Shapes: `ends` (m, 2), `some` (k,): their numbers."""
    first, second = np.take(ends, some, axis=0).T
    i, j = np.take(unknown, first), np.take(unknown, second)
    offset = forest.offsets[0]
    volts = np.take(offset, second) - np.take(offset, first)
    tied, joined = (i < 0) != (j < 0), np.flatnonzero((i >= 0) & (j >= 0) & (i != j) & (volts != 0))
    return RailContacts(
        element=np.concatenate([some[tied], some[joined], some[joined]]),
        row=np.concatenate([np.maximum(i, j)[tied], i[joined], j[joined]]),
        volts=np.concatenate([np.where(i >= 0, volts, -volts)[tied], volts[joined], -volts[joined]]),
        ties=int(np.count_nonzero(tied)),
    )


def injected_into_rows(netlist: Netlist, unknown: NDArray[np.int32], size: int) -> NDArray[np.float64]:
    """What current sources drive into every row, in amperes, shape (n,); rounded once: several may nearly cancel."""
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
    """Current that the current sources feed into every node, in amperes; shape (nodes,)."""
    unknown, (taken, fed) = np.arange(netlist.node_count, dtype=np.int32), netlist.current_nodes.T
    unknown[GROUND] = -1
    injected, amps = injected_into_rows(netlist, unknown, netlist.node_count), netlist.current_amps
    amps = np.concatenate([amps[fed == GROUND], -amps[taken == GROUND]])
    injected[GROUND] = amps.sum() if len(amps) > _MANY else math.fsum(amps.tolist())
    return injected


def _without_memory(currents: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """The same currents; one zero for all rows where nothing flows."""
    return currents if currents.any() else np.broadcast_to(0.0, size)


def _between_rails(netlist: Netlist, volts: NDArray[np.float64], parts: Parts) -> NDArray[np.float64]:
    """The known voltages that resistors join to others.

    Where there is none, nothing flows: of the chip of a space that is an error, any other circuit is at rest.
    """
    ends = np.where(parts.of_node < 0, volts, np.nan)[netlist.resistor_nodes]
    ends = ends[np.abs(ends[:, 0] - ends[:, 1]) > 0]
    if not ends.size and netlist.cell_map is not None:
        raise CircuitError(
            "nothing is driven: no part of the circuit touches two rails or is fed a current, so that nothing flows; "
            "add a second rail (an obstacle, an edge that counts as one), open a way to the goal, or feed every free "
            "cell the same current (boundary = 'neumann')"
        )
    if not ends.size and parts.floating.all() and np.count_nonzero(parts.of_node < 0) == 1:
        raise CircuitError("no element touches ground, node 0, so that no voltage is known; tie the circuit to it")
    return np.asarray(ends)
