"""Models of a ball, and of the obstacle and goal cells around it, in the 3-D scene that the package viser displays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.colours import GOAL, SURFACE
from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.robots.voxel_surfaces import (
    Faces,
    block_of,
    coarse_axis,
    coarse_cells,
    surface_of,
    surface_to_air,
)
from resgrid.viewer.models import Colour, rgb

if TYPE_CHECKING:
    import viser

ROBOT_BALL: Colour = (230, 159, 0)
"""Colour of the moving ball: red, green and blue from 0 to 255."""

_BANDS = 24
"""Number of equal parts into which the grid's range of z is divided; obstacle faces have one colour per part."""


class BallModel:
    """A ball that can be moved, in a 3-D scene of the package viser.

    `server`: server of the scene; `name`: name of the ball's node in the scene; `radius`: radius in world units.
    """

    def __init__(self, server: viser.ViserServer, name: str, radius: float, colour: Colour) -> None:
        self._ball = server.scene.add_icosphere(f"/{name}", radius=radius, color=colour)

    def move(self, pose: NDArray[np.float64]) -> None:
        """Show the ball at a place; `pose` (3,): place in the world."""
        self._ball.position = pose

    def show(self, visible: bool) -> None:
        """Show or hide the ball."""
        self._ball.visible = visible


def add_voxels(server: viser.ViserServer, space: ConfigurationSpace) -> None:
    """Add the surface of the obstacles, coloured by the z coordinate, and the goal cells to a scene of viser.

    The surface consists of the faces between obstacles and goal or goal-connected cells. The faces are visible from the
    front only, so that the camera looks into closed rooms. `space`: space with the axes x, y and z of a point or a
    ball; many cells are joined into blocks.
    """
    block = block_of(space.axes)
    axes = [coarse_axis(axis, block) for axis in space.axes]
    solid = coarse_cells(space.cell == Cell.OBSTACLE, block)
    air = coarse_cells(space.goal_connected | (space.cell == Cell.GOAL), block) & ~solid
    faces = surface_to_air(solid, air, axes, merge=True)
    low, high = axes[2].lower, axes[2].upper
    height = (faces.corners[:, :, 2].mean(axis=1) - low) / (high - low)
    band = np.clip((height * _BANDS).astype(int), 0, _BANDS - 1)
    for number in np.unique(band).tolist():
        own = band == number
        _add_faces(server, f"/obstacles/{number}", Faces(faces.corners[own], faces.plane[own]), _tint(number))
    goal = coarse_cells(space.cell == Cell.GOAL, block)
    _add_faces(server, "/goals", surface_of(goal, axes, merge=True), rgb(GOAL), 0.5)


def _add_faces(
    server: viser.ViserServer, name: str, faces: Faces, colour: Colour, opacity: float | None = None
) -> None:
    """Add faces to a scene of viser.

    `name`: name of the node of the faces in the scene; `colour`: red, green and blue from 0 to 255; `opacity`: 0 to 1,
    None for opaque faces.
    """
    if not len(faces.corners):
        return
    first = 4 * np.arange(len(faces.corners))[:, np.newaxis]
    triangles = np.concatenate([first + np.array(corners) for corners in ((0, 1, 2), (0, 2, 3))]).astype(np.int32)
    points = faces.corners.reshape(-1, 3).astype(np.float32)
    server.scene.add_mesh_simple(
        name, points, triangles, color=colour, opacity=opacity, side="front", flat_shading=True, receive_shadow=False
    )


def _tint(band: int) -> Colour:
    """Return the colour, red, green and blue from 0 to 255, of obstacle faces in a range of the z coordinate.

    `band`: index of the range, one of 24 equal parts of the grid's z axis, from 0 at the lower end to 23 at the upper.
    """
    stops = np.array([rgb(colour) for colour in SURFACE], dtype=np.float64)
    place = (band + 0.5) / _BANDS * (len(stops) - 1)
    red, green, blue = (round(float(np.interp(place, np.arange(len(stops)), part))) for part in stops.T)
    return red, green, blue
