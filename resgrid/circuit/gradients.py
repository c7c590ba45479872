"""The public functions `gradient` and `pullback`: derivatives of circuit quantities by the adjoint method."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.circuit.adjoint_gradient import Gradient, forward_currents, gradient_of, source_free_circuit
from resgrid.circuit.equations import ALWAYS_RECOVERED
from resgrid.circuit.functionals import (
    DotProduct,
    above_obstacles,
    checked_seeds,
    dot_product,
    log_drops,
    place_weights,
    rail_voltages,
    with_log_seeds,
)
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.path_costs import path_cost_gradient, successful_path_cost_gradient
from resgrid.errors import InputError
from resgrid.solvers.method_choice import check_method
from resgrid.solvers.scaled import canonical

Quantity = Literal["voltage", "log_drop", "collision_probability", "path_cost", "path_cost_given_success"]
"""Names of the quantities that `gradient` can differentiate, at nodes or cells of a circuit."""


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

    One factorization and one adjoint solve give the derivatives with respect to all elements.  Path costs need one more
    solve with the same factors, or two for ``"path_cost_given_success"``.

    Parameters
    ----------
    op : OperatingPoint
        Operating point of the circuit, with ``accuracy="direction"``; with ``"normwise"`` the derivatives are as
        inaccurate as the differences of the voltages.
    of : str, or array_like of float, shape (nodes,)
        The quantity at the places `at`.

        ``"voltage"``: node voltage, in volts.
        ``"log_drop"``: natural logarithm of the drop ``u = (V_high - V) / (V_high - V_low)`` from the high rail.
        ``"collision_probability"``: probability that the random walk of `resgrid.planning.collision_probability` hits
        the high rail before the low rail, which is ``1 - u``.
        ``"path_cost"``: expected cost of the random walk from the place until it is absorbed on a rail, for the costs
        per time `cost` of the cells (the cost-to-go of a Markov chain, Kemeny & Snell 1960, chapter 3).  With the
        default costs it is the expected time ``CollisionProbability.time``, in units of ``R C``.
        ``"path_cost_given_success"``: the expected cost of the walks that end on the low rail (a goal); with the
        default costs it is ``CollisionProbability.time_given_success``.

        The rail voltages in ``u`` are constants; they do not move with the sources.  An array contains weights ``c``
        of the node voltages, and the quantity is ``c . V``.
    at : int, str, tuple or sequence
        Place, or several places: node numbers or names, or cells.  The function is the sum over the places.  Required
        with a name in `of`; not allowed with an array.
    weights : array_like of float, shape (places,), optional
        Weight of every place in the sum, 1 by default.
    cost : array_like of float, shape of the space, optional
        Cost of every cell per unit of time ``R C``, at least 0, for path costs; 1 by default.
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
        if not (at is None and weights is None and cost is None) or cells:
            raise InputError(
                "an array of node weights leaves no choice of places; leave out at, weights, cost and cells"
            )
        return pullback(op, voltage=of, method=method)
    if cost is not None and not of.startswith("path_cost"):
        raise InputError(f"of = {of!r} has no cost of cells; leave out cost, or choose of = 'path_cost'")
    seed = place_weights(op.netlist, at, weights, cells)
    if of == "voltage":
        return pullback(op, voltage=seed, method=method)
    if of == "log_drop":
        return pullback(op, log_drop=seed, method=method)
    if of == "path_cost":
        return path_cost_gradient(op, seed, cost, method)
    if of == "path_cost_given_success":
        return successful_path_cost_gradient(op, seed, cost, method)
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
        If both seeds are missing, a seed has a wrong shape or is not finite, or a node with a seed other than 0 floats
        or has no drop.
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
    if voltage is None and log_drop is None:
        raise InputError("the seeds are missing; give voltage or log_drop, with one number per node")
    volts, logs = (checked_seeds(op, name, seed) for name, seed in (("voltage", voltage), ("log_drop", log_drop)))
    seeds = volts, np.zeros(op.netlist.node_count, dtype=np.int64)
    weights, values = volts[volts != 0.0], op.voltage[volts != 0.0]
    if logs.any():
        drops = log_drops(op, logs)
        weights, values = np.append(weights, logs[logs != 0.0]), np.append(values, drops)
        seeds = with_log_seeds(op, seeds, logs)
    canonical(*seeds)
    circuit = source_free_circuit(op, np.flatnonzero(seeds[0]), method)
    response = circuit.respond(seeds)
    product = dot_product(weights, values)
    found = gradient_of(op, circuit.netlist, product.value, response, forward_currents(op), above_obstacles(op))
    return found if logs.any() else replace(found, value=_value_by_sources(found, product))


def _value_by_sources(found: Gradient, product: DotProduct) -> float:
    """Return a weighted sum of node voltages from its derivatives by the sources, if this sum cancels less.

    The voltages of a linear circuit are homogeneous functions of its sources, so that ``c . V = sum_k dF/ds_k s_k``
    with the values ``s`` of the sources (Euler's theorem).  In circuits of at most 500 nodes the derivatives have all
    digits, also where the rounded voltages in the product ``c . V`` nearly cancel.  `found`: gradient; `product`: the
    product ``c . V``.
    """
    netlist = found.op.netlist
    if netlist.node_count > ALWAYS_RECOVERED or netlist.nonlinear_nodes.size:
        return product.value
    sources = np.append(netlist.source_volts, netlist.current_amps)
    driven, slopes = sources != 0.0, np.append(found.voltage, found.current)
    if not np.isfinite(slopes[driven]).all():
        return product.value
    by_sources = dot_product(slopes[driven], sources[driven])
    return by_sources.value if by_sources.log_size < product.log_size else product.value


def _of_collision(op: OperatingPoint, seed: NDArray[np.float64], method: str) -> Gradient:
    """Return the gradient of a weighted sum of collision probabilities.

    `op`: operating point; `seed` (nodes,): weight of the collision probability of every node; `method`: ``"direct"``,
    ``"multigrid"``, or ``"auto"`` for the method that solved `op`.
    """
    drops = log_drops(op, seed, beyond=-np.inf)
    high, low = rail_voltages(op)
    found = pullback(op, voltage=seed / (high - low), method=method)
    return replace(found, value=dot_product(seed[seed != 0.0], -np.expm1(drops)).value)
