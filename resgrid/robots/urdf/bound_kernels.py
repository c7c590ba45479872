"""Compiled device functions: proofs that two convex pieces stay apart while joints move within a box.

Import this module only inside functions that call a kernel, because importing numba takes seconds.

The bound.  Joint values q lie in the box ``c + d`` with ``|d_j| <= e_j`` (c: centre, e: half widths).  Let p be a point
of a body at q = c, and E_j(d) the motion by joint j from its pose at c.  Number the joints from the common ancestor of
both bodies to the body: 1, ..., k.  Then p moves to ``E_1(d_1) ... E_k(d_k) p``.  Turn joint 1 first, then joint 2, and
so on.  The displacement is the sum of ``Q_j (E_j(d_j) p - p)``: p is still at its pose at c, and Q_j is the rotation by
the joints before j.  Q_j has at most the angle ``t_j``, the sum of ``e_i`` over the revolute joints before j.  For a
unit vector n, ``|n Q_j v - n v| <= 2 sin(t_j / 2) |v|``.

- Revolute joint with axis w through o, ``r = p - o``: ``n (E(d) p - p) = A (cos d - 1) + B sin d`` with
  ``A = n r - (n w)(w r)`` and ``B = n (w x r)``.  The minimum over ``|d| <= e`` is known in closed form.
  ``|E(d) p - p| <= 2 sin(e / 2) rho`` with rho the distance of p from the axis.
- Prismatic joint: ``n (E(d) p - p) = d n w``; the length is at most e.

A joint that follows a moving joint has the half width ``|factor| e``.  The lowest level of n over a moving piece is
therefore at least the minimum over its points of::

    n p + sum_j [ min_d n (E_j(d) p - p) - 2 sin(t_j / 2) max_d |E_j(d) p - p| ] - radius.

This is a concave function of n: the support function of the sum of p, of an arc for every joint, and of balls.  The
algorithm of Gilbert, Johnson and Keerthi (1988) finds the direction n with the largest gap between the swept sets of
both pieces.  Any n with a positive gap proves that the pieces stay apart, even if the search found no better n.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from resgrid._internal.jit import inner
from resgrid.robots.urdf.arrays import Flags, Floats, Integers, TreeArrays
from resgrid.robots.urdf.simplex_kernels import dot, drop_corners, nearest_on_simplex

MAX_STEPS = 24
"""Maximum number of steps of the search for a separating direction; the best bound so far is then the result."""

TOLERANCE = 1e-7
"""Largest distance in metres between swept pieces for which they count as touching, so that the search for a direction
that separates them ends.
"""


class Frames(NamedTuple):
    """Poses of the k joints' frames in the world at one configuration; entry 0 is the world, entry j + 1 joint j.

    `rotation` (k + 1, 3, 3): rotation matrix from a joint's frame to the world; `origin` (k + 1, 3): origin of a
    joint's frame in the world, in metres; `axis` (k + 1, 3): unit vector along a joint's axis, in the world; `local`
    (3, 3): work array, the rotation by one joint in the joint's own frame.
    """

    rotation: Floats
    origin: Floats
    axis: Floats
    local: Floats


class BoxSweep(NamedTuple):
    """Motion of the two pieces of an item, a pair of convex pieces, while joints move within a box.

    The first index of an array is the side: 0 for the first piece, 1 for the second one. Vectors are in the frame of
    the joint that carries the piece, at the centre of the box. The second index counts the joints that move the piece
    relative to the common ancestor of both bodies, the nearest to the ancestor first; K is the largest number of such
    joints.

    `piece, frame, chained` (2,): index of the piece, index of its frame in `Frames`, and number of moving joints;
    `joint` (2, K): index of a joint; `prismatic` (2, K): whether the joint translates; `axis, origin` (2, K, 3): unit
    vector along the joint's axis, and a point of the axis in metres; `half` (2, K): largest motion from the centre, in
    radians or metres; `cosine, sine` (2, K): cosine and sine of this angle, at most pi; `chord` (2, K): largest
    displacement of a point per metre of distance from the axis, for a prismatic joint in metres; `turn` (2, K): ``2
    sin(t / 2)``, with ``t`` the sum of the angles of the joints before; `ball` (2, V): for every point of the piece,
    the sum over joints of turn times displacement, in metres, with V the largest number of points of a piece; `level`
    (V,): work array, height of every point along a direction; `point` (2, 3): lowest point of the swept piece along the
    last direction, in the world, in metres; `vertex` (2,): index in `TreeArrays.x` of the vertex that moves to this
    point.
    """

    piece: Integers
    frame: Integers
    chained: Integers
    joint: Integers
    prismatic: Flags
    axis: Floats
    origin: Floats
    half: Floats
    cosine: Floats
    sine: Floats
    chord: Floats
    turn: Floats
    ball: Floats
    level: Floats
    point: Floats
    vertex: Integers


class Search(NamedTuple):
    """Work arrays of the search for a direction along which the swept sets of two pieces are separated (GJK).

    `normal` (3,): current unit direction, from the second piece to the first, in the world; `best` (3,): direction with
    the largest gap so far; `corners` (4, 3): corners of the simplex, differences of points of both swept pieces, in
    metres; `weights` (4,): barycentric weights of the corners for the point of the simplex that is nearest to the
    origin; `trial` (4,): such weights for one face of a tetrahedron; `nearest` (3,): the nearest point; `local` (3,):
    the direction, with the sign of a side, in the frame of this side's piece; `across` (3,): work array for a vector or
    a point in the frame of a piece.
    """

    normal: Floats
    best: Floats
    corners: Floats
    weights: Floats
    trial: Floats
    nearest: Floats
    local: Floats
    across: Floats


@inner
def copy(target: Floats, source: Floats) -> None:
    """Copy the vector `source` to the vector `target`, of equal length."""
    for i in range(len(target)):
        target[i] = source[i]


@inner
def place(values: Floats, tree: TreeArrays, frames: Frames) -> None:
    """Write the poses of all joints to `frames`: forward kinematics, with Rodrigues' formula.

    `values` (m,): configuration, values of the moving joints in radians or metres; `tree`: joints of the robot.
    """
    local = frames.local
    for joint in range(len(tree.parent)):
        base, value = tree.parent[joint] + 1, tree.factor[joint] * values[tree.driver[joint]] + tree.offset[joint]
        x, y, z = tree.direction[joint, 0], tree.direction[joint, 1], tree.direction[joint, 2]
        sine, versine = math.sin(value), 2.0 * math.sin(value / 2.0) ** 2
        slide = 0.0
        if tree.prismatic[joint]:
            sine, versine, slide = 0.0, 0.0, value
        local[0, 0], local[1, 1], local[2, 2] = (
            1.0 - versine * (y * y + z * z), 1.0 - versine * (x * x + z * z), 1.0 - versine * (x * x + y * y)
        )  # fmt: skip
        local[0, 1], local[1, 0] = versine * x * y - sine * z, versine * x * y + sine * z
        local[0, 2], local[2, 0] = versine * x * z + sine * y, versine * x * z - sine * y
        local[1, 2], local[2, 1] = versine * y * z - sine * x, versine * y * z + sine * x
        own, placed = frames.rotation[joint + 1], frames.rotation[base]
        for i in range(3):
            for j in range(3):
                total = 0.0
                for k in range(3):
                    total += placed[i, k] * (
                        tree.rotation[joint, k, 0] * local[0, j]
                        + tree.rotation[joint, k, 1] * local[1, j]
                        + tree.rotation[joint, k, 2] * local[2, j]
                    )
                own[i, j] = total
        for i in range(3):
            frames.axis[joint + 1, i] = own[i, 0] * x + own[i, 1] * y + own[i, 2] * z
            frames.origin[joint + 1, i] = (
                frames.origin[base, i] + dot(placed[i], tree.translation[joint]) + slide * frames.axis[joint + 1, i]
            )


@inner
def _to_local(vector: Floats, frames: Frames, frame: int, out: Floats) -> None:
    """Write the coordinates of a vector in a joint's frame to `out` (3,).

    `vector` (3,): the vector in the world; `frames`: poses of the joints; `frame`: index into `frames`, 0 for the
    world, j + 1 for joint j.
    """
    rotation = frames.rotation[frame]
    for i in range(3):
        out[i] = rotation[0, i] * vector[0] + rotation[1, i] * vector[1] + rotation[2, i] * vector[2]


@inner
def sweep_side(
    side: int, piece: int, pair: int, half: Floats, tree: TreeArrays, frames: Frames, sweep: BoxSweep, search: Search
) -> None:
    """Write the motion of one piece of an item (a pair of pieces) to `sweep`, except fields about points of the piece.

    `side`: 0 for the first piece of the item, 1 for the second; `piece`: index of the piece; `pair`: index of the pair
    of bodies; `half` (m,): half widths of the box of the moving joints, in radians or metres; `tree`: joints and pieces
    of the robot; `frames`: poses of the joints at the centre of the box; `search`: work arrays.
    """
    frame = tree.joint[piece] + 1
    sweep.piece[side], sweep.frame[side], sweep.chained[side] = piece, frame, 0
    turned = 0.0
    for joint in tree.chain[pair, side]:
        if joint < 0:
            break
        largest = abs(tree.factor[joint]) * half[tree.driver[joint]]
        if largest == 0.0:
            continue
        at = sweep.chained[side]
        sweep.chained[side] = at + 1
        sweep.joint[side, at], sweep.prismatic[side, at], sweep.half[side, at] = joint, tree.prismatic[joint], largest
        sweep.turn[side, at] = 2.0 * math.sin(min(turned, math.pi) / 2.0)
        _to_local(frames.axis[joint + 1], frames, frame, sweep.axis[side, at])
        for i in range(3):
            search.across[i] = frames.origin[joint + 1, i] - frames.origin[frame, i]
        _to_local(search.across, frames, frame, sweep.origin[side, at])
        if tree.prismatic[joint]:
            sweep.chord[side, at] = largest
        else:
            clipped = min(largest, math.pi)
            sweep.cosine[side, at], sweep.sine[side, at] = math.cos(clipped), math.sin(clipped)
            sweep.chord[side, at] = 2.0 * math.sin(clipped / 2.0)
            turned += largest


@inner
def _from_axis(x: float, y: float, z: float, axis: Floats, origin: Floats) -> float:
    """Return the distance, in metres, of the point (x, y, z) from a line.

    `axis` (3,): unit vector along the line; `origin` (3,): a point of the line.
    """
    x, y, z = x - origin[0], y - origin[1], z - origin[2]
    along = x * axis[0] + y * axis[1] + z * axis[2]
    return math.sqrt(max(x * x + y * y + z * z - along * along, 0.0))


@inner
def weigh_points(side: int, tree: TreeArrays, sweep: BoxSweep) -> None:
    """Write the radii of the balls around the points of a piece to ``sweep.ball[side]``, in metres.

    A radius is the sum, over the joints that move the piece, of the point's largest displacement by the joint times
    ``2 sin(t / 2)``, with ``t`` the sum of the largest angles of the joints before. It bounds the effect of the
    rotation by the joints before on the direction of the displacement. `side`: 0 for the first piece, 1 for the second.
    """
    first, last = tree.first[sweep.piece[side]], tree.first[sweep.piece[side] + 1]
    xs, ys, zs = tree.x[first:last], tree.y[first:last], tree.z[first:last]
    ball = sweep.ball[side]
    for v in range(last - first):
        ball[v] = 0.0
    for k in range(sweep.chained[side]):
        weight = sweep.turn[side, k] * sweep.chord[side, k]
        if weight == 0.0:
            continue
        axis, origin = sweep.axis[side, k], sweep.origin[side, k]
        for v in range(last - first):
            length = 1.0 if sweep.prismatic[side, k] else _from_axis(xs[v], ys[v], zs[v], axis, origin)
            ball[v] += weight * length


@inner
def ball_gap(tree: TreeArrays, frames: Frames, sweep: BoxSweep) -> float:
    """Return a lower bound of the distance, in metres, between the balls around both pieces while joints move.

    The bound is negative if the balls may overlap. `frames`: poses at the centre of the box of joint values; `sweep`:
    motion of both pieces.
    """
    squared, gap = 0.0, 0.0
    a, b = tree.centre[sweep.piece[0]], tree.centre[sweep.piece[1]]
    first, second = frames.rotation[sweep.frame[0]], frames.rotation[sweep.frame[1]]
    for i in range(3):
        difference = (
            dot(first[i], a) + frames.origin[sweep.frame[0], i] - dot(second[i], b) - frames.origin[sweep.frame[1], i]
        )
        squared += difference * difference
    gap = math.sqrt(squared)
    for side in range(2):
        centre, reach = tree.centre[sweep.piece[side]], tree.reach[sweep.piece[side]]
        gap -= reach
        for k in range(sweep.chained[side]):
            if sweep.prismatic[side, k]:
                gap -= sweep.half[side, k]
            else:
                axis, origin = sweep.axis[side, k], sweep.origin[side, k]
                gap -= sweep.chord[side, k] * (_from_axis(centre[0], centre[1], centre[2], axis, origin) + reach)
    return gap


@inner
def _arc_levels(level: Floats, side: int, k: int, tree: TreeArrays, sweep: BoxSweep, search: Search) -> None:
    """Add to `level` (V,), for every point of a piece, the lowest change of height along its arc about a joint.

    The height is the coordinate along the direction ``search.local``, in metres; the change is 0 or negative. `side`: 0
    for the first piece, 1 for the second; `k`: number of the revolute joint among those that move the piece.
    """
    first, last = tree.first[sweep.piece[side]], tree.first[sweep.piece[side] + 1]
    xs, ys, zs = tree.x[first:last], tree.y[first:last], tree.z[first:last]
    n, w, o = search.local, sweep.axis[side, k], sweep.origin[side, k]
    along = dot(n, w)
    ax, ay, az = n[0] - along * w[0], n[1] - along * w[1], n[2] - along * w[2]
    bx, by, bz = n[1] * w[2] - n[2] * w[1], n[2] * w[0] - n[0] * w[2], n[0] * w[1] - n[1] * w[0]
    a0, b0 = ax * o[0] + ay * o[1] + az * o[2], bx * o[0] + by * o[1] + bz * o[2]
    cosine, sine = sweep.cosine[side, k], sweep.sine[side, k]
    for v in range(last - first):
        a = ax * xs[v] + ay * ys[v] + az * zs[v] - a0
        b = bx * xs[v] + by * ys[v] + bz * zs[v] - b0
        radius = math.sqrt(a * a + b * b)
        end = a * cosine - abs(b) * sine
        level[v] += (-radius if -a >= radius * cosine else end) - a


@inner
def lowest(side: int, sign: float, tree: TreeArrays, frames: Frames, sweep: BoxSweep, search: Search) -> float:
    """Return the lowest coordinate along ``sign * search.normal`` that a moving piece reaches, in metres.

    The result is a lower bound for the core of the piece, without its radius. The lowest point of the swept piece, in
    the world, and the index of its vertex are written to ``sweep.point`` and ``sweep.vertex``. `side`: 0 for the first
    piece, 1 for the second; `sign`: 1 for the first piece, -1 for the second; `frames`: poses at the centre of the box.
    """
    frame, piece = sweep.frame[side], sweep.piece[side]
    normal = search.normal
    _to_local(normal, frames, frame, search.local)
    n = search.local
    n[0], n[1], n[2] = sign * n[0], sign * n[1], sign * n[2]
    first, last = tree.first[piece], tree.first[piece + 1]
    xs, ys, zs = tree.x[first:last], tree.y[first:last], tree.z[first:last]
    level, ball = sweep.level, sweep.ball[side]
    for v in range(last - first):
        level[v] = n[0] * xs[v] + n[1] * ys[v] + n[2] * zs[v] - ball[v]
    shift = 0.0
    for k in range(sweep.chained[side]):
        if sweep.prismatic[side, k]:
            shift -= sweep.half[side, k] * abs(dot(n, sweep.axis[side, k]))
        else:
            _arc_levels(level, side, k, tree, sweep, search)
    at, least = 0, math.inf
    for v in range(last - first):
        if level[v] < least:
            at, least = v, level[v]
    sweep.vertex[side] = first + at
    _extreme_point(side, at, tree, frames, sweep, search)
    return least + shift + sign * dot(normal, frames.origin[frame])


@inner
def _extreme_point(side: int, at: int, tree: TreeArrays, frames: Frames, sweep: BoxSweep, search: Search) -> None:
    """Write the point at which a moving vertex is the lowest to ``sweep.point[side]``, in the world, in metres.

    The lowest point is that with the smallest coordinate along ``search.local``. `side`: 0 for the first piece, 1 for
    the second; `at`: index of the vertex in its piece, from 0.
    """
    frame, n, p = sweep.frame[side], search.local, search.across
    vertex = sweep.vertex[side]
    x, y, z = tree.x[vertex], tree.y[vertex], tree.z[vertex]
    p[0], p[1], p[2] = x - sweep.ball[side, at] * n[0], y - sweep.ball[side, at] * n[1], z - sweep.ball[side, at] * n[2]
    for k in range(sweep.chained[side]):
        w, o = sweep.axis[side, k], sweep.origin[side, k]
        along = dot(n, w)
        if sweep.prismatic[side, k]:
            move = -math.copysign(sweep.half[side, k], along)
            p[0], p[1], p[2] = p[0] + move * w[0], p[1] + move * w[1], p[2] + move * w[2]
            continue
        rx, ry, rz = x - o[0], y - o[1], z - o[2]
        height = rx * w[0] + ry * w[1] + rz * w[2]
        tx, ty, tz = w[1] * rz - w[2] * ry, w[2] * rx - w[0] * rz, w[0] * ry - w[1] * rx
        rx, ry, rz = rx - height * w[0], ry - height * w[1], rz - height * w[2]
        a, b = n[0] * rx + n[1] * ry + n[2] * rz, n[0] * tx + n[1] * ty + n[2] * tz
        radius = math.sqrt(a * a + b * b)
        cosine, sine = sweep.cosine[side, k], -math.copysign(sweep.sine[side, k], b)
        if radius > 0.0 and -a >= radius * cosine:
            cosine, sine = -a / radius, -b / radius
        p[0] += (cosine - 1.0) * rx + sine * tx
        p[1] += (cosine - 1.0) * ry + sine * ty
        p[2] += (cosine - 1.0) * rz + sine * tz
    for i in range(3):
        sweep.point[side, i] = frames.origin[frame, i] + dot(frames.rotation[frame, i], p)


@inner
def largest_gap(margin: float, exact: bool, tree: TreeArrays, frames: Frames, sweep: BoxSweep, search: Search) -> float:
    """Return a lower bound of the gap, in metres, between the moving pieces, and write its direction to `search.best`.

    The bound is the largest one of all directions that the search has visited; it is negative or 0 if none proves that
    the pieces stay apart.  The search starts with the direction `search.normal`.  `margin`: distance in metres that is
    subtracted from the gap; `exact`: whether to continue to the direction of the largest gap, otherwise the search
    stops at the first direction with a positive gap; `frames`, `sweep`: poses at the centre of the box, and motion of
    both pieces.
    """
    radii = tree.radius[sweep.piece[0]] + tree.radius[sweep.piece[1]] + margin
    is_flat = tree.flat[sweep.piece[1]]
    if is_flat:
        copy(search.normal, tree.normal[sweep.piece[1]])
    best, count = -np.inf, 0
    for _ in range(MAX_STEPS):
        gap = -radii
        for side in range(2):
            gap += lowest(side, 1.0 - 2.0 * side, tree, frames, sweep, search)
        if gap > best:
            best = gap
            copy(search.best, search.normal)
        if is_flat or (gap > 0.0 and not exact):
            break
        for i in range(3):
            search.corners[count, i] = sweep.point[0, i] - sweep.point[1, i] - radii * search.normal[i]
        squared = nearest_on_simplex(search.corners, count + 1, search.weights, search.trial, search.nearest)
        distance = math.sqrt(squared)
        if distance <= TOLERANCE or distance - best <= 1e-3 * distance:
            break
        count = drop_corners(search.corners, count + 1, search.weights)
        if count == 4:
            break
        for i in range(3):
            search.normal[i] = search.nearest[i] / distance
    return best
