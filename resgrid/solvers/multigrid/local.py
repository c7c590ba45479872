"""Passes of refinement where few rows are left: their equations are solved directly, with what surrounds them.

Coarse levels see little of slits and of the patches behind them, which are the last to be right.  All around them is
right by then, and corrections die out within a few cells, so that a pass over the whole circuit would serve some
hundred rows alone.

Along a slit the potential falls by decades within a few cells.  Where what a pass over the whole circuit leaves is
larger than the potential itself, it is found there from what flows in, all decades at once: every number is positive.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.extended import Scaled
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.refine import Approximation, Numbers, imbalance
from resgrid.solvers.supernodal import factor_supernodes

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
        rows = _around(self._laplacian, np.flatnonzero(m)) if 0 < count <= self._most else None
        if rows is None:
            self._most, self._in_slit = _FEW, False
            return self._whole(m, e, accuracy)
        self._most = _GAIN * count
        x, exponent = np.zeros_like(m), np.zeros_like(e)
        x[rows], exponent[rows] = self._solved(rows, m, e)
        return x, exponent

    def anew(
        self, left: NDArray[np.float64], voltage: Numbers, current: Numbers
    ) -> tuple[NDArray[np.int64], Numbers] | None:
        """Voltages of the rows left and those around, from all others; as `resgrid.solvers.refine.refine` takes it.

        What the others feed into them is the residual where their own voltages are 0.
        """
        count = np.count_nonzero(left)
        some = not self._in_slit and 0 < count <= self._most_anew
        rows = _around(self._laplacian, np.flatnonzero(left)) if some else None
        if rows is None:
            return None
        self._most_anew = _GAIN * count
        x, e = voltage
        others, fed = Scaled(x.copy(), np.zeros_like(x), e), (np.zeros_like(x), np.zeros_like(e))
        others.hi[rows] = 0.0
        imbalance(self._laplacian.conductances, current, others, fed)
        return rows, self._solved(rows, *fed)

    def _solved(self, rows: NDArray[np.int64], m: NDArray[np.float64], e: NDArray[np.int64]) -> Numbers:
        """Voltages of some rows for what is fed into them, those of all others 0.  Shapes: `m, e` (n,)."""
        kept = np.zeros(self._laplacian.size, dtype=np.bool_)
        kept[rows] = True
        return factor_supernodes(self._laplacian.within(kept)).substitute(m[rows], e[rows])


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
