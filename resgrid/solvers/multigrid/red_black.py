"""Red-black grids: where cells stand, and compiled passes over all resistors between a red cell and a black one.

Cells are numbered with a stride along every axis, as in an array, but all strides are odd: the numbers of neighbours
differ by an odd one, so that those of red cells are even and those of black cells odd.  Halved, they are slots in an
array for each colour, where the black neighbour across a face lies at the same distance for all red cells.  All passes
run over blocks of slots, which stay in the first cache, and over some faces of all their cells after others, which
fills the vector registers whatever the dimension.  What fits no face, a resistor that closes a ring or leads to a node
beside the grid, is a coupling.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, cast

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from resgrid._internal.jit import inner, inner_fast
from resgrid.solvers.scaled import Floats, Indices, Integers, Reals

RED, BLACK = cast(int, np.int64(0)), cast(int, np.int64(1))
"""The colours of cells, by the parity of their indices' sum."""


_PADDING = 16


@dataclass(frozen=True, eq=False)
class Lattice:
    """The slots of a grid's cells.

    `shape`: of the grid, of two axes or more; `extras`: slots of either colour behind the grid, for nodes beside it.
    """

    shape: tuple[int, ...]
    extras: int = 0

    @cached_property
    def strides(self) -> tuple[int, ...]:
        """From the number of a cell to the next one's along every axis.

        They leave gaps, so that the numbers of no other cells differ by a stride.
        """
        strides, span = [1], 0
        for cells in self.shape[:0:-1]:
            span += (cells - 1) * strides[-1]
            strides.append(strides[-1] + span + 1 | 1)
        return tuple(strides[::-1])

    @property
    def margin(self) -> int:
        """Places before the first cell and behind the last node."""
        return (self.strides[0] + 1) // 2 + _PADDING

    @property
    def first_extra(self) -> int:
        """First slot behind the grid."""
        return self.margin + (self.shape[0] * self.strides[0] + 1) // 2

    @property
    def slots(self) -> int:
        """Places of a colour, margins included."""
        return self.first_extra + self.extras + self.margin

    @property
    def distance(self) -> NDArray[np.int64]:
        """From a red slot to the black one across each face, the lower and the upper one along every axis."""
        return np.array([d for s in self.strides for d in (-(s + 1) // 2, (s - 1) // 2)], dtype=np.int64)

    @property
    def lines(self) -> NDArray[np.int64]:
        """Number of the first cell of every line along the last axis, red and black slots counted in turn."""
        first = np.ix_(
            *(stride * np.arange(cells) for stride, cells in zip(self.strides, self.shape[:-1], strict=False))
        )
        return np.ravel(2 * self.margin + sum(first))

    @property
    def cells(self) -> NDArray[np.int32]:
        """Slots of all cells, of the grid's shape; black ones are counted behind all slots of red ones."""
        return self._by_cell(np.arange(2 * self.slots, dtype=np.int32).reshape(2, -1).T.ravel())

    def at_slots(self, values: NDArray[np.int32]) -> NDArray[np.int32]:
        """Values of all cells, of the grid's shape, at the cells' slots: shape (2, slots), 0 elsewhere."""
        by_number = np.zeros(2 * self.slots, dtype=np.int32)
        self._by_cell(by_number)[...] = values
        return np.ascontiguousarray(by_number.reshape(-1, 2).T)

    def _by_cell(self, by_number: NDArray[np.int32]) -> NDArray[np.int32]:
        """What stands at the cells' numbers, red and black slots in turn (2 slots,), as a view of the grid's shape."""
        return as_strided(by_number[2 * self.margin :], self.shape, [4 * s for s in self.strides])

    def cells_at(self, colour: int, slot: NDArray[np.integer]) -> tuple[NDArray[np.int64], ...]:
        """Indices of the cells at some slots of a colour, one array for each axis."""
        rest = 2 * (slot.astype(np.int64) - self.margin) + colour
        index = []
        for stride in self.strides:
            along, rest = np.divmod(rest, stride)
            index.append(along)
        return tuple(index)


class Stencil(NamedTuple):
    """A grid of conductances by colour, in single or in double precision.

    Arrays over slots have shape (slots,), with unused margins before and behind.

    `faces` (2 ndim, slots): conductance from a red cell to the black one at ``distance``; 0 for none; `distance` (2
    ndim,): from a red slot to the black slot across each face; `margin, first_extra`: slots before the first cell, and
    before the first node beside the grid; `block`: how many a pass takes at a time; `off_red, off_black`: slots that
    off-stencil couplings join, in the order of their red slots; `couplings`: their conductances; `red_inverse,
    black_inverse, black_degree`: reciprocals of the diagonal at red and at black cells, and the latter; 0 where there
    is no unknown.
    """

    faces: Reals
    distance: Integers
    margin: int
    first_extra: int
    block: int
    off_red: Indices
    off_black: Indices
    couplings: Reals
    red_inverse: Reals
    black_inverse: Reals
    black_degree: Reals


class Edges(NamedTuple):
    """The conductances of a red-black grid, in double precision.

    `faces, distance, margin`: as of `Stencil`; `off_red, off_black` (couplings,): slots that the off-stencil couplings
    join, in the order of both; `off_axis, couplings` (couplings,): their axes and conductances.
    """

    faces: Floats
    distance: Integers
    margin: int
    off_red: Indices
    off_black: Indices
    off_axis: Indices
    couplings: Floats


@inner_fast
def _two_products(
    g: Reals, q: int, at: tuple[int, int], x: Reals, there: tuple[int, int], count: int, total: Reals
) -> None:
    """``total = g x`` across faces ``q`` and ``q + 1`` over ``count`` slots, in its precision; added to it but for two.

    Conductances begin ``at``, values of ``x`` ``there``.  Without signs, no index is asked whether it counts from the
    end.
    """
    real, face, other = total.dtype.type, np.uint64(q), np.uint64(q + 1)
    a, b, i, j = np.uint64(at[0]), np.uint64(at[1]), np.uint64(there[0]), np.uint64(there[1])
    if q == 0:
        for here in range(count):
            k = np.uint64(here)
            total[k] = real(g[face, a + k]) * x[i + k] + real(g[other, b + k]) * x[j + k]
        return
    for here in range(count):
        k = np.uint64(here)
        total[k] += real(g[face, a + k]) * x[i + k] + real(g[other, b + k]) * x[j + k]


@inner
def products(faces: Reals, away: Integers, cells: tuple[int, int, int], x: Reals, total: Reals) -> None:
    """``total = sum_j g_ij x_j`` across the faces of some cells of one colour.

    ``cells``: their colour, the first one, and how many.  Conductances stand at red cells.
    """
    colour, begin, count = cells
    back, ahead = -colour, 1 - 2 * colour
    for q in range(0, len(away), 2):
        at = (begin + back * away[q], begin + back * away[q + 1])
        _two_products(faces, q, at, x, (begin + ahead * away[q], begin + ahead * away[q + 1]), count, total)


@inner_fast
def relax(inverse: Reals, fed: Reals, begin: int, count: int, total: Reals, value: Reals) -> None:
    """``value = inverse (fed + total)`` on a block."""
    at = np.uint64(begin)
    for i in range(count):
        k = np.uint64(i)
        value[at + k] = inverse[at + k] * (fed[at + k] + total[k])
