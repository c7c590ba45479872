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
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.extended import BITS, NOISE, Scaled, power
from resgrid.solvers.laplacian import Laplacian

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


def refine(
    laplacian: Laplacian,
    rhs: NDArray[np.float64] | Scaled,
    approximate: Approximation,
    floor: float,
    *,
    exact: bool = False,
    resolve: Resolution | None = None,
) -> Refined:
    """Solve for a right-hand side without negative entries.  Shapes: `rhs` (n,)."""
    pair = _Answer(laplacian, rhs, floor, exact)
    best, size, bound, gain = np.inf, np.inf, np.inf, 0.0
    while pair.steps < _MOST_STEPS:
        anew = resolve is not None and pair.hopeless and pair.replace(resolve)
        if not anew:
            pair.improve(*approximate(pair.residual, pair.exponent, gain))
        if pair.compute_residual():
            best, size = np.inf, np.inf
        if not (pair.error < _LEAST_GAIN * best or pair.log_size < size + np.log(_LEAST_GAIN)):
            if not anew:
                pair.take_back()
                break
            resolve = None
        best, size, bound = pair.error, pair.log_size, pair.bound
        if pair.left <= 1.0:
            break
        gain = _MARGIN / pair.left
    return Refined(pair.solution, float(best), bound)


class _Answer:
    """Double-doubles that are corrected step by step, and their residual; with exponents only where needed."""

    def __init__(self, laplacian: Laplacian, rhs: NDArray[np.float64] | Scaled, floor: float, exact: bool) -> None:
        n = laplacian.size
        self._laplacian, self._floor, self._exact, self.steps = laplacian, floor, exact, 0
        self._current, self._scale = scaled_currents(rhs)
        self._plain = not exact and _without_exponent(self._current, self._scale)
        if self._plain:
            self._scale = _NONE
        self._now, self._last = self._zeros(n), self._zeros(n)
        self.residual, self.exponent = self._current.copy(), self._scale.copy()
        self.error = self.left = self.bound = np.inf
        self._found: Imbalance | None = None
        self._changed = np.ones(n, dtype=np.bool_)

    def _zeros(self, n: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        return np.zeros(n), np.zeros(n), _NONE if self._plain else np.zeros(n, dtype=np.int64)

    @property
    def solution(self) -> Scaled:
        """The answer, in canonical numbers."""
        from resgrid.solvers.refine_kernels import canonical_pairs

        hi, lo, e = self._now
        if self._plain:
            e = np.zeros(len(hi), dtype=np.int64)
        canonical_pairs(hi, lo, e)
        return Scaled(hi, lo, e, max(NOISE, _DIFFERENCE * self._floor))

    @property
    def log_size(self) -> float:
        """Natural logarithm of the largest entry of the residual."""
        with np.errstate(divide="ignore"):
            if self._plain and self._found is not None:
                return float(np.log(self._found.largest))
            log = np.log(np.abs(self.residual)) + self.exponent * (BITS * np.log(2.0))
        return float(np.max(log, initial=-np.inf))

    @property
    def hopeless(self) -> bool:
        """Whether some voltages have no digit right."""
        return self.steps > 0 and not self._exact and self.error > _HOPELESS

    def improve(self, m: NDArray[np.float64], e: NDArray[np.int64]) -> None:
        """Add a correction."""
        from resgrid.solvers.refine_kernels import correct, corrected

        if self._plain and not _without_exponent(m, e):
            self._leave_plain()
        self._now, self._last = self._last, self._now
        if self._plain:
            corrected(*self._last[:2], m, *self._now[:2])
        else:
            self._copy_last()
            correct(*self._now, m, e if e.size else np.zeros(len(m), dtype=np.int64))
        self._changed = m != 0.0

    def replace(self, resolve: Resolution) -> bool:
        """Take some voltages from elsewhere; returns whether there were any."""
        from resgrid.solvers.extended_kernels import canonical

        hi, _, exponent = self._now
        found = resolve(self.residual, (hi, exponent), (self._current, self._scale))
        if found is None:
            return False
        rows, (m, e) = found
        self._now, self._last = self._last, self._now
        self._copy_last()
        self._now[0][rows], self._now[1][rows] = m, 0.0
        if not self._plain:
            canonical(m, e)
            self._now[0][rows], self._now[2][rows] = m, e
        self._changed = np.zeros(len(hi), dtype=np.bool_)
        self._changed[rows] = True
        return True

    def _copy_last(self) -> None:
        for new, old in zip(self._now, self._last, strict=True):
            new[:] = old

    def take_back(self) -> None:
        """Forget the last correction."""
        self._now, self._last = self._last, self._now

    def _rows_changed(self) -> NDArray[np.int32]:
        """Rows whose residuals a change of few voltages changes; none where all are to be looked at."""
        changed = self._changed
        if not self._plain or self._found is None or _FEW * np.count_nonzero(changed) > len(changed):
            return _ALL
        changed[self._laplacian.edges[np.flatnonzero(changed)].indices] = True
        rows = np.flatnonzero(changed).astype(np.int32)
        return rows if np.count_nonzero(self.residual[rows]) == np.count_nonzero(self.residual) else _ALL

    def compute_residual(self) -> bool:
        """Judge relative to the currents, and where they are too small for that, relative to the voltages.

        Returns whether it is judged more strictly from now on.
        """
        self.steps += 1
        rows, before = self._rows_changed(), self._exact
        self._judge(rows)
        return self._exact and not before

    def _judge(self, rows: NDArray[np.int32]) -> None:
        if not self._exact:
            found = self._residual_of_currents(rows)
            if self._plain and found.least < _LEAST_PLAIN:
                self._leave_plain()
                found = self._residual_of_currents(_ALL)
            self.error, self.left, self._found = found.backward, found.left / _ALLOWED, found
            self.bound = entry_bound(found.left + found.right)
            if self.left > 1.0 or found.share > _FLAT:
                return
            self._leave_plain()
            self._exact = True
        self._exact_residual()

    def _residual_of_currents(self, rows: NDArray[np.int32]) -> Imbalance:
        from resgrid.solvers.refine_kernels import residual

        found = residual(
            *self._rows, self._current, self._scale, *self._now,
            self._plain, self._floor, _kept(self.steps), rows, self.residual, self.exponent,
        )  # fmt: skip
        return found if not len(rows) or self._found is None else found.beside(self._found)

    def _exact_residual(self) -> None:
        from resgrid.solvers.refine_kernels import exact_residual

        self.error, violation = exact_residual(
            *self._rows, self._current, self._scale, *self._now, self.residual, self.exponent
        )  # fmt: skip
        self.left, self.bound = self.error / self._floor, entry_bound(violation)

    @property
    def _rows(self) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
        coupling = self._laplacian.sorted_rows
        return coupling.indptr, coupling.indices, coupling.data, self._laplacian.ground

    def _leave_plain(self) -> None:
        from resgrid.solvers.extended_kernels import canonical
        from resgrid.solvers.refine_kernels import canonical_pairs

        if not self._plain:
            return
        n = len(self._current)
        self._plain = False
        self._scale, self.exponent = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
        canonical(self._current, self._scale)
        self._now = (*self._now[:2], np.zeros(n, dtype=np.int64))
        self._last = (*self._last[:2], np.zeros(n, dtype=np.int64))
        canonical_pairs(*self._now)
        canonical_pairs(*self._last)


def _kept(step: int) -> float:
    """Roundings by which a row may violate KCL that has been found right before.

    More at every step: on the verge of a bound that stands still, rows would come and go, and what they stir up
    would drown others that are smaller by many decades.
    """
    return 1.0 if step == 1 else 4.0 * step


def _without_exponent(m: NDArray[np.float64], e: NDArray[np.int64]) -> bool:
    """Write scaled numbers as doubles, in place, if their range allows."""
    lowest, highest = e.min(initial=0), e.max(initial=0)
    if lowest < -2 or highest > 1:
        return False
    if lowest < 0 or highest > 0:
        m *= power(e)
    return True


def scaled_currents(rhs: NDArray[np.float64] | Scaled) -> Numbers:
    """Currents as canonical scaled numbers of their own; ``lo`` is left out."""
    from resgrid.solvers.extended_kernels import canonical

    if isinstance(rhs, Scaled):
        current, scale = rhs.hi.copy(), rhs.exponent.copy()
    else:
        current, scale = np.array(rhs, dtype=np.float64), np.zeros(len(rhs), dtype=np.int64)
    canonical(current, scale)
    return current, scale
