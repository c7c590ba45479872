"""The type `KinematicTree`: joints, bodies, and pairs of bodies that may collide, as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen
from resgrid.robots.convex import Body


@frozen
@dataclass(frozen=True, eq=False)
class KinematicTree:
    """A robot with m moving joints (the axes of its configuration space), as a tree of k >= m joints with bodies.

    The k joints are the moving joints and the mimic joints that follow them.  Joints that do not move are merged into
    the placements.  Joints are sorted so that a parent comes before its children.

    Attributes
    ----------
    moving : tuple of str
        Names of the m moving joints, in the order of the axes.
    lower, upper : ndarray of float64, shape (m,)
        Limits of the moving joints, in radians or metres; -pi and pi for continuous joints.
    velocity : ndarray of float64, shape (m,)
        Speed limits of the moving joints, in rad/s or m/s; infinite without a limit in the file.
    is_continuous : ndarray of bool, shape (m,)
        Whether a moving joint turns without limits.
    names : tuple of str
        Names of the k joints.
    parent : ndarray of int64, shape (k,)
        Index of the joint whose frame carries a joint; -1 for the world.
    placement : ndarray of float64, shape (k, 4, 4)
        Pose of a joint's frame in its parent's frame at joint value 0.
    direction : ndarray of float64, shape (k, 3)
        Unit vector along the axis of rotation or translation, in the joint's own frame.
    is_prismatic : ndarray of bool, shape (k,)
        Whether a joint translates; otherwise it rotates.
    driver : ndarray of int64, shape (k,)
        Index of the moving joint that determines a joint's value.
    factor, offset : ndarray of float64, shape (k,)
        The value of a joint is ``factor * configuration[driver] + offset``.
    bodies : tuple of Body
        Bodies of the links, then those of the surroundings (joint -1).
    pairs : ndarray of int64, shape (p, 2)
        Indices of the pairs of bodies that must not touch each other; the first one moves with a joint.
    tools : mapping of str to (int, ndarray of float64 of shape (4, 4))
        For every link of the file, by name: index of the joint that carries the link (-1 for the world), and pose of
        the link in this joint's frame.
    """

    moving: tuple[str, ...]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    velocity: NDArray[np.float64]
    is_continuous: NDArray[np.bool_]
    names: tuple[str, ...]
    parent: NDArray[np.int64]
    placement: NDArray[np.float64]
    direction: NDArray[np.float64]
    is_prismatic: NDArray[np.bool_]
    driver: NDArray[np.int64]
    factor: NDArray[np.float64]
    offset: NDArray[np.float64]
    bodies: tuple[Body, ...]
    pairs: NDArray[np.int64]
    tools: Mapping[str, tuple[int, NDArray[np.float64]]]

    def frames(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return poses of the k joint frames in the world (n, k, 4, 4), by forward kinematics.

        `configurations` (n, m): values of the m moving joints, in radians or metres.
        """
        values = configurations[:, self.driver] * self.factor + self.offset
        poses = np.empty((len(configurations), len(self.names), 4, 4))
        for joint, parent in enumerate(self.parent):
            own = self.placement[joint] @ self._motion(joint, values[:, joint])
            poses[:, joint] = own if parent < 0 else poses[:, parent] @ own
        return poses

    def _motion(self, joint: int, value: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the transformations (n, 4, 4) of a joint at the values (n,): Rodrigues' formula, or a translation."""
        motion = np.tile(np.eye(4), (len(value), 1, 1))
        x, y, z = axis = self.direction[joint]
        if self.is_prismatic[joint]:
            motion[:, :3, 3] = value[:, np.newaxis] * axis
            return motion
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        sine, versine = np.sin(value)[:, np.newaxis, np.newaxis], 2 * np.sin(value / 2)[:, np.newaxis, np.newaxis] ** 2
        motion[:, :3, :3] += sine * cross + versine * (cross @ cross)
        return motion
