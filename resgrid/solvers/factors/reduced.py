"""Solving after star-mesh elimination: carry the currents to the core, solve that, put the other voltages back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import AccuracyError
from resgrid.solvers.extended import Scaled
from resgrid.solvers.factors.factor import Factor, refine_normwise
from resgrid.solvers.monitor import Watch
from resgrid.solvers.refine import entry_bound, scaled_currents
from resgrid.solvers.star_mesh import StarMesh

ELIMINATION = "elimination"
"""The method's name where elimination leaves nothing to solve."""

NOISE = 2.0**-96
"""Relative difference of two voltages found by elimination alone below which it is noise."""


@dataclass(frozen=True, eq=False)
class ReducedFactor(Factor):
    """A matrix after star-mesh elimination, with a factor of its core.

    `laplacian`: as of every `Factor`; `mesh`: what was eliminated; `inner`: solves the core; None where there
    is none.
    """

    mesh: StarMesh
    inner: Factor | None

    @property
    def name(self) -> str:
        """The method that solves the core; ``"elimination"`` where nothing is left."""
        return self.inner.name if self.inner is not None else ELIMINATION

    def _solve(
        self, rhs: NDArray[np.float64], rtol: float, guess: NDArray[np.float64] | None, watch: Watch | None
    ) -> NDArray[np.float64]:
        x, error = refine_normwise(
            self.laplacian,
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
