"""``resgrid check``: compare decks, boards and layouts with outside programs, and check electrical rules.

The comparison of a new deck with its simulation, and the report on it, also serve other subcommands.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import resgrid as rg
from resgrid.cli.decks import is_deck, open_deck, refuse_scene_options, solve_deck
from resgrid.cli.hardware_checks import check_hardware, is_hardware
from resgrid.cli.option_types import Suggested, fraction_below
from resgrid.cli.options import POSITIVE, CommandInput, given_options, refuse_unused, subcommand, with_source
from resgrid.cli.scenes import open_job, report_ignored
from resgrid.cli.terminal import NEGATIVE, NOT_VERIFIED, counted, detail, finish, say, stage
from resgrid.errors import InputError, ResgridError, ToolMissingError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from resgrid.spice.check.agreement import Agreement
    from resgrid.spice.check.portability import Prediction
    from resgrid.spice.circuit import Circuit
    from resgrid.spice.findings import Violation

_REFERENCES = {"sidecar": "the sidecar", "scene": "the scene's solution", "solve": "resgrid's solution"}
_LONG_SIMULATION = 10.0
"""Estimated duration of a simulation, in seconds, above which the estimate is printed even without ``--verbose``."""

TIMEOUT = 600.0
"""Default limit of the duration of a simulation, in seconds; a longer simulation is stopped."""

MAX_AUTOMATIC_SECONDS = 30.0
"""Largest estimated duration, in seconds, of a simulation that runs without being requested by ``--check``."""


@subcommand(
    "check",
    examples=(
        "resgrid check rooms.cir",
        "resgrid check rooms.toml --deck ours.cir",
        "resgrid check --rules theirs.sp",
        "resgrid check board/grid.kicad_pcb",
    ),
)
@with_source("SCENE|DECK|BOARD")
@click.option("--rules", is_flag=True, help="Only check the electrical rules; exit with 1 on errors.")
@click.option("--deck", metavar="FILE", type=click.Path(), help="Simulate this deck and compare it with SCENE.")
@click.option(
    "--tolerance",
    metavar="T",
    type=fraction_below(1),
    default=1e-9,
    help="Largest voltage error, as a fraction of the supply.",
)
@click.option(
    "--timeout", metavar="S", type=POSITIVE, default=TIMEOUT, help="Time limit of each outside program, in seconds."
)
@click.option(
    "--engine", type=Suggested("name", "ngspice", "eecircuit"), default="ngspice",
    help="Simulator: ngspice, or eecircuit (for large decks).",
)  # fmt: skip
def command(source: CommandInput, rules: bool, deck: str | None, tolerance: float, timeout: float, engine: str) -> int:
    """Compare a deck, a board or a layout with outside programs.

    For a DECK with a sidecar DECK.json, the reference is the sidecar: its hash of the deck, then its voltages. For
    other decks, the reference is resgrid's solution. A SCENE is solved and compared with the simulation of its own
    deck, or of the deck given by --deck. The time and memory of the simulation are estimated first; exits with 4 if it
    would not end within the time limit. Exits with 1 on disagreement. Exits with 5 if the simulator cannot run the deck
    itself (another dialect, a control block, files from other folders); the circuit as read by resgrid is simulated
    instead, which does not verify the deck.

    For a BOARD (a KiCad board, its project or folder) or a layout (.gds, .oas), kicad-cli or klayout extracts the
    circuit, which is compared with the record beside the file: parts, nets, values and voltages. Every difference is
    listed with its place. Exits with 5 if the program is not installed.

    --rules checks the electrical rules instead, and predicts for each simulator whether it would solve the circuit
    correctly. The file of a DECK is read by the rules of every simulator, and text that a simulator rejects is
    reported.
    """
    from resgrid.spice.run import engine_named

    engine_named(engine)
    limits = {"engine": engine, "tolerance": tolerance, "timeout": timeout}
    if is_hardware(source.file):
        if rules or deck is not None:
            raise InputError(
                f"{source.name} is a board or layout, and --rules and --deck check scenes and decks; leave them out"
            )
        refuse_unused(f"{source.name} is a board or layout, which no simulator runs", given_options("engine"))
        return check_hardware(source, tolerance, timeout)
    if rules:
        refuse_unused("--rules runs no simulator", given_options("tolerance", "timeout", "engine"))
    given = is_deck(source)
    if given and source.file == "-" and not rules:
        raise InputError("a simulator cannot run a deck from standard input: write it to a file, or use --rules")
    if given and deck is not None:
        raise InputError(f"{source.name} is a deck, and --deck needs a scene to compare with; leave --deck out")
    if rules and deck is not None:
        raise InputError("--rules checks SCENE or DECK, not the deck of --deck; leave --deck out")
    if rules:
        return _check_rules(source, given)
    if given:
        agreement = _check_deck(source, limits)
        finish(agreement_data(agreement), agreement_lines(agreement))
    else:
        agreement, ignored = _check_scene(source, deck, limits)
        finish(agreement_data(agreement) | ignored, agreement_lines(agreement))
    return NOT_VERIFIED if agreement.agrees is None else 0 if agreement.agrees else NEGATIVE


def _check_rules(source: CommandInput, given: bool) -> int:
    circuit: rg.Netlist | Circuit
    ignored: dict[str, list[str]] = {}
    if given:
        circuit = open_deck(source, names=False)
    else:
        job = open_job(source)
        ignored = report_ignored(job, "circuit")
        circuit = job.compile(job.problem.only_wiring()[1], scaled=False)
    with stage("check the electrical rules"):
        violations = rg.check_erc(circuit)
    with stage("predict the answers of simulators"):
        predictions = rg.spice.check_portability(circuit, violations)
    passes = not any(violation.severity == "error" for violation in violations)
    data = {
        "passes": passes,
        "findings": [dataclasses.asdict(violation) for violation in violations],
        "simulators": [dataclasses.asdict(prediction) for prediction in predictions],
    }
    finish(data | ignored, _rules_lines(violations, predictions))
    return 0 if passes else NEGATIVE


def _check_scene(
    source: CommandInput, deck: str | None, limits: dict[str, Any]
) -> tuple[Agreement, dict[str, list[str]]]:
    """Return the comparison of a scene's solution with a simulation, and the ignored keys of the scene, for JSON.

    The dict has the single key ``ignored`` with the list of scene keys without effect, such as ``k``.  `source`: the
    scene; `deck`: name of the deck to simulate, None for the deck of the scene itself; `limits`: the keywords
    ``engine``, ``tolerance`` and ``timeout`` (seconds) of `rg.check_deck`.
    """
    job = open_job(source)
    ignored = report_ignored(job, "circuit")
    op = job.solve(job.problem.only_wiring()[1])
    _report_cost(op.netlist, limits)
    with stage("simulate"):
        return rg.check_deck(deck or op, reference=op if deck else None, **limits), ignored


def _check_deck(source: CommandInput, limits: dict[str, Any]) -> Agreement:
    """Return the comparison of a deck's simulation with its sidecar, or, without a sidecar, with resgrid's solution.

    `limits`: the keywords ``engine``, ``tolerance`` and ``timeout`` (seconds) of `rg.check_deck`.
    """
    from resgrid.spice.read.deck import is_network
    from resgrid.spice.write.sidecar import sidecar_path

    refuse_scene_options(source)
    path = Path(source.file)
    if path.suffix == ".json" and path.with_suffix("").is_file():
        raise InputError(f"{path} is the sidecar of a deck; check the deck: resgrid check {path.with_suffix('')}")
    if is_network(source.file, source.dialect):
        raise InputError(
            f"{path}: simulators cannot read this format; convert it to a deck (resgrid convert {path} -o FILE.cir) "
            "and check the deck"
        )
    if sidecar_path(path).exists():
        why = f"{path} has a sidecar, {sidecar_path(path)}, which states how to read the deck"
        refuse_unused(why, given_options("read_as", "root"))
        try:
            written = open_deck(source)
        except ResgridError:  # the deck was changed; the comparison reports where
            written = None
        if written is not None:
            _report_cost(written, limits)
        with stage("simulate"):
            return rg.check_deck(path, **limits)
    deck = open_deck(source, names=False)
    violations = [violation for violation in rg.check_erc(deck) if violation.rule != "reading"]
    _say_violations(violations, "warning")
    op = solve_deck(deck, threads=source.threads)  # the message of a failure lists the errors
    _say_violations(violations, "error")
    _report_cost(deck, limits)
    with stage("simulate"):
        return rg.check_deck(deck, reference=op, root=source.root, **limits)


def _say_violations(violations: Sequence[Violation], severity: str) -> None:
    """Print only the violations of electrical rules whose severity equals `severity`, "warning" or "error"."""
    for violation in violations:
        if violation.severity == severity:
            say(f"  {violation}")


def _report_cost(circuit: rg.Netlist | Circuit, limits: dict[str, Any]) -> None:
    """Print the estimated time and memory of a simulation; raise BudgetError if the time exceeds the limit.

    An estimate of at most 10 s is printed only with the option ``--verbose``.  `circuit`: the simulated circuit;
    `limits`: keywords of `rg.check_deck` with ``engine`` and ``timeout`` (seconds).
    """
    from resgrid.spice.run.cost_estimate import forecast, require_time
    from resgrid.spice.run.ngspice import ngspice_version

    version = ngspice_version() if limits["engine"] == "ngspice" else ""
    expected = forecast(circuit, limits["engine"], version)
    require_time(expected, limits["timeout"])
    (say if expected.seconds > _LONG_SIMULATION else detail)(str(expected))


def check_written(deck: Path, netlist: rg.Netlist, asked: bool | None, folder: Path) -> Agreement | str:
    """Return the comparison of a new deck with its simulation, or the reason, as text, why the deck was not simulated.

    `deck`: file of the deck; `netlist`: circuit of the deck, for the estimate of the time; `asked`: True for the option
    ``--check``, False for ``--no-check``, None without these options; `folder`: final folder of the deck, for messages.
    Without these options, the deck is simulated if ngspice is installed and needs at most 30 s by the estimate.  With
    ``--check``, a missing ngspice raises ToolMissingError.
    """
    from resgrid.spice.run.cost_estimate import forecast
    from resgrid.spice.run.ngspice import ngspice_version

    if asked is False:
        return "not simulated: --no-check"
    try:
        expected = forecast(netlist, version=ngspice_version())
        if asked is None and expected.seconds > MAX_AUTOMATIC_SECONDS:
            timeout = f" --timeout {3 * expected.seconds:.0f}" if 3 * expected.seconds > TIMEOUT else ""
            return f"not simulated, because {expected}; run 'resgrid check {folder / deck.name}{timeout}'"
        with stage(f"simulate {deck.name}", seconds=expected.seconds):
            return rg.check_deck(deck, timeout=max(TIMEOUT, 10 * expected.seconds))
    except ToolMissingError as error:
        if asked:
            raise
        return f"not simulated: {error}"


def agreement_data(agreement: Agreement) -> dict[str, Any]:
    """Return the comparison of a deck with its simulation as a dictionary for JSON.

    The keys are the fields of `Agreement`. ``worst`` is a list of dictionaries with the keys ``node``, ``expected`` and
    ``got`` (both in volts). If the simulator did not run the deck itself, ``as_read`` holds the comparison for the
    circuit that resgrid reads from the deck, with all of these keys; otherwise it is None.
    """
    data = dataclasses.asdict(agreement)
    data["worst"] = [{"node": node, "expected": expected, "got": got} for node, expected, got in agreement.worst]
    data["as_read"] = None if agreement.as_read is None else agreement_data(agreement.as_read)
    return data


def agreement_lines(agreement: Agreement) -> Iterable[str]:
    """Yield the lines of text for a comparison with a simulation: the verdict, then findings and the remark."""
    read = agreement.as_read or agreement
    verdict = _comparison(read, _REFERENCES[agreement.reference])
    if agreement.verified:
        yield verdict
    elif agreement.as_read is None:
        yield f"not verified: {agreement.remark}"
    else:
        yield f"not verified: {agreement.simulator} did not run the deck itself: {agreement.remark}"
        yield f"  the circuit as read: {verdict}" + ("; errors of reading would not show" if read.agrees else "")
    yield from (f"  {finding}" for finding in agreement.findings)
    yield from (f"  {remark}" for remark in (read.remark,) if remark and read.verified)


def _comparison(agreement: Agreement, words: str) -> str:
    simulator = f"{agreement.simulator} {agreement.version}"
    error = agreement.max_relative_error
    largest = "" if error is None else f"; the largest error is {error:.1e} of the supply"
    if agreement.agrees:
        return f"{simulator} agrees with {words} on all {agreement.nodes:,} nodes{largest}"
    return f"{simulator} DISAGREES with {words} ({counted(agreement.nodes, 'node')} compared{largest})"


def _rules_lines(violations: Sequence[Violation], predictions: Sequence[Prediction]) -> Iterable[str]:
    nouns = {"error": "error", "warning": "warning", "info": "remark"}
    counts = (counted(sum(v.severity == severity for v in violations), noun) for severity, noun in nouns.items())
    yield f"electrical rules: {', '.join(counts)}"
    yield from (f"  {violation}" for violation in violations)
    yield "expected behaviour of simulators"
    yield from (f"  {prediction}" for prediction in predictions)
