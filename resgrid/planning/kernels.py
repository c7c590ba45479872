"""Compiled kernels of the planner: Pollock tracing of streamlines, and distances from segments to obstacle cells.

Import this module only inside functions that call a kernel, because importing numba takes seconds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import inlined, inner, kernel

REACHED, NO_CURRENT, ENDLESS = 0, 1, 2  # end in a goal cell; in a cell without outgoing current; more steps than cells
MIXED, _FREE, _GOAL = -2, 0, 2  # label of cells whose current leads to several goals; `Cell.FREE` and `Cell.GOAL`

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class Flow(NamedTuple):
    """A field as flat arrays, the input of the tracing kernels.

    The lower face of cell ``c`` across axis ``a`` has the index ``first_face[a] + sum_b c_b face_stride[a, b]``.

    `code` (cells,): `Cell` codes, with `GOAL` wherever streamlines end; `shape` (ndim,): number of cells per axis;
    `spacing` (ndim,): cell widths in axis units; `first_face` (ndim,) and `face_stride` (ndim, ndim): see above;
    `direction` (faces,): sign of the current along the axis; `log_current` (faces,): natural log of its magnitude.
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
    """Write the multi-index of a flat C-order index into `cell` (ndim,); `shape` (ndim,): number of cells per axis."""
    for axis in range(len(shape) - 1, -1, -1):
        cell[axis] = flat % shape[axis]
        flat //= shape[axis]


@inlined
def ravel(cell: Integers, shape: Integers) -> int:
    """Return the flat C-order index of a cell (ndim,); `shape` (ndim,): number of cells per axis."""
    flat = 0
    for axis in range(len(shape)):
        flat = flat * shape[axis] + cell[axis]
    return flat


@inlined
def _face(flow: Flow, cell: Integers, axis: int) -> int:
    """Return the index, in the flat arrays of `flow`, of the lower face of a cell (ndim,) across an axis."""
    face: int = flow.first_face[axis]
    for other in range(len(cell)):
        face += cell[other] * flow.face_stride[axis, other]
    return face


@inlined
def face_velocities(flow: Flow, cell: Integers, lower: Floats, upper: Floats) -> float:
    """Write a cell's face currents over the largest magnitude m to `lower, upper` (ndim,); return ln m, -inf for 0."""
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
    """Return the time from ``x`` in [0, 1] to an exit along one axis, and its face: -1 lower, 1 upper; (inf, 0): none.

    ``v(x) = lower (1 - x) + upper x``: the velocity is linear between the faces (Pollock 1988, equations 4 to 8).
    The time over a distance ``d``, at a velocity that changes from ``v`` to ``w``, is ``d log(w / v) / (w - v)``.
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
    """Return the coordinate in [0, 1] a `time` after ``x``, for a velocity linear from `lower` at 0 to `upper` at 1."""
    v = lower * (1.0 - x) + upper * x
    if v == 0.0:
        return x  # a separate case: with a large time the growth may overflow
    rate = upper - lower
    growth = rate * time
    step = v * time * (1.0 + 0.5 * growth) if abs(growth) < 1e-8 else v * math.expm1(growth) / rate
    return min(max(x + step, 0.0), 1.0)


@inlined
def _first_exit(local: Floats, lower: Floats, upper: Floats) -> tuple[float, int, int]:
    """Return time, axis (-1: none), side (-1 lower, 1 upper) of the first exit from `local`, for face velocities."""
    time, across, side = np.inf, -1, 0
    for axis in range(len(local)):
        axis_time, axis_side = _exit_time(local[axis], lower[axis], upper[axis])
        if axis_time < time:
            time, across, side = axis_time, axis, axis_side
    return time, across, side


@inlined
def _strongest_exit(lower: Floats, upper: Floats) -> tuple[float, int, int]:
    """Return the largest outward velocity at a face, its axis (-1: none) and side (-1: lower, 1: upper face)."""
    speed, across, side = 0.0, -1, 0
    for axis in range(len(lower)):
        if upper[axis] > speed:
            speed, across, side = upper[axis], axis, 1
        if -lower[axis] > speed:
            speed, across, side = -lower[axis], axis, -1
    return speed, across, side


@inlined
def _cross(local: Floats, lower: Floats, upper: Floats, spacing: Floats) -> tuple[float, float, int, int]:
    """Move `local` (0 to 1) to its cell's exit face; return time, length, axis (-1: none), side (-1 lower, 1 upper)."""
    time, across, side = _first_exit(local, lower, upper)
    drifts = across >= 0
    if not drifts:
        # A stagnation point, or a line that ends in one: move straight to the face with the largest current.
        speed, across, side = _strongest_exit(lower, upper)
        # The function has one exit, because numba counts references to the arrays in each step if it has several.
        time = (1.0 - local[across] if side > 0 else local[across]) / speed if across >= 0 else 0.0
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
    """Return ``log(exp(a) + exp(b))`` without overflow."""
    if a < b:
        a, b = b, a
    return a if b == -np.inf else a + math.log1p(math.exp(b - a))


