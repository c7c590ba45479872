"""Compiled loops of rigid contact: the complementarity problem of its forces, solved by pivoting.

Numba takes seconds to import: only functions that are about to run import this module.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from resgrid.jit import inner

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_LEAST_MOBILITY = 1e-12
_LEAST_PIVOT = 1e-13
_TIE = 1e-12
_GONE = 1e-9
_CLOSED = 1e-6
_REFINEMENTS = 3


@inner
def _leaving_row(table: Floats, entering: int, basis: Integers) -> int:
    """Row of the smallest ratio, ties decided by the ratios of the inverse basis (lexicographic); -1 if none bounds."""
    size = len(table)
    least = _LEAST_PIVOT * np.abs(table[:, :size]).max()
    best = -1
    for row in range(size):
        if table[row, entering] <= least:
            continue
        if best < 0:
            best = row
            continue
        for column in range(-1, size):
            own = table[row, column] / table[row, entering]
            other = table[best, column] / table[best, entering]
            if abs(own - other) > _TIE * (1.0 + abs(other)):
                if own < other:
                    best = row
                break
    if best >= 0:
        for row in range(size):
            if basis[row] == 2 * size and table[row, entering] > least:
                own, other = table[row, -1] / table[row, entering], table[best, -1] / table[best, entering]
                if own <= other + _TIE * (1.0 + abs(other)):
                    return row
    return best


@inner
def _pivot(table: Floats, row: int, column: int) -> None:
    table[row] /= table[row, column]
    for other in range(len(table)):
        if other != row and table[other, column] != 0.0:
            table[other] -= table[other, column] * table[row]


@njit(cache=True)
def complementary(matrix: Floats, offset: Floats, inverse: Floats, basis: Integers) -> bool:
    """Basis of ``z >= 0, w = M z + q >= 0, z . w = 0`` by Lemke's method, for small copositive M; False without one.

    Columns of the table: the slacks ``w``, the unknowns ``z``, Lemke's artificial one, and the right-hand side.
    ``basis`` ends as the columns that are not 0, whose values are ``inverse @ q``.
    """
    size = len(offset)
    inverse[:], basis[:] = np.eye(size), np.arange(size)
    if offset.min() >= 0.0:
        return True
    table = np.zeros((size, 2 * size + 2))
    for row in range(size):
        table[row, row] = 1.0
        table[row, size : 2 * size] = -matrix[row]
        table[row, 2 * size] = -1.0
        table[row, -1] = offset[row]
    row = int(np.argmin(offset))
    entering = 2 * size
    for _ in range(50 * size):
        leaving = basis[row]
        _pivot(table, row, entering)
        basis[row] = entering
        done = leaving == 2 * size
        for other in range(size):
            done |= basis[other] == 2 * size and table[other, -1] <= _GONE
        if done:
            inverse[:] = table[:, :size]
            return True
        entering = leaving + size if leaving < size else leaving - size
        row = _leaving_row(table, entering, basis)
        if row < 0:
            return False
    return False


@inner
def _refined(
    rows: Floats, give: Floats, matrix: Floats, offset: Floats, kind: Integers, inverse: Floats, basis: Integers,
    unknown: Floats,
) -> float:  # fmt: skip
    """Unknowns of a basis, with residuals from the velocity itself, whose rounding is not squared; what they violate.

    Contacts that almost face each other are as badly conditioned in ``M = N A N^T`` as the square of ``N`` is.
    """
    used = len(unknown)
    slack = np.empty(used)
    for turn in range(_REFINEMENTS + 1):
        change = np.zeros(rows.shape[1])
        for row in range(used):
            if kind[row] < 3:
                change += unknown[row] * give[row]
        for row in range(used):
            slack[row] = offset[row]
            if kind[row] < 3:
                slack[row] += np.dot(rows[row], change)
            for other in range(used):
                if kind[row] == 3 or kind[other] == 3:
                    slack[row] += matrix[row, other] * unknown[other]
        if turn == _REFINEMENTS:
            break
        error = slack.copy()
        for column in basis:
            if column < used:
                error[column] = 0.0
        for row in range(used):
            if used <= basis[row] < 2 * used:
                unknown[basis[row] - used] += np.dot(inverse[row], error)
    worst = max(-slack.min(), -unknown.min())
    for row in range(used):
        worst = max(worst, min(abs(slack[row]), abs(unknown[row])))
    largest = unknown.max()
    for row in range(used):
        if unknown[row] < _TIE * largest:
            unknown[row] = 0.0
    return worst


@njit(cache=True)
def resolve_contacts(
    normal: Floats, tangent: Floats, target: Floats, admittance: Floats, friction: float, velocity: Floats,
    force: Floats,
) -> bool:  # fmt: skip
    """Contact forces that keep ``n . J qdot >= target``, with Coulomb friction; ``velocity`` is changed in place.

    The complementarity problem ``0 <= f_n, n . J qdot - target >= 0``, one of them 0, and ``|f_t| <= mu f_n``, opposing
    ``t . J qdot`` (in the plane the cone of friction is a wedge, so this is linear): one unknown ``f_n`` for each
    contact and, with friction, the two sides of ``f_t`` and its slip.  ``force[k]`` ends as normal and tangential
    force.  A contact whose force could not move the robot is left out.  Returns whether a solution was found to 1e-6 of the velocity;
    with targets that are not positive there is one.
    """
    count, ndim = normal.shape
    size = max(np.abs(normal).max(), np.abs(tangent).max())
    rows = np.empty((4 * count, ndim))
    offset, scale = np.zeros(4 * count), np.empty(4 * count)
    owner, kind = np.empty(4 * count, np.int64), np.empty(4 * count, np.int64)
    used = 0
    force[:] = 0.0
    for k in range(count):
        if np.abs(normal[k]).max() <= _LEAST_MOBILITY * size:
            continue
        rubs = friction > 0.0 and np.abs(tangent[k]).max() > _LEAST_MOBILITY * size
        for part in range(4 if rubs else 1):
            owner[used], kind[used], rows[used] = k, part, 0.0
            if part < 3:
                row = normal[k] if part == 0 else tangent[k]
                scale[used] = 1.0 / np.sqrt(np.dot(row @ admittance, row))
                rows[used] = row * (-scale[used] if part == 2 else scale[used])
                offset[used] = np.dot(rows[used], velocity) - (target[k] * scale[used] if part == 0 else 0.0)
            else:
                scale[used] = scale[used - 1]
            used += 1
    largest = np.abs(offset[:used]).max() if used else 0.0
    if largest == 0.0:
        return True
    rows, kind = rows[:used], kind[:used]
    give, unknown = rows @ admittance, np.zeros(used)
    matrix = give @ rows.T
    for row in range(used):
        if kind[row] == 3:
            matrix[row - 1, row] = matrix[row - 2, row] = 1.0
            matrix[row, row - 1] = matrix[row, row - 2] = -1.0
            matrix[row, row - 3] = friction * scale[row - 3] / scale[row]
    inverse, basis = np.empty((used, used)), np.empty(used, np.int64)
    if not complementary(matrix, offset[:used] / largest, inverse, basis):
        return False
    closes = _refined(rows, give, matrix, offset[:used], kind, inverse, basis, unknown)
    for row in range(used):
        if kind[row] < 3:
            velocity += unknown[row] * give[row]
            force[owner[row], min(kind[row], 1)] += (-unknown[row] if kind[row] == 2 else unknown[row]) * scale[row]
    return closes <= _CLOSED * largest
