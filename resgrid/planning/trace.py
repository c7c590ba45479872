"""Pollock tracing of streamlines along the current, from a start to a goal.

The method is semi-analytical (D. W. Pollock, Ground Water 26(6), 1988): inside a cell, each velocity component is
linear between the two faces that it crosses, so that exit face and time have a closed form.  Voltages are not
interpolated.  A face to an obstacle carries no outward current, and each crossing strictly lowers the node potential.
A leak, like a uniform drive, adds current to each cell.  More current then leaves a cell with current than enters it
through its faces, so that a neighbour of strictly lower potential always exists.
A streamline therefore cannot enter an obstacle, cut a corner, loop, or stop before a goal.  The current ends on the
face of a goal cell.  From there a straight leg within this convex cell leads to the configuration that solves the goal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.values import frozen
from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import AccuracyError, InputError
from resgrid.planning.clearance import segment_clearance
from resgrid.planning.fields import Field
from resgrid.planning.streamline import Outcome, Streamline

_BATCH = 1 << 18
"""Number of streamlines that `basins` traces in one kernel call; it limits the memory for their end points."""


@frozen
@dataclass(frozen=True, eq=False)
class Traces:
    """Outcomes, goals, lengths, durations and numbers of steps of n streamlines or node paths, without their points.

    Returned by `resgrid.streamlines` and `resgrid.planning.Planner.ends`.

    Attributes
    ----------
    outcome : ndarray of str, shape (n,)
        Outcome of every streamline, as the text of `Outcome`, such as ``"reached"``.
    goal : ndarray of int64, shape (n,)
        Index of the reached goal region; -1 if the streamline reaches no goal.
    length : ndarray of float64, shape (n,)
        Length in axis units, last leg included; NaN if the streamline does not reach a goal.
    log_duration : ndarray of float64, shape (n,)
        Natural logarithm of the time to the goal cell's face, or to the end of the streamline, at the velocity
        ``-conductivity * grad(phi)``; NaN without motion, and for a lattice other than "square".
    steps : ndarray of int64, shape (n,)
        Number of crossed faces; for a lattice other than "square", number of steps between sites.

    Examples
    --------
    >>> field = rg.plan(rg.read_scene("examples/scenes/lesson.toml")).field
    >>> traces = rg.streamlines(field, [(0.5, 6.5), (2.5, 4.5)])
    >>> traces.outcome.tolist()
    ['reached', 'start_blocked']
    >>> traces.length.round(3), traces.steps
    (array([8.712,   nan]), array([11,  0]))
    """

    outcome: NDArray[np.str_]
    goal: NDArray[np.int64]
    length: NDArray[np.float64]
    log_duration: NDArray[np.float64]
    steps: NDArray[np.int64]


def streamline(field: Field, start: ArrayLike | None = None, *, cell: Sequence[int] | None = None) -> Streamline:
    """Follow the current from a start to a goal.

    If no velocity component reaches a face in finite time (at stagnation points, on lines that lead to them, and for
    starts on an obstacle's face), the streamline leaves straight through the face with the largest outward current.

    Parameters
    ----------
    field : Field
        The field to follow.
    start : array_like of float, shape (ndim,)
        World coordinates of a point within the grid.
    cell : sequence of int, optional
        Cell whose centre is the start, instead of `start`.

    Returns
    -------
    Streamline
        Its ``outcome`` states whether it reached a goal; `resgrid.certify` verifies it.

    Raises
    ------
    InputError
        If the start lies outside the grid, or not exactly one of `start` and `cell` is given.
    AccuracyError
        If the streamline does not end, which is impossible in a direction-safe field.

    Examples
    --------
    >>> field = rg.plan(rg.read_scene("examples/scenes/lesson.toml")).field
    >>> path = rg.streamline(field, (0.5, 6.5))
    >>> path
    <Streamline reached goal 0: 12 points, length 8.712, clearance 0.4148>
    >>> path.points[:3].round(3)
    array([[0.5  , 6.5  ],
           [1.   , 6.439],
           [2.   , 6.383]])
    >>> str(rg.streamline(field, cell=(6, 6)).outcome)
    'start_blocked'
    """
    return follow(field, one_start(field.space, start, cell))


def follow(field: Field, point: NDArray[np.float64]) -> Streamline:
    """Return the streamline of a field from a point (ndim,) in axis units."""
    from resgrid.planning import kernels

    space = field.space
    cells, local = start_cells(space, point[np.newaxis])
    if blocked := static_outcomes(space, cells)[0]:
        points = _points(space, cells, local)
        return Streamline(points, cells, Outcome(blocked), None, 0.0, np.nan, np.nan, field)
    none = np.empty((0, space.ndim))
    first, position = cells[0], local[0]
    code, steps, length, log_time = kernels.trace(
        field.flow, first.copy(), position.copy(), none.astype(np.int64), none
    )
    _check_ended(np.array([code]))
    cells, local = np.empty((steps + 1, space.ndim), dtype=np.int64), np.empty((steps + 1, space.ndim))
    kernels.trace(field.flow, first, position, cells, local)
    reached = code == kernels.REACHED and space.cell[tuple(cells[-1])] == Cell.GOAL
    end, leg = _last_leg(space, cells[-1:], local[-1:])
    # A segment ends where the next one starts, relative to its own cell: a point that enters at 0 came from below.
    step = np.where(np.diff(cells, axis=0) != 0, np.where(local[1:] == 0.0, 1, -1), 0)
    ends = np.concatenate([local[1:] + step, end])
    return Streamline(
        axis_points=_points(space, cells, local),
        cells=cells,
        outcome=Outcome.REACHED if reached else Outcome.NO_CURRENT,
        goal=int(space.goal_region[tuple(cells[-1])]) if reached else None,
        length=float(length + leg[0]),
        clearance=segment_clearance(cells, local, ends, space, field.edge, field.obstacle_reach),
        log_duration=float(_log_duration(field, np.array([log_time]))[0]),
        field=field,
    )


def streamlines(field: Field, starts: ArrayLike) -> Traces:
    """Follow the current from n starts, and return outcomes, goals and lengths without the points of the streamlines.

    Parameters
    ----------
    field : Field
        The field to follow.
    starts : array_like of float, shape (n, ndim) or (ndim,)
        World coordinates, one start per row.

    Returns
    -------
    Traces
        Outcome, goal, length, duration and number of steps of every streamline.

    Raises
    ------
    InputError
        If the starts have another shape, or one lies outside the grid.
    AccuracyError
        If a streamline does not end, which is impossible in a direction-safe field.

    Examples
    --------
    >>> field = rg.plan(rg.read_scene("examples/scenes/lesson.toml")).field
    >>> ends = rg.streamlines(field, [(0.5, 6.5), (6.5, 6.5), (7.5, 0.5)])
    >>> ends.outcome.tolist()
    ['reached', 'start_blocked', 'reached']
    >>> ends.goal, ends.length.round(3)
    (array([ 0, -1,  0]), array([8.712,   nan, 0.709]))
    """
    return follow_many(field, start_points(field.space, starts))


def follow_many(field: Field, points: NDArray[np.float64]) -> Traces:
    """Return outcomes, goals, lengths, durations and numbers of steps of streamlines from n points, as Traces.

    A goal is the index of a goal region of the space, -1 if no goal is reached.  Lengths are in axis units, NaN if no
    goal is reached.  Durations are natural logarithms of the time of motion along the streamline at the velocity
    ``-conductivity * grad(phi)``, NaN without motion.  `points` (n, ndim): starts in axis units.
    """
    from resgrid.planning import kernels

    cells, local = start_cells(field.space, points)
    outcome = static_outcomes(field.space, cells).astype("U16")
    free = np.flatnonzero(outcome == "")
    last, position = cells[free], local[free]
    code, crossed = np.empty(len(free), dtype=np.int64), np.empty(len(free), dtype=np.int64)
    lengths, log_time = np.empty(len(free)), np.empty(len(free))
    kernels.trace_many(field.flow, last, position, code, crossed, lengths, log_time)
    _check_ended(code)
    reached = (code == kernels.REACHED) & (field.space.cell[tuple(last.T)] == Cell.GOAL)
    outcome[free] = np.where(reached, Outcome.REACHED.value, Outcome.NO_CURRENT.value)
    goal, length, log_duration, steps = (np.full(len(points), rest) for rest in (-1, np.nan, np.nan, 0))
    arrived = free[reached]
    goal[arrived] = field.space.goal_region[tuple(last[reached].T)]
    length[arrived] = lengths[reached] + _last_leg(field.space, last[reached], position[reached])[1]
    log_duration[free], steps[free] = _log_duration(field, log_time), crossed
    return Traces(outcome, goal, length, log_duration, steps)


def basins(field: Field) -> NDArray[np.int32]:
    """Return the goal that the streamline from the centre of every cell reaches.

    Streamlines are traced only from cells whose current leads to more than one goal.

    Parameters
    ----------
    field : Field
        The field to follow.

    Returns
    -------
    ndarray of int32, shape of the space
        Index of the goal region; -1 on obstacles, and for cells from which no goal is reached.

    Raises
    ------
    AccuracyError
        If a streamline does not end, which is impossible in a direction-safe field.

    Examples
    --------
    >>> axes = [rg.Axis("x", 0.0, 6.0, 6), rg.Axis("y", 0.0, 1.0, 1)]
    >>> space = rg.ConfigurationSpace(axes, [[2], [0], [0], [0], [0], [2]])
    >>> rg.basins(rg.plan(space, boundary="neumann").field).T
    array([[0, 0, 0, 1, 1, 1]], dtype=int32)
    """
    from resgrid.planning.kernels import MIXED, only_goal

    space = field.space
    flat_goal = only_goal(field.flow, space.goal_region.ravel().astype(np.int64), space.periodic)
    goal = np.where(space.cell == Cell.OBSTACLE, -1, flat_goal.reshape(space.shape)).astype(np.int32)
    cells = np.argwhere(goal == MIXED)
    for first in range(0, len(cells), _BATCH):
        some = cells[first : first + _BATCH]
        goal[tuple(some.T)] = follow_many(field, space.axis_centre(some)).goal
    return goal


def start_cells(
    space: ConfigurationSpace, points: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the cells of `points`, in axis units, and the positions within the cells, in [0, 1]; all (n, ndim).

    A point of an obstacle cell is assigned to a free neighbour if it lies on their common border, to rounding error.
    """
    cells, local = space.split(points)
    if not np.any(space.cell[tuple(cells.T)] == Cell.OBSTACLE):
        return cells, local
    size, slack = np.array(space.shape), space.rounding_errors
    for step in sorted(product((0, -1, 1), repeat=space.ndim), key=np.count_nonzero):
        beyond = np.array(step)
        on_border = (beyond == 0) | np.where(beyond < 0, local <= slack, local >= 1.0 - slack)
        touched = (space.cell[tuple(cells.T)] == Cell.OBSTACLE) & np.all(on_border, axis=1)
        neighbour = cells + beyond
        touched &= np.all(((neighbour >= 0) & (neighbour < size)) | space.periodic, axis=1)
        neighbour %= size
        touched &= space.cell[tuple(neighbour.T)] != Cell.OBSTACLE
        cells[touched] = neighbour[touched]
        local[touched] = np.where(beyond == 0, local[touched], np.where(beyond < 0, 1.0, 0.0))
    return cells, local


def start_cell(space: ConfigurationSpace, start: ArrayLike) -> tuple[int, ...]:
    """Return the cell of a start (ndim,) in world coordinates; a point on a border belongs to a free cell, if any."""
    return tuple(start_cells(space, one_start(space, start, None)[np.newaxis])[0][0].tolist())


def one_start(space: ConfigurationSpace, start: ArrayLike | None, cell: Sequence[int] | None) -> NDArray[np.float64]:
    """Return a start point (ndim,) in axis units; raise InputError unless exactly one of `start` and `cell` is given.

    `start` (ndim,): point in world coordinates, or None; `cell`: cell whose centre is the start, or None.
    """
    if (start is None) == (cell is None):
        raise InputError("give either a start point or a start cell")
    if start is not None:
        points = start_points(space, start)
        if len(points) != 1:
            raise InputError(f"start must be a single point with {space.ndim} coordinates, got {len(points)} points")
        return np.asarray(points[0])
    return space.axis_centre(cell_indices(space, cell, ndim=1))


def cell_indices(space: ConfigurationSpace, cells: ArrayLike | None, ndim: int | None = None) -> NDArray[np.int64]:
    """Return `cells` (..., space.ndim), indices of cells, as int64; raise InputError unless all are in the grid.

    `ndim`: required number of dimensions of the array `cells`, 1 for a single cell, 2 for a list; None for any number.
    """
    index = np.asarray(cells)
    if index.dtype.kind not in "iu" or index.shape[-1:] != (space.ndim,) or ndim not in (None, index.ndim):
        raise InputError(f"a cell of this space has {space.ndim} whole indices, got {cells!r}")
    outside = np.any((index < 0) | (index >= space.shape), axis=-1)
    if outside.any():
        cell = tuple(index[outside][0].tolist())
        raise InputError(f"cell {cell} is not in the grid of {' x '.join(map(str, space.shape))} cells")
    return index.astype(np.int64)


def start_points(space: ConfigurationSpace, starts: ArrayLike) -> NDArray[np.float64]:
    """Return `starts`, (n, ndim) or (ndim,) in world coordinates, as an array (n, ndim) in axis units."""
    try:
        points = np.asarray(starts, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"starts must be numbers, {space.ndim} for each start") from error
    if points.shape == (space.ndim,):
        points = points[np.newaxis]
    if points.shape == (0,):
        points = points.reshape(0, space.ndim)
    if points.ndim != 2 or points.shape[1] != space.ndim:
        raise InputError(f"starts have shape {points.shape}, but a start of this space has {space.ndim} coordinates")
    inside = space.from_world(points)
    try:
        space.split(inside)
    except InputError as error:
        if space.frame.is_world:
            raise
        within = np.all((inside >= space.lower) & (inside <= space.upper) | space.periodic, axis=1)
        given = tuple(points[int(np.argmin(within))].tolist())
        raise InputError(f"start {given} lies outside the map; in the map's own axes, {error}") from None
    return inside


def static_outcomes(space: ConfigurationSpace, cells: NDArray[np.int64]) -> NDArray[np.str_]:
    """Return the failures of paths from start cells (n, ndim) that follow from connectivity alone, shape (n,).

    An entry is a value of `Outcome`, or an empty text where a path to a goal exists.
    """
    at = tuple(cells.T)
    code = space.cell[at]
    outcome = np.full(len(cells), "", dtype="U16")
    blocked = not space.goal_connected.any()
    cut_off = (code == Cell.FREE) & ~space.goal_connected[at]
    outcome[cut_off] = (Outcome.GOAL_BLOCKED if blocked else Outcome.NO_PATH).value
    outcome[code == Cell.OBSTACLE] = Outcome.START_BLOCKED.value
    return outcome


def _points(space: ConfigurationSpace, cells: NDArray[np.int64], locals_: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points of a streamline in axis units, (n, ndim), or (n + 1, ndim) with the last cell's goal point.

    The goal point is appended if the space defines one for the last cell.  `cells` (n, ndim): visited cells; `locals_`
    (n, ndim): positions within the cells, in [0, 1].
    """
    points = space.lower + (cells + locals_) * space.spacing
    goal = space.goal_point(cells[-1:])
    return points if np.isnan(goal).any() else np.concatenate([points, goal])


def _last_leg(
    space: ConfigurationSpace, cells: NDArray[np.int64], local: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ends (n, ndim) and lengths (n,) of the straight last legs of n streamlines to their goal points.

    `cells` (n, ndim): last cells; `local` (n, ndim): starts of the legs.  Starts and ends are positions within the
    cells, in [0, 1]; lengths are in axis units.  A cell without a goal point has a leg of length 0.
    """
    goal = (space.goal_point(cells) - space.lower) / space.spacing - cells
    end = np.where(np.isnan(goal), local, np.clip(goal, 0.0, 1.0))
    return end, np.linalg.norm((end - local) * space.spacing, axis=1)


def _check_ended(code: NDArray[np.int64]) -> None:
    """Raise AccuracyError if a streamline did not end.

    `code` (n,): outcomes that the tracing kernel returns; `ENDLESS` means more steps than the grid has cells.
    """
    from resgrid.planning import kernels

    if np.any(code == kernels.ENDLESS):
        raise AccuracyError(
            "a streamline visits more cells than the grid has: the field is not direction-safe; solve with "
            "accuracy = 'direction'"
        )


def _log_duration(field: Field, log_time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return natural logarithms (n,) of durations at the velocity ``-conductivity * grad(phi)``; NaN without motion.

    `log_time` (n,): logarithms of times in cells of width 1 that are crossed at velocities equal to the face currents,
    in units of supply / resistance; -inf without motion.
    """
    scaled = log_time + 2.0 * np.log(field.space.spacing.min())
    return np.where(np.isneginf(log_time), np.nan, scaled)
