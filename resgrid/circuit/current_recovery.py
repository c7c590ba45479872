"""Branch currents where the difference of two node voltages would cancel, by iterative correction.

Examples are large conductances to a rail, dead ends, balanced bridges and opposed sources.  The true currents there may
be many orders of magnitude below the conductance times the rounding error of a voltage.  Circuits whose factors have at
most 10,000 entries are solved in integer arithmetic (`resgrid.circuit.cancellation`).  In larger ones the voltages are
sums of corrections, each computed from the KCL residual of the sum before it.  The voltage difference across every
resistor is accumulated separately in double-double, so that its relative error is small even where both voltages agree.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.cancellation import Pairs, RecoveredCurrents, solve_in_integers
from resgrid.circuit.equations import Equations
from resgrid.circuit.sources import sum_cuts, without_loops
from resgrid.core.netlist import Netlist
from resgrid.core.regions import label_components
from resgrid.errors import BudgetError
from resgrid.solvers.conservative_factors import columns_of
from resgrid.solvers.factors import DirectFactor
from resgrid.solvers.method_choice import factor_laplacian
from resgrid.solvers.supernodal_factors import SupernodalFactors

_FEW_ENTRIES, _MOST_ENTRIES = 10_000, 2_000_000
"""Maximum numbers of entries of the factors for a solution in integers.

A circuit with at most `_FEW_ENTRIES` is solved in integers immediately (30 ms); one with at most `_MOST_ENTRIES` only
after corrections in double-double have failed (some seconds).
"""

_CERTAIN = 1e-9
"""Largest change of a current by the last correction, as a fraction of the smaller current through its end nodes.

A larger change means that the corrections have not converged.
"""

_UNDERFLOW, _UNRESOLVED, _UNCHECKED_KCL = 1e-280, 1e-30, 1e-28
"""Limits on currents, as fractions of the largest current in the circuit.

Currents below `_UNDERFLOW` are set to zero, because products would underflow. Currents below `_UNRESOLVED` are set to
zero if cancellation has removed all their digits.  KCL is not checked at nodes with a current that was set to zero and
a sum of currents below `_UNCHECKED_KCL`.
"""

_MOST_NET = 1e-6
"""Largest net current into a row, as a fraction of the current through the row, of a direction-safe solution."""

_UNBOUNDED = 1e-20
"""Smallest divisor of a relative error, as a fraction of the largest current in the circuit.

The bound on the error of a current is divided by the smaller current through its two end nodes, but at least by this
fraction of the largest current.
"""

_DIGITS = 48
"""Number of binary digits to which a correction is rounded, counted from the largest entry of the correction.

Smaller digits are rounding errors.
"""

_SUM_ROUNDING = 2.0**-98
"""Rounding error of a sum of currents in double-double, as a fraction of the sum of the magnitudes."""

_MOST_VOLTS = 1e200
"""Limit on the entries of a correction, in volts; the corrections count as divergent if an entry reaches it."""

_MOST_STEPS = 30

Doubled = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Array of double-doubles, as the pair of an array of leading parts and an array of their rounding errors."""

_NONE: Doubled = np.zeros(0), np.zeros(0)
"""Array of no double-doubles."""


def recover_currents(system: Equations, pairs: Pairs = ()) -> tuple[RecoveredCurrents | None, DirectFactor | None]:
    """Return voltages and currents that obey KCL at every row (unknown voltage), and the factors of the matrix.

    KCL holds to within rounding errors, which are small relative to the currents at each row, except at nodes marked
    as `unchecked`.  Both results are None if the factors exceed the memory; the factors are also None without rows.

    Circuits whose factors have at most 10,000 entries are solved in integer arithmetic: each value is computed to 60
    binary digits and rounded once to a double, and values below 2**-200 of the largest may be set to zero.  Larger
    circuits, and all grids of cells with two rails, or with one rail and source currents of one sign, are corrected in
    double-double.  They are solved in integers if these corrections do not converge or violate KCL, and the factors
    have at most 2,000,000 entries.

    `system`: equations; `pairs`: pairs of nodes; a solution in integers contains the voltages between both nodes as
    `falls`, which is None after corrections in double-double.
    """
    if not system.size:
        return solve_in_integers(system, [], pairs), None
    try:
        direct = factor_laplacian(system.laplacian, "direct")
    except BudgetError:
        return None, None
    assert isinstance(direct, DirectFactor)
    entries = direct.factors.symbolic.entries
    is_small = entries <= _FEW_ENTRIES and not _is_field(system)
    found = None if is_small else _correct(system, direct.factors)
    if found is None or (entries <= _MOST_ENTRIES and (found.error_bound > _CERTAIN or _violates_kcl(system, found))):
        found = (
            solve_in_integers(system, columns_of(direct.factors), pairs) or found or _correct(system, direct.factors)
        )
    return found, direct


