"""Compiled loops of control: the nominal direction at a configuration, gaps to obstacles, and rigid contact.

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

MOVES, GOAL, OFF, OUTSIDE, NOT_FINITE = 0, 1, 2, 3, 4
_GOAL = 2
_EDGE = 1e-9
_SWEEPS = 300
_SETTLED = 1e-12
_LEAST_MOBILITY = 1e-12


@inner
def _cell_at(
    shape: Integers, corner: Floats, spacing: Floats, periodic: NDArray[np.bool_], point: Floats, cell: Integers,
    local: Floats,
) -> int:  # fmt: skip
    """Cell of a point, and where in it the point is, each coordinate in [0, 1]; returns a status."""
    for axis in range(len(shape)):
        x = (point[axis] - corner[axis]) / spacing[axis]
        if not math.isfinite(x):
            return NOT_FINITE
        if periodic[axis]:
            x -= shape[axis] * math.floor(x / shape[axis])
        elif x < -_EDGE or x > shape[axis] + _EDGE:
            return OUTSIDE
        cell[axis] = min(max(math.floor(x), 0), shape[axis] - 1)
        local[axis] = min(max(x - cell[axis], 0.0), 1.0)
    return MOVES


@inner
def _face_velocities(
    first_face: Integers, face_stride: Integers, direction: NDArray[np.int8], log_current: Floats, cell: Integers,
    lower: Floats, upper: Floats,
) -> bool:  # fmt: skip
    """Velocities on the lower and upper faces of a cell, scaled to a maximum of 1; False where none flows."""
    ndim = len(cell)
    face, scale = np.empty(ndim, np.int64), -np.inf
    for axis in range(ndim):
        face[axis] = first_face[axis]
        for other in range(ndim):
            face[axis] += cell[other] * face_stride[axis, other]
        scale = max(scale, log_current[face[axis]], log_current[face[axis] + face_stride[axis, axis]])
    if scale == -np.inf:
        return False
    for axis in range(ndim):
        above = face[axis] + face_stride[axis, axis]
        lower[axis] = direction[face[axis]] * math.exp(log_current[face[axis]] - scale)
        upper[axis] = direction[above] * math.exp(log_current[above] - scale)
    return True


@njit(cache=True, inline="always")
def _to_face(x: float, velocity: float, spacing: float) -> float:
    """Time until a point is just beyond the face ahead of it."""
    return ((1.0 - x if velocity > 0.0 else x) + _EDGE) * spacing / abs(velocity)


@inner
def _along_current(local: Floats, lower: Floats, upper: Floats, spacing: Floats, velocity: Floats) -> float:
    """Unit velocity within a cell, and how far a straight step may go; -1 where no current leaves.

    Each component is linear between its two faces (Pollock 1988).
    """
    drifts, outward, way = False, 0.0, 0
    squares, decay = 0.0, 0.0
    for axis in range(len(local)):
        speed = lower[axis] * (1.0 - local[axis]) + upper[axis] * local[axis]
        drifts |= (speed > 0.0 and upper[axis] > 0.0) or (speed < 0.0 and lower[axis] < 0.0)
        velocity[axis] = speed * spacing[axis]
        squares += velocity[axis] ** 2
        decay = max(decay, lower[axis] - upper[axis])
        if max(upper[axis], -lower[axis]) > outward:
            outward, way = max(upper[axis], -lower[axis]), axis
    if outward <= 0.0:
        return -1.0
    if not drifts:
        velocity[:] = 0.0
        velocity[way] = 1.0 if upper[way] >= -lower[way] else -1.0
        return _to_face(local[way], velocity[way], spacing[way])
    length = math.sqrt(squares)
    farthest = 0.5 * length / decay if decay > 0.0 else np.inf
    for axis in range(len(local)):
        velocity[axis] /= length
        if (velocity[axis] > 0.0 and upper[axis] > 0.0) or (velocity[axis] < 0.0 and lower[axis] < 0.0):
            farthest = min(farthest, _to_face(local[axis], velocity[axis], spacing[axis]))
    return farthest


@njit(cache=True)
def nominal(
    code: NDArray[np.uint8],
    served: NDArray[np.bool_],
    shape: Integers,
    corner: Floats,
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

    Where no axis leads out in finite time it points to the face with the largest outward current.  Returns a status,
    and how far a straight step may go: just across the next face that current leaves by, and no more than half way to
    where a component vanishes, so that no step ends beyond a face without outward current.
    """
    ndim = len(shape)
    cell, local, lower, upper = np.empty(ndim, np.int64), np.empty(ndim), np.empty(ndim), np.empty(ndim)
    velocity[:] = 0.0
    status = _cell_at(shape, corner, spacing, periodic, point, cell, local)
    if status != MOVES:
        return status, 0.0
    flat = 0
    for axis in range(ndim):
        flat = flat * shape[axis] + cell[axis]
    if code[flat] == _GOAL:
        return GOAL, 0.0
    if served[flat] and _face_velocities(first_face, face_stride, direction, log_current, cell, lower, upper):
        farthest = _along_current(local, lower, upper, spacing, velocity)
        if farthest >= 0.0:
            return MOVES, farthest
        velocity[:] = 0.0
    return OFF, 0.0


