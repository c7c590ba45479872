"""Batches of boxes of joint values, and their division into smaller boxes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from resgrid.robots.urdf.arrays import Flags, Floats, Integers, ProofArrays


@dataclass(frozen=True, eq=False)
class Group:
    """The pairs of bodies whose relative poses depend on the same moving joints.

    Attributes
    ----------
    joints : tuple of int
        Indices of these moving joints.
    pairs : ndarray of int64, shape (p,)
        Indices of the pairs.
    edges : tuple of ndarray of float64
        Cell borders of the axes of these joints.
    middle : ndarray of float64, shape (m,)
        Configuration for the values of the other joints.
    excess : ndarray of float64, shape (m,)
        Rounding error of joint values, added to the half widths of boxes; 0 for the other joints.
    """

    joints: tuple[int, ...]
    pairs: Integers
    edges: tuple[Floats, ...]
    middle: Floats
    excess: Floats

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of cells along every axis of the group's grid."""
        return tuple(len(edges) - 1 for edges in self.edges)


@dataclass(frozen=True, eq=False)
class Batch:
    """Boxes of joint values, and items: pairs of convex pieces that are not yet proven to stay apart in a box.

    Attributes
    ----------
    lower, upper : ndarray of float64, shape (n, m)
        Corners of the boxes, in joint units.
    first : ndarray of int64, shape (n + 1,)
        Box i has the items ``first[i] .. first[i + 1] - 1``.
    items : ndarray of int64, shape (t, 3)
        Pair of bodies, piece of the first body, piece of the second one.
    hints : ndarray of float64, shape (t, 3)
        Likely separating directions, from the second piece to the first one.
    owner : ndarray of int64, shape (n,)
        Number of the cell that contains a box, in C order of the block; -1 for a box of several cells.
    low, high : ndarray of int64, shape (n, g)
        First cell, and last cell plus 1, of a box along the joints of its group.
    """

    lower: Floats
    upper: Floats
    first: Integers
    items: Integers
    hints: Floats
    owner: Integers
    low: Integers
    high: Integers

    def __len__(self) -> int:
        return len(self.lower)

    def boxes_of_items(self) -> Integers:
        """Return the box of every item, shape (t,)."""
        return np.repeat(np.arange(len(self)), np.diff(self.first))

    def select(self, rows: Flags) -> Batch:
        """Return the boxes of a mask (n,), with all their items."""
        return self.keep(rows, np.repeat(rows, np.diff(self.first)))

    def keep(self, rows: Flags, items: Flags) -> Batch:
        """Return the boxes of a mask (n,), with the items of a mask (t,)."""
        per_box = np.bincount(self.boxes_of_items()[items], minlength=len(self))[rows]
        return Batch(
            self.lower[rows], self.upper[rows], np.concatenate([[0], np.cumsum(per_box)]), self.items[items],
            self.hints[items], self.owner[rows], self.low[rows], self.high[rows],
        )  # fmt: skip

    def twice(self) -> Batch:
        """Return every box twice: all boxes, then all boxes again."""
        first = np.concatenate([self.first, self.first[-1] + self.first[1:]])
        lower, upper, items, hints, owner, low, high = (
            np.concatenate([part, part])
            for part in (self.lower, self.upper, self.items, self.hints, self.owner, self.low, self.high)
        )
        return Batch(lower, upper, first, items, hints, owner, low, high)

    def halve(self, weight: Floats) -> Batch:
        """Return the halves of all boxes, cut along the joint with the largest weight; `weight` (n, m)."""
        count = len(self)
        rows, joint = np.arange(count), weight.argmax(axis=1)
        middle = 0.5 * (self.lower[rows, joint] + self.upper[rows, joint])
        halves = self.twice()
        halves.upper[rows, joint] = middle
        halves.lower[rows + count, joint] = middle
        return halves

    def split_cells(self, group: Group, weight: Floats) -> Batch:
        """Return two parts of all boxes, cut between cells along the joint with the largest weight; `weight` (n, m)."""
        count, size = len(self), self.high - self.low
        rows, axis = np.arange(count), np.where(size > 1, weight[:, list(group.joints)], -1.0).argmax(axis=1)
        middle = self.low[rows, axis] + size[rows, axis] // 2
        halves = self.twice()
        halves.high[rows, axis] = middle
        halves.low[rows + count, axis] = middle
        return halves.with_corners(group)

    def with_corners(self, group: Group) -> Batch:
        """Return the batch with corners in joint units that belong to the ranges of cells."""
        lower, upper = np.tile(group.middle, (2, len(self), 1))
        for axis, joint in enumerate(group.joints):
            lower[:, joint] = group.edges[axis][self.low[:, axis]]
            upper[:, joint] = group.edges[axis][self.high[:, axis]]
        return replace(self, lower=lower, upper=upper)

    def with_pieces(self, coarse: Flags, bodies: Integers, spans: Integers) -> Batch:
        """Return the batch with items replaced by one item for every pair of pieces of their bodies.

        `coarse` (t,): the replaced items; `bodies` (t, 2): bodies of the items; `spans` (bodies, 2): pieces of a body.
        """
        if not coarse.any():
            return self
        start, count = spans[bodies, 0], np.diff(spans, axis=1)[bodies, 0]
        repeats = np.where(coarse, count.prod(axis=1), 1)
        source = np.repeat(np.arange(len(coarse)), repeats)
        number = np.arange(len(source)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
        pieces = start[source] + np.stack(np.divmod(number, count[source, 1]), axis=1)
        items = self.items[source]
        items[coarse[source], 1:] = pieces[coarse[source]]
        per_box = np.bincount(self.boxes_of_items()[source], minlength=len(self))
        return replace(
            self, first=np.concatenate([[0], np.cumsum(per_box)]), items=items, hints=self.hints[source].copy()
        )


def whole_block(group: Group, arrays: ProofArrays, pairs: Integers, low: Integers, high: Integers) -> Batch:
    """Return a block of cells as one box with all pairs of a group.

    `pairs` (p, 2): bodies of all pairs; `low, high` (g,): first cells, and last cells plus 1.
    """
    bodies = pairs[group.pairs]
    items = np.column_stack([group.pairs, arrays.hull[bodies]])
    hints = np.tile([0.0, 0.0, 1.0], (len(items), 1))
    corner = np.zeros((1, len(group.middle)))
    first, owner = np.array([0, len(items)]), np.full(1, -1)
    batch = Batch(corner, corner, first, items, hints, owner, low[np.newaxis], high[np.newaxis])
    return batch.with_corners(group).with_pieces(np.any(arrays.is_loose[bodies], axis=1), bodies, arrays.spans)