def _violates_kcl(system: Equations, found: RecoveredCurrents) -> bool:
    """Return whether the net current into a checked row exceeds 1e-6 of the current through the row."""
    rows, checked = system.unknown[system.netlist.resistor_nodes], np.ones(system.size + 1, dtype=np.bool_)
    checked[system.unknown[found.unchecked]] = False
    net, through = _residual(system, rows, (found.amps / system.netlist.conductance, np.zeros(len(rows))))
    return bool(np.any(checked[:-1] & (np.abs(net) > _MOST_NET * through)))


def _is_field(system: Equations) -> bool:
    """Return whether the circuit is a grid of cells with two rails, or one rail and source currents of one sign."""
    if system.netlist.space_map is None or system.rails is not None:
        return system.netlist.space_map is not None
    return not (np.any(system.drive < 0.0) and np.any(system.drive > 0.0))


class _Differences(NamedTuple):
    """Voltage differences across resistors, and voltages of rows (nodes with unknown voltage), in double-double.

    `falls` (resistors,): voltage of the first end minus voltage of the second end, in volts; `heights` (n,): voltages
    of the rows above the lowest known voltage, in volts; `net`, `through` (n,): net current into every row, and half
    the sum of the magnitudes of its currents, in amperes; `change`: largest change of a current by the last correction,
    as a fraction of the smaller current through its two ends, infinite after divergence; `unresolved` (resistors,):
    whether a current is indistinguishable from zero; `currentless` (resistors,): whether a resistor lies in a dead end,
    where the current is zero for any conductances.
    """

    falls: Doubled
    heights: Doubled
    net: NDArray[np.float64]
    through: NDArray[np.float64]
    change: float
    unresolved: NDArray[np.bool_]
    currentless: NDArray[np.bool_]


def _correct(system: Equations, factors: SupernodalFactors) -> RecoveredCurrents:
    """Return the voltages and currents from corrections in double-double, with a bound on the errors.

    `system`: equations; `factors`: factors of the matrix of the equations.
    """
    netlist, ends = system.netlist, system.netlist.resistor_nodes
    found = _refined(system, factors)
    falls, unchecked = found.falls, np.zeros(netlist.node_count, dtype=np.bool_)
    amps = netlist.conductance * np.abs(falls[0])
    if found.unresolved.any():
        is_zero = _connected_small(ends, netlist.node_count, amps <= amps[found.unresolved].max(), found.unresolved)
        for part in falls:
            part[is_zero] = 0.0
        unchecked[ends[is_zero]] = True
        total = np.bincount(ends.ravel(), np.repeat(amps, 2), netlist.node_count)
        unchecked &= total <= _UNCHECKED_KCL * amps.max()
    error_bound = found.change
    if not _is_field(system):
        error_bound = max(error_bound, _bound(system, factors, found))
    heights, amps = system.heights(found.heights[0]), netlist.conductance * falls[0]
    power, source_amps = float(amps @ falls[0]), _source_amps(system, falls)
    volts = system.above_ground(heights)
    return RecoveredCurrents(volts, heights, amps, source_amps, power, unchecked, np.inf, error_bound)


