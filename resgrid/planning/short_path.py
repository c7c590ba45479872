"""`ShortPath`, the result of `resgrid.shortcut`: a path whose bends were replaced by straight lines."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen
from resgrid.core.space import ConfigurationSpace
from resgrid.planning.fields import Field
from resgrid.planning.lattice_fields import LatticeField
from resgrid.planning.node_paths import NodePath
from resgrid.planning.streamline import Streamline, in_world


@frozen
@dataclass(frozen=True, eq=False)
class ShortPath:
    """A path whose bends were replaced by straight lines, certified by `certify_collision_free`.

    Returned by `resgrid.shortcut`.

    Attributes
    ----------
    axis_points, line : ndarray of float64, shape (n, ndim)
        Two names of one array: corners in axis units, from the start of the path to its end.  Coordinates are
        continuous across periodic seams and may leave the range of a periodic axis.
    points : ndarray of float64, shape (n, ndim)
        Corners in world coordinates.
    length : float
        Length in axis units, at most that of the original.
    clearance : float
        Smallest distance, in axis units, to the box of an obstacle cell, or to an edge of the grid on an axis with
        ``edge = "obstacle"``; infinite if there is neither.
    original : Streamline or NodePath
        The path that was shortened.
    field : Field or LatticeField
        Field of the original path.
    space : ConfigurationSpace
        Configuration space of the path.
    goal : int or None
        Index of the goal region at the end of the path, None if it ends in no goal.

    Examples
    --------
    >>> path = rg.plan(rg.read_scene("examples/scenes/lesson.toml")).path((0.5, 6.5))
    >>> short = rg.shortcut(path)
    >>> len(path.points), len(short.points)
    (12, 4)
    >>> round(path.length, 3), round(short.length, 3), round(short.clearance, 3)
    (8.712, 8.27, 0.251)
    """

    axis_points: NDArray[np.float64]
    length: float
    clearance: float
    original: Streamline | NodePath

    @property
    def field(self) -> Field | LatticeField:
        """The field of the original path."""
        return self.original.field

    @property
    def space(self) -> ConfigurationSpace:
        """The configuration space of the path."""
        return self.original.space

    @property
    def goal(self) -> int | None:
        """Index of the goal region at the end of the path, None if it ends in no goal."""
        return self.original.goal

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """Corners of the path in world coordinates, shape (n, ndim)."""
        return in_world(self.axis_points, self.space)

    @property
    def line(self) -> NDArray[np.float64]:
        """Corners of the path in axis units, continuous across periodic seams, shape (n, ndim)."""
        return self.axis_points
