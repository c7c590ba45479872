"""Whether levels are graded for a potential between two rails: by how many decades it falls, as foreseen."""

from __future__ import annotations

from resgrid.solvers.decay import foresee_decades
from resgrid.solvers.laplacian import Laplacian

MOST_DECADES = 120.0
"""By how many decades heights may fall: their squares are doubles."""

_FAR, _FIXED = 11.5, 7e5
"""Decades in a plane from which levels are graded: so many, and so many over the rows.

Some of the time that grading takes is the same for few rows and for many.
"""

_FAR_IN_VOLUMES = 40.0
"""The same in a volume, where levels that are not graded do better."""

_STEEP = 8.0
"""Decades around the low rail from which it lies in a slit: a pass would gain little beyond."""


def may_be_graded(laplacian: Laplacian) -> bool:
    """Whether the potential falls by no more decades than levels can be graded for."""
    return foresee_decades(laplacian).whole <= MOST_DECADES


def is_graded(laplacian: Laplacian) -> bool:
    """Whether levels are graded for the potential: it may be done, and saves more time than it takes."""
    if laplacian.rails is None or laplacian.grid is None or laplacian.dimensions not in (2, 3):
        return False
    far = _FAR_IN_VOLUMES if laplacian.dimensions > 2 else _FAR + _FIXED / laplacian.size
    return may_be_graded(laplacian) and foresee_decades(laplacian).most - decades_in_slit(laplacian) >= far


def decades_in_slit(laplacian: Laplacian) -> float:
    """Decades that the potential falls in a slit around the low rail; 0 where it lies in none."""
    near = foresee_decades(laplacian).near
    return near if near > _STEEP else 0.0
