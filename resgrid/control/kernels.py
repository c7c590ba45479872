"""Compiled loops of control: the nominal direction at a configuration, gaps to obstacles, and rigid contact.

Numba takes seconds to import: only functions that are about to run import this module.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

MOVES, GOAL, OFF, OUTSIDE, NOT_FINITE = 0, 1, 2, 3, 4
_GOAL = 2
_EDGE = 1e-9
_SWEEPS = 300


@njit(cache=True)
def nominal(
    code: NDArray[np.uint8],
    served: NDArray[np.bool_],
    shape: Integers,
    lower_corner: Floats,
    spacing: Floats,
    periodic: NDArray[np.bool_],
    first_face: Integers,
    face_stride: Integers,
    direction: NDArray[np.int8],
    log_current: Floats,
    point: Floats,
    velocity: Floats,
) -> tuple[int, float]:
    """Unit velocity along the current at a point, as Pollock interpolates it within the point's cell.

    Where no axis leads out in finite time it points to the face with the largest outward current.  Returns a status
    and the fastest rate at which a component decays, per unit of length travelled: an explicit step longer than its
    inverse would overshoot a line that the velocity only tends to.
    """
    ndim = len(shape)
    cell, local = np.empty(ndim, np.int64), np.empty(ndim)
    flat = 0
    for axis in range(ndim):
        velocity[axis] = 0.0
        x = (point[axis] - lower_corner[axis]) / spacing[axis]
        if not math.isfinite(x):
            return NOT_FINITE, 0.0
        if periodic[axis]:
            x -= shape[axis] * math.floor(x / shape[axis])
        elif x < -_EDGE or x > shape[axis] + _EDGE:
            return OUTSIDE, 0.0
        cell[axis] = min(max(int(math.floor(x)), 0), shape[axis] - 1)
        local[axis] = min(max(x - cell[axis], 0.0), 1.0)
        flat = flat * shape[axis] + cell[axis]
    if code[flat] == _GOAL:
        return GOAL, 0.0
    if not served[flat]:
        return OFF, 0.0
    low, high, scale = np.empty(ndim), np.empty(ndim), -np.inf
    for axis in range(ndim):
        face = first_face[axis]
        for other in range(ndim):
            face += cell[other] * face_stride[axis, other]
        above = face + face_stride[axis, axis]
        low[axis], high[axis] = log_current[face], log_current[above]
        scale = max(scale, low[axis], high[axis])
    if scale == -np.inf:
        return OFF, 0.0
    drifts, best, way = False, 0.0, 0
    for axis in range(ndim):
        face = first_face[axis]
        for other in range(ndim):
            face += cell[other] * face_stride[axis, other]
        above = face + face_stride[axis, axis]
        low[axis] = direction[face] * math.exp(low[axis] - scale)
        high[axis] = direction[above] * math.exp(high[axis] - scale)
        speed = low[axis] * (1.0 - local[axis]) + high[axis] * local[axis]
        drifts |= (speed > 0.0 and high[axis] > 0.0) or (speed < 0.0 and low[axis] < 0.0)
        velocity[axis] = speed * spacing[axis]
        if max(high[axis], -low[axis]) > best:
            best, way = max(high[axis], -low[axis]), axis
    if best <= 0.0:
        velocity[:] = 0.0
        return OFF, 0.0
    if not drifts:
        velocity[:] = 0.0
        velocity[way] = 1.0 if high[way] >= -low[way] else -1.0
        return MOVES, 0.0
    squares, decay = 0.0, 0.0
    for axis in range(ndim):
        squares += velocity[axis] ** 2
        decay = max(decay, low[axis] - high[axis])
    length = math.sqrt(squares)
    for axis in range(ndim):
        velocity[axis] /= length
    return MOVES, decay / length


@njit(cache=True, inline="always")
def _share(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Where on the segment from a to b the point nearest to p lies, in [0, 1]."""
    dx, dy = bx - ax, by - ay
    squared = dx * dx + dy * dy
    if squared <= 0.0:
        return 0.0
    return min(max(((px - ax) * dx + (py - ay) * dy) / squared, 0.0), 1.0)


@njit(cache=True)
def _add(
    found: Floats, count: int, px: float, py: float, ox: float, oy: float, radius: float, part: int, body: int,
    reach: float,
) -> int:  # fmt: skip
    """Keep a pair of near points: the robot's core at p, the obstacle's surface at o."""
    dx, dy = px - ox, py - oy
    apart = math.hypot(dx, dy)
    gap = apart - radius
    if gap > reach or apart <= 0.0 or count >= len(found):
        return count
    nx, ny = dx / apart, dy / apart
    rx, ry = px - radius * nx, py - radius * ny
    for k in range(count):
        same = abs(found[k, 0] - rx) + abs(found[k, 1] - ry) + abs(found[k, 2] - ox) + abs(found[k, 3] - oy)
        if same <= 1e-12 * (1.0 + abs(ox) + abs(oy)):
            return count
    row = found[count]
    row[0], row[1], row[2], row[3], row[4], row[5] = rx, ry, ox, oy, nx, ny
    row[6], row[7], row[8] = gap, part, body
    return count + 1


