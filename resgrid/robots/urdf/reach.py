"""Upper bounds on the motion of a robot's bodies per motion of a joint, for step lengths along paths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.robots.urdf.tree import KinematicTree


def motion_per_joint(tree: KinematicTree) -> NDArray[np.float64]:
    """Return upper bounds of the distance that any point of a body moves per unit of each moving joint (bodies, m).

    Units: metres per radian, or metres per metre. The bound is 0 for joints that do not move the body.

    A point of a body is never farther from the axis of a joint j that carries it than the following sum: the distances
    between successive joint origins from j to the body, the largest translations of the joints after j, and the
    distance of the point from the last of these origins.
    """
    origins = np.linalg.norm(tree.placement[:, :3, 3], axis=1)
    ends = np.maximum(np.abs(tree.lower), np.abs(tree.upper))[tree.driver]
    slides = np.where(tree.is_prismatic, np.abs(tree.factor) * ends + np.abs(tree.offset), 0.0)
    bounds = np.zeros((len(tree.bodies), len(tree.moving)))
    for row, body in zip(bounds, tree.bodies, strict=True):
        away = float(np.linalg.norm(body.hull.points, axis=1).max()) + body.hull.radius
        joint = body.joint
        while joint >= 0:
            row[tree.driver[joint]] += abs(tree.factor[joint]) * (1.0 if tree.is_prismatic[joint] else away)
            away += origins[joint] + slides[joint]
            joint = int(tree.parent[joint])
    return bounds
