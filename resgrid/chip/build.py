"""Construction of chips: the netlist of one chip from a chip description, or conductances of many chips."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from resgrid.chip import effects
from resgrid.chip.effects import Effect, Faults, InternodalSwitches, Mismatch
from resgrid.chip.effects.base import checked
from resgrid.chip.figures_of_merit import formatted
from resgrid.core import random_sites
from resgrid.core.drive_checks import require_drive
from resgrid.core.lattice import require_square
from resgrid.core.netlist import Netlist
from resgrid.core.random_sites import Seed, seed_of
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring
from resgrid.errors import InputError, suggestion
from resgrid.planning.pipeline import compile_circuit
from resgrid.scene.chip import Chip
from resgrid.scene.table_models import described_keys

Form = Literal["circuit", "tiles", "grid"]
"""Form of an exported circuit: the netlist of `build_chip` with all effects (``"circuit"``), an array of equal
subcircuits with one cell each (``"tiles"``), or the ideal netlist without effects (``"grid"``).
"""

READING = (
    "readout.figure_of_merit",
    "readout.conversion_time",
    "readout.offset",
    "readout.noise_bandwidth",
    "readout.bits",
    "readout.range",
)
"""Keys of the read-out in a chip description that do not change the circuit."""

_SCALE = ("resistance", "corner", "supply", "wall_resistance")
"""Keys of the chip description that every form of the circuit (netlist with effects, array of tiles, ideal netlist)
represents.

The next three constants are groups of further keys: `_SWITCHES`, `_DRAWN` (rounding of resistances to preferred values
or drawn lengths) and `_SCATTERED` (deviations of the resistances).
"""
_SWITCHES = tuple(f"{kind}_switch_{state}" for kind in ("goal", "obstacle", "internodal") for state in ("on", "off"))
_DRAWN = ("process", "preferred", "sheet_resistance", "width", "length", "drawing_grid")
_SCATTERED = ("gradient", "pelgrom", "mismatch", "seed")
_HELD = {
    "grid": (*_SCALE, "capacitance"),  # capacitors carry no current at the operating point
    "tiles": (*_SCALE, "capacitance", *_SWITCHES, *_DRAWN, *_SCATTERED),
}
"""Keys of the chip description whose effects a form of the circuit represents, by the name of the form.

