"""The electrical rule check (ERC): defects of a circuit with which a simulator fails or gives wrong results.

Each rule is a function from a `Circuit` to violations, in time proportional to the number of elements.  This module
applies all rules and holds the rules on values and names; `connectivity` holds the rules on connections.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.core.netlist import Netlist
from resgrid.spice.check import connectivity
from resgrid.spice.circuit import LISTED, SHOWN, Circuit, some
from resgrid.spice.dialects import DIALECTS
from resgrid.spice.dialects.record import ReadingRules
from resgrid.spice.findings import SEVERITIES, Note, Severity, Violation

WIDEST_SPREAD = 1e15
"""Largest ratio of two positive resistances in a circuit for which the rule check yields no warning.

Above this ratio, double precision no longer resolves the currents through the largest resistances.
"""

SMALLEST_SAFE, LARGEST_SAFE = 1e-5, 1e12
"""Smallest and largest nonzero resistance that every simulator takes as written and resolves, in ohms.

HSPICE raises resistances below the first limit to its option RESMIN.  Resistances above the second limit conduct less
than the 1e-12 S that a simulator may add from a node to ground.
"""


def check_erc(circuit: Netlist | Circuit) -> tuple[Violation, ...]:
    """Apply the electrical rule check (ERC) to a netlist, or to a deck as it was written.

    The rules concern ground, floating nodes, current sources without a return path, loops of voltage sources, extreme
    resistances, elements with both ends at one node, names, nodes with one element, and remarks of the deck reader.

    Parameters
    ----------
    circuit : Netlist or Circuit
        Netlist from `compile_space` or from arrays, or circuit from `read_spice`.

    Returns
    -------
    tuple of Violation
        Violations of severity ``"error"``, then ``"warning"``, then ``"info"``; empty if no rule is violated.

    Examples
    --------
    >>> circuit = rg.Netlist(3, [[1, 0]], [1.0], source_nodes=[[1, 0]], source_volts=[1.0])
    >>> rg.check_erc(circuit)[0].message
    '1 node has no path of resistors or voltage sources to ground'
    """
    subject = Circuit.of(circuit)
    violations = [violation for rule in RULES for violation in rule(subject)]
    return tuple(sorted(violations, key=lambda violation: SEVERITIES.index(violation.severity)))


class _Limit(NamedTuple):
    """A rule on the values of resistances.

    `severity`: severity of the violation; `rule`: name of the rule; `is_beyond`: function of resistances (n,) in ohms
    that returns the mask (n,) of those that violate the rule; `message`: template with the fields ``count`` (number of
    these resistances) and ``shown`` (names and values of the first 5); `remedy`: text that states the correction.
    """

    severity: Severity
    rule: str
    is_beyond: Callable[[NDArray[np.float64]], NDArray[np.bool_]]
    message: str
    remedy: str


def _overflows(ohms: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the mask (n,) of the resistances (n,), in ohms, that are infinite or have an infinite reciprocal."""
    with np.errstate(over="ignore", divide="ignore"):
        return np.asarray(np.isinf(ohms) | (np.isinf(1 / ohms) & (ohms != 0)))


_LIMITS = (
    _Limit(
        "error",
        "negative resistance",
        lambda ohms: ohms < 0,
        "{count} resistances are negative ({shown}): the circuit is active and cannot be solved as a resistor network",
        "correct the values",
    ),
    _Limit(
        "warning",
        "zero resistance",
        lambda ohms: ohms == 0,
        "{count} resistances are 0 ohm ({shown}): resgrid reads them as shorts, ngspice silently as 1 milliohm, "
        "HSPICE as its RESMIN",
        "write voltage sources of 0 V, or the intended resistance",
    ),
    _Limit(
        "error",
        "value",
        _overflows,
        "{count} resistances or their reciprocals exceed the largest double ({shown})",
        "omit a resistor that is too large: it is open; replace one that is too small by a voltage source of 0 V",
    ),
    _Limit(
        "info",
        "extreme value",
        lambda ohms: (ohms != 0) & (np.abs(ohms) < SMALLEST_SAFE),
        f"{{count}} resistances are below {SMALLEST_SAFE:g} ohm, which HSPICE raises to its RESMIN ({{shown}})",
        "set .option resmin there, or write voltage sources of 0 V",
    ),
    _Limit(
        "info",
        "extreme value",
        lambda ohms: (np.abs(ohms) > LARGEST_SAFE) & np.isfinite(ohms),
        f"{{count}} resistances are above {LARGEST_SAFE:g} ohm: they conduct less than the 1e-12 S (gmin, rshunt) that "
        "a simulator may add to a node ({shown})",
        "switch gmin and rshunt off, or omit the resistors",
    ),
)


def limits(circuit: Circuit) -> Iterator[Violation]:
    """Yield violations for resistances that a simulator cannot use or changes, one for each kind of violation.

    Negative resistances, and resistances that are infinite or have an infinite reciprocal, are errors; 0 ohm is a
    warning; nonzero resistances with a magnitude below 1e-5 ohm (`SMALLEST_SAFE`) or above 1e12 ohm (`LARGEST_SAFE`)
    have the severity "info".
    """
    for limit in _LIMITS:
        beyond = np.flatnonzero(limit.is_beyond(circuit.resistance))
        if beyond.size:
            named = [
                f"{circuit.element_name('resistor', number)} = {circuit.resistance[number]:g}"
                for number in beyond[:SHOWN].tolist()
            ]
            message = limit.message.format(count=f"{beyond.size:,}", shown=some(named, beyond.size))
            place = circuit.place_of("resistor", int(beyond[0]))
            yield Violation(limit.severity, limit.rule, place, message, limit.remedy)


