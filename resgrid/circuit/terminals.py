"""Terminals as a user gives them (nodes, names, cells, regions of joined nodes), converted to node numbers."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.numbers import is_whole
from resgrid.core.cell import Cell
from resgrid.core.netlist import Netlist
from resgrid.core.regions import label_components
from resgrid.errors import InputError, suggestion

Nodes = NDArray[np.int64]

_MOST_NAMES = 5000
"""Maximum number of node names that are compared with an unknown name, to suggest a similar name in the message."""

_NO_VOLTAGE = "is free, but has no path to a goal and no voltage; choose a cell with a path to a goal"
_OPEN_OBSTACLE = "is an open obstacle, without a node; choose a free cell or a goal cell"
_LEFT_OUT = (
    "is free, but has no path to a goal, and a circuit with a drive leaves such cells out; compile the space with "
    "drive = 'none', which gives every free cell a node"
)
"""Reasons why a cell has no node, with remedies; the message starts with the cell."""


@dataclass(frozen=True, eq=False)
class TerminalReader:
    """Conversion of a terminal, as a user gives it, to node numbers.

    `netlist`: the circuit; `cells`: whether terminals are cells of the compiled space instead of nodes; `voltages`:
    whether terminals are places of an operating point, where a mask ignores free cells without a node, instead of ends
    of a resistance, where such a cell is an error.
    """

    netlist: Netlist
    cells: bool = False
    voltages: bool = False

    @cached_property
    def _number_of(self) -> dict[str, int]:
        """Number of every node by its name."""
        names = self.netlist.names_of(np.arange(self.netlist.node_count))
        return {name: node for node, name in enumerate(names)}

    def nodes(self, terminal: Any) -> Nodes:
        """Return the sorted node numbers of a terminal; raise InputError if it has none, or a node does not exist.

        `terminal`: a node number, a node name, a list of both, or a mask of nodes; with `self.cells` a cell (a tuple of
        indices), a list of cells, or a mask of cells.
        """
        found = self._in_cells(terminal) if self.cells else self._in_nodes(terminal)
        nodes = np.unique(np.asarray(found, dtype=np.int64))
        if not nodes.size:
            raise InputError(f"the terminal {terminal!r} has no nodes; name at least one node or cell")
        return nodes

    def _in_nodes(self, terminal: Any) -> Iterable[int]:
        """Return the node numbers of a node, a name, a mask of nodes, or a list of nodes and names."""
        if isinstance(terminal, np.ndarray) and terminal.dtype == np.bool_:
            if terminal.shape != (self.netlist.node_count,):
                raise InputError(
                    f"a mask of nodes has shape {terminal.shape}; give one entry per node: ({self.netlist.node_count},)"
                )
            return np.flatnonzero(terminal)
        if isinstance(terminal, str) or is_whole(terminal):
            return [self._node(terminal)]
        if not isinstance(terminal, Sequence | set | frozenset | np.ndarray):
            raise InputError(f"the terminal {terminal!r} is not a node number, a node name, or a list of both")
        return [self._node(each) for each in terminal]

    def _node(self, node: Any) -> int:
        """Return the number of a node that is given by its number or its name."""
        if isinstance(node, str):
            if node not in self._number_of:
                raise InputError(f"the circuit has no node {node!r}; {self._hint(node)}")
            return self._number_of[node]
        if not is_whole(node) or not 0 <= node < self.netlist.node_count:
            raise InputError(
                f"the circuit has no node {node!r}; its nodes are 0 to {self.netlist.node_count - 1:,}, or names"
            )
        return int(node)

    def _hint(self, name: str) -> str:
        """Return advice for the name of a node that does not exist, for a message."""
        found = self.netlist.space_map
        if found is not None and name == "obstacle" and found.wiring.is_open and found.obstacle_node < 0:
            return "obstacles are open; choose boundary = 'dirichlet' or 'wall', or name another node"
        kind, _, region = name.partition("_")
        is_rail = name == "obstacle" or (kind == "goal" and region.isdecimal())
        if found is not None and found.wiring.rails == "cells" and is_rail:
            space = found.space
            in_rail = space.cell == Cell.OBSTACLE if name == "obstacle" else space.goal_region == int(region)
            nodes: list[int] = found.node[in_rail & (found.node >= 0)].tolist()
            if nodes:
                return f"each of its cells is a node of its own here, such as {self.netlist.node_name(nodes[0])}"
        names = list(islice(self._number_of, _MOST_NAMES))
        return suggestion(name, names) or f"some of its nodes are {', '.join(names[:4])}"

    def _in_cells(self, terminal: Any) -> Iterable[int]:
        """Return the node numbers of a cell (a tuple of indices), a mask of cells, or a list of cells."""
        node, shape = self.netlist.cells.node, self.netlist.cells.space.shape
        if isinstance(terminal, np.ndarray) and terminal.dtype == np.bool_:
            if terminal.shape != shape:
                raise InputError(f"a mask of cells has shape {terminal.shape}; the space has shape {shape}")
            free = terminal & (self.netlist.cells.space.cell == Cell.FREE)
            if not self.voltages:
                for cell in np.argwhere(free & (node < 0))[:1]:
                    self._node_of_cell(tuple(cell.tolist()))  # raises
            inside = node[terminal]
            return inside[inside >= 0]
        cells = [terminal] if isinstance(terminal, tuple) and all(map(is_whole, terminal)) else terminal
        if not isinstance(cells, Sequence | np.ndarray) or isinstance(cells, str):
            raise InputError(f"the terminal {terminal!r} is not a cell, such as (3, 5), a list of cells or a mask")
        return [self._node_of_cell(tuple(cell) if np.iterable(cell) else (cell,)) for cell in cells]

    def _node_of_cell(self, cell: tuple[Any, ...]) -> int:
        """Return the node of a cell; raise InputError for a cell outside the space or without a node."""
        node, shape = self.netlist.cells.node, self.netlist.cells.space.shape
        inside = len(cell) == len(shape) and all(
            is_whole(index) and 0 <= index < count for index, count in zip(cell, shape, strict=True)
        )
        if not inside:
            last = tuple(count - 1 for count in shape)
            raise InputError(f"the space has no cell {cell!r}; its cells are {(0,) * len(shape)} to {last}")
        if node[cell] < 0:
            is_free = self.netlist.cells.space.cell[cell] == Cell.FREE
            left_out = _NO_VOLTAGE if self.voltages else _LEFT_OUT
            raise InputError(f"cell {cell!r} {left_out if is_free else _OPEN_OBSTACLE}")
        return int(node[cell])


def pairs_of(
    read: TerminalReader, pairs: Collection[Any] | None, terminals: Collection[Any] | None
) -> tuple[tuple[Nodes, ...], NDArray[np.int64]]:
    """Return the node numbers of the different terminals, and the pairs (p, 2) as indices into these terminals.

    `read`: converts terminals to nodes; `pairs`: pairs of terminals; `terminals`: terminals, of which all pairs are
    formed. Exactly one of both must be given, and the other is None.
    """
    if (pairs is None) == (terminals is None):
        raise InputError("give either pairs, such as [(0, 5)], or terminals, such as [0, 5, 7]")
    if terminals is not None:
        if len(terminals) < 2:
            count = f"{len(terminals)} entry" if len(terminals) else "no entries"
            raise InputError(f"terminals has {count}; give at least two, such as [0, 5]")
        ends = tuple(read.nodes(terminal) for terminal in terminals)
        first, second = np.triu_indices(len(ends), 1)
        return ends, np.stack([first, second], axis=1).astype(np.int64)
    number_of: dict[bytes, int] = {}
    found: list[Nodes] = []
    rows = []
    for place, pair in enumerate(() if pairs is None else pairs):
        if isinstance(pair, str) or not isinstance(pair, Sequence | np.ndarray) or len(pair) != 2:
            raise InputError(f"pairs[{place}] = {pair!r} is not a pair of terminals; write [(first, second), ...]")
        row = []
        for nodes in map(read.nodes, pair):
            number = number_of.setdefault(nodes.tobytes(), len(found))
            if number == len(found):
                found.append(nodes)
            row.append(number)
        rows.append(row)
    return tuple(found), np.array(rows, dtype=np.int64).reshape(-1, 2)


def joined_nodes(netlist: Netlist, regions: Iterable[Nodes] = ()) -> Nodes:
    """Return the number of the group of joined nodes of every node, (nodes,).

    Ideal wires and voltage sources join nodes to groups; a voltage source counts as a wire, since independent sources
    are set to zero. `regions`: node numbers of every region that an ideal wire joins.
    """
    wires = [np.stack([region[:-1], region[1:]], axis=1) for region in regions]
    edges = np.concatenate([netlist.source_nodes.astype(np.int64), *wires])
    if not len(edges):
        return np.arange(netlist.node_count)
    return label_components(edges, netlist.node_count)


def require_linear(netlist: Netlist) -> None:
    """Raise InputError if a netlist has nonlinear resistors."""
    if netlist.nonlinear_nodes.size:
        raise InputError(
            "a circuit with nonlinear resistors has no effective resistance; use rg.circuit.linearize(op), its "
            "linearization around an operating point"
        )
