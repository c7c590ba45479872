"""Cells of a grid within a distance of a shape (obstacles), or that meet a shape or point (goals, with solutions)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from math import ceil
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.core.axis import Axis, Point, rounding, split_points
from resgrid.errors import InputError
from resgrid.robots.bounded import Bounds
from resgrid.robots.box_distances import near_boxes
from resgrid.robots.geometry import edges_of, periodic_images
from resgrid.robots.mesh import Mesh
from resgrid.robots.mesh_cells import near_mesh
from resgrid.robots.shapes import Ball, Box, CellSet, HalfSpace, Polygon, Shape, SingleShape, SpaceSolid, rings_of
from resgrid.robots.solid_cells import near_convex
from resgrid.robots.solids import Capsule, Cylinder, OrientedBox
from resgrid.robots.voxels import Voxels

Sampling = Literal["conservative", "centre"]
"""Rule for blocked cells: test the whole cell (``"conservative"``) or only its centre (``"centre"``)."""

Progress = Callable[[int, int], object]
"""Progress callback ``progress(done, total)`` with the finished and the total amount of work, in arbitrary units."""

FAR = 1e3
"""Largest distance, in margins, of a polygon's corners from the grid enlarged by one margin for which it is unclipped.

The margin is the largest side of the grid plus the distance up to which cells are marked around the polygon.
"""

Grids = Sequence[NDArray[np.float64]]
"""One array per axis: coordinates of cell centres in axis units, with shapes that broadcast to a block of cells."""

BISECTIONS = 60
"""Number of bisection steps in `_enter_region`; each halves the error, so that 60 give full float64 precision."""


def rims(axes: Sequence[Axis]) -> list[float]:
    """Return the rounding margin of each axis, in axis units.

    Before a test against an obstacle, a cell is reduced by the margin on every side.  Rounding moves an obstacle's edge
    that is meant to lie on a border between cells by less than this margin.
    """
    return [fraction * axis.spacing for fraction, axis in zip(rounding(axes).tolist(), axes, strict=True)]


def half_widths(axes: Sequence[Axis], bounds: Bounds, reach: float, rule: Sampling) -> tuple[float, ...]:
    """Return half the width, per axis and in axis units, of the box that is tested in place of a cell.

    The box is a point with the rule ``"centre"``, and otherwise the cell without its rounding margin (`rims`).  If the
    shape, dilated by `reach`, is thinner along an axis than two margins, the box is the cell plus the margin along that
    axis, so that no cell is missed.  `bounds`: bounding box of the shape; `reach`: dilation of the shape in axis units.
    """
    if rule == "centre":
        return (0.0,) * len(axes)
    thin = [high - low + 2 * reach <= 2 * rim for low, high, rim in zip(*bounds, rims(axes), strict=True)]
    return tuple(
        axis.spacing / 2 + rim if flat else max(axis.spacing / 2 - rim, 0.0)
        for axis, rim, flat in zip(axes, rims(axes), thin, strict=True)
    )


def mark(out: NDArray[np.bool_], axes: tuple[Axis, ...], shape: Shape, reach: float, rule: Sampling) -> None:
    """Mark, in place, the cells within a distance of a shape or of its periodic images.

    `out`: mask, shape of the grid, in which cells are set to True; `axes`: axes of the grid; `reach`: distance in axis
    units; `rule`: whether the whole cell (``"conservative"``) or only the centre of the cell (``"centre"``) is tested.
    """
    if shape.ndim != len(axes):
        raise InputError(f"a shape with {shape.ndim} coordinates does not fit a grid with {len(axes)} axes")
    if isinstance(shape, CellSet):
        out |= _near_cells(shape, axes, reach, rule)
        return
    if isinstance(shape, Voxels):
        _mark_voxels(out, axes, shape, reach, rule)
        return
    for image in periodic_images(shape, axes, [reach] * len(axes)):
        mark_image(out, axes, image, reach, rule)


def mark_image(
    out: NDArray[np.bool_], axes: tuple[Axis, ...], shape: SingleShape, reach: float, rule: Sampling
) -> None:
    """Mark, in place, the cells within a distance of one shape, without its periodic images.

    `out`: mask, shape of the grid, in which cells are set to True; `axes`: axes of the grid; `shape`: shape that may
    extend beyond the grid; `reach`: distance in axis units; `rule`: whether the whole cell (``"conservative"``) or only
    its centre (``"centre"``) is tested.
    """
    half = half_widths(axes, shape.bounds, reach, rule)
    if isinstance(shape, Mesh) and rule == "conservative" and not shape.is_closed:  # may lie between two cells
        half = tuple(axis.spacing / 2 + rim for axis, rim in zip(axes, rims(axes), strict=True))
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
    elif isinstance(shape, Mesh):
        spacing = np.array([axis.spacing for axis in axes])
        out[block] |= near_mesh(shape, grids, half, reach, spacing)
    elif isinstance(shape, Cylinder | Capsule | OrientedBox):
        out[block] |= near_convex(shape, grids, half, reach)
    else:
        out[block] |= _near_round(shape, grids, half, reach)


def _mark_voxels(out: NDArray[np.bool_], axes: tuple[Axis, ...], shape: Voxels, reach: float, rule: Sampling) -> None:
    """Mark, in place, the cells within a distance of voxels or of their periodic images.

    `out`: mask, shape of the grid, in which cells are set to True; `axes`: axes of the grid; `reach`: distance in axis
    units; `rule`: whether the whole cell (``"conservative"``) or only its centre (``"centre"``) is tested.
    """
    if reach > 0 or any(axis.periodic for axis in axes):
        for low, high in shape.corners.tolist():
            mark(out, axes, Box(tuple(low), tuple(high)), reach, rule)
        return
    half = half_widths(axes, ((0.0,) * 3, (shape.size,) * 3), reach, rule)
    lower, upper = shape.corners.transpose(1, 2, 0)
    first = [np.searchsorted(axis.centres + side, low) for axis, side, low in zip(axes, half, lower, strict=True)]
    last = [
        np.searchsorted(axis.centres - side, high, side="right")
        for axis, side, high in zip(axes, half, upper, strict=True)
    ]
    for (x0, y0, z0), (x1, y1, z1) in zip(np.transpose(first).tolist(), np.transpose(last).tolist(), strict=True):
        out[x0:x1, y0:y1, z0:z1] = True


def _clip(index: float, cells: int) -> int:
    """Return `index`, a coordinate in cell widths, rounded up and clipped to the range from 0 to `cells`."""
    return ceil(min(max(index, 0.0), float(cells)))


def _near_round(shape: Box | Ball, centres: Grids, half: Sequence[float], reach: float) -> NDArray[np.bool_]:
    """Return the mask, shape of a block of cells, of cells whose tested box is within a distance of a box or ball.

    `centres`: cell centres, an array per axis; `half` (ndim,): half the widths of the box that is tested in place of a
    cell, 0 to test only the centre; `reach`: distance; lengths are in axis units.
    """
    lower, upper = (shape.centre, shape.centre) if isinstance(shape, Ball) else shape.bounds
    within = reach + shape.radius if isinstance(shape, Ball) else reach
    squared = np.zeros((1,) * len(half))
    for centre, side, low, high in zip(centres, half, lower, upper, strict=True):
        gap = np.maximum(np.maximum(centre - side - high, low - (centre + side)), 0.0)
        squared = squared + gap**2
    return np.asarray(squared <= within**2)


def near_half_space(shape: HalfSpace, centres: Grids, half: Sequence[float], reach: float) -> NDArray[np.bool_]:
    """Return the mask, shape of a block of cells, of cells whose tested box is within a distance of a half-space.

    `centres`: cell centres, an array per axis; `half` (ndim,): half the widths of the box that is tested in place of a
    cell, 0 to test only the centre; `reach`: distance; lengths are in axis units.
    """
    smallest = np.zeros((1,) * len(half))
    for centre, side, component in zip(centres, half, shape.normal, strict=True):
        smallest = smallest + component * centre - abs(component) * side
    return np.asarray(smallest <= shape.offset + reach * float(np.linalg.norm(shape.normal)))


def _near_cells(shape: CellSet, axes: tuple[Axis, ...], reach: float, rule: Sampling) -> NDArray[np.bool_]:
    """Return the mask, shape of the grid, of cells within a distance of a set of cells of the same or a larger grid.

    `axes`: axes of the grid, which those of the set may extend by whole cells; `reach`: distance in axis units; `rule`:
    whether the distance is measured from the cell's box (``"conservative"``) or its centre (``"centre"``).
    """
    if shape.axes != axes:
        return _near_cells(shape, shape.axes, reach, rule)[_part_of_grid(shape.axes, axes)]
    if reach == 0 or not shape.mask.any():
        return shape.mask
    pad = [(min(ceil(reach / axis.spacing) + 1, axis.cells) if axis.periodic else 0,) * 2 for axis in axes]
    spacing = np.array([axis.spacing for axis in axes])
    mask = np.pad(shape.mask, pad, mode="wrap")
    rim = min(rims(axes)) if rule == "conservative" else 0.0
    near = mask | near_boxes(mask, spacing, reach - rim, rule)
    return near[tuple(slice(before, size - after) for (before, after), size in zip(pad, mask.shape, strict=True))]


def _part_of_grid(whole: Sequence[Axis], part: Sequence[Axis]) -> tuple[slice, ...]:
    """Return, per axis, the slice of cells of a grid that form a second grid; raise InputError unless they form it.

    `whole`, `part`: axes of the two grids, which must not be periodic where they differ.
    """
    slices = []
    for large, small in zip(whole, part, strict=True):
        offset = (small.lower - large.lower) / large.spacing
        first, end = round(offset), round(offset) + small.cells
        is_same = abs(offset - first) < 1e-3 and abs(small.spacing / large.spacing - 1) * small.cells < 1e-3
        if not (is_same and first >= 0 and end <= large.cells) or (large != small and small.periodic):
            raise InputError("the cells of a map can only be obstacles on the map's own grid")
        slices.append(slice(first, end))
    return tuple(slices)


def _mark_polygon(
    out: NDArray[np.bool_], axes: Sequence[Axis], half: Sequence[float], polygon: Polygon, reach: float
) -> None:
    """Mark, in place, the cells within a distance of a polygon.

    A cell meets a polygon if it meets the outline, or if the polygon encloses the cell's centre.
    `out`: mask, shape of the grid; `axes`: axes of the grid; `half` (2,): half the size of the box that is tested in
    place of a cell, 0 to test only the centre; `reach`: distance; lengths are in axis units.
    """
    from resgrid.robots.kernels import CellPlane, mark_enclosed, mark_parallelograms

    x, y = axes
    plane = CellPlane(x.lower, y.lower, x.spacing, y.spacing, half[0], half[1])
    edges = outline(polygon, axes, reach)
    mark_enclosed(out, edges, plane)
    sides = np.hstack([edges[:, :2], edges[:, 2:] - edges[:, :2], np.zeros((len(edges), 2))])
    mark_parallelograms(out, sides, reach, plane)


def outline(shape: Box | Polygon, axes: Sequence[Axis], reach: float) -> NDArray[np.float64]:
    """Return the edges ``x0, y0, x1, y1`` of a polygon or rectangle, shape (e, 4), clipped far outside the grid.

    `axes`: x and y of the grid; `reach`: distance up to which the caller marks cells around the shape, in axis units.
    The grid is enlarged on every side by a margin: `reach` plus the grid's largest side.  A ring with a corner more
    than 1000 margins outside the enlarged grid is clipped to the enlarged grid; other rings are not changed.
    """
    margin = reach + max(axis.upper - axis.lower for axis in axes)
    lower, upper = (axes[0].lower - margin, axes[1].lower - margin), (axes[0].upper + margin, axes[1].upper + margin)
    return edges_of([_clip_ring(ring, lower, upper, FAR * margin) for ring in rings_of(shape)])


def _clip_ring(ring: tuple[Point, ...], lower: Point, upper: Point, far: float) -> Sequence[Point]:
    """Return the corners of a ring (closed polyline), clipped to a box only if a corner lies far outside the box.

    `lower, upper`: corners of the box; `far`: axis units.  The ring is returned unchanged if no corner lies more than
    `far` outside the box along any axis.  Otherwise the ring is clipped (Sutherland and Hodgman, 1974); the result is
    the single point `lower` if no part of the ring lies in the box.
    """
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
                fraction = (bound - a[k]) / (b[k] - a[k])
                kept.append(tuple(p + fraction * (q - p) for p, q in zip(a, b, strict=True)))
        corners = kept
    return [tuple(map(float, point)) for point in corners] or [lower]


class GoalCells(NamedTuple):
    """Cells that contain a solution of a goal, with one solution per cell.

    `cells`: mask, shape of the grid, True if the closed cell contains a configuration that solves the goal; `points`
    (goal cells, ndim): one such configuration per goal cell, in C order of the cells, in axis units.
    """

    cells: NDArray[np.bool_]
    points: NDArray[np.float64]


class CellClasses(NamedTuple):
    """Cells in which a robot may collide.

    `blocked`: mask, shape of the grid, True for cells that are obstacles; `undecided`: mask of the blocked cells for
    which neither freedom nor a collision was proven, None if the method does not distinguish them.
    """

    blocked: NDArray[np.bool_]
    undecided: NDArray[np.bool_] | None = None


def region_cells(axes: Sequence[Axis], region: Shape | Point) -> GoalCells:
    """Return the cells of a grid that meet a region, with one configuration of the region per cell.

    The configuration is the point nearest to the cell's centre among the points that cell and region have in common.
    `region`: shape or single point, in axis units.
    """
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
    if isinstance(region, SpaceSolid | Voxels):
        raise InputError(f"a goal cannot be a {type(region).__name__}; use a box, a ball or a half-space")
    if isinstance(region, CellSet):
        return GoalCells(region.mask, lower + (np.argwhere(region.mask) + 0.5) * spacing)
    return merge_goals(shape, [_image_cells(axes, image) for image in periodic_images(region, axes, [0.0] * len(axes))])


def merge_goals(shape: tuple[int, ...], goals: Sequence[GoalCells]) -> GoalCells:
    """Return the union of goals on one grid, of shape `shape`, as the cells of one goal.

    A cell that belongs to several of the `goals` gets the configuration of the first of them.
    """
    met, points = [np.empty(0, dtype=np.int64)], [np.empty((0, len(shape)))]
    for goal in goals:
        met.append(np.flatnonzero(goal.cells))
        points.append(goal.points)
    every, first = np.unique(np.concatenate(met), return_index=True)
    cells = np.zeros(shape, dtype=bool)
    cells.reshape(-1)[every] = True
    return GoalCells(cells, np.concatenate(points)[first])


def _image_cells(axes: tuple[Axis, ...], shape: SingleShape) -> GoalCells:
    """Return the cells that a shape meets, with the common point nearest to each cell's centre.

    Periodic images of the shape are not included; `axes`: axes of the grid.
    """
    centred = np.zeros(tuple(axis.cells for axis in axes), dtype=bool)
    mark_image(centred, axes, shape, 0.0, "centre")
    met = centred.copy()
    mark_image(met, axes, shape, 0.0, "conservative")
    lower, spacing = np.array([(axis.lower, axis.spacing) for axis in axes]).T
    points = lower + (np.argwhere(met) + 0.5) * spacing
    off_centre = ~centred[met]
    points[off_centre] = _nearest(shape, points[off_centre], axes)
    return GoalCells(met, points)


def _nearest(shape: SingleShape, middle: NDArray[np.float64], axes: tuple[Axis, ...]) -> NDArray[np.float64]:
    """Return, for m cells that a shape meets, the common point nearest to the cell's centre, shape (m, ndim).

    `middle` (m, ndim): centres of the cells, in axis units; `axes`: axes of the grid.
    """
    half = np.array([axis.spacing for axis in axes]) / 2
    match shape:
        case Box(lower, upper):
            return np.clip(np.clip(middle, lower, upper), middle - half, middle + half)
        case Ball(centre, radius):
            return _enter_region(
                middle, half, np.array(centre) - middle, lambda at: np.linalg.norm(at - centre, axis=1) <= radius
            )
        case HalfSpace(normal, offset):
            leans = np.abs(normal) > 1e-12 * np.abs(normal).max()
            farthest = float((half[leans] / np.abs(normal)[leans]).max())
            step = np.where(leans, normal, 0.0) * -farthest
            return _enter_region(middle, half, step, lambda at: at @ np.array(normal) <= offset)
        case Polygon():
            return _nearest_on_outline(outline(shape, axes, 0.0), middle, half, np.array(rims(axes)))
    raise AssertionError("`region_cells` rejects other shapes")


def _enter_region(
    middle: NDArray[np.float64],
    half: NDArray[np.float64],
    step: NDArray[np.float64],
    inside: Callable[[NDArray[np.float64]], NDArray[np.bool_]],
) -> NDArray[np.float64]:
    """Return the first points (m, ndim) of a convex region on curves ``clip(middle + s step)``, s from 0 to 1.

    The function ``clip`` restricts every coordinate to the range of the cell.
    The point of a ball or half-space within a cell that is nearest to the cell's centre minimizes a quadratic function
    whose gradient is parallel to ``step``.  So the point lies on this curve, and bisection finds the smallest s.
    `middle` (m, ndim): centres of cells; `step` (m, ndim): vectors towards the region; `half` (ndim,): half widths of a
    cell; `inside`: function that returns which points (m, ndim) lie in the region, shape (m,).
    """
    out, into = np.zeros((len(middle), 1)), np.ones((len(middle), 1))
    for _ in range(BISECTIONS):
        between = (out + into) / 2
        within = inside(np.clip(middle + between * step, middle - half, middle + half))[:, None]
        out, into = np.where(within, out, between), np.where(within, between, into)
    return np.clip(middle + into * step, middle - half, middle + half)


def _nearest_on_outline(
    edges: NDArray[np.float64], middle: NDArray[np.float64], half: NDArray[np.float64], rim: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return, for m cells, the point of an outline within the cell that is nearest to the cell's centre, shape (m, 2).

    `edges` (e, 4): segments ``x0, y0, x1, y1`` of the outline; `middle` (m, 2): centres of the cells; `half` (2,): half
    widths of a cell; `rim` (2,): margin by which cells are enlarged against rounding errors; all in axis units.
    """
    import shapely

    lines = shapely.multilinestrings(edges.reshape(-1, 2, 2))
    reach = half + rim
    pieces = np.asarray(shapely.intersection(lines, shapely.box(*(middle - reach).T, *(middle + reach).T)))
    pieces[shapely.is_empty(pieces)] = lines
    connections = shapely.shortest_line(shapely.points(middle), pieces)
    return np.clip(shapely.get_coordinates(connections)[1::2], middle - half, middle + half)
