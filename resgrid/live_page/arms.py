"""Arms of two links on the live page: cells recomputed from the arm's workspace, and poses along paths."""

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

_MAX_POSES = 60
"""Largest number of poses along one path that the page shows."""


def resample(drawing: Drawing) -> Drawing:
    """Return a copy of a drawing of an arm, with cells that are computed again from the arm's workspace.

    Conductivities and goal configurations are computed again, too; k, starts and wiring do not change.  Raises
    InputError for a drawing without a workspace, for a workspace with a map file, and if the axes of the workspace's
    arm differ from the axes of the drawing.
    """
    from resgrid.scene.reading import build_scene

    if drawing.world is None:
        raise InputError("this drawing has no workspace; open the scene of an arm")
    if "map" in drawing.world:
        raise InputError("the workspace of an arm on the page cannot have a map file; use obstacles instead")
    fresh = drawing_of(build_scene(drawing.world, "the workspace", Path()))
    if fresh.axes != drawing.axes:
        raise InputError("the workspace and the drawing have different joints; reload the page")
    return replace(
        drawing, cell=fresh.cell, level=fresh.level, palette=fresh.palette, world=fresh.world,
        goal_points=fresh.goal_points,
    )  # fmt: skip


def poses(frame: SolvedDrawing) -> list[list[Any]]:
    """Return the positions of the arm's base, joints and tip along each path, one list (poses, links + 1, 2) per path.

    Positions are in the workspace, in metres, for at most 60 poses per path.  Without an arm the result is empty.  The
    entry of a path is an empty list where a preview (quick solution during a mouse gesture) is too inaccurate for the
    path.  `frame`: solved drawing with the paths.
    """
    if frame.drawing.world is None:
        return []
    arm = _arm(frame.drawing.world)
    return [[] if path is None else arm.joints(_thinned(path.line)).tolist() for path in frame.paths]


def pose(frame: SolvedDrawing, configuration: list[float]) -> list[Any] | None:
    """Return the positions of the arm's base, joints and tip in a configuration, as a list of shape (links + 1, 2).

    Positions are in the workspace, in metres.  The result is None if the drawing has no arm.  `frame`: solved drawing;
    `configuration`: joint angles in radians.
    """
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


def _thinned(line: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return at most 60 points (n, 2) of a line (points, 2), evenly spaced by index, with the first and the last."""
    return line[np.unique(np.linspace(0, len(line) - 1, _MAX_POSES).round().astype(np.int64))]
