"""From a path to a trajectory: as fast as the axes allow.

With limits on accelerations a corner would have to be taken at rest.  Instead it is rounded by a parabola of constant
acceleration that leaves the straight lines at a distance ``d`` before and meets them as far behind it (linear segments
with parabolic blends: R. P. Paul, Robot Manipulators, 1981, chapter 5).  It stays within the triangle at the corner and
passes it at ``d |u2 - u1| / 4``, for directions ``u1`` and ``u2``, which bounds ``d``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import NotNegative, check_number, per_axis
from resgrid._internal.values import frozen
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.planning.streamline import AnyPath, Polyline, distinct_rows, robot_of, unwrap

Limits = float | Sequence[float] | NDArray[np.float64]

Load = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""How many times its limits each of some vectors, shape (n, ndim), is: shape (n,)."""

Knots = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""Times, positions, velocities and accelerations of a trajectory."""

_STRAIGHT = 1e-12
_MOMENT = 1e-13
_MOST_SAMPLES = 10_000_000

_LEAST_STEP = 1e-3
"""Shortest last step of a sampled motion, as a fraction of the sampling period."""


@frozen
@dataclass(frozen=True, eq=False)
class Trajectory:
    """A motion: between two knots the acceleration is constant, unless it was resampled.

    Attributes
    ----------
    times : ndarray of float64, shape (n,)
        Ascending from 0, in seconds.
    positions : ndarray of float64, shape (n, ndim)
        World coordinates, continuous across periodic seams.
    velocities : ndarray of float64, shape (n, ndim)
        In the world, per second, just after each knot; 0 at the last.
    accelerations : ndarray of float64, shape (n - 1, ndim)
        In the world, per second squared, between the knots; of a resampled motion, their means.
    path : Streamline, ShortPath or Polyline
        The path that it times.
    motion : Trajectory or None
        Of a resampled motion, the one it was taken from, which it follows between its knots too.
    """

    times: NDArray[np.float64]
    positions: NDArray[np.float64]
    velocities: NDArray[np.float64]
    accelerations: NDArray[np.float64]
    path: AnyPath
    motion: Trajectory | None = None

    @property
    def space(self) -> ConfigurationSpace:
        """The space it lies in."""
        return self.path.space

    @property
    def duration(self) -> float:
        """Time from start to end, in seconds."""
        return float(self.times[-1])

    def at(self, times: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Positions and velocities at any times, both (m, ndim); before the start and after the end the robot rests.

        Shapes: `times` (m,), in seconds.
        """
        try:
            when = np.atleast_1d(np.asarray(times, dtype=np.float64))
        except (TypeError, ValueError):
            when = np.full(1, np.nan)
        if when.ndim != 1 or np.isnan(when).any():
            raise InputError("a time is not a number, or the times are no row")
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
        """So many times a second and the end (m,), with positions and velocities there, both (m, ndim).

        A time that precedes the end by less than a thousandth of a period is left out: the same place twice, or a step
        whose acceleration is a quotient of rounding errors, would follow.
        """
        check_number("rate", rate, "a positive number of samples a second", above=0.0)
        if rate * self.duration > _MOST_SAMPLES:
            raise InputError(
                f"{rate:g} samples a second for {self.duration:g} s are more than {_MOST_SAMPLES:,}; lower the rate"
            )
        steps = np.arange(int(np.floor(rate * self.duration)) + 1) / rate
        apart = (self.duration - steps) * rate >= _LEAST_STEP
        apart[0] = self.duration > 0
        times = np.append(steps[apart], self.duration)
        return times, *self.at(times)

    def resampled(self, rate: float) -> Trajectory:
        """The same motion with so many knots a second: exact at them, and `at` any time; accelerations are means."""
        times, positions, velocities = self.sample(rate)
        step = np.diff(times)[:, np.newaxis]
        accelerations = np.diff(velocities, axis=0) / step
        return Trajectory(times, positions, velocities, accelerations, self.path, self.motion or self)


