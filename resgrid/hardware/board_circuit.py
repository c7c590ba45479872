"""The circuit that a board realises (a compiled space with E96 resistors and named nets), and limits of boards."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import solve
from resgrid.core.cell import Cell
from resgrid.core.compiler import compile_space
from resgrid.core.drive_checks import why_undriven
from resgrid.core.netlist import Netlist
from resgrid.core.regions import crossed_faces
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring
from resgrid.errors import CircuitError, InputError
from resgrid.hardware.e_series import nearest_e96
from resgrid.hardware.record import GROUND

Kind = Literal["fixed", "jumpers"]

MOST_CELLS = 64
"""Largest number of cells along an axis of a board; larger spaces are rejected."""

RESISTORS = (1.0, 10e6)
"""Lowest and highest resistance sold in size 0603, in ohms; boards with other resistances are rejected."""

MOST_HEAT = 0.1
"""Rated power of a resistor of size 0603, in watts; a board in which a resistor dissipates more is rejected."""

OBSTACLE_NET, GOAL_NET = "obstacle", "goal"
"""Names of the net of the obstacle rail, and of the net of the goal rail on a board with jumpers."""


@dataclass(frozen=True)
class GridResistor:
    """A resistor between two neighbouring cells, or between a cell and the border of the grid.

    `reference`: name on the board, such as R7; `ohms`: resistance in ohms; `lower`, `upper`: nets of the terminals at
    the lower and the higher coordinate along the axis; `axis`: 0 for a horizontal, 1 for a vertical resistor; `cell`:
    cell (column from the left, row from the bottom) at the higher coordinate, outside the grid for a resistor at the
    right or upper border.
    """

    reference: str
    ohms: float
    lower: str
    upper: str
    axis: int
    cell: tuple[int, int]

    @property
    def ends(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Cells (column, row) at the end of lower and the end of higher coordinate; one may lie outside the grid."""
        i, j = self.cell
        return ((i - 1, j), (i, j)) if self.axis == 0 else ((i, j - 1), (i, j))


