"""Streamlines: from a start, along the current, to a goal.

Pollock's semi-analytical method (D. W. Pollock, Ground Water 26(6), 1988): inside a cell every velocity component is
linear between the two faces it crosses, so that exit face and time have a closed form.  No interpolated voltage is ever
used: a wall face carries no, or inward, current, and each crossing strictly lowers the node potential.  A streamline
therefore cannot enter an obstacle, cut a corner, loop, or stop short of a goal.  Where the current ends, on the face of
a goal cell, a straight leg within that convex cell leads on to the configuration that solves the goal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.values import frozen
from resgrid.core.space import Cell, ConfigurationSpace
from resgrid.errors import AccuracyError, InputError
from resgrid.planning.clearance import segment_clearance
from resgrid.planning.fields import Field
from resgrid.planning.streamline import Outcome, Streamline

_BATCH = 1 << 18


@frozen
@dataclass(frozen=True, eq=False)
class Traces:
    """The ends of many streamlines.

    Attributes
    ----------
    outcome : ndarray of str, shape (n,)
        Values of `Outcome`.
    goal : ndarray of int64, shape (n,)
        Goal region reached, -1 for none.
    length : ndarray of float64, shape (n,)
        In axis units, last leg included; NaN where the streamline does not reach a goal.
    log_duration : ndarray of float64, shape (n,)
        As in `Streamline`.
    steps : ndarray of int64, shape (n,)
        Faces crossed.
    """

    outcome: NDArray[np.str_]
    goal: NDArray[np.int64]
    length: NDArray[np.float64]
    log_duration: NDArray[np.float64]
    steps: NDArray[np.int64]


def streamline(field: Field, start: ArrayLike | None = None, *, cell: Sequence[int] | None = None) -> Streamline:
    """Follow the current from a start to a goal.

    Where no axis leads out in finite time (stagnation points and the lines that lead to them, starts on a wall) the
    streamline leaves straight through the face with the largest outward current.

    Parameters
    ----------
    field : Field
    start : array_like of float, shape (ndim,)
        World coordinates; any point of the grid.
    cell : sequence of int, optional
        Instead of `start`: a cell, whose centre is the start.

    Returns
    -------
    Streamline
        Typed by its outcome; certified by `resgrid.certify`.

    Raises
    ------
    InputError
        If the start lies outside the grid, or not exactly one of `start` and `cell` is given.
    AccuracyError
        If the streamline does not end, which a direction-safe field rules out.

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
    """The streamline from a point in axis units, shape (ndim,); see `streamline`."""
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
    # A segment ends where the next one starts, seen from its own cell: a point that enters at 0 came upward.
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
    """Follow the current from many starts, and keep the ends only.

    Parameters
    ----------
    field : Field
    starts : array_like of float, shape (n, ndim) or (ndim,)
        World coordinates; one start is a row of its own.

    Returns
    -------
    Traces

    Raises
    ------
    InputError
        If the starts have another shape, or one lies outside the grid.
    AccuracyError
        If a streamline does not end.

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
    """The ends of streamlines from points in axis units, shape (n, ndim); see `streamlines`."""
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
    """Which goal the streamline from the centre of every cell reaches.

    Only cells from which the current leads to several goals are traced.

    Parameters
    ----------
    field : Field

    Returns
    -------
    ndarray of int32, shape of the space
        Number of the goal region; -1 on obstacles, and where no streamline reaches a goal.

    Raises
    ------
    AccuracyError
        If a streamline does not end, which a direction-safe field rules out.

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
    """Return cells and positions within them of starts, all (n, ndim).

    A start in an obstacle cell belongs to a free neighbour if it lies on their common border, rounding error included.
    """
    cells, local = space.split(points)
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
    """Cell of a start in the world, free if it touches a free one.  Shapes: `start` (ndim,)."""
    return tuple(start_cells(space, one_start(space, start, None)[np.newaxis])[0][0].tolist())


