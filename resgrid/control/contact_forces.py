"""Contact forces: a linear complementarity problem, by pivoting (Lemke 1965; Cottle, Pang & Stone 1992, section 4.4).

The unknowns of a contact are its normal force and, with friction, the two directions of the tangential force and the
slip.  In the plane the friction cone is a wedge, so that the problem is linear.  With the unit normal ``n`` out of the
obstacle, the tangent ``t`` (``n`` turned left) and the Jacobian ``J`` of the robot's point, the rows ``n . J`` and ``t
. J`` give the normal and tangential velocity of the point for unit velocities of the axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Basis = tuple[NDArray[np.int64], Vector]
"""Lemke's basis for a problem of size n, as a pair of arrays: index of the variable of each row of the tableau, shape
(n,), and the matrix (n, n) from the right-hand side ``q`` to the values of these variables.

Indices 0 to n - 1 are the slacks ``w``, n to 2 n - 1 the unknowns ``z``, 2 n the artificial variable.
"""

_LEAST_MOBILITY = 1e-12
"""Limit below which contacts are ignored, as a fraction of the largest entry of the rows ``n . J`` and ``t . J``.

A contact is ignored if no entry of its row ``n . J`` exceeds the limit.  The friction of a contact is ignored if no
entry of its row ``t . J`` exceeds the limit.
"""
_LEAST_PIVOT = 1e-13
"""Smallest accepted pivot of Lemke's method, relative to the largest entry of the inverse basis."""
_TIE = 1e-12
"""Largest relative difference of two ratios of Lemke's method that count as equal.

Forces below this fraction of the largest force count as 0, too.
"""
_GONE = 1e-9
"""Largest value of Lemke's artificial variable that counts as 0, as a fraction of the largest entry of the right-hand
side ``q``.
"""
_CLOSED = 1e-6
"""Largest accepted residual of the complementarity problem, as a fraction of the largest entry of the right-hand side
``q``.
"""
_REFINEMENTS = 3
"""Number of steps of iterative refinement of the contact forces."""


def contact_forces(
    normal: Vector, tangent: Vector, target: Vector, velocity: Vector, admittance: Vector, friction: float
) -> tuple[Vector, Vector, bool]:
    """Return the velocity with contacts, the normal and tangential forces, and whether they are a solution.

    Conditions for the velocity ``qdot`` and the forces ``f_n, f_t`` of each contact: ``0 <= f_n, n . J qdot - target >=
    0``, one of them 0, and ``|f_t| <= mu f_n``, opposing ``t . J qdot``.  Contacts whose force cannot move the robot
    are ignored (force 0). The relative tolerance of the velocity is 1e-6.  A solution exists if no target is positive.
    Without a solution, velocity and forces are 0.

    `normal, tangent` (m, ndim): ``n . J`` and ``t . J`` of the m contacts, for the normals ``n``, tangents ``t`` and
    the Jacobian ``J`` of the touched point; `target` (m,): least rates at which the gaps must grow, in m/s; `velocity`
    (ndim,): command in axis coordinates, per second; `admittance` (ndim, ndim): velocity per generalised force;
    `friction`: friction coefficient ``mu``.  Shapes of the results: velocity (ndim,), forces (m, 2), normal first.
    """
    least = _LEAST_MOBILITY * max(np.abs(normal).max(initial=0.0), np.abs(tangent).max(initial=0.0))
    used = np.flatnonzero(np.abs(normal).max(axis=1) > least)
    rubs = np.flatnonzero((friction > 0.0) & (np.abs(tangent[used]).max(axis=1) > least))
    plus, minus, slip = len(used) + np.arange(3 * len(rubs)).reshape(3, -1)
    rows = np.zeros((len(used) + 3 * len(rubs), len(velocity)))
    rows[: len(used)], rows[plus], rows[minus] = normal[used], tangent[used[rubs]], -tangent[used[rubs]]
    # Scale velocity and admittance to 1, and each force to an admittance of 1.
    speed, most = float(np.abs(velocity).max(initial=0.0)) or 1.0, float(np.abs(admittance).max())
    give = rows @ (admittance / most)
    unit = np.sqrt((give * rows).sum(axis=1))
    unit[slip] = 1.0
    rows, give = rows / unit[:, np.newaxis], give / unit[:, np.newaxis]
    offset = rows @ (velocity / speed)
    offset[: len(used)] -= target[used] / (speed * unit[: len(used)])
    cone = np.zeros((len(rows), len(rows)))
    cone[plus, slip] = cone[minus, slip] = 1.0
    cone[slip, plus] = cone[slip, minus] = -1.0
    cone[slip, rubs] = friction * unit[plus] / unit[rubs]
    found = _solution(rows, give, cone, offset)
    forces = np.zeros((len(normal), 2))
    if found is None:
        return np.zeros_like(velocity), forces, False
    forces[used, 0] = found[: len(used)] / unit[: len(used)]
    most_tangential = friction * forces[used[rubs], 0]  # rounding may leave a force outside the friction cone
    forces[used[rubs], 1] = np.clip((found[plus] - found[minus]) / unit[plus], -most_tangential, most_tangential)
    return velocity + speed * (found @ give), forces * (speed / most), True


