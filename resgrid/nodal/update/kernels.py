"""Compiled loops of an update: what stands at some places of a board, searches near them, and windows cut out of it.

Places of black cells are counted behind those of red ones, as in `resgrid.nodal.multigrid.boards.lay_out`.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inner
from resgrid.nodal.assembly import find
from resgrid.nodal.multigrid.board_passes import Board, Reals
from resgrid.nodal.multigrid.board_setup import share_of_red
from resgrid.nodal.multigrid.place_kernels import place_of

Floats = NDArray[np.float64]
Indices = NDArray[np.int32]
Integers = NDArray[np.int64]


@njit(cache=True)
def across(board: Board, place: int, side: int) -> tuple[int, float]:
    """The place across a face of another place, and the conductance between them."""
    places, away = board.faces.shape[1], board.distance[side]
    if place < places:
        return places + place + away, board.faces[side, place]
    red = place - places - away
    return red, board.faces[side, red]


@njit(cache=True)
def sum_others(board: Board, place: Integers, cut: Integers) -> Floats:
    """Conductances to neighbouring cells, summed for each place, but for those to some places that are cut off."""
    total = np.zeros(len(place))
    places = board.faces.shape[1]
    for k in range(len(place)):
        for side in range(len(board.faces)):
            there, g = across(board, place[k], side)
            if g > 0.0 and there not in cut:
                total[k] += g
        for m in range(len(board.links)):
            red, black = board.link_red[m], places + board.link_black[m]
            if (place[k] == red and black not in cut) or (place[k] == black and red not in cut):
                total[k] += board.links[m]
    return total


@njit(cache=True)
def black_beside(board: Board, red: Integers) -> Integers:
    """Black places that red ones share a conductance with, counted from 0; some more than once."""
    found, count = np.empty(len(red) * (len(board.distance) + len(board.links)), np.int64), 0
    for place in red:
        for side in range(len(board.distance)):
            if board.faces[side, place] > 0.0:
                found[count] = place + board.distance[side]
                count += 1
        for m in range(len(board.links)):
            if board.link_red[m] == place:
                found[count] = board.link_black[m]
                count += 1
    return found[:count]


@njit(cache=True)
def compensated_degrees(true: Board, board: Board, black: Integers) -> Floats:
    """As `resgrid.nodal.multigrid.board_setup.compensate`, for some black places counted from 0."""
    place = black + board.faces.shape[1]
    degree = _leaks(true, place, true.black_degree[black])
    for k in range(len(place)):
        for side in range(len(board.distance)):
            red, g = across(board, place[k], side)
            if g > 0.0:
                degree[k] += g * _share_of(true, board, red)
        for m in range(len(board.links)):
            if board.link_black[m] == black[k]:
                degree[k] += board.links[m] * _share_of(true, board, board.link_red[m])
    return degree


@inner
def _share_of(true: Board, board: Board, red: int) -> float:
    place = np.array([red])
    conductance = sum_others(board, place, place[:0])
    return share_of_red(conductance[0], _leaks(true, place, 1.0 / true.red_inverse[place])[0], board.red_inverse[red])


@inner
def _leaks(true: Board, place: Integers, degree: Reals) -> Floats:
    """What places of some degrees conduct to the rails; nothing where that may be rounding."""
    leak = degree - sum_others(true, place, place[:0])
    return np.where(leak > 1e-14 * degree, leak, 0.0)


@njit(cache=True)
def count_neighbours(board: Board, place: Integers) -> int:
    """How many neighbours places have, summed."""
    count, places = 0, board.faces.shape[1]
    for k in range(len(place)):
        for side in range(len(board.faces)):
            count += across(board, place[k], side)[1] > 0.0
        for m in range(len(board.links)):
            here = place[k] == board.link_red[m] or place[k] == places + board.link_black[m]
            count += here and board.links[m] > 0.0
    return count


@njit(cache=True)
def between_places(board: Board, one: Integers, other: Integers) -> Floats:
    """Conductance between pairs of places, 0 for none."""
    found = np.zeros(len(one))
    places = board.faces.shape[1]
    for k in range(len(one)):
        for side in range(len(board.faces)):
            there, g = across(board, one[k], side)
            if there == other[k]:
                found[k] += g
        red, black = min(one[k], other[k]), max(one[k], other[k]) - places
        for m in range(len(board.links)):
            if board.link_red[m] == red and board.link_black[m] == black:
                found[k] += board.links[m]
    return found


@njit(cache=True)
def separate(board: Board, one: Integers, other: Integers) -> None:
    """Take the conductances between pairs of places off a board, in place."""
    places = board.faces.shape[1]
    for k in range(len(one)):
        red, black = min(one[k], other[k]), max(one[k], other[k]) - places
        for side in range(len(board.faces)):
            if across(board, red, side)[0] == places + black:
                board.faces[side, red] = 0.0
        for m in range(len(board.links)):
            if board.link_red[m] == red and board.link_black[m] == black:
                board.links[m] = 0.0


@inner
def cell_at(board: Board, shape: Integers, place: int) -> int:
    """Flat index, in a grid of some shape, of the cell at a place of its first level."""
    places, cell = board.faces.shape[1], 0
    black = place >= places
    rest = 2 * (place - board.margin - black * places) + black
    for axis in range(len(shape)):
        stride = board.distance[2 * axis + 1] - board.distance[2 * axis]
        cell = cell * shape[axis] + rest // stride
        rest %= stride
    return int(cell)


@njit(cache=True)
def stay_together(
    board: Board, node: Indices, shape: Integers, row_of_node: Indices, excess: Floats, feed: Floats,
    span: float, seeds: Integers, needed: NDArray[np.bool_], most: int, label: Indices,
) -> bool:  # fmt: skip
    """Whether some places still reach each other, and the rails they need, within ``most`` steps.

    ``needed`` says whether a contact with the low and with the high rail must be found; ``span`` is the voltage
    between the rails, 0 where they are not told apart.  ``label`` is zero for all places of both colours,
    negative for those that are cut off.
    """
    queue = np.empty(most + len(seeds), np.int64)
    parent = np.arange(len(seeds)).astype(np.int32)
    end, begin, apart = len(seeds), 0, len(seeds)
    low, high = not needed[0], not needed[1]
    for k in range(len(seeds)):
        queue[k] = seeds[k]
        label[seeds[k]] = k + 1
    while begin < end:
        place = queue[begin]
        begin += 1
        row = row_of_node[node[cell_at(board, shape, place)]]
        touches = contacts(excess[row], feed[row], span)
        low, high = low or touches[0], high or touches[1]
        for side in range(len(board.faces)):
            there, g = across(board, place, side)
            if g == 0.0 or label[there] < 0:
                continue
            if label[there] > 0:
                a, b = find(parent, label[place] - 1), find(parent, label[there] - 1)
                if a != b:
                    parent[max(a, b)] = min(a, b)
                    apart -= 1
            elif end < len(queue):
                label[there] = label[place]
                queue[end] = there
                end += 1
        if apart <= 1 and low and high:
            return True
    return False


@njit(cache=True)
def contacts(excess: float, feed: float, span: float) -> tuple[bool, bool]:
    """Whether a row touches the low and the high rail; one that may only seem to touch the low one does not."""
    if span == 0.0:
        return excess > 0.0, excess > 0.0
    return excess * span - feed > 1e-9 * excess * span, feed > 0.0


@njit(cache=True)
def number_cells(row: Indices, first: Integers, margin: int, places: int, rows: Integers, place: Indices) -> int:
    """Rows of the cells of a window in C order, -1 for none, and their places on its board; returns how many.

    ``first`` are the numbers of the first cells of all lines of cells.
    """
    count, columns = 0, len(row) // len(first)
    for line in range(len(first)):
        for column in range(columns):
            here, number = row[line * columns + column], first[line] + column
            if here >= 0:
                rows[count] = here
                place[count] = place_of(number, margin, places)
                count += 1
    return count


@njit(cache=True)
def cut_out(
    board: Board, shape: Integers, lines: Integers, first: Integers, window_first: Integers, low: int, high: int,
    margin: int, faces: Floats, inner: Integers, outer: Integers, conductance: Floats,
) -> int:  # fmt: skip
    """Copy the faces of a window, and list the conductances that lead out of it.

    ``shape`` is that of the grid, ``first`` the numbers of the first cells of all its lines; ``lines`` are those in the
    window and around it, ``window_first`` the numbers in the window of their cells at column ``low``, -1 outside; the
    window ends before column ``high``.  Returns the length of the list: ``inner`` counts places of the window,
    ``outer`` those of the board.
    """
    count, places, last = 0, board.faces.shape[1], len(shape) - 1
    for line in lines:
        own, apart = window_first[line], len(first)
        for side in range(2 * len(shape)):
            axis, ahead = side >> 1, 2 * (side & 1) - 1
            if side & 1 == 0 and axis < last:
                apart //= shape[axis]
            other, aside = (line + ahead * apart, 0) if axis < last else (line, ahead)
            theirs = window_first[other] if 0 <= other < len(first) else -1
            if own < 0 and theirs < 0:
                continue
            begin = max(low - 1, 0)
            for column in range(begin + (first[line] + begin & 1), min(high + 1, shape[last]), 2):
                place = board.margin + (first[line] + column >> 1)
                g = board.faces[side, place]
                red = own >= 0 and low <= column < high
                black = theirs >= 0 and low <= column + aside < high
                if g == 0.0 or not (red or black):
                    continue
                red_at = margin + (own + column - low >> 1)
                if red and black:
                    faces[side, red_at] = g
                    continue
                if red:
                    inner[count], outer[count] = red_at, places + place + board.distance[side]
                else:
                    inner[count] = faces.shape[1] + margin + (theirs + column + aside - low >> 1)
                    outer[count] = place
                conductance[count] = g
                count += 1
    return _cut_links(board, shape, window_first, low, high, margin, faces.shape[1], count, inner, outer, conductance)


@inner
def _cut_links(
    board: Board, shape: Integers, window_first: Integers, low: int, high: int, margin: int, window_places: int,
    count: int, inner: Integers, outer: Integers, conductance: Floats,
) -> int:  # fmt: skip
    """The same for links, all of which count as leading out."""
    places = board.faces.shape[1]
    for m in range(len(board.links)):
        for colour in range(2):
            here, there = int(board.link_red[m]), int(places + board.link_black[m])
            if colour == 1:
                here, there = there, here
            line, column = divmod(cell_at(board, shape, here), shape[-1])
            own = window_first[line]
            if own >= 0 and low <= column < high and board.links[m] > 0.0:
                inner[count] = colour * window_places + margin + (own + column - low >> 1)
                outer[count] = there
                conductance[count] = board.links[m]
                count += 1
    return count