@kernel
def trace(flow: Flow, cell: Integers, local: Floats, cells: Integers, locals_: Floats) -> tuple[int, int, float, float]:
    """Follow the current from one point until it enters a goal cell, or a cell that no current leaves.

    ``cell`` (ndim,) and ``local`` (ndim,), the position within the cell in [0, 1], hold the start on entry and the end
    on return.  The first n visited cells and entry positions are written to ``cells`` and ``locals_`` (n, ndim).
    Return outcome (`REACHED`, `NO_CURRENT`, or `ENDLESS` after as many steps as cells), number of crossings, length in
    axis units, and natural log of the time, in the unit for which velocities equal face currents.
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
    """Return the index of the goal region at which all current lines from each cell end, shape (cells,).

    The result is -1 if all lines from a free cell end in cells without outward current, and `MIXED` if they end in
    different regions; it has no meaning for obstacle cells.  Cells are labelled downstream first.
    ``goal`` (cells,): index of the goal region of every goal cell; ``periodic`` (ndim,): mask of periodic axes.
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
    """Trace streamlines from n starts, and write the results of `trace` for each to four arrays (n,).

    ``starts`` and ``locals_`` (n, ndim) hold cells and positions within them at the starts on entry, and at the ends on
    return.  Results: ``outcome``: `REACHED`, `NO_CURRENT` or `ENDLESS`; ``steps``: number of crossed faces; ``length``:
    in axis units; ``log_time``: natural log of the time, for velocities equal to face currents.
    """
    no_cells, no_locals = np.empty((0, starts.shape[1]), np.int64), np.empty((0, starts.shape[1]))
    for k in range(len(starts)):
        outcome[k], steps[k], length[k], log_time[k] = trace(flow, starts[k], locals_[k], no_cells, no_locals)


@inner
def segment_to_box(start: Floats, end: Floats, lower: Floats, upper: Floats) -> float:
    """Return the distance from a segment `start, end` to a box `lower, upper` (corners, (ndim,)), by bisection."""
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
    """Return the smallest distance, in axis units, from n segments to the box of an obstacle cell; inf without any.

    ``cells`` (n, ndim): cell of each segment; ``starts``, ``ends`` (n, ndim): end points in axis units, relative to the
    cell's lower corner; ``reach`` (n,): upper bounds of each segment's distance, ascending; ``obstacle`` (cells,): mask
    in C order; ``shape, spacing, periodic`` (ndim,): number of cells, cell width, and whether the axis is periodic.
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
            if periodic[axis]:  # beyond half a period, another periodic image of the same cell is nearer
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
    """Return whether every closed cell that a closed segment touches is free.

    ``start, end`` (ndim,): in cell units, continuous across seams; ``free`` (cells,): mask in C order; ``shape``,
    ``periodic`` (ndim,): number of cells, and whether the axis is periodic; ``rim``: margin, in cell units, by which
    cells are enlarged.  Cells outside the grid are not free.  In each layer of cells across the axis of the segment's
    longest component, every cell in the bounding box of the segment's part is tested: the set of cells is exact.
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
        enter, leave = _clip_to_slab(start[major], end[major], slab, rim, 0.0, 1.0)
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
                t0, t1 = _clip_to_slab(start[axis], end[axis], at[axis], rim, t0, t1)
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
def _clip_to_slab(a: float, b: float, index: int, rim: float, t0: float, t1: float) -> tuple[float, float]:
    """Return the part of [t0, t1] where ``a + t (b - a)`` is in [index - rim, index + 1 + rim]; t0 > t1 if empty."""
    if a == b:
        return (t0, t1) if index - rim <= a <= index + 1 + rim else (1.0, 0.0)
    enter, leave = (index - rim - a) / (b - a), (index + 1 + rim - a) / (b - a)
    if enter > leave:
        enter, leave = leave, enter
    return max(t0, enter), min(t1, leave)
