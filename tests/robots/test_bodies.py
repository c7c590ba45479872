"""Bodies of shapes: the convex pieces contain the exact solid, the hull contains the pieces.

Tests internals: `resgrid.robots.body`, `resgrid.robots.convex`.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog
from support.space_shapes import CUBE, FACES, a_shape

import resgrid as rg
from resgrid.robots.body import bodies_of
from resgrid.robots.convex import ConvexPiece, Solid


def points_of(solid: Solid, random: np.random.Generator, count: int = 200) -> np.ndarray:
    """Return random points (n, 3) of a solid, most of them on its surface."""
    match solid.kind:
        case "box":
            local = (random.integers(0, 3, (count, 3)) / 2 - 0.5) * solid.size
        case "ball":
            local = random.normal(size=(count, 3))
            local *= solid.size[0] / np.linalg.norm(local, axis=1, keepdims=True)
        case "cylinder" | "capsule":
            radius, length = solid.size
            angle = random.uniform(0, 2 * np.pi, count)
            z = random.choice([-0.5, 0.5], count) * length
            local = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])
            if solid.kind == "capsule":
                tilt = random.uniform(0, np.pi / 2, count)
                local[:, :2] *= np.cos(tilt)[:, None]
                local[:, 2] += np.sign(z) * radius * np.sin(tilt)
        case "half_space":
            local = random.uniform(-3, 3, (count, 3)) - [0, 0, 3]
        case "mesh":
            parts = random.dirichlet([0.5] * 3, count)
            corners = solid.points[solid.triangles[random.integers(len(solid.triangles), size=count)]]
            local = np.einsum("nk,nkj->nj", parts, corners)
    return local @ solid.placement[:3, :3].T + solid.placement[:3, 3]


def contains(piece: ConvexPiece, point: np.ndarray, slack: float) -> bool:
    """Return whether a piece contains a point, by linear programming over the hull (L1 distance for the radius)."""
    if piece.normal is not None:
        return bool((point - piece.points[0]) @ piece.normal <= piece.radius + slack)
    if len(piece.points) == 1:
        return bool(np.linalg.norm(point - piece.points[0]) <= piece.radius + slack)
    if len(piece.points) == 2:
        start, end = piece.points
        part = np.clip((point - start) @ (end - start) / np.sum((end - start) ** 2), 0, 1)
        return bool(np.linalg.norm(point - start - part * (end - start)) <= piece.radius + slack)
    offsets = np.vstack([(piece.points - point).T, np.ones(len(piece.points))])
    bounds = [(0, None)] * len(piece.points)
    within = np.vstack([offsets[:3], -offsets[:3]])
    found = linprog(np.zeros(len(bounds)), within, np.full(6, slack), offsets[3:], [1.0], bounds=bounds)
    return bool(found.status == 0)


@pytest.mark.parametrize("kind", ["cylinder", "upright", "capsule", "box", "ring", "crate", "half"])
@pytest.mark.parametrize("padding", [0.0, 0.02])
def test_the_pieces_contain_the_solid(kind: str, padding: float) -> None:
    random = np.random.default_rng(7)
    shape = a_shape(kind, random)
    (body,) = bodies_of(shape, "obstacle[2]", padding)
    assert body.name == "obstacle[2]" and body.joint == -1
    assert body.hull.radius >= padding or kind == "half"
    for point in points_of(body.solid, random, 40):
        assert contains(body.hull, point, 1e-9)
        assert any(contains(piece, point, 1e-9) for piece in body.pieces)
        low, high = shape.bounds
        assert (point >= np.array(low) - 1e-9).all() and (point <= np.array(high) + 1e-9).all()


def test_balls_boxes_and_voxels_give_one_body_each() -> None:
    (ball,) = bodies_of(rg.Ball((1.0, 2.0, 3.0), 0.5), "ball", 0.1)
    assert ball.solid.kind == "ball" and ball.hull.radius == 0.6 and ball.hull.points.tolist() == [[1.0, 2.0, 3.0]]
    (box,) = bodies_of(rg.Box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)), "box")
    assert box.solid.size == (1.0, 2.0, 3.0) and sorted(box.hull.points.tolist()) == sorted((CUBE * [1, 2, 3]).tolist())
    voxels = rg.Voxels((0.5, 0.0, 0.0), 0.5, [[[0, 0, 0], [2, 1, 1]], [[4, 4, 4], [5, 5, 5]]])
    first, second = bodies_of(voxels, "cloud")
    assert first.solid.size == (1.0, 0.5, 0.5) and second.solid.placement[:3, 3].tolist() == [2.75, 2.25, 2.25]
    for body, (low, high) in zip((first, second), voxels.corners, strict=True):
        assert body.hull.points.min(axis=0).tolist() == low.tolist()
        assert body.hull.points.max(axis=0).tolist() == high.tolist()


def test_bodies_of_half_spaces_point_out_of_the_solid() -> None:
    (floor,) = bodies_of(rg.HalfSpace((0.0, 0.0, 2.0), 0.5), "floor")
    assert floor.hull.normal is not None and floor.hull.normal.tolist() == [0.0, 0.0, 1.0]
    assert floor.hull.points.tolist() == [[0.0, 0.0, 0.25]]
    assert floor.solid.placement[:3, 2].tolist() == [0.0, 0.0, 1.0] and floor.solid.placement[2, 3] == 0.25


def test_a_flat_mesh_is_its_own_hull() -> None:
    (plate,) = bodies_of(rg.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), "plate")
    assert len(plate.hull.points) == 3
    (crate,) = bodies_of(rg.Mesh(CUBE, np.array(FACES)), "crate")
    assert len(crate.hull.points) == 8 and crate.solid.triangles.shape == (12, 3)


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        (rg.Ball((0.0, 0.0), 1.0), "obstacle.1.: a robot arm moves in space: a shape needs 3 coordinates, got 2"),
        (rg.Polygon(((0, 0), (1, 0), (0, 1))), "got 2"),
    ],
)
def test_shapes_of_the_plane_are_rejected(shape, words: str) -> None:
    with pytest.raises(rg.InputError, match=words):
        bodies_of(shape, "obstacle[1]")
