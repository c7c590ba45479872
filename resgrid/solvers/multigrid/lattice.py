"""Where the cells of a grid lie on a stencil.

Cells are numbered with a stride along every axis, as in an array, but all strides are odd: the numbers of neighbours
differ by an odd one, so that those of red cells are even and those of black cells odd.  Halved, they are slots in an
array for each colour, where every neighbour of a red cell lies at the same distance for all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_PADDING = 16


@dataclass(frozen=True, eq=False)
class Lattice:
    """The slots of a grid's cells.

    `shape`: of the grid, of two axes or more; `extras`: slots of either colour behind the grid, for nodes beside it.
    """

    shape: tuple[int, ...]
    extras: int = 0

    @property
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
    def rows(self) -> NDArray[np.int64]:
        """Numbers of the first cells of all rows along the last axis, in C order."""
        first = np.ix_(*(np.arange(cells) for cells in (*self.shape[:-1], 1)))
        return self.number(first).ravel()

    def number(self, index: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
        """Numbers of cells, from their indices along every axis."""
        return np.asarray(sum(i * s for i, s in zip(index, self.strides, strict=True)), dtype=np.int64)

    def slot(self, number: NDArray[np.int64]) -> NDArray[np.int64]:
        """Slots of numbered cells, black ones counted behind all slots of red ones."""
        return (number & 1) * self.slots + self.margin + (number >> 1)

    def cells_at(self, colour: int, slot: NDArray[np.integer]) -> tuple[NDArray[np.int64], ...]:
        """Indices of the cells at some slots of a colour, one array for each axis."""
        rest = 2 * (slot.astype(np.int64) - self.margin) + colour
        index = []
        for stride in self.strides:
            along, rest = np.divmod(rest, stride)
            index.append(along)
        return tuple(index)
