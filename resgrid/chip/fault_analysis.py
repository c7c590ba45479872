"""Fault analysis: the number of starts lost when one resistor or switch of a chip is open or shorted.

A fault changes one conductance, and the change of all voltages is a multiple of one vector (Sherman & Morrison 1950).
With the conductance matrix ``A``, let ``w`` be 1 and -1 at the ends of the element, ``d`` the voltage across it, and
``z = A^-1 w``.  A change ``delta`` of the conductance changes the voltages by ``-delta d z / (1 + delta w . z)``.  The
relative error is the rounding error over the denominator.  The denominator is small where, without the element, only
leakage connects its two ends; one step of iterative refinement then corrects the voltages.  The denominator vanishes
where an open cuts the circuit in two; such a fault, and every fault of a circuit with nonlinear resistors, is solved
from scratch.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import check_whole
from resgrid.chip.effects.base import cells_with_nodes, without_stranded_currents
from resgrid.chip.figures_of_merit import Figure, Result
from resgrid.chip.walk import converter_of, neighbours_of, reaches_goal
from resgrid.chip.yields import checked_starts
from resgrid.circuit.dynamics import Dynamics, dynamics_of
from resgrid.circuit.solve import solve
from resgrid.core.netlist import Netlist, add_elements, select_elements
from resgrid.core.random_sites import end_names
from resgrid.errors import CircuitError, InputError
from resgrid.scene.chip import Readout
from resgrid.solvers.supernodal import factor_supernodes

IDEAL_BITS = 40
"""Resolution in bits that stands for an ideal read-out; one step is 1e-12 of the converter's range, above rounding
errors.
"""

_BLOCK = 128
"""Number of elements between two calls of the progress function and checks of the time limit."""
_LEAKY, _BRIDGE = 1e-3, 1e-9
"""Limits on the denominator ``1 + delta r`` of the voltage update for a fault, without unit.

``delta`` is the change of the element's conductance in siemens, ``r`` the resistance in ohms that the circuit without a
fault has between the ends of the element.  Below `_LEAKY` the voltages get a step of iterative refinement.  At or below
`_BRIDGE` the faulty circuit is solved from scratch.
"""

_WORST = 10
"""Default maximum number of elements in a list of the most harmful ones."""

Solve = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Function from currents into the rows (unknown voltages), in amperes, to the voltages of the rows in volts, both (n,).
"""


