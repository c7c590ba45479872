"""Approximate solutions in proportion to themselves, for refinement: all decades of a potential in a few passes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import AccuracyError
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.monitor import Watch
from resgrid.solvers.multigrid.cg_kernels import put_at_places
from resgrid.solvers.multigrid.conjugate_gradients import approximate
from resgrid.solvers.multigrid.foresight import foresee
from resgrid.solvers.multigrid.graded import Gradable
from resgrid.solvers.refine import Approximation, Numbers

_LOW = 0.03
"""What is low gains digits a little later than the norm of the residual tells, to which it adds nothing."""


def graded_approximation(
    laplacian: Laplacian, levels: Gradable, currents: NDArray[np.float64], watch: Watch | None
) -> Approximation | None:
    """What refines a solution on levels that are graded by it; None where nothing can be foreseen.

    Shapes: `currents` (n,).
    """
    try:
        height = foresee(levels, at_places(levels, currents))
    except AccuracyError:
        return None
    if not np.all(np.isfinite(height)):
        return None
    hierarchy = levels.grade(height)

    def passes(m: NDArray[np.float64], e: NDArray[np.int64], accuracy: float) -> Numbers:
        return approximate(laplacian, hierarchy, watch, m, e, _LOW * accuracy)

    return passes


def at_places(levels: Gradable, currents: NDArray[np.float64]) -> NDArray[np.float64]:
    """Currents into the places of the first level, in its unit, shape (2, places)."""
    into = np.zeros((2, levels.level.lattice.places))
    put_at_places(levels.place, currents, 1.0 / levels.unit, into.ravel())
    return into
