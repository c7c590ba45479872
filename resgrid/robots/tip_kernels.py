"""Compiled loops of the arms' goals: which cells hold a configuration that brings the tip into a region.

Numba takes seconds to import: only functions that are about to sample import this module.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from resgrid._internal.jit import inner, kernel
from resgrid.robots.geometry import ArmLinks, ObstacleArrays
from resgrid.robots.kernels import Flags, Floats, Integers, near_solids, place_joints, share

BOXES = 200_000
"""So many parts of a cell are examined at before it is given up."""

STEPS = 30
"""So many Newton steps are made from the middle of a part."""

DEPTH = 256
"""Halvings of a cell that end in a part too small to matter: some fifty along each of four joints."""


class _Work(NamedTuple):
    """One cell: where its joints end, a configuration, and what Newton's steps and the halvings need."""

    low: Floats
    high: Floats
    at: Floats
    best: Floats
    step: Floats
    held: Flags
    rows: Floats
    joints: Floats
    middles: Floats
    halves: Floats


@inner
def _towards(x: float, y: float, piece: int, goal: ObstacleArrays) -> tuple[float, float, float, bool]:
    """Distance from a piece of a region's border, the unit vector away from it, and whether it is a corner's.

    The pieces, all convex, are the edges of its polygons, its discs and its half-planes.
    """
    edges, discs = len(goal.edges), len(goal.discs)
    if piece < edges:
        ax, ay = goal.edges[piece, 0], goal.edges[piece, 1]
        bx, by = goal.edges[piece, 2], goal.edges[piece, 3]
        t = share(x, y, ax, ay, bx, by)
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
def _place_tip(work: _Work, links: ArmLinks) -> None:
    """Joint positions of the configuration, and velocity of the tip for unit velocities of the joints, shape (n, 2)."""
    n, joints = len(work.at), work.joints
    place_joints(joints, n - 1, work.at, links.lengths, links.base, links.relative)
    for j in range(n):
        far = n if links.relative else j + 1
        work.rows[j, 0] = joints[j, 1] - joints[far, 1]
        work.rows[j, 1] = joints[far, 0] - joints[j, 0]


@inner
def _turn(work: _Work, rx: float, ry: float, flat: bool) -> None:
    """Turn the joints by the least that would move the tip by ``r``, or by as much along ``r`` and somehow across it.

    A joint at the end of its cell that would have to turn further is held, and the others turn for it; what still
    leaves the cell is cut off.
    """
    n, rows, step, at = len(work.at), work.rows, work.step, work.at
    for j in range(n):
        work.held[j] = False
    for _ in range(n + 1):
        xx = xy = yy = 0.0
        for j in range(n):
            if not work.held[j]:
                xx += rows[j, 0] * rows[j, 0]
                xy += rows[j, 0] * rows[j, 1]
                yy += rows[j, 1] * rows[j, 1]
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
            step[j] = 0.0 if work.held[j] else rows[j, 0] * px + rows[j, 1] * py
            if (step[j] > 0.0 and at[j] >= work.high[j]) or (step[j] < 0.0 and at[j] <= work.low[j]):
                work.held[j] = True
                again = True
        if not again:
            break
    for j in range(n):
        at[j] = min(work.high[j], max(work.low[j], at[j] + step[j]))


@inner
def _solve(work: _Work, piece: int, links: ArmLinks, goal: ObstacleArrays, least: float) -> float:
    """Turn the joints within a cell until the tip touches a piece; distance of the nearest place found, which is left.

    Newton's steps, cut off at the borders of the cell: straight at the piece, whatever happens across, and where that
    leads no nearer, with the tip held on its line.
    """
    n = len(work.at)
    nearest, stuck = math.inf, 0
    for _ in range(STEPS):
        _place_tip(work, links)
        away, ux, uy, corner = _towards(work.joints[n, 0], work.joints[n, 1], piece, goal)
        stuck = 0 if away < 0.7 * nearest else stuck + 1
        if away < nearest:
            nearest = away
            for j in range(n):
                work.best[j] = work.at[j]
        if nearest <= least or stuck > 3:
            break
        _turn(work, -away * ux, -away * uy, not corner and stuck == 0)
    for j in range(n):
        work.at[j] = work.best[j]
    return nearest


