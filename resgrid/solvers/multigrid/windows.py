"""Windows over the red cells of a stencil, which go ahead of the black ones in a sweep, so that faces are read once.

They go ahead by as many slots as there are between neighbours, and red values are only kept in a window around the
slots that a window has come to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from resgrid.jit import ZERO, inner, inner_fast
from resgrid.solvers.multigrid.red_black import RED, Integers, Reals, Stencil, blocks_of, draw_into, extent

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
def blocks_ahead(stencil: Stencil) -> int:
    """How many blocks red cells go ahead of black ones, so that all neighbours of these are there."""
    return int(-(-stencil.margin // stencil.block))


@inner
def open_window(stencil: Stencil, block: int, like: Reals) -> Window:
    """A window that comes to a block first, of the precision of other values."""
    ahead, begin, coupling = blocks_ahead(stencil), stencil.margin + block * stencil.block, 0
    kept = ahead * stencil.block + stencil.margin
    red = np.zeros(_ROOM * (kept + stencil.block), like.dtype)
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
    to = draw_into_red(stencil, window, x, block)
    if block < blocks_of(stencil):
        begin, count = extent(stencil, block)
        _scale(stencil.red_inverse, begin, count, window.red, to)
        note(stencil, window, begin, to)


@inner
def draw_into_red(stencil: Stencil, window: Window, x: Reals, block: int) -> int:
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
def note(stencil: Stencil, window: Window, begin: int, to: int) -> None:
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
