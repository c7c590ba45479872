"""`rg.ConfigurationSpace.from_array`, against spaces that are made of axes."""

from __future__ import annotations

import numpy as np
import pytest

import resgrid as rg


def test_a_space_of_an_array_equals_one_made_of_axes() -> None:
    cell = np.zeros((4, 3), dtype=np.uint8)
    cell[1, 1], cell[3, 0] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    space = rg.ConfigurationSpace.from_array(cell, spacing=(0.5, 0.25), origin=(-1.0, 2.0), periodic=(True, False))
    assert space.axes == (rg.Axis("x", -1.0, 1.0, 4, True), rg.Axis("y", 2.0, 2.75, 3))
    np.testing.assert_array_equal(space.cell, cell)


def test_a_scalar_spacing_applies_to_all_axes_and_true_is_an_obstacle() -> None:
    image = np.array([[True, False], [False, False]])
    space = rg.ConfigurationSpace.from_array(image.T[:, ::-1], 0.1)
    np.testing.assert_allclose(space.upper, (0.2, 0.2))
    assert space.cell[0, 1] == rg.Cell.OBSTACLE and np.count_nonzero(space.cell) == 1


@pytest.mark.parametrize("ndim", [1, 2, 3, 4])
def test_axes_are_named_x_y_z_w(ndim: int) -> None:
    names = [axis.name for axis in rg.ConfigurationSpace.from_array(np.zeros((2,) * ndim)).axes]
    assert names == ["x", "y", "z", "w"][:ndim]


@pytest.mark.parametrize(
    ("shape", "options", "message"),
    [
        ((), {}, "cell has 0 dimensions"),
        ((1,) * 5, {}, "cell has 5 dimensions"),
        ((2, 2), {"spacing": 0.0}, "spacing = 0.0 must be a positive number"),
        ((2, 2), {"origin": (1.0, 2.0, 3.0)}, "origin = "),
        ((2, 2), {"periodic": (True,)}, "periodic has 1 entries"),
    ],
)
def test_from_array_rejects_invalid_values(shape: tuple[int, ...], options: dict[str, object], message: str) -> None:
    with pytest.raises(rg.InputError, match=message):
        rg.ConfigurationSpace.from_array(np.zeros(shape), **options)  # type: ignore[arg-type]
