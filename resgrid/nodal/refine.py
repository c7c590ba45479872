"""Refinement of scaled double-doubles: from an approximate inverse to an answer that is right entry by entry.

The residual is computed with differences first, relative to the currents at each node, so that every pass gains the
digits of the approximate inverse wherever it is any good.  It ends where KCL holds to the rounding of currents at every
node, however small they are there, or where nothing is left to gain.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.scaled import BITS, Scaled, power
from resgrid.nodal.system import NodalSystem

if TYPE_CHECKING:
    from resgrid.nodal.refine_kernels import Imbalance

_NONE = np.zeros(0, dtype=np.int64)
_ALL = np.zeros(0, dtype=np.int32)
_MOST_STEPS = 60
_LEAST_GAIN = 0.5

_FEW = 8
"""One voltage in so many is few: then residuals are computed around those alone."""

_MARGIN = 0.01
"""Share of the violation allowed that the last pass aims at."""

_FLAT = 1e-14
"""Share of currents in ``(b + |A| |x|)_i`` below which they may be what rounding leaves of none."""

_LEAST_PLAIN = 1e-200
"""Smallest value that needs no exponent; residuals are up to a hundred decades smaller."""

Numbers = tuple[NDArray[np.float64], NDArray[np.int64]]
"""Scaled numbers in single doubles: mantissas and exponents; no exponents (an empty array) where all are 0."""

Approximation = Callable[[NDArray[np.float64], NDArray[np.int64], float], Numbers]
"""About ``A^-1`` times scaled numbers, right to a share (the third argument) of the largest; may be better."""


def refine(
    system: NodalSystem,
    rhs: NDArray[np.float64] | Scaled,
    approximate: Approximation,
    floor: float,
    *,
    exact: bool = False,
) -> tuple[Scaled, float]:
    """Solve for a right-hand side without negative entries.

    Parameters
    ----------
    system : NodalSystem
    rhs : ndarray of float64 or Scaled, shape (n,)
        Currents in amperes, none negative; of scaled ones ``lo`` is not used.
    approximate : callable
        Takes scaled numbers and the accuracy wanted, and returns scaled numbers.
    floor : float
        Componentwise backward error to reach where hardly any current flows; everywhere, if ``exact``.
    exact : bool
        Whether KCL is to hold relative to the voltages, not just to the currents at every node.

    Returns
    -------
    solution : Scaled, shape (n,)
        Voltages in volts.
    error : float
        Its componentwise backward error.
    """
    pair = _Answer(system, rhs, floor, exact)
    best, size, gain = np.inf, np.inf, 0.0
    while pair.steps < _MOST_STEPS:
        if pair.improve(*approximate(pair.residual, pair.exponent, gain)):
            best, size = np.inf, np.inf
        if not (pair.error < _LEAST_GAIN * best or pair.log_size < size + np.log(_LEAST_GAIN)):
            pair.take_back()
            break
        best, size = pair.error, pair.log_size
        if pair.left <= 1.0:
            break
        gain = _MARGIN / pair.left
    return pair.solution, float(best)


class _Answer:
    """Double-doubles that are corrected step by step, and their residual; with exponents only where needed."""

    def __init__(self, system: NodalSystem, rhs: NDArray[np.float64] | Scaled, floor: float, exact: bool) -> None:
        n = system.size
        self._system, self._floor, self._exact, self.steps = system, floor, exact, 0
        self._current, self._scale = scaled_currents(rhs)
        self._plain = not exact and _without_exponent(self._current, self._scale)
        if self._plain:
            self._scale = _NONE
        self._now, self._last = self._zeros(n), self._zeros(n)
        self.residual, self.exponent = self._current.copy(), self._scale.copy()
        self.error = self.left = np.inf
        self._found: Imbalance | None = None

    def _zeros(self, n: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        return np.zeros(n), np.zeros(n), _NONE if self._plain else np.zeros(n, dtype=np.int64)

    @property
    def solution(self) -> Scaled:
        """The answer, in canonical numbers."""
        from resgrid.nodal.refine_kernels import canonical_pairs

        hi, lo, e = self._now
        if self._plain:
            e = np.zeros(len(hi), dtype=np.int64)
        canonical_pairs(hi, lo, e)
        return Scaled(hi, lo, e)

    @property
    def log_size(self) -> float:
        """Natural logarithm of the largest entry of the residual."""
        with np.errstate(divide="ignore"):
            if self._plain and self._found is not None:
                return float(np.log(self._found.largest))
            log = np.log(np.abs(self.residual)) + self.exponent * (BITS * np.log(2.0))
        return float(np.max(log, initial=-np.inf))

    def improve(self, m: NDArray[np.float64], e: NDArray[np.int64]) -> bool:
        """Add a correction, and compute the residual; returns whether it is judged more strictly from now on."""
        from resgrid.nodal.refine_kernels import correct, corrected

        self.steps += 1
        if self._plain and not _without_exponent(m, e):
            self._leave_plain()
        self._now, self._last = self._last, self._now
        if self._plain:
            corrected(*self._last[:2], m, *self._now[:2])
        else:
            for new, old in zip(self._now, self._last, strict=True):
                new[:] = old
            correct(*self._now, m, e if e.size else np.zeros(len(m), dtype=np.int64))
        before = self._exact
        self._compute_residual(self._changed_by(m))
        return self._exact and not before

    def take_back(self) -> None:
        """Forget the last correction."""
        self._now, self._last = self._last, self._now

    def _changed_by(self, m: NDArray[np.float64]) -> NDArray[np.int32]:
        """Rows whose residuals a correction of few voltages changes; none where all are to be looked at."""
        if not self._plain or self._found is None or _FEW * np.count_nonzero(m) > len(m):
            return _ALL
        changed = m != 0.0
        changed[self._system.coupling[np.flatnonzero(changed)].indices] = True
        rows = np.flatnonzero(changed).astype(np.int32)
        return rows if np.count_nonzero(self.residual[rows]) == np.count_nonzero(self.residual) else _ALL

    def _compute_residual(self, rows: NDArray[np.int32]) -> None:
        """Judge relative to the currents, and where they are too small for that, relative to the voltages."""
        if not self._exact:
            found = self._residual_of_currents(rows)
            if self._plain and found.least < _LEAST_PLAIN:
                self._leave_plain()
                found = self._residual_of_currents(_ALL)
            self.error, self.left, self._found = found.backward, found.left, found
            if self.left > 1.0 or found.share > _FLAT:
                return
            self._leave_plain()
            self._exact = True
        self._exact_residual()

    def _residual_of_currents(self, rows: NDArray[np.int32]) -> Imbalance:
        from resgrid.nodal.refine_kernels import residual

        found = residual(
            *self._rows, self._current, self._scale, *self._now,
            self._plain, self._floor, _kept(self.steps), rows, self.residual, self.exponent,
        )  # fmt: skip
        return found if not len(rows) or self._found is None else found.beside(self._found)

    def _exact_residual(self) -> None:
        from resgrid.nodal.refine_kernels import exact_residual

        self.error = exact_residual(
            *self._rows, self._current, self._scale, *self._now, self.residual, self.exponent
        )  # fmt: skip
        self.left = self.error / self._floor

    @property
    def _rows(self) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
        coupling = self._system.coupling
        return coupling.indptr, coupling.indices, coupling.data, self._system.excess

    def _leave_plain(self) -> None:
        from resgrid.nodal.kernels import canonical
        from resgrid.nodal.refine_kernels import canonical_pairs

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
    from resgrid.nodal.kernels import canonical

    if isinstance(rhs, Scaled):
        current, scale = rhs.hi.copy(), rhs.exponent.copy()
    else:
        current, scale = np.array(rhs, dtype=np.float64), np.zeros(len(rhs), dtype=np.int64)
    canonical(current, scale)
    return current, scale
