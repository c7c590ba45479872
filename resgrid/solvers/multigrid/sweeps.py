"""Sweeps over a stencil: passes in which red cells go ahead of black ones, so that faces are read once.

They go ahead by as many slots as there are between neighbours, and red values are only kept in a window around the
slots that a window has come to.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from resgrid.jit import ZERO, inner, inner_fast, kernel
from resgrid.solvers.multigrid.red_black import (
    BLACK,
    RED,
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
)
from resgrid.solvers.multigrid.subnormals import flush_subnormals, restore_subnormals

_ROOM = 4
"""Of a window, in units of what is kept and a block; so seldom it is moved."""


class Window(NamedTuple):
    """The red values around the slots that a window has come to.

    `coupled`: what couplings draw into red cells; behind the window, the red values where they begin; `at` (3,): slot
    of the first of the red values, the next coupling to draw, and the next to note a red value of; `kept`: how many
    values behind a block may still be asked for; `ahead`: as of `blocks_ahead`.
    """

    red: Reals
    coupled: Reals
    at: Integers
    kept: int
    ahead: int


class Slab(NamedTuple):
    """A part of a stencil that one thread sweeps over.

    `first, last`: its blocks, the last one left out; `begin, end`: black slots that share their nodes on the next level
    with no other slab's.
    """

    first: int
    last: int
    begin: int
    end: int


@inner
def _whole(stencil: Stencil) -> Slab:
    return Slab(ZERO, blocks_of(stencil), stencil.margin, stencil.faces.shape[1] - stencil.margin)


@inner
def blocks_ahead(stencil: Stencil) -> int:
    """How many blocks red cells go ahead of black ones, so that all neighbours of these are there."""
    return int(-(-stencil.margin // stencil.block))


@inner
def open_window(stencil: Stencil, block: int) -> Window:
    """A window that comes to a block first."""
    ahead, begin, coupling = blocks_ahead(stencil), stencil.margin + block * stencil.block, 0
    kept = ahead * stencil.block + stencil.margin
    red = np.zeros(_ROOM * (kept + stencil.block), stencil.black_degree.dtype)
    while coupling < len(stencil.couplings) and stencil.off_red[coupling] < begin:
        coupling += 1
    at = np.array([begin - kept, coupling, coupling])
    return Window(red, np.empty(len(stencil.couplings), red.dtype), at, kept, ahead)


@inner
def make_room(stencil: Stencil, window: Window, block: int) -> int:
    """Make room for a block of red values; returns where among them it begins."""
    begin = stencil.margin + block * stencil.block
    if begin + stencil.block - window.at[0] > len(window.red):
        behind = begin - window.kept - window.at[0]
        for k in range(window.kept):
            window.red[k] = window.red[behind + k]
        window.at[0] = begin - window.kept
    return int(begin - window.at[0])


@inner
def lead(stencil: Stencil, window: Window, x: Reals, block: int) -> None:
    """``red = G x / degree`` on a block, zero behind the last one."""
    to = _draw_into_red(stencil, window, x, block)
    if block < blocks_of(stencil):
        begin, count = extent(stencil, block)
        _scale(stencil.red_inverse, begin, count, window.red, to)
        _note(stencil, window, begin, to)


@inner
def _draw_into_red(stencil: Stencil, window: Window, x: Reals, block: int) -> int:
    """``red = G x`` on a block, zero behind the last one; returns where among the red values it begins."""
    to = make_room(stencil, window, block)
    if block >= blocks_of(stencil):
        for k in range(to, to + stencil.block):
            window.red[k] = 0.0
        return to
    begin, count = extent(stencil, block)
    draw_into(stencil, RED, x, ZERO, block, window.red, to)
    while window.at[1] < len(stencil.couplings) and stencil.off_red[window.at[1]] < begin + count:
        window.red[to + stencil.off_red[window.at[1]] - begin] += window.coupled[window.at[1]]
        window.at[1] += 1
    return to


@inner
def _note(stencil: Stencil, window: Window, begin: int, to: int) -> None:
    """Note the red values of a block where couplings begin."""
    while window.at[2] < window.at[1]:
        window.coupled[window.at[2]] = window.red[to + stencil.off_red[window.at[2]] - begin]
        window.at[2] += 1


@inner_fast
def _scale(inverse: Reals, begin: int, count: int, value: Reals, to: int) -> None:
    """``value = inverse * value``, the value from slot ``to`` on."""
    at, v_at = np.uint64(begin), np.uint64(to)
    for i in range(count):
        k = np.uint64(i)
        value[v_at + k] *= inverse[at + k]


@inner
def restrict_within(stencil: Stencil, aggregate: Indices, weight: Singles, z: Singles, coarse: Singles) -> None:
    """Let the red cells follow the black values ``z``, and sum the black residual into the next level.

    ``aggregate`` leads from a black slot to its node there; from unused slots to node 0, which nothing belongs to.
    ``weight`` is what a black slot counts for, and takes from its node; where it is empty, it is 1.
    """
    flags = flush_subnormals()
    for node in range(len(coarse)):
        coarse[node] = 0.0
    coupled = restrict_slab(stencil, aggregate, weight, z, _whole(stencil), coarse)
    restrict_couplings(stencil, aggregate, weight, coupled, coarse)
    restore_subnormals(flags)


restrict = kernel(restrict_within)


@inner
def restrict_slab(
    stencil: Stencil, aggregate: Indices, weight: Singles, z: Singles, slab: Slab, coarse: Singles
) -> Singles:
    """`restrict` on a slab but for its couplings; returns the red values where these begin."""
    total = np.empty(stencil.block, stencil.red_inverse.dtype)
    ahead = blocks_ahead(stencil)
    begin, last = max(slab.first - ahead, 0), -(-(slab.end - stencil.margin) // stencil.block)
    window = open_window(stencil, begin)
    draw(stencil, z, window.coupled)
    for step in range(begin, max(last, slab.last) + ahead):
        lead(stencil, window, z, step)
        block = step - ahead
        if slab.first <= block < last:
            draw_into(stencil, BLACK, window.red, window.at[0], block, total, ZERO)
            at, count = extent(stencil, block)
            behind = max(slab.begin - at, 0)
            if behind < count:
                count = min(count, slab.end - at) - behind
                _add_to_nodes(aggregate, weight, at + behind, count, total[behind:], coarse)
    return window.coupled


@inner
def restrict_couplings(
    stencil: Stencil, aggregate: Indices, weight: Singles, coupled: Singles, coarse: Singles
) -> None:
    """The rest of `restrict`, behind all slabs."""
    for m in range(len(stencil.couplings)):
        share = weight[stencil.off_black[m]] if len(weight) > 0 else np.float32(1.0)
        coarse[aggregate[stencil.off_black[m]]] += share * stencil.couplings[m] * coupled[m]
    coarse[0] = 0.0


@inner
def _add_to_nodes(aggregate: Indices, weight: Singles, begin: int, count: int, total: Reals, coarse: Singles) -> None:
    at = np.uint64(begin)
    if len(weight) > 0:
        for i in range(count):
            k = np.uint64(i)
            coarse[np.uint32(aggregate[at + k])] += weight[at + k] * total[k]
        return
    for i in range(count):
        k = np.uint64(i)
        coarse[np.uint32(aggregate[at + k])] += total[k]


@inner
def add_from_nodes(
    aggregate: Indices, weight: Singles, begin: int, count: int, coarse: Singles, z: Singles, total: Singles
) -> None:
    """``total = z +`` what the slots of a block take from their nodes."""
    at = np.uint64(begin)
    if len(weight) > 0:
        for i in range(count):
            k = at + np.uint64(i)
            total[k] = z[k] + weight[k] * coarse[np.uint32(aggregate[k])]
        return
    for i in range(count):
        k = at + np.uint64(i)
        total[k] = z[k] + coarse[np.uint32(aggregate[k])]


@inner
def prolong_within(
    stencil: Stencil, exact: Stencil, aggregate: Indices, weight: Singles, coarse: Singles, r: Singles, s: Singles,
    z: Singles, w: Singles,
) -> tuple[float, float, float]:  # fmt: skip
    """Finish the preconditioner's answer ``z`` to ``r``, and form ``w = S z``; returns ``z.r``, ``z.w`` and ``z.s``.

    The next level's answer is added to ``z``, the red cells follow, and the black ones are relaxed.  S is the Schur
    complement of the black cells of ``exact``, which is the same stencil with a diagonal in a precision of its own.

    The sweeps of both follow as close upon each other as neighbours allow, but where there are couplings.
    """
    flags = flush_subnormals()
    first, second = open_window(stencil, ZERO), open_window(exact, ZERO)
    blocks, ahead = blocks_of(stencil), first.ahead
    before, between = (ahead, 3 * ahead) if len(stencil.couplings) == 0 else (blocks, 2 * blocks + ahead)
    total = np.empty(stencil.block, stencil.red_inverse.dtype)
    product = np.empty(len(total), exact.black_degree.dtype)
    zr, zw, zs = 0.0, 0.0, 0.0
    for step in range(between + blocks + ahead):
        if step < blocks:
            begin, count = extent(stencil, step)
            add_from_nodes(aggregate, weight, begin, count, coarse, z, z)
        if step == before:
            draw(stencil, z, first.coupled)
        if step == between:
            relax_couplings(stencil, first.coupled, z)
            draw(exact, z, second.coupled)
        if before <= step < before + blocks + ahead:
            lead(stencil, first, z, step - before)
        if before + ahead <= step < before + blocks + ahead:
            begin, count = extent(stencil, step - before - ahead)
            draw_into(stencil, BLACK, first.red, first.at[0], step - before - ahead, total, ZERO)
            relax(stencil.black_inverse, r, begin, count, total, z)
        if between <= step:
            lead(exact, second, z, step - between)
        if between + ahead <= step:
            begin, count = extent(exact, step - between - ahead)
            draw_into(exact, BLACK, second.red, second.at[0], step - between - ahead, product, ZERO)
            a, b, c = products(exact.black_degree, z, r, s, begin, count, product, w)
            zr, zw, zs = zr + a, zw + b, zs + c
    zw -= multiply_couplings(exact, second.coupled, z, w)
    restore_subnormals(flags)
    return zr, zw, zs


prolong_and_multiply = kernel(prolong_within)


@inner
def relax_couplings(stencil: Stencil, coupled: Singles, z: Singles) -> None:
    """Add what couplings feed into black cells that have been relaxed."""
    for m in range(len(stencil.couplings)):
        black = stencil.off_black[m]
        z[black] += stencil.black_inverse[black] * stencil.couplings[m] * coupled[m]


@inner
def multiply_couplings(stencil: Stencil, coupled: Reals, z: Singles, w: Singles) -> float:
    """Take what couplings draw off the product; returns by how much ``z.w`` becomes less."""
    less = 0.0
    for m in range(len(stencil.couplings)):
        black, drawn = stencil.off_black[m], stencil.couplings[m] * coupled[m]
        w[black] -= drawn
        less += z[black] * drawn
    return less


@inner_fast
def products(
    degree: Reals, z: Singles, r: Singles, s: Singles, begin: int, count: int, total: Reals, w: Singles
) -> tuple[float, float, float]:
    """``w = degree z - total`` on a block, and its share of ``z.r``, ``z.w`` and ``z.s``."""
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


@kernel
def black_residual(stencil: Stencil, b: Floats, x: Floats, r: Floats) -> float:
    """Relax the red cells exactly, and form the residual at the black ones; ``b`` and ``x`` of shape (2, slots).

    Returns its norm.
    """
    squares = np.empty(blocks_of(stencil))
    coupled = residual_slab(stencil, b, x, r, _whole(stencil), squares)
    return finish_residual(stencil, coupled, squares, r)


@inner
def residual_slab(stencil: Stencil, b: Floats, x: Floats, r: Floats, slab: Slab, squares: Floats) -> Reals:
    """`black_residual` on a slab but for its couplings; returns the red values where these begin.

    ``squares`` (blocks,) receives the squares of every block, summed.
    """
    total, ahead = np.empty(stencil.block), blocks_ahead(stencil)
    begin = max(slab.first - ahead, 0)
    window = open_window(stencil, begin)
    draw(stencil, x[1], window.coupled)
    for step in range(begin, slab.last + ahead):
        to = _draw_into_red(stencil, window, x[1], step)
        if step < blocks_of(stencil):
            at, count = extent(stencil, step)
            _relax_both(stencil.red_inverse, b[0], at, count, window.red, to, x[0])
            _note(stencil, window, at, to)
        block = step - ahead
        if block >= slab.first:
            at, count = extent(stencil, block)
            draw_into(stencil, BLACK, window.red, window.at[0], block, total, ZERO)
            squares[block] = _subtract(stencil.black_degree, b[1], x[1], at, count, total, r)
    return window.coupled


@inner
def finish_residual(stencil: Stencil, coupled: Reals, squares: Floats, r: Floats) -> float:
    """The rest of `black_residual`, behind all slabs; returns the norm."""
    r[: stencil.margin] = 0.0
    r[len(r) - stencil.margin :] = 0.0
    if len(stencil.couplings) > 0:
        for m in range(len(stencil.couplings)):
            r[stencil.off_black[m]] += stencil.couplings[m] * coupled[m]
        return math.sqrt(_squares(r))
    total = 0.0
    for block in range(len(squares)):
        total += squares[block]
    return math.sqrt(total)


@inner_fast
def _squares(r: Floats) -> float:
    total = 0.0
    for k in range(len(r)):
        total += r[k] * r[k]
    return total


@inner_fast
def _relax_both(inverse: Reals, fed: Reals, begin: int, count: int, drawn: Reals, to: int, red: Reals) -> None:
    """``red = inverse (fed + drawn)``, put in place of what is drawn too."""
    at, d_at = np.uint64(begin), np.uint64(to)
    for i in range(count):
        k = np.uint64(i)
        v = inverse[at + k] * (fed[at + k] + drawn[d_at + k])
        red[at + k] = v
        drawn[d_at + k] = v


@inner_fast
def _subtract(degree: Reals, b: Reals, x: Reals, begin: int, count: int, total: Reals, r: Reals) -> float:
    """``r = b + total - degree x`` on a block; returns its squares, summed."""
    squares = 0.0
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        v = b[k] + (total[np.uint64(i)] - degree[k] * x[k])
        r[k] = v
        squares += v * v
    return squares
