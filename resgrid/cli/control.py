"""``resgrid control``: move a robot by its field through a world that the map does not quite show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin, get_type_hints

import click

from resgrid.cli.failures import NEGATIVE
from resgrid.cli.options import NUMBERS, Source, output_option, verb, with_source
from resgrid.cli.report import finish, say, stage
from resgrid.cli.scenes import open_job, place_of, require_starts, say_unheeded
from resgrid.errors import InputError
from resgrid.scene import Control
from resgrid.scene.table import described_keys

if TYPE_CHECKING:
    from resgrid.control.announced import Wavefront
    from resgrid.control.log import Run
    from resgrid.control.simulation import Simulation
    from resgrid.scene import Scene

FRAMES = 120


def _control_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """An option for every key of a scene's ``[control]`` table but k, which all verbs have."""
    hints = get_type_hints(Control)
    for key, (_, meaning) in reversed(described_keys(Control).items()):
        if key != "k":
            function = _option(key, hints[key], getattr(Control, key), meaning)(function)
    return function


def _option(key: str, hint: Any, default: Any, meaning: str) -> Callable[..., Any]:
    hint = next((part for part in get_args(hint) if part is not type(None)), hint) if _is_optional(hint) else hint
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
        return click.option(name, metavar="N" if hint is int else "X", type=hint, help=text)
    many = get_origin(get_args(hint)[0]) is tuple
    return click.option(name, metavar="X,...", type=NUMBERS, multiple=many, help=f"{text}{'  Repeatable.' * many}")


def _is_optional(hint: Any) -> bool:
    return type(None) in get_args(hint)


@verb(
    "control",
    examples=(
        "resgrid control chair.toml --animate chair.gif -o log.csv",
        "resgrid control chair.toml --announce --settle sor --wavefront front.gif",
        "resgrid control map.yaml --goal 5,0 --start=-5,-4 --robot-radius 0.3 --push 1,0.5,0,2",
    ),
)
@with_source()
@output_option("Write a log of every step to FILE.csv or .npz; - prints CSV.")
@click.option("--animate", metavar="FILE", type=click.Path(), help="Write an animation: .gif, or .mp4 with ffmpeg.")
@click.option("--wavefront", metavar="FILE", type=click.Path(), help="With --announce: animate the potential's change.")
@_control_options
def command(source: Source, output: str | None, animate: str | None, wavefront: str | None, **keys: Any) -> int:
    """Move the robot of SCENE from each start by V = V0 + A F, with the scene's hidden obstacles in its way.

    Contacts are felt by the whole robot; with --learn they are marked in the map, and the field is solved again. The
    same seed gives the same run. Options stand in for keys of the scene's [control] table. Of a scene that asks for
    several blends, the first is used; choose others with --k. Exits with 1 if some run does not arrive.
    """
    from resgrid.io.runs import check_run_file, run_record, write_run

    if output is not None:
        check_run_file(output)
    _check_films(animate, wavefront)
    changes = {f"control.{key}": value for key, value in keys.items() if value not in (None, ())}
    job = open_job(replace(source, changes={**source.changes, **changes}))
    scene = job.scene
    if wavefront is not None and not scene.control.announce:
        raise InputError("--wavefront shows how an obstacle spreads that is put on the map: give --announce too")
    if output is not None:
        check_run_file(output, job.space.axes)
    require_starts(scene)
    own = scene.k[:1] if scene.control.k is None else (scene.control.k,)
    shares: tuple[float | None, ...] = (scene.k if "k" in source.changes else own) or (None,)
    unheeded = say_unheeded(job, "grid", k=tuple(k for k in scene.k if k not in shares))
    if (animate or wavefront) and len(shares) * len(scene.starts) > 1:
        say("of several runs, the first is drawn; choose one with --start X,Y and --k K")
    runs: list[tuple[Simulation, Run]] = []
    starts = [start for _ in shares for start in scene.starts]
    for k in shares:
        with stage("solve the field", seconds=1.0):
            sim = _simulation(scene, k)
        with stage("move the robot", steps=len(scene.starts)) as progress:
            for start in scene.starts:
                runs.append((sim, _run(sim, scene, start)))
                progress.advance()
    if output is not None:
        write_run([run for _, run in runs], output)
    if animate is not None:
        _draw(animate, runs[0][1], count=FRAMES)
    if wavefront is not None:
        _draw(wavefront, _front(*runs[0]), run=runs[0][1], rate=10.0)
    records = [
        run_record(run) | {"start": start, "cell_motion": sim.plant.cell_motion}
        for start, (sim, run) in zip(starts, runs, strict=True)
    ]
    lines = (_line(start, run) for start, (_, run) in zip(starts, runs, strict=True))
    finish({"scene": scene.title, "runs": records, **unheeded}, lines, written=output)
    return 0 if all(str(run.ending) == "arrived" for _, run in runs) else NEGATIVE


