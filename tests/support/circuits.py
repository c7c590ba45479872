"""Small manual circuits, and a dense nodal analysis without code from the package."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

import resgrid as rg
from resgrid.circuit.operating_point import BranchCurrents


def ladder(rungs: int = 4) -> rg.Netlist:
    """Return a chain of 1 kohm from 1 V at node 1 to ground, with 10 uA injected into its middle."""
    nodes = np.arange(1, rungs + 2)
    pairs = np.stack([nodes, np.append(nodes[1:], 0)], axis=1)
    return rg.Netlist(
        rungs + 2,
        pairs,
        np.full(len(pairs), 1e-3),
        source_nodes=[[1, 0]],
        source_volts=[1.0],
        current_nodes=[[0, 1 + rungs // 2]],
        current_amps=[1e-5],
    )


def random_grid(seed: int, side: int = 6, decades: float = 2.0, drive: bool = True) -> rg.Netlist:
    """Return a square of random resistors between a rail of 1 V (node 1) and two goals of 0 V, with random currents."""
    rng = np.random.default_rng(seed)
    grid = 4 + np.arange(side * side).reshape(side, side)
    rails = np.stack([np.repeat([1, 2, 3], side), grid[[0, -1, side // 2]].ravel()], axis=1)
    down = np.stack([grid[:-1].ravel(), grid[1:].ravel()], axis=1)
    across = np.stack([grid[:, :-1].ravel(), grid[:, 1:].ravel()], axis=1)
    pairs = rng.permutation(np.concatenate([rails, down, across]))
    fed = grid[1:3].ravel() if drive else np.empty(0, dtype=np.int64)
    return rg.Netlist(
        int(grid.max()) + 1,
        pairs,
        1e-4 * 10.0 ** rng.uniform(-decades / 2, decades / 2, len(pairs)),
        source_nodes=[[1, 0], [0, 2], [3, 0]],
        source_volts=[1.0, 0.0, 0.0],
        current_nodes=np.stack([np.zeros(len(fed), dtype=np.int64), fed], axis=1),
        current_amps=rng.uniform(-1e-5, 1e-5, len(fed)),
    )


def dense_solution(netlist: rg.Netlist) -> rg.OperatingPoint:
    """Solve by dense modified nodal analysis, for circuits without floating nodes."""
    n, s = netlist.node_count, len(netlist.source_volts)
    A, b = np.zeros((n + s, n + s)), np.zeros(n + s)
    for (i, j), g in zip(netlist.resistor_nodes, netlist.conductance, strict=True):
        A[[i, j], [i, j]] += g
        A[[i, j], [j, i]] -= g
    for (i, j), amps in zip(netlist.current_nodes, netlist.current_amps, strict=True):
        b[i] -= amps
        b[j] += amps
    for k, ((plus, minus), volts) in enumerate(zip(netlist.source_nodes, netlist.source_volts, strict=True)):
        A[[plus, n + k], [n + k, plus]] += 1
        A[[minus, n + k], [n + k, minus]] -= 1
        b[n + k] = volts
    scale = np.append(np.ones(n), np.full(s, np.abs(A[:n, :n]).max()))
    A, b = A * scale[:, None] * scale, b * scale
    x = np.append(0.0, np.linalg.solve(A[1:, 1:], b[1:])) * scale
    voltage, current = x[:n], x[n:]
    first, second = voltage[netlist.resistor_nodes].T
    through = netlist.conductance * (first - second)
    return rg.OperatingPoint(
        netlist=netlist,
        voltage=voltage,
        log_drop=None,
        potential=None,
        _currents=BranchCurrents(
            resistor_current=through,
            scaled=(through, np.zeros(len(through), dtype=np.int64)),
            source_current=current,
            power=float(np.sum(through * (first - second))),
            kcl_residual=0.0,
        ),
        floating=np.empty(0, dtype=np.int64),
        undriven=np.empty(0, dtype=np.int64),
        method="dense",
        seconds={},
    )


def eliminated(a: list[list[Fraction]], b: list[Fraction]) -> list[Fraction]:
    """Solve a linear system in place by elimination in exact arithmetic without pivoting."""
    n = len(b)
    for k in range(n):
        for i in range(k + 1, n):
            if share := a[i][k] / a[k][k]:
                a[i] = [x - share * y for x, y in zip(a[i], a[k], strict=True)]
                b[i] -= share * b[k]
    x = [Fraction(0)] * n
    for k in reversed(range(n)):
        x[k] = (b[k] - sum((a[k][j] * x[j] for j in range(k + 1, n)), Fraction(0))) / a[k][k]
    return x


def exact_currents(netlist: rg.Netlist) -> tuple[list[Fraction], list[Fraction]]:
    """Return the voltages of all nodes (0 if floating) and the currents of all resistors, in exact arithmetic."""
    n = netlist.node_count
    root, height = list(range(n)), [Fraction(0)] * n
    for (plus, minus), volts in zip(netlist.source_nodes.tolist(), netlist.source_volts.tolist(), strict=True):
        here, there, rise = (plus, minus, -Fraction(volts)) if root[plus] == 0 else (minus, plus, Fraction(volts))
        kept, gone, shift = root[here], root[there], height[here] + rise - height[there]
        for node in range(n):
            if root[node] == gone:
                root[node], height[node] = kept, height[node] + shift
    a, b = [[Fraction(0)] * n for _ in range(n)], [Fraction(0)] * n
    pairs, siemens = netlist.resistor_nodes.tolist(), map(Fraction, netlist.conductance.tolist())
    edges = [(i, j, g) for (i, j), g in zip(pairs, siemens, strict=True)]
    reached = {0}
    for _ in range(n):
        reached |= {root[k] for i, j, _ in edges for k in (i, j) if {root[i], root[j]} & reached}
    for i, j, g in edges:
        for here, there in ((i, j), (j, i)):
            a[root[here]][root[here]] += g
            a[root[here]][root[there]] -= g
            b[root[here]] -= g * (height[here] - height[there])
    for (i, j), amps in zip(netlist.current_nodes.tolist(), netlist.current_amps.tolist(), strict=True):
        b[root[i]] -= Fraction(amps)
        b[root[j]] += Fraction(amps)
    rows = sorted(reached - {0})
    x = dict(zip(rows, eliminated([[a[i][j] for j in rows] for i in rows], [b[i] for i in rows]), strict=True))
    voltage = [x.get(root[k], Fraction(0)) + height[k] if root[k] in reached else Fraction(0) for k in range(n)]
    return voltage, [g * (voltage[i] - voltage[j]) for i, j, g in edges]
