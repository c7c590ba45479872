"""Time parameterization of paths: the fastest trajectory within velocity and acceleration limits.

Corners are rounded by parabolic blends (R. P. Paul, Robot Manipulators, 1981, chapter 5): a parabola of constant
acceleration from a distance ``d`` before the corner to ``d`` after it, which passes the corner, for unit directions
``u1`` and ``u2``, at the distance ``d |u2 - u1| / 4``.  The tolerance bounds ``d``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import NotNegative, check_number
from resgrid._internal.values import frozen
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.planning.motion_limits import LimitRatio, Limits, limit_ratio, own_velocity_limits
from resgrid.planning.streamline import AnyPath, Polyline, distinct_rows, robot_of, unwrap

Knots = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""Times (n,), positions and velocities (n, ndim), and accelerations (n - 1, ndim) of a `Trajectory`, in this order."""

_STRAIGHT = 1e-12
"""Euclidean norm of the change of unit direction at a corner (no unit) below which the path counts as straight."""

_MOMENT = 1e-13
"""Duration below which a piece of constant acceleration is omitted, as a fraction of the total duration."""

_MOST_SAMPLES = 10_000_000
"""Maximum number of samples of a trajectory."""

_LEAST_STEP = 1e-3
"""Minimum duration of the last step of a sampled trajectory, as a fraction of the sampling period."""


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
    path : Streamline, ShortPath or Polyline
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
) -> Trajectory:
    """Compute the fastest trajectory along a path within velocity and acceleration limits.

    With velocity limits only, each segment has the largest permitted constant velocity.  With acceleration limits, the
    robot starts and ends at rest, rounds corners at constant speed, and accelerates and brakes at the limit.

    Parameters
    ----------
    path : Streamline, ShortPath or Polyline
        The path to follow.
    velocity_limits : float or sequence of float, optional
        Positive limits in world coordinates per second.  A sequence limits each coordinate separately.  A single number
        limits the speed (Euclidean norm) of point and disc robots, and each coordinate of other robots.  By default
        those of the robot: of a robot from a URDF file, the limits of its joints; other robots have none.
    acceleration_limits : float or sequence of float, optional
        Limits in world coordinates per second squared, applied in the same form.  By default those of the robot, if it
        has some (`URDFRobot.acceleration`).
    tolerance : float, optional
        With acceleration limits: maximum deviation from the path, in axis units, one half to straighten small bends,
        one half to round the remaining corners.  By default half of the path's clearance (at most a quarter of the
        smallest cell width), or 0 for a `Polyline`.  With 0, as on a path along obstacles, the robot stops at bends.

    Returns
    -------
    Trajectory
        The path with times, in seconds, in world coordinates.

    Raises
    ------
    InputError
        If a limit is not positive, the number of limits is not the number of axes, or velocity limits are not given
        and the robot has none for a coordinate that changes along the path.

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
    if acceleration_limits is None:
        if tolerance is not None:
            raise InputError("tolerance applies only with acceleration limits: give acceleration_limits too")
        return Trajectory(*_at_constant_velocities(points, velocity), path)
    acceleration = limit_ratio("acceleration_limits", acceleration_limits, path)
    within = _default_tolerance(path) if tolerance is None else tolerance
    if len(points) < 2:
        return Trajectory(*_at_constant_velocities(points, velocity), path)
    corners = _simplified(points, max(within / 2, 4 * np.spacing(np.abs(points).max())))
    return Trajectory(*_with_blends(corners, velocity, acceleration, within / 2), path)


def _default_tolerance(path: AnyPath) -> float:
    """Return the default of the maximum deviation from a path, in axis units: 0 for a `Polyline`."""
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


def _at_constant_velocities(points: NDArray[np.float64], velocity: LimitRatio) -> Knots:
    """Return times, positions, velocities, accelerations (0) of the fastest motion through `points` (n, ndim).

    `velocity`: function from steps to the ratios of their lengths to the velocity limits: shortest durations (s).
    """
    step = np.diff(points, axis=0)
    seconds = velocity(step)
    velocities = np.concatenate([step / seconds[:, np.newaxis], np.zeros((1, points.shape[1]))])
    times = np.concatenate([[0.0], np.cumsum(seconds)])
    return times, points, velocities, np.zeros_like(step)


def _with_blends(points: NDArray[np.float64], velocity: LimitRatio, acceleration: LimitRatio, within: float) -> Knots:
    """Return times, positions, velocities, accelerations of a motion whose corners are rounded by blends (parabolas).

    `points` (n, ndim): corners; `velocity, acceleration`: functions from vectors to the ratios of their magnitudes to
    the limits; `within`: largest distance of a blend from its corner.
    """
    step = np.diff(points, axis=0)
    length = np.linalg.norm(step, axis=1)
    heading = step / length[:, np.newaxis]
    top_speed, accel = 1.0 / velocity(heading), 1.0 / acceleration(heading)
    reach, corner_speed = _blend_limits(heading, length, top_speed, acceleration, within)
    straight = np.maximum(length - reach[:-1] - reach[1:], 0.0)
    speed = _attainable_speeds(corner_speed, straight, accel)
    pieces: list[tuple[float, NDArray[np.float64]]] = []
    for k in range(len(length)):
        if reach[k] > 0:
            pieces.append((2 * reach[k] / speed[k], speed[k] * heading[k]))
        pieces += [
            (seconds, end_speed * heading[k])
            for seconds, end_speed in _straight_pieces(straight[k], speed[k], speed[k + 1], top_speed[k], accel[k])
        ]
    return _knots(points, pieces)


def _straight_pieces(length: float, enter: float, leave: float, top: float, accel: float) -> list[tuple[float, float]]:
    """Return pairs (duration, final speed) for acceleration, constant speed and braking on a straight part.

    `length`: length of the part; `enter, leave`: speeds at both ends; `top`, `accel`: limits of speed, acceleration.
    """
    peak = min(top, float(np.sqrt(accel * length + (enter**2 + leave**2) / 2)))
    peak = max(peak, enter, leave)
    cruise = length - (2 * peak**2 - enter**2 - leave**2) / (2 * accel)
    pieces = [((peak - enter) / accel, peak), (max(cruise, 0.0) / peak, peak), ((peak - leave) / accel, leave)]
    return [(seconds, speed) for seconds, speed in pieces if seconds > 0]


def _knots(points: NDArray[np.float64], pieces: list[tuple[float, NDArray[np.float64]]]) -> Knots:
    """Return times, positions, velocities, accelerations; `pieces`: (seconds, velocity at the end) between knots."""
    total = sum(duration for duration, _ in pieces)
    pieces = [piece for piece in pieces if piece[0] > _MOMENT * total]
    seconds = np.array([duration for duration, _ in pieces])
    velocities = np.stack([np.zeros(points.shape[1]), *(velocity for _, velocity in pieces)])
    duration = seconds[:, np.newaxis]
    positions = points[0] + np.concatenate(
        [np.zeros((1, points.shape[1])), np.cumsum(duration * (velocities[:-1] + velocities[1:]) / 2, axis=0)]
    )
    positions[-1], velocities[-1] = points[-1], 0.0
    times = np.concatenate([[0.0], np.cumsum(seconds)])
    return times, positions, velocities, np.diff(velocities, axis=0) / duration


def _blend_limits(
    heading: NDArray[np.float64],
    length: NDArray[np.float64],
    top_speed: NDArray[np.float64],
    acceleration: LimitRatio,
    within: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return distances from corners to the ends of their blends (parabolas), and speeds in blends, both (n + 1,).

    `heading` (n, ndim), `length`, `top_speed` (n,): unit directions, lengths and largest speeds of the n segments;
    `acceleration`: ratios of vectors to the limits; `within`: largest deviation.  Results are 0 at start and end.
    """
    reach, speed = np.zeros(len(length) + 1), np.zeros(len(length) + 1)
    turn = np.diff(heading, axis=0)
    sharpness = np.linalg.norm(turn, axis=1)
    bent = sharpness > _STRAIGHT
    half = np.minimum(length[:-1], length[1:]) / 2
    with np.errstate(divide="ignore"):
        reach[1:-1] = np.where(bent, np.minimum(4 * within / np.maximum(sharpness, _STRAIGHT), half), 0.0)
        accel = 1.0 / acceleration(turn)
    limit = np.minimum(top_speed[:-1], top_speed[1:])
    # Over a distance 2 d at speed v, the velocity changes by v (u2 - u1): the acceleration is v^2 (u2 - u1) / (2 d).
    with np.errstate(invalid="ignore"):
        speed[1:-1] = np.where(bent, np.minimum(limit, np.sqrt(2 * reach[1:-1] * accel)), limit)
    return reach, speed


def _attainable_speeds(
    limit: NDArray[np.float64], straight: NDArray[np.float64], accel: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the largest speeds (n + 1,) at corners that satisfy ``v'^2 <= v^2 + 2 a s`` in both directions.

    `limit` (n + 1,): speed limits at corners; `straight` (n,): lengths s; `accel` (n,): acceleration limits a.
    """
    square = limit**2
    for k in range(len(straight)):
        square[k + 1] = min(square[k + 1], square[k] + 2 * accel[k] * straight[k])
    for k in range(len(straight) - 1, -1, -1):
        square[k] = min(square[k], square[k + 1] + 2 * accel[k] * straight[k])
    return np.sqrt(square)
