"""Windows around changed cells: cut out of the board and coarsened by themselves.

What a window's levels hold away from its edges is what coarsening the whole grid anew would give there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.multigrid.board_iteration import iterate_on_board
from resgrid.nodal.multigrid.board_passes import Board
from resgrid.nodal.multigrid.boards import Level, level_of
from resgrid.nodal.multigrid.coarsening import Coarsened
from resgrid.nodal.multigrid.grid_levels import coarsen_boards, lay_levels
from resgrid.nodal.multigrid.hierarchy import Hierarchy
from resgrid.nodal.multigrid.lattice import Lattice
from resgrid.nodal.system import NodalSystem
from resgrid.nodal.update import kernels
from resgrid.nodal.watch import Watch

_SHARE = 24
"""A window holds about one cell in so many."""

_MOST, _MOST_CELLS = 4, 20_000
"""All windows together hold at most one cell in so many, or so many."""

_BLOCKS = 4
"""Pairs of blocks that are as long as a window, at least."""

_SMALL = 10
"""Nodes under which a window is not coarsened any more."""

_TILES = 200
"""Groups of changed cells from which they count as being all over the grid."""


@dataclass(frozen=True, eq=False)
class Box:
    """A range of cells, in whole blocks of all levels.

    Attributes
    ----------
    low, high : ndarray of int64, shape (ndim,)
        First cell, and the one behind the last.
    first, last : ndarray of int64, shape (ndim,)
        The range of the changed cells in it and their neighbours, alike.
    """

    low: NDArray[np.int64]
    high: NDArray[np.int64]
    first: NDArray[np.int64]
    last: NDArray[np.int64]

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along every axis."""
        return tuple((self.high - self.low).tolist())

    def meets(self, other: Box) -> bool:
        """Whether two boxes overlap or touch."""
        return bool(np.all((self.low <= other.high) & (other.low <= self.high)))

    def joined(self, other: Box) -> Box:
        """The box around two."""
        low, first = np.minimum([self.low, self.first], [other.low, other.first])
        high, last = np.maximum([self.high, self.last], [other.high, other.last])
        return Box(low, high, first, last)


def window_depth(shape: tuple[int, ...], depth: int) -> int:
    """How many times a window is coarsened, at most ``depth``: its blocks are to be small beside it."""
    return min(depth, max(int(np.log2(_side(shape) / _BLOCKS)) - 1, 1))


def _side(shape: tuple[int, ...]) -> float:
    return float((np.prod(shape, dtype=np.float64) / _SHARE) ** (1 / len(shape)))


