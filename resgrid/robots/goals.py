"""Goal cells, and in each of them a configuration that solves the goal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.axis import Axis, Point, split_points
from resgrid.errors import InputError
from resgrid.robots.cells import mark_copy, outline, rims
from resgrid.robots.geometry import copies
from resgrid.robots.shapes import Ball, Box, CellSet, HalfSpace, Polygon, Shape, Solid

HALVINGS = 60
"""So often is the way to a region halved to find where it begins: to the last bit."""


class GoalCells(NamedTuple):
    """The cells of a goal, and where in each of them it is.

    `cells`: one entry per cell, True where the closed cell holds a configuration that solves the goal; `points`
    (number of such cells, ndim): such a configuration for each of them, in C order, in axis units.
    """

    cells: NDArray[np.bool_]
    points: NDArray[np.float64]


def cells_of_place(axes: Sequence[Axis], region: Shape | Point) -> GoalCells:
    """The cells of a grid that meet a region of it, with the nearest point of the region to each cell's centre."""
    axes = tuple(axes)
    shape = tuple(axis.cells for axis in axes)
    if (len(region) if isinstance(region, tuple) else region.ndim) != len(axes):
        raise InputError(f"a goal does not fit a grid with {len(axes)} axes: {region}")
    lower, spacing = np.array([(axis.lower, axis.spacing) for axis in axes]).T
    if isinstance(region, tuple):
        cell, local = split_points(axes, region)
        cells = np.zeros(shape, dtype=bool)
        cells[tuple(cell)] = True
        return GoalCells(cells, (lower + (cell + local) * spacing)[None])
    if isinstance(region, CellSet):
        return GoalCells(region.mask, lower + (np.argwhere(region.mask) + 0.5) * spacing)
    return joined(shape, [_met_by_copy(axes, copy) for copy in copies(region, axes, [0.0] * len(axes))])


def joined(shape: tuple[int, ...], goals: Sequence[GoalCells]) -> GoalCells:
    """Several goals as one; where they share a cell, with the point of the first."""
    met, points = [np.empty(0, dtype=np.int64)], [np.empty((0, len(shape)))]
    for goal in goals:
        met.append(np.flatnonzero(goal.cells))
        points.append(goal.points)
    every, first = np.unique(np.concatenate(met), return_index=True)
    cells = np.zeros(shape, dtype=bool)
    cells.reshape(-1)[every] = True
    return GoalCells(cells, np.concatenate(points)[first])


def _met_by_copy(axes: tuple[Axis, ...], shape: Solid) -> GoalCells:
    """Cells that a shape meets where it stands, and the point of it nearest to each centre."""
    centred = np.zeros(tuple(axis.cells for axis in axes), dtype=bool)
    mark_copy(centred, axes, shape, 0.0, "centre")
    met = centred.copy()
    mark_copy(met, axes, shape, 0.0, "conservative")
    lower, spacing = np.array([(axis.lower, axis.spacing) for axis in axes]).T
    points = lower + (np.argwhere(met) + 0.5) * spacing
    beside = ~centred[met]
    points[beside] = _nearest(shape, points[beside], axes)
    return GoalCells(met, points)


def _nearest(shape: Solid, middle: NDArray[np.float64], axes: tuple[Axis, ...]) -> NDArray[np.float64]:
    """Nearest points of a shape to the centres, shape (m, ndim), of cells that it meets, each within its cell."""
    half = np.array([axis.spacing for axis in axes]) / 2
    match shape:
        case Box(lower, upper):
            return np.clip(np.clip(middle, lower, upper), middle - half, middle + half)
        case Ball(centre, radius):
            return _first_within(
                middle, half, np.array(centre) - middle, lambda at: np.linalg.norm(at - centre, axis=1) <= radius
            )
        case HalfSpace(normal, offset):
            leans = np.abs(normal) > 1e-12 * np.abs(normal).max()
            farthest = float((half[leans] / np.abs(normal)[leans]).max())
            step = np.where(leans, normal, 0.0) * -farthest
            return _first_within(middle, half, step, lambda at: at @ np.array(normal) <= offset)
        case Polygon():
            return _nearest_on_outline(outline(shape, axes, 0.0), middle, half, np.array(rims(axes)))


def _first_within(
    middle: NDArray[np.float64],
    half: NDArray[np.float64],
    step: NDArray[np.float64],
    inside: Callable[[NDArray[np.float64]], NDArray[np.bool_]],
) -> NDArray[np.float64]:
    """Where a convex region begins on the way that starts at the centre, aims at the region and keeps to the cell.

    The point of a box nearest to its centre, among those of a ball or half-space, minimises a quadratic whose
    gradient leads along ``step``, and is so some ``clip(middle + s step)``.
    """
    out, into = np.zeros((len(middle), 1)), np.ones((len(middle), 1))
    for _ in range(HALVINGS):
        between = (out + into) / 2
        within = inside(np.clip(middle + between * step, middle - half, middle + half))[:, None]
        out, into = np.where(within, out, between), np.where(within, between, into)
    return np.clip(middle + into * step, middle - half, middle + half)


def _nearest_on_outline(
    edges: NDArray[np.float64], middle: NDArray[np.float64], half: NDArray[np.float64], rim: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Nearest points to the centres, shape (m, 2), of cells, of what each cell cuts from edges, shape (e, 4)."""
    import shapely

    lines = shapely.multilinestrings(edges.reshape(-1, 2, 2))
    reach = half + rim
    pieces = np.asarray(shapely.intersection(lines, shapely.box(*(middle - reach).T, *(middle + reach).T)))
    pieces[shapely.is_empty(pieces)] = lines
    ways = shapely.shortest_line(shapely.points(middle), pieces)
    return np.clip(shapely.get_coordinates(ways)[1::2], middle - half, middle + half)
