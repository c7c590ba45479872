"""``resgrid control``: simulate a robot that follows its field, among obstacles of which some are not in its map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin, get_type_hints

import click

import resgrid as rg
from resgrid.cli.option_types import Number
from resgrid.cli.options import NUMBERS, OUTPUT_FILE, CommandInput, output_option, subcommand, with_source
from resgrid.cli.scenes import open_job, place_of, report_ignored, require_starts
from resgrid.cli.terminal import NEGATIVE, counted, finish, say, stage
from resgrid.errors import InputError
from resgrid.scene import Control
from resgrid.scene.table_models import described_keys

if TYPE_CHECKING:
    from resgrid.control.simulation import Simulation
    from resgrid.control.wavefronts import Wavefront

FRAMES = 120
"""Number of frames of an animation of a run or a wavefront."""


def _control_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function`, a subcommand, with an added option for every key of the ``[control]`` table except ``k``.

    The option for ``k`` is shared by all subcommands and added elsewhere.
    """
    hints = get_type_hints(Control)
    for key, (_, meaning) in reversed(described_keys(Control).items()):
        if key != "k":
            function = _option(key, hints[key], getattr(Control, key), meaning.replace("``", ""))(function)
    return function


def _option(key: str, hint: Any, default: Any, meaning: str) -> Callable[..., Any]:
    """Return the decorator that adds the option of a key of the ``[control]`` table to a subcommand.

    `key`: name of the key, which becomes ``--key`` with dashes; `hint`: type annotation of the key, which determines
    the type of the option; `default`: default value of the key for the help text, None without a default; `meaning`:
    description for the help text.
    """
    if type(None) in get_args(hint):
        hint = next(part for part in get_args(hint) if part is not type(None))
    name = f"--{key.replace('_', '-')}"
    shown = default if isinstance(default, int | float | str) and not isinstance(default, bool) else None
    text = meaning if shown is None else f"{meaning}  [default: {shown}]"
    if hint is bool:
        return click.option(
            f"{name}/--no-{name[2:]}", default=None, help=f"{meaning}  [default: {'yes' if default else 'no'}]"
        )
    if get_origin(hint) is Literal:
        return click.option(name, type=click.Choice(get_args(hint)), help=text)
    if hint in (int, float):
        return click.option(name, metavar="N" if hint is int else "X", type=int if hint is int else Number(), help=text)
    many = get_origin(get_args(hint)[0]) is tuple
    return click.option(name, metavar="X,...", type=NUMBERS, multiple=many, help=f"{text}{'  Repeatable.' * many}")


