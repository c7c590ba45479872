"""The next board of a board: blocks of two cells along every axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.multigrid import block_kernels
from resgrid.solvers.multigrid.boards import WEAK, Level, frame, level_of
from resgrid.solvers.multigrid.lattice import Lattice


@dataclass(frozen=True, eq=False)
class Coarsened:
    """A level and the way to it.

    `target` (places,): place there, red ones first, of the aggregate that every black place before belongs to; 0 for
    unused places; `whole_target` (2, places): the same of both colours; empty, as what follows, where it was not
    asked for; `stretch` (2 ndim, places): what length has left of the conductance across every face; `link_stretch`
    (links,): the same of every link.
    """

    level: Level
    target: NDArray[np.int32]
    whole_target: NDArray[np.int32]
    stretch: NDArray[np.float32]
    link_stretch: NDArray[np.float32]


def coarsen(level: Level, *, split: bool, keep: bool = False) -> Coarsened | None:
    """Make the next level: blocks of two cells along every axis but those that conduct badly.

    A block that falls apart, without its weak conductances, keeps one part on the grid; the others become extra nodes
    beside it, reached by links.
    """
    shift = (level.mean > WEAK * level.mean.max()).astype(np.int64)
    lattice = Lattice(tuple((n - 1 >> s) + 1 for n, s in zip(level.lattice.shape, shift.tolist(), strict=True)))
    target = _blocks(level, lattice, shift)
    home = _split(level, lattice, target, WEAK if split else 0.0)
    before, colour = lattice.places, (home >= lattice.places).astype(np.int64)
    if len(home):
        most = int(np.bincount(colour).max())
        lattice = Lattice(lattice.shape, most)
        rank = np.where(colour == 0, np.cumsum(colour == 0), np.cumsum(colour == 1)) - 1
        number = (colour * lattice.places + lattice.first_extra + rank).astype(np.int32)
        block_kernels.renumber(target, before, number, lattice.places - before)
    cells = [lattice.cells_at(c, home[colour == c] - c * before) for c in range(2)]
    red, black = (np.ravel_multi_index(cell, lattice.shape).astype(np.int64) for cell in cells)
    return _summed(level, lattice, target, (red, black), keep)


def _blocks(level: Level, lattice: Lattice, shift: NDArray[np.int64]) -> NDArray[np.int32]:
    """The place on the next lattice, red ones first, that every place's block takes."""
    fine = level.lattice
    index = np.ix_(*(np.arange(n) >> s for n, s in zip((*fine.shape[:-1], 1), shift.tolist(), strict=True)))
    target = np.zeros(level.degree.shape, dtype=np.int32)
    block_kernels.block_of_places(
        level.degree > 0.0, fine.rows, fine.shape[-1], fine.margin, int(shift[-1]), lattice.number(index).ravel(),
        lattice.margin, lattice.places, target,
    )  # fmt: skip
    for colour, cell in enumerate(level.extra_cell):
        block = [index >> s for index, s in zip(np.unravel_index(cell, fine.shape), shift.tolist(), strict=True)]
        target[colour, fine.first_extra : fine.first_extra + len(cell)] = lattice.place(lattice.number(block))
    return target


def _split(level: Level, lattice: Lattice, target: NDArray[np.int32], weak: float) -> NDArray[np.int64]:
    """Number the parts of blocks that fall apart, in place; returns the block that every extra node comes from."""
    graph = (level.faces, *frame(level.lattice), level.ends[0], level.ends[1], level.links)
    strongest = np.zeros(level.degree.shape if weak else (2, 1), dtype=np.float32)
    if weak:
        block_kernels.strongest_at(*graph, strongest)
    members, inner = np.zeros((2, 2 * lattice.places), dtype=np.int32)
    block_kernels.count_inside(*graph[:3], target, weak, strongest, members, inner)
    # A part of a hypercube with n corners has at most as many edges as there are ones in the numbers below n.
    most = np.cumsum([0, 0, *(k.bit_count() for k in range(1, 64))])
    doubtful = (members > 1) & (inner <= most[np.clip(members - 1, 0, 63)])
    for colour, cell in enumerate(level.extra_cell):
        first = level.lattice.first_extra
        doubtful[target[colour, first : first + len(cell)]] = True
    doubtful[0] = False
    if not doubtful.any():
        return np.empty(0, dtype=np.int64)
    parent = np.arange(target.size, dtype=np.int32)
    block_kernels.join_inside(*graph, target, weak, strongest, doubtful, parent)
    home = np.empty(int(members[doubtful].sum()), dtype=np.int64)
    return home[: block_kernels.split_blocks(doubtful, parent, target, lattice.places, home)]


