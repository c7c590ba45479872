"""Transient analysis of linear netlists with capacitors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Lt
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import Positive, real_numbers
from resgrid._internal.values import frozen
from resgrid.circuit.dynamics import Dynamics, dynamics_of, energy_delivered, factor_resolvent, initial_state
from resgrid.circuit.equations import across
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.stepping import RTOL, Method, advance, controlled_steps, fixed_steps, rate_of
from resgrid.core.cell_map import CellMap
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.solvers.factors import Factor

Solver = Literal["auto", "direct", "multigrid"]

_KEPT = 4
"""Maximum number of factorizations in the cache; each step length has its own factorization."""


@frozen
@dataclass(frozen=True, eq=False)
class Transient:
    """Voltages of a netlist over time.

    Returned by `resgrid.circuit.transient`.

    Attributes
    ----------
    netlist : Netlist
        The circuit.
    times : ndarray of float64, shape (t,)
        Output times, in seconds; time 0 means 0+, just after the sources are switched on.
    voltage : ndarray of float64, shape (t, nodes)
        Node voltages above ground, in volts; NaN where a node floats.
    energy : ndarray of float64, shape (t,)
        Energy that all sources have delivered since 0+, in joules; floating components are not counted.
    stored : ndarray of float64, shape (t,)
        Energy in the capacitors, in joules.
    steps : int
        Number of time steps.
    factorizations : int
        Number of matrices that were factored.
    method : {"tr-bdf2", "trapezoidal", "backward_euler"}
        Integration method.

    Examples
    --------
    >>> rc = rg.Netlist(
    ...     3, [[1, 2]], [1e-3], source_nodes=[[1, 0]], source_volts=[1.0], capacitor_nodes=[[2, 0]], capacitance=[1e-9]
    ... )
    >>> charging = rg.circuit.transient(rc, [0.0, 1e-6, 2e-6])
    >>> charging.voltage[:, 2].round(3)
    array([0.   , 0.632, 0.865])
    >>> [f"{joules:.3g} J" for joules in charging.stored]
    ['0 J', '2e-10 J', '3.74e-10 J']
    """

    netlist: Netlist
    times: NDArray[np.float64]
    voltage: NDArray[np.float64]
    energy: NDArray[np.float64]
    stored: NDArray[np.float64]
    steps: int
    factorizations: int
    method: str


@dataclass(frozen=True, eq=False)
class TransientStepper:
    """Time integrator for a netlist with a fixed step and a matrix that is factored once.

    Returned by `resgrid.circuit.transient_stepper`.

    Attributes
    ----------
    dynamics : Dynamics
        Equations of the netlist.
    step : float
        Length of a step, in seconds.
    method : {"tr-bdf2", "trapezoidal", "backward_euler"}
        Integration method.
    factors : Factor or None
        Factors of the matrix of every step; None without unknown voltages.

    Examples
    --------
    >>> rc = rg.Netlist(
    ...     3, [[1, 2]], [1e-3], source_nodes=[[1, 0]], source_volts=[1.0], capacitor_nodes=[[2, 0]], capacitance=[1e-9]
    ... )
    >>> stepper = rg.circuit.transient_stepper(rc, step=1e-7)
    >>> stepper.advance(stepper.start(np.zeros(3))).round(4)
    array([0.    , 1.    , 0.0952])
    """

    dynamics: Dynamics
    step: float
    method: Method
    factors: Factor | None

    def __repr__(self) -> str:
        return f"<TransientStepper of {self.dynamics.netlist!r}: steps of {self.step:g} s, {self.method}>"

    def start(self, initial: OperatingPoint | ArrayLike | None = None) -> NDArray[np.float64]:
        """Return the node voltages at time 0+, just after the sources are switched on.

        Parameters
        ----------
        initial : OperatingPoint or array_like of float, shape (nodes,), optional
            Node voltages before time 0, in volts; by default all capacitors are discharged.

        Returns
        -------
        ndarray of float64, shape (nodes,)
            Node voltages above ground, in volts; NaN where a node floats.
        """
        before = initial_voltages(self.dynamics.netlist, initial)
        return self.dynamics.voltage(initial_state(self.dynamics, before))

    def advance(self, voltage: ArrayLike) -> NDArray[np.float64]:
        """Return the node voltages after one step.

        If every capacitor is connected to a rail, backward Euler involves no subtraction: voltages of one sign keep
        their relative accuracy over any number of orders of magnitude.

        Parameters
        ----------
        voltage : array_like of float, shape (nodes,)
            Node voltages before the step, in volts, as returned by `start` or `advance`.

        Returns
        -------
        ndarray of float64, shape (nodes,)
            Node voltages above ground after the step, in volts; NaN where a node floats.

        Raises
        ------
        InputError
            If the shape is wrong, or the voltage of a node that does not float is not finite.
        """
        dynamics = self.dynamics
        x = dynamics.state(_checked_voltages(dynamics.netlist, "voltage", voltage, dynamics.row >= 0))
        factors = self.factors
        if factors is not None and self.method == "backward_euler" and dynamics.is_capacitance_diagonal:
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
    """Compute the node voltages of a netlist over time, after its sources are switched on at time 0.

    Parameters
    ----------
    netlist : Netlist
        Netlist with capacitors; nodes without capacitors follow without delay.
    times : array_like of float, shape (t,)
        Output times, in seconds, ascending and not negative.
    initial : OperatingPoint or array_like of float, shape (nodes,), optional
        Node voltages before time 0, which determine the charges of the capacitors.  The voltages of an operating point
        of another scene on the same grid are taken over cell by cell; cells without a voltage get 0 V.  By default all
        capacitors are discharged (SPICE's UIC without initial conditions).
    step : float, optional
        Largest length of a step in seconds; every interval between output times is divided into equal steps.  By
        default the steps are powers of two, controlled by comparing each step with two half steps.
    tolerance : float
        Without ``step``: largest error of every voltage, as a fraction of the largest voltage between two nodes up to
        that time, ground and rails included.  The result therefore does not depend on the length of the simulation.
        With ``step``: ignored.
    method : {"tr-bdf2", "trapezoidal", "backward_euler"}
        Integration method.  For a tolerance ``e`` one decay takes about ``2 / e**(1/3)``, ``1 / e**(1/2)`` or
        ``2 / e`` steps.  With a fixed step the trapezoidal rule starts with four backward Euler steps of half the
        length (Rannacher 1984), which damp oscillations.
    solver : {"auto", "direct", "multigrid"}
        Method for the linear systems; ``"auto"`` chooses by size and shape.

    Returns
    -------
    Transient
        Voltages and energies at the output times.

    Raises
    ------
    InputError
        If an argument is not admissible or the netlist has nonlinear elements.
    CircuitError
        If voltage sources contradict each other, or a current source injects into a floating component.
    AccuracyError
        If the state at 0+ is not determined in double precision, or rounding errors exceed the tolerance.
    BudgetError
        If more than ten million steps would be needed.

    Examples
    --------
    >>> rc = rg.Netlist(
    ...     3, [[1, 2]], [1e-3], source_nodes=[[1, 0]], source_volts=[1.0], capacitor_nodes=[[2, 0]], capacitance=[1e-9]
    ... )
    >>> rg.circuit.transient(rc, [0.0, 1e-6, 5e-6]).voltage[:, 2].round(3)
    array([0.   , 0.632, 0.993])
    """
    when = checked_times(times)
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
    """Set up a time integration with a fixed step, which the program advances step by step.

    Parameters
    ----------
    netlist : Netlist
        Netlist with capacitors.
    step : float
        Length of a step, in seconds.
    method : {"tr-bdf2", "trapezoidal", "backward_euler"}
        Integration method: TR-BDF2, the trapezoidal rule or the backward Euler method.
    solver : {"auto", "direct", "multigrid"}
        Method for the linear systems; ``"auto"`` chooses by size and shape.

    Returns
    -------
    TransientStepper
        Integrator with the methods ``start`` (voltages at 0+) and ``advance`` (one step).

    Raises
    ------
    InputError
        If an argument is not admissible or the netlist has nonlinear elements.
    CircuitError
        If voltage sources contradict each other, or a current source injects into a floating component.

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


def checked_times(times: ArrayLike) -> NDArray[np.float64]:
    """Return output times as an array (t,), in seconds; raise InputError unless they are ascending and not negative."""
    when = np.array(real_numbers("times", times), dtype=np.float64)
    if when.ndim != 1 or not len(when):
        raise InputError(f"times has shape {when.shape}; it must be one-dimensional, with at least one time")
    if not (np.isfinite(when).all() and (when >= 0).all() and (np.diff(when) >= 0).all()):
        with np.errstate(invalid="ignore"):
            bad = int(np.argmin(np.isfinite(when) & (np.diff(when, prepend=0.0) >= 0)))
        raise InputError(f"times[{bad}] = {when[bad]}: times must be finite, at least 0 and ascending, in seconds")
    return when


def initial_voltages(netlist: Netlist, initial: OperatingPoint | ArrayLike | None) -> NDArray[np.float64]:
    """Return the node voltages before time 0, in volts, (nodes,).

    `initial`: node voltages (nodes,) in volts, an operating point of this or another scene, or None for 0 V.
    """
    if initial is None:
        return np.zeros(netlist.node_count)
    if isinstance(initial, OperatingPoint):
        old, new = initial.netlist.cell_map, netlist.cell_map
        initial = np.nan_to_num(_transferred(initial, old, netlist, new) if old and new else initial.voltage)
    return _checked_voltages(netlist, "initial", initial, np.ones(netlist.node_count, dtype=np.bool_))


def _checked_voltages(netlist: Netlist, name: str, values: ArrayLike, needed: NDArray[np.bool_]) -> NDArray[np.float64]:
    volts = np.array(real_numbers(name, values), dtype=np.float64)
    if volts.shape != needed.shape:
        raise InputError(
            f"{name} has shape {volts.shape}, but the netlist has {netlist.node_count} nodes; give one voltage per node"
        )
    bad = needed & ~np.isfinite(volts)
    if bad.any():
        raise InputError(f"{name}: the voltage of node {netlist.node_name(int(np.argmax(bad)))} is not finite")
    return volts


def _transferred(point: OperatingPoint, old: CellMap, netlist: Netlist, new: CellMap) -> NDArray[np.float64]:
    """Return the voltages of an operating point at the nodes of another scene, cell by cell and rail by rail.

    `point`: the operating point; `netlist`: netlist of the other scene; `old`, `new`: cell maps of the operating point
    and of the netlist.  Returns voltages (nodes,) in volts; 0 for nodes without an old voltage.
    """
    if old.space.shape != new.space.shape:
        raise InputError(
            f"initial belongs to a grid of {old.space.shape} cells, but this netlist has {new.space.shape}; "
            "give the operating point of another scene on the same grid"
        )
    before = np.zeros(netlist.node_count)
    if netlist.node_count == point.netlist.node_count and old.wiring.rails == new.wiring.rails == "cells":
        before[:] = point.voltage
    in_both = (new.node >= 0) & (old.node >= 0)
    before[new.node[in_both]] = point.voltage[old.node[in_both]]
    pairs = [(new.obstacle_node, old.obstacle_node), *zip(new.goal_nodes, old.goal_nodes, strict=False)]
    for new_node, old_node in pairs:
        if new_node >= 0 and old_node >= 0:
            before[new_node] = point.voltage[old_node]
    return before
