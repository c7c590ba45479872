"""Which faults matter: how many starts lose their way when one resistor or switch of a chip is open, or shorted.

A fault changes one conductance, and with it all voltages by a multiple of one vector (Sherman & Morrison 1950): with
``z = A^-1 w``, ``w`` being 1 and -1 at the ends of the element, across which ``d`` volts lie, a change ``delta`` of its
conductance changes the voltages by ``-delta d z / (1 + delta w . z)``.  That is right to rounding over the denominator:
where that is small, because leaks alone join what the element did, the voltages are corrected once by what they leave
of KCL.  Where an open cuts the circuit in two the denominator vanishes, and the circuit is solved anew, as it is for
nonlinear resistors.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.arguments import check_number, check_whole, is_number
from resgrid.chip.figures import Reading, json_form
from resgrid.chip.passes import editing
from resgrid.chip.passes.spread import without_stranded_currents
from resgrid.chip.readout import Eyes, Floor, eyes_of, floor_of, walk
from resgrid.errors import CircuitError, InputError
from resgrid.frozen import frozen, picture_html
from resgrid.netlist import Netlist
from resgrid.nodal.solve import solve
from resgrid.nodal.superlu import symmetric_factors
from resgrid.nodal.system import NodalSystem, assemble
from resgrid.scene.chip import Readout

IDEAL_BITS = 40
"""Resolution of an ideal read-out here: a step of 1e-12 of the supply, which rounding does not reach."""

_BLOCK = 128
_LEAKY, _BRIDGE = 1e-3, 1e-9
"""Denominators below which voltages are corrected, and solved anew."""

_WORST = 10


@frozen
@dataclass(frozen=True, eq=False)
class Criticality:
    """What single faults do to a chip.

    Attributes
    ----------
    netlist : Netlist
        The chip.
    served : int
        Starts that reach a goal without a fault.
    open, short : ndarray of float64, shape (elements,)
        Starts among them that no longer do when the element is open, or shorted; resistors (switches and rails
        included), then nonlinear resistors; NaN where time ran out.
    short_resistance : float
        Of a short, in ohms.
    bits : int
        Of the read-out that the robot sees, without offset and noise.
    ideal : bool
        Whether that stands for an ideal read-out.
    """

    netlist: Netlist
    served: int
    open: NDArray[np.float64]
    short: NDArray[np.float64]
    short_resistance: float
    bits: int
    ideal: bool

    _repr_html_ = picture_html

    @property
    def examined(self) -> int:
        """Elements that were examined."""
        return int(np.isfinite(self.open).sum())

    def worst(self, fault: str = "open", count: int = _WORST) -> NDArray[np.int64]:
        """Numbers of the elements whose ``fault``, "open" or "short", costs most starts, worst first; at least one.

        Raises
        ------
        InputError
            If it is another fault, or the count is no whole number.
        """
        if fault not in ("open", "short"):
            raise InputError(f"fault = {fault!r} is unknown; it may be 'open' or 'short'")
        check_whole("count", count, 0)
        lost = np.nan_to_num(self.open if fault == "open" else self.short)
        order = np.argsort(-lost, kind="stable")[:count]
        return order[lost[order] > 0]

    @property
    def readings(self) -> Mapping[str, Reading]:
        """The figures, with units and definitions."""
        seen = "an ideal read-out" if self.ideal else f"a {self.bits}-bit read-out without offset and noise"
        result = {
            "starts_served": Reading(self.served, "", f"starts that reach a goal on the faultless chip through {seen}"),
            "elements_examined": Reading(
                self.examined,
                "",
                f"resistors, switches and stretches of rail that were made faulty, of {len(self.open)}",
            ),
        }
        faults = {"open": "is open", "short": f"is a short of {self.short_resistance:g} ohm"}
        for name, what in faults.items():
            lost = getattr(self, name)
            known = lost[np.isfinite(lost)]
            result[f"critical_{name}"] = Reading(
                int((known > 0).sum()), "", f"elements of which each alone costs at least one start when it {what}"
            )
            result[f"most_lost_{name}"] = Reading(
                int(known.max(initial=0)), "", f"starts lost when the worst single element {what}"
            )
            result[f"mean_lost_{name}"] = Reading(
                float(known.mean()) if known.size else None, "", f"starts lost when a random single element {what}"
            )
        return result

    def to_json(self) -> dict[str, Any]:
        """The readings and the worst elements, as plain values."""
        ends = np.concatenate([self.netlist.resistor_nodes, self.netlist.nonlinear_nodes])
        listed = {}
        for fault in ("open", "short"):
            worst = self.worst(fault)
            names = zip(*(self.netlist.names_of(ends[worst, end]) for end in (0, 1)), strict=True)
            lost = (self.open if fault == "open" else self.short)[worst]
            listed[f"worst_{fault}"] = [
                {"nodes": list(pair), "starts_lost": int(count)} for pair, count in zip(names, lost, strict=True)
            ]
        return {**json_form(self.readings), **listed}


def analyse_criticality(
    netlist: Netlist,
    readout: Readout | None = None,
    *,
    starts: ArrayLike | None = None,
    short_resistance: float = 1.0,
    seconds: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Criticality:
    """Make every resistor and switch of a chip faulty, one at a time, and count the starts that are lost.

    Parameters
    ----------
    netlist : Netlist
        One chip, with one node per cell.
    readout : Readout, optional
        What the robot sees; its offset and noise do not count.  Ideal by default: 40 bits, which only tells steps of
        more than 1e-12 of the supply.
    starts : array_like of bool, shape of the space, optional
        By default every free cell with a way to a goal.
    short_resistance : float
        In ohms.
    seconds : float, optional
        Time after which no further element is examined; those with the largest currents come first.
    progress : callable, optional
        Called now and then with the elements done and those in all.

    Returns
    -------
    Criticality

    Raises
    ------
    InputError
        If an argument is not admissible or the netlist has not one node per cell.
    CircuitError
        If the chip has no operating point.
    """
    cell_map = editing.tiled_layout(netlist, "faults that cost starts")
    check_number("short_resistance", short_resistance, "positive and finite, in ohms", above=0.0)
    if seconds is not None and not (is_number(seconds) or seconds == np.inf):
        raise InputError(f"seconds = {seconds!r} must be a number, or None for as long as it takes")
    readout = readout or Readout()
    bits = IDEAL_BITS if readout.bits is None else readout.bits
    eyes = eyes_of(Readout(range=readout.range), cell_map, None)
    sight = _Sight(netlist, floor_of(cell_map), _with_bits(eyes, bits), _mask(netlist, starts))
    point = solve(netlist)
    through = np.append(np.abs(point.resistor_current), np.abs(point.nonlinear_amps))
    order = np.argsort(-np.nan_to_num(through), kind="stable")
    before = sight.arrivals(point.voltage)
    lost = np.full((2, len(order)), np.nan)
    end = np.inf if seconds is None else time.monotonic() + seconds
    voltages = _anew if netlist.nonlinear_nodes.size else _updated
    for number, (element, *faulty) in enumerate(voltages(netlist, point.voltage, order, short_resistance)):
        for fault, volts in enumerate(faulty):
            lost[fault, element] = int((before & ~sight.arrivals(volts)).sum())
        if number % _BLOCK == 0:
            if progress is not None:
                progress(number, len(order))
            if time.monotonic() > end:
                break
    return Criticality(netlist, int(before.sum()), lost[0], lost[1], short_resistance, bits, readout.bits is None)


@dataclass(frozen=True, eq=False)
class _Sight:
    netlist: Netlist
    floor: Floor
    eyes: Eyes
    starts: NDArray[np.bool_]

    def arrivals(self, volts: NDArray[np.float64]) -> NDArray[np.bool_]:
        return walk(volts, self.floor, self.eyes) & self.starts


def _with_bits(eyes: Eyes, bits: int) -> Eyes:
    return Eyes(eyes.low, eyes.span, 2.0**bits, 0.0, eyes.noise, eyes.falling)


def _mask(netlist: Netlist, starts: ArrayLike | None) -> NDArray[np.bool_]:
    way = netlist.cells.space.goal_connected
    mask = way if starts is None else np.asarray(starts)
    if mask.dtype != np.bool_ or mask.shape != way.shape:
        raise InputError(f"starts must be True or False for every cell, shape {way.shape}")
    return np.asarray((mask & way).ravel())


_Faulty = tuple[int, NDArray[np.float64], NDArray[np.float64]]
"""An element, and the voltages of all nodes when it is open, and when it is shorted."""


def _updated(
    netlist: Netlist, volts: NDArray[np.float64], order: NDArray[np.int64], short_resistance: float
) -> Iterator[_Faulty]:
    """Voltages by updates of the solution, some elements at a time."""
    system = assemble(netlist)
    factors = symmetric_factors(system.matrix) if system.size else None
    for begin in range(0, len(order), _BLOCK):
        block = order[begin : begin + _BLOCK]
        spread = _responses(system, factors, netlist.resistor_nodes[block])
        for element, z in zip(block.tolist(), spread, strict=True):
            opened = _changed(system, factors, volts, element, 0.0, z)
            if opened is None:
                opened = _solved(_without(netlist, element), len(volts))
            shorted = _changed(system, factors, volts, element, 1.0 / short_resistance, z)
            if shorted is None:
                shorted = _solved(_shorted(netlist, element, short_resistance), len(volts))
            yield element, opened, shorted


def _changed(
    system: NodalSystem, factors: Any, volts: NDArray[np.float64], element: int, siemens: float, z: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Voltages when an element has another conductance; None where the others do not determine them."""
    a, b = system.netlist.resistor_nodes[element]
    delta = siemens - float(system.netlist.conductance[element])
    rest = 1.0 + delta * float(z[a] - z[b])
    if not rest > _BRIDGE:
        return None
    changed = volts - delta * float(volts[a] - volts[b]) / rest * z
    if rest < _LEAKY:
        y = _spread(system, factors.solve(_imbalance(system, changed, element, siemens)))
        changed += y - delta * float(y[a] - y[b]) / rest * z
    return np.asarray(changed)


