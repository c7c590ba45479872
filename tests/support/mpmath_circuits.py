"""Modified nodal analysis in mpmath, and central differences of functions of the node voltages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mpmath as mp
import numpy as np

import resgrid as rg

Numbers = Sequence[Any]


def node_voltages(netlist: rg.Netlist, conductance: Numbers, volts: Numbers, amps: Numbers) -> list[Any]:
    """Return the node voltages of a circuit without floating nodes or loops of sources, at the precision of mpmath."""
    nodes = netlist.node_count - 1
    size = nodes + len(volts)
    matrix, rhs = mp.matrix(size, size), mp.matrix(size, 1)
    for (a, b), siemens in zip(netlist.resistor_nodes.tolist(), conductance, strict=True):
        for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
            if i and j:
                matrix[i - 1, j - 1] += sign * siemens
    for row, (ends, value) in enumerate(zip(netlist.source_nodes.tolist(), volts, strict=True), nodes):
        for node, sign in zip(ends, (1, -1), strict=True):
            if node:
                matrix[row, node - 1] += sign
                matrix[node - 1, row] += sign
        rhs[row] = value
    for (taken, fed), value in zip(netlist.current_nodes.tolist(), amps, strict=True):
        for node, sign in ((taken, -1), (fed, 1)):
            if node:
                rhs[node - 1] += sign * value
    found = mp.lu_solve(matrix, rhs)
    return [mp.mpf(0), *(found[i] for i in range(nodes))]


def differences(
    netlist: rg.Netlist, function: Callable[[list[Any]], Any], which: dict[str, Sequence[int]], digits: int
) -> dict[str, list[Any]]:
    """Return central differences of a function of the node voltages, by name of the element values.

    `which`: numbers of the elements, by ``"conductance"``, ``"voltage"`` or ``"current"``; `digits`: precision.
    """
    with mp.workdps(digits):
        values = {
            "conductance": [mp.mpf(float(x)) for x in netlist.conductance],
            "voltage": [mp.mpf(float(x)) for x in netlist.source_volts],
            "current": [mp.mpf(float(x)) for x in netlist.current_amps],
        }
        found: dict[str, list[Any]] = {}
        for name, numbers in which.items():
            found[name] = []
            for number in numbers:
                step = (abs(values[name][number]) or mp.mpf(1)) * mp.mpf(10) ** (-digits // 3)
                ends = []
                for sign in (1, -1):
                    changed = {key: list(given) for key, given in values.items()}
                    changed[name][number] += sign * step
                    ends.append(function(node_voltages(netlist, *changed.values())))
                found[name].append((ends[0] - ends[1]) / (2 * step))
        return found


def largest_error(
    found: rg.circuit.Gradient, wanted: dict[str, list[Any]], which: dict[str, Sequence[int]], digits: int
) -> float:
    """Return the largest error of the derivatives, relative to each.

    Differences below the rounding errors of `digits` digits count as 0, as do derivatives below 1e-300.
    """
    worst = 0.0
    for name, numbers in which.items():
        rounding = max(map(abs, wanted[name]), default=0) * mp.mpf(10) ** (-digits // 2)
        for number, value in zip(numbers, wanted[name], strict=True):
            got = mp.mpf(float(getattr(found, name)[number]))
            if abs(value) > max(rounding, mp.mpf("1e-300")):
                worst = max(worst, float(abs(got - value) / abs(value)))
            else:
                worst = max(worst, float(abs(got) / (rounding or 1)))
    return worst


def all_elements(netlist: rg.Netlist) -> dict[str, Sequence[int]]:
    """Return the numbers of all resistors, voltage sources and current sources."""
    return {
        "conductance": range(len(netlist.conductance)),
        "voltage": range(len(netlist.source_volts)),
        "current": range(len(netlist.current_amps)),
    }


def comb(length: int, ratio: float, seed: int = 0) -> rg.Netlist:
    """Chain of nodes between a goal rail and a dead end, each tied to an obstacle rail by `ratio` times the chain."""
    rng = np.random.default_rng(seed)
    chain = np.arange(3, 3 + length)
    pairs = np.concatenate([[[2, 3]], np.stack([chain[:-1], chain[1:]], 1), np.stack([np.ones_like(chain), chain], 1)])
    siemens = np.repeat([1.0, ratio], length) * rng.uniform(0.5, 2.0, 2 * length)
    return rg.Netlist(3 + length, pairs, siemens, source_nodes=[[1, 0], [2, 0]], source_volts=[1.0, 0.0])
