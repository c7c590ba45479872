"""What a simulator found, held against what is expected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from resgrid.spice.run import SIMULATED
from resgrid.spice.run.ngspice import VERSIONS, Simulation
from resgrid.spice.write.expected import Expected

Reference = Literal["sidecar", "scene", "solve"]
_SHOWN = 5


@dataclass(frozen=True)
class Agreement:
    """The outcome of a comparison with a simulator.

    Attributes
    ----------
    reference : {"sidecar", "scene", "solve"}
        Where the expected voltages come from.
    agrees : bool or None
        Whether nothing at all was found; None where nothing was, but the simulator did not run the deck itself.
    verified : bool
        Whether the simulator was given the deck itself, byte for byte but for its analyses.
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
    remark : str
        What else is to be known of the comparison, empty if nothing; where it is not verified, why.
    as_read : Agreement or None
        Where the deck itself was not run: the comparison with what was read of it, written anew.  It tests the solution
        and not the reading; the deck's own figures are None, and its number of nodes 0.
    """

    reference: Reference
    agrees: bool | None
    max_abs_error: float | None
    max_relative_error: float | None
    nodes: int
    simulator: str
    version: str
    tolerance: float
    findings: tuple[str, ...]
    worst: tuple[tuple[str, float, float], ...]
    remark: str = ""
    verified: bool = True
    as_read: Agreement | None = None


def compare(
    expected: Expected,
    simulation: Simulation,
    *,
    tolerance: float = 1e-9,
    reference: Reference = "solve",
    findings: Sequence[str] = (),
) -> Agreement:
    """Compare what a simulator said with what is expected."""
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
        remark=_remark(simulation),
    )


def _remark(simulation: Simulation) -> str:
    if simulation.simulator != SIMULATED or simulation.version in (*VERSIONS, "not run"):
        return ""
    return f"resgrid is tried with {SIMULATED} {' and '.join(VERSIONS)}; this is version {simulation.version}"


def unverified(found: Agreement, why: str) -> Agreement:
    """What a comparison with what was read of a deck, written anew, says of the deck itself: nothing good."""
    return replace(
        found,
        agrees=None if found.agrees else False,
        max_abs_error=None,
        max_relative_error=None,
        nodes=0,
        worst=(),
        remark=why,
        verified=False,
        as_read=found,
    )


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
