"""Compiled kernels that mark cells: collisions of arm links in joint space, polygons and parallelograms in the plane.

They build on distances between points, segments, polygons and discs, and on the forward kinematics of the arm, which
are also defined here.
Import this module only inside functions that call a kernel, because importing numba takes seconds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid._internal.jit import inner, kernel
from resgrid.robots.geometry import ArmLinks, ObstacleArrays

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


@njit(cache=True, inline="always")
def segment_parameter(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Return the parameter of the point on the segment from a to b that is nearest to the point p: 0 at a, 1 at b.

    `px, py, ax, ay, bx, by`: coordinates of the three points.  The result is 0 if a equals b.
    """
    dx, dy = bx - ax, by - ay
    squared = dx * dx + dy * dy
    if squared <= 0.0:
        return 0.0
    return min(max(((px - ax) * dx + (py - ay) * dy) / squared, 0.0), 1.0)


@inner
def _squared_from_segment(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Return the squared distance of the point (x, y) from the segment between (ax, ay) and (bx, by)."""
    t = segment_parameter(x, y, ax, ay, bx, by)
    return (x - ax - t * (bx - ax)) ** 2 + (y - ay - t * (by - ay)) ** 2


@inner
def _squared_between(ax: float, ay: float, bx: float, by: float, cx: float, cy: float, dx: float, dy: float) -> float:
    """Return the squared distance of the segments from a to b and from c to d; 0 if they cross.

    `ax` to `dy`: coordinates of the four points.  Unless the segments cross, the distance is attained at an end point
    of one of them.
    """
    c = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    d = (bx - ax) * (dy - ay) - (by - ay) * (dx - ax)
    a = (dx - cx) * (ay - cy) - (dy - cy) * (ax - cx)
    b = (dx - cx) * (by - cy) - (dy - cy) * (bx - cx)
    if c * d < 0.0 and a * b < 0.0:
        return 0.0
    from_first = min(_squared_from_segment(ax, ay, cx, cy, dx, dy), _squared_from_segment(bx, by, cx, cy, dx, dy))
    from_second = min(_squared_from_segment(cx, cy, ax, ay, bx, by), _squared_from_segment(dx, dy, ax, ay, bx, by))
    return min(from_first, from_second)


@inner
def _near_polygon(ax: float, ay: float, bx: float, by: float, reach: float, edges: Floats) -> bool:
    """Return whether the segment from a to b is inside a polygon or within a distance `reach` of its outline.

    `ax, ay, bx, by`: ends of the segment, in metres; `reach`: in metres; `edges` (m, 4): edges ``x0, y0, x1, y1`` of
    the polygon, in metres.
    """
    inside = False
    for e in range(len(edges)):
        cx, cy, dx, dy = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3]
        if _squared_between(ax, ay, bx, by, cx, cy, dx, dy) <= reach * reach:
            return True
        if (cy <= ay) != (dy <= ay) and ax < cx + (ay - cy) * (dx - cx) / (dy - cy):
            inside = not inside
    return inside


@inner
def near_solids(ax: float, ay: float, bx: float, by: float, reach: float, solids: ObstacleArrays) -> bool:
    """Return whether the segment from a to b lies in one of the `solids`, or at most `reach` metres from one.

    `ax, ay, bx, by`: coordinates of a and b, in metres; `solids`: polygons, discs and half-planes.
    """
    left, right = min(ax, bx) - reach, max(ax, bx) + reach
    low, high = min(ay, by) - reach, max(ay, by) + reach
    for k in range(len(solids.bounds)):
        if left > solids.bounds[k, 2] or right < solids.bounds[k, 0]:
            continue
        if low > solids.bounds[k, 3] or high < solids.bounds[k, 1]:
            continue
        edges = solids.edges[solids.first_edge[k] : solids.first_edge[k + 1]]
        if _near_polygon(ax, ay, bx, by, reach, edges):
            return True
    for k in range(len(solids.discs)):
        x, y, radius = solids.discs[k, 0], solids.discs[k, 1], solids.discs[k, 2]
        if _squared_from_segment(x, y, ax, ay, bx, by) <= (reach + radius) ** 2:
            return True
    for k in range(len(solids.half_planes)):
        nx, ny, offset = solids.half_planes[k, 0], solids.half_planes[k, 1], solids.half_planes[k, 2]
        if min(nx * ax + ny * ay, nx * bx + ny * by) <= offset + reach:
            return True
    return False


@kernel
def place_joints(joints: Floats, link: int, angles: Floats, lengths: Floats, base: Floats, relative: bool) -> None:
    """Write the positions of all joints up to the far end of link number `link` to `joints` (forward kinematics).

    `joints` (>= link + 2, 2): positions in metres; `angles` (>= link + 1,): joint angles in radians, measured from the
    previous link if `relative`, else from the base direction; `lengths` (>= link + 1,): lengths of the links, in
    metres; `base` (3,): x and y of the base, in metres, and direction of joint angle 0, in radians.
    """
    direction = base[2]
    joints[0, 0], joints[0, 1] = base[0], base[1]
    for j in range(link + 1):
        direction = direction + angles[j] if relative else base[2] + angles[j]
        joints[j + 1, 0] = joints[j, 0] + lengths[j] * math.cos(direction)
        joints[j + 1, 1] = joints[j, 1] + lengths[j] * math.sin(direction)


@kernel
def _displacement_bound(
    joints: Floats, first: int, link: int, chords: Floats, lengths: Floats, relative: bool
) -> float:
    """Return an upper bound, in metres, of the distance that any point of a link moves while its joints turn.

    Joints ``first .. link`` turn within a cell; the other joints stay at the cell's centre.  Relative angles: turn the
    joints one after the other, from the base outwards.  Each rotation moves all further links rigidly, so that
    distances from the joint are those at the cell's centre.  Absolute angles: a joint rotates only its own link and
    translates all further links, so that the displacements add up.

    `joints`: positions of the joints in the configuration at the cell's centre, in metres; `chords` (n,):
    ``2 sin(t / 2)`` for the largest turn ``t`` of every joint from the centre; `lengths` (n,): lengths of the links, in
    metres; `relative`: whether joint angles are measured from the previous link.
    """
    total = 0.0
    for j in range(first, link + 1):
        if relative:
            near = math.hypot(joints[link, 0] - joints[j, 0], joints[link, 1] - joints[j, 1])
            far = math.hypot(joints[link + 1, 0] - joints[j, 0], joints[link + 1, 1] - joints[j, 1])
            total += chords[j] * max(near, far)
        else:
            total += chords[j] * lengths[j]
    return total


@inner
def _may_collide(
    joints: Floats, link: int, chords: Floats, relative_chords: Floats, links: ArmLinks, self_collision: bool,
    slack: float, solids: ObstacleArrays,
) -> bool:  # fmt: skip
    """Return whether a link may touch an obstacle, or a non-adjacent earlier link, for some configuration of a cell.

    `joints` (link + 2, 2): joint positions in the configuration at the cell's centre, in metres; `link`: index of the
    link; `chords` (n,): ``2 sin(t / 2)`` for the largest turn ``t`` of every joint within the cell; `relative_chords`
    (n,): work array; `links`: the arm; `self_collision`: whether links are tested against each other; `slack`: bound on
    the rounding error of distances, in metres; `solids`: the obstacles.
    """
    radii, lengths, relative = links.radii, links.lengths, links.relative
    ax, ay, bx, by = joints[link, 0], joints[link, 1], joints[link + 1, 0], joints[link + 1, 1]
    reach = radii[link] + _displacement_bound(joints, 0, link, chords, lengths, relative) + slack
    if near_solids(ax, ay, bx, by, reach, solids):
        return True
    if self_collision:
        for j in range(link - 1):
            # Motion relative to link j: with absolute angles, the rotation of link j adds to that of further joints.
            if not relative:
                for k in range(j + 1, link + 1):
                    relative_chords[k] = chords[k] + chords[j]
            within = radii[j] + radii[link] + slack
            turning = chords if relative else relative_chords
            within += _displacement_bound(joints, j + 1, link, turning, lengths, relative)
            squared = _squared_between(ax, ay, bx, by, joints[j, 0], joints[j, 1], joints[j + 1, 0], joints[j + 1, 1])
            if squared <= within * within:
                return True
    return False


@kernel
def mark_link(
    out: Flags, first: int, last: int, link: int, counts: Integers, centres: Floats, widths: Floats, links: ArmLinks,
    self_collision: bool, parts: int, slack: float, solids: ObstacleArrays,
) -> None:  # fmt: skip
    """Mark the cells of joints ``0 .. link`` in which link number `link` may hit an obstacle or an earlier link.

    A cell in which the link may collide, but does not at the centre, is subdivided once into ``parts`` parts per joint.
    Cells that are marked already are skipped. `out` (product of counts[:link + 1],): flat mask in C order, in which
    cells are set to True; `first, last`: the cells ``first .. last - 1`` of `out` are tested; `counts` (n,): number of
    cells per joint; `centres` (n, max(counts)): joint angles of cell centres; `widths` (n,): cell widths in radians;
    `links`: the arm; `self_collision`: whether links are tested against each other; `slack`: bound on the rounding
    error of distances, in metres; `solids`: the obstacles.
    """
    joints = np.empty((link + 2, 2))
    middle, angles, scratch = np.empty(link + 1), np.empty(link + 1), np.zeros(link + 1)
    whole, none, small = np.empty(link + 1), np.zeros(link + 1), np.empty(link + 1)
    for j in range(link + 1):
        whole[j] = 2.0 * math.sin(min(widths[j] / 2, math.pi) / 2)
        small[j] = 2.0 * math.sin(min(widths[j] / (2 * parts), math.pi) / 2)
    exact = whole.max() == 0.0
    for flat in range(first, last):
        if out[flat]:
            continue
        rest = flat
        for j in range(link, -1, -1):
            middle[j] = centres[j, rest % counts[j]]
            rest //= counts[j]
        place_joints(joints, link, middle, links.lengths, links.base, links.relative)
        if not _may_collide(joints, link, whole, scratch, links, self_collision, slack, solids):
            continue
        if exact or parts == 1 or _may_collide(joints, link, none, scratch, links, self_collision, slack, solids):
            out[flat] = True
            continue
        for part in range(parts ** (link + 1)):
            rest = part
            for j in range(link, -1, -1):
                angles[j] = middle[j] + widths[j] * ((rest % parts + 0.5) / parts - 0.5)
                rest //= parts
            place_joints(joints, link, angles, links.lengths, links.base, links.relative)
            if _may_collide(joints, link, small, scratch, links, self_collision, slack, solids):
                out[flat] = True
                break


class CellPlane(NamedTuple):
    """A grid in the plane, and the box around each cell centre that is tested in place of the cell.

    `x, y`: lower corner of the grid; `width, height`: size of a cell; `half_x, half_y`: half the size of the tested
    box, 0 to test only the centre.  All in metres.
    """

    x: float
    y: float
    width: float
    height: float
    half_x: float
    half_y: float


@inner
def _index(scaled: float, count: int) -> int:
    """Return `scaled`, a coordinate in cell widths, rounded up and clipped to an index from 0 to `count`."""
    return math.ceil(min(max(scaled, 0.0), float(count)))


@inner
def _extent_of_disc(y: float, radius: float, low: float, high: float) -> float:
    """Return half the length of the longest chord of a disc that is parallel to x with a coordinate y in [low, high].

    `y`: coordinate of the disc's centre; `radius`: radius of the disc.  The result is -1 if there is no such chord.
    """
    away = max(0.0, low - y, y - high)
    return math.sqrt((radius - away) * (radius + away)) if away <= radius else -1.0


@inner
def _ends_of_segment(ax: float, ay: float, bx: float, by: float, low: float, high: float) -> tuple[float, float]:
    """Return least and largest x of the part of the segment from a to b with y in [low, high]; (inf, -inf) if none."""
    if ay > by:
        ax, ay, bx, by = bx, by, ax, ay
    if ay > high or by < low:
        return math.inf, -math.inf
    first, last = ax, bx
    if ay < low:
        first = ax + (low - ay) * ((bx - ax) / (by - ay))
    if by > high:
        last = ax + (high - ay) * ((bx - ax) / (by - ay))
    return min(first, last), max(first, last)


@kernel
def mark_parallelograms(out: Flags, pieces: Floats, reach: float, plane: CellPlane) -> None:
    """Mark the cells whose tested box comes within a distance `reach`, in metres, of one of p parallelograms.

    The tested box has the half widths ``plane.half_x, plane.half_y`` around the cell's centre: about the whole cell, or
    0 to test only the centre.  `out` (columns, rows): mask, row 0 at the lowest y, in which cells are set to True, and
    other entries keep their values; `pieces` (p, 6): x and y of a corner and of two edge vectors of each parallelogram,
    in metres; `plane`: grid.  The set of points within the distance is convex, so that in each row the marked cells
    form one interval.  The ends of the interval lie on circles around the corners or on edges shifted outwards.
    """
    columns, rows = out.shape
    for piece in range(len(pieces)):
        x, y, ax, ay, bx, by = pieces[piece]
        lowest = y + min(0.0, ay) + min(0.0, by) - reach - plane.half_y
        highest = y + max(0.0, ay) + max(0.0, by) + reach + plane.half_y
        first = _index((lowest - plane.y) / plane.height - 1.5, rows)
        last = _index((highest - plane.y) / plane.height + 0.5, rows)
        for row in range(first, last):
            middle = plane.y + (row + 0.5) * plane.height
            low, high = middle - plane.half_y, middle + plane.half_y
            left, right = math.inf, -math.inf
            for corner in range(4):
                cx = x + (ax if corner & 1 else 0.0) + (bx if corner & 2 else 0.0)
                cy = y + (ay if corner & 1 else 0.0) + (by if corner & 2 else 0.0)
                extent = _extent_of_disc(cy, reach, low, high)
                if extent >= 0.0:
                    left, right = min(left, cx - extent), max(right, cx + extent)
            for edge in range(4):
                dx, dy = (ax, ay) if edge & 1 else (bx, by)
                sx = x + (0.0 if edge < 2 else (bx if edge & 1 else ax))
                sy = y + (0.0 if edge < 2 else (by if edge & 1 else ay))
                length = math.hypot(dx, dy)
                if length == 0.0:
                    continue
                for side in (-reach, reach):
                    ox, oy = -dy / length * side, dx / length * side
                    ends = _ends_of_segment(sx + ox, sy + oy, sx + dx + ox, sy + dy + oy, low, high)
                    left, right = min(left, ends[0]), max(right, ends[1])
            if left <= right:
                start = _index((left - plane.half_x - plane.x) / plane.width - 0.5, columns)
                stop = _index((right + plane.half_x - plane.x) / plane.width - 0.5, columns)
                if stop < columns and plane.x + (stop + 0.5) * plane.width <= right + plane.half_x:
                    stop += 1
                out[start:stop, row] = True


@kernel
def mark_enclosed(out: Flags, edges: Floats, plane: CellPlane) -> None:
    """Mark the cells whose centres lie inside closed rings of edges, by the even-odd rule.

    `out` (columns, rows): mask, row 0 at the lowest y, in which enclosed cells are set to True; other entries keep
    their values; `edges` (e, 4): end points ``x0, y0, x1, y1`` in metres; `plane`: grid.  A cell is enclosed if an odd
    number of edges cross the line through the row's cell centres to the left of the cell's centre.
    """
    columns, rows = out.shape
    flips = np.zeros(columns + 1, dtype=np.bool_)
    first = _index((edges[:, 1].min() - plane.y) / plane.height - 1.5, rows)
    last = _index((edges[:, 1].max() - plane.y) / plane.height + 0.5, rows)
    for row in range(first, last):
        middle = plane.y + (row + 0.5) * plane.height
        flips[:] = False
        for edge in range(len(edges)):
            ax, ay, bx, by = edges[edge]
            if (ay <= middle) != (by <= middle):
                crossing = ax + (middle - ay) * ((bx - ax) / (by - ay))
                at = _index((crossing - plane.x) / plane.width - 0.5, columns)
                flips[at] = not flips[at]
        inside = False
        for column in range(columns):
            inside ^= flips[column]
            if inside:
                out[column, row] = True
