"""Names of nodes and elements that all simulators accept.

They are unique and consist of lower case letters, digits and underscores, with a letter first.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from resgrid.core.netlist import GROUND, Netlist
from resgrid.core.networkx_graphs import ELEMENTS
from resgrid.spice.dialects.record import GROUND_NAME, Dialect

INITIALS = {"voltage source": "v", "current source": "i", "resistor": "r", "nonlinear resistor": "b", "capacitor": "c"}
"""First letter of the names of each kind of element; the kinds have the order in which a deck lists them."""

_LEGAL = re.compile(r"[a-z][a-z0-9_]*")
_ALL_LEGAL = re.compile(r"(?:[a-z][a-z0-9_]*\n)*")
_ILLEGAL = re.compile(r"[^a-z0-9_]+")
_MAX_LENGTH = 200


def name_nodes(netlist: Netlist, dialect: Dialect, held: NDArray[np.bool_]) -> list[str]:
    """Return the deck's names of all nodes, node_count strings, empty for nodes that the deck omits.

    `dialect`: dialect of the deck, whose reserved names are avoided; `held` (node_count,): mask of the nodes in the
    deck.
    """
    nodes = np.flatnonzero(held)
    nodes = nodes[nodes != GROUND]
    given = netlist.names_of(nodes)
    if netlist.node_names is not None:
        given = legal_names(given, "n", dialect.reserved)
    names = [""] * netlist.node_count
    for node, name in zip(nodes.tolist(), given, strict=True):
        names[node] = name
    names[GROUND] = GROUND_NAME
    return names


def name_elements(netlist: Netlist, kind: str, numbers: NDArray[np.int64], node_names: Sequence[str]) -> list[str]:
    """Return the deck's names of n elements, made from the elements' names in the netlist.

    If the netlist does not name elements of this kind, the names are made from the names of both nodes. `kind`: kind of
    the elements, such as ``"resistor"``; `numbers` (n,): netlist indices of the elements; `node_names` (node_count,):
    deck names of all nodes.
    """
    initial = INITIALS[kind]
    given = (netlist.element_names or {}).get(kind)
    if given is not None:
        read = [given[number] for number in numbers.tolist()]
        return legal_names([name if name[:1].lower() == initial else f"{initial}_{name}" for name in read], initial)
    first, second = getattr(netlist, ELEMENTS[kind][0])[numbers].T
    if kind == "current source":
        first, second = np.where(second == GROUND, first, second), np.full(len(second), GROUND)
    place = [f"_{name.removeprefix('n_')}" for name in node_names]
    place[GROUND] = ""
    ends = zip(first.tolist(), second.tolist(), strict=True)
    return legal_names([f"{initial}{place[a]}{place[b]}" for a, b in ends], initial)


def legal_names(names: Sequence[str], initial: str, reserved: Iterable[str] = ()) -> list[str]:
    """Return one unique legal name for each of `names`, with as few changes as possible.

    A legal name has at most 200 lower case letters, digits and underscores, a letter first.  A legal name that is not
    reserved is kept at its first occurrence.  Other names are folded to lower case, illegal characters become ``_``,
    and a number is appended if the result is reserved or in use already.  `initial`: prefix of names that do not begin
    with a letter; `reserved`: names that may not be used.

    Examples
    --------
    >>> legal_names(["a", "A", "b 1", "7", "gnd"], "n", reserved=["gnd"])
    ['a', 'a_2', 'b_1', 'n_7', 'gnd_2']
    """
    taken = set(reserved)
    distinct = set(names)
    all_legal = _ALL_LEGAL.fullmatch("\n".join([*names, ""])) is not None
    if len(distinct) == len(names) and taken.isdisjoint(distinct) and all_legal:
        return list(names)
    legal: list[str] = []
    for name in names:
        is_legal = all_legal or (len(name) <= _MAX_LENGTH and _LEGAL.fullmatch(name) is not None)
        keeps = is_legal and name not in taken
        legal.append(name if keeps else "")
        if keeps:
            taken.add(name)
    counters: dict[str, int] = {}
    for i, name in enumerate(legal):
        if not name:
            base = _ILLEGAL.sub("_", names[i].lower())[:_MAX_LENGTH]
            base = base if _LEGAL.fullmatch(base) else f"{initial}_{base}"
            legal[i], number = base, counters.get(base, 2)
            while legal[i] in taken:
                legal[i], number = f"{base}_{number}", number + 1
            counters[base] = number
            taken.add(legal[i])
    return legal
