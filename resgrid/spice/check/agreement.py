"""Whether an outside simulator agrees with resgrid, and where it does not."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from resgrid.errors import InputError
from resgrid.netlist import Netlist
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.spice.check.comparison import Agreement, compare, unverified
from resgrid.spice.check.kirchhoff import inspect_deck
from resgrid.spice.dialects import dialect_named
from resgrid.spice.run import engine_named
from resgrid.spice.run.ngspice import Simulation, read_deck, simulate
from resgrid.spice.write.expected import expect
from resgrid.spice.write.flat import flatten
from resgrid.spice.write.sidecar import altered_files, read_sidecar, sidecar_path, with_parts

if TYPE_CHECKING:
    from resgrid.spice.check.external import Runnable
    from resgrid.spice.parsed import ParsedDeck

_SHOWN = 5
_SIMULATED = "ngspice"


def check_spice(
    netlist: Netlist,
    operating_point: OperatingPoint,
    *,
    dialect: str = "ngspice",
    engine: str = "ngspice",
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
        Of the deck that is simulated; what runs here reads ngspice's.
    engine : str
        Which simulator, one of `resgrid.spice.run.ENGINES`.
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
    run = engine_named(engine)
    if dialect_named(dialect).name != _SIMULATED:
        raise InputError(
            f"no simulator of dialect {dialect!r} is run here: check the circuit with dialect = {_SIMULATED!r}, or "
            "write the deck and check its file, which is read first"
        )
    deck = flatten(netlist, dialect=dialect)
    simulation = run(deck.text.encode("ascii"), timeout=timeout)
    return compare(expect(deck, operating_point), simulation, tolerance=tolerance, reference="solve")


def check_deck(
    path: str | os.PathLike[str],
    *,
    tolerance: float = 1e-9,
    reference: OperatingPoint | None = None,
    dialect: str = "auto",
    root: str | os.PathLike[str] | None = None,
    engine: str = "ngspice",
    timeout: float = 600.0,
) -> Agreement:
    """Check a deck: its bytes against its sidecar's hash, its elements and the simulator against the expected voltages.

    A deck without a sidecar is read and solved, and the simulator is held against that.  The simulator is given the
    deck itself, with the files that it includes, where that is safe.  Otherwise (control blocks, another dialect, files
    from elsewhere) it is given what was read, and the deck is not verified: ``agrees`` is not True.

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
        Of a deck without sidecar, as in `read_spice`.
    root : path-like, optional
        Folder that the includes of such a deck may not leave, as in `read_spice`.
    engine : str
        Which simulator, one of `resgrid.spice.run.ENGINES`.
    timeout : float
        How long the simulator may take, in seconds.

    Returns
    -------
    Agreement

    Raises
    ------
    InputError
        If the deck or its sidecar cannot be read.
    CircuitError
        If a deck without sidecar has no operating point.
    ToolMissingError
        If the simulator is not installed.
    BudgetError
        If it does not end in time.
    """
    _check_tolerance(tolerance)
    engine_named(engine)
    deck = Path(path)
    data = read_deck(deck)
    has_sidecar = sidecar_path(deck).exists()
    if reference is None and not has_sidecar:
        return _check_foreign(deck, data, dialect, root, Run(engine, tolerance, timeout))
    sidecar = read_sidecar(deck) if has_sidecar else None
    name = _SIMULATED if dialect == "auto" else dialect
    name = dialect_named(name if sidecar is None else sidecar.dialect).name
    findings = [] if sidecar is None else altered_files(data, sidecar)
    if reference is not None:
        expected = expect(flatten(reference.netlist, dialect=name), reference)
    elif sidecar is not None:
        expected = sidecar.expected
    has_parts, why = sidecar is not None and bool(sidecar.parts), ""
    if name == _SIMULATED and sidecar is not None and sidecar.parts:
        data = with_parts(deck, data, sidecar)
    elif name == _SIMULATED:
        findings += inspect_deck(data, expected, tolerance)
    else:
        job = _translated(deck, name)
        data, why = job.data, job.why
    simulation = _simulate_or_refuse(data, engine, str(deck), timeout, direct=name != _SIMULATED)
    if has_parts:  # the inner nodes of tiles are nobody's business
        known = {node: volts for node, volts in simulation.voltage.items() if node in expected.voltage}
        simulation = replace(simulation, voltage=known)
    found = compare(
        expected,
        simulation,
        tolerance=tolerance,
        reference="scene" if reference is not None else "sidecar",
        findings=findings,
    )
    return unverified(found, why) if why else found


@dataclass(frozen=True)
class Run:
    """Which simulator is asked, how close it must come, and how long it may take, in seconds."""

    engine: str
    tolerance: float
    timeout: float


def check_read_deck(
    deck: ParsedDeck, point: OperatingPoint, data: bytes, run: Run, root: str | os.PathLike[str] | None = None
) -> Agreement:
    """Hold a simulator against our solution of somebody's deck; the places of the worst nodes are told."""
    from resgrid.spice.check.external import expected_of, places_of, runnable

    job = runnable(deck, data, root=None if root is None else Path(root), engine=run.engine)
    expected = expected_of(deck, point, as_written=job.as_written)
    simulation = _simulated(job, deck.path, run)
    found = compare(expected, simulation, tolerance=run.tolerance, reference="solve")
    if not job.as_written:
        return unverified(found, job.why)
    if found.agrees:
        return found
    places = places_of(deck, (name for name, *_ in found.worst))
    located = tuple(_with_place(finding, places) for finding in found.findings)
    return replace(found, findings=(*located, *_explanations(deck)))


