"""Factors of a Laplacian by the direct or the multigrid method, to solve for many right-hand sides.

The direct method: subtraction-free (GTH) factors (`resgrid.solvers.supernodal`), and substitution with an exponent for
every number, for potentials below 1e-308. The answer is refined with residuals that are computed from differences.
Refinement ends when the sum of the violations of KCL bounds the error of every entry. In circuits of at most
`EXACT_ROWS` rows it ends when KCL holds to the rounding of the voltages (`resgrid.solvers.refinement`).

The multigrid method: normwise answers by iteration, entrywise answers by refinement; `resgrid.solvers.multigrid`
describes the algorithm.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from resgrid._internal.numbers import check_number, real_numbers
from resgrid.errors import AccuracyError, InputError
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.refinement import Refined, refine
from resgrid.solvers.scaled import Floats, Scaled
from resgrid.solvers.threads import SINGLE_THREAD, ThreadTeam

if TYPE_CHECKING:
    from resgrid.solvers.multigrid.hierarchy import Hierarchy
    from resgrid.solvers.supernodal_factors import SupernodalFactors
    from resgrid.solvers.symbolic import Symbolic

EXACT_ROWS = 20_000
"""Largest number of rows for which the direct method refines voltages to the nearest doubles.

The voltages are then equal on every machine.
"""

_REFINED_DIRECTLY, _REFINED = 1e-28, 1e-26
"""Residual of KCL at a row, relative to ``(b + |A| |x|)_i``, that counts as rounding error: direct method, multigrid.

Refinement usually ends earlier, when the violations of KCL relative to the currents are small. This limit decides at
rows whose resistors carry hardly any current, since all neighbours have nearly equal voltages. It also ends every
refinement of small circuits (`EXACT_ROWS`) by the direct method. The first value is the rounding error of double-double
arithmetic. The second is larger, since multigrid iterates for every digit.
"""

_ROUNDINGS = 16.0 * np.finfo(np.float64).eps
"""Bound on the relative error of an entry of a direct solution, divided by the number of rows of the matrix.

The error is due to rounding in subtraction-free factors and substitution.
"""

_LEAST_ENTRY = 1e-150
"""Smallest positive entry of ``-L`` (a dimensionless fraction) for which products of two entries do not underflow.

