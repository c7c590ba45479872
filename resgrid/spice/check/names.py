"""Rules about names: those borne twice, and those that some simulator reads as something else."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from resgrid.spice.check.violation import Severity, Violation
from resgrid.spice.subject import LISTED, SHOWN, Subject


@dataclass(frozen=True)
class Trap:
    """Names that a simulator misreads.

    `pattern`: regular expression that such a name matches, within one line; `severity`: in a netlist that is to be
    written; names are mapped there, so nothing worse; `message, remedy`: what happens, and what to do.
    """

    pattern: str
    severity: Severity
    message: str
    remedy: str


NODE_TRAPS = (
    Trap(r"gnd!?", "warning", "are other names of ground in ngspice, LTspice and HSPICE", "call the node otherwise"),
    Trap(
        r".*[ \t(),=;'\"{}].*|",
        "warning",
        "hold characters that separate words in every dialect",
        "use letters, digits and underscores",
    ),
    Trap(r".*\$.*", "warning", "hold a $, which begins a comment in HSPICE and ngspice", "leave it out"),
    Trap(r".*[^ -~\t\n].*", "warning", "hold characters beyond ASCII, which few simulators read", "write ASCII"),
    Trap(
        r".*[-+*/^%!&|<>~?@\[\]:].*",
        "info",
        "hold operators, so that v(...) of them is misread in expressions and measurements",
        "use letters, digits and underscores where you measure",
    ),
    Trap(
        r"[0-9]+[A-Za-z_].*",
        "info",
        "begin with a digit but are no numbers, which Spectre reads only escaped",
        "put a letter in front",
    ),
    Trap(r"time|temper|temp|hertz", "info", "are variables of the simulator in expressions", "call the node otherwise"),
)
"""What makes a node's name dangerous, as data; full matches, case ignored."""


def alike(subject: Subject) -> Iterator[Violation]:
    """Names that two nodes or two elements bear, or that differ in case only."""
    if subject.deck is None:
        assert subject.netlist is not None
        nodes = {"node": subject.netlist.node_names or ()}
        elements: Mapping[str, Sequence[str]] = subject.netlist.element_names or {}
        yield from _alike(subject, {**nodes, **elements})
    else:
        yield from _alike(subject, subject.deck.element_names)


def _alike(subject: Subject, tables: Mapping[str, Sequence[str]]) -> Iterator[Violation]:
    for kind, names in tables.items():
        folded = [name.lower() for name in names]
        if len(set(folded)) == len(folded):
            continue
        twice = [name for name, number in Counter(folded).items() if number > 1]
        told = ", ".join(twice[:SHOWN]) + (f" and {len(twice) - SHOWN:,} more" if len(twice) > SHOWN else "")
        if subject.deck is None:
            yield Violation(
                "warning",
                "names",
                told,
                f"{len(twice):,} {kind} names are shared or differ in case only, which simulators do not see",
                "decks number them apart (the sidecar holds the map); rename them to keep their names",
                tuple(twice[:LISTED]) if kind == "node" else (),
            )
            continue
        second = folded.index(twice[0], folded.index(twice[0]) + 1)
        yield Violation(
            "error",
            "names",
            subject.place_of_element(kind, second),
            f"{len(twice):,} {kind} names are given twice ({told}); ngspice does not run such a deck, others keep one "
            "of the two",
            "rename the second",
        )


def misread(subject: Subject) -> Iterator[Violation]:
    """Node names that some simulator takes for something else."""
    names = subject.deck.node_names if subject.deck is not None else getattr(subject.netlist, "node_names", None)
    if not names:
        return
    text = "\n".join(name.replace("\n", " ") for name in names[1:])
    for trap in NODE_TRAPS:
        pattern = re.compile(rf"^(?:{trap.pattern})$", re.MULTILINE | re.IGNORECASE)
        found = [match.group() for match in pattern.finditer(text)] if len(names) > 1 else []
        if found:
            told = ", ".join(map(repr, found[:SHOWN]))
            more = f" and {len(found) - SHOWN:,} more" if len(found) > SHOWN else ""
            yield Violation(
                trap.severity,
                "names",
                "" if subject.deck is None else subject.deck.path,
                f"{len(found):,} node names ({told}{more}) {trap.message}",
                trap.remedy,
                tuple(found[:LISTED]),
            )
