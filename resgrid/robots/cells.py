"""The cells of a grid that lie within some distance of a shape, and those in which a goal is met, in closed form."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from itertools import product
from math import ceil
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.core.axis import Axis, Point, rounding, split_points
from resgrid.errors import InputError
from resgrid.robots.geometry import copies, edges_of
from resgrid.robots.shapes import Ball, Bounds, Box, CellSet, HalfSpace, Polygon, Shape, Solid, rings_of

Sampling = Literal["conservative", "centre"]
"""How a cell is judged: by its whole square, or by its centre alone."""

Progress = Callable[[int, int], object]
"""Called now and then with how much work is done, and how much there is in all."""

FAR = 1e3
"""So many times the size of the grid a ring may stick out before it is cut off."""

Grids = Sequence[NDArray[np.float64]]
"""Coordinates of cells along every axis, shaped to broadcast over a block."""

HALVINGS = 60
"""So often is the way to a region halved to find where it begins: to the last bit."""


def rims(axes: Sequence[Axis]) -> list[float]:
    """Width of the rim that a cell's interior leaves out, per axis, for an edge that is meant to lie on a border."""
    return [share * axis.spacing for share, axis in zip(rounding(axes).tolist(), axes, strict=True)]


def halves(axes: Sequence[Axis], bounds: Bounds, reach: float, rule: Sampling) -> tuple[float, ...]:
    """Half the width, per axis, of what stands for a cell beside a shape that grows by a distance."""
    if rule == "centre":
        return (0.0,) * len(axes)
    thin = [high - low + 2 * reach <= 2 * rim for low, high, rim in zip(*bounds, rims(axes), strict=True)]
    return tuple(
        axis.spacing / 2 + rim if flat else max(axis.spacing / 2 - rim, 0.0)
        for axis, rim, flat in zip(axes, rims(axes), thin, strict=True)
    )


def mark(out: NDArray[np.bool_], axes: tuple[Axis, ...], shape: Shape, reach: float, rule: Sampling) -> None:
    """Mark, in place, the cells that come within a distance of a shape."""
    if shape.ndim != len(axes):
        raise InputError(f"a shape with {shape.ndim} coordinates does not fit a grid with {len(axes)} axes")
    if isinstance(shape, CellSet):
        out |= _near_cells(shape, axes, reach, rule)
        return
    for copy in copies(shape, axes, [reach] * len(axes)):
        mark_copy(out, axes, copy, reach, rule)


def mark_copy(out: NDArray[np.bool_], axes: tuple[Axis, ...], shape: Solid, reach: float, rule: Sampling) -> None:
    """The same for one copy of a shape, which is cut off where it sticks out of the grid."""
    half = halves(axes, shape.bounds, reach, rule)
    if isinstance(shape, Polygon):
        _mark_polygon(out, axes, half, shape, reach)
        return
    block = tuple(
        slice(_clip((low - reach - axis.lower) / axis.spacing - 1, axis.cells),
              _clip((high + reach - axis.lower) / axis.spacing + 2, axis.cells))
        for axis, low, high in zip(axes, *shape.bounds, strict=True)
    )  # fmt: skip
    grids = np.meshgrid(
        *(axis.centres[part] for axis, part in zip(axes, block, strict=True)), indexing="ij", sparse=True
    )
    if isinstance(shape, HalfSpace):
        out[block] |= near_half_space(shape, grids, half, reach)
    else:
        out[block] |= _near_round(shape, grids, half, reach)


def _clip(index: float, cells: int) -> int:
    return ceil(min(max(index, 0.0), float(cells)))


def _near_round(shape: Box | Ball, centres: Grids, half: Sequence[float], reach: float) -> NDArray[np.bool_]:
    lower, upper = (shape.centre, shape.centre) if isinstance(shape, Ball) else shape.bounds
    within = reach + shape.radius if isinstance(shape, Ball) else reach
    squared = np.zeros((1,) * len(half))
    for centre, side, low, high in zip(centres, half, lower, upper, strict=True):
        gap = np.maximum(np.maximum(centre - side - high, low - (centre + side)), 0.0)
        squared = squared + gap**2
    return np.asarray(squared <= within**2)


def near_half_space(shape: HalfSpace, centres: Grids, half: Sequence[float], reach: float) -> NDArray[np.bool_]:
    """Which of some cells, of half widths (ndim,), come within a distance of a half-space; broadcast."""
    smallest = np.zeros((1,) * len(half))
    for centre, side, component in zip(centres, half, shape.normal, strict=True):
        smallest = smallest + component * centre - abs(component) * side
    return np.asarray(smallest <= shape.offset + reach * float(np.linalg.norm(shape.normal)))


