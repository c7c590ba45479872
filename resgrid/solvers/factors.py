"""What every method of solving makes of a nodal laplacian: something to solve with, many times.

The direct method: factors are made in positive numbers alone (`resgrid.solvers.supernodal`), and substitution keeps an
exponent beside every number, for a potential that falls below 1e-308.  The answer is refined with residuals in which
differences come first, until the violations of KCL, summed, prove every entry right, or in small circuits until KCL
holds to the rounding of the voltages (`resgrid.solvers.refinement`).

The multigrid method: normwise answers by iteration, entrywise ones by refinement; the algorithm is told on one page in
`resgrid.solvers.multigrid`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from resgrid._internal.validation import check_number, real_numbers
from resgrid.errors import AccuracyError, InputError
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.refinement import Refined, refine
from resgrid.solvers.scaled import Floats, Scaled
from resgrid.solvers.threads import ALONE, ThreadTeam

if TYPE_CHECKING:
    from resgrid.solvers.multigrid.hierarchy import Hierarchy
    from resgrid.solvers.supernodal import SupernodalFactors
    from resgrid.solvers.symbolic import Symbolic

EXACT_ROWS = 20_000
"""Rows up to which KCL holds to rounding: their answers are the nearest doubles, on every machine the same."""

_REFINED_DIRECTLY, _REFINED = 1e-28, 1e-26
"""Componentwise backward error that is enough where no current flows: the noise of double-double arithmetic, or more
where every digit takes steps."""

_ROUNDINGS = 16.0 * np.finfo(np.float64).eps
"""Share of itself by which factors and substitution in positive numbers put an entry off for every row, at most."""

_LEAST_SHARE = 1e-150
"""Entry of ``-L`` from which products of two are no subnormal numbers."""

_MOST_PASSES = 4
"""Solutions and corrections of a direct method: each gains most of the digits, or none."""


@dataclass(frozen=True, eq=False)
class Factor(ABC):
    """A matrix, `laplacian`, made ready for many right-hand sides."""

    laplacian: Laplacian

    name: ClassVar[str]
    """The method."""

    def solve(
        self,
        rhs: ArrayLike,
        *,
        rtol: float = 1e-10,
        guess: ArrayLike | None = None,
        watch: ProgressMonitor | None = None,
    ) -> Floats:
        """Solve to a normwise backward error.  Shapes: `rhs` (n,), `guess` (n,); returns (n,)."""
        check_rtol(rtol)
        begin = None if guess is None else self._one_per_row("guess", guess)
        return self._solve(self._one_per_row("rhs", rhs), rtol, begin, watch)

    def solve_nonnegative(
        self, rhs: ArrayLike | Scaled, *, watch: ProgressMonitor | None = None
    ) -> tuple[Scaled, float]:
        """Solve for a right-hand side (n,) without negative entries, entry by entry; returns the solution (n,)."""
        currents = self._one_per_row("rhs", rhs.hi if isinstance(rhs, Scaled) else rhs)
        if currents.min(initial=0.0) < 0.0:
            row = int(np.argmin(currents))
            raise InputError(
                f"rhs[{row}] is negative, and only currents of one sign are solved for entry by entry; solve for both "
                "signs apart, or use Factor.solve"
            )
        found = self._refined(rhs if isinstance(rhs, Scaled) else currents, watch)
        if watch is not None:
            watch.done(found.error, found.bound)
        return found.solution, found.error

    def _judged(self, x: Floats, error: float, rtol: float, watch: ProgressMonitor | None) -> Floats:
        """The solution, if its backward error is small enough."""
        if not error <= rtol:
            raise AccuracyError(
                f"method {self.name!r} stagnates at a backward error of {error:.1e}, above rtol = {rtol:.1e}; use "
                "another method, or a larger rtol",
                x,
            )
        if watch is not None:
            watch.done(error)
        return x

    @abstractmethod
    def _solve(self, rhs: Floats, rtol: float, guess: Floats | None, watch: ProgressMonitor | None) -> Floats:
        """As `solve`, for contiguous arrays of the right shape."""

    @abstractmethod
    def _refined(self, rhs: Floats | Scaled, watch: ProgressMonitor | None) -> Refined:
        """As `solve_nonnegative`, for contiguous arrays of the right shape."""

    def _one_per_row(self, name: str, values: ArrayLike) -> Floats:
        array = np.ascontiguousarray(real_numbers(name, values), dtype=np.float64)
        if array.shape != (self.laplacian.size,):
            raise InputError(
                f"{name} has shape {array.shape}, but there are {self.laplacian.size} rows; give one number per row"
            )
        if not np.isfinite(array).all():
            row = int(np.flatnonzero(~np.isfinite(array))[0])
            raise InputError(f"{name}[{row}] is {array[row]}; it must be finite")
        return array


def check_rtol(rtol: float) -> None:
    """Refuse a backward error that is none."""
    check_number("rtol", rtol, "a number between 0 and 1", above=0.0, below=1.0)


@dataclass(frozen=True, eq=False)
class DirectFactor(Factor):
    """A matrix and its factors ``L D L^T``."""

    factors: SupernodalFactors
    name: ClassVar[str] = "direct"

    def _solve(self, rhs: Floats, rtol: float, guess: Floats | None, watch: ProgressMonitor | None) -> Floats:
        """As every `Factor` does, corrected until it is right enough, or a few times (Higham 2002, section 12.1)."""
        del guess
        from resgrid.solvers.csr_kernels import row_residual

        matrix, drive = self.factors.matrix, float(np.abs(rhs).max(initial=0.0))
        norm, x, residual = 2.0 * self.factors.largest, np.zeros_like(rhs), rhs.copy()
        for _ in range(_MOST_PASSES):
            x += self.factors.solve(residual)
            row_residual(matrix, np.arange(len(x), dtype=np.int32), rhs, x, residual)
            scale = norm * float(np.abs(x).max(initial=0.0)) + drive
            error = float(np.abs(residual).max(initial=0.0)) / scale if scale else 0.0
            if error <= rtol or not np.isfinite(error):
                break
        return self._judged(x, error, rtol, watch)

    def _refined(self, rhs: Floats | Scaled, watch: ProgressMonitor | None) -> Refined:
        """As every `Factor` does."""
        del watch
        factors, exact = self.factors, self.laplacian.size <= EXACT_ROWS
        sure = self._certainty() if exact else np.inf
        return refine(
            self.laplacian,
            rhs,
            lambda m, e, _: factors.substitute(m, e),
            _REFINED_DIRECTLY,
            exact=exact,
            sure=sure,
        )

    def _certainty(self) -> float:
        """Share of itself by which substitution puts an entry off, at most; infinite where shares may underflow."""
        values = self.factors.values
        least = values.min(initial=1.0, where=values > 0.0)
        return _ROUNDINGS * self.laplacian.size if least > _LEAST_SHARE else np.inf


def factor_direct(laplacian: Laplacian, order: Symbolic | None = None) -> DirectFactor:
    """Factor a matrix, in an order that has been found or in the one that suits it."""
    from resgrid.solvers.supernodal import factor_supernodes

    laplacian = laplacian.with_rows()
    return DirectFactor(laplacian, factor_supernodes(laplacian, order))


@dataclass(frozen=True, eq=False)
class MultigridFactor(Factor):
    """A matrix and the hierarchy that preconditions it; `team`: whose threads take the steps."""

    hierarchy: Hierarchy
    team: ThreadTeam = ALONE
    name: ClassVar[str] = "multigrid"

    def _solve(self, rhs: Floats, rtol: float, guess: Floats | None, watch: ProgressMonitor | None) -> Floats:
        """As every `Factor` does; the residual norm is brought to ``rtol |b|`` where rounding allows.

        From a guess on, the iteration also ends where it estimates the error of every voltage to be at most ``rtol``
        of the largest one: where all currents meet in a few cells, as at the goal of open obstacles, the residual
        norm asks for much more than that.
        """
        from resgrid.solvers.multigrid.conjugate_gradients import iterate
        from resgrid.solvers.multigrid.krylov import norm

        x, residual = iterate(self.laplacian, self.hierarchy, rhs, rtol, guess, watch, self.team)
        scale = 2.0 * self.hierarchy.largest_degree * norm(x, self.team) + norm(rhs, self.team)
        error = residual / (scale or 1.0)
        return self._judged(x, error, rtol, watch)

    def _refined(self, rhs: Floats | Scaled, watch: ProgressMonitor | None) -> Refined:
        """As every `Factor` does."""
        from resgrid.solvers.multigrid.conjugate_gradients import approximate

        passes = partial(approximate, self.laplacian, self.hierarchy, watch, team=self.team)
        return refine(self.laplacian, rhs, passes, _REFINED, anew=True, team=self.team)


def factor_multigrid(laplacian: Laplacian, *, team: ThreadTeam = ALONE) -> MultigridFactor:
    """Coarsen a matrix; it keeps its rows if it is no grid of two colours."""
    from resgrid.solvers.multigrid.hierarchy import build_hierarchy

    hierarchy = build_hierarchy(laplacian, team)
    return MultigridFactor(laplacian if hierarchy.grid else laplacian.with_rows(), hierarchy, team)
