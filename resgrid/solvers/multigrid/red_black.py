"""Red-black grids: memory layout, and kernels over all conductances between red and black cells.

Cells are numbered with a stride along every axis, as in an array, but all strides are odd. The numbers of neighbours
therefore differ by an odd number: those of red cells are even, those of black cells odd. Half of the number, rounded
down, is the slot of the cell: its index in an array (slots,) over the cells of its colour. Red and black slots both
count from 0. The black neighbour across a face lies at the same distance in slots for all red cells. Kernels run over
blocks of slots that fit in the first cache, and over two faces of all cells at a time, which fills the vector registers
in any dimension. Conductances across no face (an edge that closes a periodic axis, or leads to an extra node) are
couplings.
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
"""The two colours of cells; the colour is the parity of the sum of a cell's indices, 0 or 1."""


_PADDING = 16
"""Number of unused entries at either end of an array over one colour, besides those within reach of a stride."""


@dataclass(frozen=True, eq=False)
class RedBlackLayout:
    """Memory layout of a grid's cells: each cell has a slot, its index in the arrays (slots,) of its colour.

    The colours are red and black; the slots of both count from 0. `shape`: number of cells along every axis, two axes
    or more; `extras`: number of additional slots, equal for both colours, after those of the grid. They belong to extra
    nodes: the connected components of a cell (a block of finer cells) except the first.
    """

    shape: tuple[int, ...]
    extras: int = 0

    @cached_property
    def strides(self) -> tuple[int, ...]:
        """Difference between the numbers of neighbouring cells, for every axis; odd.

        The slot of a cell, its index in the arrays of its colour, is half of its number, rounded down. The numbers have
        gaps, so that no two cells that are not neighbours have numbers that differ by a stride.
        """
        strides, span = [1], 0
        for cells in self.shape[:0:-1]:
            span += (cells - 1) * strides[-1]
            strides.append(strides[-1] + span + 1 | 1)
        return tuple(strides[::-1])

    @property
    def margin(self) -> int:
        """Number of unused entries before the first cell in an array over one colour.

        The array has equally many unused entries after its last node.
        """
        return (self.strides[0] + 1) // 2 + _PADDING

    @property
    def first_extra(self) -> int:
        """Index, in an array over one colour, of the first extra node; these follow the nodes of all cells.

        A coarse cell is a block of finer cells; extra nodes are the connected components of a block except its first
        one.
        """
        return self.margin + (self.shape[0] * self.strides[0] + 1) // 2

    @property
    def slots(self) -> int:
        """Length of the arrays over the cells of one colour, including the unused entries at both ends."""
        return self.first_extra + self.extras + self.margin

    @property
    def distance(self) -> NDArray[np.int64]:
        """Index of the black cell across every face minus the index of the red cell, shape (2 ndim,).

        Each index counts from 0 in an array over the cells of its own colour. The lower face of every axis precedes the
        upper one.
        """
        return np.array([d for s in self.strides for d in (-(s + 1) // 2, (s - 1) // 2)], dtype=np.int64)

    @property
    def lines(self) -> NDArray[np.int64]:
        """Number of the first cell of every line of cells along the last axis, shape (lines,).

        Half of a number, rounded down, is the index of the cell in the arrays of its colour; the remainder is the
        colour, 0 for red. Cells along a line have successive numbers: red and black cells alternate.
        """
        first = np.ix_(
            *(stride * np.arange(cells) for stride, cells in zip(self.strides, self.shape[:-1], strict=False))
        )
        return np.ravel(2 * self.margin + sum(first))

    @property
    def cells(self) -> NDArray[np.int32]:
        """Position of every cell, an array of the grid's shape.

        The position of a red cell is its index in an array (slots,) over the red cells; that of a black cell is
        ``slots`` plus its index in an array (slots,) over the black cells.
        """
        return self._by_cell(np.arange(2 * self.slots, dtype=np.int32).reshape(2, -1).T.ravel())

    def at_slots(self, values: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return values of cells, of the grid's shape, as an array (2, slots): red cells in row 0, black ones in row 1.

        The array is 0 at entries without a cell.
        """
        by_number = np.zeros(2 * self.slots, dtype=np.int32)
        self._by_cell(by_number)[...] = values
        return np.ascontiguousarray(by_number.reshape(-1, 2).T)

    def _by_cell(self, by_number: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return a view, of the grid's shape, of an array (2 slots,) in which red and black cells alternate.

        `by_number` (2 slots,): one value per cell, by the cell's number: twice its index in an array over its colour,
        plus 1 for a black cell.
        """
        return as_strided(by_number[2 * self.margin :], self.shape, [4 * s for s in self.strides])

    def cells_at(self, colour: int, slot: NDArray[np.integer]) -> tuple[NDArray[np.int64], ...]:
        """Return the grid indices of the cells at the array indices ``slot`` (m,): one array (m,) per axis.

        `colour`: 0 if ``slot`` contains indices in arrays over the red cells, 1 for black cells; both count from 0.
        """
        rest = 2 * (slot.astype(np.int64) - self.margin) + colour
        index = []
        for stride in self.strides:
            along, rest = np.divmod(rest, stride)
            index.append(along)
        return tuple(index)


class Stencil(NamedTuple):
    """Conductances of a grid by colour, in single or double precision, divided by the conductance ``hierarchy.unit``.

    A slot is the index of a cell in the arrays of its colour, from 0 for both colours. Arrays over slots have shape
    (slots,), with unused entries at both ends.

    `faces` (2 ndim, slots): conductance from a red cell to the black one across every face, by red slot, 0 for none;
    `distance` (2 ndim,): slot of the black cell across every face minus that of the red cell; `margin, first_extra`:
    number of slots before the first cell, and first slot of extra nodes; `block`: number of slots that a kernel
    processes at a time; `off_red, off_black` (couplings,): red and black slots that are joined by couplings, edges
    across no face, in the order of red slots; `couplings` (couplings,): their conductances; `red_inverse,
    black_inverse, black_degree` (slots,): reciprocal diagonals at red and at black cells, and the black diagonal; 0 at
    slots without an unknown.
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
    """The conductances of a red-black grid, in double precision, divided by the conductance ``hierarchy.unit``.

    A slot is the index of a cell in the arrays of its colour, from 0 for both colours. `faces` (2 ndim, slots):
    conductance from a red cell to the black one across every face, by red slot, 0 for none; `distance` (2 ndim,): slot
    of the black cell across every face minus that of the red cell; `margin`: number of unused slots at either end;
    `off_red, off_black` (couplings,): red and black slots that are joined by couplings, edges across no face, sorted by
    red, then black slot; `off_axis, couplings` (couplings,): axes and conductances of the couplings.
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
    """Set ``total`` to the sum of ``g x`` across faces ``q`` and ``q + 1``; for ``q > 0`` add it to ``total``.

    `g` (faces, slots): conductances across every face, by red cell; `at`: column of the first cell's conductance in
    rows ``q`` and ``q + 1``; `x` (slots,): values at the neighbours; `there`: index in `x` of the first cell's
    neighbour across ``q`` and across ``q + 1``; `count`: number of cells; `total` (count,): result. Unsigned indices
    avoid checks for negative ones.
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
    """Set ``total`` to ``sum_j g_ij x_j`` over the neighbours ``j`` across the faces of cells ``i`` of one colour.

    `faces` (faces, slots): conductances, stored at red cells; `away` (faces,): index of the black cell across a face in
    an array over the black cells, minus the index of the red cell in an array over the red cells; `cells`: colour of
    the cells ``i``, index of the first one in an array over this colour, and their number; `x` (slots,): values at the
    cells of the other colour; `total` (number of cells,): result.
    """
    colour, begin, count = cells
    back, ahead = -colour, 1 - 2 * colour
    for q in range(0, len(away), 2):
        at = (begin + back * away[q], begin + back * away[q + 1])
        _two_products(faces, q, at, x, (begin + ahead * away[q], begin + ahead * away[q + 1]), count, total)


@inner_fast
def relax(inverse: Reals, rhs: Reals, begin: int, count: int, total: Reals, value: Reals) -> None:
    """Set ``value = inverse (rhs + total)`` on ``count`` entries from ``begin`` on.

    `inverse, rhs` (slots,): reciprocal diagonal and right-hand side over the cells of a colour; `total` (block,):
    currents from neighbours into the ``count`` cells; `value` (slots,): result.
    """
    at = np.uint64(begin)
    for i in range(count):
        k = np.uint64(i)
        value[at + k] = inverse[at + k] * (rhs[at + k] + total[k])
