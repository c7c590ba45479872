"""Gradients of the expected costs of random walks that jump along resistors until they end on a rail.

A walk that jumps along resistors pays the cost ``k`` of a cell per unit of time ``R C``, with the resistance ``R``
between neighbouring cells and the capacitance ``C`` of every node.  Its expected cost ``v`` until it ends on a rail
solves ``G v = k / R`` (the cost-to-go of a Markov chain, Kemeny & Snell 1960, chapter 3).  The expected cost of the
walks that end on the low rail is ``s / u`` with ``G s = k u / R`` and their probability ``u``.  With ``x = G^-1 w`` for
weights ``w`` of the places, ``w . v`` has the derivative ``-(x_a - x_b) (v_a - v_b)`` with respect to a conductance.
``w . (s / u)`` has the derivative ``-(x_a - x_b) (s_a - s_b) - (y_a - y_b) (u_a - u_b)`` with ``x = G^-1 (w / u)`` and
``y = G^-1 (k x / R - w s / u**2)``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import real_numbers
from resgrid.circuit.adjoint_gradient import Gradient, forward_currents, gradient_of, source_free_circuit
from resgrid.circuit.functionals import above_obstacles, checked_seeds, log_drops, rail_voltages, times_drops
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.errors import InputError
from resgrid.solvers.refinement import corrected
from resgrid.solvers.scaled import Scaled, canonical, logarithm


class _Costs(NamedTuple):
    """Costs of the free nodes: a random walk pays the cost of the node where it is, per unit of time ``R C``.

    `node` (k,): free nodes that do not float; `cell` (k,): flat index of the cell of every node; `amps` (nodes,): cost
    of the node divided by ``R`` in ohms, 0 for other nodes.
    """

    node: NDArray[np.int64]
    cell: NDArray[np.int64]
    amps: NDArray[np.float64]


def path_cost_gradient(op: OperatingPoint, seed: NDArray[np.float64], cost: ArrayLike | None, method: str) -> Gradient:
    """Return the gradient of a weighted sum of the expected costs of random walks until they end on a rail.

    `op`: operating point; `seed` (nodes,): weights of the start nodes; `cost` (shape of the space): costs of the cells
    per unit of time ``R C``, None for 1; `method`: ``"direct"``, ``"multigrid"``, or ``"auto"`` for the method that
    solved `op`.
    """
    costs, weights = _costs_of(op, cost), checked_seeds(op, "path_cost", seed)
    circuit = source_free_circuit(op, costs.node, method)
    plain = np.zeros(len(weights), dtype=np.int64)
    walk, adjoint = (circuit.respond((currents, plain)) for currents in (costs.amps, weights))
    value, above = float(weights @ walk.voltage.plain), (walk.voltage.hi, walk.voltage.exponent)
    found = gradient_of(op, circuit.netlist, value, adjoint, walk.resistor, above)
    return _of_walks(found, costs, adjoint.voltage.plain)


def successful_path_cost_gradient(
    op: OperatingPoint, seed: NDArray[np.float64], cost: ArrayLike | None, method: str
) -> Gradient:
    """Return the gradient of a weighted sum of the expected costs of the random walks that end on the low rail.

    `op`: operating point; `seed` (nodes,): weights of the start nodes; `cost` (shape of the space): costs of the cells
    per unit of time ``R C``, None for 1; `method`: ``"direct"``, ``"multigrid"``, or ``"auto"`` for the method that
    solved `op`.
    """
    costs, drops, (high, low) = _costs_of(op, cost), log_drops(op, seed), rail_voltages(op)
    circuit, chosen = source_free_circuit(op, costs.node, method), np.flatnonzero(seed)
    walk, first = circuit.respond(times_drops(op, costs.amps, 1)), circuit.respond(times_drops(op, seed, -1))
    paid, times = walk.voltage, first.voltage
    of_places = np.zeros(len(seed))
    of_places[chosen] = seed[chosen] * np.exp(logarithm(paid.hi[chosen], paid.exponent[chosen]) - drops)
    own = Scaled(costs.amps * times.hi, costs.amps * times.lo, times.exponent)
    changed = corrected(own, *times_drops(op, -of_places, -1))
    seeds = -changed.hi / (high - low), changed.exponent.copy()
    canonical(*seeds)
    by_cost = gradient_of(op, circuit.netlist, float(of_places.sum()), first, walk.resistor, (paid.hi, paid.exponent))
    by_drop = gradient_of(op, circuit.netlist, 0.0, circuit.respond(seeds), forward_currents(op), above_obstacles(op))
    found = replace(
        by_cost,
        conductance=by_cost.conductance + by_drop.conductance,
        leak=None if by_cost.leak is None or by_drop.leak is None else by_cost.leak + by_drop.leak,
    )
    assert op.log_drop is not None
    with np.errstate(divide="ignore"):
        log_times = logarithm(np.abs(times.hi), times.exponent) + op.log_drop
    return _of_walks(found, costs, np.sign(times.hi) * np.exp(log_times))


def _costs_of(op: OperatingPoint, cost: ArrayLike | None) -> _Costs:
    """Return the costs of the free nodes; raise InputError for wrong costs, and for circuits without a random walk.

    `cost` (shape of the space): cost of every cell per unit of time ``R C``, None for 1.  A circuit with nonlinear
    resistors, or driven at the start cell, has no random walk.
    """
    netlist, cells = op.netlist, op.netlist.cells
    if netlist.nonlinear_nodes.size:
        raise InputError("a random walk needs linear resistors; use rg.circuit.linearize(op), and solve its result")
    if cells.wiring.drive == "start":
        raise InputError("a start-driven circuit absorbs walks at its start: compile it with drive = 'uniform'")
    rates = np.ones(cells.space.shape) if cost is None else np.array(real_numbers("cost", cost), dtype=np.float64)
    if rates.shape != cells.space.shape or not np.all((rates >= 0.0) & np.isfinite(rates)):
        raise InputError(
            f"cost of shape {rates.shape} must have one finite number of at least 0 per cell: {cells.space.shape}"
        )
    walked = ~np.isnan(op.voltage[cells.free_node])
    node = cells.free_node[walked].astype(np.int64)
    cell = netlist.cell_of_node()[node]
    amps = np.zeros(netlist.node_count)
    amps[node] = rates.ravel()[cell] / cells.wiring.resistance
    return _Costs(node, cell, amps)


def _of_walks(found: Gradient, costs: _Costs, times: NDArray[np.float64]) -> Gradient:
    """Return a gradient with derivatives with respect to costs, and zeros for those with respect to sources.

    Costs of walks do not depend on sources.  In the circuit, the cost of a node is a current into it, and the expected
    cost of a walk is the voltage of its start.
    `found`: gradient without derivatives with respect to costs; `costs`: costs of the free nodes; `times` (nodes,):
    derivative of the expected cost with respect to `costs.amps`, in ohms: ``R`` times the expected time of the walk at
    the node, in units of ``R C``.
    """
    space, resistance = found.op.netlist.cells.space, found.op.netlist.cells.wiring.resistance
    by_cell = np.zeros(space.cell.size)
    by_cell[costs.cell] = times[costs.node] / resistance
    zeros = {name: 0.0 * getattr(found, name) for name in ("voltage", "current", "injection")}
    return replace(found, cost=by_cell.reshape(space.shape), **zeros)