def spread(circuit: Circuit) -> Iterator[Violation]:
    """Yield a warning if the largest positive resistance exceeds 1e15 (`WIDEST_SPREAD`) times the smallest one."""
    size = np.where(circuit.resistance > 0, circuit.resistance, np.nan)
    if np.isnan(size).all():
        return
    low, high = int(np.nanargmin(size)), int(np.nanargmax(size))
    if size[high] / WIDEST_SPREAD > size[low]:
        yield Violation(
            "warning",
            "value range",
            circuit.place_of("resistor", high),
            f"resistances run from {size[low]:g} ({circuit.element_name('resistor', low)}) to {size[high]:g} ohm "
            f"({circuit.element_name('resistor', high)}); rounding errors at the small ones exceed the currents of the "
            "large ones",
            "replace the smallest by voltage sources of 0 V, or omit the largest",
        )


class _Trap(NamedTuple):
    """A class of node names that some simulators misread.

    `pattern`: regular expression for the whole name, case ignored; `severity`: "warning" or "info", but not "error",
    because written decks rename such nodes; `message, remedy`: texts of the violation, where ``message`` may have the
    field ``simulators`` (their names); `misreads`: function of the reading rules of a dialect that returns whether its
    simulator misreads such names, by default always True.
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
        "choose another name for the node",
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
        "remove it from the name",
        lambda rules: rules.dollar_comments,
    ),
    _Trap(r".*[^ -~\t\n].*", "warning", "hold characters beyond ASCII, which few simulators read", "write ASCII"),
    _Trap(
        r".*[-+*/^%!&|<>~?@\[\]:].*",
        "info",
        "hold operators, so that v(...) of them is misread in expressions and measurements",
        "use letters, digits and underscores in names of measured nodes",
    ),
    _Trap(
        r"[0-9]+[A-Za-z_].*",
        "info",
        "begin with a digit but are not numbers, which {simulators} reads only when escaped",
        "put a letter in front",
        lambda rules: rules.instances,
    ),
    _Trap(
        r"time|temper|temp|hertz",
        "info",
        "are variables of the simulator in expressions",
        "choose another name for the node",
    ),
)


def name_clashes(circuit: Circuit) -> Iterator[Violation]:
    """Yield a violation for each kind of element in which two elements have the same name, regardless of case.

    Equal names of nodes are a violation, too, but only in a netlist: in a deck they mean one node.  The violation is an
    error in a deck, and a warning for a netlist, because written decks append numbers to the names.
    """
    nodes = {} if circuit.is_deck else {"node": circuit.node_names}
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
                "deck, other simulators keep one of the two",
                "rename the second",
            )
        else:
            yield Violation(
                "warning",
                "names",
                some(twice, len(twice)),
                f"{len(twice):,} {kind} names are shared or differ in case only, which simulators ignore",
                "decks append numbers to them (the sidecar holds the map); rename them to keep their names",
                tuple(twice[:LISTED]) if kind == "node" else (),
            )


def repeated_names(circuit: Circuit) -> tuple[Note, ...]:
    r"""Return one warning for every kind of element of which a deck has two with the same name, regardless of case.

    The note states whether the simulator of the deck's dialect fails at such names.  Without a deck there is no note.

    Examples
    --------
    >>> import io
    >>> deck = rg.read_spice(io.StringIO("title\nV1 a 0 1\nR1 a 0 1\nr1 a 0 1\n"))
    >>> print(repeated_names(deck)[0])
    <text>:4: 1 resistor names are given twice (r1); ngspice does not run such a deck; resgrid keeps all of them
    """
    own = DIALECTS.get(circuit.dialect)
    if own is None:
        return ()
    fails = own.quirks.duplicates == "fails"
    effect = f"{own.label} does not run such a deck" if fails else f"it is not known which of them {own.label} keeps"
    outcome: Literal["fails", "unsure"] = "fails" if fails else "unsure"
    notes = []
    for violation in name_clashes(circuit):
        file, _, line = violation.place.rpartition(":")
        text = f"{violation.message.partition(';')[0]}; {effect}; resgrid keeps all of them"
        notes.append(Note("warning", file, int(line), 0, text, outcome))
    return tuple(notes)


def misread_names(circuit: Circuit) -> Iterator[Violation]:
    """Yield a violation for each class of node names that some simulator misreads, such as names with ``$``.

    The severity is "warning" or "info", but not "error", because written decks rename such nodes.
    """
    if len(circuit.node_names) < 2:
        return
    text = "\n".join(name.replace("\n", " ") for name in circuit.node_names[1:])
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
    """Return the names of the simulators that misread the class `trap` of node names, as one text: ``A, B and C``."""
    labels = [item.label for item in DIALECTS.values() if trap.misreads(item.reading)]
    return " and ".join(filter(None, (", ".join(labels[:-1]), labels[-1])))


def _notes(circuit: Circuit) -> Iterator[Violation]:
    """Yield every note of the deck reader (`Circuit.notes`) as a violation of the rule "reading", with its severity."""
    for note in circuit.notes:
        remedy = "check whether this is intended" if note.severity != "info" else "nothing to do"
        yield Violation(note.severity, "reading", note.place, note.text, remedy)


RULES: tuple[Callable[[Circuit], Iterator[Violation]], ...] = (
    connectivity.ground,
    connectivity.islands,
    connectivity.trapped_currents,
    connectivity.source_loops,
    limits,
    spread,
    connectivity.shorted,
    name_clashes,
    misread_names,
    connectivity.dangling,
    _notes,
)
"""All rules, in the order in which violations of equal severity are reported."""
