"""The h-transform: levels for potentials that fall by many decades (Doob 1957).

A plain coarse node moves all of its members alike.  Where the potential falls by ten decades across it, what is right
for the high ones is ten decades too much for the low ones, and iterations pay for every decade.  Here members move in
proportion to a height ``h`` that falls about as the potential ``u`` does: in ``u / h`` coarse nodes are plain again,
and the circuit has the conductances ``g_ij h_i h_j``.  What preconditions then keeps all decades in proportion, and so
does every polynomial of it: conjugate gradients from 0 on, an error of 1 in proportion to ``u`` everywhere, gain digits
in all decades at once.

Coarse matrices are Galerkin sums over that circuit, with the imbalance of ``h`` among its leaks.  Where ``h`` is nearly
the potential itself, there is hardly any, and conductances are made to know length as on plain levels.  They span
hundreds of decades; in single precision every level has a diagonal of 1, and its scale goes into the weights by which
values pass to and fro.

The height comes from nested iteration, in which all numbers stay positive.  A level that is small is solved directly.
Then, level by level, the answer is spread over the blocks and made better by a multiplicative cycle (Horton &
Leutenegger 1994): it is relaxed, the level is put in proportion to it, and the coarse equations, whose answer is 1
where it is right, tell by what the blocks are multiplied.  Sums know of proportions only, so that what lies behind a
gap, lower by twenty decades, is put right as quickly as all else.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.errors import AccuracyError
from resgrid.solvers.columns import symmetric_factors
from resgrid.solvers.decay import MOST_DECADES
from resgrid.solvers.extended import Numbers
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.monitor import Watch
from resgrid.solvers.multigrid.blocks import Coarsened, sum_up
from resgrid.solvers.multigrid.conjugate_gradients import approximate
from resgrid.solvers.multigrid.graphs import Graph, pack_graphs
from resgrid.solvers.multigrid.grid_level import Level, in_double, level_of, stencil_of, to_graph
from resgrid.solvers.multigrid.hierarchy import (
    FirstLevel,
    Hierarchy,
    coarsen_beside,
    counted,
    largest_degree,
    lay_out_grid,
)
from resgrid.solvers.multigrid.krylov import black_residual, scatter_rows, sweep_colour
from resgrid.solvers.multigrid.levels import Finest, GridLevel, Levels, Way, blocks_of
from resgrid.solvers.multigrid.red_black import BLACK, RED, Edges, Stencil
from resgrid.solvers.refine import Approximation
from resgrid.solvers.team import ALONE, Team

_MOST_LEFT = 500
"""Nodes that may be left where grids end: their matrix is inverted."""

_LEAST_REST = 0.01
"""Share of a node's conductances that its leak leaves of its diagonal, at least."""

_LOW = 0.03
"""What is low gains digits a little later than the norm of the residual tells, to which it adds nothing."""

_SMALL = 4000
"""Nodes up to which a level is solved directly."""

_SWEEPS = 3


def scaled_approximation(
    laplacian: Laplacian, levels: Scalable, currents: NDArray[np.float64], watch: Watch | None, team: Team = ALONE
) -> Approximation | None:
    """What refines a solution on levels scaled by its h-transform; None where nested iteration fails.

    Shapes: `currents` (n,).
    """
    try:
        height = nested_iteration(levels, at_slots(levels, currents))
    except AccuracyError:
        return None
    if not np.all(np.isfinite(height)):
        return None
    hierarchy = levels.scaled(height)

    def passes(m: NDArray[np.float64], e: NDArray[np.int64], accuracy: float) -> Numbers:
        return approximate(laplacian, hierarchy, watch, m, e, _LOW * accuracy, team)

    return passes


def at_slots(levels: Scalable, currents: NDArray[np.float64]) -> NDArray[np.float64]:
    """Currents into the slots of the first level, in its unit, shape (2, slots)."""
    into = np.zeros((2, levels.level.lattice.slots))
    scatter_rows(levels.slot, currents, 1.0 / levels.unit, into.ravel())
    return into


@dataclass(frozen=True, eq=False)
class Scalable:
    """A grid's levels, coarsened and ready to be scaled by one height after another.

    `level`: the first one; `steps`: the others, down to one that is small, and the ways to them; `first`: the first
    level, as of `finest_stencils`; `slot` (n,): slot of every unknown, red ones first; `unit`:
    conductance that counts as 1 on all levels, in siemens; `box`: as of `Hierarchy`.
    """

    level: Level
    steps: list[Coarsened]
    first: FirstLevel
    slot: NDArray[np.int32]
    unit: float
    box: tuple[slice, ...]

    @property
    def unknown(self) -> NDArray[np.bool_]:
        """Whether there is an unknown at every slot, shape (2, slots)."""
        stencil = self.first[0]
        return np.stack([stencil.red_inverse > 0.0, stencil.black_degree > 0.0])

    def scaled(self, height: NDArray[np.float64]) -> Hierarchy:
        """Levels in proportion to a height that is nearly the solution.  Shapes: `height` (2, slots)."""
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
        first, *ways = (Way(*both) for both in zip(targets, weights, strict=True))
        grids = tuple(_in_single(*of) for of in zip(levels[1:-1], scales[1:-1], ways, strict=True))
        finest, largest = Finest(*self.first, first), self.unit * largest_degree(self.first[0])
        return Hierarchy(Levels(grids, graphs), self.slot, self.unit, largest, finest, self.box)


