"""Approximate solutions in proportion to themselves, for refinement: all decades of a potential in a few passes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import AccuracyError
from resgrid.nodal.multigrid.foresight import FEW, foresee, mended
from resgrid.nodal.multigrid.graded import Gradable
from resgrid.nodal.multigrid.place_kernels import put_at_places, take_from_places
from resgrid.nodal.multigrid.solver import approximate
from resgrid.nodal.refine import Approximation, Numbers
from resgrid.nodal.system import NodalSystem
from resgrid.nodal.watch import Watch

_SPAN = 1e-48
"""Fall of a potential down to which it is found in single precision."""

_MANY = 1000
"""Places astray for which levels are graded once more; fewer are solved directly at the end."""

_LOW = 0.03
"""What is low gains digits a little later than the norm of the residual tells, to which it adds nothing."""

_LEAST = 1e-200
"""Voltages that are left to scaled numbers."""


def graded_approximation(
    system: NodalSystem, levels: Gradable, currents: NDArray[np.float64], watch: Watch | None
) -> Approximation | None:
    """What refines a solution on levels that are graded by it; None where that does not serve (`_Graded.begin`).

    Parameters
    ----------
    system : NodalSystem
    levels : Gradable
        Its own.
    currents : ndarray of float64, shape (n,)
        Into the rows, in amperes, none negative.
    watch : Watch or None
        Told every step.

    Returns
    -------
    callable or None
        As `resgrid.nodal.refine.refine` takes it.
    """
    try:
        height = foresee(levels, at_places(levels, currents))
    except AccuracyError:
        return None
    if not np.all(np.isfinite(height)):
        return None
    graded = _Graded(system, levels, watch)
    return graded if graded.begin(currents, height) else None


def at_places(levels: Gradable, currents: NDArray[np.float64]) -> NDArray[np.float64]:
    """Currents into the places of the first level, in its unit, shape (2, places)."""
    into = np.zeros((2, levels.level.lattice.places))
    put_at_places(levels.place, currents, 1.0 / levels.unit, into.ravel())
    return into


class _Graded:
    """Passes over levels that are graded by a height, or by the first answer, where that tells of quite another height.

    Slits and pockets behind them fall by more decades than single precision spans: they are left to
    `resgrid.nodal.multigrid.pockets`.
    """

    def __init__(self, system: NodalSystem, levels: Gradable, watch: Watch | None) -> None:
        self._system, self._levels, self._watch = system, levels, watch
        self._begun: NDArray[np.float64] | None = None

    def begin(self, currents: NDArray[np.float64], height: NDArray[np.float64]) -> bool:
        """Make the first pass; returns whether the height serves.

        Single precision must reach all of it but for what is solved directly, and the way up the answer must lead to
        the source, but for pockets.
        """
        if np.count_nonzero(self._levels.unknown & (height < _SPAN * height.max())) > FEW:
            return False
        self._grade(height)
        no_exponents = np.empty(0, dtype=np.int64)
        rows, _ = approximate(self._system, self._hierarchy, self._watch, currents, no_exponents, 0.0)
        into, x = at_places(self._levels, currents), np.zeros((2, self._levels.level.lattice.places))
        put_at_places(self._levels.place, rows, 1.0, x.ravel())
        better = mended(self._levels, into, x, height)
        astray = np.count_nonzero(better != x)
        if astray > FEW:
            return False
        if astray > _MANY:
            self._grade(better)
        self._begun = take_from_places(self._levels.place, better.ravel())
        self._begun[np.abs(self._begun) < _LEAST] = 0.0
        return True

    def __call__(self, m: NDArray[np.float64], e: NDArray[np.int64], accuracy: float) -> Numbers:
        """As `resgrid.nodal.multigrid.solver.approximate`; for the currents that it began with at first."""
        if self._begun is not None:
            rows, self._begun = self._begun, None
            return rows, np.zeros_like(e)
        return approximate(self._system, self._hierarchy, self._watch, m, e, _LOW * accuracy)

    def _grade(self, height: NDArray[np.float64]) -> None:
        self._hierarchy = self._levels.grade(height, stretched=True)
