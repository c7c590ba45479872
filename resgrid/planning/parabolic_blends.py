"""Speeds along a polyline: constant speeds between corners, or straight parts with parabolic blends at the corners.

See `resgrid.planning.time_parameterization` for the method.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.planning.motion_limits import LimitRatio
from resgrid.scene.speed_zones import SpeedLimits, SpeedZones

Knots = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""Times (n,), positions and velocities (n, ndim), and accelerations (n - 1, ndim) of a `Trajectory`, in this order."""

_STRAIGHT = 1e-12
"""Euclidean norm of the change of unit direction at a corner (no unit) below which the path counts as straight."""

_MOMENT = 1e-13
"""Duration below which a piece of constant acceleration is omitted, as a fraction of the total duration."""


def at_constant_velocities(points: NDArray[np.float64], velocity: LimitRatio, zones: SpeedZones | None = None) -> Knots:
    """Return times, positions, velocities, accelerations (0) at largest constant velocities between `points`.

    `velocity`: ratio to the velocity limits; `zones`: further speed limits, None for none.
    """
    points, _, limits = _split(points, zones)
    step = np.diff(points, axis=0)
    seconds = velocity(step)
    if zones is not None:
        seconds = np.maximum(seconds / limits.fraction, np.linalg.norm(step[:, :2], axis=1) / limits.speed)
    velocities = np.concatenate([step / seconds[:, np.newaxis], np.zeros((1, points.shape[1]))])
    times = np.concatenate([[0.0], np.cumsum(seconds)])
    return times, points, velocities, np.zeros_like(step)


def with_blends(
    points: NDArray[np.float64],
    velocity: LimitRatio,
    acceleration: LimitRatio,
    within: float,
    zones: SpeedZones | None = None,
) -> Knots:
    """Return times, positions, velocities, accelerations with blends at most `within` away from the `points`.

    `velocity`, `acceleration`: ratios to the limits; `zones`: further speed limits, None for none.
    """
    heading = np.diff(points, axis=0)
    heading /= np.linalg.norm(heading, axis=1)[:, np.newaxis]
    points, origin, limits = _split(points, zones)
    length = np.linalg.norm(np.diff(points, axis=0), axis=1)
    heading = heading[origin]  # equal for the parts of a segment, which makes them exactly straight
    top_speed, accel = 1.0 / velocity(heading), 1.0 / acceleration(heading)
    if zones is not None:
        with np.errstate(divide="ignore"):
            absolute = limits.speed / np.linalg.norm(heading[:, :2], axis=1)
        top_speed = np.minimum(top_speed * limits.fraction, absolute)
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
    """Return times, positions from ``points[0]`` on, velocities, accelerations; `pieces`: (duration, end velocity)."""
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
    """Return distances from corners to the ends of their blends, and largest speeds in blends, both (n + 1,).

    `heading` (n, ndim), `length`, `top_speed` (n,): unit directions, lengths and largest speeds of the n segments;
    `acceleration`: ratio to the limits; `within`: largest deviation from a corner.  Results are 0 at start and end.
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


def _split(
    points: NDArray[np.float64], zones: SpeedZones | None
) -> tuple[NDArray[np.float64], NDArray[np.int64], SpeedLimits]:
    """Return a polyline (n, ndim) divided where its speed limits change, as by `SpeedZones.split`."""
    if zones is None:
        count = len(points) - 1
        return points, np.arange(count), SpeedLimits(np.ones(count), np.full(count, np.inf))
    return zones.split(points)
