"""Compiled loops that make the next board of a board: blocks of cells, their connected parts, and what joins them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inner
from resgrid.solvers.multigrid.board_passes import Floats, Indices, Integers, Singles, place_of
from resgrid.solvers.row_kernels import find, join


@njit(cache=True)
def strongest_at(
    faces: Floats, distance: Integers, margin: int, link_red: Indices,
    link_black: Indices, links: Floats, strongest: Singles,
) -> None:  # fmt: skip
    """Strongest conductance at every place of both colours, shape (2, places)."""
    for red in range(margin, faces.shape[1] - margin):
        for q in range(len(distance)):
            g = faces[q, red]
            if g > 0.0:
                black = red + distance[q]
                strongest[0, red] = max(strongest[0, red], g)
                strongest[1, black] = max(strongest[1, black], g)
    for k in range(len(links)):
        strongest[0, link_red[k]] = max(strongest[0, link_red[k]], links[k])
        strongest[1, link_black[k]] = max(strongest[1, link_black[k]], links[k])


@njit(cache=True)
def block_of_places(
    exists: NDArray[np.bool_], rows: Integers, columns: int, margin: int, shift: int, coarse_rows: Integers,
    coarse_margin: int, coarse_places: int, block: Indices,
) -> None:  # fmt: skip
    """Which place of the next board, red ones first, the block around every place takes; left alone where nothing is.

    ``rows`` are the numbers of the first cells of all rows, ``coarse_rows`` those of the blocks that these are in.
    """
    for line in range(len(rows)):
        for column in range(columns):
            number = rows[line] + column
            colour, here = number & 1, margin + (number >> 1)
            if exists[colour, here]:
                number = coarse_rows[line] + (column >> shift)
                block[colour, here] = place_of(number, coarse_margin, coarse_places)


@inner
def _joins(g: float, weak: float, strongest: Singles, red: int, black: int | np.uint64) -> bool:
    return weak == 0.0 or g >= weak * max(strongest[0, red], strongest[1, black])


@njit(cache=True)
def count_inside(
    faces: Floats, distance: Integers, margin: int, block: Indices, weak: float, strongest: Singles, members: Indices,
    inner: Indices,
) -> None:  # fmt: skip
    """Members of every block, and the faces inside it that conduct and are not weak.

    Links do not count: those that close a ring of two cells join what a face joins already.
    """
    red_block, black_block = block[0], block[1]
    for k in range(margin, faces.shape[1] - margin):
        at = np.uint64(k)
        own, joined = np.uint64(red_block[at]), 0
        members[own] += 1
        members[np.uint64(black_block[at])] += 1
        for q in range(len(distance)):
            black = np.uint64(k + distance[q])
            g, same = faces[np.uint64(q), at], own == np.uint64(black_block[black])
            joined += same and g > 0.0 and _joins(g, weak, strongest, k, black)
        inner[own] += joined
    members[0] = 0


@njit(cache=True)
def join_inside(
    faces: Floats, distance: Integers, margin: int, link_red: Indices,
    link_black: Indices, links: Floats, block: Indices, weak: float, strongest: Singles,
    doubtful: NDArray[np.bool_], parent: Indices,
) -> None:  # fmt: skip
    """Join the members of doubtful blocks by the resistors inside that are not weak (union-find over both colours)."""
    places = faces.shape[1]
    for k in range(margin, faces.shape[1] - margin):
        if not doubtful[block[0, k]]:
            continue
        for q in range(len(distance)):
            g = faces[q, k]
            if g > 0.0:
                black = k + distance[q]
                if block[0, k] == block[1, black] and _joins(g, weak, strongest, k, black):
                    join(parent, k, places + black)
    for k in range(len(links)):
        red, black = link_red[k], link_black[k]
        if block[0, red] == block[1, black] and _joins(links[k], weak, strongest, red, black):
            join(parent, red, places + black)


@njit(cache=True)
def split_blocks(
    doubtful: NDArray[np.bool_], parent: Indices, block: Indices, coarse_places: int, extra_block: Integers
) -> int:
    """Let the first part of a split block keep its place, and number the others as extra nodes, in place.

    Extra nodes are numbered from ``2 coarse_places`` on, and ``extra_block`` notes the block each comes from.
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
                of_root[node] = 2 * coarse_places + count
                extra_block[count] = home
                count += 1
            else:
                taken[home] = True
                of_root[node] = home
        flat[node] = of_root[root]
    return count


