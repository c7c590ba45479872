"""Interface of exact tests of a robot among obstacles (first collision, clearances), and the test in the plane."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.robots.geometry import Obstacle, RigidPart

PartsOf = Callable[[NDArray[np.float64]], list[RigidPart]]
"""Function that returns the rigid parts of a robot in configurations (n, ndim)."""


class Hit(NamedTuple):
    """First collision in a sequence of configurations.

    `row`: index of the configuration in the sequence; `part`: index of the robot's rigid part or body that collides;
    `obstacle`: index of the obstacle, None for a collision of the robot with itself; `names`: names of the two bodies
    that collide, None for robots of the plane.
    """

    row: int
    part: int
    obstacle: int | None
    names: tuple[str, str] | None = None


class CollisionTest(ABC):
    """Interface of a collision test, which holds a robot and fixed obstacles.

    The test returns the clearance at every given configuration, and the first collision in a sequence of them.
    """

    @abstractmethod
    def clearances(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return distances (n,), in metres, to the nearest collision at each of the configurations (n, ndim).

        Each is the smallest distance of the robot from an obstacle or, if the test includes self-collision, between two
        of its bodies.  The distance is 0 for a collision or contact, and infinite if nothing can collide.
        """

    @abstractmethod
    def first_hit(self, configurations: NDArray[np.float64]) -> Hit | None:
        """Return the first collision among configurations (n, ndim), in their order; None without a collision."""


class PlanarTest(CollisionTest):
    """Collision test of a robot of the plane among obstacles, with shapely.

    `parts`: function from configurations (n, ndim) to the robot's rigid parts; `obstacles`: the obstacles.
    """

    def __init__(self, parts: PartsOf, obstacles: Sequence[Obstacle]) -> None:
        self._parts, self._obstacles = parts, obstacles

    def clearances(self, configurations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return distances (n,), in metres, from the robot to the nearest obstacle for configurations (n, ndim).

        The distance is 0 for a collision or contact, and infinite without obstacles.
        """
        parts = self._parts(configurations)
        nearest = np.full(len(configurations), np.inf)
        for obstacle in self._obstacles:
            for part in parts:
                nearest = np.minimum(nearest, obstacle.distance(part))
        return nearest

    def first_hit(self, configurations: NDArray[np.float64]) -> Hit | None:
        """Return the first collision among configurations (n, ndim), in their order; None without a collision.

        Bodies that touch do not collide, nor do round bodies and half-planes that are entered by at most 1e-9 of the
        sum of 1 m and the radii (`TOUCH`).
        """
        hits = [
            Hit(int(np.argmax(hit)), number, obstacle.number)
            for number, part in enumerate(self._parts(configurations))
            for obstacle in self._obstacles
            if (hit := obstacle.collides(part)).any()
        ]
        return min(hits, default=None)
