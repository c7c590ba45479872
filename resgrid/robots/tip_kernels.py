"""Compiled kernels for goal cells of arms: the cells that contain a solution of the inverse kinematics.

A solution is a configuration that brings the tip (tool point) into a goal region.
Import this module only inside functions that call a kernel, because importing numba takes seconds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from resgrid._internal.jit import inner, kernel
from resgrid.robots.geometry import ArmLinks, ObstacleArrays
from resgrid.robots.kernels import Flags, Floats, Integers, near_solids, place_joints, segment_parameter

MAX_BOXES = 200_000
"""Maximum number of boxes (parts of a cell) that the search examines per cell; beyond it the cell is no goal cell."""

MAX_NEWTON_STEPS = 30
"""Maximum number of Newton steps of one search for a configuration, which starts from the centre of a box of joint
angles.
"""

MAX_DEPTH = 256
"""Maximum number of boxes on the stack of the search; with more, the cell is no goal cell.

The number is enough for about fifty bisections along each of four joints.
"""


class _SearchArrays(NamedTuple):
    """Work arrays of the search in one cell, for n joints.

    `low, high` (n,): limits of the cell, in radians; `at` (n,): current configuration; `best` (n,): configuration of a
    Newton iteration with the tip nearest to the goal region; `step` (n,): Newton step; `held` (n,): mask of joints that
    are kept at a limit of the cell; `jacobian` (n, 2): derivative of the tip position by each joint angle; `joints`
    (n + 1, 2): joint positions in metres; `middles, halves` (MAX_DEPTH, n): stack of boxes, centres and half widths.
    """

    low: Floats
    high: Floats
    at: Floats
    best: Floats
    step: Floats
    held: Flags
    jacobian: Floats
    joints: Floats
    middles: Floats
    halves: Floats


@inner
def _piece_distance(x: float, y: float, piece: int, goal: ObstacleArrays) -> tuple[float, float, float, bool]:
    """Return the distance of (x, y) from a convex piece of a region, the unit vector away from the piece, and a flag.

    The result is ``distance, ux, uy, is_point``.  The distance, in metres, is negative inside a disc or half-plane.
    The flag is True if the piece acts as a point: the nearest place is the end of an edge, (x, y) lies on the edge or
    at the centre of the disc, or the radius of the disc is at most a thousandth of the distance from its centre.
    `piece`: index; the pieces are the edges of polygons, the discs and the half-planes of `goal`, in this order.
    """
    edges, discs = len(goal.edges), len(goal.discs)
    if piece < edges:
        ax, ay = goal.edges[piece, 0], goal.edges[piece, 1]
        bx, by = goal.edges[piece, 2], goal.edges[piece, 3]
        t = segment_parameter(x, y, ax, ay, bx, by)
        ux, uy = x - ax - t * (bx - ax), y - ay - t * (by - ay)
        away = math.hypot(ux, uy)
        if away == 0.0:
            return 0.0, 1.0, 0.0, True
        return away, ux / away, uy / away, not 0.0 < t < 1.0
    if piece < edges + discs:
        disc = piece - edges
        cx, cy, radius = goal.discs[disc, 0], goal.discs[disc, 1], goal.discs[disc, 2]
        away = math.hypot(x - cx, y - cy)
        if away == 0.0:
            return -radius, 1.0, 0.0, True
        return away - radius, (x - cx) / away, (y - cy) / away, radius <= 1e-3 * away
    plane = piece - edges - discs
    nx, ny = goal.half_planes[plane, 0], goal.half_planes[plane, 1]
    return nx * x + ny * y - goal.half_planes[plane, 2], nx, ny, False


@inner
def _place_tip(work: _SearchArrays, links: ArmLinks) -> None:
    """Compute ``work.joints`` and ``work.jacobian`` for the configuration ``work.at``; `links`: the arm."""
    n, joints = len(work.at), work.joints
    place_joints(joints, n - 1, work.at, links.lengths, links.base, links.relative)
    for j in range(n):
        far = n if links.relative else j + 1
        work.jacobian[j, 0] = joints[j, 1] - joints[far, 1]
        work.jacobian[j, 1] = joints[far, 0] - joints[j, 0]


@inner
def _newton_step(work: _SearchArrays, rx: float, ry: float, flat: bool) -> None:
    """Add to ``work.at`` the least-norm joint step whose linearized tip motion is ``(rx, ry)``, in metres.

    With `flat`, only the component of the tip motion along ``(rx, ry)`` is prescribed, e.g. for a straight border.  A
    joint at a limit of the cell, ``work.low`` or ``work.high``, that would move beyond it is held, and the step is
    recomputed for the other joints.  The result is clipped to the cell.
    """
    n, jacobian, step, at = len(work.at), work.jacobian, work.step, work.at
    for j in range(n):
        work.held[j] = False
    for _ in range(n + 1):
        xx = xy = yy = 0.0
        for j in range(n):
            if not work.held[j]:
                xx += jacobian[j, 0] * jacobian[j, 0]
                xy += jacobian[j, 0] * jacobian[j, 1]
                yy += jacobian[j, 1] * jacobian[j, 1]
        px = py = 0.0
        if flat:
            squared = rx * rx * xx + 2.0 * rx * ry * xy + ry * ry * yy
            if squared > 0.0:
                scale = (rx * rx + ry * ry) / squared
                px, py = scale * rx, scale * ry
        else:
            more = 1e-14 * (xx + yy)
            det = (xx + more) * (yy + more) - xy * xy
            if det > 0.0:
                px, py = ((yy + more) * rx - xy * ry) / det, ((xx + more) * ry - xy * rx) / det
        again = False
        for j in range(n):
            step[j] = 0.0 if work.held[j] else jacobian[j, 0] * px + jacobian[j, 1] * py
            if (step[j] > 0.0 and at[j] >= work.high[j]) or (step[j] < 0.0 and at[j] <= work.low[j]):
                work.held[j] = True
                again = True
        if not again:
            break
    for j in range(n):
        at[j] = min(work.high[j], max(work.low[j], at[j] + step[j]))


@inner
def _newton(work: _SearchArrays, piece: int, links: ArmLinks, goal: ObstacleArrays, tolerance: float) -> float:
    """Minimize the distance from the tip to a piece by Newton steps within the cell; return the smallest distance.

    The cell is that between ``work.low`` and ``work.high``.  The iteration starts from ``work.at``, to which the
    configuration with the smallest distance is written, and ends at a distance of `tolerance`, in metres.  Steps
    prescribe only the tip motion towards the piece.  For a piece that acts as a point (such as an edge whose end is
    nearest, or a small disc: `_piece_distance`), and after a step without sufficient decrease, steps also prescribe
    that the tip does not move sideways.  `piece`: index of an edge, disc or half-plane of `goal`.
    """
    n = len(work.at)
    nearest, stuck = math.inf, 0
    for _ in range(MAX_NEWTON_STEPS):
        _place_tip(work, links)
        away, ux, uy, corner = _piece_distance(work.joints[n, 0], work.joints[n, 1], piece, goal)
        stuck = 0 if away < 0.7 * nearest else stuck + 1
        if away < nearest:
            nearest = away
            for j in range(n):
                work.best[j] = work.at[j]
        if nearest <= tolerance or stuck > 3:
            break
        _newton_step(work, -away * ux, -away * uy, not corner and stuck == 0)
    for j in range(n):
        work.at[j] = work.best[j]
    return nearest


@inner
def _reachable_piece(
    work: _SearchArrays, box: int, links: ArmLinks, goal: ObstacleArrays, tolerance: float
) -> tuple[int, int]:
    """Return the index of the nearest piece of the goal region that the tip may reach, and the joint to bisect.

    `box`: index of the box on the stack, a part of the cell; `tolerance`: distance from the region, in metres, up to
    which the tip counts as in the region.  The piece is an edge, disc or half-plane of `goal`, or -1 if bounds exclude
    the whole region.  A joint has the Jacobian column ``J`` and turns by at most ``half``, half the width of the box,
    from the middle.  Bound 1: the tip moves by at most the sum over joints of ``2 sin(half / 2) |J|``.  Bound 2:
    towards a convex piece with unit vector ``u`` it moves by at most the sum of ``|u . J| half`` over joints plus, for
    the remainder of the linearization, the sum of ``length * turn**2 / 2`` over links, with the largest ``turn`` of the
    link.  The joint to bisect is the one with the largest effect on the tip.
    """
    n, jacobian, halves = len(work.at), work.jacobian, work.halves
    travel = curved = turn = most = 0.0
    widest = 0
    for j in range(n):
        width = halves[box, j]
        turn = turn + width if links.relative else width
        curved += 0.5 * links.lengths[j] * turn * turn
        lever = math.hypot(jacobian[j, 0], jacobian[j, 1])
        travel += 2.0 * math.sin(min(width, math.pi) / 2) * lever
        if width * (links.lengths[j] + lever) > most:
            most, widest = width * (links.lengths[j] + lever), j
    nearest, closest = -1, math.inf
    for piece in range(len(goal.edges) + len(goal.discs) + len(goal.half_planes)):
        away, ux, uy, _ = _piece_distance(work.joints[n, 0], work.joints[n, 1], piece, goal)
        if away <= travel + tolerance and away < closest:
            straight = curved
            for j in range(n):
                straight += abs(ux * jacobian[j, 0] + uy * jacobian[j, 1]) * halves[box, j]
            if away <= straight + tolerance:
                nearest, closest = piece, away
    return nearest, widest


@inner
def _search_cell(work: _SearchArrays, links: ArmLinks, goal: ObstacleArrays, tolerance: float) -> bool:
    """Return whether a cell has a configuration with the tip in the goal region; write the solution to ``work.at``.

    ``work.middles[0]`` and ``work.halves[0]`` contain centre and half widths of the cell on entry; `tolerance`:
    distance in metres up to which the tip counts as in the region.  Branch and bound: a box (part of the cell) is
    discarded if bounds show that the tip cannot reach the region.  Otherwise Newton steps search for a solution.  If
    they fail, the box is bisected, and the half with the last iterate is searched first.  The result is False if the
    search exceeds `MAX_BOXES` boxes or a stack of `MAX_DEPTH` boxes.
    """
    n, middles, halves = len(work.at), work.middles, work.halves
    size, examined = 1, 0
    while size > 0 and examined < MAX_BOXES:
        size -= 1
        examined += 1
        for j in range(n):
            work.at[j] = middles[size, j]
        _place_tip(work, links)
        x, y = work.joints[n, 0], work.joints[n, 1]
        if near_solids(x, y, x, y, 0.0, goal):
            return True
        piece, widest = _reachable_piece(work, size, links, goal, tolerance)
        if piece < 0:
            continue
        if _newton(work, piece, links, goal, 1e-6 * tolerance) <= tolerance:
            return True
        if size + 2 > MAX_DEPTH:
            return False
        halves[size, widest] /= 2
        for j in range(n):
            halves[size + 1, j] = halves[size, j]
            middles[size + 1, j] = middles[size, j]
        shift = math.copysign(halves[size, widest], work.at[widest] - middles[size, widest])
        middles[size, widest] -= shift
        middles[size + 1, widest] += shift
        size += 2
    return False


@kernel
def find_goal_cells(
    out: Flags, points: Floats, first: int, counts: Integers, lower: Floats, widths: Floats,
    links: ArmLinks, goal: ObstacleArrays, bounds: Floats, tolerance: float,
) -> None:  # fmt: skip
    """Mark the cells that contain a configuration with the tip in a region, and record one configuration per cell.

    `out` (m,): mask of cells ``first .. first + m - 1`` in C order; `points` (m, n): configurations in radians, written
    only in the rows of marked cells;
    `counts` (n,): cells per joint; `lower, widths` (n,): lower limits and cell widths in radians; `links`: the arm;
    `goal`: the region;
    `bounds` (4,): box ``x0, y0, x1, y1``; a cell is excluded if, in the configuration at the cell's centre, the tip
    lies outside this box; `tolerance`: distance in metres up to which the tip counts as in the region.
    """
    n = len(counts)
    work = _SearchArrays(
        np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n, dtype=np.bool_),
        np.empty((n, 2)), np.empty((n + 1, 2)), np.empty((MAX_DEPTH, n)), np.empty((MAX_DEPTH, n)),
    )  # fmt: skip
    for row in range(len(out)):
        rest = first + row
        for j in range(n - 1, -1, -1):
            work.at[j] = lower[j] + (rest % counts[j] + 0.5) * widths[j]
            rest //= counts[j]
        place_joints(work.joints, n - 1, work.at, links.lengths, links.base, links.relative)
        x, y = work.joints[n, 0], work.joints[n, 1]
        if not (bounds[0] <= x <= bounds[2] and bounds[1] <= y <= bounds[3]):
            continue
        for j in range(n):
            work.middles[0, j], work.halves[0, j] = work.at[j], widths[j] / 2
            work.low[j], work.high[j] = work.at[j] - widths[j] / 2, work.at[j] + widths[j] / 2
        if _search_cell(work, links, goal, tolerance):
            out[row] = True
            for j in range(n):
                points[row, j] = work.at[j]
