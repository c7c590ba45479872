"""Verdicts of one block of cells, for the pairs of bodies that depend on the same joints."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from resgrid.robots.urdf.arrays import Floats, Integers, ProofArrays
from resgrid.robots.urdf.collision import CollisionChecker

MARGIN = 1e-5
"""Distance in metres by which proven cells stay away from collisions.

Collision tests with the algorithm of Gilbert, Johnson and Keerthi report a collision at distances below 1e-6 m.
"""

CHUNK = 512
"""Number of cells that are subdivided at once; limits the memory."""

MAX_BOXES = 2000
"""Number of boxes of a cell after which it stays undecided."""

FREE, COLLISION, UNDECIDED = 0, 1, 2


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
    halvings : int
        Number of times that a cell is halved.
    """

    joints: tuple[int, ...]
    pairs: Integers
    edges: tuple[Floats, ...]
    middle: Floats
    excess: Floats
    halvings: int


@dataclass(frozen=True, eq=False)
class _Batch:
    """Boxes with their open items.

    `low, high` (n, g): first cell, and last cell plus 1, of a box along the joints of the group; `lower, upper` (n, m):
    corners in joint units; `owner` (n,): number of the cell that contains a box, -1 for larger boxes; `first` (n + 1,),
    `items` (t, 3), `hints` (t, 3): see `resgrid.robots.urdf.box_kernels.Boxes`.
    """

    lower: Floats
    upper: Floats
    first: Integers
    items: Integers
    hints: Floats
    owner: Integers = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    low: Integers = field(default_factory=lambda: np.zeros((0, 0), dtype=np.int64))
    high: Integers = field(default_factory=lambda: np.zeros((0, 0), dtype=np.int64))

    def boxes_of_items(self) -> Integers:
        """Return the box of every item, shape (t,)."""
        return np.repeat(np.arange(len(self.first) - 1), np.diff(self.first))


@dataclass(eq=False)
class BlockProof:
    """Verdicts of the cells of a block, and the work that they took.

    `verdict`: uint8, shape of the block; `bounds`: number of evaluated bounds; `probes`: number of tests of convex
    pieces at single configurations; `tests`: number of collision tests of exact solids.
    """

    verdict: NDArray[np.uint8]
    bounds: int = 0
    probes: int = 0
    tests: int = 0


