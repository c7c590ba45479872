"""A polygon that moves and turns in the plane."""

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
"""With the conservative rule every slice is cut into so many thinner ones, and blocked where any of them is."""


@checked
@brief
@dataclass(frozen=True)
class PolygonRobot(Robot):
    """A polygon with configurations ``(x, y, theta)``: moved to ``(x, y)`` and turned about its reference point.

    The third coordinate is an arc, not an angle: ``theta = turning_length * angle``, in the unit of x and y, so that
    resistances, lengths and clearances weigh turning by one radian like moving by ``turning_length``.  With the
    default of 1 it reads like radians.

    Parameters
    ----------
    vertices : tuple of (float, float)
        Corners of a simple polygon, in either sense; the reference point is the origin.
    turning_length : float
        Above 0.

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
        """Distance from the reference point to the farthest corner."""
        return float(np.hypot(*np.transpose(self.vertices)).max())

    def corners(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Where the corners are. Shapes: `configurations` (..., 3); returns (..., v, 2)."""
        pose = np.asarray(configurations, dtype=np.float64)
        if pose.shape[-1:] != (3,):
            raise InputError(f"a turning polygon's configuration is (x, y, theta), got shape {pose.shape}")
        angle = pose[..., 2, None] / self.turning_length
        x, y = np.transpose(self.vertices)
        turned = np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)], axis=-1)
        return np.asarray(turned + pose[..., None, :2])

    def parts(self, configurations: NDArray[np.float64]) -> list[RigidPart]:
        """The polygon; see `Robot.parts`."""
        import shapely

        return [RigidPart(np.asarray(shapely.polygons(self.corners(configurations))), 0.0)]

    def travel(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
        """How far the reference point moves, and the farthest corner turns; see `Robot.travel`."""
        angle = np.abs(end[:, 2] - start[:, 2]) / self.turning_length
        return np.asarray(np.linalg.norm((end - start)[:, :2], axis=1) + self.farthest * angle)

    def pose(self, configuration: NDArray[np.float64]) -> Pose:
        """The edges of a rigid body; see `Robot.pose`."""
        corners = self.corners(configuration)
        edges = np.hstack([corners, np.roll(corners, -1, axis=0)])
        return Pose.of_body(edges, 0.0, configuration, self.turning_length)

    def occupancy(
        self, axes: Sequence[Axis], obstacles: Sequence[Shape], rule: Sampling, progress: Progress | None = None
    ) -> NDArray[np.bool_]:
        """Cells in which the polygon may touch an obstacle; see `Robot.occupancy`.

        At a fixed angle the polygon touches an obstacle exactly where its reference point lies in the Minkowski
        difference of the two (Lozano-Perez, IEEE Trans. Computers C-32 (1983) 108).  While the angle varies within a
        third of a cell no point of the polygon moves farther than a chord at the farthest corner: with the conservative
        rule the differences grow by it, and a cell, its border included, is free only if it is free in all three
        thirds.
        """
        from resgrid.robots.kernels import CellPlane

        self.check_axes(axes)
        x, y, turning = axes
        solids = [_Solid.of(require_plane(shape, "a turning polygon"), (x, y), self.farthest) for shape in obstacles]
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
class _Solid:
    """An obstacle as a turning polygon meets it: everything within a radius of an area, or a half-plane.

    `edges` (e, 4): of the area; a disc has its centre for an edge; `places` (p, 2): a point of every piece of it.
    """

    edges: NDArray[np.float64]
    places: NDArray[np.float64]
    radius: float = 0.0
    half_plane: HalfSpace | None = None

    @classmethod
    def of(cls, shape: Shape, axes: tuple[Axis, Axis], farthest: float) -> _Solid:
        match shape:
            case Box() | Polygon():
                edges = outline(shape, axes, 4 * farthest)
                return cls(edges, edges[:1, :2])
            case Ball(centre, radius):
                return cls(np.array([[*centre, *centre]]), np.array([centre]), radius)
            case CellSet():
                return cls(shape.borders(), shape.places())
        return cls(np.empty((0, 4)), np.empty((0, 2)), 0.0, shape)

    def mark(self, layer: NDArray[np.bool_], plane: CellPlane, mirrored: NDArray[np.float64], reach: float) -> None:
        """Mark the cells, shape (columns, rows), near the sum of the area and a polygon with mirrored corners (v, 2).

        The Minkowski sum of the outlines (a parallelogram for every pair of edges) covers all but places where a piece
        of one lies wholly inside the other, and those lie in a copy of either, moved by one point of the other.  Every
        piece is marked as it is: a union of nearly coinciding ones would lose some.
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
            for place in self.places:
                mark_enclosed(layer, others + np.tile(place, 2), plane)
            mark_enclosed(layer, self.edges + np.tile(mirrored[0], 2), plane)
