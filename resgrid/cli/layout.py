"""``resgrid layout``: write a scene's resistor grid as mask data of a chip (GDSII or OASIS)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click

import resgrid as rg
from resgrid.cli.option_types import NumberRange, Suggested, fraction_below
from resgrid.cli.options import CommandInput, output_option, subcommand, with_source
from resgrid.cli.scenes import Job, open_job, report_ignored
from resgrid.cli.terminal import counted, finish, say, stage
from resgrid.errors import InputError
from resgrid.hardware.record import record_path
from resgrid.processes.reading import process_names

PROCESSES = tuple(process_names())
"""Names of all pairs of a process and one of its resistors, such as ``ihp-sg13g2:rppd``."""

DRAWN = ("process", "corner", "width")
"""Keys of the ``[chip]`` table that an ideal netlist ignores, but a layout applies.

A layout ignores all other keys that an ideal netlist ignores.
"""

SHOWN_PADS = 8
"""Largest number of pads whose places are printed in the floor plan."""


@subcommand(
    "layout",
    examples=(
        "resgrid layout rooms.toml --process toy:poly -o rooms.gds",
        "resgrid layout lesson.toml --process ihp-sg13g2:rhigh --resistance 50k -o lesson.oas",
    ),
)
@with_source()
@output_option(
    "Layout file: FILE.gds (GDSII) or FILE.oas (OASIS); also writes FILE.record.json (circuit and expected voltages).",
    required=True,
)
@click.option(
    "--process",
    metavar="NAME",
    type=Suggested("name", *PROCESSES),
    help=f"Process and its resistor: {', '.join(PROCESSES)}.  [default: chip.process]",
)
@click.option(
    "--width", metavar="UM", type=NumberRange(0, min_open=True),
    help="Width of the resistors, in micrometres.  [default: the smallest one]",
)  # fmt: skip
@click.option(
    "--matching", metavar="SIGMA", type=fraction_below(1),
    help="Wanted standard deviation of the relative resistance, such as 0.01; determines the width.",
)  # fmt: skip
@click.option("--labels/--no-labels", default=None, help="Label every node.  [default: up to 20,000 cells]")
@click.option("--record/--no-record", default=None, help="Write the record.  [default: up to 65,536 cells]")
def command(
    source: CommandInput,
    output: str,
    process: str | None,
    width: float | None,
    matching: float | None,
    labels: bool | None,
    record: bool | None,
) -> int:
    """Draw the resistor grid of SCENE as a chip layout in GDSII or OASIS.

    Every resistor is a serpentine of the process, between bars of metal 1. Obstacles are connected to a rail of metal
    2, goal regions and a driving start to trunks of metal 3, and all of them to pads. Prints a floor plan with the
    pitch, the area, the rails and their voltage drops. 'resgrid check' with the layout as its input extracts the
    circuit with klayout and compares it with the record.
    """
    from resgrid.hardware.layout_files import SUFFIXES, has_record, load_gdstk, require_suffix

    if output == "-":
        raise InputError(
            f"-o -: a layout is a binary file with a record; name a file that ends in {' or '.join(SUFFIXES)}"
        )
    require_suffix(Path(output))
    load_gdstk()
    job = open_job(source)
    name, wiring = job.problem.only_wiring()
    ignored = _report_ignored(job)
    size = job.space.cell.size
    with stage("draw the layout", seconds=2e-5 * size):
        layout = rg.hardware.build_layout(
            job.space,
            process or _process_of(job.scene),
            wiring,
            width=_width(job.scene, width, matching),
            matching=matching,
            labels=labels,
            resistance=job.scene.chip.resistance,  # resistors are drawn for the typical corner of the process
        )
    recorded = has_record(layout, record)
    with stage("write the layout", seconds=8e-5 * size * recorded):
        rg.save(layout, output, record=recorded)
    summary = layout.summary()
    for warning in layout.warnings:
        say(f"warning: {warning}")
    if not recorded:
        say("no record was written, which the check of a layout needs; --record writes it")
    file = record_path(output) if recorded else None
    data = {"chip": name, "file": output, "record": file, "bytes": Path(output).stat().st_size, **summary, **ignored}
    finish(data, _floor_plan(summary), written=output, more=True)
    return 0


def _report_ignored(job: Job) -> dict[str, list[str]]:
    """Print the keys of a scene that a layout ignores, with reasons; return ``{"ignored": keys}`` for JSON."""
    from resgrid.chip.build import keys_not_held

    keys = [f"chip.{key}" for key in keys_not_held(job.scene.chip, "grid") if key not in DRAWN]
    if keys:
        say(f"ignored: {', '.join(keys)}: a layout consists of ideal resistors; 'resgrid chip' computes their effect")
    return {"ignored": [*keys, *report_ignored(job, "chip")["ignored"]]}


def _process_of(scene: rg.Scene) -> str:
    """Return the name of the process in the ``[chip]`` table of a scene; raise InputError if there is none."""
    if scene.chip.process is None:
        raise InputError(
            f"the scene has no chip.process; name one with --process, for instance --process {PROCESSES[-1]}"
        )
    return scene.chip.process


def _width(scene: rg.Scene, width: float | None, matching: float | None) -> float | None:
    """Return the width of the resistors in metres; None for the smallest one, or if `matching` determines the width.

    `width`: width of the option in micrometres, None for that of the scene's chip; `matching`: target standard
    deviation of the relative resistance, None without one.
    """
    if width is not None:
        return width * 1e-6
    return scene.chip.width if matching is None else None


def _floor_plan(summary: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of the floor plan: sizes, resistors, rails with voltage drops, and pads.

    `summary`: result of `Layout.summary`.
    """
    um = 1e6
    columns, rows = summary["cells"]
    (px, py), (width, height) = summary["pitch"], summary["size"]
    resistor, rails = summary["resistor"], summary["rails"]
    yield f"{summary['process']}: {columns} x {rows} cells of {px * um:.4g} x {py * um:.4g} um"
    array = " x ".join(f"{side * um:.5g}" for side in summary["array_size"])
    yield f"array {array} um ({summary['array_area'] * 1e6:.4g} mm^2), outline {width * um:.5g} x {height * um:.5g} um"
    ohms, folds = _span(resistor["resistance"], 1.0, ".6g"), _span(resistor["rows"], 1, "d")
    yield (
        f"{counted(summary['resistors'], 'resistor')} of {ohms} ohm, {resistor['width'] * um:.4g} um wide and "
        f"{_span(resistor['length'], um, '.4g')} um long in {folds} row{'s' * (folds != '1')}"
    )
    for net, amps in rails["current"].items():
        yield f"rail {net}: {amps:.3g} A, voltage drop up to {rails['drop'].get(net, 0.0):.2g} V"
    pads = summary["pads"]
    listed = ", ".join(f"{pad['net']} ({pad['at'][0] * um:.5g}, {pad['at'][1] * um:.5g})" for pad in pads[:SHOWN_PADS])
    yield f"{counted(len(pads), 'pad')} at, in um: {listed}{', ...' if len(pads) > SHOWN_PADS else ''}"


def _span(values: list[Any], scale: float, form: str) -> str:
    """Return a range such as ``1 to 3`` as text, or one number if both ends are equal.

    `values`: the two ends; `scale`: factor by which they are multiplied; `form`: format of the numbers.
    """
    low, high = (format(value * scale, form) for value in values)
    return low if low == high else f"{low} to {high}"
