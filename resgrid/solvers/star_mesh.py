"""Star-mesh elimination of rows with at most two neighbours: series resistors, dead ends, rings and what they leave.

Corridors one or two cells wide, trees and chains vanish altogether; of other circuits a core is left, a matrix of its
own.  Everything is a sum, product or quotient of positive numbers in double-double, so that no accuracy depends on how
the conductances differ: a chain of 1e12 S grounded through 1e-12 S keeps all its digits.  Solving carries the currents
to the core, solves that, and puts the other voltages back.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import AccuracyError
from resgrid.solvers.extended import Scaled
from resgrid.solvers.factor import Factor, Residual, refine_normwise
from resgrid.solvers.laplacian import Connections, Laplacian, Rows
from resgrid.solvers.monitor import Watch
from resgrid.solvers.refine import entry_bound, scaled_currents

if TYPE_CHECKING:
    from resgrid.solvers.star_mesh_kernels import Log, QuotientGraph

ELIMINATION = "elimination"
"""The method's name where elimination leaves nothing to solve."""

NOISE = 2.0**-96
"""Relative difference of two voltages found by elimination alone below which it is noise."""


_CORRIDOR = 3.1
"""Neighbours a row in corridors two cells wide."""

_FEW = 0.12
"""Share of rows with at most two neighbours from which elimination may pay anywhere."""

_SMALL = 100
"""Rows up to which it always may."""

_LARGEST, _SMALLEST = 2.0**300, 2.0**-300
"""Range of conductances that products of them can bear, in siemens."""

_MOST_ROUNDS = 20


@dataclass(frozen=True, eq=False)
class StarMesh:
    """What star-mesh elimination leaves of a matrix.

    `log`: how rows were eliminated, one entry each; `kept` (core rows,): rows that are left; `number` (n,): their
    number among these, -1 for the others; `edges` (core rows, core rows): edge conductances, in siemens, in double
    precision; `ground` (core rows,): ground conductances, in siemens.
    """

    log: Log
    kept: NDArray[np.int64]
    number: NDArray[np.int32]
    edges: Rows
    ground: NDArray[np.float64]

    @property
    def count(self) -> int:
        """Number of rows that were eliminated."""
        return len(self.log.rows)

    def feed_kept(self, currents: NDArray[np.float64]) -> NDArray[np.float64]:
        """What is fed into the rows that are left, (core rows,), of what is fed into all, (n,)."""
        from resgrid.solvers.star_mesh_kernels import forward

        carried = currents.copy()
        forward(self.log, carried)
        return carried[self.kept]


def may_shrink(laplacian: Laplacian, found: Connections) -> bool:
    """Tell cheaply whether elimination may take a fair share of the rows.

    It may where one row in eight has at most two neighbours, or where there are about three neighbours a row as in
    corridors two cells wide; and only within the range of conductances that products of them can bear.
    """
    n = laplacian.size
    if not n or found.entries >= 2**31:
        return False
    if found.entries > _CORRIDOR * n and n > _SMALL and found.few < _FEW * n:
        return False
    return found.largest < _LARGEST and found.smallest > _SMALLEST


def shrink(laplacian: Laplacian) -> tuple[StarMesh, Laplacian | None]:
    """Eliminate every row that has, or comes to have, at most two neighbours; no core where nothing is left."""
    mesh = eliminate_rows(laplacian.as_rows(), laplacian.ground)
    if not len(mesh.kept):
        return mesh, None
    rails = laplacian.rails
    if rails is not None:
        rails = rails.tied(mesh.feed_kept(rails.to_high), mesh.feed_kept(rails.to_low))
    return mesh, Laplacian(mesh.ground, compressed=mesh.edges, dimensions=laplacian.dimensions, rails=rails)


def eliminate_rows(edges: Rows, ground: NDArray[np.float64]) -> StarMesh:
    """Eliminate rows of at most two neighbours until there are none.

    Time and memory are linear in the number of conductances.  Conductances that come to join the same two rows are
    merged at once where one of the rows is short; between two hubs they wait for a pass over all rows.

    Shapes: `edges` (n, n), sorted; `ground` (n,).
    """
    from resgrid.solvers import star_mesh_kernels as kernels

    n, count, doubled = len(ground), 0, 1
    graph = _quotient_graph(edges, ground)
    log = kernels.Log(np.empty((n, 3), dtype=np.int32), np.empty((n, 6)))
    for round_ in range(_MOST_ROUNDS):
        if round_:
            kernels.merge_parallel(graph)
        count, doubled = kernels.eliminate(graph, log, count)
        if not doubled or count == n:
            break
    if doubled:
        kernels.merge_parallel(graph)
    kept = np.flatnonzero(~graph.gone)
    number = np.full(n, -1, dtype=np.int32)
    number[kept] = np.arange(len(kept), dtype=np.int32)
    indptr = np.concatenate([np.zeros(1, dtype=np.int32), np.cumsum(graph.length[kept], dtype=np.int32)])
    indices, conductance = np.empty(indptr[-1], dtype=np.int32), np.empty(indptr[-1])
    kernels.pack(graph, number, indptr, indices, conductance)
    order = np.argsort(np.repeat(np.arange(len(kept)), np.diff(indptr)) * len(kept) + indices)
    core = Rows(indptr, indices[order], conductance[order], ordered=True)
    return StarMesh(kernels.Log(log.rows[:count], log.weights[:count]), kept, number, core, graph.ground[kept])


