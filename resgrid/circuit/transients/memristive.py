"""The transient analysis of circuits with memristors: public function, and result with voltages and states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Lt
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.values import frozen
from resgrid.circuit.dynamics import dynamics_of, initial_state
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.transients.integration import Integration
from resgrid.circuit.transients.linear import checked_times, initial_voltages
from resgrid.circuit.transients.memristive_equations import MemristiveEquations, Point
from resgrid.circuit.transients.memristors import MemristiveCircuit
from resgrid.circuit.transients.stamps import Vector
from resgrid.circuit.transients.waveforms import drive_at, waveform_corners
from resgrid.errors import InputError
from resgrid.solvers.progress import Progress


@frozen
@dataclass(frozen=True, eq=False)
class MemristiveTransient:
    """States, voltages and currents of a circuit with memristors over time.

    Returned by `resgrid.circuit.memristive_transient`.

    Attributes
    ----------
    circuit : MemristiveCircuit
        The circuit.
    times : ndarray of float64, shape (t,)
        Output times, in seconds; time 0 means 0+, just after the sources are switched on.
    voltage : ndarray of float64, shape (t, nodes)
        Node voltages above ground, in volts; NaN where a node floats.
    state : ndarray of float64, shape (t, m)
        States of the memristors, from 0 (``off_resistance``) to 1 (``on_resistance``).
    current : ndarray of float64, shape (t, m)
        Currents through the memristors, from the first to the second node, in amperes.
    charge : ndarray of float64, shape (t, m)
        Time integrals of these currents since 0+, in coulombs.
    energy : ndarray of float64, shape (t, m)
        Energy that every memristor has dissipated since 0+, in joules.
    switching_time : ndarray of float64, shape (m,)
        First time at which the state is 0.5, in seconds; NaN if that does not happen.
    steps : int
        Number of time steps.

    Examples
    --------
    A memristor at a voltage source has the charge ``q`` with ``R_off q - (R_off - R_on) k q**2 / 2 = V t``:

    >>> law = rg.circuit.Memristor(on_resistance=100.0, off_resistance=1e4, rate=1e4)
    >>> loop = rg.Netlist(2, [[1, 0]], [1.0], source_nodes=[[1, 0]], source_volts=[1.0])
    >>> run = rg.circuit.memristive_transient(rg.circuit.MemristiveCircuit(loop, law), [0.0, 0.25, 0.5, 1.0])
    >>> run.state[:, 0].round(6)
    array([0.      , 0.292289, 0.909091, 1.      ])
    >>> run.resistance[:, 0].round(2)
    array([10000.  ,  7106.34,  1000.  ,   100.  ])
    """

    circuit: MemristiveCircuit
    times: NDArray[np.float64]
    voltage: NDArray[np.float64]
    state: NDArray[np.float64]
    current: NDArray[np.float64]
    charge: NDArray[np.float64]
    energy: NDArray[np.float64]
    switching_time: NDArray[np.float64]
    steps: int

    @property
    def resistance(self) -> NDArray[np.float64]:
        """Resistances of the memristors, in ohms, shape (t, m)."""
        return self.circuit.law.resistance(self.state)


def memristive_transient(
    circuit: MemristiveCircuit,
    times: ArrayLike,
    *,
    waveform: ArrayLike | None = None,
    initial: OperatingPoint | ArrayLike | None = None,
    tolerance: Annotated[float, Ge(1e-11), Lt(1)] = 1e-6,
    progress: Progress | None = None,
) -> MemristiveTransient:
    """Compute the states and voltages of a circuit with memristors over time, after its sources are switched on.

    Parameters
    ----------
    circuit : MemristiveCircuit
        Circuit with or without capacitors.
    times : array_like of float, shape (t,)
        Output times, in seconds, ascending and not negative; the last is above 0.
    waveform : array_like of float, shape (n, 2), optional
        Times in seconds, strictly ascending, and factors by which the values of all sources are multiplied.  The factor
        is linear between these times and constant before and after them, as in a PWL source of SPICE.  By default the
        sources are constant.
    initial : OperatingPoint or array_like of float, shape (nodes,), optional
        Node voltages before time 0, which determine the charges of the capacitors; by default these are discharged.
    tolerance : float
        Largest error of the states, and of the voltages as a fraction of the largest voltage between two nodes so far.
        While a memristor switches, earlier errors grow by up to the ratio of its resistances, because a lower
        resistance increases the current; these errors amount to a small shift of the switching time.
    progress : callable, optional
        Function that is called after every step with the number of steps, the fraction of the time that remains, and
        the estimated seconds until the end.  The integration ends if it raises an exception.

    Returns
    -------
    MemristiveTransient
        States, voltages, currents, charges and energies at the output times.

    Raises
    ------
    InputError
        If an argument is not admissible.
    CircuitError
        If voltage sources contradict each other, or a current source injects into a floating component.
    AccuracyError
        If the tolerance is out of reach in double precision.
    BudgetError
        If more than ten million steps would be needed.

    Notes
    -----
    The method is RODAS (Hairer & Wanner 1996), of order 4 with error control.  Steps end where a state reaches or
    leaves a limit.  Linear systems are solved by a sparse LU factorization in double precision.

    Examples
    --------
    >>> law = rg.circuit.Memristor(on_resistance=100.0, off_resistance=1e4, rate=1e4)
    >>> loop = rg.Netlist(2, [[1, 0]], [1.0], source_nodes=[[1, 0]], source_volts=[1.0])
    >>> both = rg.circuit.MemristiveCircuit.antiparallel(loop, law)
    >>> rg.circuit.memristive_transient(both, [0.0, 0.6]).state.round(6)
    array([[0., 0.],
           [1., 0.]])
    """
    when, corners = checked_times(times), waveform_corners(waveform)
    if when[-1] == 0.0:
        raise InputError("times ends at 0 s; at least one output time must be positive")
    equations = MemristiveEquations.of(circuit)
    start = _start(equations, drive_at(corners, 0.0).value, initial_voltages(circuit.netlist, initial))
    integration = Integration(equations, corners, tolerance, float(when[-1]), progress)
    points = list(integration.states(start, when))
    factors = [drive_at(corners, now).value for now in when.tolist()]
    state = np.array([equations.coordinates.to_state(at.state) for at in points])
    return MemristiveTransient(
        circuit=circuit,
        times=when,
        voltage=np.array([equations.at_nodes(at.voltage, w) for at, w in zip(points, factors, strict=True)]),
        state=np.clip(state, 0.0, 1.0),
        current=np.array([equations.currents(at, w) for at, w in zip(points, factors, strict=True)]),
        charge=np.array([at.charge for at in points]),
        energy=np.array([at.heat for at in points]),
        switching_time=integration.switched,
        steps=integration.steps,
    )


def _start(equations: MemristiveEquations, factor: float, before: Vector) -> Point:
    """Return the unknowns at 0+; `factor`: waveform; `before` (nodes,): voltages before time 0, in volts."""
    circuit = equations.circuit
    netlist = circuit.netlist
    scaled = netlist.replace(source_volts=factor * netlist.source_volts, current_amps=factor * netlist.current_amps)
    nothing = np.zeros(len(circuit.state))
    voltage = np.asarray(initial_state(dynamics_of(scaled), before))
    at = Point(voltage, equations.coordinates.from_state(circuit.state), nothing, nothing)
    return equations.restore(at, factor)
