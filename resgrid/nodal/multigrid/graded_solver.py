"""Approximate solutions in proportion to themselves, for refinement: all decades of a potential in a few passes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import AccuracyError
from resgrid.nodal.multigrid.foresight import FEW, foresee, mended, part_of
from resgrid.nodal.multigrid.graded import Gradable
from resgrid.nodal.multigrid.part import Part
from resgrid.nodal.multigrid.place_kernels import put_at_places, take_from_places
from resgrid.nodal.multigrid.solver import approximate
from resgrid.nodal.refine import Approximation, Numbers
from resgrid.nodal.system import NodalSystem
from resgrid.nodal.watch import Watch

_SPAN = 1e-48
"""Fall of a potential down to which it is found in single precision."""

_MANY = 1000
"""Places astray for which levels are graded once more; fewer are solved directly at the end."""

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

    Slits and pockets behind them fall by more decades than single precision spans: there the equations are solved
    directly, after every pass.
    """

    def __init__(self, system: NodalSystem, levels: Gradable, watch: Watch | None) -> None:
        self._system, self._levels, self._watch = system, levels, watch
        self._begun: NDArray[np.float64] | None = None

    def begin(self, currents: NDArray[np.float64], height: NDArray[np.float64]) -> bool:
        """Make the first pass; returns whether the height serves.

        Single precision must reach all of it but for what is solved directly, and the way up the answer must lead to
        the source, but for pockets.
        """
        self._grade(height)
        if len(self._deep) > FEW:
            return False
        no_exponents = np.empty(0, dtype=np.int64)
        rows, _ = approximate(self._system, self._hierarchy, self._watch, currents, no_exponents, 0.0)
        into, x = self._at_places(currents, rows)
        better = mended(self._levels, into, x, height)
        astray = np.count_nonzero(better != x)
        if astray > FEW:
            return False
        if astray > _MANY:
            self._grade(better)
        self._begun = self._with_depths(into, better)
        return True

    def __call__(self, m: NDArray[np.float64], e: NDArray[np.int64], accuracy: float) -> Numbers:
        """As `resgrid.nodal.multigrid.solver.approximate`; for the currents that it began with at first."""
        if self._begun is not None:
            rows, self._begun = self._begun, None
            return rows, np.zeros_like(e)
        rows, exponent = approximate(self._system, self._hierarchy, self._watch, m, e, accuracy)
        if not len(self._deep) or exponent.any():
            return rows, exponent
        return self._with_depths(*self._at_places(m, rows)), exponent

    def _grade(self, height: NDArray[np.float64]) -> None:
        self._hierarchy = self._levels.grade(height, stretched=True)
        self._deep_part: Part | None = None
        self._deep = np.flatnonzero(self._levels.unknown & (height < _SPAN * height.max()))

    def _at_places(
        self, m: NDArray[np.float64], rows: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Currents and potentials by place, shape (2, places)."""
        into = at_places(self._levels, m)
        x = np.zeros_like(into)
        put_at_places(self._levels.place, rows, 1.0, x.ravel())
        return into, x

    def _with_depths(self, into: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64]:
        """The rows of a potential, solved directly where single precision does not reach."""
        if 0 < len(self._deep) <= FEW:
            self._deep_part = self._deep_part or part_of(self._levels, self._deep)
            x.ravel()[self._deep] = self._deep_part.potential(into.ravel(), x.ravel())
        rows = take_from_places(self._levels.place, x.ravel())
        rows[np.abs(rows) < _LEAST] = 0.0
        return rows
