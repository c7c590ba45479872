"""Rules about what is joined to what: ground, islands, loops of sources, loose ends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.netlist import GROUND
from resgrid.spice.check.violation import Severity, Violation
from resgrid.spice.subject import Subject

_TOLD = 10
_TOLERANCE = 1e-9


def ground(subject: Subject) -> Iterator[Violation]:
    """Nothing that conducts touches ground."""
    if not any((subject.ends[kind] == GROUND).any() for kind in ("resistor", "voltage source", "nonlinear resistor")):
        yield Violation(
            "error",
            "ground",
            "0" if subject.deck is None else subject.deck.path,
            "no resistor and no voltage source touches ground, so no voltage is defined",
            "tie one node to node 0 by a voltage source",
        )


def islands(subject: Subject) -> Iterator[Violation]:
    """Parts without a path to ground, those that capacitors hold told apart."""
    floating = np.flatnonzero(subject.part != subject.part[GROUND])
    if not floating.size:
        return
    held = _parts_at(subject, "capacitor")
    order = floating[np.argsort(subject.part[floating], kind="stable")]
    groups = np.split(order, np.flatnonzero(np.diff(subject.part[order])) + 1)
    if subject.deck is None:
        by_capacitor = held[subject.part[floating]]
        groups = [floating[~by_capacitor], floating[by_capacitor]]
    groups = sorted((group for group in groups if group.size), key=lambda group: -group.size)
    for group in groups[:_TOLD]:
        yield _island(subject, group, by_capacitor=bool(held[subject.part[group[0]]]))
    if len(groups) > _TOLD:
        rest = np.concatenate(groups[_TOLD:])
        yield _island(subject, rest, by_capacitor=False, what=f"{len(groups) - _TOLD:,} more parts, with ")


def _island(subject: Subject, nodes: NDArray[np.int64], *, by_capacitor: bool, what: str = "") -> Violation:
    many = nodes.size > 1
    subject_text = f"{what}{nodes.size:,} node{'s' if many else ''}"
    names = f" ({subject.told(nodes)})" if subject.deck is not None else ""
    verb = "have" if many else "has"
    if by_capacitor:
        message = f"{subject_text}{names} {'are' if many else 'is'} held by capacitors only, which are open"
    else:
        message = f"{subject_text}{names} {verb} no path of resistors or voltage sources to ground"
    return Violation(
        "error" if subject.deck is not None else "warning",
        "capacitor node" if by_capacitor else "floating",
        subject.place_of_nodes(nodes),
        message,
        "join it to the circuit by a resistor, or remove it: ngspice would answer wrongly everywhere"
        if subject.deck is not None
        else "they are left out of decks; join them to the circuit by a resistor if they belong to it",
        subject.listed(nodes),
    )


def trapped_currents(subject: Subject) -> Iterator[Violation]:
    """Current sources that feed a part which lets no current out."""
    trapped = trapped_sources(subject.ends["current source"], subject.amps, subject.part)
    if trapped.size:
        nodes = np.unique(subject.ends["current source"][trapped])
        one = trapped.size == 1
        yield Violation(
            "error",
            "trapped current",
            subject.place_of_element("current source", int(trapped[0])) if subject.deck else subject.told(nodes),
            f"{trapped.size:,} current source{'' if one else 's'} ({_elements(subject, 'current source', trapped)}) "
            f"feed{'s' if one else ''} a floating part, which lets no current out",
            "remove these sources, or join the part to ground",
            subject.listed(nodes),
        )


def trapped_sources(ends: NDArray[np.int32], amps: NDArray[np.float64], part: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers of the current sources, shapes (c, 2) and (c,), that join different parts."""
    parts = part[ends]
    return np.flatnonzero((parts[:, 0] != parts[:, 1]) & (amps != 0))


@dataclass(frozen=True, eq=False)
class Loops:
    """Elements that close loops of voltage sources; of those in a loop, inductors and then resistors of 0 ohm close it.

    `sources, inductors, shorts`: numbers of the voltage sources (inductors apart) and resistors that close consistent
    loops; `contradictions`: kind and number of those that contradict the others, and by how many volts.
    """

    sources: NDArray[np.int64]
    inductors: NDArray[np.int64]
    shorts: NDArray[np.int64]
    contradictions: tuple[tuple[str, int, float], ...]


