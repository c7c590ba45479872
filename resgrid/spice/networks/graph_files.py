"""Netlists as graphs and as arrays, both ways."""

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
"""Graphs as GraphML and as node-link JSON, and NumPy arrays."""

_ARRAYS = tuple(name for names in ARRAYS.values() for name in names)


def graphml(netlist: Netlist) -> bytes:
    """A netlist as GraphML; its attributes are no lists, so that the nodes of an element are words."""
    import networkx as nx

    graph, data = netlist.to_networkx(), BytesIO()
    for *_, attributes in graph.edges(data=True):
        attributes["nodes"] = " ".join(map(str, attributes["nodes"]))
    nx.write_graphml(graph, data)
    return data.getvalue()


def node_link(netlist: Netlist) -> dict[str, Any]:
    """A netlist as a graph in node-link form."""
    import networkx as nx

    record: dict[str, Any] = nx.node_link_data(netlist.to_networkx(), edges="edges")
    return record


def netlist_arrays(netlist: Netlist) -> dict[str, Any]:
    """The arrays of a netlist, and its names, by their names."""
    arrays = {name: getattr(netlist, name) for name in _ARRAYS if getattr(netlist, name) is not None}
    arrays["node_names"] = np.array(netlist.names_of(np.arange(netlist.node_count)), dtype=np.str_)
    names = (netlist.element_names or {}).items()
    return arrays | {f"{kind.replace(' ', '_')}_names": np.array(own, dtype=np.str_) for kind, own in names}


def read_graph(path: str | os.PathLike[str]) -> Netlist:
    """Read a netlist from GraphML, node-link JSON or arrays, by the end of the file's name."""
    file = Path(path)
    readers = {".graphml": _read_graphml, ".json": _read_json, ".npz": _read_arrays}
    try:
        return readers[file.suffix.lower()](file)
    except InputError as error:
        raise InputError(f"{os.fspath(path)}: {error}") from error
    except OSError as error:
        raise InputError(f"cannot read {os.fspath(path)}: {error.strerror or error}; check the path") from error
    except Exception as error:  # whatever a parser of somebody else's makes of a damaged file
        raise InputError(
            f"{os.fspath(path)} holds no netlist ({type(error).__name__}: {error}); write it with 'resgrid convert', "
            "or as Netlist.to_networkx does"
        ) from error


def _read_graphml(path: Path) -> Netlist:
    import networkx as nx

    graph = nx.read_graphml(path)
    for *_, data in graph.edges(data=True):
        if "nodes" in data:
            data["nodes"] = tuple(str(data["nodes"]).split())
    return _netlist_of(graph)


def _read_json(path: Path) -> Netlist:
    import networkx as nx

    content = json.loads(path.read_bytes())
    if not isinstance(content, dict) or not {"nodes", "edges"} <= content.keys():
        raise InputError("this is no graph in node-link form, with nodes and edges")
    return _netlist_of(nx.node_link_graph(content, edges="edges"))


def _netlist_of(graph: nx.Graph[Any]) -> Netlist:
    """Return the netlist of a graph; ground is the node 0, else the one with the name 0, else it is added."""
    by_node = (node for node in graph if str(node) == "0")
    by_name = (node for node, data in graph.nodes(data=True) if str(data.get("name")) == "0")
    return Netlist.from_networkx(graph, next(chain(by_node, by_name), GROUND))


def _read_arrays(path: Path) -> Netlist:
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    if "resistor_nodes" not in arrays or "node_names" not in arrays:
        raise InputError("these arrays are no netlist: resistor_nodes and node_names are missing")
    node_names = tuple(arrays.pop("node_names").tolist())
    names = {
        key.removesuffix("_names").replace("_", " "): tuple(value.tolist())
        for key, value in arrays.items()
        if key.endswith("_names")
    }
    fields = {name: arrays[name] for name in _ARRAYS if name in arrays}
    return Netlist(node_count=len(node_names), node_names=node_names, element_names=names or None, **fields)
