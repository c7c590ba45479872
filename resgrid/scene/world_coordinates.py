"""Points and shapes of the world, brought into the coordinates of the space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.core.axis import Axis, Point, split_points
from resgrid.core.frame import Frame
from resgrid.errors import InputError
from resgrid.robots import Ball, Box, CellSet, HalfSpace, Polygon, Shape
from resgrid.scene.maps.arrays import MapCells


def located(axes: tuple[Axis, ...], frame: Frame, point: Point, key: str) -> tuple[tuple[int, ...], Point]:
    """Cell that a point of the world lies in, and the point in the coordinates of the space."""
    inside = frame.from_world(point)
    try:
        cell, local = split_points(axes, inside, frame.reach(axes))
    except InputError:
        turned = "" if frame.is_world else f", which is {inside.round(6).tolist()} in the map's frame,"
        words = f"the point {list(point)}{turned} lies outside the grid ({extent_of(axes)})"
        raise InputError(f"{key}: {words}; {_exchanged(axes, inside)}move it inside") from None
    steps = zip(axes, cell.tolist(), local.tolist(), strict=True)
    within = tuple(axis.lower + (number + share) * axis.spacing for axis, number, share in steps)
    return tuple(cell.tolist()), within


def unknown_cells(cells: MapCells | None, axes: tuple[Axis, ...]) -> NDArray[np.bool_] | None:
    """Return the cells of a space that are obstacles because their occupancy is unknown, in the shape of its axes.

    None where the map knows no such cells, takes them as free, or has other axes than the space.
    """
    if cells is None or cells.unknown is None or cells.table.get("unknown") == "free":
        return None
    planar = cells.unknown.ndim
    if axes[:planar] != cells.axes:
        return None
    unknown = cells.unknown.reshape(cells.unknown.shape + (1,) * (len(axes) - planar))
    return np.broadcast_to(unknown, tuple(axis.cells for axis in axes))


def _exchanged(axes: tuple[Axis, ...], point: NDArray[np.float64]) -> str:
    """That a point lies inside with its first two coordinates exchanged; empty if it does not."""
    try:
        split_points(axes, point[..., [1, 0, *range(2, len(axes))]])
    except (InputError, IndexError):
        return ""
    return f"with {axes[0].name} and {axes[1].name} exchanged it lies inside; exchange them, or "


def extent_of(axes: tuple[Axis, ...]) -> str:
    """What axes cover, in words."""
    return ", ".join(f"{axis.name} in [{axis.lower:g}, {axis.upper:g}]" for axis in axes)


def cell_centre(axes: tuple[Axis, ...], frame: Frame, cell: tuple[int, ...], key: str) -> Point:
    """World coordinates of the centre of a cell."""
    check_cell(axes, cell, key)
    inside = [axis.lower + (index + 0.5) * axis.spacing for index, axis in zip(cell, axes, strict=True)]
    return tuple(np.asarray(frame.to_world(inside)).tolist())


def check_cell(axes: tuple[Axis, ...], cell: tuple[int, ...], key: str) -> None:
    """Refuse a cell that is not in the grid."""
    if len(cell) != len(axes) or not all(0 <= index < axis.cells for index, axis in zip(cell, axes, strict=True)):
        size = " x ".join(str(axis.cells) for axis in axes)
        raise InputError(f"{key}: cell {list(cell)} is not in the grid of {size} cells (counted from 0)")


def to_space(shape: Shape, frame: Frame) -> Shape:
    """A shape of the world in the coordinates of the space."""
    if frame.is_world or isinstance(shape, CellSet):  # the cells of a map lie there already
        return shape
    if shape.ndim != 2:
        raise InputError("a region with headings does not fit a turned map; give a point (x, y, heading), or a place")
    match shape:
        case Box(lower, upper):
            # A line turned by rounding has corners that coincide, or edges that cross.
            least = 64 * float(np.spacing(max(map(abs, (*lower, *upper, frame.x, frame.y)))))
            upper = tuple(max(low + least, high) for low, high in zip(lower, upper, strict=True))
            corners = (lower, (upper[0], lower[1]), upper, (lower[0], upper[1]))
            return Polygon(_ring(corners, frame))
        case Ball(centre, radius):
            return Ball(_ring((centre,), frame)[0], radius)
        case Polygon(vertices, holes):
            return Polygon(_ring(vertices, frame), tuple(_ring(hole, frame) for hole in holes))
        case HalfSpace(normal, offset):
            turned = np.asarray(Frame(yaw=frame.yaw).from_world(normal)).tolist() if frame.yaw else list(normal)
            return HalfSpace(tuple(turned), offset - normal[0] * frame.x - normal[1] * frame.y)


def _ring(points: tuple[Point, ...], frame: Frame) -> tuple[Point, ...]:
    return tuple(tuple(point) for point in np.asarray(frame.from_world(points)).tolist())
