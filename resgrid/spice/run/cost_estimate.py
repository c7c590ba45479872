"""Estimate of the time and memory of a simulator run, before it starts.

ngspice up to version 41 orders its matrix by Markowitz's rule with linear searches.  Measured with version 39 on grids
of 16^2 to 256^2 cells, cubes of 10^3 to 26^3 nodes, four dimensions, chains, trees and random networks, its time grows
as the 3.5th power of the width of the network's core (nodes per breadth-first level) and the 0.6th power of the core's
size.  Trees and chains cause no fill-in and take time in proportion to their elements.  KLU, which newer versions and
the `eecircuit` engine use, takes seconds instead of minutes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.core.netlist import GROUND, Netlist
from resgrid.core.regions import label_components
from resgrid.errors import BudgetError, InputError
from resgrid.spice.circuit import CONDUCTING, Circuit
from resgrid.spice.dialects import DIALECTS

_FIRST_WITH_KLU = 42
"""First major version of ngspice with the matrix package KLU; it and later ones have the costs ``ngspice-klu``."""
_RANDOM_WIDTH = 0.117
"""Coefficient ``a`` of the upper limit ``a * k * n**(2/3)`` of the core's width in the cost model.

The core is the network without nodes of known voltage and dangling trees, its width the core nodes per breadth-first
level.  ``k`` is the mean number of neighbours and ``n`` the number of core nodes with more than two neighbours.  The
limit is for random networks.  They have few breadth-first levels, so that the nodes per level would overestimate the
cost of elimination.
"""


COSTS = {engine: costs for dialect in DIALECTS.values() for engine, costs in dialect.engines.items()}
"""Cost model (`Costs`: coefficients for time and memory) by engine: "ngspice", "ngspice-klu" or "eecircuit"."""


@dataclass(frozen=True)
class Forecast:
    """Estimated cost of a simulator run.

    `engine`: ``"ngspice"`` (Markowitz ordering), ``"ngspice-klu"`` or ``"eecircuit"`` (both KLU); `seconds`: wall-clock
    time, accurate to a factor of about three; `memory`: peak memory, in bytes; `core_nodes`: number of nodes of the
    core, whose elimination causes fill-in (without dangling trees and nodes of known voltage); `core_width`: core nodes
    per breadth-first level.
    """

    engine: str
    seconds: float
    memory: float
    core_nodes: int
    core_width: float

    def __str__(self) -> str:
        return (
            f"{self.engine} will take about {_duration(self.seconds)} and {self.memory / 2**20:,.0f} MiB "
            f"({self.core_nodes:,} nodes in loops, {self.core_width:,.0f} per breadth-first level)"
        )


def forecast(circuit: Netlist | Circuit, engine: str = "ngspice", version: str = "") -> Forecast:
    """Return the estimated time and memory that an engine needs for an operating point.

    `engine`: name of the engine, a key of `COSTS`; `version`: version of ngspice, which determines the matrix package
    (KLU from 42 on), empty if unknown (then without KLU).  Computing the estimate takes time proportional to the number
    of elements.  Raises InputError for an unknown engine.
    """
    major = version.partition(".")[0].rstrip("+")
    if engine == "ngspice" and major.isdecimal() and int(major) >= _FIRST_WITH_KLU:
        engine = "ngspice-klu"
    if engine not in COSTS:
        raise InputError(f"there is no cost model for the engine {engine!r}; choose one of {', '.join(COSTS)}")
    circuit = Circuit.of(circuit)
    size, width = core_of(circuit)
    costs = COSTS[engine]
    elements = sum(len(ends) for ends in circuit.ends.values())
    seconds = costs.start + costs.element * elements + costs.core * width**costs.width_power * size**costs.size_power
    memory = costs.start_bytes + costs.element_bytes * elements + costs.fill_bytes * size * width
    return Forecast(engine, seconds, memory, size, width)


def require_time(expected: Forecast, timeout: float) -> None:
    """Raise BudgetError if the estimated time exceeds the limit `timeout`, in seconds; `expected`: the estimate."""
    if expected.seconds > timeout:
        other = "" if expected.engine != "ngspice" else ", use the faster engine (--engine eecircuit)"
        more = f"allow more (--timeout {max(expected.seconds * 3, 1):.0f})"
        limit = f"the time limit is {_duration(timeout)}"
        raise BudgetError(f"{expected}, but {limit}: {more}{other} or check a smaller circuit")


def core_of(circuit: Circuit) -> tuple[int, float]:
    """Return the size and the width of the core of a network, (0, 0.0) for a network without a core.

    The core is the network without nodes of known voltage and without dangling trees.  Its size is the number of nodes
    with more than two neighbours in the core.  Its width is the number of core nodes per breadth-first level, at most
    the width of a random network of this size (0.117 times the mean number of neighbours times size**(2/3)).
    """
    from scipy.sparse import coo_array

    tree = label_components(circuit.source_nodes, circuit.node_count)
    known = tree == tree[GROUND]
    pairs = np.concatenate([circuit.ends[kind] for kind in CONDUCTING])
    pairs = pairs[~known[pairs].any(axis=1) & (pairs[:, 0] != pairs[:, 1])].astype(np.int32)
    if not len(pairs):
        return 0, 0.0
    both = np.concatenate([pairs, pairs[:, ::-1]])
    shape = (circuit.node_count, circuit.node_count)
    graph = coo_array((np.ones(len(both), dtype=np.int8), tuple(both.T)), shape=shape).tocsr()
    degree = np.diff(graph.indptr).astype(np.int64)
    _strip_leaves(graph, degree)
    alive = np.flatnonzero(degree)
    forks = degree[alive] > 2
    if not forks.any():
        return 0, 0.0
    core = graph[alive][:, alive]
    _, _, far = _sweep(core, int(np.argmax(forks)))
    levels, reached, _ = _sweep(core, far)
    size, neighbours = int(forks.sum()), float(degree[alive][forks].mean())
    return size, min(reached / levels, _RANDOM_WIDTH * neighbours * size ** (2 / 3))


def _strip_leaves(graph: Any, degree: NDArray[np.int64]) -> None:
    """Set the `degree` of nodes with one neighbour to 0, until no such node is left; this removes dangling trees.

    `graph`: symmetric adjacency in compressed sparse rows, not changed; `degree` (nodes,): number of remaining
    neighbours of every node, changed in place.
    """
    leaves = np.flatnonzero(degree == 1).tolist()
    while leaves:
        node = leaves.pop()
        if degree[node] == 1:
            degree[node] = 0
            for other in graph.indices[graph.indptr[node] : graph.indptr[node + 1]]:
                degree[other] -= degree[other] > 0
                if degree[other] == 1:
                    leaves.append(other)


def _sweep(graph: Any, start: int) -> tuple[int, int, int]:
    """Return the number of breadth-first levels from node `start`, the number of nodes reached, and a farthest node.

    The node `start` counts as a level and as reached.  `graph`: sparse adjacency matrix of the network.
    """
    from scipy.sparse.csgraph import breadth_first_order

    order, before = breadth_first_order(graph, start)
    levels, node = 1, order[-1]
    while node != start:
        levels, node = levels + 1, before[node]
    return levels, len(order), int(order[-1])


def _duration(seconds: float) -> str:
    """Return a duration, given in seconds, as text in seconds, minutes, hours or days."""
    if seconds < 1:
        return f"{seconds:.1g} s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    if seconds < 7200:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.0f} h" if seconds < 360_000 else f"{seconds / 86_400:,.0f} days"
