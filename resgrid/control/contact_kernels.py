"""Compiled loops of rigid contact: pairs of near points, how they move, and the forces between them.

The forces solve a complementarity problem, by pivoting.

Numba takes seconds to import: only functions that are about to run import this module.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inner
from resgrid.robots.geometry import TOUCH, ObstacleArrays, Pose
from resgrid.robots.kernels import share

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Pairs = Any
"""An array of `resgrid.control.plant.PAIR`."""

_LEAST_MOBILITY = 1e-12
_LEAST_PIVOT = 1e-13
_TIE = 1e-12
_GONE = 1e-9
_CLOSED = 1e-6
_REFINEMENTS = 3


@inner
def _leaving_row(table: Floats, entering: int, basis: Integers) -> int:
    """Row of the smallest ratio, ties decided by the ratios of the inverse basis (lexicographic); -1 if none bounds."""
    size = len(table)
    least = _LEAST_PIVOT * np.abs(table[:, :size]).max()
    best = -1
    for row in range(size):
        if table[row, entering] <= least:
            continue
        if best < 0:
            best = row
            continue
        for column in range(-1, size):
            own = table[row, column] / table[row, entering]
            other = table[best, column] / table[best, entering]
            if abs(own - other) > _TIE * (1.0 + abs(other)):
                if own < other:
                    best = row
                break
    if best >= 0:
        for row in range(size):
            if basis[row] == 2 * size and table[row, entering] > least:
                own, other = table[row, -1] / table[row, entering], table[best, -1] / table[best, entering]
                if own <= other + _TIE * (1.0 + abs(other)):
                    return row
    return best


@inner
def _pivot(table: Floats, row: int, column: int) -> None:
    table[row] /= table[row, column]
    for other in range(len(table)):
        if other != row and table[other, column] != 0.0:
            table[other] -= table[other, column] * table[row]


@njit(cache=True)
def complementary(matrix: Floats, offset: Floats, inverse: Floats, basis: Integers) -> bool:
    """Basis of ``z >= 0, w = M z + q >= 0, z . w = 0`` by Lemke's method, for small copositive M; False without one.

    Columns of the table: the slacks ``w``, the unknowns ``z``, Lemke's artificial one, and the right-hand side.
    ``basis`` ends as the columns that are not 0, whose values are ``inverse @ q``.
    """
    size = len(offset)
    inverse[:], basis[:] = np.eye(size), np.arange(size)
    if offset.min() >= 0.0:
        return True
    table = np.zeros((size, 2 * size + 2))
    for row in range(size):
        table[row, row] = 1.0
        table[row, size : 2 * size] = -matrix[row]
        table[row, 2 * size] = -1.0
        table[row, -1] = offset[row]
    row = int(np.argmin(offset))
    entering = 2 * size
    for _ in range(50 * size):
        leaving = basis[row]
        _pivot(table, row, entering)
        basis[row] = entering
        done = leaving == 2 * size
        for other in range(size):
            done |= basis[other] == 2 * size and table[other, -1] <= _GONE
        if done:
            inverse[:] = table[:, :size]
            return True
        entering = leaving + size if leaving < size else leaving - size
        row = _leaving_row(table, entering, basis)
        if row < 0:
            return False
    return False


@inner
def _slacks(
    rows: Floats, give: Floats, cone: Floats, offset: Floats, unknown: Floats, slack: Floats
) -> None:  # fmt: skip
    """``w = M z + q`` from the velocity that z gives, whose rounding is not squared."""
    change = np.zeros(rows.shape[1])
    for row in range(len(unknown)):
        change += unknown[row] * give[row]
    for row in range(len(unknown)):
        slack[row] = offset[row] + np.dot(rows[row], change) + np.dot(cone[row], unknown)


@inner
def _refined(
    rows: Floats, give: Floats, cone: Floats, offset: Floats, inverse: Floats, basis: Integers, unknown: Floats
) -> float:
    """Unknowns of a basis, made right by its residuals; returns by how much they miss the problem.

    Contacts that almost face each other are as badly conditioned in ``M = N A N^T`` as the square of ``N`` is.
    """
    used = len(unknown)
    slack = np.empty(used)
    for _ in range(_REFINEMENTS):
        _slacks(rows, give, cone, offset, unknown, slack)
        for column in basis:
            if column < used:
                slack[column] = 0.0
        for row in range(used):
            if used <= basis[row] < 2 * used:
                unknown[basis[row] - used] += np.dot(inverse[row], slack)
    _slacks(rows, give, cone, offset, unknown, slack)
    missed, largest = max(-slack.min(), -unknown.min()), unknown.max()
    for row in range(used):
        missed = max(missed, min(abs(slack[row]), abs(unknown[row])))
        if unknown[row] < _TIE * largest:
            unknown[row] = 0.0
    return float(missed)


@inner
def _unknowns(
    normal: Floats, tangent: Floats, target: Floats, admittance: Floats, friction: float, velocity: Floats,
    rows: Floats, offset: Floats, scale: Floats, owner: Integers, kind: Integers, cone: Floats,
) -> int:  # fmt: skip
    """What is looked for: of each contact ``f_n``, and with friction both sides of ``f_t`` and the slip; how many.

    Forces are in units in which each alone has an admittance of 1: rows of unit size, offsets without force, and a
    cone that ties the kinds together.
    """
    used, size = 0, max(np.abs(normal).max(), np.abs(tangent).max())
    for k in range(len(normal)):
        if np.abs(normal[k]).max() <= _LEAST_MOBILITY * size:
            continue
        first = used
        for part in range(4 if friction > 0.0 and np.abs(tangent[k]).max() > _LEAST_MOBILITY * size else 1):
            owner[used], kind[used], scale[used] = k, part, scale[used - 1]
            if part < 3:
                row = normal[k] if part == 0 else tangent[k]
                scale[used] = 1.0 / np.sqrt(np.dot(row @ admittance, row))
                rows[used] = row * (-scale[used] if part == 2 else scale[used])
                offset[used] = np.dot(rows[used], velocity) - (target[k] * scale[used] if part == 0 else 0.0)
            used += 1
        if used > first + 1:
            slip = first + 3
            cone[first + 1, slip] = cone[first + 2, slip] = 1.0
            cone[slip, first + 1] = cone[slip, first + 2] = -1.0
            cone[slip, first] = friction * scale[first] / scale[slip]
    return used


@njit(cache=True)
def resolve_contacts(
    normal: Floats, tangent: Floats, target: Floats, admittance: Floats, friction: float, velocity: Floats,
    force: Floats,
) -> bool:  # fmt: skip
    """Contact forces that keep ``n . J qdot >= target``, with Coulomb friction; ``velocity`` is changed in place.

    The complementarity problem ``0 <= f_n, n . J qdot - target >= 0``, one of them 0, and ``|f_t| <= mu f_n``, opposing
    ``t . J qdot``; in the plane the cone of friction is a wedge, so this is linear.  ``force[k]`` ends as normal and
    tangential force.  A contact whose force could not move the robot is left out.  Returns whether a solution was found
    to 1e-6 of the velocity; with targets that are not positive there is one.
    """
    most, ndim = 4 * len(normal), normal.shape[1]
    rows, offset, scale, cone = np.zeros((most, ndim)), np.zeros(most), np.empty(most), np.zeros((most, most))
    owner, kind = np.empty(most, np.int64), np.empty(most, np.int64)
    force[:] = 0.0
    used = _unknowns(
        normal, tangent, target, admittance, friction, velocity, rows, offset, scale, owner, kind, cone
    )  # fmt: skip
    rows, offset, cone = rows[:used], offset[:used], np.ascontiguousarray(cone[:used, :used])
    largest = np.abs(offset).max() if used else 0.0
    if largest == 0.0:
        return True
    give, unknown = rows @ admittance, np.zeros(used)
    inverse, basis = np.empty((used, used)), np.empty(used, np.int64)
    if not complementary(give @ rows.T + cone, offset / largest, inverse, basis):
        return False
    missed = _refined(rows, give, cone, offset, inverse, basis, unknown)
    for row in range(used):
        if kind[row] < 3:
            velocity += unknown[row] * give[row]
            force[owner[row], min(kind[row], 1)] += (-unknown[row] if kind[row] == 2 else unknown[row]) * scale[row]
    return missed <= _CLOSED * largest


@inner
def _add(
    pairs: Pairs, count: int, px: float, py: float, ox: float, oy: float, inward: tuple[float, float],
    outward: tuple[float, float], owner: tuple[float, int, int], reach: float,
) -> int:  # fmt: skip
    """Keep a pair of near points: the robot's core at p, the obstacle's surface at o; where they touch, its normal."""
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


@njit(cache=True, inline="always")
def misses(edge: Floats, x0: float, x1: float, y0: float, y1: float) -> bool:
    """Whether an edge lies beside a box."""
    ax, ay, bx, by = edge
    return bool(max(ax, bx) < x0 or min(ax, bx) > x1 or max(ay, by) < y0 or min(ay, by) > y1)


@njit(cache=True, inline="always")
def _left_of(edge: Floats) -> tuple[float, float]:
    """Unit normal of an edge into the solid, which lies on its left."""
    dx, dy = edge[2] - edge[0], edge[3] - edge[1]
    length = math.hypot(dx, dy)
    return -dy / length, dx / length


@inner
def _inside_corner(edge: Floats, before: Floats) -> tuple[float, float]:
    """Direction into the solid from the corner where an edge starts: between its edges' normals, or along a spike."""
    (ax, ay), (bx, by) = _left_of(edge), _left_of(before)
    length = math.hypot(ax + bx, ay + by)
    if length < 1e-9:
        return ay, -ax
    return (ax + bx) / length, (ay + by) / length


