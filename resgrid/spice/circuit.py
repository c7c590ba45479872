"""A circuit as somebody wrote it, elements as arrays: what is read, and what the rules look at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import compress
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.core.netlist import GROUND, Netlist
from resgrid.core.networkx_graphs import ARRAYS
from resgrid.core.regions import label_components
from resgrid.errors import InputError
from resgrid.spice.dialects import DIALECTS

Severity = Literal["error", "warning", "info"]

SEVERITIES: tuple[Severity, ...] = ("error", "warning", "info")
"""Worst first."""

KINDS = tuple(ARRAYS)
"""The kinds of element, as in `Netlist`."""

TOLERANCE = 1e-9
"""Largest error of an answer that counts as right: of a voltage relative to the largest, of a current likewise."""

SHOWN = 5
"""How many names a message holds."""

LISTED = 1000
CONDUCTING = ("resistor", "voltage source", "nonlinear resistor")
"""Kinds that carry current at direct current whatever drives them."""

_NOMINAL_TEMPERATURE = 27.0
_SHARED = tuple(name for names in ARRAYS.values() for name in names if name != "conductance")
"""Arrays that a circuit has in common with a netlist."""


@dataclass(frozen=True)
class Note:
    """Something about a deck that its reader wants to have said.

    Attributes
    ----------
    severity : {"error", "warning", "info"}
        A warning is something that simulators disagree about or that was probably not meant.
    file : str
        The file, as displayed.
    line, column : int
        Counted from 1; column 0 means the whole line.
    text : str
        What was noted.
    outcome : {"", "fails", "unsure"}
        Consequence for the deck's own simulator: no answer, or perhaps another one.
    """

    severity: Severity
    file: str
    line: int
    column: int
    text: str
    outcome: Literal["", "fails", "unsure"] = ""

    @property
    def place(self) -> str:
        """``file:line``, with the column where there is one."""
        return f"{self.file}:{self.line}" + (f":{self.column}" if self.column else "")

    def __str__(self) -> str:
        return f"{self.place}: {self.text}"


@dataclass(frozen=True)
class Violation:
    """One violation of an electrical rule.

    Attributes
    ----------
    severity : {"error", "warning", "info"}
        An error keeps the circuit from having an operating point, or a deck from being simulated rightly.
    rule : str
        Short name of the rule.
    place : str
        ``file:line`` in a deck, the cell of a scene, otherwise the nodes or elements concerned.
    message : str
        What is wrong.
    remedy : str
        What to do.
    nodes : tuple of str
        The nodes concerned, at most the first thousand.
    """

    severity: Severity
    rule: str
    place: str
    message: str
    remedy: str
    nodes: tuple[str, ...] = ()

    def __str__(self) -> str:
        where = f"{self.place}: " if self.place else ""
        return f"{self.severity} [{self.rule}] {where}{self.message}; {self.remedy}"


@dataclass(frozen=True, eq=False)
class Circuit:
    """A resistive circuit as it was written: subcircuits expanded, values evaluated, nothing repaired.

    Names keep the spelling of their first appearance, though SPICE folds case: ``A`` and ``a`` are one node.  What
    lies in a subcircuit has its path in front, ``x1.x2.mid`` and ``x1.x2.r1``.

    Attributes
    ----------
    title : str or None
        The title line of a deck without a leading ``*``; None if there is none.
    path : str
        The file, as displayed; empty where there is none.
    dialect : str
        Whose rules it was read by; ``"network"`` for what is no deck.
    node_names : sequence of str
        Ground, ``"0"``, first; then the nodes in the order of their first use; none where a netlist has none.
    resistor_nodes : ndarray of int32, shape (m, 2)
    resistance : ndarray of float64, shape (m,)
        At the nominal temperature, in ohms; zero and negative values as written, multipliers ``m=`` applied.
    source_nodes, source_volts : ndarray, shapes (s, 2) and (s,)
        Voltage sources (plus, minus; volts at direct current) and, as 0 V, inductors.
    is_inductor : ndarray of bool, shape (s,)
        Which of them stand for inductors.
    current_nodes, current_amps : ndarray, shapes (c, 2) and (c,)
        Node the current is taken from, node it is fed into (SPICE's plus and minus); amperes.
    capacitor_nodes, capacitance : ndarray, shapes (k, 2) and (k,)
        In farads; open at direct current.
    nonlinear_nodes, nonlinear_current, nonlinear_voltage : ndarray, shapes (n, 2), (n,) and (n,)
        Resistors that carry ``current tanh(V / voltage)``; in amperes and volts.
    element_names : mapping of str to tuple of str
        Per kind (`KINDS`) one name an element, where they have names.
    place : mapping of str to ndarray of int64, shape (elements, 2)
        Per kind the index into `files` and the line of every element of a deck.
    files : tuple of str
        Every file that was read, the deck first.
    notes : tuple of Note
        What was ignored, adapted or looks wrong.
    tc1, tc2 : ndarray of float64, shape (m,), or None
        Temperature coefficients of the resistors, in 1/K and 1/K^2.
    temperature, nominal_temperature : float or None
        In degrees Celsius; None where the deck does not say.
    options : mapping of str to str
        What ``.option`` lines set, keys in lower case; a flag has the value ``""``.
    subcircuits : tuple of str
        Names of the subcircuits that are used.
    given : Netlist or None
        What it is, where it came from no deck.
    """

    title: str | None
    path: str
    dialect: str
    node_names: Sequence[str]
    resistor_nodes: NDArray[np.int32]
    resistance: NDArray[np.float64]
    source_nodes: NDArray[np.int32]
    source_volts: NDArray[np.float64]
    is_inductor: NDArray[np.bool_]
    current_nodes: NDArray[np.int32]
    current_amps: NDArray[np.float64]
    capacitor_nodes: NDArray[np.int32]
    capacitance: NDArray[np.float64]
    nonlinear_nodes: NDArray[np.int32]
    nonlinear_current: NDArray[np.float64]
    nonlinear_voltage: NDArray[np.float64]
    element_names: Mapping[str, tuple[str, ...]]
    place: Mapping[str, NDArray[np.int64]]
    files: tuple[str, ...]
    notes: tuple[Note, ...] = ()
    tc1: NDArray[np.float64] | None = None
    tc2: NDArray[np.float64] | None = None
    temperature: float | None = None
    nominal_temperature: float | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    subcircuits: tuple[str, ...] = ()
    given: Netlist | None = None

    def __post_init__(self) -> None:
        shared = (getattr(self, name) for name in _SHARED)
        for array in (self.resistance, self.is_inductor, *shared, *self.place.values()):
            if array is not None:
                array.flags.writeable = False

    def __repr__(self) -> str:
        counts = [f"{len(ends)} {kind}s" for kind, ends in self.ends.items() if len(ends)]
        return f"Circuit({self.path or 'netlist'!r}, {self.dialect}: {self.node_count} nodes, {', '.join(counts)})"

    @staticmethod
    def of(circuit: Circuit | Netlist, path: str = "") -> Circuit:
        """A netlist, perhaps read from a file, as a circuit; a circuit as it is."""
        if isinstance(circuit, Circuit):
            return circuit
        with np.errstate(over="ignore"):
            resistance = 1.0 / circuit.conductance
        return Circuit(
            title=None,
            path=path,
            dialect="network",
            node_names=circuit.node_names or (),
            resistance=resistance,
            is_inductor=np.zeros(len(circuit.source_volts), dtype=np.bool_),
            element_names=circuit.element_names or {},
            place={},
            files=(path,) if path else (),
            given=circuit,
            **{name: getattr(circuit, name) for name in _SHARED},
        )

    @property
    def is_deck(self) -> bool:
        """Whether it has lines; what has none is written without what simulators stumble over."""
        return self.given is None

    @property
    def node_count(self) -> int:
        """Number of nodes, ground among them."""
        return len(self.node_names) if self.given is None else self.given.node_count

    @cached_property
    def ends(self) -> Mapping[str, NDArray[np.int32]]:
        """Nodes of every element, per kind; shapes (elements, 2)."""
        return {kind: getattr(self, nodes) for kind, (nodes, *_) in ARRAYS.items()}

    @cached_property
    def part(self) -> NDArray[np.int64]:
        """Number of the part each node belongs to: nodes that elements which conduct join; shape (nodes,)."""
        return label_components(np.concatenate([self.ends[kind] for kind in CONDUCTING]), self.node_count)

    @cached_property
    def is_floating(self) -> NDArray[np.bool_]:
        """Which nodes nothing that conducts joins to ground, shape (nodes,)."""
        return np.asarray(self.part != self.part[GROUND])

    @cached_property
    def degree(self) -> NDArray[np.int64]:
        """Number of element ends at every node, shape (nodes,)."""
        return np.asarray(sum(np.bincount(ends.ravel(), minlength=self.node_count) for ends in self.ends.values()))

    @cached_property
    def trapped_sources(self) -> NDArray[np.int64]:
        """Numbers of the current sources that drive a floating part from outside, so that no current can return."""
        parts = self.part[self.current_nodes]
        return np.flatnonzero((parts[:, 0] != parts[:, 1]) & (self.current_amps != 0))

    def names_of(self, nodes: ArrayLike) -> list[str]:
        """Return the names of nodes, shape (n,)."""
        if self.given is not None:
            return self.given.names_of(nodes)
        return [self.node_names[node] for node in np.asarray(nodes).tolist()]

    def listed(self, nodes: NDArray[np.integer[Any]]) -> tuple[str, ...]:
        """The first thousand of some nodes' names."""
        return tuple(self.names_of(nodes[:LISTED]))

    def shown(self, nodes: NDArray[np.integer[Any]]) -> str:
        """A few of some nodes' names, and how many more there are."""
        return some(self.names_of(nodes[:SHOWN]), nodes.size)

    def element_name(self, kind: str, number: int) -> str:
        """Name of an element, or its kind and number."""
        names = self.element_names
        return names[kind][number] if kind in names else f"{kind} {number}"

    def place_of(self, kind: str, element: int) -> str:
        """``file:line`` of an element of one of `KINDS`, or the cells or nodes it joins."""
        if not self.is_deck:
            return self.place_of_nodes(np.unique(self.ends[kind][element]))
        file, line = self.place[kind][element].tolist()
        return f"{self.files[file]}:{line}"

    def place_of_nodes(self, nodes: NDArray[np.integer[Any]]) -> str:
        """``file:line`` of the first element at some nodes, or their cells, or their names."""
        if self.given is None:
            return next((f"{self.files[file]}:{line}" for file, line in self.places_at(nodes).tolist()), self.path)
        cell_map = self.given.cell_map
        cell = np.empty(0, dtype=np.int64) if cell_map is None else self.given.cell_of_node()[nodes]
        if cell_map is None or (cell < 0).all():
            return self.shown(nodes)
        cells = np.transpose(np.unravel_index(cell[cell >= 0], cell_map.space.shape))
        places = ["(" + ", ".join(map(str, place)) + ")" for place in cells[:SHOWN].tolist()]
        return f"cell{'s' if len(cells) > 1 else ''} {some(places, len(cells))}"

    def places_at(self, nodes: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
        """File and line of every element of a deck at some nodes, in their order; shape (lines, 2)."""
        touched = np.zeros(self.node_count, dtype=np.bool_)
        touched[nodes] = True
        there = [place[touched[self.ends[kind]].any(axis=1)] for kind, place in self.place.items()]
        return np.unique(np.concatenate(there), axis=0)

    @property
    def heating(self) -> float:
        """How far the deck's temperature lies above the nominal one, in kelvin."""
        usual = DIALECTS[self.dialect].nominal_temperature if self.dialect in DIALECTS else _NOMINAL_TEMPERATURE
        nominal = usual if self.nominal_temperature is None else self.nominal_temperature
        return (usual if self.temperature is None else self.temperature) - nominal

    def netlist(self) -> Netlist:
        """Make a netlist: resistances at the deck's temperature, resistors of 0 ohm as sources of 0 V, names kept.

        Returns
        -------
        Netlist
            Voltage sources in the deck's order, then the resistors of 0 ohm; the temperature coefficients count from
            the deck's temperature.

        Raises
        ------
        InputError
            If a resistance is negative at that temperature, or so small that its conductance overflows; the message
            names file and line.
        """
        if self.given is not None:
            return self.given
        resistance, tc1, tc2 = rebase(self.resistance, self.tc1, self.tc2, self.heating)
        self._refuse_inadmissible(resistance)
        short = resistance == 0
        keeps, shorts = ~short, self.resistor_nodes[short]
        names: Mapping[str, tuple[str, ...]] = self.element_names
        if len(shorts):
            own = names["resistor"]
            names = {**names, "resistor": tuple(compress(own, keeps))}
            names["voltage source"] += tuple(compress(own, short))
        changed = {
            "resistor_nodes": self.resistor_nodes[keeps] if len(shorts) else self.resistor_nodes,
            "source_nodes": np.concatenate([self.source_nodes, shorts]),
            "source_volts": np.concatenate([self.source_volts, np.zeros(len(shorts))]),
            "tc1": None if tc1 is None else tc1[keeps],
            "tc2": None if tc2 is None else tc2[keeps],
        }
        return Netlist(
            node_count=self.node_count,
            conductance=1.0 / resistance[keeps],
            node_names=tuple(self.node_names),
            element_names=names,
            **{name: getattr(self, name) for name in _SHARED} | changed,
        )

    def _refuse_inadmissible(self, resistance: NDArray[np.float64]) -> None:
        with np.errstate(divide="ignore", over="ignore"):
            wrong = ~np.isfinite(resistance) | (resistance < 0) | ((resistance > 0) & ~np.isfinite(1.0 / resistance))
        if wrong.any():
            worst = int(np.argmax(wrong))
            more = f" (and {int(wrong.sum()) - 1} more like it)" if wrong.sum() > 1 else ""
            raise InputError(
                f"{self.place_of('resistor', worst)}: resistor {self.element_names['resistor'][worst]} has "
                f"{float(resistance[worst])!r} ohm{more}; only zero (a short) and positive finite resistances can be "
                "solved: correct the value"
            )


def some(words: Sequence[str], count: int) -> str:
    """The first few of ``count`` words, and how many more there are."""
    more = f" and {count - SHOWN:,} more" if count > SHOWN else ""
    return ", ".join(words[:SHOWN]) + more


def rebase(
    resistance: NDArray[np.float64],
    tc1: NDArray[np.float64] | None,
    tc2: NDArray[np.float64] | None,
    heating: float | NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """Count temperature from another point: ``R (1 + tc1 d + tc2 d^2)`` expanded about ``d = heating``.

    Shapes: `resistance` (m,), `tc1, tc2` (m,), `heating` (m,).
    """
    if np.all(heating == 0) or (tc1 is None and tc2 is None):
        return resistance, tc1, tc2
    first, second = (np.zeros(len(resistance)) if tc is None else tc for tc in (tc1, tc2))
    factor = 1.0 + (first + second * heating) * heating
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = (first + 2.0 * second * heating) / factor, second / factor
    first, second = (np.where(factor == 0, 0.0, tc) for tc in moved)
    return resistance * factor, first, None if tc2 is None else second


def rebase_one(ohms: float, tc1: float, tc2: float, heating: float) -> tuple[float, float, float]:
    """The same of a single resistor, without the cost of arrays."""
    factor = 1.0 + (tc1 + tc2 * heating) * heating
    moved = ((tc1 + 2.0 * tc2 * heating) / factor, tc2 / factor) if factor else (0.0, 0.0)
    return ohms * factor, *moved