@njit(cache=True, inline="always")
def _share(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Where on the segment from a to b the point nearest to p lies, in [0, 1]."""
    dx, dy = bx - ax, by - ay
    squared = dx * dx + dy * dy
    if squared <= 0.0:
        return 0.0
    return min(max(((px - ax) * dx + (py - ay) * dy) / squared, 0.0), 1.0)


@inner
def _add(
    found: Floats, count: int, px: float, py: float, ox: float, oy: float, inward: tuple[float, float],
    owner: tuple[float, int, int], reach: float,
) -> int:  # fmt: skip
    """Keep a pair of near points: the robot's core at p, the obstacle's surface at o; the normal of a touch is its."""
    dx, dy = px - ox, py - oy
    apart = math.hypot(dx, dy)
    radius, part, body = owner
    gap = apart - radius
    if gap > reach or count >= len(found):
        return count
    nx, ny = (dx / apart, dy / apart) if apart > TOUCH else (-inward[0], -inward[1])
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
def _misses(edge: Floats, x0: float, x1: float, y0: float, y1: float) -> bool:
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
def _add_end(
    found: Floats, count: int, px: float, py: float, edge: Floats, before: Floats, owner: tuple[float, int, int],
    reach: float, facing: bool,
) -> int:  # fmt: skip
    """A point of the robot before an edge, or before the corner where the edge starts."""
    ax, ay, bx, by = edge
    t = _share(px, py, ax, ay, bx, by)
    if 0.0 < t < 1.0:
        if facing and (px - ax) * (by - ay) - (py - ay) * (bx - ax) <= 0.0:
            return count
        return _add(found, count, px, py, ax + t * (bx - ax), ay + t * (by - ay), _left_of(edge), owner, reach)
    if t >= 1.0 or (facing and _share(px, py, before[0], before[1], before[2], before[3]) < 1.0):
        return count
    return _add(found, count, px, py, ax, ay, _inside_corner(edge, before), owner, reach)


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
    of the robot count before the side of an edge that is free, and before a corner only where it is nearer than its
    edges.  Rows of `found`: the robot's surface point, the obstacle's, the unit normal between them, the gap, the part,
    the obstacle, and the direction into it.  Returns how many there are.
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
            if _misses(edge, x0, x1, y0, y1):
                continue
            owner = (r, part[s], edge_body[e])
            count = _add_end(found, count, ax, ay, edge, before, owner, reach, facing)
            if single:
                continue
            count = _add_end(found, count, bx, by, edge, before, owner, reach, facing)
            t = _share(edge[0], edge[1], ax, ay, bx, by)
            if 0.0 < t < 1.0:
                px, py = ax + t * (bx - ax), ay + t * (by - ay)
                count = _add(found, count, px, py, edge[0], edge[1], _inside_corner(edge, before), owner, reach)
        for d in range(len(discs)):
            cx, cy, size = discs[d]
            t = _share(cx, cy, ax, ay, bx, by)
            px, py = ax + t * (bx - ax), ay + t * (by - ay)
            apart = math.hypot(px - cx, py - cy)
            if apart > max(size - TOUCH * (1.0 + size), 0.0):
                nx, ny = (px - cx) / apart, (py - cy) / apart
                ox, oy = cx + size * nx, cy + size * ny
                height = max(apart - size, 0.0)
                owner = (r, part[s], disc_body[d])
                count = _add(found, count, ox + height * nx, oy + height * ny, ox, oy, (-nx, -ny), owner, reach)
        for h in range(len(planes)):
            nx, ny, offset = planes[h]
            for end in range(1 if single else 2):
                px, py = (ax, ay) if end == 0 else (bx, by)
                height = nx * px + ny * py - offset
                if height > -TOUCH * (1.0 + r):
                    height = max(height, 0.0)
                    owner = (r, part[s], plane_body[h])
                    count = _add(found, count, px, py, px - height * nx, py - height * ny, (-nx, -ny), owner, reach)
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


@inner
def _coulomb(
    normal: float, cross: float, tangent: float, approach: float, slip: float, friction: float
) -> tuple[float, float]:
    """Normal and tangential force of one contact that moves at ``(approach, slip)`` without them.

    A unit normal force changes these speeds by ``normal`` and ``cross``, a unit tangential one by ``cross`` and
    ``tangent``.  The law may be met apart, sticking, or slipping to either side: the first that meets it is taken.
    """
    if approach >= 0.0:
        return 0.0, 0.0
    alone = -approach / normal
    if friction <= 0.0 or tangent <= _LEAST_MOBILITY * normal:
        return alone, 0.0
    determinant = normal * tangent - cross * cross
    if determinant > _LEAST_MOBILITY * normal * tangent:
        press = (cross * slip - tangent * approach) / determinant
        rub = (cross * approach - normal * slip) / determinant
        if press >= 0.0 and abs(rub) <= friction * press:
            return press, rub
    for side in (1.0, -1.0):
        moves = normal - side * friction * cross
        if moves <= 0.0:
            continue
        press = -approach / moves
        if side * (slip + (cross - side * friction * tangent) * press) >= 0.0:
            return press, -side * friction * press
    rub = -(slip + cross * alone) / tangent
    return alone, min(max(rub, -friction * alone), friction * alone)


@njit(cache=True)
def resolve_contacts(
    normal: Floats, tangent: Floats, target: Floats, admittance: Floats, friction: float, velocity: Floats,
    force: Floats,
) -> None:  # fmt: skip
    """Contact forces that keep ``n . J qdot >= target``, with Coulomb friction; ``velocity`` is changed in place.

    Gauss-Seidel over the contacts on the complementarity problem ``0 <= f_n, n . J qdot - target >= 0``, one of them 0,
    and ``|f_t| <= mu f_n``, opposing ``t . J qdot``; each contact is solved exactly while the others keep their forces.
    ``force[k]`` ends as normal and tangential force.  A contact whose force could not move the robot is left out.
    """
    count = len(normal)
    give_n, give_t = normal @ admittance, tangent @ admittance
    can_n, can_t = np.sum(give_n * normal, axis=1), np.sum(give_t * tangent, axis=1)
    cross = np.sum(give_n * tangent, axis=1)
    least = _LEAST_MOBILITY * max(can_n.max(), can_t.max())
    for _ in range(_SWEEPS):
        moved, size = 0.0, 0.0
        for k in range(count):
            if can_n[k] <= least:
                continue
            press, rub = force[k, 0], force[k, 1]
            approach = np.dot(normal[k], velocity) - target[k] - can_n[k] * press - cross[k] * rub
            slip = np.dot(tangent[k], velocity) - cross[k] * press - can_t[k] * rub
            force[k, 0], force[k, 1] = _coulomb(can_n[k], cross[k], can_t[k], approach, slip, friction)
            for i in range(len(velocity)):
                velocity[i] += (force[k, 0] - press) * give_n[k, i] + (force[k, 1] - rub) * give_t[k, i]
            moved = max(moved, abs(force[k, 0] - press), abs(force[k, 1] - rub))
            size = max(size, force[k, 0])
        if moved <= _SETTLED * size:
            return


@njit(cache=True)
def relax(
    first: NDArray[np.int32], column: NDArray[np.int32], coupling: Floats, diagonal: Floats, drive: Floats,
    omega: float, count: int, value: Floats, spare: Floats,
) -> None:  # fmt: skip
    """Sweeps of relaxation of ``G x = b``, row by row; ``omega`` 0 stands for Jacobi's, which read old values only.

    The solution is known not to be negative.  Over-relaxation overshoots, and is held at 0: projected SOR (Cryer 1971)
    converges to the same solution.
    """
    for _ in range(count):
        if omega == 0.0:
            spare[:] = value
        source = spare if omega == 0.0 else value
        for row in range(len(diagonal)):
            total = drive[row]
            for entry in range(first[row], first[row + 1]):
                total += coupling[entry] * source[column[entry]]
            mean = total / diagonal[row]
            value[row] = mean if omega == 0.0 else max(value[row] + omega * (mean - value[row]), 0.0)
