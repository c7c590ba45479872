"""Compiled sweeps over one slab of a grid, so that several threads share a level.

They leave the digits that one thread leaves (`resgrid.solvers.multigrid.cycle`), however a level is cut.  Slabs are
whole blocks; red values that two slabs need are found by both; no slab reads what another one writes; sums are kept
block by block, and added in one order behind all slabs.  What couplings carry from anywhere to anywhere is noted by the
slabs, and added behind them (`finish_...`).
"""

from __future__ import annotations

import numpy as np

from resgrid.jit import ZERO, inner, kernel
from resgrid.solvers.multigrid.cycle import CHUNK, combine, keep_step, take_step
from resgrid.solvers.multigrid.red_black import (
    BLACK,
    Floats,
    Indices,
    Reals,
    Singles,
    Stencil,
    blocks_of,
    draw,
    draw_into,
    extent,
    relax,
    relax_red_blocks,
)
from resgrid.solvers.multigrid.subnormals import flush_subnormals, restore_subnormals
from resgrid.solvers.multigrid.sweeps import (
    Slab,
    add_from_nodes,
    blocks_ahead,
    finish_residual,
    lead,
    make_room,
    multiply_couplings,
    open_window,
    products,
    relax_couplings,
    residual_slab,
    restrict_couplings,
    restrict_slab,
)


@kernel
def eliminate_part(
    stencil: Stencil, red_fed: Singles, black_fed: Singles, slab: Slab, f: Singles, z: Singles, share: Singles
) -> None:
    """What black cells are due, red ones eliminated, and ``z`` relaxed from zero; clears a share of the next level."""
    flags = flush_subnormals()
    share[:] = 0.0
    total, ahead = np.empty(stencil.block, f.dtype), blocks_ahead(stencil)
    begin = max(slab.first - ahead, 0)
    window = open_window(stencil, begin)
    for step in range(begin, slab.last + ahead):
        to = make_room(stencil, window, step)
        if step < blocks_of(stencil):
            at, count = extent(stencil, step)
            for k in range(count):
                window.red[to + k] = stencil.red_inverse[at + k] * red_fed[at + k]
        block = step - ahead
        if block >= slab.first:
            at, count = extent(stencil, block)
            draw_into(stencil, BLACK, window.red, window.at[0], block, total, ZERO)
            for k in range(count):
                f[at + k] = total[k] + black_fed[at + k]
                z[at + k] = stencil.black_inverse[at + k] * f[at + k]
    restore_subnormals(flags)


@kernel
def finish_eliminating(stencil: Stencil, red_fed: Singles, f: Singles, z: Singles) -> None:
    """What couplings carry, behind all slabs."""
    flags = flush_subnormals()
    for m in range(len(stencil.couplings)):
        red, black = stencil.off_red[m], stencil.off_black[m]
        value = np.float32(stencil.red_inverse[red] * red_fed[red])
        f[black] += stencil.couplings[m] * value
    for m in range(len(stencil.couplings)):
        black = stencil.off_black[m]
        z[black] = stencil.black_inverse[black] * f[black]
    restore_subnormals(flags)


@kernel
def relax_from_zero(inverse: Singles, r: Singles, z: Singles, begin: int, end: int, share: Singles) -> None:
    """``z = inverse r`` on some slots; clears a share of the next level."""
    flags = flush_subnormals()
    share[:] = 0.0
    for k in range(begin, end):
        z[k] = inverse[k] * r[k]
    restore_subnormals(flags)


@kernel
def restrict_part(
    stencil: Stencil, aggregate: Indices, weight: Singles, z: Singles, slab: Slab, noted: Singles, coarse: Singles
) -> None:
    """`sweeps.restrict`, into nodes that come as 0."""
    flags = flush_subnormals()
    _note_own(stencil, slab, restrict_slab(stencil, aggregate, weight, z, slab, coarse), noted)
    restore_subnormals(flags)


@kernel
def finish_restricting(stencil: Stencil, aggregate: Indices, weight: Singles, noted: Singles, coarse: Singles) -> None:
    """What couplings carry, behind all slabs."""
    flags = flush_subnormals()
    restrict_couplings(stencil, aggregate, weight, noted, coarse)
    restore_subnormals(flags)


@kernel
def relax_part(
    stencil: Stencil, way: tuple[Indices, Singles, Singles], r: Singles, before: Singles, slab: Slab, own: Singles,
    noted: Singles, z: Singles,
) -> None:  # fmt: skip
    """The first half of `sweeps.prolong_and_multiply`, from ``before`` into ``z``.

    ``way``: aggregates, their weights, and the next level's answer; ``own`` (slots,): work space of this slab, 0 in the
    margins.
    """
    flags = flush_subnormals()
    aggregate, weight, coarse = way
    total, ahead = np.empty(stencil.block, z.dtype), blocks_ahead(stencil)
    begin = max(slab.first - ahead, 0)
    window = open_window(stencil, begin)
    for m in range(len(stencil.couplings)):
        add_from_nodes(aggregate, weight, stencil.off_black[m], 1, coarse, before, own)
    draw(stencil, own, window.coupled)
    for step in range(max(begin - ahead, 0), slab.last + 2 * ahead):
        if step < blocks_of(stencil):
            at, count = extent(stencil, step)
            add_from_nodes(aggregate, weight, at, count, coarse, before, own)
        if step - ahead >= begin:
            lead(stencil, window, own, step - ahead)
        block = step - 2 * ahead
        if block >= slab.first:
            at, count = extent(stencil, block)
            draw_into(stencil, BLACK, window.red, window.at[0], block, total, ZERO)
            relax(stencil.black_inverse, r, at, count, total, z)
    _note_own(stencil, slab, window.coupled, noted)
    restore_subnormals(flags)