class BlockProver:
    """Finds the verdicts of blocks of cells for one robot.

    `arrays`: input of the kernels; `checker`: collision tests of the exact solids.
    """

    def __init__(self, arrays: ProofArrays, checker: CollisionChecker) -> None:
        self._arrays, self._checker = arrays, checker
        self._points = int(np.diff(arrays.tree.first).max(initial=1))
        self._pairs = checker.tree.pairs
        self._work = BlockProof(np.zeros(0, np.uint8))

    def prove(self, group: Group, low: Integers, high: Integers, known: NDArray[np.uint8]) -> BlockProof:
        """Return the verdicts of the cells from `low` to `high` (excluded), both (g,), of a group's grid.

        `known`: verdicts of other groups, shape of the block.  Cells with a collision are skipped; undecided cells are
        only tested for collisions at a few configurations.
        """
        self._work = work = BlockProof(np.zeros(known.shape, np.uint8))
        flat, skipped = work.verdict.reshape(-1), known.reshape(-1)
        if (skipped == COLLISION).all():
            return work
        fresh: list[_Batch] = []
        batch = self._whole(group, low, high)
        while len(batch.lower):
            cells = (batch.high - batch.low).prod(axis=1)
            single = cells == 1
            if single.any():
                fresh.append(_select(batch, single))
                batch = _select(batch, ~single)
                continue
            batch = _drop_known(self._split(group, self._bound(group, batch, 0)), low, known)
        for cells in fresh:
            at = np.ravel_multi_index(tuple((cells.low - low).T), known.shape)
            wanted = skipped[at] != COLLISION
            cells = replace(_select(cells, wanted), owner=at[wanted])
            for start in range(0, len(cells.lower), CHUNK):
                part = np.zeros(len(cells.lower), bool)
                part[start : start + CHUNK] = True
                self._subdivide(group, _select(cells, part), flat, skipped)
        return work

    def _whole(self, group: Group, low: Integers, high: Integers) -> _Batch:
        """Return the whole block as one box with all pairs of the group."""
        bodies = self._pairs[group.pairs]
        items = np.column_stack([group.pairs, self._arrays.hull[bodies]])
        hints = np.tile([0.0, 0.0, 1.0], (len(items), 1))
        first = np.array([0, len(items)])
        empty = np.zeros((1, len(group.middle)))
        batch = _Batch(empty, empty, first, items, hints, np.full(1, -1), low[np.newaxis], high[np.newaxis])
        return _with_corners(group, batch)

    def _bound(self, group: Group, batch: _Batch, probing: int) -> tuple[_Batch, _Findings]:
        """Return a batch of the boxes that are not proven, with improved hints, and the findings about them."""
        from resgrid.robots.urdf.box_kernels import Boxes, Findings, bound_boxes

        count, items, joints = len(batch.lower), len(batch.items), batch.lower.shape[1]
        found = Findings(
            np.zeros(items, bool), np.zeros(items, bool), np.zeros((count, joints)), np.zeros((count, joints)),
            np.zeros(count, np.int64), np.zeros(2, np.int64),
        )  # fmt: skip
        boxes = Boxes(batch.lower, batch.upper, batch.first, batch.items, batch.hints)
        bound_boxes(boxes, group.excess, MARGIN, probing, self._arrays.tree, self._points, found)
        self._work.bounds += int(found.counts[0])
        self._work.probes += int(found.counts[1])
        return _open_boxes(batch, found.is_open, found.touching, found.weight, found.probe, found.probe_item)

    def _split(self, group: Group, bounded: tuple[_Batch, _Findings]) -> _Batch:
        """Return the halves of boxes of several cells, cut between cells along the joint with the largest weight."""
        batch, found = bounded
        count = len(batch.lower)
        if not count:
            return batch
        size = batch.high - batch.low
        weight = np.where(size > 1, found.weight[:, list(group.joints)], -1.0)
        rows, axis = np.arange(count), weight.argmax(axis=1)
        middle = batch.low[rows, axis] + size[rows, axis] // 2
        halves = _twice(batch)
        halves.high[rows, axis] = middle
        halves.low[rows + count, axis] = middle
        return _with_corners(group, halves)

    def _subdivide(self, group: Group, batch: _Batch, flat: NDArray[np.uint8], known: NDArray[np.uint8]) -> None:
        """Write the verdicts of single cells to `flat`; `batch`: one box for every cell."""
        spent = np.zeros(len(flat), dtype=np.int64)
        for halving in range(group.halvings + 1):
            np.add.at(spent, batch.owner, 1)
            bounded, found = self._bound(group, batch, 2 if halving == 0 else 1)
            flat[self._colliding(bounded, found, whole=halving == 0)] = COLLISION
            going = flat[bounded.owner] != COLLISION
            stopped = going & ((known[bounded.owner] == UNDECIDED) | (spent[bounded.owner] > MAX_BOXES))
            if halving == group.halvings:
                stopped = going
            flat[bounded.owner[stopped]] = UNDECIDED
            going &= flat[bounded.owner] != UNDECIDED
            if not going.any():
                return
            weight = found.weight[going]
            batch = self._refine(_select(bounded, going), found.touching[np.repeat(going, np.diff(bounded.first))])
            batch = _halve(batch, weight)

    def _colliding(self, batch: _Batch, found: _Findings, *, whole: bool) -> Integers:
        """Return the cells in which exact solids collide at a probed configuration.

        `whole`: whether all items that overlap at the centre of a box are tested, otherwise only the probed ones.
        """
        rows = np.flatnonzero(found.probe_item >= 0)
        pairs, configurations, owners = batch.items[found.probe_item[rows], 0], found.probe[rows], batch.owner[rows]
        if whole:
            box = batch.boxes_of_items()
            more = np.flatnonzero(found.touching)
            centres = (batch.lower + batch.upper) / 2
            pairs = np.concatenate([pairs, batch.items[more, 0]])
            configurations = np.concatenate([configurations, centres[box[more]]])
            owners = np.concatenate([owners, batch.owner[box[more]]])
        done = np.zeros(0, dtype=np.int64)
        while len(pairs):  # one test per cell and round, until a test succeeds
            _, chosen = np.unique(owners, return_index=True)
            hits = self._checker.collide_in_pairs(configurations[chosen], pairs[chosen])
            self._work.tests += len(chosen)
            done = np.concatenate([done, owners[chosen[hits]]])
            rest = np.ones(len(pairs), bool)
            rest[chosen] = False
            rest &= ~np.isin(owners, done)
            pairs, configurations, owners = pairs[rest], configurations[rest], owners[rest]
        return done

    def _refine(self, batch: _Batch, touching: NDArray[np.bool_]) -> _Batch:
        """Replace items whose pieces overlap, although the solids do not collide, by the pieces of their bodies."""
        hull, spans = self._arrays.hull, self._arrays.spans
        a, b = self._pairs[batch.items[:, 0]].T
        counts = (spans[a, 1] - spans[a, 0]) * (spans[b, 1] - spans[b, 0])
        coarse = touching & (batch.items[:, 1] == hull[a]) & (batch.items[:, 2] == hull[b]) & (counts > 1)
        if not coarse.any():
            return batch
        repeats = np.where(coarse, counts, 1)
        source = np.repeat(np.arange(len(a)), repeats)
        number = np.arange(len(source)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
        items, wide = batch.items[source].copy(), spans[b, 1] - spans[b, 0]
        fine = coarse[source]
        items[fine, 1] = spans[a[source], 0][fine] + number[fine] // wide[source][fine]
        items[fine, 2] = spans[b[source], 0][fine] + number[fine] % wide[source][fine]
        per_box = np.bincount(batch.boxes_of_items()[source], minlength=len(batch.lower))
        first = np.concatenate([[0], np.cumsum(per_box)])
        return replace(batch, first=first, items=items, hints=batch.hints[source].copy())


@dataclass(frozen=True, eq=False)
class _Findings:
    """Findings about boxes that are not proven: see `resgrid.robots.urdf.box_kernels.Findings`."""

    touching: NDArray[np.bool_]
    weight: Floats
    probe: Floats
    probe_item: Integers


def _open_boxes(
    batch: _Batch, is_open: NDArray[np.bool_], touching: NDArray[np.bool_], weight: Floats, probe: Floats,
    probe_item: Integers,
) -> tuple[_Batch, _Findings]:  # fmt: skip
    """Return a batch of the boxes with open items, and the findings about them; the arrays are those of `Findings`."""
    per_box = np.bincount(batch.boxes_of_items()[is_open], minlength=len(batch.lower))
    rows = np.flatnonzero(per_box)
    number = np.cumsum(is_open) - 1
    item = np.where(probe_item[rows] >= 0, number[probe_item[rows]], -1) if len(number) else probe_item[rows]
    kept = _Batch(
        batch.lower[rows], batch.upper[rows], np.concatenate([[0], np.cumsum(per_box[rows])]), batch.items[is_open],
        batch.hints[is_open], batch.owner[rows], batch.low[rows], batch.high[rows],
    )  # fmt: skip
    return kept, _Findings(touching[is_open], weight[rows], probe[rows], item)


def _select(batch: _Batch, rows: NDArray[np.bool_]) -> _Batch:
    """Return the boxes of a mask (n,), with their items."""
    per_box = np.diff(batch.first)
    items = np.repeat(rows, per_box)
    return _Batch(
        batch.lower[rows], batch.upper[rows], np.concatenate([[0], np.cumsum(per_box[rows])]), batch.items[items],
        batch.hints[items], batch.owner[rows], batch.low[rows], batch.high[rows],
    )  # fmt: skip


def _twice(batch: _Batch) -> _Batch:
    """Return a batch that contains every box twice: first all boxes, then all again."""
    both = [np.concatenate([part, part]) for part in (batch.lower, batch.upper, batch.items, batch.hints)]
    first = np.concatenate([batch.first, batch.first[-1] + batch.first[1:]])
    ranges = [np.concatenate([part, part]) for part in (batch.owner, batch.low, batch.high)]
    return _Batch(both[0], both[1], first, both[2], both[3], *ranges)


def _halve(batch: _Batch, weight: Floats) -> _Batch:
    """Return the halves of boxes, cut along the joint of the largest weight; `weight` (n, m)."""
    count = len(batch.lower)
    rows, axis = np.arange(count), weight.argmax(axis=1)
    middle = 0.5 * (batch.lower[rows, axis] + batch.upper[rows, axis])
    halves = _twice(batch)
    halves.upper[rows, axis] = middle
    halves.lower[rows + count, axis] = middle
    return halves


def _with_corners(group: Group, batch: _Batch) -> _Batch:
    """Return the batch with the corners of its boxes in joint units, from the ranges of cells."""
    lower, upper = np.tile(group.middle, (2, len(batch.low), 1))
    for axis, joint in enumerate(group.joints):
        lower[:, joint] = group.edges[axis][batch.low[:, axis]]
        upper[:, joint] = group.edges[axis][batch.high[:, axis]]
    return replace(batch, lower=lower, upper=upper)


def _drop_known(batch: _Batch, low: Integers, known: NDArray[np.uint8]) -> _Batch:
    """Return the boxes that contain cells without a known collision; `low` (g,): first cell of the block."""
    if not (known == COLLISION).any() or not len(batch.lower):
        return batch
    total = np.pad((known != COLLISION).astype(np.int64), [(1, 0)] * known.ndim)
    for axis in range(known.ndim):
        total = total.cumsum(axis=axis)
    count = np.zeros(len(batch.lower), dtype=np.int64)
    for corner in np.ndindex(*(2,) * known.ndim):
        at = np.where(corner, batch.high, batch.low) - low
        count += (-1) ** (known.ndim - sum(corner)) * total[tuple(at.T)]
    return _select(batch, count > 0)
