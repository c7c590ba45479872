"""Iterative refinement with one exponent per entry, until even the smallest entry of a solution is accurate.

The residual is computed from differences of values, accurate relative to the currents at each node, so that every step
gains the digits of the approximate inverse. Refinement ends when the error of every entry is bounded, or when a step
gains no more.

The bound: a row whose currents violate KCL by a fraction ``e_i`` is exact for conductances that differ by at most that
fraction. By the matrix-tree theorem every entry of ``A^-1`` is a ratio of sums of positive products, in which each row
contributes at most one conductance to the numerator and one to the denominator. Every entry of ``A^-1 b``, even the
smallest, therefore has a relative error of at most ``2 sum_i e_i`` (for equal fractions: O'Cinneide 1993).

Coarse levels do not resolve slits, along which the potential falls by orders of magnitude within a few cells, and every
step gains about fifteen orders. If the remaining error exceeds the potential itself in a few rows, these rows are
solved directly from the currents into them. The direct method resolves all orders of magnitude at once, since it is
subtraction-free.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.laplacian import Graph, Laplacian
from resgrid.solvers.scaled import NOISE, Floats, Integers, Numbers, Scaled, canonical, logarithm, power
from resgrid.solvers.threads import SINGLE_THREAD, ThreadTeam

_CONVERGED = 1e-12
"""Largest componentwise backward error of an accepted solution, if the relative error of its entries has no bound."""

CERTAIN = 1e-9
"""Error of an entry up to which a solution needs no further check or correction.

The error is relative to the largest magnitude of an entry of the solution.
"""

_MOST_STEPS = 60
"""Maximum number of refinement steps of one solution."""

_LEAST_GAIN = 0.5
"""Fraction of its previous value below which a step must bring the backward error, or the largest residual in amperes.

A step that does neither is rejected, and refinement ends.
"""

_ALLOWED = 2e-9
"""Largest sum of relative violations of KCL at which refinement ends.

The sum is over the rows whose residual is more than rounding error. Entries then have a relative error of 4e-9, plus
the rounding of the rows' sums, about 4e-9 for a million rows.
"""

_MARGIN = 0.03
"""Relative accuracy requested of a correction, multiplied by the ratio of the present error to the limit of the error.

With this margin, below 1, the last correction rarely misses the limit.
"""

_HOPELESS = 1e-4
"""Componentwise backward error above which the rows that are not converged are solved directly.

These rows then have few correct digits or none.
"""

_PROVED = 1e-6
"""Bound on the relative error of entries up to which a solution is accepted, whatever its backward error."""

_DIFFERENCE = 4.0
"""Relative difference up to which two refined values are equal except for rounding, divided by a limit on residuals.

The limit on residuals is the parameter ``floor`` of `refine`, the residual of a row relative to ``(b + |A| |x|)_i``.
"""

_FLAT = 1e-14
"""Ratio below which the currents at a row may be pure rounding error.

It is the ratio of the sum of the magnitudes of the currents at row ``i`` to ``(b + |A| |x|)_i``.
"""

_STEPS, _FEWEST_STEPS, _LEAST = 8, 2, 128
"""Size of the neighbourhood that is solved directly with inaccurate rows: maximum and minimum number of steps, and N.

A step leads along one resistor. The neighbourhood grows to the maximum number of steps from the inaccurate rows, but
only to the minimum once it has half of the rows that may be solved directly: 20,000 (100,000 on a two-dimensional
grid), and at most a tenth of all rows. It grows on beyond either number of steps until it has 1/N of all rows of the
matrix: along a slit, all voltages beyond depend on the ones before.
"""

_MOST, _MOST_OF_PLANE, _ONE_IN = 20_000, 100_000, 10
"""Largest number of rows that are solved directly: without a two-dimensional grid, on a two-dimensional grid, and N.

