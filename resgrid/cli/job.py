"""The way that the verbs share: a scene is read and cut into cells, chips are compiled and solved, fields read off."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from resgrid.cli.first_run import NOTICE, is_first_run
from resgrid.cli.options import SceneChoice
from resgrid.cli.report import Report
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.netlist import Netlist
    from resgrid.nodal.operating_point import OperatingPoint
    from resgrid.planning.road import Problem, Solution
    from resgrid.scene import Scene
    from resgrid.space import ConfigurationSpace

DECK_SUFFIXES = (".cir", ".sp", ".spice", ".ckt", ".net", ".cdl")
SPECTRE_SUFFIX = ".scs"


@dataclass(frozen=True, eq=False)
class Job:
    """A scene, the space that was cut from it, and how many threads may solve it."""

    scene: Scene
    space: ConfigurationSpace
    threads: int = 1


@dataclass(frozen=True, eq=False)
class Chip:
    """One circuit of a scene, and what its meters read.

    Attributes
    ----------
    boundary : str
        ``dirichlet``, ``neumann`` or ``wall``.
    start : int or None
        Number of the start that drives it.
    netlist : Netlist
        A uniform drive is scaled so that the highest node of the ideal grid sits at the supply.
    point : OperatingPoint
    """

    boundary: str
    start: int | None
    netlist: Netlist
    point: OperatingPoint

    @property
    def name(self) -> str:
        """Its boundary, or ``neumann_start_0`` for one driven by the first start."""
        return self.boundary if self.start is None else f"{self.boundary}_start_{self.start}"


def open_job(choice: SceneChoice, report: Report, *, require_goal: bool = True) -> Job:
    """Read a scene with its changes, and cut it into cells."""
    from resgrid.scene import sample

    with report.stage("read the scene"):
        scene = load_scene(choice)
    cells = math.prod(axis.cells for axis in scene.axes)
    with report.stage("cut it into cells", seconds=3e-7 * cells) as progress:
        space = sample(scene, require_goal=require_goal, progress=progress.tell)
    return Job(scene, space, choice.threads)


def load_scene(choice: SceneChoice) -> Scene:
    """Read a scene and change the keys that the command line names."""
    from resgrid.scene import apply_overrides, read_scene

    if Path(choice.source).suffix.lower() in DECK_SUFFIXES:
        raise InputError(
            f"{choice.source}: this is a deck, and a scene or a map is needed; decks go to 'resgrid check'"
        )
    scene = _piped_scene(choice) if choice.source == "-" else read_scene(choice.source, **choice.map_options)
    return apply_overrides(scene, choice.changes) if choice.changes else scene


def _piped_scene(choice: SceneChoice) -> Scene:
    """A scene from standard input: TOML, or a map known by its first bytes."""
    import tempfile

    from resgrid.files import decode
    from resgrid.scene import parse_scene, read_scene

    data = sys.stdin.buffer.read()
    if not data.strip():
        raise InputError("standard input: nothing was piped in; give a scene file, or pipe one")
    if _is_toml(data) and choice.map_options.get("format") is None:
        return parse_scene(decode(data, Path("standard input")), "standard input")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "standard_input"
        file.write_bytes(data)
        return read_scene(file, **choice.map_options)


def _is_toml(data: bytes) -> bool:
    magic = (b"\x93NUMPY", b"type ", b"\x89PNG", b"P2", b"P5", b"BM", b"GIF8")
    return not data.startswith(magic)


def solve_chip(
    job: Job, report: Report, boundary: str | None = None, start: int | None = None, *, ideal: bool = False
) -> Chip:
    """Compile one circuit of a scene and solve it."""
    from resgrid.planning.road import solve_circuit

    if is_first_run():
        report.say(NOTICE)
    boundary = boundary or job.scene.boundary
    point = solve_circuit(job.space, threads=job.threads, **_circuit(job, report, boundary, start, ideal=ideal))
    return Chip(boundary, start, point.netlist, point)


def compile_chip(job: Job, report: Report, boundary: str, start: int | None = None, *, ideal: bool = False) -> Netlist:
    """Compile one circuit of a scene; as `solve_chip` otherwise, but the drive of an ideal one is not yet scaled."""
    from resgrid.planning.road import compile_circuit

    options = _circuit(job, report, boundary, start, ideal=ideal)
    return compile_circuit(job.space, scaled=options["passes"] is not None, **options)


def _circuit(job: Job, report: Report, boundary: str, start: int | None, *, ideal: bool) -> dict[str, Any]:
    """How a circuit is wired and what is made of it, as the road takes it."""
    from resgrid.chip.build import build_chip

    problem = problem_of_job(job, boundary)
    wiring = problem.wiring if start is None or not problem.start_driven else problem.driven_by(start)[1]
    if ideal or is_ideal(job):
        return {"wiring": wiring, "passes": None, "observe": report.compute}
    passes = partial(build_chip, chip=job.scene.chip)
    return {"wiring": replace(wiring, rails="cells"), "passes": passes, "observe": report.compute}


def chip_of(name: str, op: OperatingPoint) -> Chip:
    """A solved circuit under the name that the road gave it."""
    boundary, _, start = name.partition("_start_")
    return Chip(boundary, int(start) if start else None, op.netlist, op)


def problem_of_job(job: Job, boundary: str | None = None) -> Problem:
    """What a scene asks for, or one circuit of it."""
    from resgrid.planning.road import problem_of

    return problem_of(job.scene, boundary=boundary, space=job.space)


def compile_options(job: Job, boundary: str, start: int | None) -> dict[str, Any]:
    """How a scene's space is compiled: boundary, drive, edge and start cell."""
    problem = problem_of_job(job, boundary)
    wiring = problem.wiring if start is None or not problem.start_driven else problem.driven_by(start)[1]
    return {"boundary": boundary, "drive": wiring.drive, "edge": wiring.edge, "start": wiring.start}


