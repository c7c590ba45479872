"""Currents that obey Kirchhoff's current law at every node, where differences of its voltages do not tell them.

Stiff ties to a rail, flat dead ends, balanced loops: what flows there is some 1e-16 of what the voltages are, or less.
Voltages are sums of corrections, each of which makes up for what the others leave of Kirchhoff's law, node by node;
falls are sums of the corrections' differences, so that one is known to its last digit, however small.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from resgrid.circuit.equations import Equations
from resgrid.errors import BudgetError
from resgrid.solvers.choose import factor_laplacian
from resgrid.solvers.factor import DirectFactor

_CERTAIN = 1e-9
"""Share of the current through a node by which the last correction may have changed a current there."""

_LEAST, _FAINT, _NONE = 1e-280, 1e-30, 1e-28
"""Shares of the largest current: below the first, currents count as none, for doubles end; below the second, those that
cancellation hides do; below the third, KCL is not asked for where they do."""

_DIGITS = 48
"""Binary digits of a correction, counted from its largest entry: what only rounding tells apart is equal."""

_NOISE = 2.0**-98
"""Share of the currents at a node below which their sum is what double-doubles leave of none."""

_MOST_VOLTS = 1e200
"""A correction from which on they make nothing better, only larger."""

_MOST_STEPS = 30

Doubled = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Double-doubles: numbers and what they leave."""


class Falls(NamedTuple):
    """Falls across resistors and the voltages that they make.

    `falls` (resistors,): voltage of the first end above the second one's; `heights` (n,): of the rows above the
    reference, in volts; `doubt`: the most by which the last correction has changed a current, relative to what flows
    through either end; `excused` (nodes,): whether a current counts as none there that others, of 1e-28 of the largest
    at most, may not add up without; `factors`: those that they were found with, if there are rows.
    """

    falls: NDArray[np.float64]
    heights: NDArray[np.float64]
    doubt: float
    excused: NDArray[np.bool_]
    factors: DirectFactor | None


def balance(system: Equations) -> Falls | None:
    """Falls that balance at every row; None where there is too little memory for the factors."""
    netlist, none, forest = system.netlist, np.zeros(system.size), system.forest
    ends, rows = netlist.resistor_nodes, system.unknown[netlist.resistor_nodes]
    offset, rest = forest.offsets
    held = np.where(system.unknown >= 0, offset, np.nan_to_num(system.known_voltages()))
    still = np.zeros(netlist.node_count, dtype=np.bool_)
    still[system.floating] = still[system.undriven] = True
    flows = ~still[ends].any(axis=1)
    one, other = ((flows * held[end], flows * rest[end]) for end in ends.T)
    falls, excused = _plus(one, -other[0], -other[1]), np.zeros(netlist.node_count, dtype=np.bool_)
    if not system.size:
        return Falls(falls[0], none, 0.0, excused, None)
    try:
        direct = factor_laplacian(system.laplacian, "direct")
    except BudgetError:
        return None
    assert isinstance(direct, DirectFactor)
    heights, worst = (none - system.reference, none), np.inf
    net, through = _residual(system, rows, falls)
    for _ in range(_MOST_STEPS):
        x = direct.factors.solve(net)
        size = float(np.abs(x).max())
        if not size < _MOST_VOLTS:
            worst = np.inf
            break
        digit = math.ldexp(1.0, math.frexp(size)[1] - _DIGITS) or 1.0
        x = np.rint(x / digit) * digit
        first, second = np.append(x, 0.0)[rows.T]
        change = _plus((first, np.zeros(len(rows))), -second)
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
    faint |= least & (amps > 0.0)
    if faint.any():
        none_flows = _around(ends, netlist.node_count, amps <= amps[faint].max(), faint)
        falls[0][none_flows] = 0.0
        excused[ends[none_flows]] = True
        excused &= np.bincount(ends.ravel(), np.repeat(amps, 2), netlist.node_count) <= _NONE * amps.max()
    return Falls(falls[0], heights[0], worst, excused, direct)


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
    """What flows into every row beyond what flows out, and half of all that flows there; in amperes, (n,)."""
    from resgrid.circuit.kernels import add_flows

    netlist, amps = system.netlist, system.netlist.current_amps
    net, net_low, total = np.zeros((3, system.size))
    add_flows(rows, netlist.conductance, *falls, net, net_low, total)
    add_flows(system.unknown[netlist.current_nodes], np.ones_like(amps), amps, np.zeros_like(amps), net, net_low, total)
    return np.where(np.abs(net) > _NOISE * total, net, 0.0), 0.5 * total
