"""Where the cells of a grid lie on a board."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_PADDING = 16


@dataclass(frozen=True, eq=False)
class Lattice:
    """Where the cells of a grid lie on a board.

    Attributes
    ----------
    shape : tuple of int
        Of the grid.
    extra_rows : int
        Rows behind the last one for nodes beside the grid.
    """

    shape: tuple[int, ...]
    extra_rows: int = 0

    @property
    def width(self) -> int:
        """Places a row; one is left empty between rows."""
        return (self.shape[-1] + 1) // 2 + 1

    @property
    def grid_rows(self) -> int:
        """Rows of cells."""
        return int(np.prod(self.shape[:-1]))

    @property
    def rows(self) -> int:
        """All rows."""
        return self.grid_rows + self.extra_rows

    @property
    def strides(self) -> list[int]:
        """Places from one cell to the next along every axis but the last."""
        return [self.width * int(np.prod(self.shape[a + 1 : -1])) for a in range(len(self.shape) - 1)]

    @property
    def margin(self) -> int:
        """Places before the first row."""
        return max(self.strides) + _PADDING

    @property
    def places(self) -> int:
        """Places of a colour, margins included."""
        return 2 * self.margin + self.width * self.rows

    @property
    def first_extra(self) -> int:
        """First place behind the grid."""
        return self.margin + self.width * self.grid_rows

    @property
    def distance(self) -> NDArray[np.int64]:
        """From a red place to the black one across each face but the last."""
        return np.array([*(d for stride in self.strides for d in (-stride, stride)), 0], dtype=np.int64)

    @property
    def colour(self) -> NDArray[np.int64]:
        """Parity of every row of cells."""
        return np.asarray(np.indices(self.shape[:-1]).sum(axis=0).ravel() % 2, dtype=np.int64)

    @property
    def aside(self) -> NDArray[np.int64]:
        """From a red place to the black one across the last face, for every row."""
        return np.concatenate([np.where(self.colour == 0, -1, 1), np.ones(self.extra_rows, dtype=np.int64)])


def cells_at(lattice: Lattice, colour: int, place: NDArray[np.integer]) -> tuple[NDArray[np.int64], ...]:
    """Indices of the cells at some places of a colour, one array for each axis."""
    line, along = np.divmod(place.astype(np.int64) - lattice.margin, lattice.width)
    column = 2 * along + ((lattice.colour[line] == 1) != (colour == 1))
    return (*np.unravel_index(line, lattice.shape[:-1]), column)
