"""Paths in a configuration space: streamlines and user-defined polylines."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.values import frozen, picture_html
from resgrid.core.cell import Cell
from resgrid.core.regions import sides_of_cells
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.planning.failure_reasons import failure_reason, no_current_reason
from resgrid.planning.fields import Field


class Outcome(StrEnum):
    """Outcome of tracing a streamline from a start.

    ``reached``: the streamline ends in a goal cell; ``no_path``: no sequence of neighbouring free cells leads from the
    start to a goal; ``no_current``: no current, or none of known direction, leaves the last cell; ``start_blocked``:
    the start lies in an obstacle; ``goal_blocked``: no free cell of the space has a path to a goal.

    Examples
    --------
    >>> planner = rg.plan(rg.read_scene("examples/scenes/lesson.toml"))
    >>> planner.path((0.5, 6.5)).outcome is rg.Outcome.REACHED
    True
    >>> planner.path((3.5, 4.5)).outcome
    <Outcome.START_BLOCKED: 'start_blocked'>
    >>> [str(outcome) for outcome in rg.Outcome]
    ['reached', 'no_path', 'no_current', 'start_blocked', 'goal_blocked']
    """

    REACHED = "reached"
    NO_PATH = "no_path"
    NO_CURRENT = "no_current"
    START_BLOCKED = "start_blocked"
    GOAL_BLOCKED = "goal_blocked"


_UNSAFE = (
    "the field is not direction-safe from cell {cell} on (too inaccurate to give a direction): solve with accuracy "
    "'direction' (method 'auto', no warm start), or open obstacles with --drive uniform"
)


@frozen
@dataclass(frozen=True, eq=False)
class Streamline:
    """A path that follows the current of a field from a start; its `points` are world coordinates.

    With the outcome ``start_blocked``, ``no_path`` or ``goal_blocked``, it consists of the start: the length is 0, and
    `clearance` and `log_duration` are NaN.

    Attributes
    ----------
    axis_points : ndarray of float64, shape (n, ndim)
        Points in axis units, each within its cell: the start; every crossing of a cell face, up to the face of the
        goal cell; and the configuration within the goal cell that solves the goal, if the space defines one
        (``ConfigurationSpace.goal_points``).  Several points coincide if the streamline starts on a face or passes
        through an edge or a corner; `points` and `line` contain distinct points only.
    cells : ndarray of int64, shape (m, ndim)
        Visited cells, from the start cell to the entered goal cell, or to the last cell if no goal is reached.  Row
        ``i`` of `axis_points` is the point at which cell ``i`` is entered.  With a last leg, straight to the goal
        point, n is m + 1, and the last point lies in the last cell.
    outcome : Outcome
        Reason why tracing ended.
    goal : int or None
        Index of the reached goal region; None if the streamline reaches no goal.
    length : float
        Length of the polyline, last leg included, in axis units and continuous across periodic seams.
    clearance : float
        Smallest distance, in axis units, from the polyline to the box of an obstacle cell or to an edge of the grid
        that counts as an obstacle; infinite if there is neither.
    log_duration : float
        Natural logarithm of the time to the goal cell's face, where the current ends, or to the last crossing if no
        goal is reached, at the velocity ``-conductivity * grad(phi)``; NaN without motion.
    field : Field
        The field whose current the streamline follows.
    space : ConfigurationSpace
        The configuration space of the path.
    points, line : ndarray of float64, shape (p, ndim)
        Distinct points: `points` in world coordinates; `line` in axis units, continuous across periodic seams.
    reason : str or None
        Reason why the streamline reaches no goal, with a remedy; None if it reaches a goal.
    point_cells : ndarray of int64, shape (n, ndim)
        Cell of every row of `axis_points`.

    Examples
    --------
    >>> path = rg.plan(rg.read_scene("examples/scenes/lesson.toml")).path((5.5, 2.5))
    >>> path
    <Streamline reached goal 0: 3 points, length 0.7253, clearance 1.5>
    >>> path.points.round(3)
    array([[5.5  , 2.5  ],
           [6.   , 2.053],
           [6.013, 2.   ]])
    >>> path.cells
    array([[5, 2],
           [6, 2],
           [6, 1]])
    >>> path.goal, round(path.log_duration, 3)
    (0, 1.257)
    """

    axis_points: NDArray[np.float64]
    cells: NDArray[np.int64]
    outcome: Outcome
    goal: int | None
    length: float
    clearance: float
    log_duration: float
    field: Field

    def __repr__(self) -> str:
        return f"<Streamline {summary(self.outcome, self.goal, len(self.line), self.length, self.clearance)}>"

    _repr_html_ = picture_html

    @property
    def space(self) -> ConfigurationSpace:
        """The configuration space of the path."""
        return self.field.space

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """Distinct points of the streamline in world coordinates, shape (p, ndim)."""
        return in_world(self.axis_points[self._places], self.space)

    @property
    def reason(self) -> str | None:
        """Reason why the streamline reaches no goal, with a remedy; None if it reaches a goal."""
        if self.outcome is Outcome.NO_CURRENT:
            return dead_end_reason(self.field, tuple(self.cells[-1].tolist()))
        return failure_reason(self.outcome, self.space, tuple(self.cells[0].tolist()))

    @property
    def point_cells(self) -> NDArray[np.int64]:
        """Cell of every row of `axis_points`, shape (n, ndim); it also contains the segment that starts at this row."""
        return np.concatenate([self.cells, self.cells[-1:]])[: len(self.axis_points)]

    @cached_property
    def line(self) -> NDArray[np.float64]:
        """Distinct points of the streamline in axis units, continuous across periodic seams, shape (p, ndim)."""
        return np.asarray(self._crossings[self._places])

    @cached_property
    def _places(self) -> NDArray[np.int64]:
        """Indices (p,) of the rows of `axis_points` that remain if rows equal to within rounding error count once."""
        return distinct_rows(self._crossings, 0.5 * self.space.rounding * self.space.spacing)

    @cached_property
    def _crossings(self) -> NDArray[np.float64]:
        """All rows of `axis_points`, continuous across periodic seams, shape (n, ndim).

        The direction of every step across a seam follows from the entered face: a point on the lower face of a cell
        came from below, a point on the upper face from above.  This is unique even in a ring of two cells.
        """
        space, cells = self.space, self.point_cells
        local = (self.axis_points - space.lower) / space.spacing - cells
        step = np.where(np.diff(cells, axis=0) != 0, np.where(local[1:] < 0.5, 1, -1), 0)
        continuous = np.concatenate([cells[:1], cells[:1] + np.cumsum(step, axis=0)])
        turns = (continuous - cells) // np.array(space.shape)
        return np.asarray(self.axis_points + turns * (space.upper - space.lower))


def dead_end_reason(field: Field, cell: tuple[int, ...]) -> str:
    """Return the reason why streamlines of a field end without a goal in a free cell, and a remedy, as a message.

    `cell`: cell that no current leaves, or that is not direction-safe.
    """
    if field.safe is not None and not field.safe[cell]:
        return _UNSAFE.format(cell=cell)
    return no_current_reason(field.space, field.wiring, cell, _flowing_cells(field))


def _flowing_cells(field: Field) -> NDArray[np.bool_]:
    """Return the mask of the free, direction-safe cells that a current leaves through a face, shape of the space."""
    flows = np.zeros(field.space.shape, dtype=np.bool_)
    for axis, direction in enumerate(field.face_direction):
        lower, upper = sides_of_cells(direction, axis)
        flows |= (lower < 0) | (upper > 0)
    flows &= field.space.cell == Cell.FREE
    return flows if field.safe is None else flows & field.safe


@frozen
@dataclass(frozen=True, eq=False)
class Polyline:
    """A user-defined path, for functions such as `time_parameterize`, `certify_collision_free` and `check_collisions`.

    Parameters
    ----------
    points : array_like of float, shape (n, ndim)
        Corners of the path in world coordinates, continuous across periodic seams: coordinates may leave the range of a
        periodic axis.
    space : ConfigurationSpace
        Configuration space of the path.

    Raises
    ------
    InputError
        If the points do not fit the space or are not finite.

    Examples
    --------
    >>> space = rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))
    >>> own = rg.Polyline([(0.5, 6.5), (5.5, 5.5), (6.5, 1.5)], space)
    >>> rg.certify_collision_free(own)
    >>> rg.save(own, "own.csv").read_text().splitlines()
    ['path,k,outcome,x,y', '0,,,0.5,6.5', '0,,,5.5,5.5', '0,,,6.5,1.5']
    """

    points: NDArray[np.float64]
    space: ConfigurationSpace

    def __init__(self, points: ArrayLike, space: ConfigurationSpace) -> None:
        try:
            table = np.array(points, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            raise InputError("a path must be an array of numbers with one point per row") from None
        if not isinstance(space, ConfigurationSpace):
            raise InputError(f"space = {space!r} must be a ConfigurationSpace (rg.build_space(scene))")
        if table.ndim != 2 or table.shape[1] != space.ndim or not len(table):
            raise InputError(f"a path in this space has shape (points, {space.ndim}), got {table.shape}")
        if not np.isfinite(table).all():
            row = int(np.argmin(np.isfinite(table).all(axis=1)))
            raise InputError(f"point {row} of the path is not finite: {table[row].tolist()}")
        object.__setattr__(self, "points", table)
        object.__setattr__(self, "space", space)

    @property
    def line(self) -> NDArray[np.float64]:
        """Points of the path in axis units, shape (n, ndim)."""
        return self.space.from_world(self.points)


def distinct_rows(points: NDArray[np.float64], tolerance: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the indices (m,) of rows that differ from the last row before them in the result by more than a tolerance.

    The first and the last row are always included, unless all rows lie within the tolerance of the first.
    `points` (n, ndim): rows; `tolerance` (ndim,): largest difference of equal coordinates, in the unit of the points.
    """
    kept, row = np.ones(len(points), dtype=np.bool_), 0
    for near in (np.flatnonzero(np.all(np.abs(np.diff(points, axis=0)) <= tolerance, axis=1)) + 1).tolist():
        if near <= row:
            continue
        row, reference = near, points[near - 1]
        while row < len(points) and np.all(np.abs(points[row] - reference) <= tolerance):
            kept[row] = False
            row += 1
    rows = np.flatnonzero(kept)
    rows[1:][-1:] = len(points) - 1
    return rows


def length_of(points: NDArray[np.float64]) -> float:
    """Return the length of the polyline through `points` (n, ndim), in the unit of the points."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def summary(outcome: Outcome, goal: int | None, points: int, length: float, clearance: float) -> str:
    """Return a text on a path: outcome, goal (unless None), number of points, length and clearance in axis units."""
    end = f"{outcome}" + ("" if goal is None else f" goal {goal}")
    return f"{end}: {points:,} points, length {length:.4g}, clearance {clearance:.4g}"


def in_world(axis_points: NDArray[np.float64], space: ConfigurationSpace) -> NDArray[np.float64]:
    """Return `axis_points` (n, ndim), given in axis units, in world coordinates, as a read-only array."""
    points = space.frame.to_world(axis_points)
    points.flags.writeable = False
    return points
