"""Time parameterization of paths: the fastest trajectory within velocity and acceleration limits.

Corners are rounded by parabolic blends (R. P. Paul, Robot Manipulators, 1981, chapter 5): a parabola of constant
acceleration from a distance ``d`` before the corner to ``d`` after it, which passes the corner, for unit directions
``u1`` and ``u2``, at the distance ``d |u2 - u1| / 4``.  Half of the tolerance bounds this distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import NotNegative, check_number
from resgrid._internal.values import frozen
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.planning.any_path import AnyPath, robot_of, unwrap
from resgrid.planning.motion_limits import Limits, limit_ratio, own_velocity_limits
from resgrid.planning.parabolic_blends import at_constant_velocities, with_blends
from resgrid.planning.streamline import Polyline, distinct_rows
from resgrid.scene.mask import Mask
from resgrid.scene.speed_zones import speed_zones

_MOST_SAMPLES = 10_000_000
"""Maximum number of samples of a trajectory; for more, InputError is raised."""

_LEAST_STEP = 1e-3
"""Minimum duration of the last step of a sampled trajectory, as a fraction of the sampling period.

A regular sample nearer to the end is left out.
"""


@frozen
@dataclass(frozen=True, eq=False)
class Trajectory:
    """A path with times.  Between two knots the acceleration is constant, except in resampled trajectories.

    Returned by `resgrid.time_parameterize`.

    Attributes
    ----------
    times : ndarray of float64, shape (n,)
        Times of the knots, ascending from 0, in seconds.
    positions : ndarray of float64, shape (n, ndim)
        Positions at the knots in world coordinates, continuous across periodic seams.
    velocities : ndarray of float64, shape (n, ndim)
        Velocities in world coordinates per second, just after each knot; 0 at the last knot.
    accelerations : ndarray of float64, shape (n - 1, ndim)
        Accelerations in world coordinates per second squared, between the knots; means in a resampled trajectory.
    path : Streamline, ShortPath, Polyline or NodePath
        The path that was time-parameterized.
    motion : Trajectory or None
        For a resampled trajectory, the original, which defines the motion between knots.
    space : ConfigurationSpace
        Configuration space of the path.
    duration : float
        Time from start to end, in seconds.

    Examples
    --------
    >>> path = rg.shortcut(rg.plan(rg.read_scene("examples/scenes/lesson.toml")).path((0.5, 6.5)), clearance=0.2)
    >>> motion = rg.time_parameterize(path, velocity_limits=2.0, acceleration_limits=1.0)
    >>> round(motion.duration, 2)
    7.35
    >>> positions, velocities = motion.at([1.0, 2.0])
    >>> positions.round(2), velocities.round(2)
    (array([[0.98, 6.36],
           [2.42, 5.95]]), array([[ 0.96, -0.27],
           [ 1.92, -0.55]]))
    """

    times: NDArray[np.float64]
    positions: NDArray[np.float64]
    velocities: NDArray[np.float64]
    accelerations: NDArray[np.float64]
    path: AnyPath
    motion: Trajectory | None = None

    @property
    def space(self) -> ConfigurationSpace:
        """Configuration space of the path."""
        return self.path.space

    @property
    def duration(self) -> float:
        """Time from start to end, in seconds."""
        return float(self.times[-1])

    def at(self, times: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return positions and velocities at given times; the robot rests before the start and after the end.

        Parameters
        ----------
        times : array_like of float, shape (m,)
            Times in seconds, from 0 at the start.

        Returns
        -------
        positions, velocities : ndarray of float64, shape (m, ndim)
            In world coordinates and world coordinates per second.

        Raises
        ------
        InputError
            If a time is not a number, or the times are not one-dimensional.
        """
        try:
            when = np.atleast_1d(np.asarray(times, dtype=np.float64))
        except (TypeError, ValueError):
            when = np.full(1, np.nan)
        if when.ndim != 1 or np.isnan(when).any():
            raise InputError("times must be a one-dimensional sequence of numbers")
        if self.motion is not None:
            return self.motion.at(when)
        if len(self.times) < 2:
            still = np.repeat(self.positions, len(when), axis=0)
            return still, np.zeros_like(still)
        piece = np.clip(np.searchsorted(self.times, when, side="right") - 1, 0, len(self.times) - 2)
        past = np.clip(when, 0.0, self.duration) - self.times[piece]
        step = past[:, np.newaxis]
        velocity = self.velocities[piece] + step * self.accelerations[piece]
        position = self.positions[piece] + step * (self.velocities[piece] + velocity) / 2
        over = when >= self.duration
        position[over] = self.positions[-1]
        velocity[over | (when < 0)] = 0.0
        return position, velocity

    def sample(self, rate: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Sample the trajectory at a constant rate; the end is always included.

        The last regular sample is omitted if it precedes the end by less than a thousandth of the sampling period.

        Parameters
        ----------
        rate : float
            Samples per second.

        Returns
        -------
        times : ndarray of float64, shape (m,)
        positions, velocities : ndarray of float64, shape (m, ndim)
            At these times, in seconds from the start: world coordinates, and world coordinates per second.

        Raises
        ------
        InputError
            If the rate is not positive, or gives more than 10,000,000 samples.
        """
        check_number("rate", rate, "a positive number of samples per second", above=0.0)
        if rate * self.duration > _MOST_SAMPLES:
            raise InputError(
                f"{rate:g} samples per second for {self.duration:g} s exceed {_MOST_SAMPLES:,}; lower the rate"
            )
        steps = np.arange(int(np.floor(rate * self.duration)) + 1) / rate
        apart = (self.duration - steps) * rate >= _LEAST_STEP
        apart[0] = self.duration > 0
        times = np.append(steps[apart], self.duration)
        return times, *self.at(times)

    def resampled(self, rate: float) -> Trajectory:
        """Return the motion with knots at a constant rate.

        Parameters
        ----------
        rate : float
            Knots per second.

        Returns
        -------
        Trajectory
            Positions and velocities at the knots are exact, accelerations are means; `at` is exact at all times.

        Raises
        ------
        InputError
            If the rate is not positive, or gives more than 10,000,000 knots.
        """
        times, positions, velocities = self.sample(rate)
        step = np.diff(times)[:, np.newaxis]
        accelerations = np.diff(velocities, axis=0) / step
        return Trajectory(times, positions, velocities, accelerations, self.path, self.motion or self)


def time_parameterize(
    path: AnyPath,
    *,
    velocity_limits: Limits | None = None,
    acceleration_limits: Limits | None = None,
    tolerance: NotNegative | None = None,
    masks: Sequence[Mask] = (),
) -> Trajectory:
    """Compute the fastest trajectory along a path within velocity and acceleration limits.

    With velocity limits only, each segment has the largest permitted constant velocity.  With acceleration limits, the
    robot starts and ends at rest, rounds corners at constant speed, and accelerates and brakes at the limit.

    Parameters
    ----------
    path : Streamline, ShortPath, Polyline or NodePath
        The path to follow.
    velocity_limits : float or sequence of float, optional
        Positive limits in world coordinates per second.  A sequence limits each coordinate separately.  A single number
        limits the speed (Euclidean norm) of point and disc robots, and each coordinate of other robots.  By default
        those of the robot: of a robot from a URDF file, the limits of its joints; other robots have none.
    acceleration_limits : float or sequence of float, optional
        Limits in world coordinates per second squared, in the forms of `velocity_limits`.  By default those of the
        robot (`URDFRobot.acceleration`); if the robot has none, accelerations are not limited.
    tolerance : float, optional
        With acceleration limits: maximum deviation from the path, in axis units, one half to straighten small bends,
        one half to round the remaining corners.  By default half of the path's clearance (at most a quarter of the
        smallest cell width), or 0 for a `Polyline`.  With 0, as on a path along obstacles, the robot stops at bends.
    masks : sequence of Mask
        Masks whose speed limits apply where the path, or a deviation from it within the tolerance, crosses them;
        `Scene.mask` of the scene.  Percentages refer to `velocity_limits`, absolute limits to the speed of the
        reference point in the plane.

    Returns
    -------
    Trajectory
        The path with times, in seconds, in world coordinates.

    Raises
    ------
    InputError
        If a limit is not positive, the number of limits is not the number of axes, a mask cannot be read, or velocity
        limits are not given and the robot has none for a coordinate that changes along the path.

    Examples
    --------
    >>> path = rg.shortcut(rg.plan(rg.read_scene("examples/scenes/lesson.toml")).path((0.5, 6.5)), clearance=0.2)
    >>> fast = rg.time_parameterize(path, velocity_limits=2.0)
    >>> smooth = rg.time_parameterize(path, velocity_limits=2.0, acceleration_limits=1.0)
    >>> round(float(fast.times[-1]), 2), round(float(smooth.times[-1]), 2)
    (4.11, 7.35)
    """
    points = _without_duplicates(unwrap(path))
    velocity_limits = own_velocity_limits(points, path) if velocity_limits is None else velocity_limits
    velocity = limit_ratio("velocity_limits", velocity_limits, path)
    acceleration_limits = robot_of(path).acceleration_limits if acceleration_limits is None else acceleration_limits
    zones = speed_zones(masks)
    if acceleration_limits is None:
        if tolerance is not None:
            raise InputError("tolerance applies only with acceleration limits: give acceleration_limits too")
        return Trajectory(*at_constant_velocities(points, velocity, zones), path)
    acceleration = limit_ratio("acceleration_limits", acceleration_limits, path)
    within = _default_tolerance(path) if tolerance is None else tolerance
    if len(points) < 2:
        return Trajectory(*at_constant_velocities(points, velocity), path)
    corners = _simplified(points, max(within / 2, 4 * np.spacing(np.abs(points).max())))
    zones = zones if zones is None else zones.widened(within)
    return Trajectory(*with_blends(corners, velocity, acceleration, within / 2, zones), path)


def _default_tolerance(path: AnyPath) -> float:
    """Return the default of the maximum deviation from a path, in axis units.

    It is half of the path's clearance, but at most a quarter of the smallest cell width; 0 for a `Polyline`.
    """
    if isinstance(path, Polyline):
        return 0.0
    clearance = np.inf if np.isnan(path.clearance) else path.clearance
    return float(min(clearance / 2, path.space.spacing.min() / 4))


def _without_duplicates(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points (m, ndim), m <= n, that remain of `points` (n, ndim) without consecutive duplicates."""
    return np.asarray(points[distinct_rows(points, np.zeros(points.shape[1]))])


def _simplified(points: NDArray[np.float64], within: float) -> NDArray[np.float64]:
    """Return corners (m, ndim) of a simpler polyline, at most `within` away from `points` (Douglas & Peucker 1973)."""
    keep = np.zeros(len(points), dtype=bool)
    keep[[0, -1]] = True
    open_parts = [(0, len(points) - 1)]
    while open_parts:
        first, last = open_parts.pop()
        if last - first < 2:
            continue
        away = _distance_from_segment(points[first + 1 : last], points[first], points[last])
        farthest = int(np.argmax(away))
        if away[farthest] > within:
            keep[middle := first + 1 + farthest] = True
            open_parts += [(first, middle), (middle, last)]
    return _without_duplicates(points[keep])


def _distance_from_segment(
    points: NDArray[np.float64], start: NDArray[np.float64], end: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distances (n,) of points (n, ndim) from the segment between `start` and `end` (ndim,)."""
    along = end - start
    square = along @ along
    fraction = np.clip((points - start) @ along / square, 0.0, 1.0) if square else np.zeros(len(points))
    return np.asarray(np.linalg.norm(points - start - fraction[:, np.newaxis] * along, axis=1))
