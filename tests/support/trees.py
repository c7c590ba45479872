"""Kinematic trees for tests, made by hand or at random, and convex pieces that coal measures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from resgrid.robots.convex import Body, ConvexPiece, Solid
from resgrid.robots.urdf.tree import KinematicTree

Floats = NDArray[np.float64]

NO_POINTS, NO_TRIANGLES = np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32)


def pose(xyz: Sequence[float] = (0.0, 0.0, 0.0), axis: Sequence[float] = (0.0, 0.0, 1.0), angle: float = 0.0) -> Floats:
    """Return a pose (4, 4) from a translation and a rotation about a unit vector."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out = np.eye(4)
    out[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)
    out[:3, 3] = xyz
    return out


def box(name: str, joint: int, size: Sequence[float], at: Floats | Sequence[float] = (0.0, 0.0, 0.0)) -> Body:
    """Return a box centred at a pose or point."""
    placement = np.asarray(at) if np.ndim(at) == 2 else pose(at)  # type: ignore[arg-type]
    corners = np.array(np.meshgrid(*([-side / 2, side / 2] for side in size))).reshape(3, -1).T
    piece = ConvexPiece(corners @ placement[:3, :3].T + placement[:3, 3])
    return Body(name, joint, Solid("box", tuple(map(float, size)), placement, NO_POINTS, NO_TRIANGLES), piece, (piece,))


def ball(name: str, joint: int, radius: float, at: Sequence[float] = (0.0, 0.0, 0.0)) -> Body:
    """Return a ball."""
    piece = ConvexPiece(np.array([at], dtype=np.float64), radius)
    return Body(name, joint, Solid("ball", (radius,), pose(at), NO_POINTS, NO_TRIANGLES), piece, (piece,))


def half_space(name: str, height: float = 0.0) -> Body:
    """Return the half-space below a height."""
    piece = ConvexPiece(np.array([[0.0, 0.0, height]]), 0.0, np.array([0.0, 0.0, 1.0]))
    return Body(name, -1, Solid("half_space", (), pose((0, 0, height)), NO_POINTS, NO_TRIANGLES), piece, (piece,))


def mesh(name: str, joint: int, parts: Sequence[Floats], at: Floats | None = None) -> Body:
    """Return the union of the convex hulls of some parts (v, 3), as a mesh with the surfaces of all parts."""
    placement = np.eye(4) if at is None else at
    points, triangles, start = [], [], 0
    for part in parts:
        hull = ConvexHull(part)
        corners = hull.simplices.copy()
        across = np.cross(part[corners[:, 1]] - part[corners[:, 0]], part[corners[:, 2]] - part[corners[:, 0]])
        inward = np.einsum("ti,ti->t", across, hull.equations[:, :3]) < 0
        corners[inward] = corners[inward][:, ::-1]
        points.append(part)
        triangles.append(corners + start)
        start += len(part)
    moved = [part @ placement[:3, :3].T + placement[:3, 3] for part in parts]
    solid = Solid("mesh", (), placement, np.concatenate(points), np.concatenate(triangles).astype(np.int32))
    pieces = tuple(ConvexPiece(part) for part in moved)
    return Body(name, joint, solid, ConvexPiece(np.concatenate(moved)), pieces)


def block(lower: Sequence[float], upper: Sequence[float]) -> Floats:
    """Return the corners (8, 3) of a box with sides along the axes."""
    return np.array(np.meshgrid(*zip(lower, upper, strict=True))).reshape(3, -1).T.astype(np.float64)


def tree(
    joints: Sequence[tuple[int, Floats, Sequence[float]]],
    bodies: Sequence[Body],
    pairs: Sequence[tuple[int, int]],
    *,
    prismatic: Sequence[int] = (),
    driver: Sequence[int] | None = None,
    factor: Sequence[float] | None = None,
    offset: Sequence[float] | None = None,
) -> KinematicTree:
    """Return a tree; `joints`: parent, placement and direction of every joint."""
    count = len(joints)
    drivers = np.arange(count) if driver is None else np.array(driver)
    moving = int(drivers.max()) + 1
    return KinematicTree(
        tuple(f"q{i}" for i in range(moving)), np.full(moving, -np.pi), np.full(moving, np.pi), np.full(moving, np.inf),
        np.zeros(moving, bool), tuple(f"joint{i}" for i in range(count)),
        np.array([parent for parent, _, _ in joints]), np.array([placement for _, placement, _ in joints]),
        np.array([direction for _, _, direction in joints], dtype=np.float64), np.isin(np.arange(count), prismatic),
        drivers, np.ones(count) if factor is None else np.array(factor),
        np.zeros(count) if offset is None else np.array(offset), tuple(bodies),
        np.array(pairs, dtype=np.int64).reshape(-1, 2), {},
    )  # fmt: skip


