"""Writers of netlists as edge lists, graph files and array files; `resgrid.read_spice` reads all these files.

The files do not contain the cells of a space.  An edge list contains resistors only.
"""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

import numpy as np

from resgrid.core.netlist import Netlist
from resgrid.core.networkx_graphs import ELEMENTS
from resgrid.io.tables import FORMATS, write
from resgrid.spice.networks.edges import edges_text
from resgrid.spice.networks.graph_files import graphml, netlist_arrays, node_link

_VIEWS = {"edges": edges_text, "graph": graphml, "record": node_link, "arrays": netlist_arrays}
NETWORK_SUFFIXES = tuple(suffix for suffix, form in FORMATS.items() if form.view in _VIEWS)
"""Suffixes of the files to which `write_network` can write a netlist, such as ``.graphml``; not those of decks."""


def write_network(netlist: Netlist, file: str | os.PathLike[str]) -> Path:
    """Write a netlist as an edge list, a graph or arrays.  The file is written atomically.

    Parameters
    ----------
    netlist : Netlist
        Circuit to write.
    file : path-like
        ``.txt``: list of edges, two nodes and a resistance in ohms per line, resistors only; ``.graphml`` and
        node-link ``.json``: graphs with all elements; ``.npz``: arrays and names of the netlist.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the suffix is unknown, an edge list cannot represent a node's name, or the file cannot be written.

    Examples
    --------
    >>> divider = rg.Netlist(3, [[1, 2], [2, 0]], [1e-3, 1e-3], source_nodes=[[1, 0]], source_volts=[2.0])
    >>> rg.save(divider, "divider.txt").read_text().splitlines()
    ['node_1 node_2 1000.0', 'node_2 ground 1000.0']
    """
    return write(file, {view: partial(made, netlist) for view, made in _VIEWS.items()}, "a network")


def left_out(netlist: Netlist, file: str | os.PathLike[str]) -> dict[str, int]:
    """Return the numbers of elements of a netlist that a file of this name cannot represent, by kind of element.

    Only an edge list (``.txt``) leaves out elements, because it contains resistors only. A resistor with a temperature
    coefficient other than 0 counts as one element of the kind "temperature coefficient". Kinds that lose no element are
    omitted.
    """
    if FORMATS[Path(file).suffix.lower()].view != "edges":
        return {}
    counts = {kind: len(getattr(netlist, nodes)) for kind, (nodes, _) in ELEMENTS.items() if kind != "resistor"}
    tempered = [np.asarray(values) != 0 for values in (netlist.tc1, netlist.tc2) if values is not None]
    counts["temperature coefficient"] = int(np.any(tempered, axis=0).sum()) if tempered else 0
    return {kind: count for kind, count in counts.items() if count}