def scalable(laplacian: Laplacian, team: Team = ALONE) -> Scalable | None:
    """Coarsen a grid to be scaled; None where it is none, or is not small before it falls apart."""
    found = lay_out_grid(laplacian, team)
    if found is None:
        return None
    level, slot, unit, box = found
    levels, steps, first = coarsen_beside(level, team, keep=True)
    if not steps or levels[-1].size > _MOST_LEFT:
        return None
    return Scalable(level, steps, first, slot, unit, box)


def cut_off(height: NDArray[np.float64], unknown: NDArray[np.bool_]) -> NDArray[np.float64]:
    """A height where there are unknowns, lifted to where its square is a double."""
    lowest = 10.0**-MOST_DECADES * height.max()
    return np.asarray(np.maximum(height, lowest, out=np.zeros_like(height), where=unknown), dtype=np.float64)


def transformed(level: Level, stencil: Stencil, h: NDArray[np.float64]) -> Level:
    """The circuit of ``u / h``, with the leaks ``h_i (A h)_i``."""
    leak, relaxed, blocks = np.zeros_like(h), h.copy(), blocks_of(stencil)
    squares, total, inflow = np.empty(blocks), np.empty(stencil.block), leak[1]
    sweep_colour(stencil, RED, leak, relaxed, inflow, squares, total, (0, blocks))
    sweep_colour(stencil, BLACK, leak, h, inflow, squares, total, (0, blocks))
    np.add.at(inflow, stencil.off_black, stencil.couplings * h[0, stencil.off_red])
    np.divide(relaxed[0] - h[0], stencil.red_inverse, out=leak[0], where=stencil.red_inverse > 0.0)
    leak *= -h
    return replace(level, edges=_scaled_edges(level.edges, h), leak=leak)


def summed(level: Level, step: Coarsened, *, fed: bool) -> Level:
    """The next level, where conductances know length; leaks do as well, unless they balance currents that are fed."""
    plain = step.level
    found = sum_up(level, plain.lattice, step.whole_target, sum(len(cell) for cell in plain.extra_cell))
    assert found is not None
    edges, leak, _ = found
    before = np.empty(0) if fed else _degree(plain, edges)
    edges = edges._replace(faces=edges.faces * step.stretch, couplings=edges.couplings * step.off_stretch)
    total = _degree(plain, edges)
    if not fed:
        leak *= np.divide(total, before, out=np.ones_like(total), where=before > 0.0)
    np.maximum(leak, (_LEAST_REST - 1.0) * total, out=leak)
    return replace(plain, edges=edges, leak=leak, degree=total + leak)


def _degree(level: Level, edges: Edges) -> NDArray[np.float64]:
    """Conductances at every slot, summed, shape (2, slots)."""
    return level_of(level.lattice, edges, np.zeros((2, level.lattice.slots)), level.extra_cell).degree


def _scale(degree: NDArray[np.float64]) -> NDArray[np.float64]:
    """What makes the diagonal 1; 0 where nothing is."""
    scale = np.zeros_like(degree)
    np.power(degree, -0.5, out=scale, where=degree > 0.0)
    return scale


def _shares(height: NDArray[np.float64], scale: NDArray[np.float64]) -> NDArray[np.float32]:
    """What black slots of the first level take from their nodes."""
    return np.asarray(height * scale, dtype=np.float32)


def _quotients(
    scale: NDArray[np.float64], below: NDArray[np.float64], target: NDArray[np.int32]
) -> NDArray[np.float32]:
    """What black slots of a coarse level take from their nodes."""
    black = scale[1]
    quotient = np.divide(below.ravel()[target], black, out=np.zeros_like(black), where=black > 0.0)
    return np.asarray(quotient, dtype=np.float32)


def _in_single(level: Level, scale: NDArray[np.float64], way: Way) -> GridLevel:
    """A level for the compiled passes, its diagonal 1."""
    edges, one = _scaled_edges(level.edges, scale), (scale > 0.0).astype(np.float32)
    faces, couplings = edges.faces.astype(np.float32), edges.couplings.astype(np.float32)
    stencil = stencil_of(level, faces, couplings, one[0], one[1], np.empty(0, np.float32))
    return GridLevel(stencil, one[1].astype(np.float64), way)


