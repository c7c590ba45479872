"""Compiled loops of refinement: corrections and residuals of scaled double-doubles."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from resgrid.jit import inlined, inner, kernel
from resgrid.solvers.extended import Scaled
from resgrid.solvers.extended_kernels import (
    _BASE,
    _INVERSE,
    _LARGE,
    _SMALL,
    Floats,
    Indices,
    Integers,
    _canonical,
    _shift,
    _sum,
    _two_product,
    _two_sum,
)
from resgrid.solvers.laplacian import Conductances

Numbers = tuple[Floats, Integers]

_SETTLED = 1e-29
_UNIT = 2.0**-53
_NOTHING = 1e-290
"""Residual below which a row is right: what the lower parts of values that are gone leave."""

_ROW_ROUNDING = 12.0
"""Rounding errors in a row's sum of currents beside one for each conductance, with a margin."""


@inlined
def _canonical_pair(hi: float, lo: float, e: int) -> tuple[float, float, int]:
    if hi == 0.0 or not math.isfinite(hi):
        return hi, lo, e
    while abs(hi) < _SMALL:
        hi, lo, e = hi * _BASE, lo * _BASE, e - 1
    while abs(hi) >= _LARGE:
        hi, lo, e = hi * _INVERSE, lo * _INVERSE, e + 1
    return hi, lo, e


@kernel
def correct(hi: Floats, lo: Floats, e: Integers, m: Floats, me: Integers) -> None:
    """Add the scaled numbers ``(m, me)`` to scaled double-doubles, in place."""
    for i in range(len(hi)):
        if m[i] == 0.0:
            continue
        if hi[i] == 0.0 or me[i] > e[i] + 1:
            hi[i], e[i] = _canonical(m[i], me[i])
            lo[i] = 0.0
            continue
        if me[i] == e[i] + 1:
            hi[i], lo[i], e[i] = hi[i] * _INVERSE, lo[i] * _INVERSE, me[i]
        hi[i], lo[i] = _sum(hi[i], lo[i], _shift(m[i], me[i] - e[i]), 0.0)
        hi[i], lo[i], e[i] = _canonical_pair(hi[i], lo[i], e[i])


@kernel
def corrected(hi: Floats, lo: Floats, m: Floats, new_hi: Floats, new_lo: Floats) -> None:
    """Add doubles to double-doubles."""
    for i in range(len(hi)):
        s, t = _two_sum(hi[i], m[i])
        new_hi[i], new_lo[i] = _two_sum(s, t + lo[i])


@inner
def _find_exponents(
    indptr: Indices, indices: Indices, injected: Floats, injected_e: Integers, hi: Floats, e: Integers, top: Integers
) -> None:
    """Exponents of the largest number in every row of the equations.

    All rows at once: a function that takes arrays counts references at every call, which takes as long as ten rows.
    """
    for i in range(len(hi)):
        most = -(2**62)
        if injected[i] != 0.0:
            most = injected_e[i]
        if hi[i] != 0.0:
            most = max(most, e[i])
        for k in range(indptr[i], indptr[i + 1]):
            if hi[indices[k]] != 0.0:
                most = max(most, e[indices[k]])
        top[i] = most


class Imbalance(NamedTuple):
    """How far KCL is from holding.

    `backward`: componentwise backward error ``max |r_i| / (b + |A| |x|)_i`` (Oettli & Prager 1964); `settled`: that
    of the rows that are right; `left`: sum of the violations of rows that are not right, each relative to the
    currents at its row; `right`: that of all other rows, those below ``floor`` times ``(b + |A| |x|)_i`` among them,
    and what rounding may hide; `largest`: largest magnitude of a residual, where plain; `least`: smallest magnitude
    of a value other than 0, where plain; `share`: smallest ratio of a row's currents to ``(b + |A| |x|)_i``.
    """

    backward: float
    settled: float
    left: float
    right: float
    largest: float
    least: float
    share: float

    def beside(self, rest: Imbalance) -> Imbalance:
        """Together with rows that have been found right before."""
        return self.plus(rest._replace(backward=rest.settled, left=0.0, largest=0.0))

    def plus(self, rest: Imbalance) -> Imbalance:
        """Together with other rows."""
        return Imbalance(
            max(self.backward, rest.backward), max(self.settled, rest.settled), self.left + rest.left,
            self.right + rest.right, max(self.largest, rest.largest), min(self.least, rest.least),
            min(self.share, rest.share),
        )  # fmt: skip


