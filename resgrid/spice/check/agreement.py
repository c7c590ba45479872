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
    """Result of the comparison of simulated with expected voltages and currents.

    Returned by `resgrid.check_deck`.

    Attributes
    ----------
    reference : {"sidecar", "scene", "solve"}
        Source of the expected voltages: the deck's sidecar, a scene, or a solution by resgrid of the circuit as read.
    agrees : bool or None
        True if the deck itself was run, at least one node was compared, and there is no finding.  None if the simulator
        found no operating point and the files show no fault, or if there is no finding but another deck was run in
        place of this one; else False.
    verified : bool
        Whether the simulator ran the deck's own bytes (only the analyses are replaced) and returned an operating point.
    max_abs_error : float or None
        Largest magnitude, over the nodes, of the difference between simulated and expected voltage, in volts; None if
        nothing could be compared.
    max_relative_error : float or None
        ``max_abs_error`` divided by the supply (the largest voltage difference in the circuit); None if nothing could
        be compared.  For a deck with memristors: the larger of this value and the largest error of a state (0 to 1).
    nodes : int
        Number of nodes with a simulated and an expected voltage.
    simulator, version : str
        Simulator that was run, and its version.
    tolerance : float
        Largest accepted error: of a voltage relative to the supply; of a source current relative to the largest source
        current, or to ``1e-3 G V`` if that is more (largest conductance ``G``, supply ``V``).
    findings : tuple of str
        Messages about differences above the tolerance (at most 5 nodes and 5 voltage sources), about names that only
        one side has, and about altered files; then messages of the simulator.  Empty if there are none.
    worst : tuple of (str, float, float)
        Node, expected and simulated voltage in volts, for at most 5 nodes, the largest differences first; nodes without
        a difference are not listed.
    remark : str
        Note on the comparison, or empty; if `verified` is False, the reason.
    as_read : Agreement or None
        For a deck that was not run itself: the comparison for a deck written from the circuit that resgrid read, which
        tests the solution and not the reader.  `max_abs_error` and `max_relative_error` are then None, and `nodes` is
        0.  None for a deck that was run.

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
    """Return the comparison of simulated with expected node voltages and source currents.

    `expected`: expected values, and the scales of voltage and of current errors; `simulation`: result of the simulator;
    `tolerance`: largest accepted ratio of an error to its scale; `reference`: source of the expected values, "sidecar",
    "scene" or "solve" (solution by resgrid); `findings`: findings of earlier tests, which come first in the result;
    `place_of`: function that returns the place of a node in the deck (``file:line: ``, or empty) by the node's name.
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
    missing = bool(expected.voltage) and not simulation.voltage
    return Agreement(
        reference=reference,
        agrees=None if missing and not findings else not problems and bool(error),
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
        remark=f"{simulation.simulator} found no operating point" if missing else tested if unknown else "",
        verified=not missing,
    )


def _errors(expected: Mapping[str, float | None], got: Mapping[str, float]) -> dict[str, float]:
    """Return the magnitudes of the differences between expected and simulated values, by name, the largest first.

    Names that only one mapping has, and undetermined values, are left out.  `expected`: expected value by name, in
    volts or amperes, None if undetermined; `got`: simulated value by name, in the same unit.  A difference that is NaN
    becomes infinite.
    """
    error_of = {name: abs(got[name] - value) for name, value in expected.items() if name in got and value is not None}
    finite = {name: error if error < np.inf else np.inf for name, error in error_of.items()}
    return dict(sorted(finite.items(), key=lambda entry: -entry[1]))


def _unmatched(expected: Mapping[str, object], got: Mapping[str, object], kind: str) -> list[str]:
    """Return messages about names that only one of two mappings contains: at most one message per mapping.

    `expected`: expected values by name; `got`: simulated values by name; `kind`: "node" or "voltage source", for the
    messages.
    """
    missing = [name for name in expected if name not in got]
    extra = [name for name in got if name not in expected]
    return [
        f"{len(names)} {kind}{'s' if len(names) > 1 else ''} {state}: {some(names, len(names))}"
        for names, state in ((missing, "absent from the simulation"), (extra, "simulated but not expected"))
        if names
    ]


def unverified(agreement: Agreement, why: str) -> Agreement:
    """Return the result for a deck that was not run, from the comparison of a deck that was written in its place.

    `agreement`: comparison of the deck that was run, which becomes the attribute `as_read` of the result; `why`: reason
    for which the original deck was not run.  `agrees` of the result is False if it is False in `agreement`, else None.
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
