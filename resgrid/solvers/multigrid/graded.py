"""Levels for potentials that fall by many decades: what belongs to a coarse node is graded as the potential is.

A plain coarse node moves all of its members alike.  Where the potential falls by ten decades across it, what is right
for the high ones is ten decades too much for the low ones, and iterations pay for every decade.  Here members move in
proportion to a height ``h`` that falls about as the potential ``u`` does: in ``u / h`` coarse nodes are plain again,
and the circuit has the conductances ``g_ij h_i h_j`` (Doob's h-transform).  What preconditions then keeps all decades
in proportion, and so does every polynomial of it: conjugate gradients from 0 on, an error of 1 in proportion to ``u``
everywhere, gain digits in all decades at once.

Coarse matrices are Galerkin sums over that circuit, with the imbalance of ``h`` among its leaks.  Where ``h`` is nearly
the potential itself, there is hardly any, and conductances are made to know length as on plain levels.  They span
hundreds of decades; in single precision every level has a diagonal of 1, and its scale goes into the weights by which
values pass to and fro.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.multigrid import grade_kernels
from resgrid.solvers.multigrid.board_passes import Board
from resgrid.solvers.multigrid.board_setup import sum_degrees
from resgrid.solvers.multigrid.boards import Level, board_of, frame, to_graph
from resgrid.solvers.multigrid.coarsening import Coarsened, sum_up
from resgrid.solvers.multigrid.cycle import Finest
from resgrid.solvers.multigrid.grading import MOST_DECADES
from resgrid.solvers.multigrid.graphs import Graph
from resgrid.solvers.multigrid.hierarchy import (
    NO_GROUND,
    Hierarchy,
    coarsen_grid,
    counted,
    finest_boards,
    largest_degree,
    lay_out_grid,
)
from resgrid.solvers.multigrid.packing import pack_graphs, pack_grids, pack_levels

_MOST_LEFT = 500
"""Nodes that may be left where boards end: their matrix is inverted."""

_LEAST_REST = 0.01
"""Share of a node's conductances that its leak leaves of its diagonal, at least."""


