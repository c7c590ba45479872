"""Collision tests and distances of exact solids at single configurations, by the collision library coal."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.errors import InputError
from resgrid.robots.urdf.exact_solids import PlacedSolid, coal_module
from resgrid.robots.urdf.tree import KinematicTree

BATCH = 4096
"""Largest number of configurations for which the poses of all joints are computed at once, which limits the memory."""

BOUNDS = 1_000_000
"""Largest number of bounds of distances that are computed at once, which limits the memory.

One bound is computed for every configuration and every pair of bodies.
"""

_Floats = NDArray[np.float64]
_Worlds = Sequence[_Floats]


class CollisionChecker:
    """Collision test of a robot at single configurations, with the solids themselves instead of convex covers.

    Solids that touch each other collide.  A mesh with a closed surface also counts its interior: a solid that lies
    inside, without contact with the surface, collides.  Of a mesh with an open surface only the triangles count.
    Distances below some 1e-6 m may be reported as collisions.

    Parameters
    ----------
    tree : KinematicTree
        Robot and surroundings, with the pairs of bodies that must not touch each other.

    Raises
    ------
    ToolMissingError
        If coal is not installed, at the first test.
    """

    def __init__(self, tree: KinematicTree) -> None:
        self.tree = tree
        self._local = threading.local()  # the objects of coal must not be shared by threads

    def __reduce__(self) -> tuple[type[CollisionChecker], tuple[KinematicTree]]:
        return CollisionChecker, (self.tree,)

    def collides(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Return whether any pair of ``tree.pairs`` collides, shape (n,), for configurations (n, m), radians or metres.

        The pairs are those that must not touch: bodies of the robot with the surroundings and, if self-collision is
        tested, with each other, except links that may touch (adjacent ones, or those that an SRDF file disables).
        """
        return self.first_pairs(configurations) >= 0

    def first_pairs(
        self, configurations: ArrayLike, pairs: Sequence[int] | NDArray[np.int64] | None = None
    ) -> NDArray[np.int64]:
        """Return the index in ``tree.pairs`` of the first pair that collides, -1 for none, shape (n,).

        `configurations` (n, m): values of the m moving joints, in radians or metres; `pairs`: indices of the tested
        pairs in ``tree.pairs``, in the order of the tests; None for all pairs. Raises InputError for a wrong number of
        values.
        """
        values = self._checked(configurations)
        tested = range(len(self.tree.pairs)) if pairs is None else pairs
        found = np.full(len(values), -1, dtype=np.int64)
        for batch in _batches(len(values)):
            found[batch] = self._tests.first_pairs(self.tree.frames(values[batch]), tested)
        return found

    def names(self, pair: int) -> tuple[str, str]:
        """Return the names of the two bodies of a pair; `pair`: index in ``tree.pairs``."""
        first, second = self.tree.pairs[pair]
        return self.tree.bodies[first].name, self.tree.bodies[second].name

    def collide_in_pairs(self, configurations: _Floats, pairs: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return whether pair ``pairs[i]`` collides at configuration i, shape (n,).

        `configurations` (n, m): values of the m moving joints, in radians or metres; `pairs` (n,): indices in
        ``tree.pairs``.
        """
        found = np.zeros(len(pairs), dtype=bool)
        for batch in _batches(len(pairs)):
            found[batch] = self._tests.collide(self.tree.frames(configurations[batch]), pairs[batch])
        return found

    def distance(self, configurations: ArrayLike) -> _Floats:
        """Return the smallest distance between the bodies of any pair of ``tree.pairs``, in metres, shape (n,).

        The distance is 0 if a pair collides, and infinite for a tree without pairs. `configurations` (n, m): values of
        the m moving joints, in radians or metres. Raises InputError for a wrong number of values.
        """
        values = self._checked(configurations)
        found = np.full(len(values), np.inf)
        for batch in _batches(len(values), BOUNDS // max(len(self.tree.pairs), 1)):
            found[batch] = self._tests.distances(self.tree.frames(values[batch]))
        return found

    def _checked(self, configurations: ArrayLike) -> _Floats:
        """Return one configuration (m,) or several (n, m) as an array (n, m); raise InputError for another shape."""
        values = np.atleast_2d(np.asarray(configurations, dtype=np.float64))
        if values.ndim != 2 or values.shape[1] != len(self.tree.moving):
            raise InputError(
                f"a configuration of this robot has {len(self.tree.moving)} values ({', '.join(self.tree.moving)}), "
                f"got an array of shape {np.shape(configurations)}"
            )
        return values

    @property
    def _tests(self) -> _PairTests:
        """Tests of all pairs of bodies, with coal objects that only the calling thread uses."""
        tests: _PairTests | None = getattr(self._local, "tests", None)
        if tests is None:
            tests = self._local.tests = _PairTests(self.tree)
        return tests


class _PairTests:
    """Tests of the pairs of a tree at n configurations.

    The methods take `frames` (n, k, 4, 4), the poses in the world of the k joints at every configuration, and `worlds`,
    the poses in the world of all solids, (n, 4, 4) or (1, 4, 4) each. A pair is an index in ``tree.pairs``.
    """

    def __init__(self, tree: KinematicTree) -> None:
        coal = coal_module()
        self._solids = [PlacedSolid(body.solid, body.joint) for body in tree.bodies]
        self._pairs: list[tuple[int, int]] = [(int(first), int(second)) for first, second in tree.pairs]
        shapes = [[self._solids[body].geometry for body in pair] for pair in self._pairs]
        self._collide = [coal.ComputeCollision(*shape) for shape in shapes]
        self._measure = [coal.ComputeDistance(*shape) for shape in shapes]
        self._request, self._result = coal.CollisionRequest(), coal.CollisionResult()
        self._request.enable_contact = False
        self._distance_request, self._distance_result = coal.DistanceRequest(), coal.DistanceResult()

    def first_pairs(self, frames: _Floats, pairs: Iterable[int]) -> NDArray[np.int64]:
        """Return, for every configuration, the first of the given pairs that collides, -1 for none, shape (n,)."""
        found = np.full(len(frames), -1, dtype=np.int64)
        worlds = self._worlds(frames)
        boxes = [solid.boxes(world) for solid, world in zip(self._solids, worlds, strict=True)]
        for pair in pairs:
            first, second = self._pairs[pair]
            (centre, half), (other, its) = boxes[first], boxes[second]
            near = (np.abs(centre - other) <= half + its).all(axis=1)
            for index in np.flatnonzero(near & (found < 0)).tolist():
                if self._collides(pair, worlds, index):
                    found[index] = pair
        return found

    def collide(self, frames: _Floats, pairs: NDArray[np.int64]) -> list[bool]:
        """Return for every configuration whether its pair collides; `pairs` (n,): one pair per configuration."""
        worlds = self._worlds(frames)
        return [self._collides(pair, worlds, index) for index, pair in enumerate(pairs.tolist())]

    def distances(self, frames: _Floats) -> _Floats:
        """Return the smallest distance of all pairs in metres, (n,): 0 for a collision, infinite without pairs."""
        worlds = self._worlds(frames)
        boxes = [solid.boxes(world) for solid, world in zip(self._solids, worlds, strict=True)]
        bounds = np.empty((len(frames), len(self._pairs)))
        for pair, (first, second) in enumerate(self._pairs):
            (centre, half), (other, its) = boxes[first], boxes[second]
            bounds[:, pair] = np.linalg.norm(np.maximum(np.abs(centre - other) - half - its, 0.0), axis=1)
        nearest = np.full(len(frames), np.inf)
        for index, order in enumerate(bounds.argsort(axis=1, kind="stable")):
            for pair in order.tolist():
                if bounds[index, pair] >= nearest[index]:
                    break
                nearest[index] = min(nearest[index], self._distance(pair, worlds, index))
        return nearest

    def _worlds(self, frames: _Floats) -> _Worlds:
        """Return the poses of all solids in the world: (n, 4, 4), or (1, 4, 4) for a solid that does not move."""
        return [solid.worlds(frames) for solid in self._solids]

    def _collides(self, pair: int, worlds: _Worlds, index: int) -> bool:
        """Return whether a pair collides at configuration number `index`, from 0."""
        first, second = self._pairs[pair]
        one, other = self._solids[first], self._solids[second]
        one.move(worlds[first], index)
        other.move(worlds[second], index)
        self._result.clear()
        if self._collide[pair](one.pose, other.pose, self._request, self._result):
            return True
        return one.contains_a_point_of(other) or other.contains_a_point_of(one)

    def _distance(self, pair: int, worlds: _Worlds, index: int) -> float:
        """Return the distance of a pair in metres at configuration number `index`, 0 for a collision."""
        if self._collides(pair, worlds, index):
            return 0.0
        first, second = (self._solids[body] for body in self._pairs[pair])
        self._distance_result.clear()
        found = self._measure[pair](first.pose, second.pose, self._distance_request, self._distance_result)
        return max(float(found), 0.0)


def _batches(count: int, most: int = BATCH) -> Iterator[slice]:
    """Return slices that divide `count` configurations into batches of at most `most`, clipped to [1, `BATCH`]."""
    size = max(min(most, BATCH), 1)
    return (slice(start, min(start + size, count)) for start in range(0, count, size))
