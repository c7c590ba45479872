"""Paths from node to node of a lattice, along the largest current.

The read-out compares the currents at a node and goes to the neighbour to which the largest one flows (local current
comparison, Hernandez-Mejia et al. 2018).  In their lattices all resistors are equal.  Where weights or lengths of steps
differ, currents are divided by weight and length: the current densities along the steps are compared
(`LatticeField.read_out`).  Every step lowers the potential, so that a path cannot loop or stop before a
goal.  A resistor exists only where the straight line between its nodes meets no obstacle cell, so that a path cuts no
corner.  The start is joined to the nearest node of its cell, which is convex and free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import with_article
from resgrid._internal.values import frozen, picture_html
from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import AccuracyError, InputError
from resgrid.planning.clearance import clearance_of
from resgrid.planning.failure_reasons import failure_reason, no_current_reason
from resgrid.planning.lattice_fields import LatticeField
from resgrid.planning.streamline import Outcome, in_world, length_of, summary
from resgrid.planning.trace import Traces, one_start, start_cells, static_outcomes


@frozen
@dataclass(frozen=True, eq=False)
class NodePath:
    """A path from node to node of a lattice, along the largest current.

    Attributes
    ----------
    line : ndarray of float64, shape (n, ndim)
        Points in axis units, continuous across periodic seams: the start, the visited sites (the first one is omitted
        if it is the start), and the configuration in the last cell that solves the goal, if the space defines one.
    nodes : ndarray of int64, shape (m, ndim)
        Indices of the visited sites of the lattice, from a site of the start's cell to a site in a goal cell (or, for
        the outcome ``no_current``, a site without outward current); empty if the start is blocked, has no way to a
        goal, or lies in a goal cell.
    cells : ndarray of int64, shape (max(m, 1), ndim)
        Cells of the visited sites; the cell of the start if there are none.
    outcome : Outcome
        Reason why the path ended.
    goal : int or None
        Index of the reached goal region; None if the path reaches no goal.
    length : float
        Length of the polyline in axis units.
    clearance : float
        Smallest distance, in axis units, from the polyline to an obstacle cell or to an edge of the grid that counts
        as an obstacle; infinite if there is neither; NaN for a start that is blocked or has no way to a goal.
    log_duration : float
        NaN, since a path from node to node has no duration.
    field : LatticeField
        The field whose currents the path follows.
    space : ConfigurationSpace
        The configuration space of the path.
    points : ndarray of float64, shape (n, ndim)
        Points in world coordinates.
    axis_points : ndarray of float64, shape (n, ndim)
        Points in axis units, within the range of periodic axes.
    point_cells : ndarray of int64, shape (n, ndim)
        Cell of every row of `axis_points`.
    reason : str or None
        Reason why the path reaches no goal, with a remedy; None if it reaches a goal.

    Examples
    --------
    >>> path = rg.plan(rg.read_scene("examples/scenes/lesson.toml"), lattice="square8").path((0.5, 6.5))
    >>> path
    <NodePath reached goal 0: 10 points, length 9.828, clearance 0.5>
    >>> path.points[-3:]
    array([[6.5, 3.5],
           [6.5, 2.5],
           [6.5, 1.5]])
    >>> rg.certify(path)
    """

    line: NDArray[np.float64]
    nodes: NDArray[np.int64]
    cells: NDArray[np.int64]
    outcome: Outcome
    goal: int | None
    length: float
    clearance: float
    field: LatticeField

    def __repr__(self) -> str:
        return f"<NodePath {summary(self.outcome, self.goal, len(self.line), self.length, self.clearance)}>"

    _repr_html_ = picture_html

    @property
    def space(self) -> ConfigurationSpace:
        """The configuration space of the path."""
        return self.field.space

    @property
    def log_duration(self) -> float:
        """NaN, since a path from node to node has no duration."""
        return float("nan")

    @cached_property
    def axis_points(self) -> NDArray[np.float64]:
        """Points in axis units, within the range of periodic axes, shape (n, ndim)."""
        space = self.space
        wrapped = space.lower + np.mod(self.line - space.lower, space.upper - space.lower)
        return np.where(space.periodic, wrapped, self.line)

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """Points of the path in world coordinates, shape (n, ndim)."""
        return in_world(self.axis_points, self.space)

    @cached_property
    def point_cells(self) -> NDArray[np.int64]:
        """Cell of every row of `axis_points`, shape (n, ndim)."""
        return np.concatenate([self.cells[:1], self.cells, self.cells[-1:]])[1 - self._joins :][: len(self.line)]

    @property
    def _joins(self) -> int:
        """Number of points before the first site: 1 if the start is not a site, 0 if the path begins at a site."""
        leg = self.outcome is Outcome.REACHED and not np.isnan(self.space.goal_point(self.cells[-1])).any()
        return len(self.line) - leg - len(self.nodes)

    @property
    def reason(self) -> str | None:
        """Reason why the path reaches no goal, with a remedy; None if it reaches a goal."""
        if self.outcome is Outcome.NO_CURRENT:
            cell = tuple(self.cells[-1].tolist())
            return no_current_reason(self.space, self.field.wiring, cell, _flowing_cells(self.field))
        return failure_reason(self.outcome, self.space, tuple(self.cells[0].tolist()))


def node_path(field: LatticeField, start: ArrayLike | None = None, *, cell: Sequence[int] | None = None) -> NodePath:
    """Follow the largest current from node to node, from a start to a goal.

    The start is joined by a straight line to the nearest node of its cell; every free cell contains a node.

    Parameters
    ----------
    field : LatticeField
        The field to follow.
    start : array_like of float, shape (ndim,)
        World coordinates of a point within the grid.
    cell : sequence of int, optional
        Cell whose centre is the start, instead of `start`.

    Returns
    -------
    NodePath
        Its ``outcome`` states whether it reached a goal; `resgrid.certify` verifies it.

    Raises
    ------
    InputError
        If the start lies outside the grid, or not exactly one of `start` and `cell` is given.
    AccuracyError
        If the path does not end, which is impossible in a direction-safe field.

    Examples
    --------
    >>> planner = rg.plan(rg.read_scene("examples/scenes/lesson.toml"), lattice="hexagonal")
    >>> rg.planning.node_path(planner.field, (0.5, 6.5))
    <NodePath reached goal 0: 12 points, length 10.26, clearance 0.5>
    """
    if not isinstance(field, LatticeField):
        raise InputError(
            f"node_path follows the field of a lattice, not {with_article(type(field).__name__)}; compile the space "
            "with lattice = 'square8', 'cube26' or 'hexagonal', or use rg.streamline"
        )
    return follow_nodes(field, one_start(field.space, start, cell))


def follow_nodes(field: LatticeField, point: NDArray[np.float64]) -> NodePath:
    """Return the path of a field from a point (ndim,) in axis units."""
    space, lattice = field.space, field.lattice
    cells, local = start_cells(space, point[np.newaxis])
    inside = space.lower + (cells + local) * space.spacing
    blocked = str(static_outcomes(space, cells)[0])
    no_nodes = np.empty((0, space.ndim), dtype=np.int64)
    if blocked:
        return NodePath(inside, no_nodes, cells, Outcome(blocked), None, 0.0, np.nan, field)
    sites = no_nodes
    if space.cell[tuple(cells[0])] != Cell.GOAL:
        sites = _visited(field, _first_site(field, cells[0], inside[0]))
        cells = lattice.cells(sites)
    reached = space.cell[tuple(cells[-1])] == Cell.GOAL
    line = _line(field, inside, sites, cells[-1] if reached else None)
    return NodePath(
        line=line,
        nodes=sites,
        cells=cells,
        outcome=Outcome.REACHED if reached else Outcome.NO_CURRENT,
        goal=int(space.goal_region[tuple(cells[-1])]) if reached else None,
        length=length_of(line),
        clearance=clearance_of(line, space, field.edge, field.obstacle_reach),
        field=field,
    )


def follow_many_nodes(field: LatticeField, points: NDArray[np.float64]) -> Traces:
    """Return outcomes, goals, lengths and numbers of steps of the paths from `points` (n, ndim), given in axis units.

    Steps lead from site to site; `log_duration` is NaN.
    """
    paths = [follow_nodes(field, point) for point in points]
    reached = np.array([path.outcome is Outcome.REACHED for path in paths], dtype=np.bool_)
    return Traces(
        outcome=np.array([path.outcome.value for path in paths], dtype="U16"),
        goal=np.array([-1 if path.goal is None else path.goal for path in paths], dtype=np.int64),
        length=np.where(reached, [path.length for path in paths], np.nan),
        log_duration=np.full(len(paths), np.nan),
        steps=np.array([max(len(path.nodes) - 1, 0) for path in paths], dtype=np.int64),
    )


def _flowing_cells(field: LatticeField) -> NDArray[np.bool_]:
    """Return the mask of the free cells in which a path can leave every site, shape of the space."""
    flows = np.asarray(field.space.cell == Cell.FREE)
    ends = np.stack(np.unravel_index(np.flatnonzero(field.next_site < 0), field.lattice.shape), axis=1)
    flows[tuple(field.lattice.cells(ends).T)] = False
    return flows


def _first_site(field: LatticeField, cell: NDArray[np.int64], point: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the index of the site at which a path begins, (ndim,): the nearest site in the cell of the start.

    In the cell that drives the circuit, it is the driven site, the nearest one to the centre of the cell.  `cell`
    (ndim,): cell of the start; `point` (ndim,): start, in axis units.
    """
    driven = field.wiring.start
    if driven is not None and tuple(cell.tolist()) == tuple(driven):
        point = field.space.axis_centre(cell)
    return field.lattice.nearest(cell, point)


