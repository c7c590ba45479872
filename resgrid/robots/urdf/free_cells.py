"""Proofs that whole cells of the configuration space of a robot from a URDF file are free of collisions.

The pairs of bodies are grouped by the joints that change their relative pose.  Every group has the grid of its joints
alone; the verdicts of all groups are broadcast to the whole grid and combined.  A group's grid is divided into blocks,
which any executor can process in any order with the same result.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.checkpoints import Journal
from resgrid._internal.parallel import JobPart, in_order
from resgrid._internal.values import frozen
from resgrid.core.axis import Axis, rounding
from resgrid.errors import InputError
from resgrid.robots.cells import Progress
from resgrid.robots.convex import Solid
from resgrid.robots.urdf.arrays import Integers, ProofArrays, proof_arrays
from resgrid.robots.urdf.batches import Group
from resgrid.robots.urdf.cell_blocks import BlockProof, BlockProver, CellVerdict
from resgrid.robots.urdf.collision import CollisionChecker
from resgrid.robots.urdf.tree import KinematicTree

RULES = 1
"""Version number of the proof rules; increase it when verdicts change, so that stored verdicts are computed again."""

CENTRES = 1 << 14
"""Number of cells whose centres are tested between two reports of progress.

The cells are those of a `Group`: the grid over the joints that one set of pairs of bodies depends on.
"""

BLOCK = 8
"""Largest number of cells, along an axis, of a block, the unit of work and of a checkpoint."""

HALVINGS = 5
"""Largest number of successive halvings of a cell, per moving joint of the robot; with m joints m times as many."""

MARGIN = 1e-5
"""Distance in metres by which the bodies of every pair stay apart in a cell that is proven free.

Collision tests with the algorithm of Gilbert, Johnson and Keerthi report a collision at distances below 1e-6 m. The
distance is larger for robots with coordinates beyond 1e7 m (see `ROUNDING`).
"""

ROUNDING = 1e-12
"""Bound on the rounding error of a position in space, relative to the largest magnitude of the robot's coordinates."""


@frozen
@dataclass(frozen=True, eq=False)
class CellProof:
    """Verdicts of all cells of a grid.

    Attributes
    ----------
    verdict : ndarray of uint8, shape of the grid
        `CellVerdict` of every cell.
    bounds : int
        Number of evaluated bounds: pairs of convex pieces in boxes of joint values.
    probes : int
        Number of tests of convex pieces at single configurations, in search of collisions.
    tests : int
        Number of collision tests of exact solids.
    seconds : float
        Duration of the computation in seconds; blocks that a checkpoint contains take no time.
    """

    verdict: NDArray[np.uint8]
    bounds: int
    probes: int
    tests: int
    seconds: float

    @property
    def counts(self) -> dict[CellVerdict, int]:
        """Number of cells of every verdict."""
        found = np.bincount(self.verdict.reshape(-1), minlength=len(CellVerdict))
        return {verdict: int(found[verdict]) for verdict in CellVerdict}


