"""Loops that find blocks of a grid, split them, and sum up what lies between them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import inner, kernel
from resgrid.solvers.multigrid.red_black import Edges, Floats, Indices, Integers, Singles, slot_of
from resgrid.solvers.row_kernels import find, join


@kernel
def strongest_at(edges: Edges, strongest: Singles) -> None:
    """Strongest conductance at every slot of both colours, shape (2, slots)."""
    faces, distance, margin, off_red, off_black, _, couplings = edges
    for red in range(margin, faces.shape[1] - margin):
        for q in range(len(distance)):
            g = faces[q, red]
            if g > 0.0:
                black = red + distance[q]
                strongest[0, red] = max(strongest[0, red], g)
                strongest[1, black] = max(strongest[1, black], g)
    for k in range(len(couplings)):
        strongest[0, off_red[k]] = max(strongest[0, off_red[k]], couplings[k])
        strongest[1, off_black[k]] = max(strongest[1, off_black[k]], couplings[k])


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
    edges: Edges, block: Indices, weak: float, strongest: Singles, begin: int, end: int, members: Indices,
    inner: Indices,
) -> None:  # fmt: skip
    """Count the members of the blocks at some slots, and the faces inside that conduct and are not weak.

    Couplings do not count: those that close a ring of two cells join what a face joins already.
    """
    faces, distance = edges.faces, edges.distance
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
def renumber(block: Indices, before: int, number: Indices, shift: int) -> None:
    """Give extra nodes, counted from ``2 before``, their slot, and move black slots by ``shift``, in place."""
    flat = block.ravel()
    for node in range(len(flat)):
        if flat[node] >= 2 * before:
            flat[node] = number[flat[node] - 2 * before]
        elif flat[node] >= before:
            flat[node] += shift


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
    count, red_target, black_target = 0, target[0], target[1]
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


@kernel
def lengthen(edges: Edges, leak: Floats, inner: Singles, begin: int, end: int) -> None:
    """Make the conductances of faces and leaks at some slots of a coarse grid know length, in place.

    From the middle of one block to the middle of the next lies half of either block's own resistance, in series with
    what joins the two; a rail is reached through 0.15 times the block's.
    """
    faces, distance, slots = edges.faces, edges.distance, edges.faces.shape[1]
    for red in range(begin, end):
        for q in range(len(distance)):
            if faces[q, red] > 0.0:
                black = slots + red + distance[q]
                faces[q, red] = _behind_both(faces[q, red], inner[q >> 1, red], inner[q >> 1, black], 0.5)
        for colour in range(2):
            if leak[colour, red] > 0.0:
                own = 0.0
                for axis in range(len(inner)):
                    own = max(own, float(inner[axis, colour * slots + red]))
                leak[colour, red] = _behind_both(leak[colour, red], own, 0.0, 0.15)


@inner
def _behind_both(conductance: float, one: float, other: float, share: float) -> float:
    resistance = 1.0 / conductance
    if one > 0.0:
        resistance += share / one
    if other > 0.0:
        resistance += share / other
    return 1.0 / resistance
