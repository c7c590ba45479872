"""Certificates: independent checks of streamlines, without the code that computes them."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from numbers import Integral, Real

import numpy as np
from numpy.typing import NDArray

from resgrid.core.cell import Cell
from resgrid.errors import CertificateError
from resgrid.planning.certify_nodes import certify_nodes
from resgrid.planning.clearance import clearance_of
from resgrid.planning.node_paths import NodePath
from resgrid.planning.streamline import Outcome, Streamline, length_of

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
_SAME_TIME = 1e-9  # tolerance of the logarithm of the duration
_SLACK = 4.0  # tolerance of positions within a cell, as a multiple of their rounding error (`space.rounding`)
_LARGEST_LOG = 745.0  # natural logarithm of the largest finite ratio of two float64 velocities


def certify(path: Streamline | NodePath) -> None:
    """Verify all properties and numbers of a path; raise CertificateError at the first violation.

    A streamline that reached a goal must satisfy all of the following.

    - The visited cells are free and distinct, and consecutive ones are face neighbours.
    - Every crossing follows the current and lowers the potential (for blends, only the blended current decides).
    - Every point lies on the crossed face, at the position to which the current carries the previous point.
    - The last cell belongs to the stated goal region, and the streamline ends at its goal point, if one is defined.
    - Length, clearance and duration agree with the polyline.

    A path from node to node of a lattice must begin in the cell of its first site; its steps must lead from site to
    neighbouring site, along the largest current (or current density) of each site and to no higher potential; and no
    segment may touch an obstacle cell, not even at a corner.  Sites are distinct, and the last one lies in the stated
    goal region.

    For other outcomes, the outcome must be true, and the path must state no further results.
    The tolerance of positions is 1e-9 of a cell, or the rounding error of large coordinates.

    Parameters
    ----------
    path : Streamline or NodePath
        The path to verify.

    Raises
    ------
    CertificateError
        At the first violation; the message names the step.

    Examples
    --------
    >>> from dataclasses import replace
    >>> path = rg.plan(rg.read_scene("examples/scenes/lesson.toml")).path((0.5, 6.5))
    >>> rg.certify(path)
    >>> rg.certify(replace(path, goal=1))
    Traceback (most recent call last):
        ...
    resgrid.errors.CertificateError: the last cell belongs to goal 0
    """
    if isinstance(path, NodePath):
        certify_nodes(path)
        return
    _check_kinds(path)
    if path.outcome in {Outcome.REACHED, Outcome.NO_CURRENT}:
        _check_cells(path)
        axis, side = _check_crossings(path)
        _check_descent(path)
        _check_motion(path, axis, side)
        _check_extent(path)
    else:
        _check_still(path)
    if path.outcome is not Outcome.REACHED:
        _check_failure(path)


def _check_kinds(path: Streamline) -> None:
    """Raise CertificateError unless types and shapes are valid, and points are finite and lie within their cells."""
    if not isinstance(path, Streamline) or not isinstance(path.outcome, Outcome):
        raise CertificateError(f"path must be a Streamline with an Outcome, got {type(path).__name__}")
    space = path.space
    cells, points = path.cells, path.axis_points
    if cells.dtype.kind not in "iu" or cells.ndim != 2 or cells.shape[1] != space.ndim or not len(cells):
        raise CertificateError(
            f"cells are {cells.dtype} of shape {cells.shape}, but the space has {space.ndim} axes and whole indices"
        )
    if np.any(cells < 0) or np.any(cells >= space.shape):
        raise CertificateError("the streamline leaves the grid")
    last = space.goal_point(cells[-1:])
    leg = 1 if path.outcome is Outcome.REACHED and not np.isnan(last).any() else 0
    if points.dtype.kind != "f" or points.shape != (len(cells) + leg, space.ndim):
        goal = " and its goal point" if leg else ""
        raise CertificateError(f"points are {points.dtype} of shape {points.shape} for {len(cells)} cells{goal}")
    _require(np.isfinite(points), lambda number: f"point {number} is not finite")
    for name in ("length", "clearance", "log_duration"):
        if not isinstance(getattr(path, name), Real):
            raise CertificateError(f"{name} must be a number, got {getattr(path, name)!r}")
    if path.goal is not None and (isinstance(path.goal, bool) or not isinstance(path.goal, Integral)):
        raise CertificateError(f"goal must be the index of a goal region or None, got {path.goal!r}")
    within = np.abs(_cell_positions(path) - 0.5) <= 0.5 + space.rounding
    _require(within, lambda number: f"point {number} lies outside its cell {_as_tuple(path.point_cells[number])}")
    if leg and np.any(np.abs(points[-1:] - last) > space.rounding * space.spacing):
        raise CertificateError(f"the path ends at {points[-1].tolist()}, not at the goal point {last[0].tolist()}")


def _check_still(path: Streamline) -> None:
    """Raise CertificateError unless a path without motion states no results.

    Such a path has a blocked start, or one without a way to a goal.  It must have one cell, length 0, no goal, and NaN
    for clearance and duration.
    """
    empty = path.goal is None and path.length == 0 and np.isnan(path.clearance) and np.isnan(path.log_duration)
    if len(path.cells) != 1 or not empty:
        raise CertificateError(f"a path with outcome {path.outcome.value} has one cell, length 0 and no other results")


def _check_failure(path: Streamline) -> None:
    """Raise CertificateError unless the outcome of a streamline that reached no goal is true.

    The start cell decides: it is an obstacle, has no path to a goal, or has a path; in the last case (``no_current``)
    no current of known direction may leave the last cell.
    """
    start = tuple(path.cells[0])
    code = path.space.cell[start]
    connected = bool(path.space.goal_connected[start])
    blocked = not path.space.goal_connected.any()
    true = {
        Outcome.START_BLOCKED: code == Cell.OBSTACLE,
        Outcome.NO_PATH: code == Cell.FREE and not connected and not blocked,
        Outcome.GOAL_BLOCKED: code == Cell.FREE and blocked,
        Outcome.NO_CURRENT: connected and path.goal is None and not _flows_out(path),
    }
    if not true[path.outcome]:
        raise CertificateError(
            f"the outcome {path.outcome.value} of the start cell {_as_tuple(path.cells[0])} is not true"
        )


def _flows_out(path: Streamline) -> bool:
    """Return whether a current of known direction leaves the last cell; False if the cell is not direction-safe."""
    safe = path.field.safe
    if safe is not None and not safe[tuple(path.cells[-1])]:
        return False  # the direction of the current is unknown in this cell
    lower, upper = path.field.faces_of(path.cells[-1:])[0]
    return bool(np.any(lower < 0) or np.any(upper > 0))


def _check_cells(path: Streamline) -> None:
    """Raise CertificateError unless visited cells are free and distinct.

    If the path reached a goal, the last cell must be a goal cell of the stated goal region.
    """
    cells = path.cells
    codes = path.space.cell[tuple(cells.T)]
    reached = path.outcome is Outcome.REACHED
    inner = codes[:-1] if reached else codes
    _require(inner == Cell.FREE, lambda step: f"step {step} is in cell {_as_tuple(cells[step])}, which is not free")
    if reached and codes[-1] != Cell.GOAL:
        raise CertificateError(f"the last cell {_as_tuple(cells[-1])} is not a goal cell")
    if reached and path.goal != path.space.goal_region[tuple(cells[-1])]:
        raise CertificateError(f"the last cell belongs to goal {path.space.goal_region[tuple(cells[-1])]}")
    if len(np.unique(cells, axis=0)) < len(cells):
        raise CertificateError("a cell is visited twice")


def _check_crossings(path: Streamline) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the axis of every crossing of a face, and its direction along the axis, 1 or -1, both (steps,).

    Raise CertificateError unless every crossing leads to the next cell of the path, lies on the face between both
    cells, and follows the current.
    """
    space = path.space
    here, there = path.cells[:-1].astype(np.int64), path.cells[1:].astype(np.int64)
    number = np.arange(len(here))
    changed = here != there
    axis = np.argmax(changed, axis=1)
    # In a ring of two cells both faces connect them: the position of the point identifies the crossed face.
    entered = _cell_positions(path)[1 : len(path.cells)][number, axis]
    side = np.where(entered < 0.5, 1, -1)
    beyond, size = here[number, axis] + side, np.array(space.shape)[axis]
    beyond = np.where(space.periodic[axis], np.mod(beyond, size), beyond)

    def between(step: int) -> str:
        return f"cell {_as_tuple(here[step])} to cell {_as_tuple(there[step])}"

    leads = (changed.sum(axis=1) == 1) & (beyond == there[number, axis])
    _require(leads, lambda step: f"step {step}: the face that was crossed does not lead from {between(step)}")
    on_face = np.abs(entered - (side < 0)) <= space.rounding[axis]
    _require(on_face, lambda step: f"step {step}: the crossing does not lie on the face between its cells")
    along = side * path.field.faces_of(here)[0][(side > 0).astype(np.int64), number, axis] > 0
    _require(along, lambda step: f"step {step}: no current runs from {between(step)}")
    return axis, side


