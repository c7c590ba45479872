"""The gradient of a function of a circuit, from the currents of the circuit and those of its adjoint.

Let ``F`` be a function of the node voltages ``V``, and ``c = dF / dV``.  With the adjoint ``x = G^-1 c``, the response
of the circuit with zeroed sources to the currents ``c`` (Director & Rohrer 1969):

- ``dF / dg = -(x_a - x_b) (V_a - V_b)`` for the conductance ``g`` of a resistor between the nodes ``a`` and ``b``;
- ``dF / dI = x_b - x_a`` for a current source from ``a`` to ``b``;
- ``dF / dE`` is the current into the plus terminal of a voltage source in the adjoint circuit (Tellegen's theorem).

Both voltage differences come from currents that are accurate where differences of voltages are not.  Products are
formed with separate exponents, so that the derivatives of ``log_drop`` are accurate where the drop itself underflows.
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
from resgrid.core.contact_derivatives import conductivity_gradient
from resgrid.core.netlist import Netlist
from resgrid.solvers.method_choice import METHODS
from resgrid.solvers.refinement import minus
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
        the node floats; 0 for path costs, which do not depend on sources.
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


def gradient_of(
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


def _product(first: Numbers, second: Numbers, conductance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the products of the voltages across resistors, as doubles (resistors,), from their currents.

    `first`, `second`: currents in amperes, as mantissas and exponents; `conductance`: in siemens.
    """
    (one, e_one), (two, e_two), (g, e_g) = (np.frexp(part) for part in (first[0], second[0], conductance))
    exponent = BITS * (first[1] + second[1]) + e_one.astype(np.int64) + e_two - 2 * e_g
    with np.errstate(over="ignore", under="ignore"):
        return np.asarray(np.ldexp(one * two / (g * g), np.clip(exponent, -4000, 4000).astype(np.int32)))


def forward_currents(op: OperatingPoint) -> Numbers:
    """Return the currents of the resistors, nonlinear ones last, in amperes, as mantissas and exponents."""
    amps, exponent = op.readings.scaled
    if not op.netlist.nonlinear_nodes.size:
        return amps, np.asarray(exponent)
    # A resistor of the small-signal circuit with the voltage across the nonlinear resistor.
    small = linearize(op).conductance[len(amps) :] * nonlinear_drops(op)
    return np.concatenate([amps, small]), np.append(exponent, np.zeros(len(small), dtype=np.int64))


def source_free_circuit(op: OperatingPoint, driven: NDArray[np.int64], method: str) -> SourceFreeCircuit:
    """Return the factored small-signal circuit without sources; `driven` (k,): nodes that currents enter."""
    used = op.method.rpartition(" ")[2]
    if method == "auto" and used in METHODS:
        method = used
    return SourceFreeCircuit.of(linearize(op), driven, method)