def one_start(space: ConfigurationSpace, start: ArrayLike | None, cell: Sequence[int] | None) -> NDArray[np.float64]:
    """A start that is given as a point of the world or as a cell, in axis units, shape (ndim,)."""
    if (start is None) == (cell is None):
        raise InputError("give either a start point or a start cell")
    if start is not None:
        points = start_points(space, start)
        if len(points) != 1:
            raise InputError(f"one start is wanted, a point with {space.ndim} coordinates; got {len(points)}")
        return np.asarray(points[0])
    return space.axis_centre(cell_indices(space, cell, ndim=1))


def cell_indices(space: ConfigurationSpace, cells: ArrayLike | None, ndim: int | None = None) -> NDArray[np.int64]:
    """Cells that are given by their indices, checked, shape (..., ndim); with `ndim`, as an array of so many axes."""
    index = np.asarray(cells)
    if index.dtype.kind not in "iu" or index.shape[-1:] != (space.ndim,) or ndim not in (None, index.ndim):
        raise InputError(f"a cell of this space has {space.ndim} whole indices, got {cells!r}")
    outside = np.any((index < 0) | (index >= space.shape), axis=-1)
    if outside.any():
        cell = tuple(index[outside][0].tolist())
        raise InputError(f"cell {cell} is not in the grid of {' x '.join(map(str, space.shape))} cells")
    return index.astype(np.int64)


def start_points(space: ConfigurationSpace, starts: ArrayLike) -> NDArray[np.float64]:
    """Starts given in the world, shape (n, ndim) or (ndim,), in axis units: an array of shape (n, ndim)."""
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
        raise InputError(f"the start {given} in the world: along the map's own axes {error}") from None
    return inside


def static_outcomes(space: ConfigurationSpace, cells: NDArray[np.int64]) -> NDArray[np.str_]:
    """Outcomes that cells (n, ndim) decide before anything flows, shape (n,); empty where connectivity finds a path."""
    at = tuple(cells.T)
    code = space.cell[at]
    outcome = np.full(len(cells), "", dtype="U16")
    blocked = not space.goal_connected.any()
    cut_off = (code == Cell.FREE) & ~space.goal_connected[at]
    outcome[cut_off] = (Outcome.GOAL_BLOCKED if blocked else Outcome.NO_PATH).value
    outcome[code == Cell.OBSTACLE] = Outcome.START_BLOCKED.value
    return outcome


def _points(space: ConfigurationSpace, cells: NDArray[np.int64], locals_: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points of a streamline in axis units, the last cell's goal point behind them."""
    points = space.lower + (cells + locals_) * space.spacing
    goal = space.goal_point(cells[-1:])
    return points if np.isnan(goal).any() else np.concatenate([points, goal])


def _last_leg(
    space: ConfigurationSpace, cells: NDArray[np.int64], local: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions within their cells at which last legs end, shape (n, ndim), and their lengths, (n,); 0 for none."""
    goal = (space.goal_point(cells) - space.lower) / space.spacing - cells
    end = np.where(np.isnan(goal), local, np.clip(goal, 0.0, 1.0))
    return end, np.linalg.norm((end - local) * space.spacing, axis=1)


def _check_ended(code: NDArray[np.int64]) -> None:
    from resgrid.planning import kernels

    if np.any(code == kernels.ENDLESS):
        raise AccuracyError(
            "a streamline visits more cells than there are: the field is not direction-safe; solve with "
            "accuracy = 'direction'"
        )


def _log_duration(field: Field, log_time: NDArray[np.float64]) -> NDArray[np.float64]:
    """From face currents to velocities: ``d xi / dt = I R / supply / h_ref**2`` in every axis; NaN where none moved."""
    scaled = log_time + 2.0 * np.log(field.space.spacing.min())
    return np.where(np.isneginf(log_time), np.nan, scaled)