@dataclass(frozen=True, eq=False, repr=False)
class FaultAnalysis(Result):
    """Number of starts lost by single faults of a chip.

    Returned by `resgrid.chip.Study.faults`.

    Attributes
    ----------
    netlist : Netlist
        The chip.
    served : int
        Number of starts that reach a goal without a fault.
    open, short : ndarray of float64, shape (elements,)
        Number of the starts counted in `served` that do not reach a goal when the element is open, or shorted.  Linear
        resistors (switches and rail segments included) come first, then nonlinear resistors.  NaN for elements not
        examined within the time limit.
    short_resistance : float
        Resistance of a short, in ohms.
    bits : int
        Resolution of the read-out, which has neither offset nor noise.
    ideal : bool
        Whether `bits` stands for an ideal read-out.
    examined : int
        Number of elements that were made faulty.
    figures : mapping of str to Figure
        Figures of merit by name.

    Examples
    --------
    >>> chip = rg.Chip(readout=rg.chip.Readout(bits=8))
    >>> faults = rg.study(rg.read_scene("examples/scenes/lesson.toml"), chip).faults()
    >>> faults.served, faults.examined
    (40, 144)
    >>> worst = faults.worst("open", count=3)
    >>> faults.lost("open")[worst], faults.netlist.names_of(faults.netlist.resistor_nodes[worst[0]])
    (array([5., 5., 5.]), ['n_5_3', 'n_5_4'])
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
        """Number of elements that were made faulty."""
        return int(np.isfinite(self.open).sum())

    def worst(self, fault: str = "open", count: int = _WORST) -> NDArray[np.int64]:
        """Return the numbers of the elements whose fault costs most starts, worst first.

        Elements whose fault costs no start are left out.

        Parameters
        ----------
        fault : {"open", "short"}
            The fault.
        count : int
            Maximum number of elements.

        Returns
        -------
        ndarray of int64, shape (at most count,)
            Indices of the elements, in the order of `open` and `short`.

        Raises
        ------
        InputError
            If the fault is unknown, or `count` is not a whole number of at least 0.
        """
        check_whole("count", count, 0)
        lost = np.nan_to_num(self.lost(fault))
        order = np.argsort(-lost, kind="stable")[:count]
        return order[lost[order] > 0]

    @property
    def figures(self) -> Mapping[str, Figure]:
        """Figures of merit by name: numbers of examined and critical elements, and of lost starts.

        ``starts_served``: starts that reach a goal without a fault; ``elements_examined``; and for open elements (for
        shorts with ``short`` in place of ``open``) ``critical_open``: elements whose fault costs a start;
        ``most_lost_open`` and ``mean_lost_open``: starts lost by the worst and by a random fault, the mean None if no
        element was examined.
        """
        through = "an ideal read-out" if self.ideal else f"a {self.bits}-bit read-out without offset and noise"
        result = {
            "starts_served": Figure(
                self.served, "", f"starts that reach a goal on the faultless chip through {through}"
            ),
            "elements_examined": Figure(
                self.examined,
                "",
                f"resistors, switches and rail segments that were made faulty, of {len(self.open)}",
            ),
        }
        faults = {"open": "is open", "short": f"is a short of {self.short_resistance:g} ohm"}
        for name, state in faults.items():
            lost = self.lost(name)
            known = lost[np.isfinite(lost)]
            result[f"critical_{name}"] = Figure(
                int((known > 0).sum()), "", f"elements that each cost at least one start when the element {state}"
            )
            result[f"most_lost_{name}"] = Figure(
                int(known.max(initial=0)), "", f"starts lost when the worst single element {state}"
            )
            result[f"mean_lost_{name}"] = Figure(
                float(known.mean()) if known.size else None,
                "",
                f"mean number of starts lost when a random single element {state}",
            )
        return result

    def to_json(self) -> dict[str, Any]:
        """Return the result as a dictionary for JSON.

        Keys: the names of `figures`, each with a dictionary of ``value``, ``unit`` and ``definition``; ``worst_open``
        and ``worst_short``: lists of the worst elements, each with ``nodes`` (names of both nodes) and ``starts_lost``.
        """
        listed = {}
        for fault in ("open", "short"):
            worst = self.worst(fault)
            counts = zip(end_names(self.netlist, worst), self.lost(fault)[worst].tolist(), strict=True)
            listed[f"worst_{fault}"] = [{"nodes": pair, "starts_lost": int(count)} for pair, count in counts]
        return {**super().to_json(), **listed}

    def lost(self, fault: str) -> NDArray[np.float64]:
        """Return for every element the number of starts counted in `served` that its fault keeps from reaching a goal.

        Parameters
        ----------
        fault : {"open", "short"}
            The fault.

        Returns
        -------
        ndarray of float64, shape (elements,)
            Numbers of starts; NaN for elements not examined within the time limit.

        Raises
        ------
        InputError
            If the fault is unknown.
        """
        if fault not in ("open", "short"):
            raise InputError(f"fault = {fault!r} is unknown; it may be 'open' or 'short'")
        return self.open if fault == "open" else self.short


def analyse_faults(
    netlist: Netlist,
    readout: Readout,
    short_resistance: float,
    *,
    starts: ArrayLike | None = None,
    seconds: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> FaultAnalysis:
    """Simulate an open and a short of every element of a netlist, and count the starts that each fault loses.

    `readout`: read-out of the chip, whose offset and noise are ignored; `short_resistance`: resistance of a short, in
    ohms; `starts` (shape of the space): mask of the start cells, None for all cells with a path to a goal; `seconds`:
    time limit in seconds, None for no limit; `progress`: function called with the numbers of finished and of all
    elements.  Elements are examined in descending order of their currents, so that a time limit leaves out those with
    the smallest currents.  Returns a FaultAnalysis.
    """
    cells = cells_with_nodes(netlist, "faults that cost starts")
    bits = IDEAL_BITS if readout.bits is None else readout.bits
    converter = converter_of(Readout(range=readout.range), cells)
    converter = dataclasses.replace(converter, steps=2.0**bits)  # may exceed the limit of a Readout
    neighbours = neighbours_of(cells)
    mask = cells.space.goal_connected
    mask = (mask if starts is None else mask & checked_starts(cells.space, starts)).ravel()
    op = solve(netlist)
    through = np.append(np.abs(op.resistor_current), np.abs(op.nonlinear_amps))
    order = np.argsort(-np.nan_to_num(through), kind="stable")
    before = reaches_goal(op.voltage, neighbours, converter) & mask
    lost = np.full((2, len(order)), np.nan)
    end = np.inf if seconds is None else time.monotonic() + seconds
    for number, (element, *faulty) in enumerate(faulty_voltages(netlist, op.voltage, order, short_resistance)):
        for fault, volts in enumerate(faulty):
            lost[fault, element] = int((before & ~reaches_goal(volts, neighbours, converter)).sum())
        if number % _BLOCK == 0:
            if progress is not None:
                progress(number, len(order))
            if time.monotonic() > end:
                break
    return FaultAnalysis(netlist, int(before.sum()), lost[0], lost[1], short_resistance, bits, readout.bits is None)


def faulty_voltages(
    netlist: Netlist, volts: NDArray[np.float64], order: NDArray[np.int64], short_resistance: float
) -> Iterator[tuple[int, NDArray[np.float64], NDArray[np.float64]]]:
    """Yield each element and the node voltages (nodes,) in volts with the element open, and with the element shorted.

    `volts` (nodes,): voltages without a fault; `order` (elements,): numbers of the elements (linear resistors first,
    then nonlinear ones), in the order of simulation; `short_resistance`: resistance of a short, in ohms.  Voltages are
    NaN if the faulty circuit has no operating point.
    """
    rows = solve_rows = None
    if not netlist.nonlinear_nodes.size:
        rows = dynamics_of(netlist.replace(capacitor_nodes=[], capacitance=[]))
        solve_rows = factor_supernodes(rows.conductance).solve if rows.size else np.copy
    for element in order.tolist():
        change = None if rows is None or solve_rows is None else _Change.of(rows, solve_rows, volts, element)
        voltages = []
        for siemens in (0.0, 1.0 / short_resistance):
            changed = None if change is None else change.voltages(siemens)
            voltages.append(_voltages_with(netlist, element, siemens) if changed is None else changed)
        yield element, voltages[0], voltages[1]


@dataclass(frozen=True, eq=False)
class _Change:
    """A change of the conductance of one resistor of a linear circuit with the conductance matrix ``A``.

    `rows`: equations of the circuit; `solve`: function that multiplies currents (n,) by ``A^-1``; `volts` (nodes,):
    voltages before the change, in volts; `element`: number of the resistor; `z` (nodes,): voltages for 1 A into the
    first end of the resistor and out of the second, 0 where voltages are known.
    """

    rows: Dynamics
    solve: Solve
    volts: NDArray[np.float64]
    element: int
    z: NDArray[np.float64]

    @classmethod
    def of(cls, rows: Dynamics, solve: Solve, volts: NDArray[np.float64], element: int) -> _Change:
        """Return the change of a resistor's conductance, with the voltages ``z`` for 1 A through its ends.

        `rows`: equations of the circuit; `solve`: function that multiplies by the inverse conductance matrix; `volts`
        (nodes,): voltages before the change, in volts; `element`: number of the resistor.
        """
        w = rows.injection(rows.netlist.resistor_nodes[element], np.array([1.0, -1.0]))
        return cls(rows, solve, volts, element, rows.at_nodes(solve(w)))

    def _across(self, volts: NDArray[np.float64]) -> float:
        """Return the difference of `volts` (nodes,) between the first and the second end of the resistor."""
        a, b = self.rows.netlist.resistor_nodes[self.element]
        return float(volts[a] - volts[b])

    def voltages(self, siemens: float) -> NDArray[np.float64] | None:
        """Return the node voltages in volts, shape (nodes,), when the resistor has the conductance `siemens`.

        Returns None if the circuit with this conductance is singular, or nearly so (see `_BRIDGE`).
        """
        delta = siemens - float(self.rows.netlist.conductance[self.element])
        rest = 1.0 + delta * self._across(self.z)
        if not rest > _BRIDGE:
            return None
        changed = self.volts - delta * self._across(self.volts) / rest * self.z
        if rest < _LEAKY:
            y = self.rows.at_nodes(self.solve(self._kcl_residual(changed, siemens)))
            changed += y - delta * self._across(y) / rest * self.z
        return np.asarray(changed)

    def _kcl_residual(self, volts: NDArray[np.float64], siemens: float) -> NDArray[np.float64]:
        """Return the residual of Kirchhoff's current law in every row (unknown voltage), in amperes, shape (n,).

        The residual is the sum of the currents into the node of the row, from resistors and current sources.  `volts`
        (nodes,): node voltages, in volts; `siemens`: new conductance of the resistor.
        """
        netlist = self.rows.netlist
        conductance = netlist.conductance.copy()
        conductance[self.element] = siemens
        ends = np.concatenate([netlist.resistor_nodes, netlist.current_nodes])
        flow = np.append(conductance * np.subtract(*volts[netlist.resistor_nodes.T]), netlist.current_amps)
        return self.rows.injection(ends[:, 1], flow) - self.rows.injection(ends[:, 0], flow)


def _voltages_with(netlist: Netlist, element: int, siemens: float) -> NDArray[np.float64]:
    """Return the node voltages in volts with another conductance of one element, shape (nodes,).

    All are NaN if the circuit has no operating point.  `element`: number of the element, linear resistors first, then
    nonlinear ones; `siemens`: new conductance, 0 for an open element.
    """
    try:
        return solve(_netlist_with(netlist, element, siemens), accuracy="normwise").voltage
    except CircuitError:
        return np.full(netlist.node_count, np.nan)


def _netlist_with(netlist: Netlist, element: int, siemens: float) -> Netlist:
    """Return the netlist with another conductance of one element.

    `element`: number of the element, linear resistors first, then nonlinear ones; `siemens`: new conductance; 0 removes
    the element.  A nonlinear resistor becomes a linear one.
    """
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
