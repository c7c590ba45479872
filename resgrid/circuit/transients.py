"""How a netlist with capacitors moves in time: what is asked for, and what comes back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Lt
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.validation import Positive, real_numbers
from resgrid._internal.values import frozen
from resgrid.circuit.dynamics import Dynamics, dynamics_of, energy_delivered, factor_resolvent, initial_state
from resgrid.circuit.equations import across
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.stepping import RTOL, Method, advance, controlled_steps, fixed_steps, rate_of
from resgrid.core.netlist import CellMap, Netlist
from resgrid.errors import InputError
from resgrid.solvers.factors import Factor

Solver = Literal["auto", "direct", "multigrid"]

_KEPT = 4
"""Rates of steps whose factors are kept."""


@frozen
@dataclass(frozen=True, eq=False)
class Transient:
    """Voltages of a netlist over time.

    Attributes
    ----------
    netlist : Netlist
        The circuit.
    times : ndarray of float64, shape (t,)
        In seconds; at time 0 the state is that of 0+, when the sources already act.
    voltage : ndarray of float64, shape (t, nodes)
        Node voltages above ground, in volts; NaN where a node floats.
    energy : ndarray of float64, shape (t,)
        Energy that all sources have delivered since 0+, in joules; what floats counts nothing.
    stored : ndarray of float64, shape (t,)
        Energy in the capacitors, in joules.
    steps : int
        Steps of integration.
    factorisations : int
        How many matrices were factored.
    method : str
        The method of integration.
    """

    netlist: Netlist
    times: NDArray[np.float64]
    voltage: NDArray[np.float64]
    energy: NDArray[np.float64]
    stored: NDArray[np.float64]
    steps: int
    factorisations: int
    method: str


@dataclass(frozen=True, eq=False)
class TransientStepper:
    """A netlist made ready for steps of one length.

    Attributes
    ----------
    dynamics : Dynamics
        Its equations.
    step : float
        In seconds.
    method : str
        The method of integration.
    factors : Factor or None
        Of the matrix of every step; None where nothing is to be solved.
    """

    dynamics: Dynamics
    step: float
    method: Method
    factors: Factor | None

    def __repr__(self) -> str:
        return f"<TransientStepper of {self.dynamics.netlist!r}: steps of {self.step:g} s, {self.method}>"

    def start(self, initial: OperatingPoint | ArrayLike | None = None) -> NDArray[np.float64]:
        """Node voltages at time 0+, shape (nodes,), in volts; ``initial`` as in `transient`."""
        before = initial_voltages(self.dynamics.netlist, initial)
        return self.dynamics.voltage(initial_state(self.dynamics, before))

    def advance(self, voltage: ArrayLike) -> NDArray[np.float64]:
        """Node voltages one step after ``voltage``, which `start` or `advance` returned; shape (nodes,), in volts.

        Backward Euler subtracts nothing where every capacitor goes to a rail: voltages of one sign keep their relative
        accuracy then, over any number of decades.

        Raises
        ------
        InputError
            If the voltage is not one finite number for every node that is solved for.
        """
        dynamics = self.dynamics
        x = dynamics.state(_checked_voltages(dynamics.netlist, "voltage", voltage, dynamics.row >= 0))
        factors = self.factors
        if factors is not None and self.method == "backward_euler" and dynamics.apart:
            x = factors.solve(dynamics.capacitance.ground * x / self.step + dynamics.drive, rtol=RTOL)
        elif factors is not None:
            x, _ = advance(dynamics, self.method, np.stack([x, np.zeros_like(x)]), self.step, lambda _: factors)
        return dynamics.voltage(x)


def transient(
    netlist: Netlist,
    times: ArrayLike,
    *,
    initial: OperatingPoint | ArrayLike | None = None,
    step: Positive | None = None,
    tolerance: Annotated[float, Ge(1e-12), Lt(1)] = 1e-6,
    method: Method = "tr-bdf2",
    solver: Solver = "auto",
) -> Transient:
    """Follow the voltages of a netlist after its sources are switched on at time 0.

    Parameters
    ----------
    netlist : Netlist
        With capacitors; nodes without any follow the others at once.
    times : array_like of float, shape (t,)
        When to report, in seconds, ascending, none negative.
    initial : OperatingPoint or array_like of float, shape (nodes,), optional
        Node voltages before time 0: they say how the capacitors are charged.  An operating point of another scene on
        the same grid is carried over cell by cell; a cell that had no voltage counts as 0 V.  None: all capacitors
        are discharged (SPICE's UIC without initial conditions).
    step : float, optional
        Length of a step in seconds; every interval between times is divided evenly into steps no longer than this.
        None: chosen as the answer needs, in powers of two, by comparing each step with two halves.
    tolerance : float
        Without ``step``: wanted accuracy of every voltage, relative to the largest voltage difference that has occurred
        until then, ground and rails included.  So no answer depends on how long the circuit is watched.
    method : {"tr-bdf2", "trapezoidal", "backward_euler"}
        Method of integration.  To a tolerance ``e`` one decay takes about ``2 / e**(1/3)``, ``1 / e**(1/2)`` or
        ``2 / e`` steps.  The trapezoidal rule of fixed step begins with four backward Euler steps of half the length
        (Rannacher 1984), which damp what it would let ring.
    solver : {"auto", "direct", "multigrid"}
        Method for the linear systems, as in `resgrid.solve`.

    Returns
    -------
    Transient

    Raises
    ------
    InputError
        If an argument is not admissible or the netlist holds nonlinear elements.
    CircuitError
        If the netlist contradicts itself, or a current source feeds a part that nothing ties to ground.
    AccuracyError
        If double precision does not tell the state at 0+, or does not allow the tolerance.
    BudgetError
        If it would take more than ten million steps.

    Examples
    --------
    >>> rc = rg.Netlist(
    ...     3, [[1, 2]], [1e-3], source_nodes=[[1, 0]], source_volts=[1.0], capacitor_nodes=[[2, 0]], capacitance=[1e-9]
    ... )
    >>> rg.circuit.transient(rc, [0.0, 1e-6, 5e-6]).voltage[:, 2].round(3)
    array([0.   , 0.632, 0.993])
    """
    when = np.array(real_numbers("times", times), dtype=np.float64)
    if when.ndim != 1 or not len(when):
        raise InputError(f"times has shape {when.shape}; give at least one time, in a row")
    if not (np.isfinite(when).all() and (when >= 0).all() and (np.diff(when) >= 0).all()):
        raise InputError("times must be finite, at least 0 and ascending, in seconds")
    dynamics = dynamics_of(netlist)
    factors = lru_cache(_KEPT)(lambda rate: factor_resolvent(dynamics, rate, solver))
    start = np.zeros((2, dynamics.size))
    start[0] = initial_state(dynamics, initial_voltages(netlist, initial))
    voltage = np.empty((len(when), netlist.node_count))
    energy, stored = np.empty(len(when)), np.empty(len(when))
    if step is not None:
        states = fixed_steps(dynamics, method, start, when, step, factors)
    else:
        states = controlled_steps(dynamics, method, start, when, tolerance, factors)
    for number, ((x, integral), taken) in enumerate(states):
        voltage[number] = dynamics.voltage(x)
        energy[number] = energy_delivered(dynamics, when[number], x - start[0], integral)
        stored[number] = 0.5 * np.sum(netlist.capacitance * across(voltage[number], netlist.capacitor_nodes) ** 2)
        steps = taken
    return Transient(netlist, when, voltage, energy, stored, steps, factors.cache_info().misses, method)


def transient_stepper(
    netlist: Netlist, step: Positive, *, method: Method = "tr-bdf2", solver: Solver = "auto"
) -> TransientStepper:
    """Make a netlist ready for many steps of one length, for callers that do something between steps.

    Parameters
    ----------
    netlist : Netlist
        With capacitors.
    step : float
        In seconds.
    method : {"tr-bdf2", "trapezoidal", "backward_euler"}
    solver : {"auto", "direct", "multigrid"}

    Returns
    -------
    TransientStepper

    Raises
    ------
    InputError, CircuitError
        As `transient`.

    Examples
    --------
    >>> rc = rg.Netlist(
    ...     3, [[1, 2]], [1e-3], source_nodes=[[1, 0]], source_volts=[1.0], capacitor_nodes=[[2, 0]], capacitance=[1e-9]
    ... )
    >>> stepper = rg.circuit.transient_stepper(rc, step=1e-7)
    >>> voltage = stepper.start(np.zeros(3))
    >>> for _ in range(10):
    ...     voltage = stepper.advance(voltage)
    >>> voltage.round(3)
    array([0.   , 1.   , 0.632])
    """
    dynamics = dynamics_of(netlist)
    factors = factor_resolvent(dynamics, rate_of(method, float(step)), solver) if dynamics.size else None
    return TransientStepper(dynamics, float(step), method, factors)


def initial_voltages(netlist: Netlist, initial: OperatingPoint | ArrayLike | None) -> NDArray[np.float64]:
    """Node voltages before time 0, in volts, (nodes,), as `transient` takes them."""
    if initial is None:
        return np.zeros(netlist.node_count)
    if isinstance(initial, OperatingPoint):
        old, new = initial.netlist.cell_map, netlist.cell_map
        initial = np.nan_to_num(_carried_over(initial, old, netlist, new) if old and new else initial.voltage)
    return _checked_voltages(netlist, "initial", initial, np.ones(netlist.node_count, dtype=np.bool_))


def _checked_voltages(netlist: Netlist, name: str, values: ArrayLike, needed: NDArray[np.bool_]) -> NDArray[np.float64]:
    volts = np.array(real_numbers(name, values), dtype=np.float64)
    if volts.shape != needed.shape:
        raise InputError(f"{name} has shape {volts.shape}, but the netlist has {netlist.node_count} nodes")
    bad = needed & ~np.isfinite(volts)
    if bad.any():
        raise InputError(f"{name}: the voltage of node {netlist.node_name(int(np.argmax(bad)))} is not finite")
    return volts


def _carried_over(point: OperatingPoint, old: CellMap, netlist: Netlist, new: CellMap) -> NDArray[np.float64]:
    """Old voltages at the nodes of a new scene: cell by cell, and rail by rail."""
    if old.space.shape != new.space.shape:
        raise InputError(
            f"initial is of a grid of {old.space.shape} cells, but this netlist has {new.space.shape}; "
            "it must be the operating point of the same chip with another scene"
        )
    before = np.zeros(netlist.node_count)
    if netlist.node_count == point.netlist.node_count and old.wiring.rails == new.wiring.rails == "cells":
        before[:] = point.voltage
    had = (new.node >= 0) & (old.node >= 0)
    before[new.node[had]] = point.voltage[old.node[had]]
    pairs = [(new.obstacle_node, old.obstacle_node), *zip(new.goal_nodes, old.goal_nodes, strict=False)]
    for here, there in pairs:
        if here >= 0 and there >= 0:
            before[here] = point.voltage[there]
    return before
