"""Currents that obey Kirchhoff's current law at every node, where differences of voltages do not give them.

Stiff ties to a rail, flat dead ends, balanced loops, sources that oppose each other: currents there are 1e-16 of the
currents that voltages would suggest, or less.  Small circuits are solved in integers (`resgrid.circuit.cancellation`).
Here voltages of larger ones are sums of corrections, each of which removes the currents that the corrections before it
leave unbalanced.  Falls are sums of the corrections' differences, so that each is known to its own last digit.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from resgrid.circuit.cancellation import Balanced, cancel
from resgrid.circuit.equations import Equations
from resgrid.circuit.sources import sum_cuts, without_loops
from resgrid.core.netlist import Netlist
from resgrid.errors import BudgetError
from resgrid.solvers.conservative_factors import columns_of
from resgrid.solvers.factors import DirectFactor
from resgrid.solvers.method_choice import factor_laplacian
from resgrid.solvers.supernodal import SupernodalFactors

_FEW_ENTRIES, _MOST_ENTRIES = 10_000, 2_000_000
"""Entries of factors up to which circuits are solved in integers at once (30 ms), and at most (some seconds)."""

_CERTAIN = 1e-9
"""Fraction of the current through a node by which the last correction may have changed a current there."""

_LEAST, _FAINT, _NONE = 1e-280, 1e-30, 1e-28
"""Fractions of the largest current: below the first, currents count as zero, for doubles end; below the second, those
that cancellation hides do; below the third, KCL is not checked where they do."""

_UNCHECKED = 1e-20
"""Fraction of the largest current below which errors of currents are not bounded."""

_DIGITS = 48
"""Binary digits of a correction, counted from its largest entry: less is a rounding error."""

_NOISE = 2.0**-98
"""Fraction of the currents at a node below which their sum is a rounding error of double-doubles."""

_MOST_VOLTS = 1e200
"""A correction from which on they make nothing better, only larger."""

_MOST_STEPS = 30

Doubled = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Double-doubles: numbers and their rounding errors."""


def balance(system: Equations) -> tuple[Balanced | None, DirectFactor | None]:
    """Find currents that balance at every row; none where there is too little memory for the factors.

    Small circuits are solved in integers, and so are others where corrections in double-double leave doubt; potentials
    of cells are corrected in double-double first, whatever their number.  Returns the factors as well, if there are
    rows.
    """
    if not system.size:
        return cancel(system, []), None
    try:
        direct = factor_laplacian(system.laplacian, "direct")
    except BudgetError:
        return None, None
    assert isinstance(direct, DirectFactor)
    entries = direct.factors.symbolic.entries
    few = entries <= _FEW_ENTRIES and not _is_field(system)
    found = None if few else _correct(system, direct.factors)
    if found is None or (found.doubt > _CERTAIN and entries <= _MOST_ENTRIES):
        found = cancel(system, columns_of(direct.factors)) or found or _correct(system, direct.factors)
    return found, direct


def _is_field(system: Equations) -> bool:
    """Return whether cells have a potential: between two rails, or above one with currents of one sign."""
    if system.netlist.cell_map is None or system.rails is not None:
        return system.netlist.cell_map is not None
    return not (np.any(system.drive < 0.0) and np.any(system.drive > 0.0))


class _Falls(NamedTuple):
    """Falls across resistors and the voltages that they make, in double-double.

    `falls` (resistors,): voltage of the first end above the second one; `heights` (n,): of the rows above the
    reference, in volts; `net, through` (n,): current into every row that does not leave it, and half of all currents
    there; `doubt`: largest change of a current by the last correction, relative to the current through either end;
    `faint` (resistors,): whether a current cannot be told from zero; `currentless` (resistors,): whether it is zero
    whatever the conductances are.
    """

    falls: Doubled
    heights: Doubled
    net: NDArray[np.float64]
    through: NDArray[np.float64]
    doubt: float
    faint: NDArray[np.bool_]
    currentless: NDArray[np.bool_]


