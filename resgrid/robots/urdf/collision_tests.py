"""`SolidTest`, the collision test of a robot from a URDF file: distances and first collisions of exact solids."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from resgrid.robots.collision_tests import CollisionTest, Hit
from resgrid.robots.urdf.collision import CollisionChecker
from resgrid.robots.urdf.tree import KinematicTree

_BATCH = 256
"""Number of configurations that are tested at once; the search ends after the first batch with a collision."""

_OBSTACLE = re.compile(r"^obstacle\[(\d+)\]")
"""Beginning of the names of bodies that belong to an obstacle, with its index."""


class SolidTest(CollisionTest):
    """A robot from a URDF file among obstacles, with the exact solids of both.

    `tree`: robot and surroundings, with the pairs of bodies that must not touch each other.
    """

    def __init__(self, tree: KinematicTree) -> None:
        self._tree, self._checker = tree, CollisionChecker(tree)

    def clearances(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the smallest distances (n,), in metres, between bodies that must not touch, for configurations (n, m).

        The distance is 0 for a collision, and infinite for a tree without pairs.
        """
        return self._checker.distance(configurations)

    def first_hit(self, configurations: NDArray[np.float64]) -> Hit | None:
        """Return the first collision among configurations (n, m), in their order; None without a collision.

        Solids that touch collide.
        """
        for first in range(0, len(configurations), _BATCH):
            pairs = self._checker.first_pairs(configurations[first : first + _BATCH])
            hits = np.flatnonzero(pairs >= 0)
            if len(hits):
                return self._hit(first + int(hits[0]), int(pairs[hits[0]]))
        return None

    def _hit(self, row: int, pair: int) -> Hit:
        one, other = self._tree.pairs[pair].tolist()
        names = self._tree.bodies[one].name, self._tree.bodies[other].name
        found = _OBSTACLE.match(names[1]) if self._tree.bodies[other].joint < 0 else None
        return Hit(row, one, None if found is None else int(found[1]), names)
