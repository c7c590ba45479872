"""Will your simulator get it right?  The circuit as each simulator understands it, solved and compared.

Where a simulator changes a circuit (a shunt at every node, 1 milliohm for 0 ohm, a device taken for the title), the
changed circuit is solved too, and the largest difference is the error to expect.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.solve import solve
from resgrid.core.netlist import GROUND, Netlist, add_elements, select_elements
from resgrid.core.regions import label_components
from resgrid.errors import ResgridError
from resgrid.spice.check.connectivity import Loops, loops_of
from resgrid.spice.check.erc import check_rules
from resgrid.spice.check.rereading import first_difference, reread
from resgrid.spice.check.singular import singularity
from resgrid.spice.circuit import TOLERANCE, Circuit, Violation, rebase
from resgrid.spice.dialects import DIALECTS
from resgrid.spice.dialects.record import Basis, Dialect, Quirks
from resgrid.spice.read.numerals import Numeral, parse_numeral

Outcome = Literal["right", "wrong", "fails", "unsure"]
_Result = tuple[Outcome, float | None, str | None, tuple[str, ...]]

_LARGEST = 300_000
_SAFE_SPREAD = 1e12
_ROUNDING = 2.0**-52
_SHOWN = 3


@dataclass(frozen=True)
class Prediction:
    """Whether one simulator will find a deck's operating point.

    Attributes
    ----------
    simulator : str
    outcome : {"right", "wrong", "fails", "unsure"}
        ``"wrong"``: it answers, without an error, something else; ``"fails"``: it gives no answer.
    max_error : float or None
        Largest error of a node's voltage to expect, in volts; None where it was not computed.
    worst_node : str or None
        Where it occurs.
    reasons : tuple of str
        Why.
    basis : {"measured", "documented"}
        Whether the simulator was asked, or its manual.
    """

    simulator: str
    outcome: Outcome
    max_error: float | None
    worst_node: str | None
    reasons: tuple[str, ...]
    basis: Basis

    def __str__(self) -> str:
        size = f" by {self.max_error:.3g} V at {self.worst_node}" if self.max_error else ""
        why = f": {'; '.join(self.reasons)}" if self.reasons else ""
        known = "" if self.basis == "measured" else " (from its documentation, not run)"
        return f"{self.simulator}: {self.outcome}{size if self.outcome == 'wrong' else ''}{why}{known}"


@dataclass(frozen=True, eq=False)
class _Case:
    """A deck, places of names given twice, and its right answer (None where there is none, or it is too large)."""

    deck: Circuit
    duplicates: tuple[str, ...]
    loops: Loops
    voltage: NDArray[np.float64] | None


def predict_simulators(
    circuit: Netlist | Circuit, violations: tuple[Violation, ...] | None = None
) -> tuple[Prediction, ...]:
    """Say for every simulator whether it will find the right operating point.

    Parameters
    ----------
    circuit : Netlist or Circuit
        Of a deck the file is judged, as each simulator would read it; a netlist as the deck that resgrid writes of it.
    violations : tuple of Violation, optional
        From `check_rules`, if they are known.

    Returns
    -------
    tuple of Prediction
        One a simulator.  Errors are computed for up to 300,000 nodes; beyond, reasons are given without a number.

    Examples
    --------
    >>> divider = rg.Netlist(3, [[1, 2], [2, 0]], [1e-3, 1e-3], source_nodes=[[1, 0]], source_volts=[2.0])
    >>> for prediction in rg.predict_simulators(divider)[:2]:
    ...     print(prediction)
    ngspice: right
    ltspice: right (from its documentation, not run)
    """
    circuit = Circuit.of(circuit)
    errors = [item for item in violations or check_rules(circuit) if item.severity == "error"]
    if circuit.is_deck:
        case = _case_of(circuit, errors)
        outcomes = [_of_file(dialect, case) for dialect in DIALECTS.values()]
    else:
        outcomes = [_of_netlist(dialect.quirks, circuit.resistance, errors) for dialect in DIALECTS.values()]
    return tuple(
        Prediction(dialect.name, *what, dialect.quirks.basis)
        for dialect, what in zip(DIALECTS.values(), outcomes, strict=True)
    )


def _of_netlist(quirks: Quirks, resistance: NDArray[np.float64], errors: list[Violation]) -> _Result:
    """Our own decks leave out what simulators stumble over."""
    if errors:
        return "fails", None, None, (f"there is no deck to run: {errors[0].message}",)
    doubts = _spread_doubts(resistance)
    least = quirks.smallest_resistance
    if least and not quirks.raises_zero_only and resistance.min(initial=np.inf) < least:
        doubts += (f"it raises resistances to {least:g} ohm (RESMIN)",)
    return "unsure" if doubts else "right", None, None, doubts


def _of_file(dialect: Dialect, case: _Case) -> _Result:
    """Judge the file that a simulator would be given: how it reads it, then what it makes of the circuit."""
    label = dialect.label
    found = reread(case.deck, dialect)
    if found.circuit is None:
        if found.fails:
            return "fails", None, None, (found.why,)
        return "unsure", None, None, (f"this file is not read by the rules of {label}: {found.why}",)
    stops = [note for note in found.circuit.notes if note.outcome == "fails"]
    if stops:
        return "fails", None, None, tuple(str(note) for note in stops[:_SHOWN])
    if found.circuit is case.deck:
        outcome, error, worst, reasons = _of_deck(dialect.quirks, case)
    else:
        own = _case_of(found.circuit, check_rules(found.circuit))
        if own.voltage is not None and case.voltage is not None:
            difference = first_difference((case.deck, found.circuit), (case.voltage, own.voltage))
            if difference is not None:
                return "wrong", _finite(difference[1]), difference[0], (f"{label} reads another circuit in this file",)
        outcome, error, worst, reasons = _of_deck(dialect.quirks, own)
    doubts = tuple(str(note) for note in found.circuit.notes if note.outcome == "unsure")[:_SHOWN]
    if doubts and outcome == "right":
        outcome = "unsure"
    return outcome, error, worst, (*reasons, *doubts)


def _finite(volts: float) -> float | None:
    return volts if np.isfinite(volts) else None


def _case_of(deck: Circuit, violations: Iterable[Violation]) -> _Case:
    """Solve a deck once for all simulators."""
    duplicates = tuple(item.place for item in violations if item.severity == "error" and item.rule == "names")
    right = _voltages(deck.netlist) if deck.node_count <= _LARGEST else None
    return _Case(deck, duplicates, loops_of(deck), right)


def _of_deck(quirks: Quirks, case: _Case) -> _Result:
    fatal = [
        f"a loop of voltage sources leaves no answer ({case.deck.place_of('voltage source', number)})"
        for number in _failing_loops(quirks, case)[:1]
    ]
    if quirks.duplicates == "fails":
        fatal += [f"a name is given twice ({place})" for place in case.duplicates[:1]]
    if fatal:
        return "fails", None, None, tuple(fatal)
    lost = _lost_to_title(case.deck)
    resistance, raised = _raised(quirks, case.deck)
    siemens, shunts, shunt_doubts = _shunt(quirks, case)
    reasons = (*(f"the first line is taken for the title, so {name} is lost" for name in lost[:1]), *raised, *shunts)
    doubts = (*_doubts(quirks, case, resistance), *shunt_doubts)
    trapped = case.deck.trapped_sources
    if trapped.size:
        name = case.deck.element_name("current source", int(trapped[0]))
        text = f"{name} feeds a floating part, which lets no current out: no answer exists"
        if quirks.floating == "unknown":
            doubts += (text,)
        else:
            reasons += (text,)
    if not reasons:
        return "unsure" if doubts else "right", None, None, doubts
    got = None if case.voltage is None else _voltages(lambda: _simulated(case.deck, lost, resistance, siemens))
    if case.voltage is None or got is None:
        return "wrong", None, None, (*reasons, *doubts)
    names, error = case.deck.node_names, np.nan_to_num(np.abs(got - case.voltage), nan=0.0)
    cut_off = np.flatnonzero(np.isnan(got) & ~np.isnan(case.voltage))
    reasons += tuple(f"node {names[node]} is cut off" for node in cut_off[:1].tolist())
    worst = int(np.argmax(error))
    harmless = error[worst] <= TOLERANCE * np.nanmax(np.abs(case.voltage), initial=0.0) and not cut_off.size
    outcome: Outcome = "wrong" if not harmless else "unsure" if doubts else "right"
    return outcome, float(error[worst]), names[worst], (*reasons, *doubts)


def _failing_loops(quirks: Quirks, case: _Case) -> list[int]:
    """Voltage sources that close a loop which leaves no answer."""
    ends = case.deck.source_nodes
    closing = [int(number) for number in case.loops.sources]
    inductive = case.deck.is_inductor
    closing += [i for kind, i, _ in case.loops.contradictions if kind == "voltage source" and not inductive[i]]
    if quirks.loops == "fail at ground":
        tree = label_components(ends, case.deck.node_count)
        closing = [i for i in closing if tree[ends[i, 0]] == tree[GROUND] or ends[i, 0] == ends[i, 1]]
    return closing


def _doubts(quirks: Quirks, case: _Case, resistance: NDArray[np.float64]) -> tuple[str, ...]:
    """What speaks against an answer to a deck whose resistances a simulator takes so."""
    doubts = _spread_doubts(np.abs(case.deck.resistance)) or _drowned(case.deck, np.abs(resistance))
    answered = quirks.loops == "fail at ground"
    for kind, numbers in (("inductors", case.loops.inductors), ("voltage sources", case.loops.sources)):
        if not numbers.size:
            continue
        place = case.deck.place_of("voltage source", int(numbers[0]))
        what = "the answer is what a transient comes to, and may be anything" if answered else "it may fail"
        doubts += (f"a loop of {kind} ({place}): {what}",)
    if case.deck.is_floating.any() and quirks.floating == "unknown":
        doubts += ("it is not known here what it makes of floating nodes",)
    if quirks.smallest_resistance is None and (case.deck.resistance == 0).any():
        doubts += ("it is not known here what it makes of 0 ohm",)
    if (case.deck.resistance < 0).any():
        doubts += ("negative resistances cannot be checked here",)
    if quirks.duplicates == "unknown" and case.duplicates:
        doubts += ("it is not known here which of two elements of one name it keeps",)
    return doubts


def _drowned(deck: Circuit, size: NDArray[np.float64]) -> tuple[str, ...]:
    """Whether conductances drown in those beside them: groups of nodes tied together far more firmly than to the rest.

    The conductances that leave such a group are what is left of the sums on the diagonal of the matrix when those
    within it cancel, so that they are known to the rounding of the latter.
    """
    usable = (size > 0) & np.isfinite(size)
    size, ends = size[usable], deck.resistor_nodes[usable]
    if not size.size or size.max() <= size.min() * TOLERANCE / _ROUNDING:
        return ()
    worst = 0.0
    for decade in np.unique(np.ceil(np.log10(size))).tolist()[:-1]:
        firm = size <= 10.0**decade
        group = label_components(np.concatenate([ends[firm], deck.source_nodes]), deck.node_count)
        leaves = ~firm & (group[ends[:, 0]] != group[ends[:, 1]])
        leaving = np.bincount(group[ends[leaves]].ravel(), np.repeat(1 / size[leaves], 2), deck.node_count)
        within = np.zeros(deck.node_count)
        np.maximum.at(within, group[ends[firm, 0]], 1 / size[firm])
        held = leaving > 0
        held[group[GROUND]] = False
        worst = max(worst, float(np.max(within[held] / leaving[held], initial=0.0)))
    if worst * _ROUNDING <= TOLERANCE:
        return ()
    return (f"the smallest resistances drown the others: about {worst * _ROUNDING:.0e} of the voltage is lost",)


def _spread_doubts(resistance: NDArray[np.float64]) -> tuple[str, ...]:
    size = resistance[(resistance > 0) & np.isfinite(resistance)]
    if not size.size or size.max() <= _SAFE_SPREAD * size.min():
        return ()
    decades = np.log10(size.max() / size.min())
    return (f"resistances span {decades:.0f} decades, and double precision holds 16",)


def _lost_to_title(deck: Circuit) -> list[str]:
    """Names of the elements on a first line, which simulators take for the title."""
    if deck.title is not None:
        return []
    first = ((kind, (place == [0, 1]).all(axis=1)) for kind, place in deck.place.items())
    return [deck.element_names[kind][i] for kind, lines in first for i in np.flatnonzero(lines).tolist()]


def _raised(quirks: Quirks, deck: Circuit) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Resistances as a simulator takes them, and what it does to those that are too small."""
    resistance, _, _ = rebase(deck.resistance, deck.tc1, deck.tc2, deck.heating)
    least, size = quirks.smallest_resistance, np.abs(resistance)
    if least is None:
        return resistance, ()
    low = size == 0 if quirks.raises_zero_only else size < least
    if not low.any():
        return resistance, ()
    which = "0" if quirks.raises_zero_only else "below"
    reason = f"{int(low.sum()):,} resistances ({which} ohm) become {least:g} ohm"
    return np.where(low, least, resistance), (reason,)


