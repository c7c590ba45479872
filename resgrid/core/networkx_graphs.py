"""Conversion between netlists and networkx graphs, which lose the map to cells, and checks of fields of netlists."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import real_numbers
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
"""Names of the fields of a netlist by kind of element: the field of the nodes, and a mapping for the values.

The mapping is from the name of the attribute of a graph edge to the name of the field of the netlist.
"""

ARRAYS = {kind: (nodes, *columns.values()) for kind, (nodes, columns) in ELEMENTS.items()}
"""Names of the fields of a netlist per kind of element: first the field of the nodes, then the fields of the values."""

_OPTIONAL = ("tc1", "tc2")
_SYMMETRIC = ("resistor", "capacitor", "nonlinear resistor")
_ROUNDING = 1e-9
"""Largest relative difference between the attribute ``conductance`` of an edge and the inverse of ``resistance``.

Beyond it, InputError is raised.
"""

Edge: TypeAlias = tuple[Hashable, Hashable, Mapping[str, Any]]
"""First node, second node, and attributes of an edge of a graph."""


def no_pairs() -> NDArray[np.int32]:
    """Return an empty array of node pairs, shape (0, 2)."""
    return np.empty((0, 2), dtype=np.int32)


def no_values() -> NDArray[np.float64]:
    """Return an empty array of values, shape (0,)."""
    return np.empty(0)


def check_node_names(names: Any, count: int) -> None:
    """Raise InputError unless the node names are None or a list of different strings; `count`: number of nodes."""
    if names is None:
        return
    if not isinstance(names, Sequence) or isinstance(names, str):
        raise InputError(f"node_names = {names!r} must be a list of strings, one per node")
    if len(names) != count:
        raise InputError(f"node_names has {len(names)} names for {count} nodes; give one name per node")
    if len(set(names)) != count:
        name, times = Counter(names).most_common(1)[0]
        raise InputError(f"node_names: {times} nodes have the name {name!r}; give every node a different name")


def check_element_names(netlist: Any) -> None:
    """Raise InputError unless ``netlist.element_names`` is None or maps kinds of elements to one name per element."""
    names = {} if netlist.element_names is None else netlist.element_names
    if not isinstance(names, Mapping) or names.keys() - ARRAYS.keys():
        raise InputError(
            f"element_names = {names!r} must map kinds of elements to strings; kinds are {', '.join(ARRAYS)}"
        )
    for kind, texts in names.items():
        count = len(getattr(netlist, ARRAYS[kind][0]))
        if not isinstance(texts, Sequence) or isinstance(texts, str) or len(texts) != count:
            raise InputError(f"element_names[{kind!r}] must be {count} strings, one for every {kind}")


def all_within(value: NDArray[np.float64], low: float, high: float) -> bool:
    """Return whether all values lie strictly between `low` and `high`; False if a value is NaN, True without values."""
    return not value.size or bool(low < value.min() and value.max() < high)


def node_numbers(name: str, value: ArrayLike, node_count: int, width: int = 2) -> NDArray[np.int32]:
    """Return node numbers as an array (n, 2), or (n,) if `width` is 0; raise InputError if a node does not exist.

    `name`: name of the array in messages; `value`: node numbers; `node_count`: number of nodes of the netlist.
    """
    array = real_numbers(name, value)
    if array.size and array.dtype.kind not in "iu":
        raise InputError(f"{name} must hold node numbers, got {array.dtype}; convert them to integers")
    bits = np.ascontiguousarray(array).view(f"u{array.itemsize}")  # negative numbers become huge
    if array.size and not bits.max() < node_count:
        bad = int(array.ravel()[int(np.argmax(bits))])
        raise InputError(
            f"{name} names a node outside 0 ... {node_count - 1}: {bad}; correct the number, or raise node_count"
        )
    return column_of(name, array, width, np.int32)


def column_of(name: str, value: ArrayLike, width: int, dtype: Any) -> NDArray[Any]:
    """Return a read-only array (n, 2), or (n,) if `width` is 0; raise InputError for another shape.

    `name`: name of the array in messages; `value`: numbers, copied if they are a writeable array; `dtype`: type of the
    result.
    """
    array = real_numbers(name, value)
    shape_ok = array.ndim == 2 and array.shape[1] == 2 if width else array.ndim == 1
    if not shape_ok and array.size:
        raise InputError(f"{name} has shape {array.shape}, expected {'(n, 2)' if width else '(n,)'}")
    own = np.ascontiguousarray(array.reshape((-1, 2) if width else -1), dtype=dtype)
    if own.flags.writeable:
        own = own.copy() if array is value and np.may_share_memory(own, array) else own.view()
        own.flags.writeable = False
    return own


def graph_of(netlist: Any) -> nx.MultiGraph[int]:
    """Return a netlist as a networkx multigraph: one node per node number, one edge per element.

    Graph nodes have the attribute ``name``.  Edges have ``kind``, such as ``"resistor"``, the ordered pair ``nodes``,
    ``number`` (index of the element within its kind), ``name`` if the elements have names, and values in SI units, such
    as ``conductance``.
    """
    import networkx as nx

    graph: nx.MultiGraph[int] = nx.MultiGraph()
    names = netlist.names_of(np.arange(netlist.node_count))
    graph.add_nodes_from((i, {"name": name}) for i, name in enumerate(names))
    for kind in ELEMENTS:
        graph.add_edges_from(_edges(netlist, kind))
    return graph


def _edges(netlist: Any, kind: str) -> Iterator[tuple[int, int, dict[str, Any]]]:
    """Yield the elements of one kind as edges: first node, second node (numbers), and attributes by name.

    Attributes: ``kind``, ``nodes`` (both numbers), ``number`` (index of the element), values in SI units such as
    ``conductance``, and ``name`` if the elements have names. `netlist`: circuit; `kind`: kind, such as ``"resistor"``.
    """
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
    """Return the arguments of `Netlist` for a graph, by the names of the arguments, such as ``resistor_nodes``.

    Raise InputError for an edge of an unknown kind, or without a valid value.  `graph`: graph whose edges are elements;
    `ground`: the graph node that becomes node 0.
    """
    order = [ground, *(node for node in graph if node != ground)]
    number = {node: i for i, node in enumerate(order)}
    kinds: dict[str, list[Edge]] = {kind: [] for kind in ELEMENTS}
    for a, b, data in graph.edges(data=True):
        kind = data.get("kind", "resistor")
        if not isinstance(kind, str) or kind not in kinds:
            raise InputError(f"edge {a!r} - {b!r} has kind {kind!r}; it may be one of {sorted(kinds)}")
        kinds[kind].append((a, b, data))
    if graph.is_directed():
        _check_directions(kinds["resistor"])
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    names: dict[str, tuple[str, ...]] = {}
    for kind, edges in kinds.items():
        if all("number" in data for *_, data in edges):
            edges.sort(key=lambda edge: _number(edge[2]["number"], "number", edge))
        nodes, keys = ELEMENTS[kind]
        pairs = [[number[node] for node in _ends(edge, kind)] for edge in edges]
        arrays[nodes] = np.array(pairs, np.int32).reshape(-1, 2)
        for key, column in keys.items():
            if key not in _OPTIONAL or any(key in data for *_, data in edges):
                arrays[column] = np.array([_value(edge, key) for edge in edges], np.float64)
        if edges and all("name" in data for *_, data in edges):
            names[kind] = tuple(str(data["name"]) for *_, data in edges)
    return {
        "node_count": len(order),
        "node_names": _node_names(graph, order),
        "element_names": names or None,
        **arrays,
    }


def _node_names(graph: nx.Graph[Any], order: list[Any]) -> tuple[str, ...]:
    """Return a unique name for every graph node: its attribute ``name``, or else the node as a string.

    Ground without a name is ``0``, or ``ground`` if another node is called ``0``.  A duplicate name gets a suffix, such
    as ``a_2``.  `graph`: the graph; `order`: nodes of the graph in the order of the node numbers, ground first.
    """
    ground, others = order[0], order[1:]
    wanted = [str(graph.nodes[node].get("name", node)) for node in others]
    usual = "ground" if "0" in wanted else "0"
    own = graph.nodes[ground].get("name", usual) if ground in graph else usual
    taken: set[str] = set()
    names = []
    every, reserved = [str(own), *wanted], {str(own), *wanted}
    for name in every:
        unique, copies = name, 1
        while unique in taken or (copies > 1 and unique in reserved):
            copies += 1
            unique = f"{name}_{copies}"
        taken.add(unique)
        names.append(unique)
    return tuple(names)


def _check_directions(resistors: list[Edge]) -> None:
    """Raise InputError if a directed graph connects two nodes by resistor edges in both directions.

    `resistors`: triples of first node, second node and attributes of an edge.
    """
    joined = {(a, b) for a, b, _ in resistors if a != b}
    for a, b in joined:
        if (b, a) in joined:
            raise InputError(
                f"this directed graph has resistors {a!r} -> {b!r} and {b!r} -> {a!r}: one resistor, or two in "
                "parallel? Use graph.to_undirected() for one; build a MultiGraph for two"
            )


def _ends(edge: Edge, kind: str) -> tuple[Hashable, Hashable]:
    """Return the first and the second node of an element, in the order of the attribute ``nodes`` of its edge.

    Without this attribute, the order is that of `edge`.  If the attribute does not name the nodes of the edge, raise
    InputError for a source, whose direction would be unknown, and ignore the attribute for other elements.  `edge`:
    first node, second node, and attributes by name; `kind`: kind of element, such as ``"resistor"``.
    """
    a, b, data = edge
    if "nodes" not in data:
        return a, b
    stated = data["nodes"]
    if isinstance(stated, Sequence) and len(stated) == 2 and set(stated) == {a, b}:
        return stated[0], stated[1]
    if kind in _SYMMETRIC:
        return a, b
    raise InputError(
        f"edge {a!r} - {b!r} is a {kind} with nodes = {stated!r}; they must be its two nodes, in the order of its "
        "direction (set them again after nodes were renamed)"
    )


def _value(edge: Edge, key: str) -> float:
    """Return one value of an element in SI units; raise InputError if the value is missing or not admissible.

    A missing ``tc1`` or ``tc2`` is 0, and a missing ``conductance`` is the inverse of the attribute ``resistance``.
    `edge`: first node, second node, and attributes of the element by name; `key`: name of the attribute with the value,
    such as ``"conductance"``.
    """
    data = edge[2]
    if key in data:
        value = _number(data[key], key, edge)
        if key == "conductance" and "resistance" in data:
            other = _number(data["resistance"], "resistance", edge)
            if not abs(value * other - 1.0) < _ROUNDING:
                raise InputError(
                    f"edge {edge[0]!r} - {edge[1]!r} has conductance {value:g} and resistance {other:g}, which "
                    "contradict each other; remove one"
                )
    elif key in _OPTIONAL:
        return 0.0
    elif key == "conductance" and data.get("resistance") is not None:
        ohms = _number(data["resistance"], "resistance", edge)
        value = 1.0 / ohms if ohms else np.inf
        if not 0.0 < value < np.inf:
            raise InputError(
                f"edge {edge[0]!r} - {edge[1]!r} has resistance {ohms:g}; it must be positive and finite (a short is a "
                "voltage source of 0 V)"
            )
    else:
        hint = " or 'resistance'" if key == "conductance" else ""
        raise InputError(f"edge {edge[0]!r} - {edge[1]!r} has no {key!r}{hint}")
    if key == "conductance" and not value > 0.0:
        raise InputError(f"edge {edge[0]!r} - {edge[1]!r} has conductance {value:g}; it must be positive")
    return value


def _number(value: object, key: str, edge: Edge) -> float:
    """Return an attribute of an edge as a float; raise InputError unless the attribute is a finite number.

    `value`: value of the attribute; `key`: name of the attribute.
    """
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = np.nan
    if not np.isfinite(number) or isinstance(value, bool) or (isinstance(value, str) and "_" in value):
        raise InputError(
            f"edge {edge[0]!r} - {edge[1]!r} has {key} = {value!r}; it must be a finite number in SI units, such as "
            "3000.0 (suffixes such as k or M are not supported here)"
        )
    return number
