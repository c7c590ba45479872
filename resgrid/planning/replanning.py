"""Replanning: the solution of a planning problem after some cells of its space have changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from threading import Lock
from typing import Any

import numpy as np

from resgrid.core.drive_checks import NO_GOAL, why_undriven
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring
from resgrid.errors import InputError
from resgrid.planning.changed_fields import KeptCircuit, NotSolvedError, why_not_kept
from resgrid.planning.fields import Field, undriven_field
from resgrid.planning.pipeline import DEFAULT_OPTIONS, Problem, Solution, SolveOptions, solve_problem

_MOST = 0.25
"""Largest fraction of changed cells for which an update reuses results; more changed cells need a fresh plan."""


@dataclass(frozen=True)
class Replanning:
    """Report of `Planner.update`: the method that was used, and the reason for a fresh plan.

    Attributes
    ----------
    method : {"elimination", "unchanged", "fresh"}
        ``"elimination"``: nested dissection, repeated only around the changed cells; ``"unchanged"``: no cell has
        changed, and the fields are those of the last planner; ``"fresh"``: all fields were solved without reuse.
    reason : str or None
        Reason for a fresh plan; None for other methods.
    changed : int
        Number of cells whose code or conductivity has changed; all cells if the axes have changed.
    eliminated : float
        Fraction of the nodes of the elimination tree that the update eliminated, in [0, 1]: 1 in the first update, 0
        for ``"unchanged"``, and the mean over both fields of a blend; NaN for a fresh plan.

    Examples
    --------
    >>> planner = rg.plan(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")))
    >>> planner = planner.update(cells=[(0, 0)], values=rg.Cell.OBSTACLE)
    >>> planner.replanning
    Replanning(method='elimination', reason=None, changed=1, eliminated=1.0)
    """

    method: str
    reason: str | None
    changed: int
    eliminated: float


class KeptCircuits:
    """Eliminated equations of circuits, kept between updates and shared by all planners of one map.

    Kept equations save time, but change no result: every update first repeats the elimination where the map of the
    updated planner differs from the map that was eliminated last.

    Parameters
    ----------
    work : SolveOptions
        Options of the solves of a fresh plan.
    """

    def __init__(self, work: SolveOptions = DEFAULT_OPTIONS) -> None:
        self.work = work
        self._lock, self._circuits = Lock(), dict[str, KeptCircuit]()

    def __getstate__(self) -> dict[str, Any]:
        return {"work": self.work}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        self.__init__(state["work"])  # type: ignore[misc]

    def solve(self, problem: Problem, wirings: Mapping[str, Wiring]) -> tuple[dict[str, Field], float]:
        """Return the fields of a problem's circuits by name, and the mean fraction of nodes that were eliminated.

        The fraction refers to the nodes of the elimination trees; it is 0 if no circuit carries current.  `wirings`:
        wirings of the circuits by name.  Raise NotSolvedError if a field is not direction-safe.
        """
        space, fields, fractions = problem.space, dict[str, Field](), []
        with self._lock:
            for name, wiring in wirings.items():
                if why_undriven(space, wiring) is not None:
                    fields[name] = undriven_field(space, wiring)
                    continue
                kept = self._circuits.get(name)
                if kept is None or kept.shape != space.shape:
                    kept = self._circuits[name] = KeptCircuit(space.shape)
                fields[name], fraction = kept.field(space, wiring)
                fractions.append(fraction)
        return fields, float(np.mean(fractions)) if fractions else 0.0


def solve_changed(solution: Solution, space: ConfigurationSpace, kept: KeptCircuits) -> tuple[Solution, Replanning]:
    """Return the solution of a problem on a changed space, and the report of the method.

    `solution`: solution of the problem before the change; `space`: the changed space; `kept`: equations kept from
    earlier updates, which are updated in place.

    Raises
    ------
    InputError
        If the changed space has no goal cell.
    """
    old, problem = solution.problem.space, replace(solution.problem, space=space)
    if not space.goal_count:
        raise InputError(NO_GOAL)
    changed, reason = _compared(old, space)
    if changed == 0 and reason is None and space is old:
        return solution, Replanning("unchanged", None, 0, 0.0)
    wirings = problem.wirings
    for wiring in wirings.values():
        reason = reason or why_not_kept(space, wiring)
    if kept.work.by_petsc:
        reason = "method = 'petsc'"
    if reason is None:
        try:
            fields, fraction = kept.solve(problem, wirings)
            return Solution(problem, {}, fields), Replanning("elimination", None, changed, fraction)
        except NotSolvedError as error:
            reason = str(error)
    return solve_problem(problem, work=kept.work), Replanning("fresh", reason, changed, float("nan"))


def _compared(old: ConfigurationSpace, new: ConfigurationSpace) -> tuple[int, str | None]:
    """Return the number of cells that differ, and the reason why no result of the space `old` can be reused for `new`.

    Cells differ in code or conductivity.  The reason is None if results can be reused.
    """
    if new.axes != old.axes:
        return new.cell.size, "other axes"
    differs = new.cell != old.cell
    if new.conductivity is not old.conductivity:
        one, other = (1.0 if space.conductivity is None else space.conductivity for space in (old, new))
        differs |= np.not_equal(one, other)
    changed = int(np.count_nonzero(differs))
    if changed > _MOST * differs.size:
        return changed, f"{changed:,} of {differs.size:,} cells have changed, more than {_MOST:.0%}"
    return changed, None
