"""``resgrid plot``: one picture of a scene."""

from __future__ import annotations

from pathlib import Path

import click

from resgrid.cli.options import Source, output_option, verb, with_source
from resgrid.cli.paths import Plan, plan_routes
from resgrid.cli.pictures import PICTURES, draw_picture
from resgrid.cli.report import finish, stage
from resgrid.cli.scenes import open_job, say_unheeded
from resgrid.errors import InputError

SUFFIXES = (".png", ".pdf", ".svg")


@verb(
    "plot",
    short="Draw a scene, its potential, currents, paths or circuit.",
    examples=("resgrid plot map.yaml --what space -o map.png", "resgrid plot rooms.toml --k 0.9 -o page.pdf"),
)
@with_source()
@output_option("The picture: FILE.png, .pdf or .svg; - prints a PNG.", required=True)
@click.option("--what", default="page", show_default=True, type=click.Choice(tuple(PICTURES)), help="Which picture.")
def command(source: Source, output: str, what: str) -> int:
    """Draw one picture of SCENE.

    A page shows potential, currents and paths together; a space of three axes is drawn in slices. Of a scene that asks
    for several blends, the first is drawn; choose one with --k. '--what space' draws the cells alone: a map needs no
    goal for that.
    """
    if output != "-" and Path(output).suffix.lower() not in SUFFIXES:
        raise InputError(f"-o {output}: a picture is written as {', '.join(SUFFIXES)}; name the file so")
    job = open_job(source, require_goal=what != "space")
    unheeded = say_unheeded(job, "grid", k=() if what == "space" else job.scene.k[1:])
    plan = Plan({}, [], []) if what == "space" else plan_routes(job)
    with stage("draw the picture"):
        from resgrid.io.tables import emit
        from resgrid.plot.figures import render_figure

        suffix = ".png" if output == "-" else Path(output).suffix.lower()
        emit(output, render_figure(draw_picture(what, job, plan), suffix.lstrip(".")))
    finish({"file": output, "what": what, **unheeded}, written=output)
    return 0