def prove_cells(
    tree: KinematicTree,
    axes: Sequence[Axis],
    *,
    halvings: int = HALVINGS,
    executor: Executor | None = None,
    progress: Progress | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
) -> CellProof:
    """Find the cells in which no configuration collides, and cells with a collision; other cells stay undecided.

    Parameters
    ----------
    tree : KinematicTree
        Robot and surroundings, with the pairs of bodies that must not touch each other.
    axes : sequence of Axis
        One axis for every moving joint, in radians or metres.
    halvings : int, optional
        Largest number of successive halvings of a cell, per moving joint.  A larger number takes longer and decides
        more cells.
    executor : concurrent.futures.Executor, optional
        Workers of the blocks of cells; by default this process.  The result does not depend on the executor.
    progress : callable, optional
        Called after every block of cells as ``progress(done, total)`` with numbers of cells, summed over groups of
        pairs of bodies: the pairs that depend on the same joints share a grid of the values of these joints.
    checkpoint : path, optional
        File of finished blocks.  An interrupted run continues from it with the same result.

    Returns
    -------
    CellProof
        Verdict of every cell.  A free cell contains no configuration in which two bodies of a pair come closer than
        1e-5 m; this includes configurations that lie outside the cell by rounding errors only.

    Raises
    ------
    InputError
        If the number of axes is wrong, a half-space moves, or the checkpoint belongs to another run.
    ToolMissingError
        If coal is not installed.
    """
    begin = time.perf_counter()
    job = _ProofJob(tree, tuple(axes), halvings)
    groups = job.groups
    known = _Finished(checkpoint, tree, job.axes, halvings)
    total, done = sum(int(np.prod(group.shape)) for group in groups), 0
    verdict = np.zeros(tuple(axis.cells for axis in axes), dtype=np.uint8)
    work = np.zeros(3, dtype=np.int64)
    for number, group in enumerate(groups):
        seen = _seen_by_group(verdict, group)
        own = np.zeros_like(seen)
        blocks = list(_blocks(group.shape))
        items = [(number, low, seen[block].copy()) for low, block in blocks[known.count(number) :]]
        with closing(in_order([JobPart(_prove_blocks, job, items, "blocks")], executor)) as results:
            for index, (_, block) in enumerate(blocks):
                proof = known.take(number, index, seen[block].shape)
                if proof is None:
                    proof = next(results)
                    known.add(number, proof)
                own[block] = proof.verdict
                work += proof.bounds, proof.probes, proof.tests
                done += proof.verdict.size
                if progress is not None:
                    progress(done, total)
        verdict = _combined(verdict, own, group)
    bounds, probes, tests = work.tolist()
    return CellProof(verdict, bounds, probes, tests, time.perf_counter() - begin)


def centre_cells(tree: KinematicTree, axes: Sequence[Axis], progress: Progress | None = None) -> NDArray[np.bool_]:
    """Return the mask of cells whose centre collides, shape of the grid; nothing is proven about the rest of a cell.

    `tree`: robot and surroundings; `axes`: one axis for every moving joint; `progress`: called as ``progress(done,
    total)`` with numbers of cells, summed over groups of pairs of bodies: the pairs that depend on the same joints
    share a grid of the values of these joints.
    """
    checker = CollisionChecker(tree)
    groups = _groups(proof_arrays(tree), _checked_axes(tree, axes))
    verdict = np.zeros(tuple(axis.cells for axis in axes), dtype=np.uint8)
    total, done = sum(int(np.prod(group.shape)) for group in groups), 0
    for group in groups:
        own = _seen_by_group(verdict, group).reshape(-1)
        for start in range(0, len(own), CENTRES):
            cells = start + np.flatnonzero(own[start : start + CENTRES] != CellVerdict.COLLISION)
            values = np.tile(group.middle, (len(cells), 1))
            for joint, index in zip(group.joints, np.unravel_index(cells, group.shape), strict=True):
                values[:, joint] = axes[joint].centres[index]
            own[cells] = checker.first_pairs(values, group.pairs) >= 0
            done += len(own[start : start + CENTRES])
            if progress is not None:
                progress(done, total)
        verdict = _combined(verdict, own.reshape(group.shape), group)
    return np.asarray(verdict == CellVerdict.COLLISION)


def proof_key(tree: KinematicTree, axes: Sequence[Axis], halvings: int = HALVINGS) -> str:
    """Return a hash of everything on which the verdicts depend: robot, surroundings, axes and number of halvings."""
    digest = hashlib.sha256(repr((RULES, tuple(axes), halvings, tree.moving, tree.names)).encode())
    arrays = proof_arrays(tree)
    solids = [array for body in tree.bodies for array in _solid_arrays(body.solid)]
    for array in (*arrays.tree, arrays.hull, arrays.spans, tree.pairs, *solids):
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _solid_arrays(solid: Solid) -> tuple[NDArray[Any], ...]:
    """Return kind (as bytes), size, placement, points and triangles of an exact solid as arrays, to be hashed."""
    kind = np.frombuffer(solid.kind.encode(), dtype=np.uint8)
    return (
        kind,
        np.array(solid.size),
        np.asarray(solid.placement),
        np.asarray(solid.points),
        np.asarray(solid.triangles),
    )


