"""``resgrid solve``: compute the operating point of the circuit of a scene, or of a deck."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

import resgrid as rg
from resgrid.cli.decks import deck_data, is_deck, open_deck, solve_deck
from resgrid.cli.option_types import Suggested
from resgrid.cli.options import CommandInput, output_option, subcommand, with_method, with_source
from resgrid.cli.scenes import open_job, ranked_summary, report_ignored, size_of, solution_summary
from resgrid.cli.terminal import finish, stage
from resgrid.errors import InputError


@subcommand(
    "solve",
    examples=("resgrid solve rooms.toml -o field.npz", "resgrid solve power_grid.sp --worst 20 -o voltages.csv"),
)
@with_source("SCENE|DECK")
@output_option("Solution: FILE.npz for a scene; FILE.csv, .json, .npz or .raw for a deck.")
@click.option(
    "--worst", metavar="N", type=click.IntRange(0), help="Deck: number of largest drops to list.  [default: 10]"
)
@click.option(
    "--raw", type=Suggested("form", "binary", "ascii"),
    help="Deck: encoding of a .raw file, binary or ascii.  [default: binary]",
)  # fmt: skip
@with_method
def command(
    source: CommandInput, output: str | None, worst: int | None, raw: str | None, method: str, ranks: int | None,
    launcher: str | None,
) -> int:  # fmt: skip
    """Solve the resistor grid of SCENE, or a resistive DECK, and print residual, power and solver.

    For a SCENE, FILE.npz has the arrays potential (1 on obstacles, 0 on goals; NaN for cells without a node), log_drop
    (the natural logarithm of 1 - potential, exact even where potential rounds to 1; -inf for cells without a path to a
    goal) and cell (0 free, 1 obstacle, 2 goal), one dimension per axis. With --method petsc it also has the array safe:
    the cells in which KCL holds to 1e-6 of their own current.

    For a DECK, the largest drops from the supply are listed, and FILE has the voltage of every node and the current and
    power of every element, by name; waveform viewers open FILE.raw.
    """
    from resgrid.io.solutions import check_solution_file, solution_record

    answer: rg.OperatingPoint | rg.Field
    about: dict[str, Any]
    given = is_deck(source)
    if not given and (worst is not None or raw is not None):
        raise InputError(f"{source.name} is not a deck: --worst and --raw are for decks; leave them out")
    if given and (method == "petsc" or ranks is not None or launcher is not None):
        raise InputError(f"{source.name} is a deck: --method petsc, --ranks and --launcher are for scenes; remove them")
    if output is not None:
        check_solution_file(output, of_space=not given)
    if raw is not None and (output is None or Path(output).suffix.lower() != ".raw"):
        raise InputError(f"--raw {raw}: the encoding applies to a .raw file; add -o FILE.raw, or leave --raw out")
    if given:
        deck = open_deck(source)
        answer = op = solve_deck(deck, method, source.threads)
        about, title = deck_data(deck), deck.title or deck.path
        data = {**about, **solution_record(op, 10 if worst is None else worst)}
        lines = _deck_lines(data)
    else:
        job = open_job(source, method=method, ranks=ranks, launcher=launcher)
        ignored = report_ignored(job, "circuit")
        name, wiring = job.problem.only_wiring()
        about, title = {}, job.scene.title
        if method == "petsc":
            ranked = job.solve_ranked(wiring)
            answer, data = ranked.field, ranked_summary(name, ranked) | ignored
            lines = _ranked_lines(data, job.space.shape)
        else:
            answer = op = job.solve(wiring)
            data = solution_summary(name, op, job.space) | ignored
            lines = _scene_lines(data, job.space.shape)
    if output is not None:
        with stage("write the solution"):
            rg.save(answer, output, title=title, form=raw or "binary", about=about)
        data["file"] = output
    finish(data, lines, written=output, more=True)
    return 0


def _scene_lines(data: dict[str, Any], shape: tuple[int, ...]) -> Iterable[str]:
    yield f"{data['chip']} chip of {size_of(shape)} cells, {data['free_cells']:,} free"
    yield f"  nodes               {data['nodes']:,}"
    yield f"  resistors           {data['resistors']:,}"
    yield f"  unreachable cells   {data['unreachable_cells']:,}"
    yield f"  KCL residual        {data['kcl_residual']:.1e} of the current through the node"
    if data["entry_error"] is not None:
        yield f"  relative error      at most {data['entry_error']:.1e} at every node, as bounded by KCL"
    yield f"  power               {data['power']:.6g} W"
    threads = f", {data['threads']} threads" if data["threads"] > 1 else ""
    yield f"  solver              {data['solver']}{threads}"


def _ranked_lines(data: dict[str, Any], shape: tuple[int, ...]) -> Iterable[str]:
    safe, free = data["direction_safe_cells"], data["free_cells"] - data["unreachable_cells"]
    peaks = ", ".join(f"{peak / 2**30:.3g}" for peak in data["peak_bytes"])
    yield f"{data['chip']} chip of {size_of(shape)} cells, {data['free_cells']:,} free"
    yield f"  unreachable cells   {data['unreachable_cells']:,}"
    yield f"  direction-safe      {safe:,} of {free:,} cells connected with a goal ({safe / max(free, 1):.2%})"
    yield f"  solver              {data['solver']}, {data['ranks']} ranks, {data['iterations']} iterations"
    yield f"  residual            {data['residual']:.1e} of the right-hand side's norm"
    yield f"  memory              {peaks} GiB, peak of every rank"


def _deck_lines(data: dict[str, Any]) -> Iterable[str]:
    """Yield the lines of text for a solved deck: counts, residual, power and largest drops from the supply.

    `data`: dictionary for JSON with the description of the deck (`deck_data`) and the solution (`solution_record`).
    """
    from resgrid.spice.circuit import some

    yield f"{data['title'] or data['source']} ({data['dialect']})"
    yield f"  nodes               {data['nodes']:,}"
    yield (
        f"  elements            {data['resistors']:,} resistors, {data['voltage_sources']:,} voltage sources, "
        f"{data['current_sources']:,} current sources, {data['capacitors']:,} capacitors"
    )
    yield f"  KCL residual        {data['kcl_residual']:.1e} of the current through the node"
    delivered = data["power_delivered"]
    undetermined = "; delivered in loops of sources: undetermined"
    supplied = f", {delivered:.6g} W delivered" if math.isfinite(delivered) else undetermined
    yield f"  power               {data['power']:.6g} W dissipated{supplied}"
    if data["floating_nodes"]:
        yield f"  floating            {some(data['floating_nodes'], len(data['floating_nodes']))}: no voltage"
    yield f"  solver              {data['solver']}"
    worst = data["worst_drops"]
    if worst:
        width = max(len("worst drops"), *(len(row["node"]) for row in worst))
        yield f"  {'worst drops':{width}}  {'voltage':>14}  {'supply':>9}  {'drop':>12}"
        for row in worst:
            yield f"  {row['node']:{width}}  {row['voltage']:12.9g} V  {row['supply']:7.6g} V  {row['drop']:10.6g} V"
