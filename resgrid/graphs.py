"""Netlists as graphs of networkx, and back again, nothing lost but the cells."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from resgrid.errors import InputError

if TYPE_CHECKING:
    import networkx as nx

ELEMENTS: dict[str, tuple[str, dict[str, str]]] = {
    "resistor": ("resistor_nodes", {"conductance": "conductance", "tc1": "tc1", "tc2": "tc2"}),
    "voltage source": ("source_nodes", {"volts": "source_volts"}),
    "current source": ("current_nodes", {"amps": "current_amps"}),
    "capacitor": ("capacitor_nodes", {"capacitance": "capacitance"}),
    "nonlinear resistor": ("nonlinear_nodes", {"current": "nonlinear_current", "voltage": "nonlinear_voltage"}),
}
"""Per kind the netlist's array of nodes, and its arrays of values by their keys in the graph."""

ARRAYS = {kind: (nodes, *columns.values()) for kind, (nodes, columns) in ELEMENTS.items()}
"""Per kind the netlist's arrays: that of its nodes, then those of its values."""

_OPTIONAL = ("tc1", "tc2")


def graph_of(netlist: Any) -> nx.MultiGraph[int]:
    """As `Netlist.to_networkx`, whose module stands above this one."""
    import networkx as nx

    graph: nx.MultiGraph[int] = nx.MultiGraph()
    names = netlist.names_of(np.arange(netlist.node_count))
    graph.add_nodes_from((i, {"name": name}) for i, name in enumerate(names))
    for kind in ELEMENTS:
        graph.add_edges_from(_edges(netlist, kind))
    return graph


def _edges(netlist: Any, kind: str) -> Iterator[tuple[int, int, dict[str, Any]]]:
    nodes, keys = ELEMENTS[kind]
    columns: dict[str, list[Any]] = {
        key: getattr(netlist, column).tolist() for key, column in keys.items() if getattr(netlist, column) is not None
    }
    if netlist.element_names is not None and kind in netlist.element_names:
        columns["name"] = list(netlist.element_names[kind])
    for number, (a, b) in enumerate(getattr(netlist, nodes).tolist()):
        values = {key: column[number] for key, column in columns.items()}
        yield a, b, {"kind": kind, **values, "nodes": (a, b), "number": number}


def fields_of(graph: nx.Graph[Any], ground: object) -> dict[str, Any]:
    """What `Netlist.from_networkx` makes a netlist of."""
    order = [ground, *(node for node in graph if node != ground)]
    number = {node: i for i, node in enumerate(order)}
    kinds: dict[str, list[tuple[Hashable, Hashable, Mapping[str, Any]]]] = {kind: [] for kind in ELEMENTS}
    for a, b, data in graph.edges(data=True):
        kind = data.get("kind", "resistor")
        if kind not in kinds:
            raise InputError(f"edge {a!r} - {b!r} has kind {kind!r}; it may be one of {sorted(kinds)}")
        kinds[kind].append((a, b, data))
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    names: dict[str, tuple[str, ...]] = {}
    for kind, edges in kinds.items():
        if all("number" in data for *_, data in edges):
            edges.sort(key=lambda edge: int(edge[2]["number"]))
        nodes, keys = ELEMENTS[kind]
        pairs = [[number[node] for node in data.get("nodes", (a, b))] for a, b, data in edges]
        arrays[nodes] = np.array(pairs, np.int32).reshape(-1, 2)
        for key, column in keys.items():
            if key not in _OPTIONAL or any(key in data for *_, data in edges):
                values = [_value(data, key, (a, b)) for a, b, data in edges]
                arrays[column] = np.array(values, np.float64)
        if edges and all("name" in data for *_, data in edges):
            names[kind] = tuple(str(data["name"]) for *_, data in edges)
    own = graph.nodes[ground].get("name", "0") if ground in graph else "0"
    node_names = (str(own), *(str(graph.nodes[node].get("name", node)) for node in order[1:]))
    return {"node_count": len(order), "node_names": node_names, "element_names": names or None, **arrays}


def _value(data: Mapping[str, Any], key: str, edge: tuple[object, object]) -> float:
    if key in data:
        return float(data[key])
    if key in _OPTIONAL:
        return 0.0
    if key == "conductance" and data.get("resistance"):
        return 1.0 / float(data["resistance"])
    raise InputError(f"edge {edge[0]!r} - {edge[1]!r} lacks {key!r} (or a resistance that is not zero)")