@dataclass(frozen=True, eq=False)
class Gradable:
    """A grid's levels, coarsened and ready to be graded by one height after another.

    `level`: the first one; `steps`: the others, down to one that is small, and the ways to them; `first`: the first
    level, as of `finest_boards`; `place` (n,): place of every unknown, red ones first; `unit`:
    conductance that counts as 1 on all levels, in siemens; `box`: as of `Hierarchy`.
    """

    level: Level
    steps: list[Coarsened]
    first: tuple[Board, Board, Board]
    place: NDArray[np.int32]
    unit: float
    box: tuple[slice, ...]

    @cached_property
    def unknown(self) -> NDArray[np.bool_]:
        """Whether there is an unknown at every place, shape (2, places)."""
        board = self.first[0]
        return np.stack([board.red_inverse > 0.0, board.black_degree > 0.0])

    def grade(self, height: NDArray[np.float64]) -> Hierarchy:
        """Levels in proportion to a height that is nearly the solution.  Shapes: `height` (2, places)."""
        height = cut_off(height, self.unknown)
        levels, scales = [transformed(self.level, self.first[0], height)], [height]
        for step in self.steps:
            levels.append(summed(levels[-1], step, fed=False))
            scales.append(_scale(levels[-1].degree))
        targets = [step.target for step in self.steps]
        weights = [_shares(height[1], scales[1].ravel()[targets[0]])]
        weights += [_quotients(*of) for of in zip(scales[1:], scales[2:], targets[1:], strict=False)]
        graph, number = to_graph(levels[-1])
        graphs, rank = pack_graphs([_of_unit_diagonal(graph)], [])
        targets[-1] = counted(number, rank, targets[-1])
        boards = [_in_single(*both) for both in zip(levels[1:-1], scales[1:-1], strict=True)]
        grids = pack_grids(boards, targets[1:], weights[1:], len(self.level.faces) // 2)
        true, board, exact = self.first
        finest = Finest(board, exact, targets[0], weights[0], NO_GROUND)
        largest = self.unit * largest_degree(true)
        return Hierarchy(pack_levels(grids, graphs), self.place, self.unit, largest, finest, true, self.box)


def gradable(laplacian: Laplacian) -> Gradable | None:
    """Coarsen a grid to be graded; None where it is none, or is not small before its boards fall apart."""
    found = lay_out_grid(laplacian)
    if found is None:
        return None
    level, place, unit, box = found
    levels, steps = coarsen_grid(level, keep=True)
    if not steps or levels[-1].size > _MOST_LEFT:
        return None
    return Gradable(level, steps, finest_boards(level), place, unit, box)


def cut_off(height: NDArray[np.float64], unknown: NDArray[np.bool_]) -> NDArray[np.float64]:
    """A height where there are unknowns, lifted to where its square is a double."""
    lowest = 10.0**-MOST_DECADES * height.max()
    return np.asarray(np.maximum(height, lowest, out=np.zeros_like(height), where=unknown), dtype=np.float64)


def transformed(level: Level, board: Board, h: NDArray[np.float64]) -> Level:
    """The circuit of ``u / h``."""
    faces, leak, (red, black) = np.zeros_like(level.faces), np.zeros_like(h), level.ends
    np.add.at(leak[0], red, level.links * h[1, black])
    np.add.at(leak[1], black, level.links * h[0, red])
    grade_kernels.transform(board, h, faces, leak)
    return replace(level, faces=faces, leak=leak, links=level.links * h[0, red] * h[1, black])


def summed(level: Level, step: Coarsened, *, fed: bool) -> Level:
    """The next level, where conductances know length; leaks do as well, unless they balance currents that are fed."""
    plain = step.level
    found = sum_up(level, plain.lattice, step.whole_target, sum(len(cell) for cell in plain.extra_cell))
    assert found is not None
    faces, leak, _, _, _, links = found
    before = np.empty(0) if fed else _degree(plain, faces, links)
    faces *= step.stretch
    links *= step.link_stretch
    total = _degree(plain, faces, links)
    if not fed:
        leak *= np.divide(total, before, out=np.ones_like(total), where=before > 0.0)
    np.maximum(leak, (_LEAST_REST - 1.0) * total, out=leak)
    return replace(plain, faces=faces, leak=leak, degree=total + leak, links=links)


def _degree(level: Level, faces: NDArray[np.float64], links: NDArray[np.float64]) -> NDArray[np.float64]:
    """Conductances at every place, summed, shape (2, places)."""
    degree = np.zeros((2, level.lattice.places))
    sum_degrees(faces, *frame(level.lattice), level.ends[0], level.ends[1], links, degree)
    return degree


def _scale(degree: NDArray[np.float64]) -> NDArray[np.float64]:
    """What makes the diagonal 1; 0 where nothing is."""
    scale = np.zeros_like(degree)
    np.power(degree, -0.5, out=scale, where=degree > 0.0)
    return scale


def _shares(height: NDArray[np.float64], scale: NDArray[np.float64]) -> NDArray[np.float32]:
    """What black places of the first level take from their nodes."""
    return np.asarray(height * scale, dtype=np.float32)


def _quotients(
    scale: NDArray[np.float64], below: NDArray[np.float64], target: NDArray[np.int32]
) -> NDArray[np.float32]:
    """What black places of a coarse level take from their nodes."""
    black = scale[1]
    quotient = np.divide(below.ravel()[target], black, out=np.zeros_like(black), where=black > 0.0)
    return np.asarray(quotient, dtype=np.float32)


def _in_single(level: Level, scale: NDArray[np.float64]) -> Board:
    """A level for the compiled passes, its diagonal 1."""
    lattice, (red, black) = level.lattice, level.ends
    faces = np.zeros(level.faces.shape, dtype=np.float32)
    grade_kernels.scale_faces(level.faces, *frame(lattice), scale, faces)
    one = (scale > 0.0).astype(np.float32)
    links = (level.links * scale[0, red] * scale[1, black]).astype(np.float32)
    return board_of(level, faces, links, one[0], one[1], one[1])


def _of_unit_diagonal(graph: Graph) -> Graph:
    row = np.repeat(np.arange(graph.size), np.diff(graph.indptr))
    scale = _scale(np.bincount(row, graph.conductance, graph.size) + graph.leak)
    conductance = graph.conductance * scale[row] * scale[graph.indices]
    leak = np.asarray(1.0 - np.bincount(row, conductance, graph.size), dtype=np.float64)
    return Graph(graph.indptr, graph.indices, conductance, leak)
