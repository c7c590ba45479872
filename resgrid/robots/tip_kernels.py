"""Compiled loops of the arms' goals: which cells hold a configuration that brings the tip into a region.

Numba takes seconds to import: only functions that are about to sample import this module.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inner
from resgrid.robots.kernels import _near_solids, _place
from resgrid.robots.solids import Solids

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

BOXES = 20_000
"""So many parts of a cell are looked at before it is given up."""

STEPS = 30
"""So many Newton steps are made from the middle of a part."""

DEPTH = 256
"""Halvings of a cell that end in a part too small to matter: some fifty along each of four joints."""


@inner
def _towards(x: float, y: float, piece: int, goal: Solids) -> tuple[float, float, float, bool]:
    """Distance from a piece of a region's border, the unit vector away from it, and whether it is a corner's.

    The pieces, all convex, are the edges of its polygons, its discs and its half-planes.
    """
    edges, discs = len(goal.edges), len(goal.discs)
    if piece < edges:
        ax, ay, bx, by = goal.edges[piece]
        dx, dy = bx - ax, by - ay
        squared = dx * dx + dy * dy
        share = 0.0 if squared == 0.0 else min(1.0, max(0.0, ((x - ax) * dx + (y - ay) * dy) / squared))
        ux, uy = x - ax - share * dx, y - ay - share * dy
        away = math.hypot(ux, uy)
        if away == 0.0:
            return 0.0, 1.0, 0.0, True
        return away, ux / away, uy / away, not 0.0 < share < 1.0
    if piece < edges + discs:
        cx, cy, radius = goal.discs[piece - edges]
        away = math.hypot(x - cx, y - cy)
        if away == 0.0:
            return -radius, 1.0, 0.0, True
        return away - radius, (x - cx) / away, (y - cy) / away, radius <= 1e-3 * away
    nx, ny, offset = goal.half_planes[piece - edges - discs]
    return nx * x + ny * y - offset, nx, ny, False


@inner
def _jacobian(out: Floats, joints: Floats, relative: bool) -> None:
    """Velocity of the tip for unit velocities of the joints, shape (n, 2)."""
    n = len(joints) - 1
    for j in range(n):
        far = n if relative else j + 1
        out[j, 0] = joints[j, 1] - joints[far, 1]
        out[j, 1] = joints[far, 0] - joints[j, 0]


@inner
def _step(out: Floats, rows: Floats, at: Floats, low: Floats, high: Floats, rx: float, ry: float, flat: bool) -> None:
    """Least turn of the joints that would move the tip by ``r``, or for a flat piece by as much along it as may be.

    A joint at the end of its cell that would have to turn further is held, and the others turn for it.
    """
    n = len(at)
    held = np.zeros(n, dtype=np.bool_)
    for _ in range(n + 1):
        xx = xy = yy = 0.0
        for j in range(n):
            if not held[j]:
                xx += rows[j, 0] * rows[j, 0]
                xy += rows[j, 0] * rows[j, 1]
                yy += rows[j, 1] * rows[j, 1]
        if flat:
            squared = rx * rx * xx + 2.0 * rx * ry * xy + ry * ry * yy
            scale = 0.0 if squared == 0.0 else (rx * rx + ry * ry) / squared
            px, py = scale * rx, scale * ry
        else:
            more = 1e-14 * (xx + yy)
            xx += more
            yy += more
            det = xx * yy - xy * xy
            px, py = (0.0, 0.0) if det <= 0.0 else ((yy * rx - xy * ry) / det, (xx * ry - xy * rx) / det)
        again = False
        for j in range(n):
            out[j] = 0.0 if held[j] else rows[j, 0] * px + rows[j, 1] * py
            if (out[j] > 0.0 and at[j] >= high[j]) or (out[j] < 0.0 and at[j] <= low[j]):
                held[j] = True
                again = True
        if not again:
            return


@inner
def _solve(
    at: Floats, low: Floats, high: Floats, piece: int, work: Floats, joints: Floats,
    lengths: Floats, base: Floats, relative: bool, goal: Solids, least: float,
) -> float:  # fmt: skip
    """Turn the joints within a cell until the tip touches a piece; distance of the nearest place found, which is left.

    Newton's steps, cut off at the borders of the cell.
    """
    n = len(at)
    rows, step, best = work[:, :2], work[:, 2], work[:, 3]
    nearest, stuck = math.inf, 0
    for _ in range(STEPS):
        _place(joints, n - 1, at, lengths, base, relative)
        away, ux, uy, corner = _towards(joints[n, 0], joints[n, 1], piece, goal)
        stuck = 0 if away < 0.7 * nearest else stuck + 1
        if away < nearest:
            nearest = away
            best[:] = at
        if nearest <= least or stuck > 3:
            break
        _jacobian(rows, joints, relative)
        _step(step, rows, at, low, high, -away * ux, -away * uy, not corner)
        for j in range(n):
            at[j] = min(high[j], max(low[j], at[j] + step[j]))
    at[:] = best
    return nearest


@inner
def _find(
    found: Floats, middle: Floats, half: Floats, stack: Floats, work: Floats, joints: Floats,
    lengths: Floats, base: Floats, relative: bool, goal: Solids, tolerance: float,
) -> bool:  # fmt: skip
    """Whether a cell holds a configuration with the tip in a region, and one of them.

    Branch and bound: a part of the cell is left out if the tip cannot come from where it is at its middle to any piece
    of the region's border; it moves by at most ``chord times lever``, summed over the joints, and away from a convex
    piece by at most ``|u . J| half`` and, for what the Jacobian leaves out, half of ``length times turn**2``, summed
    over the links.  Elsewhere Newton's steps look for a configuration; where they fail the part is cut in two.
    """
    n = len(middle)
    low, high, at, rows = work[:, 4], work[:, 5], work[:, 6], work[:, :2]
    low[:] = middle - half
    high[:] = middle + half
    stack[0, 0], stack[0, 1] = middle, half
    size, looked = 1, 0
    pieces = len(goal.edges) + len(goal.discs) + len(goal.half_planes)
    while size > 0 and looked < BOXES:
        size -= 1
        looked += 1
        at[:] = stack[size, 0]
        _place(joints, n - 1, at, lengths, base, relative)
        x, y = joints[n, 0], joints[n, 1]
        if _near_solids(x, y, x, y, 0.0, goal):
            found[:] = at
            return True
        _jacobian(rows, joints, relative)
        travel = curved = turn = most = 0.0
        widest = 0
        for j in range(n):
            width = stack[size, 1, j]
            turn = turn + width if relative else width
            curved += 0.5 * lengths[j] * turn * turn
            moved = 2.0 * math.sin(min(width, math.pi) / 2) * math.hypot(rows[j, 0], rows[j, 1])
            travel += moved
            if width * lengths[j] + moved > most:
                most, widest = width * lengths[j] + moved, j
        aim, closest = -1, math.inf
        for piece in range(pieces):
            away, ux, uy, _ = _towards(x, y, piece, goal)
            if away > travel + tolerance or away >= closest:
                continue
            straight = curved
            for j in range(n):
                straight += abs(ux * rows[j, 0] + uy * rows[j, 1]) * stack[size, 1, j]
            if away <= straight + tolerance:
                aim, closest = piece, away
        if aim < 0:
            continue
        if _solve(at, low, high, aim, work, joints, lengths, base, relative, goal, 1e-6 * tolerance) <= tolerance:
            found[:] = at
            return True
        if size + 2 > DEPTH:
            return False
        stack[size + 1] = stack[size]
        stack[size, 1, widest] /= 2
        stack[size + 1, 1, widest] /= 2
        stack[size, 0, widest] -= stack[size, 1, widest]
        stack[size + 1, 0, widest] += stack[size + 1, 1, widest]
        size += 2
    return False


@njit(cache=True)
def find_tips(
    out: Flags, points: Floats, first: int, counts: Integers, lower: Floats, widths: Floats,
    lengths: Floats, base: Floats, relative: bool, goal: Solids, bounds: Floats, tolerance: float,
) -> None:  # fmt: skip
    """Find the cells that hold a configuration with the tip in a region, and one for each.

    Parameters
    ----------
    out : ndarray of bool, shape (m,)
        Set to True for every such cell.
    points : ndarray of float64, shape (m, n)
        The configurations; other rows are left alone.
    first : int
        Number of the first cell, in C order.
    counts : ndarray of int64, shape (n,)
        Cells along each joint.
    lower, widths : ndarray of float64, shape (n,)
        Where the axes begin, and the width of a cell, in radians.
    lengths : ndarray of float64, shape (n,)
        Of the links.
    base : ndarray of float64, shape (3,)
        Position and angle.
    relative : bool
        As in `resgrid.robots.arm.Arm`.
    goal : Solids
        The region.
    bounds : ndarray of float64, shape (4,)
        Smallest ``x, y`` and largest ``x, y`` of where the tip is at the middle of such a cell.
    tolerance : float
        How near the region the tip counts as in it.
    """
    n = len(counts)
    middle, half, found = np.empty(n), widths / 2, np.empty(n)
    stack, work, joints = np.empty((DEPTH, 2, n)), np.empty((n, 7)), np.empty((n + 1, 2))
    for row in range(len(out)):
        rest = first + row
        for j in range(n - 1, -1, -1):
            middle[j] = lower[j] + (rest % counts[j] + 0.5) * widths[j]
            rest //= counts[j]
        _place(joints, n - 1, middle, lengths, base, relative)
        if not (bounds[0] <= joints[n, 0] <= bounds[2] and bounds[1] <= joints[n, 1] <= bounds[3]):
            continue
        if _find(found, middle, half, stack, work, joints, lengths, base, relative, goal, tolerance):
            out[row] = True
            points[row] = found
