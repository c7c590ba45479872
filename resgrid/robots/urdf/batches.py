"""Boxes of joint values that are tested together in proofs of freedom, and their division into smaller boxes.

There are m moving joints, in radians or metres; g of them belong to a group of pairs of bodies.  A batch has n boxes
and t items, each a pair of convex pieces in one box.
"""

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
        Indices of these g moving joints, ascending.
    pairs : ndarray of int64, shape (p,)
        Indices of the pairs of bodies in ``KinematicTree.pairs``.
    edges : tuple of ndarray of float64
        For every joint of the group, the borders of the cells of its axis (cells + 1,), in radians or metres.
    middle : ndarray of float64, shape (m,)
        Configuration in the middle of all axes; it sets the joints outside the group, which do not matter.
    excess : ndarray of float64, shape (m,)
        Rounding error of joint values, added to the half widths of boxes; 0 for joints outside the group.
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
        Lowest and highest value of every moving joint in a box, in radians or metres.
    first : ndarray of int64, shape (n + 1,)
        Box i has the items ``first[i] .. first[i + 1] - 1``.
    items : ndarray of int64, shape (t, 3)
        Index of the pair of bodies, and indices of a convex piece of its first and of its second body.
    hints : ndarray of float64, shape (t, 3)
        Unit vectors from the second piece to the first one along which the pieces are likely to be apart.
    owner : ndarray of int64, shape (n,)
        Number of the cell that contains a box, in C order of the block of cells; -1 for a box of several cells.
    low, high : ndarray of int64, shape (n, g)
        Index of the first cell, and of the last cell plus 1, along every joint of the group: the cells of the box, or
        the cell that contains it.
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
        """Return the index of the box to which every item belongs, shape (t,)."""
        return np.repeat(np.arange(len(self)), np.diff(self.first))

    def select(self, rows: Flags) -> Batch:
        """Return the boxes for which `rows` (n,) is True, with all items of these boxes."""
        return self.keep(rows, np.repeat(rows, np.diff(self.first)))

    def keep(self, rows: Flags, items: Flags) -> Batch:
        """Return the boxes for which `rows` (n,) is True, with their items for which `items` (t,) is True.

        `items` must be False for the items of all other boxes.
        """
        per_box = np.bincount(self.boxes_of_items()[items], minlength=len(self))[rows]
        return Batch(
            self.lower[rows], self.upper[rows], np.concatenate([[0], np.cumsum(per_box)]), self.items[items],
            self.hints[items], self.owner[rows], self.low[rows], self.high[rows],
        )  # fmt: skip

    def twice(self) -> Batch:
        """Return a batch with every box twice, with the same items: all boxes, then all boxes again."""
        first = np.concatenate([self.first, self.first[-1] + self.first[1:]])
        lower, upper, items, hints, owner, low, high = (
            np.concatenate([part, part])
            for part in (self.lower, self.upper, self.items, self.hints, self.owner, self.low, self.high)
        )
        return Batch(lower, upper, first, items, hints, owner, low, high)

    def halve(self, weight: Floats) -> Batch:
        """Return the two halves of every box: first all lower halves, then all upper halves.

        A box is cut in the middle of the range of the joint with the largest weight. `weight` (n, m): bound on the
        distance, in metres, by which every joint moves the pieces of one item of the box within the box.  This item is
        the one with the smallest bound on the distance between its pieces.
        """
        count = len(self)
        rows, joint = np.arange(count), weight.argmax(axis=1)
        middle = 0.5 * (self.lower[rows, joint] + self.upper[rows, joint])
        halves = self.twice()
        halves.upper[rows, joint] = middle
        halves.lower[rows + count, joint] = middle
        return halves

    def split_cells(self, group: Group, weight: Floats) -> Batch:
        """Return two parts of every box of several cells, cut between cells: first all lower parts, then the others.

        The range of the joint with the largest weight, among joints with at least two cells, is cut. `weight` (n, m):
        bound on the distance, in metres, by which every joint moves the pieces of one item of the box within the box.
        This item is the one with the smallest bound on the distance between its pieces.
        """
        count, size = len(self), self.high - self.low
        rows, axis = np.arange(count), np.where(size > 1, weight[:, list(group.joints)], -1.0).argmax(axis=1)
        middle = self.low[rows, axis] + size[rows, axis] // 2
        halves = self.twice()
        halves.high[rows, axis] = middle
        halves.low[rows + count, axis] = middle
        return halves.with_corners(group)

    def with_corners(self, group: Group) -> Batch:
        """Return the batch with `lower` and `upper` recomputed from the ranges of cells `low` and `high`."""
        lower, upper = np.tile(group.middle, (2, len(self), 1))
        for axis, joint in enumerate(group.joints):
            lower[:, joint] = group.edges[axis][self.low[:, axis]]
            upper[:, joint] = group.edges[axis][self.high[:, axis]]
        return replace(self, lower=lower, upper=upper)

    def with_pieces(self, coarse: Flags, bodies: Integers, spans: Integers) -> Batch:
        """Return the batch with some items replaced by one item for every pair of pieces of their two bodies.

        `coarse` (t,): mask of the replaced items; `bodies` (t, 2): indices of the bodies of every item; `spans`
        (bodies, 2): first index, and last index plus 1, of the pieces of every body.
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
    """Return a batch of one box, a whole block of cells, with items for all pairs of bodies of a group.

    An item is a pair of convex hulls, or, if a body of the pair is loose (its convex pieces have less than 0.8 of the
    volume of its hull), every pair of convex pieces.  `group`: the group of pairs; `arrays`: arrays of the tree with
    hulls and pieces; `pairs` (p, 2): bodies of all pairs of the tree; `low, high` (g,): index of the block's first
    cell, and of its last cell plus 1, along every joint of the group.
    """
    bodies = pairs[group.pairs]
    items = np.column_stack([group.pairs, arrays.hull[bodies]])
    hints = np.tile([0.0, 0.0, 1.0], (len(items), 1))
    corner = np.zeros((1, len(group.middle)))
    first, owner = np.array([0, len(items)]), np.full(1, -1)
    batch = Batch(corner, corner, first, items, hints, owner, low[np.newaxis], high[np.newaxis])
    return batch.with_corners(group).with_pieces(np.any(arrays.is_loose[bodies], axis=1), bodies, arrays.spans)