class _ProofJob:
    """Inputs of the proofs of all blocks; the arrays of the kernels are computed once in every process.

    `tree`: robot and surroundings; `axes`: one axis for every moving joint; `halvings`: largest number of successive
    halvings of a cell, per moving joint.
    """

    def __init__(self, tree: KinematicTree, axes: tuple[Axis, ...], halvings: int) -> None:
        self.tree, self.axes, self.halvings = tree, _checked_axes(tree, axes), halvings
        self.arrays, self.checker = proof_arrays(tree), CollisionChecker(tree)
        self.groups = _groups(self.arrays, self.axes)
        self.margin = max(MARGIN, ROUNDING * _extent(self.arrays, self.axes))

    def __reduce__(self) -> tuple[Any, ...]:
        return _ProofJob, (self.tree, self.axes, self.halvings)


def _prove_blocks(job: _ProofJob, items: Sequence[tuple[int, Integers, NDArray[np.uint8]]]) -> list[BlockProof]:
    """Return the verdicts of some blocks of cells, in the order of `items`.

    `items`: for every block, the number of its group, the index of its first cell (g,) along the g joints of the group,
    and the verdicts that other groups give for its cells.
    """
    halvings = job.halvings * len(job.axes)
    return [
        BlockProver(job.arrays, job.checker, job.groups[number], halvings, job.margin).prove(low, known)
        for number, low, known in items
    ]


class _Finished:
    """Finished blocks of a checkpoint file.

    `path`: the file, None for no checkpoint (nothing is finished or stored); `tree`, `axes`, `halvings`: robot and
    surroundings, axes and number of halvings, which must be those of the run that wrote the file.
    """

    def __init__(
        self, path: str | os.PathLike[str] | None, tree: KinematicTree, axes: tuple[Axis, ...], halvings: int
    ) -> None:
        self._journal: Journal | None = None
        self._records: dict[int, list[dict[str, Any]]] = {}
        if path is not None:
            self._journal = Journal(path, {"resgrid": "cells", "fingerprint": proof_key(tree, axes, halvings)})
            for record in self._journal:
                self._records.setdefault(record["group"], []).append(record)

    def count(self, group: int) -> int:
        """Return the number of finished blocks of a group; `group`: number of the group."""
        return len(self._records.get(group, ()))

    def take(self, group: int, index: int, shape: tuple[int, ...]) -> BlockProof | None:
        """Return a finished block, None for a block that is not finished; raise InputError for a damaged file.

        `group`: number of the group; `index`: number of the block in the group; `shape`: number of the block's cells
        along every axis.
        """
        if index >= self.count(group):
            return None
        record = self._records[group][index]
        cells = np.frombuffer(record["verdict"].encode("ascii"), dtype=np.uint8) - ord("0")
        if cells.size != np.prod(shape) or cells.max(initial=0) > max(CellVerdict):
            assert self._journal is not None
            raise self._journal.damaged(f"block {index} of group {group} does not fit the grid")
        return BlockProof(cells.reshape(shape), *record["work"])

    def add(self, group: int, proof: BlockProof) -> None:
        """Append the next finished block of a group to the checkpoint; `group`: number of the group."""
        if self._journal is not None:
            cells = (proof.verdict.reshape(-1) + np.uint8(ord("0"))).tobytes().decode("ascii")
            self._journal.append({"group": group, "verdict": cells, "work": [proof.bounds, proof.probes, proof.tests]})


def _checked_axes(tree: KinematicTree, axes: Sequence[Axis]) -> tuple[Axis, ...]:
    """Return the axes; raise InputError unless there is one for every moving joint."""
    if len(axes) != len(tree.moving):
        raise InputError(
            f"this robot has {len(tree.moving)} moving joints ({', '.join(tree.moving)}), got {len(axes)} axes; give "
            "one axis for every joint"
        )
    return tuple(axes)


