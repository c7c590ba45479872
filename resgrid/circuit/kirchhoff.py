"""Currents that obey Kirchhoff's current law at every node, where differences of its voltages do not tell them.

Stiff ties to a rail, flat dead ends, balanced loops: what flows there is some 1e-16 of what the voltages are, or less.
Substitution is done in differences between the rows that elimination joins, each of them a sum of products
(`resgrid.solvers.columns.substitute_differences`), and corrected until all currents balance at every node, each
node by its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from resgrid.circuit.equations import Equations
from resgrid.errors import BudgetError
from resgrid.solvers.choose import factor_laplacian
from resgrid.solvers.columns import Columns, Gaps, add_falls, columns_of, feed_forward, substitute_differences
from resgrid.solvers.factor import DirectFactor

_MOST_TIES = 2e7
"""Rows times rails that are kept apart."""

_CERTAIN = 1e-9
"""Share of the current through a node by which the last correction may have changed a current there."""

_FAINT = 1e-30
"""Share of the largest current below which one that cancellation hides counts as none."""

_MOST_STEPS = 30


class Falls(NamedTuple):
    """Falls across resistors and the voltages that they make.

    `falls` (resistors,): voltage of the first end above the second one's; `volts` (rails,): voltages of the rails;
    `above` (n, rails): heights of the rows above each, in volts; `doubt`: the most by which the last correction has
    changed a current, relative to what flows through either end.
    """

    falls: NDArray[np.float64]
    volts: NDArray[np.float64]
    above: NDArray[np.float64]
    doubt: float


def balance(system: Equations) -> Falls | None:
    """Falls that balance at every row; None where there are too many rails, or too little memory for the factors."""
    forest, netlist = system.forest, system.netlist
    lift = np.where(system.unknown >= 0, forest.offset, 0.0)
    rows, known = system.unknown[netlist.resistor_nodes], system.known_voltages()[netlist.resistor_nodes]
    held = rows < 0
    contact = held[:, 0] != held[:, 1]
    volts, rail = np.unique(known[contact][held[contact]], return_inverse=True)
    if not 0 < system.size * len(volts) <= _MOST_TIES:
        return None
    rail_of = np.zeros(len(rows), dtype=np.int32)
    rail_of[contact] = rail
    try:
        by = _differences(system, rows, rail_of, len(volts))
    except BudgetError:
        return None
    apart = np.where(
        held.all(axis=1), np.nan_to_num(known[:, 0] - known[:, 1]), -np.diff(lift[netlist.resistor_nodes])[:, 0]
    )
    none, faint = np.zeros_like(apart), np.zeros(len(apart), dtype=np.bool_)
    gaps, worst = by.solve(_residual(system, rows, (apart, none))[0], volts), np.inf
    residual, _ = _residual(system, rows, by.falls(gaps, apart))
    for _ in range(_MOST_STEPS):
        more = by.solve(residual, np.zeros_like(volts))
        by.correct(gaps, more, volts)
        falls = by.falls(gaps, apart)
        residual, through = _residual(system, rows, falls)
        least = np.append(through, np.inf)[rows].min(axis=1)
        amps = netlist.conductance * np.abs(falls[0])
        moved = netlist.conductance * np.abs(by.falls(more, none)[0])
        share = np.divide(moved, least, out=none.copy(), where=(amps > 0.0) & (least > 0.0))
        faint = (share > _CERTAIN) & (amps <= _FAINT * amps.max())
        before, worst = worst, float(share.max(where=~faint, initial=0.0))
        if worst <= _CERTAIN or not worst < before:
            break
    if faint.any():
        falls[0][_around(netlist.resistor_nodes, netlist.node_count, amps <= _FAINT * amps.max(), faint)] = 0.0
    above = np.empty((system.size, len(volts)))
    above[by.order] = gaps.apart[by.columns.starts[1:, np.newaxis] - np.arange(len(volts), 0, -1)]
    return Falls(falls[0], volts, above, worst)


@dataclass(frozen=True, eq=False)
class _Differences:
    """Factors by columns, with the rails as rows behind all others.

    `columns`: of ``-L`` and ``D``; `order` (n,): the row that is eliminated at every place; `ends` (resistors, 2):
    places of their ends; -1 where both are of known voltage.
    """

    columns: Columns
    order: NDArray[np.int32]
    ends: NDArray[np.int32]

    def solve(self, fed: NDArray[np.float64], volts: NDArray[np.float64]) -> Gaps:
        """Solve for what is fed into the rows (n,), in amperes, and the rails' voltages (rails,)."""
        n, entries = len(self.order), len(self.columns.rows)
        carried = np.zeros((n + len(volts), 2))
        carried[:n] = np.stack([fed, np.abs(fed)], axis=1)[self.order]
        feed_forward(self.columns, carried)
        gaps = Gaps(*np.zeros((2, n)), *np.zeros((2, entries)))
        substitute_differences(self.columns, carried, volts, gaps, given=False)
        return gaps

    def correct(self, gaps: Gaps, more: Gaps, volts: NDArray[np.float64]) -> None:
        """Add the changes of other gaps, in place."""
        total = gaps.change + more.change
        taken = total - gaps.change
        lost = (gaps.change - (total - taken)) + (more.change - taken) + gaps.change_low
        gaps.change[:] = total + lost
        gaps.change_low[:] = lost - (gaps.change - total)
        substitute_differences(self.columns, np.zeros((len(self.order), 2)), volts, gaps, given=True)

    def falls(self, gaps: Gaps, apart: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Falls across the resistors beside what sources hold ``apart``, in double-double; shapes (resistors,)."""
        falls, falls_low = apart.copy(), np.zeros_like(apart)
        add_falls(self.columns, gaps, self.ends, falls, falls_low)
        return falls, falls_low


def _differences(system: Equations, rows: NDArray[np.int32], rail: NDArray[np.int32], rails: int) -> _Differences:
    """Factor a circuit with its rails.  Shapes: `rows` (resistors, 2), -1 on a rail, `rail` (resistors,)."""
    factors = factor_laplacian(system.laplacian, "direct")
    assert isinstance(factors, DirectFactor)
    order, columns = columns_of(factors.factors)
    n, tied = system.size, (rows < 0).sum(axis=1) == 1
    place = np.argsort(order)
    ends = np.where(rows >= 0, np.append(place, -1)[rows], np.where(tied, n + rail, -1)[:, np.newaxis])
    ties = np.zeros((n, rails))
    np.add.at(ties, (place[rows[tied].max(axis=1)], rail[tied]), system.netlist.conductance[tied])
    feed_forward(columns, ties)
    at = np.repeat(columns.starts[1:], rails)
    behind, shares = np.tile(np.arange(n, n + rails), n), ties / columns.pivot[:, np.newaxis]
    columns = Columns(
        columns.starts + rails * np.arange(n + 1),
        np.insert(columns.rows, at, behind),
        np.insert(columns.weight, at, shares.ravel()),
        columns.pivot,
    )
    return _Differences(columns, order, ends.astype(np.int32))


def _around(
    ends: NDArray[np.int32], nodes: int, small: NDArray[np.bool_], faint: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """The small currents (resistors,) that others join to a faint one: none of these is known if that is not."""
    pairs = ends[small]
    joined = sparse.coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(nodes, nodes))
    part = connected_components(joined, directed=False)[1][ends[:, 0]]
    return np.asarray(small & np.isin(part, part[faint]))


def _residual(
    system: Equations, rows: NDArray[np.int32], falls: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What flows into every row beyond what flows out, and half of all that flows there; in amperes, (n,)."""
    from resgrid.circuit.kernels import add_flows

    netlist, amps = system.netlist, system.netlist.current_amps
    net, net_low, total = np.zeros((3, system.size))
    add_flows(rows, netlist.conductance, *falls, net, net_low, total)
    add_flows(system.unknown[netlist.current_nodes], np.ones_like(amps), amps, np.zeros_like(amps), net, net_low, total)
    return net, 0.5 * total
