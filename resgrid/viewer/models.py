"""Models of an arm and of its surroundings in the 3-D scene that the package viser displays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.colours import GOAL
from resgrid.robots import HalfSpace, Shape, URDFRobot
from resgrid.robots.surfaces import Surface, floor_height, link_surfaces, shape_surfaces
from resgrid.scene.goal_shapes import goal_shapes
from resgrid.scene.scene import Scene

if TYPE_CHECKING:
    import viser

Colour = tuple[int, int, int]

ROBOT: Colour = (222, 222, 226)
START: Colour = (74, 74, 74)
END: Colour = (0, 114, 178)
PATH: Colour = (213, 94, 0)
SOLID: Colour = (150, 150, 150)
"""Colour of obstacles: red, green and blue from 0 to 255."""

HIDDEN: Colour = (185, 107, 107)
"""Colour of obstacles that the planner does not know (hidden): red, green and blue from 0 to 255."""

_ABOVE = 0.001
"""Height of the grid above the floor in metres, so that the grid stays visible."""

_PLANE = 0.4
"""Opacity, 0 to 1, of the border planes of obstacles that are half-spaces."""

_BEYOND = 1.2
"""Half the side of a cube around the robot's base in which the border planes of half-spaces are shown, as a multiple of
the robot's reach.
"""

_GHOST = 0.35
"""Opacity, 0 to 1, of the robot at start and goal."""


class ArmModel:
    """An arm that can be moved, in a 3-D scene of the package viser.

    `name`: name of the arm's node in the scene; `colour`: red, green and blue from 0 to 255; `opacity`: 0 to 1, None
    for an opaque arm; with an opacity, the links that do not move are not shown.
    """

    def __init__(
        self, server: viser.ViserServer, robot: URDFRobot, name: str, colour: Colour, opacity: float | None = None
    ) -> None:
        self.robot = robot
        joints = range(len(robot.tree.names))
        self._root = server.scene.add_frame(f"/{name}", show_axes=False)
        self._frames = [server.scene.add_frame(f"/{name}/joint_{joint}", show_axes=False) for joint in joints]
        for number, surface in enumerate(link_surfaces(robot.tree)):
            if surface.joint < 0 and opacity is not None:
                continue  # links that do not move are the same in all poses
            place = "base" if surface.joint < 0 else f"joint_{surface.joint}"
            _add_mesh(server, f"/{name}/{place}/{number}_{surface.name}", surface, colour, opacity)

    def move(self, pose: NDArray[np.float64]) -> None:
        """Show the arm in a configuration `pose` (ndim,), in radians or metres per joint."""
        poses = self.robot.tree.frames(pose.reshape(1, -1))[0]
        for frame, matrix in zip(self._frames, poses, strict=True):
            frame.wxyz, frame.position = _quaternion(matrix[:3, :3]), matrix[:3, 3]

    def show(self, visible: bool) -> None:
        """Show or hide the arm."""
        self._root.visible = visible


def add_surroundings(server: viser.ViserServer, scene: Scene, robot: URDFRobot) -> None:
    """Add the obstacles, hidden obstacles and goal regions of `scene`, and a grid on the floor, to a scene of viser.

    The floor is the highest obstacle that is a half-space below a horizontal plane; without one, the grid is at z = 0.
    """
    reach, base = robot.reach, robot.tree.placement[0, :3, 3]
    low, high = (tuple((base + sign * _BEYOND * reach).tolist()) for sign in (-1.0, 1.0))
    kinds: tuple[tuple[Sequence[Shape], str, Colour, float | None], ...] = (
        (scene.obstacles, "obstacle", SOLID, None),
        (scene.hidden, "hidden", HIDDEN, 0.6),
        (goal_shapes(scene), "goal", rgb(GOAL), 0.5),
    )
    for shapes, name, colour, opacity in kinds:
        for shape, surface in zip(shapes, shape_surfaces(shapes, name, (low, high)), strict=True):
            if len(surface.triangles):
                see_through = _PLANE if isinstance(shape, HalfSpace) else opacity
                _add_mesh(server, f"/{surface.name}", surface, colour, see_through)
    height = floor_height(scene.obstacles, 0.0)
    server.scene.add_grid(
        "/floor", width=4 * reach, height=4 * reach, cell_size=0.1, section_size=0.5,
        position=(base[0], base[1], height + _ABOVE),
    )  # fmt: skip


def _add_mesh(server: viser.ViserServer, name: str, surface: Surface, colour: Colour, opacity: float | None) -> None:
    """Add a surface to a scene of viser.

    `name`: name of the surface's node in the scene; `colour`: red, green and blue from 0 to 255; `opacity`: 0 to 1,
    None for an opaque surface.
    """
    server.scene.add_mesh_simple(
        name, surface.points.astype(np.float32), surface.triangles, color=colour, opacity=opacity, side="double",
        flat_shading=True, receive_shadow=False,
    )  # fmt: skip


def add_ghosts(server: viser.ViserServer, robot: URDFRobot) -> tuple[ArmModel, ArmModel]:
    """Add translucent models of an arm, for its start and its goal, to a scene of viser, and return them."""
    return ArmModel(server, robot, "start", START, _GHOST), ArmModel(server, robot, "end", END, _GHOST)


def add_line(server: viser.ViserServer, points: NDArray[np.float64]) -> Any:
    """Draw the path of the tool in a scene of viser, in place of an earlier path; return the node of the line.

    `points` (n, 3): places of the tool along the path, in world coordinates.
    """
    segments = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
    return server.scene.add_line_segments("/path", segments, PATH, thickness=3.0, thickness_units="screen")


def _quaternion(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quaternion (w, x, y, z) of a rotation matrix (3, 3)."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return np.array([w, x, y, z])


def rgb(colour: str) -> Colour:
    """Return red, green and blue, from 0 to 255, of a colour such as ``#e8491d``."""
    red, green, blue = bytes.fromhex(colour.lstrip("#"))
    return red, green, blue
