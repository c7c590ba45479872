"""Shapes in space, and the cells that they block, compared with distances by coal and with winding numbers.

Tests internals: `resgrid.robots` (shapes, `bodies_of`, `voxels`).
"""

from __future__ import annotations

from importlib import import_module

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.space_shapes import CUBE, FACES, a_shape

import resgrid as rg
from resgrid.robots.body import bodies_of
from resgrid.robots.mesh_cells import nearest_on_triangles
from resgrid.robots.voxels import merge_boxes

AXES = (rg.Axis("x", -1.0, 1.0, 10), rg.Axis("y", -0.8, 1.0, 9), rg.Axis("z", -1.0, 1.0, 7))
SIZES = [axis.spacing for axis in AXES]
CENTRES = np.stack(np.meshgrid(*(axis.centres for axis in AXES), indexing="ij"), axis=-1).reshape(-1, 3)


def geometry_of(solid):
    """Return a solid and its pose for coal."""
    coal = import_module("coal")
    match solid.kind:
        case "box":
            shape = coal.Box(*solid.size)
        case "ball":
            shape = coal.Sphere(*solid.size)
        case "cylinder":
            shape = coal.Cylinder(*solid.size)
        case "capsule":
            shape = coal.Capsule(*solid.size)
        case "half_space":
            shape = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
        case "mesh":
            shape = coal.BVHModelOBBRSS()
            shape.beginModel(len(solid.triangles), len(solid.points))
            shape.addVertices(solid.points)
            for triangle in solid.triangles:
                shape.addTriangle(*solid.points[triangle])
            shape.endModel()
    return shape, coal.Transform3s(solid.placement[:3, :3].copy(), solid.placement[:3, 3].copy())


def distances(shape):
    """Return the distances of all cells and of all centres from the surface or solid, by coal."""
    coal = import_module("coal")
    solids = [geometry_of(body.solid) for body in bodies_of(shape, "shape")]
    probes = coal.Box(*SIZES), coal.Sphere(1e-9)
    found = np.full((2, len(CENTRES)), np.inf)
    for number, centre in enumerate(CENTRES):
        pose = coal.Transform3s(np.eye(3), centre)
        for solid, place in solids:
            for kind, probe in enumerate(probes):
                request, result = coal.DistanceRequest(), coal.DistanceResult()
                gap = coal.distance(probe, pose, solid, place, request, result)
                found[kind, number] = min(found[kind, number], gap)
    return found


def is_enclosed(mesh, points):
    """Return whether a closed surface winds around points, by the sum of solid angles (van Oosterom 1983)."""
    angle = np.zeros(len(points))
    for triangle in mesh.corners:
        a, b, c = (corner - points for corner in triangle)
        la, lb, lc = (np.linalg.norm(each, axis=1) for each in (a, b, c))
        volume = np.sum(a * np.cross(b, c), axis=1)
        parts = np.sum(a * b, axis=1) * lc + np.sum(b * c, axis=1) * la + np.sum(c * a, axis=1) * lb
        angle += 2 * np.arctan2(volume, la * lb * lc + parts)
    return np.abs(angle / (4 * np.pi)) > 0.5


@pytest.mark.parametrize("kind", ["cylinder", "upright", "capsule", "box", "ring", "crate", "surface", "half"])
def test_blocked_cells_are_those_within_the_radius(kind: str) -> None:
    random = np.random.default_rng(sum(map(ord, kind)))
    for _ in range(3):
        shape = a_shape(kind, random)
        gaps = distances(shape)
        inside = np.zeros(len(CENTRES), dtype=bool)
        if isinstance(shape, rg.Mesh):
            assert shape.is_closed is (kind != "surface")
            inside = is_enclosed(shape, CENTRES) if shape.is_closed else inside
        for radius in (0.0, 0.07, 0.3):
            for gap, rule in zip(gaps, ("conservative", "centre"), strict=True):
                blocked = rg.PointRobot(radius).occupancy(AXES, [shape], rule).ravel()
                doubtful = np.abs(gap - radius) < 1e-6  # cells on the border, and rounding errors of coal
                np.testing.assert_array_equal(blocked[~doubtful], ((gap <= radius) | inside)[~doubtful])


@settings(max_examples=30)
@given(
    st.sampled_from(["cylinder", "capsule", "box", "ring"]), st.integers(0, 10**6), st.sampled_from([0.0, 0.1, 0.35])
)
@pytest.mark.slow
def test_no_point_of_a_free_cell_is_within_the_radius(kind: str, seed: int, radius: float) -> None:
    random = np.random.default_rng(seed)
    shape = a_shape(kind, random)
    blocked = rg.PointRobot(radius).occupancy(AXES, [shape], "conservative")
    free = np.argwhere(~blocked)
    lower, spacing = np.array([axis.lower for axis in AXES]), np.array(SIZES)
    count = 400 if kind == "ring" else 2000  # the distance to a mesh takes a loop over its triangles
    points = lower + (free[random.integers(len(free), size=count)] + random.uniform(0.001, 0.999, (count, 3))) * spacing
    assert not is_within(shape, points, radius - 1e-12).any()


