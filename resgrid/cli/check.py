"""``resgrid check``: ask an outside simulator whether it agrees."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from resgrid.cli.compile import dialect_option
from resgrid.cli.failures import NEGATIVE
from resgrid.cli.job import DECK_SUFFIXES, Chip, only_boundary, open_job, solve_chip
from resgrid.cli.options import SceneChoice, with_report, with_scene
from resgrid.cli.report import Report
from resgrid.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from resgrid.spice.agreement import Agreement

_WORDS = {"sidecar": "the sidecar", "scene": "the scene's solution", "solve": "our solution"}


@click.command("check", short_help="Ask the circuit simulator whether it agrees.")
@with_scene(metavar="SCENE|DECK")
@click.option("--deck", metavar="FILE", type=click.Path(), help="Simulate this deck, and compare it with SCENE.")
@click.option("--tolerance", metavar="T", default=1e-9, show_default=True, help="Largest error, over the supply.")
@click.option("--timeout", metavar="S", default=600.0, show_default=True, help="Time for the simulator, in seconds.")
@dialect_option
@with_report
def command(
    choice: SceneChoice, deck: str | None, tolerance: float, timeout: float, dialect: str, report: Report
) -> int:
    """Simulate a deck and compare every node.

    A DECK is compared with its sidecar DECK.json: first its hash, then the voltages. A SCENE is solved, and compared
    with the simulator's answer to its own deck, or to the one given by --deck. Exits with 1 where they disagree.
    """
    limits: dict[str, Any] = {"tolerance": tolerance, "timeout": timeout, "dialect": dialect}
    if is_deck(choice.source):
        if deck is not None:
            raise InputError(f"{choice.source} is a deck already; --deck goes with a scene")
        if choice.changes or choice.map_options:
            raise InputError(f"{choice.source} is a deck: options that change a scene do nothing to it; remove them")
        agreement = _simulated(None, choice.source, limits, report)
    else:
        job = open_job(choice, report)
        chip = solve_chip(job, report, *only_boundary(job))
        agreement = _simulated(chip, deck, limits, report)
    report.finish(agreement_data(agreement), agreement_lines(agreement))
    return 0 if agreement.agrees else NEGATIVE


def is_deck(source: str) -> bool:
    """Whether a file is a deck, by the end of its name or by the sidecar beside it."""
    path = Path(source)
    return path.suffix.lower() in DECK_SUFFIXES or (source != "-" and path.with_name(path.name + ".json").is_file())


def _simulated(chip: Chip | None, deck: str | None, limits: dict[str, Any], report: Report) -> Agreement:
    from resgrid.spice.agreement import check_deck, check_spice

    with report.stage("simulate"):
        if chip is None and deck is not None:
            return check_deck(deck, **limits)
        if chip is not None and deck is not None:
            return check_deck(deck, reference=chip.point, **limits)
        assert chip is not None
        return check_spice(chip.netlist, chip.point, **limits)


def agreement_data(agreement: Agreement) -> dict[str, Any]:
    """An agreement as ``--json`` gives it."""
    data = dataclasses.asdict(agreement)
    data["worst"] = [{"node": node, "expected": expected, "got": got} for node, expected, got in agreement.worst]
    return data


def agreement_lines(agreement: Agreement) -> Iterable[str]:
    """An agreement for people: the verdict, then what was found and where."""
    simulator = f"{agreement.simulator} {agreement.version}"
    error = agreement.max_relative_error
    largest = "" if error is None else f"; the largest error is {error:.1e} of the supply"
    if agreement.agrees:
        yield f"{simulator} agrees with {_WORDS[agreement.reference]} on all {agreement.nodes:,} nodes{largest}"
        return
    yield f"{simulator} DISAGREES with {_WORDS[agreement.reference]} ({agreement.nodes:,} nodes compared{largest})"
    for finding in agreement.findings:
        yield f"  {finding}"
