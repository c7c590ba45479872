"""What refinement takes for an inverse: iterations on one scale, relative to the largest entry."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.extended import power
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.monitor import Watch
from resgrid.solvers.refine import Numbers

if TYPE_CHECKING:
    from resgrid.solvers.multigrid.hierarchy import Hierarchy

_PASS, _LEAST_PASS = 1e-12, 1e-2
"""By how much a pass of refinement lessens the residual: at most, and at least."""


def approximate(
    laplacian: Laplacian,
    hierarchy: Hierarchy,
    watch: Watch | None,
    m: NDArray[np.float64],
    e: NDArray[np.int64],
    accuracy: float,
) -> Numbers:
    """Up to twelve digits of ``A^-1`` times scaled numbers, relative to the largest."""
    from resgrid.solvers.multigrid.iteration import iterate

    top = 0
    if e.any() and m.any():
        top = int(e[m != 0].max())
        m = m * power(np.clip(e - top, -8, 0))
    largest = max(float(m.max(initial=0.0)), -float(m.min(initial=0.0)))
    if not largest:
        return np.zeros_like(m), np.zeros_like(e)
    x, _ = iterate(laplacian, hierarchy, m / largest, min(max(accuracy, _PASS), _LEAST_PASS), None, watch)
    with np.errstate(over="ignore"):
        x *= largest
    return x, np.full_like(e, top)
