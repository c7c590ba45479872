"""Coarsen a grid: blocks of two cells along every axis, split into their connected parts.

The *slot* of a node is its index in an array (slots,) over the nodes of its colour; red and black slots both count from
0. The *position* of a node is its index in a flattened array (2, slots): the slot of a red node, or the number of slots
plus the slot of a black node. Slots and positions belong to one level: the finer one, or the next coarser one. Slot 0
is unused on every level, so that position 0 stands for no node.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import ZERO, inner, kernel
from resgrid.solvers.csr_kernels import find, join
from resgrid.solvers.multigrid.grid_level import WEAK, Level, level_of
from resgrid.solvers.multigrid.red_black import Edges, RedBlackLayout
from resgrid.solvers.scaled import Indices, Integers, Singles


def coarsen(level: Level, *, split: bool) -> tuple[Level, NDArray[np.int32]] | None:
    """Return the next coarser level, and the coarse node of every node; None if nodes of one colour would be joined.

    The nodes of the next level are blocks of two cells along every axis, except along axes whose mean conductance is at
    most a tenth of that of the best axis. If a block is disconnected without its weak conductances, one connected
    component stays on the grid. The other components become extra nodes, which are joined by couplings (edges that
    cross no face of the grid).

    `level`: the finer level; `split`: whether a block counts as disconnected without its weak conductances (below a
    tenth of the strongest conductance at their two ends); if False, every conductance connects. The returned array has
    shape (2, slots of the finer level): row 0 for red, row 1 for black nodes, by their index in the arrays of the finer
    level. An entry is the position of the node's coarse node: a red coarse node's index in the arrays (coarse slots,)
    of the coarser level, or the number of coarse slots plus a black coarse node's index. An entry is 0 where the finer
    level has no node.
    """
    shift = (level.mean > WEAK * level.mean.max()).astype(np.int64)
    lattice = RedBlackLayout(tuple((n - 1 >> s) + 1 for n, s in zip(level.lattice.shape, shift.tolist(), strict=True)))
    target = _blocks(level, lattice, shift)
    home = _split(level, lattice, target, WEAK if split else 0.0)
    before, colour = lattice.slots, (home >= lattice.slots).astype(np.int64)
    if len(home):
        most = int(np.bincount(colour).max())
        lattice = RedBlackLayout(lattice.shape, most)
        rank = np.where(colour == 0, np.cumsum(colour == 0), np.cumsum(colour == 1)) - 1
        number = (colour * lattice.slots + lattice.first_extra + rank).astype(np.int32)
        extra = target >= 2 * before
        target[(target >= before) & ~extra] += lattice.slots - before
        target[extra] = number[target[extra] - 2 * before]
    cells = [lattice.cells_at(c, home[colour == c] - c * before) for c in range(2)]
    red, black = (np.ravel_multi_index(cell, lattice.shape).astype(np.int64) for cell in cells)
    summed = sum_up(level, lattice, target, len(home))
    if summed is None:
        return None
    edges, leak = _with_block_resistance(*summed)
    return level_of(lattice, edges, leak, (red, black)), target


def _blocks(level: Level, lattice: RedBlackLayout, shift: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return the position, on the next level, of the block that contains the node at every fine slot, shape (2, slots).

    Row 0 belongs to the red nodes of the finer level, row 1 to the black ones. A position is the index of a red block
    in an array (coarse slots,), or the number of coarse slots plus the index of a black block; 0 at unused slots.
    `level`: the finer level; `lattice`: memory layout of the next level; `shift` (ndim,): 1 for axes along which blocks
    have two cells, 0 for others.
    """
    fine, blocks = level.lattice, lattice.cells
    for axis, halved in enumerate(shift.tolist()):
        if halved:
            doubled = np.repeat(blocks, 2, axis=axis)
            blocks = doubled[(slice(None),) * axis + (slice(fine.shape[axis]),)]
    target = fine.at_slots(blocks)
    np.copyto(target, 0, where=level.degree == 0.0)
    for colour, cell in enumerate(level.extra_cell):
        target[colour, fine.first_extra : fine.first_extra + len(cell)] = blocks.ravel()[cell]
    return target


