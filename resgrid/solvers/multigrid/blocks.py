"""The next level of a grid: blocks of two cells along every axis, split into their connected parts."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import ZERO, inner, kernel, makes_arrays
from resgrid.solvers.multigrid.grid_level import WEAK, Level, level_of
from resgrid.solvers.multigrid.red_black import Edges, Floats, Indices, Integers, Lattice, Singles, slot_of
from resgrid.solvers.row_kernels import find, join
from resgrid.solvers.team import ALONE, Team

_STRETCH = 2**16
"""Slots of a colour that one thread coarsens at a time, about."""


def coarsen(level: Level, *, split: bool, team: Team = ALONE) -> tuple[Level, NDArray[np.int32]] | None:
    """Make the next level: blocks of two cells along every axis but those that conduct badly.

    Returns the slot there of every slot's aggregate too, red ones first, shape (2, slots); 0 for unused slots.

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
        extra = target >= 2 * before
        target[(target >= before) & ~extra] += lattice.slots - before
        target[extra] = number[target[extra] - 2 * before]
    cells = [lattice.cells_at(c, home[colour == c] - c * before) for c in range(2)]
    red, black = (np.ravel_multi_index(cell, lattice.shape).astype(np.int64) for cell in cells)
    summed = sum_up(level, lattice, target, len(home), team)
    if summed is None:
        return None
    edges, leak = _lengthened(*summed, team)
    return level_of(lattice, edges, leak, (red, black), team), target


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
    strongest = _strongest(edges) if weak else np.zeros((2, 1), dtype=np.float32)
    members, inner = np.zeros((2, 2 * lattice.slots), dtype=np.int32)
    within, beside = _stretches(level)
    count = partial(count_inside, edges.faces, edges.distance, target, weak, strongest)
    team.together([partial(count, *some, members, inner) for some in within])
    count(*beside, members, inner)
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


def _strongest(edges: Edges) -> NDArray[np.float32]:
    """Strongest conductance at every slot of both colours, shape (2, slots)."""
    strongest = np.zeros((2, edges.faces.shape[1]), dtype=np.float32)
    inside = slice(edges.margin, edges.faces.shape[1] - edges.margin)
    for face, away in zip(edges.faces[:, inside].astype(np.float32), edges.distance.tolist(), strict=True):
        there = slice(inside.start + away, inside.stop + away)
        for of, at in ((strongest[0], inside), (strongest[1], there)):
            np.maximum(of[at], face, out=of[at])
    for of, slot in zip(strongest, (edges.off_red, edges.off_black), strict=True):
        np.maximum.at(of, slot, edges.couplings.astype(np.float32))
    return strongest


def _lengthened(
    edges: Edges, leak: NDArray[np.float64], inner: NDArray[np.float32], team: Team
) -> tuple[Edges, NDArray[np.float64]]:
    """Conductances and leaks of a coarse grid that know length; takes over the faces.

    From the middle of one block to the middle of the next lies half of either block's own resistance, in series with
    what joins the two; a rail is reached through 0.15 times the block's.
    """
    slots = leak.shape[1]
    here = slice(edges.margin, slots - edges.margin)

    def lengthen(q: int) -> None:
        there = slice(slots + here.start + int(edges.distance[q]), slots + here.stop + int(edges.distance[q]))
        half = _in_series(edges.faces[q, here], inner[q >> 1, here], 0.5)
        edges.faces[q, here] = _in_series(half, inner[q >> 1, there], 0.5)

    team.together([partial(lengthen, q) for q in range(len(edges.faces))])
    off = _in_series(edges.couplings, inner[edges.off_axis, edges.off_red], 0.5)
    off = _in_series(off, inner[edges.off_axis, slots + edges.off_black], 0.5)
    return edges._replace(couplings=off), _in_series(leak, inner.max(axis=0).reshape(2, slots), 0.15)


def _in_series(conductance: NDArray[np.float64], inner: NDArray[np.float32], share: float) -> NDArray[np.float64]:
    """Conductances in series with a share of what lies inside blocks, where there is some."""
    own = inner.astype(np.float64)
    return np.divide(own * conductance, own + share * conductance, out=conductance.copy(), where=own > 0.0)


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


@kernel
def block_of_slots(
    degree: Floats, rows: Integers, columns: int, margin: int, shift: int, coarse_rows: Integers, coarse_margin: int,
    coarse_slots: int, block: Indices,
) -> None:  # fmt: skip
    """Which slot of the next stencil, red ones first, the block around every slot takes; left alone where nothing is.

    ``rows`` are the numbers of the first cells of all rows, ``coarse_rows`` those of the blocks that these are in.
    """
    for line in range(len(rows)):
        for column in range(columns):
            number = rows[line] + column
            colour, here = number & 1, margin + (number >> 1)
            if degree[colour, here] > 0.0:
                number = coarse_rows[line] + (column >> shift)
                block[colour, here] = slot_of(number, coarse_margin, coarse_slots)


@inner
def _joins(g: float, weak: float, strongest: Singles, red: int, black: int | np.uint64) -> bool:
    return weak == 0.0 or g >= weak * max(strongest[0, red], strongest[1, black])


