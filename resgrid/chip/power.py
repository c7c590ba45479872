"""Power of a chip: sources, heat of resistors, and droop of the rails."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.chip.figures_of_merit import Figure, Result
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.core.cell import Cell
from resgrid.core.netlist import GROUND, Netlist
from resgrid.core.random_sites import end_names
from resgrid.spice.power import PowerBalance, power_balance

_WORST = 10
"""Default number of resistors in a list of the hottest ones."""


@dataclass(frozen=True)
class RailPower:
    """Power of the voltage sources of one rail.

    An entry of `Power.rails`, which `resgrid.chip.Study.power` returns.

    Attributes
    ----------
    name : str
        ``"obstacle"``, ``"goal_0"`` and so on for the goal regions, or the name of the node that the sources hold.
    volts : float
        Voltage of the sources, in volts.
    sources : int
        Number of sources.
    amps : float
        Current out of the plus terminals of the sources, in amperes.
    watts : float
        Power that the sources deliver, in watts; negative where they absorb power.

    Examples
    --------
    >>> rail = rg.study(rg.read_scene("examples/scenes/lesson.toml")).power().rails[0]
    >>> rail.name, rail.sources, f"{rail.amps:.4g} A at {rail.volts:g} V"
    ('obstacle', 8, '0.0002462 A at 1 V')
    """

    name: str
    volts: float
    sources: int
    amps: float
    watts: float


@dataclass(frozen=True, eq=False, repr=False)
class Power(Result):
    """Power of a chip at its operating point.

    Returned by `resgrid.chip.Study.power`.

    Attributes
    ----------
    op : OperatingPoint
        Operating point of the chip.
    rails : tuple of RailPower
        Voltage sources, rail by rail, without the 0 V sources that join a cell to a rail.
    current_sources : float
        Power that all current sources deliver, in watts.
    resistor : ndarray of float64, shape (resistors,)
        Heat (dissipated power) of every linear resistor, in watts.
    nonlinear : ndarray of float64, shape (nonlinear resistors,)
        Heat of every nonlinear resistor, in watts.
    node : ndarray of float64, shape (nodes,)
        Half the heat of all resistors with an end at each node, in watts.
    droop : ndarray of float64, shape (nodes,)
        Voltage between an obstacle or goal cell and its rail, in volts.  It is positive where the voltage of an
        obstacle cell deviates towards the goal rail, or that of a goal cell towards the obstacle rail.  NaN at other
        nodes; empty without a map of cells.
    total : float
        Heat of all resistors, equal to the power of all sources, in watts.
    largest_droop : float
        Largest magnitude of `droop`, in volts; 0 where obstacle and goal cells have no nodes of their own.
    cell_heat : ndarray of float64, shape of the space
        Heat at every cell, in watts; NaN where a cell has no node of its own.
    figures : mapping of str to Figure
        Figures of merit by name.

    Examples
    --------
    >>> power = rg.study(rg.read_scene("examples/scenes/lesson.toml"), rg.Chip(rail_resistance=10.0)).power()
    >>> f"{power.total:.4g} W", f"{power.largest_droop:.3g} V"
    ('0.0002459 W', '0.00103 V')
    >>> hottest = power.worst(count=1)
    >>> power.op.netlist.names_of(power.op.netlist.resistor_nodes[hottest[0]])
    ['n_6_0', 'n_6_1']
    """

    op: OperatingPoint
    rails: tuple[RailPower, ...]
    current_sources: float
    resistor: NDArray[np.float64]
    nonlinear: NDArray[np.float64]
    node: NDArray[np.float64]
    droop: NDArray[np.float64]

    @property
    def total(self) -> float:
        """Heat of all resistors, equal to the power of all sources, in watts."""
        return float(self.resistor.sum() + self.nonlinear.sum())

    @property
    def largest_droop(self) -> float:
        """Largest magnitude of the droop of an obstacle or goal cell, in volts; 0 if no such cell has its own node."""
        return float(np.nanmax(np.abs(self.droop))) if np.isfinite(self.droop).any() else 0.0

    def worst(self, count: int = _WORST) -> NDArray[np.int64]:
        """Return the numbers of the linear resistors with the largest heat, hottest first.

        Parameters
        ----------
        count : int
            Maximum number of resistors.

        Returns
        -------
        ndarray of int64, shape (at most count,)
            Numbers of the resistors, indices into `resistor`.
        """
        return np.argsort(-self.resistor, kind="stable")[:count]

    @property
    def cell_heat(self) -> NDArray[np.float64]:
        """Heat at every cell, shape of the space, in watts: half the heat of all resistors at the cell's node.

        The heat is NaN where a cell has no node of its own.
        """
        cell_map = self.op.netlist.cells
        cell = self.op.netlist.cell_of_node()
        heat = np.full(cell_map.space.cell.size, np.nan)
        heat[cell[cell >= 0]] = self.node[cell >= 0]
        return heat.reshape(cell_map.space.shape)

    @property
    def figures(self) -> Mapping[str, Figure]:
        """Figures of merit by name: heat, droop of the supply, and delivered powers.

        ``power``: heat in all resistors, and ``hottest_resistor``: heat in one resistor, in watts; ``supply_droop``:
        largest voltage in volts between an obstacle or goal cell and its rail; ``power_current_sources`` and
        ``power_<rail>``: powers that sources deliver, in watts.
        """
        hottest = float(self.resistor.max(initial=0.0))
        result = {
            "power": Figure(self.total, "W", "heat in all resistors at the operating point"),
            "hottest_resistor": Figure(hottest, "W", "heat in the resistor that dissipates most"),
            "supply_droop": Figure(
                self.largest_droop, "V", "largest distance of an obstacle or goal cell from the voltage of its rail"
            ),
            "power_current_sources": Figure(
                self.current_sources, "W", "power that the drive's current sources deliver"
            ),
        }
        for rail in self.rails:
            result[f"power_{rail.name}"] = Figure(
                rail.watts, "W", f"power delivered by the {rail.sources} sources of {rail.volts:g} V at {rail.name}"
            )
        return result

    def to_json(self) -> dict[str, Any]:
        """Return the result as a dictionary for JSON.

        Keys: the names of `figures`, each with a dictionary of ``value``, ``unit`` and ``definition``; ``hottest``:
        list of the ten hottest resistors, each with ``nodes`` (names of both nodes) and ``power`` (watts).
        """
        worst = self.worst()
        names, heat = end_names(self.op.netlist, worst), self.resistor[worst].tolist()
        hottest = [{"nodes": pair, "power": watts} for pair, watts in zip(names, heat, strict=True)]
        return {**super().to_json(), "hottest": hottest}


def analyse_power(op: OperatingPoint) -> Power:
    """Compute the power of the sources and the heat of the resistors at an operating point; return them as a Power."""
    netlist = op.netlist
    balance = power_balance(op)
    heat, nonlinear = balance.resistor_power, balance.nonlinear_power
    halves = np.zeros(netlist.node_count)
    for ends, watts in ((netlist.resistor_nodes, heat), (netlist.nonlinear_nodes, nonlinear)):
        for end in (0, 1):
            halves += 0.5 * np.bincount(ends[:, end], watts, netlist.node_count)
    return Power(
        op=op,
        rails=_rails(op, balance),
        current_sources=float(balance.current_source_power.sum()),
        resistor=heat,
        nonlinear=nonlinear,
        node=halves,
        droop=_droop(op),
    )


def _rails(op: OperatingPoint, balance: PowerBalance) -> tuple[RailPower, ...]:
    """Return the power of the voltage sources, grouped by rail and voltage, as a tuple of RailPower.

    Sources of 0 V between two nodes, which join a cell to a rail, are left out.  `op`: operating point; `balance`:
    power of every element.
    """
    netlist = op.netlist
    ties = (netlist.source_volts == 0.0) & (netlist.source_nodes != GROUND).all(axis=1)
    groups: dict[tuple[str, float], list[int]] = {}
    for number, name in enumerate(rail_names(netlist)):
        if not ties[number]:
            groups.setdefault((name, float(netlist.source_volts[number])), []).append(number)
    return tuple(
        RailPower(
            name,
            volts,
            sources=len(numbers),
            amps=float(-op.source_current[numbers].sum()),
            watts=float(balance.source_power[numbers].sum()),
        )
        for (name, volts), numbers in groups.items()
    )


def rail_names(netlist: Netlist) -> list[str]:
    """Return the name of the rail of every voltage source: ``"obstacle"``, or ``"goal_0"`` and so on for goal regions.

    Other sources, and all sources of a netlist without one node per cell, have the name of the node at their plus
    terminal, or of the node at their minus terminal if the plus terminal is at ground.
    """
    plus, minus = netlist.source_nodes.T
    node = np.where(plus == GROUND, minus, plus)
    names = netlist.names_of(node)
    if netlist.cell_map is None or netlist.cells.wiring.rails != "cells":
        return names
    space = netlist.cells.space
    for number, cell in enumerate(netlist.cell_of_node()[node].tolist()):
        if cell >= 0 and space.cell.flat[cell] == Cell.OBSTACLE:
            names[number] = "obstacle"
        elif cell >= 0 and space.cell.flat[cell] == Cell.GOAL:
            names[number] = f"goal_{space.goal_region.flat[cell]}"
    return names


def _droop(op: OperatingPoint) -> NDArray[np.float64]:
    """Return the voltage between obstacle or goal cells and their rail, in volts, shape (nodes,).

    The value is positive where the cell's voltage deviates from its rail towards the opposite rail, and NaN at other
    nodes. The array is empty if the netlist has no map of cells.
    """
    if op.netlist.cell_map is None:
        return np.empty(0)
    cells = op.netlist.cells
    code, wiring, own = cells.space.cell, cells.wiring, cells.node >= 0
    droop = np.full(op.netlist.node_count, np.nan)
    if not wiring.is_open:
        high = cells.node[(code == Cell.OBSTACLE) & own]
        droop[high] = wiring.high - op.voltage[high]
    low = cells.node[(code == Cell.GOAL) & own]
    droop[low] = op.voltage[low] - wiring.goal_voltage
    return np.asarray(np.sign(wiring.supply) * droop)
