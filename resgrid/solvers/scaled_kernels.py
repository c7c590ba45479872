"""Kernels for scaled numbers: arithmetic, corrections and residuals.

A *scaled* number is ``m * 2**(256 e)`` with a double ``m`` (canonical: ``2**-128 <= |m| < 2**128``, or 0) and a 64-bit
integer ``e``. A scaled double-double adds a second double, ``(hi + lo) * 2**(256 e)`` with ``|lo| <= ulp(hi) / 2``. The
error-free sum and product are those of Knuth and Dekker (Ogita, Rump & Oishi 2005, algorithms 3.1 to 3.3).

The import of numba takes seconds: only functions that are about to solve import this module.
"""

from __future__ import annotations

import math

import numpy as np

from resgrid._internal.jit import inlined, kernel
from resgrid.solvers.laplacian import Graph
from resgrid.solvers.scaled import BITS, Floats, Integers, Numbers, Scaled

_BASE = 2.0**BITS
_INVERSE = 2.0**-BITS
_LARGE = 2.0 ** (BITS // 2)
_SMALL = 2.0 ** -(BITS // 2)
"""Limits of the magnitude of a canonical mantissa: below `_LARGE`, at least `_SMALL`."""

_SPLITTER = 2.0**27 + 1.0
"""Factor by which a double is multiplied to split it into two halves of at most 26 bits (Dekker)."""

_SETTLED = 1e-29
"""Rounding error of a row's residual in double-double, relative to ``(b + |A| |x|)_i``; a smaller residual counts as 0.
"""

_UNIT = 2.0**-53
"""Largest relative error of a rounded double."""

_NOTHING = 1e-290
"""Residual of a row, in amperes times ``2**(-256 e)`` with the row's exponent ``e``, below which the row is converged.

Underflow in the lower parts of double-doubles leaves residuals of this size.
"""

NO_EXPONENT = -(2**62)
"""Exponent of the number 0 where the largest exponent of several numbers is sought; any other exponent is larger."""

_LOG_BASE = BITS * math.log(2.0)

_ROW_ROUNDING = 12.0
"""Number of rounding errors in the sum of a row's currents, with a margin; one more is added for every conductance.

Each rounding error is 2**-53 times the sum of the magnitudes of the currents.
"""


@inlined
def _canonical(m: float, e: int) -> tuple[float, int]:
    """Return ``m * 2**(256 e)`` as a mantissa between ``2**-128`` and ``2**128`` in magnitude, and an exponent.

    A mantissa that is 0 or not finite is returned unchanged.
    """
    if m == 0.0 or not math.isfinite(m):
        return m, e
    while abs(m) < _SMALL:
        m *= _BASE
        e -= 1
    while abs(m) >= _LARGE:
        m *= _INVERSE
        e += 1
    return m, e


@inlined
def _shift(value: float, steps: int) -> float:
    """Return ``value * 2**(256 * steps)``, exact for -1, 0 and 1 steps; 0 below -1, signed infinity above 1.

    A value of 0 is returned unchanged.
    """
    if steps == 0 or value == 0.0:
        return value
    if steps == 1:
        return value * _BASE
    if steps == -1:
        return value * _INVERSE
    return 0.0 if steps < 0 else math.copysign(np.inf, value)


@inlined
def _add_product(m: float, e: int, factor: float, v: float, ve: int) -> tuple[float, int]:
    """Return mantissa and exponent of ``m * 2**(256 e) + factor * v * 2**(256 ve)``.

    A term that is more than 2**256 times smaller than the other is neglected.
    """
    t, te = _canonical(factor * v, ve)
    if m == 0.0 or t == 0.0:
        return (t, te) if m == 0.0 else (m, e)
    top = max(e, te)
    return _shift(m, e - top) + _shift(t, te - top), top


@inlined
def _two_sum(a: float, b: float) -> tuple[float, float]:
    """Return the rounded sum ``a + b`` and its rounding error (Knuth)."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


@inlined
def _two_product(a: float, b: float) -> tuple[float, float]:
    """Return the rounded product ``a b`` and its rounding error (Dekker)."""
    p = a * b
    t = _SPLITTER * a
    a1 = t - (t - a)
    a2 = a - a1
    t = _SPLITTER * b
    b1 = t - (t - b)
    b2 = b - b1
    return p, a2 * b2 - (((p - a1 * b1) - a2 * b1) - a1 * b2)


@inlined
def _sum(a: float, a_low: float, b: float, b_low: float) -> tuple[float, float]:
    """Return the sum of the double-doubles ``a + a_low`` and ``b + b_low``, as its upper and its lower part."""
    s, t = _two_sum(a, b)
    u, v = _two_sum(a_low, b_low)
    s, t = _two_sum(s, t + u)
    return _two_sum(s, t + v)


@kernel
def correct(x: Scaled, m: Floats, me: Integers, out: Scaled) -> None:
    """Write the sum of the double-doubles ``x`` and the numbers ``m * 2**(256 me)`` to the double-doubles ``out``.

    `x, out` (n,): double-doubles with separate exponents; `m, me` (n,): mantissas and exponents of the correction.
    """
    hi, lo, e = x.hi, x.lo, x.exponent
    new_hi, new_lo, new_e = out.hi, out.lo, out.exponent
    for i in range(len(hi)):
        a, a_low, exponent = hi[i], lo[i], e[i]
        if m[i] != 0.0:
            top = me[i] if a == 0.0 else max(me[i], exponent)
            a, rest = _two_sum(_shift(a, exponent - top), _shift(m[i], me[i] - top))
            a, a_low = _two_sum(a, rest + _shift(a_low, exponent - top))
            a, exponent = _canonical(a, top)
            a_low = math.ldexp(a_low, BITS * (top - exponent)) if top != exponent else a_low
        new_hi[i], new_lo[i], new_e[i] = a, a_low, exponent


@inlined
def _add_inflow(
    r: float, r_low: float, g: float, v: float, v_low: float, own: float, own_low: float, exact: bool
) -> tuple[float, float, float]:
    """Add the current from a neighbour, ``g ((v + v_low) - (own + own_low))``, to a sum of currents into a row.

    `r, r_low`: upper and lower part of the sum; `g`: conductance; `v, v_low`: upper and lower part of the neighbour's
    voltage; `own, own_low`: upper and lower part of the row's voltage; `exact`: whether to compute in double-double.
    Returns upper and lower part of the new sum, and the added current.
    """
    if exact:
        d, d_low = _sum(v, v_low, -own, -own_low)
        inflow, inflow_low = _two_product(g, d)
        r, r_low = _sum(r, r_low, inflow, inflow_low + g * d_low)
        return r, r_low, inflow
    inflow = g * ((v - own) + (v_low - own_low))
    return r + inflow, r_low, inflow


@kernel
def residual(
    matrix: Graph, current: Numbers, x: Scaled, begin: int, end: int, plain: bool, exact: bool, floor: float,
    kept: float, out: Numbers,
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """Write the residual of KCL of the rows ``begin`` to ``end - 1`` to ``out``; return five measures of the violation.

    The residual of row ``i`` is ``b_i - g_i x_i + sum_j g_ij (x_j - x_i)``. Differences are formed first, so that
    off-diagonals and ground conductances never meet in a rounded diagonal. A difference of double-doubles is accurate
    to the last digits of a double (the upper parts of nearly equal values subtract without error: Sterbenz 1974). The
    residual is therefore accurate relative to the currents at the row. With ``exact``, sums and products are
    double-doubles too: if no current flows, differences of voltages then vanish to thirty digits.

    The exponent of a residual is the largest one of the row's current and of the voltages of the row and its
    neighbours. Converged rows, whose residual is a rounding error of these sums, get the residual 0, so that a
    correction can address rows that are smaller by many orders of magnitude. A row with the residual 0 on entry remains
    converged up to ``kept`` times that rounding error.

    `matrix`: conductances in siemens; `current`: right-hand side ``b`` in amperes, as mantissas and exponents; `x`
    (n,): voltages; `plain`: whether all exponents are 0; `exact`: whether to sum in double-double; `floor`: residual,
    relative to ``(b + |A| |x|)_i``, up to which a row's violation is added to the sum of the converged rows; `out`:
    mantissas and exponents, on entry those of the previous residual.

    The relative violation of a row is ``|r_i|`` divided by the sum of the magnitudes of its currents. Returned are, as
    in `resgrid.solvers.refinement.Imbalance`: the largest ``|r_i| / (b + |A| |x|)_i``; the sum of the relative
    violations of rows that are not converged; that sum for converged rows, plus the rounding errors possible in all
    rows; the smallest ratio of the summed current magnitudes of a row to ``(b + |A| |x|)_i``; and the natural logarithm
    of the largest residual in amperes, -inf for none. If a residual is not finite, the fourth is 0 and the others are
    infinite.
    """
    indptr, indices, conductance, ground = matrix
    injected, injected_e = current
    hi, lo, e = x.hi, x.lo, x.exponent
    r_out, r_e = out
    backward, unconverged, converged, fraction, largest, largest_e, top = 0.0, 0.0, 0.0, 1.0, 0.0, 0, 0
    for i in range(begin, end):
        own, own_low, r, r_low = hi[i], lo[i], injected[i], 0.0
        if not plain:
            top = max(injected_e[i] if r != 0.0 else NO_EXPONENT, e[i] if own != 0.0 else NO_EXPONENT)
            for k in range(indptr[i], indptr[i + 1]):
                top = max(top, e[indices[k]] if hi[indices[k]] != 0.0 else NO_EXPONENT)
            own, own_low = _shift(own, e[i] - top), _shift(own_low, e[i] - top)
            r = _shift(r, injected_e[i] - top)
        size = abs(r)
        if ground[i] > 0.0:
            tied, tied_low = _two_product(ground[i], own)
            r, r_low = _sum(r, 0.0, -tied, -(tied_low + ground[i] * own_low))
            size += abs(tied)
        flow = size
        for k in range(indptr[i], indptr[i + 1]):
            j, g = indices[k], conductance[k]
            v, v_low = hi[j], lo[j]
            if not plain:
                v, v_low = _shift(v, e[j] - top), _shift(v_low, e[j] - top)
            r, r_low, inflow = _add_inflow(r, r_low, g, v, v_low, own, own_low, exact)
            flow += abs(inflow)
            size += g * (abs(v) + abs(own))
        r += r_low
        wrong = 0.0 if abs(r) < _NOTHING else abs(r)
        if not math.isfinite(wrong):
            return np.inf, np.inf, np.inf, 0.0, np.inf
        if wrong > backward * size:
            backward = wrong / size
        if flow < fraction * size:
            fraction = flow / size
        rounding = _SETTLED * size / flow if flow > 0.0 else 0.0
        rounding = rounding if exact else _UNIT * (_ROW_ROUNDING + indptr[i + 1] - indptr[i])
        violation = wrong / flow if wrong > 0.0 else 0.0
        converged += rounding
        if wrong <= max(rounding * flow * (kept if r_out[i] == 0.0 else 1.0), _SETTLED * size):
            r, converged, r_e[i] = 0.0, converged + violation, 0
        else:
            counted = violation if wrong > floor * size else 0.0
            unconverged, converged, r_e[i] = unconverged + counted, converged + violation - counted, top
            if wrong > _shift(largest, largest_e - top):
                largest, largest_e = wrong, top
        r_out[i] = r
    log_size = math.log(largest) + largest_e * _LOG_BASE if largest > 0.0 else -np.inf
    return backward, unconverged, converged, fraction, log_size
