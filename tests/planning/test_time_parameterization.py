"""Time parameterization, compared with closed forms; limits compared with differences of dense samples."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.spaces import serpentine, space_of

import resgrid as rg

PLANE = space_of(np.zeros((20, 20)))


def test_with_velocity_limits_only_the_duration_is_a_sum_of_quotients() -> None:
    motion = rg.time_parameterize(rg.Polyline([(0, 0), (3, 1), (3, 1), (3, 5)], PLANE), velocity_limits=(1.0, 0.5))
    assert motion.duration == 3.0 + 8.0
    np.testing.assert_allclose(motion.velocities, [(1, 1 / 3), (0, 0.5), (0, 0)])
    np.testing.assert_allclose(motion.at([1.5, 7.0])[0], [(1.5, 0.5), (3, 3)])


@pytest.mark.parametrize(
    ("length", "seconds"),
    [(8.0, 8 / 2 + 2 / 1), (1.0, 2.0), (4.0, 4.0)],  # trapezium s/v + v/a; triangle 2 sqrt(s/a); just both
)
def test_a_straight_line_has_the_duration_of_the_trapezoidal_profile(length: float, seconds: float) -> None:
    motion = rg.time_parameterize(
        rg.Polyline([(0, 0), (length, 0)], PLANE), velocity_limits=2.0, acceleration_limits=1.0
    )
    assert motion.duration == pytest.approx(seconds)
    np.testing.assert_allclose(motion.at(seconds / 2)[0], [(length / 2, 0)])


def test_corners_without_tolerance_have_zero_velocity() -> None:
    motion = rg.time_parameterize(
        rg.Polyline([(0, 0), (1, 0), (1, 1)], PLANE), velocity_limits=9.0, acceleration_limits=1.0
    )
    assert motion.duration == pytest.approx(4.0)
    np.testing.assert_allclose(motion.at(2.0), [[(1, 0)], [(0, 0)]], atol=1e-9)


@pytest.mark.parametrize("yaw", [0.0, 0.3, -1.2])
def test_rounding_errors_far_from_the_origin_are_not_corners(yaw: float) -> None:
    along = np.linspace(0.0, 8.0, 161)[:, np.newaxis] * (np.cos(yaw), np.sin(yaw))
    corner = np.concatenate(
        [along, along[-1] + np.linspace(0.0, 1.0, 20)[1:, np.newaxis] * (-np.sin(yaw), np.cos(yaw))]
    )
    far = rg.time_parameterize(
        rg.Polyline(np.add(corner, (500000.0, 5400000.0)), PLANE), velocity_limits=2.0, acceleration_limits=1.0
    )
    assert far.duration == pytest.approx((8 / 2 + 2) + 2, rel=1e-6)  # at rest only at the corner


@pytest.mark.parametrize(("limit", "turn"), [((1.0, 1.0), 1.0), (1.0, np.sqrt(2))])  # of each axis, of the robot
def test_a_right_angle_is_rounded_within_half_the_tolerance(limit: object, turn: float) -> None:
    corner = [(0.0, 0.0), (5.0, 0.0), (5.0, 5.0)]
    motion = rg.time_parameterize(
        rg.Polyline(corner, PLANE), velocity_limits=9.0, acceleration_limits=limit, tolerance=0.2
    )
    points = motion.sample(500)[1]
    away = np.minimum(np.abs(points[:, 1]), np.abs(points[:, 0] - 5)).max()
    gap = np.linalg.norm(points - (5, 0), axis=1).min()
    assert gap == pytest.approx(0.1, rel=1e-3)
    assert away < gap
    # d = 4 * 0.1 / sqrt(2), v = sqrt(2 d a / turn): speeds up over 5 - d, from rest to a peak, and slows down to v.
    d = 0.4 / np.sqrt(2)
    v = np.sqrt(2 * d / turn)
    peak = np.sqrt(5 - d + v**2 / 2)
    assert motion.duration == pytest.approx(2 * (peak + (peak - v)) + 2 * d / v)


@pytest.mark.parametrize("robot", [None, rg.PointRobot(), rg.DiscRobot(0.1)])
def test_a_scalar_limit_applies_to_the_norm_for_point_and_disc_robots(robot: object) -> None:
    way = rg.Polyline([(0, 0), (3, 4), (3, 9)], rg.ConfigurationSpace(PLANE.axes, PLANE.cell, robot=robot))
    assert rg.time_parameterize(way, velocity_limits=1.0).duration == pytest.approx(5 + 5)
    motion = rg.time_parameterize(way, velocity_limits=0.5, acceleration_limits=0.3, tolerance=0.2)
    assert np.linalg.norm(motion.velocities, axis=1).max() == pytest.approx(0.5)
    assert np.linalg.norm(motion.accelerations, axis=1).max() == pytest.approx(0.3)


def test_a_scalar_limit_applies_to_every_joint_of_an_arm() -> None:
    space = rg.ConfigurationSpace(PLANE.axes, PLANE.cell, robot=rg.Arm((1.0, 1.0)))
    assert rg.time_parameterize(rg.Polyline([(0, 0), (3, 4)], space), velocity_limits=1.0).duration == pytest.approx(
        4.0
    )


@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.sampled_from([0.0, 0.01, 0.5]))
@settings(max_examples=40)
def test_motions_obey_the_limits_within_the_tolerance_of_the_path(seed: int, ndim: int, tolerance: float) -> None:
    rng = np.random.default_rng(seed)
    space = space_of(np.zeros((10,) * ndim))
    corners = rng.uniform(0, 10, (int(rng.integers(1, 8)), ndim))
    velocity, acceleration = rng.uniform(0.2, 3, ndim), rng.uniform(0.2, 3, ndim)
    way = rg.Polyline(corners, space)
    motion = rg.time_parameterize(way, velocity_limits=velocity, acceleration_limits=acceleration, tolerance=tolerance)
    np.testing.assert_array_equal(motion.positions[[0, -1]], corners[[0, -1]])
    assert np.all(np.diff(motion.times) > 0)
    times, points, speeds = motion.sample(max(200.0 / max(motion.duration, 0.1), 1.0))
    step = np.diff(times)[:, np.newaxis]
    assert np.all(np.abs(np.diff(points, axis=0)) <= velocity * step * (1 + 1e-7) + 1e-9)
    assert np.all(np.abs(np.diff(speeds, axis=0)) <= acceleration * step * (1 + 1e-7) + 1e-7)
    assert distance_from_polyline(points, corners) <= tolerance + 1e-7


def distance_from_polyline(points: np.ndarray, corners: np.ndarray) -> float:
    best = np.linalg.norm(points - corners[0], axis=1)
    for start, end in pairwise(corners):
        share = np.clip((points - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
        best = np.minimum(best, np.linalg.norm(points - start - share[:, np.newaxis] * (end - start), axis=1))
    return float(best.max())


def test_the_default_tolerance_keeps_motions_collision_free() -> None:
    space = space_of(serpentine(4, 10, 2))
    field = rg.field(rg.solve(rg.compile_space(space)))
    path = rg.streamline(field, cell=np.argwhere(space.goal_connected)[-1].tolist())
    for way in (path, rg.shortcut(path, clearance=0.25)):
        motion = rg.time_parameterize(way, velocity_limits=1.0, acceleration_limits=1.0)
        rg.certify_collision_free(rg.Polyline(motion.sample(50)[1], space))
        assert motion.duration >= way.length * (1 - 0.1)
    slow = rg.time_parameterize(path, velocity_limits=1.0, acceleration_limits=1.0, tolerance=0.0)
    assert slow.duration > rg.time_parameterize(path, velocity_limits=1.0, acceleration_limits=1.0).duration


def test_a_single_point_has_duration_0() -> None:
    for acceleration in (None, 1.0):
        motion = rg.time_parameterize(
            rg.Polyline([(1, 2), (1, 2)], PLANE), velocity_limits=1, acceleration_limits=acceleration
        )
        assert motion.duration == 0
        np.testing.assert_array_equal(motion.at([-1, 0, 5])[0], [(1, 2)] * 3)
        assert len(motion.sample(10)[0]) == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"velocity_limits": 0}, "velocity_limits = 0 must be positive"),
        ({"velocity_limits": (1, float("nan"))}, r"velocity_limits = \(1, nan\) must be positive"),
        ({"velocity_limits": (1, 1, 1)}, "one for each of the 2 axes"),
        ({"velocity_limits": "fast"}, "velocity_limits = 'fast' must be"),
        ({"velocity_limits": 1, "acceleration_limits": -1}, "acceleration_limits = -1 must be"),
        ({"velocity_limits": 1, "tolerance": 0.1}, "give acceleration_limits"),
        ({"velocity_limits": 1, "acceleration_limits": 1, "tolerance": -1}, "tolerance = -1"),
    ],
)
def test_invalid_limits_raise_input_error(options: dict, message: str) -> None:
    with pytest.raises(rg.InputError, match=message):
        rg.time_parameterize(rg.Polyline([(0, 0), (1, 1)], PLANE), **options)


@pytest.mark.parametrize("acceleration", [None, 0.5], ids=["velocities", "accelerations"])
@pytest.mark.parametrize("rate", [0.5, 2.0, 10.0])
def test_resampled_motions_have_equal_positions_and_velocities(acceleration: float | None, rate: float) -> None:
    """At the knots, which are written to files, and at all times between them."""
    options = {} if acceleration is None else {"acceleration_limits": acceleration, "tolerance": 0.1}
    motion = rg.time_parameterize(rg.Polyline([(1, 1), (9, 1), (9, 9)], PLANE), velocity_limits=1.0, **options)
    again = motion.resampled(rate)
    times = np.linspace(0, motion.duration, 777)
    for found in (again, again.resampled(3 * rate).resampled(rate)):
        np.testing.assert_array_equal(found.positions, motion.at(found.times)[0])
        np.testing.assert_array_equal(found.at(times)[0], motion.at(times)[0])
        np.testing.assert_array_equal(found.at(times)[1], motion.at(times)[1])
    assert np.diff(again.times)[:-1] == pytest.approx(1 / rate)


@pytest.mark.parametrize("acceleration", [None, 1.0], ids=["velocities", "accelerations"])
def test_the_last_sample_is_not_repeated(acceleration: float | None) -> None:
    """Durations such as 0.351 s are a whole number of periods up to rounding errors."""
    for thousandths in range(1, 400):
        line = rg.Polyline([(0.05, 1), (0.05 + thousandths / 1000, 1)], PLANE)
        motion = rg.time_parameterize(line, velocity_limits=1.0, acceleration_limits=acceleration)
        for rate in (1e-4, 10.0, 20.0, 1000.0):
            again = motion.resampled(rate)
            step = np.diff(again.times)
            assert again.times[0] == 0
            assert again.duration == motion.duration
            assert len(step) == 1 or step.min() >= 1e-3 / rate
            assert (np.diff(again.positions[:, 0]) > 0).all()


def test_invalid_rates_and_times_raise_input_error() -> None:
    motion = rg.time_parameterize(rg.Polyline([(0, 0), (1, 1)], PLANE), velocity_limits=1)
    for rate in (0, -1, float("nan"), float("inf"), 1e30):
        with pytest.raises(rg.InputError, match=r"rate|samples"):
            motion.sample(rate)
    with pytest.raises(rg.InputError, match="sequence of numbers"):
        motion.at([np.nan])
    for bad in ("noon", [[0.0, 1.0]]):
        with pytest.raises(rg.InputError, match="sequence of numbers"):
            motion.at(bad)
    assert isinstance(PLANE, rg.ConfigurationSpace)
