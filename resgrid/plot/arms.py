"""Pictures of arms in space: obstacles, poses along a path, and the path of the tool."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Polygon
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.colours import GOAL
from resgrid.errors import InputError
from resgrid.planning.any_path import AnyPath
from resgrid.plot.figures import axes_or_new
from resgrid.plot.motions import Motion, dense_motion, goal_places, poses_along, reference_of
from resgrid.plot.raster import Camera, ImageLayer, render
from resgrid.plot.shading import nice_step
from resgrid.plot.space_view import SpaceView, window_around
from resgrid.plot.style import HIDDEN, SMALL, TEXT, add_swatch, mark, refresh_legend
from resgrid.robots import HalfSpace, Shape, URDFRobot
from resgrid.robots.surfaces import Surface, floor_height, is_floor, link_surfaces, shape_surfaces
from resgrid.scene.goal_shapes import goal_shapes
from resgrid.scene.scene import Scene

SOLID, START, BETWEEN, END, LEARNT = "#b4b4b4", "#4a4a4a", "#7fb2d6", "#0072B2", HIDDEN
"""Colours of obstacles; of the robot at the start, between start and end, and at the end; and of hidden obstacles."""

_PALE = "#cfe1ef"
"""Colour of the robot between start and end in the legend."""

_GROUND = "#ececec"
"""Colour of a floor that is an obstacle."""

_SIDE = 1500
"""Number of pixels along the longer side of a picture before it is reduced to half this size."""

_BEYOND = 1.15
"""Half the side of the cube around the base in which obstacles are shown, as a multiple of the robot's reach."""

_HIDDEN_DEPTH = 0.02
"""Depth in metres: a line is drawn as hidden where it lies farther than this depth behind the nearest surface."""


_NOWHERE = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
"""Lower and upper corner of a box of size 0, to which half-spaces are cut when the limits of a picture are computed.

A half-space has no surface in this box, so that it does not extend the limits.
"""

_BEHIND = 0.002
"""Distance in metres by which each pose along the path is drawn farther from the camera than the previous pose.

Links at the same place in several poses are then drawn in the colour of the first of these poses.
"""


def is_in_space(scene: Scene) -> bool:
    """Return whether the robot of a scene is an arm with bodies in space (a robot from a URDF file)."""
    return isinstance(scene.robot, URDFRobot)


def arm_of(scene: Scene) -> URDFRobot:
    """Return the robot of a scene; raise InputError unless it is an arm with bodies in space."""
    if not isinstance(scene.robot, URDFRobot):
        raise InputError("this picture shows an arm in space, but the robot of the scene has no bodies in space")
    return scene.robot


@dataclass(frozen=True)
class _Group:
    """Triangles that are drawn in one colour.

    `triangles` (n, 3, 3): corners in the world, in metres; `owner` (n,): number of the body to which each triangle
    belongs.
    """

    triangles: NDArray[np.float64]
    owner: NDArray[np.int64]


