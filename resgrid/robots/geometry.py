"""Robots and obstacles of the plane as shapely geometry and as arrays for compiled kernels; periodic images of shapes.

A link with a width is a segment with a radius, and a disc is a point with a radius.  Distances are therefore exact and
not affected by polygons that approximate circles.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from math import ceil, floor, hypot, isinf, prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import with_article
from resgrid.core.axis import Axis
from resgrid.errors import InputError
from resgrid.robots.bounded import Bounds
from resgrid.robots.shapes import Ball, Box, CellSet, HalfSpace, Polygon, Shape, SingleShape, rings_of, to_shapely
from resgrid.robots.voxels import Voxels

TOUCH = 1e-9
"""Largest penetration depth that counts as touching for a round body or half-plane, relative to 1 m plus the radii of
obstacle and robot part."""

MAX_IMAGES = 1000
"""Maximum number of periodic images of a shape (copies translated by multiples of the periods); more raise InputError.
"""


class ArmLinks(NamedTuple):
    """A planar arm as arrays, input of the kernels.

    `lengths, radii` (n,): length and half width of every link, in metres; `base` (3,): x and y of the base in metres,
    and direction of joint angle 0 in radians; `relative`: whether joint angles are measured from the previous link
    instead of the base direction.
    """

    lengths: NDArray[np.float64]
    radii: NDArray[np.float64]
    base: NDArray[np.float64]
    relative: bool


@dataclass(frozen=True, eq=False)
class RigidPart:
    """A rigid part of a robot in n configurations: all points within a radius of a geometry, the core.

    `core` (n,): shapely geometry of the core in every configuration, in metres; `radius`: in metres.
    """

    core: NDArray[Any]
    radius: float


@dataclass(frozen=True, eq=False)
class Obstacle:
    """An obstacle, or a periodic image of one: all points within a radius of a geometry (the core), or a half-plane.

    `number`: index of the obstacle in the scene; `core`: shapely geometry in metres, None for a half-plane; `radius`:
    in metres, 0 for a half-plane; `half_plane`: the half-plane, None for other obstacles.
    """

    number: int
    core: Any
    radius: float = 0.0
    half_plane: HalfSpace | None = None

    @property
    def extent(self) -> float:
        """Largest absolute coordinate of the core, or distance of the half-plane's border from the origin, in metres.

        Rounding errors of distances from the obstacle are proportional to this length.
        """
        if self.half_plane is not None:
            return float(abs(_unit_normal(self.half_plane)[-1]))
        return float(np.abs(self.core.bounds).max())

    def core_distance(self, part: RigidPart) -> NDArray[np.float64]:
        """Return distances (n,), in metres, from a part's n cores to the core or half-plane, without the radii.

        The distance is 0 if the cores intersect, and negative inside a half-plane.
        """
        import shapely

        if self.half_plane is None:
            return np.asarray(shapely.distance(part.core, self.core))
        *normal, offset = _unit_normal(self.half_plane)
        points, owner = shapely.get_coordinates(part.core, return_index=True)
        height = points @ normal - offset
        lowest = np.full(len(part.core), np.inf)
        np.minimum.at(lowest, owner, height)
        return lowest

    def distance(self, part: RigidPart) -> NDArray[np.float64]:
        """Return the distances (n,), in metres, of a part in n configurations from the obstacle; 0 at intersections."""
        return np.maximum(self.core_distance(part) - self.radius - part.radius, 0.0)

    def collides(self, part: RigidPart) -> NDArray[np.bool_]:
        """Return the mask (n,) of configurations in which a part penetrates the obstacle; touching does not count."""
        import shapely

        within = self.radius + part.radius
        if self.half_plane is not None or within > 0:
            return self.core_distance(part) < within - TOUCH * (1.0 + within)
        near = np.asarray(shapely.intersects(part.core, self.core))
        near[near] = ~shapely.touches(part.core[near], self.core)
        return near


def obstacles_of(shapes: Iterable[Shape], axes: Sequence[Axis] = ()) -> list[Obstacle]:
    """Return shapes of the plane as obstacles for distance computations.

    `axes`: axes of the plane, empty for a plane that is not periodic.  On periodic axes, a shape gives one obstacle for
    every periodic image that may contain the point nearest to a robot in the grid.
    """
    return [obstacle for number, shape in enumerate(shapes) for obstacle in _obstacles(number, shape, axes)]


def _obstacles(number: int, shape: Shape, axes: Sequence[Axis]) -> list[Obstacle]:
    """Return the periodic images of the shape with index `number` as obstacles; an empty list for an empty shape.

    `axes`: axes of the plane, empty for a plane that is not periodic.
    """
    import shapely

    if not isinstance(shape, Shape) or shape.ndim != 2:
        raise InputError(
            f"obstacle {number}: collision tests need shapes of the plane, not {with_article(type(shape).__name__)}"
        )
    if isinstance(shape, HalfSpace):
        return [Obstacle(number, None, 0.0, half_plane) for half_plane in periodic_images(shape, axes, ())]  # type: ignore[arg-type]
    core = shapely.Point(shape.centre) if isinstance(shape, Ball) else to_shapely(shape)
    if core.is_empty:
        return []
    half = [(axis.upper - axis.lower) / 2 for axis in axes]
    cores = [_translated(core, by) for by in periodic_shifts((core.bounds[:2], core.bounds[2:]), axes, half)]
    shapely.prepare(cores)
    return [Obstacle(number, image, shape.radius if isinstance(shape, Ball) else 0.0) for image in cores]


def _translated(core: Any, by: tuple[float, ...]) -> Any:
    """Return the shapely geometry `core` translated by the vector `by`."""
    import shapely

    return shapely.transform(core, lambda points: points + by) if any(by) else core


class ObstacleArrays(NamedTuple):
    """Polygons, discs and half-planes as arrays in metres, the input of compiled kernels.

    `edges` (e, 4): ``x0, y0, x1, y1``, polygon by polygon, with the solid on the left; `edge_before` (e,): index of the
    preceding edge in the ring; `first_edge` (p + 1,): index of each polygon's first edge, followed by the number e of
    edges; `bounds` (p, 4): smallest ``x, y`` and largest ``x, y`` of each polygon; `discs` (d, 3): centre and radius;
    `half_planes` (h, 3): unit normal ``n`` out of the solid ``n @ x <= d``, and ``d``; `edge_owner` (e,), `disc_owner`
    (d,), `half_plane_owner` (h,): index of the obstacle that the edge, disc or half-plane belongs to.
    """

    edges: NDArray[np.float64]
    edge_before: NDArray[np.int64]
    edge_owner: NDArray[np.int64]
    first_edge: NDArray[np.int64]
    bounds: NDArray[np.float64]
    discs: NDArray[np.float64]
    disc_owner: NDArray[np.int64]
    half_planes: NDArray[np.float64]
    half_plane_owner: NDArray[np.int64]


def obstacle_arrays(shapes: Iterable[Shape], axes: Sequence[Axis] = ()) -> ObstacleArrays:
    """Return shapes of the plane as arrays, for kernels; a set of cells becomes boxes, voxels (in space) are left out.

    `axes`: axes of the plane, empty for a plane that is not periodic.  On periodic axes, the arrays contain all
    periodic images of a shape that come within one period of the grid.
    """
    period = [axis.upper - axis.lower for axis in axes]
    solids = [
        (number, solid)
        for number, shape in enumerate(shapes)
        for piece in (shape.boxes() if isinstance(shape, CellSet) else [] if isinstance(shape, Voxels) else [shape])
        for solid in periodic_images(piece, axes, period)
    ]
    polygons = [(number, _solid_on_the_left(solid)) for number, solid in solids if isinstance(solid, Box | Polygon)]
    discs = [(number, *solid.centre, solid.radius) for number, solid in solids if isinstance(solid, Ball)]
    half_planes = [(number, *_unit_normal(solid)) for number, solid in solids if isinstance(solid, HalfSpace)]
    edges = [edges_of(rings) for _, rings in polygons]
    sizes = [len(ring) for _, rings in polygons for ring in rings]
    before = [first + np.roll(np.arange(size), 1) for first, size in zip(np.cumsum([0, *sizes]), sizes, strict=False)]
    bounds = [[*each[:, :2].min(axis=0), *each[:, :2].max(axis=0)] for each in edges]
    table_of_discs, table_of_half_planes = (np.array(rows, np.float64).reshape(-1, 4) for rows in (discs, half_planes))
    return ObstacleArrays(
        edges=np.concatenate([np.empty((0, 4)), *edges]),
        edge_before=np.concatenate([np.empty(0, np.int64), *before]),
        edge_owner=np.repeat(np.array([number for number, _ in polygons], np.int64), [len(each) for each in edges]),
        first_edge=np.cumsum([0, *map(len, edges)], dtype=np.int64),
        bounds=np.array(bounds, np.float64).reshape(-1, 4),
        discs=table_of_discs[:, 1:].copy(),
        disc_owner=table_of_discs[:, 0].astype(np.int64),
        half_planes=table_of_half_planes[:, 1:].copy(),
        half_plane_owner=table_of_half_planes[:, 0].astype(np.int64),
    )


def edges_of(rings: Iterable[ArrayLike]) -> NDArray[np.float64]:
    """Return the edges ``x0, y0, x1, y1`` of closed rings, shape (e, 4); `rings`: corners (n, 2) of each ring."""
    corners = [np.asarray(ring, dtype=np.float64) for ring in rings]
    return np.concatenate([np.hstack([ring, np.roll(ring, -1, axis=0)]) for ring in corners])


def _unit_normal(half_plane: HalfSpace) -> NDArray[np.float64]:
    """Return the unit normal ``n`` of a half-space ``n @ x <= d``, followed by ``d`` in metres, shape (ndim + 1,)."""
    return np.array([*half_plane.normal, half_plane.offset]) / hypot(*half_plane.normal)


def _solid_on_the_left(solid: Box | Polygon) -> list[list[tuple[float, ...]]]:
    """Return the rings of a solid as lists of corners (x, y), with the outer ring anticlockwise and holes clockwise.

    Consecutive equal corners are removed.
    """
    if isinstance(solid, Box):
        return [[*rings_of(solid)[0][1:], rings_of(solid)[0][0]]]
    import shapely

    oriented = shapely.geometry.polygon.orient(shapely.Polygon(solid.vertices, solid.holes))
    rings = [list(ring.coords) for ring in (oriented.exterior, *oriented.interiors)]
    return [[b for a, b in pairwise(ring) if a != b] for ring in rings]


def periodic_images(shape: SingleShape, axes: Sequence[Axis], reach: Sequence[float]) -> Iterator[SingleShape]:
    """Yield the periodic images of a shape that come within a distance of a grid, and the shape itself if it does.

    A half-space is yielded once, unchanged; raise InputError if its normal has a component along a periodic axis.
    `axes`: axes of the grid; `reach`: distance along each axis, in axis units.
    """
    if isinstance(shape, HalfSpace):
        for axis, component in zip(axes, shape.normal, strict=False):
            if axis.periodic and component != 0:
                raise InputError(
                    f"a half-plane with a normal component along the periodic axis {axis.name!r} would block all of "
                    "it; use a box, or set periodic = false"
                )
        yield shape
        return
    for by in periodic_shifts(shape.bounds, axes, reach):
        yield shape.shifted(by) if any(by) else shape


def periodic_shifts(bounds: Bounds, axes: Sequence[Axis], reach: Sequence[float]) -> Iterator[tuple[float, ...]]:
    """Yield all translations by multiples of the periods that bring a bounding box to within a distance of a grid.

    A component is 0 along an axis that is not periodic.  `bounds`: lower and upper corner of the box; `reach`: distance
    along each axis, in axis units.
    """
    shifts = list(map(_axis_shifts, axes, *bounds, reach))
    if prod(map(len, shifts)) > MAX_IMAGES:
        raise InputError(f"a shape winds around the periodic axes more than {MAX_IMAGES} times; make it smaller")
    yield from product(*shifts)


def _axis_shifts(axis: Axis, lower: float, upper: float, reach: float) -> list[float]:
    """Return the multiples of an axis' period that move the interval [lower, upper] to within `reach` of the axis.

    The result is [0.0] if the axis is not periodic; all lengths are in axis units.
    """
    if not axis.periodic:
        return [0.0]
    period = axis.upper - axis.lower
    first = (axis.lower - upper - reach) / period
    last = (axis.upper - lower + reach) / period
    if isinf(first) or isinf(last) or last - first > MAX_IMAGES:
        raise InputError(
            f"a shape winds around the periodic axis {axis.name!r} more than {MAX_IMAGES} times; make it smaller"
        )
    return [turn * period for turn in range(ceil(first), floor(last) + 1)]


class Pose(NamedTuple):
    """Geometry and differential kinematics of a planar robot in one configuration, for contacts.

    The robot consists of rigid parts; a part consists of segments with a radius.  With the unit vector k out of the
    plane, the velocity of a point ``p`` of part ``m`` for a unit velocity of axis ``a`` is the sum of ``shift[m, a]``
    and ``spin[m, a] k x (p - pivot[m, a])``.

    `segments` (s, 4): ``x0, y0, x1, y1``, in metres; a point is a segment of length 0; `radius` (s,): radius around
    each segment, in metres; `part` (s,): index of the rigid part (the link of an arm) of each segment; `frame` (parts,
    3): origin and direction of each part, in metres and radians; `shift` (parts, ndim, 2): translation velocity, in
    metres per axis unit; `spin` (parts, ndim): rotation rate, in radians per axis unit; `pivot` (parts, ndim, 2):
    centre of rotation, in metres; `lever` (s, 2, parts): upper bound, in metres, of the acceleration of each segment
    end per squared rotation rate of each part, at constant rates of the axes.
    """

    segments: NDArray[np.float64]
    radius: NDArray[np.float64]
    part: NDArray[np.int64]
    frame: NDArray[np.float64]
    shift: NDArray[np.float64]
    spin: NDArray[np.float64]
    pivot: NDArray[np.float64]
    lever: NDArray[np.float64]

    @classmethod
    def of_body(
        cls, segments: NDArray[np.float64], radius: float, place: ArrayLike, turning_length: float | None = None
    ) -> Pose:
        """Return the pose of one rigid body at ``(x, y)`` or ``(x, y, theta)``.

        Parameters
        ----------
        segments : ndarray of float64, shape (s, 4)
            Segments of the body in this configuration, in metres.
        radius : float
            Radius around each segment, in metres.
        place : array_like of float, shape (2,) or (3,)
            Configuration; theta is the heading times the turning length.
        turning_length : float, optional
            Length that corresponds to a rotation by one radian, in metres; None if the body does not turn.

        Returns
        -------
        Pose
            Pose with a single rigid part.
        """
        x, y, *arc = np.asarray(place, dtype=np.float64).tolist()
        count, ndim = len(segments), 2 if turning_length is None else 3
        frame, spin = np.array([[x, y, 0.0]]), np.zeros((1, ndim))
        shift, pivot, lever = np.zeros((1, ndim, 2)), np.zeros((1, ndim, 2)), np.zeros((count, 2, 1))
        shift[0, 0, 0] = shift[0, 1, 1] = 1.0
        if turning_length is not None:
            frame[0, 2], spin[0, 2], pivot[0, 2] = arc[0] / turning_length, 1.0 / turning_length, (x, y)
            lever[:] = np.hypot(*(segments.reshape(-1, 2) - (x, y)).T).max()
        return cls(segments, np.full(count, radius), np.zeros(count, np.int64), frame, shift, spin, pivot, lever)

    def carried(self, point: ArrayLike, part: int, other: Pose) -> NDArray[np.float64]:
        """Return the position (2,), in metres, that a point fixed to a part of the robot has in the pose `other`.

        `point` (2,): position of the point in this pose, in metres; `part`: index of the rigid part.
        """
        x, y, angle = self.frame[part]
        to_x, to_y, to_angle = other.frame[part]
        dx, dy = np.asarray(point, dtype=np.float64) - (x, y)
        cos, sin = np.cos(to_angle - angle), np.sin(to_angle - angle)
        return np.array([to_x + cos * dx - sin * dy, to_y + sin * dx + cos * dy])
