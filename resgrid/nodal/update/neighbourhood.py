"""What lies around some rows: read off the board that multigrid keeps, or off compressed rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.multigrid.board_passes import Board
from resgrid.nodal.multigrid.hierarchy import Hierarchy
from resgrid.nodal.system import NodalSystem
from resgrid.nodal.update import kernels

_NEAR, _NEAR_SHARE = 4096, 16
"""Rows searched for a way around the changed cells, before the whole circuit is: so many, or one in so many."""


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """The neighbours of rows.

    `board`: the first level, in double precision; `place` (n,): places there; empty where there is no board; `unit`:
    conductance that counts as 1 on it, in siemens; `node` as the grid: node of every cell that it covers.
    """

    system: NodalSystem
    board: Board | None
    place: NDArray[np.int32]
    unit: float
    node: NDArray[np.int32]

    def between(self, pairs: NDArray[np.int64]) -> NDArray[np.float64]:
        """Conductance between pairs of rows, in siemens; 0 for none."""
        if not len(pairs):
            return np.empty(0)
        if self.board is None:
            return np.asarray(self.system.coupling[pairs[:, 0], pairs[:, 1]], dtype=np.float64).ravel()
        one, other = self._places(pairs[:, 0]), self._places(pairs[:, 1])
        return self.unit * kernels.between_places(self.board, one, other)

    def joins(self, rows: NDArray[np.int64]) -> int:
        """How many neighbours rows have, summed."""
        if self.board is None:
            return int(np.diff(self.system.coupling.indptr)[rows].sum())
        return kernels.count_neighbours(self.board, self._places(rows))

    def sums(
        self, excess: NDArray[np.float64], rows: NDArray[np.int64], apart: NDArray[np.int64]
    ) -> NDArray[np.float64] | None:
        """Return the degrees of all rows after a change, of which these have lost neighbours; None if not known.

        Rows that are cut off, the first of every pair that is set apart, are pinned by as much as held them before.
        """
        if self.board is None:
            return None
        rows = np.unique(rows)
        cut = np.isin(apart[:, 1], rows)
        degree = self.system.degree.copy()
        total = kernels.sum_others(self.board, self._places(rows), self._places(apart[cut, 0]))
        degree[rows] = self.unit * total + excess[rows]
        return degree

    def stay_together(
        self,
        before: NodalSystem,
        after: NodalSystem,
        rows: NDArray[np.int64],
        seeds: NDArray[np.int64],
    ) -> bool:
        """Whether the neighbours of rows that are cut off reach each other and the rails near by."""
        board = self.board
        if board is None:
            return False
        rails = before.rails
        span = 0.0 if rails is None else abs(rails.high - rails.low)
        touches = [kernels.contacts(before.excess[row], before.feed[row], span) for row in rows]
        label = np.zeros(2 * board.faces.shape[1], dtype=np.int32)
        label[self._places(rows)] = -1
        return kernels.stay_together(
            board, self.node.ravel(), np.array(self.node.shape), before.unknown, after.excess,
            np.ascontiguousarray(after.feed), span,
            self._places(seeds), np.any(touches, axis=0), max(_NEAR, before.size // _NEAR_SHARE), label,
        )  # fmt: skip

    def _places(self, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        return self.place[rows].astype(np.int64)


def neighbourhood(system: NodalSystem, hierarchy: Hierarchy | None) -> Neighbourhood:
    """Of a system, and of its hierarchy if the first level is a board."""
    grid, cell_map = None if hierarchy is None else hierarchy.grid, system.netlist.cell_map
    none = np.empty(0, dtype=np.int32)
    if hierarchy is None or grid is None or cell_map is None:
        return Neighbourhood(system, None, none, 1.0, none)
    return Neighbourhood(system, grid.true, grid.place, hierarchy.unit, cell_map.node[hierarchy.box])