@dataclass(frozen=True, eq=False)
class BoardCircuit:
    """The circuit of a board.

    `kind`: "fixed" for one scene, "jumpers" for every scene of this size; `ideal`: the compiled circuit with exact
    resistances; `op`: operating point of the circuit with resistances of the E96 series.
    """

    kind: Kind
    ideal: Netlist
    op: OperatingPoint

    @property
    def netlist(self) -> Netlist:
        """The circuit with resistances of the E96 series."""
        return self.op.netlist

    @cached_property
    def cells_netlist(self) -> Netlist:
        """The circuit of the board with one node for every cell, also for obstacle and goal cells.

        Its resistances are of the E96 series, too. Studies of robots that read the voltages of all cells use this
        circuit.
        """
        ideal = self.ideal
        if self.wiring.rails != "cells":
            ideal = compile_space(self.space, self.wiring, rails="cells")
        return ideal.replace(conductance=1.0 / nearest_e96(1.0 / ideal.conductance))

    @property
    def space(self) -> ConfigurationSpace:
        """The configuration space whose circuit the board realises."""
        return self.netlist.cells.space

    @property
    def wiring(self) -> Wiring:
        """Boundary conditions, supply and nominal resistance of the circuit."""
        return self.netlist.cells.wiring

    @cached_property
    def node_nets(self) -> list[str]:
        """Name of the net of every node, in the order of the nodes of `netlist`."""
        return self.netlist.names_of(np.arange(self.netlist.node_count))

    @property
    def high_net(self) -> str:
        """Name of the net at the positive supply: the obstacle rail, or with drive "start" the net of the start cell.

        The copper plane of the board belongs to this net.
        """
        start = self.wiring.start
        return OBSTACLE_NET if start is None else "n_{}_{}".format(*start)

    @property
    def goal_nets(self) -> tuple[str, ...]:
        """Names of the nets of the goal rails: one per goal region, or the common rail of a board with jumpers."""
        return (GOAL_NET,) if self.kind == "jumpers" else tuple(f"goal_{goal}" for goal in range(self.space.goal_count))

    @cached_property
    def resistors(self) -> tuple[GridResistor, ...]:
        """All resistors, named R1, R2, ... in their order: row by row from the top of the grid, each row from the left.

        The vertical resistors between two rows of cells form a row of their own.
        """
        cells = self.netlist.cells
        axes, index = crossed_faces(cells.resistor_face, self.space.shape)
        nodes = np.where(
            cells.resistor_upward[:, np.newaxis], self.netlist.resistor_nodes, self.netlist.resistor_nodes[:, ::-1]
        )
        centre = index - 0.5 * (np.arange(2) == axes[:, np.newaxis])
        nets = self.node_nets
        order = np.lexsort((centre[:, 0], -centre[:, 1]))
        return tuple(
            GridResistor(
                f"R{number}",
                float(ohms),
                nets[nodes[at, 0]],
                nets[nodes[at, 1]],
                int(axes[at]),
                (int(index[at, 0]), int(index[at, 1])),
            )
            for number, (at, ohms) in enumerate(zip(order, self.ohms[order], strict=True), start=1)
        )

    @cached_property
    def ohms(self) -> NDArray[np.float64]:
        """E96 resistance of every resistor, in ohms, shape (resistors,), in the order of the resistors of `netlist`."""
        return nearest_e96(1.0 / self.ideal.conductance)

    @property
    def largest_deviation(self) -> float:
        """Largest absolute deviation of a resistor's E96 value from the compiled resistance, relative to the latter."""
        return float(np.abs(self.ohms * self.ideal.conductance - 1.0).max(initial=0.0))

    @cached_property
    def cell_nets(self) -> dict[tuple[int, int], str]:
        """Name of the net of every cell with a test pad, by the cell (column, row).

        These are the free cells and goal cells with a node; on a board with jumpers, all cells. Row 0 is at the bottom.
        """
        node = self.netlist.cells.node
        wanted = (node >= 0) & ((self.space.cell != Cell.OBSTACLE) | (self.kind == "jumpers"))
        return {(int(i), int(j)): self.node_nets[node[i, j]] for i, j in np.argwhere(wanted)}

    @cached_property
    def voltages(self) -> dict[str, float]:
        """Expected voltage of every net on the board against ground, in volts, by the name of the net.

        Nets on the board are those with a resistor, the net of the supply, the goal rails and ground.
        """
        used = {net for part in self.resistors for net in (part.lower, part.upper)}
        volts = {net: float(self.op.voltage[node]) for node, net in enumerate(self.node_nets) if net in used}
        volts |= dict.fromkeys(self.goal_nets, self.wiring.goal_voltage)
        return volts | {self.high_net: self.wiring.high, GROUND: 0.0}

    @property
    def power(self) -> float:
        """Power that the supply delivers, in watts."""
        return float(self.op.power)

    @property
    def supply_current(self) -> float:
        """Current from the positive supply, in amperes."""
        return self.power / self.wiring.supply

    @property
    def hottest(self) -> float:
        """Largest power that one resistor dissipates, in watts."""
        across = self.op.voltage[self.netlist.resistor_nodes] @ [1.0, -1.0]
        return float(np.nanmax(across**2 * self.netlist.conductance, initial=0.0))

    @property
    def goal_currents(self) -> dict[str, float]:
        """Current into every goal region, in amperes, by the region's name ``goal_0``, ``goal_1`` ...

        A positive current flows from the grid into the region.
        """
        pairs, current = self.netlist.resistor_nodes, self.op.resistor_current
        total = dict[str, float]()
        region_of = np.full(self.netlist.node_count, -1)
        goal = self.space.cell == Cell.GOAL
        region_of[self.netlist.cells.node[goal]] = self.space.goal_region[goal]
        for region in range(self.space.goal_count):
            into = current[region_of[pairs[:, 1]] == region].sum() - current[region_of[pairs[:, 0]] == region].sum()
            total[f"goal_{region}"] = float(into)
        return total


