"""What joins two cells, and a cell and a rail: the rules of the boundary, for the compiler and for later changes.

Along axis ``a`` the conductance is ``(h_ref / h_a)**2 / R`` times the series combination ``2 c_i c_j / (c_i + c_j)`` of
the cells' conductivities, ``h_ref`` being the smallest spacing.  Kirchhoff's current law at a node is then the
finite-volume form of ``div(c grad phi) = 0`` (Tarassenko & Blake 1991; Connolly & Grupen 1992, section 2).

Two neighbours have a contact of this kind, whatever they are:

=================  ==========  ============================  =======================
neighbours         dirichlet   wall                          neumann
=================  ==========  ============================  =======================
free, free         ``G``       ``G``                         ``G``
free, goal         ``G``       ``G``                         ``G``
goal, goal         ``G``       ``G``                         ``G``
free, obstacle     ``G``       ``1 / (1 / G + R_wall)``      none
goal, obstacle     ``G``       ``1 / (1 / G + R_wall)``      none
obstacle, obstacle ``G``       ``G``                         none
=================  ==========  ============================  =======================

Where just one of two cells is free, its conductivity counts alone.  Beyond an edge that counts as an obstacle lies an
obstacle cell, of the conductivity of the cell at the edge, that is on the obstacle rail; beyond an open edge lies
nothing.  Resistors between cells of the rails exist only where these have nodes (``rails="cells"``, chips, tiles).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def of_face(spacing: NDArray[np.float64], axis: int, resistance: float) -> float:
    """Return the conductance across a face between cells of conductivity 1, in siemens; `spacing` (ndim,)."""
    return float((spacing.min() / spacing[axis]) ** 2 / resistance)


def in_series(
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
    lower_free: NDArray[np.bool_] | bool,
    upper_free: NDArray[np.bool_] | bool,
) -> NDArray[np.float64]:
    """Combine the conductivities of two half cells; against a rail the free cell's counts alone."""
    lower = np.where(upper_free & ~np.asarray(lower_free), upper, lower)
    upper = np.where(lower_free & ~np.asarray(upper_free), lower, upper)
    return lower * (2.0 * upper / (lower + upper))


def has_wall(lower_obstacle: NDArray[np.bool_] | bool, upper_obstacle: NDArray[np.bool_] | bool) -> NDArray[np.bool_]:
    """Return which contacts have the wall in series: those of an obstacle with what is none."""
    return np.not_equal(lower_obstacle, upper_obstacle)


def behind_wall(conductance: NDArray[np.float64], wall_resistance: float | None) -> NDArray[np.float64]:
    """Return contacts with obstacles, in siemens, with the resistance of their wall in series; 0 ohms for none."""
    return 1.0 / (1.0 / conductance + wall_resistance) if wall_resistance else conductance
