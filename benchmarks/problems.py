"""Benchmark problems: a few plain values from which every process builds the same circuit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from benchmarks import irregular, layouts
from resgrid.core.compiler import compile_space
from resgrid.core.netlist import GROUND, Netlist
from resgrid.core.space import ConfigurationSpace

SPACES: dict[str, Callable[[int, int, int], ConfigurationSpace]] = {
    "rectangles": lambda size, _, seed: layouts.boxes(size, 2, seed),
    "boxes": lambda size, _, seed: layouts.boxes(size, 3, seed),
    "maze": layouts.maze,
}
NETLISTS: dict[str, Callable[[int, int], Netlist]] = {
    "power grid": irregular.power_grid,
    "geometric graph": irregular.geometric,
    "thinned grid": irregular.thinned,
}


@dataclass(frozen=True)
class Problem:
    """A circuit described by a few plain values.

    Attributes
    ----------
    kind : str
        A key of `SPACES` or `NETLISTS`.
    size : int
        Cells per side of a space; nodes of a netlist.
    boundary : {"dirichlet", "neumann"}
        Boundary of a space; Neumann has the uniform drive.
    seed : int
    width : int
        Width of a maze's corridors.
    mismatch : float
        Relative spread of the resistances of a space: uniform in ``1 +- mismatch``.
    """

    kind: str
    size: int
    boundary: str = "dirichlet"
    seed: int = 1
    width: int = 1
    mismatch: float = 0.1

    @property
    def name(self) -> str:
        """Return the name in the table."""
        if self.kind in NETLISTS:
            return f"{self.kind}, {self.size:,} nodes"
        shape = f"{self.size}^{3 if self.kind == 'boxes' else 2}"
        kind = f"maze of width {self.width}, {shape}" if self.kind == "maze" else shape
        return f"{kind} {self.boundary}"

    def space(self) -> ConfigurationSpace:
        """Return the space of a grid problem."""
        return SPACES[self.kind](self.size, self.width, self.seed)

    def netlist(self) -> Netlist:
        """Return the circuit."""
        if self.kind in NETLISTS:
            return NETLISTS[self.kind](self.size, self.seed)
        return mismatched(compile_space(self.space(), boundary=self.boundary), self.mismatch, self.seed)


def mismatched(netlist: Netlist, mismatch: float, seed: int) -> Netlist:
    """Return the circuit with resistances that deviate by up to the fraction ``mismatch``."""
    error = np.random.default_rng(seed + 1).uniform(-mismatch, mismatch, len(netlist.conductance))
    return netlist.replace(conductance=netlist.conductance / (1.0 + error))


@dataclass(frozen=True, eq=False)
class Equations:
    """The nodal equations in the form of other libraries: ``matrix @ voltage[nodes] = rhs``.

    They are assembled from the netlist in this module, so that they also check resgrid's own assembly.
    """

    matrix: sparse.csr_array
    rhs: NDArray[np.float64]
    nodes: NDArray[np.int64]

    def residual(self, x: NDArray[np.float64]) -> float:
        """Return ``|b - A x| / |b|`` in the 2-norm."""
        return float(np.linalg.norm(self.rhs - self.matrix @ x) / np.linalg.norm(self.rhs))


def equations(netlist: Netlist) -> Equations:
    """Assemble the equations of a circuit whose voltage sources all have one end at ground.

    Components without current (at most one rail and no injected current) are omitted.
    """
    known = np.full(netlist.node_count, np.nan)
    known[GROUND] = 0.0
    known[netlist.source_nodes[:, 0]] = netlist.source_volts
    source, sink = netlist.current_nodes.T
    fed = _summed(sink, netlist.current_amps, netlist.node_count) - _summed(
        source, netlist.current_amps, netlist.node_count
    )
    a, b = netlist.resistor_nodes.T
    nodes = np.flatnonzero(_carrying(netlist, known, fed))
    row = np.full(netlist.node_count, -1, dtype=np.int64)
    row[nodes] = np.arange(len(nodes))
    here, there = np.concatenate([a, b]), np.concatenate([b, a])
    g = np.concatenate([netlist.conductance, netlist.conductance])
    solved = row[here] >= 0
    here, there, g = row[here[solved]], there[solved], g[solved]
    rail = ~np.isnan(known[there])
    rhs = fed[nodes] + _summed(here[rail], (g * known[there])[rail], len(nodes))
    diagonal = sparse.diags_array(_summed(here, g, len(nodes)))
    ends = (here[~rail], row[there[~rail]])
    coupling = sparse.coo_array((g[~rail], ends), shape=(len(nodes),) * 2)
    matrix = sparse.csr_array(diagonal - coupling)
    matrix.sort_indices()
    matrix.indices, matrix.indptr = matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32)
    return Equations(matrix, rhs, nodes)


def _summed(row: NDArray[np.int64], amount: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    return np.bincount(row, amount, size).astype(np.float64)


def _carrying(netlist: Netlist, known: NDArray[np.float64], fed: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the unknown nodes in components with two rails, or with a rail and an injected current."""
    ends, unknown = netlist.resistor_nodes, np.isnan(known)
    inner = unknown[ends].all(axis=1)
    shape = (netlist.node_count,) * 2
    graph = sparse.coo_array((np.ones(np.count_nonzero(inner), np.int8), tuple(ends[inner].T)), shape=shape)
    count, part = connected_components(graph, directed=False)
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    for near, far in ((0, 1), (1, 0)):
        touching = unknown[ends[:, near]] & ~unknown[ends[:, far]]
        np.minimum.at(low, part[ends[touching, near]], known[ends[touching, far]])
        np.maximum.at(high, part[ends[touching, near]], known[ends[touching, far]])
    driven = high > low
    current = np.bincount(part[unknown & (fed != 0)], minlength=count) > 0
    return np.asarray(unknown & (driven | (current & np.isfinite(low)))[part])
