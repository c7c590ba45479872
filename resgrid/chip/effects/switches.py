"""Effects that replace ideal connections by real switches, rails, capacitors and loads.

They need netlists compiled with ``rails="cells"``: every cell has a node, and every obstacle and goal cell is connected
to its rail.  Where obstacles are open (``boundary="neumann"``), the switch of an obstacle cell is open; where obstacles
are held at the obstacle rail, it is closed.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from resgrid.chip.effects.base import Effect, add_nodes, cells_with_nodes, rail_pin, to_node
from resgrid.core.cell import Cell
from resgrid.core.cell_map import CellMap
from resgrid.core.compiler import compile_space
from resgrid.core.netlist import GROUND, Netlist, add_elements, select_elements
from resgrid.core.wiring import EdgeRule
from resgrid.errors import InputError
from resgrid.scene.chip import Ohms, OhmsOrZero
from resgrid.scene.quantities import Quantity


def _on_rail(cells: CellMap, rail: str) -> NDArray[np.bool_]:
    """Return the mask of the cells that closed switches connect to a rail, shape of the space.

    For the goal rail these are the goal cells.  For the obstacle rail they are the obstacle cells or, where obstacles
    are open (``boundary="neumann"``), the start cell if it is driven, else no cells.  `rail`: ``"goal"`` or
    ``"obstacle"``.
    """
    if rail == "goal":
        return np.asarray(cells.space.cell == Cell.GOAL)
    if cells.wiring.boundary != "neumann":
        return np.asarray(cells.space.cell == Cell.OBSTACLE)
    mask = np.zeros(cells.space.shape, dtype=np.bool_)
    if cells.wiring.start is not None:
        mask[cells.wiring.start] = True
    return mask


@dataclass(frozen=True)
class InternodalSwitches(Effect):
    """Put a switch in series with every resistor between cells; switches at open obstacles are open, all others closed.

    `on`: resistance of a closed switch in ohms, None for a wire; `off`: resistance of an open switch in ohms, None for
    no connection.  Open obstacles are those of ``boundary="neumann"``; with other boundaries `off` has no effect.

    With open obstacles and a value of `off`, obstacle cells and free cells without a node get nodes.  The
    resistors to these new nodes, leaks included, keep their nominal values, without mismatch.  These resistors are
    assigned to no cell face, so that a field does not include the leakage current through them.
    """

    KEYS = {"on": "internodal_switch_on", "off": "internodal_switch_off"}

    on: OhmsOrZero | None = None
    off: Ohms | None = None

    def apply(self, netlist: Netlist) -> Netlist:
        cells = cells_with_nodes(netlist, "internodal switches")
        if netlist.nonlinear_nodes.size:
            raise InputError("internodal switches must come before saturation in a list of effects")
        if self.off is not None and cells.wiring.boundary == "neumann":
            netlist = _with_open_nodes(netlist, self.on or 0.0, self.off)
        elif self.on is not None:
            netlist = _in_series(netlist, _between_cells(netlist, cells), self.on)
        return netlist


def _in_series(netlist: Netlist, which: NDArray[np.bool_], ohms: float) -> Netlist:
    """Return the netlist with a resistance in series with the selected resistors.

    The temperature coefficients of a resistor are multiplied by its fraction of the summed resistance.  `which`
    (resistors,): mask of the selected resistors; `ohms`: added resistance, in ohms.
    """
    whole = np.where(which, 1 / (1 / netlist.conductance + ohms), netlist.conductance)
    share = whole / netlist.conductance
    return netlist.replace(
        conductance=whole,
        tc1=None if netlist.tc1 is None else netlist.tc1 * share,
        tc2=None if netlist.tc2 is None else netlist.tc2 * share,
    )


def _between_cells(netlist: Netlist, cells: CellMap) -> NDArray[np.bool_]:
    """Return the mask of the grid resistors that connect two cells, shape (resistors,).

    Resistors to the obstacle rail beyond the edge of the grid are not in the mask.  `cells`: map of the cells of
    `netlist`.
    """
    to_edge = (netlist.resistor_nodes == cells.obstacle_node).any(axis=1) & (cells.obstacle_node >= 0)
    return np.asarray((cells.resistor_face >= 0) & ~to_edge)


def _with_open_nodes(netlist: Netlist, on: float, off: float) -> Netlist:
    """Return the netlist with new nodes for obstacles and other cells without a node, for open obstacles.

    A resistor in series with an open switch connects a new node to the node of each face neighbour.  The existing
    resistors of the grid get closed switches in series.  `on, off`: resistances of closed and open switches, in ohms.
    """
    cells = netlist.cells
    netlist = _in_series(netlist, cells.resistor_face >= 0, on)
    missing = cells.node < 0
    netlist, nodes = add_nodes(netlist, int(missing.sum()))
    node = cells.node.copy()
    node[missing] = nodes
    edge: list[EdgeRule] = ["open" if rule == "obstacle" else rule for rule in cells.wiring.edges(cells.space)]
    full = compile_space(cells.space, edge=edge, rails="cells", resistance=cells.wiring.resistance, drive="none")
    ends = full.cell_of_node()[full.resistor_nodes]
    new = ~np.isin(full.cells.resistor_face, cells.resistor_face)
    netlist = netlist.replace(cell_map=dataclasses.replace(netlist.cells, node=node))
    if cells.wiring.leak:
        leaking = to_node(node[missing & (cells.space.cell == Cell.FREE)], cells.obstacle_node)
        netlist = add_elements(netlist, "resistor", leaking, cells.wiring.leak_conductance(cells.space.spacing))
    return add_elements(netlist, "resistor", node.ravel()[ends[new]], 1 / (1 / full.conductance[new] + off))


@dataclass(frozen=True)
class RailSwitches(Effect):
    """Connect cells to the rails by switches: closed between a cell and the rail of its kind, open for all other cells.

    The goal rail belongs to goal cells, the obstacle rail to obstacle cells.  With open obstacles
    (``boundary="neumann"``), all switches to the obstacle rail are open, except that of a driven start cell.  With a
    uniform drive, the obstacle rail is at the goal voltage.

    `obstacle_on, goal_on`: resistance of closed switches in ohms, None for a wire; `obstacle_off, goal_off`: resistance
    of open switches in ohms, None for no connection.
    """

    KEYS = {f"{rail}_{state}": f"{rail}_switch_{state}" for rail in ("obstacle", "goal") for state in ("on", "off")}

    obstacle_on: Ohms | None = None
    obstacle_off: Ohms | None = None
    goal_on: Ohms | None = None
    goal_off: Ohms | None = None

    def apply(self, netlist: Netlist) -> Netlist:
        cells = cells_with_nodes(netlist, "switches to the rails")
        for rail, on, off in (
            ("obstacle", self.obstacle_on, self.obstacle_off),
            ("goal", self.goal_on, self.goal_off),
        ):
            tied = _on_rail(cells, rail)
            if (on is None or not tied.any()) and off is None:
                continue
            netlist, pin = rail_pin(netlist, rail)
            if on is not None:
                netlist = _tie(netlist, cells.node[tied & (cells.node >= 0)], pin, on)
            if off is not None:
                nodes = cells.node[~tied & (cells.node >= 0)]
                netlist = add_elements(netlist, "resistor", to_node(nodes, pin), 1 / off)
        return netlist


def _tie(netlist: Netlist, nodes: NDArray[np.int32], pin: int, resistance: float) -> Netlist:
    """Return the netlist with resistors, in place of voltage sources, from nodes to the supply pin of a rail.

    `nodes` (k,): node numbers; `pin`: node number of the supply pin; `resistance`: resistance of each resistor, in
    ohms.
    """
    freed = select_elements(netlist, "voltage source", ~np.isin(netlist.source_nodes[:, 0], nodes))
    return add_elements(freed, "resistor", to_node(nodes, pin), 1 / resistance)


@dataclass(frozen=True)
class RailResistance(Effect):
    """Model each rail as a resistive mesh over the die, fed along its border, so that the supply voltage droops inside.

    A rail has one node per cell, segments between the rail nodes of face neighbours (none across periodic seams: the
    die is flat), and one segment from each border cell to the supply pin.  A switch or a leak connects its cell to the
    rail node of the cell. The node of a cell that is held by an ideal voltage source becomes the rail node itself.

    `ohms`: resistance of a segment; 0 for an ideal rail.
    """

    KEYS = {"ohms": "rail_resistance"}

    ohms: OhmsOrZero

    def apply(self, netlist: Netlist) -> Netlist:
        cells = cells_with_nodes(netlist, "rails")
        if self.ohms == 0:
            return netlist
        for rail in ("obstacle", "goal"):
            if _on_rail(cells, rail).any() or (rail == "obstacle" and cells.wiring.leak):
                netlist = _droop(netlist, rail, self.ohms)
        return netlist


def _droop(netlist: Netlist, rail: str, ohms: float) -> Netlist:
    """Return the netlist with a mesh of resistors (segments) in place of a rail.

    Switches and leaks to the rail then lead to nodes of the mesh.  `rail`: ``"goal"`` or ``"obstacle"``; `ohms`:
    resistance of a segment.
    """
    netlist, pin = rail_pin(netlist, rail)
    cells = netlist.cells
    own = cells.node >= 0
    tied = cells.node[own & _on_rail(cells, rail)]
    wired = np.isin(netlist.source_nodes[:, 0], tied) & (netlist.source_nodes[:, 1] == GROUND)
    on_rail = np.isin(cells.node, netlist.source_nodes[wired, 0])
    netlist, numbers = add_nodes(netlist, int((~on_rail).sum()))
    mesh = cells.node.copy()
    mesh[~on_rail] = numbers
    own_nodes = np.where(on_rail, np.int32(-1), mesh)
    rail_nodes = {**cells.rail_nodes, "obstacle" if rail == "obstacle" else "goal_0": own_nodes}
    netlist = netlist.replace(cell_map=dataclasses.replace(cells, rail_nodes=rail_nodes))
    local = np.full(netlist.node_count, -1, dtype=np.int64)
    local[cells.node[own]] = mesh[own]
    linear, nonlinear = netlist.resistor_nodes.copy(), netlist.nonlinear_nodes.copy()
    for ends, face in ((linear, cells.resistor_face), (nonlinear, cells.nonlinear_face)):
        switch = (face < 0) & (ends[:, 1] == pin) & (local[ends[:, 0]] >= 0)
        ends[switch, 1] = local[ends[switch, 0]]
    netlist = netlist.replace(resistor_nodes=linear, nonlinear_nodes=nonlinear)
    netlist = select_elements(netlist, "voltage source", ~wired)
    return add_elements(netlist, "resistor", _mesh_segments(mesh, pin), 1 / ohms)


def _mesh_segments(mesh: NDArray[np.int32], pin: int) -> NDArray[np.int32]:
    """Return the pairs of nodes that the segments of a rail mesh connect, shape (segments, 2).

    Segments connect the rail nodes of neighbouring cells, and both ends of every line of cells to the supply pin.
    `mesh` (shape of the space): rail node of every cell; `pin`: node number of the supply pin.
    """
    parts = []
    for axis in range(mesh.ndim):
        lines = np.moveaxis(mesh, axis, 0)
        parts.append(np.stack([lines[:-1].ravel(), lines[1:].ravel()], axis=1))
        parts += [to_node(lines[end].ravel(), pin) for end in (0, -1)]
    return np.concatenate(parts)


@dataclass(frozen=True)
class Capacitance(Effect):
    """Give the node of every cell a capacitor to ground.

    `farads`: capacitance, in farads.
    """

    KEYS = {"farads": "capacitance"}

    farads: Annotated[float, Ge(0), Quantity("F")]

    def apply(self, netlist: Netlist) -> Netlist:
        cells = cells_with_nodes(netlist, "capacitors")
        return add_elements(netlist, "capacitor", to_node(cells.node[cells.node >= 0], GROUND), self.farads)


@dataclass(frozen=True)
class ReadoutLoad(Effect):
    """Load the node of every cell with the input resistance of the read-out, to ground.

    `ohms`: input resistance, in ohms.
    """

    KEYS = {"ohms": "readout.input_resistance"}

    ohms: Ohms

    def apply(self, netlist: Netlist) -> Netlist:
        cells = cells_with_nodes(netlist, "loads of the read-out")
        return add_elements(netlist, "resistor", to_node(cells.node[cells.node >= 0], GROUND), 1 / self.ohms)
