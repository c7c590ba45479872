"""Compiled kernels of a robot among obstacles: near-point pairs, contact Jacobians, collision-free parts of motions.

The robot consists of segments with a radius, obstacles of edges, discs and half-planes.  A segment of the robot and an
obstacle are separate while a line separates them.  Two kinds of lines are used.  One is fixed, and both ends of the
segment stay beyond it.  The other is the line of the segment, which moves with it, and the obstacle stays on the other
side of this line.  The heights (signed distances) above such a line have known rates and bounded second derivatives, so
that the time until a height vanishes is at least the root of a parabola.  The motion of a segment is given by seven
numbers: the rates of both ends (4), bounds on their accelerations (2), and the rate of its direction.  The unit of time
is the duration of the whole motion.

Importing numba takes seconds, so that this module is imported only by functions that call a kernel.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import inlined, inner, kernel
from resgrid.robots.geometry import TOUCH, ObstacleArrays, Pose
from resgrid.robots.kernels import segment_parameter

_RIM = 1e-13
"""Allowance for rounding errors in gaps, as a fraction of 1 m plus the largest magnitude of a coordinate."""

Floats = NDArray[np.float64]
Pairs = Any
"""A structured array of near-point pairs, with the dtype `resgrid.control.plant.PAIR`."""


@inner
def _add(
    pairs: Pairs, count: int, px: float, py: float, ox: float, oy: float, inward: tuple[float, float],
    outward: tuple[float, float], owner: tuple[float, int, int], reach: float,
) -> int:  # fmt: skip
    """Append a pair of near points to an array unless it is a duplicate or too far; return the new number of pairs.

    `pairs`: array of records with the points, directions, gap and owners of a pair (`resgrid.control.plant.PAIR`);
    `count`: present number of pairs; `px, py`: point on the robot's core (its segment without the radius), in metres;
    `ox, oy`: point on the obstacle's surface, in metres; `inward`: unit direction into the obstacle; `outward`: unit
    normal out of the obstacle, used if both points coincide; `owner`: radius of the segment in metres, index of its
    rigid body (the link of an arm), index of the obstacle; `reach`: largest gap of a pair, in metres.
    """
    dx, dy = px - ox, py - oy
    apart = math.hypot(dx, dy)
    radius, part, body = owner
    gap = apart - radius
    if gap > reach or count >= len(pairs):
        return count
    nx, ny = (dx / apart, dy / apart) if apart > TOUCH else outward
    rx, ry = px - radius * nx, py - radius * ny
    for k in range(count):
        (x, y), (u, v) = pairs[k].on_robot, pairs[k].point
        if abs(x - rx) + abs(y - ry) + abs(u - ox) + abs(v - oy) <= 1e-12 * (1.0 + abs(ox) + abs(oy)):
            return count
    pair = pairs[count]
    pair.on_robot[0], pair.on_robot[1], pair.point[0], pair.point[1] = rx, ry, ox, oy
    pair.normal[0], pair.normal[1], pair.inward[0], pair.inward[1] = nx, ny, inward[0], inward[1]
    pair.gap, pair.part, pair.body = gap, part, body
    return count + 1


@inlined
def misses(edge: Floats, x0: float, x1: float, y0: float, y1: float) -> bool:
    """Return whether an edge certainly lies outside an axis-parallel box.

    The test is sufficient only: the result may be False for an edge that passes close to a corner of the box.  `edge`
    (4,): start and end, ``ax, ay, bx, by``; `x0, x1, y0, y1`: limits of the box; all in metres.
    """
    ax, ay, bx, by = edge
    return bool(max(ax, bx) < x0 or min(ax, bx) > x1 or max(ay, by) < y0 or min(ay, by) > y1)


@inlined
def _left_of(edge: Floats) -> tuple[float, float]:
    """Return the components of the unit normal to the left of an edge, which points into the obstacle.

    `edge` (4,): start and end, ``ax, ay, bx, by``, in metres.
    """
    dx, dy = edge[2] - edge[0], edge[3] - edge[1]
    length = math.hypot(dx, dy)
    return -dy / length, dx / length


@inner
def _inside_corner(edge: Floats, before: Floats) -> tuple[float, float]:
    """Return the unit direction ``(x, y)`` into the obstacle from the corner at the start of an edge.

    The direction bisects the normals of both edges; at a spike (edges in opposite directions) it points along the
    spike.  `edge` (4,): edge that starts at the corner; `before` (4,): edge that ends there; both as ``ax, ay, bx,
    by``, in metres.
    """
    (ax, ay), (bx, by) = _left_of(edge), _left_of(before)
    length = math.hypot(ax + bx, ay + by)
    if length < 1e-9:
        return ay, -ax
    return (ax + bx) / length, (ay + by) / length


@inner
def _off_side(ax: float, ay: float, bx: float, by: float, inward: tuple[float, float]) -> tuple[float, float]:
    """Return the unit normal ``(x, y)`` of the segment from a to b on the side away from an obstacle.

    `ax, ay, bx, by`: ends of the segment, in metres; `inward`: direction into the obstacle.
    """
    length = math.hypot(bx - ax, by - ay)
    nx, ny = (ay - by) / length, (bx - ax) / length
    return (-nx, -ny) if nx * inward[0] + ny * inward[1] > 0.0 else (nx, ny)


@inner
def _add_end(
    pairs: Pairs, count: int, px: float, py: float, edge: Floats, before: Floats, owner: tuple[float, int, int],
    reach: float,
) -> int:  # fmt: skip
    """Append the pair of a robot point and an edge (or the edge's start corner); return the new number of pairs.

    `pairs`: array of records with the points, directions, gap and owners of a pair (`resgrid.control.plant.PAIR`);
    `count`: present number of pairs; `px, py`: point on the robot's core (its segment without the radius), in metres;
    `edge` (4,): start and end of the edge, ``ax, ay, bx, by``; `before` (4,): edge that ends at the start of `edge`;
    `owner`: radius of the segment in metres, index of its rigid body (the link of an arm), index of the obstacle;
    `reach`: largest gap of a pair, in metres.
    """
    ax, ay, bx, by = edge
    t = segment_parameter(px, py, ax, ay, bx, by)
    if 0.0 < t < 1.0:
        lx, ly = _left_of(edge)
        if lx * (px - ax) + ly * (py - ay) > TOUCH:
            return count
        ox, oy = ax + t * (bx - ax), ay + t * (by - ay)
        return _add(pairs, count, px, py, ox, oy, (lx, ly), (-lx, -ly), owner, reach)
    if t >= 1.0 or segment_parameter(px, py, before[0], before[1], before[2], before[3]) < 1.0:
        return count
    lx, ly = _inside_corner(edge, before)
    return _add(pairs, count, px, py, ax, ay, (lx, ly), (-lx, -ly), owner, reach)


@kernel
def near_points(pose: Pose, solid: ObstacleArrays, reach: float, pairs: Pairs) -> int:
    """Find pairs of near points of a robot (segments with a radius) and obstacles; return the number of pairs.

    Two segments that do not cross are nearest at an end of one of them, so that the ends of both are tested; two
    parallel segments give both ends of their overlap.  A disc or half-plane that is entered by at most `TOUCH` (1e-9 of
    1 m plus a radius) is touched, with a gap of 0.  Edges have the obstacle on their left, and ``solid.edge_before`` is
    the edge that ends at the start of an edge.  The end of a segment pairs with an edge only from the free side of the
    edge (or on it), and with a corner only where the corner is nearer than its edges; other pairs would lie through an
    obstacle or across a corner.

    `pose`: segments of the robot in the workspace; `solid`: obstacles; `reach`: largest gap of a pair, in metres;
    `pairs`: output array of records with the points, directions, gap and owners of a pair
    (`resgrid.control.plant.PAIR`), filled from its start.  A result equal to its length means that some pairs may be
    missing.
    """
    count, segments, radius, part = 0, pose.segments, pose.radius, pose.part
    edges, edge_before, discs, planes = solid.edges, solid.edge_before, solid.discs, solid.half_planes
    for s in range(len(segments)):
        ax, ay, bx, by = segments[s]
        r = radius[s]
        x0, x1 = min(ax, bx) - r - reach, max(ax, bx) + r + reach
        y0, y1 = min(ay, by) - r - reach, max(ay, by) + r + reach
        single = ax == bx and ay == by
        for e in range(len(edges)):
            edge, before = edges[e], edges[edge_before[e]]
            if misses(edge, x0, x1, y0, y1):
                continue
            owner = (r, part[s], solid.edge_owner[e])
            count = _add_end(pairs, count, ax, ay, edge, before, owner, reach)
            if single:
                continue
            count = _add_end(pairs, count, bx, by, edge, before, owner, reach)
            t = segment_parameter(edge[0], edge[1], ax, ay, bx, by)
            if 0.0 < t < 1.0:
                px, py = ax + t * (bx - ax), ay + t * (by - ay)
                inward = _inside_corner(edge, before)
                off = _off_side(ax, ay, bx, by, inward)
                count = _add(pairs, count, px, py, edge[0], edge[1], inward, off, owner, reach)
        for d in range(len(discs)):
            cx, cy, size = discs[d]
            t = segment_parameter(cx, cy, ax, ay, bx, by)
            px, py = ax + t * (bx - ax), ay + t * (by - ay)
            apart = math.hypot(px - cx, py - cy)
            if apart > max(size - TOUCH * (1.0 + size), 0.0):
                nx, ny = (px - cx) / apart, (py - cy) / apart
                ox, oy = cx + size * nx, cy + size * ny
                height = max(apart - size, 0.0)
                owner, off = (r, part[s], solid.disc_owner[d]), (nx, ny)
                count = _add(pairs, count, ox + height * nx, oy + height * ny, ox, oy, (-nx, -ny), off, owner, reach)
        for h in range(len(planes)):
            nx, ny, offset = planes[h]
            for end in range(1 if single else 2):
                px, py = (ax, ay) if end == 0 else (bx, by)
                height = nx * px + ny * py - offset
                if height > -TOUCH * (1.0 + r):
                    height = max(height, 0.0)
                    owner, off = (r, part[s], solid.half_plane_owner[h]), (nx, ny)
                    ox, oy = px - height * nx, py - height * ny
                    count = _add(pairs, count, px, py, ox, oy, (-nx, -ny), off, owner, reach)
    return count


@kernel
def contact_rows(pairs: Pairs, pose: Pose, normal: Floats, tangent: Floats) -> None:
    """Write the rows ``n . J`` and ``t . J`` of every pair to `normal` and `tangent`, both of shape (pairs, ndim).

    ``J`` is the Jacobian of the point on the robot's surface, in metres per axis unit; ``n`` is the unit normal out of
    the obstacle, and ``t`` is ``n`` turned left by a right angle.  `pairs`: array of records with the points, normal
    and rigid body (link) of each pair (`resgrid.control.plant.PAIR`); `pose`: pose of the robot.
    """
    shift, spin, pivot = pose.shift, pose.spin, pose.pivot
    for k in range(len(pairs)):
        (x, y), (nx, ny), part = pairs[k].on_robot, pairs[k].normal, pairs[k].part
        for axis in range(spin.shape[1]):
            vx = shift[part, axis, 0] - spin[part, axis] * (y - pivot[part, axis, 1])
            vy = shift[part, axis, 1] + spin[part, axis] * (x - pivot[part, axis, 0])
            normal[k, axis] = nx * vx + ny * vy
            tangent[k, axis] = -ny * vx + nx * vy


@inlined
def _time_to_zero(height: float, rate: float, bend: float) -> float:
    """Return the time ``u`` at which ``height + rate u - bend u^2 / 2`` becomes negative; 0 for a negative height.

    `height`: distance above a line, in metres; `rate`: first derivative of the height; `bend`: bound on the magnitude
    of its second derivative.  The unit of time is the duration of the whole motion.  Returns infinity if the parabola
    stays positive.
    """
    if height < 0.0:
        return 0.0
    root = math.sqrt(rate * rate + 2.0 * bend * height)
    if rate < 0.0:
        return 2.0 * height / (root - rate)
    return (rate + root) / bend if bend > 0.0 else np.inf


@inner
def _time_beyond(nx: float, ny: float, segment: Floats, moves: Floats, top: float) -> float:
    """Return a time up to which both ends ``x`` of a moving segment provably have ``n . x >= top``; infinite if always.

    The unit of time is the duration of the motion, so that a rate is the change over the whole motion.  `nx, ny`: unit
    normal ``n`` of the line; `segment` (4,): ends ``ax, ay, bx, by``, in metres; `moves` (7,): rates of these
    coordinates in metres (4), bounds on the accelerations of both ends (2), turning rate in radians; `top`: offset of
    the line, in metres.
    """
    first = _time_to_zero(nx * segment[0] + ny * segment[1] - top, nx * moves[0] + ny * moves[1], moves[4])
    return min(first, _time_to_zero(nx * segment[2] + ny * segment[3] - top, nx * moves[2] + ny * moves[3], moves[5]))


@inner
def _time_beside(px: float, py: float, qx: float, qy: float, segment: Floats, moves: Floats, keep: float) -> float:
    """Return a time up to which two fixed points provably stay on one side of the line of a moving segment.

    The points keep a distance of `keep` metres from the line.  The result is 0 for a segment of length 0.  The unit of
    time is the duration of the motion, so that a rate is the change over the whole motion.  `px, py, qx, qy`: the
    points, in metres; `segment` (4,): ends ``ax, ay, bx, by``, in metres; `moves` (7,): rates of these coordinates in
    metres (4), bounds on the accelerations of both ends (2), turning rate in radians.
    """
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
        free = min(free, _time_to_zero(height, rate, bends))
    return free


@inner
def _distance(segment: Floats, edge: Floats) -> tuple[float, float, float]:
    """Return the distance of two segments in metres, and the components of the unit vector from `edge` to `segment`.

    `segment`, `edge` (4,): ends ``ax, ay, bx, by``, in metres. The segments must not cross.  All three values are 0 for
    segments that touch.
    """
    best, vx, vy = np.inf, 0.0, 0.0
    for case in range(4):
        one, other = (segment, edge) if case < 2 else (edge, segment)
        px, py = one[2 * (case % 2)], one[2 * (case % 2) + 1]
        t = segment_parameter(px, py, other[0], other[1], other[2], other[3])
        dx, dy = px - other[0] - t * (other[2] - other[0]), py - other[1] - t * (other[3] - other[1])
        size = math.hypot(dx, dy)
        if size < best:
            best = size
            vx, vy = (dx, dy) if case < 2 else (-dx, -dy)
    return (best, vx / best, vy / best) if best > 0.0 else (0.0, 0.0, 0.0)


@inner
def _time_clear_of_edge(segment: Floats, moves: Floats, edge: Floats, keep: float) -> float:
    """Return a time up to which a line provably separates a moving segment from a fixed edge.

    The unit of time is the duration of the motion, so that a rate is the change over the whole motion, and a result of
    1 or more stands for the whole motion.  `segment` (4,): ends ``ax, ay, bx, by``, in metres; `moves` (7,): rates of
    these coordinates in metres (4), bounds on the accelerations of both ends (2), turning rate in radians; `edge` (4,):
    ends of the edge, equal for a point, in metres; `keep`: distance to keep, in metres.
    """
    ax, ay, bx, by = edge
    apart, nx, ny = _distance(segment, edge)
    free = 0.0
    if apart > 0.0:
        free = _time_beyond(nx, ny, segment, moves, max(nx * ax + ny * ay, nx * bx + ny * by) + keep)
    if free < 1.0:
        free = max(free, _time_beside(ax, ay, bx, by, segment, moves, keep))
    length = math.hypot(bx - ax, by - ay)
    if free < 1.0 and length > 0.0:
        nx, ny = (by - ay) / length, (ax - bx) / length
        if nx * (segment[0] + segment[2] - ax - bx) + ny * (segment[1] + segment[3] - ay - by) < 0.0:
            nx, ny = -nx, -ny
        free = max(free, _time_beyond(nx, ny, segment, moves, max(nx * ax + ny * ay, nx * bx + ny * by) + keep))
    return free


@inner
def _segment_motion(
    segment: Floats, part: int, shift: Floats, spin: Floats, pivot: Floats, lever: Floats, motion: Floats,
    turn: Floats, moves: Floats,
) -> None:  # fmt: skip
    """Write the motion of a segment for a motion of the axes to `moves` (7,).

    The unit of time is the duration of the motion.  `moves`: receives the rates of the ends' coordinates in metres (4),
    bounds on the accelerations of both ends (2), and the turning rate in radians (1).  `segment` (4,): ends, in metres;
    `part`: number of the rigid body that contains the segment; `shift, spin, pivot`: translation rate, turning rate and
    pivot of every body for each axis (fields of Pose); `lever` (2, bodies): bound on the acceleration of each end per
    squared turning rate of each body, in metres; `motion` (ndim,): motion of the axes, in axis units; `turn` (bodies,):
    turning rate of every body.
    """
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
def free_fraction(pose: Pose, solid: ObstacleArrays, motion: Floats, least: float) -> float:
    """Return a fraction (0 to 1) of a straight motion in configuration space on which every gap stays at least `least`.

    The result is a proven lower bound: the true fraction may be larger.  `pose`: pose of the robot at the start;
    `solid`: obstacles; `motion` (ndim,): offset of the configuration, in axis units; `least`: smallest gap, in metres.
    """
    segments, radius, part, lever = pose.segments, pose.radius, pose.part, pose.lever
    edges, discs, planes = solid.edges, solid.discs, solid.half_planes
    free, moves, turn, centre = 1.0, np.empty(7), pose.spin @ motion, np.empty(4)
    for s in range(len(segments)):
        segment = segments[s]
        _segment_motion(segment, part[s], pose.shift, pose.spin, pose.pivot, lever[s], motion, turn, moves)
        far = max(math.hypot(moves[0], moves[1]) + moves[4], math.hypot(moves[2], moves[3]) + moves[5])
        reach = radius[s] + least + far
        x0, x1 = min(segment[0], segment[2]) - reach, max(segment[0], segment[2]) + reach
        y0, y1 = min(segment[1], segment[3]) - reach, max(segment[1], segment[3]) + reach
        keep = radius[s] + least - _RIM * (1.0 + max(abs(x0), abs(x1), abs(y0), abs(y1)))
        for e in range(len(edges)):
            if not misses(edges[e], x0, x1, y0, y1):
                free = min(free, _time_clear_of_edge(segment, moves, edges[e], keep))
        for d in range(len(discs)):
            size = discs[d, 2]
            centre[:2], centre[2:] = discs[d, :2], discs[d, :2]
            if not misses(centre, x0 - size, x1 + size, y0 - size, y1 + size):
                free = min(free, _time_clear_of_edge(segment, moves, centre, keep + size))
        for h in range(len(planes)):
            nx, ny, offset = planes[h]
            free = min(free, _time_beyond(nx, ny, segment, moves, offset + keep))
    return free
