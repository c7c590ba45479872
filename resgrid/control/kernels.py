"""Compiled kernels of control: direction of motion at a configuration, and relaxation sweeps over the grid.

The direction follows the face currents of a field, with the velocities of `resgrid.planning.kernels`; the sweeps run on
any matrix in compressed rows.
Importing numba takes seconds, so that this module is imported only by functions that call a kernel.
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
_CLEARANCE = 3e-9
_VANISHING = 4e-9
"""Lengths as fractions of a cell width: `_EDGE`: overshoot beyond a crossed face; `_BORDER`: largest distance from a
face at which a point counts as on the border of its cell; `_CLEARANCE`: distance from the border to which points on the
border are moved; `_VANISHING`: half width of the interval around a zero of a velocity component in which the component
is set to 0.
"""

_LARGEST_TILT = 1e-3
"""Largest correction that moves the end of a step away from a border, as a fraction of the length of the step."""


class FlowGrid(NamedTuple):
    """Currents of a field, with the position of its cells.

    `flow`: face currents, cell widths and cell codes; `served` (cells,): mask of goal cells and of cells with a path to
    a goal; `corner` (n,): lower ends of the axes; `periodic` (n,): mask of the periodic axes.
    """

    flow: Flow
    served: NDArray[np.bool_]
    corner: Floats
    periodic: NDArray[np.bool_]


@inner
def _cell_at(grid: FlowGrid, point: Floats, cell: Integers, local: Floats) -> int:
    """Find the cell of a point; return the status `MOVES`, or `OUTSIDE` or `NOT_FINITE` for an invalid point.

    `grid`: currents and cells; `point` (n,): configuration in axis coordinates; `cell` (n,): output, index of the cell;
    `local` (n,): output, position in the cell, 0 to 1 along each axis.
    """
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
    """Return the time until a point lies 1e-9 of a cell width beyond the face in front of it, along one axis.

    `x`: position in the cell, 0 to 1; `velocity`: velocity component along the axis, in axis units per unit of time;
    `spacing`: cell width, in axis units.
    """
    return ((1.0 - x if velocity > 0.0 else x) + _EDGE) * spacing / abs(velocity)


@inner
def _along_current(local: Floats, lower: Floats, upper: Floats, spacing: Floats, velocity: Floats) -> float:
    """Compute the unit velocity within a cell; return the length of the longest straight step, -1 without outflow.

    Outflow is a current out of the cell through any of its faces.  Each component is linear between its two faces
    (Pollock 1988).  A component is set to 0 where it is at most 4e-9 of the sum of its magnitudes at both faces: the
    point lies at a zero of the component, and following the rounding error would take thousands of steps that are too
    short for the coordinates of a robot.

    `local` (n,): position in the cell, 0 to 1; `lower, upper` (n,): current through the lower and the upper face of
    each axis, positive along the axis; `spacing` (n,): cell widths; `velocity` (n,): output.  The length is in axis
    units.
    """
    drifts, outward, out = False, 0.0, 0
    squares, decay = 0.0, 0.0
    for axis in range(len(local)):
        speed = lower[axis] * (1.0 - local[axis]) + upper[axis] * local[axis]
        if abs(speed) <= _VANISHING * (abs(lower[axis]) + abs(upper[axis])):
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
    """Move a point that lies on cell faces with outward current across the face with the largest current.

    Returns whether the point was moved.  `grid`: currents and cells; `cell, local` (n,): cell of the point and position
    in the cell (0 to 1), both updated; `lower, upper` (n,): current through the lower and the upper face of each axis,
    positive along the axis.
    """
    out, step, outward = 0, 0, 0.0
    for axis in range(len(cell)):
        if local[axis] >= 1.0 - _BORDER and upper[axis] > outward:
            out, step, outward = axis, 1, upper[axis]
        if local[axis] <= _BORDER and -lower[axis] > outward:
            out, step, outward = axis, -1, -lower[axis]
    return step != 0 and _step(grid, cell, local, out, step)


@inner
def _keep_off(local: Floats, spacing: Floats, farthest: float, velocity: Floats) -> None:
    """Turn the velocity of a point on a border of its cell so that the step ends slightly inside the cell.

    The end lies 3e-9 of a cell width away from the border, along each axis along which the point is on a border. On a
    border without current the point could belong to either of two cells without a current between them. A turn by more
    than 1e-3 is omitted. `local` (n,): position in the cell, 0 to 1; `spacing` (n,): cell widths; `farthest`: length of
    the step, in axis units; `velocity` (n,): direction, updated.
    """
    for axis in range(len(local)):
        inward = 0.0
        if local[axis] <= _BORDER:
            inward = _CLEARANCE - local[axis]
        elif local[axis] >= 1.0 - _BORDER:
            inward = 1.0 - _CLEARANCE - local[axis]
        if inward != 0.0 and abs(inward) * spacing[axis] <= _LARGEST_TILT * farthest:
            velocity[axis] += inward * spacing[axis] / farthest


@inner
def _step(grid: FlowGrid, cell: Integers, local: Floats, axis: int, step: int) -> bool:
    """Move a point on a border to the same position in the next cell along one axis; return whether that cell exists.

    `grid`: currents and cells; `cell, local` (n,): cell of the point and position in the cell (0 to 1), both updated;
    `axis`: number of the axis; `step`: 1 upwards, -1 downwards.
    """
    other = cell[axis] + step
    if grid.periodic[axis]:
        other %= grid.flow.shape[axis]
    if other < 0 or other >= grid.flow.shape[axis]:
        return False
    cell[axis] = other
    local[axis] = 0.0 if step > 0 else 1.0
    return True


@inner
def _enter_served_neighbour(grid: FlowGrid, cell: Integers, local: Floats) -> bool:
    """Move a point on the border of its cell into a neighbour with a path to a goal; return whether there is one.

    Rounding may place a point on the border of a cell with a path just outside this cell.  `grid`: currents and cells;
    `cell, local` (n,): cell of the point and position in the cell (0 to 1), both updated.
    """
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
    """Compute the unit velocity along the current at a point; return a status and the length of the longest step.

    The velocity follows Pollock's interpolation within the cell of the point.  A point on a border belongs to the cell
    that the current enters there, cell by cell down the potential.  Otherwise a robot at a corner could oscillate for
    ever between cells that both lead back to the corner.  Where no axis leads out of the cell in finite time, the
    velocity points to the face with the largest outward current.  The (straight) step ends just across the next face
    with outward current, and at most half way to a zero of a component, so that it never ends beyond a face without
    outward current.

    `flow`: currents of the field; `served` (cells,): mask of goal cells and of cells with a path to a goal; `corner`
    (n,): lower ends of the axes; `periodic` (n,): mask of the periodic axes; `point` (n,): configuration in axis
    coordinates; `velocity` (n,): output, 0 unless the status is `MOVES`.  Status: `MOVES`, `GOAL` (in a goal cell),
    `OFF` (no path to a goal, or no current), `OUTSIDE` (of the grid) or `NOT_FINITE`.  The length is in axis units; it
    is 0 unless the status is `MOVES`.
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
    if not grid.served[flat] and not _enter_served_neighbour(grid, cell, local):
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
    """Apply relaxation sweeps to ``G x = b``, row by row; ``omega = 0`` selects Jacobi sweeps, other values SOR.

    A Jacobi sweep uses only values of the previous sweep; successive over-relaxation (SOR) uses values that this sweep
    has already updated.  ``b`` and the solution are nonnegative.  Over-relaxation may overshoot and is clipped at 0;
    this projected SOR (Cryer 1971) converges to the same solution.

    `first` (n + 1,), `column` and `coupling`: index pointers, column indices and values of the negated off-diagonal
    part of ``G``, in compressed rows; `diagonal` (n,): diagonal of ``G``; `drive` (n,): ``b``; `omega`: relaxation
    factor; `count`: number of sweeps; `value` (n,): ``x``, updated; `spare` (n,): work array.
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