@kernel
def finish_relaxing(stencil: Stencil, noted: Singles, z: Singles) -> None:
    """What couplings carry, behind all slabs."""
    flags = flush_subnormals()
    relax_couplings(stencil, noted, z)
    restore_subnormals(flags)


@kernel
def multiply_part(
    exact: Stencil, z: Singles, r: Singles, s: Singles, slab: Slab, noted: Reals, w: Singles, sums: Floats
) -> None:
    """The second half of `sweeps.prolong_and_multiply`; ``sums`` (blocks, 3) of ``z.r``, ``z.w``, ``z.s``."""
    flags = flush_subnormals()
    ahead = blocks_ahead(exact)
    begin = max(slab.first - ahead, 0)
    window = open_window(exact, begin)
    total = np.empty(exact.block, exact.black_degree.dtype)
    draw(exact, z, window.coupled)
    for step in range(begin, slab.last + ahead):
        lead(exact, window, z, step)
        block = step - ahead
        if block >= slab.first:
            at, count = extent(exact, block)
            draw_into(exact, BLACK, window.red, window.at[0], block, total, ZERO)
            sums[block, 0], sums[block, 1], sums[block, 2] = products(exact.black_degree, z, r, s, at, count, total, w)
    _note_own(exact, slab, window.coupled, noted)
    restore_subnormals(flags)


@kernel
def finish_multiplying(exact: Stencil, noted: Reals, z: Singles, w: Singles) -> float:
    """What couplings carry, behind all slabs; returns by how much ``z.w`` becomes less."""
    flags = flush_subnormals()
    less = multiply_couplings(exact, noted, z, w)
    restore_subnormals(flags)
    return less


@kernel
def take_part(r: Singles, v: Singles, step: float, chunks: tuple[int, int], sums: Floats) -> None:
    """`cycle.take_step` on some chunks of slots; ``sums`` (chunks, 2) of squares before and after."""
    flags = flush_subnormals()
    for chunk in range(*chunks):
        begin = chunk * CHUNK
        sums[chunk, 0], sums[chunk, 1] = take_step(r, v, np.float32(step), begin, min(begin + CHUNK, len(r)))
    restore_subnormals(flags)


@kernel
def keep_part(z: Singles, c: Singles, step: float, enough: bool, begin: int, end: int) -> None:
    """`cycle.keep_step` on some slots."""
    flags = flush_subnormals()
    keep_step(z, c, np.float32(step), enough, begin, end)
    restore_subnormals(flags)


@kernel
def combine_part(z: Singles, c: Singles, on_c: float, on_z: float, begin: int, end: int) -> None:
    """`cycle.combine` on some slots."""
    flags = flush_subnormals()
    combine(z, c, np.float32(on_c), np.float32(on_z), begin, end)
    restore_subnormals(flags)


@kernel
def put_back_part(stencil: Stencil, z: Singles, red_fed: Singles, slab: Slab, red: Singles, black: Singles) -> None:
    """Voltages of the black nodes, and of the red ones that follow."""
    flags = flush_subnormals()
    for block in range(slab.first, slab.last):
        at, count = extent(stencil, block)
        black[at : at + count] = z[at : at + count]
    relax_red_blocks(stencil, red_fed, z, slab.first, slab.last, red)
    restore_subnormals(flags)


@kernel
def residual_part(
    stencil: Stencil, b: Floats, x: Floats, r: Floats, slab: Slab, noted: Floats, squares: Floats
) -> None:
    """`sweeps.black_residual`; ``squares`` (blocks,) of every block, summed."""
    _note_own(stencil, slab, residual_slab(stencil, b, x, r, slab, squares), noted)


@kernel
def norm_of_residual(stencil: Stencil, noted: Floats, squares: Floats, r: Floats) -> float:
    """The rest of `sweeps.black_residual`, behind all slabs."""
    return finish_residual(stencil, noted, squares, r)


@inner
def _note_own(stencil: Stencil, slab: Slab, coupled: Reals, noted: Reals) -> None:
    """Hand on a slab's red values where couplings begin."""
    begin, end = stencil.margin + slab.first * stencil.block, stencil.margin + slab.last * stencil.block
    for m in range(len(coupled)):
        if begin <= stencil.off_red[m] < end:
            noted[m] = coupled[m]
