"""Flexible conjugate gradients (Notay 2000), preconditioned by one cycle of the hierarchy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.monitor import Watch
from resgrid.solvers.multigrid.board_iteration import iterate_on_board
from resgrid.solvers.multigrid.graph_iteration import iterate_on_graph
from resgrid.solvers.multigrid.hierarchy import Hierarchy


def iterate(
    laplacian: Laplacian,
    hierarchy: Hierarchy,
    b: NDArray[np.float64],
    rtol: float,
    guess: NDArray[np.float64] | None = None,
    watch: Watch | None = None,
) -> tuple[NDArray[np.float64], float]:
    """Solve until the residual norm is ``rtol |b|``, or rounding forbids more.

    From a guess on, an error of at most ``rtol`` in every voltage, relative to the largest one, is enough too, as the
    steps tell it (after Hestenes & Stiefel 1952; Strakos & Tichy 2002).

    Shapes: `b` (n,), `guess` (n,); returns `x` (n,).
    """
    watch = Watch() if watch is None else watch
    if hierarchy.grid is None:
        return iterate_on_graph(laplacian, hierarchy.stack, hierarchy.unit, b, rtol, guess, watch)
    return iterate_on_board(hierarchy, hierarchy.grid, b, rtol, guess, watch)
