"""Resistor networks that are no decks: plain lists of edges, sources and grounds, or Circuitscape configurations."""

from __future__ import annotations

import os

from resgrid.errors import InputError
from resgrid.netlist import Netlist
from resgrid.spice.reader.circuitscape import read_circuitscape
from resgrid.spice.reader.edges import MEASURES, Measure, NetworkParts, Table, read_table


def read_network(
    path: str | os.PathLike[str],
    *,
    measure: Measure | None = None,
    sources: str | os.PathLike[str] | None = None,
    grounds: str | os.PathLike[str] | None = None,
    ground_measure: Measure = "resistance",
    root: str | os.PathLike[str] | None = None,
) -> Netlist:
    """Read a resistor network from a list of edges, or from a Circuitscape configuration (``.ini``).

    An edge is a line ``node node ohms`` (or siemens); a heading may say ``resistance`` or ``conductance``.

    Parameters
    ----------
    path : path-like
        The edges, or a configuration in advanced mode.
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
    if os.fspath(path).lower().endswith(".ini"):
        if measure is not None or sources is not None or grounds is not None:
            raise InputError(f"{os.fspath(path)} names its own sources, grounds and measure; leave those options out")
        return read_circuitscape(path, root=root).netlist
    table = read_table(path, 2, "edge")
    chosen = _measure(table, measure)
    network = NetworkParts.of_edges(table, chosen)
    if sources is not None:
        network.feed(read_table(sources, 1, "source"))
    if grounds is not None:
        network.ground(read_table(grounds, 1, "ground"), _known(ground_measure))
    return network.netlist()


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
