"""Portability check: the circuit as each simulator reads it, solved and compared with the circuit as written.

A simulator may change a circuit (a shunt at every node, 1 milliohm for 0 ohm, a first element read as the title).  The
changed circuit is then solved too, and the largest voltage difference is the predicted error.
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
from resgrid.spice.check.erc import check_erc
from resgrid.spice.check.rereading import first_difference, reread
from resgrid.spice.check.singular import singularity
from resgrid.spice.circuit import TOLERANCE, Circuit, rebase
from resgrid.spice.dialects import DIALECTS
from resgrid.spice.dialects.record import Basis, Dialect, Quirks
from resgrid.spice.findings import Violation
from resgrid.spice.read.numerals import Numeral, parse_numeral

Outcome = Literal["right", "wrong", "fails", "unsure"]
_Result = tuple[Outcome, float | None, str | None, tuple[str, ...]]

_LARGEST = 300_000
"""Largest number of nodes of a deck for which voltage errors are computed; predictions for larger decks have none."""
_SAFE_SPREAD = 1e12
"""Ratio of the largest to the smallest resistance of a circuit above which the outcome is "unsure", not "right"."""
_ROUNDING = 2.0**-52
"""Machine epsilon of double precision: relative rounding error that is assumed for a sum of conductances."""
_SHOWN = 3
"""Maximum number of notes of the deck reader (`Circuit.notes`) among the reasons of one `Prediction`."""


@dataclass(frozen=True)
class Prediction:
    r"""Predicted result of one simulator for a deck's operating point.

    Returned by `resgrid.spice.check_portability`, one for each simulator.

    Attributes
    ----------
    simulator : str
        Name of the dialect.
    outcome : {"right", "wrong", "fails", "unsure"}
        ``"wrong"``: the simulator returns wrong voltages without an error message; ``"fails"``: it returns no result;
        ``"unsure"``: its behaviour is not known, or depends on rounding errors.
    max_error : float or None
        Largest predicted difference between a simulated and the correct node voltage, in volts; None if it was not
        computed, or if `worst_node` floats in the circuit that the simulator reads.
    worst_node : str or None
        Name of the node with the largest error, or of one that floats; None if no error was computed.
    reasons : tuple of str
        Reasons for an outcome other than ``"right"``, in words.
    basis : {"measured", "documented"}
        Source of the simulator's behaviour: runs of the simulator, or its documentation.

    Examples
    --------
    >>> import io
    >>> deck = rg.read_spice(io.StringIO("a short\nV1 a 0 2\nR1 a b 1k\nR2 b 0 0\n"))
    >>> prediction = rg.spice.check_portability(deck)[0]
    >>> prediction.simulator, prediction.outcome, prediction.basis
    ('ngspice', 'wrong', 'measured')
    >>> f"{prediction.max_error:.3g} V at {prediction.worst_node}"
    '2e-06 V at b'
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
    """A deck with the results that the predictions for all simulators need.

    `deck`: the circuit as read; `duplicates`: places (``file:line``) of element names that occur twice; `loops`: loops
    of voltage sources in the deck; `voltage` (nodes,): correct node voltages, in volts, None if the deck has no
    operating point or more than 300,000 nodes.
    """

    deck: Circuit
    duplicates: tuple[str, ...]
    loops: Loops
    voltage: NDArray[np.float64] | None


def check_portability(
    circuit: Netlist | Circuit, violations: tuple[Violation, ...] | None = None
) -> tuple[Prediction, ...]:
    """Predict for every simulator whether it finds the right operating point.

    Parameters
    ----------
    circuit : Netlist or Circuit
        A circuit read from a deck: its file is judged as each simulator reads it.  Or a netlist: the deck that resgrid
        would write is judged.
    violations : tuple of Violation, optional
        Result of `check_erc` for the circuit; computed if it is not given.

    Returns
    -------
    tuple of Prediction
        One for each simulator.  Errors are computed for decks of up to 300,000 nodes; others get reasons only.

    Examples
    --------
    >>> divider = rg.Netlist(3, [[1, 2], [2, 0]], [1e-3, 1e-3], source_nodes=[[1, 0]], source_volts=[2.0])
    >>> for prediction in rg.spice.check_portability(divider)[:2]:
    ...     print(prediction)
    ngspice: right
    ltspice: right (from its documentation, not run)
    """
    circuit = Circuit.of(circuit)
    errors = [item for item in violations or check_erc(circuit) if item.severity == "error"]
    if circuit.is_deck:
        case = _case_of(circuit, errors)
        outcomes = [_predict_file(dialect, case) for dialect in DIALECTS.values()]
    else:
        outcomes = [_predict_netlist(dialect.quirks, circuit.resistance, errors) for dialect in DIALECTS.values()]
    return tuple(
        Prediction(dialect.name, *outcome, dialect.quirks.basis)
        for dialect, outcome in zip(DIALECTS.values(), outcomes, strict=True)
    )


