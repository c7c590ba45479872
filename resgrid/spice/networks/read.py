"""Resistor networks that are no decks: lists of edges, sources and grounds, Circuitscape configurations, graphs."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from resgrid.errors import InputError
from resgrid.netlist import Netlist
from resgrid.spice.networks.circuitscape import read_circuitscape
from resgrid.spice.networks.edges import is_edge_list, read_edges
from resgrid.spice.networks.graphs import GRAPH_SUFFIXES, read_graph
from resgrid.spice.parsed import KINDS, ParsedDeck

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
) -> ParsedDeck:
    """Read a network as if it were a deck."""
    suffix = Path(path).suffix.lower()
    if suffix not in (*GRAPH_SUFFIXES, ".ini"):
        return _circuit(read_edges(path, sources, grounds, measure, measure).netlist(), os.fspath(path))
    if measure is not None or sources is not None or grounds is not None:
        raise InputError(f"{os.fspath(path)} names its own sources, grounds and measure; leave those options out")
    netlist = read_circuitscape(path, root=root)[0].netlist() if suffix == ".ini" else read_graph(path)
    return _circuit(netlist, os.fspath(path))


def _circuit(netlist: Netlist, path: str) -> ParsedDeck:
    """A circuit that came as a whole, every element with a name."""
    values = {
        "resistor": netlist.conductance,
        "voltage source": netlist.source_volts,
        "current source": netlist.current_amps,
        "capacitor": netlist.capacitance,
        "nonlinear resistor": netlist.nonlinear_current,
    }
    counts = {kind: len(values[kind]) for kind in KINDS}
    names = dict(netlist.element_names or {})
    for kind, count in counts.items():
        known = names.get(kind, ())
        names[kind] = (*known, *(f"{kind[0]}{number}" for number in range(len(known) + 1, count + 1)))
    return ParsedDeck(
        title=None,
        path=path,
        dialect="network",
        node_names=tuple(netlist.names_of(np.arange(netlist.node_count))),
        resistor_nodes=netlist.resistor_nodes,
        resistance=1.0 / netlist.conductance,
        source_nodes=netlist.source_nodes,
        source_volts=netlist.source_volts,
        current_nodes=netlist.current_nodes,
        current_amps=netlist.current_amps,
        capacitor_nodes=netlist.capacitor_nodes,
        capacitance=netlist.capacitance,
        nonlinear_nodes=netlist.nonlinear_nodes,
        nonlinear_current=netlist.nonlinear_current,
        nonlinear_voltage=netlist.nonlinear_voltage,
        element_names=names,
        place={kind: np.zeros((count, 2), dtype=np.int64) for kind, count in counts.items()},
        files=(path,),
        given=netlist,
    )