def _summed(
    level: Level,
    lattice: Lattice,
    target: NDArray[np.int32],
    extra_cell: tuple[NDArray[np.int64], NDArray[np.int64]],
    keep: bool,
) -> Coarsened | None:
    summed = sum_up(level, lattice, target, sum(len(cell) for cell in extra_cell))
    if summed is None:
        return None
    faces, leak, inner, ends, axis, links = summed
    before = (faces.copy(), links.copy()) if keep else (np.empty((0, 0)), np.empty(0))
    block_kernels.lengthen_faces(faces, leak, *frame(lattice), ends[0], ends[1], axis, links, inner)
    left = [_share_left(old, new) for old, new in zip(before, (faces, links), strict=True)]
    coarse = level_of(lattice, faces, leak, ends, axis, links, extra_cell)
    return Coarsened(coarse, target[1].copy(), target if keep else np.empty((2, 0), dtype=np.int32), *left)


def _share_left(before: NDArray[np.float64], after: NDArray[np.float64]) -> NDArray[np.float32]:
    left = np.ones(before.shape, dtype=np.float32)
    if before.size:
        np.divide(after, before, out=left, where=before > 0.0, casting="same_kind")
    return left


Summed = tuple[
    NDArray[np.float64], NDArray[np.float64], NDArray[np.float32], NDArray[np.int32], NDArray[np.int32],
    NDArray[np.float64],
]  # fmt: skip
"""Faces, leaks, what lies inside blocks, and the ends, axes and conductances of links."""


def sum_up(level: Level, lattice: Lattice, target: NDArray[np.int32], extras: int) -> Summed | None:
    """Sum the conductances between blocks, which have ``extras`` nodes beside the lattice.

    None if parts of one block are joined by weak conductances: they have one colour.
    """
    sides = len(level.faces)
    room = len(level.links) + extras * sides * 2 ** (sides // 2)
    faces, leak = np.zeros((sides, lattice.places)), np.zeros((2, lattice.places))
    inner = np.zeros((sides // 2, 2 * lattice.places), dtype=np.float32)
    ends, axis, links = np.empty((2, room), dtype=np.int32), np.empty(room, dtype=np.int32), np.empty(room)
    count = block_kernels.sum_blocks(
        level.faces, level.leak, *frame(level.lattice), level.ends[0], level.ends[1], level.axis, level.links,
        target, lattice.places, lattice.first_extra, faces, leak.ravel(), inner, ends, axis, links,
    )  # fmt: skip
    if count < 0:
        return None
    return faces, leak, inner, *_united(ends[:, :count], axis[:count], links[:count])


def _united(
    ends: NDArray[np.int32], axis: NDArray[np.int32], links: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
    """Links by red places, those between the same two nodes summed."""
    order = np.lexsort((ends[1], ends[0]))
    ends, axis, links = ends[:, order], axis[order], links[order]
    new = np.any(np.diff(ends, axis=1, prepend=np.full((2, 1), -1, dtype=np.int32)) != 0, axis=0)
    first = np.flatnonzero(new)
    summed = np.add.reduceat(links, first) if len(first) else links
    return np.ascontiguousarray(ends[:, first]), axis[first], summed
