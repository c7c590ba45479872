"""Resistor networks that are no decks: lists of edges, sources and grounds, Circuitscape configurations, graphs."""

from __future__ import annotations

import os
from pathlib import Path

from resgrid.errors import InputError
from resgrid.spice.circuit import Circuit
from resgrid.spice.networks.circuitscape import read_circuitscape
from resgrid.spice.networks.edges import is_edge_list, read_edges
from resgrid.spice.networks.graphs import GRAPH_SUFFIXES, read_graph

_TABLES = (".csv", ".tsv")


def is_network(path: str | os.PathLike[str]) -> bool:
    """Whether a file is a network that is no deck: a graph, arrays, a configuration, or a list of edges."""
    suffix = Path(path).suffix.lower()
    return is_edge_list(path) if suffix == ".txt" else suffix in (*_TABLES, *GRAPH_SUFFIXES, ".ini")


def read_network(
    path: str | os.PathLike[str],
    *,
    measure: str | None = None,
    sources: str | os.PathLike[str] | None = None,
    grounds: str | os.PathLike[str] | None = None,
    root: str | os.PathLike[str] | None = None,
) -> Circuit:
    """Read a network as if it were a deck."""
    suffix = Path(path).suffix.lower()
    if suffix not in (*GRAPH_SUFFIXES, ".ini"):
        return Circuit.of(read_edges(path, sources, grounds, measure, measure).netlist(), os.fspath(path))
    if measure is not None or sources is not None or grounds is not None:
        raise InputError(f"{os.fspath(path)} names its own sources, grounds and measure; leave those options out")
    netlist = read_circuitscape(path, root=root)[0].netlist() if suffix == ".ini" else read_graph(path)
    return Circuit.of(netlist, os.fspath(path))
