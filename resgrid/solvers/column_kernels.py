"""Compiled loops over the columns of a factor: substitution by differences, and the selected inverse."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import inner, kernel, makes_arrays
from resgrid.solvers.extended_kernels import Floats, Indices, Integers, _sum

_NOISE = 2.0**-96
"""A difference of double-doubles this small beside them is what rounding leaves of none."""

_ROUNDING = 2.0**-44
"""The same of a sum of products of doubles; what else it may have been is for a correction to find."""


class Columns(NamedTuple):
    """A unit lower triangle by columns: `starts` (n + 1,), `rows`, `weight` (entries,): ``-L``; `pivot` (n,): ``D``.

    Every column begins with its diagonal entry, of weight -1; the others are sorted by row.
    """

    starts: Indices | Integers
    rows: Indices
    weight: Floats
    pivot: Floats


class Gaps(NamedTuple):
    """Voltages as differences, in double-double (the ``low`` arrays hold the rest).

    `change` (n,): of a row from the node its voltage hangs on most, its base; `apart` (entries,): of a column's row
    from the entry's; `above` (n, rails): of a row from every rail.
    """

    change: Floats
    change_low: Floats
    apart: Floats
    apart_low: Floats
    above: Floats
    above_low: Floats


@kernel
def feed_forward(columns: Columns, fed: Floats) -> None:
    """Carry what is fed into every row (n, sets) to the rows that are eliminated later, in place."""
    for k in range(len(columns.pivot)):
        for q in range(columns.starts[k] + 1, columns.starts[k + 1]):
            for each in range(fed.shape[1]):
                fed[columns.rows[q], each] += columns.weight[q] * fed[k, each]


@inner
def _less(a: float, a_low: float, b: float, b_low: float) -> tuple[float, float]:
    """``a - b``; 0 where that is noise."""
    d, d_low = _sum(a, a_low, -b, -b_low)
    return (0.0, 0.0) if abs(d) <= _NOISE * max(abs(a), abs(b)) else (d, d_low)


@inner
def _at(columns: Columns, k: int, row: int) -> int:
    """Where a column has its entry of a row."""
    low, high = int(columns.starts[k]) + 1, int(columns.starts[k + 1]) - 1
    while low < high:
        middle = (low + high) // 2
        if columns.rows[middle] < row:
            low = middle + 1
        else:
            high = middle
    return low


@inner
def _base(columns: Columns, ties: Floats, k: int) -> int:
    """What a row's voltage hangs on most: a row eliminated later, or ``n`` and more for a rail."""
    base, most = len(columns.pivot), ties[k, 0] / columns.pivot[k]
    for q in range(columns.starts[k] + 1, columns.starts[k + 1]):
        if columns.weight[q] > most:
            base, most = columns.rows[q], columns.weight[q]
    for r in range(1, ties.shape[1]):
        if ties[k, r] / columns.pivot[k] > most:
            base, most = len(columns.pivot) + r, ties[k, r] / columns.pivot[k]
    return base


@inner
def _row_above(columns: Columns, gaps: Gaps, place: Integers, j: int, base: int) -> tuple[float, float]:
    """Height of a row above a base that one later row has in common with it; ``place`` is of the base's column."""
    n = len(columns.pivot)
    if j == base:
        return 0.0, 0.0
    if base >= n:
        return gaps.above[j, base - n], gaps.above_low[j, base - n]
    if j < base:
        q = _at(columns, j, base)
        return gaps.apart[q], gaps.apart_low[q]
    return -gaps.apart[place[j]], -gaps.apart_low[place[j]]


@inner
def _rail_above(columns: Columns, gaps: Gaps, volts: Floats, r: int, base: int) -> tuple[float, float]:
    """Height of a rail above a base."""
    n = len(columns.pivot)
    if base >= n:
        return _sum(volts[r], 0.0, -volts[base - n], 0.0)
    return -gaps.above[base, r], -gaps.above_low[base, r]


