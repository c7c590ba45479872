"""Triangular lattices over a plane, in which every node has six neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import ceil, floor, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.core.cell import Cell
from resgrid.core.lattice import Index, Lattice
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError

_ROW = sqrt(3.0) / 2.0
"""Distance of the rows of an equilateral triangular lattice, as a multiple of the pitch."""

_PHASES = 65
"""Number of trial positions of the first row; the position is chosen so that rows stay away from borders of cells."""

_APART = 1e-4
"""Smallest distance of rows from borders of cells in accepted positions of the rows, as a fraction of a cell's width.

Of the accepted positions, the one that centres the rows best in the grid is taken; if no position is accepted, the
position with the largest distance.
"""


@dataclass(frozen=True, eq=False)
class HexagonalLattice(Lattice):
    """A triangular lattice of sites (positions of nodes) with rows parallel to the first axis.

    Along the first axis, the first site of a row lies alternately a quarter and three quarters of the pitch above the
    lower end of the axis.  Fields besides those of `Lattice`: `pitch`: distance of neighbours in a row; `row`: distance
    of neighbouring rows; `first`: distance of the first row from the lower end of the second axis, all in axis units;
    `per_cell`: number of sites that a row has in a cell.
    """

    pitch: float
    row: float
    first: float
    per_cell: int

    def points(self, site: ArrayLike) -> NDArray[np.float64]:
        """Return the points of sites in axis units, (..., 2); `site` (..., 2): index in the row, index of the row."""
        i, j = np.moveaxis(np.asarray(site, dtype=np.int64), -1, 0)
        x = (i + np.where(j % 2 == 0, 0.25, 0.75)) * self.pitch
        return np.asarray(self.space.lower + np.stack([x, self.first + j * self.row], axis=-1))

    def cells(self, site: ArrayLike) -> NDArray[np.int64]:
        """Return the cells that contain sites, (..., 2); `site` (..., 2): index in the row, index of the row."""
        i, j = np.moveaxis(np.asarray(site, dtype=np.int64), -1, 0)
        return np.asarray(np.stack([i // self.per_cell, self._row_cells[j]], axis=-1))

    @cached_property
    def _row_cells(self) -> NDArray[np.int64]:
        """Index along the second axis of the cells that contain each row, (rows,)."""
        height = (self.first + np.arange(self.shape[1]) * self.row) / self.space.spacing[1]
        return np.asarray(np.floor(height), dtype=np.int64)

    def beyond(self, step: int, sense: int) -> Index:
        """Return the indices of the neighbours of all sites in one direction; they may lie outside the lattice.

        The result is a pair of arrays, index in the row and index of the row, which broadcast to the lattice's shape.
        `step`: 0 along the row, 1 or 2 to the next row, half a pitch forward or backward along the first axis; `sense`:
        1 for the step, -1 for its negative.
        """
        i, j = np.indices(self.shape, sparse=True)
        if step == 0:
            return i + sense, j
        left = 1 if step == 2 else 0
        lower = j if sense > 0 else j - 1
        return i + sense * (lower % 2 - left), j + sense

    def weights_at(self, step: int) -> NDArray[np.float64]:
        """Return the weight of the step with index `step` from every site, in the lattice's shape.

        A weight is a conductance times ``wiring.resistance``, at conductivity 1.  It is 0 if the straight segment of
        the step touches an obstacle cell or leaves the grid.
        """
        there, solid = self.neighbours(step), self.space.cell == Cell.OBSTACLE
        (x, y), (x_there, y_there) = self._ends(step)
        at_x, at_y = self._crossings(step)
        slack = self.space.rounding[1] * self.space.spacing[1] / self.row
        blocked = (there < 0) | solid[x, y] | solid[x_there, y_there]
        both = (at_x < 1.0) & (at_y < 1.0)
        blocked |= both & (at_x <= at_y + slack) & solid[x_there, y]
        blocked |= both & (at_y <= at_x + slack) & solid[x, y_there]
        return np.where(blocked, 0.0, self.weights[step])

    def conductivity_at(self, step: int) -> NDArray[np.float64] | None:
        """Return the harmonic mean of the conductivity along the segment of a step from every site, in lattice shape.

        On a segment between a site in a free cell and a site in a goal cell, goal cells count with the conductivity of
        the cell at the free end.  None if the space has no conductivities.  `step`: index of the step.
        """
        code, c = self.space.cell, self.space.conductivity
        if c is None:
            return None
        here, there = self._ends(step)
        at_x, at_y = self._crossings(step)
        first, last = c[here], c[there]
        is_goal, is_goal_there = code[here] == Cell.GOAL, code[there] == Cell.GOAL
        is_contact = is_goal != is_goal_there
        first, last = (
            np.where(is_goal & ~is_goal_there, last, first), np.where(is_goal_there & ~is_goal, first, last),
        )  # fmt: skip
        x_first, one, other = at_x < at_y, (there[0], here[1]), (here[0], there[1])
        middle = np.where(x_first, c[one], c[other])
        middle = np.where(is_contact & (np.where(x_first, code[one], code[other]) == Cell.GOAL), first, middle)
        low, high = np.minimum(np.minimum(at_x, at_y), 1.0), np.maximum(at_x, at_y)
        high = np.where(high > 1.0, low, high)  # no middle cell with fewer than two crossings
        return np.asarray(1.0 / (low / first + (high - low) / middle + (1.0 - high) / last))

    def contact_weight(self, step: int) -> float:
        """Return the weight of the resistor to the obstacle rail that replaces a blocked step: the weight of the step.

        A weight is a conductance times ``wiring.resistance``, at conductivity 1.  `step`: index of the step.
        """
        return float(self.weights[step])

    def _ends(self, step: int) -> tuple[Index, Index]:
        """Return the cells of both ends of a step from every site, each as one array of indices per axis."""
        there = self.neighbours(step)
        x, y = self.site_cells
        return (x, y), (x.ravel()[there], y.ravel()[there])

    def _crossings(self, step: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return where the segment of a step from every site crosses a cell border, across the first and second axis.

        Both arrays have the lattice's shape; entries are fractions of the segment in [0, 1], or 2 for no crossing.  A
        segment crosses at most one border across each axis.
        """
        (x, y), (_, y_there) = self._ends(step)
        across, up = self.beyond(step, 1)  # before wrapping
        crosses_x, crosses_y = across // self.per_cell != x, (up >= self.shape[1]) | (y != y_there)
        height = (y + 1) * self.space.spacing[1] - (self.first + np.arange(self.shape[1]) * self.row)
        at_border = np.where(np.arange(self.shape[1]) % 2 == 0, 0.75, 0.25) if step == 0 else 0.5
        return np.where(crosses_x, at_border, 2.0), np.where(crosses_y, height / self.row, 2.0)

    def sites_in(self, cell: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the indices of the sites in a cell, (n, 2); `cell` (2,): index of the cell."""
        rows = np.flatnonzero(self._row_cells == cell[1])
        columns = np.arange(cell[0] * self.per_cell, (cell[0] + 1) * self.per_cell)
        return np.stack(np.meshgrid(columns, rows, indexing="ij"), axis=-1).reshape(-1, 2)


def hexagonal_lattice(space: ConfigurationSpace) -> HexagonalLattice:
    """Return the triangular lattice over a space with two axes."""
    per_cell, pitch, rows, row = hexagonal_rows(space)
    h_ref = float(space.spacing.min())
    across = h_ref**2 / (2.0 * row**2)
    along = (h_ref / pitch) ** 2 - across / 2.0
    return HexagonalLattice(
        space=space,
        name="hexagonal",
        shape=(space.shape[0] * per_cell, rows),
        steps=np.array([(pitch, 0.0), (pitch / 2.0, row), (-pitch / 2.0, row)]),
        weights=np.array([along, across, across]),
        pitch=pitch,
        row=row,
        first=_first_row(space, rows, row),
        per_cell=per_cell,
    )


def hexagonal_rows(space: ConfigurationSpace) -> tuple[int, float, int, float]:
    """Return number of sites of a row in a cell, pitch, number of rows, and distance of neighbouring rows.

    The pitch is the distance of neighbouring sites of a row; both lengths are in axis units.  Raise InputError if the
    second axis is periodic and has too few cells for a lattice.
    """
    width, height = space.spacing.tolist()
    per_cell = max(ceil(_ROW * width / height - 1e-9), 1)
    pitch = width / per_cell
    length, cells = height * space.shape[1], space.shape[1]
    if not space.axes[1].periodic:
        return per_cell, pitch, max(floor(length / (_ROW * pitch)), 1), _ROW * pitch
    rows = max(2 * round(length / (2.0 * _ROW * pitch)), 2 * ceil(cells / 2))
    row = length / rows
    if row < 0.55 * pitch:
        name = space.axes[1].name
        raise InputError(
            f"lattice = 'hexagonal' does not close on the ring {name!r} of {cells} cell{'s' if cells > 1 else ''}: its "
            "rows would be too close; use more cells along it, or lattice = 'square'"
        )
    return per_cell, pitch, rows, row


def _first_row(space: ConfigurationSpace, rows: int, row: float) -> float:
    """Return the distance of the first row from the lower end of the second axis, in axis units.

    No row lies on a border of cells, the first row lies in the first cell, and the last row in the last cell.  The rows
    are centred in the grid, or moved from there as little as possible.  `rows`: number of rows; `row`: distance of
    neighbouring rows.  Raise InputError if, for every position, a row lies on a border of cells.
    """
    height, cells = float(space.spacing[1]), space.shape[1]
    length = height * cells
    if space.axes[1].periodic:
        low, high = 0.0, row
    else:
        last = (rows - 1) * row
        low, high = max(length - height - last, 0.0), min(height, length - last)
    first = low + (high - low) * np.arange(1, _PHASES + 1) / (_PHASES + 1)
    first = first[np.argsort(np.abs(first - (low + high) / 2.0), kind="stable")]
    position = np.mod((first[:, np.newaxis] + np.arange(rows) * row) / height, 1.0)
    distance = np.minimum(position, 1.0 - position).min(axis=1)
    largest = float(distance.max())
    if largest < 4.0 * space.rounding[1]:
        raise InputError(
            f"lattice = 'hexagonal': a row of nodes lies on a border of the {cells:,} cells along "
            f"{space.axes[1].name!r}; change their number by one, or use lattice = 'square'"
        )
    return float(first[int(np.argmax(distance >= min(_APART, largest)))])