def time_parameterize(
    path: AnyPath,
    *,
    velocity_limits: Limits,
    acceleration_limits: Limits | None = None,
    tolerance: NotNegative | None = None,
) -> Trajectory:
    """Time a path as fast as limits allow.

    With velocities alone every segment is passed at the greatest constant velocity, which jumps at corners.  With
    accelerations the robot starts and ends at rest, corners are rounded at constant speed, and on the straight parts it
    accelerates and brakes as hard as it may (speeds at corners by a forward and a backward pass): no motion of this
    kind is faster.

    Parameters
    ----------
    path : Streamline, ShortPath or Polyline
    velocity_limits : float or sequence of float
        In units of the world's coordinates a second, positive.  A number for each of them limits each by itself.  One
        number limits how fast the robot itself is: of a point or a disc its speed in whatever direction; of other
        robots every axis by itself.
    acceleration_limits : float or sequence of float, optional
        Likewise, a second squared.
    tolerance : float, optional
        Greatest distance, in axis units, from the path: half of it to straighten the path's small bends, half to round
        the corners that are left.  By default half the path's clearance, at most a quarter of the narrowest cell; of a
        `Polyline`, 0: rest at every corner.  A path that touches an obstacle, as those of open ones do, has no
        clearance either, and rests at every bend: `shortcut` it with a clearance first, or say how far it may swerve.
        Only with accelerations.

    Returns
    -------
    Trajectory
        In the world.

    Raises
    ------
    InputError
        If a limit is not positive, or does not fit the axes.

    Examples
    --------
    >>> path = rg.shortcut(rg.plan(rg.read_scene("examples/scenes/lesson.toml")).path((0.5, 6.5)), clearance=0.2)
    >>> fast = rg.time_parameterize(path, velocity_limits=2.0)
    >>> smooth = rg.time_parameterize(path, velocity_limits=2.0, acceleration_limits=1.0)
    >>> round(float(fast.times[-1]), 2), round(float(smooth.times[-1]), 2)
    (4.11, 7.35)
    """
    velocity = _load("velocity_limits", velocity_limits, path)
    points = _distinct(unwrap(path))
    if acceleration_limits is None:
        if tolerance is not None:
            raise InputError("tolerance rounds corners for the sake of accelerations: give acceleration_limits too")
        return Trajectory(*_at_constant_velocities(points, velocity), path)
    acceleration = _load("acceleration_limits", acceleration_limits, path)
    within = _default_tolerance(path) if tolerance is None else tolerance
    if len(points) < 2:
        return Trajectory(*_at_constant_velocities(points, velocity), path)
    corners = _straightened(points, max(within / 2, 4 * np.spacing(np.abs(points).max())))
    return Trajectory(*_blended(corners, velocity, acceleration, within / 2), path)


def _default_tolerance(path: AnyPath) -> float:
    if isinstance(path, Polyline):
        return 0.0
    clearance = np.inf if np.isnan(path.clearance) else path.clearance
    return float(min(clearance / 2, path.space.spacing.min() / 4))


def _load(name: str, limits: Limits, path: AnyPath) -> Load:
    """How limits weigh vectors of the world."""
    each = per_axis(name, limits, path.space.ndim, "positive and finite", above=0.0)
    if np.size(limits) == 1 and robot_of(path).moves_in_workspace:
        return lambda vectors: np.asarray(np.linalg.norm(vectors, axis=1) / each[0])
    return lambda vectors: np.asarray((np.abs(vectors) / each).max(axis=1))


