"""Fields of a drawing that changes under the hand, each solved from the one before."""

from __future__ import annotations

from resgrid.circuit.update import WarmStart
from resgrid.planning.fields import Field, field
from resgrid.planning.road import Problem, Solution

TOLERANCE = 1e-6
"""Normwise backward error of what is shown while somebody draws."""


class WarmFields:
    """Fields of ideal circuits, normwise, without their netlists."""

    def __init__(self) -> None:
        self._starts: dict[str, WarmStart] = {}

    def solve(self, problem: Problem) -> Solution:
        """The fields of a problem; errors as of `WarmStart.solve` and `resgrid.field`."""
        pure = dict[str, Field]()
        for name, wiring in problem.wirings.items():
            start = self._starts.pop(name, None)  # one that fails is begun anew
            if start is None or start.wiring != wiring:
                start = WarmStart(wiring, rtol=TOLERANCE)
            pure[name] = field(start.solve(problem.space))
            self._starts[name] = start
        return Solution(problem, {}, pure)