@inner
def _off_side(ax: float, ay: float, bx: float, by: float, inward: tuple[float, float]) -> tuple[float, float]:
    """Unit normal of a segment that points away from a solid."""
    length = math.hypot(bx - ax, by - ay)
    nx, ny = (ay - by) / length, (bx - ax) / length
    return (-nx, -ny) if nx * inward[0] + ny * inward[1] > 0.0 else (nx, ny)


@inner
def _add_end(
    pairs: Pairs, count: int, px: float, py: float, edge: Floats, before: Floats, owner: tuple[float, int, int],
    reach: float,
) -> int:  # fmt: skip
    """A point of the robot before an edge, or before the corner where the edge starts."""
    ax, ay, bx, by = edge
    t = share(px, py, ax, ay, bx, by)
    if 0.0 < t < 1.0:
        lx, ly = _left_of(edge)
        if lx * (px - ax) + ly * (py - ay) > TOUCH:
            return count
        ox, oy = ax + t * (bx - ax), ay + t * (by - ay)
        return _add(pairs, count, px, py, ox, oy, (lx, ly), (-lx, -ly), owner, reach)
    if t >= 1.0 or share(px, py, before[0], before[1], before[2], before[3]) < 1.0:
        return count
    lx, ly = _inside_corner(edge, before)
    return _add(pairs, count, px, py, ax, ay, (lx, ly), (-lx, -ly), owner, reach)


