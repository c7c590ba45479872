"""A robot in space whose joints and bodies are made by hand, without a URDF file and without its reader."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import pi

import numpy as np
from numpy.typing import NDArray

import resgrid as rg
from resgrid.robots import Shape
from resgrid.robots.convex import Body, ConvexPiece, Solid
from resgrid.robots.urdf.tree import KinematicTree

UPPER, FORE, THICKNESS, HEIGHT = 0.5, 0.4, 0.05, 0.3


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> NDArray[np.float64]:
    """Return the matrix (4, 4) of a translation."""
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def box_body(name: str, joint: int, lower: Sequence[float], upper: Sequence[float]) -> Body:
    """Return a box between two corners in the frame of a joint as a body."""
    low, high = np.array(lower), np.array(upper)
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    none = np.empty((0, 3))
    solid = Solid("box", tuple((high - low).tolist()), pose(*(low + high) / 2), none, none.astype(np.int32))
    hull = ConvexPiece(corners)
    return Body(name, joint, solid, hull, (hull,))


def two_links(velocity: Sequence[float] = (1.0, 2.0), drop: float = 0.0) -> KinematicTree:
    """Return an arm with two joints about z at a height of 0.3 m: the first with limits, the second continuous.

    `drop`: height by which the forearm is lower, in metres; from 0.15 on it hits the column when it folds back.
    """
    half = THICKNESS / 2
    bodies = (
        box_body("column", -1, (-0.1, -0.1, 0.0), (0.1, 0.1, HEIGHT - 0.1)),
        box_body("upper_arm", 0, (0.0, -half, -half), (UPPER, half, half)),
        box_body("forearm", 1, (0.0, -half, THICKNESS), (FORE, half, 2 * THICKNESS)),
    )
    return KinematicTree(
        moving=("shoulder", "elbow joint"),
        lower=np.array([-2.5, -pi]),
        upper=np.array([2.5, pi]),
        velocity=np.array(velocity),
        is_continuous=np.array([False, True]),
        names=("shoulder", "elbow joint"),
        parent=np.array([-1, 0]),
        placement=np.stack([pose(z=HEIGHT), pose(x=UPPER, z=-drop)]),
        direction=np.array([[0.0, 0.0, 1.0]] * 2),
        is_prismatic=np.array([False, False]),
        driver=np.array([0, 1]),
        factor=np.ones(2),
        offset=np.zeros(2),
        bodies=bodies,
        pairs=np.array([[2, 0]]),
        tools={"world": (-1, np.eye(4)), "forearm": (1, np.eye(4)), "hand": (1, pose(x=FORE))},
    )


@dataclass(frozen=True, eq=False, repr=False)
class HandMadeRobot(rg.URDFRobot):
    """The arm of `two_links`, whose obstacles are boxes."""

    file: str = "arm.urdf"
    moving: tuple[str, ...] = ("shoulder", "elbow joint")
    speeds: tuple[float, ...] = (1.0, 2.0)
    drop: float = 0.0

    @cached_property
    def tree(self) -> KinematicTree:
        """Joints and bodies of the robot."""
        return two_links(self.speeds, self.drop)

    def among(self, obstacles: Sequence[Shape]) -> KinematicTree:
        """Return joints and bodies of the robot with boxes as further bodies; every link may hit every box."""
        tree = self.tree
        boxes = tuple(
            box_body(f"obstacle[{n}]", -1, box.lower, box.upper)
            for n, box in enumerate(obstacles)
            if isinstance(box, rg.Box)
        )
        first = len(tree.bodies)
        pairs = [[link, first + n] for link in (1, 2) for n in range(len(boxes))]
        return replace(
            tree,
            bodies=tree.bodies + boxes,
            pairs=np.concatenate([tree.pairs, np.array(pairs, dtype=np.int64).reshape(-1, 2)]),
        )
