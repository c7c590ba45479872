"""`Effect`, the base class of the effects on a chip's netlist, and functions that several effects use.

An effect is a deviation of real devices from the ideal circuit.  Effects append new elements, so that the resistors of
the grid keep their numbers.  New elements cross no cell face: the map of the cells gives them the face number -1.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from resgrid.core.cell_map import CellMap
from resgrid.core.netlist import GROUND, Netlist, add_elements, select_elements
from resgrid.core.random_sites import Seed, seed_of
from resgrid.core.regions import label_components
from resgrid.errors import InputError
from resgrid.scene.chip import Chip
from resgrid.scene.table_models import check_fields


@dataclass(frozen=True)
class Effect:
    """One effect of a chip on its netlist: a pure function, with a seed if the effect is random.

    The fields of a subclass are the parameters of the effect, with the range and the unit of the matching keys of a
    chip description (`Chip`).  `KEYS`: mapping from the name of a field to the name of its key in the chip description.
    """

    KEYS: ClassVar[Mapping[str, str]] = {}

    def __post_init__(self) -> None:
        if hasattr(self, "seed"):
            object.__setattr__(self, "seed", seed_of(self.seed))
        check_fields(self)

    @classmethod
    def of(cls, chip: Chip, seed: Seed) -> Self | None:
        """Return the effect of a chip description; None if all keys in `KEYS` are unset or 0 in the description.

        `chip`: chip description; `seed`: seed of random effects, which this method ignores.
        """
        del seed
        values = {name: attrgetter(key)(chip) for name, key in cls.KEYS.items()}
        given = {name: value for name, value in values.items() if value}
        return cls(**given) if given else None

    def apply(self, netlist: Netlist) -> Netlist:
        """Return a copy of the netlist with this effect."""
        raise NotImplementedError


def checked(effects: Iterable[Effect]) -> Iterator[Effect]:
    """Yield the given effects unchanged; raise InputError for a value that is not an Effect."""
    for effect in effects:
        if not isinstance(effect, Effect):
            raise InputError(f"{effect!r} is not an effect of a chip; see resgrid.chip.effects, such as Mismatch(0.01)")
        yield effect


def cells_with_nodes(netlist: Netlist, what: str) -> CellMap:
    """Return the map of the cells of a netlist; raise InputError unless each cell has a node.

    `what`: plural noun for the feature that needs these nodes; subject of the error message.
    """
    if netlist.cells.wiring.rails != "cells":
        raise InputError(f"{what} need one node per cell; compile with rails = 'cells'")
    return netlist.cells


def add_nodes(netlist: Netlist, count: int) -> tuple[Netlist, NDArray[np.int32]]:
    """Append `count` nodes to a netlist; return the new netlist and the numbers of the new nodes, shape (count,)."""
    first = netlist.node_count
    names = netlist.node_names
    if names is not None:
        names = (*names, *(f"node_{node}" for node in range(first, first + count)))
    return netlist.replace(node_count=first + count, node_names=names), np.arange(first, first + count, dtype=np.int32)


def to_node(nodes: NDArray[np.int32], end: int) -> NDArray[np.int32]:
    """Return the pairs of node numbers (node, `end`) for each of the `nodes` (n,), shape (n, 2), for new elements."""
    return np.stack([nodes, np.full(len(nodes), end, dtype=np.int32)], axis=1)


def rail_pin(netlist: Netlist, rail: str) -> tuple[Netlist, int]:
    """Return the netlist with the supply pin of a rail, and the node number of the pin.

    The pin is the node at which the supply feeds the rail.  If the rail has no pin, a node is added as the pin, with a
    voltage source to ground at the voltage of the rail.  With open obstacles and the drive "uniform" or "none", an
    added pin of the obstacle rail is at the goal voltage.  `netlist`: circuit of a space; `rail`: ``"obstacle"`` or
    ``"goal"``.
    """
    cells = cells_with_nodes(netlist, "rails")
    wiring = cells.wiring
    known = cells.obstacle_node if rail == "obstacle" else cells.goal_nodes[0] if cells.goal_nodes else -1
    if known >= 0:
        return netlist, known
    netlist, (node,) = add_nodes(netlist, 1)
    pin = int(node)
    is_high = rail == "obstacle" and wiring.drive != "uniform" and not wiring.has_islands
    volts = wiring.high if is_high else wiring.goal_voltage
    changed: dict[str, Any] = {"obstacle_node": pin} if rail == "obstacle" else {"goal_nodes": (pin,)}
    netlist = add_elements(netlist, "voltage source", [pin, GROUND], volts)
    return netlist.replace(cell_map=dataclasses.replace(cells, **changed)), pin


def without_stranded_currents(netlist: Netlist) -> Netlist:
    """Return the netlist without the current sources that have an end in a part of the circuit not connected to ground.

    The current of such a source has no return path.  Connections are resistors, nonlinear ones and voltage sources.
    """
    if not netlist.current_nodes.size:
        return netlist
    ties = np.concatenate([netlist.resistor_nodes, netlist.source_nodes, netlist.nonlinear_nodes])
    part = label_components(ties, netlist.node_count)
    kept = (part[netlist.current_nodes] == part[GROUND]).all(axis=1)
    return select_elements(netlist, "current source", kept)