def _solution(rows: Vector, give: Vector, cone: Vector, offset: Vector) -> Vector | None:
    """Return ``z`` (u,) with ``z >= 0, w = M z + q >= 0, z . w = 0`` for ``M = rows give^T + cone``, or None.

    None means that no solution was found.  Iterative refinement evaluates ``M z`` by the factors of ``M``, because
    contacts that almost face each other give ``M = N A N^T`` the squared condition number of ``N``.  `rows` (u, ndim):
    contact Jacobian, one row per unknown, scaled so that a unit force gives a unit velocity, and 0 for slips; `give`
    (u, ndim): `rows` times the admittance; `cone` (u, u): conditions of the friction cones; `offset` (u,): ``q``.
    """
    size, z, w = len(offset), np.zeros(len(offset)), offset.copy()
    if w.min(initial=0.0) >= 0.0:
        return z
    largest = float(np.abs(offset).max())
    basis = _complementary(rows @ give.T + cone, offset / largest)
    if basis is None:
        return None
    column, inverse = basis
    free, held = column[column < size], (column >= size) & (column < 2 * size)
    for _ in range(_REFINEMENTS):
        w[free] = 0.0
        z[column[held] - size] += inverse[held] @ w
        w = rows @ (z @ give) + cone @ z + offset
    missed = max(-w.min(), -z.min(), np.minimum(np.abs(w), np.abs(z)).max())
    z[z < _TIE * z.max()] = 0.0
    return z if missed <= _CLOSED * largest else None


def _complementary(M: Vector, q: Vector) -> Basis | None:
    """Return a basis that solves ``z >= 0, w = M z + q >= 0, z . w = 0``, by Lemke's method; None without a solution.

    The basis is a pair of arrays: index of the variable of each row (n,), with 0 to n - 1 for the slacks ``w``, n to 2
    n - 1 for the unknowns ``z`` and 2 n for Lemke's artificial variable; and the matrix (n, n) from ``q`` to their
    values. `M` (n, n): copositive matrix; `q` (n,): right-hand side with a negative entry, scaled to a largest
    magnitude of 1.
    """
    size = len(q)
    basis, artificial = np.arange(size), 2 * size
    table = np.hstack([np.eye(size), -M, -np.ones((size, 1)), q[:, np.newaxis]])
    row, entering = int(np.argmin(q)), artificial
    for _ in range(50 * size):
        pivot = table[row] / table[row, entering]
        table -= np.outer(table[:, entering], pivot)
        table[row] = pivot
        leaving, basis[row] = basis[row], entering
        if leaving == artificial or np.any(table[basis == artificial, -1] <= _GONE):
            return basis, table[:, :size]
        entering = leaving + size if leaving < size else leaving - size
        bounding = _bounding_row(table, entering, basis)
        if bounding is None:
            return None
        row = bounding
    return None


def _bounding_row(table: Vector, entering: int, basis: NDArray[np.int64]) -> int | None:
    """Return the row of Lemke's tableau that bounds the entering variable (smallest ratio); None if no row does.

    The ratio is the right-hand side over the entry of the entering variable's column.  Ties are broken by the ratios of
    the inverse basis (lexicographic rule).  `table` (n, 2 n + 2): tableau; `entering`: number of the column; `basis`
    (n,): index of the variable of each row.
    """
    size = len(table)
    rows = np.flatnonzero(table[:, entering] > _LEAST_PIVOT * np.abs(table[:, :size]).max())
    for column in range(-1, size):
        if len(rows) < 2:
            break
        ratio = table[rows, column] / table[rows, entering]
        rows = rows[ratio <= ratio.min() + _TIE * (1.0 + abs(ratio.min()))]
        if column < 0 and np.any(basis[rows] == 2 * size):
            return int(rows[basis[rows] == 2 * size][0])
    return int(rows[0]) if len(rows) else None
