"""Grids that are still settling while a robot follows them (Connolly & Grupen 1992, section 7).

A change of the map changes the rail connections of some cells at once; all other voltages follow as a wavefront.  Two
mechanisms are emulated: the digital relaxation of the paper, with a number of sweeps over the grid per control step,
and the chip, with a capacitor at every node, by implicit time steps.  One time step of the chip is the time between two
readings of its voltages, in which a robot at nominal speed crosses `TICK` (0.2) of a cell; this is 2 R C at the default
pace, with the resistance R of one resistor and the capacitance C of one node.  Backward Euler is of first order, and
late: a mode that decays as ``exp(-t / tau)`` takes ``step / (2 tau)`` longer, as a fraction of its time.  At the
default pace the error of potentials is about 2 % of the supply at the first reading and 0.4 % at the fourth.  Between
readings the robot sees the last reading.

Voltages are measured from the obstacle rail (Dirichlet, walls, leaks) or from the goal rail (other Neumann circuits).
The right-hand side is then nonnegative, and neither a Jacobi sweep nor a backward Euler step contains a subtraction.
Therefore a voltage keeps its relative accuracy far from the goals, and lies between those of the rails at all times.
Over-relaxation may overshoot and is clipped at the rail (projected SOR).  Hence no current ever flows into an obstacle,
however far the grid is from settled, and a robot that follows the current avoids all obstacles of the map.  Before the
grid has settled, cells without outward current (local minima) may exist.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.circuit.dynamics import Dynamics, dynamics_of, factor_resolvent
from resgrid.circuit.transients.linear import Solver, transient_stepper
from resgrid.core.compiler import compile_space
from resgrid.core.netlist import GROUND, Netlist, add_elements
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring
from resgrid.errors import InputError
from resgrid.planning.blend import blend
from resgrid.planning.fields import Field, read_field

TICK = 0.2
"""Time between two readings of a chip, as the distance in cells that a robot at nominal speed covers in this time."""

_OMEGA = 1.8
"""Relaxation factor of successive over-relaxation, a number between 1 and 2."""

_SETTLED = 1e-6
"""Largest difference of a voltage from its final value at which it counts as settled, as a fraction of the final value.
"""

_DIRECT = 100_000
"""Largest number of unknowns (circuit nodes without a source) for the direct solver.