def _refined(system: Equations, factors: SupernodalFactors) -> _Differences:
    """Return voltage differences and voltages as sums of corrections, computed from KCL residuals.

    The corrections end when none changes a current by more than 1e-9 of the smaller current through its ends, or when
    they diverge (`_Differences.change` is then infinite).  `system`: equations of the circuit; `factors`: factors of
    their matrix.
    """
    netlist, zeros = system.netlist, np.zeros(system.size)
    ends, rows = netlist.resistor_nodes, system.unknown[netlist.resistor_nodes]
    held, rest = _held_voltages(system)
    still = np.zeros(netlist.node_count, dtype=np.bool_)
    still[system.floating] = still[system.undriven] = True
    parts = _parts_of(system)
    currentless, first_volts = parts.currentless, parts.shifts(zeros, parts.lift)
    flows = ~still[ends].any(axis=1) & ~currentless
    of_row = np.append(first_volts[0], 0.0)[system.unknown], np.append(first_volts[1], 0.0)[system.unknown]
    volts = _plus(of_row, held, rest)
    one, other = ((flows * volts[0][end], flows * volts[1][end]) for end in ends.T)
    falls = _plus(one, -other[0], -other[1])
    heights, worst = _plus(first_volts, zeros - system.reference), np.inf
    unresolved, underflowing = flows & False, flows & False
    net, through = _residual(system, rows, falls)
    for _ in range(_MOST_STEPS):
        x = factors.solve(net)
        x += parts.shifts(x)[0]
        size = float(np.abs(x).max())
        if not size < _MOST_VOLTS:
            worst = np.inf
            break
        digit = math.ldexp(1.0, math.frexp(size)[1] - _DIGITS) or 1.0
        x = np.rint(x / digit) * digit
        first, second = np.append(x, 0.0)[rows.T]
        change = _plus((np.where(currentless, 0.0, first), np.zeros(len(rows))), np.where(currentless, 0.0, -second))
        falls, heights = _plus(falls, *change), _plus(heights, x)
        net, through = _residual(system, rows, falls)
        amps, moved = netlist.conductance * np.abs(falls[0]), netlist.conductance * np.abs(change[0])
        smaller = np.where(rows >= 0, through[rows], amps[:, np.newaxis]).min(axis=1)
        ratio = np.divide(moved, smaller, out=np.zeros_like(amps), where=(amps > 0.0) & (smaller > 0.0))
        unresolved = (ratio > _CERTAIN) & (amps <= _UNRESOLVED * amps.max())
        underflowing = amps <= _UNDERFLOW * amps.max()
        worst = float(ratio.max(where=~unresolved, initial=0.0))
        unbalanced = np.abs(net) > np.maximum(_CERTAIN * through, _UNRESOLVED * through.max())
        if worst <= _CERTAIN and not ((unresolved & ~underflowing).any() or unbalanced.any()):
            break
    unresolved = unresolved | (underflowing & (falls[0] != 0.0))
    return _Differences(falls, heights, net, through, worst, unresolved, currentless)


def _held_voltages(system: Equations) -> Doubled:
    """Return the voltages of all nodes above their rows, (nodes,), in volts; of nodes without a row above ground."""
    offset, rest = system.forest.offsets
    return np.where(system.unknown >= 0, offset, np.nan_to_num(system.known_voltages())), rest


class _Parts(NamedTuple):
    """Parts of a circuit that only resistors without current join, such as a circuit and its dead ends.

    `currentless` (resistors,): whether a resistor carries no current for any conductances; `of_row` (n + 1,): part of
    every row, and of the known voltages; `joints` (k, 2): rows at the two ends of the resistor that joins a part to an
    earlier one, n for a known voltage; `lift` (k,): voltage of the first end above its row, or its known voltage, minus
    that of the second end, in volts, as a double-double.  The part of the known voltages has no joint.
    """

    currentless: NDArray[np.bool_]
    of_row: NDArray[np.int64]
    joints: NDArray[np.int64]
    lift: Doubled

    def shifts(self, x: NDArray[np.float64], lift: Doubled | None = None) -> Doubled:
        """Return the shifts of all rows, (n,), in volts, for which no voltage lies across the joints of the parts.

        `x` (n,): voltages of the rows before the shift; `lift` (k,): the field of this name for voltages, None for
        corrections of voltages.
        """
        from resgrid.circuit.kernels import align_parts

        shift, shift_low = np.zeros((2, int(self.of_row.max()) + 1))
        lift = lift or (np.zeros(len(self.joints)), np.zeros(len(self.joints)))
        align_parts(self.joints, self.of_row, *lift, np.append(x, 0.0), shift, shift_low)
        return shift[self.of_row[:-1]], shift_low[self.of_row[:-1]]