class ArmPicture(SpaceView):
    """A picture of an arm and its surroundings from one direction.

    Parameters
    ----------
    scene : Scene
        Scene with an arm in space.
    poses : ndarray of float64, shape (n, ndim)
        Configurations that the picture must contain.
    camera : Camera
        Direction of the view.
    also : ndarray of float64, shape (m, 3)
        Further points in the world that the picture must contain.
    side : int
        Number of pixels along the longer side, before the image is reduced to half this size.

    Attributes
    ----------
    solids, regions : list of Shape
        Obstacles without half-spaces, and goal regions.
    lower, upper : ndarray of float64, shape (3,)
        Corners of the box that contains everything shown, in metres, at most 1.15 times the reach from the arm's base.
    step : float
        Distance of the lines of the floor's grid, in metres.
    """

    def __init__(
        self, scene: Scene, poses: NDArray[np.float64], camera: Camera, also: ArrayLike = (), side: int = _SIDE
    ) -> None:
        self.scene = scene
        self.arm = arm_of(scene)
        tree = self.arm.tree
        self._base = np.asarray(tree.placement[0, :3, 3])
        self._reach = _BEYOND * self.arm.reach
        self._robot = link_surfaces(tree)
        self.regions = goal_shapes(scene)
        self.solids = [shape for shape in scene.obstacles if not isinstance(shape, HalfSpace)]
        bounded = shape_surfaces([*self.solids, *scene.hidden, *self.regions], "shape", _NOWHERE)
        corners = [self.moved(pose).triangles.reshape(-1, 3) for pose in poses]
        corners += [surface.points for surface in bounded]
        shown = np.concatenate([*corners, self._base[np.newaxis], goal_places(scene), np.reshape(also, (-1, 3))])
        shown = self._base + np.clip(shown - self._base, -self._reach, self._reach)
        self.lower, self.upper = shown.min(axis=0), shown.max(axis=0)
        self.step = nice_step(float((self.upper - self.lower).max()) / 8)
        seen = np.concatenate([camera.seen(shown)[:, :2], camera.seen(self.floor_corners)[:, :2]])
        margin = 0.03 * float(np.ptp(seen, axis=0).max())
        super().__init__(camera, window_around(seen, side, margin), _HIDDEN_DEPTH)

    @property
    def floor(self) -> float:
        """Coordinate z of the floor in metres.

        The floor is the highest obstacle that is a half-space below a horizontal plane, or else the lowest shown point.
        """
        return floor_height(self.scene.obstacles, float(self.lower[2]))

    @property
    def floor_corners(self) -> NDArray[np.float64]:
        """Corners of the floor's grid in metres, shape (4, 3), in the order (x0, y0), (x0, y1), (x1, y0), (x1, y1)."""
        (x0, y0), (x1, y1) = (
            np.floor(self.lower[:2] / self.step) * self.step, np.ceil(self.upper[:2] / self.step) * self.step
        )  # fmt: skip
        return np.array([(x, y, self.floor) for x, y in product((x0, x1), (y0, y1))])

    def moved(self, pose: NDArray[np.float64], behind: float = 0.0) -> _Group:
        """Return the triangles of the robot in a configuration; `pose` (ndim,): configuration.

        `behind`: distance in metres by which the triangles are moved away from the camera, so that links at the same
        place in several poses do not cover each other at random.
        """
        frames = self.arm.tree.frames(np.reshape(pose, (1, -1)))[0]
        group = _group(self._robot, frames)
        return group if not behind else replace(group, triangles=group.triangles + behind * self.camera.rotation[2])

    def fixed(self, shapes: Sequence[Shape]) -> _Group:
        """Return the triangles of obstacles or goal regions, in the world.

        Half-spaces are cut to the shown box, which stands on the floor's grid and ends at the highest shown point.
        """
        (x0, y0, z), (x1, y1, _) = self.floor_corners[[0, 3]].tolist()
        box = ((x0, y0, z), (x1, y1, float(self.upper[2])))
        return _group(shape_surfaces(shapes, "shape", box), np.empty((0, 4, 4)))

    def layer(self, group: _Group, colour: str, opacity: float = 1.0) -> ImageLayer:
        """Return the shaded image of triangles in one colour; `opacity`: from 0 (transparent) to 1."""
        return render(group.triangles, group.owner, colour, self.camera, self.window, opacity)

    def surroundings(self) -> list[ImageLayer]:
        """Return one image each of obstacles, hidden obstacles, goal regions, and half-spaces that are not a floor.

        Kinds without a body are left out.  The floor is left out, because `prepare` draws it with its grid.
        """
        walls = [shape for shape in self.scene.obstacles if isinstance(shape, HalfSpace) and not is_floor(shape)]
        kinds: tuple[tuple[Sequence[Shape], str, float], ...] = (
            (self.solids, SOLID, 0.9), (self.scene.hidden, LEARNT, 0.9), (self.regions, GOAL, 0.6),
            (walls, SOLID, 0.25),
        )  # fmt: skip
        return [self.layer(self.fixed(shapes), colour, opacity) for shapes, colour, opacity in kinds if shapes]

    def prepare(self, axes: Axes) -> None:
        """Set limits and aspect of matplotlib axes, and draw the floor, arrows along x, y and z, and legend entries."""
        axes.set_axis_off()
        window = self.window
        axes.set(xlim=(window.left, window.right), ylim=(window.bottom, window.top), aspect="equal")
        self._draw_grid(axes)
        self._draw_directions(axes)
        swatches = (
            (self.solids, SOLID, "obstacle"),
            (self.scene.hidden, LEARNT, "hidden obstacle"),
            (self.regions, GOAL, "goal"),
        )
        for shapes, colour, label in swatches:
            if shapes:
                add_swatch(axes, label, colour)
        mark(self.camera.seen(goal_places(self.scene))[:, :2], axes, "goal")

    def _draw_grid(self, axes: Axes) -> None:
        (x0, y0, z), (x1, y1, _) = self.floor_corners[[0, 3]]
        xs, ys = (np.arange(round((b - a) / self.step) + 1) * self.step + a for a, b in ((x0, x1), (y0, y1)))
        lines = [((x, y0, z), (x, y1, z)) for x in xs] + [((x0, y, z), (x1, y, z)) for y in ys]
        seen = self.camera.seen(np.array(lines))[..., :2]
        if any(map(is_floor, self.scene.obstacles)):
            outline = self.camera.seen(self.floor_corners[[0, 1, 3, 2]])[:, :2]
            axes.add_patch(Polygon(outline, facecolor=_GROUND, edgecolor="none", zorder=0.5))
        axes.add_collection(
            LineCollection(list(seen), colors="#c8c8c8", linewidths=0.5, zorder=1.0, label=f"grid of {self.step:g} m"),
            autolim=False,
        )

    def _draw_directions(self, axes: Axes) -> None:
        """Draw arrows along x, y and z at the corner of the floor that is leftmost in the picture."""
        corners = self.camera.seen(self.floor_corners)
        origin = self.floor_corners[corners[:, 0].argmin()]
        for direction, name in zip(np.eye(3), "xyz", strict=True):
            tail, head, text = self.camera.seen(origin + self.step * np.outer((0.0, 1.0, 1.28), direction))[:, :2]
            arrow = {
                "arrowstyle": "-|>",
                "color": "#606060",
                "linewidth": 0.8,
                "mutation_scale": 6,
                "shrinkA": 0,
                "shrinkB": 0,
            }
            axes.annotate("", head, tail, arrowprops=arrow, zorder=7)
            axes.text(text[0], text[1], name, fontsize=SMALL, color="#606060", ha="center", va="center", zorder=7)


