"""A chip's die: what its resistors are, whatever passes made of them, and the random numbers of their places."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.grids import face_counts
from resgrid.netlist import Netlist


def identities(netlist: Netlist) -> int:
    """How many resistors a chip of this kind may have: the faces of its grid, or else the resistors of its netlist."""
    if netlist.cell_map is None:
        return len(netlist.conductance) + len(netlist.nonlinear_current)
    return sum(face_counts(netlist.cells.space.shape))


def identity(netlist: Netlist) -> tuple[NDArray[np.integer[Any]], NDArray[np.int64]]:
    """What resistors and nonlinear resistors are on the die, whatever passes did: their faces, -1 for extra ones."""
    if netlist.cell_map is None:
        m = len(netlist.conductance)
        return np.arange(m), np.arange(m, m + len(netlist.nonlinear_current))
    return netlist.cells.resistor_face, netlist.cells.nonlinear_face


def on_grid(netlist: Netlist) -> NDArray[np.bool_]:
    """Which resistors are the grid's own, shape (resistors,)."""
    return np.asarray(identity(netlist)[0] >= 0)


def per_resistor(netlist: Netlist, value: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Spread a factor of every face over the resistors and the nonlinear resistors; 1 for those that cross none.

    Shapes: `value` (identities,); returns `linear` (resistors,), `nonlinear` (nonlinear resistors,).
    """
    padded = np.append(value, 1.0)
    linear, nonlinear = identity(netlist)
    return padded[linear], padded[nonlinear]


def scaled(netlist: Netlist, factor: NDArray[np.float64]) -> Netlist:
    """Multiply the resistance of the grid's resistors.  Shapes: `factor` (identities,)."""
    linear, nonlinear = per_resistor(netlist, factor)
    return netlist.replace(
        conductance=netlist.conductance / linear, nonlinear_current=netlist.nonlinear_current / nonlinear
    )


Seed = int | tuple[int, ...]
"""Entropy, or entropy and the spawn key of a child, as whole numbers that JSON can hold."""

MISMATCH, DEFECTS, OFFSET, NOISE = 1, 2, 3, 4
"""The streams of one chip."""


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


def mismatch_terms(deviation: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The terms of `mismatch_factors` for standard deviations that are shares of the mean.

    Shapes: `deviation` (places,); returns `spread, shift` (places,).
    """
    log_variance = np.log1p(deviation**2)
    return np.sqrt(log_variance), 0.5 * log_variance


def mismatch_factors(spread: NDArray[np.float64], shift: NDArray[np.float64], seed: Seed) -> NDArray[np.float64]:
    """What fabrication multiplies the resistances of one chip by: log-normal, ``exp(spread z - shift)``, of mean 1.

    Parameters
    ----------
    spread, shift : ndarray of float64, shape (places,)
        From `mismatch_terms`.
    seed : int or tuple of int
        The chip.

    Returns
    -------
    ndarray of float64, shape (places,)
        Drawn in the order of the places on the die.
    """
    z = generator(seed, MISMATCH).standard_normal(len(spread))
    z *= spread
    z -= shift
    return np.asarray(np.exp(z, out=z))