def _cell_positions(path: Streamline) -> NDArray[np.float64]:
    """Return the position of every point within its cell, in [0, 1], shape (points, ndim)."""
    return np.asarray((path.axis_points - path.space.lower) / path.space.spacing - path.point_cells)


def _check_descent(path: Streamline) -> None:
    """Raise CertificateError if the potential rises from a visited cell to the next; blends are not checked."""
    field = path.field
    if field.boundary == "blend":
        return
    at = tuple(path.cells.T)
    height = -field.log_drop[at] if field.log_drop is not None else field.potential[at]
    # Two potentials may be equal in float64; the direction of the current, known to more digits, was checked before.
    _require(
        np.diff(height) <= 0,
        lambda step: f"step {step}: the potential rises from cell {_as_tuple(path.cells[step])} to the next",
    )


def _check_extent(path: Streamline) -> None:
    """Raise CertificateError unless the stated length and clearance agree with those of the polyline ``path.line``."""
    space, field, line = path.space, path.field, path.line
    slack = 2.0 * float(np.linalg.norm(space.rounding * space.spacing))
    length = length_of(line)
    if not abs(length - path.length) <= slack * len(path.axis_points):
        raise CertificateError(f"the length is {length}, not {path.length}")
    clearance = clearance_of(line, space, field.edge, field.obstacle_reach)
    if clearance != path.clearance and not abs(clearance - path.clearance) <= slack:
        raise CertificateError(f"the clearance is {clearance}, not {path.clearance}")


