"""Random circuits whose voltages and currents cancel exactly or nearly."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

import resgrid as rg

Element = tuple[int, int, float]

_SIEMENS: list[Callable[[np.random.Generator], float]] = [
    lambda rng: float(10.0 ** rng.integers(-12, 13)),
    lambda rng: float(10.0 ** rng.uniform(-12.0, 12.0)),
    lambda rng: float(rng.choice([1e-12, 1.0, 1e12])),
    lambda rng: float(rng.choice([0.001, 0.5, 1.0, 2.0])),
    lambda rng: float(10.0 ** rng.uniform(-3.0, 0.0)),
]


def cancelling_circuit(seed: int, number: int) -> rg.Netlist:
    """Return a circuit of 3 to 12 nodes, the same for the same seed and number."""
    rng = np.random.default_rng([seed, number])
    nodes = int(rng.integers(3, 13))
    resistors = _resistors(rng, nodes)
    sources, currents = _voltage_sources(rng, nodes), _current_sources(rng, nodes)
    label = np.concatenate([[0], 1 + rng.permutation(nodes - 1)]) if rng.random() < 0.7 else rng.permutation(nodes)
    (ends, siemens), (poles, volts), (flow, amps) = (
        (label[np.reshape([each[:2] for each in found], (-1, 2)).astype(np.int64)], [each[2] for each in found])
        for found in (resistors, sources, currents)
    )
    return rg.Netlist(nodes, ends, siemens, poles, volts, current_nodes=flow, current_amps=amps)


def _some(rng: np.random.Generator, nodes: int, count: int) -> list[int]:
    return [int(node) for node in rng.choice(nodes, count, replace=False)]


def _volts(rng: np.random.Generator) -> float:
    size = rng.choice([0.1, 0.2, 0.3, 1.0, 3.3, 1e4, 1e-9, 1e-12, 10.0 ** rng.uniform(-12.0, 4.0)])
    return float(rng.choice([-1.0, 1.0]) * size)


def _amps(rng: np.random.Generator) -> float:
    size = rng.choice([0.1, 0.2, 0.3, 1.0, 1e-3, 1e-12, 1e-24, 10.0 ** rng.uniform(-15.0, 1.0)])
    return float(rng.choice([-1.0, 1.0]) * size)


def _resistors(rng: np.random.Generator, nodes: int) -> list[Element]:
    """Return trees on islands, weak resistors between islands, meshes, parallel resistors, balanced bridges."""
    siemens = _SIEMENS[int(rng.integers(len(_SIEMENS)))]
    found: list[Element] = []
    island = rng.integers(0, int(rng.integers(1, 4)) if rng.random() < 0.5 else 1, nodes)
    island[0] = 0
    for number in range(int(island.max()) + 1):
        inside = rng.permutation(np.flatnonzero(island == number)).tolist()
        found += [(inside[int(rng.integers(k))], inside[k], siemens(rng)) for k in range(1, len(inside))]
        if number and inside and rng.random() < 0.85:
            for _ in range(int(rng.integers(1, 3))):
                other = int(rng.choice(np.flatnonzero(island < number)))
                found.append((int(rng.choice(inside)), other, 1e-12 if rng.random() < 0.6 else siemens(rng)))
    for _ in range(int(rng.integers(0, 5))):
        a, b = _some(rng, nodes, 2)
        found.append((a, b, siemens(rng)))
    for _ in range(int(rng.integers(0, 3))):
        a, b, same = found[int(rng.integers(len(found)))] if found else (0, 1, 1.0)
        found.append((b, a, siemens(rng) if rng.random() < 0.7 else same))
    if nodes >= 4 and rng.random() < 0.3:
        a, b, c, d = _some(rng, nodes, 4)
        first, second, ratio = siemens(rng), siemens(rng), float(rng.choice([0.5, 1.0, 2.0, 1024.0]))
        found += [(a, c, first), (c, b, second), (a, d, first * ratio), (d, b, second * ratio), (c, d, siemens(rng))]
    return found


def _voltage_sources(rng: np.random.Generator, nodes: int) -> list[Element]:
    """Return single sources and stacks of equal sources, without loops or with one consistent loop."""
    found: list[Element] = []
    part = list(range(nodes))

    def tie(a: int, b: int, volts: float) -> None:
        if part[a] != part[b]:
            part[:] = [part[b] if each == part[a] else each for each in part]
            found.append((a, b, volts))

    for _ in range(int(rng.integers(0, 4))):
        a, b = _some(rng, nodes, 2)
        tie(a, 0 if rng.random() < 0.5 else b, _volts(rng))
    if nodes >= 4 and rng.random() < 0.35:
        chain, step = _some(rng, nodes, int(rng.integers(3, min(nodes, 5) + 1))), _volts(rng)
        for low, high in pairwise(chain):
            volts = step if rng.random() < 0.8 else _volts(rng)
            tie(*((high, low) if rng.random() < 0.5 else (low, high)), volts)
    if found and rng.random() < 0.08:
        a, b, volts = found[0]
        found.append((a, b, volts) if rng.random() < 0.5 else (b, a, -volts))
    return found


def _current_sources(rng: np.random.Generator, nodes: int) -> list[Element]:
    """Return single and opposing current sources, and sources that cancel at a node or form a loop."""
    found: list[Element] = []
    for _ in range(int(rng.integers(0, 4))):
        a, b = _some(rng, nodes, 2)
        found.append((a, b, _amps(rng)))
    if rng.random() < 0.4:
        (a, b), amps = _some(rng, nodes, 2), _amps(rng)
        found += [(a, b, amps), (b, a, amps)] if rng.random() < 0.5 else [(a, b, amps), (a, b, -amps)]
    if rng.random() < 0.4:
        (a, b, c), amps = _some(rng, nodes, 3), _amps(rng)
        found += [(a, b, amps), (b, c, amps)]
        if rng.random() < 0.3:
            found.append((c, a, amps))
    return found
