"""A chip's die: what its resistors are, whatever passes made of them, and the random numbers of their places.

Every random effect draws from a stream of its own, and a value belongs to a place on the die, not to a row of an array:
the same seed gives the same chip whatever the order of the passes, and whichever scene the chip is switched to.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.core.netlist import Netlist
from resgrid.core.regions import face_counts
from resgrid.errors import InputError

Seed = int | tuple[int, ...]
"""Entropy, or entropy and the spawn key of a child, as whole numbers that JSON can hold."""

MISMATCH, DEFECTS, OFFSET, NOISE = 1, 2, 3, 4
"""The streams of one chip."""


def place_count(netlist: Netlist) -> int:
    """How many resistors a chip of this kind may have: the faces of its grid, or else the resistors of its netlist."""
    if netlist.cell_map is None:
        return len(netlist.conductance) + len(netlist.nonlinear_current)
    return sum(face_counts(netlist.cells.space.shape))


def places(netlist: Netlist) -> tuple[NDArray[np.integer[Any]], NDArray[np.integer[Any]]]:
    """The places of resistors and of nonlinear resistors: the faces they cross; -1 for switches, rails and loads."""
    if netlist.cell_map is None:
        linear = len(netlist.conductance)
        return np.arange(linear), np.arange(linear, place_count(netlist))
    return netlist.cells.resistor_face, netlist.cells.nonlinear_face


def on_grid(netlist: Netlist) -> NDArray[np.bool_]:
    """Which resistors are the grid's own, shape (resistors,)."""
    return np.asarray(places(netlist)[0] >= 0)


def ends_of(netlist: Netlist) -> NDArray[np.int32]:
    """Nodes of all resistors, nonlinear ones last, shape (resistors, 2)."""
    return np.concatenate([netlist.resistor_nodes, netlist.nonlinear_nodes])


def end_names(netlist: Netlist, resistors: NDArray[np.int64]) -> list[list[str]]:
    """Names of the two nodes of some resistors, numbered with nonlinear ones last."""
    ends = ends_of(netlist)[resistors]
    return [list(pair) for pair in zip(*(netlist.names_of(ends[:, end]) for end in (0, 1)), strict=True)]


def scaled(netlist: Netlist, factor: NDArray[np.float64]) -> Netlist:
    """Multiply the resistances of the grid by the factors of their places, shape (places,)."""
    linear, nonlinear = places(netlist)
    padded = np.append(factor, 1.0)  # place -1
    return netlist.replace(
        conductance=netlist.conductance / padded[linear],
        nonlinear_current=netlist.nonlinear_current / padded[nonlinear],
    )


def seed_of(seed: Any) -> Seed:
    """Check a seed and bring it to whole numbers."""
    if isinstance(seed, np.random.SeedSequence):
        entropy = seed.entropy if isinstance(seed.entropy, int) else None
        seed = None if entropy is None else (entropy, *seed.spawn_key) if seed.spawn_key else entropy
    parts = seed if isinstance(seed, tuple | list) and seed else (seed,)
    for part in parts:
        if isinstance(part, bool) or not isinstance(part, int | np.integer) or part < 0:
            raise InputError(f"seed = {seed!r} must be a whole number of at least 0, or several (entropy, spawn key)")
    numbers = tuple(int(part) for part in parts)
    return numbers if len(numbers) > 1 else numbers[0]


def generator(seed: Seed, stream: int) -> np.random.Generator:
    """Random numbers of one stream of a chip."""
    entropy, *key = seed if isinstance(seed, tuple) else (seed,)
    return np.random.default_rng(np.random.SeedSequence(entropy, spawn_key=(*key, stream)))


def mismatch_factors(count: int, deviation: float | NDArray[np.float64], seed: Seed) -> NDArray[np.float64]:
    """What fabrication multiplies the resistances of one chip by: ``exp(s z - s^2 / 2)``, log-normal, of mean 1.

    Shapes: `deviation` () or (places,), as a share of the mean; returns (places,).
    """
    log_variance = np.log1p(np.square(deviation))
    z = generator(seed, MISMATCH).standard_normal(count)
    z *= np.sqrt(log_variance)
    z -= 0.5 * log_variance
    return np.asarray(np.exp(z, out=z))