def _correct(system: Equations, factors: SupernodalFactors) -> Balanced:
    """Correct in double-double, and bound the errors."""
    netlist, ends = system.netlist, system.netlist.resistor_nodes
    found = _refined(system, factors)
    falls, excused = found.falls, np.zeros(netlist.node_count, dtype=np.bool_)
    amps = netlist.conductance * np.abs(falls[0])
    if found.faint.any():
        none_flows = _around(ends, netlist.node_count, amps <= amps[found.faint].max(), found.faint)
        for part in falls:
            part[none_flows] = 0.0
        excused[ends[none_flows]] = True
        excused &= np.bincount(ends.ravel(), np.repeat(amps, 2), netlist.node_count) <= _NONE * amps.max()
    doubt = found.doubt
    if not _is_field(system):
        doubt = max(doubt, _bound(system, factors, found))
    heights, amps = system.heights(found.heights[0]), netlist.conductance * falls[0]
    power, source_amps = float(amps @ falls[0]), _source_amps(system, falls)
    return Balanced(system.above_ground(heights), heights, amps, source_amps, power, excused, np.inf, doubt)


def _refined(system: Equations, factors: SupernodalFactors) -> _Falls:
    """Add corrections until they change no current."""
    netlist, none, forest = system.netlist, np.zeros(system.size), system.forest
    ends, rows = netlist.resistor_nodes, system.unknown[netlist.resistor_nodes]
    offset, rest = forest.offsets
    held = np.where(system.unknown >= 0, offset, np.nan_to_num(system.known_voltages()))
    still = np.zeros(netlist.node_count, dtype=np.bool_)
    still[system.floating] = still[system.undriven] = True
    currentless = _currentless(system, rows)
    flows = ~still[ends].any(axis=1) & ~currentless
    one, other = ((flows * held[end], flows * rest[end]) for end in ends.T)
    falls = _plus(one, -other[0], -other[1])
    heights, worst, faint, least = (none - system.reference, none), np.inf, flows & False, flows & False
    net, through = _residual(system, rows, falls)
    for _ in range(_MOST_STEPS):
        x = factors.solve(net)
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
        beside = np.where(rows >= 0, through[rows], amps[:, np.newaxis]).min(axis=1)
        share = np.divide(moved, beside, out=np.zeros_like(amps), where=(amps > 0.0) & (beside > 0.0))
        faint, least = (share > _CERTAIN) & (amps <= _FAINT * amps.max()), amps <= _LEAST * amps.max()
        worst = float(share.max(where=~faint, initial=0.0))
        open_rows = np.abs(net) > np.maximum(_CERTAIN * through, _FAINT * through.max())
        if worst <= _CERTAIN and not ((faint & ~least).any() or open_rows.any()):
            break
    return _Falls(falls, heights, net, through, worst, faint | (least & (falls[0] != 0.0)), currentless)


