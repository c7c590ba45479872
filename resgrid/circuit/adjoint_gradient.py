"""The gradient of a function of a circuit, from the currents of the circuit and those of its adjoint.

Let ``F`` be a function of the node voltages ``V``, and ``c = dF / dV``.  With the adjoint ``x = G^-1 c``, the response
of the circuit with zeroed sources to the currents ``c`` (Director & Rohrer 1969):

- ``dF / dg = -(x_a - x_b) (V_a - V_b)`` for the conductance ``g`` of a resistor between the nodes ``a`` and ``b``;
- ``dF / dI = x_b - x_a`` for a current source from ``a`` to ``b``;
- ``dF / dE`` is the current into the plus terminal of a voltage source in the adjoint circuit (Tellegen's theorem).

Both voltage differences are computed from branch currents, which are accurate even where the difference of two rounded
node voltages is not.  Products are formed with separate exponents, so that the derivatives of ``log_drop`` are accurate
where the drop itself underflows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen
from resgrid.circuit.nonlinear import linearize, nonlinear_drops
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.responses import Response, SourceFreeCircuit
from resgrid.core.conductivity_derivatives import conductivity_gradient
from resgrid.core.netlist import Netlist
from resgrid.solvers.method_choice import METHODS
from resgrid.solvers.scaled import BITS, Numbers, Scaled, unscaled


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
        Value of the function.  A weighted sum of voltages is computed from the voltages, rounded to doubles, or in a
        linear circuit of at most 500 nodes from the derivatives by the sources, whichever cancels less; its error is
        a rounding error of the largest term.  Sums of log drops are computed from the log drops.
    conductance : ndarray of float64, shape (resistors,)
        Derivative with respect to the conductance of every resistor, per siemens.
    voltage : ndarray of float64, shape (sources,)
        Derivative with respect to every source voltage, per volt; NaN for sources in a loop of sources, whose voltages
        cannot change one by one; 0 for path costs, which do not depend on sources.
    current : ndarray of float64, shape (current sources,)
        Derivative with respect to the current of every current source, per ampere; 0 for path costs.
    injection : ndarray of float64, shape (nodes,)
        Derivative with respect to a current from ground into every node, per ampere: the adjoint voltage.  NaN where
        the node floats; 0 for path costs.
    nonlinear_current, nonlinear_voltage : ndarray of float64, shape (nonlinear resistors,)
        Derivatives with respect to the parameters of ``I = I0 tanh(dV / V0)``: ``I0``, per ampere, and ``V0``, per
        volt.
    cost : ndarray of float64, shape of the space, or None
        For path costs (expected costs of a random walk), derivative with respect to the cost of every cell: the
        expected time of the walk in the cell, in units of ``R C``.  None for other functions.
    leak : ndarray of float64, shape of the space, or None
        Derivative with respect to the leak of every free cell to the obstacle rail (`Wiring.leak`, in 1 / (unit of
        the axes)^2); the sum is the derivative with respect to the leak of the space.  None for a circuit that was not
        compiled from a space, with nonlinear resistors, and with open obstacles without a leak, where a leak would
        replace the drive.
    conductivity : ndarray of float64, shape of the space, or None
        Derivative with respect to the conductivity of every cell, a factor (1 by default) without unit.  None for a
        circuit that was not compiled from a space, and with nonlinear resistors.

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

        A conductivity is a factor without unit, 1 by default.  The result is None for a circuit that was not compiled
        from a space, and with nonlinear resistors.  A resistor that differs from the compiled one is taken to be a
        constant multiple of the compiled one.
        """
        netlist = self.op.netlist
        if netlist.cell_map is None or netlist.nonlinear_nodes.size:
            return None
        found = conductivity_gradient(netlist, self.conductance)
        found.setflags(write=False)
        return found


