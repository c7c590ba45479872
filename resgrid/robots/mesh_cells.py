"""Cells of a grid within a distance of a mesh: tests of boxes against triangles, and of centres by winding numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain, product
from math import ceil

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.memory import require_grid_memory
from resgrid.robots.box_distances import distance_from_boxes
from resgrid.robots.mesh import Mesh

BATCH = 1 << 17
"""Approximate number of pairs of a triangle and a cell that are tested at once, which limits the memory."""

CHUNK = 1024
"""Number of triangles whose surroundings are searched for cells at once, which limits the memory."""


def near_mesh(
    mesh: Mesh,
    grids: Sequence[NDArray[np.float64]],
    half: Sequence[float],
    reach: float,
    spacing: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Return the mask, shape of a block of cells, of cells whose tested box is within a distance of a mesh.

    The inside of closed parts belongs to the mesh.

    The result is exact up to rounding: a box is left out if a plane separates it from every triangle by more than
    `reach`.
    `grids`: cell centres, an array per axis; `half` (3,): half the widths of the box that is tested in place of a cell,
    0 to test only the centre; `reach`: distance; `spacing` (3,): distances between centres; all in axis units.
    """
    lines = [np.asarray(grid).reshape(-1) for grid in grids]
    side = np.asarray(half, dtype=np.float64)
    if not all(map(len, lines)):  # the mesh is outside the grid
        return np.zeros(tuple(map(len, lines)), dtype=np.bool_)
    if reach > 0:
        near = _near_offset(mesh.corners, lines, side, reach, spacing)
    else:
        near = _near_surface(mesh.corners, lines, side)
    if len(mesh.closed_parts):
        near |= _enclosed(mesh, lines)
    return near