def _require(valid: NDArray[np.bool_], message: Callable[[int], str]) -> None:
    """Raise CertificateError with ``message(i)`` for the first row i of `valid` (n, ...) that contains False."""
    if not valid.all():
        raise CertificateError(message(int(np.argwhere(~valid)[0, 0])))


def _as_tuple(cell: NDArray[np.int64]) -> tuple[int, ...]:
    """Return the indices (ndim,) of a cell as a tuple of int, for messages."""
    return tuple(cell.tolist())


@np.errstate(divide="ignore", invalid="ignore", over="ignore")  # overflow gives infinity, a valid bound
def _check_motion(path: Streamline, axis: Integers, side: Integers) -> None:
    """Raise CertificateError unless the current, linear between faces, carries every point to the next.

    `axis`, `side` (steps,): axis and direction, 1 or -1, of every crossing.  Near a stagnation point, a rounding error
    of the entry point changes the exit point and the time much.  Both are therefore compared with bounds over all entry
    points within rounding error.
    """
    local = _cell_positions(path)
    steps, slack = np.arange(len(axis)), _SLACK * path.space.rounding
    direction, log_current = path.field.faces_of(path.cells[:-1].astype(np.int64))
    scale = log_current.max(axis=(0, 2))
    lower, upper = direction * np.exp(log_current - scale[:, np.newaxis])
    start, end = np.clip(local[: len(axis)], 0.0, 1.0), local[1 : len(axis) + 1]
    up = side > 0
    shortest, longest, is_moving = _exit_times(
        np.where(up, start[steps, axis], 1.0 - start[steps, axis]),
        np.where(up, lower[steps, axis], -upper[steps, axis]),
        np.where(up, upper[steps, axis], -lower[steps, axis]),
        slack[axis],
    )
    low, high = _exit_bounds(start, lower, upper, (shortest, longest), slack)
    # Where the streamline may have left straight, it has not moved along the other axes.
    stays = ~is_moving[:, np.newaxis]
    low, high = np.where(stays, np.minimum(low, start), low), np.where(stays, np.maximum(high, start), high)
    carried = (end >= low - slack) & (end <= high + slack)
    carried[steps, axis] = True
    _require(carried, lambda step: f"point {step + 1} is not where the current carries the path from point {step}")
    _check_duration(path, np.log(shortest) - scale, np.log(longest) - scale)


