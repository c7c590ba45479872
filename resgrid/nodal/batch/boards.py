"""Many chips of one grid by multigrid: the levels of the nominal chip precondition all of them."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import AccuracyError
from resgrid.nodal.batch.pattern import Pattern
from resgrid.nodal.multigrid.checkerboard_kernels import Board
from resgrid.nodal.multigrid.hierarchy import Hierarchy, build_hierarchy
from resgrid.nodal.multigrid.kernels import Stack

_MOST_ITERATIONS = 200


@dataclass(frozen=True, eq=False)
class BoardBatch:
    """A grid made ready for other conductances.

    Attributes
    ----------
    pattern : Pattern
    hierarchy : Hierarchy
        Of the nominal chip, with a board.
    face : ndarray of int64, shape (entries,)
        Where the entries of red rows belong on the board, as `kernels.refill` takes it.
    start : ndarray of float64, shape (n,)
        Where the iteration begins, in volts.
    """

    pattern: Pattern
    hierarchy: Hierarchy
    face: NDArray[np.int64]
    start: NDArray[np.float64]
    name = "multigrid"

    def solve(self, conductance: NDArray[np.float64], rtol: float) -> NDArray[np.float64]:
        """Voltages of the rows for every chip, shape (chips, n), in volts.

        Parameters
        ----------
        conductance : ndarray of float64, shape (chips, resistors)
            In siemens.
        rtol : float
            Bound on the residual norm relative to that of the right-hand side.

        Raises
        ------
        AccuracyError
            If a chip is so far from the nominal one that the iteration stagnates.
        """
        from resgrid.nodal.batch import kernels

        system, hierarchy = self.pattern.system, self.hierarchy
        board, stack = _own_copies(hierarchy)
        indptr, indices = system.coupling.indptr.view(np.uint32), system.coupling.indices.view(np.uint32)
        inverse, places = np.empty(system.size), len(board.aggregate)
        doubles, singles = np.empty((6, places)), np.empty((2, places), dtype=np.float32)
        solution = np.empty((len(conductance), system.size))
        for x, chip in zip(solution, conductance, strict=True):
            entries, excess, b = self.pattern.rows(chip)
            degree = kernels.refill(indptr, entries, excess, self.face, hierarchy.place, hierarchy.unit, board, inverse)
            x[:] = self.start
            residual = kernels.solve_board(
                board, stack, indptr, indices, entries, excess, inverse, hierarchy.place, hierarchy.reach,
                hierarchy.unit, degree, b, rtol, _MOST_ITERATIONS, x, doubles, singles,
            )  # fmt: skip
            check_error(residual, degree, x, b, rtol)
        return solution


def check_error(residual: float, degree: float, x: NDArray[np.float64], b: NDArray[np.float64], rtol: float) -> None:
    """Refuse a solution whose normwise backward error exceeds a bound."""
    error = residual / (2.0 * degree * float(np.linalg.norm(x)) + float(np.linalg.norm(b)) or 1.0)
    if not error <= rtol:
        raise AccuracyError(
            f"a chip stagnates at a backward error of {error:.1e}, above rtol = {rtol:.1e}: its conductances differ "
            "too much from those of the netlist; solve such chips one by one",
            x,
        )


def board_batch(pattern: Pattern) -> BoardBatch | None:
    """Lay a grid out by colour; None where it has no two colours."""
    from resgrid.nodal.multigrid.iteration import iterate

    system = pattern.system
    hierarchy = build_hierarchy(system)
    if hierarchy.board is None:
        return None
    start, _ = iterate(system, hierarchy, system.feed + system.injected, 1e-12)
    return BoardBatch(pattern, hierarchy, _faces(pattern, hierarchy, hierarchy.board), start)


def _faces(pattern: Pattern, hierarchy: Hierarchy, board: Board) -> NDArray[np.int64]:
    coupling, place = pattern.system.coupling, hierarchy.place
    row = np.repeat(np.arange(len(place)), np.diff(coupling.indptr))
    of_entry = np.zeros(len(row), dtype=np.int64)
    entry = np.flatnonzero(place[row] < 0)
    here, there = -1 - place[row[entry]], place[coupling.indices[entry]]
    away = there - here
    face = np.full(len(entry), -1)
    face[away == board.aside[(here - board.margin) // board.width]] = len(board.distance)
    for q, distance in enumerate(board.distance.tolist()):
        face[away == distance] = q
    wraps = np.flatnonzero(face < 0)
    face[wraps[np.argsort(here[wraps], kind="stable")]] = -1 - np.arange(len(wraps))
    of_entry[entry] = face
    return of_entry


def _own_copies(hierarchy: Hierarchy) -> tuple[Board, Stack]:
    """Board and work space that nobody else writes to."""
    assert hierarchy.board is not None
    return copy.deepcopy(hierarchy.board), copy.deepcopy(hierarchy.stack)
