"""Compiled device functions: the point of a simplex that is nearest to the origin, for the GJK algorithm.

Import this module only inside functions that call a kernel, because importing numba takes seconds.
The case distinctions are those of C. Ericson, "Real-Time Collision Detection" (2005), section 5.1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import inlined, inner

Floats = NDArray[np.float64]


@inlined
def dot(a: Floats, b: Floats) -> float:
    """Return the scalar product of the vectors `a` (3,) and `b` (3,)."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@inlined
def _dot_difference(corners: Floats, i: int, j: int, k: int) -> float:
    """Return the scalar product of corner k with the vector from corner i to corner j; `corners` (4, 3): corners."""
    return float(
        (corners[j, 0] - corners[i, 0]) * corners[k, 0]
        + (corners[j, 1] - corners[i, 1]) * corners[k, 1]
        + (corners[j, 2] - corners[i, 2]) * corners[k, 2]
    )


@inner
def _nearest_on_segment(corners: Floats, i: int, j: int, weights: Floats) -> None:
    """Write the weights of corners i and j for the point of their segment that is nearest to the origin.

    The point is the sum of the corners (4, 3) times the barycentric `weights` (4,), whose other entries are 0 on entry.
    """
    at_start, at_end = -_dot_difference(corners, i, j, i), _dot_difference(corners, i, j, j)
    if at_start <= 0.0:
        weights[i] = 1.0
    elif at_end <= 0.0:
        weights[j] = 1.0
    else:
        weights[j] = at_start / (at_start + at_end)
        weights[i] = 1.0 - weights[j]


@inner
def _nearest_on_triangle(corners: Floats, i: int, j: int, k: int, weights: Floats) -> None:
    """Write the weights of corners i, j and k for the point of their triangle that is nearest to the origin.

    The point is the sum of the corners (4, 3) times the barycentric `weights` (4,); the weight of the fourth corner
    becomes 0.
    """
    for corner in range(4):
        weights[corner] = 0.0
    d1, d2 = -_dot_difference(corners, i, j, i), -_dot_difference(corners, i, k, i)
    d3, d4 = -_dot_difference(corners, i, j, j), -_dot_difference(corners, i, k, j)
    d5, d6 = -_dot_difference(corners, i, j, k), -_dot_difference(corners, i, k, k)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        weights[i] = 1.0
    elif d3 >= 0.0 and d4 <= d3:
        weights[j] = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        weights[k] = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        _nearest_on_segment(corners, i, j, weights)
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        _nearest_on_segment(corners, i, k, weights)
    elif va <= 0.0 and d4 >= d3 and d5 >= d6:
        _nearest_on_segment(corners, j, k, weights)
    elif va + vb + vc > 0.0:
        weights[j], weights[k] = vb / (va + vb + vc), vc / (va + vb + vc)
        weights[i] = 1.0 - weights[j] - weights[k]
    else:
        _nearest_on_segment(corners, i, j, weights)


@inner
def _is_beyond(corners: Floats, i: int, j: int, k: int, opposite: int) -> bool:
    """Return whether the origin is in the plane of corners i, j and k, or on the other side than corner `opposite`.

    The result is also True if all four corners lie in one plane. `corners` (4, 3): corners of a tetrahedron.
    """
    ux, uy, uz = corners[j, 0] - corners[i, 0], corners[j, 1] - corners[i, 1], corners[j, 2] - corners[i, 2]
    vx, vy, vz = corners[k, 0] - corners[i, 0], corners[k, 1] - corners[i, 1], corners[k, 2] - corners[i, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    level = nx * corners[i, 0] + ny * corners[i, 1] + nz * corners[i, 2]
    height = nx * corners[opposite, 0] + ny * corners[opposite, 1] + nz * corners[opposite, 2] - level
    return bool(-level * height <= 0.0)


@inner
def _squared_norm(corners: Floats, weights: Floats, nearest: Floats) -> float:
    """Write the sum of the corners (4, 3) times `weights` (4,) to `nearest` (3,), and return its squared norm."""
    for axis in range(3):
        nearest[axis] = 0.0
        for corner in range(4):
            if weights[corner] != 0.0:
                nearest[axis] += weights[corner] * corners[corner, axis]
    return dot(nearest, nearest)


@inner
def _nearest_on_tetrahedron(corners: Floats, weights: Floats, trial: Floats, nearest: Floats) -> float:
    """Write the point of a tetrahedron that is nearest to the origin, and return its squared norm.

    The result is 0 if the origin is inside; weights and point are then not meaningful. `corners` (4, 3): corners;
    `weights` (4,): receives the barycentric weights of the point, 0 on entry; `trial` (4,): work array for the weights
    of one face; `nearest` (3,): receives the point.
    """
    best = np.inf
    for opposite in range(4):
        i, j, k = (opposite + 1) % 4, (opposite + 2) % 4, (opposite + 3) % 4
        if _is_beyond(corners, i, j, k, opposite):
            _nearest_on_triangle(corners, i, j, k, trial)
            squared = _squared_norm(corners, trial, nearest)
            if squared < best:
                best = squared
                for corner in range(4):
                    weights[corner] = trial[corner]
    if best == np.inf:
        return 0.0
    return _squared_norm(corners, weights, nearest)


@inner
def nearest_on_simplex(corners: Floats, count: int, weights: Floats, trial: Floats, nearest: Floats) -> float:
    """Write the point of a simplex that is nearest to the origin, and return its squared norm.

    The norm is 0 if a tetrahedron contains the origin; weights and point are then not meaningful. `corners` (4, 3): the
    first `count` rows, 1 to 4, are the corners; `weights` (4,): receives the barycentric weights of the point; `trial`
    (4,): work array for the weights of one face; `nearest` (3,): receives the point.
    """
    for corner in range(4):
        weights[corner] = 0.0
    if count == 4:
        return _nearest_on_tetrahedron(corners, weights, trial, nearest)
    if count == 1:
        weights[0] = 1.0
    elif count == 2:
        _nearest_on_segment(corners, 0, 1, weights)
    else:
        _nearest_on_triangle(corners, 0, 1, 2, weights)
    return _squared_norm(corners, weights, nearest)


@inner
def drop_corners(corners: Floats, count: int, weights: Floats) -> int:
    """Remove the corners of weight 0 from a simplex in place, and return the number of the remaining corners.

    `corners` (4, 3): the first `count` rows are the corners, and the remaining ones become the first rows; `weights`
    (4,): barycentric weights of the corners, not moved.
    """
    kept = 0
    for corner in range(count):
        if weights[corner] > 0.0:
            for axis in range(3):
                corners[kept, axis] = corners[corner, axis]
            kept += 1
    return kept
