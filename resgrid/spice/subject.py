"""What the electrical rules look at: a netlist or a deck as it was written, told apart only by where things lie."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.netlist import Netlist
from resgrid.spice.parsed import ParsedDeck

CONDUCTING = ("resistor", "voltage source", "nonlinear resistor")
"""Kinds that carry current at direct current whatever drives them."""

SHOWN = 5
LISTED = 1000


@dataclass(frozen=True, eq=False)
class Subject:
    """A circuit under examination.

    `node_count`: ground included; `ends` (elements, 2): nodes of every element, per kind; `resistance` (resistors,):
    in ohms, as written in a deck: zero and negative values included; `volts, amps`: of the voltage and the current
    sources; `deck`: where it comes from; one of the two.
    """

    node_count: int
    ends: Mapping[str, NDArray[np.int32]]
    resistance: NDArray[np.float64]
    volts: NDArray[np.float64]
    amps: NDArray[np.float64]
    netlist: Netlist | None = None
    deck: ParsedDeck | None = None

    @cached_property
    def part(self) -> NDArray[np.int64]:
        """Number of the part each node belongs to, shape (node_count,); see `connected_parts`."""
        return connected_parts_of(np.concatenate([self.ends[kind] for kind in CONDUCTING]), self.node_count)

    @cached_property
    def degree(self) -> NDArray[np.int64]:
        """Number of element ends at every node, shape (node_count,)."""
        return np.asarray(sum(np.bincount(ends.ravel(), minlength=self.node_count) for ends in self.ends.values()))

    @cached_property
    def is_inductor(self) -> NDArray[np.bool_]:
        """Which voltage sources of a deck stand for inductors, shape (voltage sources,)."""
        if self.deck is None or not (self.volts == 0).any():
            return np.zeros(len(self.volts), dtype=np.bool_)
        names = self.deck.element_names["voltage source"]
        return np.array([name.rpartition(".")[2][:1] in ("l", "L") for name in names], dtype=np.bool_)

    def names_of(self, nodes: NDArray[np.integer[Any]]) -> list[str]:
        """Names of nodes."""
        if self.deck is not None:
            return [self.deck.node_names[node] for node in nodes.tolist()]
        assert self.netlist is not None
        return self.netlist.names_of(nodes)

    def listed(self, nodes: NDArray[np.integer[Any]]) -> tuple[str, ...]:
        """The first thousand of some nodes' names."""
        return tuple(self.names_of(nodes[:LISTED]))

    def told(self, nodes: NDArray[np.integer[Any]]) -> str:
        """A few of some nodes' names, and how many more there are."""
        shown = ", ".join(self.names_of(nodes[:SHOWN]))
        return shown if nodes.size <= SHOWN else f"{shown} and {nodes.size - SHOWN:,} more"

    def element_name(self, kind: str, number: int) -> str:
        """Name of an element: the deck's, or its kind and number."""
        names = self.deck.element_names if self.deck is not None else self._netlist_names
        return names[kind][number] if kind in names else f"{kind} {number}"

    @property
    def _netlist_names(self) -> Mapping[str, tuple[str, ...]]:
        assert self.netlist is not None
        return self.netlist.element_names or {}

    def place_of_element(self, kind: str, number: int) -> str:
        """Deck line of an element, or the cells or nodes it joins."""
        if self.deck is not None:
            return self.deck.place_of(kind, number)
        return self.place_of_nodes(np.unique(self.ends[kind][number]))

    def place_of_nodes(self, nodes: NDArray[np.integer[Any]]) -> str:
        """Deck line of the first element at some nodes, or their cells, or their names."""
        if self.deck is not None:
            return self._line_of_nodes(nodes)
        assert self.netlist is not None
        if self.netlist.cell_map is None:
            return self.told(nodes)
        cell = self.netlist.cell_of_node()[nodes]
        if (cell < 0).all():
            return self.told(nodes)
        cells = np.transpose(np.unravel_index(cell[cell >= 0], self.netlist.cells.space.shape))
        shown = ", ".join("(" + ", ".join(map(str, place)) + ")" for place in cells[:SHOWN].tolist())
        more = f" and {len(cells) - SHOWN:,} more" if len(cells) > SHOWN else ""
        return f"cell{'s' if len(cells) > 1 else ''} {shown}{more}"

    def _line_of_nodes(self, nodes: NDArray[np.integer[Any]]) -> str:
        assert self.deck is not None
        wanted = np.zeros(self.node_count, dtype=np.bool_)
        wanted[nodes] = True
        firsts = []
        for kind, place in self.deck.place.items():
            touching = np.flatnonzero(wanted[self.ends[kind]].any(axis=1))
            if touching.size:
                files, lines = place[touching].T
                first = int(touching[np.lexsort((lines, files))[0]])
                firsts.append((*place[first].tolist(), kind, first))
        return self.deck.place_of(*min(firsts)[2:]) if firsts else self.deck.path


def subject_of(circuit: Netlist | ParsedDeck) -> Subject:
    """Bring a netlist or a deck into the form that the rules look at."""
    ends = {
        "resistor": circuit.resistor_nodes,
        "voltage source": circuit.source_nodes,
        "current source": circuit.current_nodes,
        "capacitor": circuit.capacitor_nodes,
        "nonlinear resistor": circuit.nonlinear_nodes,
    }
    volts, amps = circuit.source_volts, circuit.current_amps
    if isinstance(circuit, ParsedDeck):
        return Subject(len(circuit.node_names), ends, circuit.resistance, volts, amps, deck=circuit)
    with np.errstate(over="ignore"):
        resistance = 1 / circuit.conductance
    return Subject(circuit.node_count, ends, resistance, volts, amps, netlist=circuit)


def connected_parts_of(joined: NDArray[np.int32], node_count: int) -> NDArray[np.int64]:
    """Number of the part each node belongs to.  Shapes: `joined` (n, 2); returns (node_count,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    first, second = joined.T
    pairs = coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(node_count, node_count))
    return np.asarray(connected_components(pairs, directed=False)[1], dtype=np.int64)