def loops_of(subject: Subject) -> Loops:
    """Find the loops of voltage sources; resistors of 0 ohm count as sources of 0 V."""
    from resgrid.spice.kernels import left_over

    zero = np.flatnonzero(subject.resistance == 0)
    sources = len(subject.volts)
    order = np.argsort(subject.is_inductor, kind="stable")
    ends = np.concatenate([subject.ends["voltage source"][order], subject.ends["resistor"][zero]])
    volts = np.concatenate([subject.volts[order], np.zeros(len(zero))])
    rest = left_over(ends, volts, subject.node_count) if len(ends) else np.empty(0)
    number = np.concatenate([order, zero])
    closing = ~np.isnan(rest)
    with np.errstate(invalid="ignore"):
        bad = closing & (np.abs(rest) > _TOLERANCE * np.max(np.abs(volts), initial=0.0))
    place = np.flatnonzero(closing & ~bad)
    own, short = number[place[place < sources]], number[place[place >= sources]]
    is_inductor = subject.is_inductor[own]
    contradictions = tuple(
        ("voltage source" if i < sources else "resistor", int(number[i]), float(abs(rest[i])))
        for i in np.flatnonzero(bad).tolist()
    )
    return Loops(own[~is_inductor], own[is_inductor], short, contradictions)


def source_loops(subject: Subject) -> Iterator[Violation]:
    """Loops of voltage sources, contradictory or consistent; inductors and resistors of 0 ohm count as such."""
    loops = loops_of(subject)
    for kind, number, volts in loops.contradictions[:_TOLD]:
        yield _contradiction(subject, kind, number, volts)
    if loops.sources.size:
        severity: Severity = "error" if subject.deck is not None else "warning"
        yield _loop(subject, severity, "voltage source", "voltage sources close loops", loops.sources)
    if loops.inductors.size:
        yield _loop(subject, "warning", "voltage source", "inductors close loops of shorts", loops.inductors)
    if loops.shorts.size:
        yield _loop(subject, "warning", "resistor", "resistors of 0 ohm close loops of shorts", loops.shorts)


def _contradiction(subject: Subject, kind: str, element: int, volts: float) -> Violation:
    ends = subject.ends[kind][element]
    names = subject.names_of(ends)
    return Violation(
        "error",
        "voltage loop",
        subject.place_of_element(kind, element),
        f"{kind} {subject.element_name(kind, element)} between nodes {names[0]} and {names[1]} contradicts the other "
        f"sources by {volts:g} V",
        "remove one source of the loop, or put a resistor into it",
        tuple(names),
    )


def _loop(subject: Subject, severity: Severity, kind: str, what: str, closing: NDArray[np.int64]) -> Violation:
    nodes = np.unique(subject.ends[kind][closing])
    return Violation(
        severity,
        "voltage loop",
        subject.place_of_element(kind, int(closing[0])) if subject.deck is not None else subject.told(nodes),
        f"{closing.size:,} {what} ({_elements(subject, kind, closing)}), so the currents around them are undetermined",
        "remove them" if subject.deck is not None else "decks leave out the sources that close a loop",
        subject.listed(nodes),
    )


def shorted(subject: Subject) -> Iterator[Violation]:
    """Elements with both ends on one node."""
    for kind in ("resistor", "current source", "nonlinear resistor"):
        ends = subject.ends[kind]
        both = np.flatnonzero(ends[:, 0] == ends[:, 1])
        if both.size:
            nodes = np.unique(ends[both])
            yield Violation(
                "warning",
                f"shorted {kind}",
                subject.place_of_element(kind, int(both[0])) if subject.deck is not None else subject.told(nodes),
                f"{both.size:,} {kind}s have both ends on one node ({_elements(subject, kind, both)}) and do nothing",
                "remove them",
                subject.listed(nodes),
            )


def dangling(subject: Subject) -> Iterator[Violation]:
    """Nodes with a single element, which carry no current."""
    loose = subject.degree == 1
    loose[GROUND] = False
    loose &= subject.part == subject.part[GROUND]
    nodes = np.flatnonzero(loose)
    if nodes.size:
        yield Violation(
            "info",
            "dangling",
            subject.place_of_nodes(nodes[:1]) if subject.deck is not None else subject.place_of_nodes(nodes),
            f"{nodes.size:,} nodes ({subject.told(nodes)}) have one element only, which carries no current",
            "nothing to do if they are probes or dead ends",
            subject.listed(nodes),
        )


def _parts_at(subject: Subject, kind: str) -> NDArray[np.bool_]:
    """Which parts an element of a kind touches, shape (parts,)."""
    touched = np.zeros(int(subject.part.max()) + 1, dtype=np.bool_)
    touched[subject.part[subject.ends[kind].ravel()]] = True
    return touched


def _elements(subject: Subject, kind: str, numbers: NDArray[np.int64]) -> str:
    shown = ", ".join(subject.element_name(kind, number) for number in numbers[:5].tolist())
    return shown if numbers.size <= 5 else f"{shown} and {numbers.size - 5:,} more"
