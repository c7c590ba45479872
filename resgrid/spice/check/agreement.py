"""What a simulator found, held against what is expected."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from resgrid.spice.circuit import SHOWN, TOLERANCE, some
from resgrid.spice.run import SIMULATED
from resgrid.spice.run.ngspice import VERSIONS, SimulatorRun
from resgrid.spice.write.sidecar import Expected

Reference = Literal["sidecar", "scene", "solve"]


@dataclass(frozen=True)
class Agreement:
    """The outcome of a comparison with a simulator.

    Attributes
    ----------
    reference : {"sidecar", "scene", "solve"}
        Where the expected voltages come from.
    agrees : bool or None
        Whether nothing at all was found; None where nothing was, but the simulator did not run the deck itself, or
        found no operating point.
    verified : bool
        Whether the simulator was given the deck itself, byte for byte but for its analyses, and answered.
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
    simulation: SimulatorRun,
    *,
    tolerance: float = TOLERANCE,
    reference: Reference = "solve",
    findings: Sequence[str] = (),
    place_of: Callable[[str], str] = lambda _: "",
) -> Agreement:
    """Compare what a simulator said with what is expected; ``place_of`` says where a node stands in the deck."""
    error = _errors(expected.voltage, simulation.voltage)
    largest = next(iter(error.values()), np.inf)
    compared: tuple[tuple[str, str, Mapping[str, float | None], Mapping[str, float], float], ...] = (
        ("node", "V", expected.voltage, simulation.voltage, expected.supply),
        ("voltage source", "A", expected.source_current, simulation.source_current, expected.current_scale),
    )
    problems = [*findings, *simulation.complaints]
    for what, _, known, got, _ in compared:
        problems += _unmatched(known, got, what)
    for what, unit, known, got, scale in compared:
        for name, distance in list(_errors(known, got).items())[:SHOWN]:
            if distance > tolerance * scale:
                where = place_of(name) if what == "node" else ""
                finds = f"{simulation.simulator} finds {got[name]!r} {unit}, expected {known[name]!r} {unit}"
                problems.append(f"{where}{what} {name}: {finds}")
    unknown = simulation.simulator == SIMULATED and simulation.version not in (*VERSIONS, "not run")
    tried = f"resgrid is tried with {SIMULATED} {' and '.join(VERSIONS)}; this is version {simulation.version}"
    silent = bool(expected.voltage) and not simulation.voltage and not findings
    return Agreement(
        reference=reference,
        agrees=None if silent else not problems and bool(error),
        max_abs_error=largest if np.isfinite(largest) else None,
        max_relative_error=largest / expected.supply if np.isfinite(largest) else None,
        nodes=len(error),
        simulator=simulation.simulator,
        version=simulation.version,
        tolerance=tolerance,
        findings=tuple(problems),
        worst=tuple(
            (name, expected.voltage[name], simulation.voltage[name]) for name in list(error)[:SHOWN] if error[name] > 0
        ),
        remark=f"{simulation.simulator} found no operating point" if silent else tried if unknown else "",
        verified=not silent,
    )


def _errors(expected: Mapping[str, float | None], got: Mapping[str, float]) -> dict[str, float]:
    """Distances of what both have, the largest first; NaN is larger than every number."""
    distance = {name: abs(got[name] - value) for name, value in expected.items() if name in got and value is not None}
    finite = {name: error if error < np.inf else np.inf for name, error in distance.items()}
    return dict(sorted(finite.items(), key=lambda entry: -entry[1]))


def _unmatched(expected: Mapping[str, object], got: Mapping[str, object], what: str) -> list[str]:
    missing = [name for name in expected if name not in got]
    strange = [name for name in got if name not in expected]
    return [
        f"{len(names)} {what}{'s' if len(names) > 1 else ''} {verb}: {some(names, len(names))}"
        for names, verb in ((missing, "absent from the simulation"), (strange, "simulated but not expected"))
        if names
    ]


def unverified(agreement: Agreement, why: str) -> Agreement:
    """What a comparison with what was read of a deck, written anew, says of the deck itself: nothing good."""
    return replace(
        agreement,
        agrees=None if agreement.agrees else False,
        max_abs_error=None,
        max_relative_error=None,
        nodes=0,
        worst=(),
        remark=why,
        verified=False,
        as_read=agreement,
    )
