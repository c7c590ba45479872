"""``resgrid plot``: one picture of a scene."""

from __future__ import annotations

from pathlib import Path

import click

from resgrid.cli.scenes import tell_unheeded
from resgrid.cli.scenes import open_job
from resgrid.cli.options import Source, output_option, with_report, with_scene

from resgrid.cli.paths import Plan, plan_routes
from resgrid.cli.pictures import PICTURES, draw_picture
from resgrid.errors import InputError

SUFFIXES = (".png", ".pdf", ".svg")


@click.command("plot", short_help="Draw a scene, its potential, currents, paths or circuit.")
@with_source()
@output_option("The picture: FILE.png, .pdf or .svg; - prints a PNG.", required=True)
@click.option("--what", default="page", show_default=True, type=click.Choice(tuple(PICTURES)), help="Which picture.")
def command(source: Source, output: str, what: str) -> int:
    """Draw one picture of SCENE.

    A page shows potential, currents and paths together; a space of three axes is drawn in slices. Of a scene that asks
    for several blends, the first is drawn; choose one with --k. '--what space' draws the cells alone: a map needs no
    goal for that.
    """
    suffix = ".png" if output == "-" else Path(output).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"-o {output}: a picture is written as {', '.join(SUFFIXES)}; name the file so")
    if output == "-" and report.json:
        raise InputError("-o - and --json both want standard output; write the picture to a file")
    job = open_job(source, require_goal=what != "space")
    told = tell_unheeded(job, "grid", k=() if what == "space" else job.scene.k[1:])
    plan = Plan({}, [], []) if what == "space" else plan_routes(job)
    with stage("draw the picture"):
        from resgrid.plot import save_figure

        figure = draw_picture(what, job, plan)
        emit_file(output, suffix, lambda path: save_figure(figure, path))
    if output != "-":
        say(f"wrote {output}")
        finish({"file": output, "what": what, **told}, ())
    return 0
