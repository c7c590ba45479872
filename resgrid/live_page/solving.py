"""Drawings solved: in haste while somebody draws, each field from the one before, or direction-safe and certified."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import solve
from resgrid.circuit.warm_start import WarmStart
from resgrid.core.netlist import Netlist
from resgrid.core.space import Cell
from resgrid.errors import AccuracyError, CircuitError, InputError
from resgrid.live_page.drawing import Drawing
from resgrid.planning.certify import certify
from resgrid.planning.fields import Field, read_cells
from resgrid.planning.pipeline import Problem, Solution, SolveOptions, Solver, solve_problem
from resgrid.planning.streamline import Streamline
from resgrid.planning.trace import follow, start_points

if TYPE_CHECKING:
    from resgrid.chip.effects import Effect

_TOLERANCE = 1e-6
"""Normwise backward error of what is shown while somebody draws."""


class WarmFields:
    """Fields of ideal circuits, normwise, without their netlists."""

    def __init__(self) -> None:
        self._starts: dict[str, WarmStart] = {}

    def solve(self, problem: Problem) -> Solution:
        """The fields of a problem; errors as of `WarmStart.solve` and `read_cells`."""
        pure = dict[str, Field]()
        for name, wiring in problem.wirings.items():
            start = self._starts.pop(name, None)  # one that fails is begun anew
            if start is None or start.wiring != wiring:
                start = WarmStart(wiring, rtol=_TOLERANCE)
            point = start.solve(problem.space)
            pure[name] = read_cells(point.space, point.wiring, point.voltage, check=False)
            self._starts[name] = start
        return Solution(problem, {}, pure)


@dataclass(frozen=True, eq=False)
class SolvedDrawing:
    """A drawing that was solved: direction-safe with certified paths, or while somebody draws in haste.

    `paths`: one for each start, None where a hasty field shows no way; `seconds`: that it took.
    """

    drawing: Drawing
    solution: Solution
    paths: tuple[Streamline | None, ...]
    exact: bool
    seconds: float

    @property
    def field(self) -> Field:
        """The field that is shown."""
        return self.solution.fields[0]


def solve_drawing(drawing: Drawing, *, exact: bool, warm: WarmFields | None = None) -> SolvedDrawing:
    """Solve a drawing and follow the current from its starts; exact paths are certified.

    `warm`: from where a chip without flaws is solved in haste.
    """
    began = time.perf_counter()
    if not (drawing.cell == Cell.GOAL).any():
        raise InputError("there is no goal: set one with the goal tool")
    if drawing.driven and not len(drawing.starts):
        raise InputError("there is no start to drive the grid: set one, or choose the uniform drive")
    solution = _solved(drawing, exact, warm)
    points = start_points(drawing.space, drawing.starts) if len(drawing.starts) else ()
    paths = tuple(_path(field, points[number], exact) for field, number in solution.tasks)
    return SolvedDrawing(drawing, solution, paths, exact, time.perf_counter() - began)


def _solved(drawing: Drawing, exact: bool, warm: WarmFields | None) -> Solution:
    flaws = flaws_of(drawing)
    if warm is not None and not exact and not drawing.driven and not flaws:
        with suppress(CircuitError, AccuracyError):  # where a half is flat, or a circuit is too stiff to be hurried
            return warm.solve(drawing.problem)
    solver = solve if exact else partial(solve, accuracy="normwise", rtol=_TOLERANCE)
    return solve_problem(drawing.problem, work=SolveOptions(_flawed(solver, flaws) if flaws else solver))


def _path(field: Field, point: NDArray[np.float64], exact: bool) -> Streamline | None:
    if not exact:
        field = replace(field, safe=None)
    try:
        path = follow(field, point)
    except AccuracyError:
        if exact:
            raise
        return None
    if exact:
        certify(path)
    return path


def flaws_of(drawing: Drawing) -> list[Effect]:
    """Passes that make a drawing's chip of an ideal one; none where it has no flaws."""
    chip = drawing.chip or {}
    sigma = chip.get("mismatch", 0.0)
    if not sigma and not drawing.broken:
        return []
    from resgrid.chip.effects import Faults, Mismatch

    mismatch = [Mismatch(sigma=sigma, seed=chip.get("seed", 0))] if sigma else []
    return [*mismatch, *([Faults(open_at=drawing.broken)] if drawing.broken else [])]


def without_flaws(drawing: Drawing) -> Drawing:
    """The drawing of the same chip as it was meant."""
    chip = {key: value for key, value in (drawing.chip or {}).items() if key not in ("mismatch", "seed")}
    return replace(drawing, chip=chip, broken=())


def _flawed(solver: Solver, flaws: list[Effect]) -> Solver:
    """A solver of netlists that are given flaws first."""
    from resgrid.chip.build import build_chip

    def solve_flawed(netlist: Netlist, **options: object) -> OperatingPoint:
        return solver(build_chip(netlist, flaws), **options)

    return solve_flawed
