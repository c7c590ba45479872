"""Which cells of a turning polygon's configuration space are blocked: slice by slice, by Minkowski differences."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid.robots.protocol import Progress, Sampling
from resgrid.robots.reach import mark
from resgrid.robots.shapes import Ball, Box, HalfSpace, Polygon, Shape
from resgrid.robots.solids import as_polygon, require_plane
from resgrid.space import Axis

if TYPE_CHECKING:
    from resgrid.robots.polygon_robot import PolygonRobot

PARTS = 4
"""With the conservative rule every slice is cut into so many thinner ones, and blocked where any of them is."""

SLACK = 1e-9
"""Obstacles grow by this share of the polygon's size, against rounding."""


def turning_occupancy(
    robot: PolygonRobot,
    axes: tuple[Axis, ...],
    obstacles: Sequence[Shape],
    rule: Sampling,
    progress: Progress | None = None,
) -> NDArray[np.bool_]:
    """Cells in which a turning polygon may touch an obstacle.

    At a fixed angle the polygon touches an obstacle exactly where its reference point lies in the Minkowski difference
    of the two (Lozano-Perez, IEEE Trans. Computers C-32 (1983) 108), which is cut into cells exactly.  While the angle
    varies within a quarter of a cell no point of the polygon moves farther than a chord at the farthest corner: with
    the conservative rule the differences grow by it, and a cell is free only if it is free in all four quarters.

    Parameters
    ----------
    robot : PolygonRobot
    axes : tuple of Axis
        x, y and theta.
    obstacles : sequence of Shape
        Shapes of the plane.
    rule : {"conservative", "centre"}
        ``"centre"`` judges the configuration at the cell's centre alone.
    progress : callable, optional
        Called as ``progress(done, total)``, in slices.

    Returns
    -------
    ndarray of bool

    Raises
    ------
    InputError
        If the axes are not the robot's, or a shape is not one of the plane.
    """
    robot.check_axes(axes)
    solids = [require_plane(shape, "a turning polygon") for shape in obstacles]
    parts = PARTS if rule == "conservative" else 1
    reach = (robot.travel(axes[2], parts) + SLACK * robot.farthest) if rule == "conservative" else 0.0
    blocked = np.zeros(tuple(axis.cells for axis in axes), dtype=bool)
    for number, centre in enumerate(axes[2].centres):
        layer = np.zeros(blocked.shape[:2], dtype=bool)
        for part in range(parts):
            turn = centre + axes[2].spacing * ((part + 0.5) / parts - 0.5)
            _mark_slice(layer, axes[:2], robot.corners((0.0, 0.0, turn)), solids, reach, rule)
        blocked[:, :, number] = layer
        if progress is not None:
            progress(number + 1, len(axes[2].centres))
    return blocked


def _mark_slice(
    layer: NDArray[np.bool_],
    axes: tuple[Axis, ...],
    corners: NDArray[np.float64],
    obstacles: Sequence[Shape],
    reach: float,
    rule: Sampling,
) -> None:
    """Mark the cells of one slice, all of them at one angle."""
    mirrored = -corners
    for shape in obstacles:
        match shape:
            case Ball(centre, radius):
                grown = Polygon(tuple(map(tuple, (mirrored + centre).tolist())))
                mark(layer, axes, grown, reach + radius, rule)
            case HalfSpace(normal, offset):
                farthest = float((mirrored @ normal).max())
                mark(layer, axes, HalfSpace(normal, offset + farthest), reach, rule)
            case Box() | Polygon():
                for piece in minkowski_sum(as_polygon(shape), mirrored):
                    mark(layer, axes, piece, reach, rule)


def minkowski_sum(polygon: Polygon, corners: NDArray[np.float64]) -> Iterator[Polygon]:
    """Sum of a polygon, which may have holes, and a simple polygon.

    The sum of the outlines (a parallelogram for every pair of edges) covers all but places where one polygon lies
    wholly inside the other, and those lie in a copy of either, moved by one corner of the other.

    Parameters
    ----------
    polygon : Polygon
        The one that may have holes.
    corners : ndarray of float64, shape (v, 2)
        The other one.

    Yields
    ------
    Polygon
        Pieces that do not overlap.
    """
    import shapely

    other = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    rings = [np.asarray(ring, dtype=np.float64) for ring in polygon.rings]
    edges = np.concatenate([np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in rings])
    sums = edges[:, None, :, None, :] + other[None, :, None, :, :]
    corner_sets = sums.reshape(-1, 4, 2)
    covers = [shapely.MultiPoint(each).convex_hull for each in corner_sets]
    inner = shapely.Polygon(corners + rings[0][0])
    outer = shapely.Polygon(rings[0] + corners[0], [ring + corners[0] for ring in rings[1:]])
    union = shapely.union_all([*(each for each in covers if each.geom_type == "Polygon"), inner, outer])
    for piece in shapely.get_parts(union):
        if piece.geom_type == "Polygon":
            holes = tuple(_ring(hole) for hole in piece.interiors)
            yield Polygon(_ring(piece.exterior), holes)


def _ring(ring: object) -> tuple[tuple[float, ...], ...]:
    import shapely

    return tuple(map(tuple, shapely.get_coordinates(ring)[:-1].tolist()))  # type: ignore[call-overload]
