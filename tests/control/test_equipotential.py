"""Equation (1) of Connolly & Grupen, against cross products and its invariants.

Tests internals: `resgrid.control.equipotential`.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

import resgrid as rg
from resgrid.control.equipotential import following_velocity

number = st.floats(-1e3, 1e3, allow_subnormal=False).map(lambda x: x if abs(x) > 1e-6 else 0.0)
pairs = st.integers(1, 4).flatmap(lambda n: st.tuples(*[st.lists(number, min_size=n, max_size=n).map(np.array)] * 2))


@given(pairs, st.floats(1e-3, 10) | st.just(0.0))
def test_the_velocity_is_normal_to_the_streamline_and_does_positive_work(pair, c) -> None:
    v, f = pair
    phi = rg.control.equipotential_velocity(v, f, c=c)
    scale = c * np.linalg.norm(v) ** 2 * np.linalg.norm(f)
    assert abs(phi @ v) <= 1e-13 * scale * np.linalg.norm(v)
    assert phi @ f >= -1e-13 * scale * np.linalg.norm(f)
    assert np.linalg.norm(phi) <= scale * (1 + 1e-12)


@given(st.tuples(*[st.lists(number, min_size=3, max_size=3).map(np.array)] * 2), st.floats(1e-3, 10) | st.just(0.0))
def test_the_velocity_in_three_dimensions_is_a_double_cross_product(pair, c) -> None:
    v, f = pair
    expected = c * np.cross(v, np.cross(f, v))
    np.testing.assert_allclose(
        rg.control.equipotential_velocity(v, f, c=c), expected, atol=1e-12 * c * (v @ v) * (1 + np.abs(f).max()), rtol=0
    )


@given(pairs, st.floats(-5, 5))
def test_a_force_along_the_streamline_gives_exactly_zero_velocity(pair, share) -> None:
    v, _ = pair
    np.testing.assert_array_equal(following_velocity(v, share * v), 0.0)
    np.testing.assert_array_equal(rg.control.equipotential_velocity(v, 2.0 * v), 0.0)


@given(pairs)
def test_following_velocity_is_the_nominal_speed_times_the_sine_of_the_angle(pair) -> None:
    v, f = pair
    if not (v.any() and f.any()):
        return
    u, g = v / np.linalg.norm(v), f / np.linalg.norm(f)
    sine = np.sqrt(max(0.0, (1 - u @ g) * (1 + u @ g)))
    moved = following_velocity(v, f)
    if sine > 2e-3:
        assert np.linalg.norm(moved) == pytest.approx(np.linalg.norm(v) * sine, rel=1e-6)
    assert moved @ f >= -1e-13 * np.linalg.norm(v) * np.linalg.norm(f)


@pytest.mark.parametrize(
    ("v", "f", "c", "says"),
    [([1, 0], [np.nan, 0], 1, "finite"), ([1, 0], [1], 1, "shapes"), ([1, 0], [0, 1], -1, "c = -1")],
)
def test_invalid_vectors_and_gains_raise_input_error(v, f, c, says) -> None:
    with pytest.raises(rg.InputError, match=says):
        rg.control.equipotential_velocity(v, f, c=c)


def test_overflow_raises_input_error_and_following_velocity_ignores_the_force_size() -> None:
    with pytest.raises(rg.InputError, match="overflows"):
        rg.control.equipotential_velocity((1e200, 0.0), (1e200, 1.0))
    for size in (1e-300, 1.0, 1e200, 1.7e308):
        velocity = following_velocity(np.array([2.0, 0.0]), np.array([size, size]))
        np.testing.assert_allclose(velocity, [0.0, np.sqrt(2.0)])