def is_within(shape, points, reach):
    """Return whether points (n, 3) lie within a distance of a shape, from formulas of their own."""
    match shape:
        case rg.OrientedBox():
            corners = shape.corners
            edges = corners[[4, 2, 1]] - corners[0]
            parts = np.clip((points - corners[0]) @ edges.T / np.sum(edges**2, axis=1), 0.0, 1.0)
            return np.linalg.norm(points - corners[0] - parts @ edges, axis=1) <= reach
        case rg.Mesh():
            gaps = [np.linalg.norm(nearest_on_triangles(shape.corners, p) - p, axis=1).min() for p in points]
            return (np.array(gaps) <= reach) | is_enclosed(shape, points)
    start, end = np.array(shape.start), np.array(shape.end)
    part = (points - start) @ (end - start) / np.sum((end - start) ** 2)
    if isinstance(shape, rg.Capsule):
        return (
            np.linalg.norm(points - start - np.clip(part, 0, 1)[:, None] * (end - start), axis=1)
            <= reach + shape.radius
        )
    off = np.linalg.norm(points - start - part[:, None] * (end - start), axis=1)
    beyond = np.maximum(np.maximum(-part, part - 1), 0) * np.linalg.norm(end - start)
    return np.hypot(np.maximum(off - shape.radius, 0), beyond) <= reach


def test_nearest_points_of_triangles_are_those_of_dense_samples() -> None:
    random = np.random.default_rng(2)
    corners, points = random.normal(size=(40, 3, 3)), random.normal(size=(40, 3)) * 2
    grid = np.array([(i, j, 200 - i - j) for i in range(201) for j in range(201 - i)]) / 200
    samples = np.einsum("sk,nkj->nsj", grid, corners)
    sampled = np.linalg.norm(samples - points[:, None], axis=2).min(axis=1)
    found = np.linalg.norm(nearest_on_triangles(corners, points) - points, axis=1)
    assert (found <= sampled + 1e-12).all() and (found > sampled - 0.03).all()


def test_a_shell_that_lies_on_borders_blocks_both_sides_of_an_open_surface() -> None:
    axes = tuple(rg.Axis(name, 0.0, 1.0, 4) for name in "xyz")
    plate = rg.Mesh([[0.5, 0, 0], [0.5, 1, 0], [0.5, 1, 1], [0.5, 0, 1]], np.array([[0, 1, 2], [0, 2, 3]]))
    blocked = rg.PointRobot().occupancy(axes, [plate], "conservative")
    assert blocked.any(axis=(1, 2)).tolist() == [False, True, True, False]
    wall = rg.Mesh(
        [[0.5, 0, 0], [0.5, 1, 0], [0.5, 1, 1], [0.5, 0, 1], [0.9, 0, 0.5]], np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4]])
    )
    assert rg.PointRobot().occupancy(axes, [wall], "conservative")[1:3].all()


def test_a_solid_crate_on_borders_blocks_its_own_cells_only() -> None:
    axes = tuple(rg.Axis(name, 0.0, 1.0, 5) for name in "xyz")
    crate = rg.Mesh(CUBE * 0.6 + 0.2, np.array(FACES))
    for turned in (crate, rg.Mesh(crate.points, crate.triangles[:, ::-1])):  # the normals point inwards
        blocked = rg.PointRobot().occupancy(axes, [turned], "conservative")
        assert blocked.sum() == 27 and blocked[1:4, 1:4, 1:4].all()
    box = rg.OrientedBox((0.5, 0.5, 0.5), (0.2, 0.6, 0.6), (0.0, 0.0, np.pi / 2))
    assert np.argwhere(rg.PointRobot().occupancy(axes, [box], "conservative")).min(axis=0).tolist() == [1, 2, 1]
    assert rg.PointRobot().occupancy(axes, [box], "conservative").sum() == 9


def test_closed_parts_of_an_open_mesh_have_an_inside() -> None:
    axes = tuple(rg.Axis(name, 0.0, 1.0, 10) for name in "xyz")
    crate = CUBE * 0.5 + 0.05
    mixed = rg.Mesh(np.vstack([crate, CUBE * 0.3 + 0.67]), np.array([*FACES, *(np.array(FACES[:-1]) + 8)]))
    assert not mixed.is_closed and len(mixed.closed_parts) == 12
    blocked = rg.PointRobot().occupancy(axes, [mixed], "centre")
    np.testing.assert_array_equal(blocked, rg.PointRobot().occupancy(axes, [rg.Mesh(crate, np.array(FACES))], "centre"))
    assert rg.PointRobot().occupancy(axes, [mixed], "conservative")[6:, 6:, 6:].any()


