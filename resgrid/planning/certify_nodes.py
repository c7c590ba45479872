"""Certificate of paths from node to node, without the code that compiles lattices and follows currents.

The certificate reads from the lattice only the points of sites and the displacements and weights of steps.  The closed
boxes of the cells decide which segments are clear.  The potential, the currents and the cells of the space decide the
order of the sites and the outcome.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.core.cell import Cell
from resgrid.errors import CertificateError
from resgrid.planning.clearance import clearance_of
from resgrid.planning.lattice_fields import SAME_CURRENT
from resgrid.planning.node_paths import NodePath
from resgrid.planning.streamline import Outcome, length_of

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def certify_nodes(path: NodePath) -> None:
    """Raise CertificateError at the first property or number of a node path that is wrong.

    A path that reached a goal must satisfy all of the following.

    - It begins at the start, in a free or goal cell, and a straight line within this cell leads to its first site.
    - Consecutive sites are neighbours: their displacement is a step of the lattice.
    - No segment between sites touches an obstacle cell (closed, so that no corner is cut) or leaves the grid.
    - Along every step flows the largest outward current of the site, or the current with the largest density (current
      over weight and length of the step), as `LatticeField.read_out` states.  The potential does not rise: two
      potentials may round to one double, but the direction of the current is known.
    - All sites are distinct, all but the last lie in free cells, and the last one in the stated goal region.
    - Length and clearance agree with the polyline.

    For other outcomes, the outcome must be true.
    """
    _check_kinds(path)
    if path.outcome in {Outcome.REACHED, Outcome.NO_CURRENT}:
        _check_ends(path)
        if len(path.nodes):
            step, sense = _check_steps(path)
            _check_segments(path)
            _check_currents(path, step, sense)
        _check_extent(path)
    elif len(path.nodes) or len(path.line) != 1 or path.goal is not None or path.length != 0:
        raise CertificateError(f"a path with outcome {path.outcome.value} has no site, length 0 and no goal")
    if path.outcome is not Outcome.REACHED:
        _check_failure(path)


def _check_kinds(path: NodePath) -> None:
    """Raise CertificateError unless shapes are valid, numbers are finite, and cells are those of the sites."""
    space, lattice = path.space, path.field.lattice
    count = max(len(path.nodes), 1)
    if path.line.ndim != 2 or path.line.shape[1] != space.ndim or path.cells.shape != (count, space.ndim):
        raise CertificateError(f"points of shape {path.line.shape} and cells of shape {path.cells.shape} do not fit")
    if path.nodes.ndim != 2 or np.any(path.nodes < 0) or np.any(path.nodes >= lattice.shape):
        raise CertificateError("a site of the path is not in the lattice")
    if not np.isfinite(path.line).all():
        raise CertificateError(f"point {int(np.argmin(np.isfinite(path.line).all(axis=1)))} is not finite")
    if len(path.nodes):
        found = np.floor((lattice.points(path.nodes) - space.lower) / space.spacing)
        if not np.array_equal(found, path.cells):
            raise CertificateError("the cells of the path do not contain its sites")


def _check_ends(path: NodePath) -> None:
    """Raise CertificateError unless start, sites and goal point of a path lie in the cells that the path states.

    All sites must be distinct and in free cells, except the last site of a path that reached a goal.  This site must
    lie in a goal cell of the stated region, and the path must end at the cell's goal point, within the cell, if the
    space defines one.
    """
    space, cells = path.space, path.cells
    code = space.cell[tuple(cells.T)]
    reached = path.outcome is Outcome.REACHED
    if np.any(code[: len(code) - reached] != Cell.FREE):
        raise CertificateError(f"site {int(np.argmax(code != Cell.FREE))} does not lie in a free cell")
    if reached and (code[-1] != Cell.GOAL or path.goal != space.goal_region[tuple(cells[-1])]):
        raise CertificateError(f"the last site does not lie in goal {path.goal}")
    if not reached and path.goal is not None:
        raise CertificateError(f"the path states goal {path.goal}, but reaches none")
    if len(np.unique(path.nodes, axis=0)) < len(path.nodes):
        raise CertificateError("a site is visited twice")
    if not _in_cell(path, path.line[0], cells[0]):
        raise CertificateError("the start does not lie in the cell of the first site")
    last = space.goal_point(cells[-1])
    if reached and not np.isnan(last).any():
        gap = path.line[-1] - last
        if np.any(np.abs(gap - _turns(path, gap)) > space.rounding * space.spacing):
            raise CertificateError(f"the path ends at {path.line[-1].tolist()}, not at the goal point {last.tolist()}")
        if not _in_cell(path, path.line[-1], cells[-1]):
            raise CertificateError("the last leg leaves the goal cell")


def _turns(path: NodePath, gap: Floats) -> Floats:
    """Return the multiples of the periods nearest to differences of coordinates, in axis units, (..., ndim).

    The multiple is 0 on axes that are not periodic.  `gap` (..., ndim): the differences, in axis units.
    """
    period = path.space.upper - path.space.lower
    return np.where(path.space.periodic, np.round(gap / period) * period, 0.0)


def _in_cell(path: NodePath, point: Floats, cell: Integers) -> bool:
    """Return whether a closed cell, or a periodic image of it, contains a point (ndim,) to within rounding error.

    `path`: gives the space; `point` (ndim,): in axis units; `cell` (ndim,): index of the cell.
    """
    space = path.space
    gap = point - space.axis_centre(cell)
    gap = (gap - _turns(path, gap)) / space.spacing
    return bool(np.all(np.abs(gap) <= 0.5 + space.rounding))


def _at_sites(path: NodePath) -> Floats:
    """Return the points of the polyline that belong to its sites, (sites, ndim), without start and goal point.

    Raise CertificateError if a point is not at its site.
    """
    space, line = path.space, path.line
    points = path.field.lattice.points(path.nodes)
    slack = 4.0 * space.rounding * space.spacing
    leg = path.outcome is Outcome.REACHED and not np.isnan(space.goal_point(path.cells[-1])).any()
    first = len(line) - leg - len(points)
    if first not in (0, 1):
        raise CertificateError(f"{len(line)} points do not fit {len(points)} sites")
    own = line[first : first + len(points)]
    gap = own - points
    wrong = np.any(np.abs(gap - _turns(path, gap)) > slack, axis=1)
    if wrong.any():
        raise CertificateError(f"point {first + int(np.argmax(wrong))} is not at its site")
    return own


def _check_steps(path: NodePath) -> tuple[Integers, Integers]:
    """Return, for every pair of consecutive sites, the index of the lattice's step and its sense, (steps,) each.

    The sense is 1 for the step, -1 for its negative.  Raise CertificateError if consecutive sites are no neighbours.
    """
    lattice = path.field.lattice
    moved = np.diff(_at_sites(path), axis=0)[:, np.newaxis]
    slack = 8.0 * path.space.rounding * path.space.spacing
    up, down = (np.all(np.abs(moved - sense * lattice.steps) <= slack, axis=2) for sense in (1, -1))
    wrong = (up | down).sum(axis=1) != 1
    if wrong.any():
        raise CertificateError(f"step {int(np.argmax(wrong))} does not lead to a neighbour of its site")
    return np.argmax(up | down, axis=1), np.where(up.any(axis=1), 1, -1)


def _check_segments(path: NodePath) -> None:
    """Raise CertificateError if a segment between sites touches an obstacle cell or a place outside the grid.

    Cells are closed boxes, enlarged by the rounding error of positions.
    """
    space = path.space
    scaled = (_at_sites(path) - space.lower) / space.spacing
    start, end = scaled[:-1], scaled[1:]
    first = np.floor(np.minimum(start, end) - space.rounding)
    counts = (np.floor(np.maximum(start, end) + space.rounding) - first).max(axis=0, initial=0).astype(int) + 1
    for offset in product(*(range(count) for count in counts.tolist())):
        cell = (first + offset).astype(np.int64)
        touched = _touches(start, end, cell, space.rounding)
        inside = np.all((cell >= 0) & (cell < space.shape) | space.periodic, axis=1)
        solid = space.cell[tuple(np.mod(cell, space.shape).T)] == Cell.OBSTACLE
        wrong = touched & (~inside | solid)
        if wrong.any():
            step = int(np.argmax(wrong))
            raise CertificateError(
                f"the segment of step {step} touches cell {tuple(cell[step].tolist())}, which is not free or outside "
                "the grid"
            )


def _touches(start: Floats, end: Floats, cell: Integers, rim: Floats) -> NDArray[np.bool_]:
    """Return whether segments from `start` to `end` (n, ndim) touch closed boxes, (n,).

    All lengths are in cell widths: the boxes extend from `cell` (n, ndim) to ``cell + 1``, enlarged by `rim` (ndim,).
    """
    moved = end - start
    low, high = cell - rim - start, cell + 1 + rim - start
    with np.errstate(divide="ignore", invalid="ignore"):
        near, far = np.sort(np.stack([low / moved, high / moved]), axis=0)
    still = moved == 0
    near = np.where(still, np.where((low <= 0) & (high >= 0), -np.inf, np.inf), near)
    far = np.where(still, np.inf, far)
    return np.asarray(np.maximum(near.max(axis=1), 0.0) <= np.minimum(far.min(axis=1), 1.0))


def _check_currents(path: NodePath, step: Integers, sense: Integers) -> None:
    """Raise CertificateError unless every step of a path follows the largest outward current, or density, of its site.

    A density is the current over weight and length of the step.  The potential must also not rise, except in a blend.
    `step`, `sense` (steps,): index of the lattice's step between consecutive sites, and the sense: 1 for the step, -1
    for its negative.
    """
    field = path.field
    flat = np.ravel_multi_index(tuple(path.nodes.T), field.lattice.shape)
    tail = np.where(sense > 0, flat[:-1], flat[1:])  # the current of a step is stored at its lower end
    direction = _taken(field.step_direction, step, tail)
    if np.any(direction != sense):
        raise CertificateError(f"step {int(np.argmax(direction != sense))}: no current flows along it")
    rating, slack = _taken(field.step_log_current, step, tail), np.full(len(step), 2.0 * SAME_CURRENT)
    if field.read_out == "density":
        moved = np.linalg.norm(np.diff(_at_sites(path), axis=0), axis=1)
        rating = rating - np.log(field.lattice.site_weights[step, tail] * moved / path.space.spacing.min())
        slack += 2.0 * np.linalg.norm(path.space.rounding * path.space.spacing) / moved  # both ends of the step round
    less = rating < field.largest_rating[flat[:-1]] - slack
    if less.any():
        raise CertificateError(f"step {int(np.argmax(less))}: another {field.read_out} of its site is larger")
    if field.boundary == "blend":
        return
    rises = np.diff(field.potential.ravel()[flat]) > 0
    if field.log_drop is not None:
        rises |= np.diff(field.log_drop.ravel()[flat]) < 0
    if rises.any():
        raise CertificateError(f"step {int(np.argmax(rises))}: the potential rises")


def _taken(parts: Sequence[NDArray[Any]], step: Integers, tail: Integers) -> NDArray[Any]:
    """Return the values (n,) of n pairs of a step and a site.

    `parts`: values at all sites, one array of the lattice's shape per step; `step`, `tail` (n,): index of the step, and
    flat index of the site, of every pair.
    """
    found = np.zeros(len(step), dtype=parts[0].dtype)
    for number in np.unique(step).tolist():
        own = step == number
        found[own] = parts[number].ravel()[tail[own]]
    return found


def _check_extent(path: NodePath) -> None:
    """Raise CertificateError unless the stated length and clearance agree with the polyline."""
    space = path.space
    slack = 2.0 * float(np.linalg.norm(space.rounding * space.spacing))
    length = length_of(path.line)
    if not abs(length - path.length) <= slack * len(path.line):
        raise CertificateError(f"the length is {length}, not {path.length}")
    clearance = clearance_of(path.line, space, path.field.edge, path.field.obstacle_reach)
    if clearance != path.clearance and not abs(clearance - path.clearance) <= slack:
        raise CertificateError(f"the clearance is {clearance}, not {path.clearance}")


def _check_failure(path: NodePath) -> None:
    """Raise CertificateError unless the outcome of a path that reached no goal is true.

    The start cell decides: it is an obstacle, has no path to a goal, or has a path; in the last case (``no_current``)
    no current may leave the last site.
    """
    space, start = path.space, tuple(path.cells[0].tolist())
    code, connected = space.cell[start], bool(space.goal_connected[start])
    blocked = not space.goal_connected.any()
    still = len(path.nodes) > 0 and not np.isfinite(
        path.field.largest_rating[np.ravel_multi_index(tuple(path.nodes[-1]), path.field.lattice.shape)]
    )
    true = {
        Outcome.START_BLOCKED: code == Cell.OBSTACLE,
        Outcome.NO_PATH: code == Cell.FREE and not connected and not blocked,
        Outcome.GOAL_BLOCKED: code == Cell.FREE and blocked,
        Outcome.NO_CURRENT: connected and still,
    }
    if not true[path.outcome]:
        raise CertificateError(f"the outcome {path.outcome.value} of the start cell {start} is not true")
