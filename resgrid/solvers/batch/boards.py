"""Many chips of one grid by multigrid: the levels of the nominal chip precondition all of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.batch.chips import Chip
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.multigrid.board_passes import Board
from resgrid.solvers.multigrid.grid_levels import GridLevels, inverse_below, own_vectors
from resgrid.solvers.multigrid.hierarchy import Hierarchy, build_hierarchy

_MOST_ITERATIONS = 200
_DEPTH = 12
"""Steps of a burst at most."""

_ROUNDING = 16 * 2.0**-52
"""Share of ``|A| |x|`` up to which a residual may be what rounding leaves."""


@dataclass(frozen=True, eq=False)
class BoardBatch:
    """A grid made ready for other conductances.

    `hierarchy`: of the nominal chip; `grid`: its boards; `face` (entries,): where the entries of red rows belong on
    the board, as `kernels.refill` takes it; `start` (n,): where the iteration begins, in volts.
    """

    laplacian: Laplacian
    hierarchy: Hierarchy
    grid: GridLevels
    face: NDArray[np.int64]
    start: NDArray[np.float64]
    name = "multigrid"

    def solve(
        self, chips: Iterable[Chip], rtol: float, solution: NDArray[np.float64], reached: NDArray[np.bool_]
    ) -> None:
        """Solve for some chips, and tell which were.  Shapes: `solution` (chips, n), `reached` (chips,)."""
        from resgrid.solvers.batch import kernels

        ordinary = self.grid.largest_degree
        grid, inverse = _own_copies(self.grid), inverse_below(self.hierarchy.stack)
        places = len(grid.aggregate)
        leak, vectors = np.zeros((2, places)), np.zeros((3, 2, places))
        singles = np.zeros((3 + 1 + _DEPTH, places), dtype=np.float32)
        for number, (x, chip) in enumerate(zip(solution, chips, strict=True)):
            unit = self.hierarchy.unit * chip.mostly
            largest = kernels.refill(
                self.laplacian.edges.indptr, chip.entries, chip.ground, self.face, grid.place, unit, grid.true,
                grid.board, grid.exact, leak,
            )  # fmt: skip
            residual, wanted = kernels.solve_board(
                grid.true, grid.board, grid.exact, grid.aggregate, grid.boards, inverse, grid.place, chip.drive / unit,
                largest, ordinary, rtol, _MOST_ITERATIONS, self.start, x, vectors, singles[:3], singles[3:],
            )  # fmt: skip
            reached[number] = residual <= max(wanted, _ROUNDING * ordinary * float(np.linalg.norm(x)))


def board_batch(laplacian: Laplacian, drive: NDArray[np.float64]) -> BoardBatch | None:
    """Lay a grid out by colour; None where it has no two colours, or falls apart into graphs.  Shapes: `drive` (n,)."""
    from resgrid.solvers.multigrid.iteration import iterate

    hierarchy = build_hierarchy(laplacian)
    if hierarchy.grid is None or not len(inverse_below(hierarchy.stack)):
        return None
    start, _ = iterate(laplacian, hierarchy, drive, 1e-12)
    return BoardBatch(laplacian, hierarchy, hierarchy.grid, _faces(laplacian, hierarchy.grid), start)


def _faces(laplacian: Laplacian, grid: GridLevels) -> NDArray[np.int64]:
    edges, place, board = laplacian.edges, grid.place.astype(np.int64), grid.board
    places = len(grid.aggregate)
    row = np.repeat(np.arange(len(place)), np.diff(edges.indptr))
    of_entry = np.zeros(len(row), dtype=np.int64)
    entry = np.flatnonzero(place[row] < places)
    here, there = place[row[entry]], place[edges.indices[entry]] - places
    away = there - here
    face = np.full(len(entry), -1)
    for q, distance in enumerate(board.distance.tolist()):
        face[away == distance] = q
    links = np.flatnonzero(face < 0)
    face[links[np.lexsort((there[links], here[links]))]] = -1 - np.arange(len(links))
    of_entry[entry] = face
    return of_entry


def _own_copies(grid: GridLevels) -> GridLevels:
    """Boards and work space that nobody else writes to."""
    true, board = _copied(grid.true), _copied(grid.board)
    exact = board._replace(black_inverse=grid.exact.black_inverse, black_degree=grid.exact.black_degree.copy())
    return replace(grid, true=true, board=board, exact=exact, boards=own_vectors(grid.boards))


def _copied(board: Board) -> Board:
    arrays = ("faces", "links", "red_inverse", "black_inverse", "black_degree")
    return board._replace(**{name: getattr(board, name).copy() for name in arrays})
