"""The levels of a changed circuit: patched where cells have changed, all else as it was.

The first level loses the resistors that are gone.  On the coarse ones, the blocks around the change are renewed by
those of a window that is coarsened by itself.  Nodes keep the blocks they belong to: a part that a new wall has split
off a block is left to the other levels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.multigrid.board_cycle import Boards
from resgrid.nodal.multigrid.board_passes import Board
from resgrid.nodal.multigrid.boards import Level
from resgrid.nodal.multigrid.coarsening import Coarsened
from resgrid.nodal.multigrid.grid_levels import GridLevels
from resgrid.nodal.multigrid.hierarchy import Hierarchy
from resgrid.nodal.multigrid.kernels import Stack
from resgrid.nodal.multigrid.lattice import Lattice
from resgrid.nodal.system import NodalSystem
from resgrid.nodal.update import kernels
from resgrid.nodal.update.change import Change
from resgrid.nodal.update.window import Box, Window, boxes_around, open_window, window_depth

_Places = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Of red and of black cells."""

_Level = TypeVar("_Level", Board, Boards)

_BLOCK_RESISTANCE = 0.125
"""Resistance on the way through a block of four to a point in it, in units of the mean resistance around."""

_ROUNDING = 1e-5
"""Share of a diagonal entry in single precision that may be rounding."""


def patch_levels(
    hierarchy: Hierarchy, system: NodalSystem, change: Change, cells: NDArray[np.int64]
) -> tuple[Hierarchy, tuple[Window, ...]] | None:
    """Patch the levels of a grid."""
    grid, cell_map = hierarchy.grid, system.netlist.cells
    assert grid is not None
    node, count = cell_map.node[hierarchy.box], len(grid.boards.margin)
    shape = node.shape
    depth = window_depth(shape, count + 1)
    boxes = boxes_around(_within(hierarchy.box, cells, cell_map.node.shape), shape, depth)
    if not boxes:
        return None
    true, board, exact = _patch_board(grid, system, hierarchy.unit, change)
    aggregate = grid.aggregate.copy()
    alone = grid.place[change.pinned] - len(aggregate)
    aggregate[alone[alone >= 0]] = 0
    boards = _own_arrays(grid.boards, "faces", "red_inverse", "black_inverse", "black_degree", "aggregate")
    stack, windows = hierarchy.stack, []
    for box in boxes:
        window, levels, steps = open_window(system, node, true, hierarchy.unit, box, change.pinned, depth)
        patch = _Patch(box, shape, levels, steps, boards)
        patch.leave(aggregate)
        for number in range(1, len(levels)):
            if number > count:
                stack = patch.tie(stack)
            elif not patch.renew(number):
                break
        windows += [] if window is None else [window]
    levels_after = GridLevels(true, board, exact, grid.place, aggregate, boards, grid.weight)
    return replace(hierarchy, stack=stack, grid=levels_after), tuple(windows)


