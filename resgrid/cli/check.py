"""``resgrid check``: ask an outside simulator whether it agrees."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import resgrid as rg
from resgrid.cli.decks import is_deck, open_deck, refuse_scene_options, solve_deck
from resgrid.cli.options import POSITIVE, CommandInput, Suggested, share, verb, with_source
from resgrid.cli.scenes import open_job, report_ignored
from resgrid.cli.terminal import NEGATIVE, NOT_VERIFIED, counted, detail, finish, say, stage
from resgrid.errors import InputError, ResgridError, ToolMissingError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from resgrid.spice.check.agreement import Agreement
    from resgrid.spice.check.portability import Prediction
    from resgrid.spice.circuit import Circuit
    from resgrid.spice.findings import Violation

_WORDS = {"sidecar": "the sidecar", "scene": "the scene's solution", "solve": "our solution"}
_LONG = 10.0
TIMEOUT = 600.0
PATIENCE = 30.0
"""How long the simulation of a deck that was just written may take unasked, in seconds."""


@verb(
    "check",
    examples=("resgrid check rooms.cir", "resgrid check rooms.toml --deck ours.cir", "resgrid check --rules theirs.sp"),
)
@with_source("SCENE|DECK")
@click.option("--rules", is_flag=True, help="Check the electrical rules only; errors exit with 1.")
@click.option("--deck", metavar="FILE", type=click.Path(), help="Simulate this deck, and compare it with SCENE.")
@click.option(
    "--tolerance",
    metavar="T",
    type=share(1),
    default=1e-9,
    help="Largest error, over the supply.",
)
@click.option("--timeout", metavar="S", type=POSITIVE, default=TIMEOUT, help="Time for the simulator, in seconds.")
@click.option(
    "--engine", type=Suggested("name", "ngspice", "eecircuit"), default="ngspice",
    help="ngspice, or eecircuit (for large decks).",
)  # fmt: skip
def command(source: CommandInput, rules: bool, deck: str | None, tolerance: float, timeout: float, engine: str) -> int:
    """Simulate a deck and compare every node.

    A DECK is compared with its sidecar DECK.json: first its hash, then the voltages; without one it is read and
    solved, and the simulator is held against that. A SCENE is solved, and compared with the simulator's answer to its
    own deck, or to the one given by --deck. Before the simulator starts, its time and memory are estimated, and it is
    not started where it would not end in time (exit code 4). Exits with 1 where they disagree, and with 5 where the
    simulator could not be given the deck itself: of another dialect, with a control block, with files from elsewhere.
    Then what was read is simulated, and that is no agreement.

    --rules checks the electrical rules instead, and says for each simulator whether it would get the answer right: the
    file of a DECK is read by the rules of every simulator, and text that stops one is reported.
    """
    from resgrid.spice.run import engine_named

    engine_named(engine)
    limits = {"engine": engine, "tolerance": tolerance, "timeout": timeout}
    given = is_deck(source)
    if given and source.file == "-" and not rules:
        raise InputError("a simulator runs a deck that is a file: write it to one, or ask for --rules alone")
    if given and deck is not None:
        raise InputError(f"{source.file} is a deck already; --deck goes with a scene")
    if rules and deck is not None:
        raise InputError("--rules checks SCENE or DECK itself; leave --deck out")
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
    with stage("check the rules"):
        violations = rg.check_erc(circuit)
    with stage("ask what simulators would make of it"):
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
    """A scene is held against its own deck, or against one that is given."""
    job = open_job(source)
    ignored = report_ignored(job, "circuit")
    op = job.solve(job.problem.only_wiring()[1])
    _forecast(op.netlist, limits)
    with stage("simulate"):
        return rg.check_deck(deck or op, reference=op if deck else None, **limits), ignored


def _check_deck(source: CommandInput, limits: dict[str, Any]) -> Agreement:
    """A deck with a sidecar is held against that, any other against its own solution."""
    from resgrid.spice.read.deck import is_network
    from resgrid.spice.write.sidecar import sidecar_path

    refuse_scene_options(source)
    path = Path(source.file)
    if is_network(source.file):
        raise InputError(
            f"{path}: no simulator reads this; make a deck of it (resgrid convert {path} -o FILE.cir) and check that"
        )
    if sidecar_path(path).exists():
        try:
            written = open_deck(source)
        except ResgridError:  # it was changed: the comparison says where
            written = None
        if written is not None:
            _forecast(written, limits)
        with stage("simulate"):
            return rg.check_deck(path, **limits)
    deck = open_deck(source, names=False)
    violations = [violation for violation in rg.check_erc(deck) if violation.rule != "reading"]
    for violation in violations:
        if violation.severity != "info":
            say(f"  {violation}")
    op = solve_deck(deck)
    _forecast(deck, limits)
    with stage("simulate"):
        return rg.check_deck(deck, reference=op, root=source.root, **limits)


def _forecast(circuit: rg.Netlist | Circuit, limits: dict[str, Any]) -> None:
    """Say what the simulator will take, and refuse what will not end in time."""
    from resgrid.spice.run.cost_estimate import forecast, require_time
    from resgrid.spice.run.ngspice import ngspice_version

    version = ngspice_version() if limits["engine"] == "ngspice" else ""
    expected = forecast(circuit, limits["engine"], version)
    require_time(expected, limits["timeout"])
    (say if expected.seconds > _LONG else detail)(str(expected))


def check_written(deck: Path, netlist: rg.Netlist, asked: bool | None, folder: Path) -> Agreement | str:
    """The simulator's verdict on a deck that was just written, or why there is none."""
    from resgrid.spice.run.cost_estimate import forecast
    from resgrid.spice.run.ngspice import ngspice_version

    if asked is False:
        return "not simulated: --no-check"
    try:
        expected = forecast(netlist, version=ngspice_version())
        if asked is None and expected.seconds > PATIENCE:
            timeout = f" --timeout {3 * expected.seconds:.0f}" if 3 * expected.seconds > TIMEOUT else ""
            return f"not simulated, for {expected}; 'resgrid check {folder / deck.name}{timeout}' does it"
        with stage(f"simulate {deck.name}", seconds=expected.seconds):
            return rg.check_deck(deck, timeout=max(TIMEOUT, 10 * expected.seconds))
    except ToolMissingError as error:
        if asked:
            raise
        return f"not simulated: {error}"


def agreement_data(agreement: Agreement) -> dict[str, Any]:
    """An agreement as ``--json`` gives it."""
    data = dataclasses.asdict(agreement)
    data["worst"] = [{"node": node, "expected": expected, "got": got} for node, expected, got in agreement.worst]
    data["as_read"] = None if agreement.as_read is None else agreement_data(agreement.as_read)
    return data


def agreement_lines(agreement: Agreement) -> Iterable[str]:
    """An agreement for people: the verdict, then what was found and where."""
    read = agreement.as_read or agreement
    verdict = _comparison(read, _WORDS[agreement.reference])
    if agreement.verified:
        yield verdict
    elif agreement.as_read is None:
        yield f"not verified: {agreement.remark}"
    else:
        yield f"not verified: {agreement.simulator} did not run the deck itself, for {agreement.remark}"
        yield f"  of what was read of it: {verdict}" + ("; a wrong reading would not show" if read.agrees else "")
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
    yield "will your simulator get it right?"
    yield from (f"  {prediction}" for prediction in predictions)
