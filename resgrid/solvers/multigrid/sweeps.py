"""Smoother and grid transfers of multigrid on red-black grids, as wavefront sweeps over slabs of cells.

Slabs are whole blocks of cells. Two neighbouring slabs compute the red values that both need, with equal results. No
slab reads other values that another one writes. Sums are kept per block and added in a fixed order after all slabs; so
are couplings, edges across no face, which join arbitrary cells. The results are therefore bitwise equal for any
division into slabs. Arrays over one colour have shape (slots,); red and black cells both have indices from 0 in them.
"""

from __future__ import annotations

from typing import cast

import numpy as np

from resgrid._internal.jit import ZERO, inner, inner_fast
from resgrid.solvers.llvm_intrinsics import doubles, indices, singles
from resgrid.solvers.multigrid.levels import (
    Row,
    Slab,
    blocks_ahead,
    combine,
    copy,
    extent,
    first_coupling,
    multiply_faces,
    multiply_red,
    scale,
    take_step,
)
from resgrid.solvers.multigrid.red_black import BLACK, relax
from resgrid.solvers.scaled import Indices, Reals, Singles

CLEAR, ELIMINATE, RESTRICT, RELAX, PROLONG, COMBINE, BACK_SUBSTITUTE, STEP, MULTIPLY = (
    cast(int, np.int64(k)) for k in range(9)
)
"""The kinds of sweeps over a grid; variables and not literals, for which numba would compile the code once per kind.

Names in double backticks are fields of the grid's record (`levels.GRID`); ``S = D - G^T R G`` is the Schur complement
of the black cells, with the black diagonal ``D``, conductances ``G`` from black to red cells, and reciprocal red
diagonal ``R``. Four kinds sweep from red to black cells. `ELIMINATE` eliminates the red cells: the black residual goes
to ``r``, the residual times the reciprocal diagonal to ``before``. `RESTRICT` adds the residual after relaxation, ``r -
S before``, which is ``G^T R G before``, to ``below_rhs``. `RELAX` sets ``z`` to ``(r + G^T R G before) / D``, a Jacobi
step from ``before``. `MULTIPLY` writes ``S z`` to ``s`` after the first direction of a K-cycle, else to ``w``, and the
inner products ``z.r, z.w, z.s`` of every block to ``sums``.

`BACK_SUBSTITUTE` computes the red cells ``red`` from ``before``. The others work cell by cell. `PROLONG` adds
``below_x`` to ``before``. `STEP` subtracts the first of the ``coefficients`` times ``s`` from ``r``, writes ``|r|^2``
of every block before and after to ``sums``, copies ``z`` to ``c``, and sets ``before`` to ``r`` times the reciprocal
diagonal. `COMBINE` sets ``before`` to the sum of ``c`` and ``z``, multiplied by the first and the second of the
``coefficients``. `CLEAR` sets ``below_rhs`` to 0, as do `ELIMINATE` and `STEP`.
"""


