"""``resgrid board``: write a printed circuit board of a scene as a KiCad project, with instructions."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import resgrid as rg
from resgrid._internal.files import SUMMARY, whole_folder
from resgrid.chip.figures_of_merit import formatted
from resgrid.cli.options import POSITIVE, CommandInput, folder_of, output_option, subcommand, with_source
from resgrid.cli.scenes import Job, open_job, several_k, size_of
from resgrid.cli.terminal import finish, say, stage
from resgrid.errors import InputError, ToolMissingError

if TYPE_CHECKING:
    from resgrid.hardware.board_circuit import Kind
    from resgrid.hardware.tools import KicadCli


@subcommand(
    "board",
    examples=(
        "resgrid board lesson.toml -o class",
        "resgrid board lesson.toml --kind jumpers --resistance 22k -o class",
        "resgrid board lesson.toml --boundary neumann --drive start --start 0.5,6.5 --no-kicad -o start",
    ),
)
@with_source()
@output_option("Folder for the board.  [default: out/SCENE_board]", of_folder=True)
@click.option(
    "--kind", type=click.Choice(("fixed", "jumpers")), default="fixed",
    help="A board for this scene (fixed), or one for every scene of its size, with solder bridges (jumpers).",
)  # fmt: skip
@click.option(
    "--pitch", metavar="MM", type=POSITIVE, default=6.35,
    help="Distance of neighbouring cells in millimetres, at least 5.08 (fixed) or 6.35 (jumpers).",
)  # fmt: skip
@click.option(
    "--tolerance", metavar="PERCENT", default="1 %", help="Tolerance of the resistors, such as '1 %' or 0.01."
)
@click.option(
    "--kicad/--no-kicad", "asked", default=None,
    help="Let kicad-cli write the files for a manufacturer, or not.  [default: if it is installed]",
)  # fmt: skip
def command(
    source: CommandInput, output: str | None, kind: Kind, pitch: float, tolerance: str, asked: bool | None
) -> int:
    """Write a printed circuit board that realises the resistor grid of SCENE.

    The folder contains a KiCad 9 project (schematic and routed board), a bill of materials, the expected voltage of
    every test pad, a README for teachers with the predicted yield, and for boards with jumpers the plan of solder
    bridges. If kicad-cli is installed, the folder also contains Gerber and drill files, pictures and the printed
    schematic. The same scene gives the same project. 'resgrid check' verifies the board.

    Resistors have values of the E96 series. The scene needs two axes that are not periodic, and
    obstacles on a rail (dirichlet or wall) or one driven start (neumann with --drive start).
    """
    from resgrid.io.tables import json_text

    folder = folder_of(output, source, "_board")
    fraction = _tolerance(tolerance)
    kicad = _kicad(asked)
    with whole_folder(folder) as work:
        job = open_job(source)
        ignored = _report_ignored(job)
        with stage("build the board"):
            board = rg.hardware.build_board(job.scene, kind=kind, pitch=pitch, tolerance=fraction, space=job.space)
        files = _write(board, work, kicad)
        data = {**_summary(board, job), "files": files, "kicad": None if kicad is None else kicad.version, **ignored}
        (work / SUMMARY).write_text(json_text(data) + "\n", encoding="utf-8")
    finish({"folder": folder, **data}, _lines(data, folder))
    return 0


def _tolerance(text: str) -> float:
    """Return the tolerance in the text of the option ``--tolerance`` as a fraction, such as 0.01 for ``"1 %"``.

    The text is a percentage with the sign ``%`` (``"1 %"``, ``"1%"``), or a fraction without it (``"0.01"``, also with
    an SI prefix: ``"10m"``). Raises InputError for other texts, and unless the fraction is above 0 and at most 0.5:
    ``"1"`` means 100 % and is refused.
    """
    from resgrid.scene.quantities import parse_fraction

    try:
        value = parse_fraction(text)
    except InputError as error:
        raise InputError(f"--tolerance {text}: {error}") from None
    if not 0 < value <= 0.5:
        raise InputError(f"--tolerance {text}: give a tolerance above 0 and up to 50 %, such as '1 %'")
    return value


def _kicad(asked: bool | None) -> KicadCli | None:
    """Return kicad-cli; None if it is excluded, or neither installed nor demanded.

    `asked`: True if kicad-cli is demanded, False if it is excluded, None to use it if it is installed. Raises
    ToolMissingError if it is demanded and not installed; otherwise a message states how to get it.
    """
    from resgrid.hardware.tools import find_kicad

    if asked is False:
        return None
    try:
        return find_kicad()
    except ToolMissingError as error:
        if asked:
            raise
        say(f"no Gerber files: {error}")
        return None


def _report_ignored(job: Job) -> dict[str, list[str]]:
    """Print the keys of the scene's ``[chip]`` table that a board ignores; return ``{"ignored": keys}`` for JSON.

    Raises InputError for a scene with several weights k, because a board is one circuit.
    """
    from resgrid.chip.build import keys_not_held

    keys = [f"chip.{key}" for key in keys_not_held(job.scene.chip, "grid") if not key.startswith("readout.")]
    if keys:
        say(f"ignored: {', '.join(keys)}: a board has resistors of the E96 series and no other effects of a chip")
    if len(several_k(job.scene)) > 1:
        raise InputError(
            f"k = {', '.join(f'{k:g}' for k in job.scene.k)}: a board is one circuit; choose it with "
            "--boundary dirichlet, or with --boundary neumann --drive start"
        )
    return {"ignored": keys}


def _write(board: rg.hardware.Board, work: Path, kicad: KicadCli | None) -> dict[str, str]:
    """Write all files except the summary into the folder `work`; return descriptions by file name.

    `kicad`: kicad-cli, which writes the files for a manufacturer; None: these files are not written.
    """
    from resgrid.hardware.board_files import described, manufacture, write_board
    from resgrid.plot.figures import save_figure
    from resgrid.plot.pictures import draw

    with stage("write the project"):
        names = write_board(board, work, manufactured=kicad is not None)
    with stage("draw the plan"):
        plan = "jumper_plan" if board.kind == "jumpers" else "expected_voltages"
        picture = draw(board)
        for suffix in ("pdf", "png"):
            names.append(save_figure(picture, work / f"{plan}.{suffix}").name)
    if kicad is not None:
        with stage("run kicad-cli", seconds=30.0):
            names += manufacture(kicad, work)
    return dict(described([*names, SUMMARY]))


def _summary(board: rg.hardware.Board, job: Job) -> dict[str, Any]:
    """Return the summary of a board as a dictionary for JSON, in SI units except for sizes in millimetres.

    It contains the size, the numbers of parts and bridges, supply, power and tolerance (a fraction). The key ``yield``
    holds the predicted fraction of starts that reach a goal (``value``), its confidence interval (``low``, ``high``),
    and the resolution of the measured voltages in ``bits``.
    """
    bits = board.readout.bits or 0
    overall = board.predicted_yields[bits]
    width, height = board.size
    return {
        "title": board.title,
        "scene": job.scene.source,
        "shape": job.space.shape,
        "kind": board.kind,
        "boundary": board.circuit.wiring.boundary,
        "width_mm": width,
        "height_mm": height,
        "pitch_mm": board.placement.pitch,
        "resistors": len(board.circuit.resistors),
        "values": len({part.ohms for part in board.circuit.resistors}),
        "largest_deviation": board.largest_deviation,
        "bridges": len(board.closed),
        "supply_volts": board.circuit.wiring.supply,
        "supply_current": board.supply_current,
        "power": board.power,
        "tolerance": board.tolerance,
        "yield": {"bits": bits, "value": overall.value, "low": overall.low, "high": overall.high},
    }


def _lines(data: dict[str, Any], folder: Path) -> Iterator[str]:
    """Yield the lines of the summary; `data`: the summary for JSON; `folder`: the written folder."""
    width, height = data["width_mm"], data["height_mm"]
    cheap = "fits into 100 x 100 mm" if max(width, height) <= 100 else "larger than 100 x 100 mm, the usual cheap size"
    share = data["yield"]
    bridges = f", {data['bridges']} bridges" if data["kind"] == "jumpers" else ""
    yield f"{data['title']}: board of kind {data['kind']}, {size_of(data['shape'])} cells, {data['boundary']}{bridges}"
    yield f"  size: {width:.1f} x {height:.1f} mm ({cheap})"
    yield (
        f"  resistors: {data['resistors']:,} of {data['values']} value{'s' * (data['values'] > 1)}, "
        f"largest deviation of E96 {100 * data['largest_deviation']:.2g} %"
    )
    yield (
        f"  supply: {data['supply_volts']:g} V, {formatted(data['supply_current'], 'A')}, "
        f"{formatted(data['power'], 'W')}"
    )
    yield (
        f"  predicted yield at {100 * data['tolerance']:g} % tolerance and {share['bits']} bits: "
        f"{100 * share['value']:.1f} % of the starts ({100 * share['low']:.1f} to {100 * share['high']:.1f} %)"
    )
    yield f"files in {folder}"
    names = [name for name in data["files"] if "/" not in name]
    longest = max(map(len, names))
    yield from (f"  {name:{longest}}  {data['files'][name]}" for name in names)
