"""What a deck says, before anything is made of it: elements as arrays, with names, places and notes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.netlist import Netlist
from resgrid.spice.dialects import DIALECTS

Severity = Literal["error", "warning", "info"]

NOMINAL_TEMPERATURE = 27.0
"""Of a circuit that is no deck, in degrees Celsius."""

KINDS = ("resistor", "voltage source", "current source", "capacitor", "nonlinear resistor")
"""The kinds of element, as in `Netlist`."""

_ARRAYS = (
    "resistor_nodes",
    "resistance",
    "tc1",
    "tc2",
    "source_nodes",
    "source_volts",
    "current_nodes",
    "current_amps",
    "capacitor_nodes",
    "capacitance",
    "nonlinear_nodes",
    "nonlinear_current",
    "nonlinear_voltage",
)


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
    """

    severity: Severity
    file: str
    line: int
    column: int
    text: str

    def __str__(self) -> str:
        column = f":{self.column}" if self.column else ""
        return f"{self.file}:{self.line}{column}: {self.text}"


class LateNames(Mapping[str, tuple[str, ...]]):
    """Names of elements per kind, made when they are first asked for.

    `makers`: what makes the names of each kind.
    """

    def __init__(self, makers: Mapping[str, Callable[[], Sequence[str]]]) -> None:
        self._makers = dict(makers)
        self._made: dict[str, tuple[str, ...]] = {}

    def __getitem__(self, kind: str) -> tuple[str, ...]:
        """Names of a kind."""
        if kind not in self._made:
            self._made[kind] = tuple(self._makers[kind]())
        return self._made[kind]

    def __iter__(self) -> Iterator[str]:
        """Kinds."""
        return iter(self._makers)

    def __len__(self) -> int:
        """Number of kinds."""
        return len(self._makers)


@dataclass(frozen=True, eq=False)
class ParsedDeck:
    """A resistive deck as it was written: subcircuits expanded, values evaluated, nothing repaired.

    Names keep the spelling of their first appearance, though SPICE folds case: ``A`` and ``a`` are one node.  What
    lies in a subcircuit has its path in front, ``x1.x2.mid`` and ``x1.x2.r1`` (`ngspice_name` gives ngspice's names).

    Attributes
    ----------
    title : str or None
        The title line without a leading ``*``; None if the deck has none.
    path : str
        The deck, as displayed.
    dialect : str
        Whose rules it was read by.
    node_names : tuple of str
        Ground, ``"0"``, first; then the nodes in the order of their first use.
    resistor_nodes : ndarray of int32, shape (m, 2)
    resistance : ndarray of float64, shape (m,)
        At the nominal temperature, in ohms; zero and negative values as written, multipliers ``m=`` applied.
    source_nodes, source_volts : ndarray, shapes (s, 2) and (s,)
        Voltage sources (plus, minus; volts at direct current) and, as 0 V, inductors.
    current_nodes, current_amps : ndarray, shapes (c, 2) and (c,)
        Node the current is taken from, node it is fed into (SPICE's plus and minus); amperes.
    capacitor_nodes, capacitance : ndarray, shapes (k, 2) and (k,)
        In farads; open at direct current.
    nonlinear_nodes, nonlinear_current, nonlinear_voltage : ndarray, shapes (n, 2), (n,) and (n,)
        Resistors that carry ``current tanh(V / voltage)``; in amperes and volts.
    element_names : mapping of str to tuple of str
        Per kind (`KINDS`) one name an element.
    place : mapping of str to ndarray of int64, shape (elements, 2)
        Per kind the index into `files` and the line of every element.
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
        What it was made of, where that is no deck.
    """

    title: str | None
    path: str
    dialect: str
    node_names: tuple[str, ...]
    resistor_nodes: NDArray[np.int32]
    resistance: NDArray[np.float64]
    source_nodes: NDArray[np.int32]
    source_volts: NDArray[np.float64]
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
        for array in (*(getattr(self, name) for name in _ARRAYS), *self.place.values()):
            if array is not None:
                array.flags.writeable = False

    def place_of(self, kind: str, element: int) -> str:
        """``file:line`` of an element.

        Parameters
        ----------
        kind : str
            One of `KINDS`.
        element : int
            Its index among those of its kind.

        Returns
        -------
        str
        """
        file, line = self.place[kind][element].tolist()
        return f"{self.files[file]}:{line}"

    @property
    def heating(self) -> float:
        """How far the deck's temperature lies above the nominal one, in kelvin."""
        usual = DIALECTS[self.dialect].nominal_temperature if self.dialect in DIALECTS else NOMINAL_TEMPERATURE
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
        keeps = ~short
        all_kept = bool(keeps.all())
        names = self.element_names
        if not all_kept:
            names = dict(names)
            names["resistor"] = tuple(_pick(names["resistor"], keeps))
            names["voltage source"] += tuple(_pick(self.element_names["resistor"], short))
        shorts = self.resistor_nodes[short]
        return Netlist(
            node_count=len(self.node_names),
            resistor_nodes=self.resistor_nodes if all_kept else self.resistor_nodes[keeps],
            conductance=1.0 / resistance[keeps],
            source_nodes=np.concatenate([self.source_nodes, shorts]),
            source_volts=np.concatenate([self.source_volts, np.zeros(len(shorts))]),
            current_nodes=self.current_nodes,
            current_amps=self.current_amps,
            capacitor_nodes=self.capacitor_nodes,
            capacitance=self.capacitance,
            nonlinear_nodes=self.nonlinear_nodes,
            nonlinear_current=self.nonlinear_current,
            nonlinear_voltage=self.nonlinear_voltage,
            tc1=None if tc1 is None else tc1[keeps],
            tc2=None if tc2 is None else tc2[keeps],
            node_names=self.node_names,
            element_names=names,
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
    zero: Any = 0.0
    first, second = zero if tc1 is None else tc1, zero if tc2 is None else tc2
    factor = 1.0 + (first + second * heating) * heating
    with np.errstate(divide="ignore", invalid="ignore"):
        new_first = (first + 2.0 * second * heating) / factor
        new_second = second / factor
    bad = factor == 0
    shape = resistance.shape
    return (
        resistance * factor,
        np.broadcast_to(np.where(bad, 0.0, new_first), shape).copy(),
        None if tc2 is None else np.broadcast_to(np.where(bad, 0.0, new_second), shape).copy(),
    )


def ngspice_name(name: str) -> str:
    """How ngspice spells the name of an element: ``r1``, but ``r.x1.r1`` for one inside a subcircuit.

    Examples
    --------
    >>> ngspice_name("V1"), ngspice_name("X1.X2.Vdd")
    ('v1', 'v.x1.x2.vdd')
    """
    folded = name.lower()
    leaf = folded.rpartition(".")[2]
    return f"{leaf[:1]}.{folded}" if "." in folded else folded


def _pick(names: tuple[str, ...], which: NDArray[np.bool_]) -> list[str]:
    return [names[i] for i in np.flatnonzero(which).tolist()]
