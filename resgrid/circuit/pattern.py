"""How the nodal equations of a circuit follow from its conductances, the circuit itself staying as it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.equations import Equations
from resgrid.solvers.batch import Chip

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]

_FEW = 1000
"""Resistors that tell in which unit a chip is solved."""


@dataclass(frozen=True, eq=False)
class Terms:
    """Sums of conductances: term ``k`` adds ``weight[k] * conductance[resistor[k]]`` to entry ``entry[k]``.

    `count`: number of entries; `entry, resistor` (k,); `weight` (k,): none where all are 1.
    """

    count: int
    entry: Integers
    resistor: Integers
    weight: Floats | None = None

    def of(self, conductance: Floats) -> Floats:
        """The sums, shape (count,)."""
        values = conductance[self.resistor]
        if self.weight is not None:
            values *= self.weight
        return np.asarray(np.bincount(self.entry, values, self.count), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Pattern:
    """What conductances are to a nodal system: all of its parts are linear in them.

    `system`: of the nominal conductances; rows and entries stay where they are; `source` (entries,): the resistor
    behind every entry of its matrix's edges; None where resistors are in parallel, and ``entries`` tells; `entries`: of
    these entries; `ground, feed`: of the system's parts of these names; `node` (k,): nodes that are solved
    for.
    """

    system: Equations
    source: Integers | None
    entries: Terms
    ground: Terms
    feed: Terms
    node: Integers

    def chip(self, conductance: Floats) -> Chip:
        """The equations of a chip of other conductances, shape (resistors,), in siemens."""
        entries = self.entries.of(conductance) if self.source is None else conductance[self.source]
        with np.errstate(over="ignore"):
            times = conductance / self.system.netlist.conductance
        few = times[:: max(1, len(times) // _FEW)]
        mostly = float(2.0 ** np.round(np.log2(np.median(few))))
        drive = self.feed.of(conductance) + self.system.injected
        return Chip(entries, self.ground.of(conductance), drive, mostly, float(times.min()))

    def voltages(self, solution: Floats) -> Floats:
        """Voltages of all nodes, shape (chips, nodes), from those of the rows, (chips, n); NaN where a node floats."""
        system = self.system
        voltage = np.empty((len(solution), len(system.known)))
        row, base = system.unknown[self.node], system.reference + system.forest.offset[self.node]
        for volts, x in zip(voltage, solution, strict=True):
            volts[:] = system.known
            volts[self.node] = x[row] + base
        return voltage


def pattern_of(system: Equations) -> Pattern:
    """Find out where the conductances of a netlist go in its nodal system."""
    ends = system.netlist.resistor_nodes
    rows = system.unknown[ends].astype(np.int64)
    offset = np.where(system.unknown >= 0, system.forest.offset, 0.0)
    solved = rows >= 0
    inner = np.flatnonzero(solved.all(axis=1) & (rows[:, 0] != rows[:, 1]))
    tied = np.flatnonzero(solved[:, 0] != solved[:, 1])
    first = np.where(solved[tied, 0], 0, 1)
    row, here, there = rows[tied, first], ends[tied, first], ends[tied, 1 - first]
    height = system.known[there] - system.reference - offset[here]
    entry, resistor = _entries(system, rows, inner)
    single = len(entry) == system.laplacian.edges.nnz
    fed = _shifted(rows, inner, offset[ends[inner, 0]] - offset[ends[inner, 1]])
    return Pattern(
        system=system,
        source=resistor[np.argsort(entry, kind="stable")] if single else None,
        entries=Terms(system.laplacian.edges.nnz, entry, resistor),
        ground=Terms(system.size, row, tied),
        feed=_nonzero(system.size, *(np.concatenate(pair) for pair in zip((row, tied, height), fed, strict=True))),
        node=np.flatnonzero(system.unknown >= 0),
    )


def _entries(system: Equations, rows: Integers, inner: Integers) -> tuple[Integers, Integers]:
    """Entries in the compressed rows of the coupling, and the resistors that they hold."""
    a, b = rows[inner].T
    coupling = system.laplacian.edges
    key = np.repeat(np.arange(system.size), np.diff(coupling.indptr)) * system.size + coupling.indices
    wanted = np.append(a, b) * system.size + np.append(b, a)
    return np.searchsorted(key, wanted), np.append(inner, inner)


def _shifted(rows: Integers, inner: Integers, step: Floats) -> tuple[Integers, Integers, Floats]:
    """What the offsets of floating sources drive through the resistors between rows."""
    moved = np.flatnonzero(step)
    a, b = rows[inner[moved]].T
    return np.append(b, a), np.tile(inner[moved], 2), np.append(step[moved], -step[moved])


def _nonzero(count: int, entry: Integers, resistor: Integers, weight: Floats) -> Terms:
    kept = weight != 0.0
    return Terms(count, entry[kept], resistor[kept], weight[kept])
