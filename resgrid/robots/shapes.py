"""Shapes of the workspace: closed point sets, in the coordinates of the grid unless somebody says otherwise."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import hypot, inf
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from resgrid._internal.validation import checked
from resgrid._internal.values import brief
from resgrid.core.axis import LARGEST, Axis, Coordinate, Point
from resgrid.core.regions import label_regions
from resgrid.errors import InputError

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

Bounds = tuple[Point, Point]

FAR = 1e4
"""Half-planes are drawn this far, in the unit of the workspace."""


class _Bounded(ABC):
    """A shape that knows its bounds."""

    @property
    @abstractmethod
    def bounds(self) -> Bounds:
        """Lower and upper corner of the smallest box around the shape."""

    @property
    def ndim(self) -> int:
        """Number of coordinates."""
        return len(self.bounds[0])


@checked
@dataclass(frozen=True)
class Box(_Bounded):
    """A rectangle (two coordinates) or box (any number), sides along the axes.

    Parameters
    ----------
    lower, upper : tuple of float
        Opposite corners, in axis units; ``lower <= upper`` in every coordinate.

    Raises
    ------
    InputError
        If a coordinate is not finite, or ``lower`` is above ``upper``.

    Examples
    --------
    >>> rg.Box((0.0, 0.0), (2.0, 1.0)).shifted((1.0, 0.0)).bounds
    ((1.0, 0.0), (3.0, 1.0))
    """

    lower: Point
    upper: Point

    def __post_init__(self) -> None:
        if len(self.lower) != len(self.upper) or not len(self.lower):
            raise InputError(f"a box needs as many lower as upper coordinates, got {self.lower} and {self.upper}")
        if any(low > high for low, high in zip(self.lower, self.upper, strict=True)):
            raise InputError(f"a box needs lower <= upper in every coordinate, got {self.lower} and {self.upper}")

    @property
    def bounds(self) -> Bounds:
        """Lower and upper corner of the smallest box around the shape."""
        return self.lower, self.upper

    def shifted(self, by: Point) -> Box:
        """The same shape, moved."""
        return Box(_add(self.lower, by), _add(self.upper, by))


@checked
@dataclass(frozen=True)
class Ball(_Bounded):
    """A disc (two coordinates) or ball (any number).

    Parameters
    ----------
    centre : tuple of float
        In axis units.
    radius : float
        At least 0, in axis units.

    Raises
    ------
    InputError
        If a number is not finite, or the radius is negative.

    Examples
    --------
    >>> rg.Ball((1.0, 2.0), 0.5).shifted((1.0, 0.0)).bounds
    ((1.5, 1.5), (2.5, 2.5))
    """

    centre: Point
    radius: Annotated[float, Ge(0), Le(LARGEST)]

    @property
    def bounds(self) -> Bounds:
        """Lower and upper corner of the smallest box around the shape."""
        return tuple(c - self.radius for c in self.centre), tuple(c + self.radius for c in self.centre)

    def shifted(self, by: Point) -> Ball:
        """The same shape, moved."""
        return Ball(_add(self.centre, by), self.radius)


@checked
@brief
@dataclass(frozen=True)
class Polygon(_Bounded):
    """A simple polygon in the plane, with holes if need be.

    Parameters
    ----------
    vertices : tuple of (float, float)
        The outer ring, at least three corners, in either sense; the last joins the first.
    holes : tuple of rings
        Rings inside the outer one that are not part of the polygon.

    Raises
    ------
    InputError
        If a ring has fewer than three corners, crosses itself, or a hole sticks out.

    Examples
    --------
    >>> yard = rg.Polygon(((0, 0), (4, 0), (4, 3), (0, 3)), holes=(((1, 1), (2, 1), (2, 2)),))
    >>> yard.bounds
    ((0, 0), (4, 3))
    """

    vertices: tuple[Point, ...]
    holes: tuple[tuple[Point, ...], ...] = ()

    def __post_init__(self) -> None:
        for ring in self.rings:
            if len(ring) < 3 or any(len(point) != 2 for point in ring):
                raise InputError("a polygon needs at least three corners [x, y] in every ring")
        import shapely

        outline = shapely.Polygon(self.vertices, self.holes)
        if not outline.is_valid:
            raise InputError(f"the polygon is not simple: {shapely.is_valid_reason(outline)}")

    @property
    def rings(self) -> tuple[tuple[Point, ...], ...]:
        """The outer ring and the holes."""
        return (self.vertices, *self.holes)

    @property
    def bounds(self) -> Bounds:
        """Lower and upper corner of the smallest box around the shape."""
        x, y = zip(*self.vertices, strict=True)
        return (min(x), min(y)), (max(x), max(y))

    def shifted(self, by: Point) -> Polygon:
        """The same shape, moved."""
        vertices, *holes = (tuple(_add(point, by) for point in ring) for ring in self.rings)
        return Polygon(vertices, tuple(holes))


@checked
@dataclass(frozen=True)
class HalfSpace(_Bounded):
    """All points where ``normal @ x <= offset``: the normal points out of the solid, into the free side.

    Parameters
    ----------
    normal : tuple of float
        Not zero; need not have length 1.
    offset : float
        In the units of ``normal @ x``.

    Raises
    ------
    InputError
        If a number is not finite, or the normal is zero.

    Examples
    --------
    >>> floor = rg.HalfSpace(normal=(0.0, 1.0), offset=0.5)
    >>> axes = (rg.Axis("x", 0.0, 2.0, 2), rg.Axis("y", 0.0, 2.0, 4))
    >>> rg.build_space(rg.Scene(axes, obstacles=(floor,), goals=(rg.GoalCell((0, 3)),))).cell
    array([[1, 0, 0, 2],
           [1, 0, 0, 0]], dtype=uint8)
    """

    normal: Point
    offset: Coordinate

    def __post_init__(self) -> None:
        if not any(abs(float(part)) >= 1 / LARGEST for part in self.normal):
            raise InputError("a half-plane needs a normal that is not zero")

    @property
    def bounds(self) -> Bounds:
        """Lower and upper corner of the smallest box around the shape: infinite."""
        return (-inf,) * len(self.normal), (inf,) * len(self.normal)


@dataclass(frozen=True, eq=False)
class CellSet(_Bounded):
    """The union of marked cells of a grid, each a closed box.

    `axes`: the grid; `mask`: one entry per cell.
    """

    axes: tuple[Axis, ...]
    mask: NDArray[np.bool_]

    def __post_init__(self) -> None:
        if self.mask.shape != tuple(axis.cells for axis in self.axes):
            raise InputError(f"a mask of shape {self.mask.shape} does not fit its axes")

    @property
    def bounds(self) -> Bounds:
        """Lower and upper corner of the grid."""
        return tuple(axis.lower for axis in self.axes), tuple(axis.upper for axis in self.axes)

    def boxes(self) -> list[Box]:
        """Marked cells of a plane as boxes, one for each run of neighbours along the second axis."""
        x, y = self.axes
        column, first, last = _runs(self.mask)
        corners = np.column_stack([x.edges[column], y.edges[first], x.edges[column + 1], y.edges[last]]).tolist()
        return [Box((x0, y0), (x1, y1)) for x0, y0, x1, y1 in corners]

    def borders(self) -> NDArray[np.float64]:
        """Edges between marked cells of a plane and others, joined along straight lines.  Returns (e, 4)."""
        edges = []
        for mask, (across, along), columns in (
            (self.mask, self.axes, [0, 1, 2, 3]), (self.mask.T, self.axes[::-1], [1, 0, 3, 2])
        ):  # fmt: skip
            line, first, last = _runs(np.diff(mask, axis=0, prepend=False, append=False))
            at = across.edges[line]
            edges.append(np.column_stack([at, along.edges[first], at, along.edges[last]])[:, columns])
        return np.concatenate(edges)

    def places(self) -> NDArray[np.float64]:
        """Centre of a cell of every connected piece of marked cells of a plane.  Returns (p, 2)."""
        pieces = label_regions(self.mask, periodic=False)
        count = int(pieces.max(initial=0))
        _, first = np.unique(pieces, return_index=True)
        cells = np.unravel_index(first[-count:] if count else first[:0], self.mask.shape)
        return np.column_stack([axis.centres[index] for axis, index in zip(self.axes, cells, strict=True)])


def _runs(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Row, first and past-the-last entry of every run of marked entries along the second axis of a mask."""
    flips = np.diff(mask.astype(np.int8), axis=1, prepend=0, append=0)
    row, first = np.nonzero(flips > 0)
    _, last = np.nonzero(flips < 0)
    return row, first, last