def _visited(field: LatticeField, first: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the indices of the sites of the path from a site to a goal, or to one without outward current, (m, ndim).

    `first` (ndim,): index of the first site.
    """
    at, following = int(np.ravel_multi_index(tuple(first), field.lattice.shape)), field.next_site.ravel().item
    visited, most = [at], field.lattice.size
    while (at := following(at)) >= 0:
        visited.append(at)
        if len(visited) > most:
            raise AccuracyError("the path along the largest currents does not end; solve with accuracy = 'direction'")
    return np.stack(np.unravel_index(visited, field.lattice.shape), axis=1)


def _line(
    field: LatticeField, start: NDArray[np.float64], sites: NDArray[np.int64], goal_cell: NDArray[np.int64] | None
) -> NDArray[np.float64]:
    """Return the polyline of a path in axis units, continuous across periodic seams, (n, ndim).

    `start` (1, ndim): start, in axis units; `sites` (m, ndim): indices of the visited sites; `goal_cell` (ndim,): index
    of the reached goal cell, whose goal point is appended if there is one, or None.
    """
    space, lattice = field.space, field.lattice
    parts = [start]
    turns = np.zeros(space.ndim)
    if len(sites):
        points = lattice.points(sites)
        move = field.move[np.ravel_multi_index(tuple(sites[:-1].T), lattice.shape)]
        sense = np.where(move % 2 == 0, 1.0, -1.0)[:, np.newaxis]
        gone = points[0] + np.concatenate([np.zeros((1, space.ndim)), np.cumsum(sense * lattice.steps[move // 2], 0)])
        period = space.upper - space.lower
        around = np.where(space.periodic, np.round((gone - points) / period), 0.0)
        points, turns = points + around * period, around[-1] * period
        near = np.all(np.abs(points[0] - start[0]) <= space.rounding * space.spacing)
        parts.append(points[1:] if near else points)
    if goal_cell is not None and not np.isnan(last := space.goal_point(goal_cell)).any():
        parts.append((last + turns)[np.newaxis])
    return np.concatenate(parts)
