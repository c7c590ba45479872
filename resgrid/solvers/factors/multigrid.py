"""The multigrid method as a factor: normwise answers, and entrywise ones by refinement.

The algorithm is told on one page in `resgrid.solvers.multigrid`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.decay import decades_in_slit, h_transform_pays
from resgrid.solvers.extended import Scaled
from resgrid.solvers.factors.factor import Factor
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.monitor import Watch
from resgrid.solvers.refine import Approximation, Refined, refine
from resgrid.solvers.team import ALONE, Team

if TYPE_CHECKING:
    from resgrid.solvers.multigrid.h_transform import Scalable
    from resgrid.solvers.multigrid.hierarchy import Hierarchy

REFINED = 1e-26
"""Componentwise backward error that is enough where no current flows."""


@dataclass(frozen=True, eq=False)
class MultigridFactor(Factor):
    """A matrix and the hierarchy that preconditions it.

    `laplacian`: as of every `Factor`; `scalable`: levels to be scaled by the solution's h-transform, where the
    potential falls by so many decades that plain ones would take longer; `team`: whose threads take the steps.
    """

    scalable: Scalable | None = None
    team: Team = ALONE
    name = "multigrid"

    @cached_property
    def hierarchy(self) -> Hierarchy:
        """Plain levels: made at once without `scalable` ones, and beside them where they are asked for."""
        from resgrid.solvers.multigrid.hierarchy import build_hierarchy

        return build_hierarchy(self.laplacian, self.team)

    def _solve(
        self, rhs: NDArray[np.float64], rtol: float, guess: NDArray[np.float64] | None, watch: Watch | None
    ) -> NDArray[np.float64]:
        """As every `Factor` does; the residual norm is brought to ``rtol |b|`` where rounding allows.

        From a guess on, the iteration also ends where it estimates the error of every voltage to be at most ``rtol``
        of the largest one: where all currents meet in a few cells, as at the goal of open obstacles, the residual
        norm asks for much more than that.
        """
        from resgrid.solvers.multigrid.conjugate_gradients import iterate
        from resgrid.solvers.multigrid.krylov import norm

        _tell(watch, "plain")
        x, residual = iterate(self.laplacian, self.hierarchy, rhs, rtol, guess, watch, self.team)
        scale = 2.0 * self.hierarchy.largest_degree * norm(x, self.team) + norm(rhs, self.team)
        error = residual / (scale or 1.0)
        return self._judged(x, error, rtol, watch)

    def _solve_nonnegative(self, rhs: NDArray[np.float64] | Scaled, watch: Watch | None) -> tuple[Scaled, float]:
        """As every `Factor` does, on scaled levels if there are any; where these do not converge, on plain ones.

        ``watch`` is told which.
        """
        from resgrid.solvers.multigrid.conjugate_gradients import approximate

        found = None
        scaled = self._on_scaled_levels(rhs, watch)
        if scaled is not None:
            _tell(watch, "h-transform")
            found = self._refined(rhs, scaled)
        if found is None or not found.converged:
            _tell(watch, "plain")
            found = self._refined(rhs, partial(approximate, self.laplacian, self.hierarchy, watch, team=self.team))
        if watch is not None:
            watch.done(found.error, found.bound)
        return found.solution, found.error

    def _refined(self, rhs: NDArray[np.float64] | Scaled, passes: Approximation) -> Refined:
        from resgrid.solvers.multigrid.local import LocalCorrections

        in_slit = decades_in_slit(self.laplacian) > 0.0
        local = LocalCorrections(self.laplacian, passes, in_slit)
        return refine(self.laplacian, rhs, local, REFINED, resolve=local.anew, team=self.team)

    def _on_scaled_levels(self, rhs: NDArray[np.float64] | Scaled, watch: Watch | None) -> Approximation | None:
        """What approximates ``A^-1`` in proportion to the solution, where that falls by many decades."""
        if self.scalable is None or isinstance(rhs, Scaled):
            return None
        from resgrid.solvers.multigrid.h_transform import scaled_approximation

        return scaled_approximation(self.laplacian, self.scalable, rhs, watch, self.team)


def _tell(watch: Watch | None, levels: str) -> None:
    if watch is not None:
        watch.uses(levels)


def factor_multigrid(laplacian: Laplacian, accuracy: str = "direction", team: Team = ALONE) -> MultigridFactor:
    """Coarsen a matrix: for an h-transform where directions are asked for along many decades, plainly otherwise."""
    from resgrid.solvers.multigrid.h_transform import scalable

    def made() -> MultigridFactor:
        levels = scalable(laplacian, team) if accuracy == "direction" and h_transform_pays(laplacian) else None
        factors = MultigridFactor(laplacian, levels, team)
        if levels is None:
            _ = factors.hierarchy
        return factors

    if team.size == 1 or accuracy != "direction" or laplacian.grid is None:
        return made()
    factors, _ = team.together([made, lambda: laplacian.sorted_rows])  # which refinement asks for
    return cast("MultigridFactor", factors)
