"""The straight first leg by which a disc or ball leaves the inflated zone around obstacles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from resgrid.core.cell import Cell
from resgrid.core.regions import label_regions
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import CertificateError, InputError
from resgrid.planning.certify_segments import certify_collision_free
from resgrid.planning.streamline import Polyline
from resgrid.planning.trace import start_cell
from resgrid.robots import PointRobot
from resgrid.scene import Scene, build_space

_MOST_TRIALS = 2000
"""Maximum number of straight lines that are tested, the shortest ones first; longer lines are not tried."""


def escape_leg(
    scene: Scene, space: ConfigurationSpace, start: NDArray[np.float64], targets: NDArray[np.bool_]
) -> Polyline | None:
    """Return the shortest straight line from a start in the inflated zone to the nearest point of a target cell.

    The robot's centre crosses no obstacle on the line; None if the centre lies in an obstacle, or if no such line is
    among the `_MOST_TRIALS` shortest lines.  The inflated zone consists of the cells in which the robot, but not its
    centre, touches an obstacle.  `space`: space of the scene without goals; `start` (ndim,): in world coordinates;
    `targets`: mask of the free cells in which the line may end, shape of the space.  Raise InputError for robots
    without radius.
    """
    if not isinstance(scene.robot, PointRobot) or not scene.robot.radius:
        raise InputError("escape applies to discs and balls, which have a radius; other robots have no inflated zone")
    bare = build_space(replace(scene, robot=PointRobot(), goals=()), require_goal=False)
    own = start_cell(bare, start)
    if bare.cell[own] == Cell.OBSTACLE:
        return None
    region = label_regions(bare.cell != Cell.OBSTACLE, bare.periodic)
    cells = np.argwhere(targets & (region == region[own]))
    if not len(cells):
        return None
    at = space.from_world(start)
    centre, half = space.axis_centre(cells), space.spacing / 2 * (1 - 1e-6)
    offset = at - centre
    turn = space.upper - space.lower
    offset -= np.where(space.periodic, turn * np.round(offset / turn), 0.0)
    nearest = np.clip(offset, -half, half)
    apart = np.linalg.norm(offset - nearest, axis=1)
    for row in np.argsort(apart, kind="stable")[:_MOST_TRIALS]:
        ends = space.to_world(np.array([at, at + nearest[row] - offset[row]]))
        try:
            certify_collision_free(Polyline(ends, bare))
        except CertificateError:
            continue
        return Polyline(ends, space)
    return None
