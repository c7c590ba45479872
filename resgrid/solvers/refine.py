"""Refinement of scaled double-doubles: from an approximate inverse to an answer that is right entry by entry.

The residual is computed with differences first, relative to the currents at each node, so that every pass gains the
digits of the approximate inverse wherever it is any good.  It ends where a bound on the error of every entry is proved,
or where nothing is left to gain.

The bound: a row that violates KCL by a share ``e_i`` of its currents is right for conductances that differ by no more
than that share.  By the matrix-tree theorem every entry of ``A^-1`` is a ratio of sums of products, positive all of
them, in which each row has one conductance above and one below at most.  So every entry of ``A^-1 b``, be it the
smallest, is off by a share of at most ``2 sum_i e_i`` (for shares that are all alike: O'Cinneide 1993).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.extended import BITS, NOISE, Scaled, canonical, power
from resgrid.solvers.laplacian import Conductances, Laplacian
from resgrid.solvers.team import ALONE, Team

if TYPE_CHECKING:
    from resgrid.solvers.refine_kernels import Imbalance

_CONVERGED = 1e-12
"""Componentwise backward error up to which an answer is one, whatever is proved of its entries."""

_NONE = np.zeros(0, dtype=np.int64)
_ALL = np.zeros(0, dtype=np.int32)
_MOST_STEPS = 60
_LEAST_GAIN = 0.5

_FEW = 8
"""One voltage in so many is few: then residuals are computed around those alone."""

_ALLOWED = 2e-9
"""Violations of KCL, summed over the rows that are not right, that refinement leaves: entries are right to 4e-9, and to
the rounding of the rows' sums, some 4e-9 for a million rows."""

_MARGIN = 0.1
"""Share of what is allowed that the last pass aims at."""

_HOPELESS = 1e-3
"""Componentwise backward error above which some voltages have no digit right."""

_PROVED = 1e-6
"""Bound on the errors of entries up to which an answer is one, whatever its backward error."""

_DIFFERENCE = 4.0
"""Errors that two values may be off by where hardly any current flows, in units of the floor: less is noise."""

_FLAT = 1e-14
"""Share of currents in ``(b + |A| |x|)_i`` below which they may be what rounding leaves of none."""

_LEAST_PLAIN = 1e-200
"""Smallest value that needs no exponent; residuals are up to a hundred decades smaller."""

Numbers = tuple[NDArray[np.float64], NDArray[np.int64]]
"""Scaled numbers in single doubles: mantissas and exponents; no exponents (an empty array) where all are 0."""

Approximation = Callable[[NDArray[np.float64], NDArray[np.int64], float], Numbers]
"""About ``A^-1`` times scaled numbers, right to a share (the third argument) of the largest; may be better."""

Resolution = Callable[[NDArray[np.float64], Numbers, Numbers], tuple[NDArray[np.int64], Numbers] | None]
"""From mantissas of the residual, all voltages and all currents: some rows and their voltages, found anew; or None."""


class Refined(NamedTuple):
    """An answer and what it is worth.

    `solution` (n,): voltages in volts; `error`: componentwise backward error; `bound`: no voltage is off by a larger
    share of itself.
    """

    solution: Scaled
    error: float
    bound: float

    @property
    def converged(self) -> bool:
        """Whether it is an answer at all."""
        return is_answer(self.error, self.bound)


def entry_bound(violation: float) -> float:
    """Share of itself by which an entry is off, at most, from the sum of all rows' violations of KCL."""
    return float(np.expm1(2.0 * violation / (1.0 - violation))) if violation < 0.1 else np.inf


def is_answer(error: float, bound: float) -> bool:
    """Whether a componentwise backward error, or a bound on the error of every entry, tells of an answer."""
    return error <= _CONVERGED or bound <= _PROVED


class _Worth(NamedTuple):
    """What a residual says of an answer.

    `error`: componentwise backward error; `left`: what is wrong, in units of what is allowed; `bound`: on the error of
    every entry; `log_size`: natural logarithm of the largest entry of the residual.
    """

    error: float = np.inf
    left: float = np.inf
    bound: float = np.inf
    log_size: float = np.inf

    def gains_on(self, other: _Worth) -> bool:
        return self.error < _LEAST_GAIN * other.error or self.log_size < other.log_size + np.log(_LEAST_GAIN)