@inner
def sweep_black(level: Row, kind: int, slab: Slab) -> None:
    """Eliminate, restrict or relax on the black cells of one slab (a part of a grid for one thread).

    `ELIMINATE` writes the residual ``r`` and the relaxed residual ``before`` of the record at black cells, `RELAX`
    writes the correction ``z`` there, and `RESTRICT` adds the residual after relaxation to the next level's right-hand
    side, ``below_rhs``. Red values are computed first, into ``w``. Couplings (edges that cross no face) contribute to
    red cells only; `add_couplings` adds those at black cells afterwards. `level`: record of the grid; `kind`:
    `ELIMINATE`, `RESTRICT` or `RELAX`; `slab`: range of blocks of cells.
    """
    slots, ahead = level.slots, blocks_ahead(level)
    before, r, z = singles(level.before, slots), singles(level.r, slots), singles(level.z, slots)
    inverse, rhs = singles(level.black_inverse, slots), singles(level.black_rhs, slots)
    red_inverse, red_rhs = singles(level.red_inverse, slots), singles(level.red_rhs, slots)
    aggregate, coarse = indices(level.aggregate, slots), singles(level.below_rhs, level.below_slots)
    red, total, begin, last = singles(level.w, slots), singles(slab.buffer, level.block), slab.first - ahead, slab.last
    if kind == RESTRICT:
        last = -(-(slab.end - level.margin) // level.block)
    coupling = first_coupling(level, max(begin, 0))
    for step in range(max(begin, 0), max(last, slab.last) + ahead):
        if step < level.blocks:
            at, count = extent(level, step)
            if kind == ELIMINATE:
                scale(red_inverse, red_rhs, at, at, count, red)
            else:
                coupling = multiply_red(level, step, before, coupling, total)
                scale(red_inverse, total, ZERO, at, count, red)
        block = step - ahead
        if not slab.first <= block < last:
            continue
        at, count = extent(level, block)
        multiply_faces(level, BLACK, red, block, total)
        if kind == ELIMINATE:
            _add_rhs(inverse, rhs, total, at, count, r, before)
        elif kind == RELAX:
            relax(inverse, r, at, count, total, z)
        elif slab.begin < at + count:
            skipped = max(slab.begin - at, 0)
            _add_to_nodes(aggregate, at + skipped, min(count, slab.end - at) - skipped, total, skipped, coarse)


@inner_fast
def _add_rhs(
    inverse: Singles, rhs: Singles, total: Singles, begin: int, count: int, r: Singles, before: Singles
) -> None:
    """Set ``r = total + rhs`` and ``before = inverse r`` on ``count`` entries from ``begin`` on.

    `inverse, rhs, r, before` (slots,): reciprocal diagonal, right-hand side, residual, and relaxed residual of the
    black cells; `total` (block,): currents from neighbours into the ``count`` cells.
    """
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        v = total[np.uint64(i)] + rhs[k]
        r[k] = v
        before[k] = inverse[k] * v


@inner
def _add_to_nodes(aggregate: Indices, begin: int, count: int, total: Singles, skipped: int, coarse: Singles) -> None:
    """Restrict: add ``total[skipped:skipped + count]`` to ``coarse``, at nodes of ``count`` cells from ``begin`` on.

    `aggregate` (slots,): index in ``coarse`` of the node of every black cell, 0 for none; `begin`: index of the first
    cell in arrays over the black cells; `total` (block,): residuals of the cells of a block; `coarse`: right-hand side
    of the next level, with red nodes before black ones if that level is a grid; its entry 0 belongs to no node.
    """
    at, t_at = np.uint64(begin), np.uint64(skipped)
    for i in range(count):
        k = np.uint64(i)
        coarse[np.uint32(aggregate[at + k])] += total[t_at + k]


@inner
def multiply(level: Row, slab: Slab, product: Singles) -> None:
    """Set ``product = S z`` on one slab, without couplings; write ``z.r, z.w, z.s`` of every block to ``level.sums``.

    ``S`` is the Schur complement of the black cells; ``r``, ``s`` and ``z`` are fields of the record (residual, first
    product of the K-cycle, correction), ``w`` is the product. Couplings are edges that cross no face of the grid.
    `level`: record of the grid; `slab`: range of blocks of cells; `product` (slots,): receives the product.
    """
    slots, ahead, inverse = level.slots, blocks_ahead(level), singles(level.red_inverse, level.slots)
    r, s, z = singles(level.r, slots), singles(level.s, slots), singles(level.z, slots)
    degree, red, total = (
        doubles(level.degree, slots),
        doubles(level.red_double, slots),
        doubles(slab.buffer, level.block),
    )
    sums, begin = doubles(level.sums, 3 * level.blocks), max(slab.first - ahead, 0)
    coupling = first_coupling(level, begin)
    for step in range(begin, slab.last + ahead):
        if step < level.blocks:
            at, count = extent(level, step)
            coupling = multiply_red(level, step, z, coupling, total)
            scale(inverse, total, ZERO, at, count, red)
        block = step - ahead
        if slab.first <= block:
            at, count = extent(level, block)
            multiply_faces(level, BLACK, red, block, total)
            k, sum_of = 3 * block, _multiply(degree, z, r, s, at, count, total, product)
            sums[k], sums[k + 1], sums[k + 2] = sum_of


@inner_fast
def _multiply(
    degree: Reals, z: Singles, r: Singles, s: Singles, begin: int, count: int, total: Reals, w: Singles
) -> tuple[float, float, float]:
    """Set ``w = degree z - total`` on ``count`` entries from ``begin`` on; return ``z.r, z.w, z.s`` over these entries.

    `degree` (slots,): black diagonal; `total` (block,): currents from neighbours; `z, r, s, w` (slots,): vectors over
    the black cells.
    """
    a, b, c = 0.0, 0.0, 0.0
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        one = np.float64(z[k])
        v = degree[k] * one - total[np.uint64(i)]
        w[k] = v
        a += one * r[k]
        b += one * v
        c += one * s[k]
    return a, b, c


@inner
def add_couplings(level: Row, kind: int, product: Singles) -> float:
    """Add the couplings to the results of a sweep over black cells, after all slabs; return the decrease of ``z.w``.

    Couplings are edges that cross no face of the grid; a slab is a part of the grid that one thread sweeps over.
    `level`: record of the grid, whose field ``w`` holds the red values; `kind`: kind of the sweep. `ELIMINATE` adds the
    currents through couplings to the residual ``r`` of the record and updates the relaxed residual ``before``;
    `RESTRICT` adds them to the next level's right-hand side ``below_rhs``, and `RELAX` adds their relaxation to the
    correction ``z``. Any other kind must be `MULTIPLY`, which subtracts them from `product`.

    `product` (slots,): product ``w`` of the matrix with ``z`` over the black cells, for `MULTIPLY` only. The result is
    the decrease of the inner product ``z.w`` due to the couplings, for `MULTIPLY`; 0 for the other kinds.
    """
    slots, joined, decrease = level.slots, level.joined, 0.0
    off_red, off_black = indices(level.off_red, joined), indices(level.off_black, joined)
    g, red, red_double = singles(level.couplings, joined), singles(level.w, slots), doubles(level.red_double, slots)
    before, r, z = singles(level.before, slots), singles(level.r, slots), singles(level.z, slots)
    inverse, aggregate = singles(level.black_inverse, slots), indices(level.aggregate, slots)
    coarse = singles(level.below_rhs, level.below_slots)
    for m in range(joined):
        black, inflow = off_black[m], g[m] * red[off_red[m]]
        if kind == ELIMINATE:
            r[black] += inflow
            before[black] = inverse[black] * r[black]
        elif kind == RESTRICT:
            coarse[aggregate[black]] += inflow
        elif kind == RELAX:
            z[black] += inverse[black] * inflow
        else:
            product[black] -= g[m] * red_double[off_red[m]]
            decrease += z[black] * g[m] * red_double[off_red[m]]
    coarse[0] = 0.0
    return decrease


@inner
def back_substitute(level: Row, slab: Slab) -> None:
    """Compute the red cells of one slab, ``red``, from the solution at black cells, ``before``; both are in the record.

    `level`: record of the grid; `slab`: range of blocks of cells.
    """
    slots, total, coupling = level.slots, singles(slab.buffer, level.block), first_coupling(level, slab.first)
    before, inverse = singles(level.before, slots), singles(level.red_inverse, slots)
    rhs, red = singles(level.red_rhs, slots), singles(level.red, slots)
    for block in range(slab.first, slab.last):
        at, count = extent(level, block)
        coupling = multiply_red(level, block, before, coupling, total)
        relax(inverse, rhs, at, count, total, red)


@inner
def update_slots(level: Row, kind: int, slab: Slab) -> None:
    """Prolong, combine or take a step on the black cells of one slab, cell by cell.

    Names in double backticks are fields of the record. The vector ``before`` holds the approximate solution: the
    relaxed residual, then with corrections, finally the solution. `PROLONG` adds the next level's solution to it.
    `COMBINE` sets it to the sum of both search directions ``c`` and ``z``, multiplied by both ``coefficients``. `STEP`
    subtracts the first of the ``coefficients`` times ``s``, the product of the matrix with ``z``, from the residual
    ``r``. It also copies ``z`` to ``c``, sets ``before`` to ``r`` times the reciprocal diagonal, and writes ``|r|^2``
    before and after the step to ``sums``, per block. `level`: record of the grid; `kind`: `PROLONG`, `COMBINE` or
    `STEP`; `slab`: range of blocks of cells.
    """
    slots, coefficients, sums = level.slots, doubles(level.coefficients, 2), doubles(level.sums, 3 * level.blocks)
    r, s, z, c = singles(level.r, slots), singles(level.s, slots), singles(level.z, slots), singles(level.c, slots)
    inverse, before = singles(level.black_inverse, slots), singles(level.before, slots)
    aggregate, coarse = indices(level.aggregate, slots), singles(level.below_x, level.below_slots)
    on_c, on_z = np.float32(coefficients[0]), np.float32(coefficients[1])
    for block in range(slab.first, slab.last):
        begin, count = extent(level, block)
        if kind == PROLONG:
            _add_from_nodes(aggregate, begin, count, coarse, before)
        elif kind == COMBINE:
            combine(z, c, on_c, on_z, begin, count, before)
        else:
            sums[3 * block], sums[3 * block + 1] = take_step(r, s, on_c, begin, count)
            sums[3 * block + 2] = 0.0
            copy(z, begin, count, c)
            scale(inverse, r, begin, begin, count, before)


@inner
def _add_from_nodes(aggregate: Indices, begin: int, count: int, coarse: Singles, total: Singles) -> None:
    """Prolong: add to ``total``, on ``count`` entries from ``begin`` on, the values of the cells' coarse nodes.

    `aggregate` (slots,): index in ``coarse`` of the node of every black cell, 0 for none; `coarse`: solution on the
    next level, with red nodes before black ones if that level is a grid; its entry 0 is 0; `total` (slots,): values of
    black cells.
    """
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        total[k] += coarse[np.uint32(aggregate[k])]
