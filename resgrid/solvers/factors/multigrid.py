"""The multigrid method as a factor: normwise answers, and entrywise ones by refinement.

The algorithm is told on one page in `resgrid.solvers.multigrid`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.decay import Fall, h_transform_pays
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

    `laplacian`: as of every `Factor`; `plain`: levels as they are; None where there are `scalable` ones and no others
    were asked for; `scalable`: levels to be scaled by the solution's h-transform, where the potential falls by so many
    decades that plain ones would take longer; `in_slit`: whether it falls steeply around the low rail; `team`: whose
    threads take the steps.
    """

    plain: Hierarchy | None
    scalable: Scalable | None = None
    in_slit: bool = False
    team: Team = ALONE
    name = "multigrid"

    @property
    def hierarchy(self) -> Hierarchy:
        """Plain levels: those at hand, or others made now."""
        from resgrid.solvers.multigrid.hierarchy import build_hierarchy

        return self.plain or build_hierarchy(self.laplacian, self.team)

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
        hierarchy = self.hierarchy
        x, residual = iterate(self.laplacian, hierarchy, rhs, rtol, guess, watch, self.team)
        scale = 2.0 * hierarchy.largest_degree * norm(x, self.team) + norm(rhs, self.team)
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

        local = LocalCorrections(self.laplacian, passes, self.in_slit)
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


def factor_multigrid(
    laplacian: Laplacian, fall: Fall | None = None, *, both: bool = False, team: Team = ALONE
) -> MultigridFactor:
    """Coarsen a matrix: for an h-transform where the potential is foreseen to fall by many decades, plainly otherwise.

    ``fall``: of the potential, if answers are to be right entry by entry; ``both``: if others will be asked for, too.
    """
    from resgrid.solvers.multigrid.h_transform import scalable
    from resgrid.solvers.multigrid.hierarchy import build_hierarchy

    if laplacian.grid is None:
        laplacian = laplacian.with_rows(ordered=False)
    if fall is None:
        return MultigridFactor(laplacian, build_hierarchy(laplacian, team), team=team)

    def levels() -> tuple[Hierarchy | None, Scalable | None]:
        scaled = scalable(laplacian, team) if h_transform_pays(laplacian, fall) else None
        return build_hierarchy(laplacian, team) if scaled is None or both else None, scaled

    (plain, scaled), rows = team.together([levels, laplacian.with_rows])  # which refinement asks for
    return MultigridFactor(rows, plain, scaled, fall.in_slit > 0.0, team)
