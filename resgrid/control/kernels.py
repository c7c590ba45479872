"""Compiled loops of control: the nominal direction at a configuration, and relaxation.

Numba takes seconds to import: only functions that are about to run import this module.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import inlined, inner, kernel
from resgrid.planning.kernels import Flow, face_velocities, ravel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

MOVES, GOAL, OFF, OUTSIDE, NOT_FINITE = 0, 1, 2, 3, 4
_GOAL = 2
_EDGE = 1e-9
_BORDER = 2e-9
_OFF = 3e-9
_NOTHING = 4e-9
"""Shares of a cell: beyond a face that was crossed, a border's width, off it, and around where a component is 0."""

_LITTLE = 1e-3


class FlowGrid(NamedTuple):
    """A field's flow, and where its cells lie.

    `served` (cells,): whether each is a goal or has a path to one; `corner, periodic` (n,): of the axes.
    """

    flow: Flow
    served: NDArray[np.bool_]
    corner: Floats
    periodic: NDArray[np.bool_]


@inner
def _cell_at(grid: FlowGrid, point: Floats, cell: Integers, local: Floats) -> int:
    """Cell of a point, and where in it the point is, each coordinate in [0, 1]; returns a status."""
    for axis in range(len(cell)):
        count = grid.flow.shape[axis]
        x = (point[axis] - grid.corner[axis]) / grid.flow.spacing[axis]
        if not math.isfinite(x):
            return NOT_FINITE
        if grid.periodic[axis]:
            x -= count * math.floor(x / count)
        elif x < -_EDGE or x > count + _EDGE:
            return OUTSIDE
        cell[axis] = min(max(math.floor(x), 0), count - 1)
        local[axis] = min(max(x - cell[axis], 0.0), 1.0)
    return MOVES


@inlined
def _to_face(x: float, velocity: float, spacing: float) -> float:
    """Time until a point is just beyond the face ahead of it."""
    return ((1.0 - x if velocity > 0.0 else x) + _EDGE) * spacing / abs(velocity)


@inner
def _along_current(local: Floats, lower: Floats, upper: Floats, spacing: Floats, velocity: Floats) -> float:
    """Unit velocity within a cell, and how far a straight step may go; -1 where no current leaves.

    Each component is linear between its two faces (Pollock 1988).  One no larger than they change over `_NOTHING`
    of a cell is 0: the point lies where it vanishes, and what rounding leaves of it would take thousands of steps, each
    too short for the coordinates of a robot.
    """
    drifts, outward, out = False, 0.0, 0
    squares, decay = 0.0, 0.0
    for axis in range(len(local)):
        speed = lower[axis] * (1.0 - local[axis]) + upper[axis] * local[axis]
        if abs(speed) <= _NOTHING * (abs(lower[axis]) + abs(upper[axis])):
            speed = 0.0
        else:
            decay = max(decay, lower[axis] - upper[axis])
        drifts |= (speed > 0.0 and upper[axis] > 0.0) or (speed < 0.0 and lower[axis] < 0.0)
        velocity[axis] = speed * spacing[axis]
        squares += velocity[axis] ** 2
        if max(upper[axis], -lower[axis]) > outward:
            outward, out = max(upper[axis], -lower[axis]), axis
    if outward <= 0.0:
        return -1.0
    if not drifts:
        velocity[:] = 0.0
        velocity[out] = 1.0 if upper[out] >= -lower[out] else -1.0
        return _to_face(local[out], velocity[out], spacing[out])
    length = math.sqrt(squares)
    farthest = 0.5 * length / decay if decay > 0.0 else np.inf
    for axis in range(len(local)):
        velocity[axis] /= length
        if (velocity[axis] > 0.0 and upper[axis] > 0.0) or (velocity[axis] < 0.0 and lower[axis] < 0.0):
            farthest = min(farthest, _to_face(local[axis], velocity[axis], spacing[axis]))
    return farthest