def _split(level: Level, lattice: RedBlackLayout, target: NDArray[np.int32], weak: float) -> NDArray[np.int64]:
    """Number the extra nodes, the connected components of each block except its first; return their blocks (extras,).

    A block is given as its position on the next level: a red block's index in an array (``lattice.slots``,), or
    ``lattice.slots`` plus a black block's index. `level, lattice`: the finer level, and memory layout of the next one
    without extra nodes; `target` (2, slots of the finer level): block of every red node (row 0) and black node (row 1),
    0 for none; for the nodes of an extra node, overwritten with ``2 lattice.slots`` plus the number of the extra node;
    `weak`: fraction of the strongest conductance at its two ends below which a conductance does not connect a block, 0
    if every conductance connects.
    """
    edges = level.edges
    strongest = _strongest(edges) if weak else np.zeros((2, 1), dtype=np.float32)
    members, inner = np.zeros((2, 2 * lattice.slots), dtype=np.int32)
    count_inside(edges, target, weak, strongest, members, inner)
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
    """Return the strongest conductance at every node, shape (2, slots): red nodes in row 0, black ones in row 1.

    `edges`: conductances of the grid. The column is the index of the node in the arrays of its colour.
    """
    strongest = np.zeros((2, edges.faces.shape[1]), dtype=np.float32)
    inside = slice(edges.margin, edges.faces.shape[1] - edges.margin)
    for face, away in zip(edges.faces[:, inside].astype(np.float32), edges.distance.tolist(), strict=True):
        there = slice(inside.start + away, inside.stop + away)
        for of, at in ((strongest[0], inside), (strongest[1], there)):
            np.maximum(of[at], face, out=of[at])
    for of, slot in zip(strongest, (edges.off_red, edges.off_black), strict=True):
        np.maximum.at(of, slot, edges.couplings.astype(np.float32))
    return strongest


def _with_block_resistance(
    edges: Edges, leak: NDArray[np.float64], inner: NDArray[np.float32]
) -> tuple[Edges, NDArray[np.float64]]:
    """Return conductances and leaks in series with the resistance inside blocks; ``edges.faces`` is modified in place.

    Between the centres of two blocks lies half of either block's own resistance along the axis that joins the blocks,
    in series with the conductance between them. A leak, the conductance to a rail, is in series with 0.15 times the
    smallest of the block's resistances along the axes. The factor 0.15 is empirical.

    `edges`: summed conductances between blocks; `leak` (2, slots): conductances to the rails, of red blocks in row 0
    and of black ones in row 1; `inner` (ndim, 2 slots): conductance inside every block along every axis, in the columns
    0 to ``slots - 1`` for red blocks and ``slots`` to ``2 slots - 1`` for black ones.
    """
    slots = leak.shape[1]
    here = slice(edges.margin, slots - edges.margin)
    for q, (face, away) in enumerate(zip(edges.faces[:, here], edges.distance.tolist(), strict=True)):
        there = slice(slots + here.start + away, slots + here.stop + away)
        half = _in_series(face, inner[q >> 1, here], 0.5)
        face[:] = _in_series(half, inner[q >> 1, there], 0.5)
    off = _in_series(edges.couplings, inner[edges.off_axis, edges.off_red], 0.5)
    off = _in_series(off, inner[edges.off_axis, slots + edges.off_black], 0.5)
    return edges._replace(couplings=off), _in_series(leak, inner.max(axis=0).reshape(2, slots), 0.15)


def _in_series(conductance: NDArray[np.float64], inner: NDArray[np.float32], fraction: float) -> NDArray[np.float64]:
    """Return conductances in series with a fraction of the resistance inside blocks; unchanged where ``inner`` is 0.

    `conductance`: conductances from blocks to other blocks or rails; `inner`: conductances inside the blocks, 0 if
    unknown; `fraction`: fraction of the resistance ``1 / inner``. All arrays have equal shapes.
    """
    own = inner.astype(np.float64)
    return np.divide(own * conductance, own + fraction * conductance, out=conductance.copy(), where=own > 0.0)


