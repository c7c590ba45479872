"""Netlists in files that are no decks: edge lists, graphs and arrays; `read_spice` reads back what is written.

Only the cells of a space are lost, and in an edge list everything but resistors.
"""

from __future__ import annotations

import os
import re
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from resgrid.errors import InputError
from resgrid.graphs import ELEMENTS
from resgrid.io.tables import FORMATS, Views, write
from resgrid.netlist import GROUND, Netlist
from resgrid.spice.networks.graphs import NETLIST_ARRAYS
from resgrid.spice.write.flat import resistances

_GROUND_NAME = "ground"
_PLAIN = re.compile(r"(?!\d+\.0*$)[^\s,;#%]+")
_VIEWS = ("edges", "graph", "record", "arrays")
NETWORK_SUFFIXES = tuple(suffix for suffix, form in FORMATS.items() if form.view in _VIEWS)


def write_network(netlist: Netlist, file: str | os.PathLike[str]) -> Path:
    """Write a netlist as a graph, whole or not at all.

    Parameters
    ----------
    netlist : Netlist
    file : path-like
        ``.txt``: a list of edges, two nodes and a resistance a line, resistors alone; ``.graphml`` and node-link
        ``.json``: graphs with every element; ``.npz``: the netlist's arrays and names.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If the file's name ends otherwise, an edge list cannot hold a node's name, or the file cannot be written.

    Examples
    --------
    >>> divider = rg.Netlist(3, [[1, 2], [2, 0]], [1e-3, 1e-3], source_nodes=[[1, 0]], source_volts=[2.0])
    >>> rg.write_network(divider, "divider.txt").read_text().splitlines()
    ['node_1 node_2 1000.0', 'node_2 ground 1000.0']
    """
    views: Views = {
        "edges": lambda: _edges(netlist),
        "graph": lambda: _graphml(netlist),
        "record": lambda: _node_link(netlist),
        "arrays": lambda: _arrays(netlist),
    }
    return write(file, views, "a network")


def left_out(netlist: Netlist, file: str | os.PathLike[str]) -> dict[str, int]:
    """How much of a netlist a file of that name has no place for, by kind: in an edge list, all but resistances."""
    if FORMATS[Path(file).suffix.lower()].view != "edges":
        return {}
    counts = {kind: len(getattr(netlist, nodes)) for kind, (nodes, _) in ELEMENTS.items() if kind != "resistor"}
    tempered = [np.asarray(values) != 0 for values in (netlist.tc1, netlist.tc2) if values is not None]
    counts["temperature coefficient"] = int(np.any(tempered, axis=0).sum()) if tempered else 0
    return {kind: count for kind, count in counts.items() if count}


def _edges(netlist: Netlist) -> str:
    names = netlist.names_of(range(netlist.node_count))
    for node in np.unique(netlist.resistor_nodes).tolist():
        if node != GROUND and (names[node].lower() == _GROUND_NAME or not _PLAIN.fullmatch(names[node])):
            raise InputError(
                f"an edge list cannot hold a node named {names[node]!r}; write .json, .graphml or .npz instead"
            )
    names[GROUND] = _GROUND_NAME
    rows = zip(netlist.resistor_nodes.tolist(), resistances(netlist.conductance).tolist(), strict=True)
    return "".join([f"{names[a]} {names[b]} {ohms!r}\n" for (a, b), ohms in rows])


def _graphml(netlist: Netlist) -> bytes:
    import networkx as nx

    graph, data = netlist.to_networkx(), BytesIO()
    for *_, attributes in graph.edges(data=True):
        attributes["nodes"] = " ".join(map(str, attributes["nodes"]))
    nx.write_graphml(graph, data)
    return data.getvalue()


def _node_link(netlist: Netlist) -> dict[str, Any]:
    import networkx as nx

    record: dict[str, Any] = nx.node_link_data(netlist.to_networkx(), edges="edges")
    return record


def _arrays(netlist: Netlist) -> dict[str, Any]:
    arrays = {name: getattr(netlist, name) for name in NETLIST_ARRAYS if getattr(netlist, name) is not None}
    arrays["node_names"] = np.array(netlist.names_of(np.arange(netlist.node_count)), dtype=np.str_)
    names = (netlist.element_names or {}).items()
    return arrays | {f"{kind.replace(' ', '_')}_names": np.array(own, dtype=np.str_) for kind, own in names}