The form ``"circuit"`` is not listed: it represents all keys except `READING`.
"""


def build_chip(netlist: Netlist, chip: Chip | Iterable[Effect], seed: Any = None) -> Netlist:
    """Return the netlist of a chip: an ideal netlist with all effects of a chip description.

    Parameters
    ----------
    netlist : Netlist
        The ideal circuit, compiled with the resistance and supply of the chip.  Switches, rails, capacitors and loads
        need ``rails="cells"``.
    chip : Chip or iterable of Effect
        The chip description, or effects in the order in which they are applied (`resgrid.chip.effects`).
    seed : int, sequence of int or numpy.random.SeedSequence, optional
        Seed of the random effects; by default that of the chip description, or of each effect in `chip`.

    Returns
    -------
    Netlist
        The circuit with all effects.  Resistors of the grid keep their order; saturating resistors become nonlinear
        ones in the same order, and open resistors are left out.  Switches, rails and loads are appended.

    Raises
    ------
    InputError
        If the netlist does not suit an effect.

    Examples
    --------
    >>> ideal = rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")), rails="cells")
    >>> real = rg.chip.build_chip(ideal, rg.Chip(mismatch="1 %", goal_switch_on=100.0))
    >>> real
    <Netlist of 67 nodes: 145 resistors, 9 voltage sources>
    >>> float((real.conductance[:144] / ideal.conductance).std().round(3))
    0.01
    """
    for effect in checked(effects.of_chip(chip, seed) if isinstance(chip, Chip) else chip):
        netlist = effect.apply(netlist)
    return netlist


def ideal_netlist(space: ConfigurationSpace, chip: Chip, wiring: Wiring) -> Netlist:
    """Return the ideal netlist of a space for `build_chip`: one node per cell, with the chip's resistance and supply.

    The currents of a uniform drive are scaled so that the highest node is at the supply.  `space`: the space to
    compile; `chip`: gives resistance, supply and wall resistance; `wiring`: boundary conditions of the circuit.
    """
    require_square(wiring.lattice, "the chip with its imperfections")
    require_drive(wiring, "the chip")
    wall = chip.wall_resistance if wiring.boundary == "wall" else None
    own = dataclasses.replace(
        wiring, rails="cells", resistance=chip.with_process().resistance, supply=chip.supply, wall_resistance=wall
    )
    return compile_circuit(space, own)


def conductance_samples(netlist: Netlist, seeds: Iterable[Any], *, chip: Chip) -> tuple[Netlist, NDArray[np.float64]]:
    """Return the circuit of a chip without mismatch, and the conductances of one chip per seed with mismatch.

    The conductances, in siemens, have shape (chips, resistors), in the order of the returned circuit.  `netlist`: ideal
    circuit; `seeds`: seed of every chip; `chip`: chip description.  Raises InputError for chips with defects or
    saturation, whose circuits differ in more than their conductances.
    """
    model = ConductanceModel.of(netlist, chip)
    return model.netlist, model.draw([seed_of(seed) for seed in seeds])


@dataclass(frozen=True, eq=False)
class ConductanceModel:
    """Distribution of the conductances of chips that share one circuit: everything that does not depend on the seed.

    A site is a numbered place on the die (a cell face, or a cell with a leak) with a random factor for the resistance
    of the grid resistor in that place.  The first ``k`` resistors of the circuit are those of the ideal circuit.
    Resistors that effects append (open switches, rail segments, loads of the read-out) follow; they have no mismatch.

    `netlist`: the circuit with all effects except mismatch; `site` (k,): site of each of the first ``k`` resistors, -1
    for a resistor that lies in no site and has no mismatch; `sites`: number of sites; `deviation`: standard deviation
    of a resistance as a fraction of its mean, shape () or (sites,), None without mismatch; `switch` (k,): resistance,
    in ohms, of the closed switch in series with each of the first ``k`` resistors, 0 without a switch.  A conductance
    in `netlist` is that of the resistor and its switch in series; the random factor multiplies only the resistance of
    the resistor.
    """

    netlist: Netlist
    site: NDArray[np.integer[Any]]
    sites: int
    deviation: float | NDArray[np.float64] | None
    switch: NDArray[np.float64]

    @classmethod
    def of(cls, netlist: Netlist, chip: Chip) -> ConductanceModel:
        """Return the model of a chip; raise InputError for chips with defects or saturation, whose circuits differ.

        `netlist`: ideal circuit; `chip`: chip description.
        """
        if chip.saturation_voltage is not None or Faults.of(chip, 0):
            raise InputError(
                "chips with defects or saturation differ in more than their conductances; build them one by one"
            )
        chip = chip.with_process()
        chain = effects.of_chip(chip)
        mismatch = Mismatch.of(chip, chip.seed)
        before = 0 if mismatch is None else chain.index(mismatch)
        drawn = circuit = build_chip(netlist, chain[:before])
        switch = np.zeros(len(drawn.conductance))
        for effect in chain[before:]:
            if isinstance(effect, Mismatch):
                continue
            without, circuit = circuit, effect.apply(circuit)
            if isinstance(effect, InternodalSwitches):
                # A closed switch lies in series with a resistor, and does not share its mismatch.
                switch = 1 / circuit.conductance[: len(switch)] - 1 / without.conductance
        deviation = None if mismatch is None else mismatch.deviation(drawn)
        return cls(circuit, random_sites.resistor_sites(drawn)[0], random_sites.site_count(drawn), deviation, switch)

    def draw(self, seeds: Sequence[Seed]) -> NDArray[np.float64]:
        """Draw one chip per seed at random; return the conductances in siemens, shape (chips, resistors).

        The resistors have the order of `netlist`, the circuit without mismatch.
        """
        samples = np.tile(self.netlist.conductance, (len(seeds), 1))
        if self.deviation is None:
            return samples
        has_switches = bool(self.switch.any())
        for row, seed in zip(samples, seeds, strict=True):
            factors = np.append(random_sites.mismatch_factors(self.sites, self.deviation, seed), 1.0)[self.site]
            own = row[: len(self.switch)]
            own[:] = 1 / ((1 / own - self.switch) * factors + self.switch) if has_switches else own / factors
        return samples


def chip_keys(chip: Chip) -> dict[str, Any]:
    """Return the values of all keys of a chip description, by key, with dots for nested tables (``readout.bits``)."""
    return {key: attrgetter(key)(chip) for key in described_keys(Chip)}


def chip_with(chip: Chip, values: Mapping[str, Any]) -> Chip:
    """Return a copy of a chip description with other values, given by key: ``{"mismatch": 0.02, "readout.bits": 8}``.

    Raises InputError for an unknown key or an invalid value.
    """
    known = list(described_keys(Chip))
    tables: dict[str, dict[str, Any]] = {"": {}}
    for key, value in values.items():
        if key not in known:
            hint = suggestion(key, known) or f"there are {', '.join(known)}"
            raise InputError(f"a chip has no key {key!r}; {hint}")
        table, _, name = key.rpartition(".")
        tables.setdefault(table, {})[name] = value.item() if isinstance(value, np.generic) else value
    own = tables.pop("")  # change all keys of a table at once: its checks involve several keys
    inner = {table: dataclasses.replace(getattr(chip, table), **parts) for table, parts in tables.items()}
    return dataclasses.replace(chip, **own, **inner)


def described(chip: Chip, shape: Sequence[int], boundary: str, leak: float = 0.0) -> list[tuple[str, str, str]]:
    """Return rows of text (key, value with unit, meaning) on the grid of a chip and on every key that is set.

    `chip`: chip description; `shape`: number of cells along each axis; `boundary`: ``"dirichlet"``, ``"neumann"`` or
    ``"wall"``; `leak`: leak of the free cells, in 1 / (unit of the axes)^2.
    """
    meaning = {"dirichlet": "are a rail", "neumann": "are open", "wall": "are a rail with a series resistance"}[
        boundary
    ]
    size = f"{' x '.join(map(str, shape))} cells"
    rows = [("grid", size, "one node each"), ("boundary", boundary, f"obstacles {meaning}")]
    if leak:
        rows.append(("leak", f"{leak:g}", "of every free cell to the obstacle rail, in 1 / (unit of the axes)^2"))
    about = described_keys(Chip)
    values = chip_keys(chip.with_process()) | {"process": chip.process, "corner": chip.corner}
    if values["sheet_resistance"] is None:
        del values["drawing_grid"]
    for key, value in values.items():
        unit, meaning = about[key]
        if value is not None:
            rows.append((key, value_text(value, unit), meaning))
    return rows


def value_text(value: Any, unit: str) -> str:
    """Return a value of a chip description as text with its unit; ``"none"`` for None.

    Entries of a tuple are separated by commas.  `unit`: SI unit, or ``""`` for a pure number.
    """
    if isinstance(value, tuple):
        return ", ".join(value_text(part, unit) for part in value)
    if value is None:
        return "none"
    if unit in ("% µm", "1/K", "1/K^2") or isinstance(value, str):
        return f"{value} {unit}".strip()
    return formatted(value, unit)


def keys_not_held(chip: Chip, form: Form) -> tuple[str, ...]:
    """Return the keys of a chip description that differ from their defaults and that a form of its circuit ignores.

    `form`: ``"circuit"`` (all effects), ``"tiles"`` (array of subcircuits) or ``"grid"`` (ideal netlist).
    """
    usual, values = chip_keys(Chip()), chip_keys(chip)
    held = values.keys() - set(READING) if form == "circuit" else _HELD[form]
    said = (key for key, value in values.items() if key not in held and value != usual[key])
    return tuple(key for key in said if _matters(chip, key, usual[key]))


def _matters(chip: Chip, key: str, usual: Any) -> bool:
    """Return whether the chip would change if a key of its description had its default value.

    `key`: key of the chip description; `usual`: default value of the key.  Keys of the scale (resistance, corner,
    supply, wall resistance) and of the read-out always count as a change.  The result is also True if the description
    would be invalid with the default value, because another key requires `key`.
    """
    try:
        other = chip_with(chip, {key: usual})
    except InputError:  # other keys need this one
        return True
    return key in (*_SCALE, *READING) or effects.of_chip(other) != effects.of_chip(chip)
