"""Grids that are still settling while a robot follows them (Connolly & Grupen 1992, section 7).

A change of the map sets the rails of some cells at once; everything else follows as a wavefront.  Two ways are
emulated: the paper's digital relaxation, a number of sweeps over the grid per control step, and the chip itself, with a
capacitor at every node, by implicit steps in time.  A step of the chip is what passes between two readings of it,
`TICK` of a cell: 2 R C at the default pace.  Backward Euler is of first order in it, and late: what decays as
``exp(-t / tau)`` takes ``step / (2 tau)`` longer.  At that pace potentials are off by some 2 % of the supply at the
first reading and 0.4 % at the fourth; between readings the robot sees the last one.

Voltages are counted from the obstacle rail (Dirichlet, walls) or from the goal rail (Neumann).  The right-hand sides
then hold no negative number, and neither a Jacobi sweep nor a backward Euler step subtracts: a voltage keeps its
relative accuracy far from the goals, and lies between those of the rails at every moment.  Over-relaxation overshoots;
it is held at the rail (projected SOR).  So no current ever runs into an obstacle, however far the grid is from settled,
and a robot that follows the current meets none that is on the map.  But until it has settled there may be local minima:
cells that no current leaves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.circuit.dynamics import Dynamics, dynamics_of, factor_resolvent
from resgrid.circuit.transients import Solver, transient_stepper
from resgrid.core.compiler import compile_space
from resgrid.core.netlist import GROUND, Netlist, add_elements
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring
from resgrid.errors import InputError
from resgrid.planning.blend import blend
from resgrid.planning.fields import Field, read_field

TICK = 0.2
"""How often a chip is read: every time a robot at its nominal speed has crossed this share of a cell."""

_OMEGA = 1.8
"""Factor of over-relaxation."""

_SETTLED = 1e-6
"""Largest relative distance of a voltage from its end at which the grid counts as settled for good."""

_DIRECT = 100_000
"""Unknowns up to which factors fit in memory and cache."""

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Relaxation:
    """How a grid settles, and how fast compared to the robot.

    `method`: ``"jacobi"`` sweeps, ``"sor"`` for sweeps of successive over-relaxation, or the transient of a ``"chip"``
    with a capacitor at every node; `pace`: sweeps, or for a chip units ``R C`` of time (of one resistor and one
    capacitor), while the robot at its nominal speed crosses one cell; `patience`: how long the robot stands still
    before it gives up: in cells that it might have crossed.
    """

    method: str = "chip"
    pace: float = 10.0
    patience: float = 40.0


class RelaxingGrid:
    """The voltages of a map that has changed, on their way from the old operating point to the new one.

    `before`: the field that the grid had settled to; it says how the grid is wired and blended.
    """

    def __init__(self, relaxation: Relaxation, before: Field) -> None:
        self.relaxation, self.before = relaxation, before
        halves = (before.wiring, before.wiring.opened()) if before.boundary == "blend" else (before.wiring,)
        self._parts = [_Part(relaxation, wiring, before.space) for wiring in halves]
        self._owed = 0.0

    def change(self, space: ConfigurationSpace) -> None:
        """Put another map on the rails; all other nodes keep their voltages."""
        before = self.before.space
        if before.axes != space.axes or before.frame != space.frame:
            raise InputError(
                f"the map had {before.shape} cells and now has {space.shape}: one grid settles, give one grid"
            )
        vars(self).pop("_end", None)
        self._parts = [_Part(self.relaxation, part.wiring, space, part.per_cell()) for part in self._parts]

    def advance(self, cells: float) -> bool:
        """Let it settle while the robot could cross so many cells; whether anything was due."""
        self._owed += cells * (self.relaxation.pace if self.relaxation.method != "chip" else 1.0 / TICK)
        due = int(self._owed * (1 + 1e-12))
        self._owed -= due
        moved = False
        for part in self._parts:
            moved |= part.advance(due)
        return moved

    @property
    def settled(self) -> bool:
        """Whether every voltage is at its end."""
        return all(part.settled for part in self._parts)

    @property
    def distance(self) -> float:
        """Largest distance of a potential, as a field shows it, from its end."""
        apart = np.abs(self.field.potential - self._end.potential)
        return float(np.nanmax(apart, initial=0.0))

    @property
    def field(self) -> Field:
        """What the grid shows now: not direction-safe until it has settled."""
        return self._shown([part.voltage for part in self._parts])

    @cached_property
    def _end(self) -> Field:
        return self._shown([part.end_voltage for part in self._parts])

    def _shown(self, voltages: list[Vector]) -> Field:
        fields = [field_now(part.netlist, volts) for part, volts in zip(self._parts, voltages, strict=True)]
        return fields[0] if len(fields) == 1 else blend(fields[0], fields[1], self.before.k)


class _Part:
    """One chip while it settles: at its end, or from the voltages of cells before."""

    def __init__(
        self, relaxation: Relaxation, wiring: Wiring, space: ConfigurationSpace, cells: Vector | None = None
    ) -> None:
        self.wiring, self.netlist = wiring, _compiled(wiring, space)
        self._dynamics = dynamics_of(self.netlist)
        drive = self._dynamics.drive
        solver: Solver = "direct" if self._dynamics.size <= _DIRECT else "auto"
        self._end = factor_resolvent(self._dynamics, 0.0, solver).solve(drive, rtol=1e-12) if len(drive) else drive
        self._step = _stepping(self._dynamics, relaxation, solver)
        self.settled = cells is None
        self._x = self._end.copy()
        if cells is not None:
            node, volts = self.netlist.cells.node, np.zeros(self.netlist.node_count)
            volts[node[node >= 0]] = np.nan_to_num(cells[node >= 0])
            self._x = self._dynamics.state(volts)

    @property
    def voltage(self) -> Vector:
        """Node voltages, in volts; NaN where a node floats."""
        return self._dynamics.voltage(self._x)

    @property
    def end_voltage(self) -> Vector:
        """Node voltages once it has settled."""
        return self._dynamics.voltage(self._end)

    def per_cell(self) -> Vector:
        """Voltage of every cell, NaN where there is none."""
        node = self.netlist.cells.node
        return np.where(node >= 0, self.voltage[node], np.nan)

    def advance(self, count: int) -> bool:
        """Make so many steps, unless it has settled; whether any was made."""
        if self.settled or not count:
            return False
        self._x = self._step(self._x, count)
        self.settled = bool(np.all(np.abs(self._x - self._end) <= _SETTLED * np.abs(self._end)))
        if self.settled:
            self._x = self._end.copy()
        return True


def _stepping(dynamics: Dynamics, relaxation: Relaxation, solver: Solver) -> Callable[[Vector, int], Vector]:
    """Many sweeps, or the chip for many ticks, as a function from state to state."""
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
    """A chip of 1 ohm and 1 farad, so that time counts in ``R C``, with its reference rail at 0 V."""
    supply, goal = (1.0, 0.0) if wiring.is_driven else (-1.0, 1.0)
    wall = None if wiring.wall_resistance is None else wiring.wall_resistance / wiring.resistance
    unit = replace(wiring, resistance=1.0, supply=supply, goal_voltage=goal, wall_resistance=wall)
    netlist = compile_space(space, unit)
    free = netlist.cells.free_node
    pairs = np.stack([free, np.full_like(free, GROUND)], axis=1)
    return add_elements(netlist, "capacitor", pairs, 1.0)


def field_now(netlist: Netlist, voltage: Vector) -> Field:
    """Read a field off voltages that need not be those of an operating point.  Shapes: `voltage` (nodes,)."""
    cells = netlist.cells
    height = voltage - cells.wiring.goal_voltage
    volts = cells.wiring.supply if cells.wiring.drive != "uniform" else float(np.nanmax(height, initial=0.0)) or 1.0
    a, b = netlist.resistor_nodes.T
    drop = np.nan_to_num(voltage[a] - voltage[b])
    with np.errstate(divide="ignore"):
        log_amps = np.log(np.abs(drop)) + np.log(netlist.conductance)
    resistors = (cells.resistor_face, cells.resistor_upward, np.sign(drop).astype(np.int8), log_amps)
    return read_field(cells, volts, height / volts, None, resistors)