def draw_arm_scene(scene: Scene, ax: Axes | None = None, *, camera: Camera | None = None) -> Axes:
    """Draw the arm of a scene at its first start, with obstacles and goals, in space; return the axes.

    Without a start, every joint is drawn in the middle of its range. `ax`: axes to draw on, by default those of a new
    figure; `camera`: direction of the view, None for the default `Camera()`.
    """
    starts = np.reshape(scene.starts, (-1, scene.ndim))
    middle = [[(axis.lower + axis.upper) / 2 for axis in scene.axes]]
    pose = np.array(starts[:1] if len(starts) else middle)
    picture = ArmPicture(scene, pose, camera or Camera())
    axes = _prepared(picture, ax)
    picture.show([picture.layer(picture.moved(pose[0]), START), *picture.surroundings()], axes)
    add_swatch(axes, "robot at the start" if len(starts) else "robot", START)
    places = np.reshape([reference_of(start, scene) for start in starts], (-1, 3))
    mark(picture.camera.seen(places)[:, :2], axes, "start", "tool at the start" + "s" * (len(starts) > 1))
    refresh_legend(axes, gap=1.0)
    return axes


def draw_arm(
    path: Motion, scene: Scene, ax: Axes | None = None, *, ghosts: int = 5, camera: Camera | None = None
) -> Axes:
    """Draw poses of an arm along a path, its surroundings and the path of its tool in space; return the axes.

    `path`: path, or configurations (n, ndim) in world coordinates; `ax`: axes to draw on, by default those of a new
    figure; `ghosts`: largest number of poses, 1 to 1000, start and end included; `camera`: direction of the view, None
    for the default `Camera()`.
    """
    motion = dense_motion(path, scene)
    shown = poses_along(motion, scene, ghosts)
    tool = scene.robot.reference_point(motion)
    picture = ArmPicture(scene, shown, camera or Camera(), tool)
    axes = _prepared(picture, ax)
    groups = [picture.moved(pose, behind=_BEHIND * number) for number, pose in enumerate(shown)]
    solid = [picture.layer(groups[0], START)] + [picture.layer(group, END) for group in groups[1:][-1:]]
    around = picture.surroundings()
    picture.show([*solid, *around, *(picture.layer(group, BETWEEN, 0.4) for group in groups[1:-1])], axes)
    for group, colour, label in (
        (groups[:1], START, "start"),
        (groups[1:-1], _PALE, "between"),
        (groups[1:][-1:], END, "end"),
    ):
        if group:
            add_swatch(axes, "robot between" if label == "between" else f"robot at the {label}", colour)
    if len(tool) > 1:
        picture.draw_line(tool, axes, [*solid, *around], "path of the tool")
        seen = picture.camera.seen(tool)[:, :2]
        mark(seen[:1], axes, "start", "")
        mark(seen[-1:], axes, "end", "")
    refresh_legend(axes, gap=1.0)
    return axes


