"""The plant: the robot's true body among everything that truly stands in the workspace, hidden obstacles included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product
from math import hypot
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.control.kinematics import Pose, pose_of
from resgrid.errors import InputError
from resgrid.frame import Frame
from resgrid.planning.workspace import travel_bound
from resgrid.robots import Arm, Ball, Box, CellSet, DiscRobot, HalfSpace, PointRobot, Polygon, Robot, Shape
from resgrid.robots.shapes import as_polygon
from resgrid.scene.scene import Scene
from resgrid.scene.world import along_axes
from resgrid.space import Axis, Cell, ConfigurationSpace

if TYPE_CHECKING:
    from resgrid.planning.bodies import Body

_ROOM = 64


class Bodies(NamedTuple):
    """True obstacles as flat arrays, each element with the number of its obstacle.

    `edges` (e, 4): ``x0, y0, x1, y1``, the solid on the left; `edge_before` (e,): number of the edge that ends where
    each starts; `edge_body` (e,); `discs` (d, 3): centre and radius; `disc_body` (d,); `planes` (h, 3): unit normal
    out of the solid, and offset; `plane_body` (h,).
    """

    edges: NDArray[np.float64]
    edge_before: NDArray[np.int64]
    edge_body: NDArray[np.int64]
    discs: NDArray[np.float64]
    disc_body: NDArray[np.int64]
    planes: NDArray[np.float64]
    plane_body: NDArray[np.int64]


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
    bodies : Bodies
        The same in flat arrays.
    frame : Frame
        Where the axes lie in the world.
    """

    robot: Robot
    axes: tuple[Axis, ...]
    obstacles: tuple[Shape, ...]
    known: int
    bodies: Bodies
    frame: Frame

    def pose(self, configuration: NDArray[np.float64]) -> Pose:
        """Pose of the robot in a configuration in axis units; a point is brought back into periodic axes."""
        return pose_of(self.robot, self._own(configuration))

    def _own(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        if not (isinstance(self.robot, PointRobot | DiscRobot) and any(axis.periodic for axis in self.axes)):
            return configurations
        low = np.array([axis.lower for axis in self.axes])
        extent = np.array([axis.upper - axis.lower for axis in self.axes])
        ring = np.array([axis.periodic for axis in self.axes])
        return np.asarray(np.where(ring, low + np.mod(configurations - low, extent), configurations))

    @cached_property
    def cell_motion(self) -> float:
        """Largest motion of any point of the robot across one cell, corner to corner, in metres."""
        spacing = np.array([[axis.spacing for axis in self.axes]])
        return float(travel_bound(self.robot, np.zeros_like(spacing), spacing)[0])

    def near(self, pose: Pose, reach: float, facing: bool = True) -> NDArray[np.float64]:
        """Pairs of near points of the robot and the obstacles; see `resgrid.control.near_kernels.near_points`.

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
        from resgrid.control import near_kernels

        room = _ROOM
        while True:
            found = np.empty((room, 11))
            count = near_kernels.near_points(pose.segments, pose.radius, pose.part, *self.bodies, reach, facing, found)
            if count < room:
                return found[:count]
            room *= 4

    def free_share(self, pose: Pose, motion: NDArray[np.float64], least: float) -> float:
        """Share of a straight motion that surely keeps all gaps; see `resgrid.control.sweep_kernels`."""
        from resgrid.control import sweep_kernels

        body = self.bodies
        return sweep_kernels.free_share(
            pose.segments, pose.radius, pose.part, pose.shift, pose.spin, pose.pivot, pose.lever, motion, body.edges,
            body.discs, body.planes, least,
        )  # fmt: skip

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
        return _plant(self.robot, self.axes, (self.obstacles[number],), 1, self.frame)

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
            of the obstacle; 0 where nothing is entered by more than `resgrid.planning.bodies.TOUCH`.
        """
        return self.axis_penetration(np.atleast_2d(self.frame.from_world(configurations)))

    def axis_penetration(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """The same of configurations in axis units, shape (n, ndim)."""
        from resgrid.control.depth import depth_at

        return depth_at(self.robot, self._solids, self._own(configurations))

    def deepest(self, way: NDArray[np.float64]) -> float:
        """The same for the deepest place on straight lines between configurations in axis units, shape (n, ndim)."""
        from resgrid.control.depth import depth_along

        return depth_along(self.robot, self._solids, way, self._own)

    @cached_property
    def _solids(self) -> list[Body]:
        from resgrid.planning.bodies import bodies_of

        space = ConfigurationSpace(self.axes, np.zeros(tuple(axis.cells for axis in self.axes), np.uint8))
        return bodies_of(self.obstacles, self.robot, space)


def plant_of(scene: Scene) -> Plant:
    """The plant of a scene."""
    if scene.ndim != 2 and isinstance(scene.robot, PointRobot | DiscRobot):
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
    return _plant(robot, tuple(axes), along_axes((*known, *hidden), place), len(known), place)


def _plant(robot: Robot, axes: tuple[Axis, ...], shapes: tuple[Shape, ...], known: int, frame: Frame) -> Plant:
    return Plant(robot, axes, shapes, known, _bodies(robot, axes, shapes), frame)


def _flat(shape: Shape) -> bool:
    if isinstance(shape, Ball):
        return shape.radius == 0
    return isinstance(shape, Box) and any(a == b for a, b in zip(shape.lower, shape.upper, strict=True))


def _bodies(robot: Robot, axes: tuple[Axis, ...], shapes: Sequence[Shape]) -> Bodies:
    edges: list[tuple[float, ...]] = []
    discs: list[tuple[float, ...]] = []
    planes: list[tuple[float, ...]] = []
    before: list[int] = []
    owners: tuple[list[int], list[int], list[int]] = ([], [], [])
    for number, shape in enumerate(shapes):
        for solid in _copies(robot, axes, shape):
            match solid:
                case Ball(centre, radius):
                    discs.append((*centre, radius))
                    owners[1].append(number)
                case HalfSpace(normal, offset):
                    length = hypot(*normal)
                    planes.append((normal[0] / length, normal[1] / length, offset / length))
                    owners[2].append(number)
                case Box() | Polygon():
                    for ring in _solid_on_the_left(as_polygon(solid)):
                        first, size = len(edges), len(ring)
                        edges += [(*a, *b) for a, b in zip(ring, (*ring[1:], ring[0]), strict=True)]
                        before += [first + (side - 1) % size for side in range(size)]
                        owners[0].extend([number] * size)
    flat = [np.array(rows, dtype=np.float64).reshape(-1, n) for rows, n in ((edges, 4), (discs, 3), (planes, 3))]
    numbers = [np.array(owner, dtype=np.int64) for owner in owners]
    return Bodies(flat[0], np.array(before, dtype=np.int64), numbers[0], flat[1], numbers[1], flat[2], numbers[2])


def _solid_on_the_left(polygon: Polygon) -> list[list[tuple[float, ...]]]:
    """Outer ring anticlockwise, holes clockwise; without repeated corners."""
    import shapely

    oriented = shapely.geometry.polygon.orient(shapely.Polygon(polygon.vertices, polygon.holes))
    rings = [list(ring.coords) for ring in (oriented.exterior, *oriented.interiors)]
    return [[b for a, b in pairwise(ring) if a != b] for ring in rings]


def _copies(robot: Robot, axes: tuple[Axis, ...], shape: Shape) -> list[Shape]:
    """A shape, and for a point its copies across periodic seams; marked cells as boxes, run by run."""
    if isinstance(shape, CellSet):
        return [copy for box in _runs(shape) for copy in _copies(robot, axes, box)]
    if isinstance(robot, Arm) or isinstance(shape, HalfSpace) or not isinstance(robot, PointRobot | DiscRobot):
        return [shape]
    around = [(-(a.upper - a.lower), 0.0, a.upper - a.lower) if a.periodic else (0.0,) for a in axes]
    return [shape.shifted(by) for by in product(*around)]


def _runs(cells: CellSet) -> list[Box]:
    x, y = cells.axes
    flips = np.diff(cells.mask.astype(np.int8), axis=1, prepend=0, append=0)
    column, first = np.nonzero(flips > 0)
    _, last = np.nonzero(flips < 0)
    corners = np.column_stack([x.edges[column], y.edges[first], x.edges[column + 1], y.edges[last]]).tolist()
    return [Box((x0, y0), (x1, y1)) for x0, y0, x1, y1 in corners]
