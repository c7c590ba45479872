"""The simulated plant: the robot's true body among all true obstacles, also obstacles that the robot's map lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.core.axis import Axis
from resgrid.core.cell import Cell
from resgrid.core.frame import Frame
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.robots import Ball, Box, CellSet, Pose, RigidPart, Robot, Shape
from resgrid.robots.geometry import TOUCH, Obstacle, ObstacleArrays, obstacle_arrays, obstacles_of
from resgrid.scene.scene import Scene
from resgrid.scene.world_coordinates import to_space

INSIDE = 1e-6
"""Depth below the touched surface of the point that a contact proves to lie inside an obstacle.

The depth is given as a fraction of the robot's largest motion across a cell.  Obstacles must be thicker than this
depth.
"""

PAIR = np.dtype(
    [
        ("on_robot", np.float64, 2), ("point", np.float64, 2), ("normal", np.float64, 2), ("inward", np.float64, 2),
        ("gap", np.float64), ("part", np.int64), ("body", np.int64),
    ]
)  # fmt: skip
"""Record of a pair of near points, one on the robot and one on an obstacle.

`on_robot, point`: points on the surfaces of robot and obstacle, in metres; `normal`: unit normal out of the obstacle;
`inward`: unit direction into the obstacle; `gap`: distance of the surfaces, in metres; `part`: index of the rigid part
of the robot (the link of an arm); `body`: index of the obstacle.
"""

_CAPACITY = 64
"""Initial length of the array of near-point pairs, which grows as needed."""
_SPLIT = 4
"""Number of pieces into which a line in configuration space is divided if its collision test is undecided.