def _near_surface(
    corners: NDArray[np.float64], lines: Sequence[NDArray[np.float64]], half: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return the mask, shape of a block of cells, of cells whose tested box meets a triangle.

    `corners` (t, 3, 3): vertices of the triangles; `lines`: centres of the boxes along every axis; `half` (3,): half
    the widths of the box that is tested in place of a cell; all in axis units.
    """
    near = np.zeros(tuple(map(len, lines)), dtype=np.bool_)
    flat = near.reshape(-1)
    first, count = _ranges(lines, corners.min(axis=1) - half, corners.max(axis=1) + half)
    for triangle, place in _pairs(first, count):
        cell = np.ravel_multi_index(tuple(place), near.shape)
        kept = np.flatnonzero(~flat[cell])
        centre = np.column_stack([line[index[kept]] for line, index in zip(lines, place, strict=True)])
        flat[cell[kept][_triangles_near(corners[triangle[kept]], centre, half, 0.0)]] = True
    return near


def _near_offset(
    corners: NDArray[np.float64],
    lines: Sequence[NDArray[np.float64]],
    half: NDArray[np.float64],
    reach: float,
    spacing: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Return the mask, shape of a block of cells, of cells whose tested box is within a distance above 0 of a triangle.

    The cells that meet the surface give bounds of all distances, which decide most cells.  The others are tested
    against the triangles, first against few of them, which mark most of the cells that will be marked.
    `corners` (t, 3, 3): vertices of the triangles; `lines`: centres of the boxes along every axis; `half` (3,): half
    the widths of the box that is tested in place of a cell, 0 to test only the centre; `reach`: distance; `spacing`
    (3,): distances between centres; all in axis units.
    """
    from scipy.spatial import KDTree

    gap, diagonal = _surface_gap(corners, lines, reach, spacing), float(np.linalg.norm(spacing))
    near = gap + diagonal * (1.5 if not half.any() else 1.0) * (1.0 + 1e-6) <= reach
    doubtful = ~near & (gap <= reach * (1.0 + 1e-9))
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    middle = (lower + upper) / 2
    radius = np.linalg.norm(corners - middle[:, np.newaxis], axis=2).max(axis=1) + reach + np.linalg.norm(half)
    order = np.random.default_rng(0).permutation(len(corners))
    for part in np.split(order, [len(order) // 64, len(order) // 8]):
        cells = np.argwhere(doubtful & ~near)
        if not len(cells) or not len(part):
            continue
        centres = np.column_stack([line[index] for line, index in zip(lines, cells.T, strict=True)])
        tree, marked = KDTree(centres), np.zeros(len(cells), dtype=np.bool_)
        for start in range(0, len(part), CHUNK):
            chunk = part[start : start + CHUNK]
            found = tree.query_ball_point(middle[chunk], radius[chunk] * (1.0 + 1e-9), return_sorted=False)
            triangle = np.repeat(chunk, [len(each) for each in found])
            cell = np.fromiter(chain.from_iterable(found), np.int64, len(triangle))
            beyond = np.maximum(lower[triangle] - centres[cell], centres[cell] - upper[triangle]) - half
            kept = ~marked[cell] & (np.sum(np.maximum(beyond, 0.0) ** 2, axis=1) <= reach**2)
            for pairs in np.array_split(np.flatnonzero(kept), 1 + np.count_nonzero(kept) // BATCH):
                hit = _triangles_near(corners[triangle[pairs]], centres[cell[pairs]], half, reach)
                marked[cell[pairs[hit]]] = True
        near[tuple(cells[marked].T)] = True
    return near


def _surface_gap(
    corners: NDArray[np.float64],
    lines: Sequence[NDArray[np.float64]],
    reach: float,
    spacing: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the distance of every cell of a block, in axis units, from the nearest cell that meets a triangle.

    Cells beyond the block that meet a triangle count too if they are within `reach` of the block.  The distance of a
    cell from the triangles is at least the returned number, and exceeds this number by at most the diagonal of a cell.
    The result is infinite everywhere if no cell in the block or within `reach` of the block meets a triangle.
    `corners` (t, 3, 3): vertices of the triangles; `lines`: centres of the cells along every axis; `reach`: distance;
    `spacing` (3,): distances between centres; all in axis units.
    """
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    first, wide = [], []
    for line, step, start, end in zip(lines, spacing, low, high, strict=True):
        pad = ceil(reach / step) + 1
        before = int(np.clip(ceil((line[0] - start) / step) + 1, 0, pad))
        after = int(np.clip(ceil((end - line[-1]) / step) + 1, 0, pad))
        first.append(before)
        wide.append(line[0] + step * np.arange(-before, len(line) + after))
    require_grid_memory(tuple(map(len, wide)), "the surroundings of a mesh", 32)
    surface = _near_surface(corners, wide, spacing / 2 * (1.0 + 1e-9))
    if not surface.any():
        return np.full(tuple(map(len, lines)), np.inf)
    gap = distance_from_boxes(surface, spacing, "conservative")
    return gap[tuple(slice(start, start + len(line)) for start, line in zip(first, lines, strict=True))]


def _ranges(
    lines: Sequence[NDArray[np.float64]], lower: NDArray[np.float64], upper: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return, for t boxes, the first index and the number of the grid's centres in the box along every axis.

    Both results have the shape (t, axes).  `lines`: coordinates of the centres along every axis, increasing; `lower,
    upper` (t, axes): lower and upper corners of the boxes.
    """
    first = np.column_stack([np.searchsorted(line, ends) for line, ends in zip(lines, lower.T, strict=True)])
    last = np.column_stack(
        [np.searchsorted(line, ends, side="right") for line, ends in zip(lines, upper.T, strict=True)]
    )
    return first, np.maximum(last - first, 0)


def _pairs(
    first: NDArray[np.int64], count: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], list[NDArray[np.int64]]]]:
    """Yield all pairs of a triangle and a cell in its range, in batches of at most `BATCH` pairs.

    A batch is a tuple: numbers of the triangles (n,), and a list of the indices (n,) of the cells along every axis.
    `first, count` (t, axes): first index and number of indices of every triangle's range along every axis.
    """
    ends = np.cumsum(np.prod(count, axis=1))
    for start in range(0, int(ends[-1]) if len(ends) else 0, BATCH):
        pair = np.arange(start, min(start + BATCH, int(ends[-1])))
        triangle = np.searchsorted(ends, pair, side="right")
        rest = pair - (ends[triangle] - np.prod(count[triangle], axis=1))
        place = []
        for axis in reversed(range(count.shape[1])):
            rest, index = np.divmod(rest, count[triangle, axis])
            place.append(first[triangle, axis] + index)
        yield triangle, place[::-1]


def _triangles_near(
    corners: NDArray[np.float64], centres: NDArray[np.float64], half: NDArray[np.float64], reach: float
) -> NDArray[np.bool_]:
    """Return the mask (n,) of pairs of a triangle and a box that are not farther apart than a distance.

    The caller excludes pairs whose bounding boxes are farther apart.  `corners` (n, 3, 3): vertices of the triangles;
    `centres` (n, 3): centres of the boxes; `half` (3,): half their widths; `reach`: distance, in axis units.
    """
    near = np.ones(len(corners), dtype=np.bool_)
    local = corners - centres[:, np.newaxis]  # the box is centred at the origin
    edges = np.roll(local, -1, axis=1) - local
    _drop_apart(near, np.cross(edges[:, 0], edges[:, 1]), local, half, reach)
    for edge, axis in product(range(3), np.eye(3)):
        _drop_apart(near, np.cross(edges[:, edge], axis), local, half, reach)
    if reach > 0:
        for corner in range(3):
            point = local[:, corner]
            _drop_apart(near, np.clip(point, -half, half) - point, local, half, reach)
        for signs in product((-1.0, 1.0), repeat=3):
            tip = np.array(signs) * half
            at = np.flatnonzero(near)
            toward = np.zeros_like(centres)
            toward[at] = tip - nearest_on_triangles(local[at], tip)
            _drop_apart(near, toward, local, half, reach)
    return near


def _drop_apart(
    near: NDArray[np.bool_],
    directions: NDArray[np.float64],
    local: NDArray[np.float64],
    half: NDArray[np.float64],
    reach: float,
) -> None:
    """Clear, in place, the entries of `near` (n,) whose triangle and box are farther than `reach` apart in a direction.

    `directions` (n, 3): one direction per pair, not normalized, zero for no test; `local` (n, 3, 3): vertices relative
    to the centre of the box; `half` (3,): half the widths of the box; `reach`: distance, in axis units.
    """
    at = np.flatnonzero(near)
    if not len(at):
        return
    direction = directions[at]
    along = np.einsum("nij,nj->ni", local[at], direction)
    extent = np.abs(direction) @ half + reach * np.linalg.norm(direction, axis=1)
    near[at] = (along.min(axis=1) <= extent) & (along.max(axis=1) >= -extent)


def nearest_on_triangles(corners: NDArray[np.float64], point: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the nearest points (n, 3) of triangles (n, 3, 3) to a point (3,), or of each triangle to its point (n, 3).

    The result is the foot of the perpendicular on the triangle's plane if it lies inside the triangle, otherwise the
    nearest point on the three edges.
    """
    best = np.full(len(corners), np.inf)
    nearest = np.empty((len(corners), 3))
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    squared = np.sum(normal**2, axis=1)
    inside = squared > 0
    for a, b in ((0, 1), (1, 2), (2, 0)):
        start, edge = corners[:, a], corners[:, b] - corners[:, a]
        offset = point - start
        length = np.sum(edge**2, axis=1)
        part = np.clip(np.sum(offset * edge, axis=1) / np.where(length > 0, length, 1.0), 0.0, 1.0)
        at = start + part[:, np.newaxis] * edge
        distance = np.sum((point - at) ** 2, axis=1)
        nearest[distance < best] = at[distance < best]
        best = np.minimum(best, distance)
        inside &= np.sum(np.cross(edge, offset) * normal, axis=1) >= 0
    height = np.sum((point - corners[:, 0]) * normal, axis=1) / np.where(squared > 0, squared, 1.0)
    foot = point - height[:, np.newaxis] * normal
    return np.where(inside[:, np.newaxis], foot, nearest)


def _enclosed(mesh: Mesh, lines: Sequence[NDArray[np.float64]]) -> NDArray[np.bool_]:
    """Return the mask, shape of a block of cells, of cells whose centre lies inside a closed part of a mesh.

    Rays along x through all centres count the crossed triangles with the sign of their orientation.  Edges that a ray
    meets exactly belong to one of their triangles, because each edge is evaluated in the order of its vertices.
    `lines`: centres of the cells along every axis.
    """
    turns = np.zeros((len(lines[0]) + 1, len(lines[1]), len(lines[2])), dtype=np.int32)
    indices, corners = mesh.closed_parts, mesh.points[mesh.closed_parts]
    first, count = _ranges(lines[1:], corners[:, :, 1:].min(axis=1), corners[:, :, 1:].max(axis=1))
    for triangle, (row, layer) in _pairs(first, count):
        y, z = lines[1][row], lines[2][layer]
        sign = np.zeros(len(triangle), dtype=np.int32)
        for a, b in ((0, 1), (1, 2), (2, 0)):
            sign += _crossings(mesh, indices[triangle, a], indices[triangle, b], y, z)
        hit = np.flatnonzero(sign)
        x = _heights(corners[triangle[hit]], y[hit], z[hit])
        np.add.at(turns, (np.searchsorted(lines[0], x, side="right"), row[hit], layer[hit]), sign[hit])
    return np.asarray(np.cumsum(turns[:-1], axis=0) != 0)


def _crossings(
    mesh: Mesh, start: NDArray[np.int32], end: NDArray[np.int32], y: NDArray[np.float64], z: NDArray[np.float64]
) -> NDArray[np.int32]:
    """Return whether n edges, projected along x, cross n rays from (y, z) in the direction of y, with a sign.

    The result (n,) is 1 if the edge, from start to end, crosses its ray towards larger z, -1 towards smaller z, and 0
    if the edge does not cross the ray.  Rays point towards larger y.  `mesh`: gives the coordinates of vertices;
    `start, end` (n,): indices of the vertices of the edges; `y, z` (n,): starts of the rays, in axis units.
    """
    low, high = mesh.points[np.minimum(start, end), 1:], mesh.points[np.maximum(start, end), 1:]
    crosses = (low[:, 1] > z) != (high[:, 1] > z)
    rise = np.where(crosses, high[:, 1] - low[:, 1], 1.0)
    at = low[:, 0] + (z - low[:, 1]) * ((high[:, 0] - low[:, 0]) / rise)
    upwards = np.where((high[:, 1] > low[:, 1]) == (start < end), 1, -1)
    return np.where(crosses & (y < at), upwards, 0).astype(np.int32)


def _heights(corners: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the coordinates x (n,) at which n lines parallel to x meet the planes of n triangles.

    A coordinate is clipped to the triangle's range of x, against rounding errors.  `corners` (n, 3, 3): vertices; `y,
    z` (n,): coordinates of the lines.
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    slope = normal[:, 1] * (y - corners[:, 0, 1]) + normal[:, 2] * (z - corners[:, 0, 2])
    with np.errstate(divide="ignore", invalid="ignore"):
        x = corners[:, 0, 0] - slope / normal[:, 0]
    return np.clip(
        np.where(np.isfinite(x), x, corners[:, 0, 0]), corners[:, :, 0].min(axis=1), corners[:, :, 0].max(axis=1)
    )
