"""Netlists in files that are no decks: edge lists, graphs and arrays; what is written is read back as it was.

Only the cells of a space are lost, and in an edge list everything but resistors.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from resgrid.errors import InputError
from resgrid.files import atomic_path
from resgrid.netlist import GROUND, Netlist

if TYPE_CHECKING:
    import networkx as nx

GRAPH_SUFFIXES = (".graphml", ".json", ".npz")
NETWORK_SUFFIXES = (".txt", *GRAPH_SUFFIXES)
"""Edges (two nodes and a resistance a line), graphs as GraphML and as node-link JSON, and NumPy arrays."""

_GROUND_NAME = "ground"
_ARRAYS = (
    "resistor_nodes", "conductance", "tc1", "tc2", "source_nodes", "source_volts", "current_nodes", "current_amps",
    "capacitor_nodes", "capacitance", "nonlinear_nodes", "nonlinear_current", "nonlinear_voltage",
)  # fmt: skip
_PLAIN = re.compile(r"(?!\d+\.0*$)[^\s,;#%]+")


def write_network(netlist: Netlist, path: str | os.PathLike[str]) -> None:
    """Write a netlist as the end of the file's name says, one of `NETWORK_SUFFIXES`."""
    writers = {".txt": _write_edges, ".graphml": _write_graphml, ".json": _write_json, ".npz": _write_arrays}
    write = writers.get(Path(path).suffix.lower())
    if write is None:
        raise InputError(f"{os.fspath(path)}: a network is written as {', '.join(writers)}; name the file so")
    with atomic_path(path) as temporary:
        write(netlist, temporary)


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


def _write_edges(netlist: Netlist, path: Path) -> None:
    """Names of the two nodes and the resistance of every resistor."""
    from resgrid.spice.write.flat import resistances

    names = netlist.names_of(range(netlist.node_count))
    used = np.unique(netlist.resistor_nodes).tolist()
    for node in used:
        if node != GROUND and (names[node].lower() == _GROUND_NAME or not _PLAIN.fullmatch(names[node])):
            raise InputError(
                f"an edge list cannot hold a node named {names[node]!r}; write .json, .graphml or .npz instead"
            )
    names[GROUND] = _GROUND_NAME
    rows = zip(netlist.resistor_nodes.tolist(), resistances(netlist.conductance).tolist(), strict=True)
    path.write_text("".join([f"{names[a]} {names[b]} {ohms!r}\n" for (a, b), ohms in rows]), encoding="utf-8")


def _write_graphml(netlist: Netlist, path: Path) -> None:
    import networkx as nx

    graph = netlist.to_networkx()
    for *_, data in graph.edges(data=True):
        data["nodes"] = " ".join(map(str, data["nodes"]))
    nx.write_graphml(graph, path)


def _read_graphml(path: Path) -> Netlist:
    import networkx as nx

    graph = nx.read_graphml(path)
    for *_, data in graph.edges(data=True):
        if "nodes" in data:
            data["nodes"] = tuple(str(data["nodes"]).split())
    return Netlist.from_networkx(graph, _ground_of(graph))


def _write_json(netlist: Netlist, path: Path) -> None:
    import networkx as nx

    path.write_text(json.dumps(nx.node_link_data(netlist.to_networkx(), edges="edges")) + "\n", encoding="utf-8")


def _read_json(path: Path) -> Netlist:
    import networkx as nx

    content = json.loads(path.read_bytes())
    if not isinstance(content, dict) or not {"nodes", "edges"} <= content.keys():
        raise InputError("this is no graph in node-link form, with nodes and edges")
    graph = nx.node_link_graph(content, edges="edges")
    return Netlist.from_networkx(graph, _ground_of(graph))


def _ground_of(graph: nx.Graph[Any]) -> object:
    """The node called 0, by its own name or by its attribute; 0, which is then added, if there is none."""
    return next((node for node, data in graph.nodes(data=True) if "0" in (str(node), data.get("name"))), GROUND)


def _write_arrays(netlist: Netlist, path: Path) -> None:
    arrays: dict[str, Any] = {name: getattr(netlist, name) for name in _ARRAYS if getattr(netlist, name) is not None}
    arrays["node_names"] = np.array(netlist.names_of(np.arange(netlist.node_count)), dtype=np.str_)
    for kind, names in (netlist.element_names or {}).items():
        arrays[f"{kind.replace(' ', '_')}_names"] = np.array(names, dtype=np.str_)
    with path.open("wb") as file:
        np.savez(file, **arrays)


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
