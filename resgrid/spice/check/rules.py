"""The electrical rule check: what makes a circuit unfit for a deck, or a simulator stumble.

Each rule is a function from a `Circuit` to violations, in time proportional to the number of elements.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from resgrid.netlist import Netlist
from resgrid.spice.check import connection, names, values
from resgrid.spice.check.violation import SEVERITIES, Violation
from resgrid.spice.circuit import Circuit


def check_rules(circuit: Netlist | Circuit) -> tuple[Violation, ...]:
    """Check a netlist, or a deck as it was written, against the electrical rules.

    Parameters
    ----------
    circuit : Netlist or Circuit
        From `compile_space`, plain arrays, or `read_spice`.

    Returns
    -------
    tuple of Violation
        Errors first, then warnings, then what is merely worth knowing; empty if nothing was found.

    Examples
    --------
    >>> circuit = rg.Netlist(3, [[1, 0]], [1.0], source_nodes=[[1, 0]], source_volts=[1.0])
    >>> rg.check_rules(circuit)[0].message
    '1 node has no path of resistors or voltage sources to ground'
    """
    subject = Circuit.of(circuit)
    violations = [violation for rule in RULES for violation in rule(subject)]
    return tuple(sorted(violations, key=lambda violation: SEVERITIES.index(violation.severity)))


def _notes(circuit: Circuit) -> Iterator[Violation]:
    """What the reader of a deck noted."""
    for note in circuit.notes:
        remedy = "see whether this was meant" if note.severity != "info" else "nothing to do"
        yield Violation(note.severity, "reading", note.place, note.text, remedy)


RULES: tuple[Callable[[Circuit], Iterator[Violation]], ...] = (
    connection.ground,
    connection.islands,
    connection.trapped_currents,
    connection.source_loops,
    values.limits,
    values.spread,
    connection.shorted,
    names.alike,
    names.misread,
    connection.dangling,
    _notes,
)
"""Every rule, in the order in which violations of equal severity are told."""
