"""Meshes: solids and surfaces in space that consist of triangles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from resgrid._internal.validation import checked
from resgrid._internal.values import frozen
from resgrid.core.axis import LARGEST, Point
from resgrid.core.regions import label_components
from resgrid.errors import InputError
from resgrid.robots.bounded import Bounded, Bounds

MOST_PIECES = 256
"""Largest permitted value of the parameter `pieces` of a mesh: the maximum number of convex sets that cover a mesh."""


@checked
@frozen
@dataclass(frozen=True, eq=False)
class Mesh(Bounded):
    """A solid in space whose surface consists of triangles, or a surface without an inside.

    A part of the mesh (triangles connected by vertices) is a solid, with its inside, if its surface is closed and all
    its triangles have the same orientation: every edge is used as often in one direction as in the other.  A point is
    inside if the surface winds around it.  Other parts are surfaces without thickness.

    Parameters
    ----------
    points : ndarray of float64, shape (v, 3)
        Vertices, in axis units.
    triangles : ndarray of int32, shape (t, 3)
        Indices of the three vertices of every triangle.
    pieces : int
        Maximum number of convex sets, 1 to 256, that replace the mesh in proofs that a robot arm does not collide.
        1 is the convex hull, which fills concavities.
    table : mapping
        Keys and values of the table of a scene that defines the mesh, with the absolute path of the mesh file; empty
        for a mesh that was not read from a file.

    Raises
    ------
    InputError
        If there is no triangle, a coordinate is not finite, or an index has no vertex.

    Examples
    --------
    >>> wedge = rg.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    >>> wedge
    <Mesh of 4 points and 4 triangles, closed>
    >>> wedge.bounds
    ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int32]
    pieces: Annotated[int, Ge(1), Le(MOST_PIECES)] = 1
    table: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        points, triangles = np.array(self.points, dtype=np.float64), np.array(self.triangles)
        if points.ndim != 2 or points.shape[1] != 3:
            raise InputError(f"the points of a mesh need the shape (v, 3), got {points.shape}")
        if triangles.ndim != 2 or triangles.shape[1] != 3 or not len(triangles):
            raise InputError(f"the triangles of a mesh need the shape (t, 3) with t > 0, got {triangles.shape}")
        wrong = ~(np.abs(points) <= LARGEST).all(axis=1)  # True for NaN
        if wrong.any():
            number = int(np.argmax(wrong))
            raise InputError(f"point {number} of the mesh is {points[number].tolist()}; coordinates must be finite")
        if triangles.dtype.kind not in "iu" or triangles.min() < 0 or triangles.max() >= len(points):
            raise InputError(f"the triangles of a mesh need whole numbers from 0 to {len(points) - 1}")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "triangles", triangles.astype(np.int32))

    def __repr__(self) -> str:
        kind = "closed" if self.is_closed else "open"
        return f"<Mesh of {len(self.points)} points and {len(self.triangles)} triangles, {kind}>"

    @property
    def bounds(self) -> Bounds:
        """Lower and upper corner of the mesh's bounding box, in axis units."""
        used = self.points[np.unique(self.triangles)]
        return tuple(used.min(axis=0).tolist()), tuple(used.max(axis=0).tolist())

    @property
    def corners(self) -> NDArray[np.float64]:
        """Vertices of every triangle, shape (t, 3, 3), in axis units."""
        return self.points[self.triangles]

    @property
    def is_closed(self) -> bool:
        """Whether the mesh is a solid: a closed surface whose triangles have the same orientation."""
        return self.open_edges == 0

    @cached_property
    def open_edges(self) -> int:
        """Number of edges that the triangles do not use equally often in both directions; 0 for a closed mesh."""
        return len(self._open_edges)

    @cached_property
    def closed_parts(self) -> NDArray[np.int32]:
        """Triangles of all closed parts, shape (t, 3), oriented so that their winding numbers can be added.

        A part is a set of triangles connected by vertices.  A part whose orientation is opposite to that of the part of
        largest volume is a cavity if all its vertices are inside other parts.  Otherwise its orientation is reversed,
        because in the intersection with another part the winding numbers would cancel.
        """
        part = self._part_of_triangle
        is_closed = np.ones(part.max() + 1, dtype=np.bool_)
        open_points = np.isin(self.triangles, self._open_edges).any(axis=1)
        is_closed[part[open_points]] = False
        a, b, c = (self.corners - self.points[self.triangles[0, 0]]).transpose(1, 0, 2)
        volume = np.bincount(part, np.sum(a * np.cross(b, c), axis=1), minlength=len(is_closed)) * is_closed
        triangles = self.triangles.copy()
        outer = np.sign(volume[np.argmax(np.abs(volume))])
        for number in np.flatnonzero(volume * outer < 0):
            own = part == number
            others = is_closed[part] & ~own
            if not winds_around(self.corners[others], self.points[np.unique(self.triangles[own])]).all():
                triangles[own] = triangles[own, ::-1]
        return triangles[is_closed[part]]

    @cached_property
    def _part_of_triangle(self) -> NDArray[np.int64]:
        """Number of the part to which each triangle belongs, shape (t,)."""
        edges = np.stack([self.triangles, np.roll(self.triangles, -1, axis=1)], axis=-1).reshape(-1, 2)
        return label_components(edges, len(self.points))[self.triangles[:, 0]]

    @cached_property
    def _open_edges(self) -> NDArray[np.int64]:
        """Ends (e, 2), as indices of vertices, of edges that triangles do not use equally often in both directions."""
        starts, ends = self.triangles.ravel().astype(np.int64), np.roll(self.triangles, -1, axis=1).ravel()
        code = np.minimum(starts, ends) * len(self.points) + np.maximum(starts, ends)
        edges, index = np.unique(code, return_inverse=True)
        surplus = edges[np.bincount(index, weights=np.sign(ends - starts)) != 0]
        return np.column_stack(np.divmod(surplus, len(self.points)))

    def shifted(self, by: Point) -> Mesh:
        """Return the mesh translated by the vector `by`, in axis units, with an empty `table`."""
        return Mesh(self.points + np.asarray(by), self.triangles, self.pieces)


def winds_around(corners: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the mask (n,) of points around which a closed surface winds.

    The solid angles of all triangles are added (A. van Oosterom and J. Strackee, IEEE Trans. Biomed. Eng. 30 (1983)
    125).
    `corners` (t, 3, 3): vertices of the triangles; `points` (n, 3): points that do not lie on the surface.
    """
    turns = np.empty(len(points))
    for number, point in enumerate(points):
        a, b, c = (corners - point).transpose(1, 0, 2)
        lengths = np.linalg.norm(corners - point, axis=2)
        products = np.column_stack([np.sum(b * c, axis=1), np.sum(c * a, axis=1), np.sum(a * b, axis=1)])
        volume = np.sum(a * np.cross(b, c), axis=1)
        turns[number] = np.arctan2(volume, np.prod(lengths, axis=1) + np.sum(products * lengths, axis=1)).sum()
    return np.abs(turns) > np.pi