@subcommand(
    "control",
    examples=(
        "resgrid control chair.toml --animate chair.gif -o log.csv",
        "resgrid control chair.toml --announce --settle sor --wavefront front.gif",
        "resgrid control map.yaml --goal 5,0 --start=-5,-4 --robot-radius 0.3 --push 1,0.5,0,2",
    ),
)
@with_source()
@output_option("Log of all time steps: FILE.csv, .json or .npz; - prints CSV.")
@click.option("--picture", metavar="FILE", type=OUTPUT_FILE, help="Picture of the first run: .png, .pdf or .svg.")
@click.option("--animate", metavar="FILE", type=OUTPUT_FILE, help="Animation of the first run: .gif, or .mp4 (ffmpeg).")
@click.option(
    "--wavefront", metavar="FILE", type=OUTPUT_FILE, help="Animation of the change of potential; needs --announce."
)
@_control_options
def command(
    source: CommandInput,
    output: str | None,
    picture: str | None,
    animate: str | None,
    wavefront: str | None,
    **keys: Any,
) -> int:
    """Simulate the robot of SCENE from each start with the velocity V = V0 + A F, including hidden obstacles.

    V0 is the velocity along the field, A the admittance and F the contact force on the whole robot. With --learn,
    touched obstacles enter the map, and the field is solved again. Runs with the same seed are identical. Options
    replace keys of the scene's [control] table. Of several blends in the scene, the first one is used; choose others
    with --k. Exits with 1 if a run does not arrive.
    """
    from resgrid.io.runs import check_run_file, run_record

    if output is not None:
        check_run_file(output)
    _check_pictures(picture, animate, wavefront)
    changes = {f"control.{key}": value for key, value in keys.items() if value not in (None, ())}
    job = open_job(replace(source, changes={**source.changes, **changes}))
    scene = job.scene
    if wavefront is not None and not scene.control.announce:
        raise InputError("--wavefront shows the effect of announced obstacles: add --announce, or leave it out")
    if scene.control.announce and not scene.hidden:
        if wavefront is not None:
            raise InputError("--wavefront: the scene has no hidden obstacles; add a [[hidden]] table, or leave it out")
        say("ignored: announce: the scene has no hidden obstacles")
    if output is not None:
        check_run_file(output, job.space.axes)
    require_starts(scene)
    own = scene.k[:1] if scene.control.k is None else (scene.control.k,)
    blends: tuple[float | None, ...] = (scene.k if "k" in source.changes else own) or (None,)
    ignored = report_ignored(job, "grid", k=tuple(k for k in scene.k if k not in blends))
    if (picture or animate or wavefront) and len(blends) * len(scene.starts) > 1:
        say("only the first of several runs is drawn; choose a run with --start X,Y and --k K")
    runs: list[tuple[Simulation, rg.control.Run]] = []
    starts = [start for _ in blends for start in scene.starts]
    for k in blends:
        with stage("solve the field", seconds=1.0):
            sim = rg.simulation(scene, k=k)
        with stage("move the robot", steps=len(scene.starts)) as progress:
            for start in scene.starts:
                runs.append((sim, sim.run(start)))
                progress.advance()
    if output is not None:
        rg.save([run for _, run in runs], output)
    if picture is not None:
        say(f"wrote {rg.plot.save_figure(rg.draw(runs[0][1]), picture)}")
    if animate is not None:
        _draw(animate, runs[0][1], count=FRAMES)
    if wavefront is not None:
        _draw(wavefront, _front(*runs[0]), run=runs[0][1], rate=10.0)
    records = [
        run_record(run) | {"start": start, "cell_motion": sim.plant.cell_motion}
        for start, (sim, run) in zip(starts, runs, strict=True)
    ]
    lines = (_line(start, run) for start, (_, run) in zip(starts, runs, strict=True))
    finish({"scene": scene.title, "runs": records, **ignored}, lines, written=output)
    return 0 if all(str(run.ending) == "arrived" for _, run in runs) else NEGATIVE


def _check_pictures(picture: str | None, *films: str | None) -> None:
    """Raise InputError or ToolMissingError unless the suffixes of the files select formats that can be written.

    `picture`: file of a picture; `films`: files of animations; None for no file.  ToolMissingError means that the
    program for a format (ffmpeg) is missing.
    """
    from resgrid.plot.animations import check_animation
    from resgrid.plot.figures import picture_format

    if picture is not None:
        picture_format(picture)
    for file in films:
        if file is not None:
            check_animation(file)


def _front(sim: Simulation, run: rg.control.Run) -> Wavefront:
    """Return the spread of the change of the potential that starts when the hidden obstacles enter the map.

    `sim`: simulation of the robot; `run`: motion whose duration determines the times of the result: `FRAMES` times from
    0 to the duration, counted in cells that the robot crosses at nominal speed.
    """
    import numpy as np

    crossed = float(run.time[-1]) * sim.controller.speed / float(sim.space.spacing.min())
    with stage("follow the wavefront", seconds=10.0):
        return rg.control.wavefront(sim, np.linspace(0.0, crossed, FRAMES))


def _draw(file: str, value: rg.control.Run | Wavefront, **options: Any) -> None:
    say(f"drawing {FRAMES} frames for {file}")
    with stage(f"draw {Path(file).name}", steps=FRAMES) as progress:
        rg.animate(value, file, progress=lambda _: progress.advance(), **options)
    say(f"wrote {file}")


def _line(start: Sequence[float], run: rg.control.Run) -> str:
    """Return the line of text that reports a run; `start`: requested start in world coordinates."""
    head = f"start {place_of(start)}, k = {run.field.k:g}: {run.ending} after {run.time[-1]:.4g} s"
    solves = counted(len(run.lessons), "re-solve")
    learnt = f", {counted(int(run.learnt.sum()), 'cell')} learnt in {solves}" if run.lessons else ""
    contacts = f", {counted(len(run.contacts.step), 'contact')}" if len(run.contacts.step) else ""
    why = "" if str(run.ending) == "arrived" and not run.goal_distance > 0 else f": {run.message}"
    return f"{head}{contacts}{learnt}{why}"
