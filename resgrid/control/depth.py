"""How deep a robot is in obstacles, at configurations and between them, by shapely alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.robots import Part, Robot
from resgrid.robots.geometry import TOUCH, Obstacle

_SPLIT = 4
_LEVELS = 10
_INNER = np.linspace(0.0, 1.0, 17)

Vector = NDArray[np.float64]


def depth_at(robot: Robot, obstacles: Sequence[Obstacle], points: Vector) -> Vector:
    """Depth of entry in every configuration, shape (n,), in metres; 0 where nothing is entered by more than a touch."""
    depth = np.zeros(len(points))
    for part in robot.parts(points):
        for obstacle in obstacles:
            enters = obstacle.collides(part)
            if enters.any():
                core = Part(part.core[enters], 0.0)
                within = part.radius + obstacle.radius
                apart = obstacle.core_distance(core)
                if obstacle.half_plane is None:
                    apart = np.where(apart > 0.0, apart, -_core_depth(core.core, obstacle.core))
                entry = within - apart
                depth[enters] = np.maximum(depth[enters], np.where(entry > TOUCH * (1.0 + within), entry, 0.0))
    return depth


def _core_depth(cores: NDArray[Any], solid: Any) -> Vector:
    """How far from the border of an obstacle's core a core that meets it gets, where it is looked at, shape (n,)."""
    import shapely

    border = shapely.boundary(solid)
    target = solid if shapely.is_empty(border) else border
    depth = np.zeros(len(cores))
    for number, core in enumerate(cores):
        coordinates = shapely.get_coordinates(shapely.intersection(core, solid))
        if len(coordinates):
            between = coordinates[:-1, None] + _INNER[:, None] * np.diff(coordinates, axis=0)[:, None]
            looked = np.concatenate([coordinates, between.reshape(-1, 2)])
            depth[number] = float(shapely.distance(shapely.points(looked), target).max())
    return depth


def depth_along(robot: Robot, obstacles: Sequence[Obstacle], way: Vector, own: Any) -> float:
    """Deepest entry on the straight lines between configurations, in metres.

    A line is free for sure where no point of the robot moves farther on it than the gaps at both of its ends allow
    together; others are cut in four until they are, ten times at most, or twice if something was entered.

    Shapes: `way` (n, ndim).
    """
    deepest = float(depth_at(robot, obstacles, own(way)).max(initial=0.0))
    begin, end = way[:-1], way[1:]
    moves = np.any(begin != end, axis=1)
    begin, end = begin[moves], end[moves]
    for level in range(_LEVELS + 1):
        if not len(begin):
            break
        travel = robot.travel(begin, end)
        reach = float(travel.max())
        first, last = _gaps(robot, obstacles, own(begin), reach), _gaps(robot, obstacles, own(end), reach)
        open_ = travel > first + last
        if level == _LEVELS or not open_.any() or (deepest > 0.0 and level > 1):
            break
        shares = np.linspace(0.0, 1.0, _SPLIT + 1)[:, None, None]
        stations = begin[open_] + shares * (end[open_] - begin[open_])
        between = stations[1:-1].reshape(-1, way.shape[1])
        deepest = max(deepest, float(depth_at(robot, obstacles, own(between)).max(initial=0.0)))
        begin, end = stations[:-1].reshape(-1, way.shape[1]), stations[1:].reshape(-1, way.shape[1])
    return deepest


def _gaps(robot: Robot, obstacles: Sequence[Obstacle], points: Vector, reach: float) -> Vector:
    """Distance from the nearest obstacle in every configuration, as far as the reach, shape (n,)."""
    import shapely

    gaps = np.full(len(points), reach)
    for part in robot.parts(points):
        for obstacle in obstacles:
            near = np.ones(len(points), dtype=np.bool_)
            if obstacle.half_plane is None:
                near = np.asarray(shapely.dwithin(part.core, obstacle.core, reach + part.radius + obstacle.radius))
            if near.any():
                gaps[near] = np.minimum(gaps[near], obstacle.distance(Part(part.core[near], part.radius)))
    return gaps
