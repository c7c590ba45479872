"""Clearance, the smallest distance from a polyline to obstacle cells; bounds of this distance; crossings of faces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace

_FEW_PAIRS = 300_000
"""Maximum number of pairs (cell, obstacle cell) whose distances are all computed.

For more pairs, a compiled kernel or a distance transform of scipy is used; for few pairs their import takes longer.
"""


def clearance_of(
    points: NDArray[np.float64],
    space: ConfigurationSpace,
    edge: tuple[str, ...],
    reach: float | NDArray[np.float64] | None,
    blocked: NDArray[np.bool_] | None = None,
) -> float:
    """Return the smallest distance from a polyline to an obstacle cell, or to an edge of the grid that acts as one.

    `points` (n, ndim): corners of the polyline; `space`: gives the cells; `edge`: rule of the grid's edge per axis,
    ``"obstacle"``, ``"open"`` or ``"periodic"``; `reach`: distance up to which obstacle cells are searched, one number
    or one per cell in the shape of the space, None without obstacle cells; `blocked` (cells,): mask of obstacle cells
    in C order, computed if None.  All lengths are in axis units.  The result is infinite if there is no obstacle cell
    within `reach`, and no edge that acts as an obstacle.
    """
    scaled = split_at_faces(points, space)
    starts, ends = (scaled[:-1], scaled[1:]) if len(scaled) > 1 else (scaled, scaled)
    home = np.floor((starts + ends) / 2)
    home = np.where(space.periodic, home, np.clip(home, 0, np.array(space.shape) - 1))
    return segment_clearance(home.astype(np.int64), starts - home, ends - home, space, edge, reach, blocked)


def segment_clearance(
    home: NDArray[np.int64],
    starts: NDArray[np.float64],
    ends: NDArray[np.float64],
    space: ConfigurationSpace,
    edge: tuple[str, ...],
    reach: float | NDArray[np.float64] | None,
    blocked: NDArray[np.bool_] | None = None,
) -> float:
    """Return the smallest distance from n segments within cells to an obstacle cell, or to an edge that acts as one.

    The segments are those of a polyline: each starts where the one before ends.  `home` (n, ndim): cell of each
    segment; `starts, ends` (n, ndim): end points relative to the cell's lower corner, in cell widths; `edge`: rule of
    the grid's edge per axis, ``"obstacle"``, ``"open"`` or ``"periodic"``; `reach`: distance up to which obstacle cells
    are searched, in axis units, one number or one per cell in the shape of the space, None without obstacle cells;
    `blocked` (cells,): mask of obstacle cells in C order, computed if None.  The result is in axis units; it is
    infinite if there is no obstacle cell within `reach`, and no edge that acts as an obstacle.
    """
    from resgrid.planning import kernels

    nearest = np.inf
    if reach is not None:
        cells = np.mod(home, space.shape)
        blocked = (space.cell == Cell.OBSTACLE).ravel() if blocked is None else blocked
        bound = np.broadcast_to(reach, space.shape)[tuple(cells.T)]
        order = np.argsort(bound, kind="stable")
        nearest = kernels.clearance(
            cells[order], (starts * space.spacing)[order], (ends * space.spacing)[order], bound[order],
            blocked, np.array(space.shape, dtype=np.int64), space.spacing,
            space.periodic,
        )  # fmt: skip
    position = np.concatenate([home + starts, home[-1:] + ends[-1:]]) * space.spacing
    for axis, rule in enumerate(edge):
        if rule == "obstacle":
            along, extent = position[:, axis], space.shape[axis] * space.spacing[axis]
            nearest = min(nearest, along.min(), extent - along.max())
    return float(max(nearest, 0.0))


def obstacle_reach(space: ConfigurationSpace) -> NDArray[np.float64] | None:
    """Return upper bounds of the distance from any point of each cell to the nearest obstacle cell, in axis units.

    The result has the shape of the space; it is None if the space has no obstacle cell.
    """
    clear = space.cell != Cell.OBSTACLE
    if clear.all():
        return None
    if clear.size * np.count_nonzero(~clear) <= _FEW_PAIRS:
        return _nearest_centres(space, clear) + 0.5 * float(np.linalg.norm(space.spacing))
    if space.ndim == 2 and not space.periodic.any():
        from resgrid.planning.distance_kernels import chamfer_distances

        chains = chamfer_distances(clear, *space.spacing.tolist())
        return np.asarray(chains + 0.5 * np.linalg.norm(space.spacing))
    from scipy.ndimage import distance_transform_edt

    margin = [(n // 2 + 1, n // 2 + 1) if ring else (0, 0) for n, ring in zip(space.shape, space.periodic, strict=True)]
    inner = tuple(slice(before, before + n) for (before, _), n in zip(margin, space.shape, strict=True))
    between_centres = distance_transform_edt(np.pad(clear, margin, mode="wrap"), sampling=space.spacing)[inner]
    return np.asarray(between_centres + 0.5 * np.linalg.norm(space.spacing))


def _nearest_centres(space: ConfigurationSpace, clear: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the distance from every cell's centre to the nearest centre of an obstacle cell, in axis units.

    The result has the shape of the space.  `clear`: mask of the cells that are not obstacles, shape of the space.
    """
    shape, rings = np.array(space.shape), np.asarray(space.periodic)
    apart = np.abs(np.argwhere(np.ones_like(clear))[:, np.newaxis] - np.argwhere(~clear))
    apart = np.where(rings, np.minimum(apart, shape - apart), apart)
    return np.asarray(np.linalg.norm(apart * space.spacing, axis=-1).min(axis=1).reshape(space.shape))


def split_at_faces(points: NDArray[np.float64], space: ConfigurationSpace) -> NDArray[np.float64]:
    """Return the corners (m, ndim) of a polyline, with a corner added at every crossing of a cell face.

    The result is in cell widths from the lower corner of the grid.  `points` (n, ndim): corners in axis units.
    """
    scaled = (points - space.lower) / space.spacing
    start, end = scaled[:-1], scaled[1:]
    first = np.floor(np.minimum(start, end)) + 1
    counts = np.maximum(np.ceil(np.maximum(start, end)) - first, 0).astype(np.int64)
    segment, axis = np.nonzero(counts)
    repeats = counts[segment, axis]
    segment, axis = np.repeat(segment, repeats), np.repeat(axis, repeats)
    border = first[segment, axis] + np.arange(len(segment)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = (border - start[segment, axis]) / (end[segment, axis] - start[segment, axis])
    inner = (at > 0) & (at < 1)
    segment, at = np.unique(np.stack([segment[inner], at[inner]], axis=1), axis=0).T
    segment = segment.astype(np.int64)
    crossings = start[segment] + at[:, np.newaxis] * (end[segment] - start[segment])
    return np.insert(scaled, segment + 1, crossings, axis=0)


def face_crossings(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the parameters in (0, 1), ascending, at which a segment crosses cell faces, shape (crossings,).

    `start, end` (ndim,): end points of the segment, with the parameters 0 and 1, in cell widths from the grid's corner.
    """
    parameters = [np.empty(0)]
    for first, last in zip(start.tolist(), end.tolist(), strict=True):
        borders = np.arange(np.floor(min(first, last)) + 1, np.ceil(max(first, last)))
        if len(borders):
            parameters.append((borders - first) / (last - first))
    inner = np.unique(np.concatenate(parameters))
    return inner[(inner > 0) & (inner < 1)]