def random_tree(rng: np.random.Generator) -> KinematicTree:
    """Return a tree of 1 to 6 joints with random convex bodies: branches, sliding and following joints."""
    count = int(rng.integers(1, 7))
    moving = int(rng.integers(1, min(count, 4) + 1))
    driver = np.concatenate([np.arange(moving), rng.integers(0, moving, count - moving)])
    parents = [-1, *(int(rng.integers(-1, joint)) for joint in range(1, count))]
    joints = [(parent, pose(rng.normal(0, 0.4, 3), unit(rng), rng.uniform(-3, 3)), unit(rng)) for parent in parents]
    bodies = [random_body(rng, f"link{joint}", joint) for joint in range(count)]
    bodies += [random_body(rng, f"obstacle{i}", -1) for i in range(3)] + [half_space("floor", rng.uniform(-1, 0))]
    pairs = [(b, a) for b in range(count) for a in range(b)]
    pairs += [(a, b) for a in range(count) for b in range(count, len(bodies))]
    return tree(
        joints, bodies, pairs, prismatic=np.flatnonzero(rng.random(count) < 0.25).tolist(), driver=driver.tolist(),
        factor=np.where(np.arange(count) < moving, 1.0, rng.uniform(-1.5, 1.5, count)).tolist(),
        offset=np.where(np.arange(count) < moving, 0.0, rng.uniform(-1, 1, count)).tolist(),
    )  # fmt: skip


def random_body(rng: np.random.Generator, name: str, joint: int) -> Body:
    """Return a ball, a box or a convex polyhedron."""
    kind = rng.integers(3)
    centre = rng.normal(0, 0.3, 3)
    if kind == 0:
        return ball(name, joint, rng.uniform(0.02, 0.2), centre)
    if kind == 1:
        return box(name, joint, rng.uniform(0.05, 0.5, 3), pose(centre, unit(rng), rng.uniform(-3, 3)))
    return mesh(name, joint, [centre + rng.normal(0, 0.15, (int(rng.integers(6, 30)), 3))])


def unit(rng: np.random.Generator) -> Floats:
    """Return a random unit vector; often along an axis of coordinates."""
    if rng.random() < 0.4:
        return np.roll([1.0, 0.0, 0.0], rng.integers(3))
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


class PieceDistance:
    """Distance of two convex pieces by coal, with kinematics by `KinematicTree.frames`: independent of the proofs."""

    def __init__(self, kinematics: KinematicTree, pair: int) -> None:
        import coal

        self.coal, self.tree = coal, kinematics
        self.bodies = [kinematics.bodies[body] for body in kinematics.pairs[pair]]
        self.shapes = [self._shape(body.hull) for body in self.bodies]

    def _shape(self, piece: ConvexPiece) -> Any:
        if piece.normal is not None:
            return self.coal.Halfspace(piece.normal, float(piece.normal @ piece.points[0]))
        if len(piece.points) == 1:
            return self.coal.Sphere(piece.radius)
        hull = ConvexHull(piece.points)
        points, triangles = self.coal.StdVec_Vec3s(), self.coal.StdVec_Triangle()
        points.extend(list(piece.points))
        triangles.extend([self.coal.Triangle(*map(int, corners)) for corners in hull.simplices])
        return self.coal.Convex(points, triangles)

    def __call__(self, configurations: Floats) -> Floats:
        found = np.empty(len(configurations))
        request, result = self.coal.DistanceRequest(), self.coal.DistanceResult()
        for i, frames in enumerate(self.tree.frames(configurations)):
            placed = []
            for body in self.bodies:
                place = np.eye(4) if body.joint < 0 else frames[body.joint]
                at = place[:3, :3] @ body.hull.points[0] + place[:3, 3] if len(body.hull.points) == 1 else place[:3, 3]
                if body.hull.normal is not None:
                    at = np.zeros(3)
                placed.append(self.coal.Transform3s(np.ascontiguousarray(place[:3, :3]), at))
            result.clear()
            found[i] = self.coal.distance(self.shapes[0], placed[0], self.shapes[1], placed[1], request, result)
        return found
