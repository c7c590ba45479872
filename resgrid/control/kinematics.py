"""Where every part of a robot is, and how its points move with the configuration."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.errors import InputError
from resgrid.robots import Arm, DiscRobot, PointRobot, PolygonRobot, Robot


class Pose(NamedTuple):
    """A planar robot in one configuration: segments with a radius, on rigid parts.

    The velocity of a point ``p`` of part ``m`` for a unit velocity of axis ``a`` is
    ``shift[m, a] + spin[m, a] k x (p - pivot[m, a])``, with k out of the plane.

    `segments` (s, 4): ``x0, y0, x1, y1``, in metres; a single point is a segment of length 0; `radius` (s,): of the
    robot around each segment, in metres; `part` (s,): which rigid part (of an arm, the link) each belongs to; `frame`
    (parts, 3): origin and direction of each part, in metres and radians; `shift` (parts, ndim, 2); `spin` (parts,
    ndim); `pivot` (parts, ndim, 2); `lever` (s, 2, parts): what the squared turning rate of each part adds at most to
    the accelerations of the ends of each segment, while the axes move at constant rates; in metres.
    """

    segments: NDArray[np.float64]
    radius: NDArray[np.float64]
    part: NDArray[np.int64]
    frame: NDArray[np.float64]
    shift: NDArray[np.float64]
    spin: NDArray[np.float64]
    pivot: NDArray[np.float64]
    lever: NDArray[np.float64]

    def jacobian(self, point: ArrayLike, part: int) -> NDArray[np.float64]:
        """Velocity of a point of a part for unit velocities of the axes, shape (2, ndim)."""
        x, y = np.asarray(point, dtype=np.float64)
        spin, pivot = self.spin[part], self.pivot[part]
        return np.asarray(np.stack([-spin * (y - pivot[:, 1]), spin * (x - pivot[:, 0])]) + self.shift[part].T)

    def carried(self, point: ArrayLike, part: int, other: Pose) -> NDArray[np.float64]:
        """Where a point fixed to a part lies in another pose of the same robot, shape (2,)."""
        x, y, angle = self.frame[part]
        to_x, to_y, to_angle = other.frame[part]
        turn = to_angle - angle
        dx, dy = np.asarray(point, dtype=np.float64) - (x, y)
        cos, sin = np.cos(turn), np.sin(turn)
        return np.array([to_x + cos * dx - sin * dy, to_y + sin * dx + cos * dy])


def pose_of(robot: Robot, configuration: NDArray[np.float64]) -> Pose:
    """The pose of a planar robot.  Shapes: `configuration` (ndim,)."""
    match robot:
        case Arm():
            return _arm_pose(robot, configuration)
        case PolygonRobot():
            return _polygon_pose(robot, configuration)
        case PointRobot() | DiscRobot():
            if configuration.shape != (2,):
                raise InputError(f"contact is known in the plane alone, not with {len(configuration)} axes")
            return Pose(
                np.array([[*configuration, *configuration]]), np.array([robot.radius]), np.zeros(1, np.int64),
                np.array([[*configuration, 0.0]]), np.eye(2)[np.newaxis], np.zeros((1, 2)), np.zeros((1, 2, 2)),
                np.zeros((1, 2, 1)),
            )  # fmt: skip
    raise InputError(f"how a {type(robot).__name__} moves is not known: arm, polygon, disc and point are")


def _polygon_pose(robot: PolygonRobot, configuration: NDArray[np.float64]) -> Pose:
    corners = robot.corners(configuration)
    x, y, arc = configuration
    shift, pivot = np.zeros((1, 3, 2)), np.zeros((1, 3, 2))
    shift[0, 0, 0] = shift[0, 1, 1] = 1.0
    pivot[0, 2] = x, y
    spin = np.array([[0.0, 0.0, 1.0 / robot.turning_length]])
    count = len(corners)
    segments = np.hstack([corners, np.roll(corners, -1, axis=0)])
    frame = np.array([[x, y, arc / robot.turning_length]])
    lever = np.full((count, 2, 1), robot.farthest)
    return Pose(segments, np.zeros(count), np.zeros(count, np.int64), frame, shift, spin, pivot, lever)


def _arm_pose(arm: Arm, configuration: NDArray[np.float64]) -> Pose:
    """Relative angles turn all that follows about their joint; absolute ones turn a link and shift what follows."""
    joints, directions = arm.joints(configuration), arm.directions(configuration)
    radius, part, spin, before, lever = _arm_constants(arm)
    count = len(part)
    shift, pivot = np.zeros((count, count, 2)), np.empty((count, count, 2))
    pivot[:] = joints[:-1]
    if arm.angles == "absolute":
        along = joints[1:] - joints[:-1]
        shift[:, :, 0] = -before * along[:, 1]
        shift[:, :, 1] = before * along[:, 0]
    return Pose(
        segments=np.concatenate([joints[:-1], joints[1:]], axis=1),
        radius=radius,
        part=part,
        frame=np.concatenate([joints[:-1], directions[:, np.newaxis]], axis=1),
        shift=shift,
        spin=spin,
        pivot=pivot,
        lever=lever,
    )


@cache
def _arm_constants(arm: Arm) -> tuple[NDArray[Any], ...]:
    """Of every link: radius, number, spin, whether a link is before another (count, count), lever."""
    count = arm.ndim
    spin = np.tri(count) if arm.angles == "relative" else np.eye(count)
    lever = np.stack([np.tri(count, k=-1), np.tri(count)], axis=1) * np.asarray(arm.lengths, dtype=np.float64)
    constants = np.asarray(arm.widths, dtype=np.float64) / 2, np.arange(count), spin, np.tri(count, k=-1), lever
    for array in constants:
        array.flags.writeable = False
    return constants
