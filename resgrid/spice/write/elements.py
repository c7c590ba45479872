"""Which elements of a netlist a deck holds, in which order, and under which names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import CircuitError, InputError
from resgrid.netlist import GROUND, Netlist
from resgrid.spice.check.rules import connected_parts, trapped_current_sources
from resgrid.spice.dialects.record import Dialect
from resgrid.spice.text.texts import Chosen, Texts, names, weave
from resgrid.spice.write.names import legal_names

ENDS = MappingProxyType(
    {
        "voltage source": "source_nodes",
        "current source": "current_nodes",
        "resistor": "resistor_nodes",
        "nonlinear resistor": "nonlinear_nodes",
        "capacitor": "capacitor_nodes",
    }
)
"""The kinds in the order of a deck, and where a netlist keeps their nodes."""

INITIALS = MappingProxyType(
    {"voltage source": "v", "current source": "i", "resistor": "r", "nonlinear resistor": "b", "capacitor": "c"}
)


@dataclass(frozen=True, eq=False)
class NodeNames:
    """Names of a deck's nodes.

    `nodes` (n,): the nodes that the deck holds, ascending, without ground; `texts`: name of every node of the
    netlist, empty where the deck does not hold it; `labels`: the same as part of an element's name: the place alone,
    empty for ground.
    """

    nodes: NDArray[np.int64]
    texts: Texts
    labels: Texts


def held_nodes(netlist: Netlist) -> NDArray[np.bool_]:
    """Which nodes a deck can hold: those that resistors and voltage sources join to ground; shape (node_count,)."""
    part = connected_parts(netlist)
    trapped = trapped_current_sources(netlist, part)
    if trapped.size:
        where = netlist.names_of(netlist.current_nodes[trapped[0]])
        raise CircuitError(
            f"current source {trapped[0]} from node {where[0]} to node {where[1]} feeds a floating part that lets no "
            "current out: remove it, or join the part to ground"
        )
    held: NDArray[np.bool_] = part == part[GROUND]
    if held.sum() < 2:
        raise InputError("nothing is left to write: no node has a path of resistors or voltage sources to ground")
    return held


def choose_elements(netlist: Netlist, held: NDArray[np.bool_]) -> dict[str, NDArray[np.int64]]:
    """Numbers of the elements that the deck holds, per kind, in the order of their nodes and values."""
    from resgrid.nodal.sources import tie_sources

    with np.errstate(over="ignore"):
        if np.isinf(1 / netlist.conductance).any():
            raise InputError("a resistance is beyond the largest number; leave that resistor out: it is open")
    parents = tie_sources(netlist).source
    keeps_source = np.zeros(len(netlist.source_volts), dtype=np.bool_)
    keeps_source[parents[parents >= 0]] = True
    return {
        "voltage source": _sorted(netlist.source_nodes, netlist.source_volts, held, keeps_source),
        "current source": _sorted(netlist.current_nodes, netlist.current_amps, held),
        "resistor": _sorted(netlist.resistor_nodes, -netlist.conductance, held),
        "nonlinear resistor": _sorted(netlist.nonlinear_nodes, netlist.nonlinear_current, held),
        "capacitor": _sorted(netlist.capacitor_nodes, netlist.capacitance, held),
    }


def _sorted(
    ends: NDArray[np.int32],
    value: NDArray[np.float64],
    held: NDArray[np.bool_],
    keep: NDArray[np.bool_] | None = None,
) -> NDArray[np.int64]:
    kept = held[ends[:, 0]] & held[ends[:, 1]]
    numbers = np.flatnonzero(kept if keep is None else kept & keep)
    place = ends[numbers, 0].astype(np.int64) * len(held) + ends[numbers, 1]
    order = np.argsort(place, kind="stable")
    again = place[order[1:]] == place[order[:-1]]
    if again.any():  # parallel elements, in the order of their values
        alike = np.append(again, False) | np.append(False, again)
        few = order[alike]
        order[alike] = few[np.lexsort((value[numbers[few]], place[few]))]
    return numbers[order]


def name_nodes(netlist: Netlist, rules: Dialect, held: NDArray[np.bool_]) -> NodeNames:
    """Name the nodes that a deck holds.  Shapes: `held` (node_count,)."""
    nodes = np.flatnonzero(held)
    nodes = nodes[nodes != GROUND]
    if netlist.node_names is None:
        labels, own = _places(netlist, held)
        prefix = names(["", "n_", rules.ground]).take(np.where(np.arange(len(held)) == GROUND, 2, own.astype(np.int64)))
        return NodeNames(nodes, weave(len(held), prefix, labels), labels)
    legal = legal_names(netlist.names_of(nodes), "n", rules.reserved)
    words = [""] * netlist.node_count
    for node, name in zip(nodes.tolist(), legal, strict=True):
        words[node] = name
    labels = names([word.removeprefix("n_") for word in words])
    words[GROUND] = rules.ground
    return NodeNames(nodes, names(words), labels)


def _places(netlist: Netlist, held: NDArray[np.bool_]) -> tuple[Texts, NDArray[np.bool_]]:
    """Place of every node: the coordinates of its cell, or its rail's name; and which nodes belong to cells."""
    count = netlist.node_count
    if netlist.cell_map is None:
        number = names([f"node_{node}" for node in range(count)])
        keep = held & (np.arange(count) != GROUND)
        return _only(number, keep), np.zeros(count, dtype=np.bool_)
    cell = netlist.cell_of_node()
    own = (cell >= 0) & held
    rails = np.flatnonzero(held & ~own)
    rails = rails[rails != GROUND]
    which = np.zeros(count, dtype=np.int64)
    which[rails] = np.arange(1, len(rails) + 1)
    columns = [names(["", *netlist.names_of(rails)]).take(which)]
    shape = netlist.cells.space.shape
    for axis, index in enumerate(np.unravel_index(np.maximum(cell, 0), shape)):
        table = names(["", *(f"_{i}" if axis else str(i) for i in range(shape[axis]))])
        columns.append(table.take(np.where(own, index + 1, 0)))
    return weave(count, *columns), own