def refine(
    laplacian: Laplacian,
    rhs: NDArray[np.float64] | Scaled,
    approximate: Approximation,
    floor: float,
    *,
    exact: bool = False,
    sure: float = np.inf,
    resolve: Resolution | None = None,
    team: Team = ALONE,
) -> Refined:
    """Solve for a right-hand side without negative entries.  Shapes: `rhs` (n,).

    Numbers have exponents only where their range asks for them.  With ``exact``, or where hardly any current flows, the
    residual is formed in double-double: answers are then the nearest doubles.  An entry of the first approximation is
    off by a share of at most ``sure``: a correction by more is what rounding leaves where conductances differ by more
    decades than double-doubles hold.
    """
    from resgrid.solvers.refine_kernels import exact_residual

    matrix, current = laplacian.conductances, scaled_currents(rhs)
    doubles = None if exact else _as_doubles(*current)
    if doubles is not None:
        current = doubles, _NONE
    residual = current[0].copy(), current[1].copy()
    x = Scaled(np.zeros(laplacian.size), np.zeros(laplacian.size), np.zeros_like(current[1]))
    best, found = _Worth(), None
    for step in range(1, _MOST_STEPS + 1):
        hopeless = found is not None and not exact and best.error > _HOPELESS
        anew = resolve(residual[0], (x.hi, x.exponent), current) if resolve is not None and hopeless else None
        if anew is None:
            new, changed = _corrected(x, *approximate(*residual, _MARGIN / best.left))
        else:
            new, changed = _replaced(x, *anew)
        if step > 1 and np.isfinite(sure) and _moves(x, new, sure):
            break
        current, residual = _alike(new, current), _alike(new, residual)
        if not exact:
            rows = _ALL if found is None else _rows_changed(laplacian, new, changed, residual[0])
            here = _imbalance(matrix, current, new, floor, step, rows, residual, team)
            if here.least < _LEAST_PLAIN and not new.exponent.size:
                new = _with_exponents(new)
                current, residual, rows = _alike(new, current), _alike(new, residual), _ALL
                here = _imbalance(matrix, current, new, floor, step, rows, residual, team)
            found = here if found is None or not len(rows) else here.beside(found)
            left, bound = found.left / _ALLOWED, entry_bound(found.left + found.right)
            worth = _Worth(found.backward, left, bound, _log_size(residual, found))
            if left <= 1.0 and found.share <= _FLAT:
                exact, best, new = True, _Worth(), _with_exponents(new)
                current, residual = _alike(new, current), _alike(new, residual)
        if exact:
            error, violation = exact_residual(matrix, current, new, residual)
            worth = _Worth(error, error / floor, entry_bound(violation), _log_size(residual))
        if not worth.gains_on(best):
            if anew is None:
                break
            resolve = None
        x, best = new, worth
        if best.left <= 1.0:
            break
    answer = _with_exponents(x)._replace(noise=max(NOISE, _DIFFERENCE * floor))
    return Refined(answer, float(best.error), best.bound)


def _imbalance(
    matrix: Conductances, current: Numbers, x: Scaled, floor: float, step: int, rows: NDArray[np.int32], out: Numbers,
    team: Team,
) -> Imbalance:  # fmt: skip
    """Residuals of some rows, or of all; piece by piece where they are plain."""
    from resgrid.solvers.refine_kernels import Imbalance, residual

    if x.exponent.size:
        return residual(matrix, current, x, floor, _kept(step), rows, out)
    if not len(rows):
        rows = np.arange(len(x.hi), dtype=np.int32)

    def some(piece: slice) -> Imbalance:
        return residual(matrix, current, x, floor, _kept(step), rows[piece], out)

    return reduce(Imbalance.plus, team.over(len(rows), some))


