"""Compiled loops that lay a grid out by colour, and sum up what its places conduct."""

from __future__ import annotations

import numpy as np
from numba import njit

from resgrid.jit import inner, inner_fast
from resgrid.solvers.multigrid.board_passes import Floats, Indices, Integers, Reals, place_of, spread

_TINY = 1e-300
"""Keeps what is nothing in all from being divided by."""

BLOCK = 2048
"""Places a pass takes at a time: what it touches stays in the first caches."""


@njit(cache=True)
def place_cells(
    node: Indices, row_of_node: Indices, rows: Integers, margin: int, places: int, place: Indices, at_node: Indices
) -> int:
    """Place of every unknown, and that of every node; returns how many cells have one.

    ``node`` is the node of every cell in C order, -1 for none; ``rows`` the numbers of the first cells of all rows;
    both places come -1 and stay so where an unknown has no cell.  Returns -1 if one has two.
    """
    count, columns = 0, len(node) // len(rows)
    for line in range(len(rows)):
        for column in range(columns):
            here = node[line * columns + column]
            if here < 0 or row_of_node[here] < 0:
                continue
            i, number = row_of_node[here], rows[line] + column
            if place[i] >= 0:
                return -1
            place[i] = at_node[here] = place_of(number, margin, places)
            count += 1
    return count


@njit(cache=True)
def fill_faces(
    pairs: Indices, conductance: Floats, at_node: Indices, distance: Integers, scale: float, faces: Floats,
    links: Integers,
) -> int:  # fmt: skip
    """Add every resistor between two unknowns to its red cell's face, and note those that lead elsewhere as links.

    Returns the number of links, or -1 if a resistor joins two cells of one colour or the links are too many.

    Resistors come axis by axis: most cross the face of the one before, or the opposite one.
    """
    places, count, face = faces.shape[1], 0, 0
    for k in range(len(pairs)):
        red, black = at_node[pairs[k, 0]], at_node[pairs[k, 1]]
        if red < 0 or black < 0 or red == black:
            continue
        if red >= places:
            red, black = black, red
        black -= places
        if red >= places or black < 0:
            return -1
        away = black - red
        if away == distance[face ^ 1]:
            face ^= 1
        elif away != distance[face]:
            other = _face_at(distance, away)
            if other < 0:
                if count == len(links):
                    return -1
                links[count] = k
                count += 1
                continue
            face = other
        faces[face, red] += conductance[k] * scale
    return count


@inner
def _face_at(distance: Integers, away: int) -> int:
    """The face across which a black cell lies so far from a red one; -1 for none."""
    for q in range(len(distance)):
        if distance[q] == away:
            return q
    return -1


@njit(cache=True)
def sum_degrees(
    faces: Floats, distance: Integers, margin: int, link_red: Indices, link_black: Indices, links: Floats,
    degree: Floats,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Add all conductances to the leaks of both colours, ``degree`` of shape (2, places).

    Returns the mean conductance along every axis, 0 where there is none, and the least and the greatest of all faces'.
    """
    end = faces.shape[1] - margin
    total, count = np.zeros(len(distance) // 2), np.zeros(len(distance) // 2)
    extremes = np.array([np.inf, 0.0])
    for begin in range(margin, end, BLOCK):
        for q in range(len(distance)):
            length = min(BLOCK, end - begin)
            _add(faces, q, begin, length, degree[0])
            _add_behind(faces, q, begin, distance[q], length, degree[1])
            some, number = _compare(faces[q, begin : begin + length], extremes)
            total[q >> 1] += some
            count[q >> 1] += number
    for k in range(len(links)):
        degree[0, link_red[k]] += links[k]
        degree[1, link_black[k]] += links[k]
    return total / np.maximum(count, 1.0), extremes


@njit(cache=True)
def compensate(
    faces: Reals, distance: Integers, margin: int, link_red: Indices, link_black: Indices, links: Reals,
    red_inverse: Reals, leak: Floats, degree: Reals,
) -> None:  # fmt: skip
    """Diagonal at black places that makes up for the rounding of conductances and of the red diagonal's reciprocals.

    ``S = D - G R G^T`` then leaks at every black place exactly what it would without that rounding: its rows' sums are
    those of the leaks, for red ones in the share ``leak / degree`` of the currents that pass them.
    """
    end, share = faces.shape[1] - margin, np.zeros(faces.shape[1])
    for k in range(len(degree)):
        degree[k] = leak[1, k]
    for k in range(len(links)):
        share[link_red[k]] += links[k]
    for begin in range(margin, end, BLOCK):
        count = min(BLOCK, end - begin)
        for q in range(len(distance)):
            _add(faces, q, begin, count, share)
        _turn_into_shares(share, leak[0], red_inverse, begin, count)
        for q in range(len(distance)):
            spread(faces, q, begin, distance[q], count, share, degree)
    for k in range(len(links)):
        degree[link_black[k]] += links[k] * share[link_red[k]]


@inner
def share_of_red(conductance: float, leak: float, inverse: float) -> float:
    """Share of the current towards a red cell that comes out of it, and leaks, if its neighbours are at one voltage.

    It is 1 but for the rounding of the reciprocal of its diagonal entry.
    """
    return inverse * conductance + leak / (conductance + leak + _TINY)


@inner_fast
def _turn_into_shares(conductance: Floats, leak: Floats, inverse: Reals, begin: int, count: int) -> None:
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        conductance[k] = share_of_red(conductance[k], leak[k], inverse[k])


@inner_fast
def _add(faces: Reals, q: int, begin: int, count: int, total: Floats) -> None:
    face, at = np.uint64(q), np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        total[k] += faces[face, k]


@inner_fast
def _add_behind(faces: Reals, q: int, begin: int, away: int, count: int, total: Floats) -> None:
    face, red, black = np.uint64(q), np.uint64(begin), np.uint64(begin + away)
    for i in range(count):
        k = np.uint64(i)
        total[black + k] += faces[face, red + k]


@inner_fast
def _compare(conductance: Floats, extremes: Floats) -> tuple[float, float]:
    """Sum and number of the conductances that are not 0; widens their least and their greatest.

    What is positive compares as its bits do, in whole numbers, of which several at a time are compared.
    """
    bits, extreme = conductance.view(np.uint64), extremes.view(np.uint64)
    one, least, greatest = np.uint64(1), extreme[0] - np.uint64(1), extreme[1]
    total, count = 0.0, 0.0
    for i in range(len(conductance)):
        total += conductance[i]
        count += conductance[i] > 0.0
        least, greatest = min(least, bits[i] - one), max(greatest, bits[i])  # 0 becomes the largest one
    extreme[0], extreme[1] = least + one, greatest
    return total, count


@njit(cache=True)
def invert(degree: Floats, inverse: Reals) -> None:
    """Reciprocals; 0 where there is no unknown."""
    for k in range(len(degree)):
        inverse[k] = 1.0 / degree[k] if degree[k] > 0.0 else 0.0
