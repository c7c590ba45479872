"""Arms: their scene behind the cells of a drawing, and how they stand along paths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.live_page.drawing import Drawing, drawing_of
from resgrid.live_page.solving import SolvedDrawing

if TYPE_CHECKING:
    from resgrid.robots import Arm

_POSES = 60


def resample(drawing: Drawing) -> Drawing:
    """The drawing anew from its workspace, where something was moved; k, starts and wiring stay as they are."""
    from resgrid.scene.reading import build_scene

    if drawing.world is None:
        raise InputError("this drawing has no workspace")
    if "map" in drawing.world:
        raise InputError("a workspace on the page names no map file")
    fresh = drawing_of(build_scene(drawing.world, "the workspace", Path()))
    if fresh.axes != drawing.axes:
        raise InputError("the workspace has other joints than the drawing")
    return replace(
        drawing, cell=fresh.cell, level=fresh.level, palette=fresh.palette, world=fresh.world,
        goal_points=fresh.goal_points,
    )  # fmt: skip


def poses(frame: SolvedDrawing) -> list[list[Any]]:
    """For each path the joints of the arm along it, lists of shape (poses, links + 1, 2); none without an arm."""
    if frame.drawing.world is None:
        return []
    arm = _arm(frame.drawing.world)
    return [[] if path is None else arm.joints(_some(path.line)).tolist() for path in frame.paths]


def pose(frame: SolvedDrawing, configuration: list[float]) -> list[Any] | None:
    """Joints of the arm in one configuration, (links + 1, 2); None without an arm."""
    if frame.drawing.world is None:
        return None
    joints: list[Any] = _arm(frame.drawing.world).joints(np.array(configuration)).tolist()
    return joints


def _arm(world: Mapping[str, Any]) -> Arm:
    from resgrid.robots import Arm
    from resgrid.scene.schema import robot_of

    arm = robot_of(world.get("robot", {}))
    if not isinstance(arm, Arm) or arm.ndim != 2:
        raise InputError("the workspace of this drawing has no arm of two links")
    return arm


def _some(line: NDArray[np.float64]) -> NDArray[np.float64]:
    """Some points of a line, first and last among them."""
    return line[np.unique(np.linspace(0, len(line) - 1, _POSES).round().astype(np.int64))]