def _responses(system: NodalSystem, factors: Any, ends: NDArray[np.int32]) -> NDArray[np.float64]:
    """``A^-1 w`` at all nodes for every element, shape (elements, nodes); 0 where voltages are known."""
    w = np.zeros((system.size, len(ends)))
    for column, sign in ((0, 1.0), (1, -1.0)):
        row = system.unknown[ends[:, column]]
        inside = np.flatnonzero(row >= 0)
        w[row[inside], inside] += sign
    return _spread(system, factors.solve(w) if factors is not None else w)


def _spread(system: NodalSystem, rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values of rows, shape (n,) or (n, k), at nodes, shape (nodes,) or (k, nodes); 0 where voltages are known."""
    result = np.zeros((*rows.shape[1:], len(system.unknown)))
    solved = np.flatnonzero(system.unknown >= 0)
    result[..., solved] = rows.T[..., system.unknown[solved]]
    return result


def _imbalance(system: NodalSystem, volts: NDArray[np.float64], element: int, siemens: float) -> NDArray[np.float64]:
    """Current that KCL lacks at every row when an element has another conductance, in amperes, shape (n,)."""
    netlist = system.netlist
    conductance = netlist.conductance.copy()
    conductance[element] = siemens
    across = volts[netlist.resistor_nodes[:, 0]] - volts[netlist.resistor_nodes[:, 1]]
    flow = np.append(conductance * across, netlist.current_amps)
    row = system.unknown[np.concatenate([netlist.resistor_nodes, netlist.current_nodes])]
    imbalance = np.zeros(system.size)
    for end, sign in ((0, -1.0), (1, 1.0)):
        inside = row[:, end] >= 0
        imbalance += sign * np.bincount(row[inside, end], flow[inside], system.size)
    return imbalance


def _anew(
    netlist: Netlist, _volts: NDArray[np.float64], order: NDArray[np.int64], short_resistance: float
) -> Iterator[_Faulty]:
    """Voltages by solving every faulty chip."""
    count = netlist.node_count
    for element in order.tolist():
        shorted = _shorted(netlist, element, short_resistance)
        yield element, _solved(_without(netlist, element), count), _solved(shorted, count)


def _solved(netlist: Netlist, count: int) -> NDArray[np.float64]:
    try:
        return solve(netlist, accuracy="normwise").voltage
    except CircuitError:
        return np.full(count, np.nan)


def _without(netlist: Netlist, element: int) -> Netlist:
    linear = len(netlist.conductance)
    if element < linear:
        return without_stranded_currents(editing.keep_resistors(netlist, np.arange(linear) != element))
    keep = np.arange(len(netlist.nonlinear_current)) != element - linear
    return without_stranded_currents(editing.keep_nonlinear(netlist, keep))


def _shorted(netlist: Netlist, element: int, ohms: float) -> Netlist:
    linear = len(netlist.conductance)
    if element < linear:
        conductance = netlist.conductance.copy()
        conductance[element] = 1.0 / ohms
        return netlist.replace(conductance=conductance)
    pair = netlist.nonlinear_nodes[element - linear : element - linear + 1]
    bare = _without_nonlinear(netlist, element - linear)
    return editing.add_resistors(bare, pair, np.array([1.0 / ohms]))


def _without_nonlinear(netlist: Netlist, number: int) -> Netlist:
    return editing.keep_nonlinear(netlist, np.arange(len(netlist.nonlinear_current)) != number)