def _quotient_graph(edges: Rows, ground: NDArray[np.float64]) -> QuotientGraph:
    from resgrid.solvers import star_mesh_kernels as kernels

    indptr, indices = edges.indptr.astype(np.int32), edges.indices.astype(np.int32)
    twin = np.empty_like(indices)
    kernels.find_twins(indptr, indices, twin)
    return kernels.QuotientGraph(
        start=indptr[:-1].copy(),
        length=np.diff(indptr),
        neighbour=indices,
        twin=twin,
        g=edges.data.astype(np.float64),
        g_low=np.zeros(len(indices)),
        ground=ground.astype(np.float64),
        ground_low=np.zeros(len(ground)),
        gone=np.zeros(len(ground), dtype=np.bool_),
    )


@dataclass(frozen=True, eq=False)
class ReducedFactor(Factor):
    """A matrix after star-mesh elimination, with a factor of its core.

    `laplacian`: as of every `Factor`; `mesh`: what was eliminated; `inner`: solves the core; None where there
    is none; `plain`: residuals of normwise answers, where many will be asked for.
    """

    mesh: StarMesh
    inner: Factor | None
    plain: Residual | None = None

    @property
    def name(self) -> str:
        """The method that solves the core; ``"elimination"`` where nothing is left."""
        return self.inner.name if self.inner is not None else ELIMINATION

    def _solve(
        self, rhs: NDArray[np.float64], rtol: float, guess: NDArray[np.float64] | None, watch: Watch | None
    ) -> NDArray[np.float64]:
        x, error = refine_normwise(
            self.plain or Residual.of(self.laplacian),
            rhs,
            lambda residual: self._once(residual, rtol, None, watch),
            self._once(rhs, rtol, guess, watch),
            rtol,
        )
        return self._judged(x, error, rtol, watch)

    def _once(
        self, rhs: NDArray[np.float64], rtol: float, guess: NDArray[np.float64] | None, watch: Watch | None
    ) -> NDArray[np.float64]:
        from resgrid.solvers import star_mesh_kernels as kernels

        mesh = self.mesh
        x = rhs.copy()
        kernels.forward(mesh.log, x)
        if self.inner is not None:
            begin = None if guess is None else guess[mesh.kept]
            try:
                x[mesh.kept] = self.inner.solve(x[mesh.kept], rtol=rtol, guess=begin, watch=watch)
            except AccuracyError as error:
                # The whole laplacian is judged by itself, and told with all of its rows.
                x[mesh.kept] = np.asarray(error.best, dtype=np.float64)
        kernels.backward(mesh.log, x)
        return x

    def _solve_nonnegative(self, rhs: NDArray[np.float64] | Scaled, watch: Watch | None) -> tuple[Scaled, float]:
        """As every `Factor` does.

        Both substitutions add and multiply non-negative numbers only, in scaled double-double: where nothing is left
        of the core, every voltage is right to about ``n`` units of the thirtieth digit.  The core is solved for
        conductances rounded to double precision, a relative change of 1e-16 in each.  The error is the larger one of
        the core and of the whole laplacian.
        """
        from resgrid.solvers import star_mesh_kernels as kernels
        from resgrid.solvers.refine_kernels import exact_residual

        mesh = self.mesh
        current, scale = scaled_currents(rhs)
        hi, lo, e = current.copy(), np.zeros(len(current)), scale.copy()
        kernels.forward_scaled(mesh.log, hi, lo, e)
        kept = mesh.kept
        core, core_error = self._core_solution(Scaled(hi[kept], lo[kept], e[kept]), watch)
        hi[kept], lo[kept], e[kept] = core.hi, core.lo, core.exponent
        kernels.backward_scaled(mesh.log, hi, lo, e)
        x, out = Scaled(hi, lo, e, core.noise), (np.empty(len(hi)), np.empty(len(hi), dtype=np.int64))
        error, violation = exact_residual(self.laplacian.conductances, (current, scale), x, out)
        if watch is not None:
            watch.done(max(error, core_error), entry_bound(violation))
        return x, max(error, core_error)

    def _core_solution(self, rhs: Scaled, watch: Watch | None) -> tuple[Scaled, float]:
        if self.inner is None or not rhs.hi.any():
            return rhs._replace(noise=NOISE), 0.0
        return self.inner.solve_nonnegative(rhs, watch=watch)
