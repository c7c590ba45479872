"""Random resistances of a chip, one value per site on the die (a face between cells, or a cell with a leak).

A site is a position on the die: the face between two cells that a resistor crosses, or a cell with a leak. Every random
effect has its own random stream, and a value belongs to a site, not to an index of the netlist. A seed therefore gives
one chip for any order of effects and for any scene that the chip is switched to.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.core.netlist import Netlist
from resgrid.core.regions import face_counts
from resgrid.errors import InputError

Seed = int | tuple[int, ...]
"""Seed of a chip: the entropy, or the entropy and the spawn key, of a `numpy.random.SeedSequence`, as integers."""

MISMATCH, DEFECTS, OFFSET, NOISE = 1, 2, 3, 4
"""Numbers of the random effects of a chip; the effect is the last entry of the spawn key of a random stream."""


def site_count(netlist: Netlist) -> int:
    """Return the number of sites of a netlist: the faces of its grid of cells, and with a leak also the cells.

    For a netlist without a map of cells, return the number of resistors, nonlinear ones included.
    """
    if netlist.cell_map is None:
        return len(netlist.conductance) + len(netlist.nonlinear_current)
    cells = netlist.cells
    return sum(face_counts(cells.space.shape)) + (cells.space.cell.size if cells.wiring.leak else 0)


def resistor_sites(netlist: Netlist) -> tuple[NDArray[np.integer[Any]], NDArray[np.integer[Any]]]:
    """Return the sites of the resistors (resistors,) and of the nonlinear resistors (nonlinear resistors,).

    A site is the number of the face that the resistor crosses, or the number of faces plus the flat index of the cell
    whose leak the resistor is; -1 for switches, rail segments and loads of the read-out.  In a netlist without cells,
    sites are the indices of the resistors, linear ones first.
    """
    if netlist.cell_map is None:
        linear = len(netlist.conductance)
        return np.arange(linear), np.arange(linear, site_count(netlist))
    linear_face, nonlinear_face = netlist.cells.resistor_face, netlist.cells.nonlinear_face
    if not netlist.cells.wiring.leak:
        return linear_face, nonlinear_face
    faces = sum(face_counts(netlist.cells.space.shape))
    first, second = (np.where(face < -1, faces - 2 - face, face) for face in (linear_face, nonlinear_face))
    return first, second


def on_grid(netlist: Netlist) -> NDArray[np.bool_]:
    """Return the mask (resistors,) of the resistors between cells and of the leaks.

    The mask is False for switches, rail segments and loads of the read-out, and True for all resistors of a netlist
    without a map of cells.
    """
    return np.asarray(resistor_sites(netlist)[0] >= 0)


def ends_of(netlist: Netlist) -> NDArray[np.int32]:
    """Return the first and second node of all resistors, linear ones first, then nonlinear ones, (resistors, 2)."""
    return np.concatenate([netlist.resistor_nodes, netlist.nonlinear_nodes])


def end_names(netlist: Netlist, resistors: NDArray[np.int64]) -> list[list[str]]:
    """Return the names of both nodes of some resistors, one pair per resistor.

    `resistors` (n,): indices of the resistors, linear ones first, then nonlinear ones.
    """
    ends = ends_of(netlist)[resistors]
    return [list(pair) for pair in zip(*(netlist.names_of(ends[:, end]) for end in (0, 1)), strict=True)]


def scale_resistances(netlist: Netlist, factor: NDArray[np.float64]) -> Netlist:
    """Return the netlist with every resistance of the grid multiplied by the factor of its site.

    Conductances, and the saturation currents of nonlinear resistors, are divided by the factor.  `factor` (sites,):
    factor of every face of the grid, then, with a leak, of the leak of every cell; in a netlist without cells, factor
    of every resistor, linear ones first.  Switches, rail segments and loads of the read-out have no site and stay
    unchanged.
    """
    linear, nonlinear = resistor_sites(netlist)
    padded = np.append(factor, 1.0)  # for site -1
    return netlist.replace(
        conductance=netlist.conductance / padded[linear],
        nonlinear_current=netlist.nonlinear_current / padded[nonlinear],
    )


def seed_of(seed: Any) -> Seed:
    """Return a seed as an integer, or as a tuple of integers: the entropy, then the spawn key of a `SeedSequence`.

    `seed`: integer of at least 0, tuple of such integers, or `numpy.random.SeedSequence`; raise InputError for other
    values.
    """
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
    """Return the random generator of one random effect of a chip.

    `seed`: seed of the chip, an integer or a tuple of integers (entropy, spawn key); `stream`: number of the effect,
    such as `MISMATCH` or `NOISE`.
    """
    entropy, *key = seed if isinstance(seed, tuple) else (seed,)
    return np.random.default_rng(np.random.SeedSequence(entropy, spawn_key=(*key, stream)))


def mismatch_factors(count: int, deviation: float | NDArray[np.float64], seed: Seed) -> NDArray[np.float64]:
    """Return random factors of the resistances of one chip, (count,): log-normal with mean 1.

    `count`: number of sites; `deviation` () or (count,): standard deviation of a factor; `seed`: seed of the chip.  A
    factor is ``exp(s z - s^2 / 2)``, with a standard normal ``z`` and ``s^2 = log(1 + deviation^2)``.
    """
    log_variance = np.log1p(np.square(deviation))
    z = generator(seed, MISMATCH).standard_normal(count)
    z *= np.sqrt(log_variance)
    z -= 0.5 * log_variance
    return np.asarray(np.exp(z, out=z))
