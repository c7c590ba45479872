"""Compiled loops about a robot that moves among obstacles: for how much of a motion it surely stays apart from them.

A segment of the robot and a convex piece of an obstacle (an edge, a disc, a half-plane) are apart while a line
separates them: a line that stands still, beyond which both ends of the segment stay, or the segment's own, which moves
with it, and on whose other side the obstacle stays.  Heights over such a line are known with their rates, and their
second derivatives are bounded, so that until when they stay positive is the root of a parabola.  How a segment moves is
given by seven numbers: the rates of both of its ends, bounds on their accelerations, and the rate of its direction.

Numba takes seconds to import: only functions that are about to run import this module.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.control.contact_kernels import misses
from resgrid.jit import inner, kernel
from resgrid.robots.geometry import ObstacleArrays, Pose
from resgrid.robots.kernels import share

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_RIM = 1e-13


@njit(cache=True, inline="always")
def _until(height: float, rate: float, bend: float) -> float:
    """Until when ``height + rate u - bend u^2 / 2`` is not negative; 0 where it is from the start."""
    if height < 0.0:
        return 0.0
    root = math.sqrt(rate * rate + 2.0 * bend * height)
    if rate < 0.0:
        return 2.0 * height / (root - rate)
    return (rate + root) / bend if bend > 0.0 else np.inf


@inner
def _beyond(nx: float, ny: float, segment: Floats, moves: Floats, top: float) -> float:
    """Until when both ends of a moving segment stay beyond the line ``n . x = top``."""
    first = _until(nx * segment[0] + ny * segment[1] - top, nx * moves[0] + ny * moves[1], moves[4])
    return min(first, _until(nx * segment[2] + ny * segment[3] - top, nx * moves[2] + ny * moves[3], moves[5]))


@inner
def _beside(px: float, py: float, qx: float, qy: float, segment: Floats, moves: Floats, keep: float) -> float:
    """Until when two points that stand still keep away from the line of a moving segment, both on one side of it."""
    dx, dy = segment[2] - segment[0], segment[3] - segment[1]
    length = math.hypot(dx, dy)
    if length == 0.0:
        return 0.0
    nx, ny = dy / length, -dx / length
    end = 0 if moves[0] ** 2 + moves[1] ** 2 <= moves[2] ** 2 + moves[3] ** 2 else 2
    ex, ey, vx, vy, bend = segment[end], segment[end + 1], moves[end], moves[end + 1], moves[4 + end // 2]
    if nx * (px + qx - 2.0 * ex) + ny * (py + qy - 2.0 * ey) < 0.0:
        nx, ny = -nx, -ny
    turn, free = moves[6], np.inf
    for x, y in ((px, py), (qx, qy)):
        height = nx * (x - ex) + ny * (y - ey) - keep
        rate = turn * (nx * (y - ey) - ny * (x - ex)) - nx * vx - ny * vy
        far = math.hypot(x - ex, y - ey)
        bends = turn * turn * far + 2.0 * abs(turn) * (math.hypot(vx, vy) + bend) + bend
        free = min(free, _until(height, rate, bends))
    return free


@inner
def _apart(segment: Floats, edge: Floats) -> tuple[float, float, float]:
    """Distance of two segments that do not cross, and the unit vector from the second to the first."""
    best, vx, vy = np.inf, 0.0, 0.0
    for case in range(4):
        one, other = (segment, edge) if case < 2 else (edge, segment)
        px, py = one[2 * (case % 2)], one[2 * (case % 2) + 1]
        t = share(px, py, other[0], other[1], other[2], other[3])
        dx, dy = px - other[0] - t * (other[2] - other[0]), py - other[1] - t * (other[3] - other[1])
        size = math.hypot(dx, dy)
        if size < best:
            best = size
            vx, vy = (dx, dy) if case < 2 else (-dx, -dy)
    return (best, vx / best, vy / best) if best > 0.0 else (0.0, 0.0, 0.0)


@inner
def _free_of_edge(segment: Floats, moves: Floats, edge: Floats, keep: float) -> float:
    """Until when some line keeps a moving segment this far from an edge."""
    ax, ay, bx, by = edge
    apart, nx, ny = _apart(segment, edge)
    free = 0.0
    if apart > 0.0:
        free = _beyond(nx, ny, segment, moves, max(nx * ax + ny * ay, nx * bx + ny * by) + keep)
    if free < 1.0:
        free = max(free, _beside(ax, ay, bx, by, segment, moves, keep))
    if free < 1.0:
        length = math.hypot(bx - ax, by - ay)
        nx, ny = (by - ay) / length, (ax - bx) / length
        if nx * (segment[0] + segment[2] - ax - bx) + ny * (segment[1] + segment[3] - ay - by) < 0.0:
            nx, ny = -nx, -ny
        free = max(free, _beyond(nx, ny, segment, moves, max(nx * ax + ny * ay, nx * bx + ny * by) + keep))
    return free


@inner
def _free_of_disc(segment: Floats, moves: Floats, disc: Floats, keep: float) -> float:
    """Until when some line keeps a moving segment this far from a disc."""
    cx, cy, size = disc
    t = share(cx, cy, segment[0], segment[1], segment[2], segment[3])
    dx, dy = segment[0] + t * (segment[2] - segment[0]) - cx, segment[1] + t * (segment[3] - segment[1]) - cy
    apart = math.hypot(dx, dy)
    if apart == 0.0:
        return 0.0
    nx, ny = dx / apart, dy / apart
    free = _beyond(nx, ny, segment, moves, nx * cx + ny * cy + size + keep)
    return free if free >= 1.0 else max(free, _beside(cx, cy, cx, cy, segment, moves, size + keep))


@inner
def _moves(
    segment: Floats, part: int, shift: Floats, spin: Floats, pivot: Floats, lever: Floats, motion: Floats,
    turn: Floats, moves: Floats,
) -> None:  # fmt: skip
    """How a segment moves for a motion of the axes: rates and bends of both ends, and its turning."""
    moves[:] = 0.0
    for axis in range(len(motion)):
        for x in (0, 2):
            moves[x] += motion[axis] * (
                shift[part, axis, 0] - spin[part, axis] * (segment[x + 1] - pivot[part, axis, 1])
            )
            moves[x + 1] += motion[axis] * (
                shift[part, axis, 1] + spin[part, axis] * (segment[x] - pivot[part, axis, 0])
            )
    for end in (0, 1):
        for other in range(len(turn)):
            moves[4 + end] += lever[end, other] * turn[other] ** 2
    moves[6] = turn[part]


@kernel
def free_share(pose: Pose, solid: ObstacleArrays, motion: Floats, least: float) -> float:
    """Share of a straight motion in configuration space for which every gap is known to stay at ``least`` or above.

    A bound: the share that is free may be larger.
    """
    segments, radius, part, lever = pose.segments, pose.radius, pose.part, pose.lever
    edges, discs, planes = solid.edges, solid.discs, solid.half_planes
    free, moves, turn = 1.0, np.empty(7), pose.spin @ motion
    for s in range(len(segments)):
        segment = segments[s]
        _moves(segment, part[s], pose.shift, pose.spin, pose.pivot, lever[s], motion, turn, moves)
        far = max(math.hypot(moves[0], moves[1]) + moves[4], math.hypot(moves[2], moves[3]) + moves[5])
        reach = radius[s] + least + far
        x0, x1 = min(segment[0], segment[2]) - reach, max(segment[0], segment[2]) + reach
        y0, y1 = min(segment[1], segment[3]) - reach, max(segment[1], segment[3]) + reach
        keep = radius[s] + least - _RIM * (1.0 + max(abs(x0), abs(x1), abs(y0), abs(y1)))
        for e in range(len(edges)):
            if not misses(edges[e], x0, x1, y0, y1):
                free = min(free, _free_of_edge(segment, moves, edges[e], keep))
        for d in range(len(discs)):
            cx, cy, size = discs[d]
            if x0 - size <= cx <= x1 + size and y0 - size <= cy <= y1 + size:
                free = min(free, _free_of_disc(segment, moves, discs[d], keep))
        for h in range(len(planes)):
            nx, ny, offset = planes[h]
            free = min(free, _beyond(nx, ny, segment, moves, offset + keep))
    return free