def _predict_netlist(quirks: Quirks, resistance: NDArray[np.float64], errors: list[Violation]) -> _Result:
    """Return "right", "fails" or "unsure", None, None and reasons for the deck that resgrid would write of a netlist.

    The two None stand for error and worst node, which are not computed.  `quirks`: behaviour of the simulator;
    `resistance` (m,): in ohms; `errors`: violations of severity "error", with which no deck can be written.
    """
    if errors:
        return "fails", None, None, (f"the netlist has no deck: {errors[0].message}",)
    uncertainties = _uncertain_spread(resistance)
    least = quirks.smallest_resistance
    if least and not quirks.raises_zero_only and resistance.min(initial=np.inf) < least:
        uncertainties += (f"it raises resistances to {least:g} ohm (RESMIN)",)
    return "unsure" if uncertainties else "right", None, None, uncertainties


def _predict_file(dialect: Dialect, case: _Case) -> _Result:
    """Return outcome, error in volts or None, worst node or None, and reasons for a deck's file.

    The outcome is "right", "wrong", "fails" or "unsure"; error and node are None if not computed.  A node that floats
    or is missing only by the simulator's rules is the worst node, with the error None.  `dialect`: dialect of the
    simulator, by whose rules the file is read; `case`: the deck as its own dialect reads it.
    """
    label = dialect.label
    found = reread(case.deck, dialect)
    if found.circuit is None:
        if found.fails:
            return "fails", None, None, (found.why,)
        return "unsure", None, None, (f"this file cannot be read by the rules of {label}: {found.why}",)
    stops = [note for note in found.circuit.notes if note.outcome == "fails"]
    if stops:
        return "fails", None, None, tuple(str(note) for note in stops[:_SHOWN])
    if found.circuit is case.deck:
        outcome, error, worst, reasons = _predict_deck(dialect.quirks, case)
    else:
        own = _case_of(found.circuit, check_erc(found.circuit))
        if own.voltage is not None and case.voltage is not None:
            difference = first_difference((case.deck, found.circuit), (case.voltage, own.voltage))
            if difference is not None:
                reason = f"{label} reads another circuit from this file"
                return "wrong", _finite(difference[1]), difference[0], (reason,)
        outcome, error, worst, reasons = _predict_deck(dialect.quirks, own)
    uncertainties = tuple(str(note) for note in found.circuit.notes if note.outcome == "unsure")[:_SHOWN]
    if uncertainties and outcome == "right":
        outcome = "unsure"
    return outcome, error, worst, (*reasons, *uncertainties)


def _finite(volts: float) -> float | None:
    """Return `volts` if the number is finite, otherwise None."""
    return volts if np.isfinite(volts) else None


def _case_of(deck: Circuit, violations: Iterable[Violation]) -> _Case:
    """Return a deck with the results that the predictions for all simulators need, such as its voltages.

    `violations`: result of `check_erc` for the deck.
    """
    duplicates = tuple(item.place for item in violations if item.severity == "error" and item.rule == "names")
    right = _voltages(deck.netlist) if deck.node_count <= _LARGEST else None
    return _Case(deck, duplicates, loops_of(deck), right)


