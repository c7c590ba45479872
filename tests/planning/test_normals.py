"""Surface normals of pixelised models, compared with true normals of balls and a dense Laplacian.

Tests internals: `resgrid.planning.normals`.
"""

import numpy as np
import pytest
from scipy.ndimage import binary_dilation
from support.spaces import space_of

import resgrid as rg
from resgrid.planning.normals import octree_voxels


def ball(radius: float, ndim: int, margin: int = 4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Model of an off-centre pixelised ball, distances of cell centres and true normals."""
    n = int(2 * radius) + 2 * margin
    centre = n / 2 + np.array([0.13, 0.29, 0.41])[:ndim]
    away = np.moveaxis(np.indices((n,) * ndim), 0, -1) + 0.5 - centre
    distance = np.linalg.norm(away, axis=-1)
    return distance < radius, distance, away / distance[..., np.newaxis]


def angle_errors(normals: np.ndarray, true: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip(np.sum(normals * true, axis=-1), -1.0, 1.0)))


@pytest.mark.parametrize("radius", [8, 16, 32, 64])
def test_errors_of_normals_on_a_disc_lie_within_the_documented_limits(radius: int) -> None:
    """5 degrees in the cells that touch the disc, at any resolution; 1 degree 2.5 cells out."""
    model, distance, true = ball(radius, 2)
    off = angle_errors(rg.planning.surface_normals(model), true)
    touching = binary_dilation(model) & ~model
    assert 4.4 < off[touching].mean() < 5.2
    assert 10.0 < off[touching].max() < 25.0
    assert 0.6 < off[~model & (np.abs(distance - radius - 2.5) < 0.5)].mean() < 1.2


def test_padding_reduces_the_error_near_the_edge() -> None:
    model, distance, true = ball(16, 2)
    ring = ~model & (np.abs(distance - 19.5) < 0.5)
    near = angle_errors(rg.planning.surface_normals(model, padding=0), true)[ring].mean()
    far = angle_errors(rg.planning.surface_normals(model, padding=40), true)[ring].mean()
    assert far < 0.6 and near > 2.0


def test_errors_of_normals_on_a_voxel_ball_decrease_with_distance() -> None:
    model, distance, true = ball(6, 3, margin=3)
    off = angle_errors(rg.planning.surface_normals(model), true)
    assert 3.0 < off[binary_dilation(model) & ~model].mean() < 7.0
    assert off[~model & (np.abs(distance - 8.5) < 0.5)].mean() < 2.0


@pytest.mark.parametrize(("radius", "mean"), [(5, 8.0), (9, 7.3), (12.5, 6.5)])
def test_errors_of_normals_on_a_ball_lie_within_the_documented_limits(radius: float, mean: float) -> None:
    """As documented: 6 to 8 degrees on average in cells that touch, at most 31, and 1 to 2 degrees 2.5 cells out."""
    model, distance, true = ball(radius, 3, margin=3)
    off = angle_errors(rg.planning.surface_normals(model), true)
    adjacent = off[binary_dilation(model) & ~model]
    assert 6.0 < adjacent.mean() < mean and 15.0 < adjacent.max() < 31.0
    assert 0.5 < off[~model & (np.abs(distance - radius - 2.5) < 0.5)].mean() < 1.9


def test_normals_equal_the_gradient_of_a_dense_laplacian() -> None:
    """Central differences of a potential computed by numpy alone, on cells twice as long as wide."""
    rng = np.random.default_rng(3)
    model = rng.random((9, 7)) < 0.15
    hx, hy = 2.0, 1.0
    phi = np.ones((11, 9))
    phi[1:-1, 1:-1][model] = 0.0
    free = np.zeros_like(phi, dtype=bool)
    free[1:-1, 1:-1] = ~model
    number = np.cumsum(free).reshape(phi.shape) - 1
    A, b = np.zeros((free.sum(), free.sum())), np.zeros(free.sum())
    for i, j in np.argwhere(free):
        for di, dj, g in ((1, 0, hx**-2), (-1, 0, hx**-2), (0, 1, hy**-2), (0, -1, hy**-2)):
            A[number[i, j], number[i, j]] += g
            if free[i + di, j + dj]:
                A[number[i, j], number[i + di, j + dj]] -= g
            else:
                b[number[i, j]] += g * phi[i + di, j + dj]
    phi[free] = np.linalg.solve(A, b)
    gradient = np.stack(
        [(phi[2:, 1:-1] - phi[:-2, 1:-1]) / (2 * hx), (phi[1:-1, 2:] - phi[1:-1, :-2]) / (2 * hy)], axis=-1
    )
    expected = gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)
    found = rg.planning.surface_normals(model, spacing=(hx, hy), padding=0)
    np.testing.assert_allclose(found[~model], expected[~model], atol=1e-9)
    assert np.isnan(found[model]).all()


def test_flat_surfaces_have_exact_normals_and_points_agree_with_cells() -> None:
    slab = np.zeros((9, 6))
    slab[3:5] = 1
    space = space_of(slab, periodic=(False, True), spacing=(0.5, 2.0))
    normals = rg.planning.surface_normals(space)
    np.testing.assert_allclose(normals[:3], np.broadcast_to([-1.0, 0.0], (3, 6, 2)), atol=1e-12)
    np.testing.assert_allclose(normals[5:], np.broadcast_to([1.0, 0.0], (4, 6, 2)), atol=1e-12)
    model, _, _ = ball(6, 2)
    cells = np.argwhere(~model)[::7]
    every = rg.planning.surface_normals(model)
    np.testing.assert_array_equal(rg.planning.surface_normals(model, cells=cells), every[tuple(cells.T)])
    np.testing.assert_allclose(rg.planning.surface_normals(model, cells + 0.5), every[tuple(cells.T)], atol=1e-12)
    assert rg.planning.surface_normals(model, (0.2, 0.7)).shape == (2,)


def test_normals_at_the_bottom_of_a_deep_slot_are_exact() -> None:
    """At the bottom of a slot the potential underflows towards the model; ratios of currents do not."""
    model = np.ones((5, 500), dtype=bool)
    model[2, 1:] = False
    normal = rg.planning.surface_normals(model, cells=(2, 1), padding=4)
    np.testing.assert_allclose(normal, [0.0, 1.0], atol=1e-9)


def test_octree_voxels_fills_leaves_and_rejects_invalid_ones() -> None:
    rng = np.random.default_rng(0)
    coarse = rng.random((4, 4, 4)) < 0.3
    leaves = np.column_stack([2 * np.argwhere(coarse), np.full(coarse.sum(), 2)])
    np.testing.assert_array_equal(octree_voxels(leaves, (8, 8, 8)), np.kron(coarse, np.ones((2, 2, 2), dtype=bool)))
    with pytest.raises(rg.InputError, match=r"leaf 0 at \(6, 0, 0\), side 4"):
        octree_voxels([[6, 0, 0, 4]], (8, 8, 8))
    with pytest.raises(rg.InputError, match="whole numbers"):
        octree_voxels([[0.5, 0, 0, 4]], (8, 8, 8))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"model": np.zeros((3, 3))}, "boolean array"),
        ({"model": np.zeros((3, 3), dtype=bool)}, "empty"),
        ({"model": np.ones((3, 3), dtype=bool), "padding": 0}, "fills the whole grid"),
        ({"model": np.eye(3, dtype=bool), "padding": -1}, "padding = -1"),
        ({"model": np.eye(3, dtype=bool), "spacing": (1, 2, 3)}, "spacing"),
        ({"model": np.eye(3, dtype=bool), "spacing": float("nan")}, "spacing"),
        ({"model": np.eye(3, dtype=bool), "points": (1.5, 1.5)}, "inside the model"),
        ({"model": np.eye(3, dtype=bool), "points": (7.5, 1.5)}, "outside the grid"),
        ({"model": np.eye(3, dtype=bool), "points": "here"}, "must be numbers"),
        ({"model": np.eye(3, dtype=bool), "cells": (0, 3)}, "not in the grid of 3 x 3"),
        ({"model": np.eye(3, dtype=bool), "cells": (0.5, 3)}, "whole indices"),
        ({"model": np.eye(3, dtype=bool), "cells": (0, 1), "points": (0, 1)}, "not both"),
        ({"model": space_of(np.eye(3), periodic=(True, True))}, "all axes"),
    ],
)
def test_invalid_arguments_raise_input_error(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(rg.InputError, match=message):
        rg.planning.surface_normals(**arguments)


def test_cavities_and_symmetric_gaps_have_no_normal() -> None:
    ring = np.ones((3, 3), dtype=bool)
    ring[1, 1] = False
    with pytest.raises(rg.InputError, match="encloses the cell"):
        rg.planning.surface_normals(ring, cells=(1, 1))
    assert np.isnan(rg.planning.surface_normals(ring)[1, 1]).all()
    gap = np.zeros((3, 3), dtype=bool)
    gap[0], gap[2] = True, True
    assert np.isnan(rg.planning.surface_normals(gap)[1, 1]).all()