def test_overlapping_parts_of_opposite_orientation_do_not_cancel_and_cavities_stay_free() -> None:
    axes = tuple(rg.Axis(name, 0.0, 1.0, 10) for name in "xyz")
    faces, turned = np.array(FACES), np.array(FACES)[:, ::-1] + 8

    def blocked(first, second, triangles):
        mesh = rg.Mesh(np.vstack([first, second]), np.vstack(triangles))
        assert mesh.is_closed
        return rg.PointRobot().occupancy(axes, [mesh], "conservative")

    for pair in ([faces, turned], [faces[:, ::-1], turned[:, ::-1]]):
        overlap = blocked(CUBE * 0.6, CUBE * 0.6 + 0.3, pair)
        assert overlap[:6, :6, :6].all() and overlap[3:9, 3:9, 3:9].all() and overlap.sum() == 2 * 216 - 27
        room = blocked(CUBE * 0.8 + 0.1, CUBE * 0.4 + 0.3, pair)
        assert not room[3:7, 3:7, 3:7].any() and room.sum() == 512 - 64
        apart = blocked(CUBE * 0.4, CUBE * 0.4 + 0.5, pair)
        assert apart.sum() == 128


@pytest.mark.parametrize("radius", [0.0, 0.25, 3.0])
def test_shapes_outside_the_grid_block_cells_within_the_radius_only(radius: float) -> None:
    crate = rg.Mesh(CUBE * 0.4 + [1.1, -0.2, -0.2], np.array(FACES))
    box = rg.Box((1.1, -0.2, -0.2), (1.5, 0.2, 0.2))
    turned = rg.OrientedBox((1.3, 0.0, 0.0), (0.4, 0.4, 0.4))
    voxels = rg.Voxels((1.1, -0.2, -0.2), 0.4, [[[0, 0, 0], [1, 1, 1]]])
    for rule in ("conservative", "centre"):
        expected = rg.PointRobot(radius).occupancy(AXES, [box], rule)
        assert expected.any() == (radius > 0.2)
        for shape in (crate, turned, voxels):
            np.testing.assert_array_equal(rg.PointRobot(radius).occupancy(AXES, [shape], rule), expected)
        for far in (crate.shifted((5.0, 0.0, 0.0)), turned.shifted((0.0, 5.0, 0.0)), voxels.shifted((0.0, 0.0, 5.0))):
            assert rg.PointRobot(radius / 3).occupancy(AXES, [far], rule).sum() == 0


def test_shapes_repeat_along_periodic_axes() -> None:
    axes = (rg.Axis("x", 0.0, 1.0, 10, periodic=True), rg.Axis("y", 0.0, 1.0, 4), rg.Axis("z", 0.0, 1.0, 4))
    shapes = [
        rg.Capsule((0.0, 0.5, 0.5), (0.0, 0.6, 0.5), 0.05),
        rg.Mesh(CUBE * 0.1 + [-0.05, 0.3, 0.3], np.array(FACES)),
        rg.Voxels((-0.05, 0.3, 0.3), 0.1, [[[0, 0, 0], [1, 1, 1]]]),
    ]
    for shape in shapes:
        columns = rg.PointRobot(0.01).occupancy(axes, [shape], "conservative").any(axis=(1, 2))
        assert columns.tolist() == [True] + [False] * 8 + [True]
        assert shape.shifted((0.3, 0.0, 0.0)).bounds[0][0] == pytest.approx(shape.bounds[0][0] + 0.3)


voxel_masks = st.integers(0, 2**32 - 1).map(lambda seed: np.random.default_rng(seed).random((5, 4, 6)) < 0.6)


@given(voxel_masks)
def test_merged_boxes_are_disjoint_and_have_the_same_voxels(mask: np.ndarray) -> None:
    voxels = rg.Voxels.of_cells(np.argwhere(mask), 1.0)
    painted = np.zeros(mask.shape, dtype=int)
    for first, last in voxels.boxes:
        painted[tuple(map(slice, first, last))] += 1
    np.testing.assert_array_equal(painted, mask.astype(int))
    assert voxels.count == mask.sum() and len(voxels.boxes) <= mask.sum()


