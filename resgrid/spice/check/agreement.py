"""Comparison of a simulator's voltages and source currents with the expected ones."""

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

    Returned by `resgrid.check_deck`.

    Attributes
    ----------
    reference : {"sidecar", "scene", "solve"}
        Source of the expected voltages.
    agrees : bool or None
        Whether the comparison has no finding.  None if there is no finding but the simulator did not run the deck's own
        bytes, or found no operating point.
    verified : bool
        Whether the simulator ran the deck's own bytes (only the analyses are replaced) and returned an operating point.
    max_abs_error : float or None
        Largest difference of a node's voltage, in volts; None if nothing could be compared.
    max_relative_error : float or None
        ``max_abs_error`` relative to the supply (the largest voltage difference in the circuit).
    nodes : int
        Number of nodes compared.
    simulator, version : str
        Simulator that was run, and its version.
    tolerance : float
        Largest relative error that still agrees.
    findings : tuple of str
        One message for each difference, with its place; empty if there is no difference.
    worst : tuple of (str, float, float)
        Node, expected and simulated voltage in volts, the largest differences first.
    remark : str
        Note on the comparison, or empty; for an unverified deck, the reason.
    as_read : Agreement or None
        For a deck that was not run itself: the comparison for a deck written from the circuit that resgrid read.  This
        comparison tests the solution and not the reader.  The errors of the deck itself are then None, and its number
        of nodes is 0.

    Examples
    --------
    >>> op = rg.solve(rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))))
    >>> written = rg.write_spice(op, "lesson.cir")
    >>> agreement = rg.check_deck("lesson.cir")
    >>> agreement.agrees, agreement.reference, agreement.simulator, agreement.findings
    (True, 'sidecar', 'ngspice', ())
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
    """Return the comparison of simulated with expected voltages and currents.

    `expected`: expected values and their scales; `simulation`: result of the simulator; `tolerance`: largest accepted
    relative error; `reference`: source of the expected values; `findings`: further findings; `place_of`: function that
    returns a node's place in the deck.
    """
    error = _errors(expected.voltage, simulation.voltage)
    largest = next(iter(error.values()), np.inf)
    compared: tuple[tuple[str, str, Mapping[str, float | None], Mapping[str, float], float], ...] = (
        ("node", "V", expected.voltage, simulation.voltage, expected.supply),
        ("voltage source", "A", expected.source_current, simulation.source_current, expected.current_scale),
    )
    problems = [*findings, *simulation.complaints]
    for kind, _, known, got, _ in compared:
        problems += _unmatched(known, got, kind)
    for kind, unit, known, got, scale in compared:
        for name, difference in list(_errors(known, got).items())[:SHOWN]:
            if difference > tolerance * scale:
                where = place_of(name) if kind == "node" else ""
                finds = f"{simulation.simulator} finds {got[name]!r} {unit}, expected {known[name]!r} {unit}"
                problems.append(f"{where}{kind} {name}: {finds}")
    unknown = simulation.simulator == SIMULATED and simulation.version not in (*VERSIONS, "not run")
    tested = f"resgrid is tested with {SIMULATED} {' and '.join(VERSIONS)}; this is version {simulation.version}"
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
        remark=f"{simulation.simulator} found no operating point" if silent else tested if unknown else "",
        verified=not silent,
    )


def _errors(expected: Mapping[str, float | None], got: Mapping[str, float]) -> dict[str, float]:
    """Return the absolute differences of the values with a common name, the largest first; NaN becomes infinity.

    `expected`: expected value by name, None if undetermined; `got`: simulated value by name.
    """
    error_of = {name: abs(got[name] - value) for name, value in expected.items() if name in got and value is not None}
    finite = {name: error if error < np.inf else np.inf for name, error in error_of.items()}
    return dict(sorted(finite.items(), key=lambda entry: -entry[1]))


def _unmatched(expected: Mapping[str, object], got: Mapping[str, object], kind: str) -> list[str]:
    """Return findings for the names that only one of the two mappings has, at most one for each mapping.

    `kind`: "node" or "voltage source", for the messages.
    """
    missing = [name for name in expected if name not in got]
    extra = [name for name in got if name not in expected]
    return [
        f"{len(names)} {kind}{'s' if len(names) > 1 else ''} {state}: {some(names, len(names))}"
        for names, state in ((missing, "absent from the simulation"), (extra, "simulated but not expected"))
        if names
    ]


def unverified(agreement: Agreement, why: str) -> Agreement:
    """Return the comparison of a rewritten deck as the unverified result of the deck itself.

    `agreement`: comparison of the rewritten deck; `why`: the reason why the deck itself was not run.
    """
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
