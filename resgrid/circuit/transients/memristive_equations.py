"""Equations of a circuit with memristors, ``C v' = F(v, x, t)``, ``x' = H(v, x, t)``, and their linearization.

``v`` are the voltages of the rows (unknown voltages, as in `resgrid.circuit.dynamics`), ``x`` the coordinates of the
states (`resgrid.circuit.transients.state_coordinates`).  ``F`` is the current that charges every row, and
``H = k i phi(x)`` the drift.  ``C`` is singular: a row without capacitance is an algebraic equation.  All sources have
the same waveform ``w(t)``, so that the voltage across an element is ``u = A v + w lift``, with the incidence matrix
``A`` and the voltages ``lift`` between the rails.

A step of a Rosenbrock method solves with ``(M / (gamma h) - J)``.  The block of the states is diagonal and is
eliminated.  The remaining matrix has the pattern of a nodal matrix, in which the conductance of a memristor is larger
or smaller by its response to its own voltage within the step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.dynamics import Dynamics, dynamics_of
from resgrid.circuit.equations import across, injected_into_rows
from resgrid.circuit.transients.memristors import MemristiveCircuit
from resgrid.circuit.transients.stamps import Solve, Stamps, Vector
from resgrid.circuit.transients.state_coordinates import Coordinates
from resgrid.circuit.transients.waveforms import Drive


class Point(NamedTuple):
    """Unknowns of the equations.

    `voltage` (n,): voltages of the rows, in volts; `state` (m,): coordinates of the states of the memristors (the state
    itself, or its logit for the Joglekar window); `charge` (m,): charges that have passed the memristors, in coulombs;
    `heat` (m,): energies that the memristors have dissipated, in joules.
    """

    voltage: Vector
    state: Vector
    charge: Vector
    heat: Vector

    def joined(self) -> Vector:
        """Return all unknowns as one array, (n + 3 m,)."""
        return np.concatenate(self)

    def like(self, joined: Vector) -> Point:
        """Return the point with the unknowns of an array (n + 3 m,), as `joined` returns it."""
        n, m = len(self.voltage), len(self.state)
        return Point(joined[:n], joined[n : n + m], joined[n + m : n + 2 * m], joined[n + 2 * m :])


@dataclass(frozen=True, eq=False)
class MemristiveEquations:
    """Equations of a circuit with memristors.

    `circuit`: the circuit; `coordinates`: coordinates of its states; `dynamics`: rows of the circuit in the states at
    time 0; `resistors`, `capacitors`, `both`: positions of the resistors, of the capacitors, and of resistors and then
    capacitors in the equations; `groups`: positions of the resistors in the equations of the rows without capacitance;
    `group` (n,): equation of such a row, or group of rows, -1 for others; `lift` (resistors,): voltages between rails
    across the resistors, in volts; `charging` (n,): charge of every row at 0 V on the capacitors to the rails, in
    coulombs; `injected` (n,): current of the current sources into every row, in amperes; the last three for the value 1
    of the waveform.
    """

    circuit: MemristiveCircuit
    coordinates: Coordinates
    dynamics: Dynamics
    resistors: Stamps
    capacitors: Stamps
    both: Stamps
    groups: Stamps
    group: NDArray[np.int64]
    lift: Vector
    charging: Vector
    injected: Vector

    @classmethod
    def of(cls, circuit: MemristiveCircuit) -> MemristiveEquations:
        """Return the equations of a circuit; raise CircuitError for contradictory sources."""
        netlist, dynamics = circuit.netlist, dynamics_of(circuit.netlist)
        row, size, free = dynamics.row, dynamics.size, dynamics.null_space.tocoo()
        group = np.full(size + 1, -1, dtype=np.int64)  # the last entry belongs to nodes without a row
        group[free.coords[0]] = free.coords[1]
        capacitors = Stamps.of(row[netlist.capacitor_nodes], size)
        return cls(
            circuit=circuit,
            coordinates=Coordinates.of(circuit.law),
            dynamics=dynamics,
            resistors=Stamps.of(row[netlist.resistor_nodes], size),
            capacitors=capacitors,
            both=Stamps.of(row[np.concatenate([netlist.resistor_nodes, netlist.capacitor_nodes])], size),
            groups=Stamps.of(group[row[netlist.resistor_nodes]].astype(np.int32), free.shape[1]),
            group=group[:size],
            lift=across(dynamics.fixed, netlist.resistor_nodes),
            charging=capacitors.out_of(netlist.capacitance * across(dynamics.fixed, netlist.capacitor_nodes)),
            injected=np.array(injected_into_rows(netlist, row, size), dtype=np.float64),
        )

    def drops(self, voltage: Vector, drive: float) -> Vector:
        """Return the voltages across all resistors (first node minus second), in volts, (resistors,).

        `voltage` (n,): voltages of the rows in volts; `drive`: value of the waveform.
        """
        return np.asarray(self.resistors.across(voltage) + drive * self.lift)

    def conductance(self, state: Vector) -> Vector:
        """Return the conductances of all resistors, (resistors,) in siemens; `state` (m,): coordinates of states."""
        siemens = self.circuit.netlist.conductance.copy()
        law, x = self.circuit.law, self.coordinates.to_state(state)
        siemens[self.circuit.memristors] = 1 / (law.off_resistance - (law.off_resistance - law.on_resistance) * x)
        return siemens

    def currents(self, at: Point, drive: float) -> Vector:
        """Return the currents of the memristors from the first to the second node, in amperes, (m,).

        `at`: the unknowns; `drive`: value of the waveform.
        """
        return np.asarray((self.conductance(at.state) * self.drops(at.voltage, drive))[self.circuit.memristors])

    def at_nodes(self, voltage: Vector, drive: float) -> Vector:
        """Return the node voltages in volts, (nodes,).

        `voltage` (n,): voltages of rows; `drive`: value of the waveform.
        """
        return np.asarray(drive * self.dynamics.fixed + np.append(voltage, 0.0)[self.dynamics.row])

    def by_state(self, siemens: Vector, drop: Vector, state: Vector) -> Vector:
        """Return the derivatives of memristor currents with respect to the coordinates of states, in amperes, (m,).

        `siemens`, `drop`, `state` (m,): conductances of the memristors, voltages across them in volts, coordinates.
        """
        law = self.circuit.law
        change = (law.off_resistance - law.on_resistance) * self.coordinates.state_slope(state)
        return np.asarray(change * siemens**2 * drop)

    def speed(self, moving: Vector) -> Vector:
        """Return the drift per ampere where the factor ``phi`` of the window is 1, in 1/C, (m,).

        The drift is the time derivative of the coordinate of a state.  The result has the sign of the polarity.
        `moving` (m,): 0 for states at a limit, else 1.
        """
        return self.circuit.law.rate * self.circuit.polarity * moving

    def slope(self, at: Point, drive: Drive, moving: Vector) -> Point:
        """Return the right-hand sides of the equations as a point.

        `voltage` has the currents into the rows, in amperes; `state` the time derivatives of the coordinates, in 1/s;
        `charge` the current and `heat` the power of every memristor, in amperes and watts.  `at`: the unknowns;
        `drive`: the waveform; `moving` (m,): 1 for a memristor whose state can change, 0 at a limit.
        """
        siemens, drop = self.conductance(at.state), self.drops(at.voltage, drive.value)
        amps = siemens * drop
        into = drive.value * self.injected - self.resistors.out_of(amps) - drive.slope * self.charging
        own = amps[self.circuit.memristors]
        drift = self.speed(moving) * own * self.coordinates.mobility(at.state)
        return Point(into, drift, own, own * drop[self.circuit.memristors])

    def time_derivative(self, at: Point, drive: Drive, moving: Vector) -> Point:
        """Return the partial derivatives of the right-hand sides with respect to time, as a point.

        The right-hand sides are the currents into the rows, the time derivatives of the coordinates of states, and
        currents and powers of the memristors.  `at`: the unknowns; `drive`: the waveform; `moving` (m,): 1 for a
        memristor whose state can change, 0 at a limit.
        """
        amps = self.conductance(at.state) * (drive.slope * self.lift)
        own = amps[self.circuit.memristors]
        drop = self.drops(at.voltage, drive.value)[self.circuit.memristors]
        into = drive.slope * self.injected - self.resistors.out_of(amps)
        return Point(into, self.speed(moving) * own * self.coordinates.mobility(at.state), own, 2 * own * drop)

    def restore(self, at: Point, drive: float) -> Point:
        """Return the point with the voltages of rows without capacitance corrected to Kirchhoff's current law.

        `at`: the unknowns; `drive`: value of the waveform.
        """
        count = self.groups.size
        if not count:
            return at
        siemens = self.conductance(at.state)
        excess = drive * self.injected - self.resistors.out_of(siemens * self.drops(at.voltage, drive))
        free = self.group >= 0
        per_group = np.asarray(np.bincount(self.group[free], excess[free], count), dtype=np.float64)
        change = self.groups.factorized(siemens)(per_group)
        return at._replace(voltage=at.voltage + np.append(change, 0.0)[self.group])

    def growth(self, at: Point, drive: Drive, moving: Vector) -> Vector:
        """Return the derivative of each drift with respect to its own coordinate at constant voltages, in 1/s, (m,).

        A drift is the time derivative of the coordinate of a state.  `at`: the unknowns; `drive`: the waveform;
        `moving` (m,): 1 for a memristor whose state can change, 0 at a limit.
        """
        chosen = self.circuit.memristors
        own, drop = self.conductance(at.state)[chosen], self.drops(at.voltage, drive.value)[chosen]
        coordinates = self.coordinates
        by_current = self.by_state(own, drop, at.state) * coordinates.mobility(at.state)
        return self.speed(moving) * (by_current + own * drop * coordinates.mobility_slope(at.state))

    def largest_growth(self, at: Point, drive: Drive, moving: Vector) -> float:
        """Return the largest growth rate of a state at constant voltages, in 1/s; 0 if all states decay.

        `at`: the unknowns; `drive`: the waveform; `moving` (m,): 1 for a memristor whose state can change, 0 at a
        limit.
        """
        return float(np.max(self.growth(at, drive, moving), initial=0.0))


@dataclass(frozen=True, eq=False)
class StepMatrix:
    """Factors of ``M / (gamma h) - J`` at one point, for a step of length ``h`` of the Rosenbrock method.

    ``M`` contains ``C`` for the voltages and 1 for the states; ``J`` is the Jacobian matrix of the right-hand sides,
    and ``gamma`` a coefficient of the method.  `equations`: the equations; `rate`: ``1 / (gamma h)`` in 1/s;
    `by_voltage`, `by_state` (m,): derivatives of the current of a memristor with respect to its voltage (its
    conductance, in siemens) and to its state, in amperes; `drop` (m,): voltages across memristors, in volts; `response`
    (m,): derivative of the drift with respect to the voltage, in 1/(V s); `pivot` (m,): diagonal of the block of the
    states, in 1/s; `solve`: solver of the reduced matrix (n, n).
    """

    equations: MemristiveEquations
    rate: float
    by_voltage: Vector
    by_state: Vector
    drop: Vector
    response: Vector
    pivot: Vector
    solve: Solve

    @classmethod
    def at(cls, equations: MemristiveEquations, at: Point, drive: Drive, moving: Vector, rate: float) -> StepMatrix:
        """Return the factors of the matrix of a Rosenbrock step of length ``h``, linearized at a point.

        `at`: the unknowns; `drive`: the waveform; `moving` (m,): 1 for a memristor whose state can change, 0 at a
        limit; `rate`: ``1 / (gamma h)`` in 1/s.
        """
        chosen, netlist = equations.circuit.memristors, equations.circuit.netlist
        siemens = equations.conductance(at.state)
        own, drop = siemens[chosen], equations.drops(at.voltage, drive.value)[chosen]
        by_state = equations.by_state(own, drop, at.state)
        response = equations.speed(moving) * own * equations.coordinates.mobility(at.state)
        pivot = rate - equations.growth(at, drive, moving)
        siemens[chosen] += by_state * response / pivot
        solve = equations.both.factorized(np.concatenate([siemens, rate * netlist.capacitance]))
        return cls(equations, rate, own, by_state, drop, response, pivot, solve)

    def solved(self, right: Point) -> Point:
        """Return the solution of the linear system of a stage of the step for a right-hand side, as a point.

        `right`: right-hand side.  Charges and heat are included, although voltages and states do not depend on them.
        """
        resistors, chosen = self.equations.resistors, self.equations.circuit.memristors
        amps = np.zeros(len(resistors.first))
        amps[chosen] = self.by_state * right.state / self.pivot
        volts = self.solve(right.voltage - resistors.out_of(amps))
        drop = resistors.across(volts)[chosen]
        state = (right.state + self.response * drop) / self.pivot
        own = self.by_voltage * drop + self.by_state * state
        heat = right.heat + self.drop * (own + self.by_voltage * drop)
        return Point(volts, state, (right.charge + own) / self.rate, heat / self.rate)