def _shunt(quirks: Quirks, case: _Case) -> tuple[float, tuple[str, ...], tuple[str, ...]]:
    """The conductance that a simulator adds from every node to ground, in siemens, why, and what is uncertain of it."""
    siemens, reasons, doubts = 0.0, [], []
    for option, unit in quirks.shunt_options.items():
        value = _option(case.deck, option)
        if value:
            siemens += 1 / value if unit == "ohms" else value
            reasons.append(f".option {option}={value:g} ties every node to ground")
    floating = int(case.deck.is_floating.sum())
    if floating and quirks.floating == "everywhere":
        given = (_option(case.deck, option) for option in quirks.gmin_options)
        gmin = next((value for value in given if value), quirks.gmin)
        text = f"as if {gmin:g} S led from every node to ground"
        singular = singularity(case.deck)
        if singular == "yes":
            siemens += gmin
            reasons.append(f"{floating:,} floating nodes: the answer comes, with exit status 0, {text}")
        elif singular == "unknown":
            doubts.append(f"{floating:,} floating nodes: rounding decides whether the answer comes {text}")
    return siemens, tuple(reasons), tuple(doubts)


def _option(deck: Circuit, name: str) -> float:
    """Value of an option, 0 where it is not set or no positive number."""
    number = parse_numeral(deck.options.get(name, "0"), DIALECTS[deck.dialect].reading)
    return number.value if isinstance(number, Numeral) and number.value > 0 else 0.0


def _simulated(deck: Circuit, lost: list[str], resistance: NDArray[np.float64], siemens: float) -> Netlist:
    """What a simulator solves: these resistances, a shunt at every node, and not the elements that it lost."""
    netlist = replace(deck, resistance=resistance, tc1=None, tc2=None).netlist()
    for kind, names in (netlist.element_names or {}).items() if lost else ():
        netlist = select_elements(netlist, kind, ~np.isin(names, lost))
    shunted = np.arange(1, netlist.node_count if siemens else 1)
    return add_elements(netlist, "resistor", np.stack([shunted, np.zeros_like(shunted)], axis=1), siemens)


def _voltages(netlist: Callable[[], Netlist]) -> NDArray[np.float64] | None:
    """Node voltages of a netlist, None where it has none."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # currents in loops of shorts are of no interest here
            return solve(netlist(), accuracy="normwise", rtol=1e-12).voltage
    except ResgridError:
        return None