@inner
def _aim(work: _Work, part: int, links: ArmLinks, goal: ObstacleArrays, tolerance: float) -> tuple[int, int]:
    """The nearest piece of the region's border that the tip may reach from the middle of a part, -1 if there is none.

    Within the part the tip moves by at most ``chord times lever``, summed over the joints; and away from a convex
    piece by at most ``|u . J| half`` and, for what the Jacobian leaves out, half of ``length times turn**2``, summed
    over the links.  The joint whose turning matters most comes second.
    """
    n, rows, halves = len(work.at), work.rows, work.halves
    travel = curved = turn = most = 0.0
    widest = 0
    for j in range(n):
        width = halves[part, j]
        turn = turn + width if links.relative else width
        curved += 0.5 * links.lengths[j] * turn * turn
        lever = math.hypot(rows[j, 0], rows[j, 1])
        travel += 2.0 * math.sin(min(width, math.pi) / 2) * lever
        if width * (links.lengths[j] + lever) > most:
            most, widest = width * (links.lengths[j] + lever), j
    aim, closest = -1, math.inf
    for piece in range(len(goal.edges) + len(goal.discs) + len(goal.half_planes)):
        away, ux, uy, _ = _towards(work.joints[n, 0], work.joints[n, 1], piece, goal)
        if away <= travel + tolerance and away < closest:
            straight = curved
            for j in range(n):
                straight += abs(ux * rows[j, 0] + uy * rows[j, 1]) * halves[part, j]
            if away <= straight + tolerance:
                aim, closest = piece, away
    return aim, widest


@inner
def _find(work: _Work, links: ArmLinks, goal: ObstacleArrays, tolerance: float) -> bool:
    """Whether a cell holds a configuration with the tip in a region, which is left.

    Branch and bound: parts of the cell from which the tip cannot come to the region are left out; elsewhere Newton's
    steps look for a configuration, and where they fail the part is cut in two; the half that they led to comes first.
    """
    n, middles, halves = len(work.at), work.middles, work.halves
    size, examined = 1, 0
    while size > 0 and examined < BOXES:
        size -= 1
        examined += 1
        for j in range(n):
            work.at[j] = middles[size, j]
        _place_tip(work, links)
        x, y = work.joints[n, 0], work.joints[n, 1]
        if near_solids(x, y, x, y, 0.0, goal):
            return True
        aim, widest = _aim(work, size, links, goal, tolerance)
        if aim < 0:
            continue
        if _solve(work, aim, links, goal, 1e-6 * tolerance) <= tolerance:
            return True
        if size + 2 > DEPTH:
            return False
        halves[size, widest] /= 2
        for j in range(n):
            halves[size + 1, j] = halves[size, j]
            middles[size + 1, j] = middles[size, j]
        towards = math.copysign(halves[size, widest], work.at[widest] - middles[size, widest])
        middles[size, widest] -= towards
        middles[size + 1, widest] += towards
        size += 2
    return False


@kernel
def find_tips(
    out: Flags, points: Floats, first: int, counts: Integers, lower: Floats, widths: Floats,
    links: ArmLinks, goal: ObstacleArrays, bounds: Floats, tolerance: float,
) -> None:  # fmt: skip
    """Find the cells that hold a configuration with the tip in a region, and one for each.

    Shapes: `out` (m,), `points` (m, n), `counts` (n,), `lower, widths` (n,), `bounds` (4,).
    """
    n = len(counts)
    work = _Work(
        np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n, dtype=np.bool_),
        np.empty((n, 2)), np.empty((n + 1, 2)), np.empty((DEPTH, n)), np.empty((DEPTH, n)),
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
        if _find(work, links, goal, tolerance):
            out[row] = True
            for j in range(n):
                points[row, j] = work.at[j]
