"""Voltages, currents and power of a circuit while a current flows from one terminal to another."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt
from numpy.typing import NDArray

from resgrid._internal.values import frozen
from resgrid.circuit.linear import solve_linear
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import CircuitLike, netlist_of
from resgrid.circuit.terminals import Nodes, TerminalReader, joined_nodes, require_linear
from resgrid.core.netlist import GROUND, Netlist
from resgrid.core.regions import label_components
from resgrid.errors import CircuitError

_USUAL_PLACES, _LEAST_PLACES = 900, -1000
"""Magnitude of the binary logarithm of the largest conductance in siemens up to which conductances are not scaled.

The second number is the smallest binary logarithm of a scaled conductance, at which no digits underflow.
"""


@frozen
@dataclass(frozen=True, eq=False)
class PairCurrents:
    """Voltages and currents of a circuit while a current enters at a first terminal and leaves at a second one.

    A terminal is a node, or several nodes joined by ideal wires.

    Returned by `resgrid.circuit.pair_currents`.

    Attributes
    ----------
    netlist : Netlist
        The circuit.
    resistance : float
        Effective resistance between the terminals, in ohms.
    amps : float
        Current through the circuit from the first terminal to the second, in amperes.
    power : float
        Dissipated power, ``resistance * amps**2``, in watts.
    voltage : ndarray of float64, shape (nodes,)
        Voltage of every node above the second terminal, in volts; NaN in components without the terminals.
    resistor_current : ndarray of float64, shape (resistors,)
        Current from the first node of a resistor to the second, in amperes.
    node_current : ndarray of float64, shape (nodes,)
        Current through every node, in amperes: the larger of the currents into the node and out of it through
        resistors.  Nodes that a wire or a voltage source joins have the current through all of them together.
    point : OperatingPoint
        Operating point of an auxiliary circuit with 1 V between the terminals, in which a node of the second terminal
        is exchanged with node 0.  It contains the error bounds of the solution.

    Examples
    --------
    >>> square = rg.Netlist(4, [[0, 1], [1, 2], [2, 3], [3, 0]], [1.0, 1.0, 1.0, 1.0])
    >>> flow = rg.circuit.pair_currents(square, 1, 0)
    >>> flow
    <PairCurrents of <Netlist of 4 nodes: 4 resistors>: 1 A through 0.75 ohm>
    >>> flow.voltage.round(6), flow.node_current.round(6)
    (array([0.  , 0.75, 0.5 , 0.25]), array([1.  , 1.  , 0.25, 0.25]))
    """

    netlist: Netlist
    resistance: float
    amps: float
    power: float
    voltage: NDArray[np.float64]
    resistor_current: NDArray[np.float64]
    node_current: NDArray[np.float64]
    point: OperatingPoint

    def __repr__(self) -> str:
        return f"<PairCurrents of {self.netlist!r}: {self.amps:.4g} A through {self.resistance:.4g} ohm>"


def pair_currents(
    netlist: Netlist | CircuitLike,
    first: Any,
    second: Any,
    *,
    amps: Annotated[float, Gt(0)] = 1.0,
    cells: bool = False,
    method: str = "auto",
    threads: Annotated[int, Ge(1)] = 1,
) -> PairCurrents:
    """Compute voltages, currents and power while a current flows from one terminal to another.

    The circuit is solved with 1 V between the terminals, and the result is scaled to the current.  Two known voltages
    drive the circuit, so that voltages and currents have the componentwise accuracy of `resgrid.solve`.  Independent
    sources are set to zero: a voltage source is a wire, a current source is open.

    Parameters
    ----------
    netlist : Netlist or Circuit
        Circuit of linear resistors.
    first, second : int, str, sequence or ndarray of bool
        Terminals: a node, a node name, or a region (a list or a mask) whose nodes are joined by an ideal wire.
    amps : float
        Current from the first terminal to the second, in amperes.
    cells : bool
        Whether terminals are cells of the compiled space (index tuples, lists of these, or masks) instead of nodes.
    method : {"auto", "direct", "multigrid"}
        Method for the linear system; ``"auto"`` chooses by size and shape.
    threads : int
        Largest number of threads of the solve.

    Returns
    -------
    PairCurrents
        Voltages above the second terminal, currents of resistors and through nodes, and power.

    Raises
    ------
    InputError
        If a node does not exist, or the circuit has nonlinear resistors.
    CircuitError
        If the terminals are joined, no resistors connect them, or a result exceeds the range of doubles.
    AccuracyError
        If the accuracy is not reached.

    Examples
    --------
    >>> pair = rg.Netlist(2, [[0, 1], [0, 1]], [1.0, 3.0])
    >>> rg.circuit.pair_currents(pair, 0, 1, amps=2.0).resistor_current
    array([0.5, 1.5])
    """
    circuit = netlist_of(netlist)
    require_linear(circuit)
    read = TerminalReader(circuit, cells)
    ends = read.nodes(first), read.nodes(second)
    group = joined_nodes(circuit, ends)
    if group[ends[0][0]] == group[ends[1][0]]:
        raise CircuitError(
            f"terminals {first!r} and {second!r} are joined, so that their resistance is 0 and the current through "
            "the circuit is undetermined; choose terminals without a wire or voltage source between them"
        )
    return currents_between_groups(
        circuit, group, int(group[ends[0][0]]), int(group[ends[1][0]]), amps=amps, method=method, threads=threads
    )


def currents_between_groups(
    netlist: Netlist, group: Nodes, high: int, low: int, *, amps: float = 1.0, method: str = "auto", threads: int = 1
) -> PairCurrents:
    """Return voltages and currents while a current flows between two different groups of joined nodes.

    `group` (nodes,): number of the group of joined nodes of every node; `high`, `low`: groups of the first and the
    second terminal; `amps`: current from the first to the second, in amperes; `method`: ``"auto"``, ``"direct"`` or
    ``"multigrid"``; `threads`: largest number of threads. Raises CircuitError if no resistors connect the groups.
    """
    part = label_components(group[netlist.resistor_nodes], int(group.max()) + 1)
    if part[high] != part[low]:
        raise _not_connected(netlist, group, high, low)
    places = _excess_places(netlist)
    scaled = netlist.replace(conductance=np.ldexp(netlist.conductance, -places)) if places else netlist
    driven, place = _driven(scaled, group, high, low)
    point = solve_linear(driven, accuracy="direction", method=method, rtol=1e-10, threads=threads)
    ends = group[netlist.resistor_nodes]
    current = np.where(ends[:, 0] == ends[:, 1], 0.0, point.resistor_current)
    through = through_nodes(ends, current, int(group.max()) + 1)
    total = float(through[high])
    with np.errstate(all="ignore"):
        scale = np.divide(amps, total)
        ohms = float(np.ldexp(np.divide(1.0, total), -places))
        watts, volts = ohms * amps * amps, np.ldexp(point.voltage[place] * scale, -places)
    if not (np.isfinite([scale, watts]).all() and total < np.inf) or np.isinf(volts).any():
        raise CircuitError(
            f"the effective resistance, the power or a voltage exceeds 1.8e308, the range of double precision, with "
            f"{amps:g} A between the terminals; "
            + ("choose a smaller current" if np.isfinite(ohms) else "check the unit of the smallest conductances")
        )
    return PairCurrents(
        netlist=netlist,
        resistance=ohms,
        amps=amps,
        power=watts,
        voltage=volts,
        resistor_current=current * scale,
        node_current=through[group] * scale,
        point=point,
    )


def _not_connected(netlist: Netlist, group: Nodes, high: int, low: int) -> CircuitError:
    """Return the error for two groups of joined nodes without a connection; arguments of `currents_between_groups`."""
    names = [netlist.node_name(int(np.flatnonzero(group == number)[0])) for number in (high, low)]
    return CircuitError(
        f"no resistors connect the nodes {names[0]} and {names[1]}, so that no current can flow between them; "
        "their effective resistance is infinite"
    )


def _excess_places(netlist: Netlist) -> int:
    """Return the binary logarithm of a divisor of all conductances, 0 if the largest conductance is usual.

    Divided by its power of two, the largest conductance is between 0.5 and 1 S.  The result is also 0 if the smallest
    conductance would then underflow.
    """
    if not netlist.conductance.size:
        return 0
    most, least = (int(np.frexp(siemens)[1]) for siemens in (netlist.conductance.max(), netlist.conductance.min()))
    return most if abs(most) > _USUAL_PLACES and least - most > _LEAST_PLACES else 0


def through_nodes(ends: NDArray[Any], current: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return the current through every node in amperes, (count,): the larger of those into and out of the node.

    `ends` (m, 2): nodes of the resistors; `current` (m,): current from the first to the second node in amperes;
    `count`: number of nodes.
    """
    forward, backward = np.maximum(current, 0.0), np.maximum(-current, 0.0)
    out = np.bincount(ends[:, 0], forward, count) + np.bincount(ends[:, 1], backward, count)
    into = np.bincount(ends[:, 1], forward, count) + np.bincount(ends[:, 0], backward, count)
    return np.asarray(np.maximum(into, out), dtype=np.float64)


