"""Conversion of points, shapes and cells of a map to the coordinates and cells of the configuration space, and back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.core.axis import Axis, Point, extent_of, split_points
from resgrid.core.frame import Frame
from resgrid.errors import InputError
from resgrid.robots import Ball, Box, CellSet, HalfSpace, Polygon, Shape
from resgrid.scene.maps.arrays import MapCells


def locate_point(axes: tuple[Axis, ...], frame: Frame, point: Point, key: str) -> tuple[tuple[int, ...], Point]:
    """Return the index of the cell of a point in world coordinates, and the point in the coordinates of the space.

    Along periodic axes, the returned point lies inside the grid.  `axes`, `frame`: axes of the space, and the
    transformation from axis units to the world; `key`: key path of the point, for messages.  Raises InputError if the
    point lies outside the grid.
    """
    inside = frame.from_world(point)
    try:
        cell, local = split_points(axes, inside, frame.reach(axes))
    except InputError:
        rotated = "" if frame.is_world else f", which is {inside.round(6).tolist()} in the map's frame,"
        words = f"the point {list(point)}{rotated} lies outside the grid ({extent_of(axes)})"
        raise InputError(f"{key}: {words}; {_exchange_hint(axes, inside)}move it inside") from None
    steps = zip(axes, cell.tolist(), local.tolist(), strict=True)
    within = tuple(axis.lower + (number + offset) * axis.spacing for axis, number, offset in steps)
    return tuple(cell.tolist()), within


def unknown_cells(cells: MapCells | None, axes: tuple[Axis, ...]) -> NDArray[np.bool_] | None:
    """Return the mask of cells that are obstacles because their occupancy is unknown, in the shape of the space.

    `cells`: cells of the map, None without a map; `axes`: axes of the space.  The result is None if the map's format
    has no unknown cells, if they count as free, or if the first axes of the space are not those of the map.
    """
    if cells is None or cells.unknown is None or cells.table.get("unknown") == "free":
        return None
    return None if axes[: cells.unknown.ndim] != cells.axes else over_map(cells.unknown, axes)


def over_map(values: NDArray[Any], axes: tuple[Axis, ...]) -> NDArray[Any]:
    """Return values of a map's cells broadcast to the shape of a space, constant along further axes.

    `values`: one value per cell of the map, shape of the map; `axes`: axes of the space, of which the first ones are
    the axes of the map.
    """
    planar = values.reshape(values.shape + (1,) * (len(axes) - values.ndim))
    return np.broadcast_to(planar, tuple(axis.cells for axis in axes))


def _exchange_hint(axes: tuple[Axis, ...], point: NDArray[np.float64]) -> str:
    """Return a hint, as text, that the point with its first two coordinates exchanged lies inside the grid.

    `point` (ndim,): point in axis units.  The text is empty if the point also lies outside after the exchange.
    """
    try:
        split_points(axes, point[..., [1, 0, *range(2, len(axes))]])
    except (InputError, IndexError):
        return ""
    return f"with {axes[0].name} and {axes[1].name} exchanged it lies inside; exchange them, or "


def cell_centre(axes: tuple[Axis, ...], frame: Frame, cell: tuple[int, ...], key: str) -> Point:
    """Return the world coordinates of the centre of a cell; raise InputError if the cell is outside the grid.

    `axes`, `frame`: axes of the space, and the transformation from axis units to the world; `cell`: index along each
    axis; `key`: key path of the cell, for messages.
    """
    check_cell(axes, cell, key)
    inside = [axis.lower + (index + 0.5) * axis.spacing for index, axis in zip(cell, axes, strict=True)]
    return tuple(np.asarray(frame.to_world(inside)).tolist())


def check_cell(axes: tuple[Axis, ...], cell: tuple[int, ...], key: str) -> None:
    """Raise InputError unless a cell lies in the grid; `key`: key path of the cell, for the message."""
    if len(cell) != len(axes) or not all(0 <= index < axis.cells for index, axis in zip(cell, axes, strict=True)):
        size = " x ".join(str(axis.cells) for axis in axes)
        raise InputError(f"{key}: cell {list(cell)} is not in the grid of {size} cells (counted from 0)")


def to_space(shape: Shape, frame: Frame) -> Shape:
    """Return a shape converted from world coordinates to the coordinates of the space; a `CellSet` is unchanged.

    `frame`: transformation from the coordinates of the space to the world.  Raises InputError for a shape with three
    coordinates if the two coordinate systems differ.
    """
    if frame.is_world or isinstance(shape, CellSet):  # a map's cells have these coordinates already
        return shape
    if shape.ndim != 2:
        raise InputError(
            "a region of (x, y, heading) is not possible on a rotated map; give a point (x, y, heading), or a shape in "
            "the plane"
        )
    match shape:
        case Box(lower, upper):
            # A box without width would get coinciding corners, or crossing edges, by rounding.
            least = 64 * float(np.spacing(max(map(abs, (*lower, *upper, frame.x, frame.y)))))
            upper = tuple(max(low + least, high) for low, high in zip(lower, upper, strict=True))
            corners = (lower, (upper[0], lower[1]), upper, (lower[0], upper[1]))
            return Polygon(_ring(corners, frame))
        case Ball(centre, radius):
            return Ball(_ring((centre,), frame)[0], radius)
        case Polygon(vertices, holes):
            return Polygon(_ring(vertices, frame), tuple(_ring(hole, frame) for hole in holes))
        case HalfSpace(normal, offset):
            rotated = np.asarray(Frame(yaw=frame.yaw).from_world(normal)).tolist() if frame.yaw else list(normal)
            return HalfSpace(tuple(rotated), offset - normal[0] * frame.x - normal[1] * frame.y)
    raise AssertionError("other shapes have three coordinates")


def _ring(points: tuple[Point, ...], frame: Frame) -> tuple[Point, ...]:
    return tuple(tuple(point) for point in np.asarray(frame.from_world(points)).tolist())
