"""What every method of solving makes of a nodal laplacian: something to solve with, many times."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.arguments import check_number
from resgrid.errors import AccuracyError, InputError
from resgrid.solvers.extended import Scaled
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.monitor import Watch

if TYPE_CHECKING:
    from scipy import sparse

_MOST_PASSES = 4
"""Solutions and corrections of a direct method: each gains most of the digits, or none."""


@dataclass(frozen=True, eq=False)
class Factor(ABC):
    """A matrix made ready for many right-hand sides.

    `laplacian`: the matrix.
    """

    laplacian: Laplacian

    @property
    @abstractmethod
    def name(self) -> str:
        """The method."""

    def solve(
        self,
        rhs: ArrayLike,
        *,
        rtol: float = 1e-10,
        guess: ArrayLike | None = None,
        watch: Watch | None = None,
    ) -> NDArray[np.float64]:
        """Solve to a normwise backward error.  Shapes: `rhs` (n,), `guess` (n,); returns (n,)."""
        check_rtol(rtol)
        begin = None if guess is None else self._one_per_row("guess", guess)
        return self._solve(self._one_per_row("rhs", rhs), rtol, begin, watch)

    def solve_nonnegative(self, rhs: ArrayLike | Scaled, *, watch: Watch | None = None) -> tuple[Scaled, float]:
        """Solve for a right-hand side without negative entries, entry by entry.

        Shapes: `rhs` (n,); returns `solution` (n,).
        """
        currents = self._one_per_row("rhs", rhs.hi if isinstance(rhs, Scaled) else rhs)
        if currents.min(initial=0.0) < 0.0:
            row = int(np.argmin(currents))
            raise InputError(
                f"rhs[{row}] is negative, and only currents of one sign are solved for entry by entry; solve for both "
                "signs apart, or use Factor.solve"
            )
        return self._solve_nonnegative(rhs if isinstance(rhs, Scaled) else currents, watch)

    def _judged(self, x: NDArray[np.float64], error: float, rtol: float, watch: Watch | None) -> NDArray[np.float64]:
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
    def _solve(
        self, rhs: NDArray[np.float64], rtol: float, guess: NDArray[np.float64] | None, watch: Watch | None
    ) -> NDArray[np.float64]:
        """As `solve`, for contiguous arrays of the right shape."""

    @abstractmethod
    def _solve_nonnegative(self, rhs: NDArray[np.float64] | Scaled, watch: Watch | None) -> tuple[Scaled, float]:
        """As `solve_nonnegative`, for contiguous arrays of the right shape."""

    def _one_per_row(self, name: str, values: ArrayLike) -> NDArray[np.float64]:
        no_numbers = f"{name} must be real numbers, one per row of the matrix"
        try:
            array = np.ascontiguousarray(values, dtype=None if np.iscomplexobj(values) else np.float64)
        except (TypeError, ValueError):
            raise InputError(no_numbers) from None
        if array.dtype.kind == "c":
            raise InputError(no_numbers)
        if array.shape != (self.laplacian.size,):
            raise InputError(
                f"{name} has shape {array.shape}, but there are {self.laplacian.size} rows; give one number per row"
            )
        if not np.isfinite(array).all():
            row = int(np.flatnonzero(~np.isfinite(array))[0])
            raise InputError(f"{name}[{row}] is {array[row]}; it must be finite")
        return array


class Residual(NamedTuple):
    """``b - A x`` in doubles: `degree` (n,): the diagonal; `coupling` (n, n): edge conductances; both in siemens."""

    degree: NDArray[np.float64]
    coupling: sparse.csr_array

    @classmethod
    def of(cls, laplacian: Laplacian) -> Residual:
        """That of a matrix."""
        return cls(laplacian.diagonal, laplacian.edges)


def refine_normwise(
    matrix: Residual,
    rhs: NDArray[np.float64],
    correction: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    x: NDArray[np.float64],
    rtol: float,
) -> tuple[NDArray[np.float64], float]:
    """Correct a solution until its backward error is small enough, or a few times (Higham 2002, section 12.1).

    Shapes: `rhs` (n,), `x` (n,); returns `x` (n,).
    """
    degree, coupling = matrix
    norm, drive = 2.0 * float(degree.max(initial=0.0)), float(np.abs(rhs).max(initial=0.0))
    for left in reversed(range(_MOST_PASSES)):
        with np.errstate(over="ignore", invalid="ignore"):
            residual = rhs - (degree * x - coupling @ x)
        scale = norm * float(np.abs(x).max(initial=0.0)) + drive
        error = float(np.abs(residual).max(initial=0.0)) / scale if scale else 0.0
        if error <= rtol or not left or not np.isfinite(error):
            break
        x = x + correction(residual)
    return x, error


def check_rtol(rtol: float) -> None:
    """Refuse a backward error that is none."""
    check_number("rtol", rtol, "a number between 0 and 1", above=0.0, below=1.0)