def _parts_of(system: Equations) -> _Parts:
    """Return the parts of a circuit that only resistors without current join.

    A grid of cells with two rails, or with one rail and source currents of one sign, counts as one part.
    """
    netlist, forest, count = system.netlist, system.forest, len(system.netlist.conductance)
    if _is_field(system):
        return _Parts(np.zeros(count, np.bool_), np.zeros(system.size + 1, np.int64), np.zeros((0, 2), np.int64), _NONE)
    from resgrid.circuit.kernels import mark_currentless

    tied, driven = forest.source >= 0, netlist.current_amps != 0.0
    ties = np.stack([forest.order[tied], forest.parent[tied]], axis=1)
    pairs = np.concatenate([netlist.resistor_nodes, ties, netlist.current_nodes[driven]]).astype(np.int32)
    drives = np.concatenate([np.zeros(count), netlist.source_volts[forest.source[tied]], netlist.current_amps[driven]])
    start = np.concatenate([[0], np.cumsum(np.bincount(pairs.ravel(), minlength=netlist.node_count))])
    edge, marks = np.argsort(pairs.ravel(), kind="stable") // 2, np.zeros(len(pairs), dtype=np.bool_)
    place, (order, low, entry, path) = start[:-1].copy(), np.full((4, netlist.node_count), -1)
    mark_currentless(pairs, drives != 0.0, start, edge, place, order, low, entry, path, np.empty_like(edge), marks)
    currentless, row = marks[:count], np.where(system.unknown < 0, system.size, system.unknown)
    of_row = label_components(row[netlist.resistor_nodes[~currentless]], system.size + 1)
    found = np.argsort(order)[np.count_nonzero(order < 0) + 1 :]
    ends = found[(entry[found] < count) & marks[entry[found]]]
    ends = np.stack([pairs[entry[ends]].sum(axis=1) - ends, ends])
    held, rest = _held_voltages(system)
    lift = _plus((held[ends[0]], rest[ends[0]]), -held[ends[1]], -rest[ends[1]])
    parts, joins = np.unique(of_row[row[ends[1]]], return_index=True)
    joins = np.sort(joins[parts != of_row[-1]])
    return _Parts(currentless, of_row, row[ends].T[joins], (lift[0][joins], lift[1][joins]))


def _bound(system: Equations, factors: SupernodalFactors, found: _Differences) -> float:
    """Return a bound on the relative errors of voltages and currents, one number for both.

    The error of a voltage is relative to the largest voltage, the error of a current to the smaller current through
    the two end nodes of the resistor.  `system`: equations of the circuit; `factors`: factors of the matrix; `found`:
    voltage differences and residuals.  The inverse matrix has no negative entry.  The product of the inverse matrix
    with the magnitudes of the residual currents bounds the voltage errors.  The error of a branch current is also at
    most the sum of the residual currents.
    """
    netlist, rows = system.netlist, system.unknown[system.netlist.resistor_nodes]
    residual = np.abs(found.net) + _SUM_ROUNDING * found.through
    error = np.append(factors.solve(residual), 0.0)
    level = np.abs(system.above_ground(system.heights(found.heights[0])))
    amps = netlist.conductance * np.abs(found.falls[0])
    most = np.minimum(netlist.conductance * error[rows].sum(axis=1), residual.sum())
    smaller = np.where(rows >= 0, np.append(found.through, 0.0)[rows], amps[:, np.newaxis]).min(axis=1)
    smaller = np.maximum(smaller, _UNBOUNDED * amps.max())
    ratio = np.divide(most, smaller, out=np.zeros_like(most), where=(smaller > 0.0) & ~found.currentless)
    return float(max(ratio.max(initial=0.0), error.max() / max(np.nanmax(level), np.finfo(np.float64).tiny)))