def board_circuit(space: ConfigurationSpace, kind: Kind, wiring: Wiring) -> BoardCircuit:
    """Return the circuit of a board; raise InputError for spaces and wirings that a board cannot realise.

    `space`: the space whose resistor grid the board realises; `kind`: "fixed" for one scene, "jumpers" for every scene
    of this size; `wiring`: boundary conditions, resistance and supply. Raises CircuitError if no current flows.
    """
    for problem in _problems(space, kind, wiring):
        raise InputError(problem)
    if (why := why_undriven(space, wiring)) is not None:
        raise CircuitError(why)
    ideal = compile_space(space, wiring, rails="cells" if kind == "jumpers" else "merged")
    rounded = nearest_e96(1.0 / ideal.conductance)
    low, high = RESISTORS
    if (outside := rounded[(rounded < low) | (rounded > high)]).size:
        raise InputError(
            f"a resistor has {outside[0]:g} ohm, and resistors of size 0603 are sold from {low:g} ohm to {high:g} ohm; "
            "choose another --resistance, such as 10k"
        )
    circuit = BoardCircuit(kind, ideal, solve(ideal.replace(conductance=1.0 / rounded)))
    if circuit.hottest > MOST_HEAT:
        raise InputError(
            f"one resistor would dissipate {circuit.hottest:.2g} W, and resistors of size 0603 withstand "
            f"{MOST_HEAT:g} W; choose a larger --resistance or a lower --set chip.supply"
        )
    return circuit


def _problems(space: ConfigurationSpace, kind: Kind, wiring: Wiring) -> Iterator[str]:
    """Yield a message for every property of a space or wiring that a board cannot realise."""
    if space.ndim != 2:
        yield (
            f"the space has {space.ndim} axes, but the resistors of a board lie in a plane: choose a scene with "
            "2 axes, or take one slice of the space"
        )
        return
    if max(space.shape) > MOST_CELLS or min(space.shape) < 3:
        size = " x ".join(map(str, space.shape))
        yield (
            f"a board has 3 to {MOST_CELLS} cells along each axis, but the space has {size}; choose other cells with "
            "--set grid.cells=16 (or grid.axes.0.cells and grid.axes.1.cells), or --coarsen for a map"
        )
    if space.periodic.any():
        name = space.axes[int(np.argmax(space.periodic))].name
        yield (
            f"axis {name!r} is periodic, but a board has two ends along every axis; make the axis not periodic "
            "(periodic = false), so that the board has a border there"
        )
    if wiring.drive == "uniform":
        count = int((space.goal_connected & (space.cell == Cell.FREE)).sum())
        yield (
            f"drive = 'uniform' needs {count} current sources, one for each free cell, and a board has only resistors; "
            "choose --drive start with one --start X,Y (the start is at the supply), or --boundary dirichlet"
        )
    if wiring.leak:
        yield (
            f"leak = {wiring.leak:g} adds a resistor from every free cell to the obstacle rail, for which a board has "
            "no place; set leak = 0, or write a deck with 'resgrid compile'"
        )
    if wiring.supply < 0:
        yield f"supply = {wiring.supply:g} V, but the rail of the obstacles is positive; give a supply above 0 V"
    if wiring.goal_voltage != 0:
        yield f"goal_voltage = {wiring.goal_voltage:g} V, but the goal rail of a board is its ground; leave it out"
    if kind == "jumpers":
        yield from _problems_of_jumpers(space, wiring)


def _problems_of_jumpers(space: ConfigurationSpace, wiring: Wiring) -> Iterator[str]:
    """Yield a message for every property of a space or wiring that a board with jumpers cannot realise.

    Such a board has the same resistors for every scene.
    """
    if wiring.boundary != "dirichlet":
        yield (
            f"boundary = {wiring.boundary!r} changes the resistors around obstacles, but a board with jumpers has the "
            "same resistors for every scene; choose --kind fixed, or --boundary dirichlet"
        )
    if space.conductivity is not None and np.ptp(space.conductivity) > 0:
        yield (
            "the scene has areas of other conductivity, but a board with jumpers has the same resistors for every "
            "scene; choose --kind fixed, or remove [[area]]"
        )