def _exit_times(x: Floats, enter: Floats, leave: Floats, slack: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return the least and the largest time (steps,) from positions within `slack` of `x` to the face at 1, and a mask.

    The velocity is linear from `enter` at 0 to ``leave > 0`` at 1.  The mask (steps,) is False where the velocity may
    be zero or negative at a position within `slack` of `x`.  All arguments have the shape (steps,): `x`, positions in
    [0, 1] along the crossed axis, and `slack`, in cell widths; `enter`, `leave`, velocities in cell widths per time.
    """
    before, after = np.maximum(x - slack, 0.0), np.minimum(x + slack, 1.0)
    slowest, fastest = (enter * (1.0 - at) + leave * at for at in (before, after))
    straight = (1.0 - before) / leave
    is_moving = slowest > 0
    shortest, longest = _travel_time(after, fastest, leave), _travel_time(before, slowest, leave)
    # The velocity at the face exceeds the velocity at x, because the velocity falls towards x.
    endless = np.maximum(_LARGEST_LOG / np.where(is_moving, 1.0, leave - enter), straight)
    least_straight = (1.0 - after) / leave
    return (
        np.where(is_moving, shortest, np.minimum(shortest, least_straight)),
        np.where(is_moving, longest, np.where(fastest > 0, endless, straight)),
        is_moving,
    )


def _travel_time(x: Floats, velocity: Floats, leave: Floats) -> Floats:
    """Return the times from `x` to 1, for velocities linear from `velocity` at `x` to `leave` at 1.

    The time is infinite where `velocity` is not positive.
    """
    runs = velocity > 0
    z = np.where(runs, leave / np.where(runs, velocity, 1.0), 1.0) - 1.0
    factor = np.where(np.abs(z) < 1e-8, 1.0 - 0.5 * z, np.log1p(z) / np.where(z == 0, 1.0, z))
    return np.where(runs, (1.0 - x) / np.where(runs, velocity, 1.0) * factor, np.inf)


def _exit_bounds(
    start: Floats, lower: Floats, upper: Floats, times: tuple[Floats, Floats], slack: Floats
) -> tuple[Floats, Floats]:
    """Return the lower and the upper bounds of positions in [0, 1] after the given times, (steps, ndim).

    `start` (steps, ndim): initial positions within the cells, each uncertain by `slack` (ndim,); `lower`, `upper`
    (steps, ndim): velocities at the lower and the upper faces; `times`: least and largest time (steps,).
    """
    ends = [
        _advance(np.clip(start + off, 0.0, 1.0), lower, upper, time[:, np.newaxis])
        for off, time in product((-slack, slack), times)
    ]
    return np.min(ends, axis=0), np.max(ends, axis=0)


def _advance(x: Floats, lower: Floats, upper: Floats, time: Floats) -> Floats:
    """Return positions in [0, 1] at `time` after `x`, for velocities linear from `lower` at 0 to `upper` at 1."""
    velocity, growth = lower * (1.0 - x) + upper * x, (upper - lower) * time
    exact = velocity * np.expm1(growth) / (upper - lower)
    step = np.where(np.abs(growth) < 1e-8, velocity * time * (1.0 + 0.5 * growth), exact)
    return np.clip(x + np.where(velocity == 0, 0.0, step), 0.0, 1.0)


def _check_duration(path: Streamline, log_shortest: Floats, log_longest: Floats) -> None:
    """Raise CertificateError unless the duration of a path lies between the sums of the shortest and longest times.

    `log_shortest`, `log_longest` (steps,): natural logarithms of the times in the visited cells, for velocities in cell
    widths per time that equal the face currents; a duration is a sum of times, times the square of the smallest width.
    """
    unit = 2.0 * np.log(path.space.spacing.min())
    low, high = (float(np.logaddexp.reduce(logs, initial=-np.inf) + unit) for logs in (log_shortest, log_longest))
    claimed = float(path.log_duration)
    if not (np.isnan(claimed) and np.isneginf(low)) and not low - _SAME_TIME <= claimed <= high + _SAME_TIME:
        raise CertificateError(f"the logarithm of the duration is {low}, not {claimed}")
