"""The electrical rule check: what makes a circuit unfit for a deck, or a simulator stumble.

Each rule is a function from a `Subject` to findings; `RULES` lists them.  Every rule takes time in proportion to the
number of elements.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid.netlist import Netlist
from resgrid.spice.check import connection, names, values
from resgrid.spice.check.violation import SEVERITIES, Violation
from resgrid.spice.subject import Subject, subject_of

if TYPE_CHECKING:
    from resgrid.spice.parsed import ParsedDeck

__all__ = [
    "RULES",
    "Violation",
    "check_rules",
    "connected_parts",
    "trapped_current_sources",
]


def check_rules(circuit: Netlist | ParsedDeck) -> tuple[Violation, ...]:
    """Check a netlist, or a deck as it was written, against the electrical rules.

    Parameters
    ----------
    circuit : Netlist or ParsedDeck
        From `compile_space`, plain arrays, or `read_spice`.

    Returns
    -------
    tuple of Violation
        Errors first, then warnings, then what is merely worth knowing; empty if nothing was found.

    Examples
    --------
    >>> from resgrid.netlist import Netlist
    >>> check_rules(Netlist(3, [[1, 0]], [1.0], source_nodes=[[1, 0]], source_volts=[1.0]))[0].message
    '1 node has no path of resistors or voltage sources to ground'
    """
    subject = subject_of(circuit)
    found = [finding for rule in RULES for finding in rule(subject)]
    return tuple(sorted(found, key=lambda finding: SEVERITIES.index(finding.severity)))


def connected_parts(netlist: Netlist) -> NDArray[np.int64]:
    """Number of the part each node belongs to: nodes joined by resistors and voltage sources.

    Returns (node_count,).
    """
    return subject_of(netlist).part


def trapped_current_sources(netlist: Netlist, part: NDArray[np.int64]) -> NDArray[np.int64]:
    """Current sources that drive a floating part from outside of it, so that their current cannot return.

    Shapes: `part` (node_count,).
    """
    return connection.trapped_sources(netlist.current_nodes, netlist.current_amps, part)


def _notes(subject: Subject) -> Iterator[Violation]:
    """What the reader of a deck noted."""
    if subject.deck is None:
        return
    for note in subject.deck.notes:
        column = f":{note.column}" if note.column else ""
        remedy = "see whether this was meant" if note.severity != "info" else "nothing to do"
        yield Violation(note.severity, "reading", f"{note.file}:{note.line}{column}", note.text, remedy)


RULES: tuple[Callable[[Subject], Iterator[Violation]], ...] = (
    connection.ground,
    connection.islands,
    connection.trapped_currents,
    connection.source_loops,
    values.negative,
    values.zero,
    values.overflow,
    values.spread,
    values.extremes,
    connection.shorted,
    names.alike,
    names.misread,
    connection.dangling,
    _notes,
)
"""Every rule, in the order in which findings of equal severity are told."""
