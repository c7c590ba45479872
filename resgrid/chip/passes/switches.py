"""Passes that put real switches, rails, capacitors and loads in the place of ideal ones.

They work on netlists compiled with ``rails="cells"``: every cell has a node, and every obstacle and goal cell a tie to
its rail.  An open node is an off switch, a rail is an on switch.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid import die
from resgrid.arguments import check_number, check_optional
from resgrid.chip.passes import editing
from resgrid.errors import InputError
from resgrid.netlist import GROUND, CellMap, Netlist
from resgrid.space import Cell


def _on_rail(cell_map: CellMap, rail: str) -> NDArray[np.bool_]:
    """Which cells are switched to a rail: obstacles, or a driven start where these are open, and goals."""
    if rail == "goal":
        return np.asarray(cell_map.space.cell == Cell.GOAL)
    if cell_map.wiring.boundary != "neumann":
        return np.asarray(cell_map.space.cell == Cell.OBSTACLE)
    mask = np.zeros(cell_map.space.shape, dtype=np.bool_)
    if cell_map.wiring.start is not None:
        mask[cell_map.wiring.start] = True
    return mask


@dataclass(frozen=True)
class InternodalSwitches:
    """Put a switch in series with every resistor between cells: closed, and open at obstacles that are open nodes.

    `on`: resistance of a closed one, in ohms; None is a wire; `off`: of an open one, in ohms; None is no connection.
    Where obstacles are open, it gives these, and cells that no goal serves, nodes of their own; the resistors before
    them keep their nominal values, and the leakage through them crosses no face of the field.
    """

    on: float | None = None
    off: float | None = None

    def __post_init__(self) -> None:
        check_optional("on", self.on, "at least 0 and finite, in ohms", least=0.0)
        check_optional("off", self.off, "positive and finite, in ohms", above=0.0)

    def apply(self, netlist: Netlist) -> Netlist:
        """The same netlist with these switches."""
        cell_map = editing.tiled_layout(netlist, "internodal switches")
        if netlist.nonlinear_nodes.size:
            raise InputError("internodal switches come before saturation in a list of passes")
        if self.off is not None and cell_map.wiring.boundary == "neumann":
            netlist = _with_open_nodes(netlist, self.on or 0.0, self.off)
        elif self.on is not None:
            netlist = _in_series(netlist, _between_cells(netlist, cell_map), self.on)
        return netlist


def _in_series(netlist: Netlist, which: NDArray[np.bool_], ohms: float) -> Netlist:
    """Switches in series with some resistors, whose temperature coefficients fall to their share of the sum."""
    whole = np.where(which, 1 / (1 / netlist.conductance + ohms), netlist.conductance)
    share = whole / netlist.conductance
    return netlist.replace(
        conductance=whole,
        tc1=None if netlist.tc1 is None else netlist.tc1 * share,
        tc2=None if netlist.tc2 is None else netlist.tc2 * share,
    )


def _between_cells(netlist: Netlist, cell_map: CellMap) -> NDArray[np.bool_]:
    """Grid resistors that do not lead to the rail beyond the edge."""
    to_edge = (netlist.resistor_nodes == cell_map.obstacle_node).any(axis=1) & (cell_map.obstacle_node >= 0)
    return np.asarray(die.on_grid(netlist) & ~to_edge)


def _with_open_nodes(netlist: Netlist, on: float, off: float) -> Netlist:
    """Nodes for cells without one, obstacles and what no goal serves, and the links that end there: all open."""
    from resgrid.compiler import compile_space

    cell_map = netlist.cells
    netlist = _in_series(netlist, die.on_grid(netlist), on)
    missing = cell_map.node < 0
    netlist, nodes = editing.add_nodes(netlist, int(missing.sum()))
    node = cell_map.node.copy()
    node[missing] = nodes
    edge = ["open" if rule == "obstacle" else rule for rule in cell_map.wiring.edge]
    full = compile_space(cell_map.space, edge=edge, rails="cells", resistance=cell_map.wiring.resistance)
    cells = full.cell_of_node()[full.resistor_nodes]
    new = ~np.isin(full.cells.resistor_face, cell_map.resistor_face)
    netlist = netlist.replace(cell_map=dataclasses.replace(netlist.cells, node=node))
    return editing.add_resistors(netlist, node.ravel()[cells[new]], 1 / (1 / full.conductance[new] + off))


@dataclass(frozen=True)
class RailSwitches:
    """Tie cells to the rails by switches: closed for cells of that kind, open for all others.

    Where obstacles are open (``boundary="neumann"``) all switches to the obstacle rail are, but for a driven start's;
    with a uniform drive that rail lies at the goal's voltage.

    `obstacle_on, goal_on`: resistance of closed ones, in ohms; None is a wire; `obstacle_off, goal_off`: of open
    ones, in ohms; None is no connection.
    """

    obstacle_on: float | None = None
    obstacle_off: float | None = None
    goal_on: float | None = None
    goal_off: float | None = None

    def __post_init__(self) -> None:
        for name in ("obstacle_on", "obstacle_off", "goal_on", "goal_off"):
            check_optional(name, getattr(self, name), "positive and finite, in ohms", above=0.0)

    def apply(self, netlist: Netlist) -> Netlist:
        """The same netlist with these switches."""
        cell_map = editing.tiled_layout(netlist, "switches to the rails")
        for rail, on, off in (
            ("obstacle", self.obstacle_on, self.obstacle_off),
            ("goal", self.goal_on, self.goal_off),
        ):
            tied = _on_rail(cell_map, rail)
            if (on is None or not tied.any()) and off is None:
                continue
            netlist, pin = editing.supply_node(netlist, rail)
            if on is not None:
                netlist = _tie(netlist, cell_map.node[tied & (cell_map.node >= 0)], pin, on)
            if off is not None:
                nodes = cell_map.node[~tied & (cell_map.node >= 0)]
                netlist = editing.add_resistors(netlist, _to(nodes, pin), np.full(len(nodes), 1 / off))
        return netlist


def _to(nodes: NDArray[np.int32], pin: int) -> NDArray[np.int32]:
    return np.stack([nodes, np.full(len(nodes), pin)], axis=1)


def _tie(netlist: Netlist, nodes: NDArray[np.int32], pin: int, resistance: float) -> Netlist:
    """Replace the sources of nodes by resistors to a pin."""
    kept = ~np.isin(netlist.source_nodes[:, 0], nodes)
    freed = netlist.replace(
        source_nodes=netlist.source_nodes[kept], source_volts=netlist.source_volts[kept], element_names=None
    )
    return editing.add_resistors(freed, _to(nodes, pin), np.full(len(nodes), 1 / resistance))


@dataclass(frozen=True)
class RailResistance:
    """Make every rail a mesh over the die, fed all around its border, so that supplies droop.

    A rail has a node at every cell, one segment between those of face neighbours (no periodic ones: the die is flat),
    and one from each border cell to the pin.  A switch ties its cell to the rail's node there; a cell on an ideal
    source is that node itself.

    `ohms`: resistance of a segment; 0 is an ideal rail.
    """

    ohms: float

    def __post_init__(self) -> None:
        check_number("ohms", self.ohms, "at least 0 and finite", least=0.0)

    def apply(self, netlist: Netlist) -> Netlist:
        """The same netlist with these rails."""
        cell_map = editing.tiled_layout(netlist, "rails")
        if self.ohms == 0:
            return netlist
        for rail in ("obstacle", "goal"):
            if _on_rail(cell_map, rail).any():
                netlist = _droop(netlist, rail, self.ohms)
        return netlist


def _droop(netlist: Netlist, rail: str, ohms: float) -> Netlist:
    netlist, pin = editing.supply_node(netlist, rail)
    cell_map = netlist.cells
    own = cell_map.node >= 0
    cells = cell_map.node[own & _on_rail(cell_map, rail)]
    wired = np.isin(netlist.source_nodes[:, 0], cells) & (netlist.source_nodes[:, 1] == GROUND)
    on_rail = np.isin(cell_map.node, netlist.source_nodes[wired, 0])
    netlist, numbers = editing.add_nodes(netlist, int((~on_rail).sum()))
    mesh = cell_map.node.copy()
    mesh[~on_rail] = numbers
    local = np.full(netlist.node_count, -1, dtype=np.int64)
    local[cell_map.node[own]] = mesh[own]
    resistor_nodes = netlist.resistor_nodes.copy()
    switch = ~die.on_grid(netlist) & (resistor_nodes[:, 1] == pin) & (local[resistor_nodes[:, 0]] >= 0)
    resistor_nodes[switch, 1] = local[resistor_nodes[switch, 0]]
    netlist = netlist.replace(
        resistor_nodes=resistor_nodes,
        source_nodes=netlist.source_nodes[~wired],
        source_volts=netlist.source_volts[~wired],
        element_names=None,
    )
    segments = _mesh_segments(mesh, pin)
    return editing.add_resistors(netlist, segments, np.full(len(segments), 1 / ohms))


def _mesh_segments(mesh: NDArray[np.int32], pin: int) -> NDArray[np.int32]:
    """Segments between neighbours, and from both ends of every line of cells to the pin; shape (n, 2)."""
    parts = []
    for axis in range(mesh.ndim):
        lines = np.moveaxis(mesh, axis, 0)
        parts.append(np.stack([lines[:-1].ravel(), lines[1:].ravel()], axis=1))
        parts += [_to(lines[end].ravel(), pin) for end in (0, -1)]
    return np.concatenate(parts)


@dataclass(frozen=True)
class Capacitance:
    """Give every cell's node a capacitor to ground.

    `farads`: its capacitance.
    """

    farads: float

    def __post_init__(self) -> None:
        check_number("farads", self.farads, "at least 0 and finite", least=0.0)

    def apply(self, netlist: Netlist) -> Netlist:
        """The same netlist with these capacitors."""
        cell_map = editing.tiled_layout(netlist, "capacitors")
        nodes = cell_map.node[cell_map.node >= 0]
        return netlist.replace(
            capacitor_nodes=np.concatenate([netlist.capacitor_nodes, _to(nodes, GROUND)]),
            capacitance=np.append(netlist.capacitance, np.full(len(nodes), self.farads)),
            element_names=None,
        )


@dataclass(frozen=True)
class ReadoutLoad:
    """Load every cell's node with the input resistance of the read-out, to ground.

    `ohms`: its input resistance.
    """

    ohms: float

    def __post_init__(self) -> None:
        check_number("ohms", self.ohms, "positive and finite", above=0.0)

    def apply(self, netlist: Netlist) -> Netlist:
        """The same netlist with these loads."""
        cell_map = editing.tiled_layout(netlist, "loads of the read-out")
        nodes = cell_map.node[cell_map.node >= 0]
        return editing.add_resistors(netlist, _to(nodes, GROUND), np.full(len(nodes), 1 / self.ohms))