def sum_up(
    level: Level, lattice: RedBlackLayout, target: NDArray[np.int32], extras: int
) -> tuple[Edges, NDArray[np.float64], NDArray[np.float32]] | None:
    """Return the conductances between coarse nodes, their leaks (conductances to rails), and those inside coarse nodes.

    The leaks have shape (2, coarse slots), the conductances inside coarse nodes (ndim, 2 coarse slots); red nodes
    precede black ones. Returns None if weak conductances join two components of one block, since these have the same
    colour.

    `level, lattice`: the finer level, and memory layout of the next one; `target` (2, slots of the finer level):
    position on the next level of the coarse node of every red node (row 0) and black node (row 1); a position is a red
    coarse node's index in an array (coarse slots,), or the number of coarse slots plus a black one's index; `extras`:
    number of extra nodes of the next level (components of a block except the first).
    """
    sides = len(level.edges.faces)
    capacity = len(level.edges.couplings) + extras * sides * 2 ** (sides // 2)
    inner = np.zeros((sides // 2, 2 * lattice.slots), dtype=np.float32)
    red, black, axis = np.empty((3, capacity), dtype=np.int32)
    faces, distance, margin = np.zeros((sides, lattice.slots)), lattice.distance, lattice.margin
    coarse = Edges(faces, distance, margin, red, black, axis, np.empty(capacity))
    count = sum_blocks(level.edges, target, lattice.first_extra, coarse, inner)
    if count < 0:
        return None
    at, leak = np.flatnonzero(level.leak), np.zeros((2, lattice.slots))
    np.add.at(leak.ravel(), target.ravel()[at], level.leak.ravel()[at])
    united = _merge_couplings(red[:count], black[:count], axis[:count], coarse.couplings[:count])
    return Edges(faces, distance, margin, *united), leak, inner


def _merge_couplings(
    red: NDArray[np.int32], black: NDArray[np.int32], axis: NDArray[np.int32], couplings: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
    """Return couplings sorted by red, then black node; those between the same two nodes become one, with their sum.

    `red, black` (couplings,): index of the red node in arrays over the red nodes, and of the black node in arrays over
    the black nodes, both from 0; `axis, couplings` (couplings,): axis of the grid, and conductance. The four results
    correspond to these arrays.
    """
    order = np.lexsort((black, red))
    red, black, axis, couplings = red[order], black[order], axis[order], couplings[order]
    first = np.flatnonzero((np.diff(red, prepend=-1) != 0) | (np.diff(black, prepend=-1) != 0))
    summed = np.add.reduceat(couplings, first) if len(first) else couplings
    return red[first], black[first], axis[first], summed


@inner
def _joins(g: float, weak: float, strongest: Singles, red: int, black: int | np.uint64) -> bool:
    """Return whether the conductance ``g`` between a red and a black node is not weak.

    `weak`: fraction of the larger of the strongest conductances at both nodes below which ``g`` is weak, 0 if never;
    `strongest` (2, slots): strongest conductance at every red node (row 0) and black node (row 1); `red, black`:
    columns of the two nodes in these rows.
    """
    return weak == 0.0 or g >= weak * max(strongest[0, red], strongest[1, black])


@kernel
def count_inside(
    edges: Edges, block: Indices, weak: float, strongest: Singles, members: Indices, inner: Indices
) -> None:
    """Count the nodes of every block, and the faces inside every block that conduct and are not weak.

    `edges`: conductances between the cells of the finer level; `block` (2, slots): position on the next level of the
    block of every red node (row 0) and black node (row 1), 0 for none; `weak`: fraction of the strongest conductance at
    its two ends below which a conductance is weak; `strongest` (2, slots): strongest conductance at every node;
    `members, inner` (2 coarse slots,): receive, at the position of every block, the numbers of nodes and of faces, 0 on
    entry. Edges that cross no face do not count; along a periodic axis of two cells they join cells that a face joins
    already.
    """
    red_block, black_block, faces, distance = block[0], block[1], edges.faces, edges.distance
    for k in range(edges.margin, len(red_block) - edges.margin):
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
    """Merge, in the union-find ``parent``, the nodes of possibly disconnected blocks that a conductance joins.

    `edges`: conductances of the finer level; `block` (2, slots): position on the next level of the block of every red
    node (row 0) and black node (row 1), 0 for none; `weak`: fraction of the strongest conductance at its two ends below
    which a conductance does not join; `strongest` (2, slots): strongest conductance at every node; `doubtful` (2 coarse
    slots,): whether the block at a position may be disconnected; `parent` (2 slots,): union-find over the red, then the
    black nodes of the finer level.
    """
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
def split_blocks(
    doubtful: NDArray[np.bool_], parent: Indices, block: Indices, coarse_slots: int, extra_block: Integers
) -> int:
    """Number the extra nodes, the connected components of each block except its first; return how many there are.

    `doubtful` (2 coarse slots,): whether the block at a position of the next level may be disconnected; `parent` (2
    slots,): union-find, over the red, then the black nodes of the finer level, whose trees are the components; `block`
    (2, slots): position of the block of every node of the finer level, 0 for none, overwritten by the number of the
    extra node; `coarse_slots`: length of an array over one colour of the next level; `extra_block`: receives the
    position of the block of every extra node. Extra nodes are numbered from ``2 coarse_slots`` on.
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
def sum_blocks(edges: Edges, target: Indices, first_extra: int, coarse: Edges, inner: Singles) -> int:
    """Sum the conductances between blocks into the faces and couplings of ``coarse``; return the number of couplings.

    A coarse node is a connected component of a block of cells. The first component of a block takes the block's place
    on the coarse grid; each further component is an extra node, numbered after the grid. A coupling is an edge that
    crosses no face of the grid, and every edge of an extra node is one. The result is -1 if an edge joins two coarse
    nodes of one colour.

    `edges, coarse`: edges of the finer and of the next level; `target` (2, slots of the finer level): position of the
    coarse node of every red node (row 0) and black node (row 1): the index of a red coarse node in an array (coarse
    slots,), or the number of coarse slots plus the index of a black one in such an array; `first_extra`: smallest such
    index of an extra node, equal for both colours; `inner` (ndim, 2 coarse slots): conductances inside coarse nodes
    along every axis are added here, in the column of the coarse node's position.
    """
    faces, distance, _, off_red, off_black, off_axis, couplings = edges
    sums, coarse_slots = coarse.faces, coarse.faces.shape[1]
    count, red_target, black_target = ZERO, target[0], target[1]
    for k in range(edges.margin, len(red_target) - edges.margin):
        at = np.uint64(k)
        a = np.int64(red_target[at])
        for q in range(len(distance)):
            g = faces[np.uint64(q), at]
            if g == 0.0:
                continue
            b, axis = np.int64(black_target[np.uint64(k + distance[q])]), np.int64(q >> 1)
            if a == b:
                inner[np.uint64(axis), np.uint64(a)] += g
                continue
            red, black = min(a, b), max(a, b) - coarse_slots
            if red >= coarse_slots or black < 0:
                return -1
            if red >= first_extra or black >= first_extra:
                _record(coarse, count, red, black, axis, g)
                count += 1
                continue
            # Where the red cell's block is black, the same face is the opposite one of the red block.
            sums[np.uint64(q if a < b else q ^ 1), np.uint64(red)] += g
    for k in range(len(couplings)):
        a, b, axis = np.int64(red_target[off_red[k]]), np.int64(black_target[off_black[k]]), np.int64(off_axis[k])
        if a == b:
            inner[axis, a] += couplings[k]
            continue
        red, black = min(a, b), max(a, b) - coarse_slots
        if red >= coarse_slots or black < 0:
            return -1
        _record(coarse, count, red, black, axis, couplings[k])
        count += 1
    return count


@inner
def _record(edges: Edges, k: int, red: Any, black: Any, axis: Any, conductance: float) -> None:
    """Write coupling number ``k`` (from 0) of ``edges``: its two nodes, its axis and its conductance.

    `red, black`: index of the red node in arrays over the red nodes, and of the black node in arrays over the black
    nodes.
    """
    edges.off_red[k], edges.off_black[k] = red, black
    edges.off_axis[k], edges.couplings[k] = axis, conductance
