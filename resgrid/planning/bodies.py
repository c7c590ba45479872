"""Robots and obstacles of the plane as exact geometry, for many configurations at once.

A link with a width is a segment and a radius, a disc is a point and a radius: distances to them are exact, not those to
polygons drawn in place of circles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.robots import Arm, DiscRobot, PointRobot, PolygonRobot, Robot
from resgrid.robots.reach import copies, turns
from resgrid.robots.shapes import Ball, CellSet, HalfSpace, Shape
from resgrid.space import Axis, ConfigurationSpace

TOUCH = 1e-9
"""Depth to which an entered round body or half-plane counts as touched, for each metre (and one more) of radius."""


@dataclass(frozen=True, eq=False)
class Part:
    """A rigid part of a robot in many configurations: all points within a radius of its core.

    `core` (n,).
    """

    core: NDArray[Any]
    radius: float


@dataclass(frozen=True, eq=False)
class Body:
    """An obstacle: all points within a radius of its core, or a half-plane.

    `number`: which obstacle it is, or is a copy of.
    """

    number: int
    core: Any
    radius: float
    half_plane: HalfSpace | None = None

    def distance(self, part: Part) -> NDArray[np.float64]:
        """Distance from a part in every configuration, shape (n,); 0 where they meet."""
        import shapely

        if self.half_plane is None:
            apart = shapely.distance(part.core, self.core)
        else:
            normal = np.asarray(self.half_plane.normal)
            points, owner = shapely.get_coordinates(part.core, return_index=True)
            height = (points @ normal - self.half_plane.offset) / np.linalg.norm(normal)
            apart = np.full(len(part.core), np.inf)
            np.minimum.at(apart, owner, height)
        return np.maximum(apart - self.radius - part.radius, 0.0)

    def collides(self, part: Part) -> NDArray[np.bool_]:
        """Whether a part enters it, shape (n,); a mere touch is no collision."""
        import shapely

        if self.half_plane is None and self.radius == part.radius == 0:
            near = np.asarray(shapely.intersects(part.core, self.core))
            near[near] = ~shapely.touches(part.core[near], self.core)
            return near
        within = self.radius + part.radius
        grown = Body(self.number, self.core, 0.0, self.half_plane)
        if self.half_plane is None:
            return np.asarray(grown.distance(Part(part.core, 0.0)) < within - TOUCH * (1.0 + within))
        return np.asarray(self._deeper_than(part, TOUCH * (1.0 + within)))

    def _deeper_than(self, part: Part, depth: float) -> NDArray[np.bool_]:
        assert self.half_plane is not None
        moved = HalfSpace(
            self.half_plane.normal,
            self.half_plane.offset + (part.radius - depth) * float(np.linalg.norm(self.half_plane.normal)),
        )
        return Body(self.number, None, 0.0, moved).distance(Part(part.core, 0.0)) <= 0.0


def parts_of(robot: Robot, configurations: NDArray[np.float64]) -> list[Part]:
    """The rigid parts of a robot in many configurations.  Shapes: `configurations` (n, ndim)."""
    import shapely

    match robot:
        case Arm():
            places = robot.joints(configurations)
            return [
                Part(np.asarray(shapely.linestrings(places[:, link : link + 2])), width / 2)
                for link, width in enumerate(robot.widths)
            ]
        case PolygonRobot():
            return [Part(np.asarray(shapely.polygons(robot.corners(configurations))), 0.0)]
        case PointRobot() | DiscRobot():
            if configurations.shape[1] != 2:
                raise InputError(f"geometry is known in the plane alone, not with {configurations.shape[1]} axes")
            return [Part(np.asarray(shapely.points(configurations)), robot.radius)]
    raise InputError(f"the geometry of a {type(robot).__name__} is not known: arm, polygon, disc and point are")


def bodies_of(obstacles: Sequence[Shape], robot: Robot, space: ConfigurationSpace | None) -> list[Body]:
    """Obstacles as geometry; for a robot whose space is the workspace, with copies across periodic seams."""
    axes: tuple[Axis, ...] = ()
    if space is not None and space.ndim == 2 and isinstance(robot, PointRobot | DiscRobot):
        axes = space.axes
    return [body for number, shape in enumerate(obstacles) for body in _bodies(number, shape, axes)]


def _bodies(number: int, shape: Shape, axes: tuple[Axis, ...]) -> list[Body]:
    """An obstacle, as often as some point of the axes may be nearest to it across a seam."""
    import shapely

    from resgrid.robots.solids import to_shapely

    if not isinstance(shape, Shape) or shape.ndim != 2:
        raise InputError(
            f"obstacle {number}: geometry is known of shapes of the plane alone, not of a {type(shape).__name__}"
        )
    if isinstance(shape, HalfSpace):
        return [Body(number, None, 0.0, shape) for _ in (copies(shape, axes, 0.0) if axes else [shape])]
    radius = shape.radius if isinstance(shape, Ball) else 0.0
    if isinstance(shape, Ball):
        core: Any = shapely.Point(shape.centre)
    else:
        core = _union_of_cells(shape) if isinstance(shape, CellSet) else to_shapely(shape)
    if core.is_empty:
        return []
    bounds = core.bounds[:2], core.bounds[2:]
    half = [(axis.upper - axis.lower) / 2 for axis in axes]
    cores = [_moved(core, by) for by in turns(bounds, axes, half)]
    shapely.prepare(cores)
    return [Body(number, copy, radius) for copy in cores]


def _moved(core: Any, by: tuple[float, ...]) -> Any:
    import shapely

    return shapely.transform(core, lambda points: points + by) if any(by) else core


def _union_of_cells(cells: CellSet) -> Any:
    """Marked cells as one geometry, joined run by run first."""
    import shapely

    x, y = cells.axes
    flips = np.diff(cells.mask.astype(np.int8), axis=1, prepend=0, append=0)
    column, first = np.nonzero(flips > 0)
    _, last = np.nonzero(flips < 0)
    return shapely.union_all(shapely.box(x.edges[column], y.edges[first], x.edges[column + 1], y.edges[last]))
