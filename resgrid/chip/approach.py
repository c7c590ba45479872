"""When every row of a circuit comes into a band around its final voltage for good."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.chip.motion import SPAN, Motion
from resgrid.chip.roots import Solver, laplacian_root
from resgrid.nodal.dynamics import Dynamics, charge_basis

Floats = NDArray[np.float64]

FINENESS = 0.005
"""Accuracy of deviations, relative to the band."""

_STEPS = 64
_POINTS = 256
_FEWEST_POINTS = 32
_MOST_VALUES = 3e7


@dataclass(frozen=True, eq=False)
class Approach:
    """How rows come into a band.

    `row_time` (n,): from when on every row is inside, in seconds; `end` (n,): deviations when the last one is, in
    volts; `times` (t,): in seconds: 0, then by equal ratios, until the last one is inside or later; `distance` (t,):
    largest deviation at those times, in volts.
    """

    row_time: Floats
    end: Floats
    times: Floats
    distance: Floats

    @property
    def last(self) -> float:
        """From when on all rows are inside, in seconds."""
        return float(self.row_time.max(initial=0.0))


def follow_approach(
    deviation: Floats, rows: NDArray[np.int64], window: Callable[[float, float], Motion], bound: float,
    fastest: float, band: float,
) -> Approach:  # fmt: skip
    """Walk back from when all rows are inside, a window of times at a time, until each is placed.

    Shapes: `deviation` (n,).
    """
    from resgrid.chip.motion_kernels import last_outside

    row_time = np.zeros(len(deviation))
    if bound == 0.0:
        return Approach(row_time, deviation, np.zeros(1), np.abs(deviation).max(initial=0.0, keepdims=True))
    end, last, curve = deviation, bound, None
    while rows.size or curve is None:
        first = last / SPAN if last > fastest else 0.0
        motion = window(first, last)
        times = _instants(first, last, _STEPS)
        last_outside(np.ascontiguousarray(motion.shape), motion.weight, motion.rate, times, band, rows, row_time)
        settled = float(row_time.max(initial=0.0))
        if settled > 0.0 and end is deviation:
            end, curve = motion.at(np.array([settled]))[0], None
        if curve is None:
            curve = _curve(motion, deviation, first, last)
        rows, last = rows[row_time[rows] == 0.0], first
        if last == 0.0:
            break
    return Approach(row_time, end, *curve)


def rows_to_follow(
    dynamics: Dynamics, solve: Solver, charging: Floats, deviation: Floats, band: float
) -> NDArray[np.int64]:
    """Rows that may be outside a band after time 0.

    With capacitors to rails only, the charging currents ``i`` drive every row up by ``G^-1 i+`` in all and down by
    ``G^-1 i-``, for ``exp(-t C^-1 G)`` has no negative entries: no row is ever further from its end than the larger of
    the two, and one that is driven one way only never leaves a band that it is in.

    Shapes: `charging` (n,), `deviation` (n,).
    """
    if dynamics.capacitance.coupling.nnz:
        return np.arange(dynamics.size)
    current = np.where(charge_basis(dynamics).charged, charging, 0.0)
    up, down = (solve(np.maximum(part, 0.0)) if (part > 0).any() else 0.0 * part for part in (current, -current))
    reach, swing = np.maximum(up, down), np.minimum(up, down)
    one_way = (swing <= FINENESS * band) & (np.abs(deviation) <= band)
    return np.flatnonzero((reach > band * (1.0 - FINENESS)) & ~one_way)


def settling_bound(dynamics: Dynamics, solve: Solver, deviation: Floats, tau: float, band: float) -> float:
    """Time after which ``exp(-t / tau)`` leaves no row outside a band.

    In the norms ``sqrt(y^T C y)`` and ``sqrt(y^T G y)`` every deviation ``y`` falls at least as ``exp(-t / tau)``.  A
    voltage is at most the first over the root of the smallest eigenvalue of C, which is at least the smallest
    capacitance to a rail, where every row has one or lies between others; and always at most the second times the root
    of its ``(G^-1)_ii``, which is at most its ``(G^-1 1)_i``.

    Shapes: `deviation` (n,).
    """
    basis = charge_basis(dynamics)
    stiffness = dynamics.capacitance.excess[basis.charged]
    if (stiffness > 0).all():
        norm, reach = dynamics.capacitance, 1.0 / np.sqrt(float(stiffness.min()))
    else:
        norm, reach = dynamics.conductance, float(np.sqrt(solve(np.ones(dynamics.size)).max()))
    largest = float(np.linalg.norm(laplacian_root(norm) @ deviation)) * reach
    return 0.0 if largest <= band else tau * float(np.log(largest / band))


def _instants(first: float, last: float, count: int) -> Floats:
    """Times of a window by equal ratios; its beginning besides where that is 0."""
    return np.geomspace(first, last, count) if first > 0.0 else np.append(0.0, np.geomspace(last / SPAN, last, count))


def _curve(motion: Motion, deviation: Floats, first: float, last: float) -> tuple[Floats, Floats]:
    """Times of a window after 0, and the largest deviation at them."""
    count = int(np.clip(_MOST_VALUES / len(deviation), _FEWEST_POINTS, _POINTS))
    times = _instants(first or last / SPAN, last, count)
    parts = [np.abs(motion.at(part)).max(axis=1) for part in np.array_split(times, _FEWEST_POINTS)]
    return np.append(0.0, times), np.concatenate([np.abs(deviation).max(keepdims=True), *parts])