@kernel
def count_inside(
    faces: Floats, distance: Integers, block: Indices, weak: float, strongest: Singles, begin: int, end: int,
    members: Indices, inner: Indices,
) -> None:  # fmt: skip
    """Count the members of the blocks at some slots, and the faces inside that conduct and are not weak.

    Couplings do not count: those that close a ring of two cells join what a face joins already.
    """
    red_block, black_block = block[0], block[1]
    for k in range(begin, end):
        at = np.uint64(k)
        own, joined = np.uint64(red_block[at]), 0
        members[own] += 1
        members[np.uint64(black_block[at])] += 1
        for q in range(len(distance)):
            black = np.uint64(k + distance[q])
            g, same = faces[np.uint64(q), at], own == np.uint64(black_block[black])
            joined += same and g > 0.0 and _joins(g, weak, strongest, k, black)
        inner[own] += joined


@kernel
def join_inside(
    edges: Edges, block: Indices, weak: float, strongest: Singles, doubtful: NDArray[np.bool_], parent: Indices
) -> None:
    """Join the members of doubtful blocks by the resistors inside that are not weak (union-find over both colours)."""
    faces, distance, margin, off_red, off_black, _, couplings = edges
    slots = faces.shape[1]
    for k in range(margin, faces.shape[1] - margin):
        if not doubtful[block[0, k]]:
            continue
        for q in range(len(distance)):
            g = faces[q, k]
            if g > 0.0:
                black = k + distance[q]
                if block[0, k] == block[1, black] and _joins(g, weak, strongest, k, black):
                    join(parent, k, slots + black)
    for k in range(len(couplings)):
        red, black = off_red[k], off_black[k]
        if block[0, red] == block[1, black] and _joins(couplings[k], weak, strongest, red, black):
            join(parent, red, slots + black)


@kernel
@makes_arrays
def split_blocks(
    doubtful: NDArray[np.bool_], parent: Indices, block: Indices, coarse_slots: int, extra_block: Integers
) -> int:
    """Let the first part of a split block keep its slot, and number the others as extra nodes, in place.

    Extra nodes are numbered from ``2 coarse_slots`` on, and ``extra_block`` notes the block each comes from.
    """
    flat = block.ravel()
    taken = np.zeros(len(doubtful), np.bool_)
    of_root = np.zeros(len(flat), np.int32)
    count = 0
    for node in range(len(flat)):
        home = flat[node]
        if home == 0 or not doubtful[home]:
            continue
        root = find(parent, node)
        if root == node:
            if taken[home]:
                of_root[node] = 2 * coarse_slots + count
                extra_block[count] = home
                count += 1
            else:
                taken[home] = True
                of_root[node] = home
        flat[node] = of_root[root]
    return count


@kernel
def sum_blocks(
    edges: Edges, leak: Floats, target: Indices, first_extra: int, ranges: Integers, coarse: Edges, coarse_leak: Floats,
    inner: Singles,
) -> int:  # fmt: skip
    """Sum the conductances between aggregates into the faces and couplings of the next grid, leaks into its leaks.

    ``ranges`` (n, 4): of red slots, and of the black slots to which the faces in question lead; the leaks are those of
    the slots that are in both.  ``inner`` of shape (ndim, 2 slots) receives what lies inside aggregates along every
    axis.  Returns the number of new couplings, or -1 if a resistor joins two parts of one colour.
    """
    faces, distance = edges.faces, edges.distance
    sums, coarse_slots = coarse.faces, coarse.faces.shape[1]
    count, red_target, black_target = ZERO, target[0], target[1]
    for n in range(len(ranges)):
        first, last, low, high = ranges[n, 0], ranges[n, 1], ranges[n, 2], ranges[n, 3]
        for k in range(first, last):
            at = np.uint64(k)
            if low <= k < high:
                for colour in range(2):
                    if leak[colour, at] != 0.0:
                        coarse_leak[np.uint64(target[colour, at])] += leak[colour, at]
            a = np.int64(red_target[at])
            for q in range(len(distance)):
                g, there = faces[np.uint64(q), at], k + distance[q]
                if g == 0.0 or there < low or there >= high:
                    continue
                b = np.int64(black_target[np.uint64(there)])
                axis = np.int64(q >> 1)
                if a == b:
                    inner[np.uint64(axis), np.uint64(a)] += g
                    continue
                red, black = min(a, b), max(a, b) - coarse_slots
                if red >= coarse_slots or black < 0:
                    return -1
                if red >= first_extra or black >= first_extra:
                    _note(coarse, count, red, black, axis, g)
                    count += 1
                    continue
                # Where the red cell's block is black, the same face is the opposite one of the red block.
                sums[np.uint64(q if a < b else q ^ 1), np.uint64(red)] += g
    return _sum_couplings(edges, target, coarse, count, inner)


@inner
def _sum_couplings(edges: Edges, target: Indices, coarse: Edges, count: int, inner: Singles) -> int:
    """The same of couplings, behind ``count`` others."""
    _, _, _, off_red, off_black, off_axis, couplings = edges
    coarse_slots = coarse.faces.shape[1]
    for k in range(len(couplings)):
        a, b, axis = np.int64(target[0, off_red[k]]), np.int64(target[1, off_black[k]]), np.int64(off_axis[k])
        if a == b:
            inner[axis, a] += couplings[k]
            continue
        red, black = min(a, b), max(a, b) - coarse_slots
        if red >= coarse_slots or black < 0:
            return -1
        _note(coarse, count, red, black, axis, couplings[k])
        count += 1
    return count


@inner
def _note(edges: Edges, k: int, red: Any, black: Any, axis: Any, conductance: float) -> None:
    edges.off_red[k], edges.off_black[k] = red, black
    edges.off_axis[k], edges.couplings[k] = axis, conductance