@njit(cache=True)
def renumber(block: Indices, before: int, number: Indices, shift: int) -> None:
    """Give extra nodes, counted from ``2 before``, their place, and move black places by ``shift``, in place."""
    flat = block.ravel()
    for node in range(len(flat)):
        if flat[node] >= 2 * before:
            flat[node] = number[flat[node] - 2 * before]
        elif flat[node] >= before:
            flat[node] += shift


@njit(cache=True)
def sum_blocks(
    faces: Floats, leak: Floats, distance: Integers, margin: int, link_red: Indices,
    link_black: Indices, link_axis: Indices, links: Floats, target: Indices, coarse_places: int,
    first_extra: int, coarse: Floats, coarse_leak: Floats, inner: Singles,
    new_ends: Indices, new_axis: Indices, new_links: Floats,
) -> int:  # fmt: skip
    """Sum the conductances between aggregates into the faces and links of the next board, leaks into its leaks.

    ``inner`` of shape (ndim, 2 places) receives what lies inside aggregates along every axis.  Returns the number of
    new links, or -1 if a resistor joins two parts of one colour.
    """
    count, red_target, black_target = 0, target[0], target[1]
    for k in range(margin, faces.shape[1] - margin):
        at = np.uint64(k)
        for colour in range(2):
            if leak[colour, at] != 0.0:
                coarse_leak[np.uint64(target[colour, at])] += leak[colour, at]
        a = np.int64(red_target[at])
        for q in range(len(distance)):
            g = faces[np.uint64(q), at]
            if g == 0.0:
                continue
            b = np.int64(black_target[np.uint64(k + distance[q])])
            axis = q >> 1
            if a == b:
                inner[np.uint64(axis), np.uint64(a)] += g
                continue
            red, black = min(a, b), max(a, b) - coarse_places
            if red >= coarse_places or black < 0:
                return -1
            if red >= first_extra or black >= first_extra:
                new_ends[0, count], new_ends[1, count] = red, black
                new_axis[count], new_links[count] = axis, g
                count += 1
                continue
            # Where the red cell's block is black, the same face is the opposite one of the red block.
            coarse[np.uint64(q if a < b else q ^ 1), np.uint64(red)] += g
    for k in range(len(links)):
        a, b = target[0, link_red[k]], target[1, link_black[k]]
        if a == b:
            inner[link_axis[k], a] += links[k]
            continue
        red, black = min(a, b), max(a, b) - coarse_places
        if red >= coarse_places or black < 0:
            return -1
        new_ends[0, count], new_ends[1, count] = red, black
        new_axis[count], new_links[count] = link_axis[k], links[k]
        count += 1
    return count


@njit(cache=True)
def lengthen_faces(
    faces: Floats, leak: Floats, distance: Integers, margin: int, link_red: Indices,
    link_black: Indices, link_axis: Indices, links: Floats, inner: Singles,
) -> None:  # fmt: skip
    """Make the conductances of a coarse board know length, in place.

    From the middle of one block to the middle of the next lies half of either block's own resistance, in series with
    what joins the two; a rail is reached through 0.15 times the block's.
    """
    places = faces.shape[1]
    for red in range(margin, faces.shape[1] - margin):
        for q in range(len(distance)):
            if faces[q, red] > 0.0:
                black = places + red + distance[q]
                faces[q, red] = _in_series(faces[q, red], inner[q >> 1, red], inner[q >> 1, black], 0.5)
        for colour in range(2):
            if leak[colour, red] > 0.0:
                own = 0.0
                for axis in range(len(inner)):
                    own = max(own, float(inner[axis, colour * places + red]))
                leak[colour, red] = _in_series(leak[colour, red], own, 0.0, 0.15)
    for k in range(len(links)):
        axis = link_axis[k]
        links[k] = _in_series(links[k], inner[axis, link_red[k]], inner[axis, places + link_black[k]], 0.5)


@inner
def _in_series(conductance: float, one: float, other: float, share: float) -> float:
    resistance = 1.0 / conductance
    if one > 0.0:
        resistance += share / one
    if other > 0.0:
        resistance += share / other
    return 1.0 / resistance