``L`` is the factor of ``L D L^T``. With a smaller entry the bound on the relative error of a solution is infinite.
"""

_MOST_PASSES = 4
"""Maximum number of substitutions in a normwise direct solution, the first solution and its refinements."""


@dataclass(frozen=True, eq=False)
class Factor(ABC):
    """A factorization or preconditioner of a Laplacian, to solve for many right-hand sides.

    Parameters
    ----------
    laplacian : Laplacian
        The matrix, with ``n`` rows.
    threads : ThreadTeam, optional
        Threads that share the work of a solve; the calling thread by default.
    """

    laplacian: Laplacian
    threads: ThreadTeam = field(default=SINGLE_THREAD, kw_only=True)

    name: ClassVar[str]
    """Name of the method: "direct" or "multigrid"."""

    def solve(
        self,
        rhs: ArrayLike,
        *,
        rtol: float = 1e-10,
        guess: ArrayLike | None = None,
        watch: ProgressMonitor | None = None,
    ) -> Floats:
        """Solve ``A x = rhs`` to a normwise backward error.

        Parameters
        ----------
        rhs : array_like, shape (n,)
            Right-hand side, in amperes.
        rtol : float, optional
            Largest normwise backward error ``|rhs - A x| / (2 d |x| + |rhs|)``, between 0 and 1, with the largest
            diagonal entry ``d``. Norms are maximum norms for the direct method, Euclidean norms for multigrid.
        guess : array_like, shape (n,), optional
            Initial solution in volts, for multigrid; 0 by default. The direct method ignores the guess.
        watch : ProgressMonitor, optional
            Records iterations and the accuracy, and can cancel the solve.

        Returns
        -------
        ndarray, shape (n,)
            Solution, in volts.

        Raises
        ------
        AccuracyError
            If the backward error exceeds `rtol`.
        InputError
            For a wrong `rtol` or shape, or an entry that is not finite.
        """
        check_rtol(rtol)
        begin = None if guess is None else self._one_per_row("guess", guess)
        return self._solve(self._one_per_row("rhs", rhs), rtol, begin, watch)

    def solve_nonnegative(
        self, rhs: ArrayLike | Scaled, *, watch: ProgressMonitor | None = None
    ) -> tuple[Scaled, float]:
        """Solve ``A x = rhs`` for nonnegative right-hand sides, with a small relative error of every entry.

        Parameters
        ----------
        rhs : array_like or Scaled, shape (n,)
            Right-hand side, in amperes; no entry is negative. `Scaled` numbers have a separate exponent, for
            currents below 1e-308 A.
        watch : ProgressMonitor, optional
            Records iterations and the accuracy, and can cancel the solve.

        Returns
        -------
        solution : Scaled, shape (n,)
            Solution, in volts.
        error : float
            Componentwise backward error of the solution; no exception is raised for a large one.

        Raises
        ------
        InputError
            For a negative entry, or for a wrong shape.
        """
        currents = self._one_per_row("rhs", rhs.hi if isinstance(rhs, Scaled) else rhs)
        if currents.min(initial=0.0) < 0.0:
            row = int(np.argmin(currents))
            raise InputError(
                f"rhs[{row}] = {currents[row]:g} is negative, and entrywise accuracy needs currents of one sign; solve "
                "for positive and negative currents separately, or use Factor.solve"
            )
        found = self._refined(rhs if isinstance(rhs, Scaled) else currents, watch)
        if watch is not None:
            watch.done(found.error, found.bound)
        return found.solution, found.error

    def _judged(self, x: Floats, error: float, rtol: float, watch: ProgressMonitor | None) -> Floats:
        """Return the solution `x` (n,) and record its error; raise AccuracyError if `error` exceeds `rtol`.

        `error`: normwise backward error of the solution; `rtol`: largest error allowed; `watch`: records the error, or
        None.
        """
        if not error <= rtol:
            raise AccuracyError(
                f"method {self.name!r} stagnates at a backward error of {error:.1e}, above rtol = {rtol:.1e}; use "
                "another method, or a larger rtol",
                x,
            )
        if watch is not None:
            watch.done(error)
        return x

    def substitution_bound(self) -> float:
        """Return a bound, known before the solve, on the relative error of every entry of an unrefined solution.

        The bound holds for nonnegative right-hand sides; it is infinite for methods without such a bound, the default.
        """
        return np.inf

    @abstractmethod
    def _solve(self, rhs: Floats, rtol: float, guess: Floats | None, watch: ProgressMonitor | None) -> Floats:
        """Return the solution (n,) in volts, to a normwise backward error of `rtol`, or raise AccuracyError.

        `rhs` (n,): right-hand side in amperes; `guess` (n,): initial solution in volts, or None for 0; `watch`: records
        iterations, and can cancel them; None for neither. Arrays are contiguous.
        """

    @abstractmethod
    def _refined(self, rhs: Floats | Scaled, watch: ProgressMonitor | None) -> Refined:
        """Return the solution, its componentwise backward error, and a bound on the relative error of its entries.

        `rhs` (n,): nonnegative contiguous right-hand side in amperes; `watch`: records iterations, and can cancel them;
        None for neither.
        """

    def _one_per_row(self, name: str, values: ArrayLike) -> Floats:
        """Return `values` as a contiguous array (n,) of doubles; raise InputError for a wrong shape, infinity or NaN.

        `name`: name of the argument in messages.
        """
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
    """Raise InputError unless ``0 < rtol < 1``; `rtol`: relative tolerance of a solve."""
    check_number("rtol", rtol, "a number between 0 and 1", above=0.0, below=1.0)


@dataclass(frozen=True, eq=False)
class DirectFactor(Factor):
    """A Laplacian and its factors ``L D L^T``, in the field `factors` (rows grouped into supernodes)."""

    factors: SupernodalFactors
    name: ClassVar[str] = "direct"
    """Name of the method, for users and messages."""

    def _solve(self, rhs: Floats, rtol: float, guess: Floats | None, watch: ProgressMonitor | None) -> Floats:
        """Return the solution (n,) in volts by substitution, with up to three steps of refinement (Higham 2002, 12.1).

        `rhs` (n,): right-hand side in amperes; `rtol`: largest normwise backward error; `guess`: ignored; `watch`:
        records the accuracy, or None.
        """
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
        """Return the solution by substitution, refined to a small relative error of every entry.

        Numbers have separate exponents. The returned record contains the solution in volts, its componentwise backward
        error and a bound on the relative error.

        `rhs` (n,): nonnegative right-hand side in amperes; `watch`: ignored. Matrices of at most 20,000 rows are
        refined to the nearest doubles.
        """
        del watch
        factors, exact = self.factors, self.laplacian.size <= EXACT_ROWS
        bound = self.substitution_bound() if exact else np.inf
        return refine(
            self.laplacian,
            rhs,
            lambda m, e, _: factors.substitute(m, e),
            _REFINED_DIRECTLY,
            exact=exact,
            first_bound=bound,
        )

    def substitution_bound(self) -> float:
        """Return a bound on the relative error of entries after a substitution; infinite if products may underflow.

        The bound holds for nonnegative right-hand sides.
        """
        values = self.factors.values
        least = values.min(initial=1.0, where=values > 0.0)
        return self.rounding_bound if least > _LEAST_ENTRY else np.inf

    @property
    def rounding_bound(self) -> float:
        """Bound on the relative rounding error of entries after a substitution, if no product underflows."""
        return _ROUNDINGS * self.laplacian.size


def factor_direct(laplacian: Laplacian, order: Symbolic | None = None) -> DirectFactor:
    """Return the direct factorization of a matrix; raise AccuracyError if a pivot leaves the range of doubles.

    `order`: elimination order and structure of the factors; None to compute them for this matrix.
    """
    from resgrid.solvers.supernodal import factor_supernodes

    laplacian = laplacian.with_rows()
    return DirectFactor(laplacian, factor_supernodes(laplacian, order))


@dataclass(frozen=True, eq=False)
class MultigridFactor(Factor):
    """A Laplacian, and the multigrid levels that precondition conjugate gradients for it, in the field `hierarchy`."""

    hierarchy: Hierarchy
    name: ClassVar[str] = "multigrid"
    """Name of the method, for users and messages."""

    def _solve(self, rhs: Floats, rtol: float, guess: Floats | None, watch: ProgressMonitor | None) -> Floats:
        """Return the solution (n,) in volts by preconditioned conjugate gradients, or raise AccuracyError.

        `rhs` (n,): right-hand side in amperes; `rtol`: residual norm relative to ``|rhs|`` at which the iteration ends,
        and largest backward error; `guess` (n,): initial solution in volts, or None; `watch`: records iterations, or
        None.

        With a guess the iteration also ends if the estimated error of every voltage is at most ``rtol`` times the
        largest magnitude of a voltage of the guess. This criterion is much weaker if all currents meet in a few cells,
        as at the goal when obstacles are open.
        """
        from resgrid.solvers.multigrid.conjugate_gradients import iterate
        from resgrid.solvers.multigrid.krylov import norm

        x, residual = iterate(self.laplacian, self.hierarchy, rhs, rtol, guess, watch, self.threads)
        scale = 2.0 * self.hierarchy.largest_degree * norm(x, self.threads) + norm(rhs, self.threads)
        error = residual / (scale or 1.0)
        return self._judged(x, error, rtol, watch)

    def _refined(self, rhs: Floats | Scaled, watch: ProgressMonitor | None) -> Refined:
        """Return the solution by multigrid, refined to a small relative error of every entry.

        The returned record contains the solution in volts, its componentwise backward error and a bound on the relative
        error.

        `rhs` (n,): nonnegative right-hand side in amperes; `watch`: records iterations, and can cancel them; None for
        neither.
        """
        from resgrid.solvers.multigrid.conjugate_gradients import approximate

        passes = partial(approximate, self.laplacian, self.hierarchy, watch, threads=self.threads)
        return refine(self.laplacian, rhs, passes, _REFINED, resolve=True, threads=self.threads)


def factor_multigrid(laplacian: Laplacian, *, threads: ThreadTeam = SINGLE_THREAD) -> MultigridFactor:
    """Return the multigrid preconditioner of a matrix; `threads`: share the work of setup and solves.

    Compressed rows are stored unless the matrix is a grid whose cells can be coloured red and black (no periodic axis
    with an odd number of cells).
    """
    from resgrid.solvers.multigrid.hierarchy import build_hierarchy

    hierarchy = build_hierarchy(laplacian, threads)
    return MultigridFactor(laplacian if hierarchy.grid else laplacian.with_rows(), hierarchy, threads=threads)
