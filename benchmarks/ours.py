"""resgrid as a contender, timed from the space: compile, assemble, set up, solve, compute currents."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.problems import NETLISTS, Problem
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import solve
from resgrid.core.compiler import compile_space
from resgrid.core.netlist import Netlist
from resgrid.core.space import ConfigurationSpace


@dataclass(frozen=True, eq=False)
class Answer:
    """Voltages of all nodes, and the seconds of every stage."""

    voltage: NDArray[np.float64]
    seconds: Mapping[str, float]
    method: str
    iterations: int | None


class Resgrid:
    """A prepared problem; each `run` starts from the space, or from the netlist if there is no space."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.given = problem.netlist()
        self.space = None if problem.kind in NETLISTS else problem.space()

    def run(self, accuracy: str, rtol: float) -> Answer:
        """Solve once."""
        start = time.perf_counter()
        netlist = self._compiled()
        compiled = time.perf_counter() - start
        point = solve(netlist, accuracy=accuracy, rtol=rtol)
        seconds = {"compile": compiled, **point.seconds}
        return Answer(point.voltage, seconds, point.method, iterations_of(point))

    def _compiled(self) -> Netlist:
        """Return the circuit, compiled from a space without cached values."""
        if self.space is None:
            return self.given
        fresh = ConfigurationSpace(self.space.axes, self.space.cell)
        netlist = compile_space(fresh, boundary=self.problem.boundary)
        return netlist.replace(conductance=self.given.conductance)


def iterations_of(point: OperatingPoint) -> int | None:
    """Return the number of iterations, if the operating point contains it."""
    count = getattr(point, "iterations", None)
    return None if count is None else int(count)
