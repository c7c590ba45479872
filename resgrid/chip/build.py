"""From a chip's description to the netlist of one chip, or to the conductances of many."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid import die, randomness
from resgrid.chip.ideal import compile_cells
from resgrid.chip.passes import apply_passes, passes_of
from resgrid.chip.resistors import Mismatch
from resgrid.chip.switches import InternodalSwitches
from resgrid.errors import InputError
from resgrid.netlist import Netlist
from resgrid.randomness import Seed, seed_of
from resgrid.scene.chip import Chip
from resgrid.space import ConfigurationSpace


def build_chip(netlist: Netlist, chip: Chip, seed: Any = None) -> Netlist:
    """Give an ideal netlist everything that a chip's description says.

    Parameters
    ----------
    netlist : Netlist
        Compiled with the chip's resistance and supply; with ``rails="cells"`` for switches, rails, capacitors and
        loads.
    chip : Chip
    seed : int, sequence of int or numpy.random.SeedSequence, optional
        Which chip of the kind; the description's by default.

    Returns
    -------
    Netlist
        The grid's resistors keep their numbers (those that saturate become nonlinear ones in the same order, open ones
        are left out); switches, rails and loads are appended.

    Raises
    ------
    InputError
        If the netlist does not suit an effect.
    """
    return apply_passes(netlist, passes_of(chip, seed))


def compile_chip(
    space: ConfigurationSpace,
    chip: Chip,
    *,
    boundary: str = "dirichlet",
    drive: str | None = None,
    edge: str | Sequence[str] = "obstacle",
    start: Sequence[int] | None = None,
    seed: Any = None,
) -> Netlist:
    """Compile a configuration space for one chip: `compile_space` with one node per cell, then `build_chip`.

    Parameters
    ----------
    space : ConfigurationSpace
    chip : Chip
    boundary, drive, edge, start
        As in `compile_space`.
    seed : int, sequence of int or numpy.random.SeedSequence, optional
        Which chip of the kind; the description's by default.

    Returns
    -------
    Netlist

    Raises
    ------
    InputError, CircuitError
        As `compile_space` and `build_chip`.
    """
    ideal = compile_cells(space, chip, boundary=boundary, drive=drive, edge=edge, start=start)
    return build_chip(ideal, chip, seed)


def mismatch_factors(netlist: Netlist, chip: Chip, seeds: Iterable[Any]) -> NDArray[np.float64]:
    """What fabrication multiplies the resistances of many chips by.

    Parameters
    ----------
    netlist : Netlist
        With the resistances as they are drawn.
    chip : Chip
    seeds : iterable of seeds
        One for each chip.

    Returns
    -------
    ndarray of float64, shape (chips, resistors)
        Row ``k`` belongs to the chip that `build_chip` makes with seed ``k``; mean 1, and 1 for resistors that are not
        the grid's own.
    """
    wanted = [seed_of(seed) for seed in seeds]
    factors = np.empty((len(wanted), len(netlist.conductance)))
    for row, drawn in zip(factors, _drawn_rows(netlist, chip, wanted), strict=True):
        row[:] = drawn
    return factors


def _drawn_rows(netlist: Netlist, chip: Chip, seeds: Sequence[Seed]) -> Iterator[NDArray[np.float64]]:
    """The factors of one chip after the other, each of shape (resistors,)."""
    model = next((effect for effect in passes_of(chip) if isinstance(effect, Mismatch)), None)
    if model is None:
        yield from (np.ones(len(netlist.conductance)) for _ in seeds)
        return
    terms = randomness.mismatch_terms(model.deviations(netlist))
    for seed in seeds:
        yield die.per_resistor(netlist, randomness.mismatch_factors(*terms, seed))[0]


def conductance_samples(netlist: Netlist, chip: Chip, seeds: Iterable[Any]) -> tuple[Netlist, NDArray[np.float64]]:
    """The conductances of many chips on one and the same circuit, without building a netlist for each.

    Parameters
    ----------
    netlist : Netlist
        The ideal one, as for `build_chip`.
    chip : Chip
        Without defects and saturation, which change the circuit.
    seeds : iterable of seeds
        One for each chip.

    Returns
    -------
    circuit : Netlist
        The chip without mismatch.
    conductance : ndarray of float64, shape (chips, resistors)
        In siemens; row ``k`` is the conductance of ``build_chip(netlist, chip, seed k)``.

    Raises
    ------
    InputError
        If the chip has defects or saturates.
    """
    if chip.saturation_voltage is not None or chip.defects.open_density or chip.defects.short_density:
        raise InputError(
            "chips with defects or saturation differ in more than their conductances; build them one by one"
        )
    passes = passes_of(chip)
    made = next((place for place, effect in enumerate(passes) if isinstance(effect, Mismatch)), 0)
    drawn = apply_passes(netlist, passes[:made])
    circuit, switch = drawn, np.zeros(len(drawn.conductance))
    for effect in passes[made:]:
        if isinstance(effect, Mismatch):
            continue
        before, circuit = circuit, effect.apply(circuit)
        if isinstance(effect, InternodalSwitches):
            # A closed switch lies in series with a resistor, and does not share its mismatch.
            switch = 1 / circuit.conductance[: len(switch)] - 1 / before.conductance
    wanted = [seed_of(seed) for seed in seeds]
    samples = np.empty((len(wanted), len(circuit.conductance)))
    m = len(switch)
    nominal, resistance = circuit.conductance[:m], 1 / circuit.conductance[:m] - switch
    for row, factors in zip(samples, _drawn_rows(drawn, chip, wanted), strict=True):
        if switch.any():
            np.divide(1.0, resistance * factors + switch, out=row[:m])
        else:
            np.divide(nominal, factors, out=row[:m])
        row[m:] = circuit.conductance[m:]
    return circuit, samples
