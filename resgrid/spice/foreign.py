"""Decks that someone else wrote, held against a simulator: as they stand, where that is safe, otherwise as read."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from resgrid.errors import InputError
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.spice.expected import Expected, supply_of
from resgrid.spice.ngspice import refuse_commands
from resgrid.spice.parsed import ParsedDeck, ngspice_name
from resgrid.spice.subject import subject_of

_ANALYSIS = re.compile(
    rb"\.(?:op|tran|ac|dc|noise|tf|pz|sens|disto|four|fourier|meas|measure|print|plot|probe|save|step|sp|pss|end)\b",
    re.IGNORECASE,
)


@dataclass(frozen=True, eq=False)
class Runnable:
    """What a simulator is given for someone else's deck.

    Attributes
    ----------
    data : bytes
        With one analysis, the operating point.
    as_written : bool
        Whether it is the deck itself; otherwise it is what was read, written anew and flat.
    why : str
        Why not, empty if it is.
    """

    data: bytes
    as_written: bool
    why: str


def runnable(deck: ParsedDeck, data: bytes) -> Runnable:
    """Make a deck safe to run, with its operating point as the only analysis.

    Parameters
    ----------
    deck : ParsedDeck
    data : bytes
        The content of its file.

    Returns
    -------
    Runnable
    """
    why = _why_not(deck, data)
    if why:
        from resgrid.spice.deck import format_deck

        text = format_deck(deck.netlist(), title=f"{deck.title or deck.path}, as read")
        return Runnable(_only_operating_point(text.encode("ascii")), False, why)
    return Runnable(_only_operating_point(data), True, "")


def _why_not(deck: ParsedDeck, data: bytes) -> str:
    if deck.dialect != "ngspice":
        return f"it is written for {deck.dialect}"
    if len(deck.files) > 1:
        return "it includes other files"
    try:
        refuse_commands(data, deck.path, models=True)
    except InputError as error:
        return str(error)
    return ""


def _only_operating_point(data: bytes) -> bytes:
    """Every analysis and output is left out, the first line, the title, never."""
    rows = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
    kept = [rows[0] if rows[0].strip() else b"* untitled"]
    dropping = False
    for row in rows[1:]:
        word = row.lstrip()
        if word.startswith(b"+"):
            if not dropping:
                kept.append(row)
            continue
        if word and not word.startswith(b"*"):
            dropping = _ANALYSIS.match(word) is not None
        if not (dropping and word):
            kept.append(row)
    return b"\n".join([*kept, b".options klu", b".op", b".end", b""])


def expected_of(deck: ParsedDeck, point: OperatingPoint, *, as_written: bool) -> Expected:
    """What a simulator should find in a deck, by the names it gives; as `expect` otherwise.

    Parameters
    ----------
    deck : ParsedDeck
    point : OperatingPoint
        Of ``deck.netlist()``.
    as_written : bool
        Whether the simulator is given the deck itself.

    Returns
    -------
    Expected
        Nodes that float are left out.
    """
    from resgrid.spice.deck import flatten
    from resgrid.spice.expected import expect

    if not as_written:
        return expect(flatten(point.netlist), point)
    nodes = np.flatnonzero(np.isfinite(point.voltage))[1:]
    voltage = {deck.node_names[node].lower(): float(point.voltage[node]) for node in nodes.tolist()}
    amps = point.source_current[: len(deck.source_volts)]
    names = map(ngspice_name, deck.element_names["voltage source"])
    supply = supply_of(point)
    largest = float(np.max(np.abs(point.source_current[np.isfinite(point.source_current)]), initial=0.0))
    return Expected(
        voltage=voltage,
        source_current={n: float(a) if np.isfinite(a) else None for n, a in zip(names, amps.tolist(), strict=True)},
        supply=supply,
        current_scale=max(largest, supply * float(np.max(point.netlist.conductance, initial=0.0))),
        kcl_residual=point.kcl_residual if np.isfinite(point.kcl_residual) else 0.0,
    )


def places_of(deck: ParsedDeck, names: Iterator[str]) -> dict[str, str]:
    """Where some nodes, by their folded names, first occur in a deck."""
    wanted = set(names)
    subject = subject_of(deck)
    number = {name.lower(): i for i, name in enumerate(deck.node_names) if name.lower() in wanted}
    return {name: subject.place_of_nodes(np.array([node])) for name, node in number.items()}
