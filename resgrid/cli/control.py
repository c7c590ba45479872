"""``resgrid control``: move a robot by its field through a world that the map does not quite show."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from resgrid.cli.control_files import Motion, check_log, run_data, run_line, write_log
from resgrid.cli.failures import NEGATIVE
from resgrid.cli.heeded import tell_unheeded
from resgrid.cli.job import Job, open_job
from resgrid.cli.options import SceneChoice, output_option, with_report, with_scene
from resgrid.cli.paths import require_starts
from resgrid.cli.report import Report
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.control.pushes import Push
    from resgrid.control.simulation import Simulation

FRAMES = 120


@click.command("control", short_help="Move the robot by its field, feel obstacles, learn them.")
@with_scene()
@output_option("Write a log of every step to FILE.npz or .csv; - prints CSV.")
@click.option("--animate", metavar="FILE", type=click.Path(), help="Write an animation: .gif, or .mp4 with ffmpeg.")
@click.option("--wavefront", metavar="FILE", type=click.Path(), help="With --announce: animate the potential's change.")
@click.option("--learn/--no-learn", default=True, show_default=True, help="Mark in the map what is touched.")
@click.option(
    "--push", metavar="T,S,F,...", multiple=True,
    help="Push from time T for S seconds with a generalised force, one entry per axis, which changes the velocity by "
    "the admittance times itself; repeatable.",
)  # fmt: skip
@click.option("--pushes", metavar="N", type=click.IntRange(0, 10_000), default=0, help="And N pushes at random.")
@click.option("--push-size", metavar="F", type=float, default=2.0, show_default=True, help="Force of random pushes.")
@click.option("--bias", metavar="B,...", help="Offset of the believed configuration: one for all axes, or one each.")
@click.option("--noise", metavar="N,...", help="Largest random error of the believed configuration, anew each step.")
@click.option("--seed", metavar="N", type=click.IntRange(0), default=0, show_default=True, help="Of all randomness.")
@click.option("--steps", metavar="N", type=click.IntRange(1, 10_000_000), default=50_000, show_default=True,
              help="Give up after so many.")  # fmt: skip
@click.option("--speed", metavar="V", type=float, help="Nominal speed.  [default: a 20th of the longest axis a second]")
@click.option("--admittance", metavar="A,...", help="One number, a diagonal, or a matrix row by row.  [default: speed]")
@click.option("--response", type=click.Choice(("equipotential", "admittance")), default="equipotential",
              show_default=True, help="Whether a contact force turns the robot along the equipotential, or pushes it.",
)  # fmt: skip
@click.option("--friction", metavar="MU", type=float, default=0.2, show_default=True, help="Of all contacts.")
@click.option("--settle", type=click.Choice(("chip", "jacobi", "sor")),
              help="The grid settles meanwhile: as a chip, or by sweeps.")  # fmt: skip
@click.option("--pace", metavar="P", type=float, default=10.0, show_default=True,
              help="Sweeps, or units RC of a chip, while the robot crosses a cell.")  # fmt: skip
@click.option("--announce", is_flag=True, help="At time 0 hidden obstacles are put on the map, and the grid settles.")
@with_report
def command(
    choice: SceneChoice, output: str | None, animate: str | None, wavefront: str | None, seed: int, steps: int,
    announce: bool, report: Report, **words: Any,
) -> int:  # fmt: skip
    """Move the robot of SCENE from each start by V = V0 + A F, with the scene's hidden obstacles in its way.

    Contacts are felt by the whole robot; with --learn they are marked in the map, and the field is solved again. The
    same seed gives the same run. Of a scene that asks for several blends, the first is used; choose others with --k.
    Exits with 1 if some run does not arrive.
    """
    if output == "-" and report.json:
        raise InputError("-o - and --json both want standard output; choose one")
    if output is not None:
        check_log(output)
    films = {"--animate": animate, "--wavefront": wavefront}
    _check_films(films, announce)
    if announce and words["settle"] is None:
        words["settle"] = "chip"
    job = open_job(choice, report)
    if output is not None:
        check_log(output, job.space.axes)
    require_starts(job)
    shares = job.scene.k if "k" in choice.changes else job.scene.k[:1]
    told = tell_unheeded(job, "grid", report, k=job.scene.k[len(shares) :])
    if any(films.values()) and len(shares or (None,)) * len(job.scene.starts) > 1:
        report.say("of several runs, the first is drawn; choose one with --start X,Y and --k K")
    motions = [
        motion for k in shares or (None,) for motion in _moved(job, k, words, seed, steps, announce, report)
    ]  # fmt: skip
    _write(job, motions, output, report)
    if animate is not None:
        _draw_run(animate, motions[0], job, report)
    if wavefront is not None:
        _draw_wavefront(wavefront, motions[0], job, report)
    if output != "-":
        data = {"scene": job.scene.title, "runs": [run_data(motion) for motion in motions], **told}
        report.finish(data, [run_line(motion) for motion in motions], written=output is not None)
    return 0 if all(str(motion.run.ending) == "arrived" for motion in motions) else NEGATIVE


def _moved(
    job: Job, k: float | None, words: dict[str, Any], seed: int, steps: int, announce: bool, report: Report
) -> list[Motion]:
    from dataclasses import replace

    from resgrid.control.relaxation import make_relaxation
    from resgrid.control.relaxation_ratio import announce_hidden
    from resgrid.control.simulation import simulation

    scene, ndim = job.scene, job.space.ndim
    relaxation = None
    if words["settle"] is not None:
        relaxation = make_relaxation(scene, method=words["settle"], pace=words["pace"], k=k)
    admittance = _matrix(words["admittance"], ndim)
    with report.stage("solve the field", seconds=1.0):
        sim = simulation(
            scene, k=k, speed=words["speed"], admittance=admittance, response=words["response"],
            friction=words["friction"], learn=words["learn"],
        )  # fmt: skip
    if relaxation is not None:
        sim = announce_hidden(sim, relaxation) if announce else replace(sim, relaxation=relaxation)
    pushes = _pushes(words, seed, sim)
    wrong = {name: _offset(f"--{name}", words[name]) for name in ("bias", "noise")}
    motions = []
    with report.stage("move the robot", steps=len(scene.starts)) as progress:
        for start in scene.starts:
            run = sim.run(start, pushes=pushes, seed=seed, max_steps=steps, **wrong)
            motions.append(Motion(start, sim.controller.field.k, run, sim))
            progress.advance()
    return motions


def _check_films(films: dict[str, str | None], announce: bool) -> None:
    """Refuse animations that cannot be made, before anything is computed."""
    for file in films.values():
        if file is not None:
            from resgrid.plot.films import check_animation

            check_animation(file)
    if films["--wavefront"] is not None and not announce:
        raise InputError("--wavefront shows how an obstacle spreads that is put on the map: give --announce too")


def _write(job: Job, motions: list[Motion], output: str | None, report: Report) -> None:
    if output is not None:
        write_log(output, motions, job)
        if output != "-":
            report.say(f"wrote {output}")


def _draw_run(file: str, motion: Motion, job: Job, report: Report) -> None:
    from resgrid.plot.animations import run_frames
    from resgrid.plot.films import save_animation

    report.say(f"drawing {FRAMES} frames for {file}")
    with report.stage(f"draw {Path(file).name}", steps=FRAMES) as progress:
        frames = run_frames(motion.run, job.scene, count=FRAMES)
        save_animation(frames, file, progress=lambda _: progress.advance())
    report.say(f"wrote {file}")


def _draw_wavefront(file: str, motion: Motion, job: Job, report: Report) -> None:
    """The change of the potential for as long as the robot was on its way."""
    import numpy as np

    from resgrid.control.relaxation import wavefront
    from resgrid.plot.animations import wavefront_frames
    from resgrid.plot.films import save_animation

    sim = motion.simulation
    assert sim.relaxation is not None
    crossed = float(motion.run.time[-1]) * sim.controller.speed / float(job.space.spacing.min())
    report.say(f"drawing {FRAMES} frames for {file}")
    with report.stage("follow the wavefront", seconds=10.0):
        front = wavefront(sim.relaxation, job.space, sim.space, np.linspace(0.0, crossed, FRAMES))
    with report.stage(f"draw {Path(file).name}", steps=FRAMES) as progress:
        save_animation(wavefront_frames(front, motion.run), file, rate=10.0, progress=lambda _: progress.advance())
    report.say(f"wrote {file}")


def _numbers(option: str, text: str) -> list[float]:
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        raise InputError(f"{option} {text!r}: expected numbers separated by commas") from None
    if not all(abs(number) < float("inf") for number in numbers):
        raise InputError(f"{option} {text!r}: expected finite numbers")
    return numbers


def _offset(option: str, text: str | None) -> float | list[float]:
    if text is None:
        return 0.0
    numbers = _numbers(option, text)
    return numbers[0] if len(numbers) == 1 else numbers


def _matrix(text: str | None, ndim: int) -> Any:
    if text is None:
        return None
    numbers = _numbers("--admittance", text)
    if len(numbers) == ndim * ndim and ndim > 1:
        return [numbers[row * ndim : (row + 1) * ndim] for row in range(ndim)]
    if len(numbers) not in (1, ndim):
        raise InputError(f"--admittance {text!r}: give 1 number, {ndim}, or {ndim * ndim} for a matrix row by row")
    return numbers[0] if len(numbers) == 1 else numbers


def _pushes(words: dict[str, Any], seed: int, sim: Simulation) -> list[Push]:
    from resgrid.control.pushes import Push, random_pushes

    ndim = sim.space.ndim
    pushes = []
    for text in words["push"]:
        numbers = _numbers("--push", text)
        if len(numbers) != 2 + ndim:
            raise InputError(f"--push {text!r}: give a time, a duration and a force of {ndim} entries, with commas")
        pushes.append(Push(numbers[0], numbers[1], numbers[2:]))  # type: ignore[arg-type]
    size = words["push_size"]
    if not 0 <= size < float("inf"):
        raise InputError(f"--push-size {size}: expected a finite number, not negative")
    if words["pushes"] and size:
        until = float((sim.space.upper - sim.space.lower).max()) / sim.controller.speed
        pushes += random_pushes(seed, ndim, until=until, size=size, duration=until / 20, count=words["pushes"])
    return pushes
