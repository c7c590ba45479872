"""Circuits with memristors, and independent references: closed forms, and dense equations for scipy's integrators."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import resgrid as rg

LAW = rg.circuit.Memristor(on_resistance=100.0, off_resistance=16e3, rate=1e4)


def loop(volts: float = 1.0, count: int = 1) -> rg.Netlist:
    """Return `count` resistors in parallel at a voltage source between node 1 and ground."""
    return rg.Netlist(2, [[1, 0]] * count, [1.0] * count, source_nodes=[[1, 0]], source_volts=[volts])


def chain(count: int, volts: float = 1.0) -> rg.Netlist:
    """Return `count` resistors in series from the source at node 1 to ground."""
    nodes = [1, *range(2, count + 1), 0]
    return rg.Netlist(
        count + 1, list(itertools.pairwise(nodes)), [1.0] * count, source_nodes=[[1, 0]], source_volts=[volts]
    )


def state_at_constant_voltage(law: rg.circuit.Memristor, volts: float, t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the state of one memristor of the rectangular window at a constant voltage, from the quadratic in q."""
    span = law.off_resistance - law.on_resistance
    before = law.off_resistance - span * law.initial
    limit = law.on_resistance if volts > 0 else law.off_resistance
    square = before**2 - 2 * span * law.rate * volts * t
    root = np.sqrt(np.maximum(square, limit**2) if volts > 0 else np.minimum(square, limit**2))
    return (law.off_resistance - root) / span


@dataclass
class DenseMemristors:
    """Equations of a circuit with grounded sources, by dense nodal analysis of all nodes, for `solve_ivp`.

    Nodes with a source to ground have known voltages; capacitors lead to ground; every other node has a capacitor, or
    none has one.  The state follows ``x' = k p i f(x)`` with the original window.
    """

    circuit: rg.circuit.MemristiveCircuit
    factor: Callable[[float], float] = lambda _: 1.0

    def __post_init__(self) -> None:
        netlist = self.circuit.netlist
        self.known = netlist.source_nodes[:, 0]
        self.inner = np.setdiff1d(np.arange(1, netlist.node_count), self.known)
        self.farads = np.zeros(netlist.node_count)
        np.add.at(self.farads, netlist.capacitor_nodes[:, 0], netlist.capacitance)
        identity = np.eye(netlist.node_count)
        self.incidence = identity[netlist.resistor_nodes[:, 0]] - identity[netlist.resistor_nodes[:, 1]]
        self.amps = np.zeros(netlist.node_count)
        np.add.at(self.amps, netlist.current_nodes[:, 1], netlist.current_amps)
        np.add.at(self.amps, netlist.current_nodes[:, 0], -netlist.current_amps)
        self.has_capacitors = bool(self.farads.any())

    def ohms(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        law, resistance = self.circuit.law, 1 / self.circuit.netlist.conductance
        resistance[self.circuit.memristors] = x * law.on_resistance + (1 - x) * law.off_resistance
        return resistance

    def matrix(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.incidence.T @ (self.incidence / self.ohms(x)[:, None])

    def voltages(self, t: float, y: NDArray[np.float64]) -> NDArray[np.float64]:
        x, netlist = y[: len(self.circuit.memristors)], self.circuit.netlist
        volts = np.zeros(netlist.node_count)
        volts[self.known] = self.factor(t) * netlist.source_volts
        if self.has_capacitors:
            volts[self.inner] = y[len(x) :]
        elif len(self.inner):
            matrix = self.matrix(x)
            right = self.factor(t) * self.amps - matrix @ volts
            volts[self.inner] = np.linalg.solve(matrix[np.ix_(self.inner, self.inner)], right[self.inner])
        return volts

    def slope(self, t: float, y: NDArray[np.float64]) -> NDArray[np.float64]:
        circuit, law = self.circuit, self.circuit.law
        x, volts = y[: len(circuit.memristors)], self.voltages(t, y)
        ends = circuit.netlist.resistor_nodes
        amps = ((volts[ends[:, 0]] - volts[ends[:, 1]]) / self.ohms(np.clip(x, 0, 1)))[circuit.memristors]
        drift = law.rate * circuit.polarity * amps
        if law.window == "joglekar":
            drift = drift * (1 - (2 * x - 1) ** (2 * law.exponent))
        else:
            drift = np.where(((x <= 0) & (drift < 0)) | ((x >= 1) & (drift > 0)), 0.0, drift)
        if not self.has_capacitors:
            return drift
        current = self.factor(t) * self.amps - self.matrix(np.clip(x, 0, 1)) @ volts
        return np.concatenate([drift, current[self.inner] / self.farads[self.inner]])

    def run(self, times: NDArray[np.float64], rtol: float = 1e-8) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return states (t, m) and voltages (t, nodes) at the times, from discharged capacitors.

        The method is explicit: implicit methods of scipy are wrong by 0.002 here where a drift jumps to 0 at a limit.
        """
        start = np.concatenate([self.circuit.state, np.zeros(len(self.inner) if self.has_capacitors else 0)])
        found = solve_ivp(
            self.slope, (0, times[-1]), start, "RK45", times, rtol=rtol, atol=1e-10, max_step=times[-1] / 300
        )
        assert found.success, found.message
        return np.clip(found.y[: len(self.circuit.memristors)].T, 0.0, 1.0), np.array(
            [self.voltages(t, y) for t, y in zip(found.t, found.y.T, strict=True)]
        )


def random_memristive(
    seed: int, *, capacitors: bool = False, window: str = "rectangular"
) -> rg.circuit.MemristiveCircuit:
    """Return a random connected circuit of up to 7 nodes with memristors, resistors, a source and a current source."""
    rng = np.random.default_rng(seed)
    nodes = int(rng.integers(3, 8))
    tree = [[k, int(rng.integers(0, k))] for k in range(1, nodes)]
    more = [rng.choice(nodes, 2, replace=False).tolist() for _ in range(nodes)]
    ends = np.array(tree + more)
    law = rg.circuit.Memristor(
        100.0, 100.0 * float(rng.choice([3, 10, 100])), 1e4, window, int(rng.integers(1, 4)), initial=0.1
    )
    chosen = np.flatnonzero(rng.random(len(ends)) < 0.8)
    chosen = np.array([0]) if not chosen.size else chosen
    netlist = rg.Netlist(
        nodes,
        ends,
        1 / rng.uniform(100, 5000, len(ends)),
        source_nodes=[[1, 0]],
        source_volts=[1.0],
        current_nodes=[[0, nodes - 1]],
        current_amps=[float(rng.uniform(-1e-3, 1e-3))],
        capacitor_nodes=[[k, 0] for k in range(2, nodes)] if capacitors else np.zeros((0, 2), int),
        capacitance=rng.uniform(1e-6, 2e-5, nodes - 2) if capacitors else [],
    )
    state = rng.uniform(0.05, 0.95, len(chosen))
    if window == "rectangular":
        state[rng.random(len(chosen)) < 0.3] = 0.0
    return rg.circuit.MemristiveCircuit(netlist, law, chosen, rng.choice([-1, 1], len(chosen)), state)