def is_ideal(job: Job) -> bool:
    """Whether a scene's chip is nothing but its resistors and ideal rails."""
    from resgrid.chip.passes import passes_of

    return not passes_of(job.scene.chip)


def only_boundary(job: Job) -> tuple[str, int | None]:
    """The boundary, and the start that drives it, of a scene that is asked for one chip."""
    wiring = problem_of_job(job).only_wiring()[1]
    return wiring.boundary, None if wiring.start is None else 0


def solution_of(job: Job, report: Report) -> Solution:
    """The ideal circuits and fields that a scene asks for, for pictures and decks too: drives are scaled."""
    from resgrid.planning.road import solve_problem

    if is_first_run():
        report.say(NOTICE)
    return solve_problem(problem_of_job(job), scaled=True, threads=job.threads, observe=report.compute)


def size_of(shape: Sequence[int]) -> str:
    """A grid's size, for people."""
    return " x ".join(str(size) for size in shape)


def place_of(point: Sequence[float]) -> str:
    """A point, for people."""
    return "(" + ", ".join(f"{value:.6g}" for value in point) + ")"


def solution_summary(chip: Chip, space: ConfigurationSpace) -> dict[str, Any]:
    """The figures of a solved chip, as ``--json`` gives them."""
    from resgrid.space import Cell

    free = space.cell == Cell.FREE
    return {
        "chip": chip.name,
        "nodes": chip.netlist.node_count,
        "resistors": len(chip.netlist.conductance),
        "free_cells": int(free.sum()),
        "unreachable_cells": int((free & ~space.goal_connected).sum()),
        "kcl_residual": chip.point.kcl_residual,
        "power": chip.point.power,
        "solver": chip.point.method,
        "iterations": chip.point.iterations,
        "backward_error": chip.point.backward_error,
        "entry_error": chip.point.entry_error if math.isfinite(chip.point.entry_error) else None,
        "seconds": dict(chip.point.seconds),
    }
