"""Kernels for the vectors of conjugate gradients, and residuals of grids."""

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
"""Number of preconditioned residuals that are kept before they are accumulated in the solution."""


class Vectors(NamedTuple):
    """Vectors of the iteration.

    `inverse` (slots,): reciprocal diagonal; `r, s, w` (slots,): residual, ``A p`` and ``A z``; `before` (slots,): the
    residual, relaxed from zero; `z` (depth, slots): preconditioned residuals that are not yet part of the solution; `p`
    (slots,): search direction before them.
    """

    inverse: Singles
    r: Singles
    s: Singles
    w: Singles
    before: Singles
    z: Singles
    p: Floats


def vectors_over(inverse: Singles) -> Vectors:
    """Allocate vectors, with residual and direction 0."""
    slots = len(inverse)
    r, s, w, before = np.zeros((4, slots), dtype=np.float32)
    return Vectors(inverse, r, s, w, before, np.empty((_DEPTH, slots), dtype=np.float32), np.zeros(slots))


def norm(x: Floats, threads: ThreadTeam = SINGLE_THREAD) -> float:
    """Return the Euclidean norm, which does not depend on the number of threads."""
    return math.sqrt(sum(threads.over(len(x), lambda some: squares(x[some]))))


@kernel_fast
def squares(x: Floats) -> float:
    """Return the sum of squares."""
    total = 0.0
    for i in range(len(x)):
        total += x[i] * x[i]
    return total


@kernel_fast
def advance(
    inverse: Singles, w: Singles, s: Singles, r: Singles, z: Singles, beta: float, alpha: float, begin: int, end: int
) -> float:
    """Set ``s = w + beta s``, ``r -= alpha s``, ``z = inverse r`` on some slots; returns ``|r|^2``."""
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
    """Set ``x += unit (on_x_p p + sum_j on_x_j z_j)``, then ``p = on_p_p p + sum_j on_p_j z_j``; ``z`` (steps, n)."""
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
    """Return the largest entry of the last search direction; ``z`` (steps, n)."""
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
    """Relax the red cells of ``x`` (2, slots) exactly; write the black residual to ``r`` (slots,), return its norm."""
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
    """Relax the red cells of some blocks exactly, or compute the residual at the black cells without black couplings.

    ``squares`` (blocks,) receives the sum of squared residuals per block; ``total`` (block,) is a work array.
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
    """Set ``r = b + total - degree x`` on a block; returns its sum of squares."""
    squares = 0.0
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        v = b[k] + (total[np.uint64(i)] - degree[k] * x[k])
        r[k] = v
        squares += v * v
    return squares
