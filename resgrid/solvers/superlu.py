"""Factors by differences (SuperLU; Li 2005), for what is not positive throughout, or needs a few digits alone.

Admittances and quadratic forms are complex, or have entries of both signs; levels scaled by a potential have ground
conductances of both signs; preconditioners need few digits.  All other factors are made in
positive numbers alone (`resgrid.solvers.supernodal`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from resgrid.errors import AccuracyError

_PANEL, _RELAXED = 3, 1
"""Columns that are worked on together, and those of a subtree that count as one.

Columns of a grid's factors are short, and few have the same rows: with SuperLU's own 20 and 10, planes and mazes take
1.7 times as long, and volumes no less.
"""


def symmetric_factors(matrix: Any) -> Any:
    """Factor a symmetric matrix, real or complex, with diagonal pivots.  Shapes: `matrix` (n, n)."""
    from scipy.sparse.linalg import splu

    try:
        factors = splu(
            sparse.csc_matrix(matrix),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            relax=_RELAXED,
            panel_size=_PANEL,
            options={"SymmetricMode": True, "Equil": False},
        )
    except RuntimeError as error:
        raise AccuracyError(
            "the matrix is singular in double precision: its conductances span too many decades for a direct solution"
        ) from error
    if np.any(factors.perm_r != factors.perm_c):
        raise AccuracyError("a pivot vanished in double precision: the conductances span too many decades")
    return factors