@njit(cache=True)
def near_points(pose: Pose, solid: ObstacleArrays, reach: float, pairs: Pairs) -> int:
    """Pairs of near points of a robot (segments with a radius) and obstacles, within a reach.

    Two segments that do not cross are nearest where one of them ends, so the ends of both are looked at: two parallel
    ones give both ends of their overlap.  A disc or half-plane entered by no more than `TOUCH` is touched: no gap.
    Edges have the solid on their left, and `edge_before` is the edge that ends where one starts.  Ends of the robot
    count before the side of an edge that is free (or on it), and before a corner only where it is nearer than its
    edges: others have no part in a contact, being through a solid, or across a corner from an edge's end.  `pairs` are
    of the type `PAIR`.  Returns how many there are.
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
            t = share(edge[0], edge[1], ax, ay, bx, by)
            if 0.0 < t < 1.0:
                px, py = ax + t * (bx - ax), ay + t * (by - ay)
                inward = _inside_corner(edge, before)
                off = _off_side(ax, ay, bx, by, inward)
                count = _add(pairs, count, px, py, edge[0], edge[1], inward, off, owner, reach)
        for d in range(len(discs)):
            cx, cy, size = discs[d]
            t = share(cx, cy, ax, ay, bx, by)
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


@njit(cache=True)
def contact_rows(pairs: Pairs, pose: Pose, normal: Floats, tangent: Floats) -> None:
    """Rows ``n . J`` and ``t . J`` of every pair, J the Jacobian of the robot's surface point; t is n turned left."""
    shift, spin, pivot = pose.shift, pose.spin, pose.pivot
    for k in range(len(pairs)):
        (x, y), (nx, ny), part = pairs[k].on_robot, pairs[k].normal, pairs[k].part
        for axis in range(spin.shape[1]):
            vx = shift[part, axis, 0] - spin[part, axis] * (y - pivot[part, axis, 1])
            vy = shift[part, axis, 1] + spin[part, axis] * (x - pivot[part, axis, 0])
            normal[k, axis] = nx * vx + ny * vy
            tangent[k, axis] = -ny * vx + nx * vy
