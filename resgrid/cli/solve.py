"""``resgrid solve``: the operating point of a scene's chip."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from resgrid.cli.decks import (
    deck_data,
    is_deck,
    open_deck,
    read_as_option,
    root_option,
    solution_data as deck_solution_data,
    solution_lines as deck_solution_lines,
    solve_deck,
)
from resgrid.cli.heeded import tell_unheeded
from resgrid.cli.job import only_boundary, open_job, size_of, solution_summary, solve_chip
from resgrid.cli.options import SceneChoice, output_option, with_report, with_scene
from resgrid.cli.output import emit_file
from resgrid.cli.report import Report
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.nodal.operating_point import OperatingPoint


@click.command("solve", short_help="Solve a scene's resistor grid, or any resistive deck.")
@with_scene(metavar="SCENE|DECK")
@output_option("Write the solution: a scene's to FILE.npz, a deck's to FILE.csv, .json, .npz or .raw.")
@click.option("--worst", metavar="N", default=10, show_default=True, help="Deck: how many of the worst drops to list.")
@click.option(
    "--raw", metavar="FORM", default="binary", show_default=True, help="Deck: a .raw file is binary or ascii."
)
@read_as_option
@root_option
@with_report
def command(
    choice: SceneChoice,
    output: str | None,
    worst: int,
    raw: str,
    read_as: str,
    root: str | None,
    report: Report,
) -> int:
    """Solve the resistor grid of SCENE, or a resistive DECK, and tell what its meters read.

    Of a SCENE, FILE.npz holds potential (1 on obstacles, 0 on goals; NaN where there is no node), log_drop (the
    natural logarithm of 1 - potential, right where float64 rounds; -inf where nothing arrives) and cell (0 free,
    1 obstacle, 2 goal), one dimension per axis.

    Of a DECK, the worst drops from the supply are listed, and FILE holds the voltage of every node and the current and
    power of every element, by their names; FILE.raw opens in a waveform viewer.
    """
    if is_deck(choice.source):
        return _solve_deck(choice, output, (worst, raw), (read_as, root), report)
    return _solve_scene(choice, output, report)


def _solve_deck(
    choice: SceneChoice, output: str | None, told: tuple[int, str], reading: tuple[str, str | None], report: Report
) -> int:
    from resgrid.cli.deck_files import solution_writer

    if told[0] < 0:
        raise InputError(f"--worst {told[0]}: it must be 0 or more")
    if output == "-" and report.json:
        raise InputError("-o - and --json both want standard output; write the solution to a file")
    suffix, write = solution_writer(output or "-", told[1])
    solved = solve_deck(open_deck(choice, *reading, report), report)
    data = {**deck_data(solved.deck), **deck_solution_data(solved, told[0])}
    if output is not None:
        with report.stage("write the solution"):
            emit_file(output, suffix, lambda path: write(solved, path))
        report.say(f"wrote {output}") if output != "-" else None
        data["file"] = output
    if output != "-":
        report.finish(data, deck_solution_lines(data))
    return 0


def _solve_scene(choice: SceneChoice, output: str | None, report: Report) -> int:
    _check_target(output, report)
    job = open_job(choice, report)
    told = tell_unheeded(job, "circuit", report)
    chip = solve_chip(job, report, *only_boundary(job))
    data = solution_summary(chip, job.space) | told
    if output is not None:
        emit_file(output, ".npz", lambda path: write_field(path, chip.point))
        report.say(f"wrote {output}") if output != "-" else None
        data["file"] = output
    if output != "-":
        report.finish(data, _lines(data, job.space.shape))
    return 0


def write_field(path: Path, point: OperatingPoint) -> None:
    """Write a scene's operating point as NumPy arrays: ``potential``, ``cell`` and, where it exists, ``log_drop``."""
    import numpy as np

    cell_map = point.netlist.cell_map
    if cell_map is None or point.potential is None:
        raise InputError("this circuit has more rails or drives than a potential is defined for; write it as a deck")
    per_cell = {"potential": point.potential, "log_drop": point.log_drop}
    arrays: dict[str, Any] = {
        name: np.where(cell_map.node >= 0, value[cell_map.node], np.nan)
        for name, value in per_cell.items()
        if value is not None
    }
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays, cell=cell_map.space.cell)


def _check_target(output: str | None, report: Report) -> None:
    if output is None:
        return
    if output != "-" and Path(output).suffix.lower() != ".npz":
        raise InputError(f"-o {output}: a field is written as .npz; name the file so")
    if output == "-" and report.json:
        raise InputError("-o - and --json both want standard output; write the field to a file")


def _lines(data: dict[str, Any], shape: tuple[int, ...]) -> list[str]:
    proved = data["entry_error"]
    return [
        f"{data['chip']} chip of {size_of(shape)} cells, {data['free_cells']:,} free",
        f"  nodes               {data['nodes']:,}",
        f"  resistors           {data['resistors']:,}",
        f"  unreachable cells   {data['unreachable_cells']:,}",
        f"  KCL residual        {data['kcl_residual']:.1e} of the current through the node",
        *([] if proved is None else [f"  every entry right   to {proved:.1e} of itself, as KCL proves"]),
        f"  power               {data['power']:.6g} W",
        f"  solver              {data['solver']}",
    ]
