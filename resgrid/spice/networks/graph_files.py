"""Reader and writer of netlists as GraphML, node-link JSON and NumPy arrays."""

from __future__ import annotations

import json
import os
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from resgrid.core.netlist import GROUND, Netlist
from resgrid.core.networkx_graphs import ARRAYS
from resgrid.errors import InputError

if TYPE_CHECKING:
    import networkx as nx

GRAPH_SUFFIXES = (".graphml", ".json", ".npz")
"""File name suffixes of GraphML, node-link JSON and NumPy arrays."""

_ARRAYS = tuple(name for names in ARRAYS.values() for name in names)


def graphml(netlist: Netlist) -> bytes:
    """Return the content of a GraphML file of a netlist.

    The attribute ``nodes`` of an edge is one string with the numbers of both nodes, because GraphML has no lists.
    """
    import networkx as nx

    graph, data = netlist.to_networkx(), BytesIO()
    for *_, attributes in graph.edges(data=True):
        attributes["nodes"] = " ".join(map(str, attributes["nodes"]))
    nx.write_graphml(graph, data)
    return data.getvalue()


def node_link(netlist: Netlist) -> dict[str, Any]:
    """Return a netlist as a graph in node-link form: a dict for JSON with the keys ``nodes`` and ``edges``.

    Both are lists of dictionaries: nodes with ``id``, edges with ``source`` and ``target`` (node identifiers), ``kind``
    and values in SI units, such as ``conductance`` of a resistor (see `Netlist.to_networkx`).
    """
    import networkx as nx

    record: dict[str, Any] = nx.node_link_data(netlist.to_networkx(), edges="edges")
    return record


def netlist_arrays(netlist: Netlist) -> dict[str, Any]:
    """Return the contents of an NPZ file of a netlist: arrays of elements, node names and element names, by key.

    Keys: fields of `Netlist`, such as ``resistor_nodes``; ``node_names``; and ``<kind>_names``, such as
    ``resistor_names``, if the elements have names.
    """
    arrays = {name: getattr(netlist, name) for name in _ARRAYS if getattr(netlist, name) is not None}
    arrays["node_names"] = np.array(netlist.names_of(np.arange(netlist.node_count)), dtype=np.str_)
    names = (netlist.element_names or {}).items()
    return arrays | {f"{kind.replace(' ', '_')}_names": np.array(own, dtype=np.str_) for kind, own in names}


def read_graph(path: str | os.PathLike[str]) -> Netlist:
    """Return the netlist of a GraphML, node-link JSON or NPZ file; the suffix of `path` selects the format.

    Raises InputError if the file cannot be read or holds no netlist.
    """
    file = Path(path)
    readers = {".graphml": _read_graphml, ".json": _read_json, ".npz": _read_arrays}
    try:
        return readers[file.suffix.lower()](file)
    except InputError as error:
        raise InputError(f"{os.fspath(path)}: {error}") from error
    except OSError as error:
        raise InputError(f"cannot read {os.fspath(path)}: {error.strerror or error}; check the path") from error
    except Exception as error:  # parsers raise many kinds of errors for a damaged file
        raise InputError(
            f"{os.fspath(path)} is not a netlist ({type(error).__name__}: {error}); write it with 'resgrid convert', "
            "or as Netlist.to_networkx does"
        ) from error


def _read_graphml(path: Path) -> Netlist:
    """Return the netlist of a GraphML file in the form that `graphml` writes."""
    import networkx as nx

    graph = nx.read_graphml(path)
    for *_, data in graph.edges(data=True):
        if "nodes" in data:
            data["nodes"] = tuple(str(data["nodes"]).split())
    return _netlist_of(graph)


def _read_json(path: Path) -> Netlist:
    """Return the netlist of a JSON file in node-link form; raise InputError for other JSON.

    The edges are under the key ``edges`` or ``links``, which networkx wrote by default before version 3.6.
    """
    import networkx as nx

    content = json.loads(path.read_bytes())
    keys = content.keys() if isinstance(content, dict) else set()
    missing = [name for name in ("nodes", "edges") if name not in keys and (name == "nodes" or "links" not in keys)]
    if missing:
        raise InputError(f"not a graph in node-link form: the key {' and the key '.join(missing)} is missing")
    return _netlist_of(nx.node_link_graph(content, edges="edges" if "edges" in keys else "links"))


def _netlist_of(graph: nx.Graph[Any]) -> Netlist:
    """Return the netlist of a graph.

    Ground is the graph's node ``0``; without one, the node whose attribute ``name`` is ``0``; without both, an added
    node.
    """
    by_node = (node for node in graph if str(node) == "0")
    by_name = (node for node, data in graph.nodes(data=True) if str(data.get("name")) == "0")
    return Netlist.from_networkx(graph, next(chain(by_node, by_name), GROUND))


def _read_arrays(path: Path) -> Netlist:
    """Return the netlist of an NPZ file with the arrays of `netlist_arrays`; raise InputError if one is missing."""
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    if "resistor_nodes" not in arrays or "node_names" not in arrays:
        raise InputError("not the arrays of a netlist: resistor_nodes or node_names is missing")
    node_names = tuple(arrays.pop("node_names").tolist())
    names = {
        key.removesuffix("_names").replace("_", " "): tuple(value.tolist())
        for key, value in arrays.items()
        if key.endswith("_names")
    }
    fields = {name: arrays[name] for name in _ARRAYS if name in arrays}
    return Netlist(node_count=len(node_names), node_names=node_names, element_names=names or None, **fields)