Larger circuits use the solver "auto".
"""

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Relaxation:
    """Mechanism and speed of the settling of a grid after a change of the map.

    `method`: ``"jacobi"`` (Jacobi sweeps), ``"sor"`` (sweeps of successive over-relaxation), or ``"chip"`` (the
    transient with a capacitor at every node); `pace`: number of sweeps or, for a chip, of time units ``R C`` (one
    resistor times one capacitor) in which the robot at nominal speed crosses one cell; `patience`: time that the robot
    waits for an outward current before the run ends, as the number of cells that it could have crossed.
    """

    method: str = "chip"
    pace: float = 10.0
    patience: float = 40.0


class RelaxingGrid:
    """Voltages of a grid during the transition from the operating point of an old map to that of a new map.

    `relaxation`: mechanism and speed of settling; `before`: the field of the old map after settling; its wiring and
    Dirichlet weight k also apply to the new map.
    """

    def __init__(self, relaxation: Relaxation, before: Field) -> None:
        self.relaxation, self.before = relaxation, before
        halves = (before.wiring, before.wiring.opened()) if before.boundary == "blend" else (before.wiring,)
        self._parts = [_SettlingCircuit(relaxation, wiring, before.space) for wiring in halves]
        self._pending = 0.0

    def change(self, space: ConfigurationSpace) -> None:
        """Connect the rails according to another map; the voltages of all other nodes do not change.

        `space`: the new map, with the axes of the old one.  Raises InputError for other axes.
        """
        before = self.before.space
        if before.axes != space.axes or before.frame != space.frame:
            raise InputError(
                f"the map had {before.shape} cells and now has {space.shape}: give one grid, with the same axes"
            )
        vars(self).pop("_final", None)
        self._parts = [_SettlingCircuit(self.relaxation, part.wiring, space, part.per_cell()) for part in self._parts]

    def advance(self, cells: float) -> bool:
        """Continue settling for the time in which the robot at nominal speed crosses a number of cells.

        Returns whether voltages changed: False if no whole sweep or time step was due, or the grid has settled. A
        remaining fraction of a sweep or step counts in the next call. `cells`: number of cells, which need not be
        whole.
        """
        self._pending += cells * (self.relaxation.pace if self.relaxation.method != "chip" else 1.0 / TICK)
        due = int(self._pending * (1 + 1e-12))
        self._pending -= due
        moved = False
        for part in self._parts:
            moved |= part.advance(due)
        return moved

    @property
    def settled(self) -> bool:
        """Whether every voltage has reached its final value, with a relative tolerance of 1e-6."""
        return all(part.settled for part in self._parts)

    @property
    def distance(self) -> float:
        """Largest difference, over all cells, of the normalised potential (0 to 1) from its value after settling."""
        apart = np.abs(self.field.potential - self._final.potential)
        return float(np.nanmax(apart, initial=0.0))

    @property
    def field(self) -> Field:
        """The field of the present voltages; it is direction-safe only after settling."""
        return self._shown([part.voltage for part in self._parts])

    @cached_property
    def _final(self) -> Field:
        """The field of the voltages after settling."""
        return self._shown([part.final_voltage for part in self._parts])

    def _shown(self, voltages: list[Vector]) -> Field:
        """Return the field of node voltages; for a blend, combine the Dirichlet and the Neumann field.

        `voltages`: node voltages of each circuit, shape (nodes,), in volts; a blend has two circuits (Dirichlet, then
        Neumann), other fields have one.
        """
        fields = [field_now(part.netlist, volts) for part, volts in zip(self._parts, voltages, strict=True)]
        return fields[0] if len(fields) == 1 else blend(fields[0], fields[1], self.before.k)


class _SettlingCircuit:
    """One circuit during its transition to the operating point.

    The resistances are scaled to 1 ohm and the rails to 0 V and 1 V. `relaxation`: mechanism and speed of settling;
    `wiring`: rules that turn the space into a circuit; `space`: the map; `cells`: voltages of the cells at the start
    (shape of the space, in volts; NaN for unknown, which starts at 0 V), or None to start at the operating point.
    """

    def __init__(
        self, relaxation: Relaxation, wiring: Wiring, space: ConfigurationSpace, cells: Vector | None = None
    ) -> None:
        self.wiring, self.netlist = wiring, _compiled(wiring, space)
        self._dynamics = dynamics_of(self.netlist)
        drive = self._dynamics.drive
        solver: Solver = "direct" if self._dynamics.size <= _DIRECT else "auto"
        self._final = factor_resolvent(self._dynamics, 0.0, solver).solve(drive, rtol=1e-12) if len(drive) else drive
        self._step = _stepping(self._dynamics, relaxation, solver)
        self.settled = cells is None
        self._x = self._final.copy()
        if cells is not None:
            node, volts = self.netlist.cells.node, np.zeros(self.netlist.node_count)
            volts[node[node >= 0]] = np.nan_to_num(cells[node >= 0])
            self._x = self._dynamics.state(volts)

    @property
    def voltage(self) -> Vector:
        """Node voltages, shape (nodes,), in volts; NaN where a node floats."""
        return self._dynamics.voltage(self._x)

    @property
    def final_voltage(self) -> Vector:
        """Node voltages after settling, shape (nodes,), in volts; NaN where a node floats."""
        return self._dynamics.voltage(self._final)

    def per_cell(self) -> Vector:
        """Return the voltage of every cell, shape of the space, in volts; NaN for cells without a node."""
        node = self.netlist.cells.node
        return np.where(node >= 0, self.voltage[node], np.nan)

    def advance(self, count: int) -> bool:
        """Take `count` sweeps or time steps unless the circuit has settled; return whether steps were taken."""
        if self.settled or not count:
            return False
        self._x = self._step(self._x, count)
        self.settled = bool(np.all(np.abs(self._x - self._final) <= _SETTLED * np.abs(self._final)))
        if self.settled:
            self._x = self._final.copy()
        return True


def _stepping(dynamics: Dynamics, relaxation: Relaxation, solver: Solver) -> Callable[[Vector, int], Vector]:
    """Return a function ``(x, count)`` that returns the state after `count` sweeps, or time steps of a chip.

    A state ``x`` (n,) contains the voltages of the nodes without a source, in volts.  `dynamics`: circuit equations;
    `relaxation`: mechanism (sweeps or chip) and speed; `solver`: method of the time steps, ``"auto"``, ``"direct"`` or
    ``"multigrid"``.
    """
    if relaxation.method == "chip":
        stepper = transient_stepper(dynamics.netlist, relaxation.pace * TICK, method="backward_euler", solver=solver)

        def charged(x: Vector, count: int) -> Vector:
            volts = dynamics.voltage(x)
            for _ in range(count):
                volts = stepper.advance(volts)
            return dynamics.state(volts)

        return charged
    from resgrid.control import kernels

    matrix = sparse.csr_array(dynamics.conductance.edges)
    rows = (matrix.indptr, matrix.indices, matrix.data, dynamics.conductance.diagonal, dynamics.drive)
    omega = 0.0 if relaxation.method == "jacobi" else _OMEGA

    def relaxed(x: Vector, count: int) -> Vector:
        after, spare = x.copy(), np.empty_like(x)
        kernels.relax(*rows, omega, count, after, spare)
        return after

    return relaxed


def _compiled(wiring: Wiring, space: ConfigurationSpace) -> Netlist:
    """Return a netlist with resistors of 1 ohm, and 1 farad from each free node to ground: the time unit is ``R C``.

    The obstacle rail has 0 V and the goal rail 1 V; in a circuit with a drive the goal rail has 0 V.  `wiring`: rules
    that turn the space into a circuit; `space`: the map.
    """
    supply, goal = (1.0, 0.0) if wiring.is_driven else (-1.0, 1.0)
    wall = None if wiring.wall_resistance is None else wiring.wall_resistance / wiring.resistance
    unit = replace(wiring, resistance=1.0, supply=supply, goal_voltage=goal, wall_resistance=wall)
    netlist = compile_space(space, unit)
    free = netlist.cells.free_node
    pairs = np.stack([free, np.full_like(free, GROUND)], axis=1)
    return add_elements(netlist, "capacitor", pairs, 1.0)


def field_now(netlist: Netlist, voltage: Vector) -> Field:
    """Return the field (potentials and face currents) of node voltages that need not satisfy Kirchhoff's current law.

    With a uniform drive the potential is scaled to a maximum of 1. `netlist`: compiled netlist with cells; `voltage`
    (nodes,): node voltages, in volts.
    """
    cells = netlist.cells
    height = voltage - cells.wiring.goal_voltage
    volts = cells.wiring.supply if cells.wiring.drive != "uniform" else float(np.nanmax(height, initial=0.0)) or 1.0
    a, b = netlist.resistor_nodes.T
    drop = np.nan_to_num(voltage[a] - voltage[b])
    with np.errstate(divide="ignore"):
        log_amps = np.log(np.abs(drop)) + np.log(netlist.conductance)
    resistors = (cells.resistor_face, cells.resistor_upward, np.sign(drop).astype(np.int8), log_amps)
    return read_field(cells, volts, height / volts, None, resistors)