def gradient_of(
    op: OperatingPoint, netlist: Netlist, value: float, adjoint: Response, forward: Numbers, above: Numbers,
    cost: NDArray[np.float64] | None = None,
) -> Gradient:  # fmt: skip
    """Return the derivatives of a function of the node voltages with respect to all elements of a circuit.

    `op`: operating point; `netlist`: small-signal circuit at `op`, in which resistors of the differential conductances
    replace the nonlinear ones and come last; `value`: value of the function; `adjoint`: voltages and currents of
    `netlist` with zeroed sources, caused by injected currents that equal the derivatives of the function with respect
    to the node voltages; `forward` (resistors of `netlist`,): currents in amperes, and `above` (nodes,): voltages above
    the obstacle rail in volts, both as mantissas and exponents of ``2**256``; `cost` (shape of the space): derivatives
    with respect to the costs of the cells, None if the function is not the expected cost of a random walk.
    """
    count, given = len(op.netlist.conductance), op.netlist
    slope = -_product(adjoint.resistor, forward, netlist.conductance)
    own = adjoint.voltage
    injection = own.plain
    injection[op.floating] = np.nan
    amps, siemens = (adjoint.resistor[0][count:], adjoint.resistor[1][count:]), netlist.conductance[count:]
    fall = _product(amps, (siemens, 0 * amps[1]), siemens)  # adjoint voltages across nonlinear resistors
    return Gradient(
        op=op,
        value=value,
        conductance=slope[:count],
        voltage=unscaled(*adjoint.source),
        current=-unscaled(*adjoint.fall),
        injection=injection,
        nonlinear_current=-fall * (op.nonlinear_amps / given.nonlinear_current),
        nonlinear_voltage=unscaled(*amps) * (nonlinear_drops(op) / given.nonlinear_voltage),
        leak=_leaks(given, slope, own, above),
        cost=cost,
    )


def _leaks(netlist: Netlist, slope: NDArray[np.float64], adjoint: Scaled, above: Numbers) -> NDArray[np.float64] | None:
    """Return the derivatives with respect to the leaks of the cells, shape of the space.

    None for a circuit that was not compiled from a space, with nonlinear resistors, and with a drive.  `slope`
    (resistors,): derivatives with respect to the conductances; `adjoint` (nodes,): adjoint voltages; `above` (nodes,):
    voltages above the obstacle rail in volts, as mantissas and exponents of ``2**256``.
    """
    cells = netlist.cell_map
    if cells is None or netlist.nonlinear_nodes.size or cells.wiring.is_driven or cells.wiring.has_islands:
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


def _product(first: Numbers, second: Numbers, conductance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the product of the voltages across every resistor in two states of a circuit, (resistors,), as doubles.

    `first`, `second` (resistors,): currents of the resistors in the two states, in amperes, as mantissas and exponents
    of ``2**256``; `conductance` (resistors,): in siemens.  Products beyond the range of doubles are 0 or infinite.
    """
    (one, e_one), (two, e_two), (g, e_g) = (np.frexp(part) for part in (first[0], second[0], conductance))
    exponent = BITS * (first[1] + second[1]) + e_one.astype(np.int64) + e_two - 2 * e_g
    with np.errstate(over="ignore", under="ignore"):
        return np.asarray(np.ldexp(one * two / (g * g), np.clip(exponent, -4000, 4000).astype(np.int32)))


def forward_currents(op: OperatingPoint) -> Numbers:
    """Return the currents of the small-signal circuit for the voltages of an operating point, in amperes, (resistors,).

    The result is a pair of mantissas and exponents of ``2**256``, positive from the first node to the second.  The
    resistors that replace nonlinear ones come last; a current there is the differential conductance times the voltage.
    """
    amps, exponent = op.readings.scaled
    if not op.netlist.nonlinear_nodes.size:
        return amps, np.asarray(exponent)
    # A resistor of the small-signal circuit with the voltage across the nonlinear resistor.
    small = linearize(op).conductance[len(amps) :] * nonlinear_drops(op)
    return np.concatenate([amps, small]), np.append(exponent, np.zeros(len(small), dtype=np.int64))


def source_free_circuit(op: OperatingPoint, driven: NDArray[np.int64], method: str) -> SourceFreeCircuit:
    """Return the factored small-signal circuit with all sources set to zero.

    `op`: operating point around which the circuit is linearized; `driven` (k,): nodes that injected currents may enter;
    `method`: ``"direct"``, ``"multigrid"``, or ``"auto"`` for the method that solved `op`.
    """
    used = op.method.rpartition(" ")[2]
    if method == "auto" and used in METHODS:
        method = used
    return SourceFreeCircuit.of(linearize(op), driven, method)
