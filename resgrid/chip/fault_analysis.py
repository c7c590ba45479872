"""Which faults matter: how many starts lose their way when one resistor or switch of a chip is open, or shorted.

A fault changes one conductance, and with it all voltages by a multiple of one vector (Sherman & Morrison 1950): with
``z = A^-1 w``, ``w`` being 1 and -1 at the ends of the element, across which ``d`` volts lie, a change ``delta`` of its
conductance changes the voltages by ``-delta d z / (1 + delta w . z)``.  That is right to rounding over the denominator:
where that is small, because leaks alone join what the element did, the voltages are corrected once by what they leave
of KCL.  Where an open cuts the circuit in two the denominator vanishes, and the circuit is solved anew, as it is for
nonlinear resistors.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import Positive, check_whole
from resgrid.chip.effects.base import cells_with_nodes, without_stranded_currents
from resgrid.chip.figures_of_merit import Figure, Result
from resgrid.chip.monte_carlo import arrivals, converter_of, neighbours_of
from resgrid.chip.yields import checked_starts
from resgrid.circuit.dynamics import Dynamics, dynamics_of
from resgrid.circuit.solve import solve
from resgrid.core.netlist import Netlist, add_elements, select_elements
from resgrid.core.random_sites import end_names
from resgrid.errors import CircuitError, InputError
from resgrid.scene.chip import Readout
from resgrid.solvers.supernodal import factor_supernodes

IDEAL_BITS = 40
"""Resolution of an ideal read-out here: a step of 1e-12 of the supply, which rounding does not reach."""

_BLOCK = 128
_LEAKY, _BRIDGE = 1e-3, 1e-9
"""Denominators below which voltages are corrected, and solved anew."""

_WORST = 10

Solve = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""From currents into the rows to their voltages, both (n,)."""


@dataclass(frozen=True, eq=False, repr=False)
class Criticality(Result):
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
        check_whole("count", count, 0)
        lost = np.nan_to_num(self.lost(fault))
        order = np.argsort(-lost, kind="stable")[:count]
        return order[lost[order] > 0]

    @property
    def figures(self) -> Mapping[str, Figure]:
        """The figures of merit by name, with units and definitions."""
        through = "an ideal read-out" if self.ideal else f"a {self.bits}-bit read-out without offset and noise"
        result = {
            "starts_served": Figure(
                self.served, "", f"starts that reach a goal on the faultless chip through {through}"
            ),
            "elements_examined": Figure(
                self.examined,
                "",
                f"resistors, switches and stretches of rail that were made faulty, of {len(self.open)}",
            ),
        }
        faults = {"open": "is open", "short": f"is a short of {self.short_resistance:g} ohm"}
        for name, what in faults.items():
            lost = self.lost(name)
            known = lost[np.isfinite(lost)]
            result[f"critical_{name}"] = Figure(
                int((known > 0).sum()), "", f"elements of which each alone costs at least one start when it {what}"
            )
            result[f"most_lost_{name}"] = Figure(
                int(known.max(initial=0)), "", f"starts lost when the worst single element {what}"
            )
            result[f"mean_lost_{name}"] = Figure(
                float(known.mean()) if known.size else None, "", f"starts lost when a random single element {what}"
            )
        return result

    def to_json(self) -> dict[str, Any]:
        """The figures and the worst elements, as plain values."""
        listed = {}
        for fault in ("open", "short"):
            worst = self.worst(fault)
            counts = zip(end_names(self.netlist, worst), self.lost(fault)[worst].tolist(), strict=True)
            listed[f"worst_{fault}"] = [{"nodes": pair, "starts_lost": int(count)} for pair, count in counts]
        return {**super().to_json(), **listed}

    def lost(self, fault: str) -> NDArray[np.float64]:
        """Starts lost by every element with a fault, "open" or "short"."""
        if fault not in ("open", "short"):
            raise InputError(f"fault = {fault!r} is unknown; it may be 'open' or 'short'")
        return self.open if fault == "open" else self.short


