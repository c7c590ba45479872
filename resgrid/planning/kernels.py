"""Compiled loops of the planner: Pollock's streamlines, and distances to obstacle cells.

Numba takes seconds to import: only functions that are about to trace import this module.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import inlined, inner, kernel

REACHED, NO_CURRENT, ENDLESS = 0, 1, 2
MIXED = -2
_FREE, _GOAL = 0, 2

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class Flow(NamedTuple):
    """A field as the tracing kernels take it: flat arrays.

    The lower face of cell ``c`` across axis ``a`` has number ``first_face[a] + sum_b c_b face_stride[a, b]``.

    `code` (cells,); `shape` (ndim,); `spacing` (ndim,); `first_face` (ndim,); `face_stride` (ndim, ndim); `direction`
    (faces,); `log_current` (faces,).
    """

    code: NDArray[np.uint8]
    shape: NDArray[np.int64]
    spacing: NDArray[np.float64]
    first_face: NDArray[np.int64]
    face_stride: NDArray[np.int64]
    direction: NDArray[np.int8]
    log_current: NDArray[np.float64]


@inlined
def _unravel(flat: int, shape: Integers, cell: Integers) -> None:
    for axis in range(len(shape) - 1, -1, -1):
        cell[axis] = flat % shape[axis]
        flat //= shape[axis]


@inlined
def ravel(cell: Integers, shape: Integers) -> int:
    """Number of a cell in C order."""
    flat = 0
    for axis in range(len(shape)):
        flat = flat * shape[axis] + cell[axis]
    return flat


@inlined
def _face(flow: Flow, cell: Integers, axis: int) -> int:
    """Number of the lower face of a cell across an axis."""
    face: int = flow.first_face[axis]
    for other in range(len(cell)):
        face += cell[other] * flow.face_stride[axis, other]
    return face


@inner
def face_velocities(flow: Flow, cell: Integers, lower: Floats, upper: Floats) -> float:
    """Velocities on the lower and upper faces of a cell, scaled to a maximum of 1; returns the log of the scale."""
    scale = -np.inf
    for axis in range(len(cell)):
        face = _face(flow, cell, axis)
        scale = max(scale, flow.log_current[face], flow.log_current[face + flow.face_stride[axis, axis]])
    for axis in range(len(cell)):
        face = _face(flow, cell, axis)
        above = face + flow.face_stride[axis, axis]
        lower[axis] = flow.direction[face] * math.exp(flow.log_current[face] - scale)
        upper[axis] = flow.direction[above] * math.exp(flow.log_current[above] - scale)
    return scale


@inlined
def _exit_time(x: float, lower: float, upper: float) -> tuple[float, int]:
    """Time until a point at ``x`` in [0, 1] leaves by either face, and by which (-1, 1; 0 for never).

    The velocity is linear between the faces, ``v(x) = lower (1 - x) + upper x`` (Pollock 1988, equations 4 to 8), so
    the time over a distance ``d`` from velocity ``v`` to ``w`` is ``d log(w / v) / (w - v)``.
    """
    v = lower * (1.0 - x) + upper * x
    if v > 0.0 and upper > 0.0:
        distance, speed, final, side = 1.0 - x, v, upper, 1
    elif v < 0.0 and lower < 0.0:
        distance, speed, final, side = x, -v, -lower, -1
    else:
        return np.inf, 0
    z = final / speed - 1.0
    if abs(z) < 1e-8:
        return distance / speed * (1.0 - 0.5 * z), side
    return distance / speed * (math.log1p(z) / z), side


@inlined
def _moved(x: float, lower: float, upper: float, time: float) -> float:
    """Where a point at ``x`` is after a time, within its cell."""
    v = lower * (1.0 - x) + upper * x
    if v == 0.0:
        return x  # however long: the growth may overflow
    rate = upper - lower
    growth = rate * time
    step = v * time * (1.0 + 0.5 * growth) if abs(growth) < 1e-8 else v * math.expm1(growth) / rate
    return min(max(x + step, 0.0), 1.0)


@inner
def _first_exit(local: Floats, lower: Floats, upper: Floats) -> tuple[float, int, int]:
    """Time, axis and side of the first exit in finite time; axis -1 for none."""
    time, across, side = np.inf, -1, 0
    for axis in range(len(local)):
        axis_time, axis_side = _exit_time(local[axis], lower[axis], upper[axis])
        if axis_time < time:
            time, across, side = axis_time, axis, axis_side
    return time, across, side


@inner
def _strongest_exit(lower: Floats, upper: Floats) -> tuple[float, int, int]:
    """Speed, axis and side of the face with the largest outward current; axis -1 for none."""
    speed, across, side = 0.0, -1, 0
    for axis in range(len(lower)):
        if upper[axis] > speed:
            speed, across, side = upper[axis], axis, 1
        if -lower[axis] > speed:
            speed, across, side = -lower[axis], axis, -1
    return speed, across, side


@inner
def _cross(local: Floats, lower: Floats, upper: Floats, spacing: Floats) -> tuple[float, float, int, int]:
    """Move a point to where it leaves its cell; returns time, length, axis (-1: stuck) and side."""
    time, across, side = _first_exit(local, lower, upper)
    drifts = across >= 0
    if not drifts:
        # A stagnation point, or a line that leads to one: straight through the strongest face.
        speed, across, side = _strongest_exit(lower, upper)
        if across < 0:
            return 0.0, 0.0, across, side
        time = (1.0 - local[across] if side > 0 else local[across]) / speed
    squares = 0.0
    for axis in range(len(local)):
        there = local[axis]
        if axis == across:
            there = 1.0 if side > 0 else 0.0
        elif drifts:
            there = _moved(local[axis], lower[axis], upper[axis], time)
        squares += ((there - local[axis]) * spacing[axis]) ** 2
        local[axis] = there
    return time, math.sqrt(squares), across, side


@inlined
def _log_add(a: float, b: float) -> float:
    if a < b:
        a, b = b, a
    return a if b == -np.inf else a + math.log1p(math.exp(b - a))


@kernel
def trace(flow: Flow, cell: Integers, local: Floats, cells: Integers, locals_: Floats) -> tuple[int, int, float, float]:
    """Follow the current from one point until it enters a goal cell.

    ``cell`` and ``local`` (position within the cell, each coordinate in [0, 1]) are the start, and on return the end.
    The first ``len(cells)`` cells and positions visited are recorded in ``cells`` and ``locals_``.

    Returns ``(outcome, steps, length, log of the time)``, the time in units where a velocity is a current.
    """
    ndim = len(cell)
    lower, upper = np.empty(ndim), np.empty(ndim)
    length, log_time = 0.0, -np.inf
    limit = flow.code.size
    for step in range(limit):
        if step < len(cells):
            for axis in range(ndim):
                cells[step, axis], locals_[step, axis] = cell[axis], local[axis]
        if flow.code[ravel(cell, flow.shape)] == _GOAL:
            return REACHED, step, length, log_time
        scale = face_velocities(flow, cell, lower, upper)
        if scale == -np.inf:
            return NO_CURRENT, step, length, log_time
        time, distance, across, side = _cross(local, lower, upper, flow.spacing)
        if across < 0:
            return NO_CURRENT, step, length, log_time
        length += distance
        if time > 0.0:
            log_time = _log_add(log_time, math.log(time) - scale)
        cell[across] = (cell[across] + side) % flow.shape[across]
        local[across] = 0.0 if side > 0 else 1.0
    return ENDLESS, limit, length, log_time


@kernel
def only_goal(flow: Flow, goal: Integers, periodic: NDArray[np.bool_]) -> Integers:
    """The goal to which the current leads from every cell, whichever face it takes.

    ``goal`` is the goal region of goal cells.  A free cell gets -1 if all lines from it end where no current leaves,
    `MIXED` if they end differently.  Cells are settled in the order of the current, the most downstream ones first.
    """
    count, ndim = len(flow.code), len(flow.shape)
    label, exits = np.full(count, MIXED), np.zeros(count, np.int64)
    seen = np.zeros(count, np.bool_)
    queue, cell = np.empty(count, np.int64), np.empty(ndim, np.int64)
    first, last = 0, 0
    for flat in range(count):
        _unravel(flat, flow.shape, cell)
        for axis in range(ndim):
            face = _face(flow, cell, axis)
            exits[flat] += (flow.direction[face] < 0) + (flow.direction[face + flow.face_stride[axis, axis]] > 0)
        if flow.code[flat] == _GOAL or exits[flat] == 0:
            label[flat] = goal[flat] if flow.code[flat] == _GOAL else -1
            seen[flat] = True
            queue[last] = flat
            last += 1
    while first < last:
        flat = queue[first]
        first += 1
        _unravel(flat, flow.shape, cell)
        for axis in range(ndim):
            face, home = _face(flow, cell, axis), cell[axis]
            for side in (-1, 1):
                if side * flow.direction[face + (side > 0) * flow.face_stride[axis, axis]] >= 0:
                    continue
                if not periodic[axis] and not 0 <= home + side < flow.shape[axis]:
                    continue
                cell[axis] = (home + side) % flow.shape[axis]
                above = ravel(cell, flow.shape)
                cell[axis] = home
                if flow.code[above] != _FREE:
                    continue
                label[above] = label[flat] if not seen[above] or label[above] == label[flat] else MIXED
                seen[above] = True
                exits[above] -= 1
                if exits[above] == 0:
                    queue[last] = above
                    last += 1
    for flat in range(count):
        if exits[flat] > 0 and flow.code[flat] == _FREE:
            label[flat] = MIXED
    return label


@kernel
def trace_many(
    flow: Flow, starts: Integers, locals_: Floats, outcome: Integers, steps: Integers, length: Floats, log_time: Floats
) -> None:
    """Trace many starts; ``starts`` and ``locals_`` end as the last cells and positions."""
    no_cells, no_locals = np.empty((0, starts.shape[1]), np.int64), np.empty((0, starts.shape[1]))
    for k in range(len(starts)):
        outcome[k], steps[k], length[k], log_time[k] = trace(flow, starts[k], locals_[k], no_cells, no_locals)


@inner
def segment_to_box(start: Floats, end: Floats, lower: Floats, upper: Floats) -> float:
    """Distance from a segment to an axis-parallel box, by bisection on the derivative of the (convex) square."""
    a, b = 0.0, 1.0
    for _ in range(54):
        t = 0.5 * (a + b)
        slope = 0.0
        for axis in range(len(start)):
            step = end[axis] - start[axis]
            x = start[axis] + t * step
            slope += step * (min(x - lower[axis], 0.0) + max(x - upper[axis], 0.0))
        if slope > 0.0:
            b = t
        elif slope < 0.0:
            a = t
        else:
            a = b = t
            break
    t = 0.5 * (a + b)
    squares = 0.0
    for axis in range(len(start)):
        x = start[axis] + t * (end[axis] - start[axis])
        squares += (min(x - lower[axis], 0.0) + max(x - upper[axis], 0.0)) ** 2
    return math.sqrt(squares)


@kernel
def clearance(
    cells: Integers,
    starts: Floats,
    ends: Floats,
    reach: Floats,
    obstacle: NDArray[np.bool_],
    shape: Integers,
    spacing: Floats,
    periodic: NDArray[np.bool_],
) -> float:
    """Smallest distance from segments, each within its cell, to obstacle cells.

    ``starts`` and ``ends`` are in axis units from the cell's own lower corner; ``reach[k]`` bounds from above how far
    the nearest obstacle box is from segment ``k``; segments come in ascending order of it.
    """
    ndim = len(shape)
    best = np.inf
    diagonal = 0.0
    for axis in range(ndim):
        diagonal = math.hypot(diagonal, spacing[axis])
    low, extent, at = np.empty(ndim, np.int64), np.empty(ndim, np.int64), np.empty(ndim, np.int64)
    box_low, box_high = np.empty(ndim), np.empty(ndim)
    for k in range(len(cells)):
        if reach[k] - 2.0 * diagonal > best:
            break
        within = min(best, reach[k])
        total = 1
        for axis in range(ndim):
            away = math.ceil(within / spacing[axis]) + 1
            if periodic[axis]:  # beyond half a turn another copy of the same box is nearer
                low[axis] = -min(away, shape[axis] // 2 + 1)
                extent[axis] = 1 - 2 * low[axis]
            else:
                low[axis] = max(-away, -cells[k, axis])
                extent[axis] = min(away, shape[axis] - 1 - cells[k, axis]) - low[axis] + 1
            total *= extent[axis]
        for number in range(total):
            _unravel(number, extent, at)
            flat = 0
            for axis in range(ndim):
                at[axis] += low[axis]
                flat = flat * shape[axis] + (cells[k, axis] + at[axis]) % shape[axis]
            if not obstacle[flat]:
                continue
            for axis in range(ndim):
                box_low[axis] = at[axis] * spacing[axis]
                box_high[axis] = (at[axis] + 1) * spacing[axis]
            best = min(best, segment_to_box(starts[k], ends[k], box_low, box_high))
    return best


@kernel
def segment_is_free(
    start: Floats, end: Floats, free: NDArray[np.bool_], shape: Integers, periodic: NDArray[np.bool_], rim: float
) -> bool:
    """Whether every closed cell that a closed segment touches is free; in units of cells, continuous.

    Cells count as larger by ``rim`` on every side, so that rounding can only add cells.  Beyond the grid nothing is
    free.  Slab by slab along the longest component; in each, the cells that the segment's box meets are tested one by
    one, which makes the set exact in any number of dimensions.
    """
    ndim = len(shape)
    major = 0
    for axis in range(1, ndim):
        if abs(end[axis] - start[axis]) > abs(end[major] - start[major]):
            major = axis
    low, extent, at = np.empty(ndim, np.int64), np.empty(ndim, np.int64), np.empty(ndim, np.int64)
    first = math.ceil(min(start[major], end[major]) - rim - 1.0)
    last = math.floor(max(start[major], end[major]) + rim)
    for slab in range(first, last + 1):
        enter, leave = _slab_shares(start[major], end[major], slab, rim, 0.0, 1.0)
        total = 1
        for axis in range(ndim):
            a = start[axis] + enter * (end[axis] - start[axis])
            b = start[axis] + leave * (end[axis] - start[axis])
            low[axis] = slab if axis == major else math.ceil(min(a, b) - rim - 1.0)
            extent[axis] = 1 if axis == major else math.floor(max(a, b) + rim) - low[axis] + 1
            total *= extent[axis]
        for number in range(total):
            _unravel(number, extent, at)
            flat, inside, t0, t1 = 0, True, 0.0, 1.0
            for axis in range(ndim - 1, -1, -1):
                at[axis] += low[axis]
                t0, t1 = _slab_shares(start[axis], end[axis], at[axis], rim, t0, t1)
            if t0 > t1:
                continue
            for axis in range(ndim):
                index = at[axis] % shape[axis] if periodic[axis] else at[axis]
                inside &= 0 <= index < shape[axis]
                flat = flat * shape[axis] + index
            if not inside or not free[flat]:
                return False
    return True


@inlined
def _slab_shares(a: float, b: float, index: int, rim: float, t0: float, t1: float) -> tuple[float, float]:
    """Part of the line from ``a`` to ``b`` that lies in the cells ``index``, within the part from t0 to t1."""
    if a == b:
        return (t0, t1) if index - rim <= a <= index + 1 + rim else (1.0, 0.0)
    enter, leave = (index - rim - a) / (b - a), (index + 1 + rim - a) / (b - a)
    if enter > leave:
        enter, leave = leave, enter
    return max(t0, enter), min(t1, leave)
