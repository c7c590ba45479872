"""`PolygonRobot`: a robot that is a rigid polygon, which moves and turns in the plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Gt, Le
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import checked
from resgrid._internal.values import brief
from resgrid.core.axis import Axis, Point
from resgrid.errors import InputError
from resgrid.robots.base import SLACK, ULPS, Robot
from resgrid.robots.cells import Progress, Sampling, near_half_space, outline
from resgrid.robots.geometry import Pose, RigidPart
from resgrid.robots.shapes import Ball, Box, CellSet, HalfSpace, Polygon, Shape, require_plane

if TYPE_CHECKING:
    from resgrid.robots.kernels import CellPlane

PARTS = 3
"""Number of equal parts into which the heading range of a cell is divided with the rule ``"conservative"``.

Each part is tested with the largest motion within the part; a cell is free if all its parts are.
"""


@checked
@brief
@dataclass(frozen=True)
class PolygonRobot(Robot):
    """A rigid polygon in the plane with configurations ``(x, y, theta)``: position and rotation.

    The third coordinate is an arc length, ``theta = turning_length * angle``, in the unit of x and y.  Resistances,
    lengths and clearances thus weight a rotation by one radian like a translation by ``turning_length``.  With the
    default of 1, theta equals the angle in radians.

    Parameters
    ----------
    vertices : tuple of (float, float)
        Corners of a simple polygon at angle 0, in metres, clockwise or anticlockwise; the reference point is the
        origin.
    turning_length : float
        Length in metres that corresponds to a rotation by one radian, above 0.

    Raises
    ------
    InputError
        If the polygon crosses itself or has fewer than three corners, or the length is not above 0 and finite.

    Examples
    --------
    >>> robot = rg.PolygonRobot(((-0.4, -0.2), (0.4, -0.2), (0.4, 0.2), (-0.4, 0.2)))
    >>> robot.corners((1.0, 2.0, np.pi / 2)).round(3)
    array([[1.2, 1.6],
           [1.2, 2.4],
           [0.8, 2.4],
           [0.8, 1.6]])
    >>> robot.turning_axis(36)
    Axis(name='theta', lower=0.0, upper=6.283185307179586, cells=36, periodic=True, unit='m')
    """

    vertices: tuple[Point, ...]
    turning_length: Annotated[float, Gt(0), Le(1e9)] = 1.0

    def __post_init__(self) -> None:
        Polygon(self.vertices)

    @property
    def farthest(self) -> float:
        """Distance from the reference point to the farthest corner, in metres."""
        return float(np.hypot(*np.transpose(self.vertices)).max())

    def corners(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Return positions of the v corners, shape (..., v, 2), in metres, for `configurations` (..., 3)."""
        pose = np.asarray(configurations, dtype=np.float64)
        if pose.shape[-1:] != (3,):
            raise InputError(f"a turning polygon's configuration is (x, y, theta), got shape {pose.shape}")
        angle = pose[..., 2, None] / self.turning_length
        x, y = np.transpose(self.vertices)
        turned = np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)], axis=-1)
        return np.asarray(turned + pose[..., None, :2])

    def parts(self, configurations: NDArray[np.float64]) -> list[RigidPart]:
        """Return one rigid part: the polygon in each of the configurations, shape (n, 3)."""
        import shapely

        return [RigidPart(np.asarray(shapely.polygons(self.corners(configurations))), 0.0)]

    def travel(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return upper bounds (n,), in metres, of the distance that any point of the polygon moves.

        `start, end` (n, 3): configurations at the ends of n straight motions.  The bound is the distance that the
        reference point moves plus the arc of the farthest corner.
        """
        angle = np.abs(end[:, 2] - start[:, 2]) / self.turning_length
        return np.asarray(np.linalg.norm((end - start)[:, :2], axis=1) + self.farthest * angle)

    def pose(self, configuration: NDArray[np.float64]) -> Pose:
        """Return the pose of the polygon's edges, as one rigid body, at a configuration ``(x, y, theta)``."""
        corners = self.corners(configuration)
        edges = np.hstack([corners, np.roll(corners, -1, axis=0)])
        return Pose.of_body(edges, 0.0, configuration, self.turning_length)

    def occupancy(
        self, axes: Sequence[Axis], obstacles: Sequence[Shape], rule: Sampling, progress: Progress | None = None
    ) -> NDArray[np.bool_]:
        """Return the mask, shape of the grid, of cells in which the polygon may touch an obstacle.

        At a fixed angle, the polygon touches an obstacle if and only if its reference point lies in the Minkowski
        difference of obstacle and polygon (Lozano-Perez, IEEE Trans. Computers C-32 (1983) 108).  The conservative rule
        divides the angles of a cell into three parts.  Within a part no point moves farther than the chord of the
        farthest corner, and the differences are dilated by this chord.  A closed cell is free if it is free in each of
        the three parts.
        `axes`: axes x, y and theta; `obstacles`: shapes of the plane, in metres; `rule`: ``"conservative"``, or
        ``"centre"`` to test only the configurations at cell centres; `progress`: called as ``progress(done, total)``.
        """
        from resgrid.robots.kernels import CellPlane

        self.check_axes(axes)
        x, y, turning = axes
        shapes = [require_plane(shape, "a turning polygon") for shape in obstacles]
        solids = [_PlaneObstacle.of(shape, (x, y), self.farthest) for shape in shapes]
        parts, half, reach = 1, (0.0, 0.0), 0.0
        if rule == "conservative":
            parts, half = PARTS, (x.spacing / 2, y.spacing / 2)
            extent = self.farthest + max(abs(end) for axis in (x, y) for end in (axis.lower, axis.upper))
            chord = 2 * self.farthest * np.sin(min(turning.spacing / self.turning_length / (2 * parts), pi) / 2)
            reach = float(chord) + SLACK * self.farthest + ULPS * np.spacing(extent)
        plane = CellPlane(x.lower, y.lower, x.spacing, y.spacing, *half)
        blocked = np.zeros(tuple(axis.cells for axis in axes), dtype=bool)
        for number, centre in enumerate(turning.centres):
            layer = np.zeros(blocked.shape[:2], dtype=bool)
            for part in range(parts):
                turn = centre + turning.spacing * ((part + 0.5) / parts - 0.5)
                mirrored = -self.corners((0.0, 0.0, turn))
                for solid in solids:
                    solid.mark(layer, plane, mirrored, reach)
            blocked[:, :, number] = layer
            if progress is not None:
                progress(number + 1, turning.cells)
        return blocked


@dataclass(frozen=True, eq=False)
class _PlaneObstacle:
    """An obstacle for Minkowski sums with a polygon: an area dilated by a radius, or a half-plane.

    `edges` (e, 4): boundary of the area as edges ``x0, y0, x1, y1``, for a disc one edge of length 0 at the centre;
    `inner_points` (p, 2): one point, inside or on the border, of every connected piece of the area; `radius`: dilation
    of the area, in metres; `half_plane`: None for an area.
    """

    edges: NDArray[np.float64]
    inner_points: NDArray[np.float64]
    radius: float = 0.0
    half_plane: HalfSpace | None = None

    @classmethod
    def of(cls, shape: Shape, axes: tuple[Axis, Axis], farthest: float) -> _PlaneObstacle:
        """Return a shape as an obstacle, with outlines clipped far outside the grid.

        `axes`: axes x and y of the grid; `farthest`: distance from the robot's reference point to the farthest corner.
        """
        match shape:
            case Box() | Polygon():
                edges = outline(shape, axes, 4 * farthest)
                return cls(edges, edges[:1, :2])
            case Ball(centre, radius):
                return cls(np.array([[*centre, *centre]]), np.array([centre]), radius)
            case CellSet():
                return cls(shape.borders(), shape.inner_points())
            case HalfSpace():
                return cls(np.empty((0, 4)), np.empty((0, 2)), 0.0, shape)
        raise AssertionError("`require_plane` rejects shapes in space")

    def mark(self, layer: NDArray[np.bool_], plane: CellPlane, mirrored: NDArray[np.float64], reach: float) -> None:
        """Mark, in place, the cells of a layer near the Minkowski sum of this obstacle and a mirrored polygon.

        `layer` (columns, rows): mask of the cells (x, y) at one heading; `plane`: grid of the layer; `mirrored` (v, 2):
        corners of the polygon at this heading relative to its reference point, multiplied by -1, in metres; `reach`:
        distance from the sum, in metres, up to which cells are marked.
        The sum of the outlines is a parallelogram for every pair of edges.  Other points of the Minkowski sum occur
        only if a piece of one area lies inside the other; they lie in a copy of one area, translated by a point of
        the other.  Every parallelogram is marked separately, because a geometric union of nearly coincident ones
        could lose some.
        """
        from resgrid.robots.kernels import mark_enclosed, mark_parallelograms

        if self.half_plane is not None:
            columns, rows = np.ogrid[: layer.shape[0], : layer.shape[1]]
            centres = plane.x + (columns + 0.5) * plane.width, plane.y + (rows + 0.5) * plane.height
            farthest = float((mirrored @ self.half_plane.normal).max())
            grown = replace(self.half_plane, offset=self.half_plane.offset + farthest)
            layer |= near_half_space(grown, centres, (plane.half_x, plane.half_y), reach)
        elif len(self.edges):
            others = np.hstack([mirrored, np.roll(mirrored, -1, axis=0)])
            pieces = np.empty((len(self.edges), len(others), 6))
            pieces[..., :2] = self.edges[:, None, :2] + mirrored
            pieces[..., 2:4] = (self.edges[:, 2:] - self.edges[:, :2])[:, None]
            pieces[..., 4:] = others[:, 2:] - others[:, :2]
            mark_parallelograms(layer, pieces.reshape(-1, 6), reach + self.radius, plane)
            for point in self.inner_points:
                mark_enclosed(layer, others + np.tile(point, 2), plane)
            mark_enclosed(layer, self.edges + np.tile(mirrored[0], 2), plane)
