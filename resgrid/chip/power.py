"""Where a chip's power comes from and where it becomes heat."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.chip.figures import Reading, json_form
from resgrid.frozen import frozen, picture_html
from resgrid.netlist import GROUND, Netlist
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.space import Cell
from resgrid.spice.power import PowerBalance, power_balance

_WORST = 10


@dataclass(frozen=True)
class RailPower:
    """What the voltage sources of one rail deliver together.

    `name`: ``"obstacle"``, ``"goal_0"`` ..., ``"start"``, or the node's name; `volts`: voltage of the sources, in
    volts; `sources`: how many there are; `amps`: current out of their plus terminals, in amperes; `watts`: power they
    deliver, in watts; negative where they take power up.
    """

    name: str
    volts: float
    sources: int
    amps: float
    watts: float


@frozen
@dataclass(frozen=True, eq=False)
class Power:
    """The power of a chip at its operating point.

    Attributes
    ----------
    point : OperatingPoint
        The operating point.
    rails : tuple of RailPower
        Voltage sources, rail by rail; without those of 0 V that join a cell to a rail.
    current_sources : float
        Power that all current sources deliver, in watts.
    resistor : ndarray of float64, shape (resistors,)
        Heat in every resistor, in watts.
    nonlinear : ndarray of float64, shape (nonlinear resistors,)
        Heat in every nonlinear resistor, in watts.
    node : ndarray of float64, shape (nodes,)
        Heat in the halves of resistors next to every node, in watts.
    droop : ndarray of float64, shape (nodes,)
        How far an obstacle or goal cell is from the voltage of its rail, in volts, towards the other rail; NaN at other
        nodes, empty without a map of cells.
    """

    point: OperatingPoint
    rails: tuple[RailPower, ...]
    current_sources: float
    resistor: NDArray[np.float64]
    nonlinear: NDArray[np.float64]
    node: NDArray[np.float64]
    droop: NDArray[np.float64]

    _repr_html_ = picture_html

    @property
    def total(self) -> float:
        """Heat in all resistors, in watts; what all sources deliver."""
        return float(self.resistor.sum() + self.nonlinear.sum())

    @property
    def largest_droop(self) -> float:
        """Largest droop of a rail cell, in volts; 0 where no cell has a node of its own on a rail."""
        return float(np.nanmax(np.abs(self.droop))) if np.isfinite(self.droop).any() else 0.0

    def worst(self, count: int = _WORST) -> NDArray[np.int64]:
        """Numbers of the resistors that dissipate most, hottest first; shape (at most count,)."""
        return np.argsort(-self.resistor, kind="stable")[:count]

    @property
    def cell_heat(self) -> NDArray[np.float64]:
        """Heat at every cell, shape of the space, in watts; NaN where a cell has no node of its own."""
        cell_map = self.point.netlist.cells
        cell = self.point.netlist.cell_of_node()
        heat = np.full(cell_map.space.cell.size, np.nan)
        heat[cell[cell >= 0]] = self.node[cell >= 0]
        return heat.reshape(cell_map.space.shape)

    @property
    def readings(self) -> Mapping[str, Reading]:
        """The figures, with units and definitions."""
        hottest = float(self.resistor.max(initial=0.0))
        result = {
            "power": Reading(self.total, "W", "heat in all resistors at the operating point"),
            "hottest_resistor": Reading(hottest, "W", "heat in the resistor that dissipates most"),
            "supply_droop": Reading(
                self.largest_droop, "V", "largest distance of an obstacle or goal cell from the voltage of its rail"
            ),
            "power_current_sources": Reading(
                self.current_sources, "W", "power that the drive's current sources deliver"
            ),
        }
        for rail in self.rails:
            result[f"power_{rail.name}"] = Reading(
                rail.watts, "W", f"power delivered by the {rail.sources} sources of {rail.volts:g} V at {rail.name}"
            )
        return result

    def to_json(self) -> dict[str, Any]:
        """The readings and the hottest resistors, as plain values."""
        netlist = self.point.netlist
        worst = self.worst()
        ends = netlist.resistor_nodes[worst]
        names = list(zip(netlist.names_of(ends[:, 0]), netlist.names_of(ends[:, 1]), strict=True))
        return {
            **json_form(self.readings),
            "hottest": [
                {"nodes": list(pair), "power": watts}
                for pair, watts in zip(names, self.resistor[worst].tolist(), strict=True)
            ],
        }


def analyse_power(point: OperatingPoint) -> Power:
    """Account for the power of an operating point.

    Parameters
    ----------
    point : OperatingPoint

    Returns
    -------
    Power
    """
    netlist = point.netlist
    balance = power_balance(point)
    heat, nonlinear = balance.resistor_power, balance.nonlinear_power
    count = netlist.node_count
    halves = np.zeros(count)
    for ends, watts in ((netlist.resistor_nodes, heat), (netlist.nonlinear_nodes, nonlinear)):
        for column in (0, 1):
            halves += 0.5 * np.bincount(ends[:, column], watts, count)
    return Power(
        point=point,
        rails=_rails(point, balance),
        current_sources=float(balance.current_source_power.sum()),
        resistor=heat,
        nonlinear=nonlinear,
        node=halves,
        droop=_droop(point),
    )


def _rails(point: OperatingPoint, balance: PowerBalance) -> tuple[RailPower, ...]:
    netlist = point.netlist
    groups: dict[tuple[str, float], list[int]] = {}
    names = _rail_names(netlist)
    ties = (netlist.source_volts == 0.0) & (netlist.source_nodes != GROUND).all(axis=1)
    for number in np.flatnonzero(~ties).tolist():
        volts = float(netlist.source_volts[number])
        groups.setdefault((names[number], volts), []).append(number)
    result = []
    for (name, volts), numbers in groups.items():
        amps = -point.source_current[numbers]
        result.append(
            RailPower(name, volts, len(numbers), float(amps.sum()), float(balance.source_power[numbers].sum()))
        )
    return tuple(result)


def _rail_names(netlist: Netlist) -> list[str]:
    """For every voltage source the rail that it is part of."""
    node = netlist.source_nodes[:, 0].copy()
    node[node == GROUND] = netlist.source_nodes[node == GROUND, 1]
    names = netlist.names_of(node)
    cell_map = netlist.cell_map
    if cell_map is None or cell_map.wiring.rails != "cells":
        return names
    cell = netlist.cell_of_node()[node]
    code, region = cell_map.space.cell.ravel(), cell_map.space.goal_region.ravel()
    for number, place in enumerate(cell.tolist()):
        if place >= 0 and code[place] == Cell.OBSTACLE:
            names[number] = "obstacle"
        elif place >= 0 and code[place] == Cell.GOAL:
            names[number] = f"goal_{region[place]}"
    return names


def _droop(point: OperatingPoint) -> NDArray[np.float64]:
    cell_map = point.netlist.cell_map
    if cell_map is None:
        return np.empty(0)
    droop = np.full(point.netlist.node_count, np.nan)
    towards = np.sign(cell_map.wiring.supply)
    code = cell_map.space.cell
    if cell_map.wiring.boundary != "neumann":
        high = cell_map.node[(code == Cell.OBSTACLE) & (cell_map.node >= 0)]
        droop[high] = towards * (cell_map.wiring.goal_voltage + cell_map.wiring.supply - point.voltage[high])
    low = cell_map.node[(code == Cell.GOAL) & (cell_map.node >= 0)]
    droop[low] = towards * (point.voltage[low] - cell_map.wiring.goal_voltage)
    return droop