def _within(box: tuple[slice, ...], cells: NDArray[np.int64], shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Indices in a box, shape (k, ndim), of those cells of the whole grid that lie in it."""
    low, high = (np.array([getattr(ends, name) for ends in box]) for name in ("start", "stop"))
    index = np.stack(np.unravel_index(cells, shape), axis=1).astype(np.int64)
    return np.asarray(index[np.all((index >= low) & (index < high), axis=1)] - low)


def _own_arrays(level: _Level, *names: str) -> _Level:
    """A level with copies of these arrays."""
    return level._replace(**{name: getattr(level, name).copy() for name in names})


def _patch_board(grid: GridLevels, system: NodalSystem, unit: float, change: Change) -> tuple[Board, Board, Board]:
    """The first level after the change, in all three precisions."""
    true = _own_arrays(grid.true, "faces", "links", "red_inverse", "black_degree")
    board = _own_arrays(grid.board, "faces", "links", "red_inverse", "black_inverse")
    pairs = grid.place[change.pairs].astype(np.int64)
    rows = np.setdiff1d(change.pairs, change.pinned)
    place = grid.place[rows].astype(np.int64)
    for level in (true, board):
        kernels.separate(level, pairs[:, 0], pairs[:, 1])
    black = place >= len(grid.aggregate)
    at_red, at_black = place[~black], place[black] - len(grid.aggregate)
    degree = kernels.sum_others(true, place, place[:0]) + system.excess[rows] / unit
    true.red_inverse[at_red] = 1.0 / degree[~black]
    true.black_degree[at_black] = degree[black]
    board.red_inverse[at_red] = true.red_inverse[at_red]
    board.black_inverse[at_black] = 1.0 / true.black_degree[at_black]
    diagonal = grid.exact.black_degree.copy()
    pinned = grid.place[change.pinned].astype(np.int64) - len(grid.aggregate)
    around = np.unique(np.concatenate([at_black, pinned[pinned >= 0], kernels.black_beside(true, at_red)]))
    diagonal[around] = kernels.compensated_degrees(true, board, around)
    exact = board._replace(black_inverse=grid.exact.black_inverse, black_degree=diagonal)
    return true, board, exact


@dataclass(frozen=True, eq=False)
class _Patch:
    """What a window's levels renew on those of the whole grid.

    `shape`: of the grid; `levels, steps`: of the window; `boards`: the coarse boards, whose arrays are renewed in
    place.
    """

    box: Box
    shape: tuple[int, ...]
    levels: list[Level]
    steps: list[Coarsened]
    boards: Boards

    def _shift(self, number: int) -> NDArray[np.int64]:
        """By how many bits the indices of cells have been shifted down to a level, along every axis."""
        shift = np.zeros(len(self.shape), dtype=np.int64)
        for level, coarse in zip(self.levels[:number], self.levels[1 : number + 1], strict=True):
            shift += np.array(level.lattice.shape) != np.array(coarse.lattice.shape)
        return shift

    def _ranges(self, number: int) -> tuple[Lattice, NDArray[np.int64], NDArray[np.int64]]:
        """The grid's lattice of a level, and the cells there that are to be renewed: those from ... to behind ..."""
        shift = self._shift(number)
        whole = (np.array(self.shape) - 1 >> shift) + 1
        low, high = self.box.low >> shift, (self.box.high - 1 >> shift) + 1
        low, high = np.where(low > 0, low + 1, 0), np.where(high < whole, high - 1, whole)
        first = np.maximum((self.box.first >> shift) - 1, low)
        last = np.minimum((self.box.last - 1 >> shift) + 2, high)
        return Lattice(tuple(whole.tolist())), first, last

    def _both(self, number: int) -> tuple[Lattice, _Places, _Places] | None:
        """Places to be renewed on a level of the grid, and the same in the window; None if there are none."""
        lattice, first, last = self._ranges(number)
        if np.any(first >= last):
            return None
        origin = self.box.low >> self._shift(number)
        return (
            lattice,
            _places(lattice, first, last),
            _places(self.levels[number].lattice, first - origin, last - origin),
        )

    def leave(self, aggregate: NDArray[np.int32]) -> None:
        """Take black places whose part has been split off a block away from the block, in place."""
        both = self._both(0)
        if both is not None and self.steps:
            self._split(0, both[1][1], both[2][1], aggregate)

    def _split(
        self, number: int, there: NDArray[np.int64], here: NDArray[np.int64], aggregate: NDArray[np.int32]
    ) -> None:
        """The same for black places of any level of the grid, and of the window."""
        if number + 1 >= min(len(self.boards.margin) + 1, len(self.levels)):
            return
        coarse = self.levels[number + 1].lattice
        split = self.steps[number].target[here] % coarse.places >= coarse.first_extra
        whole = self._ranges(number + 1)[0]
        places = int(self.boards.places[number + 1] - self.boards.places[number])
        split &= aggregate[there] % places < whole.first_extra
        aggregate[there[split]] = 0

    def renew(self, number: int) -> bool:
        """Renew a coarse board in place; returns whether its lattice is the window's."""
        boards, level = self.boards, self.levels[number]
        a, e = boards.places[number - 1 : number + 1]
        both = self._both(number)
        if both is None:
            return False
        lattice, there, here = both
        if not np.array_equal(lattice.distance, boards.distance[number - 1]):
            return False
        sides = len(level.faces)
        boards.faces[sides * a : sides * e].reshape(sides, e - a)[:, there[0]] = level.faces[:, here[0]]
        with np.errstate(divide="ignore"):
            inverse = [np.where(degree > 0.0, 1.0 / degree, 0.0) for degree in map(np.take, level.degree, here)]
        boards.red_inverse[a + there[0]], boards.black_inverse[a + there[1]] = inverse
        boards.black_degree[a + there[1]] = level.degree[1, here[1]]
        self._split(number, there[1], here[1], boards.aggregate[a:e])
        return True

    def tie(self, stack: Stack) -> Stack:
        """The graphs below the boards, their nodes around the change tied to the rails as the window's are."""
        number = len(self.levels) - 1
        both, before = self._both(number), self._both(number - 1)
        if both is None or before is None or number < 2:
            return stack
        # A node of the graph is known by the black places that belong to it.
        node = np.zeros(self.levels[number].degree.size, dtype=np.int64)
        a, e = self.boards.places[number - 2 : number]
        node[self.steps[number - 1].target[before[2][1]]] = self.boards.aggregate[a:e][before[1][1]]
        level = self.levels[number]
        here = np.concatenate([both[2][0], both[2][1] + level.lattice.places])
        here = here[(node[here] > 0) & (level.degree.ravel()[here] > 0)]
        nodes, leak = node[here] - 1, level.leak.ravel()[here]
        entries = np.concatenate(
            [[0.0], np.cumsum(stack.conductance[: stack.indptr[stack.first[1]]], dtype=np.float64)]
        )
        coupled = entries[stack.indptr[nodes + 1]] - entries[stack.indptr[nodes]]
        return _tie(stack, nodes, leak - (stack.diagonal[nodes] - coupled))


def _places(lattice: Lattice, first: NDArray[np.int64], last: NDArray[np.int64]) -> _Places:
    """Red and black places of a range of cells."""
    number = lattice.number(np.ix_(*(np.arange(a, b) for a, b in zip(first, last, strict=True)))).ravel()
    black = number & 1 == 1
    return lattice.margin + (number[~black] >> 1), lattice.margin + (number[black] >> 1)


def _tie(stack: Stack, nodes: NDArray[np.int64], leak: NDArray[np.float64]) -> Stack:
    """Tie nodes of the first level, and the coarser ones they belong to, to the rails by so much more.

    From level to level the way to a point takes its share of the block's own resistance (as in
    `aggregation.lengthen`).  Where a level is left by elimination, the tie ends: it only preconditions.
    """
    more = leak > _ROUNDING * stack.diagonal[nodes]
    nodes, leak = nodes[more], leak[more]
    if not len(nodes):
        return stack
    diagonal, inverse, coarsest = stack.diagonal.copy(), stack.inverse.copy(), stack.coarsest
    last = len(stack.first) - 2
    for level in range(last + 1):
        nodes, member = np.unique(nodes, return_inverse=True)
        leak = np.asarray(np.bincount(member, leak), dtype=np.float64)
        if level == last:
            coarsest = _hold(coarsest, nodes - stack.first[level], leak)
        diagonal[nodes] += leak
        inverse[nodes] = 1.0 / diagonal[nodes]
        if level == last or stack.eliminated[level + 1] > stack.eliminated[level]:
            break
        begin, end = stack.indptr[nodes].astype(np.int64), stack.indptr[nodes + 1].astype(np.int64)
        # The diagonal is little more than the sum of the conductances.
        mean = stack.diagonal[nodes] / np.maximum(end - begin, 1)
        leak = 1.0 / (1.0 / leak + _BLOCK_RESISTANCE / mean)
        nodes = stack.aggregate[nodes].astype(np.int64)
    return stack._replace(diagonal=diagonal, inverse=inverse, coarsest=coarsest)


def _hold(inverse: NDArray[np.float32], nodes: NDArray[np.int64], leak: NDArray[np.float64]) -> NDArray[np.float32]:
    """The inverse after diagonal entries have grown (Sherman & Morrison 1950)."""
    if not inverse.size:
        return inverse
    after = inverse.astype(np.float64)
    for node, amount in zip(nodes, leak, strict=True):
        column = after[:, node].copy()
        after -= np.outer(column, after[node] / (1.0 / amount + column[node]))
    return after.astype(np.float32)
