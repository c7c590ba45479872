"""Kernels for the vectors of conjugate gradients, and residuals of grids.

Arrays over the cells of one colour have shape (slots,); red and black cells both have indices from 0 in them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from resgrid._internal.jit import inner_fast, kernel, kernel_fast
from resgrid.solvers.multigrid.levels import Slab, blocks_of, slabs_of
from resgrid.solvers.multigrid.red_black import BLACK, RED, Stencil, products, relax
from resgrid.solvers.scaled import Floats, Reals, Singles
from resgrid.solvers.threads import SINGLE_THREAD, ThreadTeam

_DEPTH = 3
"""Number of preconditioned residuals that are stored before they are added to the solution."""


class Vectors(NamedTuple):
    """Vectors of flexible conjugate gradients, over the black cells of a grid or the rows of a netlist.

    The matrix ``A`` is the Schur complement of the black cells of a grid, or the matrix of a netlist. `inverse` (n,):
    reciprocal diagonal; `r, s, w` (n,): residual, product ``A p`` for the search direction, and product ``A z`` for the
    newest preconditioned residual; `before` (n,): relaxed residual ``inverse * r``; `z` (3, n): preconditioned
    residuals that are not yet added to the solution; `p` (n,): search direction before these residuals.
    """

    inverse: Singles
    r: Singles
    s: Singles
    w: Singles
    before: Singles
    z: Singles
    p: Floats


def vectors_over(inverse: Singles) -> Vectors:
    """Return new vectors of conjugate gradients for the reciprocal diagonal `inverse` (n,), which is not copied.

    `r`, `s`, `w`, `before` and `p` are 0; the stored preconditioned residuals `z` (3, n) are not initialized.
    """
    slots = len(inverse)
    r, s, w, before = np.zeros((4, slots), dtype=np.float32)
    return Vectors(inverse, r, s, w, before, np.empty((_DEPTH, slots), dtype=np.float32), np.zeros(slots))


def norm(x: Floats, threads: ThreadTeam = SINGLE_THREAD) -> float:
    """Return the Euclidean norm of ``x`` (n,), with bitwise equal results for any number of threads."""
    return math.sqrt(sum(threads.over(len(x), lambda some: squares(x[some]))))


@kernel_fast
def squares(x: Floats) -> float:
    """Return the sum of the squares of ``x`` (n,)."""
    total = 0.0
    for i in range(len(x)):
        total += x[i] * x[i]
    return total


@kernel_fast
def advance(
    inverse: Singles, w: Singles, s: Singles, r: Singles, z: Singles, beta: float, alpha: float, begin: int, end: int
) -> float:
    """Set ``s = w + beta s``, ``r -= alpha s``, ``z = inverse r`` on ``begin`` to ``end - 1``; return ``|r|^2`` there.

    `inverse` (n,): reciprocal diagonal; `w, s` (n,): products of the matrix with the newest preconditioned residual and
    with the search direction; `r` (n,): residual; `z` (n,): relaxed residual; `beta`: coefficient of the previous
    search direction; `alpha`: step length.
    """
    squares = 0.0
    for k in range(begin, end):
        product = w[k] + beta * s[k]
        s[k] = product
        new = np.float32(r[k] - alpha * product)
        r[k] = new
        z[k] = inverse[k] * new
        squares += np.float64(new) * np.float64(new)
    return squares


@kernel_fast
def add_steps(z: Singles, on_x: Floats, on_p: Floats, p: Floats, unit: float, x: Floats, begin: int, end: int) -> None:
    """Add stored vectors ``z`` to solution ``x`` and search direction ``p`` on entries ``begin`` to ``end - 1``.

    ``x += unit (on_x[-1] p + sum_j on_x[j] z[j])``, then ``p = on_p[-1] p + sum_j on_p[j] z[j]``.

    `z` (steps, n): preconditioned residuals of the last iterations, divided by `unit`; `on_x, on_p` (depth + 1,), where
    depth is the largest number of steps: coefficients in the solution and in the search direction; `p` (n,): search
    direction, divided by `unit`; `x` (n,): solution; `unit`: norm of the residual by which vectors are divided.
    """
    before_x, before_p = on_x[-1], on_p[-1]
    for k in range(begin, end):
        ahead, far = before_p * p[k], before_x * p[k]
        for j in range(len(z)):
            value = np.float64(z[j, k])
            ahead += on_p[j] * value
            far += on_x[j] * value
        p[k] = ahead
        x[k] += unit * far


def largest_step(z: Singles, on_p: Floats, p: Floats) -> float:
    """Return the largest magnitude of an entry of the newest search direction ``on_p[-1] p + sum_j on_p[j] z[j]``.

    All vectors and the result are divided by the residual norm at the begin of the burst of iterations. `z` (steps, n):
    preconditioned residuals of the last iterations; `on_p` (depth + 1,), where depth is the largest number of steps:
    coefficients; `p` (n,): search direction before these iterations.
    """
    ahead = on_p[-1] * p
    for coefficient, vector in zip(on_p.tolist(), z, strict=False):
        ahead += coefficient * vector
    return float(np.abs(ahead, out=ahead).max())


def black_residual(
    stencil: Stencil,
    b: Floats,
    x: Floats,
    r: Floats,
    parts: list[Slab] | None = None,
    threads: ThreadTeam = SINGLE_THREAD,
) -> float:
    """Relax the red cells of ``x`` exactly, write the residual at black cells to ``r``, and return its Euclidean norm.

    `stencil`: conductances in double precision, divided by ``hierarchy.unit``; `b, x` (2, slots): right-hand side in
    amperes divided by this unit, and solution in volts, with red cells in row 0 and black ones in row 1; `r` (slots,):
    residual, like the right-hand side; `parts`: slabs of the grid, None for a single one; `threads`: process the slabs.
    """
    parts = slabs_of(stencil, 1) if parts is None else parts
    squares, margin = np.empty(blocks_of(stencil)), int(stencil.margin)
    for colour in (RED, BLACK):

        def sweep(part: int, of: int = colour) -> None:
            sweep_colour(stencil, of, b, x, r, squares, np.empty(stencil.block), parts[part][:2])

        threads.run_parts(sweep, len(parts))
    r[:margin], r[len(r) - margin :] = 0.0, 0.0
    if not len(stencil.couplings):
        return math.sqrt(squares.sum())
    np.add.at(r, stencil.off_black, stencil.couplings * x[0, stencil.off_red])
    return norm(r)


@kernel
def sweep_colour(
    stencil: Stencil, colour: int, b: Floats, x: Floats, r: Floats, squares: Floats, total: Floats,
    blocks: tuple[int, int],
) -> None:  # fmt: skip
    """Relax the red cells of some blocks exactly, or compute the residual at the black cells.

    Couplings (edges that cross no face of the grid) contribute to red cells only; `black_residual` adds those at black
    cells. `stencil`: conductances; `colour`: RED to relax, BLACK for the residual; `b, x` (2, slots): right-hand side
    and solution, with red cells in row 0 and black ones in row 1; `r` (slots,): receives the residual; `squares`
    (blocks,): receives the sum of squared residuals of every block; `total` (block,): work array; `blocks`: first
    block, and block after the last.
    """
    there, margin, coupling, (first, last) = x[1 - colour], stencil.margin, 0, blocks
    while coupling < len(stencil.couplings) and stencil.off_red[coupling] < margin + first * stencil.block:
        coupling += 1
    for block in range(first, last):
        at = margin + block * stencil.block
        count = min(stencil.block, stencil.faces.shape[1] - margin - at)
        products(stencil.faces, stencil.distance, (colour, at, count), there, total)
        if colour == BLACK:
            squares[block] = _subtract(stencil.black_degree, b[1], x[1], at, count, total, r)
            continue
        while coupling < len(stencil.couplings) and stencil.off_red[coupling] < at + count:
            total[stencil.off_red[coupling] - at] += stencil.couplings[coupling] * there[stencil.off_black[coupling]]
            coupling += 1
        relax(stencil.red_inverse, b[0], at, count, total, x[0])


@inner_fast
def _subtract(degree: Reals, b: Reals, x: Reals, begin: int, count: int, total: Reals, r: Reals) -> float:
    """Set ``r = b + total - degree x`` on ``count`` entries from ``begin`` on; return ``|r|^2`` over these entries.

    `degree, b, x, r` (slots,): diagonal, right-hand side, solution and residual over the cells of a colour; `total`
    (block,): currents from neighbours, of the ``count`` cells.
    """
    squares = 0.0
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        v = b[k] + (total[np.uint64(i)] - degree[k] * x[k])
        r[k] = v
        squares += v * v
    return squares
