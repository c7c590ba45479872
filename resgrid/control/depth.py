"""How deep a robot is in obstacles, at configurations and between them, by shapely alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.planning.bodies import TOUCH, Body, Part, parts_of
from resgrid.planning.workspace import travel_bound
from resgrid.robots import HalfSpace, Robot

_SPLIT = 4
_LEVELS = 10
_INNER = np.linspace(0.0, 1.0, 17)

Vector = NDArray[np.float64]


def depth_at(robot: Robot, bodies: Sequence[Body], points: Vector) -> Vector:
    """Depth of entry in every configuration, shape (n,), in metres; 0 where nothing is entered by more than a touch."""
    depth = np.zeros(len(points))
    for part in parts_of(robot, points):
        for body in bodies:
            enters = body.collides(part)
            if enters.any():
                core = Part(part.core[enters], 0.0)
                within = part.radius + body.radius
                apart = Body(body.number, body.core, 0.0, body.half_plane).distance(core)
                entry = np.where(apart > 0.0, within - apart, within + _core_depth(core.core, body))
                depth[enters] = np.maximum(depth[enters], np.where(entry > TOUCH * (1.0 + within), entry, 0.0))
    return depth


def _core_depth(cores: NDArray[Any], body: Body) -> Vector:
    """How far from the border of an obstacle's core a core that meets it gets, where it is looked at, shape (n,)."""
    import shapely

    if body.half_plane is not None:
        return _behind(cores, body.half_plane)
    depth = np.zeros(len(cores))
    for number, core in enumerate(cores):
        common = shapely.intersection(core, body.core)
        coordinates = shapely.get_coordinates(common)
        if not len(coordinates):
            continue
        border = shapely.boundary(body.core)
        target = body.core if shapely.is_empty(border) else border
        between = coordinates[:-1, None] + _INNER[:, None] * np.diff(coordinates, axis=0)[:, None]
        looked = np.concatenate([coordinates, between.reshape(-1, 2)])
        depth[number] = float(shapely.distance(shapely.points(looked), target).max())
    return depth


def _behind(cores: NDArray[Any], half_plane: HalfSpace) -> Vector:
    import shapely

    points, owner = shapely.get_coordinates(cores, return_index=True)
    height = (points @ np.asarray(half_plane.normal) - half_plane.offset) / np.linalg.norm(half_plane.normal)
    deepest = np.zeros(len(cores))
    np.maximum.at(deepest, owner, -height)
    return deepest


def depth_along(robot: Robot, bodies: Sequence[Body], way: Vector, own: Any) -> float:
    """Deepest entry on the straight lines between configurations, in metres.

    A line is free for sure where no point of the robot moves farther on it than the gaps at both of its ends allow
    together; others are cut in four until they are, ten times at most, or twice if something was entered.

    Shapes: `way` (n, ndim).
    """
    deepest = float(depth_at(robot, bodies, own(way)).max(initial=0.0))
    begin, end = way[:-1], way[1:]
    moves = np.any(begin != end, axis=1)
    begin, end = begin[moves], end[moves]
    for level in range(_LEVELS + 1):
        if not len(begin):
            break
        travel = travel_bound(robot, begin, end)
        reach = float(travel.max())
        first, last = _gaps(robot, bodies, own(begin), reach), _gaps(robot, bodies, own(end), reach)
        open_ = travel > first + last
        if level == _LEVELS or not open_.any() or (deepest > 0.0 and level > 1):
            break
        shares = np.linspace(0.0, 1.0, _SPLIT + 1)[:, None, None]
        stations = begin[open_] + shares * (end[open_] - begin[open_])
        between = stations[1:-1].reshape(-1, way.shape[1])
        deepest = max(deepest, float(depth_at(robot, bodies, own(between)).max(initial=0.0)))
        begin, end = stations[:-1].reshape(-1, way.shape[1]), stations[1:].reshape(-1, way.shape[1])
    return deepest


def _gaps(robot: Robot, bodies: Sequence[Body], points: Vector, reach: float) -> Vector:
    """Distance from the nearest obstacle in every configuration, as far as the reach, shape (n,)."""
    import shapely

    gaps = np.full(len(points), reach)
    for part in parts_of(robot, points):
        for body in bodies:
            near = np.ones(len(points), dtype=np.bool_)
            if body.half_plane is None:
                near = np.asarray(shapely.dwithin(part.core, body.core, reach + part.radius + body.radius))
            if near.any():
                gaps[near] = np.minimum(gaps[near], body.distance(Part(part.core[near], part.radius)))
    return gaps
