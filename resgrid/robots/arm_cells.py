"""Blocked cells and goal cells in the configuration space of a planar arm."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, pi

import numpy as np
from numpy.typing import NDArray

from resgrid.core.axis import Axis, Point
from resgrid.errors import InputError
from resgrid.robots.cells import GoalCells, Progress, Sampling
from resgrid.robots.geometry import ArmLinks, RigidPart, obstacle_arrays, obstacles_of
from resgrid.robots.shapes import Box, Shape, require_plane

CHUNK = 1 << 17
"""Number of cells that one call of a compiled kernel tests; progress is reported after every call."""

PARTS = 3
"""Number of equal parts per joint into which a cell is divided if the test of the whole cell finds a possible
collision.
"""

SLACK = 1e-12
"""Bound on the rounding error of a distance, as a fraction of the largest length among the arm's reach and the absolute
coordinates of its base and of the obstacles.
"""

TOLERANCE = 1e-9
"""Largest distance of the tip from the goal region at which the tip counts as inside, as a fraction of the arm's
reach.
"""


def arm_occupancy(
    links: ArmLinks, axes: tuple[Axis, ...], obstacles: Sequence[Shape], rule: Sampling,
    progress: Progress | None = None, *, self_collision: bool,
) -> NDArray[np.bool_]:  # fmt: skip
    """Return the mask of cells in which an arm may collide with an obstacle or with itself, shape of the grid.

    With the rule ``"conservative"``, a cell is free if, at its centre or at the centres of all its parts (`PARTS` per
    joint), every link is farther from every obstacle than any point of the link can move within the cell or part.
    No cell with a collision is marked free.  With ``"centre"``, only the configuration at the centre is tested.  The
    links are tested from the base outwards: a cell of the first joints that collides is blocked for all angles of the
    further joints.
    `links`: the arm; `axes`: one axis per joint, in radians; `obstacles`: shapes in metres; `progress`: called as
    ``progress(done, total)`` with numbers of tested cells; `self_collision`: whether contacts of links that are not
    adjacent are collisions.
    """
    from resgrid.robots.kernels import mark_link

    solid = obstacle_arrays(require_plane(shape, "an arm") for shape in obstacles)
    ndim = len(axes)
    counts = np.array([axis.cells for axis in axes], dtype=np.int64)
    centres = np.zeros((ndim, counts.max()))
    for joint, axis in enumerate(axes):
        centres[joint, : axis.cells] = axis.centres
    widths = np.array([axis.spacing if rule == "conservative" else 0.0 for axis in axes])
    coordinates = np.abs([*links.base[:2], *solid.edges.ravel(), *solid.discs.ravel()])
    extent = max(links.lengths.sum(), coordinates.max())
    slack = SLACK * extent if rule == "conservative" else 0.0
    total, done = int(np.cumprod(counts).sum()), 0
    blocked = np.zeros(1, dtype=bool)
    for link in range(ndim):
        blocked = np.repeat(blocked, counts[link])
        for first in range(0, len(blocked), CHUNK):
            last = min(first + CHUNK, len(blocked))
            mark_link(blocked, first, last, link, counts, centres, widths, links, self_collision, PARTS, slack, solid)
            done += last - first
            if progress is not None:
                progress(done, total)
    return blocked.reshape(tuple(counts))


def arm_goal_cells(links: ArmLinks, axes: tuple[Axis, ...], region: Shape | Point) -> GoalCells:
    """Return the cells that contain a configuration with the tip in a region, with one such configuration per cell.

    The tip may be outside the region by 1e-9 of the arm's reach.  A cell is excluded if an upper bound on the motion of
    the tip within the cell shows that the tip stays outside.  A cell is also excluded if the search is still undecided
    after 200,000 subdivisions; in such a cell the tip touches the border of the region to within rounding error.
    `links`: the arm; `axes`: one axis per joint, in radians; `region`: shape or point in the plane, in metres.  Raise
    InputError for a region that the tip cannot reach at any joint angles.
    """
    from resgrid.robots.tip_kernels import find_goal_cells

    if isinstance(region, tuple) and len(region) != 2:
        raise InputError(f"an arm moves in the plane: a point needs 2 coordinates, got {len(region)}")
    place = require_plane(Box(region, region) if isinstance(region, tuple) else region, "an arm")
    goal, reach = obstacle_arrays([place]), float(links.lengths.sum())
    shortest = max(0.0, 2 * float(links.lengths.max()) - reach)
    nearest, farthest = _distances(place, tuple(links.base[:2].tolist()))
    if nearest > reach * (1 + 1e-12):
        raise InputError(
            f"the goal is {nearest:.4g} from the base, the arm reaches {reach:.4g}; move the goal or the base"
        )
    if farthest < shortest * (1 - 1e-12):
        raise InputError(
            f"the goal is {farthest:.4g} from the base, but the arm cannot fold nearer than {shortest:.4g}; "
            "move the goal or the base"
        )
    cells = np.zeros(tuple(axis.cells for axis in axes), dtype=bool)
    flat, points = cells.reshape(-1), [np.empty((0, len(axes)))]
    margin = (1 + TOLERANCE) * tip_travel(links, axes) + TOLERANCE * reach
    bounds = np.concatenate([np.subtract(place.bounds[0], margin), np.add(place.bounds[1], margin)])
    lower, spacing = np.array([(axis.lower, axis.spacing) for axis in axes]).T.copy()
    for first in range(0, flat.size, CHUNK):
        out = flat[first : first + CHUNK]
        solutions = np.empty((out.size, len(axes)))
        counts, tolerance = np.array(cells.shape), TOLERANCE * reach
        find_goal_cells(out, solutions, first, counts, lower, spacing, links, goal, bounds, tolerance)
        points.append(solutions[out])
    return GoalCells(cells, np.concatenate(points))


def tip_travel(links: ArmLinks, axes: Sequence[Axis]) -> float:
    """Return an upper bound, in metres, of the distance of the tip from its position at the centre of a cell.

    The bound holds for all configurations in the cell.  `links`: the arm; `axes`: one axis per joint, in radians; the
    spacing of an axis is the width of a cell.
    """
    chords = [2 * np.sin(min(axis.spacing / 2, pi) / 2) for axis in axes]
    levers = np.cumsum(links.lengths[::-1])[::-1] if links.relative else links.lengths
    return float(np.dot(chords, levers))


def _distances(place: Shape, base: Point) -> tuple[float, float]:
    """Return the smallest and the largest distance, in metres, from the point `base` to points of the region `place`.

    The largest distance is infinite for a half-plane.
    """
    import shapely

    obstacle = obstacles_of([place])[0]
    nearest = float(obstacle.distance(RigidPart(np.array([shapely.Point(base)]), 0.0))[0])
    if obstacle.core is None:
        return nearest, inf
    farthest = np.hypot(*(shapely.get_coordinates(obstacle.core) - base).T).max()  # a corner
    return nearest, float(farthest) + obstacle.radius