def _seen_by_group(verdict: NDArray[np.uint8], group: Group) -> NDArray[np.uint8]:
    """Return the verdicts that hold for all cells along the axes of the joints outside a group, by cell of its grid.

    The result is a collision if all these cells have one, undecided if none is free, otherwise free. `verdict`: the
    verdicts so far, shape of the whole grid.
    """
    others = tuple(axis for axis in range(verdict.ndim) if axis not in group.joints)
    seen = np.zeros(group.shape, dtype=np.uint8)
    seen[(verdict != CellVerdict.FREE).all(axis=others)] = CellVerdict.UNDECIDED
    seen[(verdict == CellVerdict.COLLISION).all(axis=others)] = CellVerdict.COLLISION
    return seen


def _combined(verdict: NDArray[np.uint8], own: NDArray[np.uint8], group: Group) -> NDArray[np.uint8]:
    """Return the verdicts of the whole grid after the verdicts of a group are added to them.

    A collision prevails over undecided, undecided over free. `verdict`: the verdicts so far, shape of the whole grid;
    `own`: verdicts of the group, shape of its grid, which hold for all values of the other joints.
    """
    wide = own.reshape([cells if axis in group.joints else 1 for axis, cells in enumerate(verdict.shape)])
    collides = (verdict == CellVerdict.COLLISION) | (wide == CellVerdict.COLLISION)
    return np.where(collides, np.uint8(CellVerdict.COLLISION), np.maximum(verdict, wide))


def _blocks(shape: tuple[int, ...]) -> Iterator[tuple[Integers, tuple[slice, ...]]]:
    """Yield the index of the first cell (g,) and the slices of every block of a grid, in C order.

    The blocks are nearly equal parts of every axis, of at most `BLOCK` cells. `shape`: cells along the g axes.
    """
    cuts = [np.linspace(0, cells, -(-cells // BLOCK) + 1).round().astype(np.int64) for cells in shape]
    for block in product(*(pairwise(cut.tolist()) for cut in cuts)):
        yield np.array([low for low, _ in block], dtype=np.int64), tuple(slice(low, high) for low, high in block)


def _groups(arrays: ProofArrays, axes: tuple[Axis, ...]) -> list[Group]:
    """Return the pairs grouped by the joints on which they depend, groups of few joints first.

    Pairs that depend on no joint are tested on the grid of the first joint.
    """
    excess = rounding(axes) * [axis.spacing for axis in axes]
    middle = np.array([(axis.lower + axis.upper) / 2 for axis in axes])
    kinds: dict[tuple[int, ...], list[int]] = {}
    for pair, joints in enumerate(arrays.drivers):
        kinds.setdefault(joints or (0,), []).append(pair)
    return [
        Group(
            joints,
            np.array(pairs, dtype=np.int64),
            tuple(axes[joint].edges for joint in joints),
            middle,
            np.where(np.isin(np.arange(len(axes)), joints), excess, 0.0),
        )
        for joints, pairs in sorted(kinds.items(), key=lambda kind: (len(kind[0]), kind[0]))
    ]


def _extent(arrays: ProofArrays, axes: tuple[Axis, ...]) -> float:
    """Return a bound on the magnitudes of the coordinates of all points of the bodies, in metres.

    The bound is the sum of all distances between joints, of the largest translation of every prismatic joint, of the
    largest 1-norm of a point in its link's frame, and of the largest radius.
    """
    tree, largest = arrays.tree, np.array([max(abs(axis.lower), abs(axis.upper)) for axis in axes])
    slides = np.abs(tree.factor) * largest[tree.driver] + np.abs(tree.offset)
    points = np.abs(np.stack([tree.x, tree.y, tree.z])).sum(axis=0).max(initial=0.0)
    return float(np.abs(tree.translation).sum() + slides[tree.prismatic].sum() + points + tree.radius.max(initial=0.0))
