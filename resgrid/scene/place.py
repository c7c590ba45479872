"""Points and shapes of the world, brought into the coordinates of the space."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from resgrid.errors import InputError
from resgrid.frame import Frame
from resgrid.robots import Ball, Box, CellSet, HalfSpace, Polygon, Shape
from resgrid.robots.shapes import Point
from resgrid.space import Axis


def located(axes: tuple[Axis, ...], frame: Frame, point: Point, key: str) -> tuple[int, ...]:
    """Cell that a point of the world lies in.

    Parameters
    ----------
    axes : tuple of Axis
        The grid.
    frame : Frame
        From space to world coordinates.
    point : tuple of float
        World coordinates.
    key : str
        What the point is, for the message.

    Returns
    -------
    tuple of int

    Raises
    ------
    InputError
        If the point lies outside the grid.
    """
    index = []
    inside = np.asarray(frame.from_world(point)).tolist()
    for axis, value in zip(axes, inside, strict=True):
        scaled = (value - axis.lower) / axis.spacing
        scaled = scaled % axis.cells if axis.periodic else scaled
        if not 0 <= scaled <= axis.cells:
            turned = "" if frame.is_world else f", which is {[round(v, 6) for v in inside]} in the map's frame,"
            extent = ", ".join(f"{each.name} in [{each.lower:g}, {each.upper:g}]" for each in axes)
            raise InputError(f"{key}: the point {list(point)}{turned} lies outside the grid ({extent}); move it inside")
        index.append(min(int(scaled), axis.cells - 1))
    return tuple(index)


def to_space(shape: Shape, frame: Frame) -> Shape:
    """A shape of the world in the coordinates of the space.

    Parameters
    ----------
    shape : Shape
        In world coordinates.
    frame : Frame
        From space to world coordinates.

    Returns
    -------
    Shape
        The same point set; a rectangle becomes a polygon where the frame is turned.

    Raises
    ------
    InputError
        If the frame is turned and the shape is not one of the plane.
    """
    if frame.is_world:
        return shape
    match shape:
        case Box(lower, upper):
            corners = (lower, (upper[0], lower[1]), upper, (lower[0], upper[1]))
            return Polygon(_ring(corners, frame))
        case Ball(centre, radius):
            return Ball(_ring((centre,), frame)[0], radius)
        case Polygon(vertices, holes):
            return Polygon(_ring(vertices, frame), tuple(_ring(hole, frame) for hole in holes))
        case HalfSpace(normal, offset):
            turned = np.asarray(Frame(yaw=frame.yaw).from_world(normal)).tolist() if frame.yaw else list(normal)
            return HalfSpace(tuple(turned), offset - normal[0] * frame.x - normal[1] * frame.y)
    raise InputError("the cells of a map cannot be moved to another frame")


def along_axes(obstacles: Sequence[Shape], frame: Frame) -> tuple[Shape, ...]:
    """Obstacles of the world in the coordinates of the space, where the cells of a map lie already; see `to_space`."""
    return tuple(shape if isinstance(shape, CellSet) else to_space(shape, frame) for shape in obstacles)


def _ring(points: tuple[Point, ...], frame: Frame) -> tuple[Point, ...]:
    return tuple(tuple(point) for point in np.asarray(frame.from_world(points)).tolist())
