"""Speeds along a polyline: constant speeds between corners, or straight parts with parabolic blends at the corners.

See `resgrid.planning.time_parameterization` for the method.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.planning.motion_limits import LimitRatio
from resgrid.scene.speed_zones import SpeedLimits, SpeedZones

Knots = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""Times (n,) of knots, positions and velocities (n, ndim) at the knots, accelerations (n - 1, ndim) between them.

Units are those of a `Trajectory`: seconds and world coordinates.
"""

_STRAIGHT = 1e-12
"""Euclidean norm of the change of unit direction at a corner (no unit) below which the path counts as straight."""

_MOMENT = 1e-13
"""Duration below which a phase of constant acceleration is omitted, as a fraction of the duration of the motion."""


def at_constant_velocities(points: NDArray[np.float64], velocity: LimitRatio, zones: SpeedZones | None = None) -> Knots:
    """Return times, positions, velocities and accelerations (0) of a motion with the largest constant velocities.

    The velocity is constant between two corners.  `points` (n, ndim): corners in world coordinates; `velocity`:
    function that returns ratios of vectors to the velocity limits; `zones`: further speed limits, None for none.
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
    """Return times, positions, velocities and accelerations of a motion that rounds corners by parabolic blends.

    `points` (n, ndim): corners in world coordinates; `velocity`, `acceleration`: functions that return ratios of
    vectors to the limits; `within`: largest distance of a blend from its corner; `zones`: further speed limits, None
    for none.
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

    Phases without duration are left out.  `length`: length of the part; `enter`, `leave`: speeds at its start and end;
    `top`, `accel`: limits of speed and acceleration.
    """
    peak = min(top, float(np.sqrt(accel * length + (enter**2 + leave**2) / 2)))
    peak = max(peak, enter, leave)
    cruise = length - (2 * peak**2 - enter**2 - leave**2) / (2 * accel)
    pieces = [((peak - enter) / accel, peak), (max(cruise, 0.0) / peak, peak), ((peak - leave) / accel, leave)]
    return [(seconds, speed) for seconds, speed in pieces if seconds > 0]


def _knots(points: NDArray[np.float64], pieces: list[tuple[float, NDArray[np.float64]]]) -> Knots:
    """Return times, positions, velocities and accelerations of consecutive phases of constant acceleration.

    The motion starts at rest in the first point and ends at rest in the last one.  `points` (n, ndim): corners of the
    path; `pieces`: duration and final velocity (ndim,) of every phase.
    """
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
    `acceleration`: function that returns ratios of vectors to the acceleration limits; `within`: largest distance of a
    blend from its corner.  Results are 0 at the start and the end of the path.
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

    ``v`` and ``v'`` are the speeds at the ends of a segment.  `limit` (n + 1,): speed limits at corners; `straight`
    (n,): lengths ``s`` of the straight parts of the segments; `accel` (n,): acceleration limits ``a``.
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
    """Return the corners (m, ndim) of a polyline divided where its speed limits change, and data of its segments.

    The data are the index (m - 1,) of the original segment that contains each segment, and the speed limits of each.
    `points` (n, ndim): corners in world coordinates; `zones`: speed limits, None for none.
    """
    if zones is None:
        count = len(points) - 1
        return points, np.arange(count), SpeedLimits(np.ones(count), np.full(count, np.inf))
    return zones.split(points)
