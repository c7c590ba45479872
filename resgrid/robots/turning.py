"""Which cells of a turning polygon's configuration space are blocked: slice by slice, by Minkowski differences."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid.robots.polygons import outline
from resgrid.robots.protocol import Progress, Sampling
from resgrid.robots.shapes import Ball, Box, HalfSpace, Polygon, Shape
from resgrid.robots.solids import require_plane
from resgrid.space import Axis

if TYPE_CHECKING:
    from resgrid.robots.polygon_kernels import Plane
    from resgrid.robots.polygon_robot import PolygonRobot

PARTS = 3
"""With the conservative rule every slice is cut into so many thinner ones, and blocked where any of them is."""

SLACK = 1e-9
"""Obstacles grow by this share of the polygon's size, against rounding, ..."""

ULPS = 64
"""... and by so many units in the last place of the coordinates."""


def turning_occupancy(
    robot: PolygonRobot,
    axes: tuple[Axis, ...],
    obstacles: Sequence[Shape],
    rule: Sampling,
    progress: Progress | None = None,
) -> NDArray[np.bool_]:
    """Cells in which a turning polygon may touch an obstacle.

    At a fixed angle the polygon touches an obstacle exactly where its reference point lies in the Minkowski difference
    of the two (Lozano-Perez, IEEE Trans. Computers C-32 (1983) 108).  While the angle varies within a third of a cell
    no point of the polygon moves farther than a chord at the farthest corner: with the conservative rule the
    differences grow by it, and a cell, its border included, is free only if it is free in all three thirds.
    """
    from resgrid.robots.polygon_kernels import Plane

    robot.check_axes(axes)
    x, y, turning = axes
    solids = [_outlined(require_plane(shape, "a turning polygon"), (x, y), robot.farthest) for shape in obstacles]
    conservative = rule == "conservative"
    half = (x.spacing / 2, y.spacing / 2) if conservative else (0.0, 0.0)
    plane = Plane(x.lower, y.lower, x.spacing, y.spacing, *half)
    extent = robot.farthest + max(abs(end) for axis in (x, y) for end in (axis.lower, axis.upper))
    parts = PARTS if conservative else 1
    reach = robot.travel(turning, parts) + SLACK * robot.farthest + ULPS * np.spacing(extent) if conservative else 0.0
    blocked = np.zeros(tuple(axis.cells for axis in axes), dtype=bool)
    for number, centre in enumerate(turning.centres):
        layer = np.zeros(blocked.shape[:2], dtype=bool)
        for part in range(parts):
            turn = centre + turning.spacing * ((part + 0.5) / parts - 0.5)
            _mark_slice(layer, plane, solids, -robot.corners((0.0, 0.0, turn)), reach)
        blocked[:, :, number] = layer
        if progress is not None:
            progress(number + 1, turning.cells)
    return blocked


def _outlined(shape: Shape, axes: tuple[Axis, ...], farthest: float) -> tuple[Shape, NDArray[np.float64]]:
    """A shape and its edges, shape (e, 4); a disc has its centre for an edge, a half-plane none."""
    match shape:
        case Box() | Polygon():
            return shape, outline(shape, axes, 4 * farthest)
        case Ball(centre):
            return shape, np.array([[*centre, *centre]])
    return shape, np.empty((0, 4))


def _mark_slice(
    layer: NDArray[np.bool_],
    plane: Plane,
    solids: Sequence[tuple[Shape, NDArray[np.float64]]],
    mirrored: NDArray[np.float64],
    reach: float,
) -> None:
    """Mark the cells of one slice: its polygon, mirrored at the reference point, has corners of shape (v, 2)."""
    for shape, edges in solids:
        match shape:
            case HalfSpace():
                _mark_half_plane(layer, plane, shape, mirrored, reach)
            case Ball():
                mark_sum(layer, plane, edges, mirrored, reach + shape.radius)
            case _:
                mark_sum(layer, plane, edges, mirrored, reach)


def mark_sum(
    layer: NDArray[np.bool_],
    plane: Plane,
    edges: NDArray[np.float64],
    corners: NDArray[np.float64],
    reach: float,
) -> None:
    """Mark, in place, the cells that come within a distance of the Minkowski sum of two polygons.

    The sum of the outlines (a parallelogram for every pair of edges) covers all but places where one polygon lies
    wholly inside the other, and those lie in a copy of either, moved by one corner of the other, whose own outline
    the parallelograms cover.  Every piece is marked as it is: a union of nearly coinciding ones would lose some.

    Shapes: `layer` (columns, rows), `edges` (e, 4), `corners` (v, 2).
    """
    from resgrid.robots.polygon_kernels import mark_enclosed, mark_parallelograms

    others = np.hstack([corners, np.roll(corners, -1, axis=0)])
    pieces = np.empty((len(edges), len(others), 6))
    pieces[..., :2] = edges[:, None, :2] + corners
    pieces[..., 2:4] = (edges[:, 2:] - edges[:, :2])[:, None]
    pieces[..., 4:] = others[:, 2:] - others[:, :2]
    mark_parallelograms(layer, pieces.reshape(-1, 6), reach, plane)
    mark_enclosed(layer, others + np.tile(edges[0, :2], 2), plane)
    mark_enclosed(layer, edges + np.tile(corners[0], 2), plane)


def _mark_half_plane(
    layer: NDArray[np.bool_], plane: Plane, shape: HalfSpace, mirrored: NDArray[np.float64], reach: float
) -> None:
    along, up = shape.normal
    columns, rows = layer.shape
    x = plane.x + (np.arange(columns)[:, None] + 0.5) * plane.width
    y = plane.y + (np.arange(rows) + 0.5) * plane.height
    nearest = along * x - abs(along) * plane.half_x + (up * y - abs(up) * plane.half_y)
    layer |= nearest <= shape.offset + float((mirrored @ shape.normal).max()) + reach * hypot(along, up)
