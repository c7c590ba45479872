"""Shapes of obstacles and goals: boxes, balls, polygons, half-spaces, cell sets; union types; conversion to shapely."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from resgrid._internal.validation import checked
from resgrid._internal.values import brief
from resgrid.core.axis import LARGEST, Axis, Coordinate, Point
from resgrid.errors import InputError
from resgrid.robots.bounded import Bounded, Bounds, translated
from resgrid.robots.mesh import Mesh
from resgrid.robots.solids import Capsule, Cylinder, OrientedBox
from resgrid.robots.voxels import Voxels

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

FAR = 1e4
"""Half the width along the border, and the depth, of the rectangle that represents a half-plane in shapely, in axis
units."""


@checked
@dataclass(frozen=True)
class Box(Bounded):
    """An axis-aligned rectangle (two coordinates) or box (any number of coordinates).

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
        """Lower and upper corner of the box, in axis units."""
        return self.lower, self.upper

    def shifted(self, by: Point) -> Box:
        """Return the box translated by the vector `by`, in axis units."""
        return Box(translated(self.lower, by), translated(self.upper, by))


@checked
@dataclass(frozen=True)
class Ball(Bounded):
    """A disc (two coordinates) or ball (any number of coordinates).

    Parameters
    ----------
    centre : tuple of float
        Centre, in axis units.
    radius : float
        Radius in axis units, at least 0.

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
        """Lower and upper corner of the ball's bounding box, in axis units."""
        return tuple(c - self.radius for c in self.centre), tuple(c + self.radius for c in self.centre)

    def shifted(self, by: Point) -> Ball:
        """Return the ball translated by the vector `by`, in axis units."""
        return Ball(translated(self.centre, by), self.radius)


@checked
@brief
@dataclass(frozen=True)
class Polygon(Bounded):
    """A simple polygon in the plane, optionally with holes.

    Parameters
    ----------
    vertices : tuple of (float, float)
        Corners of the outer ring in axis units, at least three, clockwise or anticlockwise; the last is connected to
        the first.
    holes : tuple of tuple of (float, float)
        Rings of corners inside the outer ring, whose interiors are not part of the polygon.

    Raises
    ------
    InputError
        If a ring has fewer than three corners or crosses itself, or a hole is not inside the outer ring.

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
        """Corners of the outer ring, followed by the corners of each hole, in axis units."""
        return (self.vertices, *self.holes)

    @property
    def bounds(self) -> Bounds:
        """Lower and upper corner of the polygon's bounding box, in axis units."""
        x, y = zip(*self.vertices, strict=True)
        return (min(x), min(y)), (max(x), max(y))

    def shifted(self, by: Point) -> Polygon:
        """Return the polygon translated by the vector `by`, in axis units."""
        vertices, *holes = (tuple(translated(point, by) for point in ring) for ring in self.rings)
        return Polygon(vertices, tuple(holes))


