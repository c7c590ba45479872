"""Operating points whose voltages and currents cancel: each of them is computed to its last digit, however small.

A level or a current that remains after large ones cancel is not the difference of rounded numbers.  Here voltages and
currents are integers, in units far below the smallest value of interest, and residuals are exact.  Refinement with
factors that conserve current (`resgrid.solvers.conservative_factors`) gains about as many digits in each step as a
double holds.  It ends when the energy of the last correction proves every voltage and every current to 60 binary
digits, or proves that it lies below a floor, a tiny fraction of the largest one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.equations import Equations
from resgrid.circuit.sources import sum_cuts, without_loops
from resgrid.solvers.conservative_factors import Column, fixed, nearest, scaled, substitute

_DEEP, _SHALLOW, _FEW = 1000, 200, 1000
"""Binary digits of the floor: a voltage or a current that lies so far below the largest one counts as zero; more of
them up to so many rows, for each step of refinement gains some fifty."""

_DIGITS = 60
"""Binary digits to which a value is proved before it is rounded to the 53 of a double."""

_GUARD = 300
"""Binary digits of the units below the floor, in addition to the range of the conductances."""

_NEAR = 20
"""Binary digits above the floor up to which the currents at a node may not add up: some of them are below it."""

_LEAST_AMPS = -2200
"""Binary logarithm of the smallest current that doubles make, in amperes: the largest one where nothing flows."""

_TINY = float(np.finfo(np.float64).tiny)
"""Smallest number that a double holds with all its digits."""

_MOST_STEPS = 200


class Balanced(NamedTuple):
    """Voltages and currents that obey Kirchhoff's laws.

    `volts` (nodes,): above ground, NaN where a node floats; `heights` (nodes,): above the reference of the equations;
    `amps` (resistors,): from the first end to the second one; `source_amps` (sources,): into the plus terminal, NaN in
    a loop of sources; `power`: in all resistors, in watts; `excused` (nodes,): whether all currents at a node are so
    close to the floor, or to the
    range of doubles, that some of them may count as zero, and others not; `entry_error`: bound on the relative error
    of every voltage above ground and above the reference; infinite where there is none; `doubt`: bound on the error of
    a voltage relative to the largest one, or of a current relative to the current through either end;
    `floor`: fraction of the largest voltage or current below which others may count as zero.
    """

    volts: NDArray[np.float64]
    heights: NDArray[np.float64]
    amps: NDArray[np.float64]
    source_amps: NDArray[np.float64]
    power: float
    excused: NDArray[np.bool_]
    entry_error: float = float(np.finfo(np.float64).eps)
    doubt: float = 0.0
    floor: float = 0.0


class _Resistor(NamedTuple):
    """A resistor that may carry current: its number, its nodes, their rows (-1: known voltage), its conductance.

    The conductance is ``siemens / 2**places``; `log` is its binary logarithm.
    """

    number: int
    nodes: tuple[int, int]
    rows: tuple[int, int]
    siemens: int
    places: int
    log: float


def cancel(system: Equations, columns: list[Column]) -> Balanced | None:
    """Solve the equations; None where refinement does not converge, as where fractions of the factors underflow."""
    state = _begin(system)
    last = math.inf
    for _ in range(_MOST_STEPS if system.size else 0):
        power = state.correct(substitute(columns, state.net[:-1], state.unit_amps - state.unit_volts))
        if power == -math.inf or state.proved(power):
            break
        if not power < last:
            return None
        last = power
    return state.rounded()


@dataclass(frozen=True, eq=False)
class _State:
    """Voltages and currents as integers, which corrections change in place.

    `depth`: of the floor below the largest voltage or current, in binary digits; `unit_volts, unit_amps`: binary
    logarithms of the units; `resistors`: those that may carry current; `volts`
    (nodes,); `net` (n + 1,): current into every row beyond the current out of it; the last entry is not used.
    """

    system: Equations
    depth: int
    unit_volts: int
    unit_amps: int
    resistors: list[_Resistor]
    volts: list[int]
    net: list[int]

    def current(self, resistor: _Resistor, fall: int) -> int:
        """Return the current of a resistor in units of current; less than a unit is lost."""
        return fall * resistor.siemens >> resistor.places + self.unit_amps - self.unit_volts

    def conduct(self, resistor: _Resistor, fall: int) -> None:
        """Move current from the row of the first end to the row of the second one."""
        amps, (first, second) = self.current(resistor, fall), resistor.rows
        self.net[first] -= amps
        self.net[second] += amps

    def correct(self, rise: list[int]) -> float:
        """Raise the rows' voltages (n,); return a bound on the square root of the correction's power, as a logarithm.

        The logarithm is binary; the unit is that of voltages, times the square root of a siemens.
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
        """Return whether errors of this power, as from `correct`, leave all values their digits.

        A resistor of conductance g has an error of current of at most ``sqrt(g)`` times the square root of the power,
        a node with a resistance R to the ground an error of voltage of ``sqrt(R)`` times that root.
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
        return True

    def _proves_cuts(self, error: float) -> bool:
        logs = [_log(amps) for amps in self.source_currents()]
        floor = max(max(logs, default=-math.inf) - self.depth, self.floor)
        return all(error <= max(amps - _DIGITS, floor) for amps in logs)

    @property
    def floor(self) -> int:
        """Binary logarithm, in units of current, below which all currents are zero, whatever the largest one is."""
        return _GUARD // 2

    def references(self) -> list[int]:
        """Return the voltages that others are counted from: ground, the reference of the equations, both rails."""
        rails = self.system.rails
        known = [0.0, self.system.reference, *([rails.low, rails.high] if rails else [])]
        return sorted({_units(volts, self.unit_volts) for volts in known})

    def source_currents(self) -> list[int]:
        """Return the currents of the voltage sources, (sources,), in units of current."""
        netlist, outflow = self.system.netlist, [0] * len(self.volts)
        for each in self.resistors:
            amps = self.current(each, self.volts[each.nodes[0]] - self.volts[each.nodes[1]])
            outflow[each.nodes[0]] += amps
            outflow[each.nodes[1]] -= amps
        for (source, target), amps in zip(netlist.current_nodes.tolist(), netlist.current_amps.tolist(), strict=True):
            outflow[source] += _units(amps, self.unit_amps)
            outflow[target] -= _units(amps, self.unit_amps)
        return sum_cuts(netlist, self.system.forest, outflow)

    def rounded(self) -> Balanced:
        """Round all numbers once."""
        system, netlist = self.system, self.system.netlist
        falls, amps = np.zeros((2, len(netlist.conductance)))
        for each in self.resistors:
            fall = self.volts[each.nodes[0]] - self.volts[each.nodes[1]]
            falls[each.number] = nearest(fall, self.unit_volts)
            amps[each.number] = nearest(fall * each.siemens, self.unit_volts - each.places)
        source_amps = np.array([nearest(amps, self.unit_amps) for amps in self.source_currents()])
        least = math.ldexp(max(np.abs(amps).max(initial=0.0), np.abs(source_amps).max(initial=0.0)), -self.depth)
        least = max(least, nearest(1 << self.floor, self.unit_amps))
        through = np.bincount(netlist.resistor_nodes.ravel(), np.repeat(np.abs(amps), 2), netlist.node_count)
        falls[np.abs(amps) <= least] = 0.0
        amps[np.abs(amps) <= least] = source_amps[np.abs(source_amps) <= least] = 0.0
        reference = _units(system.reference, self.unit_volts)
        volts = np.array([nearest(level, self.unit_volts) for level in self.volts])
        heights = np.array([nearest(level - reference, self.unit_volts) for level in self.volts])
        for levels in (volts, heights):
            levels[np.abs(levels) <= math.ldexp(np.abs(levels).max(), -self.depth)] = 0.0
            levels[system.floating] = np.nan
        heights[system.undriven] = system.undriven_volts - system.reference
        volts[system.undriven] = system.undriven_volts
        source_amps, excused = (
            without_loops(system.forest, source_amps),
            through <= math.ldexp(max(least, _TINY), _NEAR),
        )
        return Balanced(volts, heights, amps, source_amps, float(amps @ falls), excused, floor=2.0**-self.depth)


def _begin(system: Equations) -> _State:
    """Set all rows to the reference voltage."""
    netlist, unknown = system.netlist, system.unknown
    still = np.zeros(netlist.node_count, dtype=np.bool_)
    still[system.floating] = still[system.undriven] = True
    flows = np.flatnonzero(~still[netlist.resistor_nodes].any(axis=1))
    siemens, ends = netlist.conductance[flows].tolist(), netlist.resistor_nodes[flows]
    least, most = math.frexp(min(siemens, default=1.0))[1], math.frexp(max(siemens, default=1.0))[1]
    level, fed = np.abs(netlist.source_volts).sum(), np.abs(netlist.current_amps).max(initial=0.0)
    largest = max(
        math.frexp(level)[1] + 1 + most if level else -math.inf, math.frexp(fed)[1] if fed else -math.inf, _LEAST_AMPS
    )
    depth = _DEEP if system.size <= _FEW else _SHALLOW
    unit_amps = int(largest) - depth - _GUARD - (most - least)
    unit_volts = unit_amps - most
    volts, reference = _offsets(system, unit_volts), _units(system.reference, unit_volts)
    for node in np.flatnonzero(unknown >= 0).tolist():
        volts[node] += reference
    resistors = [
        _Resistor(k, tuple(nodes), tuple(rows), *fixed(g), math.log2(g))
        for k, nodes, rows, g in zip(flows.tolist(), ends.tolist(), unknown[ends].tolist(), siemens, strict=True)
    ]
    net = [0] * (system.size + 1)
    rows = unknown[netlist.current_nodes].tolist()
    for (source, target), amps in zip(rows, netlist.current_amps.tolist(), strict=True):
        net[source] -= _units(amps, unit_amps)
        net[target] += _units(amps, unit_amps)
    state = _State(system, depth, unit_volts, unit_amps, resistors, volts, net)
    for each in resistors:
        if each.rows[0] != each.rows[1]:
            state.conduct(each, volts[each.nodes[0]] - volts[each.nodes[1]])
    return state


def _offsets(system: Equations, unit: int) -> list[int]:
    """Return the voltage of every node above the root of its tree of sources, (nodes,), in units."""
    netlist, offset = system.netlist, [0] * system.netlist.node_count
    plus, volts = netlist.source_nodes[:, 0].tolist(), netlist.source_volts.tolist()
    for node, above, source, _ in system.forest.ties:
        rise = _units(volts[source], unit)
        offset[node] = offset[above] + (rise if plus[source] == node else -rise)
    return offset


def _units(value: float, unit: int) -> int:
    """Return a double as a multiple of ``2**unit``; less than a unit is lost."""
    mantissa, places = fixed(value)
    return scaled(mantissa, -places - unit)


def _log(value: int) -> float:
    """Return the binary logarithm of a magnitude, rounded down; -inf for 0."""
    return value.bit_length() - 1.0 if value else -math.inf
