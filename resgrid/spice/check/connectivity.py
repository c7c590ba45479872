"""Electrical rules on connectivity: ground, floating nodes, trapped currents, source loops, shorted and dangling ends.

A floating node has no path of resistors, nonlinear resistors or voltage sources to ground.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.sources import contradictions, tie_sources
from resgrid.core.netlist import GROUND, Netlist
from resgrid.spice.circuit import CONDUCTING, SHOWN, Circuit, some
from resgrid.spice.findings import Severity, Violation

_MOST = 10
"""Maximum number of violations about floating components of a deck, and of violations about contradictory loops.

All further floating components have one more violation together; further contradictory loops are not reported.
"""


def ground(circuit: Circuit) -> Iterator[Violation]:
    """Yield a violation of severity "error" if no resistor, nonlinear resistor or voltage source touches ground."""
    if not any((circuit.ends[kind] == GROUND).any() for kind in CONDUCTING):
        yield Violation(
            "error",
            "ground",
            "0" if not circuit.is_deck else circuit.path,
            "no resistor and no voltage source touches ground, so no voltage is defined",
            "tie one node to node 0 by a voltage source",
        )


def islands(circuit: Circuit) -> Iterator[Violation]:
    """Yield a violation for each floating component, which no resistor or voltage source connects to ground.

    The violation is an error in a deck, and a warning for a netlist, because written decks omit floating nodes.  In a
    deck, the 10 largest components have one violation each, and all others have one violation together.  For a netlist
    there are at most two violations: one for floating nodes in components that a capacitor touches, one for the others.
    """
    floating = np.flatnonzero(circuit.is_floating)
    if not floating.size:
        return
    held = np.zeros(int(circuit.part.max()) + 1, dtype=np.bool_)  # parts that capacitors touch
    held[circuit.part[circuit.ends["capacitor"].ravel()]] = True
    order = floating[np.argsort(circuit.part[floating], kind="stable")]
    groups = np.split(order, np.flatnonzero(np.diff(circuit.part[order])) + 1)
    if not circuit.is_deck:
        by_capacitor = held[circuit.part[floating]]
        groups = [floating[~by_capacitor], floating[by_capacitor]]
    groups = sorted((group for group in groups if group.size), key=lambda group: -group.size)
    for group in groups[:_MOST]:
        yield _floating_violation(circuit, group, by_capacitor=bool(held[circuit.part[group[0]]]))
    if len(groups) > _MOST:
        rest = np.concatenate(groups[_MOST:])
        yield _floating_violation(
            circuit, rest, by_capacitor=False, heading=f"{len(groups) - _MOST:,} more parts, with "
        )


def _floating_violation(
    circuit: Circuit, nodes: NDArray[np.int64], *, by_capacitor: bool, heading: str = ""
) -> Violation:
    """Return the violation for floating nodes, an error in a deck and a warning in a netlist.

    `nodes` (n,): node numbers; `by_capacitor`: whether a capacitor touches the component of these nodes, so that the
    rule is "capacitor node" and not "floating"; `heading`: text before the number of nodes in the message.
    """
    many = nodes.size > 1
    names = f" ({circuit.shown(nodes)})" if circuit.is_deck else ""
    if by_capacitor:
        state = f"{'are' if many else 'is'} held by capacitors only, which are open at direct current"
    else:
        state = f"{'have' if many else 'has'} no path of resistors or voltage sources to ground"
    return Violation(
        "error" if circuit.is_deck else "warning",
        "capacitor node" if by_capacitor else "floating",
        circuit.place_of_nodes(nodes),
        f"{heading}{nodes.size:,} node{'s' if many else ''}{names} {state}",
        "join it to the circuit by a resistor, or remove it: with it ngspice computes wrong voltages at all nodes"
        if circuit.is_deck
        else "they are left out of decks; join them to the circuit by a resistor if they belong to it",
        circuit.listed(nodes),
    )


def _element_violation(
    circuit: Circuit, severity: Severity, rule: str, kind: str, numbers: NDArray[np.int64], message: str, remedy: str
) -> Violation:
    """Return one violation about several elements of one kind.

    `severity`: "error", "warning" or "info"; `rule`: name of the violated rule; `kind`: kind of the elements, such as
    "resistor"; `numbers` (n,): indices of the elements; `message`: template with the fields ``count`` (number of
    elements), ``s`` (plural ending) and ``names`` (of the first 5 elements); `remedy`: the correction.
    """
    nodes = np.unique(circuit.ends[kind][numbers])
    names = some([circuit.element_name(kind, number) for number in numbers[:SHOWN].tolist()], numbers.size)
    place = circuit.place_of(kind, int(numbers[0])) if circuit.is_deck else circuit.shown(nodes)
    message = message.format(count=f"{numbers.size:,}", s="" if numbers.size == 1 else "s", names=names)
    return Violation(severity, rule, place, message, remedy, circuit.listed(nodes))


def trapped_currents(circuit: Circuit) -> Iterator[Violation]:
    """Yield one violation of severity "error" about all current sources that drive a floating component.

    Such a source connects a component without a conducting path to ground with another component, so that its current
    has no return path.
    """
    trapped = circuit.trapped_sources
    if trapped.size:
        drive = "drives" if trapped.size == 1 else "drive"
        message = f"{{count}} current source{{s}} ({{names}}) {drive} a floating part, which has no return path"
        remedy = "remove these sources, or join the part to ground by a resistor"
        yield _element_violation(circuit, "error", "trapped current", "current source", trapped, message, remedy)


@dataclass(frozen=True, eq=False)
class Loops:
    """Elements that close loops of voltage sources, inductors (0 V) and resistors of 0 ohm.

    Elements are added to a spanning forest one by one: voltage sources first, then inductors, then resistors.  An
    element closes a loop if earlier elements connect its nodes already.

    `sources, inductors, shorts`: indices of the voltage sources, the inductors (indices of voltage sources, too) and
    the resistors that close a loop with a voltage sum of zero; `contradictions`: a tuple for each element that closes a
    loop with another voltage sum: kind ("voltage source" or "resistor"), index, and magnitude of this sum in volts.
    """

    sources: NDArray[np.int64]
    inductors: NDArray[np.int64]
    shorts: NDArray[np.int64]
    contradictions: tuple[tuple[str, int, float], ...]


def loops_of(circuit: Circuit) -> Loops:
    """Return the elements that close loops of voltage sources, where resistors of 0 ohm count as sources of 0 V."""
    zero = np.flatnonzero(circuit.resistance == 0)
    sources = len(circuit.source_volts)
    order = np.argsort(circuit.is_inductor, kind="stable")
    ends = np.concatenate([circuit.source_nodes[order], circuit.resistor_nodes[zero]])
    volts = np.concatenate([circuit.source_volts[order], np.zeros(len(zero))])
    rest, closing, bad = loop_voltages(ends, volts, circuit.node_count)
    number = np.concatenate([order, zero])
    place = np.flatnonzero(closing & ~bad)
    own, short = number[place[place < sources]], number[place[place >= sources]]
    is_inductor = circuit.is_inductor[own]
    contradicting = tuple(
        ("voltage source" if i < sources else "resistor", int(number[i]), float(rest[i]))
        for i in np.flatnonzero(bad).tolist()
    )
    return Loops(own[~is_inductor], own[is_inductor], short, contradicting)


def loop_voltages(
    ends: NDArray[np.int32], volts: NDArray[np.float64], node_count: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the mismatch of every voltage source, the mask of sources that close loops, and that of contradictions.

    A source is added to a spanning forest, in the order of the sources, unless earlier sources connect its nodes
    already; then the source closes a loop.  The mismatch is the magnitude of the difference between the voltage of the
    source and the voltage between its nodes in the forest, in volts.  A source that closes a loop contradicts the other
    sources if its mismatch exceeds 1e-12 of the largest source voltage in the loop.  `ends` (sources, 2): plus and
    minus nodes; `volts` (sources,): voltages; `node_count`: number of nodes.  All results have the shape (sources,).
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import minimum_spanning_tree

    low, high = np.sort(ends.astype(np.int64), axis=1).T
    _, firsts = np.unique(low * node_count + high, return_index=True)  # of parallel sources
    firsts = firsts[low[firsts] != high[firsts]]
    rank = coo_array((firsts + 1.0, (low[firsts], high[firsts])), shape=(node_count, node_count))
    tree = minimum_spanning_tree(rank.tocsr()).data.astype(np.int64) - 1  # earlier sources first
    no_resistors = np.empty((0, 2), dtype=np.int32), np.empty(0)
    forest = tie_sources(Netlist(node_count, *no_resistors, source_nodes=ends[tree], source_volts=volts[tree]))
    rest, bad = contradictions(forest, volts[tree], ends, volts)
    closing = np.ones(len(volts), dtype=np.bool_)
    closing[tree] = False
    return rest, closing, closing & bad


def source_loops(circuit: Circuit) -> Iterator[Violation]:
    """Yield violations for loops of voltage sources, inductors and resistors of 0 ohm, contradictory ones first.

    A loop is contradictory if its voltages do not sum to zero.  The first 10 contradictory loops have an error each.
    Other loops leave the currents around them undetermined, with one violation for each kind of element that closes
    them: an error for voltage sources in a deck; a warning for voltage sources in a netlist, inductors and resistors.
    """
    loops = loops_of(circuit)
    for kind, number, volts in loops.contradictions[:_MOST]:
        names = circuit.names_of(circuit.ends[kind][number])
        yield Violation(
            "error",
            "voltage loop",
            circuit.place_of(kind, number),
            f"{kind} {circuit.element_name(kind, number)} between nodes {names[0]} and {names[1]} contradicts the "
            f"other sources by {volts:g} V",
            "remove one source of the loop, or put a resistor into it",
            tuple(names),
        )
    remedy = "remove them" if circuit.is_deck else "decks leave out the sources that close a loop"
    closing: tuple[tuple[Severity, str, str, NDArray[np.int64]], ...] = (
        ("error" if circuit.is_deck else "warning", "voltage source", "voltage sources close loops", loops.sources),
        ("warning", "voltage source", "inductors close loops of shorts", loops.inductors),
        ("warning", "resistor", "resistors of 0 ohm close loops of shorts", loops.shorts),
    )
    for severity, kind, problem, numbers in closing:
        if numbers.size:
            message = f"{{count}} {problem} ({{names}}), so the currents around the loops are undetermined"
            yield _element_violation(circuit, severity, "voltage loop", kind, numbers, message, remedy)


def shorted(circuit: Circuit) -> Iterator[Violation]:
    """Yield a warning for each kind of element if elements of this kind have both ends at one node.

    Such elements have no effect.  The kinds are resistor, current source and nonlinear resistor.
    """
    for kind in ("resistor", "current source", "nonlinear resistor"):
        both = np.flatnonzero(circuit.ends[kind][:, 0] == circuit.ends[kind][:, 1])
        if both.size:
            message = f"{{count}} {kind}s have both ends on one node ({{names}}) and have no effect"
            yield _element_violation(circuit, "warning", f"shorted {kind}", kind, both, message, "remove them")


def dangling(circuit: Circuit) -> Iterator[Violation]:
    """Yield one violation of severity "info" about all nodes with only one element, which carries no current.

    Ground, and nodes without a conducting path to ground, are not among these nodes.
    """
    loose = (circuit.degree == 1) & ~circuit.is_floating
    nodes = np.flatnonzero(loose[1:]) + 1  # ground may be touched once
    if nodes.size:
        yield Violation(
            "info",
            "dangling",
            circuit.place_of_nodes(nodes[:1] if circuit.is_deck else nodes),
            f"{nodes.size:,} nodes ({circuit.shown(nodes)}) have one element only, which carries no current",
            "nothing to do if they are probes or dead ends",
            circuit.listed(nodes),
        )