def _near_cells(shape: CellSet, axes: tuple[Axis, ...], reach: float, rule: Sampling) -> NDArray[np.bool_]:
    if shape.axes != axes:
        raise InputError("the cells of a map can only be obstacles on the map's own grid")
    if reach == 0 or not shape.mask.any():
        return shape.mask
    pad = [(min(ceil(reach / axis.spacing) + 1, axis.cells) if axis.periodic else 0,) * 2 for axis in axes]
    spacing = np.array([axis.spacing for axis in axes])
    mask = np.pad(shape.mask, pad, mode="wrap")
    rim = min(rims(axes)) if rule == "conservative" else 0.0
    near = mask | (_distance_from_boxes(mask, spacing, rule) <= reach - rim)
    return near[tuple(slice(before, size - after) for (before, after), size in zip(pad, mask.shape, strict=True))]


def _distance_from_boxes(mask: NDArray[np.bool_], spacing: NDArray[np.float64], rule: Sampling) -> NDArray[np.float64]:
    """Exact distance from every cell's box (or centre) to the nearest marked box, by a Euclidean distance transform.

    Two boxes ``d`` cells apart leave ``max(|d| - 1, 0)`` cells between them, which is the distance of ``d`` to the
    nearest of ``-1, 0, 1``: grow the mask by one cell all round and measure between lattice points.  A centre and a
    box leave ``max(|d| - 1/2, 0)``: the same on a lattice twice as fine.
    """
    from scipy import ndimage

    if rule == "conservative":
        grown = ndimage.binary_dilation(mask, structure=np.ones((3,) * mask.ndim, dtype=bool))
        return np.asarray(ndimage.distance_transform_edt(~grown, sampling=spacing))
    fine = np.zeros(tuple(2 * n + 1 for n in mask.shape), dtype=bool)
    for offset in product(range(3), repeat=mask.ndim):
        fine[tuple(slice(start, start + 2 * n, 2) for start, n in zip(offset, mask.shape, strict=True))] |= mask
    distance = ndimage.distance_transform_edt(~fine, sampling=spacing / 2)
    return np.asarray(distance[(slice(1, None, 2),) * mask.ndim])


def _mark_polygon(
    out: NDArray[np.bool_], axes: Sequence[Axis], half: Sequence[float], polygon: Polygon, reach: float
) -> None:
    """The same for a polygon: a cell meets it if it meets the outline, or if its centre is enclosed."""
    from resgrid.robots.kernels import CellPlane, mark_enclosed, mark_parallelograms

    x, y = axes
    plane = CellPlane(x.lower, y.lower, x.spacing, y.spacing, half[0], half[1])
    edges = outline(polygon, axes, reach)
    mark_enclosed(out, edges, plane)
    sides = np.hstack([edges[:, :2], edges[:, 2:] - edges[:, :2], np.zeros((len(edges), 2))])
    mark_parallelograms(out, sides, reach, plane)


def outline(shape: Box | Polygon, axes: Sequence[Axis], reach: float) -> NDArray[np.float64]:
    """Edges of a polygon or rectangle, ring by ring.  Returns (e, 4)."""
    margin = reach + max(axis.upper - axis.lower for axis in axes)
    lower, upper = (axes[0].lower - margin, axes[1].lower - margin), (axes[0].upper + margin, axes[1].upper + margin)
    return edges_of([_cut(ring, lower, upper, FAR * margin) for ring in rings_of(shape)])


def _cut(ring: tuple[Point, ...], lower: Point, upper: Point, far: float) -> Sequence[Point]:
    """The part of a ring in a box, if it has corners far outside (Sutherland and Hodgman, 1974)."""
    beyond = max(max(low - c, c - high) for point in ring for c, low, high in zip(point, lower, upper, strict=True))
    if beyond <= far:
        return ring
    corners: list[tuple[Fraction, ...]] = [tuple(map(Fraction, point)) for point in ring]
    for k, end, sign in ((0, lower, -1), (0, upper, 1), (1, lower, -1), (1, upper, 1)):
        bound = Fraction(end[k])
        kept: list[tuple[Fraction, ...]] = []
        for a, b in zip(corners, [*corners[1:], *corners[:1]], strict=True):
            inside = sign * a[k] <= sign * bound
            if inside:
                kept.append(a)
            if inside != (sign * b[k] <= sign * bound):
                share = (bound - a[k]) / (b[k] - a[k])
                kept.append(tuple(p + share * (q - p) for p, q in zip(a, b, strict=True)))
        corners = kept
    return [tuple(map(float, point)) for point in corners] or [lower]


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