@kernel
@makes_arrays
def substitute_differences(columns: Columns, fed: Floats, ties: Floats, volts: Floats, gaps: Gaps, given: bool) -> None:
    """Find all gaps, in place; or, where the changes are ``given``, the other ones.

    A row's voltage is a mean of those of rows eliminated later and of the rails, and what its own current adds; counted
    from its base ``p``: ``x_k - x_p = sum_j w_kj (x_j - x_p) + b_k / d_k``.  All of them are joined in the filled
    graph, so that their differences are at hand.

    Shapes: `fed` (n, 2): currents and their magnitudes, `ties` (n, rails), all carried forward; `volts` (rails,).
    """
    n, rails = len(columns.pivot), len(volts)
    starts, rows, weight = columns.starts, columns.rows, columns.weight
    change, change_low, apart, apart_low, above, above_low = gaps
    place = np.full(n, -1, np.int64)
    for k in range(n - 1, -1, -1):
        first, last, pivot, base = starts[k] + 1, starts[k + 1], columns.pivot[k], _base(columns, ties, k)
        if base < n:
            for q in range(starts[base] + 1, starts[base + 1]):
                place[rows[q]] = q
        total, size = fed[k, 0] / pivot, fed[k, 1] / pivot
        for q in range(first, last):
            apart[q], apart_low[q] = _row_above(columns, gaps, place, rows[q], base)
            total += weight[q] * apart[q]
            size += weight[q] * abs(apart[q])
        for r in range(rails):
            above[k, r], above_low[k, r] = _rail_above(columns, gaps, volts, r, base)
            total += ties[k, r] / pivot * above[k, r]
            size += ties[k, r] / pivot * abs(above[k, r])
        if not given:
            change[k] = 0.0 if abs(total) <= _ROUNDING * size else total
        for q in range(first, last):
            apart[q], apart_low[q] = _less(change[k], change_low[k], apart[q], apart_low[q])
        for r in range(rails):
            above[k, r], above_low[k, r] = _less(change[k], change_low[k], above[k, r], above_low[k, r])


@kernel
def add_falls(columns: Columns, gaps: Gaps, ends: Indices, rail: Indices, falls: Floats, falls_low: Floats) -> None:
    """Add the gaps between the rows, or a row and a rail, to falls across edges, in place.

    Shapes: `ends` (m, 2): places in the order of elimination, -1 for a node of known voltage; `rail` (m,): its rail.
    """
    for edge in range(len(ends)):
        a, b = ends[edge, 0], ends[edge, 1]
        if a == b:
            continue
        sign = -1.0 if a < 0 or (b >= 0 and b < a) else 1.0
        k, other = (a, b) if sign > 0.0 else (b, a)
        if other < 0:
            d, d_low = gaps.above[k, rail[edge]], gaps.above_low[k, rail[edge]]
        else:
            q = _at(columns, k, other)
            d, d_low = gaps.apart[q], gaps.apart_low[q]
        falls[edge], falls_low[edge] = _less(falls[edge], falls_low[edge], -sign * d, -sign * d_low)


@kernel
@makes_arrays
def selected_inverse(
    starts: Indices | Integers, rows: Indices, lower: Floats | NDArray[np.complex128], pivot: Floats, inverse: Floats
) -> None:
    """Entries of the inverse of ``L D L^T`` on the pattern of ``L`` (Takahashi, Fagan & Chen 1973).

    ``Z_ij = -sum_k Z_ik L_kj`` for ``i > j`` and ``Z_jj = 1 / D_j - sum_k Z_kj L_kj``, column by column from the last
    one back.  All entries needed lie on the pattern, for it is closed under elimination.

    Shapes: `pivot` (n,), `inverse` of ``lower``.
    """
    n = len(pivot)
    place = np.full(n, -1, dtype=np.int64)
    for j in range(n - 1, -1, -1):
        first, last = starts[j] + 1, starts[j + 1]
        for p in range(first, last):
            place[rows[p]] = p
            inverse[p] = 0.0
        for p in range(first, last):
            k = rows[p]
            inverse[p] -= inverse[starts[k]] * lower[p]
            for q in range(starts[k] + 1, starts[k + 1]):
                at = place[rows[q]]
                if at >= 0:
                    inverse[at] -= inverse[q] * lower[p]
                    inverse[p] -= inverse[q] * lower[at]
        diagonal = 1.0 / pivot[j]
        for p in range(first, last):
            diagonal -= inverse[p] * lower[p]
            place[rows[p]] = -1
        inverse[starts[j]] = diagonal