def _scaled_edges(edges: Edges, t: NDArray[np.float64]) -> Edges:
    """The conductances ``t_i g_ij t_j``."""
    faces, inside = np.zeros_like(edges.faces), slice(edges.margin, edges.faces.shape[1] - edges.margin)
    for scaled, face, away in zip(faces, edges.faces, edges.distance.tolist(), strict=True):
        there = slice(inside.start + away, inside.stop + away)
        np.multiply(face[inside], t[0, inside], out=scaled[inside])
        scaled[inside] *= t[1, there]
    return edges._replace(faces=faces, couplings=edges.couplings * t[0, edges.off_red] * t[1, edges.off_black])


def _of_unit_diagonal(graph: Graph) -> Graph:
    row = np.repeat(np.arange(graph.size), np.diff(graph.indptr))
    scale = _scale(np.bincount(row, graph.conductance, graph.size) + graph.leak)
    conductance = graph.conductance * scale[row] * scale[graph.indices]
    leak = np.asarray(1.0 - np.bincount(row, conductance, graph.size), dtype=np.float64)
    return Graph(graph.indptr, graph.indices, conductance, leak)


def nested_iteration(levels: Scalable, currents: NDArray[np.float64]) -> NDArray[np.float64]:
    """About what the potential will be.  Shapes: `currents` (2, slots); returns (2, slots)."""
    steps, into = levels.steps, [_into_blocks(levels.steps[0], currents)]
    while steps[len(into) - 1].level.size > _SMALL and len(into) < len(steps):
        into.append(_into_blocks(steps[len(into)], into[-1]))
    coarse = _solved(steps[len(into) - 1].level, into[-1])
    for k in reversed(range(1, len(into))):
        level = steps[k - 1].level
        coarse = _improved(level, steps[k:], into[k - 1], _spread(level, steps[k], coarse))
    x = _spread(levels.level, steps[0], coarse)
    smooth(levels.first[0], currents, x, _SWEEPS)
    return x


def smooth(stencil: Stencil, currents: NDArray[np.float64], x: NDArray[np.float64], sweeps: int) -> None:
    """Gauss-Seidel by colour, in place: positive numbers stay positive; ``currents`` and ``x`` of shape (2, slots).

    A residual without a diagonal is what flows in, a sum of positive numbers.
    """
    degree, inflow = stencil.black_degree, np.empty(x.shape[1])
    without = stencil._replace(black_degree=np.zeros_like(degree))
    for _ in range(sweeps):
        black_residual(without, currents, x, inflow)
        np.divide(inflow, degree, out=x[1], where=degree > 0.0)


def _into_blocks(
    step: Coarsened, currents: NDArray[np.float64], weight: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Currents, times a weight, into the blocks."""
    fed = np.flatnonzero(currents)
    amps = currents.ravel()[fed] if weight is None else currents.ravel()[fed] * weight.ravel()[fed]
    summed = np.bincount(step.whole_target.ravel()[fed], amps, 2 * step.level.lattice.slots)
    return np.asarray(summed.reshape(2, -1), dtype=np.float64)


def _spread(level: Level, step: Coarsened, coarse: NDArray[np.float64]) -> NDArray[np.float64]:
    """A coarse potential, spread over its blocks."""
    x = coarse.ravel()[step.whole_target]
    x[level.degree == 0.0] = 0.0
    return x


def _improved(
    level: Level, steps: list[Coarsened], currents: NDArray[np.float64], x: NDArray[np.float64]
) -> NDArray[np.float64]:
    """A potential made better by one multiplicative cycle down the steps; ``x`` is used up."""
    if not steps:
        return _solved(level, currents)
    step, stencil = steps[0], in_double(replace(level, degree=level.degree.copy()))
    smooth(stencil, currents, x, _SWEEPS)
    x = cut_off(x, level.degree > 0.0)
    below = summed(transformed(level, stencil, x), step, fed=True)
    ones = (below.degree > 0.0).astype(np.float64)
    factor = _improved(below, steps[1:], _into_blocks(step, currents, x), ones)
    factor[~(factor > 0.0)] = 1.0
    x *= factor.ravel()[step.whole_target]
    smooth(stencil, currents, x, _SWEEPS)
    return x


def _solved(level: Level, currents: NDArray[np.float64]) -> NDArray[np.float64]:
    """Potential by sparse factors."""
    graph, number = to_graph(level)
    n, used = graph.size, np.flatnonzero(number >= 0)
    coupling = sparse.csr_array((graph.conductance, graph.indices, graph.indptr), shape=(n, n))
    matrix = sparse.diags_array(coupling.sum(axis=1) + graph.leak) - coupling
    potential = np.zeros(number.size)
    potential[used] = symmetric_factors(matrix).solve(currents.ravel()[used])
    return potential.reshape(currents.shape)
