"""Passes that make chips differ: a gradient over the die, mismatch, opens and shorts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid import die
from resgrid.arguments import check_number, check_optional, is_number
from resgrid.chip.passes import editing
from resgrid.die import DEFECTS, Seed, generator, mismatch_factors, mismatch_terms, seed_of
from resgrid.errors import InputError
from resgrid.netlist import GROUND, Netlist


@dataclass(frozen=True)
class Gradient:
    """Let the resistance grow linearly across the die; its middle keeps the nominal value.

    `shares`: growth from end to end along each axis (missing ones: 0), as a share of the nominal resistance.
    """

    shares: tuple[float, ...]

    def __post_init__(self) -> None:
        if not (isinstance(self.shares, tuple | list) and all(is_number(share) for share in self.shares)):
            raise InputError(f"gradient = {self.shares!r} must be several finite numbers, one for each axis")
        if sum(abs(share) for share in self.shares) >= 2:
            raise InputError(f"gradient = {list(self.shares)} takes a resistance below 0 in a corner of the die")

    def apply(self, netlist: Netlist) -> Netlist:
        """The same netlist with graded resistances."""
        cell_map = editing.layout_of(netlist, "gradients")
        ndim = cell_map.space.ndim
        if len(self.shares) > ndim:
            raise InputError(f"gradient has {len(self.shares)} entries, but the space has {ndim} axes")
        share = np.zeros(ndim)
        share[: len(self.shares)] = self.shares
        return die.scaled(netlist, 1 + (editing.face_places(cell_map) - 0.5) @ share)


@dataclass(frozen=True)
class Mismatch:
    """Let every resistor of the grid differ from its mean, independently and log-normally.

    `sigma`: standard deviation as a share of the mean; `pelgrom`: instead: ``A_R`` in % µm, for ``sigma = A_R /
    sqrt(W L)`` (Pelgrom, Duinmaijer & Welbers 1989); `width`: ``W``, in metres; `length`: ``L``, in metres; or
    instead; `sheet_resistance`: in ohms per square, for ``L = R W / Rs``; `seed`: the chip.
    """

    sigma: float | None = None
    pelgrom: float | None = None
    width: float | None = None
    length: float | None = None
    sheet_resistance: float | None = None
    seed: Seed = 0

    def __post_init__(self) -> None:
        if (self.sigma is None) == (self.pelgrom is None):
            raise InputError("mismatch needs either sigma or pelgrom")
        if self.sigma is not None:
            check_number("sigma", self.sigma, "at least 0 and below 1", least=0.0, below=1.0)
        check_optional("pelgrom", self.pelgrom, "finite and at least 0, in % µm", least=0.0)
        for name in ("width", "length"):
            check_optional(name, getattr(self, name), "positive and finite, in metres", above=0.0)
        check_optional("sheet_resistance", self.sheet_resistance, "positive and finite, in ohms per square", above=0.0)
        seed_of(self.seed)
        if self.pelgrom is not None and (
            self.width is None or (self.length is None) == (self.sheet_resistance is None)
        ):
            raise InputError("pelgrom needs width and either length or sheet_resistance")

    def deviations(self, netlist: Netlist) -> NDArray[np.float64]:
        """Standard deviation of every resistor that could be, as a share of its mean; shape (identities,)."""
        count = die.identities(netlist)
        if self.sigma is not None:
            return np.full(count, self.sigma)
        assert self.pelgrom is not None
        assert self.width is not None
        metres = np.full(count, self.length if self.length is not None else np.inf)
        if self.sheet_resistance is not None:
            linear, nonlinear = die.identity(netlist)
            own = linear >= 0
            resistance = np.full(count, np.inf)
            resistance[linear[own]] = 1 / netlist.conductance[own]
            resistance[nonlinear] = netlist.nonlinear_voltage / netlist.nonlinear_current
            metres = resistance * self.width / self.sheet_resistance
        return np.asarray(1e-8 * self.pelgrom / np.sqrt(self.width * metres))

    def factors(self, netlist: Netlist) -> NDArray[np.float64]:
        """What every resistance is multiplied by: mean 1; shape (identities,)."""
        return mismatch_factors(*mismatch_terms(self.deviations(netlist)), self.seed)

    def apply(self, netlist: Netlist) -> Netlist:
        """One chip of this seed."""
        return die.scaled(netlist, self.factors(netlist))


@dataclass(frozen=True)
class Faults:
    """Open some of the grid's resistors, and short others.

    A place is open, or shorted, at some density also at every higher density of the same seed.  A current source that
    only feeds nodes that opens cut off from the rest is left out: its current has nowhere to go.

    `open_density, short_density`: share of the resistors; together at most 1; `short_resistance`: of a short, in
    ohms; `seed`: the chip.
    """

    open_density: float = 0.0
    short_density: float = 0.0
    short_resistance: float = 1.0
    seed: Seed = 0

    def __post_init__(self) -> None:
        for name in ("open_density", "short_density"):
            check_number(name, getattr(self, name), "a share of the resistors, at least 0", least=0.0)
        if self.open_density + self.short_density > 1:
            raise InputError(
                f"open_density = {self.open_density:g} and short_density = {self.short_density:g} must be shares of "
                "the resistors, together at most 1"
            )
        check_number("short_resistance", self.short_resistance, "positive and finite, in ohms", above=0.0)
        seed_of(self.seed)

    def places(self, netlist: Netlist) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which places on the die are open, and which are shorted; each of shape (identities,)."""
        draw = generator(self.seed, DEFECTS).random(die.identities(netlist))
        return draw < self.open_density, draw >= 1 - self.short_density

    def apply(self, netlist: Netlist) -> Netlist:
        """One chip of this seed."""
        opened, shorted = (np.append(places, False) for places in self.places(netlist))
        linear, nonlinear = die.identity(netlist)
        conductance = np.where(shorted[linear], 1 / self.short_resistance, netlist.conductance)
        bridges = netlist.nonlinear_nodes[shorted[nonlinear]]
        face = None if netlist.cell_map is None else nonlinear[shorted[nonlinear]]
        changed = netlist.replace(
            conductance=conductance,
            tc1=None if netlist.tc1 is None else np.where(shorted[linear], 0.0, netlist.tc1),
            tc2=None if netlist.tc2 is None else np.where(shorted[linear], 0.0, netlist.tc2),
        )
        faulty = editing.keep_resistors(changed, ~opened[linear])
        if bridges.size:
            upward = None if netlist.cell_map is None else netlist.cell_map.nonlinear_upward[shorted[nonlinear]]
            bridges = bridges if upward is None else np.where(upward[:, np.newaxis], bridges, bridges[:, ::-1])
            faulty = editing.add_resistors(faulty, bridges, np.full(len(bridges), 1 / self.short_resistance), face)
        return without_stranded_currents(editing.keep_nonlinear(faulty, ~(opened | shorted)[nonlinear]))


def without_stranded_currents(netlist: Netlist) -> Netlist:
    """Leave out current sources that feed parts which nothing ties to ground."""
    if not netlist.current_nodes.size:
        return netlist
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ties = np.concatenate([netlist.resistor_nodes, netlist.source_nodes, netlist.nonlinear_nodes])
    count = netlist.node_count
    graph = coo_array((np.ones(len(ties), dtype=np.int8), (ties[:, 0], ties[:, 1])), shape=(count, count))
    part = connected_components(graph, directed=False)[1]
    kept = (part[netlist.current_nodes] == part[GROUND]).all(axis=1)
    return netlist.replace(
        current_nodes=netlist.current_nodes[kept], current_amps=netlist.current_amps[kept], element_names=None
    )
