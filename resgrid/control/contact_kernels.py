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
def _slacks(
    rows: Floats, give: Floats, cone: Floats, offset: Floats, unknown: Floats, slack: Floats
) -> None:  # fmt: skip
    """``w = M z + q`` from the velocity that z gives, whose rounding is not squared."""
    change = np.zeros(rows.shape[1])
    for row in range(len(unknown)):
        change += unknown[row] * give[row]
    for row in range(len(unknown)):
        slack[row] = offset[row] + np.dot(rows[row], change) + np.dot(cone[row], unknown)


@inner
def _refined(
    rows: Floats, give: Floats, cone: Floats, offset: Floats, inverse: Floats, basis: Integers, unknown: Floats
) -> float:
    """Unknowns of a basis, made right by its residuals; returns by how much they miss the problem.

    Contacts that almost face each other are as badly conditioned in ``M = N A N^T`` as the square of ``N`` is.
    """
    used = len(unknown)
    slack = np.empty(used)
    for _ in range(_REFINEMENTS):
        _slacks(rows, give, cone, offset, unknown, slack)
        for column in basis:
            if column < used:
                slack[column] = 0.0
        for row in range(used):
            if used <= basis[row] < 2 * used:
                unknown[basis[row] - used] += np.dot(inverse[row], slack)
    _slacks(rows, give, cone, offset, unknown, slack)
    missed, largest = max(-slack.min(), -unknown.min()), unknown.max()
    for row in range(used):
        missed = max(missed, min(abs(slack[row]), abs(unknown[row])))
        if unknown[row] < _TIE * largest:
            unknown[row] = 0.0
    return float(missed)


@inner
def _unknowns(
    normal: Floats, tangent: Floats, target: Floats, admittance: Floats, friction: float, velocity: Floats,
    rows: Floats, offset: Floats, scale: Floats, owner: Integers, kind: Integers, cone: Floats,
) -> int:  # fmt: skip
    """What is looked for: of each contact ``f_n``, and with friction both sides of ``f_t`` and the slip; how many.

    Forces are in units in which each alone has an admittance of 1: rows of unit size, offsets without force, and a
    cone that ties the kinds together.
    """
    used, size = 0, max(np.abs(normal).max(), np.abs(tangent).max())
    for k in range(len(normal)):
        if np.abs(normal[k]).max() <= _LEAST_MOBILITY * size:
            continue
        first = used
        for part in range(4 if friction > 0.0 and np.abs(tangent[k]).max() > _LEAST_MOBILITY * size else 1):
            owner[used], kind[used], scale[used] = k, part, scale[used - 1]
            if part < 3:
                row = normal[k] if part == 0 else tangent[k]
                scale[used] = 1.0 / np.sqrt(np.dot(row @ admittance, row))
                rows[used] = row * (-scale[used] if part == 2 else scale[used])
                offset[used] = np.dot(rows[used], velocity) - (target[k] * scale[used] if part == 0 else 0.0)
            used += 1
        if used > first + 1:
            slip = first + 3
            cone[first + 1, slip] = cone[first + 2, slip] = 1.0
            cone[slip, first + 1] = cone[slip, first + 2] = -1.0
            cone[slip, first] = friction * scale[first] / scale[slip]
    return used


@njit(cache=True)
def resolve_contacts(
    normal: Floats, tangent: Floats, target: Floats, admittance: Floats, friction: float, velocity: Floats,
    force: Floats,
) -> bool:  # fmt: skip
    """Contact forces that keep ``n . J qdot >= target``, with Coulomb friction; ``velocity`` is changed in place.

    The complementarity problem ``0 <= f_n, n . J qdot - target >= 0``, one of them 0, and ``|f_t| <= mu f_n``, opposing
    ``t . J qdot``; in the plane the cone of friction is a wedge, so this is linear.  ``force[k]`` ends as normal and
    tangential force.  A contact whose force could not move the robot is left out.  Returns whether a solution was found
    to 1e-6 of the velocity; with targets that are not positive there is one.
    """
    most, ndim = 4 * len(normal), normal.shape[1]
    rows, offset, scale, cone = np.zeros((most, ndim)), np.zeros(most), np.empty(most), np.zeros((most, most))
    owner, kind = np.empty(most, np.int64), np.empty(most, np.int64)
    force[:] = 0.0
    used = _unknowns(
        normal, tangent, target, admittance, friction, velocity, rows, offset, scale, owner, kind, cone
    )  # fmt: skip
    rows, offset, cone = rows[:used], offset[:used], np.ascontiguousarray(cone[:used, :used])
    largest = np.abs(offset).max() if used else 0.0
    if largest == 0.0:
        return True
    give, unknown = rows @ admittance, np.zeros(used)
    inverse, basis = np.empty((used, used)), np.empty(used, np.int64)
    if not complementary(give @ rows.T + cone, offset / largest, inverse, basis):
        return False
    missed = _refined(rows, give, cone, offset, inverse, basis, unknown)
    for row in range(used):
        if kind[row] < 3:
            velocity += unknown[row] * give[row]
            force[owner[row], min(kind[row], 1)] += (-unknown[row] if kind[row] == 2 else unknown[row]) * scale[row]
    return missed <= _CLOSED * largest
