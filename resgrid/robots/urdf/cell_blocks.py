"""Computation of the verdicts (free, collision, undecided) of cells, block by block, for one group of pairs of bodies.

A block is a box of cells in the grid of those joints on which the relative poses of all pairs of the group depend.
An *item* of a box of joint values is a pair of convex pieces, one of either body of a pair, that is not yet proven to
stay apart while the joints move within the box.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from resgrid.robots.urdf.arrays import Flags, Floats, Integers, ProofArrays
from resgrid.robots.urdf.batches import Batch, Group, whole_block
from resgrid.robots.urdf.collision import CollisionChecker

MAX_ITEMS = 100_000
"""Largest number of items (pairs of convex pieces in a box) of a batch of boxes; larger batches are divided, to limit
the memory.
"""

MAX_BOUNDS = 5_000
"""Largest number of evaluated items (pairs of convex pieces in a box), summed over all boxes of a cell, for which boxes
of the cell are halved further; with more, the cell stays undecided.
"""


MAX_TESTS = 64
"""Largest number of collision tests of exact solids in a cell; after more, the search for a collision there ends.

This limit applies to cells in which convex pieces overlap, so that they cannot be proven free.
"""


class CellVerdict(IntEnum):
    """Verdict of a cell of a configuration space about collisions of some or all pairs of bodies."""

    FREE = 0
    """Proven: no configuration of the cell collides."""

    COLLISION = 1
    """A configuration of the cell collides."""

    UNDECIDED = 2
    """Neither a proof nor a collision was found."""


@dataclass(eq=False)
class BlockProof:
    """Verdicts of the cells of a block, and the work that they took.

    `verdict`: value of `CellVerdict` of every cell, uint8, shape of the block; `bounds`: number of evaluated lower
    bounds of the distance of two convex pieces in a box; `probes`: number of tests of two convex pieces at single
    configurations; `tests`: number of collision tests of exact solids.
    """

    verdict: NDArray[np.uint8]
    bounds: int = 0
    probes: int = 0
    tests: int = 0


@dataclass(frozen=True, eq=False)
class _Likely:
    """Likely collisions in n boxes that are not proven, with t items (pairs of convex pieces).

    `touching` (t,): whether the pieces of an item overlap at the centre of the box, False if this was not tested;
    `weight` (n, m): bound in metres, for every moving joint, on the motion within the box of the pieces of the worst
    item, which has the smallest bound on the distance of its pieces; `probe` (n, m): configuration, in radians or
    metres, at which the pieces of the worst item overlap; `item` (n,): index of the worst item, -1 if no such
    configuration was found (`probe` is then not meaningful).
    """

    touching: Flags
    weight: Floats
    probe: Floats
    item: Integers


class BlockProver:
    """Search for the verdicts (free, collision, undecided) of the cells of one block, for one group of pairs of bodies.

    Parameters
    ----------
    arrays : ProofArrays
        Joints and convex pieces, the input of the kernels.
    checker : CollisionChecker
        Collision tests of the exact solids.
    group : Group
        The pairs of bodies whose relative poses depend on the same moving joints.
    halvings : int
        Largest number of successive halvings of a cell; every halving cuts the unproven boxes of the cell into two.
    margin : float
        Distance in metres by which the bodies of every pair stay apart in a cell that is proven free.
    """

    def __init__(
        self, arrays: ProofArrays, checker: CollisionChecker, group: Group, halvings: int, margin: float
    ) -> None:
        self._arrays, self._checker, self._group = arrays, checker, group
        self._halvings, self._margin = halvings, margin
        self._pairs = checker.tree.pairs

    def prove(self, low: Integers, known: NDArray[np.uint8]) -> BlockProof:
        """Return the verdicts of the cells of a block.

        A cell is free if proven boxes cover it, a collision if a tested configuration in it collides, else undecided.

        Parameters
        ----------
        low : ndarray of int64, shape (g,)
            Index of the first cell of the block along every axis of the group's grid.
        known : ndarray of uint8, shape of the block
            Verdicts by other groups.  Cells with a collision are skipped; undecided cells are only tested for
            collisions at a few configurations.
        """
        self._low, self._known = low, known
        self._proof = BlockProof(np.full(known.shape, CellVerdict.UNDECIDED, dtype=np.uint8))
        stack = [whole_block(self._group, self._arrays, self._pairs, low, low + known.shape)]
        while stack:
            batch = self._without_known(stack.pop())
            is_cell = ((batch.high - batch.low) == 1).all(axis=1)
            if is_cell.any():
                self._prove_cells(batch.select(is_cell))
                batch = batch.select(~is_cell)
            if len(batch) > 1 and len(batch.items) > MAX_ITEMS:
                is_first = np.arange(len(batch)) < len(batch) // 2
                stack += [batch.select(~is_first), batch.select(is_first)]
            elif len(batch):
                remaining, likely = self._bound(batch, 0)
                stack.append(remaining.split_cells(self._group, likely.weight))
        return self._proof

    def _without_known(self, batch: Batch) -> Batch:
        """Return the boxes that contain at least one cell without a known collision by another group's pairs."""
        wanted = self._known != CellVerdict.COLLISION
        if wanted.all():
            return batch
        total = np.pad(wanted.astype(np.int64), [(1, 0)] * wanted.ndim)
        for axis in range(wanted.ndim):
            total = total.cumsum(axis=axis)
        count = np.zeros(len(batch), dtype=np.int64)
        for corner in np.ndindex(*(2,) * wanted.ndim):
            at = np.where(corner, batch.high, batch.low) - self._low
            count += (-1) ** (wanted.ndim - sum(corner)) * total[tuple(at.T)]
        return batch.select(count > 0)

    def _bound(self, batch: Batch, probing: int) -> tuple[Batch, _Likely]:
        """Return the boxes that are not proven, with the items that are not proven, and the likely collisions in them.

        An item is a pair of convex pieces in a box; a box is proven if all its items are proven to stay apart.  The
        search starts with the hint of an item, a direction, and stores the best direction as the new hint.  The cells
        of proven boxes of several cells get the verdict free.  `probing`: items that are tested for overlaps at single
        configurations: 0 for none, 1 for the item with the smallest distance bound in every box, 2 for all items that
        are not proven.
        """
        from resgrid.robots.urdf.box_kernels import Boxes, Findings, bound_boxes, new_work

        count, items, joints = len(batch), len(batch.items), batch.lower.shape[1]
        found = Findings(
            np.ones(items, bool), np.zeros(items, bool), np.zeros((count, joints)), np.zeros((count, joints)),
            np.full(count, -1), np.zeros(2, np.int64),
        )  # fmt: skip
        boxes = Boxes(batch.lower, batch.upper, batch.first, batch.items, batch.hints)
        tree = self._arrays.tree
        bound_boxes(boxes, self._group.excess, self._margin, probing, tree, found, new_work(tree, joints))
        self._proof.bounds += int(found.counts[0])
        self._proof.probes += int(found.counts[1])
        rows = np.bincount(batch.boxes_of_items()[found.is_open], minlength=count) > 0
        for box in np.flatnonzero(~rows & (batch.owner < 0)):
            cells = tuple(map(slice, batch.low[box] - self._low, batch.high[box] - self._low))
            self._proof.verdict[cells] = CellVerdict.FREE
        item = found.probe_item[rows]
        item = np.where(item >= 0, (np.cumsum(found.is_open) - 1)[item], -1)
        likely = _Likely(found.touching[found.is_open], found.weight[rows], found.probe[rows], item)
        return batch.keep(rows, found.is_open), likely

    def _prove_cells(self, batch: Batch) -> None:
        """Find and record the verdicts of single cells; `batch`: boxes that are one cell each."""
        owner = np.ravel_multi_index(tuple((batch.low - self._low).T), self._known.shape)
        cells = replace(batch, owner=np.asarray(owner, dtype=np.int64))
        part = np.cumsum(np.diff(cells.first)) // MAX_ITEMS
        for number in np.unique(part):
            self._halve_cells(cells.select(part == number))

    def _halve_cells(self, batch: Batch) -> None:
        """Find the verdicts of single cells: halve boxes until all are proven or a configuration collides.

        A box after h halvings has the volume ``2**-h`` of its cell.  These volumes add up without rounding error, and a
        cell is free if its proven boxes have its volume.  If convex pieces overlap in a cell, it cannot be proven; the
        search for a collision goes on in the boxes with an overlap.
        """
        verdict = self._proof.verdict.reshape(-1)
        volume = np.zeros(len(verdict))
        bounds, tests = np.zeros((2, len(verdict)), dtype=np.int64)
        is_known = self._known.reshape(-1) == CellVerdict.UNDECIDED
        overlaps = np.zeros(len(verdict), dtype=bool)
        cells = batch.owner
        for halving in range(self._halvings + 1):
            np.add.at(bounds, batch.owner, np.diff(batch.first))
            np.add.at(volume, batch.owner, 0.5**halving)
            batch, likely = self._bound(batch, 2 if halving == 0 else 1)
            np.subtract.at(volume, batch.owner, 0.5**halving)
            verdict[self._colliding(batch, likely, tests, whole=halving == 0)] = CellVerdict.COLLISION
            is_coarse = self._is_coarse(batch)
            overlaps[batch.owner[batch.boxes_of_items()[likely.touching & ~is_coarse]]] = True
            has_probe = likely.item >= 0
            overlaps[batch.owner[has_probe][~is_coarse[likely.item[has_probe]]]] = True
            stopped = is_known | (bounds > MAX_BOUNDS) | (verdict == CellVerdict.COLLISION)
            stopped |= overlaps & (tests > MAX_TESTS)
            going = ~stopped[batch.owner] & (has_probe | ~overlaps[batch.owner])
            if halving == self._halvings or not going.any():
                break
            coarse = (is_coarse & likely.touching)[np.repeat(going, np.diff(batch.first))]
            batch = self._with_pieces(batch.select(going), coarse).halve(likely.weight[going])
        verdict[cells[(volume[cells] == 1.0) & (verdict[cells] != CellVerdict.COLLISION)]] = CellVerdict.FREE

    def _colliding(self, batch: Batch, likely: _Likely, tests: Integers, *, whole: bool) -> Integers:
        """Return the numbers of the cells in which exact solids collide at a tested configuration, shape (hits,).

        Numbers are in C order of the block.  `batch`, `likely`: boxes that are not proven, and configurations at which
        convex pieces overlap; `tests` (cells,): number of tests of every cell, increased by those made here; `whole`:
        True tests ``likely.item`` (at most one pair of pieces per box, with its configuration ``likely.probe``) and all
        other pairs of pieces that overlap at the centre of a box; False tests only ``likely.item``.
        """
        rows = np.flatnonzero(likely.item >= 0)
        pairs, configurations, owners = batch.items[likely.item[rows], 0], likely.probe[rows], batch.owner[rows]
        if whole:
            box = batch.boxes_of_items()[likely.touching]
            pairs = np.concatenate([pairs, batch.items[likely.touching, 0]])
            centres = 0.5 * (batch.lower + batch.upper)
            configurations = np.concatenate([configurations, centres[box]])
            owners = np.concatenate([owners, batch.owner[box]])
        _, chosen = np.unique(np.column_stack([owners, pairs, configurations]), axis=0, return_index=True)
        chosen = np.sort(chosen)
        pairs, configurations, owners = pairs[chosen], configurations[chosen], owners[chosen]
        hits: list[Integers] = []
        while len(pairs):  # one test per cell and round, until a test succeeds
            _, tried = np.unique(owners, return_index=True)
            collides = self._checker.collide_in_pairs(configurations[tried], pairs[tried])
            self._proof.tests += len(tried)
            tests[owners[tried]] += 1
            hits.append(owners[tried[collides]])
            rest = ~np.isin(owners, hits[-1])
            rest[tried] = False
            pairs, configurations, owners = pairs[rest], configurations[rest], owners[rest]
        return np.concatenate(hits) if hits else np.zeros(0, dtype=np.int64)

    def _is_coarse(self, batch: Batch) -> Flags:
        """Return the mask (t,) of the items that pair two hulls of bodies, of which one or both have several pieces.

        An item is a pair of convex pieces, or of hulls, in a box.
        """
        bodies = self._pairs[batch.items[:, 0]]
        is_hull = (batch.items[:, 1:] == self._arrays.hull[bodies]).all(axis=1)
        return np.asarray(is_hull & (np.diff(self._arrays.spans, axis=1)[bodies, 0] > 1).any(axis=1))

    def _with_pieces(self, batch: Batch, coarse: Flags) -> Batch:
        """Return a batch in which some pairs of hulls are replaced by all pairs of convex pieces of their two bodies.

        `coarse` (t,): mask of the replaced items, which are pairs of convex hulls.
        """
        return batch.with_pieces(coarse, self._pairs[batch.items[:, 0]], self._arrays.spans)
