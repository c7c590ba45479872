"""The map from nodes and resistors of a compiled netlist to the cells and faces of its configuration space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen
from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring


@frozen
@dataclass(frozen=True, eq=False)
class CellMap:
    """Map between the nodes and resistors of a compiled netlist and the cells and faces of the compiled space.

    Attributes
    ----------
    space : ConfigurationSpace
        The space that was compiled.
    wiring : Wiring
        Boundary conditions, drive and element values, with an edge rule for every axis.
    node : ndarray of int32, shape of the space
        Node of every cell, -1 for a cell without a node.  If rails are merged, a rail cell has the node of its rail.
    resistor_face : ndarray of int32 or int64, shape (resistors,)
        Cell face that each resistor crosses; -1 for a switch, a rail segment or the load of the read-out, ``-2 - cell``
        for a leak, with the flat index of its cell.  Faces are numbered axis by axis.  Along an axis there are
        ``cells + 1`` faces, in C order of an array of shape `resgrid.core.regions.face_shape`.  Face ``i`` is the lower
        face of cell ``i``.  On a periodic axis the last face equals the first one and is not used.
    resistor_upward : ndarray of bool, shape (resistors,)
        Whether the first node of each resistor is on the lower side of the face that the resistor crosses; without
        meaning for a resistor that crosses no face.
    free_node : ndarray of int32, shape (free nodes,)
        Nodes of the free cells, in C order of the cells, without cells that have no node.
    obstacle_node : int
        Node of the obstacle rail, -1 without one.
    goal_nodes : tuple of int
        Node of the rail of every goal region; empty if every rail cell has a node of its own.
    nonlinear_face : ndarray of int64, shape (nonlinear resistors,)
        Cell face that each nonlinear resistor crosses, numbered like the faces of `resistor_face`; -1 for none.
    nonlinear_upward : ndarray of bool, shape (nonlinear resistors,)
        Whether the first node of each nonlinear resistor is on the lower side of the face that the resistor crosses.
    rail_nodes : mapping of str to ndarray of int32, shape of the space
        Nodes of rails that are resistive meshes with one node per cell, by name of the rail (``"obstacle"`` or
        ``"goal_0"``); -1 where the rail node is the node of the cell itself.  Empty for ideal rails.
    leak_cell : ndarray of int32 or int64, shape (resistors,)
        Flat index (C order) of the cell whose leak each resistor is, -1 for other resistors.  In a compiled netlist the
        leaks are the last resistors, in the order of `free_node`.
    """

    space: ConfigurationSpace
    wiring: Wiring
    node: NDArray[np.int32]
    resistor_face: NDArray[np.integer[Any]]
    resistor_upward: NDArray[np.bool_]
    free_node: NDArray[np.int32]
    obstacle_node: int
    goal_nodes: tuple[int, ...]
    nonlinear_face: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    nonlinear_upward: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, dtype=np.bool_))
    rail_nodes: Mapping[str, NDArray[np.int32]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("node", "free_node"):
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), dtype=np.int32))

    @property
    def leak_cell(self) -> NDArray[np.integer[Any]]:
        """Flat index (C order) of the cell whose leak to the obstacle rail each resistor is; -1 for other resistors."""
        return np.asarray(np.maximum(-2 - self.resistor_face, -1), dtype=self.resistor_face.dtype)

    def cell_of_node(self, node_count: int) -> NDArray[np.int64]:
        """Return the flat index of the cell of every node, -1 for rails, ground and nodes without a cell.

        The shape is (node_count,); `node_count`: number of nodes of the netlist.
        """
        node = self.node.ravel()
        own = node >= 0
        if self.wiring.rails == "merged":
            own &= self.space.cell.ravel() == Cell.FREE
        cell = np.flatnonzero(own)
        cell_of = np.full(node_count, -1, dtype=np.int64)
        cell_of[node[cell]] = cell
        return cell_of

    def names(self, nodes: NDArray[np.int64]) -> list[str]:
        """Return the names of nodes (n,), such as ``n_12_7`` for a node of the cell (12, 7).

        Other names: ``0`` (ground), ``obstacle`` and ``goal_0`` (rails), ``goal_0_3_4`` (a rail's node at a cell), and
        ``node_5`` for all other nodes, by number.
        """
        cell = self.cell_of_node(int(max(nodes.max(initial=0), self.node.max(initial=0))) + 1)[nodes]
        coordinates = np.unravel_index(np.maximum(cell, 0), self.space.shape)
        template = "n" + "_%d" * self.space.ndim
        names = [template % index for index in zip(*(c.tolist() for c in coordinates), strict=True)]
        goals = {node: f"goal_{region}" for region, node in enumerate(self.goal_nodes)}
        rails = {0: "0", self.obstacle_node: "obstacle"} | goals
        unnamed = np.flatnonzero(cell < 0).tolist()
        for rail, mesh in self.rail_nodes.items() if unnamed else ():
            places = np.argwhere(mesh >= 0).tolist()
            rails |= {int(mesh[tuple(place)]): "_".join(map(str, (rail, *place))) for place in places}
        for position, node in zip(unnamed, nodes[unnamed].tolist(), strict=True):
            names[position] = rails.get(node, f"node_{node}")
        return names
