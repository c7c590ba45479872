"""Faults of fabrication: resistors of the grid that are open or shorted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid import die
from resgrid.arguments import check_number
from resgrid.chip import faces
from resgrid.errors import InputError
from resgrid.netlist import GROUND, Netlist
from resgrid.randomness import DEFECTS, Seed, generator, seed_of


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
        faulty = faces.keep_resistors(changed, ~opened[linear])
        if bridges.size:
            upward = None if netlist.cell_map is None else netlist.cell_map.nonlinear_upward[shorted[nonlinear]]
            bridges = bridges if upward is None else np.where(upward[:, np.newaxis], bridges, bridges[:, ::-1])
            faulty = faces.add_resistors(faulty, bridges, np.full(len(bridges), 1 / self.short_resistance), face)
        return without_stranded_currents(faces.keep_nonlinear(faulty, ~(opened | shorted)[nonlinear]))


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