def _distinct(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points without repetitions of the one before."""
    return np.asarray(points[distinct_rows(points, np.zeros(points.shape[1]))])


def _straightened(points: NDArray[np.float64], within: float) -> NDArray[np.float64]:
    """Corners that keep the path within a distance (Ramer 1972; Douglas & Peucker 1973)."""
    keep = np.zeros(len(points), dtype=bool)
    keep[[0, -1]] = True
    open_parts = [(0, len(points) - 1)]
    while open_parts:
        first, last = open_parts.pop()
        if last - first < 2:
            continue
        away = _distance_from_line(points[first + 1 : last], points[first], points[last])
        farthest = int(np.argmax(away))
        if away[farthest] > within:
            keep[middle := first + 1 + farthest] = True
            open_parts += [(first, middle), (middle, last)]
    return _distinct(points[keep])


def _distance_from_line(
    points: NDArray[np.float64], start: NDArray[np.float64], end: NDArray[np.float64]
) -> NDArray[np.float64]:
    along = end - start
    square = along @ along
    share = np.clip((points - start) @ along / square, 0.0, 1.0) if square else np.zeros(len(points))
    return np.asarray(np.linalg.norm(points - start - share[:, np.newaxis] * along, axis=1))


def _at_constant_velocities(points: NDArray[np.float64], velocity: Load) -> Knots:
    step = np.diff(points, axis=0)
    seconds = velocity(step)
    velocities = np.concatenate([step / seconds[:, np.newaxis], np.zeros((1, points.shape[1]))])
    times = np.concatenate([[0.0], np.cumsum(seconds)])
    return times, points, velocities, np.zeros_like(step)


def _blended(points: NDArray[np.float64], velocity: Load, acceleration: Load, within: float) -> Knots:
    step = np.diff(points, axis=0)
    length = np.linalg.norm(step, axis=1)
    heading = step / length[:, np.newaxis]
    top_speed, push = 1.0 / velocity(heading), 1.0 / acceleration(heading)
    reach, corner_speed = _corners(heading, length, top_speed, acceleration, within)
    straight = np.maximum(length - reach[:-1] - reach[1:], 0.0)
    speed = _passes(corner_speed, straight, push)
    pieces: list[tuple[float, NDArray[np.float64]]] = []
    for k in range(len(length)):
        if reach[k] > 0:
            pieces.append((2 * reach[k] / speed[k], speed[k] * heading[k]))
        pieces += [
            (seconds, end_speed * heading[k])
            for seconds, end_speed in _straight(straight[k], speed[k], speed[k + 1], top_speed[k], push[k])
        ]
    return _joined(points, pieces)


def _straight(length: float, enter: float, leave: float, top: float, push: float) -> list[tuple[float, float]]:
    """Durations and final speeds of the pieces of a straight part: accelerate, cruise, brake."""
    peak = min(top, float(np.sqrt(push * length + (enter**2 + leave**2) / 2)))
    peak = max(peak, enter, leave)
    cruise = length - (2 * peak**2 - enter**2 - leave**2) / (2 * push)
    pieces = [((peak - enter) / push, peak), (max(cruise, 0.0) / peak, peak), ((peak - leave) / push, leave)]
    return [(seconds, speed) for seconds, speed in pieces if seconds > 0]


def _joined(points: NDArray[np.float64], pieces: list[tuple[float, NDArray[np.float64]]]) -> Knots:
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


def _corners(
    heading: NDArray[np.float64],
    length: NDArray[np.float64],
    top_speed: NDArray[np.float64],
    acceleration: Load,
    within: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How far each blend reaches on both sides, and the greatest speed in it; both 0 at start and end."""
    reach, speed = np.zeros(len(length) + 1), np.zeros(len(length) + 1)
    turn = np.diff(heading, axis=0)
    sharpness = np.linalg.norm(turn, axis=1)
    bent = sharpness > _STRAIGHT
    half = np.minimum(length[:-1], length[1:]) / 2
    with np.errstate(divide="ignore"):
        reach[1:-1] = np.where(bent, np.minimum(4 * within / np.maximum(sharpness, _STRAIGHT), half), 0.0)
        push = 1.0 / acceleration(turn)
    limit = np.minimum(top_speed[:-1], top_speed[1:])
    # Over 2 d at speed v the velocity changes by v (u2 - u1), hence the acceleration is v^2 (u2 - u1) / (2 d).
    with np.errstate(invalid="ignore"):
        speed[1:-1] = np.where(bent, np.minimum(limit, np.sqrt(2 * reach[1:-1] * push)), limit)
    return reach, speed


def _passes(
    limit: NDArray[np.float64], straight: NDArray[np.float64], push: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Greatest speeds at the corners from which the next can be met: v'^2 <= v^2 + 2 a s, forward and backward."""
    square = limit**2
    for k in range(len(straight)):
        square[k + 1] = min(square[k + 1], square[k] + 2 * push[k] * straight[k])
    for k in range(len(straight) - 1, -1, -1):
        square[k] = min(square[k], square[k + 1] + 2 * push[k] * straight[k])
    return np.sqrt(square)
