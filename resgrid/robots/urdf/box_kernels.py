"""Compiled kernel that tests boxes of joint values: proofs that convex pieces stay apart, and likely collisions.

Import this module only inside functions that call a kernel, because importing numba takes seconds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from resgrid._internal.jit import inner, kernel
from resgrid.robots.urdf.arrays import Flags, Floats, Integers, TreeArrays
from resgrid.robots.urdf.bound_kernels import (
    BoxSweep,
    Frames,
    Search,
    ball_gap,
    copy,
    largest_gap,
    lowest,
    place,
    sweep_side,
    weigh_points,
)
from resgrid.robots.urdf.simplex_kernels import dot


class Boxes(NamedTuple):
    """Boxes of joint values, and items: the pairs of pieces that are not yet proven to stay apart in a box.

    `lower, upper` (n, m): lowest and highest values of the m moving joints in every box, in radians or metres; `first`
    (n + 1,): box i has the items ``first[i] .. first[i + 1] - 1``; `items` (t, 3): index of the pair of bodies, and
    indices of a convex piece of its first and of its second body; `hints` (t, 3): unit vectors from the second piece to
    the first one, in the world, along which the pieces are likely to be apart.
    """

    lower: Floats
    upper: Floats
    first: Integers
    items: Integers
    hints: Floats


class Findings(NamedTuple):
    """Results of the test of n boxes with t items (pairs of convex pieces); the worst item has the smallest bound.

    `is_open` (t,): whether an item is not proven to stay apart; `touching` (t,): whether the pieces of an open item
    overlap at the centre of the box, False if this was not tested; `weight` (n, m): bound in metres, for every moving
    joint, on the motion within the box of the pieces of the worst open item towards each other, not written for a box
    without open items; `probe` (n, m): configuration at which the pieces of the worst item overlap, in radians or
    metres, only written if there is one; `probe_item` (n,): index of the worst item, -1 without such a configuration;
    `counts` (2,): running numbers of evaluated bounds, and of tests of pieces at fixed configurations.
    """

    is_open: Flags
    touching: Flags
    weight: Floats
    probe: Floats
    probe_item: Integers
    counts: Integers


class Work(NamedTuple):
    """Work arrays of the test of one box of joint values.

    `frames, corner`: poses of the joints at the centre and at a corner of the box; `sweep`: motion of the two pieces of
    an item; `search`: arrays of the search for a separating direction; `middle, half` (m,): centre and half widths of
    the box, in radians or metres; `still` (m,): zeros, half widths of a fixed configuration; `slope` (m,): derivative
    of the gap between two pieces by every moving joint, in metres per joint unit; `target` (m,): tested configuration.
    """

    frames: Frames
    corner: Frames
    sweep: BoxSweep
    search: Search
    middle: Floats
    half: Floats
    still: Floats
    slope: Floats
    target: Floats


def new_work(tree: TreeArrays, joints: int) -> Work:
    """Return new work arrays; `tree`: joints and pieces; `joints`: number of moving joints."""
    points, count = int(np.diff(tree.first).max(initial=1)), len(tree.parent) + 1
    frames = [
        Frames(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((3, 3)))
        for _ in range(2)
    ]
    longest = tree.chain.shape[2]
    sweep = BoxSweep(
        piece=np.zeros(2, np.int64),
        frame=np.zeros(2, np.int64),
        chained=np.zeros(2, np.int64),
        joint=np.zeros((2, longest), np.int64),
        prismatic=np.zeros((2, longest), np.bool_),
        axis=np.zeros((2, longest, 3)),
        origin=np.zeros((2, longest, 3)),
        half=np.zeros((2, longest)),
        cosine=np.zeros((2, longest)),
        sine=np.zeros((2, longest)),
        chord=np.zeros((2, longest)),
        turn=np.zeros((2, longest)),
        ball=np.zeros((2, points)),
        level=np.zeros(points),
        point=np.zeros((2, 3)),
        vertex=np.zeros(2, np.int64),
    )
    search = Search(
        np.zeros(3), np.zeros(3), np.zeros((4, 3)), np.zeros(4), np.zeros(4), np.zeros(3), np.zeros(3), np.zeros(3)
    )
    return Work(frames[0], frames[1], sweep, search, *(np.zeros(joints) for _ in range(5)))


@inner
def _load(item: Integers, half: Floats, tree: TreeArrays, frames: Frames, sweep: BoxSweep, search: Search) -> None:
    """Write the motion of both pieces of an item to `sweep`, for joints that move within a box.

    `item` (3,): index of the pair of bodies, and indices of a piece of both; `half` (m,): half widths of the box in
    radians or metres; `frames`: poses of the joints at the centre of the box.
    """
    for side in range(2):
        sweep_side(side, item[1 + side], item[0], half, tree, frames, sweep, search)


@inner
def _gap(hint: Floats, margin: float, exact: bool, tree: TreeArrays, frames: Frames, work: Work) -> float:
    """Return a lower bound of the gap, in metres, between the two moving pieces of ``work.sweep``, less a margin.

    The direction of the bound is written to ``work.search.best``. `hint` (3,): direction at which the search starts;
    `margin`: distance in metres that is subtracted from the gap; `exact`: True continues the search to the direction of
    the largest gap, False ends the search at the first direction with a positive gap; `frames`: poses of the joints at
    the centre of the box.
    """
    for side in range(2):
        weigh_points(side, tree, work.sweep)
    copy(work.search.normal, hint)
    return largest_gap(margin, exact, tree, frames, work.sweep, work.search)


@inner
def _add_weights(side: int, weight: Floats, tree: TreeArrays, work: Work) -> None:
    """Add to `weight` (m,) bounds, in metres, on how far every moving joint moves a piece towards the other one.

    The motion is that of the vertex that comes closest to the other piece along the current direction. `side`: 0
    for the first piece of the item in ``work.sweep``, 1 for the second.
    """
    sweep = work.sweep
    vertex, n = sweep.vertex[side], work.search.local
    p = work.search.across
    for k in range(sweep.chained[side]):
        w, o = sweep.axis[side, k], sweep.origin[side, k]
        driver = tree.driver[sweep.joint[side, k]]
        if sweep.prismatic[side, k]:
            weight[driver] += sweep.half[side, k] * abs(dot(n, w))
            continue
        p[0], p[1], p[2] = tree.x[vertex] - o[0], tree.y[vertex] - o[1], tree.z[vertex] - o[2]
        height = dot(p, w)
        for i in range(3):
            p[i] -= height * w[i]
        tangent = (
            n[0] * (w[1] * p[2] - w[2] * p[1]) + n[1] * (w[2] * p[0] - w[0] * p[2]) + n[2] * (w[0] * p[1] - w[1] * p[0])
        )
        length = math.sqrt(dot(p, p))
        weight[driver] += sweep.sine[side, k] * abs(tangent) + sweep.chord[side, k] * length * (
            sweep.turn[side, k] + sweep.chord[side, k] / 2.0
        )


@inner
def _weigh(item: Integers, best: Floats, weight: Floats, tree: TreeArrays, work: Work) -> None:
    """Write to `weight` (m,) bounds on how far, in metres, moving joints move an item's pieces towards each other.

    `item` (3,): index of the pair of bodies, and indices of a piece of both; `best` (3,): unit vector from the second
    piece to the first, along which displacements are measured.
    """
    for d in range(len(weight)):
        weight[d] = 0.0
    _load(item, work.half, tree, work.frames, work.sweep, work.search)
    copy(work.search.normal, best)
    for side in range(2):
        weigh_points(side, tree, work.sweep)
        lowest(side, 1.0 - 2.0 * side, tree, work.frames, work.sweep, work.search)
        _add_weights(side, weight, tree, work)


@inner
def _slopes(item: Integers, tree: TreeArrays, work: Work) -> None:
    """Write the derivative of an item's gap by every moving joint to ``work.slope`` (m,), in metres per joint unit.

    The gap is the distance along the direction ``work.search.best`` between the points ``work.sweep.point`` of both
    pieces that are nearest to each other in this direction, at the centre of the box of joint values. `item` (3,):
    index of the pair of bodies, and indices of a piece of both; `tree`: joints and pieces of the robot.
    """
    for d in range(len(work.slope)):
        work.slope[d] = 0.0
    n, p, frames = work.search.best, work.search.across, work.frames
    for side in range(2):
        sign = 1.0 - 2.0 * side
        for joint in tree.chain[item[0], side]:
            if joint < 0:
                break
            w = frames.axis[joint + 1]
            driver, factor = tree.driver[joint], sign * tree.factor[joint]
            if tree.prismatic[joint]:
                work.slope[driver] += factor * dot(n, w)
                continue
            for i in range(3):
                p[i] = work.sweep.point[side, i] - frames.origin[joint + 1, i]
            work.slope[driver] += factor * (
                n[0] * (w[1] * p[2] - w[2] * p[1])
                + n[1] * (w[2] * p[0] - w[0] * p[2])
                + n[2] * (w[0] * p[1] - w[1] * p[0])
            )


@inner
def _probe(item: Integers, hint: Floats, probe: Floats, tree: TreeArrays, work: Work) -> int:
    """Return 1 if the pieces of an item overlap at the centre of the box, 2 if at one corner of the box, else 0.

    The corner is the one towards which every moving joint reduces the gap at the centre. The tested configuration,
    centre or corner, is written to `probe` (m,). `item` (3,): index of the pair of bodies, and indices of a piece of
    both; `hint` (3,): direction at which the search starts, replaced by the direction of the gap at the centre if the
    pieces are apart there.
    """
    _load(item, work.still, tree, work.frames, work.sweep, work.search)
    copy(probe, work.middle)
    if _gap(hint, 0.0, True, tree, work.frames, work) <= 0.0:
        return 1
    copy(hint, work.search.best)
    _slopes(item, tree, work)
    for d in range(len(probe)):
        probe[d] -= math.copysign(work.half[d], work.slope[d])
    place(probe, tree, work.corner)
    _load(item, work.still, tree, work.corner, work.sweep, work.search)
    return 2 if _gap(hint, 0.0, False, tree, work.corner, work) <= 0.0 else 0


@inner
def _bound_items(box: int, boxes: Boxes, margin: float, tree: TreeArrays, found: Findings, work: Work) -> int:
    """Mark the open items of a box in `found`; return the index of the open item with the smallest bound, -1 if none.

    An item (a pair of convex pieces) is open if no positive lower bound of its gap, less the margin, was found. The
    best direction of every item replaces its hint, the direction at which the search starts. `box`: number of the box;
    `margin`: distance in metres by which pieces must stay apart.
    """
    worst, least = -1, np.inf
    for i in range(boxes.first[box], boxes.first[box + 1]):
        item = boxes.items[i]
        _load(item, work.half, tree, work.frames, work.sweep, work.search)
        found.is_open[i] = found.touching[i] = False
        if not tree.flat[item[2]] and ball_gap(tree, work.frames, work.sweep) > margin:
            continue
        found.counts[0] += 1
        gap = _gap(boxes.hints[i], margin, False, tree, work.frames, work)
        copy(boxes.hints[i], work.search.best)
        if 0.0 < gap < math.inf:
            continue
        found.is_open[i] = True
        if gap < least:
            worst, least = i, gap
    return worst


@kernel
def bound_boxes(
    boxes: Boxes, excess: Floats, margin: float, probing: int, tree: TreeArrays, found: Findings, work: Work
) -> None:
    """Test boxes of joint values: prove that pairs of convex pieces stay apart, and find likely collisions.

    An item is a pair of pieces in a box, open if it is not proven to stay apart. The worst item of a box has the
    smallest lower bound of the gap; for this item, the motion of its pieces by every joint is computed too. `excess`
    (m,): rounding error of joint values, added to half widths; `margin`: distance in metres by which pieces must stay
    apart; `probing`: items that are tested at the centre of the box and at the corner at which their pieces are likely
    to be closest: 0 for none, 1 for the worst item, 2 for all open items; `found`: receives the results; `work`: work
    arrays, see `new_work`.
    """
    count = len(excess)
    for box in range(len(boxes.lower)):
        found.probe_item[box] = -1
        for d in range(count):
            work.middle[d] = 0.5 * (boxes.lower[box, d] + boxes.upper[box, d])
            work.half[d] = 0.5 * (boxes.upper[box, d] - boxes.lower[box, d]) + excess[d]
        place(work.middle, tree, work.frames)
        worst = _bound_items(box, boxes, margin, tree, found, work)
        if worst < 0:
            continue
        _weigh(boxes.items[worst], boxes.hints[worst], found.weight[box], tree, work)
        if probing == 0:
            continue
        for d in range(count):
            work.half[d] -= excess[d]
        for i in range(boxes.first[box], boxes.first[box + 1]):
            if i == worst or (probing == 2 and found.is_open[i]):
                found.counts[1] += 1
                outcome = _probe(boxes.items[i], boxes.hints[i], work.target, tree, work)
                found.touching[i] = outcome == 1
                if outcome > 0 and i == worst:
                    found.probe_item[box] = i
                    copy(found.probe[box], work.target)
