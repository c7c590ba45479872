"""What to do about a place that lies in an obstacle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.scene.images import read_raster
from resgrid.scene.map_words import format_of
from resgrid.scene.plain import THRESHOLD
from resgrid.scene.scene import Scene


def remedy(scene: Scene, blocked: NDArray[np.bool_], cell: tuple[int, ...]) -> str:
    """Where the nearest free place is; of a grey picture also why the cell is an obstacle.

    Shapes: `blocked` as the grid.
    """
    free = np.argwhere(~blocked)
    if not len(free):
        return "no cell is free"
    steps = np.abs(free - np.array(cell))
    around = [axis.cells if axis.periodic else np.inf for axis in scene.axes]
    steps = np.minimum(steps, np.abs(np.array(around) - steps)) * [axis.spacing for axis in scene.axes]
    nearest = free[int(np.argmin((steps**2).sum(axis=1)))]
    centre = [axis.lower + (index + 0.5) * axis.spacing for axis, index in zip(scene.axes, nearest, strict=True)]
    place = ", ".join(f"{value:.6g}" for value in np.asarray(scene.frame.to_world(centre)).tolist())
    return f"move it to a free place, the nearest is ({place}){_grey(scene, cell)}"


def _grey(scene: Scene, cell: tuple[int, ...]) -> str:
    """The grey value of a cell that a picture says is an obstacle, and the one from which cells are free."""
    if scene.map is None or format_of(scene) != "image":
        return ""
    threshold: int = scene.map.table.get("threshold", THRESHOLD)
    try:
        grey = int(read_raster(Path(scene.map.table["file"])).grey[::-1].T[cell])
    except InputError:  # the picture came through a pipe, or is gone: there is less to tell
        return ""
    return f"; its grey value is {grey}, and cells are free from {threshold} on (--threshold)" * (grey < threshold)
