"""The electrical rule check: what makes a netlist unfit for a deck, or a simulator stumble."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import CircuitError
from resgrid.netlist import GROUND, Netlist

_WIDEST_RANGE = 1e15
_SHOWN = 5


@dataclass(frozen=True)
class Finding:
    """One violation of an electrical rule.

    Attributes
    ----------
    severity : {"error", "warning"}
        An error keeps the netlist from having an operating point or a deck.
    rule : str
        Short name of the rule.
    place : str
        Nodes or elements concerned.
    message : str
        What is wrong.
    remedy : str
        What to do.
    """

    severity: Literal["error", "warning"]
    rule: str
    place: str
    message: str
    remedy: str


def check_rules(netlist: Netlist) -> list[Finding]:
    """Check a netlist against the electrical rules.

    Parameters
    ----------
    netlist : Netlist

    Returns
    -------
    list of Finding
        Errors first; empty if nothing is wrong.
    """
    part = connected_parts(netlist)
    findings = [
        *_ground(netlist),
        *_floating(netlist, part),
        *_trapped_currents(netlist, part),
        *_source_loops(netlist),
        *_values(netlist),
        *_shorted(netlist),
        *_alike_names(netlist),
    ]
    return sorted(findings, key=lambda finding: finding.severity)


def connected_parts(netlist: Netlist) -> NDArray[np.int64]:
    """Number of the part each node belongs to: nodes joined by resistors and voltage sources.

    Parameters
    ----------
    netlist : Netlist

    Returns
    -------
    ndarray of int64, shape (node_count,)
        Nodes whose number differs from ground's float.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    first, second = np.concatenate([netlist.resistor_nodes, netlist.source_nodes]).T
    joined = coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(netlist.node_count,) * 2)
    return np.asarray(connected_components(joined, directed=False)[1], dtype=np.int64)


def trapped_current_sources(netlist: Netlist, part: NDArray[np.int64]) -> NDArray[np.int64]:
    """Current sources that drive a floating part from outside of it, so that their current cannot return.

    Parameters
    ----------
    netlist : Netlist
    part : ndarray of int64, shape (node_count,)
        From `connected_parts`.

    Returns
    -------
    ndarray of int64
        Numbers of the current sources.
    """
    ends = part[netlist.current_nodes]
    return np.flatnonzero((ends[:, 0] != ends[:, 1]) & (netlist.current_amps != 0))


def _ground(netlist: Netlist) -> Iterator[Finding]:
    if not (netlist.resistor_nodes == GROUND).any() and not (netlist.source_nodes == GROUND).any():
        yield Finding(
            "error",
            "ground",
            "0",
            "no resistor and no voltage source touches ground, so no voltage is defined",
            "tie one node to node 0 by a voltage source",
        )


def _floating(netlist: Netlist, part: NDArray[np.int64]) -> Iterator[Finding]:
    floating = np.flatnonzero(part != part[GROUND])
    if floating.size:
        yield Finding(
            "warning",
            "floating",
            _list_nodes(netlist, floating),
            f"{floating.size} nodes have no path of resistors or voltage sources to ground",
            "they are left out of decks; join them to the circuit by a resistor if they belong to it",
        )


def _trapped_currents(netlist: Netlist, part: NDArray[np.int64]) -> Iterator[Finding]:
    trapped = trapped_current_sources(netlist, part)
    if trapped.size:
        yield Finding(
            "error",
            "trapped current",
            _list_nodes(netlist, np.unique(netlist.current_nodes[trapped])),
            f"{trapped.size} current sources feed a floating part, which lets no current out",
            "remove these sources, or join the part to ground",
        )


def _source_loops(netlist: Netlist) -> Iterator[Finding]:
    from resgrid.nodal.sources import tie_sources

    try:
        loop = tie_sources(netlist).loop
    except CircuitError as error:
        yield Finding("error", "voltage loop", "", str(error), "remove one source of the loop")
        return
    if loop.any():
        yield Finding(
            "warning",
            "voltage loop",
            _list_nodes(netlist, np.unique(netlist.source_nodes[loop])),
            f"{int(loop.sum())} voltage sources form loops, so their currents are undetermined",
            "decks leave out the sources that close a loop; remove them to read the others' currents",
        )


def _values(netlist: Netlist) -> Iterator[Finding]:
    if not netlist.conductance.size:
        return
    low, high = float(netlist.conductance.min()), float(netlist.conductance.max())
    weakest = _list_nodes(netlist, netlist.resistor_nodes[int(netlist.conductance.argmin())])
    with np.errstate(over="ignore"):
        if np.isinf(1 / np.float64(low)):
            yield Finding(
                "error",
                "value",
                weakest,
                f"the resistance of {low:g} S is beyond the largest number",
                "leave that resistor out: it is open",
            )
    if high / _WIDEST_RANGE > low:
        yield Finding(
            "warning",
            "value range",
            weakest,
            f"conductances run from {low:g} to {high:g} S; a simulator loses the small ones beside the large ones",
            "replace the largest by 0 V sources or leave the smallest out",
        )


def _shorted(netlist: Netlist) -> Iterator[Finding]:
    shorted = np.flatnonzero(netlist.resistor_nodes[:, 0] == netlist.resistor_nodes[:, 1])
    if shorted.size:
        yield Finding(
            "warning",
            "shorted resistor",
            _list_nodes(netlist, netlist.resistor_nodes[shorted, 0]),
            f"{shorted.size} resistors have both ends on one node and carry no current",
            "remove them",
        )


def _alike_names(netlist: Netlist) -> Iterator[Finding]:
    if netlist.node_names is None:
        return
    count = Counter(name.lower() for name in netlist.node_names)
    alike = [name for name, number in count.items() if number > 1]
    if alike:
        yield Finding(
            "warning",
            "names",
            ", ".join(alike[:_SHOWN]),
            f"{len(alike)} node names are shared or differ in case only, which simulators do not see",
            "decks number them apart (the sidecar holds the map); rename them to keep their names",
        )


def _list_nodes(netlist: Netlist, nodes: NDArray[np.int64]) -> str:
    shown = ", ".join(netlist.names_of(nodes[:_SHOWN]))
    return shown if nodes.size <= _SHOWN else f"{shown} and {nodes.size - _SHOWN} more"
