"""Convex covers contain their solids: hulls, degenerate point sets, rings, brackets, open meshes, and enclosed points.

Tests internals: `resgrid.robots.hulls`, `resgrid.robots.convex_cover`, `resgrid.robots.enclosure`.
"""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import nnls

from resgrid.errors import InputError
from resgrid.robots.convex import Solid
from resgrid.robots.convex_cover import body_of, convex_cover, convex_hull
from resgrid.robots.enclosure import enclosed
from resgrid.robots.hulls import facets_of


def winding(points, corners):
    """Number of turns of a closed surface around points, by the solid angles of its triangles (van Oosterom 1983)."""
    result = np.zeros(len(points))
    for index, point in enumerate(points):
        a, b, c = np.moveaxis(corners - point, 1, 0)
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        top = np.einsum("tk,tk->t", a, np.cross(b, c))
        dot = (np.einsum("tk,tk->t", x, y) for x, y in ((a, b), (b, c), (c, a)))
        ab, bc, ca = dot
        result[index] = np.arctan2(top, la * lb * lc + ab * lc + bc * la + ca * lb).sum() / (2 * np.pi)
    return result


def extruded(outline, triangles, depth=0.2):
    """A prism over a polygon (n, 2) with a triangulation."""
    outline = np.asarray(outline, dtype=float)
    n = len(outline)
    points = np.concatenate([np.column_stack([outline, np.full(n, z)]) for z in (0.0, depth)])
    faces = [(a, c, b) for a, b, c in triangles] + [(n + a, n + b, n + c) for a, b, c in triangles]
    for i in range(n):
        j = (i + 1) % n
        faces += [(i, j, n + i), (j, n + j, n + i)]
    return points, np.array(faces, dtype=np.int32)


def ring(sides=24, inner=0.3, outer=0.4, depth=0.1):
    """A flat ring with a square cross section."""
    angle = 2 * np.pi * np.arange(sides) / sides
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    points = np.concatenate(
        [
            np.column_stack([circle * r, np.full(sides, z)])
            for r, z in ((inner, 0), (outer, 0), (outer, depth), (inner, depth))
        ]
    )
    faces = []
    for part, i in product(range(4), range(sides)):
        a, b = part * sides, (part + 1) % 4 * sides
        j = (i + 1) % sides
        faces += [(a + i, a + j, b + i), (a + j, b + j, b + i)]
    return points, np.array(faces, dtype=np.int32)[:, ::-1].copy()


L_SHAPE = extruded(
    [(0, 0), (1, 0), (1, 0.2), (0.2, 0.2), (0.2, 1), (0, 1)], [(0, 1, 2), (0, 2, 3), (0, 3, 5), (3, 4, 5)]
)
U_SHAPE = extruded(
    [(0, 0), (1, 0), (1, 1), (0.8, 1), (0.8, 0.2), (0.2, 0.2), (0.2, 1), (0, 1)],
    [(0, 1, 4), (0, 4, 5), (1, 2, 4), (2, 3, 4), (0, 5, 7), (5, 6, 7)],
)
PLUS = extruded(
    [(1, 0), (2, 0), (2, 1), (3, 1), (3, 2), (2, 2), (2, 3), (1, 3), (1, 2), (0, 2), (0, 1), (1, 1)],
    [(0, 1, 2), (0, 2, 11), (2, 3, 4), (2, 4, 5), (5, 6, 7), (5, 7, 8), (8, 9, 10), (8, 10, 11), (2, 5, 8), (2, 8, 11)],
    depth=1.0,
)


def jack(size=1.0, width=0.2):
    """Three bars along the axes that cross at the origin: cuts along three axes meet inside the solid."""
    boxes = []
    for axis in range(3):
        half = np.full(3, width / 2)
        half[axis] = size / 2
        boxes.append(np.array(list(product((-1, 1), repeat=3))) * half)
    triangles = []
    for box in boxes:
        hull = facets_of(box)
        number = [int(np.flatnonzero((box == corner).all(axis=1))[0]) for corner in hull.corners]
        triangles.append(np.array(number)[oriented(hull)])
    offsets = np.arange(3) * 8
    return np.concatenate(boxes), np.concatenate([t + o for t, o in zip(triangles, offsets, strict=True)]).astype(
        np.int32
    )


def oriented(hull):
    """Triangles of a convex hull, turned outwards."""
    centre = hull.corners.mean(axis=0)
    a, b, c = (hull.corners[hull.triangles[:, k]] for k in range(3))
    inward = np.einsum("tk,tk->t", np.cross(b - a, c - a), a - centre) < 0
    return np.where(inward[:, np.newaxis], hull.triangles[:, ::-1], hull.triangles)


SHAPES = {"L": L_SHAPE, "U": U_SHAPE, "plus": PLUS, "ring": ring(), "jack": jack()}