@inner
def _cross(grid: FlowGrid, cell: Integers, local: Floats, lower: Floats, upper: Floats) -> bool:
    """Into the next cell, where a point lies on faces that current leaves by: by the largest; whether there is one."""
    out, step, outward = 0, 0, 0.0
    for axis in range(len(cell)):
        if local[axis] >= 1.0 - _BORDER and upper[axis] > outward:
            out, step, outward = axis, 1, upper[axis]
        if local[axis] <= _BORDER and -lower[axis] > outward:
            out, step, outward = axis, -1, -lower[axis]
    return step != 0 and _step(grid, cell, local, out, step)


@inner
def _keep_off(local: Floats, spacing: Floats, farthest: float, velocity: Floats) -> None:
    """Away from borders that nothing crosses, `_OFF` of a cell by the end of the step.

    On one it could lie on an edge where two cells meet that no current joins, and be taken to be in either.
    """
    for axis in range(len(local)):
        inward = 0.0
        if local[axis] <= _BORDER:
            inward = _OFF - local[axis]
        elif local[axis] >= 1.0 - _BORDER:
            inward = 1.0 - _OFF - local[axis]
        if inward != 0.0 and abs(inward) * spacing[axis] <= _LITTLE * farthest:
            velocity[axis] += inward * spacing[axis] / farthest


@inner
def _step(grid: FlowGrid, cell: Integers, local: Floats, axis: int, step: int) -> bool:
    """To the same place on a border as it belongs to the next cell; whether there is one."""
    other = cell[axis] + step
    if grid.periodic[axis]:
        other %= grid.flow.shape[axis]
    if other < 0 or other >= grid.flow.shape[axis]:
        return False
    cell[axis] = other
    local[axis] = 0.0 if step > 0 else 1.0
    return True


@inner
def _beside_served(grid: FlowGrid, cell: Integers, local: Floats) -> bool:
    """Into a cell with a path, where a point lies on its border but was rounded out of it; whether there is one."""
    for axis in range(len(cell)):
        step = 1 if local[axis] >= 1.0 - _BORDER else -1
        if step < 0 and local[axis] > _BORDER:
            continue
        own, at = cell[axis], local[axis]
        if _step(grid, cell, local, axis, step):
            if grid.served[ravel(cell, grid.flow.shape)]:
                return True
            cell[axis], local[axis] = own, at
    return False


@kernel
def nominal(
    flow: Flow, served: NDArray[np.bool_], corner: Floats, periodic: NDArray[np.bool_], point: Floats, velocity: Floats
) -> tuple[int, float]:
    """Unit velocity along the current at a point, as Pollock interpolates it within the point's cell.

    A point on a border belongs to the cell that current enters there, step by step down the potential: else a robot at
    a corner, where the cells before and behind it both lead back to the corner, would go to and fro for ever.  Where no
    axis leads out in finite time it points to the face with the largest outward current.  Returns a status,
    and how far a straight step may go: just across the next face that current leaves by, and no more than half way to
    where a component vanishes, so that no step ends beyond a face without outward current.
    """
    grid, ndim = FlowGrid(flow, served, corner, periodic), len(point)
    cell, local, lower, upper = np.empty(ndim, np.int64), np.empty(ndim), np.empty(ndim), np.empty(ndim)
    velocity[:] = 0.0
    status = _cell_at(grid, point, cell, local)
    if status != MOVES:
        return status, 0.0
    flat = ravel(cell, grid.flow.shape)
    if grid.flow.code[flat] == _GOAL:
        return GOAL, 0.0
    if not grid.served[flat] and not _beside_served(grid, cell, local):
        return OFF, 0.0
    if face_velocities(grid.flow, cell, lower, upper) == -np.inf:
        return OFF, 0.0
    for _ in range(2**ndim):
        farthest = _along_current(local, lower, upper, grid.flow.spacing, velocity)
        if not _cross(grid, cell, local, lower, upper):
            _keep_off(local, grid.flow.spacing, farthest, velocity)
            break
        if grid.flow.code[ravel(cell, grid.flow.shape)] == _GOAL:
            break
        face_velocities(grid.flow, cell, lower, upper)
    if farthest >= 0.0:
        return MOVES, farthest
    velocity[:] = 0.0
    return OFF, 0.0


@kernel
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
