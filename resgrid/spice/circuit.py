"""`Circuit`: the result of reading a deck or a network file, with elements as arrays and their lines in the file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.core.netlist import GROUND, Netlist
from resgrid.core.networkx_graphs import ARRAYS
from resgrid.core.regions import label_components
from resgrid.errors import InputError
from resgrid.spice.dialects import DIALECTS
from resgrid.spice.findings import Note

KINDS = tuple(ARRAYS)
"""Kinds of element of a netlist: resistor, voltage source, current source, capacitor and nonlinear resistor."""

TOLERANCE = 1e-9
"""Default limit on the difference between a simulated and an expected value, as a fraction of a scale.

The scale of voltages is V, the largest voltage difference between nodes of the circuit.  The scale of source currents
is the largest source current, but at least ``1e-3 G V`` with the largest conductance G.
"""

SHOWN = 5
"""Maximum number of names in a message; the message ends with the number of further names."""

LISTED = 1000
"""Maximum number of node names in `Violation.nodes`; further nodes with the same violation are not listed."""

CONDUCTING = ("resistor", "voltage source", "nonlinear resistor")
"""Kinds of element that conduct at direct current: all except current sources and capacitors."""

_NOMINAL_TEMPERATURE = 27.0
"""Nominal temperature of a circuit that was not read from a deck, in degrees Celsius."""
_SHARED = tuple(name for names in ARRAYS.values() for name in names if name != "conductance")
"""Names of the attributes that `Circuit` and `Netlist` have in common: all arrays of elements except `conductance`."""


@dataclass(frozen=True, eq=False)
class Circuit:
    r"""A resistive circuit as written, with subcircuits expanded and values evaluated, without corrections.

    Returned by `resgrid.read_spice`.  Names keep the spelling of their first occurrence; SPICE ignores case, so ``A``
    and ``a`` are one node.  Nodes and elements in a subcircuit have its path as prefix, ``x1.x2.mid`` and ``x1.x2.r1``.

    Attributes
    ----------
    title : str or None
        The title line of a deck without its leading ``*``; None without a title.
    path : str
        Name of the file for messages; empty without a file.
    dialect : str
        Name of the dialect of a deck, such as ``"ngspice"``; ``"network"`` for a circuit made of a netlist.
    node_names : sequence of str
        Ground, ``"0"``, first, then the nodes in the order of their first use; empty for a netlist without names.
    resistor_nodes, resistance : ndarray, shapes (m, 2) and (m,)
        Resistors: nodes, and ohms at the nominal temperature, divided by the multiplier ``m=``; may be negative or 0.
    source_nodes, source_volts : ndarray, shapes (s, 2) and (s,)
        Voltage sources: nodes (plus, minus) and volts at direct current.  Inductors are sources of 0 V.
    is_inductor : ndarray of bool, shape (s,)
        Whether a voltage source replaces an inductor.
    current_nodes, current_amps : ndarray, shapes (c, 2) and (c,)
        Current sources: the node that current leaves (SPICE's plus), the node that it enters (minus), and amperes.
    capacitor_nodes, capacitance : ndarray, shapes (k, 2) and (k,)
        Capacitors in farads, which are open at direct current.
    nonlinear_nodes, nonlinear_current, nonlinear_voltage : ndarray, shapes (n, 2), (n,) and (n,)
        Nonlinear resistors with the current ``nonlinear_current * tanh(V / nonlinear_voltage)`` from the first node to
        the second, in amperes, where V is the voltage of the first node minus that of the second, in volts.
    element_names : mapping of str to tuple of str
        For each kind of element (``"resistor"``, ...) the names of its elements; a kind without names is absent.
    place : mapping of str to ndarray of int64, shape (elements, 2)
        For each kind of element the index into `files` and the line (from 1) of every element; empty without a deck.
    files : tuple of str
        Every file that was read, the deck first.
    notes : tuple of Note
        Remarks about text that was ignored, adapted, or read differently by simulators.
    tc1, tc2 : ndarray of float64, shape (m,), or None
        Temperature coefficients of the resistors, in 1/K and 1/K^2; None if all are 0.
    temperature, nominal_temperature : float or None
        Simulation and nominal temperature that the deck states, in degrees Celsius; None where it states none.
    options : mapping of str to str
        Values of ``.option`` by key in lower case; a flag has the value ``""``.
    subcircuits : tuple of str
        Names of the subcircuits of which the deck has an instance.
    given : Netlist or None
        The netlist that the circuit was made of; None if it was read from a deck.
    is_deck : bool
        Whether the circuit was read from a deck, so that its elements have line numbers.
    node_count : int
        Number of nodes, including ground.
    ends : mapping of str to ndarray of int32, shape (elements, 2)
        Node numbers of both ends of every element, for each kind of element.
    part : ndarray of int64, shape (nodes,)
        Index of the connected component of every node; only conducting elements connect nodes.
    is_floating : ndarray of bool, shape (nodes,)
        Whether a node has no conducting path to ground.
    degree : ndarray of int64, shape (nodes,)
        Number of element ends at every node, capacitors and current sources included.
    trapped_sources : ndarray of int64, shape (n,)
        Indices of the nonzero current sources between two connected components, whose current has no return path.
    heating : float
        Simulation temperature minus nominal temperature, in kelvin.

    Examples
    --------
    >>> import io
    >>> deck = rg.read_spice(io.StringIO("divider\nV1 in 0 2\nR1 in out 1k\nR2 out 0 1k\n"))
    >>> deck.node_names, deck.resistance
    (('0', 'in', 'out'), array([1000., 1000.]))
    >>> deck.element_name("resistor", 1), deck.place_of("resistor", 1)
    ('R2', '<text>:4')
    >>> deck.netlist()
    <Netlist of 3 nodes: 2 resistors, 1 voltage source>
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
        """Return the circuit of a netlist; return a circuit unchanged.

        Parameters
        ----------
        circuit : Circuit or Netlist
            The circuit or netlist.
        path : str
            Name of the netlist's file for messages; empty without a file.

        Returns
        -------
        Circuit
            `circuit` itself if it is a `Circuit`, else a circuit with the netlist as `given`.
        """
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
        """Whether the circuit was read from a deck, so that its elements have line numbers."""
        return self.given is None

    @property
    def node_count(self) -> int:
        """Number of nodes, including ground."""
        return len(self.node_names) if self.given is None else self.given.node_count

    @cached_property
    def ends(self) -> Mapping[str, NDArray[np.int32]]:
        """Node numbers of both ends of every element, by kind: arrays of shape (elements of the kind, 2)."""
        return {kind: getattr(self, nodes) for kind, (nodes, *_) in ARRAYS.items()}

    @cached_property
    def part(self) -> NDArray[np.int64]:
        """Index of the connected component of every node, shape (nodes,); only `CONDUCTING` elements connect nodes."""
        return label_components(np.concatenate([self.ends[kind] for kind in CONDUCTING]), self.node_count)

    @cached_property
    def is_floating(self) -> NDArray[np.bool_]:
        """Mask of the nodes without a conducting path to ground, shape (nodes,)."""
        return np.asarray(self.part != self.part[GROUND])

    @cached_property
    def degree(self) -> NDArray[np.int64]:
        """Number of element ends at every node, shape (nodes,); an element with both ends at one node counts twice."""
        return np.asarray(sum(np.bincount(ends.ravel(), minlength=self.node_count) for ends in self.ends.values()))

    @cached_property
    def trapped_sources(self) -> NDArray[np.int64]:
        """Indices (n,) of the nonzero current sources between two components: their current has no return path."""
        component = self.part[self.current_nodes]
        return np.flatnonzero((component[:, 0] != component[:, 1]) & (self.current_amps != 0))

    def names_of(self, nodes: ArrayLike) -> list[str]:
        """Return the names of nodes as a list of n strings; `nodes` (n,): node numbers."""
        if self.given is not None:
            return self.given.names_of(nodes)
        return [self.node_names[node] for node in np.asarray(nodes).tolist()]

    def listed(self, nodes: NDArray[np.integer[Any]]) -> tuple[str, ...]:
        """Return the names of the first 1000 (`LISTED`) of the given nodes; `nodes` (n,): node numbers."""
        return tuple(self.names_of(nodes[:LISTED]))

    def shown(self, nodes: NDArray[np.integer[Any]]) -> str:
        """Return the names of the first 5 nodes and the number of further nodes as text; `nodes` (n,): node numbers."""
        return some(self.names_of(nodes[:SHOWN]), nodes.size)

    def element_name(self, kind: str, number: int) -> str:
        """Return the name of an element, or its kind and number if it has no name.

        Parameters
        ----------
        kind : str
            Kind of the element, a key of `ends`.
        number : int
            Index of the element among those of its kind.

        Returns
        -------
        str
            Name in the deck or netlist, else a text such as ``"resistor 3"``.
        """
        names = self.element_names
        return names[kind][number] if kind in names else f"{kind} {number}"

    def place_of(self, kind: str, element: int) -> str:
        """Return ``file:line`` of an element in a deck, otherwise the cells or nodes that it connects.

        Parameters
        ----------
        kind : str
            Kind of the element, a key of `ends`.
        element : int
            Index of the element among those of its kind.

        Returns
        -------
        str
            For a deck ``room.cir:4``; for a netlist of a space ``cells (0, 1), (0, 2)``, else the names of the nodes.
        """
        if not self.is_deck:
            return self.place_of_nodes(np.unique(self.ends[kind][element]))
        file, line = self.place[kind][element].tolist()
        return f"{self.files[file]}:{line}"

    def place_of_nodes(self, nodes: NDArray[np.integer[Any]]) -> str:
        """Return ``file:line`` of the first element at `nodes`; for a netlist, at most 5 of their cells or names."""
        if self.given is None:
            return next((f"{self.files[file]}:{line}" for file, line in self.places_at(nodes).tolist()), self.path)
        found = self.given.space_map
        cell = np.empty(0, dtype=np.int64) if found is None else self.given.cell_of_node()[nodes]
        if found is None or (cell < 0).all():
            return self.shown(nodes)
        cells = np.transpose(np.unravel_index(cell[cell >= 0], found.space.shape))
        places = ["(" + ", ".join(map(str, place)) + ")" for place in cells[:SHOWN].tolist()]
        return f"cell{'s' if len(cells) > 1 else ''} {some(places, len(cells))}"

    def places_at(self, nodes: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
        """Return the places (n, 2) of the elements at `nodes` of a deck, sorted: index into `files`, and line."""
        touched = np.zeros(self.node_count, dtype=np.bool_)
        touched[nodes] = True
        places = [place[touched[self.ends[kind]].any(axis=1)] for kind, place in self.place.items()]
        return np.unique(np.concatenate(places), axis=0)

    @property
    def heating(self) -> float:
        """Simulation minus nominal temperature, in kelvin; if not stated, either is the dialect's nominal default."""
        usual = DIALECTS[self.dialect].nominal_temperature if self.dialect in DIALECTS else _NOMINAL_TEMPERATURE
        nominal = usual if self.nominal_temperature is None else self.nominal_temperature
        return (usual if self.temperature is None else self.temperature) - nominal

    def netlist(self) -> Netlist:
        """Return the netlist at the temperature of the deck, with sources of 0 V for resistors of 0 ohm.

        Returns
        -------
        Netlist
            The voltage sources are those of the deck, then sources of 0 V in place of the resistors of 0 ohm.  The
            temperature coefficients refer to the temperature of the deck.

        Raises
        ------
        InputError
            If a resistance is negative or not finite at the temperature of the deck, or so small that its conductance
            overflows; the message names file and line.
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
        """Raise InputError if a resistance (m,), in ohms, is negative, not finite, or has an overflowing reciprocal."""
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
    """Return the first 5 (`SHOWN`) of `words`, and the number of others, as text: ``a, b, c, d, e and 7 more``.

    `words`: all words, or at least the first 5; `count`: number of all words.
    """
    more = f" and {count - SHOWN:,} more" if count > SHOWN else ""
    return ", ".join(words[:SHOWN]) + more


def rebase(
    resistance: NDArray[np.float64],
    tc1: NDArray[np.float64] | None,
    tc2: NDArray[np.float64] | None,
    heating: float | NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """Return resistance, tc1 and tc2 of resistors at a reference temperature that is higher by `heating`.

    They are the coefficients of ``R (1 + tc1 d + tc2 d^2)`` expanded about ``d = heating``, with the temperature
    difference ``d`` in kelvin.  `resistance` (m,): in ohms; `tc1, tc2` (m,): in 1/K and 1/K^2, None for zeros;
    `heating`: in kelvin, a scalar or (m,).
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
    """Return ohms, tc1 (1/K) and tc2 (1/K^2) of a resistor at a reference temperature higher by `heating` kelvin."""
    factor = 1.0 + (tc1 + tc2 * heating) * heating
    moved = ((tc1 + 2.0 * tc2 * heating) / factor, tc2 / factor) if factor else (0.0, 0.0)
    return ohms * factor, *moved