def _corrected(x: Scaled, m: NDArray[np.float64], e: NDArray[np.int64]) -> tuple[Scaled, NDArray[np.bool_]]:
    """Values with a correction, and which of them it changes.  Shapes: `m` (n,), `e` (n,) or (0,)."""
    from resgrid.solvers.refine_kernels import correct, corrected

    doubles = _as_doubles(m, e) if not x.exponent.size else None
    if doubles is not None:
        hi, lo = np.empty_like(x.hi), np.empty_like(x.lo)
        corrected(x.hi, x.lo, doubles, hi, lo)
        return Scaled(hi, lo, x.exponent), doubles != 0.0
    new = _with_exponents(x)
    correct(*new[:3], m, e if e.size else np.zeros(len(m), dtype=np.int64))
    return new, m != 0.0


def _moves(x: Scaled, new: Scaled, share: float) -> bool:
    """Whether a correction changes an entry by more than such a share."""
    steps = new.exponent - x.exponent if x.exponent.size else new.exponent
    moved = np.abs(new.hi * power(steps) if steps.size else new.hi) - np.abs(x.hi)
    return bool(np.any(np.abs(moved) > share * np.abs(x.hi)))


def _replaced(x: Scaled, rows: NDArray[np.int64], values: Numbers) -> tuple[Scaled, NDArray[np.bool_]]:
    """Values of which some have been found anew, and which."""
    m, e = values
    new = Scaled(x.hi.copy(), x.lo.copy(), x.exponent.copy())
    if new.exponent.size:
        canonical(m, e)
        new.exponent[rows] = e
    new.hi[rows], new.lo[rows] = m, 0.0
    changed = np.zeros(len(new.hi), dtype=np.bool_)
    changed[rows] = True
    return new, changed


def _rows_changed(
    laplacian: Laplacian, x: Scaled, changed: NDArray[np.bool_], residual: NDArray[np.float64]
) -> NDArray[np.int32]:
    """Rows whose residuals a change of few voltages changes; none where all are to be looked at."""
    if x.exponent.size or _FEW * np.count_nonzero(changed) > len(changed):
        return _ALL
    around = changed.copy()
    around[laplacian.edges[np.flatnonzero(changed)].indices] = True
    rows = np.flatnonzero(around).astype(np.int32)
    return rows if np.count_nonzero(residual[rows]) == np.count_nonzero(residual) else _ALL


def _log_size(residual: Numbers, found: Imbalance | None = None) -> float:
    """Natural logarithm of the largest entry of a residual, which is known of one without exponents."""
    with np.errstate(divide="ignore"):
        if found is not None and not residual[1].size:
            return float(np.log(found.largest))
        log = np.log(np.abs(residual[0])) + residual[1] * (BITS * np.log(2.0))
    return float(np.max(log, initial=-np.inf))


def _with_exponents(x: Scaled) -> Scaled:
    """A copy in canonical numbers."""
    e = x.exponent.copy() if x.exponent.size else np.zeros(len(x.hi), dtype=np.int64)
    new = Scaled(x.hi.copy(), x.lo.copy(), e)
    canonical(new.hi, new.exponent, new.lo)
    return new


def _alike(x: Scaled, numbers: Numbers) -> Numbers:
    """Numbers with exponents where ``x`` has some."""
    if not x.exponent.size or numbers[1].size:
        return numbers
    m, e = numbers[0].copy(), np.zeros(len(numbers[0]), dtype=np.int64)
    canonical(m, e)
    return m, e


def _kept(step: int) -> float:
    """Roundings by which a row may violate KCL that has been found right before.

    More at every step: on the verge of a bound that stands still, rows would come and go, and what they stir up
    would drown others that are smaller by many decades.
    """
    return 1.0 if step == 1 else 4.0 * step


def _as_doubles(m: NDArray[np.float64], e: NDArray[np.int64]) -> NDArray[np.float64] | None:
    """Scaled numbers as doubles; None where their range is too wide."""
    lowest, highest = e.min(initial=0), e.max(initial=0)
    if lowest < -2 or highest > 1:
        return None
    return m * power(e) if lowest < 0 or highest > 0 else m


def scaled_currents(rhs: NDArray[np.float64] | Scaled) -> Numbers:
    """Currents as canonical scaled numbers of their own; ``lo`` is left out."""
    if isinstance(rhs, Scaled):
        current, scale = rhs.hi.copy(), rhs.exponent.copy()
    else:
        current, scale = np.array(rhs, dtype=np.float64), np.zeros(len(rhs), dtype=np.int64)
    canonical(current, scale)
    return current, scale