@kernel
def residual(
    matrix: Conductances, current: Numbers, x: Scaled, floor: float, kept: float, rows: Indices, out: Numbers
) -> Imbalance:
    """Residual of KCL into ``out``, in scaled numbers, and how large it is.

    Row ``i`` is ``b_i - s_i x_i + sum_j g_ij (x_j - x_i)``: differences come first, so that off-diagonals and row
    excess never meet in a rounded diagonal.  A difference of double-doubles is right to the last digits of a double
    (of nearly equal values the upper parts subtract without error: Sterbenz 1974), and so the residual is right
    relative to the currents at the row, which is all that counts.

    Every row has the exponent of its largest value; where there are no exponents, all are 0.  Rows that are right to
    the rounding of these sums come out as 0, so that a correction can turn to those that are smaller by many decades;
    those that come in as 0 stay so up to ``kept`` times that rounding.

    Only some ``rows`` are looked at where they are given; they must be plain.
    """
    indptr, indices, conductance, ground = matrix
    injected, injected_e = current
    hi, lo, e = x.hi, x.lo, x.exponent
    r_out, r_e = out
    plain = len(e) == 0
    backward, settled, left, right, largest, least, share, top = 0.0, 0.0, 0.0, 0.0, 0.0, np.inf, 1.0, 0
    if not plain:
        _find_exponents(indptr, indices, injected, injected_e, hi, e, r_e)
    for index in range(len(rows) if len(rows) > 0 else len(hi)):
        i = rows[index] if len(rows) > 0 else index
        own, own_low, b = hi[i], lo[i], injected[i]
        if not plain:
            top = r_e[i]
            own, own_low = _shift(own, e[i] - top), _shift(own_low, e[i] - top)
            b = _shift(b, injected_e[i] - top)
        tied = ground[i] * own
        r = (b - tied) - ground[i] * own_low
        size = abs(b) + abs(tied)
        flow = size
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            v, v_low = hi[j], lo[j]
            if not plain:
                v, v_low = _shift(v, e[j] - top), _shift(v_low, e[j] - top)
            inflow = conductance[k] * ((v - own) + (v_low - own_low))
            r += inflow
            flow += abs(inflow)
            size += conductance[k] * (abs(v) + abs(own))
        if own != 0.0:
            least = min(least, abs(own))
        wrong = 0.0 if abs(r) < _NOTHING else abs(r)
        if not math.isfinite(wrong):
            return Imbalance(np.inf, np.inf, np.inf, np.inf, np.inf, 0.0, 0.0)
        error = wrong / size if size > 0.0 else 0.0
        backward = max(backward, error)
        if flow < share * size:
            share = flow / size
        violation, rounding = wrong / flow if wrong > 0.0 else 0.0, _UNIT * (_ROW_ROUNDING + indptr[i + 1] - indptr[i])
        right += rounding
        if wrong <= max(rounding * flow * (kept if r_out[i] == 0.0 else 1.0), _SETTLED * size):
            r, top = 0.0, 0
            settled = max(settled, error)
            right += violation
        else:
            largest = max(largest, wrong)
            counted = violation if wrong > floor * size else 0.0
            left, right = left + counted, right + violation - counted
        r_out[i] = r
        if not plain:
            r_e[i] = top
    return Imbalance(backward, settled, left, right, largest, least, share)


@kernel
def exact_residual(matrix: Conductances, current: Numbers, x: Scaled, out: Numbers) -> tuple[float, float]:
    """Residual of KCL by double-double arithmetic.

    As `residual`, but right relative to the voltages: where no current flows, their differences then vanish to thirty
    digits.  Rows that are right to the noise of double-doubles come out as 0.
    """
    indptr, indices, conductance, ground = matrix
    injected, injected_e = current
    hi, lo, e = x.hi, x.lo, x.exponent
    r_out, r_e = out
    worst, violation = 0.0, 0.0
    _find_exponents(indptr, indices, injected, injected_e, hi, e, r_e)
    for i in range(len(hi)):
        top = r_e[i]
        own, own_low = _shift(hi[i], e[i] - top), _shift(lo[i], e[i] - top)
        b = _shift(injected[i], injected_e[i] - top)
        p, q = _two_product(ground[i], own)
        r, r_low = _sum(b, 0.0, -p, -(q + ground[i] * own_low))
        size = abs(b) + abs(p)
        flow = size
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            v = _shift(hi[j], e[j] - top)
            d, d_low = _sum(v, _shift(lo[j], e[j] - top), -own, -own_low)
            p, q = _two_product(conductance[k], d)
            r, r_low = _sum(r, r_low, p, q + conductance[k] * d_low)
            flow += abs(p)
            size += conductance[k] * (abs(v) + abs(own))
        r_out[i] = r + r_low
        r_e[i] = top if r_out[i] != 0.0 else 0
        if size > 0.0:
            worst = max(worst, abs(r_out[i]) / size)
        if flow > 0.0:
            violation += (abs(r_out[i]) + _SETTLED * size) / flow
        if abs(r_out[i]) <= _SETTLED * size:
            r_out[i], r_e[i] = 0.0, 0
    return worst, violation