def _predict_deck(quirks: Quirks, case: _Case) -> _Result:
    """Return outcome, error in volts or None, worst node or None, and reasons for a deck as a simulator reads it.

    The outcome is "fails" at defects that stop the simulator, else "wrong" if the simulator changes voltages, else
    "unsure" if there are reasons for uncertainty, else "right".  `quirks`: the simulator's behaviour; `case`: the deck.
    """
    fatal = [
        f"a loop of voltage sources makes the matrix singular ({case.deck.place_of('voltage source', number)})"
        for number in _failing_loops(quirks, case)[:1]
    ]
    if quirks.duplicates == "fails":
        fatal += [f"a name is given twice ({place})" for place in case.duplicates[:1]]
    if fatal:
        return "fails", None, None, tuple(fatal)
    lost = _elements_on_title_line(case.deck)
    resistance, raised = _raised_resistances(quirks, case.deck)
    siemens, shunts, shunt_uncertainties = _shunt(quirks, case)
    reasons = (*(f"the first line is read as the title, so {name} is lost" for name in lost[:1]), *raised, *shunts)
    uncertainties = (*_uncertainties(quirks, case, resistance), *shunt_uncertainties)
    trapped = case.deck.trapped_sources
    if trapped.size:
        name = case.deck.element_name("current source", int(trapped[0]))
        text = f"{name} drives a floating part, which has no return path: no operating point exists"
        if quirks.floating == "unknown":
            uncertainties += (text,)
        else:
            reasons += (text,)
    if not reasons:
        return "unsure" if uncertainties else "right", None, None, uncertainties
    got = None if case.voltage is None else _voltages(lambda: _simulated(case.deck, lost, resistance, siemens))
    if case.voltage is None or got is None:
        return "wrong", None, None, (*reasons, *uncertainties)
    names, error = case.deck.node_names, np.nan_to_num(np.abs(got - case.voltage), nan=0.0)
    cut_off = np.flatnonzero(np.isnan(got) & ~np.isnan(case.voltage))
    reasons += tuple(f"node {names[node]} is cut off" for node in cut_off[:1].tolist())
    worst = int(np.argmax(error))
    harmless = error[worst] <= TOLERANCE * np.nanmax(np.abs(case.voltage), initial=0.0) and not cut_off.size
    outcome: Outcome = "wrong" if not harmless else "unsure" if uncertainties else "right"
    return outcome, float(error[worst]), names[worst], (*reasons, *uncertainties)


def _failing_loops(quirks: Quirks, case: _Case) -> list[int]:
    """Return the indices of the voltage sources that close a loop at which the simulator fails.

    `quirks`: behaviour of the simulator, which fails at all loops or only at those tied to ground; `case`: the deck.
    """
    ends = case.deck.source_nodes
    closing = [int(number) for number in case.loops.sources]
    inductive = case.deck.is_inductor
    closing += [i for kind, i, _ in case.loops.contradictions if kind == "voltage source" and not inductive[i]]
    if quirks.loops == "fail at ground":
        tree = label_components(ends, case.deck.node_count)
        closing = [i for i in closing if tree[ends[i, 0]] == tree[GROUND] or ends[i, 0] == ends[i, 1]]
    return closing


def _uncertainties(quirks: Quirks, case: _Case, resistance: NDArray[np.float64]) -> tuple[str, ...]:
    """Return the reasons, as sentences, for which a simulator's result is uncertain; empty if the result is certain.

    `quirks`: the simulator's behaviour; `case`: the deck; `resistance` (m,): values that the simulator uses, in ohms.
    """
    uncertainties = _uncertain_spread(np.abs(case.deck.resistance)) or _cancellation(case.deck, np.abs(resistance))
    continues = quirks.loops == "fail at ground"
    for kind, numbers in (("inductors", case.loops.inductors), ("voltage sources", case.loops.sources)):
        if not numbers.size:
            continue
        place = case.deck.place_of("voltage source", int(numbers[0]))
        effect = "the result is the end of a transient, and may be arbitrary" if continues else "it may fail"
        uncertainties += (f"a loop of {kind} ({place}): {effect}",)
    if case.deck.is_floating.any() and quirks.floating == "unknown":
        uncertainties += ("its treatment of floating nodes is not known",)
    if quirks.smallest_resistance is None and (case.deck.resistance == 0).any():
        uncertainties += ("its treatment of 0 ohm is not known",)
    if (case.deck.resistance < 0).any():
        uncertainties += ("decks with negative resistances cannot be checked",)
    if quirks.duplicates == "unknown" and case.duplicates:
        uncertainties += ("it is not known which of two elements of one name it keeps",)
    return uncertainties


def _cancellation(deck: Circuit, size: NDArray[np.float64]) -> tuple[str, ...]:
    """Return a reason for uncertainty if elimination loses small conductances next to large ones, else an empty tuple.

    `size` (m,): magnitudes of the resistances, in ohms.  Gaussian elimination in a group of nodes that large
    conductances connect subtracts these conductances from diagonal entries that contain them.  The remainder is the
    conductance that leaves the group, with the rounding error of the large conductances.  This error is a reason if it
    exceeds 1e-9 of the remainder.
    """
    usable = (size > 0) & np.isfinite(size)
    size, ends = size[usable], deck.resistor_nodes[usable]
    if not size.size or size.max() <= size.min() * TOLERANCE / _ROUNDING:
        return ()
    worst = 0.0
    for exponent in np.unique(np.ceil(np.log10(size))).tolist()[:-1]:
        small = size <= 10.0**exponent
        group = label_components(np.concatenate([ends[small], deck.source_nodes]), deck.node_count)
        leaves = ~small & (group[ends[:, 0]] != group[ends[:, 1]])
        leaving = np.bincount(group[ends[leaves]].ravel(), np.repeat(1 / size[leaves], 2), deck.node_count)
        within = np.zeros(deck.node_count)
        np.maximum.at(within, group[ends[small, 0]], 1 / size[small])
        held = leaving > 0
        held[group[GROUND]] = False
        worst = max(worst, float(np.max(within[held] / leaving[held], initial=0.0)))
    if worst * _ROUNDING <= TOLERANCE:
        return ()
    error = f"{worst * _ROUNDING:.0e}"
    return (f"cancellation at the smallest resistances causes a relative voltage error of about {error}",)