The test is undecided if the robot moves farther on the line than the sum of the gaps at both ends.
"""
_LEVELS = 10
"""Maximum number of levels at which lines in configuration space are tested and divided; lines that are still undecided
then count as free.
"""
_INNER = np.linspace(0.0, 1.0, 17)
"""Positions (0 to 1) along each edge of the intersection of robot and obstacle at which the penetration depth is
evaluated.
"""


@dataclass(frozen=True, eq=False)
class Plant:
    """A robot and the true obstacles.

    `robot`: a plane robot (point, disc, polygon or arm); `axes`: axes of the configuration space; the ends of an axis
    that is not periodic are mechanical stops; `obstacles`: all obstacles in axis coordinates of the workspace, the
    obstacles of the robot's map first; `known`: number of obstacles in the map; the others are hidden; `frame`:
    position and direction of the axes in the world.
    """

    robot: Robot
    axes: tuple[Axis, ...]
    obstacles: tuple[Shape, ...]
    known: int
    frame: Frame

    def pose(self, configuration: NDArray[np.float64]) -> Pose:
        """Return the pose of the robot at a configuration (ndim,) in axis coordinates, wrapped into periodic axes."""
        return self.robot.pose(self._within_seams(configuration))

    def _within_seams(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return configurations (..., ndim) in axis coordinates, wrapped into the range of periodic axes."""
        return self.robot.within_seams(self.axes, configurations)

    @cached_property
    def arrays(self) -> ObstacleArrays:
        """The obstacles as arrays (edges, discs, half-planes, in metres) for compiled kernels."""
        return obstacle_arrays(self.obstacles, self.robot.workspace_axes(self.axes))

    @cached_property
    def cell_motion(self) -> float:
        """Largest motion of any point of the robot, in metres, while the configuration crosses a cell diagonally."""
        spacing = np.array([[axis.spacing for axis in self.axes]])
        return float(self.robot.travel(np.zeros_like(spacing), spacing)[0])

    def near(self, pose: Pose, reach: float) -> NDArray[Any]:
        """Return the pairs of near points of robot and obstacles, of dtype `PAIR`, shape (n,).

        `pose`: pose of the robot; `reach`: largest gap of a pair, in metres.
        """
        from resgrid.control import contact_kernels

        capacity = _CAPACITY
        while True:
            pairs = np.empty(capacity, PAIR)
            count = contact_kernels.near_points(pose, self.arrays, reach, pairs)
            if count < capacity:
                return pairs[:count]
            capacity *= 4

    def free_fraction(self, pose: Pose, motion: NDArray[np.float64], least: float) -> float:
        """Return a fraction (0 to 1) of a straight motion on which every gap provably stays at least `least` metres.

        The motion is straight in configuration space; gaps are distances between robot and obstacles. `pose`: pose of
        the robot at the start; `motion` (ndim,): offset of the configuration, in axis units; `least`: smallest gap.
        """
        from resgrid.control import contact_kernels

        return contact_kernels.free_fraction(pose, self.arrays, motion, least)

    def within_stops(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return configurations (..., ndim) in axis coordinates, clipped to the mechanical stops, in the same shape."""
        return np.minimum(np.maximum(configurations, self.stops[0]), self.stops[1])

    def true_space(self, space: ConfigurationSpace) -> ConfigurationSpace:
        """Return a map with all hidden obstacles added by the conservative rule.

        By this rule a cell is an obstacle if the robot may collide at any configuration in the cell.  `space`: map
        without the hidden obstacles.
        """
        hidden = self.robot.occupancy(self.axes, self.obstacles[self.known :], "conservative")
        cell = np.where(hidden, np.uint8(Cell.OBSTACLE), space.cell)
        return space.with_cells(cell)

    @cached_property
    def self_blocked(self) -> NDArray[np.bool_]:
        """Mask of the cells that are obstacle cells even without obstacles, shape of the space.

        Causes are collisions between links of the robot, and virtual obstacles (configurations that are forbidden for a
        reason other than a collision, such as a singularity of an arm).
        """
        return self.robot.occupancy(self.axes, [], "conservative")

    def proven_cells(self, point: ArrayLike) -> NDArray[np.bool_]:
        """Return the mask of the cells that the conservative rule blocks for one workspace point, shape of the space.

        The rule blocks a cell if the robot may touch the point at any configuration in the cell.  If the point belongs
        to an obstacle, each cell of the mask is therefore an obstacle cell of the true map.  A contact at the point
        proves nothing about other cells (Connolly & Grupen 1992, section 7, figure 19).  Cells that are obstacle cells
        even without obstacles (`self_blocked`) are left out. `point` (2,): in axis coordinates of the workspace, in
        metres.
        """
        place = tuple(np.asarray(point, dtype=np.float64).tolist())
        return self.robot.occupancy(self.axes, [Ball(place, 0.0)], "conservative") & ~self.self_blocked

    def only(self, number: int) -> Plant:
        """Return a plant with the same robot and one of the obstacles; `number`: index of this obstacle."""
        return replace(self, obstacles=(self.obstacles[number],), known=1)

    def name_of(self, number: int) -> str:
        """Return the name of an obstacle in the scene file, such as ``hidden[0]``; `number`: index of the obstacle."""
        if number >= self.known:
            return f"hidden[{number - self.known}]"
        return "the map" if isinstance(self.obstacles[number], CellSet) else f"obstacle[{number}]"

    @cached_property
    def stops(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper ends of the axes in axis coordinates, shape (ndim,) each; infinite for periodic axes."""
        lower = [-np.inf if axis.periodic else axis.lower for axis in self.axes]
        upper = [np.inf if axis.periodic else axis.upper for axis in self.axes]
        return np.array(lower), np.array(upper)

    def penetration(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Return the largest penetration depth of the robot into any obstacle, in metres, shape (n,).

        The depth is 0 for a robot that touches an obstacle or is clear of all.  It is computed with shapely,
        independently of the compiled kernels that move the robot.  `configurations` (n, ndim): in world coordinates.
        """
        return self.axis_penetration(np.atleast_2d(self.frame.from_world(configurations)))

    def axis_penetration(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the largest penetration depth of the robot into any obstacle, in metres, shape (n,).

        The depth is 0 for a robot that touches an obstacle or is clear of all.  `configurations` (n, ndim): in axis
        coordinates.
        """
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
        """Return the largest penetration depth of the robot on a route of straight lines, in metres, or 0.

        A line is free if no point of the robot moves farther on it than the sum of the gaps at its ends.  Other lines
        are divided into four pieces, up to ten times, or twice if a penetration was found.  `route` (n, ndim):
        configurations in axis coordinates.
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
        """Return the distance from the robot to the nearest obstacle at every configuration, in metres, shape (n,).

        `configurations` (n, ndim): in axis coordinates; `reach`: upper limit in metres, returned for all larger
        distances.
        """
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
        """The obstacles as shapely geometries (cores) in metres, each with a radius by which the core is thickened."""
        return obstacles_of(self.obstacles, self.robot.workspace_axes(self.axes))


def plant_of(scene: Scene) -> Plant:
    """Return the plant of a scene: its robot with all its obstacles, those of the map and hidden ones.

    Raises InputError for a scene outside the plane, or with a hidden obstacle without an area.
    """
    if scene.robot.workspace_ndim != 2:
        raise InputError("control works in the plane; a robot from a URDF file moves in space: plan a path instead")
    if scene.ndim != 2 and scene.robot.moves_in_workspace:
        raise InputError(
            f"contacts need a scene in the plane; this scene has {scene.ndim} ax{'is' if scene.ndim == 1 else 'es'}"
        )
    for number, shape in enumerate(scene.hidden):
        is_point = isinstance(shape, Ball) and shape.radius == 0
        is_line = isinstance(shape, Box) and any(a == b for a, b in zip(shape.lower, shape.upper, strict=True))
        if is_point or is_line:
            raise InputError(f"hidden[{number}]: a hidden obstacle needs an area to be touched; make it thicker")
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
    """Return the plant of a robot, its axes and the obstacles, given in world coordinates.

    `robot`: plane robot; `axes`: axes of the configuration space; `known`: obstacles of the robot's map; `hidden`:
    obstacles that the map does not contain; `frame`: position and direction of the axes in the world, None for the
    world's own.
    """
    place = Frame() if frame is None else frame
    obstacles = tuple(to_space(shape, place) for shape in (*known, *hidden))
    return Plant(robot, tuple(axes), obstacles, len(known), place)


def _core_depth(cores: NDArray[Any], solid: Any) -> NDArray[np.float64]:
    """Return the depth of a rigid body of the robot inside an obstacle, shape (n,), in metres; 0 without an overlap.

    It is the largest distance from the obstacle's boundary of sampled points on the border of the overlap. `cores`
    (n,): shapely geometries of the body without its radius, one per configuration; `solid`: shapely geometry of the
    obstacle without its radius.
    """
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
