"""The plant: the robot's true body among everything that truly stands in the workspace, hidden obstacles included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.core.axis import Axis
from resgrid.core.frame import Frame
from resgrid.core.space import Cell, ConfigurationSpace
from resgrid.errors import InputError
from resgrid.robots import Ball, Box, CellSet, Pose, RigidPart, Robot, Shape
from resgrid.robots.geometry import TOUCH, Obstacle, ObstacleArrays, obstacle_arrays, obstacles_of
from resgrid.scene.scene import Scene
from resgrid.scene.world_coordinates import to_space

INSIDE = 1e-6
"""How far behind a touched surface the obstacle is taken to reach at least, in cells (of motion)."""

PAIR = np.dtype(
    [
        ("on_robot", np.float64, 2), ("point", np.float64, 2), ("normal", np.float64, 2), ("inward", np.float64, 2),
        ("gap", np.float64), ("part", np.int64), ("body", np.int64),
    ]
)  # fmt: skip
"""A pair of near points: on the robot's surface, and on the obstacle's; the unit normal out of the obstacle, and the
direction into it; the gap, in metres; the rigid part of the robot (of an arm, the link); number of the obstacle."""

_ROOM = 64
_SPLIT = 4
_LEVELS = 10
_INNER = np.linspace(0.0, 1.0, 17)


@dataclass(frozen=True, eq=False)
class Plant:
    """A robot and the obstacles that are truly there.

    `robot`: of the plane: point, disc, polygon or arm; `axes`: of its configuration space; the ends of an axis that
    is not periodic are mechanical stops; `obstacles`: all obstacles, those of the map first, along the axes; `known`:
    how many of them the map shows; `frame`: where the axes lie in the world.
    """

    robot: Robot
    axes: tuple[Axis, ...]
    obstacles: tuple[Shape, ...]
    known: int
    frame: Frame

    def pose(self, configuration: NDArray[np.float64]) -> Pose:
        """Pose of the robot in a configuration in axis units; a point is brought back into periodic axes."""
        return self.robot.pose(self._within_seams(configuration))

    def _within_seams(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.robot.within_seams(self.axes, configurations)

    @cached_property
    def arrays(self) -> ObstacleArrays:
        """The obstacles for compiled loops."""
        return obstacle_arrays(self.obstacles, self.robot.workspace_axes(self.axes))

    @cached_property
    def cell_motion(self) -> float:
        """Largest motion of any point of the robot across one cell, corner to corner, in metres."""
        spacing = np.array([[axis.spacing for axis in self.axes]])
        return float(self.robot.travel(np.zeros_like(spacing), spacing)[0])

    def near(self, pose: Pose, reach: float) -> NDArray[Any]:
        """Pairs of near points of the robot and the obstacles within a reach, in metres, as `PAIR`, shape (n,)."""
        from resgrid.control import contact_kernels

        room = _ROOM
        while True:
            pairs = np.empty(room, PAIR)
            count = contact_kernels.near_points(pose, self.arrays, reach, pairs)
            if count < room:
                return pairs[:count]
            room *= 4

    def free_share(self, pose: Pose, motion: NDArray[np.float64], least: float) -> float:
        """Share of a straight motion that surely keeps all gaps."""
        from resgrid.control import contact_kernels

        return contact_kernels.free_share(pose, self.arrays, motion, least)

    def within_stops(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Configurations in axis units, shape (..., ndim), held between the mechanical stops."""
        return np.minimum(np.maximum(configurations, self.stops[0]), self.stops[1])

    def true_space(self, space: ConfigurationSpace) -> ConfigurationSpace:
        """The map as it would be if hidden obstacles were known, by the conservative rule."""
        hidden = self.robot.occupancy(self.axes, self.obstacles[self.known :], "conservative")
        cell = np.where(hidden, np.uint8(Cell.OBSTACLE), space.cell)
        return space.with_cells(cell)

    @cached_property
    def itself(self) -> NDArray[np.bool_]:
        """Cells that the robot blocks without any obstacle: collisions with itself, virtual obstacles."""
        return self.robot.occupancy(self.axes, [], "conservative")

    def proven_cells(self, point: ArrayLike) -> NDArray[np.bool_]:
        """Cells that the conservative rule blocks for one point of the workspace, shape (2,).

        Each of them is an obstacle cell by that rule if the point belongs to an obstacle; nothing else is claimed about
        it: this is all that a contact proves (Connolly & Grupen 1992, section 7, figure 19).
        """
        place = tuple(np.asarray(point, dtype=np.float64).tolist())
        return self.robot.occupancy(self.axes, [Ball(place, 0.0)], "conservative") & ~self.itself

    def only(self, number: int) -> Plant:
        """The same robot with one of the obstacles."""
        return replace(self, obstacles=(self.obstacles[number],), known=1)

    def name_of(self, number: int) -> str:
        """What a scene's file calls an obstacle."""
        if number >= self.known:
            return f"hidden[{number - self.known}]"
        return "the map" if isinstance(self.obstacles[number], CellSet) else f"obstacle[{number}]"

    @cached_property
    def stops(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper ends of the axes, shape (ndim,) each; infinite where an axis is periodic."""
        lower = [-np.inf if axis.periodic else axis.lower for axis in self.axes]
        upper = [np.inf if axis.periodic else axis.upper for axis in self.axes]
        return np.array(lower), np.array(upper)

    def penetration(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """How deep the robot is in an obstacle, by shapely and apart from the geometry that moves it.

        Shapes: `configurations` (n, ndim); returns (n,).
        """
        return self.axis_penetration(np.atleast_2d(self.frame.from_world(configurations)))

    def axis_penetration(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """The same of configurations in axis units, shape (n, ndim); 0 where none is entered by more than a touch."""
        depth = np.zeros(len(configurations))
        for part in self.robot.parts(self._within_seams(configurations)):
            for obstacle in self._solids:
                enters = obstacle.collides(part)
                if enters.any():
                    core = RigidPart(part.core[enters], 0.0)
                    within = part.radius + obstacle.radius
                    apart = obstacle.core_distance(core)
                    if obstacle.half_plane is None:
                        apart = np.where(apart > 0.0, apart, -_core_depth(core.core, obstacle.core))
                    entry = within - apart
                    depth[enters] = np.maximum(depth[enters], np.where(entry > TOUCH * (1.0 + within), entry, 0.0))
        return depth

    def deepest(self, route: NDArray[np.float64]) -> float:
        """Deepest entry on the straight lines between configurations in axis units, shape (n, ndim).

        A line is free for sure where no point of the robot moves farther on it than the gaps at both of its ends allow
        together; others are cut in four until they are, ten times at most, or twice if something was entered.
        """
        deepest = float(self.axis_penetration(route).max(initial=0.0))
        moves = np.any(route[:-1] != route[1:], axis=1)
        begin, end = route[:-1][moves], route[1:][moves]
        for level in range(_LEVELS):
            if not len(begin):
                break
            travel = self.robot.travel(begin, end)
            reach = float(travel.max())
            narrow = travel > self._gaps(begin, reach) + self._gaps(end, reach)
            if not narrow.any() or (deepest > 0.0 and level > 1):
                break
            shares = np.linspace(0.0, 1.0, _SPLIT + 1)[:, None, None]
            stations = begin[narrow] + shares * (end[narrow] - begin[narrow])
            between = stations[1:-1].reshape(-1, route.shape[1])
            deepest = max(deepest, float(self.axis_penetration(between).max(initial=0.0)))
            begin, end = stations[:-1].reshape(-1, route.shape[1]), stations[1:].reshape(-1, route.shape[1])
        return deepest

    def _gaps(self, configurations: NDArray[np.float64], reach: float) -> NDArray[np.float64]:
        """Distance from the nearest obstacle in every configuration, as far as the reach, shape (n,)."""
        import shapely

        gaps = np.full(len(configurations), reach)
        for part in self.robot.parts(self._within_seams(configurations)):
            for obstacle in self._solids:
                near = np.ones(len(gaps), dtype=np.bool_)
                if obstacle.half_plane is None:
                    near = np.asarray(shapely.dwithin(part.core, obstacle.core, reach + part.radius + obstacle.radius))
                if near.any():
                    gaps[near] = np.minimum(gaps[near], obstacle.distance(RigidPart(part.core[near], part.radius)))
        return gaps

    @cached_property
    def _solids(self) -> list[Obstacle]:
        return obstacles_of(self.obstacles, self.robot.workspace_axes(self.axes))


def plant_of(scene: Scene) -> Plant:
    """The plant of a scene."""
    if scene.ndim != 2 and scene.robot.moves_in_workspace:
        raise InputError(
            f"contacts need a scene in the plane; this scene has {scene.ndim} ax{'is' if scene.ndim == 1 else 'es'}"
        )
    for number, shape in enumerate(scene.hidden):
        is_point = isinstance(shape, Ball) and shape.radius == 0
        is_line = isinstance(shape, Box) and any(a == b for a, b in zip(shape.lower, shape.upper, strict=True))
        if is_point or is_line:
            raise InputError(f"hidden[{number}]: an obstacle to be touched needs an area; make it thicker")
    known: list[Shape] = list(scene.obstacles)
    if scene.map is not None:
        known.append(scene.map.obstacles)
    return make_plant(scene.robot, scene.axes, known, scene.hidden, frame=scene.frame)


def make_plant(
    robot: Robot,
    axes: Sequence[Axis],
    known: Sequence[Shape],
    hidden: Sequence[Shape] = (),
    *,
    frame: Frame | None = None,
) -> Plant:
    """A plant from its parts."""
    place = Frame() if frame is None else frame
    obstacles = tuple(to_space(shape, place) for shape in (*known, *hidden))
    return Plant(robot, tuple(axes), obstacles, len(known), place)


def _core_depth(cores: NDArray[Any], solid: Any) -> NDArray[np.float64]:
    """How far from the border of an obstacle's core a core that meets it gets, where it is looked at, shape (n,)."""
    import shapely

    border = shapely.boundary(solid)
    target = solid if shapely.is_empty(border) else border
    depth = np.zeros(len(cores))
    for number, core in enumerate(cores):
        coordinates = shapely.get_coordinates(shapely.intersection(core, solid))
        if len(coordinates):
            between = coordinates[:-1, None] + _INNER[:, None] * np.diff(coordinates, axis=0)[:, None]
            examined = np.concatenate([coordinates, between.reshape(-1, 2)])
            depth[number] = float(shapely.distance(shapely.points(examined), target).max())
    return depth