def _check_films(*files: str | None) -> None:
    """Refuse animations that cannot be made, before anything is computed."""
    from resgrid.plot.animations import check_animation

    for file in files:
        if file is not None:
            check_animation(file)


def _simulation(scene: Scene, k: float | None) -> Simulation:
    """The scene in motion, while its grid settles if it says so."""
    from resgrid.control.announced import announce_hidden
    from resgrid.control.relaxation import Relaxation
    from resgrid.control.simulation import simulation

    control, ndim = scene.control, scene.ndim
    numbers = control.admittance
    admittance: Any = None if numbers is None else _one_or_each(numbers)
    if numbers is not None and len(numbers) == ndim * ndim and ndim > 1:
        admittance = [numbers[row * ndim : (row + 1) * ndim] for row in range(ndim)]
    elif numbers is not None and len(numbers) not in (1, ndim):
        raise InputError(
            f"control.admittance = {list(numbers)}: give 1 number, {ndim}, or {ndim * ndim} for a matrix row by row"
        )
    limits = None if control.speed_limits is None else _one_or_each(control.speed_limits)
    sim = simulation(
        scene, k=k, speed=control.speed, admittance=admittance, speed_limits=limits, response=control.response,
        friction=control.friction, learn=control.learn, step=control.step,
    )  # fmt: skip
    method = control.settle or ("chip" if control.announce else None)
    if method is None:
        return sim
    relaxation = Relaxation(method, control.pace)
    return announce_hidden(sim, relaxation) if control.announce else replace(sim, relaxation=relaxation)


def _run(sim: Simulation, scene: Scene, start: Sequence[float]) -> Run:
    """A run from a start, with the scene's pushes and errors of belief."""
    from resgrid.control.pushes import Push, random_pushes

    control, ndim = scene.control, scene.ndim
    pushes = []
    for numbers in control.push:
        if len(numbers) != 2 + ndim:
            raise InputError(f"control.push: {list(numbers)}: give a time, a duration and a force of {ndim} entries")
        pushes.append(Push(numbers[0], numbers[1], numbers[2:]))  # type: ignore[arg-type]
    if control.pushes and control.push_size:
        until = float((sim.space.upper - sim.space.lower).max()) / sim.controller.speed
        pushes += random_pushes(
            control.seed, ndim, until=until, size=control.push_size, duration=until / 20, count=control.pushes
        )
    return sim.run(
        start, pushes=pushes, seed=control.seed, max_steps=control.steps,
        bias=_one_or_each(control.bias), noise=_one_or_each(control.noise),
    )  # fmt: skip


def _one_or_each(numbers: tuple[float, ...]) -> float | tuple[float, ...]:
    return numbers[0] if len(numbers) == 1 else numbers


def _front(sim: Simulation, run: Run) -> Wavefront:
    """The change of the potential for as long as the robot was on its way."""
    import numpy as np

    from resgrid.control.announced import wavefront

    crossed = float(run.time[-1]) * sim.controller.speed / float(sim.space.spacing.min())
    with stage("follow the wavefront", seconds=10.0):
        return wavefront(sim, np.linspace(0.0, crossed, FRAMES))


def _draw(file: str, value: Run | Wavefront, **options: Any) -> None:
    from resgrid.plot import animate

    say(f"drawing {FRAMES} frames for {file}")
    with stage(f"draw {Path(file).name}", steps=FRAMES) as progress:
        animate(value, file, progress=lambda _: progress.advance(), **options)
    say(f"wrote {file}")


def _line(start: Sequence[float], run: Run) -> str:
    """A run in one line, for people."""
    head = f"start {place_of(start)}, k = {run.field.k:g}: {run.ending} after {run.time[-1]:.4g} s"
    solves = "1 re-solve" if len(run.lessons) == 1 else f"{len(run.lessons)} re-solves"
    learnt = f", {int(run.learnt.sum())} cells learnt in {solves}" if run.lessons else ""
    count = len(run.contacts.step)
    contacts = f", {count} contact{'s' if count > 1 else ''}" if count else ""
    why = "" if str(run.ending) == "arrived" else f": {run.message}"
    return f"{head}{contacts}{learnt}{why}"