Solid = Box | Ball | Polygon | HalfSpace
Shape = Solid | CellSet


def rings_of(shape: Box | Polygon) -> tuple[tuple[Point, ...], ...]:
    """Outer ring and holes of a polygon, or of a box of the plane, which is made at least four rounding errors wide."""
    if isinstance(shape, Polygon):
        return shape.rings
    (x0, y0), (x1, y1) = shape.lower, shape.upper
    x1 = max(x1, x0 + 4 * float(np.spacing(max(abs(x0), abs(x1), 1e-9))))
    y1 = max(y1, y0 + 4 * float(np.spacing(max(abs(y0), abs(y1), 1e-9))))
    return (((x0, y0), (x1, y0), (x1, y1), (x0, y1)),)


def require_plane(shape: Shape, whose: str) -> Shape:
    """The shape, if it is one of the plane."""
    if shape.ndim != 2:
        raise InputError(f"{whose} moves in the plane: a shape needs 2 coordinates, got {shape.ndim}")
    return shape


def to_shapely(shape: Shape) -> BaseGeometry:
    """A shape of the plane as shapely geometry; a disc as a polygon of 256 edges, a half-plane cut off far away."""
    import shapely

    if shape.ndim != 2:
        raise InputError(f"geometry is known of shapes of the plane alone, not of this {type(shape).__name__}")
    match shape:
        case CellSet():
            corners = np.array([(*box.lower, *box.upper) for box in shape.boxes()]).reshape(-1, 4)
            return shapely.union_all(shapely.box(*corners.T))
        case Box(lower, upper):
            (x0, y0), (x1, y1) = lower, upper
            return shapely.MultiPoint(((x0, y0), (x1, y0), (x1, y1), (x0, y1))).convex_hull
        case Polygon(vertices, holes):
            return shapely.Polygon(vertices, holes)
        case Ball(centre, radius):
            disc = shapely.Point(centre).buffer(radius, quad_segs=64)
            return shapely.Point(centre) if disc.is_empty else disc
    length = hypot(*shape.normal)
    out = np.asarray(shape.normal) / length
    along, foot = np.array([-out[1], out[0]]), out * (shape.offset / length)
    return shapely.Polygon(
        [foot - FAR * along, foot + FAR * along, foot + FAR * (along - out), foot - FAR * (along + out)]
    )


def _add(point: Point, by: Point) -> Point:
    return tuple(a + b for a, b in zip(point, by, strict=True))