def in_piece(points, piece):
    """Which points lie in a piece, up to 1e-9, by the planes of its core or by the nearest point of its core."""
    hull = facets_of(piece.points)
    if len(hull.planes):
        near = (points @ hull.planes[:, :3].T + hull.planes[:, 3]).max(axis=1) <= 1e-9
        if piece.radius < 1e-9:
            return near
    else:
        near = np.zeros(len(points), dtype=bool)
    for index in np.flatnonzero(~near):
        near[index] = distance(points[index], piece.points) <= piece.radius + 1e-7
    return near


def distance(point, corners):
    """Distance of a point from the convex hull of corners, by non-negative least squares."""
    heavy = 1e4
    matrix = np.vstack([(corners - point).T, np.full(len(corners), heavy)])
    weights, _ = nnls(matrix, np.r_[np.zeros(3), heavy], maxiter=10_000)
    return float(np.linalg.norm((weights / weights.sum()) @ (corners - point)))


def solid_points(points, triangles, count, rng):
    """Random points on and inside a closed mesh."""
    corners = points[triangles]
    chosen = rng.integers(len(corners), size=count)
    weights = rng.dirichlet(np.ones(3), size=count)
    surface = np.einsum("nv,nvk->nk", weights, corners[chosen])
    cloud = rng.uniform(points.min(axis=0), points.max(axis=0), (count, 3))
    return np.concatenate([points, surface, cloud[np.abs(winding(cloud, corners)) > 0.5]])


@pytest.mark.parametrize("most", [1, 3, 8])
@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.quick_cases(5)
def test_a_cover_contains_the_surface_and_the_inside_of_a_mesh(name, most):
    points, triangles = SHAPES[name]
    rng = np.random.default_rng(most)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0] if most in (3, 8) else np.eye(3)
    points = points @ turn + rng.normal(size=3)
    cover = convex_cover(points, triangles, most)
    assert 1 <= len(cover) <= most
    inside = solid_points(points, triangles, 600, rng)
    assert np.any([in_piece(inside, piece) for piece in cover], axis=0).all()


@pytest.mark.parametrize(("name", "most"), [("L", 3), ("U", 4), ("plus", 6), ("jack", 8)])
def test_a_cover_of_boxes_has_the_volume_of_the_mesh(name, most):
    points, triangles = SHAPES[name]
    volume = {"L": 0.2 * 0.36, "U": 0.2 * 0.52, "plus": 5.0, "jack": 3 * 0.04 - 2 * 0.008}[name]
    cover = convex_cover(points, triangles, most)
    assert sum(facets_of(piece.points).volume for piece in cover) == pytest.approx(volume, rel=0.02)


def test_a_ring_is_cut_although_its_halves_have_the_hull_of_the_ring():
    points, triangles = ring()
    whole = facets_of(points).volume
    assert sum(facets_of(piece.points).volume for piece in convex_cover(points, triangles, 4)) < 0.7 * whole
    assert sum(facets_of(piece.points).volume for piece in convex_cover(points, triangles, 8)) < 0.52 * whole


def test_a_convex_mesh_keeps_one_piece():
    rng = np.random.default_rng(0)
    hull = facets_of(rng.normal(size=(300, 3)))
    assert len(convex_cover(hull.corners, oriented(hull).astype(np.int32), 8)) == 1


@pytest.mark.parametrize("turned", [False, True])
def test_orientation_and_holes_of_a_mesh_do_not_matter(turned):
    points, triangles = PLUS
    rng = np.random.default_rng(1)
    damaged = triangles[rng.permutation(len(triangles))]
    if turned:
        half = rng.random(len(damaged)) < 0.5
        damaged[half] = damaged[half, ::-1]
    else:
        damaged = damaged[1:]
    cover = convex_cover(points, damaged, 9)
    inside = solid_points(points, triangles, 300, rng)
    assert len(cover) > 1
    assert np.any([in_piece(inside, piece) for piece in cover], axis=0).mean() > (0.999 if turned else 0.98)
    corners = points[damaged]
    surface = np.einsum("nv,nvk->nk", rng.dirichlet(np.ones(3), len(corners) * 9), np.repeat(corners, 9, axis=0))
    assert np.any([in_piece(surface, piece) for piece in cover], axis=0).all()


def test_corners_of_cells_inside_the_solid_belong_to_the_cover():
    """A cube with a bump: cells between cuts along three axes have corners that no triangle reaches."""
    points, triangles = jack(1.0, 0.6)
    cover = convex_cover(points, triangles, 27)
    assert np.any([in_piece(np.zeros((1, 3)), piece) for piece in cover], axis=0).all()


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.integers(0, 3), st.integers(1, 60))
def test_a_hull_contains_its_points_in_any_number_of_dimensions(seed, rank, count):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, rank)) @ rng.normal(size=(rank, 3)) * rng.choice([1e-3, 1.0, 10.0]) + rng.normal(
        size=3
    )
    points = points[rng.integers(count, size=2 * count)]
    piece = convex_hull(points)
    assert piece.radius <= 2e-3 + 1e-9
    for point in points[:20]:
        assert distance(point, piece.points) <= piece.radius + 1e-6


