"""Compiled loops about a robot among obstacles: pairs of near points, and how they move.

Numba takes seconds to import: only functions that are about to run import this module.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inner
from resgrid.planning.bodies import TOUCH

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@njit(cache=True, inline="always")
def share(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Where on the segment from a to b the point nearest to p lies, in [0, 1]."""
    dx, dy = bx - ax, by - ay
    squared = dx * dx + dy * dy
    if squared <= 0.0:
        return 0.0
    return min(max(((px - ax) * dx + (py - ay) * dy) / squared, 0.0), 1.0)


@inner
def _add(
    found: Floats, count: int, px: float, py: float, ox: float, oy: float, inward: tuple[float, float],
    outward: tuple[float, float], owner: tuple[float, int, int], reach: float,
) -> int:  # fmt: skip
    """Keep a pair of near points: the robot's core at p, the obstacle's surface at o; where they touch, its normal."""
    dx, dy = px - ox, py - oy
    apart = math.hypot(dx, dy)
    radius, part, body = owner
    gap = apart - radius
    if gap > reach or count >= len(found):
        return count
    nx, ny = (dx / apart, dy / apart) if apart > TOUCH else outward
    rx, ry = px - radius * nx, py - radius * ny
    for k in range(count):
        same = abs(found[k, 0] - rx) + abs(found[k, 1] - ry) + abs(found[k, 2] - ox) + abs(found[k, 3] - oy)
        if same <= 1e-12 * (1.0 + abs(ox) + abs(oy)):
            return count
    row = found[count]
    row[0], row[1], row[2], row[3], row[4], row[5] = rx, ry, ox, oy, nx, ny
    row[6], row[7], row[8], row[9], row[10] = gap, part, body, inward[0], inward[1]
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
    found: Floats, count: int, px: float, py: float, edge: Floats, before: Floats, owner: tuple[float, int, int],
    reach: float, facing: bool,
) -> int:  # fmt: skip
    """A point of the robot before an edge, or before the corner where the edge starts."""
    ax, ay, bx, by = edge
    t = share(px, py, ax, ay, bx, by)
    if 0.0 < t < 1.0:
        lx, ly = _left_of(edge)
        if facing and lx * (px - ax) + ly * (py - ay) > TOUCH:
            return count
        ox, oy = ax + t * (bx - ax), ay + t * (by - ay)
        return _add(found, count, px, py, ox, oy, (lx, ly), (-lx, -ly), owner, reach)
    if t >= 1.0 or (facing and share(px, py, before[0], before[1], before[2], before[3]) < 1.0):
        return count
    lx, ly = _inside_corner(edge, before)
    return _add(found, count, px, py, ax, ay, (lx, ly), (-lx, -ly), owner, reach)


@njit(cache=True)
def near_points(
    segments: Floats,
    radius: Floats,
    part: Integers,
    edges: Floats,
    edge_before: Integers,
    edge_body: Integers,
    discs: Floats,
    disc_body: Integers,
    planes: Floats,
    plane_body: Integers,
    reach: float,
    facing: bool,
    found: Floats,
) -> int:
    """Pairs of near points of a robot (segments with a radius) and obstacles, within a reach.

    Two segments that do not cross are nearest where one of them ends, so the ends of both are looked at: two parallel
    ones give both ends of their overlap.  A disc or half-plane entered by no more than `TOUCH` is touched: no gap.
    Edges have the solid on their left, and `edge_before` is the edge that ends where one starts.  With `facing`, ends
    of the robot count before the side of an edge that is free (or on it), and before a corner only where it is nearer
    than its edges.  Rows of `found`: the robot's surface point, the obstacle's, the unit normal between them, the gap,
    the part, the obstacle, and the direction into it.  Returns how many there are.
    """
    count = 0
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
            owner = (r, part[s], edge_body[e])
            count = _add_end(found, count, ax, ay, edge, before, owner, reach, facing)
            if single:
                continue
            count = _add_end(found, count, bx, by, edge, before, owner, reach, facing)
            t = share(edge[0], edge[1], ax, ay, bx, by)
            if 0.0 < t < 1.0:
                px, py = ax + t * (bx - ax), ay + t * (by - ay)
                inward = _inside_corner(edge, before)
                off = _off_side(ax, ay, bx, by, inward)
                count = _add(found, count, px, py, edge[0], edge[1], inward, off, owner, reach)
        for d in range(len(discs)):
            cx, cy, size = discs[d]
            t = share(cx, cy, ax, ay, bx, by)
            px, py = ax + t * (bx - ax), ay + t * (by - ay)
            apart = math.hypot(px - cx, py - cy)
            if apart > max(size - TOUCH * (1.0 + size), 0.0):
                nx, ny = (px - cx) / apart, (py - cy) / apart
                ox, oy = cx + size * nx, cy + size * ny
                height = max(apart - size, 0.0)
                owner, off = (r, part[s], disc_body[d]), (nx, ny)
                count = _add(found, count, ox + height * nx, oy + height * ny, ox, oy, (-nx, -ny), off, owner, reach)
        for h in range(len(planes)):
            nx, ny, offset = planes[h]
            for end in range(1 if single else 2):
                px, py = (ax, ay) if end == 0 else (bx, by)
                height = nx * px + ny * py - offset
                if height > -TOUCH * (1.0 + r):
                    height = max(height, 0.0)
                    owner, off = (r, part[s], plane_body[h]), (nx, ny)
                    ox, oy = px - height * nx, py - height * ny
                    count = _add(found, count, px, py, ox, oy, (-nx, -ny), off, owner, reach)
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
