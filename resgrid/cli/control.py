"""``resgrid control``: move a robot by its field through a world that the map does not quite show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from resgrid.cli.failures import NEGATIVE
from resgrid.cli.options import NUMBERS, Source, output_option, verb, with_source
from resgrid.cli.report import finish, say, stage
from resgrid.cli.scenes import open_job, place_of, require_starts, say_unheeded
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.control.announced import Wavefront
    from resgrid.control.log import Run
    from resgrid.control.pushes import Push
    from resgrid.control.simulation import Simulation
    from resgrid.scene import Scene

FRAMES = 120


@verb(
    "control",
    short="Move the robot by its field, feel obstacles, learn them.",
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
@click.option("--learn/--no-learn", default=True, show_default=True, help="Mark in the map what is touched.")
@click.option(
    "--push",
    metavar="T,S,F,...",
    type=NUMBERS,
    multiple=True,
    help="Push from time T for S seconds with a generalised force, one entry per axis (newtons of a point or a disc, "
    "newton metres of joints), which changes the velocity by the admittance times itself; repeatable.",
)
@click.option("--pushes", metavar="N", type=click.IntRange(0, 10_000), default=0, help="And N pushes at random.")
@click.option(
    "--push-size",
    metavar="F",
    type=click.FloatRange(0, 1e308),
    default=2.0,
    show_default=True,
    help="Force of random pushes.",
)
@click.option(
    "--bias",
    metavar="B,...",
    type=NUMBERS,
    default="0",
    help="Offset of the believed configuration: one for all axes, or one each.",
)
@click.option(
    "--noise",
    metavar="N,...",
    type=NUMBERS,
    default="0",
    help="Largest random error of the believed configuration, anew each step.",
)
@click.option("--seed", metavar="N", type=click.IntRange(0), default=0, show_default=True, help="Of all randomness.")
@click.option(
    "--steps",
    metavar="N",
    type=click.IntRange(1, 10_000_000),
    default=50_000,
    show_default=True,
    help="Give up after so many.",
)
@click.option("--speed", metavar="V", type=float, help="Nominal speed.  [default: a 20th of the longest axis a second]")
@click.option("--speed-limits", metavar="V,...", type=NUMBERS, help="Largest speed of each axis.  [default: none]")
@click.option(
    "--admittance",
    metavar="A,...",
    type=NUMBERS,
    help="One number, a diagonal, or a matrix row by row.  [default: speed]",
)
@click.option(
    "--response",
    type=click.Choice(("equipotential", "admittance")),
    default="equipotential",
    show_default=True,
    help="Whether a contact force turns the robot along the equipotential, or pushes it.",
)
@click.option("--friction", metavar="MU", type=float, default=0.2, show_default=True, help="Of all contacts.")
@click.option(
    "--settle",
    type=click.Choice(("chip", "jacobi", "sor")),
    help="The grid settles meanwhile: as a chip, or by sweeps.",
)
@click.option(
    "--pace",
    metavar="P",
    type=float,
    default=10.0,
    show_default=True,
    help="Sweeps, or units RC of a chip, while the robot crosses a cell.",
)
@click.option("--announce", is_flag=True, help="At time 0 hidden obstacles are put on the map, and the grid settles.")
def command(
    source: Source, output: str | None, animate: str | None, wavefront: str | None, push: Sequence[tuple[float, ...]],
    pushes: int, push_size: float, bias: tuple[float, ...], noise: tuple[float, ...], seed: int, steps: int,
    admittance: tuple[float, ...] | None, settle: str | None, pace: float, announce: bool, **motion: Any,
) -> int:  # fmt: skip
    """Move the robot of SCENE from each start by V = V0 + A F, with the scene's hidden obstacles in its way.

    Contacts are felt by the whole robot; with --learn they are marked in the map, and the field is solved again. The
    same seed gives the same run. Of a scene that asks for several blends, the first is used; choose others with --k.
    Exits with 1 if some run does not arrive.
    """
    from resgrid.io.runs import check_run_file, run_record, write_run

    if output is not None:
        check_run_file(output)
    _check_films(animate, wavefront, announce)
    job = open_job(source)
    scene, ndim = job.scene, job.space.ndim
    if output is not None:
        check_run_file(output, job.space.axes)
    require_starts(scene)
    motion["admittance"] = None if admittance is None else _matrix(admittance, ndim)
    shares: tuple[float | None, ...] = (scene.k if "k" in source.changes else scene.k[:1]) or (None,)
    unheeded = say_unheeded(job, "grid", k=scene.k[len(shares) :])
    if (animate or wavefront) and len(shares) * len(scene.starts) > 1:
        say("of several runs, the first is drawn; choose one with --start X,Y and --k K")
    runs: list[tuple[Simulation, Run]] = []
    starts = [start for _ in shares for start in scene.starts]
    for k in shares:
        with stage("solve the field", seconds=1.0):
            sim = _simulation(scene, k, settle or ("chip" if announce else None), pace, announce, motion)
        forces = [_push(numbers, ndim) for numbers in push] + _random_pushes(sim, pushes, push_size, seed)
        offsets = {"bias": _one_or_each(bias), "noise": _one_or_each(noise)}
        with stage("move the robot", steps=len(scene.starts)) as progress:
            for start in scene.starts:
                runs.append((sim, sim.run(start, pushes=forces, seed=seed, max_steps=steps, **offsets)))
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


def _check_films(animate: str | None, wavefront: str | None, announce: bool) -> None:
    """Refuse animations that cannot be made, before anything is computed."""
    from resgrid.plot.animations import check_animation

    for file in (animate, wavefront):
        if file is not None:
            check_animation(file)
    if wavefront is not None and not announce:
        raise InputError("--wavefront shows how an obstacle spreads that is put on the map: give --announce too")


def _simulation(
    scene: Scene, k: float | None, settle: str | None, pace: float, announce: bool, motion: dict[str, Any]
) -> Simulation:
    """The scene in motion, while its grid settles if that is asked for."""
    from resgrid.control.announced import announce_hidden
    from resgrid.control.relaxation import Relaxation
    from resgrid.control.simulation import simulation

    relaxation = None if settle is None else Relaxation(settle, pace)
    sim = simulation(scene, k=k, **motion)
    if relaxation is None:
        return sim
    return announce_hidden(sim, relaxation) if announce else replace(sim, relaxation=relaxation)


def _push(numbers: tuple[float, ...], ndim: int) -> Push:
    from resgrid.control.pushes import Push

    if len(numbers) != 2 + ndim:
        text = ",".join(f"{number:g}" for number in numbers)
        raise InputError(f"--push {text}: give a time, a duration and a force of {ndim} entries, with commas")
    return Push(numbers[0], numbers[1], numbers[2:])  # type: ignore[arg-type]


def _random_pushes(sim: Simulation, count: int, size: float, seed: int) -> list[Push]:
    """Pushes spread over the time that the robot needs along the longest axis."""
    from resgrid.control.pushes import random_pushes

    if not (count and size):
        return []
    until = float((sim.space.upper - sim.space.lower).max()) / sim.controller.speed
    return random_pushes(seed, sim.space.ndim, until=until, size=size, duration=until / 20, count=count)


def _matrix(numbers: tuple[float, ...], ndim: int) -> Any:
    if len(numbers) == ndim * ndim and ndim > 1:
        return [numbers[row * ndim : (row + 1) * ndim] for row in range(ndim)]
    if len(numbers) not in (1, ndim):
        text = ",".join(f"{number:g}" for number in numbers)
        raise InputError(f"--admittance {text}: give 1 number, {ndim}, or {ndim * ndim} for a matrix row by row")
    return _one_or_each(numbers)


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
