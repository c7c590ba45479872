"""How far a polyline stays from obstacle cells."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from resgrid.space import Cell, ConfigurationSpace


def clearance_of(
    points: NDArray[np.float64],
    space: ConfigurationSpace,
    edge: tuple[str, ...],
    within: float | NDArray[np.float64] | None = None,
) -> float:
    """Smallest distance from a polyline to an obstacle cell's box, or to an edge that counts as an obstacle.

    Shapes: `points` (n, ndim), `within` as the space.
    """
    nearest = np.inf
    if (space.cell == Cell.OBSTACLE).any():
        nearest = _to_obstacles(points, space, within)
    for axis, rule in enumerate(edge):
        if rule == "obstacle":
            along = points[:, axis]
            nearest = min(nearest, along.min() - space.axes[axis].lower, space.axes[axis].upper - along.max())
    return float(max(nearest, 0.0))


def split_at_faces(points: NDArray[np.float64], space: ConfigurationSpace) -> NDArray[np.float64]:
    """A polyline in units of cells, with a point wherever a segment crosses the border between two cells.

    Shapes: `points` (n, ndim); returns (m, ndim).
    """
    scaled = (points - space.lower) / space.spacing
    parts = [scaled[:1]]
    for start, end in pairwise(scaled):
        shares = np.append(face_shares(start, end), 1.0)
        parts.append(start + shares[:, np.newaxis] * (end - start))
    return np.concatenate(parts)


def face_shares(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shares of the way, between 0 and 1, at which a segment in units of cells crosses borders; ascending, distinct."""
    shares = [np.empty(0)]
    for first, last in zip(start.tolist(), end.tolist(), strict=True):
        borders = np.arange(np.floor(min(first, last)) + 1, np.ceil(max(first, last)))
        if len(borders):
            shares.append((borders - first) / (last - first))
    inner = np.unique(np.concatenate(shares))
    return inner[(inner > 0) & (inner < 1)]


def _to_obstacles(
    points: NDArray[np.float64], space: ConfigurationSpace, within: float | NDArray[np.float64] | None
) -> float:
    from resgrid.planning import kernels
    from resgrid.planning.fields import obstacle_reach

    scaled = split_at_faces(points, space)
    starts, ends = (scaled[:-1], scaled[1:]) if len(scaled) > 1 else (scaled, scaled)
    size = np.array(space.shape)
    home = np.floor((starts + ends) / 2)
    home = np.where(space.periodic, home, np.clip(home, 0, size - 1))
    cells = np.mod(home, size).astype(np.int64)
    reach = obstacle_reach(space) if within is None else np.broadcast_to(within, space.shape)
    assert reach is not None
    bound = reach[tuple(cells.T)]
    order = np.argsort(bound, kind="stable")
    starts, ends = (starts - home) * space.spacing, (ends - home) * space.spacing
    return float(
        kernels.clearance(
            cells[order], starts[order], ends[order], bound[order], (space.cell == Cell.OBSTACLE).ravel(),
            size.astype(np.int64), space.spacing, space.periodic,
        )
    )  # fmt: skip