def _currentless(system: Equations, rows: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return which resistors of a circuit other than a field carry no current whatever the conductances are.

    These are dead ends: every way to what drives the circuit leads through one and the same row.
    """
    currentless = np.zeros(len(rows), dtype=np.bool_)
    if _is_field(system):
        return currentless
    from resgrid.circuit.kernels import mark_currentless

    netlist, forest = system.netlist, system.forest
    lifted = forest.order[(forest.height != 0.0) | (forest.rest != 0.0)]
    drives = np.unique(system.unknown[np.concatenate([netlist.current_nodes.ravel(), lifted])])
    drives = drives[drives >= 0]
    joined = np.stack([drives, np.full_like(drives, system.size)], axis=1)
    between = np.flatnonzero(rows[:, 0] != rows[:, 1])
    pairs = np.concatenate([np.where(rows[between] < 0, system.size, rows[between]), joined]).astype(np.int32)
    start = np.concatenate([[0], np.cumsum(np.bincount(pairs.ravel(), minlength=system.size + 1))])
    edge, marks = np.argsort(pairs.ravel(), kind="stable") // 2, np.zeros(len(pairs), dtype=np.bool_)
    place, (order, low, entry, path) = start[:-1].copy(), np.full((4, system.size + 1), -1)
    edges = np.empty(len(pairs), dtype=np.int64)
    mark_currentless(pairs, start, edge, place, order, low, entry, path, edges, marks)
    currentless[between] = marks[: len(between)]
    return currentless


def _bound(system: Equations, factors: SupernodalFactors, found: _Falls) -> float:
    """Bound the errors of voltages relative to the largest one, and of currents relative to those at either end.

    A wrong current into a row raises no voltage by more than the inverse matrix says, whose entries are not negative,
    and moves no current by more than itself.
    """
    netlist, rows = system.netlist, system.unknown[system.netlist.resistor_nodes]
    wrong = np.abs(found.net) + _NOISE * found.through
    error = np.append(factors.solve(wrong), 0.0)
    level = np.abs(system.above_ground(system.heights(found.heights[0])))
    amps = netlist.conductance * np.abs(found.falls[0])
    most = np.minimum(netlist.conductance * error[rows].sum(axis=1), wrong.sum())
    beside = np.where(rows >= 0, np.append(found.through, 0.0)[rows], amps[:, np.newaxis]).min(axis=1)
    beside = np.maximum(beside, _UNCHECKED * amps.max())
    share = np.divide(most, beside, out=np.zeros_like(most), where=(beside > 0.0) & ~found.currentless)
    return float(max(share.max(initial=0.0), error.max() / max(np.nanmax(level), np.finfo(np.float64).tiny)))


def _source_amps(system: Equations, falls: Doubled) -> NDArray[np.float64]:
    """Currents of the voltage sources, (sources,), from exact sums of what flows into their nodes."""
    netlist = system.netlist
    net, net_low, _ = _flows(netlist, netlist.resistor_nodes, netlist.current_nodes, netlist.node_count, falls)
    outflow = [Fraction(0)] * netlist.node_count
    for node in system.forest.order.tolist():
        outflow[node] = -Fraction(net[node]) - Fraction(net_low[node])
    return without_loops(system.forest, np.array([float(amps) for amps in sum_cuts(netlist, system.forest, outflow)]))


def _plus(total: Doubled, more: NDArray[np.float64], more_low: NDArray[np.float64] | float = 0.0) -> Doubled:
    """The sum of double-doubles (Knuth's, without an error in the leading parts)."""
    s = total[0] + more
    t = s - total[0]
    rest = (total[0] - (s - t)) + (more - t) + (total[1] + more_low)
    hi = s + rest
    return hi, rest - (hi - s)


def _around(
    ends: NDArray[np.int32], nodes: int, small: NDArray[np.bool_], faint: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """The small currents (resistors,) that others join to a faint one: none of these is known if that is not."""
    pairs = ends[small]
    joined = sparse.coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(nodes, nodes))
    part = connected_components(joined, directed=False)[1][ends[:, 0]]
    return np.asarray(small & np.isin(part, part[faint]))


def _residual(
    system: Equations, rows: NDArray[np.int32], falls: Doubled
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Current into every row that does not leave it, and half of all currents there; in amperes, (n,)."""
    fed = system.unknown[system.netlist.current_nodes]
    net, _, total = _flows(system.netlist, rows, fed, system.size, falls)
    return np.where(np.abs(net) > _NOISE * total, net, 0.0), 0.5 * total


def _flows(
    netlist: Netlist, ends: NDArray[np.int32], fed: NDArray[np.int32], count: int, falls: Doubled
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Sum the currents of resistors and current sources into nodes or rows, in double-double, and all magnitudes.

    Shapes: `ends` (resistors, 2), `fed` (current sources, 2): numbers of nodes or rows; returns (count,) each.
    """
    from resgrid.circuit.kernels import add_flows

    net, net_low, total = np.zeros((3, count))
    amps = netlist.current_amps
    add_flows(ends, netlist.conductance, *falls, net, net_low, total)
    add_flows(fed, np.ones_like(amps), amps, np.zeros_like(amps), net, net_low, total)
    return net, net_low, total
