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
    from shapely.geometry.base import BaseGeometry

    from resgrid.robots.polygon_robot import PolygonRobot

PARTS = 3
"""With the conservative rule every slice is cut into so many thinner ones, and blocked where any of them is."""

SLACK = 1e-9
"""Obstacles grow by this share of the polygon's size, against rounding."""


FLAT = 1e-12
"""Edges that enclose a smaller sine are parallel: their sum has no area, and its neighbours cover it."""


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
    varies within a third of a cell no point of the polygon moves farther than a chord at the farthest corner: with
    the conservative rule the differences grow by it, and a cell is free only if it is free in all three thirds.

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

    rings = [np.asarray(ring, dtype=np.float64) for ring in polygon.rings]
    if len(rings) == 1 and _is_convex(rings[0]) and _is_convex(corners):
        hull = shapely.MultiPoint((rings[0][:, None] + corners).reshape(-1, 2)).convex_hull
        yield Polygon(_ring(hull.boundary))
        return
    starts, steps = np.concatenate(rings), np.concatenate([np.roll(ring, -1, axis=0) - ring for ring in rings])
    other = np.roll(corners, -1, axis=0) - corners
    corner = starts[:, None] + corners[None]
    along, across = np.broadcast_to(steps[:, None], corner.shape), np.broadcast_to(other[None], corner.shape)
    cross = along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0]
    size = np.linalg.norm(along, axis=-1) * np.linalg.norm(across, axis=-1)
    proper = np.abs(cross) > FLAT * size
    outline = np.stack([corner, corner + along, corner + along + across, corner + across], axis=-2)[proper]
    covers = np.asarray(shapely.polygons(outline), dtype=object)
    inner = shapely.Polygon(corners + rings[0][0])
    outer = shapely.Polygon(rings[0] + corners[0], [ring + corners[0] for ring in rings[1:]])
    union = shapely.union_all([*covers, inner, outer])
    for piece in shapely.get_parts(union):
        if piece.geom_type == "Polygon":
            holes = tuple(_ring(hole) for hole in piece.interiors)
            yield Polygon(_ring(piece.exterior), holes)


def _is_convex(ring: NDArray[np.float64]) -> bool:
    edges = np.roll(ring, -1, axis=0) - ring
    after = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0]
    return bool((turns >= 0).all() or (turns <= 0).all())  # a simple ring cannot wind twice


def _ring(ring: BaseGeometry) -> tuple[tuple[float, ...], ...]:
    import shapely

    return tuple(map(tuple, shapely.get_coordinates(ring)[:-1].tolist()))