@checked
@dataclass(frozen=True)
class HalfSpace(Bounded):
    """The half-space ``normal @ x <= offset``; the normal points out of the solid, towards free space.

    Parameters
    ----------
    normal : tuple of float
        Normal vector, not zero; its length is arbitrary.
    offset : float
        Largest value of ``normal @ x`` in the half-space, where x is in axis units.

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
        """Lower and upper corner of the bounding box: minus infinity and infinity in every coordinate."""
        return (-inf,) * len(self.normal), (inf,) * len(self.normal)


@dataclass(frozen=True, eq=False)
class CellSet(Bounded):
    """The union of the marked cells of a grid, each a closed box.

    `axes`: axes of the grid; `mask`: True for marked cells, shape of the grid.
    """

    axes: tuple[Axis, ...]
    mask: NDArray[np.bool_]

    def __post_init__(self) -> None:
        if self.mask.shape != tuple(axis.cells for axis in self.axes):
            raise InputError(f"a mask of shape {self.mask.shape} does not fit its axes")

    @property
    def bounds(self) -> Bounds:
        """Lower and upper corner of the whole grid, in axis units."""
        return tuple(axis.lower for axis in self.axes), tuple(axis.upper for axis in self.axes)

    def boxes(self) -> list[Box]:
        """Return the marked cells of a plane grid as boxes, in axis units; a run along the second axis is one box."""
        x, y = self.axes
        column, first, last = _runs(self.mask)
        corners = np.column_stack([x.edges[column], y.edges[first], x.edges[column + 1], y.edges[last]]).tolist()
        return [Box((x0, y0), (x1, y1)) for x0, y0, x1, y1 in corners]

    def borders(self) -> NDArray[np.float64]:
        """Return the boundary of the set in a plane grid as edges ``x0, y0, x1, y1``, shape (e, 4), in axis units.

        Collinear edges of neighbouring cells are merged.
        """
        edges = []
        for mask, (across, along), columns in (
            (self.mask, self.axes, [0, 1, 2, 3]), (self.mask.T, self.axes[::-1], [1, 0, 3, 2])
        ):  # fmt: skip
            line, first, last = _runs(np.diff(mask, axis=0, prepend=False, append=False))
            at = across.edges[line]
            edges.append(np.column_stack([at, along.edges[first], at, along.edges[last]])[:, columns])
        return np.concatenate(edges)

    def inner_points(self) -> NDArray[np.float64]:
        """Return the centre of one cell of every face-connected piece of the set in a plane grid, shape (pieces, 2)."""
        from scipy.ndimage import label

        pieces, count = label(self.mask)
        _, first = np.unique(pieces, return_index=True)
        cells = np.unravel_index(first[-count:] if count else first[:0], self.mask.shape)
        return np.column_stack([axis.centres[index] for axis, index in zip(self.axes, cells, strict=True)])


def _runs(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return row, first column and end column (exclusive) of every run of True entries in a row.

    Each result has shape (runs,); a run is a maximal sequence of consecutive entries.
    """
    flips = np.diff(mask.astype(np.int8), axis=1, prepend=0, append=0)
    row, first = np.nonzero(flips > 0)
    _, last = np.nonzero(flips < 0)
    return row, first, last


SpaceSolid = Cylinder | Capsule | OrientedBox | Mesh
SingleShape = Box | Ball | Polygon | HalfSpace | SpaceSolid
Shape = SingleShape | CellSet | Voxels


def rings_of(shape: Box | Polygon) -> tuple[tuple[Point, ...], ...]:
    """Return the corners of the outer ring and of the holes of a polygon, or the one ring of a box in the plane.

    A box narrower than four units in the last place (ulp) of its coordinates is widened, so that the ring has an
    interior.
    """
    if isinstance(shape, Polygon):
        return shape.rings
    (x0, y0), (x1, y1) = shape.lower, shape.upper
    x1 = max(x1, x0 + 4 * float(np.spacing(max(abs(x0), abs(x1), 1e-9))))
    y1 = max(y1, y0 + 4 * float(np.spacing(max(abs(y0), abs(y1), 1e-9))))
    return (((x0, y0), (x1, y0), (x1, y1), (x0, y1)),)


def require_plane(shape: Shape, whose: str) -> Shape:
    """Return `shape` itself; raise InputError unless the shape has two coordinates.  `whose`: robot in the message."""
    if shape.ndim != 2:
        raise InputError(f"{whose} moves in the plane: a shape needs 2 coordinates, got {shape.ndim}")
    return shape


def to_shapely(shape: Shape) -> BaseGeometry:
    """Return a shape of the plane as a shapely geometry.

    A disc becomes a polygon with 256 edges.  A half-plane becomes a rectangle with one side on the border, 1e4 axis
    units to both sides of the border point nearest to the origin, and 1e4 axis units deep.
    """
    import shapely

    if shape.ndim != 2 or isinstance(shape, SpaceSolid | Voxels):
        raise InputError(
            f"shapely geometry exists for plane shapes only; this {type(shape).__name__} has {shape.ndim} coordinates"
        )
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
