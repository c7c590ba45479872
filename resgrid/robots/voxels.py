"""`Voxels`, the shape of point clouds and OctoMaps: a union of voxels, stored as few boxes; merging of boxes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import permutations
from math import prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import checked
from resgrid._internal.values import frozen
from resgrid.core.axis import Point
from resgrid.errors import InputError
from resgrid.robots.bounded import Bounded, Bounds, translated
from resgrid.robots.solids import Length, SpacePoint

MAX_TRIED = 50_000
"""Largest number of boxes for which all six orders of the axes are tried when boxes are merged; otherwise one order."""


@checked
@frozen
@dataclass(frozen=True, eq=False)
class Voxels(Bounded):
    """A union of cubic voxels in space, stored as boxes of voxels.

    Parameters
    ----------
    lower : tuple of (float, float, float)
        Lower corner of the voxel (0, 0, 0), in axis units.
    size : float
        Width of a voxel in axis units, above 0.
    boxes : ndarray of int64, shape (b, 2, 3)
        Index of the first voxel of every box, and the index after its last voxel, along x, y and z.
    table : mapping
        Keys and values of the table of a scene that defines the voxels, with the absolute path of the file of points
        or voxels; empty for voxels that were not read from a file.

    Raises
    ------
    InputError
        If there is no box, or a box has no voxel.

    Examples
    --------
    >>> wall = rg.Voxels.of_cells([[0, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1]], size=0.5)
    >>> wall
    <Voxels: 4 of width 0.5 in 1 box>
    >>> wall.bounds
    ((0.0, 0.0, 0.0), (0.5, 1.0, 1.0))
    """

    lower: SpacePoint
    size: Length
    boxes: NDArray[np.int64]
    table: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        boxes = np.array(self.boxes)
        if boxes.ndim != 3 or boxes.shape[1:] != (2, 3) or not len(boxes) or boxes.dtype.kind not in "iu":
            raise InputError(f"boxes of voxels need whole numbers of shape (b, 2, 3) with b > 0, got {boxes.shape}")
        if (boxes[:, 0] >= boxes[:, 1]).any():
            number = int(np.argmax((boxes[:, 0] >= boxes[:, 1]).any(axis=1)))
            raise InputError(f"box {number} has no voxel: {boxes[number].tolist()}; the first index must be smaller")
        object.__setattr__(self, "boxes", boxes.astype(np.int64))

    @classmethod
    def of_cells(cls, cells: ArrayLike, size: float, lower: SpacePoint = (0.0, 0.0, 0.0)) -> Voxels:
        """Return the union of voxels, merged into few boxes.

        Parameters
        ----------
        cells : array_like of int, shape (n, 3)
            Indices of the voxels; repeated voxels count once.
        size : float
            Width of a voxel, in axis units.
        lower : tuple of (float, float, float)
            Lower corner of the voxel (0, 0, 0), in axis units.

        Returns
        -------
        Voxels
            The union of the voxels.
        """
        first = _distinct(np.asarray(cells).reshape(-1, 3))
        return cls(lower, size, merge_boxes(np.stack([first, first + 1], axis=1)))

    def __repr__(self) -> str:
        count = f"{len(self.boxes)} box{'es' * (len(self.boxes) > 1)}"
        return f"<Voxels: {self.count} of width {self.size:g} in {count}>"

    @property
    def count(self) -> int:
        """Number of voxels, if the boxes are disjoint."""
        return int(np.prod(self.boxes[:, 1] - self.boxes[:, 0], axis=1).sum())

    @property
    def corners(self) -> NDArray[np.float64]:
        """Lower and upper corner of every box, shape (b, 2, 3), in axis units."""
        return np.asarray(np.asarray(self.lower) + self.boxes * self.size)

    @property
    def bounds(self) -> Bounds:
        """Lower and upper corner of the bounding box of all voxels, in axis units."""
        lower, upper = self.corners[:, 0].min(axis=0), self.corners[:, 1].max(axis=0)
        return tuple(lower.tolist()), tuple(upper.tolist())

    def shifted(self, by: Point) -> Voxels:
        """Return the voxels translated by the vector `by`, in axis units, with an empty `table`."""
        return Voxels(translated(self.lower, by), self.size, self.boxes)  # type: ignore[arg-type]


def _distinct(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return cells (n, 3) without repetitions, sorted by x, then y, then z."""
    if not len(cells):
        return cells
    low, high = cells.min(axis=0), cells.max(axis=0)
    size = tuple(int(b) - int(a) + 1 for a, b in zip(low, high, strict=True))
    if prod(size) > 1 << 62:  # a cell's number in the bounding box would overflow
        return np.unique(cells, axis=0)
    numbers = np.unique(np.ravel_multi_index(tuple((cells - low).T), size))
    return np.asarray(np.column_stack(np.unravel_index(numbers, size)) + low)


def merge_boxes(boxes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return few disjoint boxes with the same union as disjoint boxes.

    Boxes that share a whole face are joined greedily, along one axis after the other, until no two can be joined.  The
    result with the fewest boxes among all orders of the axes is returned; more than `MAX_TRIED` boxes are joined in the
    order z, y, x only.
    `boxes` (b, 2, 3): first index of every box, and the index after the last, along x, y and z.
    """
    if len(boxes) < 2:
        return boxes
    orders = list(permutations(range(3))) if len(boxes) <= MAX_TRIED else [(2, 1, 0)]
    return min((_merged(boxes, order) for order in orders), key=len)


def _merged(boxes: NDArray[np.int64], order: tuple[int, ...]) -> NDArray[np.int64]:
    """Return disjoint boxes joined along the axes in the given order, repeatedly, until no two boxes can be joined.

    `boxes` (b, 2, 3): first index of every box, and the index after the last, along x, y and z; `order`: numbers of the
    three axes.
    """
    count = len(boxes) + 1
    while len(boxes) < count:
        count = len(boxes)
        for axis in order:
            boxes = _joined(boxes, axis)
    return boxes


def _joined(boxes: NDArray[np.int64], axis: int) -> NDArray[np.int64]:
    """Return boxes in which every row of adjacent boxes along an axis, with equal cross sections, is one box.

    Boxes are adjacent if the end of one is the start of the next.  `boxes` (b, 2, 3): first index of every box, and the
    index after the last, along x, y and z, in any order of the boxes; `axis`: number of the axis.
    """
    across = np.delete(boxes, axis, axis=2).reshape(len(boxes), 4)
    order = np.lexsort((boxes[:, 0, axis], *across.T))
    boxes, across = boxes[order], across[order]
    follows = (across[1:] == across[:-1]).all(axis=1) & (boxes[1:, 0, axis] == boxes[:-1, 1, axis])
    starts, ends = np.flatnonzero(np.r_[True, ~follows]), np.flatnonzero(np.r_[~follows, True])
    return np.stack([boxes[starts, 0], boxes[ends, 1]], axis=1)
