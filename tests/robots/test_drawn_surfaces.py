"""Triangles of shapes for pictures: closed surfaces, oriented outwards, with almost the volume of the shape.

Tests internals: `resgrid.robots.drawn_surfaces`.
"""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from support.space_shapes import CUBE, FACES

import resgrid as rg
from resgrid.robots.drawn_surfaces import triangles_of

SHAPES = [
    (rg.Box((0, 1, 2), (1, 3, 5)), 6.0),
    (rg.OrientedBox((0.3, 0.2, 0.1), (1.0, 2.0, 3.0), (0.3, 0.5, 0.7)), 6.0),
    (rg.Ball((1.0, 2.0, 3.0), 0.5), 4 / 3 * pi * 0.5**3),
    (rg.Cylinder((0, 0, 0), (1, 2, 2), 0.5), pi * 0.25 * 3),
    (rg.Capsule((0, 0, 0), (1, 2, 2), 0.5), pi * 0.25 * 3 + 4 / 3 * pi * 0.5**3),
    (rg.Mesh(CUBE, np.array(FACES)), 1.0),
    (rg.Voxels((0.5, 0.0, 0.0), 0.5, [[[0, 0, 0], [2, 1, 1]], [[4, 4, 4], [5, 5, 5]]]), 3 / 8),
]


@pytest.mark.parametrize(("shape", "volume"), SHAPES, ids=lambda value: type(value).__name__)
def test_the_surface_is_closed_and_holds_the_volume(shape, volume: float) -> None:
    points, triangles = triangles_of(shape)
    assert rg.Mesh(points, triangles).is_closed
    a, b, c = points[triangles].transpose(1, 0, 2)
    enclosed = np.sum(a * np.cross(b, c)) / 6
    assert 0.95 * volume < enclosed <= volume * (1 + 1e-9)
    lower, upper = map(np.array, shape.bounds)
    assert (points >= lower - 1e-9).all() and (points <= upper + 1e-9).all()


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (1.0, 1.0, 1.0), (0.1, -0.5, 0.3)])
def test_the_plane_of_a_half_space_is_cut_to_the_picture(normal: tuple[float, ...]) -> None:
    box = (-1.0, -1.0, -1.0), (1.0, 2.0, 1.0)
    points, triangles = triangles_of(rg.HalfSpace(normal, 0.1), within=box)
    np.testing.assert_allclose(points @ np.array(normal), 0.1)
    assert (points >= np.array(box[0]) - 1e-12).all() and (points <= np.array(box[1]) + 1e-12).all()
    a, b, c = points[triangles].transpose(1, 0, 2)
    assert (np.cross(b - a, c - a) @ np.array(normal) > 0).all()
    if normal == (0.0, 0.0, 1.0):
        assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(6.0)
    empty, none = triangles_of(rg.HalfSpace(normal, 50.0), within=box)
    assert len(empty) == len(none) == 0


def test_shapes_without_a_surface_in_space_are_rejected() -> None:
    with pytest.raises(rg.InputError, match="a Ball with 2 coordinates has no surface in space"):
        triangles_of(rg.Ball((0.0, 0.0), 1.0))
    with pytest.raises(rg.InputError, match="a half-space has no bounded surface; give the box"):
        triangles_of(rg.HalfSpace((0.0, 0.0, 1.0), 0.0))