def draw_tool_paths(paths: Sequence[AnyPath], scene: Scene, ax: Axes | None = None) -> Axes:
    """Draw the paths of an arm's tool, with obstacles and goals, in space; return the axes.

    `paths`: paths of the arm in configuration space; `scene`: scene with the arm; `ax`: axes to draw on, by default
    those of a new figure.
    """
    motions = [dense_motion(path, scene) for path in paths]
    lines = [scene.robot.reference_point(motion) for motion in motions]
    picture = ArmPicture(
        scene, np.concatenate([motion[[0, -1]] for motion in motions]), Camera(), np.concatenate(lines)
    )
    axes = _prepared(picture, ax)
    around = picture.surroundings()
    if around:
        picture.show(around, axes)
    for line in lines:
        picture.draw_line(line, axes, around, "paths of the tool", linewidth=0.9)
    mark(picture.camera.seen(np.array([line[0] for line in lines]))[:, :2], axes, "start", "")
    refresh_legend(axes, gap=1.0)
    return axes


def _prepared(picture: ArmPicture, ax: Axes | None) -> Axes:
    """Return axes with limits, floor grid, arrows along x, y and z, and legend entries, before bodies are drawn.

    `picture`: gives limits and floor; `ax`: axes to draw on, None for those of a new figure.
    """
    window = picture.window
    axes = axes_or_new(ax, (window.top - window.bottom) / (window.right - window.left))
    picture.prepare(axes)
    axes.set_title("Workspace", fontsize=TEXT)
    return axes


def _group(surfaces: Iterable[Surface], frames: NDArray[np.float64]) -> _Group:
    """Return the triangles of surfaces in the world.

    `surfaces`: surfaces of bodies, each with the index of the joint that moves the body, -1 for a body at rest;
    `frames` (k, 4, 4): poses of the joints in the world, as homogeneous matrices.
    """
    triangles, owner = [np.empty((0, 3, 3))], [np.empty(0, dtype=np.int64)]
    for number, surface in enumerate(surfaces):
        pose = np.eye(4) if surface.joint < 0 else frames[surface.joint]
        points = surface.points @ pose[:3, :3].T + pose[:3, 3]
        triangles.append(points[surface.triangles])
        owner.append(np.full(len(surface.triangles), number, dtype=np.int64))
    return _Group(np.concatenate(triangles), np.concatenate(owner))
