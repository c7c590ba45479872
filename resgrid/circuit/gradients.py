"""Derivatives of voltages, drops, probabilities and path costs with respect to the elements of a circuit.

Let ``F`` be a function of the node voltages ``V``, and ``c = dF / dV``.  With the adjoint ``x = G^-1 c``, the response
of the circuit with zeroed sources to the currents ``c`` (Director & Rohrer 1969):

- ``dF / dg = -(x_a - x_b) (V_a - V_b)`` for the conductance ``g`` of a resistor between the nodes ``a`` and ``b``;
- ``dF / dI = x_b - x_a`` for a current source from ``a`` to ``b``;
- ``dF / dE`` is the current into the plus terminal of a voltage source in the adjoint circuit (Tellegen's theorem).

Both voltage differences come from currents that are accurate where differences of voltages are not.  Products are
formed with separate exponents, so that the derivatives of ``log_drop`` are accurate where the drop itself underflows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import real_numbers
from resgrid._internal.values import frozen
from resgrid.circuit.functionals import (
    above_obstacles,
    checked_seeds,
    log_drops,
    place_weights,
    rail_voltages,
    with_log_seeds,
)
from resgrid.circuit.nonlinear import linearize, nonlinear_drops
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.responses import Response, SourceFreeCircuit
from resgrid.core.contact_derivatives import conductivity_gradient
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.solvers.method_choice import METHODS, check_method
from resgrid.solvers.refinement import minus
from resgrid.solvers.scaled import BITS, Numbers, Scaled, canonical, unscaled

Quantity = Literal["voltage", "log_drop", "collision_probability", "path_cost"]
"""Quantities at places of a circuit whose derivatives `gradient` computes."""


@frozen
@dataclass(frozen=True, eq=False, repr=False)
class Gradient:
    """A function of a circuit's operating point, and its derivatives with respect to the elements of the circuit.

    Returned by `resgrid.gradient` and `resgrid.circuit.pullback`.  The unit of a derivative is the unit of `value`
    divided by the unit of the element's value.  A derivative beyond the range of doubles is 0 or infinite.

    Attributes
    ----------
    op : OperatingPoint
        Operating point at which the derivatives are taken.
    value : float
        Value of the function.
    conductance : ndarray of float64, shape (resistors,)
        Derivative with respect to the conductance of every resistor, per siemens.
    voltage : ndarray of float64, shape (sources,)
        Derivative with respect to every source voltage, per volt; NaN for sources in a loop of sources, whose voltages
        cannot change one by one.
    current : ndarray of float64, shape (current sources,)
        Derivative with respect to the current of every current source, per ampere.
    injection : ndarray of float64, shape (nodes,)
        Derivative with respect to a current from ground into every node, per ampere: the adjoint voltage.  NaN where
        the node floats.
    nonlinear_current, nonlinear_voltage : ndarray of float64, shape (nonlinear resistors,)
        Derivatives with respect to ``I0``, per ampere, and to ``V0``, per volt.
    cost : ndarray of float64, shape of the space, or None
        Of a path cost: derivative with respect to the cost of every cell, the expected time in the cell in units of
        ``R C``.  Otherwise None.
    leak : ndarray of float64, shape of the space, or None
        Derivative with respect to the leak of every free cell (`Wiring.leak`); the sum is the derivative with respect
        to the leak of the space.  None for a circuit that was not compiled from a space, with nonlinear resistors, and
        with open obstacles without a leak, where a leak would replace the drive.
    conductivity : ndarray of float64, shape of the space, or None
        Derivative with respect to the conductivity of every cell.  None for a circuit that was not compiled from a
        space, and with nonlinear resistors.

    Examples
    --------
    >>> divider = rg.Netlist(3, [[1, 2], [2, 0]], [1e-3, 3e-3], source_nodes=[[1, 0]], source_volts=[2.0])
    >>> found = rg.gradient(rg.solve(divider), of="voltage", at=2)
    >>> found
    <Gradient at <Netlist of 3 nodes: 2 resistors, 1 voltage source>: value 0.5>
    >>> found.conductance.round(9), found.voltage.round(9)
    (array([ 375., -125.]), array([0.25]))
    """

    op: OperatingPoint
    value: float
    conductance: NDArray[np.float64]
    voltage: NDArray[np.float64]
    current: NDArray[np.float64]
    injection: NDArray[np.float64]
    nonlinear_current: NDArray[np.float64]
    nonlinear_voltage: NDArray[np.float64]
    leak: NDArray[np.float64] | None = None
    cost: NDArray[np.float64] | None = None

    def __repr__(self) -> str:
        return f"<Gradient at {self.op.netlist!r}: value {self.value:.6g}>"

    @cached_property
    def conductivity(self) -> NDArray[np.float64] | None:
        """Derivative with respect to the conductivity of every cell, shape of the space.

        None for a circuit that was not compiled from a space, and with nonlinear resistors.  A resistor that differs
        from the compiled one is taken to be a constant multiple of the compiled one.
        """
        netlist = self.op.netlist
        if netlist.cell_map is None or netlist.nonlinear_nodes.size:
            return None
        found = conductivity_gradient(netlist, self.conductance)
        found.setflags(write=False)
        return found


def gradient(
    op: OperatingPoint,
    of: Quantity | ArrayLike,
    *,
    at: Any = None,
    weights: ArrayLike | None = None,
    cost: ArrayLike | None = None,
    cells: bool = False,
    method: str = "auto",
) -> Gradient:
    """Differentiate a quantity of a circuit with respect to its conductances, conductivities and sources.

    One factorization and one adjoint solve give the derivatives with respect to all elements.

    Parameters
    ----------
    op : OperatingPoint
        Operating point of the circuit, with ``accuracy="direction"``; with ``"normwise"`` the derivatives are as
        inaccurate as the differences of the voltages.
    of : {"voltage", "log_drop", "collision_probability", "path_cost"} or array_like of float, shape (nodes,)
        The quantity at the places `at`.

        ``"voltage"``: node voltage, in volts.
        ``"log_drop"``: natural logarithm of the drop ``u = (V_high - V) / (V_high - V_low)`` from the high rail.
        ``"collision_probability"``: probability that the random walk of `resgrid.planning.collision_probability` hits
        the high rail before the low rail, which is ``1 - u``.
        ``"path_cost"``: expected cost of the random walk from the place until it is absorbed on a rail, for the costs
        per time `cost` of the cells (the cost-to-go of a Markov chain, Kemeny & Snell 1960, chapter 3).  With the
        default costs it is the expected time ``CollisionProbability.time``, in units of ``R C``.

        The rail voltages in ``u`` are constants; they do not move with the sources.  An array contains weights ``c``
        of the node voltages, and the quantity is ``c . V``.
    at : int, str, tuple or sequence
        Place, or several places: node numbers or names, or cells.  The function is the sum over the places.
    weights : array_like of float, shape (places,), optional
        Weight of every place in the sum, 1 by default.
    cost : array_like of float, shape of the space, optional
        Cost of every cell per unit of time ``R C``, at least 0, for ``of="path_cost"``; 1 by default.
    cells : bool
        Whether places are cells of the compiled space (tuples of indices) instead of nodes.
    method : {"auto", "direct", "multigrid"}
        Method for the linear system; ``"auto"`` takes the method of the operating point.

    Returns
    -------
    Gradient
        Value and derivatives.  With the uniform drive these are the derivatives for the given currents, not for
        currents that `resgrid.normalize_drive` scales with the voltages.

    Raises
    ------
    InputError
        If the quantity or a place does not exist, a place floats, or the quantity is not defined for the circuit.
    AccuracyError
        If the accuracy of the adjoint is not reached.
    BudgetError
        If the factors do not fit in memory.

    Examples
    --------
    >>> netlist = rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")), resistance=1.0)
    >>> op = rg.solve(netlist)
    >>> found = rg.gradient(op, of="log_drop", at=(6, 2), cells=True)
    >>> found.conductivity[6, 2].round(6), found.leak.sum().round(6)
    (np.float64(0.32035), np.float64(-0.761704))
    >>> rg.gradient(op, of="collision_probability", at=(6, 2), cells=True).value.__round__(6)
    0.573718
    """
    check_method(method)
    if not isinstance(of, str):
        if at is not None or weights is not None:
            raise InputError("an array of node weights leaves no choice of places; leave out at and weights")
        return pullback(op, voltage=of, method=method)
    if cost is not None and of != "path_cost":
        raise InputError(f"of = {of!r} has no cost of cells; leave out cost, or choose of = 'path_cost'")
    seed = place_weights(op.netlist, at, weights, cells)
    if of == "voltage":
        return pullback(op, voltage=seed, method=method)
    if of == "log_drop":
        return pullback(op, log_drop=seed, method=method)
    if of == "path_cost":
        return _of_path_cost(op, seed, cost, method)
    return _of_collision(op, seed, method)


def pullback(
    op: OperatingPoint,
    *,
    voltage: ArrayLike | None = None,
    log_drop: ArrayLike | None = None,
    method: str = "auto",
) -> Gradient:
    """Multiply seeds with the Jacobian matrix of node voltages or of their log drops (vector-Jacobian product).

    The result is the gradient of ``voltage . V + log_drop . L``, where ``V`` are the node voltages, and ``L`` their
    `OperatingPoint.log_drop`.  Automatic differentiation calls such a function for every operation of a program.

    Parameters
    ----------
    op : OperatingPoint
        Operating point of the circuit.
    voltage, log_drop : array_like of float, shape (nodes,), optional
        Seeds: weights of the node voltages, per volt, and of the log drops.
    method : {"auto", "direct", "multigrid"}
        Method for the linear system; ``"auto"`` takes the method of the operating point.

    Returns
    -------
    Gradient
        Value and derivatives, from one adjoint solve.

    Raises
    ------
    InputError
        If a seed has a wrong shape or is not finite, or a node with a seed other than 0 floats or has no drop.
    AccuracyError
        If the accuracy of the adjoint is not reached.
    BudgetError
        If the factors do not fit in memory.

    Examples
    --------
    >>> divider = rg.Netlist(3, [[1, 2], [2, 0]], [1e-3, 3e-3], source_nodes=[[1, 0]], source_volts=[2.0])
    >>> op = rg.solve(divider)
    >>> found = rg.circuit.pullback(op, voltage=[0.0, 0.0, 2.0])
    >>> found.value, found.conductance.round(9)
    (1.0, array([ 750., -250.]))
    >>> rg.circuit.pullback(op, log_drop=[0.0, 0.0, 1.0]).conductance.round(9)
    array([-250.        ,   83.33333333])
    """
    check_method(method)
    volts, logs = (checked_seeds(op, name, seed) for name, seed in (("voltage", voltage), ("log_drop", log_drop)))
    seeds = volts, np.zeros(op.netlist.node_count, dtype=np.int64)
    value = float(volts[volts != 0.0] @ op.voltage[volts != 0.0])
    if logs.any():
        drops = log_drops(op, logs)
        value += float(logs[logs != 0.0] @ drops)
        seeds = with_log_seeds(op, seeds, logs, drops)
    canonical(*seeds)
    circuit = _circuit(op, np.flatnonzero(seeds[0]), method)
    response = circuit.respond(seeds)
    return _gradient_of(op, circuit.netlist, value, response, _forward(op), above_obstacles(op))


def _gradient_of(
    op: OperatingPoint, netlist: Netlist, value: float, adjoint: Response, forward: Numbers, above: Numbers,
    cost: NDArray[np.float64] | None = None,
) -> Gradient:  # fmt: skip
    """Return the gradient from the adjoint and the currents of the circuit.

    `netlist`: small-signal circuit at the operating point, in which the resistors that replace nonlinear ones come
    last; `value`: value of the function; `adjoint`: response to its derivatives with respect to the node voltages;
    `forward` (resistors of `netlist`,): currents, in amperes; `above` (nodes,): voltages above the obstacle rail, in
    volts; `cost`: derivatives with respect to the costs of cells.
    """
    count, given = len(op.netlist.conductance), op.netlist
    slope = -_product(adjoint.resistor, forward, netlist.conductance)
    taken, fed = given.current_nodes.T
    own = adjoint.voltage
    part = [Scaled(own.hi[end], own.lo[end], own.exponent[end]) for end in (fed, taken)]
    injection = own.plain
    injection[op.floating] = np.nan
    nonlinear = unscaled(adjoint.resistor[0][count:], adjoint.resistor[1][count:])
    return Gradient(
        op=op,
        value=value,
        conductance=slope[:count],
        voltage=unscaled(*adjoint.source),
        current=minus(*part).plain,
        injection=injection,
        nonlinear_current=-nonlinear / netlist.conductance[count:] * op.nonlinear_amps / given.nonlinear_current,
        nonlinear_voltage=nonlinear * nonlinear_drops(op) / given.nonlinear_voltage,
        leak=_leaks(given, slope, own, above),
        cost=cost,
    )


def _leaks(netlist: Netlist, slope: NDArray[np.float64], adjoint: Scaled, above: Numbers) -> NDArray[np.float64] | None:
    """Return the derivatives with respect to the leaks of the cells, shape of the space; None where undefined.

    `slope` (resistors,): derivatives with respect to the conductances; `adjoint` (nodes,): adjoint voltages; `above`
    (nodes,): voltages above the obstacle rail, in volts.
    """
    cells = netlist.cell_map
    if cells is None or netlist.nonlinear_nodes.size or cells.wiring.is_driven:
        return None
    space, wiring = cells.space, cells.wiring
    found = np.zeros(space.cell.size)
    if wiring.leak:
        own = cells.leak_cell >= 0
        np.add.at(found, cells.leak_cell[own], slope[own] * netlist.conductance[own] / wiring.leak)
        return found.reshape(space.shape)
    node = cells.free_node
    siemens, one = space.spacing.min() ** 2 / wiring.resistance, np.ones(node.size)
    first, second = (adjoint.hi[node], adjoint.exponent[node]), (above[0][node], above[1][node])
    found[netlist.cell_of_node()[node]] = -siemens * _product(first, second, one)
    return found.reshape(space.shape)


def _of_collision(op: OperatingPoint, seed: NDArray[np.float64], method: str) -> Gradient:
    """Return the gradient of a sum of collision probabilities; `seed` (nodes,): weights; `method`: linear solver."""
    drops = log_drops(op, seed, beyond=-np.inf)
    high, low = rail_voltages(op)
    found = pullback(op, voltage=seed / (high - low), method=method)
    return replace(found, value=float(seed[seed != 0.0] @ -np.expm1(drops)))


def _of_path_cost(op: OperatingPoint, seed: NDArray[np.float64], cost: ArrayLike | None, method: str) -> Gradient:
    """Return the gradient of a sum of path costs ``v``, with ``G v = cost / R``.

    `seed` (nodes,): weights of the places; `cost`: costs of the cells, None for 1; `method`: linear solver.
    """
    netlist = op.netlist
    cells = netlist.cells
    if netlist.nonlinear_nodes.size:
        raise InputError("a random walk needs linear resistors; use rg.circuit.linearize(op), and solve its result")
    if cells.wiring.drive == "start":
        raise InputError("a start-driven circuit absorbs walks at its start: compile it with drive = 'uniform'")
    rates = np.ones(cells.space.shape) if cost is None else np.array(real_numbers("cost", cost), dtype=np.float64)
    if rates.shape != cells.space.shape or not np.all((rates >= 0.0) & np.isfinite(rates)):
        raise InputError(
            f"cost of shape {rates.shape} must have one finite number of at least 0 per cell: {cells.space.shape}"
        )
    weights = checked_seeds(op, "path_cost", seed)
    cell_of = netlist.cell_of_node()[cells.free_node]
    walked = ~np.isnan(op.voltage[cells.free_node])
    free, cell_of = cells.free_node[walked].astype(np.int64), cell_of[walked]
    amps = np.zeros(netlist.node_count)
    amps[free] = rates.ravel()[cell_of] / cells.wiring.resistance
    circuit = _circuit(op, free, method)
    plain = np.zeros(netlist.node_count, dtype=np.int64)
    walk, adjoint = (circuit.respond((currents, plain)) for currents in (amps, weights))
    times = np.zeros(rates.size)
    times[cell_of] = adjoint.voltage.plain[free] / cells.wiring.resistance
    value, above = float(weights @ walk.voltage.plain), (walk.voltage.hi, walk.voltage.exponent)
    found = _gradient_of(op, circuit.netlist, value, adjoint, walk.resistor, above, times.reshape(rates.shape))
    return replace(found, voltage=np.zeros_like(found.voltage), current=np.zeros_like(found.current))


def _product(first: Numbers, second: Numbers, conductance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the products of the voltages across resistors, as doubles (resistors,), from their currents.

    `first`, `second`: currents in amperes, as mantissas and exponents; `conductance`: in siemens.
    """
    (one, e_one), (two, e_two), (g, e_g) = (np.frexp(part) for part in (first[0], second[0], conductance))
    exponent = BITS * (first[1] + second[1]) + e_one.astype(np.int64) + e_two - 2 * e_g
    with np.errstate(over="ignore", under="ignore"):
        return np.asarray(np.ldexp(one * two / (g * g), np.clip(exponent, -4000, 4000).astype(np.int32)))


def _forward(op: OperatingPoint) -> Numbers:
    """Return the currents of the resistors, nonlinear ones last, in amperes, as mantissas and exponents."""
    amps, exponent = op.readings.scaled
    if not op.netlist.nonlinear_nodes.size:
        return amps, np.asarray(exponent)
    # A resistor of the small-signal circuit with the voltage across the nonlinear resistor.
    small = linearize(op).conductance[len(amps) :] * nonlinear_drops(op)
    return np.concatenate([amps, small]), np.append(exponent, np.zeros(len(small), dtype=np.int64))


def _circuit(op: OperatingPoint, driven: NDArray[np.int64], method: str) -> SourceFreeCircuit:
    """Return the factored small-signal circuit without sources; `driven` (k,): nodes that currents enter."""
    used = op.method.rpartition(" ")[2]
    if method == "auto" and used in METHODS:
        method = used
    return SourceFreeCircuit.of(linearize(op), driven, method)
