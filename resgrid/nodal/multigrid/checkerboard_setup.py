"""Compiled loops that lay a grid out by colour, once, for the passes of `checkerboard_kernels`."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.nodal.multigrid.checkerboard_kernels import (
    Board,
    Floats,
    Indices,
    Integers,
    Singles,
    into_black,
    into_red,
)


@njit(cache=True, nogil=True)
def _add(amount: Floats, total: Floats) -> None:
    for k in range(len(total)):
        total[k] += amount[k]


@njit(cache=True)
def sum_faces(board: Board, red_degree: Floats, black_degree: Floats) -> None:
    """Add the conductances of all faces, as they are stored, to the leaks of both colours."""
    ones, singles = np.ones(len(board.aggregate)), np.ones(len(board.aggregate), np.float32)
    rows, width = len(board.aside), board.width
    scratch = np.empty(board.block * width)
    red_wrap, black_wrap = 0, 0
    for row in range(0, rows, board.block):
        total = scratch[: min(board.block, rows - row) * width]
        begin = board.margin + row * width
        red_wrap = into_red(board, singles, row, red_wrap, total)
        _add(total, red_degree[begin : begin + len(total)])
        black_wrap = into_black(board, ones, row, black_wrap, total)
        _add(total, black_degree[begin : begin + len(total)])


@njit(cache=True)
def place_cells(cell: Integers, columns: int, row_colour: NDArray[np.uint8], margin: int, width: int) -> Integers:
    """Place of every unknown: its black place, or -1 less its red place."""
    place = np.empty(len(cell), np.int64)
    for i in range(len(cell)):
        row, column = cell[i] // columns, cell[i] % columns
        here = margin + row * width + (column >> 1)
        place[i] = here if (row_colour[row] + column) & 1 else -1 - here
    return place


@njit(cache=True)
def fill_faces(
    indptr: Indices,
    indices: Indices,
    conductance: Floats,
    place: Integers,
    distance: Integers,
    aside: Integers,
    width: int,
    margin: int,
    unit: float,
    faces: Singles,
    wraps: Integers,
) -> int:
    """Write every resistor to its red cell's face, those that lead elsewhere to ``wraps``.

    Returns the number of wraps, or -1 if a resistor joins two cells of one colour.
    """
    count = 0
    for i in range(len(place)):
        for k in range(indptr[i], indptr[i + 1]):
            there = place[indices[k]]
            if (place[i] < 0) == (there < 0):
                return -1
            if place[i] >= 0:
                continue
            here = -1 - place[i]
            face = -1
            if there - here == aside[(here - margin) // width]:
                face = len(distance)
            for q in range(len(distance)):
                if there - here == distance[q]:
                    face = q
            if face >= 0:
                faces[face, here] = conductance[k] / unit
            elif count < len(wraps):
                wraps[count] = k
                count += 1
            else:
                return -1
    return count


@njit(cache=True)
def spread_unknowns(
    place: Integers,
    excess: Floats,
    aggregate: Indices,
    unit: float,
    red_leak: Floats,
    black_leak: Floats,
    black_aggregate: Indices,
) -> None:
    """Leaks to the rails of both colours, and the black cells' aggregates, at their places."""
    for i in range(len(place)):
        if place[i] < 0:
            red_leak[-1 - place[i]] = excess[i] / unit
        else:
            black_leak[place[i]] = excess[i] / unit
            black_aggregate[place[i]] = aggregate[i]


@njit(cache=True)
def invert_degrees(red_degree: Floats, black_degree: Floats, black_inverse: Singles) -> None:
    """Reciprocals where there is an unknown: of red degrees in place, of black ones beside them."""
    for k in range(len(red_degree)):
        if red_degree[k] > 0.0:
            red_degree[k] = 1.0 / red_degree[k]
        if black_degree[k] > 0.0:
            black_inverse[k] = 1.0 / black_degree[k]
