"""The ideal netlist that a chip's flaws are then added to."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from resgrid import die
from resgrid.chip.passes import apply_passes, passes_of
from resgrid.chip.passes.spread import Mismatch
from resgrid.chip.passes.switches import InternodalSwitches
from resgrid.compiler import compile_space
from resgrid.die import Seed, seed_of
from resgrid.errors import InputError
from resgrid.netlist import Netlist
from resgrid.nodal.drive import scale_drive
from resgrid.nodal.solve import solve
from resgrid.scene.chip import Chip
from resgrid.space import ConfigurationSpace


def compile_cells(
    space: ConfigurationSpace,
    chip: Chip,
    *,
    boundary: str,
    drive: str | None,
    edge: str | Sequence[str],
    start: Sequence[int] | None,
) -> Netlist:
    """Compile a configuration space with one node per cell and the chip's resistance, supply and wall."""
    return compile_space(
        space,
        boundary=boundary,
        drive=drive,
        edge=edge,
        rails="cells",
        resistance=chip.resistance,
        supply=chip.supply,
        wall_resistance=chip.wall_resistance if boundary == "wall" else None,
        start=start,
    )


def ideal_netlist(
    space: ConfigurationSpace,
    chip: Chip,
    *,
    boundary: str = "dirichlet",
    drive: str | None = None,
    edge: str | Sequence[str] = "obstacle",
    start: Sequence[int] | None = None,
) -> Netlist:
    """Compile a configuration space with one node per cell, for `build_chip` and the analyses of many chips.

    Parameters
    ----------
    space : ConfigurationSpace
    chip : Chip
        Its resistance, supply and wall resistance count.
    boundary, drive, edge, start
        As in `compile_space`.  A uniform drive is scaled so that the highest node of the ideal chip sits at the supply.

    Returns
    -------
    Netlist

    Raises
    ------
    InputError, CircuitError
        As `compile_space`.
    """
    netlist = compile_cells(space, chip, boundary=boundary, drive=drive, edge=edge, start=start)
    return scale_drive(netlist, solve(netlist)) if netlist.current_nodes.size else netlist


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
    terms = die.mismatch_terms(model.deviations(netlist))
    for seed in seeds:
        yield die.per_resistor(netlist, die.mismatch_factors(*terms, seed))[0]


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


Form = Literal["circuit", "tiles", "grid"]

READING = ("readout.offset", "readout.noise_bandwidth", "readout.bits", "readout.range")
"""How voltages are read: what no circuit holds."""

_SCALE = ("resistance", "supply", "wall_resistance")
_HELD = {
    "grid": (*_SCALE, "capacitance"),
    "tiles": (
        *_SCALE,
        "capacitance",
        "goal_switch_on",
        "goal_switch_off",
        "obstacle_switch_on",
        "obstacle_switch_off",
        "internodal_switch_on",
        "internodal_switch_off",
        "preferred",
        "sheet_resistance",
        "width",
        "drawing_grid",
        "gradient",
        "pelgrom",
        "length",
        "mismatch",
        "seed",
    ),
}


def chip_keys(chip: Chip) -> Iterator[tuple[str, Any]]:
    """Every key of a chip, ``readout.bits`` for one of a table in it, and its value."""
    for item in dataclasses.fields(chip):
        value = getattr(chip, item.name)
        if dataclasses.is_dataclass(value):
            yield from ((f"{item.name}.{part.name}", getattr(value, part.name)) for part in dataclasses.fields(value))
        else:
            yield item.name, value


def keys_not_held(chip: Chip, form: Form) -> tuple[str, ...]:
    """The keys of a chip that say something about it and that a form of its circuit does not hold."""
    usual = dict(chip_keys(Chip()))
    return tuple(
        key
        for key, value in chip_keys(chip)
        if value != usual[key] and not _holds(form, key) and _matters(chip, key, usual[key])
    )


def _holds(form: Form, key: str) -> bool:
    return key not in READING if form == "circuit" else key in _HELD[form]


def _matters(chip: Chip, key: str, usual: Any) -> bool:
    """Whether the chip would be another one without the key."""
    table, _, name = key.rpartition(".")
    value = dataclasses.replace(getattr(chip, table), **{name: usual}) if table else usual
    try:
        other = dataclasses.replace(chip, **{table or name: value})
    except InputError:  # other keys rest on it
        return True
    return key in (*_SCALE, *READING) or passes_of(other) != passes_of(chip)