def _only(texts: Texts, keep: NDArray[np.bool_]) -> Texts:
    empty = Texts(texts.data, np.append(texts.offset, texts.offset[-1]))
    return weave(len(keep), empty.take(np.where(keep, np.arange(len(keep)), len(keep))))


def name_elements(netlist: Netlist, kind: str, numbers: NDArray[np.int64], nodes: NodeNames) -> Texts:
    """Names of elements: the file's where there are any, otherwise from the place.  Shapes: `numbers` (n,)."""
    initial = INITIALS[kind]
    given = (netlist.element_names or {}).get(kind)
    if given is not None:
        read = [given[number] for number in numbers.tolist()]
        wanted = [name if name[:1].lower() == initial else f"{initial}_{name}" for name in read]
        return names(legal_names(wanted, initial))
    first, second = getattr(netlist, ENDS[kind])[numbers].T
    if kind == "current source":
        first, second = np.where(second == GROUND, first, second), np.full(len(second), GROUND)
    joint = names(["", "_"]).take(((first != GROUND) & (second != GROUND)).astype(np.int64))
    place: list[bytes | Chosen] = [f"{initial}_".encode(), nodes.labels.take(first), joint, nodes.labels.take(second)]
    if netlist.node_names is not None or (netlist.cell_map is not None and netlist.cells.space.ndim == 1):
        return names(legal_names(weave(len(numbers), *place).strings(), initial))
    grounded = (first == GROUND) | (second == GROUND)
    alike = np.where(grounded, np.maximum(first, second), first * len(nodes.texts) + second)
    return weave(len(numbers), *place, *_numbered_apart(alike))


def _numbered_apart(alike: NDArray[np.int64]) -> tuple[Chosen, ...]:
    """Nothing behind the first element of a place, ``_2`` behind the second: as `legal_names`, but in bulk."""
    order = np.argsort(alike, kind="stable")
    group = alike[order]
    repeats = np.append(False, group[1:] == group[:-1])
    if not repeats.any():
        return ()
    position = np.arange(len(alike))
    rank = np.empty_like(position)
    rank[order] = position - np.maximum.accumulate(np.where(repeats, 0, position))
    return (names(["", *(f"_{i + 1}" for i in range(1, int(rank.max()) + 1))]).take(rank),)


def renamed(netlist: Netlist, nodes: NodeNames) -> dict[str, str]:
    """Name in the deck to name in the netlist, of the nodes where they differ."""
    if netlist.node_names is None:
        return {}
    words = nodes.texts.strings()
    return {words[node]: name for node in nodes.nodes.tolist() if words[node] != (name := netlist.node_names[node])}


def renamed_elements(
    netlist: Netlist, elements: Mapping[str, NDArray[np.int64]], element_names: Mapping[str, Texts]
) -> dict[str, str]:
    """The same, of the elements that have names in the netlist."""
    given = netlist.element_names or {}
    return {
        name: given[kind][number]
        for kind in given
        if kind in elements
        for name, number in zip(element_names[kind].strings(), elements[kind].tolist(), strict=True)
        if name != given[kind][number]
    }
