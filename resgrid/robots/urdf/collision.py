"""Collision tests and distances of exact solids with coal, at single configurations."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.extras import install_command
from resgrid.errors import InputError, ToolMissingError
from resgrid.robots.convex import Solid
from resgrid.robots.urdf.tree import KinematicTree

BATCH = 4096
"""Number of configurations whose poses are computed at once."""

_Floats = NDArray[np.float64]


class CollisionChecker:
    """Collision test of a robot at single configurations, with the solids themselves instead of convex covers.

    Solids that touch each other collide.  A mesh with a closed surface also counts its interior: a solid that lies
    inside, without contact with the surface, collides.

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

    def __getstate__(self) -> KinematicTree:
        return self.tree

    def __setstate__(self, tree: KinematicTree) -> None:
        self.__init__(tree)  # type: ignore[misc]

    def collides(self, configurations: ArrayLike) -> NDArray[np.bool_]:
        """Return whether any pair of bodies collides, shape (n,), for configurations (n, m)."""
        return self.first_pairs(configurations) >= 0

    def first_pairs(
        self, configurations: ArrayLike, pairs: Sequence[int] | NDArray[np.int64] | None = None
    ) -> NDArray[np.int64]:
        """Return the index of the first pair that collides, -1 for none, shape (n,), for configurations (n, m).

        `pairs`: indices of the tested pairs in the order of the tests, by default of all pairs.
        """
        values = self._checked(configurations)
        tested = range(len(self.tree.pairs)) if pairs is None else pairs
        found = np.full(len(values), -1, dtype=np.int64)
        for start in range(0, len(values), BATCH):
            batch = slice(start, start + BATCH)
            poses = self.tree.frames(values[batch])
            found[batch] = self._first_pairs(poses, tested)
        return found

    def names(self, pair: int) -> tuple[str, str]:
        """Return the names of the two bodies of a pair."""
        first, second = self.tree.pairs[pair]
        return self.tree.bodies[first].name, self.tree.bodies[second].name

    def collide_in_pairs(self, configurations: _Floats, pairs: Sequence[int] | NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return whether pair ``pairs[i]`` collides at configuration i, shape (n,), for configurations (n, m)."""
        found = np.zeros(len(pairs), dtype=bool)
        for start in range(0, len(pairs), BATCH):
            batch = slice(start, start + BATCH)
            poses = self.tree.frames(configurations[batch])
            for i, pair in enumerate(pairs[batch]):
                found[start + i] = self._tests[pair].collides(poses[i])
        return found

    def distance(self, configurations: ArrayLike) -> _Floats:
        """Return the smallest distance of all pairs in metres, shape (n,), for configurations (n, m).

        The distance is 0 for a collision, and infinite without pairs.
        """
        values = self._checked(configurations)
        found = np.full(len(values), np.inf)
        for start in range(0, len(values), BATCH):
            batch = slice(start, start + BATCH)
            for i, pose in enumerate(self.tree.frames(values[batch])):
                found[start + i] = self._distance(pose)
        return found

    def _distance(self, pose: _Floats) -> float:
        """Return the smallest distance of all pairs at poses (k, 4, 4); pairs that are farther apart are skipped."""
        nearest = np.inf
        gaps = [(test.ball_gap(pose), index) for index, test in enumerate(self._tests)]
        for gap, index in sorted(gaps):
            if gap >= nearest:
                break
            nearest = min(nearest, self._tests[index].distance(pose))
        return nearest

    def _first_pairs(self, poses: _Floats, pairs: Iterable[int]) -> NDArray[np.int64]:
        """Return the first of some pairs that collides, -1 for none, (n,), for poses (n, k, 4, 4)."""
        found = np.full(len(poses), -1, dtype=np.int64)
        for index in pairs:
            test = self._tests[index]
            near = np.flatnonzero((found < 0) & (test.ball_gaps(poses) <= 0.0))
            for i in near:
                if test.collides(poses[i]):
                    found[i] = index
        return found

    def _checked(self, configurations: ArrayLike) -> _Floats:
        """Return configurations as an array (n, m); raise InputError for another shape."""
        values = np.atleast_2d(np.asarray(configurations, dtype=np.float64))
        if values.ndim != 2 or values.shape[1] != len(self.tree.moving):
            raise InputError(
                f"a configuration of this robot has {len(self.tree.moving)} values ({', '.join(self.tree.moving)}), "
                f"got an array of shape {np.shape(configurations)}"
            )
        return values

    @property
    def _tests(self) -> list[_PairTest]:
        """The tests of all pairs, with coal objects that belong to the present thread."""
        tests: list[_PairTest] | None = getattr(self._local, "tests", None)
        if tests is None:
            places = [_PlacedSolid(body.solid, body.joint) for body in self.tree.bodies]
            tests = self._local.tests = [_PairTest(places[a], places[b]) for a, b in self.tree.pairs]
        return tests


class _PlacedSolid:
    """A solid as a coal geometry, with the ball around it; `joint`: joint that moves the solid, -1 for none."""

    def __init__(self, solid: Solid, joint: int) -> None:
        coal = _coal()
        self.joint, self.placement, self.geometry = joint, np.asarray(solid.placement), _geometry(solid)
        self.pose = coal.Transform3s()
        corners = _corners(solid)
        self.inside = _Interior(solid) if solid.kind == "mesh" else None
        if corners is None:
            self.centre, self.radius, self.some = np.zeros(3), np.inf, np.zeros(3)
        else:
            self.centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
            self.radius = float(np.linalg.norm(corners - self.centre, axis=1).max())
            self.some = corners[0] if solid.kind == "mesh" else np.zeros(3)

    def set_pose(self, poses: _Floats) -> None:
        """Move the solid to the pose of its joint, for poses (k, 4, 4) of all joints."""
        pose = self.matrix(poses)
        self.pose.setTransform(pose[:3, :3], pose[:3, 3])

    def matrix(self, poses: _Floats) -> _Floats:
        """Return the pose in the world (..., 4, 4) for poses (..., k, 4, 4) of all joints."""
        if self.joint < 0:
            return self.placement
        return np.asarray(poses[..., self.joint, :, :] @ self.placement)

    def contains_some(self, other: _PlacedSolid, poses: _Floats) -> bool:
        """Return whether one point of another solid lies inside this one, a mesh with a closed surface."""
        if self.inside is None or not self.inside.is_closed or not np.isfinite(other.radius):
            return False
        own, its = self.matrix(poses), other.matrix(poses)
        point = its[:3, :3] @ other.some + its[:3, 3] - own[:3, 3]
        return self.inside.contains(own[:3, :3].T @ point)


@dataclass(eq=False)
class _PairTest:
    """Tests of two solids."""

    first: _PlacedSolid
    second: _PlacedSolid

    def __post_init__(self) -> None:
        coal = _coal()
        solids = self.first.geometry, self.second.geometry
        self._collide, self._measure = coal.ComputeCollision(*solids), coal.ComputeDistance(*solids)
        self._request, self._result = coal.CollisionRequest(), coal.CollisionResult()
        self._request.enable_contact = False
        self._distance_request, self._distance_result = coal.DistanceRequest(), coal.DistanceResult()

    def collides(self, poses: _Floats) -> bool:
        """Return whether the solids collide at poses (k, 4, 4) of all joints."""
        self.first.set_pose(poses)
        self.second.set_pose(poses)
        self._result.clear()
        if self._collide(self.first.pose, self.second.pose, self._request, self._result):
            return True
        return self.first.contains_some(self.second, poses) or self.second.contains_some(self.first, poses)

    def distance(self, poses: _Floats) -> float:
        """Return the distance of the solids in metres, 0 for a collision, at poses (k, 4, 4) of all joints."""
        if self.collides(poses):
            return 0.0
        self._distance_result.clear()
        found = self._measure(self.first.pose, self.second.pose, self._distance_request, self._distance_result)
        return max(float(found), 0.0)

    def ball_gaps(self, poses: _Floats) -> _Floats:
        """Return lower bounds of the distance (n,) from the balls around the solids, for poses (n, k, 4, 4)."""
        if not np.isfinite(self.first.radius + self.second.radius):
            return np.full(len(poses), -np.inf)
        a, b = (
            np.broadcast_to(pose[..., :3, :3] @ solid.centre + pose[..., :3, 3], (len(poses), 3))
            for solid, pose in ((solid, solid.matrix(poses)) for solid in (self.first, self.second))
        )
        return np.asarray(np.linalg.norm(a - b, axis=1) - (self.first.radius + self.second.radius) * (1 + 1e-9) - 1e-9)

    def ball_gap(self, pose: _Floats) -> float:
        """Return a lower bound of the distance from the balls around the solids, for poses (k, 4, 4)."""
        return float(self.ball_gaps(pose[np.newaxis])[0])


class _Interior:
    """Test of points inside a mesh whose surface is closed: the winding number of van Oosterom and Strackee (1983)."""

    def __init__(self, solid: Solid) -> None:
        points, triangles = np.asarray(solid.points), np.asarray(solid.triangles)
        self.lower, self.upper = points.min(axis=0), points.max(axis=0)
        _, same = np.unique(points, axis=0, return_inverse=True)
        welded = same.reshape(-1)[triangles]
        welded = welded[(welded != np.roll(welded, 1, axis=1)).all(axis=1)]
        edges = np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]], welded[:, [2, 0]]])
        forward, count = np.unique(edges, axis=0, return_counts=True)
        backward = np.unique(edges[:, ::-1], axis=0)
        self.is_closed = bool((count == 1).all() and np.array_equal(forward, backward))
        self.corners = points[triangles] if self.is_closed else None

    def contains(self, point: _Floats) -> bool:
        """Return whether a point (3,) in the frame of the mesh is inside."""
        if self.corners is None or (point <= self.lower).any() or (point >= self.upper).any():
            return False
        a, b, c = np.moveaxis(self.corners - point, 1, 0)
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        volume = np.einsum("ti,ti->t", a, np.cross(b, c))
        ab, bc, ca = (np.einsum("ti,ti->t", x, y) for x, y in ((a, b), (b, c), (c, a)))
        angle = np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
        return bool(abs(angle.sum()) > np.pi)


def _corners(solid: Solid) -> _Floats | None:
    """Return points whose convex hull contains a solid (v, 3), in the frame of its placement; None for a half-space."""
    if solid.kind == "half_space":
        return None
    if solid.kind == "mesh":
        return np.asarray(solid.points)
    if solid.kind == "box":
        half = np.array(solid.size) / 2
    elif solid.kind == "ball":
        half = np.full(3, solid.size[0])
    elif solid.kind == "cylinder":
        half = np.array([solid.size[0], solid.size[0], solid.size[1] / 2])
    else:
        half = np.array([solid.size[0], solid.size[0], solid.size[1] / 2 + solid.size[0]])
    return np.array(np.meshgrid(*([-side, side] for side in half))).reshape(3, -1).T


def _geometry(solid: Solid) -> Any:
    """Return a solid as a coal geometry, in the frame of its placement."""
    coal = _coal()
    if solid.kind == "half_space":
        return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    if solid.kind == "mesh":
        return _surface(solid)
    makers = {"box": coal.Box, "ball": coal.Sphere, "cylinder": coal.Cylinder, "capsule": coal.Capsule}
    return makers[solid.kind](*(float(size) for size in solid.size))


def _surface(solid: Solid) -> Any:
    """Return the triangles of a mesh as a coal geometry."""
    coal = _coal()
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(list(np.asarray(solid.points, dtype=np.float64)))
    triangles.extend([coal.Triangle(*corners) for corners in solid.triangles.tolist()])
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(triangles), len(points))
    model.addSubModel(points, triangles)
    model.endModel()
    return model


@cache
def _coal() -> Any:
    """Return the module coal; raise ToolMissingError if it is not installed."""
    try:
        return import_module("coal")
    except ImportError as error:
        raise ToolMissingError(
            f"collision tests of robots need the package coal; install it with: {install_command('robots')}"
        ) from error
