"""The multigrid method as a factor: normwise answers, and entrywise ones by refinement.

The algorithm is told on one page in `resgrid.nodal.multigrid`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.factors.factor import Factor, factor_anew, rebuilt
from resgrid.nodal.multigrid.approximation import approximate
from resgrid.nodal.multigrid.grading import decades_in_slit, is_graded
from resgrid.nodal.refine import Approximation, Refined, refine
from resgrid.nodal.scaled import Scaled
from resgrid.nodal.system import NodalSystem
from resgrid.nodal.watch import Watch

if TYPE_CHECKING:
    from resgrid.nodal.multigrid.graded import Gradable
    from resgrid.nodal.multigrid.hierarchy import Hierarchy
    from resgrid.nodal.update.change import Change
    from resgrid.nodal.update.window import Window

REFINED = 1e-26
"""Componentwise backward error that is enough where no current flows."""


@dataclass(frozen=True, eq=False)
class MultigridFactor(Factor):
    """A nodal system and the hierarchy that preconditions it.

    `system, change`: as of every `Factor`; `patched`: its levels, where an update has patched them; `windows`: the
    surroundings of what the last update has changed.
    """

    patched: Hierarchy | None = None
    windows: tuple[Window, ...] = ()
    name = "multigrid"

    @cached_property
    def hierarchy(self) -> Hierarchy:
        """What preconditions normwise solutions, and others that fall by few decades; made when it is asked for."""
        from resgrid.nodal.multigrid.hierarchy import build_hierarchy

        if self.patched is not None:
            return self.patched
        return build_hierarchy(self.system)

    @cached_property
    def _gradable(self) -> Gradable | None:
        from resgrid.nodal.multigrid.graded import gradable

        return gradable(self.system)

    def _solve(
        self, rhs: NDArray[np.float64], rtol: float, guess: NDArray[np.float64] | None, watch: Watch | None
    ) -> NDArray[np.float64]:
        """As every `Factor` does; the residual norm is brought to ``rtol |b|`` where rounding allows.

        From a guess on, the iteration also ends where it estimates the error of every voltage to be at most ``rtol``
        of the largest one: where all currents meet in a few cells, as at the goal of open obstacles, the residual
        norm asks for much more than that.
        """
        pinned = np.empty(0, dtype=np.int64) if self.change is None else self.change.pinned
        right = rhs
        if len(pinned):
            # Rows that an update has pinned are alone.  Behind stiff walls they would be all that norms tell of.
            right = rhs.copy()
            right[pinned] = 0.0
            guess = None if guess is None else self._improved(right, guess)
        x, error = self._iterated(right, rtol, guess, watch)
        if len(pinned):
            x[pinned] = rhs[pinned] / self.system.degree[pinned]
        return self._judged(x, error, rtol, watch)

    def _iterated(
        self, rhs: NDArray[np.float64], rtol: float, guess: NDArray[np.float64] | None, watch: Watch | None
    ) -> tuple[NDArray[np.float64], float]:
        """Voltages and their backward error; from levels made anew, once patched ones have come to stagnate."""
        from resgrid.nodal.multigrid.iteration import iterate
        from resgrid.nodal.multigrid.kernels import norm

        if "_made_anew" in vars(self):
            return self._made_anew._iterated(rhs, rtol, None, watch)
        x, residual = iterate(self.system, self.hierarchy, rhs, rtol, guess, watch)
        largest = self.hierarchy.largest_degree(self.system)
        error = residual / (2.0 * largest * norm(x) + norm(rhs) or 1.0)
        if self.patched is not None and not error <= rtol:
            return self._made_anew._iterated(rhs, rtol, None, watch)
        return x, error

    @cached_property
    def _made_anew(self) -> MultigridFactor:
        """The same without patches, for where these no longer precondition."""
        return MultigridFactor(rebuilt(self.system))

    def _solve_nonnegative(self, rhs: NDArray[np.float64] | Scaled, watch: Watch | None) -> tuple[Scaled, float]:
        graded = self._graded_approximation(rhs, watch)
        found = None if graded is None else self._refined(rhs, graded)
        if found is None or not found.converged:
            # Levels that are not graded have their turn.
            found = self._refined(rhs, partial(approximate, self.system, self.hierarchy, watch))
        if watch is not None:
            watch.done(found.error, found.bound)
        return found.solution, found.error

    def _refined(self, rhs: NDArray[np.float64] | Scaled, passes: Approximation) -> Refined:
        from resgrid.nodal.multigrid.pockets import PocketsDirectly

        in_slit = self.patched is None and decades_in_slit(self.system) > 0.0
        pockets = PocketsDirectly(self.system, passes, in_slit)
        return refine(self.system, rhs, pockets, REFINED, resolve=pockets.anew)

    def _graded_approximation(self, rhs: NDArray[np.float64] | Scaled, watch: Watch | None) -> Approximation | None:
        """What approximates ``A^-1`` in proportion to the solution, where that falls by many decades."""
        if self.patched is not None or isinstance(rhs, Scaled) or not is_graded(self.system):
            return None
        levels = self._gradable
        if levels is None:
            return None
        from resgrid.nodal.multigrid.graded_solver import graded_approximation

        graded = graded_approximation(self.system, levels, rhs, watch)
        if graded is None:
            vars(self)["_gradable"] = None  # neither kept nor tried again
        return graded

    def _improved(self, b: NDArray[np.float64], guess: NDArray[np.float64]) -> NDArray[np.float64]:
        """The guess, 0 in pinned rows, made better where the last update has changed the circuit."""
        assert self.change is not None
        if self.windows:
            from resgrid.nodal.update.guess import improve_guess

            return improve_guess(self.system, self.change, self.windows, b, guess)
        better = guess.copy()
        better[self.change.pinned] = 0.0
        return better

    def _board(self) -> Hierarchy | None:
        return self.hierarchy if self.hierarchy.grid else None

    def _updated(self, system: NodalSystem, change: Change) -> Factor:
        if self.hierarchy.grid is None:
            return factor_anew(factor_multigrid, system, change, "the levels are graphs, which are made again")
        if not change.reason:
            from resgrid.nodal.update.levels import patch_levels

            fresh = change.cells[0 if self.change is None else len(self.change.cells) :]
            patched = patch_levels(self.hierarchy, system, change, fresh)
            if patched is not None:
                return replace(self, system=system, patched=patched[0], change=change, windows=patched[1])
        return factor_anew(factor_multigrid, system, change, "the changed cells are all over the grid")


def factor_multigrid(system: NodalSystem, *, later: bool = False) -> MultigridFactor:
    """Build the hierarchy of a nodal system; ``later``, with the first solution, which tells how it is graded."""
    factors = MultigridFactor(system)
    if not later:
        _ = factors.hierarchy
    return factors