@given(voxel_masks, st.sampled_from([0.0, 0.2, 0.7]), st.sampled_from(["conservative", "centre"]))
@settings(max_examples=20)
def test_voxels_block_the_cells_of_their_own_grid_exactly(mask: np.ndarray, radius: float, rule: str) -> None:
    axes = tuple(rg.Axis(name, 0.1, 0.1 + 0.3 * n, n) for name, n in zip("xyz", mask.shape, strict=True))
    voxels = rg.Voxels.of_cells(np.argwhere(mask), 0.3, (0.1, 0.1, 0.1))
    blocked = rg.PointRobot(radius).occupancy(axes, [voxels], rule)
    same = rg.PointRobot(radius).occupancy(axes, [_cell_set(axes, mask)], rule)
    np.testing.assert_array_equal(blocked, same)
    if radius == 0:
        np.testing.assert_array_equal(blocked, mask)


def _cell_set(axes, mask):
    from resgrid.robots import CellSet

    return CellSet(axes, mask)


def test_repeated_and_distant_voxels_count_once() -> None:
    cells = [[0, 0, 0], [0, 0, 0], [2**40, -(2**40), 2**40], [0, 0, 1]]
    voxels = rg.Voxels.of_cells(cells, 0.1)
    assert sorted(voxels.boxes.tolist()) == [
        [[0, 0, 0], [1, 1, 2]],
        [[2**40, -(2**40), 2**40], [2**40 + 1, 1 - 2**40, 2**40 + 1]],
    ]
    assert rg.Voxels.of_cells(cells[:2], 0.1).boxes.tolist() == [[[0, 0, 0], [1, 1, 1]]]
    with pytest.raises(rg.InputError, match="b > 0"):
        rg.Voxels.of_cells(np.empty((0, 3), int), 0.1)


def test_large_boxes_are_merged_into_one() -> None:
    halves = np.array([[[0, 0, 0], [8, 8, 8]], [[8, 0, 0], [16, 8, 4]], [[8, 0, 4], [16, 8, 8]]])
    assert merge_boxes(halves).tolist() == [[[0, 0, 0], [16, 8, 8]]]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: rg.Cylinder((0, 0, 0), (0, 0, 0), 1.0), "the ends of a cylinder must differ"),
        (lambda: rg.Capsule((1, 2, 3), (1, 2, 3), 1.0), r"use a ball \(rg.Ball\)"),
        (lambda: rg.Cylinder((0, 0, 0), (0, 0, 1), -1.0), "radius = -1.0 must be a finite number above 0"),
        (lambda: rg.Cylinder((0, 0), (0, 0, 1), 1.0), "start = .* must be a list of 3 finite numbers"),
        (lambda: rg.OrientedBox((0, 0, 0), (1, 0, 1)), "size.1. = 0 must be a finite number above 0"),
        (lambda: rg.OrientedBox((0, 0, np.nan), (1, 1, 1)), "centre"),
        (lambda: rg.Mesh(np.zeros((3, 2)), [[0, 1, 2]]), r"need the shape \(v, 3\)"),
        (lambda: rg.Mesh(np.zeros((3, 3)), np.empty((0, 3), int)), "t > 0"),
        (lambda: rg.Mesh([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]]), "point 2 of the mesh is .*finite"),
        (lambda: rg.Mesh(np.zeros((3, 3)), [[0, 1, 3]]), "whole numbers from 0 to 2"),
        (lambda: rg.Mesh(np.zeros((3, 3)), [[0, 1, 2]], pieces=0), "pieces = 0"),
        (lambda: rg.Voxels((0, 0, 0), 1.0, np.empty((0, 2, 3), int)), "b > 0"),
        (lambda: rg.Voxels((0, 0, 0), 1.0, [[[0, 0, 0], [1, 0, 1]]]), "box 0 has no voxel"),
        (lambda: rg.Voxels((0, 0, 0), 0.0, [[[0, 0, 0], [1, 1, 1]]]), "size = 0.0"),
    ],
)
def test_an_invalid_shape_has_one_message(make, words: str) -> None:
    with pytest.raises(rg.InputError, match=words):
        make()


def test_planes_goals_and_pictures_reject_shapes_in_space() -> None:
    from resgrid.robots import to_shapely

    pillar = rg.Cylinder((0, 0, 0), (0, 0, 1), 0.2)
    plane = (rg.Axis("x", 0.0, 1.0, 4), rg.Axis("y", 0.0, 1.0, 4))
    with pytest.raises(rg.InputError, match="3 coordinates does not fit a grid with 2 axes"):
        rg.DiscRobot(0.1).occupancy(plane, [pillar], "conservative")
    with pytest.raises(rg.InputError, match="an arm moves in the plane: a shape needs 2 coordinates, got 3"):
        arm = rg.Arm(lengths=(1.0, 1.0))
        arm.occupancy(arm.axes(8), [pillar], "conservative")
    with pytest.raises(rg.InputError, match="this Cylinder has 3 coordinates"):
        to_shapely(pillar)
    with pytest.raises(rg.InputError, match="a goal cannot be a Cylinder"):
        rg.PointRobot().goal_cells(AXES, pillar)
