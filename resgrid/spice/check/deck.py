"""`check_deck`: check of a deck by an external simulator, whose results are compared with expected voltages."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from resgrid._internal.files import read_bytes
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import solve
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.spice.check.agreement import Agreement, Reference, compare, unverified
from resgrid.spice.check.external import expected_of, place_of, rewritten, runnable
from resgrid.spice.check.kcl_location import inspect_deck
from resgrid.spice.check.memristive import check_memristive
from resgrid.spice.check.portability import check_portability
from resgrid.spice.circuit import TOLERANCE, Circuit
from resgrid.spice.dialects import dialect_named
from resgrid.spice.read.deck import read_spice
from resgrid.spice.run import SIMULATED, engine_named
from resgrid.spice.run.ngspice import SimulatorRun
from resgrid.spice.write.flat import flatten
from resgrid.spice.write.memristive_sidecar import read_memristive_sidecar
from resgrid.spice.write.sidecar import Sidecar, altered_files, expect, read_sidecar, sidecar_path, with_parts


@dataclass(frozen=True)
class _Limits:
    """Settings of one check.

    `engine`: name of the program that simulates, "ngspice" or "eecircuit"; `tolerance`: largest accepted error, of a
    voltage relative to the supply (largest voltage difference in the circuit), of a source current relative to the
    largest source current, or to 1e-3 G V if more (largest conductance G, supply V); `timeout`: longest run, in
    seconds.
    """

    engine: str
    tolerance: float
    timeout: float

    def __post_init__(self) -> None:
        engine_named(self.engine)
        if not 0 < self.tolerance < 1:
            raise InputError(
                f"tolerance = {self.tolerance} must lie between 0 and 1: it is relative to the supply; "
                f"the default is {TOLERANCE:g}"
            )

    def run(self, data: bytes, source: str, **options: Any) -> SimulatorRun:
        """Run the simulator on the content `data` of a deck and return the result.

        `source`: name of the deck in messages; `options`: further arguments of the engine: ``direct`` (whether the deck
        contains an analysis statement), ``files`` (contents of included files, by path relative to the simulator's
        working folder) and ``place`` (path of the deck relative to this folder).
        """
        return engine_named(self.engine)(data, source=source, timeout=self.timeout, **options)


def check_deck(
    deck: str | os.PathLike[str] | Circuit | Netlist | OperatingPoint,
    *,
    tolerance: float = TOLERANCE,
    reference: OperatingPoint | None = None,
    dialect: str = "auto",
    root: str | os.PathLike[str] | None = None,
    engine: str = "ngspice",
    timeout: float = 600.0,
) -> Agreement:
    """Run a simulator on a deck and compare its operating point with the expected one.

    A deck with a sidecar is checked three times: its bytes against the sidecar's hash, its elements against the
    sidecar's voltages (for a flat ngspice deck), and the simulated voltages against the sidecar's voltages.  Any other
    deck is read and solved by resgrid, and the simulated voltages are compared with that solution.  For a netlist or an
    operating point, a deck is written first, and the simulated voltages are compared with resgrid's solution.

    A deck with memristors (`resgrid.spice.write_memristive`) is checked by its transient: the voltages and states that
    ngspice finds are compared with those in the sidecar, at several times and with the tolerance in the sidecar.

    The simulator runs the deck's own bytes, with the files that it includes, where that is safe.  Otherwise (control
    blocks, another dialect, includes outside the root) it runs a deck written from the circuit that resgrid read.  The
    deck is then not verified, and ``agrees`` is not True.

    Parameters
    ----------
    deck : path-like, Circuit, Netlist or OperatingPoint
        A deck's file, a circuit that was read from a deck, or a netlist without or with its solution.
    tolerance : float
        Largest accepted voltage error relative to the supply (the largest voltage difference in the circuit), and
        largest accepted error of a source current relative to the largest source current, or to ``1e-3 G V`` if that
        is more (largest conductance ``G``, supply ``V``).
    reference : OperatingPoint, optional
        Expected operating point, in place of the sidecar's voltages or of a solution by resgrid: that of the scene for
        a deck written by resgrid, that of the circuit itself for a `Circuit`; not used for a netlist.  The hash in a
        sidecar is compared in either case.
    dialect : {"auto", "ngspice", "ltspice", "xyce", "hspice", "spectre"}
        Dialect of a file without sidecar.  ``"auto"`` takes the dialect that the suffix or the text of the file
        indicates, or else ngspice; with `reference` it means ngspice.
    root : path-like, optional
        Folder that must contain all files included by a deck without sidecar; by default the deck's own folder.
    engine : {"ngspice", "eecircuit"}
        Program to run: ngspice, or its WebAssembly build ``eecircuit-engine``.
    timeout : float
        Longest run of the simulator, in seconds.

    Returns
    -------
    Agreement
        Largest errors, findings, and whether the simulated and the expected voltages agree.

    Raises
    ------
    InputError
        If the deck or its sidecar cannot be read.
    CircuitError
        If a circuit has no operating point, or cannot be written as a deck.
    ToolMissingError
        If the simulator is not installed.
    BudgetError
        If the simulator does not finish within the timeout.

    Examples
    --------
    >>> netlist = rg.compile_space(rg.build_space(rg.read_scene("examples/scenes/lesson.toml")))
    >>> written = rg.write_spice(netlist, "lesson.cir")
    >>> agreement = rg.check_deck("lesson.cir")
    >>> agreement.agrees, agreement.nodes, agreement.max_abs_error < 1e-12
    (True, 58, True)
    """
    limits = _Limits(engine, tolerance, timeout)
    if isinstance(deck, Netlist | OperatingPoint):
        op = solve(deck) if isinstance(deck, Netlist) else deck
        written = flatten(op.netlist, dialect=SIMULATED)
        simulation = limits.run(written.text.encode("ascii"), "deck", direct=False)
        return compare(expect(written, op), simulation, tolerance=tolerance)
    if isinstance(deck, Circuit):
        data = read_bytes(Path(deck.path)) if Path(deck.path).is_file() else None
        return _check_external(deck, data, reference, limits, root)
    path = Path(deck)
    data = read_bytes(path)
    memristive = read_memristive_sidecar(path)
    if memristive is not None:
        _refuse_for_memristors(reference, engine)
        return check_memristive(path, data, memristive, timeout)
    sidecar = read_sidecar(path) if sidecar_path(path).exists() else None
    if reference is None and sidecar is None:
        return _check_external(read_spice(path, dialect=dialect, root=root), data, None, limits, root)
    return _check_own(path, data, sidecar, reference, dialect, limits)


def _refuse_for_memristors(reference: OperatingPoint | None, engine: str) -> None:
    """Raise InputError, for a deck with memristors, if `reference` is not None or `engine` is not "ngspice"."""
    if reference is not None:
        raise InputError(
            "a deck with memristors is compared with the transient in its sidecar, not with an operating point; leave "
            "out reference"
        )
    if engine != SIMULATED:
        raise InputError(f"engine = {engine!r} runs operating points only; use engine = '{SIMULATED}' for memristors")


def _check_own(
    path: Path, data: bytes, sidecar: Sidecar | None, reference: OperatingPoint | None, dialect: str, limits: _Limits
) -> Agreement:
    """Return the comparison of the simulation of a deck, which resgrid wrote, with its sidecar or a scene's solution.

    `path, data`: path and content of the deck; `sidecar`: content of the sidecar, None without a sidecar (then
    `reference` is given); `reference`: solution of the scene, None to compare with the sidecar; `dialect`: name of the
    dialect of a deck without sidecar, or "auto" for ngspice; `limits`: engine, tolerance and timeout of the check.
    """
    name = dialect_named((SIMULATED if dialect == "auto" else dialect) if sidecar is None else sidecar.dialect).name
    findings = [] if sidecar is None else altered_files(data, sidecar)
    if reference is not None:
        expected = expect(flatten(reference.netlist, dialect=name), reference)
    else:
        assert sidecar is not None
        expected = sidecar.expected
    why = ""
    tiled = sidecar if sidecar is not None and sidecar.files and name == SIMULATED else None
    if name != SIMULATED:
        why = f"it is written for {name}, and only {SIMULATED} is run here"
        data = rewritten(read_spice(path, dialect=name))
    elif tiled is not None:
        data = with_parts(path, data, tiled)
    else:
        findings += inspect_deck(data, expected, limits.tolerance)
    try:
        simulation = limits.run(data, str(path), direct=bool(why))
    except InputError as error:  # a deck of resgrid holds no commands, so commands are a finding and not an exception
        simulation = SimulatorRun({}, {}, limits.engine, "not run", (str(error),))
    if tiled is not None:  # the nodes inside tile subcircuits have no expected voltage
        known = {node: volts for node, volts in simulation.voltage.items() if node in expected.voltage}
        simulation = replace(simulation, voltage=known)
    origin: Reference = "sidecar" if reference is None else "scene"
    agreement = compare(expected, simulation, tolerance=limits.tolerance, reference=origin, findings=findings)
    return unverified(agreement, why) if why else agreement


def _check_external(
    deck: Circuit,
    data: bytes | None,
    op: OperatingPoint | None,
    limits: _Limits,
    root: str | os.PathLike[str] | None,
) -> Agreement:
    """Return the comparison of the simulation of a deck that resgrid did not write with the solution by resgrid.

    If the results differ, a prediction of this difference by the portability check is added to the findings.  `deck`:
    circuit that was read from the deck; `data`: content of the deck's file, None without a file; `op`: operating point
    by resgrid, None to compute it; `limits`: engine, tolerance and timeout of the check; `root`: folder that must
    contain all included files, None for the deck's folder.
    """
    op = solve(deck.netlist()) if op is None else op
    job = runnable(deck, data, root=None if root is None else Path(root), engine=limits.engine)
    options = {"files": job.files, "place": job.place} if job.files else {}
    simulation = limits.run(job.data, deck.path, direct=True, **options)
    expected = expected_of(deck, op, as_written=not job.why)
    if job.why:
        return unverified(compare(expected, simulation, tolerance=limits.tolerance), job.why)
    agreement = compare(expected, simulation, tolerance=limits.tolerance, place_of=partial(place_of, deck))
    if agreement.agrees:
        return agreement
    prediction = next(item for item in check_portability(deck) if item.simulator == SIMULATED)
    known = [] if prediction.outcome == "right" else [f"the portability check predicts this: {prediction}"]
    return replace(agreement, findings=(*agreement.findings, *known))
