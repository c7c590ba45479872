"""Windows over the red cells of a grid, which go ahead of the black ones in a sweep, so that faces are read once.

They go ahead by as many slots as there are between neighbours, and red values are only kept in a window around the
slots that a window has come to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from resgrid.jit import ZERO, inlined, inner, inner_fast
from resgrid.solvers.machine import doubles, indices, integers, singles
from resgrid.solvers.multigrid.levels import DOUBLE, SINGLE, Row, draw_into, extent
from resgrid.solvers.multigrid.red_black import RED, Integers, Reals, Singles, Stencil

_ROOM = 4
"""Of a window, in units of what is kept and a block; so seldom it is moved."""


class Window(NamedTuple):
    """The red values around the slots that a window has come to.

    `red`: the values; `drawn` (couplings,): what couplings draw into red cells; `total` (block,): for sums; `at` (2,):
    slot of the first of the red values, and the next coupling; `kept`: how many values behind a block may still be
    asked for.
    """

    red: Reals
    drawn: Reals
    total: Reals
    at: Integers
    kept: int


class Slab(NamedTuple):
    """A part of a grid that one thread sweeps over.

    `first, last`: its blocks, the last one left out; `begin, end`: black slots that share their nodes on the next level
    with no other slab's; `room`: where it keeps its two windows, an address.
    """

    first: int
    last: int
    begin: int
    end: int
    room: int = 0


@inner
def slab_of(level: Row, part: int) -> Slab:
    """One of the slabs of a grid."""
    of, k = integers(level.slabs, 5 * level.parts), 5 * part
    return Slab(of[k], of[k + 1], of[k + 2], of[k + 3], of[k + 4])


@inner
def blocks_ahead(level: Row) -> int:
    """How many blocks red cells go ahead of black ones, so that all neighbours of these are there."""
    return int(-(-level.margin // level.block))


def values_in_window(stencil: Stencil) -> int:
    """How many red values a window holds."""
    return int(_ROOM * ((-(-stencil.margin // stencil.block) + 1) * stencil.block + stencil.margin))


@inlined
def open_window(level: Row, slab: Slab, block: int) -> Window:
    """A window of single precision that comes to a block first; what couplings draw is left open."""
    room, drawn = slab.room + 2 * DOUBLE, slab.room + 2 * DOUBLE + level.window * SINGLE
    red, total = singles(room, level.window), singles(drawn + level.joined * SINGLE, level.block)
    return _opened(level, slab.room, block, red, singles(drawn, level.joined), total)


@inlined
def open_second(level: Row, slab: Slab, block: int) -> Window:
    """The same beside it, of double precision."""
    begin = slab.room + (2 + level.window + level.joined + level.block) * DOUBLE
    room, drawn = begin + 2 * DOUBLE, begin + (2 + level.window) * DOUBLE
    red, total = doubles(room, level.window), doubles(drawn + level.joined * DOUBLE, level.block)
    return _opened(level, begin, block, red, doubles(drawn, level.joined), total)


@inner
def _opened(level: Row, room: int, block: int, red: Reals, drawn: Reals, total: Reals) -> Window:
    begin, at, off_red = level.margin + block * level.block, integers(room, 2), indices(level.off_red, level.joined)
    kept = blocks_ahead(level) * level.block + level.margin
    at[0], at[1] = begin - kept, 0
    while at[1] < level.joined and off_red[at[1]] < begin:
        at[1] += 1
    for k in range(len(red)):
        red[k] = 0.0
    return Window(red, drawn, total, at, kept)


@inner
def draw(level: Row, x: Singles, drawn: Reals) -> None:
    """What every coupling draws into its red cell."""
    couplings, off_black = singles(level.couplings, level.joined), indices(level.off_black, level.joined)
    for k in range(level.joined):
        drawn[k] = drawn.dtype.type(couplings[k]) * x[off_black[k]]


@inner
def make_room(level: Row, window: Window, block: int) -> int:
    """Make room for a block of red values; returns where among them it begins."""
    begin = level.margin + block * level.block
    if begin + level.block - window.at[0] > len(window.red):
        behind = begin - window.kept - window.at[0]
        for k in range(window.kept):
            window.red[k] = window.red[behind + k]
        window.at[0] = begin - window.kept
    return int(begin - window.at[0])


@inner
def lead(level: Row, window: Window, slab: Slab, x: Singles, block: int) -> None:
    """``red = G x / degree`` on a block, zero behind the last one; a slab notes its own where couplings begin."""
    to = make_room(level, window, block)
    if block >= level.blocks:
        for k in range(to, to + level.block):
            window.red[k] = 0.0
        return
    begin, count = extent(level, block)
    draw_into(level, RED, x, ZERO, block, window.red, to)
    off_red, noted, first = indices(level.off_red, level.joined), doubles(level.noted, level.joined), window.at[1]
    while window.at[1] < level.joined and off_red[window.at[1]] < begin + count:
        window.red[to + off_red[window.at[1]] - begin] += window.drawn[window.at[1]]
        window.at[1] += 1
    _scale(singles(level.red_inverse, level.slots), begin, count, window.red, to)
    if slab.first <= block < slab.last:
        for m in range(first, window.at[1]):
            noted[m] = window.red[to + off_red[m] - begin]


@inner_fast
def _scale(inverse: Reals, begin: int, count: int, value: Reals, to: int) -> None:
    """``value = inverse * value``, the value from slot ``to`` on."""
    at, v_at = np.uint64(begin), np.uint64(to)
    for i in range(count):
        k = np.uint64(i)
        value[v_at + k] *= inverse[at + k]
