"""Proofs that cells of a robot's configuration space are free of collisions.

The pairs of bodies are grouped by the joints that change their relative pose.  Every group has the grid of its joints
alone; the verdicts of all groups are broadcast to the whole grid and combined.  A group's grid is divided into blocks,
which any executor can process in any order with the same result.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.parallel import spread
from resgrid._internal.values import frozen
from resgrid.core.axis import Axis, rounding
from resgrid.errors import InputError
from resgrid.robots.cells import Progress
from resgrid.robots.urdf.arrays import Integers, ProofArrays, proof_arrays
from resgrid.robots.urdf.cell_blocks import BlockProof, BlockProver, Group
from resgrid.robots.urdf.collision import CollisionChecker
from resgrid.robots.urdf.tree import KinematicTree

BLOCK = 8
"""Largest number of cells of a block along an axis."""

HALVINGS = 9
"""Number of times that a cell of three joints is halved."""


class CellVerdict(IntEnum):
    """Verdict of a cell of a configuration space."""

    FREE = 0
    """Proven: no configuration of the cell collides."""

    COLLISION = 1
    """A configuration of the cell collides."""

    UNDECIDED = 2
    """Neither a proof nor a collision was found."""


@frozen
@dataclass(frozen=True, eq=False)
class CellProof:
    """Verdicts of all cells of a grid.

    Attributes
    ----------
    verdict : ndarray of uint8, shape of the grid
        `CellVerdict` of every cell.
    bounds : int
        Number of evaluated bounds.
    tests : int
        Number of collision tests of exact solids.
    seconds : float
        Duration in seconds.
    """

    verdict: NDArray[np.uint8]
    bounds: int
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
) -> CellProof:
    """Find the cells in which no configuration collides, and cells with a collision."""
    begin = time.perf_counter()
    if len(axes) != len(tree.moving):
        raise InputError(f"the robot has {len(tree.moving)} moving joints, but there are {len(axes)} axes")
    shape = tuple(axis.cells for axis in axes)
    verdict = np.zeros(shape, dtype=np.uint8)
    arrays = proof_arrays(tree)
    groups = _groups(arrays, tuple(axes), halvings)
    total = sum(int(np.prod([len(edges) - 1 for edges in group.edges])) for group in groups)
    done = bounds = tests = 0
    for number, group in enumerate(groups):
        seen = _seen_by_group(verdict, group)
        own = np.zeros(seen.shape, dtype=np.uint8)
        blocks = list(_blocks(seen.shape))
        items = [(number, low, high, seen[_slices(low, high)].copy()) for low, high in blocks]
        with closing(spread(_prove_block, items, tree, tuple(axes), halvings, executor=executor)) as results:
            for (low, high), result in zip(blocks, results, strict=True):
                own[_slices(low, high)] = result.verdict
                bounds, tests = bounds + result.bounds, tests + result.tests
                done += result.verdict.size
                if progress is not None:
                    progress(done, total)
        wide = own.reshape([shape[axis] if axis in group.joints else 1 for axis in range(len(shape))])
        hit = (verdict == CellVerdict.COLLISION) | (wide == CellVerdict.COLLISION)
        verdict = np.where(hit, np.uint8(CellVerdict.COLLISION), np.maximum(verdict, wide))
    return CellProof(verdict, bounds, tests, time.perf_counter() - begin)


def _seen_by_group(verdict: NDArray[np.uint8], group: Group) -> NDArray[np.uint8]:
    """Return the verdicts that hold for all cells along the axes of the other joints, shape of the group's grid."""
    others = tuple(axis for axis in range(verdict.ndim) if axis not in group.joints)
    collides = (verdict == CellVerdict.COLLISION).all(axis=others)
    blocked = (verdict != CellVerdict.FREE).all(axis=others)
    return np.where(collides, np.uint8(1), np.where(blocked, np.uint8(2), np.uint8(0)))


def _blocks(shape: tuple[int, ...]) -> Iterator[tuple[Integers, Integers]]:
    """Return first cells, and last cells plus 1, of the blocks of a grid, nearly equal parts along every axis."""
    cuts = [np.linspace(0, cells, -(-cells // BLOCK) + 1).round().astype(np.int64) for cells in shape]
    for block in product(*(range(len(cut) - 1) for cut in cuts)):
        low = np.array([cut[i] for cut, i in zip(cuts, block, strict=True)])
        high = np.array([cut[i + 1] for cut, i in zip(cuts, block, strict=True)])
        yield low, high


def _slices(low: Integers, high: Integers) -> tuple[slice, ...]:
    """Return the index of a block of cells in the array of a grid."""
    return tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))


def _groups(arrays: ProofArrays, axes: tuple[Axis, ...], halvings: int) -> list[Group]:
    """Return the pairs grouped by the joints on which they depend, groups of few joints first."""
    excess = rounding(axes) * [axis.spacing for axis in axes]
    middle = np.array([(axis.lower + axis.upper) / 2 for axis in axes])
    kinds: dict[tuple[int, ...], list[int]] = {}
    for pair, joints in enumerate(arrays.drivers):
        kinds.setdefault(joints, []).append(pair)
    return [
        Group(
            joints,
            np.array(pairs, dtype=np.int64),
            tuple(axes[joint].edges for joint in joints),
            middle,
            np.where(np.isin(np.arange(len(axes)), joints), excess, 0.0),
            halvings,
        )
        for joints, pairs in sorted(kinds.items(), key=lambda kind: (len(kind[0]), kind[0]))
        if joints
    ]


def _prove_block(
    item: tuple[int, Integers, Integers, NDArray[np.uint8]], tree: KinematicTree, axes: tuple[Axis, ...], halvings: int
) -> BlockProof:
    """Return the verdicts of one block; `item`: number of the group, first and last cells, known verdicts."""
    number, low, high, known = item
    prover, groups = _prover(tree, axes, halvings)
    return prover.prove(groups[number], low, high, known)


@lru_cache(maxsize=2)
def _prover(tree: KinematicTree, axes: tuple[Axis, ...], halvings: int) -> tuple[BlockProver, list[Group]]:
    """Return the prover of a robot and its groups, made once per process."""
    arrays = proof_arrays(tree)
    return BlockProver(arrays, CollisionChecker(tree)), _groups(arrays, axes, halvings)
