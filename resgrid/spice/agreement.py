"""Whether an outside simulator agrees with resgrid, and where it does not."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from resgrid.errors import InputError
from resgrid.netlist import Netlist
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.spice.deck import flatten
from resgrid.spice.dialects import dialect_named
from resgrid.spice.expected import Expected, expect
from resgrid.spice.locate import inspect_deck
from resgrid.spice.ngspice import Simulation, read_deck, simulate
from resgrid.spice.sidecar import Sidecar, altered_lines, read_sidecar, sidecar_path

Reference = Literal["sidecar", "scene", "solve"]
_SHOWN = 5
_SIMULATORS = {"ngspice": simulate}


@dataclass(frozen=True)
class Agreement:
    """The outcome of a comparison with a simulator.

    Attributes
    ----------
    reference : {"sidecar", "scene", "solve"}
        Where the expected voltages come from.
    agrees : bool
        Whether nothing at all was found.
    max_abs_error : float or None
        Largest difference of a node's voltage, in volts; None if nothing could be compared.
    max_relative_error : float or None
        The same relative to the supply (the largest voltage difference in the circuit).
    nodes : int
        Number of nodes compared.
    simulator, version : str
        Who was asked.
    tolerance : float
        Largest relative error that still agrees.
    findings : tuple of str
        What is wrong and where; empty if they agree.
    worst : tuple of (str, float, float)
        Node, expected and simulated voltage, the largest differences first.
    """

    reference: Reference
    agrees: bool
    max_abs_error: float | None
    max_relative_error: float | None
    nodes: int
    simulator: str
    version: str
    tolerance: float
    findings: tuple[str, ...]
    worst: tuple[tuple[str, float, float], ...]


def compare(
    expected: Expected,
    simulation: Simulation,
    *,
    tolerance: float = 1e-9,
    reference: Reference = "solve",
    findings: Sequence[str] = (),
) -> Agreement:
    """Compare what a simulator said with what is expected.

    Parameters
    ----------
    expected : Expected
    simulation : Simulation
    tolerance : float
        Of voltages, relative to the supply; of source currents, relative to the largest.
    reference : {"sidecar", "scene", "solve"}
        Where the expectation comes from.
    findings : sequence of str
        What was found before.

    Returns
    -------
    Agreement
    """
    shared = [name for name in expected.voltage if name in simulation.voltage]
    # NaN is larger than every difference
    error = {name: _distance(expected.voltage[name], simulation.voltage[name]) for name in shared}
    worst = sorted(shared, key=lambda name: -error[name])[:_SHOWN]
    largest = error[worst[0]] if worst else None
    found = [
        *findings,
        *simulation.complaints,
        *_unmatched(expected.voltage, simulation.voltage, "node"),
        *_unmatched(expected.source_current, simulation.source_current, "voltage source"),
        *_differences(expected, simulation, [name for name in worst if error[name] > tolerance * expected.supply]),
        *_source_differences(expected, simulation, tolerance),
    ]
    finite = largest is not None and largest < float("inf")
    return Agreement(
        reference=reference,
        agrees=not found and bool(shared),
        max_abs_error=largest if finite else None,
        max_relative_error=largest / expected.supply if finite and largest is not None else None,
        nodes=len(shared),
        simulator=simulation.simulator,
        version=simulation.version,
        tolerance=tolerance,
        findings=tuple(found),
        worst=tuple((name, expected.voltage[name], simulation.voltage[name]) for name in worst if error[name] > 0),
    )


def check_spice(
    netlist: Netlist,
    operating_point: OperatingPoint,
    *,
    dialect: str = "ngspice",
    tolerance: float = 1e-9,
    timeout: float = 600.0,
) -> Agreement:
    """Ask the simulator whether it agrees with an operating point.

    Parameters
    ----------
    netlist : Netlist
    operating_point : OperatingPoint
        Its solution.
    dialect : str
        Which simulator.
    tolerance : float
        Relative to the supply, the largest voltage difference in the circuit.
    timeout : float
        How long the simulator may take, in seconds.

    Returns
    -------
    Agreement

    Raises
    ------
    InputError
        If the netlist and the operating point do not belong together.
    CircuitError
        If the netlist makes no deck.
    ToolMissingError
        If the simulator is not installed.
    BudgetError
        If it does not end in time.
    """
    _check_tolerance(tolerance)
    deck = flatten(netlist, dialect=dialect)
    simulation = _SIMULATORS[deck.dialect.name](deck.text.encode("ascii"), timeout=timeout)
    return compare(expect(deck, operating_point), simulation, tolerance=tolerance, reference="solve")


def check_deck(
    path: str | os.PathLike[str],
    *,
    tolerance: float = 1e-9,
    reference: OperatingPoint | None = None,
    dialect: str = "ngspice",
    timeout: float = 600.0,
) -> Agreement:
    """Check a deck: its bytes against its sidecar's hash, its elements and the simulator against the expected voltages.

    Parameters
    ----------
    path : path-like
        The deck.
    tolerance : float
        Relative to the supply, the largest voltage difference in the circuit.
    reference : OperatingPoint, optional
        Solution of the scene to compare with; by default the sidecar is the reference.  A sidecar's hash is compared
        either way.
    dialect : str
        Of a deck without sidecar.
    timeout : float
        How long the simulator may take, in seconds.

    Returns
    -------
    Agreement

    Raises
    ------
    InputError
        If the deck or its sidecar cannot be read, or there is neither a sidecar nor a reference.
    ToolMissingError
        If the simulator is not installed.
    BudgetError
        If it does not end in time.
    """
    _check_tolerance(tolerance)
    deck = Path(path)
    data = read_deck(deck)
    sidecar = read_sidecar(deck) if reference is None or sidecar_path(deck).exists() else None
    name = dialect_named(dialect if sidecar is None else sidecar.dialect).name
    findings = [] if sidecar is None else _hash_findings(data, sidecar)
    if reference is not None:
        expected = expect(flatten(reference.netlist, dialect=name), reference)
    elif sidecar is not None:
        expected = sidecar.expected
    findings += inspect_deck(data, expected, tolerance)
    simulation = _simulate_or_refuse(data, name, str(deck), timeout)
    return compare(
        expected,
        simulation,
        tolerance=tolerance,
        reference="scene" if reference is not None else "sidecar",
        findings=findings,
    )


def _check_tolerance(tolerance: float) -> None:
    if not 0 < tolerance < 1:
        raise InputError(f"tolerance = {tolerance} must lie between 0 and 1: it is relative to the supply")


def _simulate_or_refuse(data: bytes, simulator: str, source: str, timeout: float) -> Simulation:
    """A deck with commands in it is not run, and that is an answer: it is not the deck that was written."""
    try:
        return _SIMULATORS[simulator](data, source=source, timeout=timeout)
    except InputError as error:
        return Simulation({}, {}, simulator, "not run", (str(error),))


def _hash_findings(data: bytes, sidecar: Sidecar) -> list[str]:
    if hashlib.sha256(data).hexdigest() == sidecar.sha256:
        return []
    ranges = altered_lines(data, sidecar)
    shown = ", ".join(f"{first}-{last}" for first, last in ranges[:_SHOWN])
    more = f" and {len(ranges) - _SHOWN} more ranges" if len(ranges) > _SHOWN else ""
    where = f"lines {shown}{more} differ" if ranges else "the hash in the sidecar differs, though no line does,"
    return [f"{where} from the deck that resgrid wrote (SHA-256 in {sidecar.path.name})"]


def _distance(expected: float, got: float) -> float:
    difference = abs(got - expected)
    return difference if difference < float("inf") else float("inf")


def _unmatched(expected: Mapping[str, object], got: Mapping[str, object], what: str) -> list[str]:
    missing = [name for name in expected if name not in got]
    strange = [name for name in got if name not in expected]
    return [
        f"{len(names)} {what}{'s' if len(names) > 1 else ''} {verb}: {', '.join(names[:_SHOWN])}"
        for names, verb in ((missing, "absent from the simulation"), (strange, "simulated but not expected"))
        if names
    ]


def _differences(expected: Expected, simulation: Simulation, names: list[str]) -> list[str]:
    return [
        f"node {name}: {simulation.simulator} finds {simulation.voltage[name]!r} V, expected "
        f"{expected.voltage[name]!r} V"
        for name in names
    ]


def _source_differences(expected: Expected, simulation: Simulation, tolerance: float) -> list[str]:
    allowed = tolerance * expected.current_scale
    return [
        f"voltage source {name}: {simulation.simulator} finds {simulation.source_current[name]!r} A, "
        f"expected {amps!r} A"
        for name, amps in expected.source_current.items()
        if amps is not None
        and name in simulation.source_current
        and not _distance(amps, simulation.source_current[name]) <= allowed
    ][:_SHOWN]
