"""Cuts of triangle meshes by planes: clipped triangles, and the cuts that bring convex hulls closest to the mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.robots.hulls import DIRECTIONS

_POSITIONS = 9
"""Number of equidistant positions of a cut along every axis that are compared first."""

_REFINED = 8
"""Maximum number of positions at vertices near the best position that are compared."""

_SAMPLE = 140
"""Number of points on the surface, and maximum number of vertices, from which costs are estimated."""

_WEIGHT = 0.2
"""Weight of the integral of the depth in the cost of a hull."""


@dataclass(frozen=True, eq=False)
class Cut:
    """A plane ``x[axis] = position``, and the estimated reduction of the cost in cubic metres; see `best_cut`."""

    axis: int
    position: float
    gain: float


def clip(corners: NDArray[np.float64], axis: int, position: float, side: int) -> NDArray[np.float64]:
    """Return the parts of triangles (t, 3, 3) on one side of a plane, as triangles (s, 3, 3).

    `side`: 1 for ``x[axis] >= position``, -1 for ``x[axis] <= position``.
    """
    height = side * (corners[:, :, axis] - position)
    inside = height >= 0
    count = inside.sum(axis=1)
    parts = [corners[count == 3]]
    for number in (1, 2):
        chosen = np.flatnonzero(count == number)
        # Turn the triangles so that corner 0 is the one that lies alone on its side.
        alone = (inside[chosen] if number == 1 else ~inside[chosen]).argmax(axis=1)
        turn = (alone[:, np.newaxis] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(corners[chosen], turn[:, :, np.newaxis], axis=1), 1, 0)
        high = np.take_along_axis(height[chosen], turn, axis=1)
        ab, ac = _crossing(a, b, high[:, 0], high[:, 1]), _crossing(a, c, high[:, 0], high[:, 2])
        ab[:, axis] = ac[:, axis] = position
        if number == 1:
            parts.append(np.stack([a, ab, ac], axis=1))
        else:
            parts += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(parts)


def _crossing(
    a: NDArray[np.float64], b: NDArray[np.float64], high_a: NDArray[np.float64], high_b: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the points (n, 3) between a and b at height 0; the heights have different signs."""
    part = high_a / (high_a - high_b)
    return a + part[:, np.newaxis] * (b - a)


def best_cut(corners: NDArray[np.float64]) -> Cut:
    """Return the axis-parallel cut of triangles (t, 3, 3) that reduces the cost of their hulls most; see `_costs`.

    Positions at vertices are compared too, because the concave edges of machine parts lie there.
    """
    if not len(corners):
        return Cut(0, 0.0, 0.0)
    sample = _sample(corners)
    whole = sum(_costs(sample.points, sample.area))
    best = Cut(0, 0.0, 0.0)
    for axis in range(3) if whole > 0 else ():
        low, high = sample.points[:, axis].min(), sample.points[:, axis].max()
        best = _better(best, corners, sample, whole, axis, np.linspace(low, high, _POSITIONS + 2)[1:-1])
    if best.gain > 0:
        step = np.ptp(sample.points[:, best.axis]) / (_POSITIONS + 1)
        vertices = np.unique(corners[:, :, best.axis])
        near = vertices[np.abs(vertices - best.position) <= step]
        near = near[np.linspace(0, len(near) - 1, min(len(near), _REFINED)).astype(int)]
        between = best.position + step * np.array([-0.5, -0.25, 0.25, 0.5])
        best = _better(best, corners, sample, whole, best.axis, np.concatenate([near, between]))
    return best


@dataclass(frozen=True, eq=False)
class _Sample:
    """Points (n, 3) on a surface, and the area (n,) that each one stands for in square metres; 0 for vertices."""

    points: NDArray[np.float64]
    area: NDArray[np.float64]


def _better(
    best: Cut, corners: NDArray[np.float64], sample: _Sample, whole: float, axis: int, positions: NDArray[np.float64]
) -> Cut:
    """Return the best of a cut and of the cuts of triangles (t, 3, 3) along an axis; `whole`: cost without a cut."""
    for position in positions:
        seam = _seam(corners, axis, float(position))
        cost = 0.0
        for side in (-1, 1):
            chosen = side * (sample.points[:, axis] - position) >= 0
            cost += sum(_costs(np.concatenate([seam, sample.points[chosen]]), sample.area[chosen]))
        if whole - cost > best.gain:
            best = Cut(axis, float(position), whole - cost)
    return best


def _seam(corners: NDArray[np.float64], axis: int, position: float) -> NDArray[np.float64]:
    """Return points (n, 3) at which edges of triangles (t, 3, 3) cross a plane; not all of them if they are many."""
    height = corners[:, :, axis] - position
    points = [np.empty((0, 3))]
    for first, second in ((0, 1), (1, 2), (2, 0)):
        across = np.flatnonzero(height[:, first] * height[:, second] < 0)
        across = across[:: 1 + len(across) // _SAMPLE]
        points.append(
            _crossing(corners[across, first], corners[across, second], height[across, first], height[across, second])
        )
    return np.concatenate(points)


def is_concave(corners: NDArray[np.float64], least: float) -> bool:
    """Return whether triangles (t, 3, 3) lie below their hull: by an integral of the depth above `least` (m^3)."""
    if not len(corners):
        return False
    sample = _sample(corners)
    return _costs(sample.points, sample.area)[1] > least


def _costs(points: NDArray[np.float64], area: NDArray[np.float64]) -> tuple[float, float]:
    """Return the costs of the convex hull of points (n, 3) in cubic metres: volume, and weighted depth of a surface.

    The last points (m,) stand for an area in square metres each, whose depth below the hull is integrated.
    In contrast to the volume, the depth can also fall when a cut leaves the total volume of the hulls unchanged.
    """
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 5:
        return 0.0, 0.0
    try:
        hull = ConvexHull(points)
    except QhullError:
        return 0.0, 0.0
    surface = points[len(points) - len(area) :][area > 0]
    depth = -(surface @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1, initial=-np.inf)
    return float(hull.volume), _WEIGHT * float(area[area > 0] @ np.maximum(depth, 0.0))


def _sample(corners: NDArray[np.float64]) -> _Sample:
    """Return vertices of triangles (t, 3, 3), and points spread evenly over their area."""
    vertices = corners.reshape(-1, 3)
    if len(vertices) > _SAMPLE:
        extreme = np.concatenate(
            [(vertices @ DIRECTIONS.T).argmax(axis=0), np.arange(0, len(vertices), len(vertices) // _SAMPLE)]
        )
        vertices = vertices[np.unique(extreme)]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1)) / 2
    numbers = np.arange(_SAMPLE)
    chosen = np.searchsorted(area, (numbers + 0.5) / _SAMPLE * area[-1]).clip(max=len(corners) - 1)
    root, part = np.sqrt((numbers * 0.7548776662466927) % 1), (numbers * 0.5698402909980532) % 1  # R2 sequence
    weights = np.stack([1 - root, root * (1 - part), root * part], axis=1)
    inner = np.einsum("nv,nvk->nk", weights, corners[chosen])
    return _Sample(np.concatenate([vertices, inner]), np.repeat([0.0, area[-1] / _SAMPLE], [len(vertices), len(inner)]))
