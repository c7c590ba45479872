"""Cuts of triangle meshes by planes: clipped triangles, and the cuts that bring convex hulls closest to the mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.robots.hulls import DIRECTIONS

_POSITIONS = 9
"""Number of equidistant positions of a cut that are compared first, along each of the three axes."""

_REFINED = 8
"""Maximum number of positions at vertices, near the best equidistant position, that are compared next."""

_SAMPLE = 140
"""Number of points inside triangles from which costs are estimated, and largest number of corners of triangles for
which all corners are used too.
"""

_WEIGHT = 0.2
"""Factor of the depth in the cost of a hull: volume plus this factor times the depth integrated over the surface.

The depth is the distance of a point of the surface below the nearest face of the hull.
"""


@dataclass(frozen=True, eq=False)
class PlaneCut:
    """A cut of a surface by the plane ``x[axis] = position``.

    `gain`: estimated reduction, in cubic metres, of the cost of the convex hulls by the cut, 0 if no cut reduces it.
    The cost is the volume of the hulls plus 0.2 times the depth of the surface below them, integrated over the surface.
    """

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
    """Return the points (n, 3) at which segments from `a` to `b`, (n, 3) each, cross a plane.

    `high_a, high_b` (n,): signed distances of the ends from the plane, of different signs.
    """
    part = high_a / (high_a - high_b)
    return a + part[:, np.newaxis] * (b - a)


def best_cut(corners: NDArray[np.float64]) -> PlaneCut:
    """Return the cut of triangles (t, 3, 3), perpendicular to an axis, that reduces the cost of their hulls most.

    The cost of a hull is its volume plus 0.2 times the depth of the surface below it, integrated over the surface. The
    gain is 0 if no cut reduces the cost.
    Positions at vertices are compared too, because the concave edges of machine parts lie there.
    """
    if not len(corners):
        return PlaneCut(0, 0.0, 0.0)
    sample = _sample(corners)
    whole = sum(_costs(sample.points, sample.area))
    best = PlaneCut(0, 0.0, 0.0)
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
    """Points on a surface from which costs are estimated: vertices, then points inside triangles.

    `points` (n, 3): in metres; `area` (n,): area in square metres that each point stands for, 0 for vertices.
    """

    points: NDArray[np.float64]
    area: NDArray[np.float64]


def _better(
    best: PlaneCut,
    corners: NDArray[np.float64],
    sample: _Sample,
    whole: float,
    axis: int,
    positions: NDArray[np.float64],
) -> PlaneCut:
    """Return the cut with the largest gain among `best` and the cuts perpendicular to an axis at some positions.

    `corners` (t, 3, 3): cut triangles; `sample`: points on them; `whole`: cost without a cut, in cubic metres;
    `positions` (p,): coordinates along the axis, in metres.
    """
    for position in positions:
        seam = _seam(corners, axis, float(position))
        cost = 0.0
        for side in (-1, 1):
            chosen = side * (sample.points[:, axis] - position) >= 0
            cost += sum(_costs(np.concatenate([seam, sample.points[chosen]]), sample.area[chosen]))
        if whole - cost > best.gain:
            best = PlaneCut(axis, float(position), whole - cost)
    return best


def _seam(corners: NDArray[np.float64], axis: int, position: float) -> NDArray[np.float64]:
    """Return points (n, 3) at which edges of triangles (t, 3, 3) cross the plane ``x[axis] = position``.

    The crossing points on the first, the second and the third edges of all triangles are thinned out evenly to at most
    140 points each.
    """
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
    """Return whether triangles (t, 3, 3) lie clearly below the surface of their convex hull.

    This is the case if 0.2 times the depth below the hull, integrated over the triangles, exceeds `least` cubic metres.
    """
    if not len(corners):
        return False
    sample = _sample(corners)
    return _costs(sample.points, sample.area)[1] > least


def _costs(points: NDArray[np.float64], area: NDArray[np.float64]) -> tuple[float, float]:
    """Return the costs of the convex hull of points (n, 3) in cubic metres: volume, and weighted depth of a surface.

    `area` (m,): area in square metres that each of the last m points stands for; their depth below the hull, times this
    area and the weight 0.2, is summed. Both costs are 0 for fewer than five points, and for points in a plane.
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
    """Return a sample of the surface of triangles (t, 3, 3): corners, and 140 points spread evenly over the area.

    Of more than 140 corners, every k-th one (140 to 279 of them) and the extreme corners in 26 directions are kept.
    """
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
