"""Compiled kernel for upper bounds of distances to obstacle cells on a plane.

Import this module only inside functions that call a kernel, because importing numba takes seconds.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import kernel


@kernel
def chamfer_distances(clear: NDArray[np.bool_], width: float, height: float) -> NDArray[np.float64]:
    """Return the length of the shortest chain of steps from every cell's centre to an obstacle cell's, (nx, ny).

    A step joins the centres of cells that share a face or a corner (Borgefors, Comput. Vis. Graph. Image Process. 34,
    1986, 344).  The length, in the unit of the cell widths, is an upper bound of the distance of both centres, at most
    8.3 % above it for square cells; it is infinite without obstacle cells.  `clear` (nx, ny): mask of cells that are
    not obstacles; `width`, `height`: cell widths along the first and the second axis.
    """
    nx, ny = clear.shape
    diagonal = math.hypot(width, height)
    out = np.where(clear, np.inf, 0.0)
    for i in range(nx):
        for j in range(ny):
            best = out[i, j]
            if j > 0:
                best = min(best, out[i, j - 1] + height)
            if i > 0:
                best = min(best, out[i - 1, j] + width)
                if j > 0:
                    best = min(best, out[i - 1, j - 1] + diagonal)
                if j + 1 < ny:
                    best = min(best, out[i - 1, j + 1] + diagonal)
            out[i, j] = best
    for i in range(nx - 1, -1, -1):
        for j in range(ny - 1, -1, -1):
            best = out[i, j]
            if j + 1 < ny:
                best = min(best, out[i, j + 1] + height)
            if i + 1 < nx:
                best = min(best, out[i + 1, j] + width)
                if j > 0:
                    best = min(best, out[i + 1, j - 1] + diagonal)
                if j + 1 < ny:
                    best = min(best, out[i + 1, j + 1] + diagonal)
            out[i, j] = best
    return out
