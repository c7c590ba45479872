"""Location of altered lines in a deck: the expected voltages must obey Kirchhoff's laws with the deck's own values."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.spice.circuit import Circuit, some
from resgrid.spice.read.deck import read_with
from resgrid.spice.write.sidecar import Expected

_MAX_FINDINGS = 5
"""Maximum number of messages about a deck that contradicts its expected voltages."""

_OPTIONS = {"reltol", "abstol", "vntol"}
_ROUNDING = 64 * np.finfo(np.float64).eps
"""Largest accepted rounding error of the voltage across an element, as a fraction.

The fraction is relative to the sum of the magnitudes of the voltages of both its nodes.
"""


def inspect_deck(data: bytes, expected: Expected, tolerance: float) -> list[str]:
    """Return messages with line numbers about elements of a flat deck that contradict its expected voltages.

    Kirchhoff's current law is evaluated at every node with the deck's own values and the expected voltages.  This
    detects a changed element even where the node voltages hardly change.  Lines that cannot be read, changed options,
    unknown nodes and missing nodes are reported, too.  The result has at most 5 messages; it is empty if nothing
    contradicts.  `data`: content of the deck; `expected`: expected results; `tolerance`: largest accepted error, for
    voltage sources relative to the supply (largest voltage difference in the circuit), for the sum of the currents at a
    node relative to the sum of their magnitudes (there at least 4 times the residual of the expected results).
    """
    try:
        circuit = read_with(io.BytesIO(data), dialect="ngspice")
    except InputError as error:
        return [_by_line(text) for text in str(error).split("\n")][:_MAX_FINDINGS]
    problems = [_by_line(str(note)) for note in circuit.notes if note.severity == "warning"]
    foreign = sorted(circuit.options.keys() - _OPTIONS) + [".temp"] * (circuit.temperature is not None)
    problems += [f"{name} is set, which decks of resgrid never do: remove it" for name in foreign]
    problems += [
        f"line {circuit.place['resistor'][i, 1]} has a value out of range: {circuit.resistance[i]:g} ohm"
        for i in np.flatnonzero(~(circuit.resistance > 0))[:_MAX_FINDINGS].tolist()
    ]
    unknown = [number for number, name in enumerate(circuit.node_names) if number and name not in expected.voltage]
    for number in unknown[:_MAX_FINDINGS]:
        line = circuit.places_at(np.array([number]))[0, 1]
        problems.append(f"line {line} names the node {circuit.node_names[number]}, which has no expected voltage")
    missing = sorted(expected.voltage.keys() - set(circuit.node_names))
    problems += [f"node {name} has no element" for name in missing[:_MAX_FINDINGS]]
    if not unknown:
        voltage = np.array([0.0, *(expected.voltage[name] for name in circuit.node_names[1:])])
        problems += _wrong_sources(circuit, voltage, expected.supply * tolerance)
        problems += _wrong_nodes(circuit, voltage, max(tolerance, 4 * expected.kcl_residual))
    return problems[:_MAX_FINDINGS]


def _by_line(text: str) -> str:
    """Return a message with "line " in place of ``<text>:``, the deck reader's name for text without a file."""
    return text.replace("<text>:", "line ")


def _wrong_sources(circuit: Circuit, voltage: NDArray[np.float64], allowed: float) -> list[str]:
    """Return messages about the voltage sources of a deck whose voltage differs from the expected one.

    `voltage` (nodes,): expected node voltages, in volts; `allowed`: magnitude of a difference, in volts, up to
    which there is no message.
    """
    plus, minus = voltage[circuit.source_nodes].T
    error = np.abs(plus - minus - circuit.source_volts)
    line = circuit.place["voltage source"][:, 1]
    return [
        f"line {line[i]}: the source sets {circuit.source_volts[i]:g} V, but {plus[i] - minus[i]:g} V is expected"
        for i in np.argsort(-error, kind="stable").tolist()
        if error[i] > allowed
    ]


def _wrong_nodes(circuit: Circuit, voltage: NDArray[np.float64], tolerance: float) -> list[str]:
    """Return messages about nodes at which the currents do not sum to zero (Kirchhoff's current law).

    At most 5 nodes are reported, those with the largest ratio of residual to accepted residual.  Ground and the nodes
    of voltage sources are not tested.  `voltage` (nodes,): expected node voltages, in volts; `tolerance`: largest
    accepted residual, as a fraction of the sum of the magnitudes of the currents at the node, in addition to rounding
    errors.
    """
    count = circuit.node_count
    ends, current, rounding = _currents(circuit, voltage)
    out, into = (np.bincount(column, current, count) for column in ends.T)
    through, error = (np.bincount(ends.ravel(), np.repeat(size, 2), count) for size in (np.abs(current), rounding))
    net = out - into
    held = np.zeros(count, dtype=np.bool_)
    held[[0, *circuit.source_nodes.ravel()]] = True
    allowed = tolerance * through + error
    excess = np.where(held, 0.0, np.abs(net)) / np.where(allowed > 0, allowed, 1.0)
    return [
        f"at node {circuit.node_names[node]} the currents do not sum to zero: the residual is {abs(net[node]):.3g} A "
        f"(lines {_lines_at(circuit, node)})"
        for node in np.argsort(-excess, kind="stable")[:_MAX_FINDINGS].tolist()
        if excess[node] > 1
    ]


def _currents(
    circuit: Circuit, voltage: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
    """Return the nodes of elements, their currents from first to second node, and the currents' rounding errors.

    The elements are resistors, current sources and nonlinear resistors, in this order; a resistance that is not
    positive carries no current.  `voltage` (nodes,): expected node voltages, in volts.  Shapes of the results:
    (elements, 2), (elements,) and (elements,); currents and errors in amperes.
    """
    sizes = len(circuit.resistance), len(circuit.current_amps)
    ends = np.concatenate([circuit.resistor_nodes, circuit.current_nodes, circuit.nonlinear_nodes])
    first, second = voltage[ends].T
    over_resistor, _, over_nonlinear = np.split(first - second, np.cumsum(sizes))
    positive = circuit.resistance > 0
    conductance = np.where(positive, 1 / np.where(positive, circuit.resistance, 1.0), 0.0)
    amps, volts = circuit.nonlinear_current, circuit.nonlinear_voltage
    parts = conductance * over_resistor, circuit.current_amps, amps * np.tanh(over_nonlinear / volts)
    slope = np.concatenate([conductance, np.zeros(len(circuit.current_amps)), amps / volts])
    return ends, np.concatenate(parts), _ROUNDING * slope * (np.abs(first) + np.abs(second))


def _lines_at(circuit: Circuit, node: int) -> str:
    """Return the line numbers of the elements at a node as text, at most 5 numbers; `node`: node number."""
    lines = [str(line) for _, line in circuit.places_at(np.array([node])).tolist()]
    return some(lines, len(lines))
