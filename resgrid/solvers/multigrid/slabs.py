"""The cycle's larger levels in slabs, which several threads sweep over: a finest grid, and the coarse ones next to it.

They leave the digits that one thread leaves (`resgrid.solvers.multigrid.cycle`), however a level is cut.  Slabs are
whole blocks; red values that two slabs need are found by both; no slab reads what another one writes; sums are kept
block by block, and added in one order behind all slabs.  What couplings carry from anywhere to anywhere is noted by the
slabs, and added behind them.  One thread leads, and the others help where there is a part to be done (`atomics`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from resgrid.jit import ZERO, inner, kernel
from resgrid.solvers.multigrid import atomics
from resgrid.solvers.multigrid.levels import CHUNK, Finest, Levels, combine, second_step, stencil_at, take_step
from resgrid.solvers.multigrid.red_black import (
    BLACK,
    Floats,
    Indices,
    Integers,
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

_CLEAR, _ELIMINATE, _RESTRICT, _RELAX, _MULTIPLY, _TAKE, _PUT_BACK = range(7)
"""The sweeps."""


class Crew(NamedTuple):
    """What threads share beside the levels.

    Levels are counted from the finest grid on.  `vectors`: the finest level's relaxed residual, the residual, ``A p``,
    the answer and its product (slots,); `state`: jobs (`atomics`); `slabs` (levels, parts, 4): as of `Slab`; `cuts`
    (levels,): how many there are; `own, own_at`: work space of every level's slabs (parts, slots), one behind the
    other, 0 in the margins, and where each level's begins; `noted, noted_exact` (couplings,): red values where
    couplings begin; `sums` (blocks, 3): of products, or of squares; `shares` (2,): what both directions of a K-cycle
    have in its answer, or the first step's length.
    """

    finest: Finest
    vectors: tuple[Singles, Singles, Singles, Singles, Singles]
    state: Integers
    slabs: Integers
    cuts: Integers
    own: Singles
    own_at: Integers
    noted: Singles
    noted_exact: Floats
    sums: Floats
    shares: Floats


@inner
def _sweep(crew: Crew, levels: Levels, kind: int, level: int, visit: int) -> None:
    """Sweep over a level together with whoever helps."""
    parts = crew.cuts[level]
    atomics.announce(crew.state, kind, level, visit, parts)
    while True:
        part = atomics.claim(crew.state)
        if part < 0:
            break
        _sweep_slab(crew, levels, kind, level, visit, part)
        atomics.finish(crew.state)
    atomics.wait_for(crew.state, parts)


@kernel
def help_sweep(crew: Crew, levels: Levels) -> None:
    """Sweep over slabs for the thread that leads, until it has no more."""
    flags, state = flush_subnormals(), crew.state
    while True:
        part = atomics.await_part(state)
        if part < 0:
            break
        _sweep_slab(crew, levels, state[atomics.KIND], state[atomics.LEVEL], state[atomics.VISIT], part)
        atomics.finish(state)
    restore_subnormals(flags)


@inner
def _sweep_slab(crew: Crew, levels: Levels, kind: int, level: int, visit: int, part: int) -> None:
    """A slab's part of a sweep."""
    (before, r, s, z, w), (grids, _, work), finest = crew.vectors, levels, crew.finest
    stencil, aggregate, weight, c = finest.stencil, finest.aggregate, finest.weight, z
    a, e = ZERO, ZERO
    if level > 0:
        a, e = grids.slots[level - 1], grids.slots[level]
        stencil, aggregate, weight = stencil_at(grids, level - 1), grids.aggregate[a:e], grids.weight[a:e]
        before, r, s, z, c = work.x[a + e : 2 * e], work.f[a:e], work.v[a:e], work.z[a:e], work.c[a:e]
        w = s if visit == 1 else work.w[a:e]
    slots, parts, slab = len(z), crew.cuts[level], _slab(crew, level, part)
    own = crew.own[crew.own_at[level] + part * slots : crew.own_at[level] + (part + 1) * slots]
    below = slice(2 * e, 2 * grids.slots[level + 1])
    if kind in (_CLEAR, _ELIMINATE, _TAKE):
        some = work.b[below]
        for k in range(part * len(some) // parts, (part + 1) * len(some) // parts):
            some[k] = 0.0
    if kind == _ELIMINATE:
        _eliminate(stencil, work.b[2 * a : a + e], work.b[a + e : 2 * e], slab, r, before)
    elif kind == _RESTRICT:
        coupled = restrict_slab(stencil, aggregate, weight, before, slab, work.b[below])
        _note_own(stencil, slab, coupled, crew.noted)
    elif kind == _RELAX:
        _relax(stencil, aggregate, weight, work.x[below], r, before, slab, own, crew.noted, z)
    elif kind == _MULTIPLY:
        if level == 0:
            _multiply(finest.exact, z, r, s, slab, crew.noted_exact, w, crew.sums)
        else:
            _multiply(stencil, z, r, s, slab, crew.noted, w, crew.sums)
    elif kind == _TAKE:
        _take(stencil.black_inverse, z, r, s, c, before, part, parts, crew.sums, crew.shares)
    elif kind == _PUT_BACK:
        fed, red = work.b[2 * a : a + e], work.x[2 * a : a + e]
        _put_back(stencil, z, c, np.float32(crew.shares[0]), np.float32(crew.shares[1]), fed, slab, own, red, before)


@inner
def _slab(crew: Crew, level: int, part: int) -> Slab:
    first, last, begin, end = crew.slabs[level, part]
    return Slab(first, last, begin, end)


@inner
def visit_slabs(crew: Crew, levels: Levels, level: int, visit: tuple[int, Floats], stop: float) -> bool:
    """As a visit of a grid in one piece; ``level`` counts from the finest one on."""
    count, first = visit
    if count == 0:
        _sweep(crew, levels, _ELIMINATE, level, count)
        _finish_eliminating(levels, level)
    else:
        rest, product, gamma = up(crew, levels, level, count)
        crew.shares[0], crew.shares[1] = 0.0, 1.0
        if count == 1:
            first[0], first[1] = rest, product
        if count > 1:
            crew.shares[0], crew.shares[1] = second_step(first[0], first[1], rest, product, gamma)
        elif product > 0.0:
            crew.shares[0], crew.shares[1] = rest / product, 0.0
            _sweep(crew, levels, _TAKE, level, count)
            squares, left = 0.0, 0.0
            for chunk in range(-(-(levels.grids.slots[level] - levels.grids.slots[level - 1]) // CHUNK)):
                squares, left = squares + crew.sums[chunk, 0], left + crew.sums[chunk, 1]
            if left > stop * stop * squares:
                down(crew, levels, level)
                return False
        _sweep(crew, levels, _PUT_BACK, level, count)
        return True
    down(crew, levels, level)
    return False


@inner
def down(crew: Crew, levels: Levels, level: int) -> None:
    """Restrict what a level leaves over to the next one's right-hand side, which comes as 0."""
    _sweep(crew, levels, _RESTRICT, level, ZERO)
    grids, work, finest = levels.grids, levels.work, crew.finest
    a, e = grids.slots[max(level - 1, 0)], grids.slots[level]
    coarse = work.b[2 * e : 2 * grids.slots[level + 1]]
    if level == 0:
        restrict_couplings(finest.stencil, finest.aggregate, finest.weight, crew.noted, coarse)
    else:
        restrict_couplings(stencil_at(grids, level - 1), grids.aggregate[a:e], grids.weight[a:e], crew.noted, coarse)


@inner
def up(crew: Crew, levels: Levels, level: int, visit: int) -> tuple[float, float, float]:
    """Add the next level's answer, relax, and multiply; returns products as `sweeps.prolong_and_multiply`."""
    grids, work, z, w = levels.grids, levels.work, crew.vectors[3], crew.vectors[4]
    stencil = crew.finest.stencil
    if level > 0:
        a, e = grids.slots[level - 1], grids.slots[level]
        stencil, z = stencil_at(grids, level - 1), work.z[a:e]
        w = work.v[a:e] if visit == 1 else work.w[a:e]
    _sweep(crew, levels, _RELAX, level, visit)
    relax_couplings(stencil, crew.noted, z)
    _sweep(crew, levels, _MULTIPLY, level, visit)
    zr, zw, zs = 0.0, 0.0, 0.0
    for block in range(blocks_of(stencil)):
        zr, zw, zs = zr + crew.sums[block, 0], zw + crew.sums[block, 1], zs + crew.sums[block, 2]
    if level == 0:
        return zr, zw - multiply_couplings(crew.finest.exact, crew.noted_exact, z, w), zs
    return zr, zw - multiply_couplings(stencil, crew.noted, z, w), zs


@inner
def begin(crew: Crew, levels: Levels) -> None:
    """Restrict the finest level's relaxed residual."""
    z, margin = crew.vectors[3], crew.finest.stencil.margin
    z[:margin] = 0.0
    z[len(z) - margin :] = 0.0
    _sweep(crew, levels, _CLEAR, ZERO, ZERO)
    down(crew, levels, ZERO)


@inner
def _eliminate(stencil: Stencil, red_fed: Singles, black_fed: Singles, slab: Slab, f: Singles, z: Singles) -> None:
    """What black cells are due, red ones eliminated, and ``z`` relaxed from zero."""
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


@inner
def _finish_eliminating(levels: Levels, level: int) -> None:
    """What couplings carry, behind all slabs."""
    grids, work = levels.grids, levels.work
    a, e = grids.slots[level - 1], grids.slots[level]
    stencil, red_fed, f, z = stencil_at(grids, level - 1), work.b[2 * a : a + e], work.f[a:e], work.x[a + e : 2 * e]
    for m in range(len(stencil.couplings)):
        red, black = stencil.off_red[m], stencil.off_black[m]
        value = np.float32(stencil.red_inverse[red] * red_fed[red])
        f[black] += stencil.couplings[m] * value
    for m in range(len(stencil.couplings)):
        black = stencil.off_black[m]
        z[black] = stencil.black_inverse[black] * f[black]


@inner
def _relax(
    stencil: Stencil, aggregate: Indices, weight: Singles, coarse: Singles, r: Singles, before: Singles, slab: Slab,
    own: Singles, noted: Singles, z: Singles,
) -> None:  # fmt: skip
    """The first half of `sweeps.prolong_and_multiply`, from ``before`` into ``z``; ``own``: work space of the slab."""
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


@inner
def _multiply(
    exact: Stencil, z: Singles, r: Singles, s: Singles, slab: Slab, noted: Reals, w: Singles, sums: Floats
) -> None:
    """The second half; ``sums`` (blocks, 3) of ``z.r``, ``z.w``, ``z.s``."""
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


@inner
def _take(
    inverse: Singles, z: Singles, r: Singles, v: Singles, c: Singles, before: Singles, part: int, parts: int,
    sums: Floats, shares: Floats,
) -> None:  # fmt: skip
    """First step of the K-cycle along ``z``, its direction kept in ``c``, and the rest relaxed from zero."""
    chunks, step = -(-len(r) // CHUNK), np.float32(shares[0])
    for chunk in range(part * chunks // parts, (part + 1) * chunks // parts):
        begin, end = chunk * CHUNK, min(chunk * CHUNK + CHUNK, len(r))
        sums[chunk, 0], sums[chunk, 1] = take_step(r, v, step, begin, end)
        for k in range(begin, end):
            c[k] = z[k]
            before[k] = inverse[k] * r[k]


@inner
def _put_back(
    stencil: Stencil, z: Singles, c: Singles, on_c: np.float32, on_z: np.float32, red_fed: Singles, slab: Slab,
    own: Singles, red: Singles, black: Singles,
) -> None:  # fmt: skip
    """The K-cycle's answer at the black nodes, and the red ones that follow."""
    ahead = blocks_ahead(stencil)
    for m in range(len(stencil.couplings)):
        combine(z, c, on_c, on_z, stencil.off_black[m], stencil.off_black[m] + 1, own)
    for block in range(max(slab.first - ahead, 0), min(slab.last + ahead, blocks_of(stencil))):
        at, count = extent(stencil, block)
        combine(z, c, on_c, on_z, at, at + count, own)
        if slab.first <= block < slab.last:
            black[at : at + count] = own[at : at + count]
    relax_red_blocks(stencil, red_fed, own, slab.first, slab.last, red)


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