def test_a_simplified_hull_contains_a_fine_cylinder_and_a_ball():
    angle = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    cylinder = np.concatenate(
        [np.column_stack([0.06 * np.cos(angle), 0.06 * np.sin(angle), np.full(2000, z)]) for z in (0, 0.3)]
    )
    piece = convex_hull(cylinder)
    assert len(piece.points) < 110 and piece.radius < 5e-4
    ball = np.random.default_rng(0).normal(size=(4000, 3))
    ball *= 0.1 / np.linalg.norm(ball, axis=1)[:, np.newaxis]
    piece_of_ball = convex_hull(ball)
    assert len(piece_of_ball.points) < 700 and piece_of_ball.radius < 2e-3
    for points, each in ((cylinder, piece), (ball, piece_of_ball)):
        for point in points[::199]:
            assert distance(point, each.points) <= each.radius + 1e-7


def test_hulls_of_no_points_and_of_infinite_points_are_errors():
    with pytest.raises(InputError, match=r"points of shape \(0, 3\) must be at least one point"):
        convex_hull(np.empty((0, 3)))
    with pytest.raises(InputError, match=r"point 1 = \[0.0, nan, 0.0\] is not finite; remove or repair it"):
        convex_cover(np.array([[0, 0, 0], [0, np.nan, 0.0]]), np.array([[0, 1, 1]], dtype=np.int32), 2)


@pytest.mark.parametrize(
    "points",
    [[[1, 2, 3]], [[1, 2, 3]] * 5, [[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]],
)
def test_degenerate_meshes_have_a_cover(points):
    points = np.array(points, dtype=float)
    triangles = np.array([[0, min(1, len(points) - 1), len(points) - 1]], dtype=np.int32)
    cover = convex_cover(points, triangles, 4)
    assert len(cover) == 1
    assert in_piece(points, cover[0]).all()


@pytest.mark.parametrize("name", SHAPES)
def test_enclosed_points_are_those_around_which_the_surface_turns(name):
    points, triangles = SHAPES[name]
    corners = points[triangles]
    cloud = np.random.default_rng(2).uniform(points.min(axis=0) - 0.1, points.max(axis=0) + 0.1, (400, 3))
    inside = np.abs(winding(cloud, corners)) > 0.5
    found = enclosed(cloud, corners)
    assert found[inside].all()  # never outside by mistake
    assert found[~inside].mean() < 0.02


SIZES = {"box": (0.3, 0.2, 0.5), "ball": (0.2,), "cylinder": (0.3, 0.7), "capsule": (0.1, 0.4)}


@pytest.mark.parametrize("kind", SIZES)
def test_bodies_of_primitives_contain_them_and_are_tight(kind):
    rng = np.random.default_rng(5)
    placement = np.eye(4)
    placement[:3, :3], placement[:3, 3] = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3)
    solid = Solid(kind, SIZES[kind], placement, np.empty((0, 3)), np.empty((0, 3), dtype=np.int32))
    body = body_of("part", 2, solid, padding=0.01)
    assert (body.name, body.joint, len(body.pieces)) == ("part", 2, 1)
    for direction in rng.normal(size=(300, 3)):
        unit = direction / np.linalg.norm(direction)
        local = placement[:3, :3].T @ unit
        size = SIZES[kind]
        exact = {
            "box": np.abs(local[: len(size)]) @ np.array(size[: len(local)]) / 2,
            "ball": size[0],
            "cylinder": size[0] * np.hypot(local[0], local[1]) + size[-1] / 2 * abs(local[2]),
            "capsule": size[0] + size[-1] / 2 * abs(local[2]),
        }[kind]
        support = (body.hull.points @ unit).max() + body.hull.radius
        assert -1e-12 <= support - (placement[:3, 3] @ unit + exact + 0.01) <= 0.0007


def test_a_half_space_keeps_its_normal_and_moves_by_the_padding():
    placement = np.eye(4)
    placement[2, 3] = 0.5
    solid = Solid("half_space", (), placement, np.empty((0, 3)), np.empty((0, 3), dtype=np.int32))
    body = body_of("floor", -1, solid, padding=0.01)
    np.testing.assert_allclose(body.hull.points, [[0, 0, 0.51]])
    np.testing.assert_allclose(body.hull.normal, [0, 0, 1])
    with pytest.raises(InputError, match="padding = -1 must be a number of metres"):
        body_of("floor", -1, solid, padding=-1)