def analyse_criticality(
    netlist: Netlist,
    *,
    readout: Readout | None = None,
    starts: ArrayLike | None = None,
    short_resistance: Positive | None = None,
    seconds: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Criticality:
    """Make every resistor and switch of the chip faulty, one at a time, and count the starts that are lost.

    `readout`: what the robot sees, by default the chip's; its offset and noise do not count, and an ideal one has 40
    bits, which tell steps of 1e-12 of the supply; `starts`: a mask of cells, by default every free cell with a way to a
    goal; `short_resistance`: in ohms, by default the chip's; `seconds`: after which no further element is examined,
    those with the largest currents being the first; `progress`: called with the elements done and those in all.
    """
    cells = cells_with_nodes(netlist, "faults that cost starts")
    short_resistance = 1.0 if short_resistance is None else short_resistance
    readout = readout or Readout()
    bits = IDEAL_BITS if readout.bits is None else readout.bits
    converter = converter_of(Readout(range=readout.range), cells)
    converter = dataclasses.replace(converter, steps=2.0**bits)  # maybe more than a chip may have
    neighbours = neighbours_of(cells)
    mask = cells.space.goal_connected
    mask = (mask if starts is None else mask & checked_starts(cells.space, starts)).ravel()
    op = solve(netlist)
    through = np.append(np.abs(op.resistor_current), np.abs(op.nonlinear_amps))
    order = np.argsort(-np.nan_to_num(through), kind="stable")
    before = arrivals(op.voltage, neighbours, converter) & mask
    lost = np.full((2, len(order)), np.nan)
    end = np.inf if seconds is None else time.monotonic() + seconds
    for number, (element, *faulty) in enumerate(faulty_voltages(netlist, op.voltage, order, short_resistance)):
        for fault, volts in enumerate(faulty):
            lost[fault, element] = int((before & ~arrivals(volts, neighbours, converter)).sum())
        if number % _BLOCK == 0:
            if progress is not None:
                progress(number, len(order))
            if time.monotonic() > end:
                break
    return Criticality(netlist, int(before.sum()), lost[0], lost[1], short_resistance, bits, readout.bits is None)


def faulty_voltages(
    netlist: Netlist, volts: NDArray[np.float64], order: NDArray[np.int64], short_resistance: float
) -> Iterator[tuple[int, NDArray[np.float64], NDArray[np.float64]]]:
    """An element after the other, and the voltages of all nodes when it is open, and when it is shorted."""
    rows = solve_rows = None
    if not netlist.nonlinear_nodes.size:
        rows = dynamics_of(netlist.replace(capacitor_nodes=[], capacitance=[]))
        solve_rows = factor_supernodes(rows.conductance).solve if rows.size else np.copy
    for element in order.tolist():
        change = None if rows is None or solve_rows is None else _Change.of(rows, solve_rows, volts, element)
        voltages = []
        for siemens in (0.0, 1.0 / short_resistance):
            changed = None if change is None else change.voltages(siemens)
            voltages.append(_solved(netlist, element, siemens) if changed is None else changed)
        yield element, voltages[0], voltages[1]


@dataclass(frozen=True, eq=False)
class _Change:
    """A change of the conductance of one element, between nodes `a` and `b`, of a linear circuit.

    `volts` (nodes,): before it; `z` (nodes,): ``A^-1 w``, 0 where voltages are known.
    """

    rows: Dynamics
    solve: Solve
    volts: NDArray[np.float64]
    element: int
    z: NDArray[np.float64]

    @classmethod
    def of(cls, rows: Dynamics, solve: Solve, volts: NDArray[np.float64], element: int) -> _Change:
        """Find what a current through the element does."""
        w = rows.injection(rows.netlist.resistor_nodes[element], np.array([1.0, -1.0]))
        return cls(rows, solve, volts, element, rows.at_nodes(solve(w)))

    def _across(self, volts: NDArray[np.float64]) -> float:
        a, b = self.rows.netlist.resistor_nodes[self.element]
        return float(volts[a] - volts[b])

    def voltages(self, siemens: float) -> NDArray[np.float64] | None:
        """Voltages of all nodes at another conductance; None where the other elements do not determine them."""
        delta = siemens - float(self.rows.netlist.conductance[self.element])
        rest = 1.0 + delta * self._across(self.z)
        if not rest > _BRIDGE:
            return None
        changed = self.volts - delta * self._across(self.volts) / rest * self.z
        if rest < _LEAKY:
            y = self.rows.at_nodes(self.solve(self._lacking(changed, siemens)))
            changed += y - delta * self._across(y) / rest * self.z
        return np.asarray(changed)

    def _lacking(self, volts: NDArray[np.float64], siemens: float) -> NDArray[np.float64]:
        """Current that KCL lacks at every row at voltages (nodes,) and another conductance, in amperes."""
        netlist = self.rows.netlist
        conductance = netlist.conductance.copy()
        conductance[self.element] = siemens
        ends = np.concatenate([netlist.resistor_nodes, netlist.current_nodes])
        flow = np.append(conductance * np.subtract(*volts[netlist.resistor_nodes.T]), netlist.current_amps)
        return self.rows.injection(ends[:, 1], flow) - self.rows.injection(ends[:, 0], flow)


def _solved(netlist: Netlist, element: int, siemens: float) -> NDArray[np.float64]:
    """Voltages when an element has another conductance, solved anew; NaN where there is no operating point."""
    try:
        return solve(_faulty(netlist, element, siemens), accuracy="normwise").voltage
    except CircuitError:
        return np.full(netlist.node_count, np.nan)


def _faulty(netlist: Netlist, element: int, siemens: float) -> Netlist:
    linear = len(netlist.conductance)
    if element < linear:
        keep = np.arange(linear) != element
        if siemens:
            return netlist.replace(conductance=np.where(keep, netlist.conductance, siemens))
        return without_stranded_currents(select_elements(netlist, "resistor", keep))
    keep = np.arange(len(netlist.nonlinear_current)) != element - linear
    bare = select_elements(netlist, "nonlinear resistor", keep)
    if siemens:
        return add_elements(bare, "resistor", netlist.nonlinear_nodes[~keep], siemens)
    return without_stranded_currents(bare)