At most 1/N of all rows are solved directly; the smaller limit applies.
"""

Approximation = Callable[[Floats, Integers, float], Numbers]
"""Function that returns an approximation of ``A^-1 b``, as mantissas (n,) and exponents (n,).

Its arguments are the mantissas (n,) and exponents (n,) of ``b``, and the relative error that the result should have.
Numbers are ``mantissa * 2**(256 * exponent)``. The error is relative to the largest magnitude of the result.
"""


class Refined(NamedTuple):
    """A solution and its accuracy.

    `solution` (n,): voltages in volts; `error`: componentwise backward error; `bound`: bound on the relative error of
    every voltage, infinite if there is none.
    """

    solution: Scaled
    error: float
    bound: float


class Imbalance(NamedTuple):
    """Violation of KCL by a solution, over some rows.

    The relative violation of a row is the residual ``|r_i|`` divided by the sum of the magnitudes of the currents at
    the row. A row is converged if this is only rounding error.

    `backward`: componentwise backward error ``max |r_i| / (b + |A| |x|)_i`` (Oettli & Prager 1964); `unconverged`: sum
    of the relative violations of the rows that are not converged; `converged`: sum of the relative violations of the
    other rows, and of the rounding errors that are possible in all rows; `fraction`: smallest ratio of the sum of the
    magnitudes of the currents at a row to ``(b + |A| |x|)_i``; `log_size`: natural logarithm of the largest ``|r_i|``
    in amperes, -inf if all are converged.
    """

    backward: float = np.inf
    unconverged: float = np.inf
    converged: float = np.inf
    fraction: float = 0.0
    log_size: float = np.inf

    def plus(self, rest: Imbalance) -> Imbalance:
        """Return the violation of KCL over the rows of this value and those of ``rest`` together."""
        return Imbalance(
            max(self.backward, rest.backward), self.unconverged + rest.unconverged, self.converged + rest.converged,
            min(self.fraction, rest.fraction), max(self.log_size, rest.log_size),
        )  # fmt: skip


def entry_bound(violation: float) -> float:
    """Return the bound on the relative error of every entry of a solution; infinite from a violation of 0.1 on.

    `violation`: sum over all rows of the violation of KCL relative to the currents at the row.
    """
    return float(np.expm1(2.0 * violation / (1.0 - violation))) if violation < 0.1 else np.inf


def is_answer(error: float, bound: float) -> bool:
    """Return whether a solution is accurate enough: ``error`` is at most 1e-12, or ``bound`` at most 1e-6.

    `error`: componentwise backward error; `bound`: bound on the relative error of every entry.
    """
    return error <= _CONVERGED or bound <= _PROVED


def refine(
    laplacian: Laplacian,
    rhs: Floats | Scaled,
    approximate: Approximation,
    floor: float,
    *,
    exact: bool = False,
    first_bound: float = np.inf,
    resolve: bool = False,
    threads: ThreadTeam = SINGLE_THREAD,
) -> Refined:
    """Return the solution for a nonnegative right-hand side `rhs` (n,), with a small relative error of every entry.

    The most accurate solution is returned even if it misses the goal; the caller checks its componentwise backward
    error and the bound on the relative error of its entries (`is_answer`).

    `laplacian`: the matrix ``A`` in siemens; `rhs` (n,): right-hand side ``b`` in amperes; `approximate`: function from
    the mantissas (n,) and exponents (n,) of a right-hand side, and a relative accuracy, to mantissas and exponents of
    an approximate solution; `floor`: residual of a row, relative to ``(b + |A| |x|)_i``, that counts as rounding error
    of the row's sum of currents; `exact`: whether to compute residuals in double-double, so that the solution is the
    nearest double. If False, the refinement changes to double-double once the currents at a row are at most 1e-14 of
    ``(b + |A| |x|)_i``. `first_bound`: bound on the relative error of entries of the first approximation, infinite if
    unknown. A later correction of an entry by more than this fraction is rounding error, since the conductances span
    more orders of magnitude than double-doubles; it is discarded, and the refinement ends. `resolve`: whether to solve
    a few rows without correct digits directly; `threads`: share the computation of residuals.
    """
    matrix, current = laplacian.graph, scaled_currents(rhs)
    residual = current[0].copy(), current[1].copy()
    x, best, excess = Scaled.of(np.zeros(laplacian.size)), Imbalance(), np.inf
    for step in range(1, _MOST_STEPS + 1):
        hopeless = not exact and _HOPELESS < best.backward < np.inf
        some = resolve_rows(laplacian, residual[0], x, current) if resolve and hopeless else None
        new = some or corrected(x, *approximate(*residual, _MARGIN / excess))
        if step > 1 and np.isfinite(first_bound) and _moves(x, new, first_bound):
            break
        if not exact:
            # The tolerance grows with every step.  With a constant one, rows could alternate between converged and
            # unconverged, and their corrections would hide rows that are smaller by many orders of magnitude.
            kept = 1.0 if step == 1 else 4.0 * step
            found = imbalance(matrix, current, new, residual, floor=floor, kept=kept, threads=threads)
            now = found.unconverged / _ALLOWED
            if now <= 1.0 and found.fraction <= _FLAT:
                exact, best = True, Imbalance()
        if exact:
            found = imbalance(matrix, current, new, residual, exact=True, threads=threads)
            now = found.backward / floor
        gains = found.backward < _LEAST_GAIN * best.backward or found.log_size < best.log_size + np.log(_LEAST_GAIN)
        if not gains:  # also for NaN
            if some is None:
                x = new if step == 1 else x  # overflow is reported by `read_entrywise`
                break
            resolve = False
        x, best, excess = new, found, now
        if excess <= 1.0:
            break
    rounding = max(NOISE, _DIFFERENCE * floor)
    return Refined(x._replace(noise=rounding), float(best.backward), entry_bound(best.unconverged + best.converged))


def imbalance(
    matrix: Graph,
    current: Numbers,
    x: Scaled,
    out: Numbers,
    *,
    exact: bool = False,
    floor: float = 0.0,
    kept: float = 1.0,
    threads: ThreadTeam = SINGLE_THREAD,
) -> Imbalance:
    """Write the residual of KCL to ``out``, and return the violation of KCL over all rows.

    `matrix, current, x`: conductances, right-hand side and voltages; `out`: mantissas and exponents of the residual,
    (n,) each, on entry those of the previous residual; `exact`: whether to sum currents in double-double; `floor`:
    residual of a row, relative to ``(b + |A| |x|)_i``, up to which the row's violation is added to the sum `converged`
    of the result; `kept`: multiple of the rounding error up to which a row counts as converged if its residual on entry
    is 0; `threads`: process slices of rows.
    """
    from resgrid.solvers.scaled_kernels import residual

    plain = not (x.exponent.any() or current[1].any())

    def some(rows: slice) -> Imbalance:
        return Imbalance(*residual(matrix, current, x, rows.start, rows.stop, plain, exact, floor, kept, out))

    return reduce(Imbalance.plus, threads.over(len(x.hi), some))


def _moves(x: Scaled, new: Scaled, fraction: float) -> bool:
    """Return whether a correction changes the magnitude of an entry by more than a fraction of that magnitude.

    `x, new` (n,): values before and after the correction; `fraction`: limit.
    """
    with np.errstate(invalid="ignore"):
        moved = np.abs(new.hi * power(new.exponent - x.exponent)) - np.abs(x.hi)
    return not np.all(np.abs(moved) <= fraction * np.abs(x.hi))


def corrected(x: Scaled, m: Floats, e: Integers) -> Scaled:
    """Return the sum of ``x`` and a correction, shape (n,), in double-double with separate exponents.

    `m, e` (n,): mantissas and exponents of the correction, ``m * 2**(256 e)``.
    """
    from resgrid.solvers.scaled_kernels import correct

    new = Scaled(np.empty_like(x.hi), np.empty_like(x.lo), np.empty_like(x.exponent))
    correct(x, m, e, new)
    return new


def scaled_currents(rhs: Floats | Scaled) -> Numbers:
    """Return the currents ``rhs`` (n,) as new mantissas and exponents, (n,) each: ``m * 2**(256 e)``.

    Mantissas are 0 or between ``2**-128`` and ``2**128`` in magnitude. The lower parts ``rhs.lo`` of double-doubles are
    neglected.
    """
    given = rhs if isinstance(rhs, Scaled) else Scaled.of(np.asarray(rhs, dtype=np.float64))
    current, scale = given.hi.copy(), given.exponent.copy()
    canonical(current, scale)
    return current, scale


def minus(a: Scaled, b: Scaled) -> Scaled:
    """Return the difference ``a - b``, shape (n,), in double-double with separate exponents."""
    return corrected(corrected(a, -b.hi, b.exponent), -b.lo, b.exponent)


def quotient(parts: list[Scaled], x: Scaled) -> float:
    """Return the largest magnitude in any of the vectors `parts`, divided by the largest magnitude in `x`.

    The result is 0 if all entries of `parts` are 0.
    """
    largest, *logs = (logarithm(np.abs(each.hi), each.exponent).max(initial=-np.inf) for each in (x, *parts))
    with np.errstate(over="ignore"):
        return 0.0 if max(logs) == -np.inf else float(np.exp(max(logs) - largest))


def resolve_rows(laplacian: Laplacian, residual: Floats, x: Scaled, current: Numbers) -> Scaled | None:
    """Return the voltages (n,) after a direct solution of the unconverged rows; None for no or too many of these rows.

    The neighbourhood of these rows is solved too; all other voltages are held fixed. The right-hand side of the solved
    rows is their residual of KCL when their own voltages are set to 0.

    `residual` (n,): 0 in rows that are converged; `x` (n,): voltages; `current`: mantissas and exponents of the
    right-hand side, (n,) each.
    """
    from resgrid.solvers.supernodal import factor_supernodes

    around = _around(laplacian, residual != 0.0)
    if around is None:
        return None
    inflow = np.zeros_like(x.hi), np.zeros_like(x.exponent)
    imbalance(laplacian.graph, current, Scaled(np.where(around, 0.0, x.hi), inflow[0].copy(), x.exponent), inflow)
    new, within = Scaled(x.hi.copy(), np.where(around, 0.0, x.lo), x.exponent.copy()), laplacian.within(around)
    new.hi[around], new.exponent[around] = factor_supernodes(within).substitute(inflow[0][around], inflow[1][around])
    return new


def _around(laplacian: Laplacian, rows: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """Return a mask (n,) of given rows and their neighbourhood; None if no row is given, or the mask has too many rows.

    `laplacian`: the matrix; `rows` (n,): mask of the given rows. The neighbourhood consists of the rows within 8 steps
    along resistors; after 2 steps or more it ends early once the mask has half of the allowed rows. Beyond, it grows on
    until the mask has 1/128 of all rows of the matrix. Allowed are at most 20,000 rows (100,000 on a two-dimensional
    grid), and at most a tenth of all rows.
    """
    plane = laplacian.grid is not None and laplacian.dimensions == 2
    most, edge = min(_MOST_OF_PLANE if plane else _MOST, laplacian.size // _ONE_IN), np.flatnonzero(rows)
    seen, count, steps = rows.copy(), len(edge), 0
    while len(edge) and count <= most:
        if steps >= (_STEPS if 2 * count < most else _FEWEST_STEPS) and count >= laplacian.size // _LEAST:
            break
        around = laplacian.edges[edge].indices
        edge = np.unique(around[~seen[around]])
        seen[edge] = True
        count, steps = count + len(edge), steps + 1
    return seen if 0 < count <= most else None