def _uncertain_spread(resistance: NDArray[np.float64]) -> tuple[str, ...]:
    """Return a reason for uncertainty if positive resistances (m,) differ by a factor above 1e12, else ()."""
    size = resistance[(resistance > 0) & np.isfinite(resistance)]
    if not size.size or size.max() <= _SAFE_SPREAD * size.min():
        return ()
    orders = np.log10(size.max() / size.min())
    return (f"resistances span {orders:.0f} orders of magnitude, and double precision has 16 digits",)


def _elements_on_title_line(deck: Circuit) -> list[str]:
    """Return the names of elements that resgrid read from the first line, which simulators take for the title."""
    if deck.title is not None:
        return []
    first = ((kind, (place == [0, 1]).all(axis=1)) for kind, place in deck.place.items())
    return [deck.element_names[kind][i] for kind, lines in first for i in np.flatnonzero(lines).tolist()]


def _raised_resistances(quirks: Quirks, deck: Circuit) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Return the resistances (m,) that a simulator uses, in ohms, and (reason,) if it raises small ones, else ()."""
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
    """Return the shunt conductance, the reasons why the result is wrong, and the reasons why it is uncertain.

    The first value is the conductance that the simulator adds from every node to ground, in siemens.  `quirks`:
    behaviour of the simulator; `case`: the deck.
    """
    siemens, reasons, uncertainties = 0.0, [], []
    for option, unit in quirks.shunt_options.items():
        value = _option(case.deck, option)
        if value:
            siemens += 1 / value if unit == "ohms" else value
            reasons.append(f".option {option}={value:g} ties every node to ground")
    floating = int(case.deck.is_floating.sum())
    if floating and quirks.floating == "everywhere":
        given = (_option(case.deck, option) for option in quirks.gmin_options)
        gmin = next((value for value in given if value), quirks.gmin)
        text = f"for a circuit with {gmin:g} S from every node to ground"
        singular = singularity(case.deck)
        if singular == "yes":
            siemens += gmin
            reasons.append(f"{floating:,} floating nodes: the result, with exit status 0, is {text}")
        elif singular == "unknown":
            uncertainties.append(f"{floating:,} floating nodes: rounding errors decide whether the result is {text}")
    return siemens, tuple(reasons), tuple(uncertainties)


def _option(deck: Circuit, name: str) -> float:
    """Return the value of the option `name` of a deck, 0 if the option is not set or not a positive number."""
    number = parse_numeral(deck.options.get(name, "0"), DIALECTS[deck.dialect].reading)
    return number.value if isinstance(number, Numeral) and number.value > 0 else 0.0


def _simulated(deck: Circuit, lost: list[str], resistance: NDArray[np.float64], siemens: float) -> Netlist:
    """Return the netlist that a simulator solves in place of the circuit `deck`.

    `lost`: names of the elements that the simulator omits; `resistance` (m,): resistances that it uses, in ohms;
    `siemens`: conductance that it adds from every node to ground, in siemens.
    """
    netlist = replace(deck, resistance=resistance, tc1=None, tc2=None).netlist()
    for kind, names in (netlist.element_names or {}).items() if lost else ():
        netlist = select_elements(netlist, kind, ~np.isin(names, lost))
    shunted = np.arange(1, netlist.node_count if siemens else 1)
    return add_elements(netlist, "resistor", np.stack([shunted, np.zeros_like(shunted)], axis=1), siemens)


def _voltages(netlist: Callable[[], Netlist]) -> NDArray[np.float64] | None:
    """Return the node voltages (nodes,) in volts, None without an operating point; `netlist`: builds the netlist."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # undetermined currents in loops of shorts do not change voltages
            return solve(netlist(), accuracy="normwise", rtol=1e-12).voltage
    except ResgridError:
        return None
