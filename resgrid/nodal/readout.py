"""From the solution of the nodal equations to voltages, potentials and currents that keep their last digits.

A current is a difference of two node values.  Where a circuit hangs between two rails, both the potential ``phi`` and
the drop ``u = 1 - phi`` are known to full relative accuracy, and the smaller of the two is differenced.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.netlist import Netlist
from resgrid.nodal.scaled import Scaled
from resgrid.nodal.system import NodalSystem

HARMLESS = 1e-7
"""Share of a node's through-current that may be dropped where float64 values of its ends are equal."""


@dataclass(frozen=True, eq=False)
class Levels:
    """Node values of one representation: ``sign * scale`` volts each, counted from a rail.

    Attributes
    ----------
    value : Scaled, shape (nodes,)
    volts : float
        Volts a unit; negative where the value grows as the voltage falls.
    """

    value: Scaled
    volts: float


@dataclass(frozen=True, eq=False)
class Currents:
    """Resistor currents: sign, from the first node to the second, and natural logarithm of the amperes."""

    direction: NDArray[np.int8]
    log_amps: NDArray[np.float64]

    @property
    def amps(self) -> NDArray[np.float64]:
        """Plain currents, shape (resistors,); 0 where they underflow."""
        return np.asarray(self.direction * np.exp(self.log_amps), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Balance:
    """Kirchhoff's current law at every node.

    Attributes
    ----------
    log_largest : ndarray of float64, shape (nodes,)
        Natural logarithm of the largest current at a node, in amperes.
    through, net : ndarray of float64, shape (nodes,)
        Half the sum of all magnitudes, and the net current into the node, both divided by the largest.
    """

    log_largest: NDArray[np.float64]
    through: NDArray[np.float64]
    net: NDArray[np.float64]


def at_nodes(system: NodalSystem, rows: Scaled, zero: float, volts: float) -> Levels:
    """Spread the values of rows over nodes; known voltages are converted.

    Parameters
    ----------
    system : NodalSystem
    rows : Scaled, shape (n,)
        Solution of the nodal equations.
    zero, volts : float
        The voltage that value 0 stands for, and the volts of a unit.
    """
    known = ~np.isnan(system.known)
    hi = np.zeros(len(known))
    lo = np.zeros(len(known))
    exponent = np.zeros(len(known), dtype=np.int64)
    hi[known] = (system.known[known] - zero) / volts
    solved = system.unknown >= 0
    row = system.unknown[solved]
    hi[solved], lo[solved], exponent[solved] = rows.hi[row], rows.lo[row], rows.exponent[row]
    offset = np.where(solved, system.forest.offset, 0.0) / volts
    if offset.any():
        # Offsets occur only in circuits without two rails, whose values do not leave the range of a double.
        return Levels(Scaled.of(Scaled(hi, lo, exponent).plain + offset), volts)
    return Levels(Scaled(hi, lo, exponent, rows.noise), volts)


def currents(netlist: Netlist, levels: list[Levels]) -> Currents:
    """Resistor currents from the representation whose values are smaller at either end.

    A difference that is noise counts as no current.

    Parameters
    ----------
    netlist : Netlist
    levels : list of Levels
        One representation, or two counted from either rail.
    """
    from resgrid.nodal.kernels import difference

    pairs = netlist.resistor_nodes
    count = len(pairs)
    direction = np.zeros(count, dtype=np.int8)
    log_amps, smallest = np.full(count, -np.inf), np.full(count, np.inf)
    for level in levels:
        log_drop, log_scale = np.empty(count), np.empty(count)
        value = level.value
        sign = difference(pairs, value.hi, value.lo, value.exponent, value.noise, log_drop, log_scale)
        better = log_scale < smallest
        direction[better] = sign[better] * np.int8(np.sign(level.volts))
        log_amps[better] = log_drop[better] + np.log(abs(level.volts))
        smallest[better] = log_scale[better]
    return Currents(direction, log_amps + np.log(netlist.conductance))


def injected_currents(netlist: Netlist) -> NDArray[np.float64]:
    """Current that the current sources feed into every node, in amperes; shape (nodes,)."""
    count = netlist.node_count
    taken, fed = netlist.current_nodes.T
    amps = netlist.current_amps
    # Counts of nothing come as whole numbers, whatever their weights.
    return np.asarray(np.bincount(fed, amps, count) - np.bincount(taken, amps, count), dtype=np.float64)


def balance(netlist: Netlist, flow: Currents) -> Balance:
    """Sum the currents at every node, each relative to the largest one there."""
    from resgrid.nodal.kernels import through_current

    injected = injected_currents(netlist)
    largest, net = np.empty(netlist.node_count), np.empty(netlist.node_count)
    through = through_current(netlist.resistor_nodes, flow.direction, flow.log_amps, injected, largest, net)
    return Balance(largest, through, net)


def drop_unresolved(netlist: Netlist, flow: Currents, sums: Balance, stored: NDArray[np.float64]) -> Currents:
    """Set currents to zero that run between nodes of equal stored value, where the nodes' balance does not notice.

    ``stored`` falls along the current, up to rounding; after this it falls strictly along every current that matters.
    """
    a, b = netlist.resistor_nodes.T
    falls = (stored[a] > stored[b]) * np.int8(1) - (stored[a] < stored[b]) * np.int8(1)
    with np.errstate(divide="ignore"):
        log_through = np.log(sums.through) + sums.log_largest
    tied = (flow.direction != 0) & (falls != flow.direction)
    tied &= flow.log_amps <= np.log(HARMLESS) + np.minimum(log_through[a], log_through[b])
    return Currents(np.where(tied, np.int8(0), flow.direction).astype(np.int8), np.where(tied, -np.inf, flow.log_amps))


def relative_residual(system: NodalSystem, sums: Balance) -> NDArray[np.float64]:
    """Violation of KCL at every node that is solved for and tied by no source, relative to its through-current."""
    own = system.unknown >= 0
    own[system.forest.order] = False
    residual = np.zeros(len(own))
    carries = own & (sums.through > 0)
    residual[carries] = np.abs(sums.net[carries]) / sums.through[carries]
    return residual
