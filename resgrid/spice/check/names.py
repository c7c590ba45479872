"""Rules about names: those borne twice, and those that some simulator reads as something else."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from typing import NamedTuple

from resgrid.spice.check.violation import Violation
from resgrid.spice.circuit import LISTED, SHOWN, Circuit, Severity, some
from resgrid.spice.dialects import DIALECTS
from resgrid.spice.dialects.reading import ReadingRules


class _Trap(NamedTuple):
    """Names of nodes that a simulator misreads.

    `pattern`: matches the whole of such a name, case ignored; `severity`: names that are written are mapped, so nothing
    worse than a warning; `message, remedy`: what happens, and what to do; ``simulators`` are those that fall for it.
    """

    pattern: str
    severity: Severity
    message: str
    remedy: str
    misreads: Callable[[ReadingRules], bool] = lambda _: True


_TRAPS = (
    _Trap(
        r"gnd!?",
        "warning",
        "are other names of ground in {simulators}",
        "call the node otherwise",
        lambda rules: "gnd" in rules.grounds,
    ),
    _Trap(
        r".*[ \t(),=;'\"{}].*|",
        "warning",
        "hold characters that separate words in every dialect",
        "use letters, digits and underscores",
    ),
    _Trap(
        r".*\$.*",
        "warning",
        "hold a $, which begins a comment in {simulators}",
        "leave it out",
        lambda rules: rules.dollar_comments,
    ),
    _Trap(r".*[^ -~\t\n].*", "warning", "hold characters beyond ASCII, which few simulators read", "write ASCII"),
    _Trap(
        r".*[-+*/^%!&|<>~?@\[\]:].*",
        "info",
        "hold operators, so that v(...) of them is misread in expressions and measurements",
        "use letters, digits and underscores where you measure",
    ),
    _Trap(
        r"[0-9]+[A-Za-z_].*",
        "info",
        "begin with a digit but are no numbers, which {simulators} reads only escaped",
        "put a letter in front",
        lambda rules: rules.instances,
    ),
    _Trap(
        r"time|temper|temp|hertz", "info", "are variables of the simulator in expressions", "call the node otherwise"
    ),
)


def alike(circuit: Circuit) -> Iterator[Violation]:
    """Names that two elements bear, or two nodes of a netlist, or that differ in case only."""
    given = circuit.given
    nodes = {} if given is None else {"node": given.node_names or ()}
    for kind, names in {**nodes, **circuit.element_names}.items():
        folded = [name.lower() for name in names]
        if len(set(folded)) == len(folded):
            continue
        twice = [name for name, number in Counter(folded).items() if number > 1]
        if circuit.is_deck:
            second = folded.index(twice[0], folded.index(twice[0]) + 1)
            yield Violation(
                "error",
                "names",
                circuit.place_of(kind, second),
                f"{len(twice):,} {kind} names are given twice ({some(twice, len(twice))}); ngspice does not run such a "
                "deck, others keep one of the two",
                "rename the second",
            )
        else:
            yield Violation(
                "warning",
                "names",
                some(twice, len(twice)),
                f"{len(twice):,} {kind} names are shared or differ in case only, which simulators do not see",
                "decks number them apart (the sidecar holds the map); rename them to keep their names",
                tuple(twice[:LISTED]) if kind == "node" else (),
            )


def misread(circuit: Circuit) -> Iterator[Violation]:
    """Node names that some simulator takes for something else."""
    names = circuit.node_names if circuit.given is None else circuit.given.node_names
    if names is None or len(names) < 2:
        return
    text = "\n".join(name.replace("\n", " ") for name in names[1:])
    for trap in _TRAPS:
        pattern = re.compile(rf"^(?:{trap.pattern})$", re.MULTILINE | re.IGNORECASE)
        matches = [match.group() for match in pattern.finditer(text)]
        if matches:
            shown = some([repr(name) for name in matches[:SHOWN]], len(matches))
            yield Violation(
                trap.severity,
                "names",
                circuit.path,
                f"{len(matches):,} node names ({shown}) {trap.message.format(simulators=_simulators(trap))}",
                trap.remedy,
                tuple(matches[:LISTED]),
            )


def _simulators(trap: _Trap) -> str:
    labels = [item.label for item in DIALECTS.values() if item.reading is not None and trap.misreads(item.reading)]
    return " and ".join(filter(None, (", ".join(labels[:-1]), labels[-1])))
