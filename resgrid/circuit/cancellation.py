"""Operating points of circuits in which large voltages or currents cancel, by refinement in integer arithmetic.

A voltage or a current that remains after large values cancel cannot be the difference of rounded numbers.  Here
voltages and currents are integers, in units far below the smallest value of interest, and residuals are exact.  Each
step of iterative refinement, with factors that conserve current (`resgrid.solvers.conservative_factors`), gains about
53 binary digits.  The refinement ends when the energy of the last correction proves 60 binary digits of every voltage
and current, or proves that a value lies below a floor, a tiny fraction of the largest value.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.equations import Equations
from resgrid.circuit.sources import sum_cuts, without_loops
from resgrid.solvers.conservative_factors import Column, fixed, nearest, scaled, substitute
from resgrid.solvers.scaled import unscaled

_DEEP_FLOOR, _SHALLOW_FLOOR, _SMALL = 1000, 200, 1000
"""Negated binary exponents of the floor, and the largest number of rows for which the deeper floor applies.

The floor is the magnitude below which voltages and currents are set to zero: the largest one times ``2**-1000``, or
times ``2**-200`` in a larger circuit, since every 53 binary digits take a step of refinement.
"""

_DIGITS = 60
"""Number of proved correct binary digits that a value needs before it is rounded to the 53 digits of a double."""

_GUARD = 300
"""Number of binary digits of the integers below the floor, besides the digits for the range of the conductances.

The floor is the magnitude below which voltages and currents are set to zero.
"""

NEAR_FLOOR = 20
"""Binary logarithm of a multiple of the floor; KCL is not checked at nodes with less total current than this multiple.

The floor is the current below which currents are set to zero.  At such a node, some of the currents may have been set
to zero.
"""

_LEAST_AMPS = -2200
"""Lower limit on the estimate of the largest current, as a binary logarithm of amperes.

