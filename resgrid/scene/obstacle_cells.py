"""Obstacle cells of a scene's configuration space."""

from __future__ import annotations

from concurrent.futures import Executor

import numpy as np
from numpy.typing import NDArray

from resgrid.robots import Progress, Shape
from resgrid.scene.keepout import Keepout, forbidden_places
from resgrid.scene.scene import Scene
from resgrid.scene.world_coordinates import to_space


def obstacle_cells(
    scene: Scene, keepouts: list[Keepout], progress: Progress | None = None, executor: Executor | None = None
) -> tuple[NDArray[np.bool_], NDArray[np.bool_] | None]:
    """Return the masks of obstacle cells and of undecided cells, shape of the space.

    The second mask is None for a robot whose test leaves no cell undecided.  `keepouts`: effects of the keep-out masks
    of the scene; `progress`: function that is called as ``progress(done, total)``; `executor`: executor whose workers
    share the computation, None for this process alone.
    """
    obstacles = [*obstacle_shapes(scene), *(effect.obstacle for effect in keepouts if effect.obstacle is not None)]
    blocked, undecided = scene.robot.classify(scene.axes, obstacles, scene.sampling, progress, executor)
    for mask in forbidden_places(scene, keepouts).values():
        blocked = blocked | mask
    return blocked, undecided


def obstacle_shapes(scene: Scene) -> list[Shape]:
    """Return the obstacles of a scene and of its map in axis units, without those of masks."""
    shapes = [to_space(shape, scene.frame) for shape in scene.obstacles]
    if scene.map is not None:
        shapes.append(scene.map.obstacles)
    return shapes