def boxes_around(cells: NDArray[np.int64], shape: tuple[int, ...], depth: int) -> list[Box]:
    """Boxes around changed cells; none if these are all over the grid.  Shapes: `cells` (k, ndim)."""
    end, block = np.array(shape), 2 << depth
    reach = int(max(_side(shape) / 2 - block / 2, 2))
    tile, number = np.unique(cells // block, axis=0, return_inverse=True)
    if len(tile) > _TILES:
        return []
    boxes: list[Box] = []
    for k in range(len(tile)):
        here = cells[number.ravel() == k]
        first, last = np.maximum(here.min(axis=0) - 1, 0), np.minimum(here.max(axis=0) + 2, end)
        low = np.maximum((first - reach) // block * block, 0)
        box = Box(low, np.minimum(-(-(last + reach) // block) * block, end), first, last)
        while met := next((other for other in boxes if other.meets(box)), None):
            boxes.remove(met)
            box = box.joined(met)
        boxes.append(box)
    volume = sum(np.prod(box.shape) for box in boxes)
    return boxes if volume <= max(end.prod() / _MOST, _MOST_CELLS) else []


@dataclass(frozen=True, eq=False)
class Window:
    """The equations of some rows with all others fixed.

    `rows` (m,); `inner, outer` (edges,): conductances that lead out: from which of the rows, counted in the window,
    to which row of the circuit; `conductance` (edges,): in siemens.
    """

    rows: NDArray[np.int64]
    hierarchy: Hierarchy
    inner: NDArray[np.int64]
    outer: NDArray[np.int64]
    conductance: NDArray[np.float64]

    def solve(
        self, currents: NDArray[np.float64], rtol: float, guess: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Voltages for currents into the rows, in volts and amperes."""
        grid = self.hierarchy.grid
        assert grid is not None
        return iterate_on_board(self.hierarchy, grid, currents, rtol, guess, Watch())[0]

    def drawn(self, x: NDArray[np.float64], reference: float = 0.0) -> NDArray[np.float64]:
        """Currents that voltages ``x`` of the whole circuit drive into the window's rows, in amperes."""
        drawn = np.bincount(self.inner, self.conductance * (x[self.outer] - reference), minlength=len(self.rows))
        return np.asarray(drawn, dtype=np.float64)


def open_window(
    system: NodalSystem,
    node: NDArray[np.int32],
    board: Board,
    unit: float,
    box: Box,
    pinned: NDArray[np.int64],
    depth: int,
) -> tuple[Window | None, list[Level], list[Coarsened]]:
    """Cut a window out and coarsen it.  Shapes: `node` as the grid, `pinned` (k,)."""
    shape, lattice = node.shape, Lattice(box.shape)
    rows, place = _rows(system, node, box, lattice, pinned)
    faces, leak = np.zeros((len(board.faces), lattice.places)), np.zeros((2, lattice.places))
    inner, outer, conductance = _cut(board, shape, box, lattice, faces)
    leak.ravel()[place] = system.excess[rows] / unit
    np.add.at(leak.ravel(), inner, conductance)
    none = np.empty(0, dtype=np.int64)
    ends, axis = np.empty((2, 0), dtype=np.int32), np.empty(0, dtype=np.int32)
    level = level_of(lattice, faces, leak, ends, axis, np.empty(0), (none, none))
    levels, steps = coarsen_boards(level, depth, _SMALL)
    made = lay_levels(levels, steps, place)
    if made is None:
        return None, levels, steps
    number = np.empty(2 * lattice.places, dtype=np.int64)
    number[place] = np.arange(len(rows))
    row_outside = system.unknown[node.ravel()[_cells(Lattice(shape), outer)]].astype(np.int64)
    window = Window(rows, Hierarchy(made[1], made[0], unit), number[inner], row_outside, unit * conductance)
    return window, levels, steps


def _rows(
    system: NodalSystem, node: NDArray[np.int32], box: Box, lattice: Lattice, pinned: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Rows of the cells of a window, and their places in it."""
    here = node[tuple(slice(a, b) for a, b in zip(box.low.tolist(), box.high.tolist(), strict=True))]
    row = np.where(here >= 0, system.unknown[here], -1)
    row[np.isin(row, pinned)] = -1
    rows, place = np.empty(row.size, dtype=np.int64), np.empty(row.size, dtype=np.int32)
    count = kernels.number_cells(row.ravel(), lattice.rows, lattice.margin, lattice.places, rows, place)
    return rows[:count], place[:count].copy()


def _cut(
    board: Board, shape: tuple[int, ...], box: Box, lattice: Lattice, faces: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Fill the faces of a window; places in it and around it, and conductances, of what leads out."""
    near = [(max(int(a) - 1, 0), min(int(b) + 1, n)) for a, b, n in zip(box.low, box.high, shape, strict=True)]
    line = np.arange(np.prod(shape[:-1])).reshape(shape[:-1])
    around = line[tuple(slice(*ends) for ends in near[:-1])]
    inside = line[tuple(slice(int(a), int(b)) for a, b in zip(box.low[:-1], box.high[:-1], strict=True))]
    window_first = np.full(line.size, -1)
    window_first[inside.ravel()] = lattice.rows
    room = 2 * sum(2 * faces.shape[1] // n for n in box.shape) + 2 * len(board.links) + 4 * len(faces)
    inner, outer = np.empty((2, room), dtype=np.int64)
    conductance = np.empty(room)
    count = kernels.cut_out(
        board, np.array(shape), around.ravel(), Lattice(shape).rows, window_first, int(box.low[-1]), int(box.high[-1]),
        lattice.margin, faces, inner, outer, conductance,
    )  # fmt: skip
    return inner[:count], outer[:count], conductance[:count]


def _cells(lattice: Lattice, place: NDArray[np.int64]) -> NDArray[np.int64]:
    """Flat indices of the cells at places of both colours."""
    cell = np.empty(len(place), dtype=np.int64)
    for colour in range(2):
        at = (place >= lattice.places) == (colour == 1)
        here = lattice.cells_at(colour, place[at] - colour * lattice.places)
        cell[at] = np.ravel_multi_index(here, lattice.shape)
    return cell