@njit(cache=True)
def near_points(
    segments: Floats,
    radius: Floats,
    part: Integers,
    edges: Floats,
    edge_body: Integers,
    discs: Floats,
    disc_body: Integers,
    planes: Floats,
    plane_body: Integers,
    reach: float,
    found: Floats,
) -> int:
    """Pairs of near points of a robot (segments with a radius) and obstacles, within a reach.

    Two segments that do not cross are nearest where one of them ends, so the ends of both are looked at: two parallel
    ones give both ends of their overlap.  Rows of `found`: the robot's surface point, the obstacle's, the unit normal
    out of the obstacle, the gap, the part, the obstacle.  Returns how many there are.
    """
    count = 0
    for s in range(len(segments)):
        ax, ay, bx, by = segments[s]
        r = radius[s]
        x0, x1 = min(ax, bx) - r - reach, max(ax, bx) + r + reach
        y0, y1 = min(ay, by) - r - reach, max(ay, by) + r + reach
        single = ax == bx and ay == by
        for e in range(len(edges)):
            cx, cy, dx, dy = edges[e]
            if max(cx, dx) < x0 or min(cx, dx) > x1 or max(cy, dy) < y0 or min(cy, dy) > y1:
                continue
            t = _share(ax, ay, cx, cy, dx, dy)
            count = _add(
                found, count, ax, ay, cx + t * (dx - cx), cy + t * (dy - cy), r, part[s], edge_body[e], reach
            )
            if single:
                continue
            t = _share(bx, by, cx, cy, dx, dy)
            count = _add(
                found, count, bx, by, cx + t * (dx - cx), cy + t * (dy - cy), r, part[s], edge_body[e], reach
            )
            t = _share(cx, cy, ax, ay, bx, by)
            if 0.0 < t < 1.0:
                count = _add(found, count, ax + t * (bx - ax), ay + t * (by - ay), cx, cy, r, part[s], edge_body[e], reach)
        for d in range(len(discs)):
            cx, cy, size = discs[d]
            t = _share(cx, cy, ax, ay, bx, by)
            px, py = ax + t * (bx - ax), ay + t * (by - ay)
            apart = math.hypot(px - cx, py - cy)
            if apart > 0.0:
                ox, oy = cx + size * (px - cx) / apart, cy + size * (py - cy) / apart
                if apart > size:
                    count = _add(found, count, px, py, ox, oy, r, part[s], disc_body[d], reach)
        for h in range(len(planes)):
            nx, ny, offset = planes[h]
            for end in range(1 if single else 2):
                px, py = (ax, ay) if end == 0 else (bx, by)
                height = nx * px + ny * py - offset
                if height > 0.0:
                    count = _add(
                        found, count, px, py, px - height * nx, py - height * ny, r, part[s], plane_body[h], reach
                    )
    return count


@njit(cache=True)
def contact_rows(
    found: Floats, count: int, shift: Floats, spin: Floats, pivot: Floats, normal: Floats, tangent: Floats
) -> None:
    """Rows ``n . J`` and ``t . J`` of every pair, J the Jacobian of the robot's surface point; t is n turned left."""
    for k in range(count):
        x, y, nx, ny, part = found[k, 0], found[k, 1], found[k, 4], found[k, 5], int(found[k, 7])
        for axis in range(spin.shape[1]):
            vx = shift[part, axis, 0] - spin[part, axis] * (y - pivot[part, axis, 1])
            vy = shift[part, axis, 1] + spin[part, axis] * (x - pivot[part, axis, 0])
            normal[k, axis] = nx * vx + ny * vy
            tangent[k, axis] = -ny * vx + nx * vy


@njit(cache=True)
def resolve_contacts(
    normal: Floats, tangent: Floats, target: Floats, admittance: Floats, friction: float, velocity: Floats, force: Floats
) -> None:
    """Contact forces that keep ``n . J qdot >= target``, with Coulomb friction; ``velocity`` is changed in place.

    Projected Gauss-Seidel on the complementarity problem ``0 <= f_n, n . J qdot - target >= 0``, one of them 0, and
    ``|f_t| <= mu f_n``, opposing ``t . J qdot``.  ``force[k]`` ends as normal and tangential force.
    """
    count, ndim = normal.shape
    push_n, push_t = np.zeros((count, ndim)), np.zeros((count, ndim))
    give_n, give_t = np.zeros(count), np.zeros(count)
    for k in range(count):
        for i in range(ndim):
            for j in range(ndim):
                push_n[k, i] += admittance[i, j] * normal[k, j]
                push_t[k, i] += admittance[i, j] * tangent[k, j]
            give_n[k] += normal[k, i] * push_n[k, i]
            give_t[k] += tangent[k, i] * push_t[k, i]
    largest = 0.0
    for k in range(count):
        largest = max(largest, give_n[k], give_t[k])
    for _ in range(_SWEEPS):
        moved, size = 0.0, 0.0
        for k in range(count):
            if give_n[k] <= 1e-12 * largest:
                continue
            speed = 0.0
            for i in range(ndim):
                speed += normal[k, i] * velocity[i]
            new = max(0.0, force[k, 0] + (target[k] - speed) / give_n[k])
            step = new - force[k, 0]
            force[k, 0] = new
            for i in range(ndim):
                velocity[i] += step * push_n[k, i]
            moved, size = max(moved, abs(step)), max(size, new)
            if friction <= 0.0 or give_t[k] <= 1e-12 * largest:
                continue
            speed = 0.0
            for i in range(ndim):
                speed += tangent[k, i] * velocity[i]
            limit = friction * force[k, 0]
            new = min(max(force[k, 1] - speed / give_t[k], -limit), limit)
            step = new - force[k, 1]
            force[k, 1] = new
            for i in range(ndim):
                velocity[i] += step * push_t[k, i]
            moved = max(moved, abs(step))
        if moved <= 1e-12 * size:
            return
