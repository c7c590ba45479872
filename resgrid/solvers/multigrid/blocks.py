"""The next level of a grid: blocks of two cells along every axis, split into their connected parts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.multigrid.block_kernels import (
    block_of_slots,
    count_inside,
    join_inside,
    lengthen,
    renumber,
    split_blocks,
    strongest_at,
    sum_blocks,
)
from resgrid.solvers.multigrid.grid_level import WEAK, Level, level_of
from resgrid.solvers.multigrid.lattice import Lattice
from resgrid.solvers.multigrid.red_black import Edges
from resgrid.solvers.team import ALONE, Team, pieces

_STRETCH = 2**16
"""Slots of a colour that one thread coarsens at a time, about."""


@dataclass(frozen=True, eq=False)
class Coarsened:
    """A level and the way to it.

    `target` (slots,): slot there, red ones first, of the aggregate that every black slot before belongs to; 0 for
    unused slots; `whole_target` (2, slots): the same of both colours; empty, as what follows, where it was not
    asked for; `stretch` (2 ndim, slots): what length has left of the conductance across every face; `off_stretch`
    (couplings,): the same of every coupling.
    """

    level: Level
    target: NDArray[np.int32]
    whole_target: NDArray[np.int32]
    stretch: NDArray[np.float32]
    off_stretch: NDArray[np.float32]


def coarsen(level: Level, *, split: bool, keep: bool = False, team: Team = ALONE) -> Coarsened | None:
    """Make the next level: blocks of two cells along every axis but those that conduct badly.

    A block that falls apart, without its weak conductances, keeps one part on the grid; the others become extra nodes
    beside it, reached by couplings.
    """
    shift = (level.mean > WEAK * level.mean.max()).astype(np.int64)
    lattice = Lattice(tuple((n - 1 >> s) + 1 for n, s in zip(level.lattice.shape, shift.tolist(), strict=True)))
    target = _blocks(level, lattice, shift, team)
    home = _split(level, lattice, target, WEAK if split else 0.0, team)
    before, colour = lattice.slots, (home >= lattice.slots).astype(np.int64)
    if len(home):
        most = int(np.bincount(colour).max())
        lattice = Lattice(lattice.shape, most)
        rank = np.where(colour == 0, np.cumsum(colour == 0), np.cumsum(colour == 1)) - 1
        number = (colour * lattice.slots + lattice.first_extra + rank).astype(np.int32)
        renumber(target, before, number, lattice.slots - before)
    cells = [lattice.cells_at(c, home[colour == c] - c * before) for c in range(2)]
    red, black = (np.ravel_multi_index(cell, lattice.shape).astype(np.int64) for cell in cells)
    return _summed(level, lattice, target, (red, black), keep, team)


def _blocks(level: Level, lattice: Lattice, shift: NDArray[np.int64], team: Team) -> NDArray[np.int32]:
    """The slot on the next lattice, red ones first, that every slot's block takes."""
    fine = level.lattice
    index = np.ix_(*(np.arange(n) >> s for n, s in zip((*fine.shape[:-1], 1), shift.tolist(), strict=True)))
    target = np.zeros(level.degree.shape, dtype=np.int32)
    rows, blocks = fine.rows, lattice.number(index).ravel()

    def some_rows(cells: slice) -> None:
        some = slice(cells.start // fine.shape[-1], cells.stop // fine.shape[-1])
        block_of_slots(
            level.degree, rows[some], fine.shape[-1], fine.margin, int(shift[-1]), blocks[some], lattice.margin,
            lattice.slots, target,
        )  # fmt: skip

    team.over(len(rows) * fine.shape[-1], some_rows)
    for colour, cell in enumerate(level.extra_cell):
        block = [index >> s for index, s in zip(np.unravel_index(cell, fine.shape), shift.tolist(), strict=True)]
        target[colour, fine.first_extra : fine.first_extra + len(cell)] = lattice.slot(lattice.number(block))
    return target


def _split(level: Level, lattice: Lattice, target: NDArray[np.int32], weak: float, team: Team) -> NDArray[np.int64]:
    """Number the parts of blocks that fall apart, in place; returns the block that every extra node comes from."""
    edges = level.edges
    strongest = np.zeros(level.degree.shape if weak else (2, 1), dtype=np.float32)
    if weak:
        strongest_at(edges, strongest)
    members, inner = np.zeros((2, 2 * lattice.slots), dtype=np.int32)
    within, beside = _stretches(level)
    team.together([partial(count_inside, edges, target, weak, strongest, *some, members, inner) for some in within])
    count_inside(edges, target, weak, strongest, *beside, members, inner)
    members[0] = 0
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
    join_inside(edges, target, weak, strongest, doubtful, parent)
    home = np.empty(int(members[doubtful].sum()), dtype=np.int64)
    return home[: split_blocks(doubtful, parent, target, lattice.slots, home)]


def _summed(
    level: Level,
    lattice: Lattice,
    target: NDArray[np.int32],
    extra_cell: tuple[NDArray[np.int64], NDArray[np.int64]],
    keep: bool,
    team: Team,
) -> Coarsened | None:
    summed = sum_up(level, lattice, target, sum(len(cell) for cell in extra_cell), team)
    if summed is None:
        return None
    edges, leak, inner = summed
    before = (edges.faces.copy(), edges.couplings.copy()) if keep else (np.empty((0, 0)), np.empty(0))
    inside = pieces(lattice.margin, lattice.slots - lattice.margin)
    team.together([partial(lengthen, edges, leak, inner, some.start, some.stop) for some in inside])
    off = _in_series(edges.couplings, inner[edges.off_axis, edges.off_red], 0.5)
    off = _in_series(off, inner[edges.off_axis, lattice.slots + edges.off_black], 0.5)
    edges = edges._replace(couplings=off)
    left = [_share_left(old, new) for old, new in zip(before, (edges.faces, edges.couplings), strict=True)]
    coarse = level_of(lattice, edges, leak, extra_cell, team)
    return Coarsened(coarse, target[1].copy(), target if keep else np.empty((2, 0), dtype=np.int32), *left)


def _in_series(conductance: NDArray[np.float64], inner: NDArray[np.float32], share: float) -> NDArray[np.float64]:
    """Conductances in series with a share of what lies inside blocks, where there is some."""
    own = inner.astype(np.float64)
    return np.divide(own * conductance, own + share * conductance, out=conductance.copy(), where=own > 0.0)


def _share_left(before: NDArray[np.float64], after: NDArray[np.float64]) -> NDArray[np.float32]:
    left = np.ones(before.shape, dtype=np.float32)
    if before.size:
        np.divide(after, before, out=left, where=before > 0.0, casting="same_kind")
    return left


def _stretches(level: Level) -> tuple[list[tuple[int, int]], tuple[int, int]]:
    """Ranges of slots of both colours that share no block, and the range of nodes beside the lattice.

    They begin at every so many rows along the first axis, an even number, as blocks do: the same for any number of
    threads.
    """
    fine = level.lattice
    rows = max(_STRETCH // fine.strides[0], 1) * 2
    begins = [fine.margin + row * fine.strides[0] // 2 for row in range(0, fine.shape[0], rows)]
    return list(zip(begins, [*begins[1:], fine.first_extra], strict=True)), (fine.first_extra, fine.slots - fine.margin)


def sum_up(
    level: Level, lattice: Lattice, target: NDArray[np.int32], extras: int, team: Team = ALONE
) -> tuple[Edges, NDArray[np.float64], NDArray[np.float32]] | None:
    """Sum the conductances between blocks, which have ``extras`` nodes beside the lattice.

    Returns the sums, leaks (2, slots), and what lies inside blocks along every axis, shape (ndim, 2 slots); None if
    parts of one block are joined by weak conductances: they have one colour.
    """
    sides = len(level.edges.faces)
    room = len(level.edges.couplings) + extras * sides * 2 ** (sides // 2)
    leak, inner = np.zeros((2, lattice.slots)), np.zeros((sides // 2, 2 * lattice.slots), dtype=np.float32)
    faces, distance, margin = np.zeros((sides, lattice.slots)), lattice.distance, lattice.margin
    within, beside = _stretches(level)

    def summed(edges: Edges, *ranges: tuple[int, int, int, int]) -> tuple[NDArray[Any], ...] | None:
        red, black, axis = np.empty((3, room), dtype=np.int32)
        coarse = Edges(faces, distance, margin, red, black, axis, np.empty(room))
        first, some = lattice.first_extra, np.array(ranges)
        count = sum_blocks(edges, level.leak, target, first, some, coarse, leak.ravel(), inner)
        return None if count < 0 else tuple(part[:count].copy() for part in coarse[3:])

    uncoupled, reach = level.edges._replace(couplings=np.empty(0)), level.lattice.margin
    across = [
        ranges
        for border, _ in within[1:]
        for ranges in (
            (border - reach, border, border, border + reach),
            (border, border + reach, border - reach, border),
        )
    ]
    met = team.together([partial(summed, uncoupled, (*some, *some)) for some in within])
    met.append(summed(level.edges, *across, (*beside, *beside)))
    off = [some for some in met if some is not None]
    if len(off) < len(met):
        return None
    return Edges(faces, distance, margin, *_united(*map(np.concatenate, zip(*off, strict=True)))), leak, inner


def _united(
    red: NDArray[np.int32], black: NDArray[np.int32], axis: NDArray[np.int32], couplings: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
    """Couplings by red slots, those between the same two nodes summed."""
    order = np.lexsort((black, red))
    red, black, axis, couplings = red[order], black[order], axis[order], couplings[order]
    first = np.flatnonzero((np.diff(red, prepend=-1) != 0) | (np.diff(black, prepend=-1) != 0))
    summed = np.add.reduceat(couplings, first) if len(first) else couplings
    return red[first], black[first], axis[first], summed
