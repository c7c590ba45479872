"""The plant: the robot's true body among everything that truly stands in the workspace, hidden obstacles included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.control.depth import depth_along, depth_at
from resgrid.errors import InputError
from resgrid.frame import Frame
from resgrid.robots import Ball, Box, CellSet, Pose, Robot, Shape
from resgrid.robots.geometry import Obstacle, ObstacleArrays, obstacle_arrays, obstacles_of
from resgrid.scene.scene import Scene
from resgrid.scene.world import along_axes
from resgrid.space import Axis, Cell, ConfigurationSpace

_ROOM = 64


@dataclass(frozen=True, eq=False)
class Plant:
    """A robot and the obstacles that are truly there.

    Attributes
    ----------
    robot : Robot
        Of the plane: point, disc, polygon or arm.
    axes : tuple of Axis
        Of its configuration space; the ends of an axis that is not periodic are mechanical stops.
    obstacles : tuple of Shape
        All obstacles, those of the map first, along the axes.
    known : int
        How many of them the map shows.
    frame : Frame
        Where the axes lie in the world.
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

    def near(self, pose: Pose, reach: float, facing: bool = True) -> NDArray[np.float64]:
        """Pairs of near points of the robot and the obstacles; see `resgrid.control.contact_kernels.near_points`.

        Parameters
        ----------
        pose : Pose
        reach : float
            In metres.
        facing : bool
            Leave out pairs that have no part in a contact: through a solid, or across a corner from an edge's end.

        Returns
        -------
        ndarray of float64, shape (n, 11)
        """
        from resgrid.control import contact_kernels

        room = _ROOM
        while True:
            found = np.empty((room, 11))
            count = contact_kernels.near_points(pose, self.arrays, reach, facing, found)
            if count < room:
                return found[:count]
            room *= 4

    def free_share(self, pose: Pose, motion: NDArray[np.float64], least: float) -> float:
        """Share of a straight motion that surely keeps all gaps; see `resgrid.control.sweep_kernels`."""
        from resgrid.control import sweep_kernels

        return sweep_kernels.free_share(pose, self.arrays, motion, least)

    def within_stops(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Configurations in axis units, shape (..., ndim), held between the mechanical stops."""
        return np.minimum(np.maximum(configurations, self.stops[0]), self.stops[1])

    def true_space(self, space: ConfigurationSpace) -> ConfigurationSpace:
        """The map as it would be if hidden obstacles were known, by the conservative rule.

        Parameters
        ----------
        space : ConfigurationSpace
            The map; its goal cells stay goals where nothing hidden blocks them.

        Returns
        -------
        ConfigurationSpace
        """
        hidden = self.robot.occupancy(self.axes, self.obstacles[self.known :], "conservative")
        cell = np.where(hidden, np.uint8(Cell.OBSTACLE), space.cell)
        return space.with_cells(cell)

    @cached_property
    def itself(self) -> NDArray[np.bool_]:
        """Cells that the robot blocks without any obstacle: collisions with itself, virtual obstacles."""
        return self.robot.occupancy(self.axes, [], "conservative")

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

        Parameters
        ----------
        configurations : array_like of float, shape (n, ndim) or (ndim,)
            World coordinates.

        Returns
        -------
        ndarray of float64, shape (n,)
            In metres: what radii overlap, and how far a core (a link's axis, a polygon, a point) is behind the border
            of the obstacle; 0 where nothing is entered by more than `resgrid.robots.geometry.TOUCH`.
        """
        return self.axis_penetration(np.atleast_2d(self.frame.from_world(configurations)))

    def axis_penetration(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """The same of configurations in axis units, shape (n, ndim)."""
        return depth_at(self.robot, self._solids, self._within_seams(configurations))

    def deepest(self, way: NDArray[np.float64]) -> float:
        """The same for the deepest place on straight lines between configurations in axis units, shape (n, ndim)."""
        return depth_along(self.robot, self._solids, way, self._within_seams)

    @cached_property
    def _solids(self) -> list[Obstacle]:
        return obstacles_of(self.obstacles, self.robot.workspace_axes(self.axes))


def plant_of(scene: Scene) -> Plant:
    """The plant of a scene."""
    if scene.ndim != 2 and scene.robot.moves_in_workspace:
        raise InputError(f"contact is known in the plane alone, and this scene has {scene.ndim} axes")
    for number, shape in enumerate(scene.hidden):
        if _flat(shape):
            raise InputError(f"hidden[{number}]: an obstacle to be touched needs an area; make it thicker")
    known: list[Shape] = list(scene.obstacles)
    if scene.map is not None:
        known.append(CellSet(scene.axes, scene.map.cell == Cell.OBSTACLE))
    return make_plant(scene.robot, scene.axes, known, scene.hidden, frame=scene.frame)


def make_plant(
    robot: Robot,
    axes: Sequence[Axis],
    known: Sequence[Shape],
    hidden: Sequence[Shape] = (),
    *,
    frame: Frame | None = None,
) -> Plant:
    """A plant from its parts.

    Parameters
    ----------
    robot : Robot
    axes : sequence of Axis
    known, hidden : sequence of Shape
        Obstacles in the world (the cells of a map along the axes): those of the map, and those it does not show.
    frame : Frame, optional
        Where the axes lie in the world.

    Returns
    -------
    Plant
    """
    place = Frame() if frame is None else frame
    return Plant(robot, tuple(axes), along_axes((*known, *hidden), place), len(known), place)


def _flat(shape: Shape) -> bool:
    if isinstance(shape, Ball):
        return shape.radius == 0
    return isinstance(shape, Box) and any(a == b for a, b in zip(shape.lower, shape.upper, strict=True))