def _simulated(job: Runnable, source: str, run: Run) -> Simulation:
    if job.files:
        return simulate(job.data, source=source, timeout=run.timeout, direct=True, files=job.files, place=job.place)
    return engine_named(run.engine)(job.data, source=source, timeout=run.timeout, direct=True)


def _explanations(deck: ParsedDeck) -> list[str]:
    """Why a simulator may disagree: what it is known to make of such a deck."""
    from resgrid.spice.check.predictions import predict_simulators

    verdict = next(verdict for verdict in predict_simulators(deck) if verdict.simulator == _SIMULATED)
    return [] if verdict.outcome == "right" else [f"this was to be expected: {verdict}"]


def _with_place(finding: str, places: Mapping[str, str]) -> str:
    name = finding.removeprefix("node ").partition(":")[0]
    return f"{places[name]}: {finding}" if finding.startswith("node ") and name in places else finding


def _check_foreign(path: Path, data: bytes, dialect: str, root: str | os.PathLike[str] | None, run: Run) -> Agreement:
    from resgrid.nodal.solve import solve
    from resgrid.spice.read.deck import read_spice

    deck = read_spice(path, dialect=dialect, root=root)
    return check_read_deck(deck, solve(deck.netlist()), data, run, root)


def _translated(path: Path, dialect: str) -> Runnable:
    """A deck of another simulator's dialect, read and written anew for the one that is run."""
    from resgrid.spice.check.external import rewritten
    from resgrid.spice.read.deck import read_spice

    why = f"it is written for {dialect}, and only {_SIMULATED} is run here"
    return rewritten(read_spice(path, dialect=dialect), why)


def _check_tolerance(tolerance: float) -> None:
    if not 0 < tolerance < 1:
        raise InputError(f"tolerance = {tolerance} must lie between 0 and 1: it is relative to the supply")


def _simulate_or_refuse(data: bytes, simulator: str, source: str, timeout: float, *, direct: bool) -> Simulation:
    """A deck with commands in it is not run, and that is an answer: it is not the deck that was written."""
    try:
        return engine_named(simulator)(data, source=source, timeout=timeout, direct=direct)
    except InputError as error:
        return Simulation({}, {}, simulator, "not run", (str(error),))
