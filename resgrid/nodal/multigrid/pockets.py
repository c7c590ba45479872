"""Passes of refinement where few rows are left: their equations are solved directly, with what surrounds them.

Coarse levels see little of slits and of the pockets behind them, which are the last to be right.  All around them is
right by then, and corrections die out within a few cells, so that a pass over the whole circuit would serve some
hundred rows alone.

Along a slit the potential falls by decades within a few cells.  Where what a pass over the whole circuit leaves is
larger than the potential itself, it is found there from what flows in, all decades at once: every number is positive.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from resgrid.nodal.multigrid.part import Part, surroundings
from resgrid.nodal.refine import Approximation, Numbers
from resgrid.nodal.scaled import power
from resgrid.nodal.system import NodalSystem

_FEW = 2_000
"""Rows left, at most, for which a direct pass is tried."""

_MOST, _SHARE = 20_000, 16
"""Rows that are solved directly, at most: so many, or one in so many of all."""

_LEAST = 8
"""One of so many of these are solved at least: along a slit all that lies below changes with what lies above."""

_GAIN = 0.5
"""Share of the rows left before that may be left after a direct pass, for another one to follow."""


class PocketsDirectly:
    """An approximate inverse that solves directly where few entries of the right-hand side are left.

    Corrections in the open do not die out: where a direct pass leaves many of the rows, the next one is a whole one.

    Parameters
    ----------
    system : NodalSystem
    whole : callable
        The approximate inverse of all rows; its turn is the first.
    """

    def __init__(self, system: NodalSystem, whole: Approximation) -> None:
        self._system, self._whole = system, whole
        self._most = 0.0
        self._most_anew = _MOST

    def __call__(self, m: NDArray[np.float64], e: NDArray[np.int64], accuracy: float) -> Numbers:
        """As `resgrid.nodal.refine.refine` takes it."""
        rows = np.flatnonzero(m != 0.0)
        if 0 < len(rows) <= self._most:
            region = _around(self._system, rows)
            found = None if region is None else _solved(self._system, region, m, e)
            if found is not None:
                self._most = _GAIN * len(rows)
                return found
        self._most = _FEW
        return self._whole(m, e, accuracy)

    def anew(
        self, rows: NDArray[np.int64], voltage: Numbers, current: Numbers
    ) -> tuple[NDArray[np.int64], Numbers] | None:
        """Voltages of some rows and those around them, from all others; as `resgrid.nodal.refine.refine` takes it."""
        if not 0 < len(rows) <= self._most_anew:
            return None
        region = _around(self._system, rows)
        found = None if region is None else _fed(self._system, region, voltage, current)
        if region is None or found is None:
            return None
        self._most_anew = int(_GAIN * len(rows))
        return region, found


def _around(system: NodalSystem, rows: NDArray[np.int64]) -> NDArray[np.int64] | None:
    """Some rows, and all that are few steps away; None for too many."""
    most = min(_MOST, system.size // _SHARE)
    return surroundings(rows, system.size, lambda edge: system.coupling[edge].indices, most, most // _LEAST)


def _part(system: NodalSystem, region: NDArray[np.int64]) -> Part | None:
    """The equations of some rows; None if rounding forbids."""
    rows, n = system.coupling[region], len(region)
    here = np.repeat(np.arange(n), np.diff(rows.indptr))
    part = Part.of(region, np.bincount(here, rows.data, n) + system.excess[region], here, rows.indices, rows.data)
    return None if part.factors is None else part


def _solved(
    system: NodalSystem, region: NDArray[np.int64], m: NDArray[np.float64], e: NDArray[np.int64]
) -> Numbers | None:
    """Corrections of some rows, all others as they are; None if rounding forbids."""
    part = _part(system, region)
    if part is None:
        return None
    x, exponent = np.zeros_like(m), np.zeros_like(e)
    right = m[region]
    if e.size:
        pocket, top = _tops(part, [(np.arange(len(region)), right, e[region])])
        exponent[region] = top[pocket]
        right = right * power(np.clip(e[region] - top[pocket], -8, 0))
    x[region] = part.factors.solve(right)
    return x, exponent


def _fed(system: NodalSystem, region: NDArray[np.int64], voltage: Numbers, current: Numbers) -> Numbers | None:
    """Voltages of some rows, fed by all others and by currents; None if rounding forbids."""
    part = _part(system, region)
    if part is None:
        return None
    (x, e), (b, scale), n = voltage, current, len(region)
    drawn, into = part.conductance * x[part.outside], b[region]
    if not e.size:
        return part.factors.solve(into + np.bincount(part.row, drawn, n)), e
    from_outside = e[part.outside]
    pocket, top = _tops(part, [(part.row, drawn, from_outside), (np.arange(n), into, scale[region])])
    drawn = drawn * power(np.clip(from_outside - top[pocket[part.row]], -8, 0))
    into = into * power(np.clip(scale[region] - top[pocket], -8, 0))
    return part.factors.solve(into + np.bincount(part.row, drawn, n)), top[pocket]


def _tops(
    part: Part, terms: list[tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]]
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Pocket of every row, and the largest exponent in every pocket of terms ``(row, mantissa, exponent)``.

    Pockets do not know of each other: each has an exponent of its own.
    """
    count, pocket = connected_components(part.coupling, directed=False)
    top = np.full(count, np.iinfo(np.int64).min)
    for row, mantissa, exponent in terms:
        used = mantissa != 0.0
        np.maximum.at(top, pocket[row[used]], exponent[used])
    top[top == np.iinfo(np.int64).min] = 0
    return pocket, top