def _source_amps(system: Equations, falls: Doubled) -> NDArray[np.float64]:
    """Return the currents into the plus terminals of the voltage sources (sources,), in amperes.

    They are exact sums of the branch currents; NaN in a loop of sources. `system`: equations; `falls`: voltages across
    the resistors (first end minus second) in volts, as a pair of arrays (resistors,): leading parts, rounding errors.
    """
    netlist = system.netlist
    net, net_low, _ = _flows(netlist, netlist.resistor_nodes, netlist.current_nodes, netlist.node_count, falls)
    outflow = [Fraction(0)] * netlist.node_count
    for node in system.forest.order.tolist():
        outflow[node] = -Fraction(net[node]) - Fraction(net_low[node])
    return without_loops(system.forest, np.array([float(amps) for amps in sum_cuts(netlist, system.forest, outflow)]))


def _plus(total: Doubled, more: NDArray[np.float64], more_low: NDArray[np.float64] | float = 0.0) -> Doubled:
    """Return the sum of two arrays of double-doubles, by Knuth's two-sum of the leading parts.

    A double-double array is a pair of arrays: leading parts and rounding errors.  `total`: first array; `more`,
    `more_low`: leading parts and rounding errors of the second array.
    """
    s = total[0] + more
    t = s - total[0]
    rest = (total[0] - (s - t)) + (more - t) + (total[1] + more_low)
    hi = s + rest
    return hi, rest - (hi - s)


def _connected_small(
    ends: NDArray[np.int32], nodes: int, small: NDArray[np.bool_], unresolved: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return which small currents are as uncertain as an unresolved one, a mask (resistors,).

    An unresolved current is indistinguishable from zero. The small currents that a chain of resistors with small
    currents connects to it are as uncertain. `ends` (resistors, 2): nodes; `nodes`: number of nodes; `small`
    (resistors,): whether a current is small; `unresolved` (resistors,): whether a current is unresolved.
    """
    component = label_components(ends[small], nodes)[ends[:, 0]]
    return np.asarray(small & np.isin(component, component[unresolved]))


def _residual(
    system: Equations, rows: NDArray[np.int32], falls: Doubled
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the net current into every row, and half the sum of the magnitudes of its currents, (n,) each, in A.

    `rows` (resistors, 2): rows of both ends, -1 for a known voltage; `falls`: voltages across the resistors (first end
    minus second) in volts, as a pair of arrays (resistors,): leading parts and rounding errors.  A net current within
    the rounding error of its sum is 0.
    """
    source_rows = system.unknown[system.netlist.current_nodes]
    net, _, total = _flows(system.netlist, rows, source_rows, system.size, falls)
    return np.where(np.abs(net) > _SUM_ROUNDING * total, net, 0.0), 0.5 * total


def _flows(
    netlist: Netlist, ends: NDArray[np.int32], source_ends: NDArray[np.int32], count: int, falls: Doubled
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the net currents into nodes or rows, their rounding errors, and the sums of the magnitudes, in amperes.

    `ends` (resistors, 2), `source_ends` (current sources, 2): nodes or rows of the ends; ends with a negative number
    are left out; `count`: number of nodes or rows, the length of the results; `falls`: voltages across the resistors
    (first end minus second) in volts, as a pair of arrays (resistors,): leading parts and rounding errors.  Sums are in
    double-double.
    """
    from resgrid.circuit.kernels import add_flows

    net, net_low, total = np.zeros((3, count))
    amps = netlist.current_amps
    add_flows(ends, netlist.conductance, *falls, net, net_low, total)
    add_flows(source_ends, np.ones_like(amps), amps, np.zeros_like(amps), net, net_low, total)
    return net, net_low, total
