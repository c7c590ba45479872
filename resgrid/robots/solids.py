"""Obstacles of the plane, as geometry for shapely and as plain arrays for compiled loops."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.robots.polygons import edges_of
from resgrid.robots.shapes import Ball, Box, CellSet, HalfSpace, Polygon, Shape, as_polygon

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

FAR = 1e4
"""Half-planes are drawn this far, in the unit of the workspace."""


class Solids(NamedTuple):
    """Polygons, discs and half-planes of the workspace, as arrays.

    `edges` (e, 4): edges ``x0, y0, x1, y1`` of all polygons, one polygon after the other; `first_edge` (p + 1,):
    where each polygon's edges start; `bounds` (p, 4): smallest ``x, y`` and largest ``x, y`` of each polygon; `discs`
    (d, 3): centre and radius; `half_planes` (h, 3): unit normal out of the solid, and offset.
    """

    edges: NDArray[np.float64]
    first_edge: NDArray[np.int64]
    bounds: NDArray[np.float64]
    discs: NDArray[np.float64]
    half_planes: NDArray[np.float64]


def solids(shapes: Sequence[Shape], whose: str) -> Solids:
    """Shapes of the plane as arrays."""
    polygons, discs, half_planes = [], [], []
    for shape in shapes:
        match require_plane(shape, whose):
            case Box() | Polygon() as solid:
                polygons.append(edges_of(as_polygon(solid).rings))
            case Ball(centre, radius):
                discs.append((*centre, radius))
            case HalfSpace(normal, offset):
                length = hypot(*normal)
                half_planes.append((normal[0] / length, normal[1] / length, offset / length))
    edges = np.concatenate([np.empty((0, 4)), *polygons])
    first = np.cumsum([0, *(len(each) for each in polygons)])
    bounds = [(each[:, 0].min(), each[:, 1].min(), each[:, 0].max(), each[:, 1].max()) for each in polygons]
    return Solids(
        edges,
        np.asarray(first, dtype=np.int64),
        np.array(bounds, dtype=np.float64).reshape(-1, 4),
        np.array(discs, dtype=np.float64).reshape(-1, 3),
        np.array(half_planes, dtype=np.float64).reshape(-1, 3),
    )


def require_plane(shape: Shape, whose: str) -> Box | Ball | Polygon | HalfSpace:
    """The shape, if it is one of the plane."""
    if isinstance(shape, CellSet):
        raise InputError(f"{whose} moves among shapes, not among the cells of a map; describe the obstacles as shapes")
    if shape.ndim != 2:
        raise InputError(f"{whose} moves in the plane: a shape needs 2 coordinates, got {shape.ndim}")
    return shape


def to_shapely(shape: Shape) -> BaseGeometry:
    """A shape of the plane as shapely geometry."""
    import shapely

    if isinstance(shape, CellSet) or shape.ndim != 2:
        raise InputError(f"geometry is known of shapes of the plane alone, not of this {type(shape).__name__}")
    match shape:
        case Box((x0, y0), (x1, y1)):
            return shapely.MultiPoint(((x0, y0), (x1, y0), (x1, y1), (x0, y1))).convex_hull
        case Polygon(vertices, holes):
            return shapely.Polygon(vertices, holes)
        case Ball(centre, radius):
            disc = shapely.Point(centre).buffer(radius, quad_segs=64)
            return shapely.Point(centre) if disc.is_empty else disc
        case HalfSpace(normal, offset):
            length = hypot(*normal)
            out = np.asarray(normal) / length
            along, foot = np.array([-out[1], out[0]]), out * (offset / length)
            corners = [foot - FAR * along, foot + FAR * along, foot + FAR * (along - out), foot - FAR * (along + out)]
            return shapely.Polygon(corners)
    raise AssertionError(f"a {type(shape).__name__} is no shape of the plane")
