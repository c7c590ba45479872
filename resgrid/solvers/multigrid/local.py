"""Passes of refinement where few rows are left: their equations are solved directly, with what surrounds them.

Coarse levels see little of slits and of the patches behind them, which are the last to be right.  All around them is
right by then, and corrections die out within a few cells, so that a pass over the whole circuit would serve some
hundred rows alone.

Along a slit the potential falls by decades within a few cells.  Where what a pass over the whole circuit leaves is
larger than the potential itself, it is found there from what flows in, all decades at once: every number is positive.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.extended import power
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.refine import Approximation, Numbers
from resgrid.solvers.supernodal import SupernodalFactors, factor_supernodes

_FEW = 5_000
"""Rows left, at most, for which a direct pass is tried."""

_STEPS = 8
"""Steps around a row within which corrections die out."""

_MOST, _SHARE = 20_000, 16
"""Rows that are solved directly, at most: so many, or one in so many of all."""

_LEAST = 8
"""One of so many of these are solved at least: along a slit all that lies below changes with what lies above."""

_GAIN = 0.5
"""Share of the rows left before that may be left after a direct pass, for another one to follow."""


class LocalCorrections:
    """An approximate inverse that solves directly where few entries of the right-hand side are left.

    Corrections in the open do not die out: where a direct pass leaves many of the rows, the next one is a whole one.

    `whole`: the approximate inverse of all rows; `in_slit`: whether the currents flow into a slit. Its surroundings
    have the first turn then, and not the whole: a pass over all rows would gain the decades along the slit, and few
    beyond.
    """

    def __init__(self, laplacian: Laplacian, whole: Approximation, in_slit: bool = False) -> None:
        self._laplacian, self._whole = laplacian, whole
        self._most, self._most_anew = float(_FEW if in_slit else 0), float(_MOST)
        self._in_slit = in_slit

    def __call__(self, m: NDArray[np.float64], e: NDArray[np.int64], accuracy: float) -> Numbers:
        """As `resgrid.solvers.refine.refine` takes it."""
        count = np.count_nonzero(m)
        part = _part_around(self._laplacian, m) if 0 < count <= self._most else None
        if part is not None:
            self._most = _GAIN * count
            return part.correction(m, e)
        self._most, self._in_slit = _FEW, False
        return self._whole(m, e, accuracy)

    def anew(
        self, left: NDArray[np.float64], voltage: Numbers, current: Numbers
    ) -> tuple[NDArray[np.int64], Numbers] | None:
        """Voltages of the rows left and those around, from all others; as `resgrid.solvers.refine.refine` takes it."""
        if self._in_slit:
            return None
        count = np.count_nonzero(left)
        part = _part_around(self._laplacian, left) if 0 < count <= self._most_anew else None
        if part is None:
            return None
        self._most_anew = _GAIN * count
        return part.rows, part.fed(voltage, current)


@dataclass(frozen=True, eq=False)
class _Part:
    """The equations of some rows.

    `rows` (n,): in ascending order; `inside, outside` (edges,): conductances that lead out: from which of the rows,
    counted, to which one; `conductance` (edges,).
    """

    rows: NDArray[np.int64]
    inside: NDArray[np.int64]
    outside: NDArray[np.int32]
    conductance: NDArray[np.float64]
    factors: SupernodalFactors

    def correction(self, m: NDArray[np.float64], e: NDArray[np.int64]) -> Numbers:
        """Corrections of these rows, all others as they are."""
        x, exponent = np.zeros_like(m), np.zeros_like(e)
        if e.size:
            x[self.rows], exponent[self.rows] = self.factors.substitute(m[self.rows], e[self.rows])
        else:
            x[self.rows] = self.factors.solve(m[self.rows])
        return x, exponent

    def fed(self, voltage: Numbers, current: Numbers) -> Numbers:
        """Voltages of these rows, fed by all others and by currents."""
        (x, e), (b, scale), n = voltage, current, len(self.rows)
        drawn, into = self.conductance * x[self.outside], b[self.rows]
        if not e.size:
            return self.factors.solve(into + np.bincount(self.inside, drawn, n)), e
        there, own = e[self.outside], scale[self.rows]
        top, flowing = np.where(into != 0.0, own, there.min(initial=0)), drawn != 0.0
        np.maximum.at(top, self.inside[flowing], there[flowing])
        drawn = drawn * power(np.clip(there - top[self.inside], -8, 0))
        return self.factors.substitute(
            into * power(np.clip(own - top, -8, 0)) + np.bincount(self.inside, drawn, n), top
        )


def _part_around(laplacian: Laplacian, left: NDArray[np.float64]) -> _Part | None:
    """The equations of the rows left, and of those around; None for too many."""
    region = _around(laplacian, np.flatnonzero(left))
    if region is None:
        return None
    rows, kept = laplacian.edges[region], np.zeros(laplacian.size, dtype=np.bool_)
    kept[region] = True
    out = ~kept[rows.indices]
    inside = np.repeat(np.arange(len(region)), np.diff(rows.indptr))[out]
    return _Part(region, inside, rows.indices[out], rows.data[out], factor_supernodes(laplacian.within(kept)))


def _around(laplacian: Laplacian, rows: NDArray[np.int64]) -> NDArray[np.int64] | None:
    """Some rows, and all that are few steps away; None for too many."""
    most = min(_MOST, laplacian.size // _SHARE)
    seen, edge, count, steps = np.zeros(laplacian.size, dtype=np.bool_), rows, len(rows), 0
    seen[rows] = True
    while len(edge) and (steps < _STEPS or count < most // _LEAST):
        steps += 1
        if count > most:
            return None
        around = laplacian.edges[edge].indices
        around = around[~seen[around]]
        seen[around] = True
        edge = np.unique(around)
        count += len(edge)
    return np.flatnonzero(seen) if count <= most else None
