"""``resgrid resistance``: effective resistances of a scene, map, deck or network, and Circuitscape jobs."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

import resgrid as rg
from resgrid.cli.decks import is_deck, open_deck, refuse_scene_options
from resgrid.cli.options import (
    CommandInput,
    cell_indices,
    given_options,
    output_option,
    refuse_unused,
    subcommand,
    with_source,
)
from resgrid.cli.scenes import open_job, report_ignored
from resgrid.cli.terminal import compute, finish, say, stage
from resgrid.errors import InputError

_MOST_LINES = 40
"""Largest number of pairs that are printed; a file contains all pairs."""

_SECONDS = 1e-5
"""Approximate computing time per resistor of the circuit and per pair of terminals, in seconds, for the progress bar.
"""


@subcommand(
    "resistance",
    examples=(
        "resgrid resistance theirs.sp --between vdd b --between a b",
        "resgrid resistance map.yaml --goal 5,0 --boundary neumann --between -5,-4 5,0 -o resistance.csv",
    ),
)
@with_source("SCENE|DECK")
@output_option("Resistances: FILE.csv, .json or .npz; - prints CSV. Circuitscape job: folder of its files.",
               may_be_folder=True)  # fmt: skip
@click.option(
    "--between", metavar="A B", nargs=2, type=str, multiple=True,
    help="Pair of terminals; repeatable. A terminal is a place X,Y (with --cells: a cell), a node name, or several of "
    "these in quotes, separated by blanks, which an ideal wire joins.",
)  # fmt: skip
@click.option("--all", "every_pair", is_flag=True, help="All pairs of the terminals that --between names.")
@click.option("--method", type=click.Choice(["auto", "direct", "multigrid"]), default="auto", help="Solution method.")
def command(
    source: CommandInput, output: str | None, between: tuple[tuple[str, str], ...], every_pair: bool, method: str
) -> int:
    """Compute effective resistances between places of SCENE, or between nodes of DECK, in ohms.

    Independent sources are set to zero: a voltage source is a wire, a current source is open. In a scene, rails are
    such wires, and a goal is not needed; with the boundary condition neumann, obstacles are open, and the drive is left
    out. A Circuitscape configuration (.ini) in pairwise, one-to-all or all-to-one mode needs no --between: its files
    are written to the folder of -o, or to that of its key output_file. Exits with 1 if a pair is not connected.
    """
    from resgrid._internal.files import target_of
    from resgrid.io.resistances import check_resistance_file, resistance_record, terminal_names

    if given_options("threads"):
        say("ignored: --threads: resistances are computed by one thread")
    if is_circuitscape_job(source.file):
        _check_job_options(source, output, between)
        return _run_job(source, output)
    if output not in (None, "-"):
        target_of(Path(output))
    if not between:
        raise InputError(f"no pair is given: {_example(source)}")
    if output is not None:
        check_resistance_file(output)
    ignored: dict[str, Any] = {}
    if is_deck(source):
        refuse_unused(f"{source.file} is a circuit without cells", given_options("cells"))
        netlist = open_deck(source).netlist()
        pairs: list[Any] = [tuple(_names(word) for word in pair) for pair in between]
    else:
        job = open_job(source, require_goal=False, method=method)
        wiring = job.problem.wiring_without_drive()
        ignored = report_ignored(job, "circuit", wiring=wiring)
        netlist = job.compile(wiring, scaled=False)
        in_cells = bool(click.get_current_context().params["cells"])
        pairs = [tuple(_places(netlist, word, in_cells) for word in pair) for pair in between]
    seconds = 0.5 + _SECONDS * len(netlist.conductance) * len(pairs)
    if every_pair:
        terminals = list({repr(terminal): terminal for pair in pairs for terminal in pair}.values())
        work = partial(rg.effective_resistance, terminals=terminals, method=method)
    else:
        work = partial(rg.effective_resistance, pairs=pairs, method=method)
    found: rg.circuit.EffectiveResistance = compute("compute the resistances", work, netlist, seconds=seconds)
    data = {**resistance_record(found, terminal_names(found)), **ignored}
    if output is not None:
        with stage("write the resistances"):
            rg.save(found, output)
        data["file"] = output
    finish(data, _lines(data), written=output, more=True)
    return 0 if all(pair["connected"] for pair in data["pairs"]) else 1


def _example(source: CommandInput) -> str:
    """Return the remedy for a missing ``--between``, with terminals of the input, and the command that lists all names.

    `source`: scene, deck or network.
    """
    if not is_deck(source):
        return "add --between A B with two places, such as --between 1,2 5,3"
    names = [name for name in open_deck(source).node_names if " " not in name][:2]
    example = f", such as --between {' '.join(map(shlex.quote, names))}" if len(names) > 1 else ""
    dialect = f" --read-as {source.dialect}" if source.dialect != "auto" else ""
    listing = f"'resgrid solve {source.file}{dialect} -o nodes.csv' lists all names"
    return f"add --between A B with names of nodes{example}; {listing}"


def _names(word: str) -> list[str]:
    """Return the node names of a terminal, at least one; `word`: names separated by blanks."""
    if names := word.split():
        return names
    raise InputError("--between: a terminal is empty; give a node name, such as a, or a place, such as 1,2")


def _places(netlist: rg.Netlist, word: str, in_cells: bool) -> list[str | int]:
    """Return the node names or node numbers of a terminal of a scene.

    `netlist`: compiled circuit of the scene; `word`: places X,Y and node names, separated by blanks; `in_cells`:
    whether places are cell indices instead of world coordinates.
    """
    return [_node_at(netlist, part, in_cells) for part in _names(word)]


def _node_at(netlist: rg.Netlist, place: str, in_cells: bool) -> str | int:
    """Return the node number of a place ``X,Y``, or the text itself if it has another form (a node name).

    `netlist`: compiled circuit of the scene; `place`: the text; `in_cells`: whether X and Y are cell indices instead of
    world coordinates. Raises InputError for a place without a node.
    """
    from resgrid.circuit.terminals import TerminalReader

    try:
        numbers = [float(part) for part in place.split(",")]
    except ValueError:
        return place
    if netlist.lattice_map is not None:
        raise InputError(
            f"--between {place}: places need face neighbours, not lattice {netlist.lattice_map.wiring.lattice!r}; "
            "name nodes, such as n_3_4 or goal_0, or use --lattice square"
        )
    space = netlist.cells.space
    if len(numbers) != space.ndim:
        raise InputError(f"--between {place}: a place of this scene has {space.ndim} coordinates")
    cell = cell_indices("--between", numbers) if in_cells else None
    try:
        cell = tuple(space.locate(numbers).tolist()) if cell is None else cell
        return int(TerminalReader(netlist, cells=True).nodes(cell)[0])
    except InputError as error:
        raise InputError(f"--between {place}: {error}") from None


def _lines(data: dict[str, Any]) -> Iterable[str]:
    """Yield the lines of text about resistances: one line per pair, at most `_MOST_LINES`, then the error bound.

    `data`: dictionary for JSON with ``pairs`` (dictionaries of ``first``, ``second``, ``resistance`` and
    ``connected``), ``relative_error`` (bound) and ``solver``.
    """
    pairs: Sequence[dict[str, Any]] = data["pairs"]
    width = max(len(f"{pair['first']} - {pair['second']}") for pair in pairs[:_MOST_LINES])
    for pair in pairs[:_MOST_LINES]:
        ends = f"{pair['first']} - {pair['second']}"
        yield f"{ends:{width}}  " + (f"{pair['resistance']:.10g} ohm" if pair["connected"] else "not connected")
    if len(pairs) > _MOST_LINES:
        yield f"and {len(pairs) - _MOST_LINES:,} more pairs; -o FILE.csv writes all"
    yield f"relative error at most {data['relative_error']:.1e}; method: {data['solver']}"


def is_circuitscape_job(file: str) -> bool:
    """Return whether an input is a Circuitscape configuration (.ini) with another scenario than ``advanced``."""
    from resgrid.spice.networks.configurations import read_configuration

    return Path(file).suffix.lower() == ".ini" and read_configuration(file).scenario != "advanced"


def _check_job_options(source: CommandInput, output: str | None, between: tuple[tuple[str, str], ...]) -> None:
    """Raise InputError for options without effect on a Circuitscape job, and for standard output as its folder.

    `source`: the configuration; `output`: value of the option -o; `between`: pairs of --between.
    """
    from resgrid.spice.networks.configurations import is_connectivity_job

    if between and is_connectivity_job(source.file):
        raise InputError(f"{source.file}: the focal points of this job define its pairs; leave --between out")
    refuse_scene_options(source, "Circuitscape job")
    if source.dialect != "auto":
        raise InputError(f"{source.file} is a Circuitscape job, not a deck: --read-as is for decks; remove it")
    why = f"the keys of the Circuitscape job {source.file} define its pairs and circuits"
    refuse_unused(why, given_options("every_pair", "cells", "method"))
    if output == "-":
        raise InputError("-o -: the results of a Circuitscape job are several files; name a folder")


def _run_job(source: CommandInput, output: str | None) -> int:
    """Run a Circuitscape job, write its files, print its resistances, and return the exit code.

    `source`: the configuration; `output`: folder of the files, None for that of the configuration's ``output_file``.
    """
    from resgrid.spice.networks.measurements import UNCONNECTED

    work = partial(rg.spice.run_circuitscape, output=output, root=source.root)
    job: rg.spice.ConnectivityResult = compute("run the Circuitscape job", work, source.file, iterates=False)
    connected = job.resistance != UNCONNECTED
    ohms = job.resistance.astype(object)
    ohms[~connected] = None
    data = {
        "scenario": job.scenario, "points": job.points.tolist(), "resistance": ohms.tolist(),
        "connected": connected.tolist(), "files": [str(file) for file in job.files],
    }  # fmt: skip
    finish(data, _job_lines(job), written=job.files[0].parent, more=True)
    return 0 if connected.all() else 1


def _job_lines(job: rg.spice.ConnectivityResult) -> Iterable[str]:
    """Yield the lines of text for a finished Circuitscape job: its resistances, one line per pair or focal point."""
    from resgrid.spice.networks.measurements import UNCONNECTED

    yield f"{job.scenario}, {len(job.points):,} focal points or regions"
    points = job.points.tolist()
    if job.resistance.ndim == 1:
        shown = [(f"{point}", ohms) for point, ohms in zip(points, job.resistance.tolist(), strict=True)]
    else:
        shown = [
            (f"{one} - {points[place]}", float(job.resistance[number, place]))
            for number, one in enumerate(points)
            for place in range(number + 1, len(points))
        ]
    for name, ohms in shown[:_MOST_LINES]:
        yield f"  {name}  " + ("not connected" if ohms == UNCONNECTED else f"{ohms:.10g} ohm")
    if len(shown) > _MOST_LINES:
        yield f"  and {len(shown) - _MOST_LINES:,} more; the file of resistances has all"