def _driven(netlist: Netlist, group: Nodes, high: int, low: int) -> tuple[Netlist, Nodes]:
    """Return a circuit with 1 V between two groups of nodes, and the number of every original node in it, (nodes,).

    One node of the group `low` exchanges its number with ground. `group` (nodes,): group of joined nodes of every node;
    `high`, `low`: groups at 1 V and 0 V.
    """
    count = netlist.node_count
    root = int(np.flatnonzero(group == low)[0])
    place = np.arange(count)
    place[[GROUND, root]] = root, GROUND
    first_of = np.full(int(group.max()) + 1, -1)
    first_of[group[::-1]] = np.arange(count)[::-1]
    first = first_of[group]
    held = np.flatnonzero((group == high) | ((group == low) & (np.arange(count) != root)))
    inner = np.flatnonzero((group != high) & (group != low) & (first != np.arange(count)))
    to_rails = np.stack([place[held], np.full(len(held), GROUND)], axis=1)
    ends = np.concatenate([to_rails, np.stack([place[inner], place[first[inner]]], axis=1)])
    volts = np.concatenate([(group[held] == high).astype(np.float64), np.zeros(len(inner))])
    cell_map = netlist.cell_map
    if cell_map is not None and root != GROUND:
        node = np.where(cell_map.node >= 0, place[cell_map.node], -1).astype(np.int32)
        cell_map = replace(cell_map, node=node, free_node=place[cell_map.free_node].astype(np.int32))
    return Netlist(
        count,
        place[netlist.resistor_nodes].astype(np.int32),
        netlist.conductance,
        ends.astype(np.int32),
        volts,
        cell_map=cell_map,
    ), place
