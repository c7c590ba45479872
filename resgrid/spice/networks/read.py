"""Resistor networks that are no decks: lists of edges, sources and grounds, Circuitscape configurations, graphs."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from resgrid.errors import InputError
from resgrid.netlist import Netlist
from resgrid.spice.networks.circuitscape import read_circuitscape
from resgrid.spice.networks.edges import MEASURES, Measure, NetworkParts, Table, read_table
from resgrid.spice.networks.graphs import read_graph
from resgrid.spice.parsed import KINDS, ParsedDeck


def read_network(
    path: str | os.PathLike[str],
    *,
    measure: Measure | None = None,
    sources: str | os.PathLike[str] | None = None,
    grounds: str | os.PathLike[str] | None = None,
    ground_measure: Measure = "resistance",
    root: str | os.PathLike[str] | None = None,
) -> Netlist:
    """Read a resistor network from a list of edges, a Circuitscape configuration (``.ini``), or what `convert` writes.

    GraphML (``.graphml``), node-link ``.json`` and the arrays of an ``.npz`` hold whole netlists; any other file is a
    list of edges.  An edge is a line ``node node ohms`` (or siemens); a heading may say ``resistance`` or
    ``conductance``.

    Parameters
    ----------
    path : path-like
        The edges, a configuration in advanced mode, a graph, or arrays.
    measure : {"resistance", "conductance"}, optional
        What the number of an edge is; by default what a heading says, otherwise a resistance.
    sources : path-like, optional
        Lines ``node amperes``: currents fed into nodes.
    grounds : path-like, optional
        Lines ``node ohms`` (or siemens, by ``ground_measure``) to ground; 0 ohm holds the node at 0 V.
    ground_measure : {"resistance", "conductance"}
    root : path-like, optional
        Folder below which the files that a configuration names must lie; by default its own.

    Returns
    -------
    Netlist
        Ground is the node ``ground``; other nodes keep their names.

    Raises
    ------
    InputError
        If a file cannot be read or a value is not admissible; the message names file and line.
    """
    suffix = Path(path).suffix.lower()
    if suffix in (".ini", ".graphml", ".json", ".npz"):
        if measure is not None or sources is not None or grounds is not None:
            raise InputError(f"{os.fspath(path)} names its own sources, grounds and measure; leave those options out")
        return read_circuitscape(path, root=root).netlist if suffix == ".ini" else read_graph(path)
    table = read_table(path, 2, "edge")
    chosen = _measure(table, measure)
    network = NetworkParts.of_edges(table, chosen)
    if sources is not None:
        network.feed(read_table(sources, 1, "source"))
    if grounds is not None:
        network.ground(read_table(grounds, 1, "ground"), _known(ground_measure))
    return network.netlist()


def network_deck(path: str | os.PathLike[str], *, root: str | os.PathLike[str] | None = None) -> ParsedDeck:
    """A network's file as if it were a deck."""
    network = read_network(path, root=root)
    sizes = (network.conductance, network.source_volts, network.current_amps, network.capacitance)
    counts = dict(zip(KINDS, map(len, sizes), strict=True))
    names = dict(network.element_names or {})
    for kind, count in counts.items():
        known = names.get(kind, ())
        names[kind] = (*known, *(f"{kind[0]}{number}" for number in range(len(known) + 1, count + 1)))
    given = network.replace(element_names=names)
    return ParsedDeck(
        title=None,
        path=os.fspath(path),
        dialect="network",
        node_names=tuple(given.names_of(np.arange(given.node_count))),
        resistor_nodes=given.resistor_nodes,
        resistance=1.0 / given.conductance,
        source_nodes=given.source_nodes,
        source_volts=given.source_volts,
        current_nodes=given.current_nodes,
        current_amps=given.current_amps,
        capacitor_nodes=given.capacitor_nodes,
        capacitance=given.capacitance,
        element_names=names,
        place={kind: np.zeros((count, 2), dtype=np.int64) for kind, count in counts.items()},
        files=(os.fspath(path),),
        given=given,
    )


def _measure(table: Table, measure: str | None) -> Measure:
    stated = next((known for known in MEASURES if known == table.measure), None)
    if measure is not None and stated is not None and measure != stated:
        raise InputError(f"{table.source}: its heading says {stated}, but measure={measure!r} was asked for")
    return _known(measure or stated or "resistance")


def _known(measure: str) -> Measure:
    if measure == "resistance":
        return "resistance"
    if measure == "conductance":
        return "conductance"
    raise InputError(f"measure = {measure!r} is unknown; it may be one of {', '.join(MEASURES)}")
