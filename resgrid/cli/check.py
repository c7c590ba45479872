"""``resgrid check``: ask an outside simulator whether it agrees."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from resgrid.cli.decks import (
    is_deck,
    is_network,
    open_deck,
    read_as_option,
    refuse_scene_options,
    root_option,
    solve_deck,
)
from resgrid.cli.failures import NEGATIVE, NOT_VERIFIED
from resgrid.cli.heeded import tell_unheeded
from resgrid.cli.job import Chip, compile_chip, only_boundary, open_job, solve_chip
from resgrid.cli.options import SceneChoice, with_report, with_scene
from resgrid.cli.report import Report
from resgrid.cli.rules import finding_lines, rules_data, rules_lines
from resgrid.errors import InputError, ResgridError, ToolMissingError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from resgrid.netlist import Netlist
    from resgrid.spice.check.agreement import Run
    from resgrid.spice.check.comparison import Agreement
    from resgrid.spice.parsed import ParsedDeck
    from resgrid.spice.run.forecast import Forecast

_WORDS = {"sidecar": "the sidecar", "scene": "the scene's solution", "solve": "our solution"}
_WORTH_TELLING = 10.0
TIMEOUT = 600.0
PATIENCE = 30.0
"""How long the simulation of a deck that was just written may take unasked, in seconds."""


@click.command("check", short_help="Check rules, and ask the circuit simulator whether it agrees.")
@with_scene(metavar="SCENE|DECK")
@click.option("--rules", is_flag=True, help="Check the electrical rules only; errors exit with 1.")
@click.option("--deck", metavar="FILE", type=click.Path(), help="Simulate this deck, and compare it with SCENE.")
@click.option("--tolerance", metavar="T", default=1e-9, show_default=True, help="Largest error, over the supply.")
@click.option("--timeout", metavar="S", default=TIMEOUT, show_default=True, help="Time for the simulator, in seconds.")
@click.option(
    "--engine", metavar="NAME", default="ngspice", show_default=True, help="ngspice, or eecircuit (for large decks)."
)
@read_as_option
@root_option
@with_report
def command(
    choice: SceneChoice,
    rules: bool,
    deck: str | None,
    tolerance: float,
    timeout: float,
    engine: str,
    read_as: str,
    root: str | None,
    report: Report,
) -> int:
    """Simulate a deck and compare every node.

    A DECK is compared with its sidecar DECK.json: first its hash, then the voltages; without one it is read and
    solved, and the simulator is held against that. A SCENE is solved, and compared with the simulator's answer to its
    own deck, or to the one given by --deck. Before the simulator starts, its time and memory are foretold, and it is
    not started where it would not end in time (exit code 4). Exits with 1 where they disagree, and with 5 where the
    simulator could not be given the deck itself: of another dialect, with a control block, with files from elsewhere.
    Then what was read is simulated, and that is no agreement.

    --rules checks the electrical rules instead, and says for each simulator whether it would get the answer right.
    """
    from resgrid.spice.check.agreement import Run
    from resgrid.spice.run import engine_named

    run = Run(engine, tolerance, timeout)
    engine_named(engine)
    if not 0 < tolerance < 1:
        raise InputError(f"--tolerance {tolerance}: it must lie between 0 and 1, for it is relative to the supply")
    if not 0 < timeout < float("inf"):
        raise InputError(f"--timeout {timeout}: it must be a positive number of seconds")
    told: dict[str, list[str]] = {}
    given = is_deck(choice.source)
    if given and deck is not None:
        raise InputError(f"{choice.source} is a deck already; --deck goes with a scene")
    if rules:
        return _check_rules(choice, deck, given, read_as, root, report)
    if given:
        agreement = _check_deck(choice, read_as, root, run, report)
    else:
        job = open_job(choice, report)
        told = tell_unheeded(job, "circuit", report)
        chip = solve_chip(job, report, *only_boundary(job))
        _foretell(chip.netlist, run, report)
        agreement = _simulated(chip, deck, run, report)
    report.finish(agreement_data(agreement) | told, agreement_lines(agreement))
    return _code(agreement)


def _code(agreement: Agreement) -> int:
    return NOT_VERIFIED if agreement.agrees is None else 0 if agreement.agrees else NEGATIVE


def _check_rules(
    choice: SceneChoice, deck: str | None, given: bool, read_as: str, root: str | None, report: Report
) -> int:
    from resgrid.spice.check.predictions import predict_simulators
    from resgrid.spice.check.rules import check_rules

    if deck is not None:
        raise InputError("--rules checks SCENE or DECK itself; leave --deck out")
    circuit: Netlist | ParsedDeck
    told: dict[str, list[str]] = {}
    if given:
        read = open_deck(choice, read_as, root, report)
        circuit = read if read.given is None else read.given
    else:
        job = open_job(choice, report)
        told = tell_unheeded(job, "circuit", report)
        circuit = compile_chip(job, report, *only_boundary(job))
    with report.stage("check the rules"):
        findings = check_rules(circuit)
    with report.stage("ask what simulators would make of it"):
        verdicts = predict_simulators(circuit, findings)
    report.finish(rules_data(findings, verdicts) | told, rules_lines(findings, verdicts))
    return NEGATIVE if any(finding.severity == "error" for finding in findings) else 0


def _check_deck(choice: SceneChoice, read_as: str, root: str | None, run: Run, report: Report) -> Agreement:
    """A deck with a sidecar is held against that, any other against its own solution."""
    from resgrid.spice.check.agreement import check_deck, check_read_deck
    from resgrid.spice.check.rules import check_rules
    from resgrid.spice.run.ngspice import read_deck
    from resgrid.spice.write.sidecar import sidecar_path

    refuse_scene_options(choice)
    path = Path(choice.source)
    if is_network(choice.source):
        raise InputError(
            f"{path}: no simulator reads this; make a deck of it (resgrid convert {path} -o FILE.cir) and check that"
        )
    data = read_deck(path)
    if sidecar_path(path).exists():
        _foretell(_readable(choice, read_as, root, report), run, report)
        with report.stage("simulate"):
            return check_deck(path, tolerance=run.tolerance, engine=run.engine, timeout=run.timeout)
    deck = open_deck(choice, read_as, root, report)
    findings = check_rules(deck)
    for line in finding_lines([finding for finding in findings if finding.rule != "reading"], least="warning"):
        report.say(line)
    solved = solve_deck(deck, report)
    _foretell(deck, run, report)
    with report.stage("simulate"):
        return check_read_deck(deck, solved.point, data, run, root)


def _readable(choice: SceneChoice, read_as: str, root: str | None, report: Report) -> ParsedDeck | None:
    """A deck of our own, unless it was changed so that it cannot be read: the comparison will say where."""
    try:
        return open_deck(choice, read_as, root, report)
    except ResgridError:
        return None


def _foretell(circuit: Netlist | ParsedDeck | None, run: Run, report: Report) -> None:
    """Say what the simulator will take, and refuse what will not end in time."""
    from resgrid.spice.run.forecast import costs_named, forecast_run, require_time
    from resgrid.spice.run.ngspice import ngspice_version

    if circuit is None:
        return
    version = ngspice_version() if run.engine == "ngspice" else ""
    expected: Forecast = forecast_run(circuit, costs_named(run.engine, version))
    require_time(expected, run.timeout)
    tell = report.say if expected.seconds > _WORTH_TELLING else report.detail
    tell(str(expected))


def _simulated(chip: Chip, deck: str | None, run: Run, report: Report) -> Agreement:
    from resgrid.spice.check.agreement import check_deck, check_spice

    limits: dict[str, Any] = {"tolerance": run.tolerance, "timeout": run.timeout, "engine": run.engine}
    with report.stage("simulate"):
        if deck is not None:
            return check_deck(deck, reference=chip.point, **limits)
        return check_spice(chip.netlist, chip.point, **limits)


def check_unasked(deck: Path, netlist: Netlist, wanted: bool | None, folder: Path, report: Report) -> Agreement | str:
    """The simulator's verdict on a deck that was just written, or why there is none."""
    from resgrid.spice.check.agreement import check_deck
    from resgrid.spice.run.forecast import costs_named, forecast_run
    from resgrid.spice.run.ngspice import ngspice_version

    if wanted is False:
        return "not simulated: --no-check"
    try:
        expected = forecast_run(netlist, costs_named("ngspice", ngspice_version()))
        if wanted is None and expected.seconds > PATIENCE:
            timeout = f" --timeout {3 * expected.seconds:.0f}" if 3 * expected.seconds > TIMEOUT else ""
            return f"not simulated, for {expected}; 'resgrid check {folder / deck.name}{timeout}' does it"
        with report.stage(f"simulate {deck.name}", seconds=expected.seconds):
            return check_deck(deck, timeout=max(TIMEOUT, 10 * expected.seconds))
    except ToolMissingError as error:
        if wanted:
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
    else:
        yield f"not verified: {agreement.simulator} did not run the deck itself, for {agreement.remark}"
        yield f"  of what was read of it: {verdict}" + ("; a wrong reading would not show" if read.agrees else "")
    yield from (f"  {finding}" for finding in agreement.findings)
    yield from (f"  {remark}" for remark in (read.remark,) if remark)


def _comparison(agreement: Agreement, words: str) -> str:
    simulator = f"{agreement.simulator} {agreement.version}"
    error = agreement.max_relative_error
    largest = "" if error is None else f"; the largest error is {error:.1e} of the supply"
    if agreement.agrees:
        return f"{simulator} agrees with {words} on all {agreement.nodes:,} nodes{largest}"
    return f"{simulator} DISAGREES with {words} ({agreement.nodes:,} nodes compared{largest})"