The limit applies to circuits without sources, and lies below the range of doubles.
"""

_TINY = float(np.finfo(np.float64).tiny)
"""Smallest normalized double; smaller currents, in amperes, lose digits."""

_MOST_STEPS = 200
"""Maximum number of steps of iterative refinement."""

Pairs = Sequence[tuple[int, int]]
"""Pairs of nodes, each a first and a second node."""


class RecoveredCurrents(NamedTuple):
    """Voltages and currents that obey Kirchhoff's current law even where large values cancel.

    `volts` (nodes,): voltages above ground in volts, NaN where a node floats; `heights` (nodes,): voltages in volts
    above the lowest known voltage; `amps` (resistors,): currents from the first end to the second, in amperes;
    `source_amps` (sources,): currents into the plus terminal in amperes, NaN in a loop of sources; `power`: total power
    of the resistors, in watts; `unchecked` (nodes,): whether all currents at a node are so small that some of them may
    have been set to zero; `entry_error`: bound on the relative error of every entry of `volts` and `heights`, infinite
    if no bound is known; `error_bound`: bound on the error of a voltage relative to the largest one, and of a current
    relative to the smaller of the total currents through its two end nodes; `floor`: fraction of the largest voltage or
    current below which values may have been set to zero; `falls` (k,): voltages in volts between the nodes of requested
    pairs, first minus second, each rounded once; None if no solution in integers was computed.
    """

    volts: NDArray[np.float64]
    heights: NDArray[np.float64]
    amps: NDArray[np.float64]
    source_amps: NDArray[np.float64]
    power: float
    unchecked: NDArray[np.bool_]
    entry_error: float = float(np.finfo(np.float64).eps)
    error_bound: float = 0.0
    floor: float = 0.0
    falls: NDArray[np.float64] | None = None


class _Resistor(NamedTuple):
    """A resistor of a component with current.

    `number`: index among all resistors; `nodes`: first and second node; `rows`: rows of the equations that belong to
    the nodes, -1 for a known voltage; `siemens`, `places`: the conductance is ``siemens / 2**places`` S; `log`: binary
    logarithm of the conductance in siemens.
    """

    number: int
    nodes: tuple[int, int]
    rows: tuple[int, int]
    siemens: int
    places: int
    log: float


def solve_in_integers(system: Equations, columns: list[Column], pairs: Pairs = ()) -> RecoveredCurrents | None:
    """Return the solution of the equations in integer arithmetic, or None if the refinement diverges.

    `columns`: elimination steps of the matrix ``system.laplacian``; `pairs`: pairs of nodes; the voltage between the
    two nodes of each pair is part of the solution.  Refinement may diverge after underflow in the factors.
    """
    depth = _DEEP_FLOOR if system.size <= _SMALL else _SHALLOW_FLOOR
    state = refine_in_integers(system, columns, depth, _GUARD, pairs)
    return None if state is None else state.rounded()


def refine_in_integers(
    system: Equations, columns: list[Column], depth: int, guard: int, pairs: Pairs = ()
) -> IntegerState | None:
    """Return the integer voltages and currents that solve the equations, or None if the refinement diverges.

    `columns`: elimination steps of the matrix ``system.laplacian``; `depth`: binary digits between the largest value
    and the floor, below which values are set to zero; `guard`: binary digits of the integers below the floor; `pairs`:
    pairs of nodes whose voltage differences must be accurate.
    """
    state = _initial_state(system, depth, guard, pairs)
    last = math.inf
    for _ in range(_MOST_STEPS if system.size else 0):
        power = state.correct(substitute(columns, state.net[:-1], state.unit_amps - state.unit_volts))
        if power == -math.inf or state.proved(power):
            break
        if not power < last:
            return None
        last = power
    return state


@dataclass(frozen=True, eq=False)
class IntegerState:
    """Voltages and currents in integers, which corrections change in place.

    `system`: equations; `depth`: binary digits between the largest value and the floor, below which values are set to
    zero; `floor`: lower limit of this floor for currents, as a binary logarithm in units of ``2**unit_amps`` A;
    `unit_volts`, `unit_amps`: binary logarithms of the units of voltage and current in volts and amperes; `pairs`:
    pairs of nodes whose voltage differences must be accurate; `resistors`: resistors that may carry current; `volts`
    (nodes,): voltages above ground, in the unit of voltage; `net` (n + 1,): net current into every row, in the unit of
    current; the last entry collects the currents into nodes of known voltage and is not used.
    """

    system: Equations
    depth: int
    floor: int
    unit_volts: int
    unit_amps: int
    pairs: Pairs
    resistors: list[_Resistor]
    volts: list[int]
    net: list[int]

    def current(self, resistor: _Resistor, fall: int) -> int:
        """Return the current of a resistor from the first to the second node, rounded down to an integer.

        The current is in units of ``2**unit_amps`` A.  `fall`: voltage of the first node minus that of the second, in
        units of ``2**unit_volts`` V.
        """
        return fall * resistor.siemens >> resistor.places + self.unit_amps - self.unit_volts

    def conduct(self, resistor: _Resistor, fall: int) -> None:
        """Subtract a resistor's current from `net` at the row of the first node, and add it at that of the second node.

        `fall`: voltage of the first node minus that of the second, in units of ``2**unit_volts`` V.
        """
        amps, (first, second) = self.current(resistor, fall), resistor.rows
        self.net[first] -= amps
        self.net[second] += amps

    def correct(self, rise: list[int]) -> float:
        """Add a correction to the voltages; return a bound on the square root of the power that it dissipates.

        `rise` (n,): correction of the rows, in units of ``2**unit_volts`` V.  The result is a binary logarithm, -inf
        for a correction of 0; the bound is in units of ``2**unit_volts`` V times the square root of a siemens.
        """
        rise = [*rise, 0]
        for node in np.flatnonzero(self.system.unknown >= 0).tolist():
            self.volts[node] += rise[self.system.unknown[node]]
        most = -math.inf
        for each in self.resistors:
            if change := rise[each.rows[0]] - rise[each.rows[1]]:
                self.conduct(each, change)
                most = max(most, 2.0 * change.bit_length() + each.log)
        return 0.5 * (most + math.log2(max(len(self.resistors), 1)))

    def proved(self, power: float) -> bool:
        """Return whether the last correction proves `_DIGITS` correct binary digits of all values above the floor.

        `power`: binary logarithm of the square root ``s`` of the power that the correction dissipates, as returned by
        `correct`.  The current through a conductance ``g`` has an error of at most ``sqrt(g) s``.  A node with a
        resistance ``R`` to ground has a voltage error of at most ``sqrt(R) s``.  The floor is the magnitude below
        which values are set to zero: ``2**-depth`` times the largest one.
        """
        logs = [each.log for each in self.resistors if each.rows[0] != each.rows[1]]
        if not logs:
            return True
        return (
            self._proves_currents(power)
            and self._proves_voltages(power + 0.5 * (math.log2(self.system.size) - min(logs)))
            and self._proves_cuts(power + 0.5 * max(logs) + math.log2(len(logs)) + self.unit_volts - self.unit_amps)
        )

    def _proves_currents(self, power: float) -> bool:
        logs = [_log(self.volts[each.nodes[0]] - self.volts[each.nodes[1]]) + each.log for each in self.resistors]
        floor = max(max(logs) - self.depth, self.floor + self.unit_amps - self.unit_volts)
        return all(
            power + 0.5 * each.log <= max(amps - _DIGITS, floor)
            for each, amps in zip(self.resistors, logs, strict=True)
            if each.rows[0] != each.rows[1]
        )

    def _proves_voltages(self, error: float) -> bool:
        solved_for = np.flatnonzero(self.system.unknown >= 0).tolist()
        for reference in self.references():
            floor = max(_log(volts - reference) for volts in self.volts) - self.depth
            if any(error > max(_log(self.volts[node] - reference) - _DIGITS, floor) for node in solved_for):
                return False
        return self._proves_falls(error + 1.0)

    def _proves_falls(self, error: float) -> bool:
        floor = max(map(_log, self.volts)) - self.depth
        return all(error <= max(_log(fall) - _DIGITS, floor) for fall in self.falls())

    def falls(self) -> list[int]:
        """Return the voltages between the nodes of `pairs` (first minus second), in units of ``2**unit_volts`` V."""
        return [self.volts[first] - self.volts[second] for first, second in self.pairs]

    def _proves_cuts(self, error: float) -> bool:
        logs = [_log(amps) for amps in self.source_currents()]
        floor = max(max(logs, default=-math.inf) - self.depth, self.floor)
        return all(error <= max(amps - _DIGITS, floor) for amps in logs)

    def references(self) -> list[int]:
        """Return ground, the lowest known voltage ``system.reference`` and the rails, as sorted integer voltages.

        The unit of voltage is ``2**unit_volts`` V. A voltage that occurs twice is listed once.
        """
        rails = self.system.rails
        known = [0.0, self.system.reference, *([rails.low, rails.high] if rails else [])]
        return sorted({self.units(volts) for volts in known})

    def units(self, volts: float) -> int:
        """Return a voltage as a multiple of ``2**unit_volts`` V, rounded down to an integer."""
        return _units(volts, self.unit_volts)

    def source_currents(self) -> list[int]:
        """Return the currents into the plus terminals of the voltage sources, (sources,), as integers.

        The unit of current is ``2**unit_amps`` A.
        """
        netlist, outflow = self.system.netlist, [0] * len(self.volts)
        for each in self.resistors:
            amps = self.current(each, self.volts[each.nodes[0]] - self.volts[each.nodes[1]])
            outflow[each.nodes[0]] += amps
            outflow[each.nodes[1]] -= amps
        for (source, target), amps in zip(netlist.current_nodes.tolist(), netlist.current_amps.tolist(), strict=True):
            outflow[source] += _units(amps, self.unit_amps)
            outflow[target] -= _units(amps, self.unit_amps)
        return sum_cuts(netlist, self.system.forest, outflow)

    def rounded(self) -> RecoveredCurrents:
        """Return all voltages and currents as doubles, each rounded once; values below the floor are 0.

        The floor is ``2**-depth`` times the largest voltage or current.
        """
        system, netlist = self.system, self.system.netlist
        amps, watts, places = np.zeros(len(netlist.conductance)), 0, 0
        digits = max((each.places for each in self.resistors), default=0)
        for each in self.resistors:
            fall = self.volts[each.nodes[0]] - self.volts[each.nodes[1]]
            amps[each.number] = nearest(fall * each.siemens, self.unit_volts - each.places)
            places = max(places, (fall * each.siemens).bit_length() + self.unit_volts - each.places)
            watts += fall * fall * each.siemens << digits - each.places
        sources = self.source_currents()
        source_amps = np.array([nearest(amps, self.unit_amps) for amps in sources])
        places = max([places, *(amps.bit_length() + self.unit_amps for amps in sources)])
        largest = max(np.abs(amps).max(initial=0.0), np.abs(source_amps).max(initial=0.0))
        least = math.ldexp(largest, -self.depth) if np.isfinite(largest) else math.ldexp(1.0, places - 1 - self.depth)
        least = max(least, nearest(1 << self.floor, self.unit_amps))
        through = np.bincount(netlist.resistor_nodes.ravel(), np.repeat(np.abs(amps), 2), netlist.node_count)
        amps[np.abs(amps) <= least] = source_amps[np.abs(source_amps) <= least] = 0.0
        reference = self.units(system.reference)
        volts = np.array([nearest(level, self.unit_volts) for level in self.volts])
        heights = np.array([nearest(level - reference, self.unit_volts) for level in self.volts])
        known = system.known_voltages()
        for levels in (volts, heights):
            levels[system.floating] = 0.0
            levels[np.abs(levels) <= math.ldexp(min(np.abs(levels).max(), sys.float_info.max), -self.depth)] = 0.0
            levels[system.floating] = np.nan
        volts = np.where(np.isnan(known), volts, known)
        heights[system.undriven] = system.undriven_volts - system.reference
        source_amps = without_loops(system.forest, source_amps)
        unchecked = through <= math.ldexp(max(least, _TINY), NEAR_FLOOR)
        power = nearest(watts, 2 * self.unit_volts - digits)
        falls = np.array([nearest(fall, self.unit_volts) for fall in self.falls()])
        falls[np.abs(falls) <= math.ldexp(min(np.nanmax(np.abs(volts)), sys.float_info.max), -self.depth)] = 0.0
        return RecoveredCurrents(
            volts, heights, amps, source_amps, power, unchecked, floor=2.0**-self.depth, falls=falls
        )


def _initial_state(system: Equations, depth: int, guard: int, pairs: Pairs) -> IntegerState:
    """Return the integer voltages and currents of the equations with all rows at the lowest known voltage.

    `depth`: binary digits between the largest value and the floor; `guard`: binary digits below the floor; `pairs`:
    pairs of nodes whose voltage differences must be accurate.
    """
    netlist, unknown = system.netlist, system.unknown
    still = np.zeros(netlist.node_count, dtype=np.bool_)
    still[system.floating] = still[system.undriven] = True
    flows = np.flatnonzero(~still[netlist.resistor_nodes].any(axis=1))
    siemens, ends = netlist.conductance[flows].tolist(), netlist.resistor_nodes[flows]
    least, most = math.frexp(min(siemens, default=1.0))[1], math.frexp(max(siemens, default=1.0))[1]
    level, fed = np.abs(netlist.source_volts).max(initial=0.0), np.abs(netlist.current_amps).max(initial=0.0)
    several = len(netlist.source_volts).bit_length()
    largest = max(
        math.frexp(level)[1] + several + most if level else -math.inf, math.frexp(fed)[1] if fed else -math.inf,
        _LEAST_AMPS,
    )  # fmt: skip
    unit_amps = int(largest) - depth - guard - (most - least)
    unit_volts = unit_amps - most
    if level:  # currents that flow through sources alone must not make the unit of voltages too large
        unit_volts = min(unit_volts, math.frexp(level)[1] - depth - guard)
    volts, reference = _offsets(system, unit_volts), _units(system.reference, unit_volts)
    for node in np.flatnonzero(unknown >= 0).tolist():
        volts[node] += reference
    for node, level in zip(system.undriven.tolist(), system.undriven_volts.tolist(), strict=True):
        volts[node] = _units(level, unit_volts)
    resistors = [
        _Resistor(k, tuple(nodes), tuple(rows), *fixed(g), math.log2(g))
        for k, nodes, rows, g in zip(flows.tolist(), ends.tolist(), unknown[ends].tolist(), siemens, strict=True)
    ]
    net = [0] * (system.size + 1)
    rows = unknown[netlist.current_nodes].tolist()
    for (source, target), amps in zip(rows, netlist.current_amps.tolist(), strict=True):
        net[source] -= _units(amps, unit_amps)
        net[target] += _units(amps, unit_amps)
    state = IntegerState(system, depth, guard // 2, unit_volts, unit_amps, pairs, resistors, volts, net)
    for each in resistors:
        if each.rows[0] != each.rows[1]:
            state.conduct(each, volts[each.nodes[0]] - volts[each.nodes[1]])
    return state


def _offsets(system: Equations, unit: int) -> list[int]:
    """Return the voltages of all nodes above the roots of their trees of voltage sources, (nodes,), as integers.

    `system`: equations with the trees; `unit`: binary logarithm of the unit of voltage in volts.
    """
    netlist, offset = system.netlist, [0] * system.netlist.node_count
    plus, volts = netlist.source_nodes[:, 0].tolist(), netlist.source_volts.tolist()
    for node, above, source, _ in system.forest.ties:
        rise = _units(volts[source], unit)
        offset[node] = offset[above] + (rise if plus[source] == node else -rise)
    return offset


def _units(value: float, unit: int) -> int:
    """Return the double ``value`` as a multiple of ``2**unit``, rounded down to an integer."""
    mantissa, places = fixed(value)
    return scaled(mantissa, -places - unit)


def _log(value: int) -> float:
    """Return the binary logarithm of the magnitude of the integer `value`, rounded down; -inf for 0."""
    return value.bit_length() - 1.0 if value else -math.inf


def with_tiny_values(
    values: NDArray[np.float64], floor: float, tiny: NDArray[np.float64], exponent: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return recovered values ``m 2**(256 e)`` as m and e, in which tiny values replace those that were set to zero.

    `values`: voltages or currents, computed again without cancellation, with 0 for values below the fraction `floor` of
    the largest one; `tiny`, `exponent`: the same values before this computation, as mantissas and exponents of
    ``2**256``.
    """
    lost = (values == 0.0) & (np.abs(unscaled(tiny, exponent)) <= floor_of(values, floor))
    return np.where(lost, tiny, values), np.where(lost, exponent, 0)


def floor_of(values: NDArray[np.float64], floor: float) -> float:
    """Return the magnitude up to which values were set to zero: the fraction `floor` of the largest magnitude."""
    return float(np.nanmax(np.abs(values), initial=0.0)) * floor
