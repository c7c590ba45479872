"""The way that the verbs share: a scene is read and cut into cells, chips are compiled and solved, fields read off."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
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
    from resgrid.planning.field import Field
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
    from resgrid.nodal.drive import scale_drive
    from resgrid.nodal.solve import solve

    run = partial(solve, threads=job.threads)
    boundary = boundary or job.scene.boundary
    netlist = compile_chip(job, report, boundary, start, ideal=ideal)
    estimate = solve_seconds(netlist.node_count)
    if is_first_run():
        report.say(NOTICE)
    point = report.compute(f"solve the {boundary} chip", run, netlist, seconds=estimate, iterates=True)
    if netlist.current_nodes.size and (ideal or is_ideal(job)):
        netlist = scale_drive(netlist, point)
        again = "solve it with its drive scaled to the supply"
        point = report.compute(again, run, netlist, seconds=estimate, iterates=True)
    return Chip(boundary, start, netlist, point)


def compile_chip(job: Job, report: Report, boundary: str, start: int | None = None, *, ideal: bool = False) -> Netlist:
    """Compile one circuit of a scene; as `solve_chip` otherwise, but the drive of an ideal one is not yet scaled."""
    from resgrid.chip.build import build_chip, ideal_netlist
    from resgrid.compiler import compile_space

    space, chip, rules = job.space, job.scene.chip, compile_options(job, boundary, start)
    with report.stage(f"compile the {boundary} chip", seconds=4e-8 * space.cell.size * space.ndim):
        if not (ideal or is_ideal(job)):
            return build_chip(ideal_netlist(space, chip, **rules), chip)
        wall = chip.wall_resistance if boundary == "wall" else None
        return compile_space(space, **rules, resistance=chip.resistance, supply=chip.supply, wall_resistance=wall)


def compile_options(job: Job, boundary: str, start: int | None) -> dict[str, Any]:
    """How a scene's space is compiled: boundary, drive, edge and start cell."""
    drive = job.scene.drive if boundary == "neumann" else None
    cell = start_cell(job, start) if drive == "start" and start is not None else None
    return {"boundary": boundary, "drive": drive, "edge": job.scene.edge, "start": cell}


def is_ideal(job: Job) -> bool:
    """Whether a scene's chip is nothing but its resistors and ideal rails."""
    from resgrid.chip.passes import passes_of

    return not passes_of(job.scene.chip)


def only_boundary(job: Job) -> tuple[str, int | None]:
    """The boundary, and the start that drives it, of a scene that is asked for one chip."""
    scene = job.scene
    boundary = scene.boundary
    if len(scene.k) == 1:
        boundary = {1.0: _driven_boundary(scene), 0.0: "neumann"}.get(scene.k[0], "")
        if not boundary:
            raise InputError(
                f"k = {scene.k[0]} blends two chips, and this makes one: choose --boundary dirichlet or "
                "--boundary neumann ('resgrid run' makes both and blends them)"
            )
    if boundary != "neumann" or scene.drive != "start":
        return boundary, None
    if len(scene.starts) != 1:
        raise InputError(
            f"drive = 'start' ties one start to the supply, and the scene has {len(scene.starts)}; "
            "choose one with --start X,Y"
        )
    return boundary, 0


def blend_fields(job: Job, chips: dict[str, Chip], report: Report) -> list[Field]:
    """The fields that a scene asks for: of its boundary, or one for each k."""
    from resgrid.planning.blend import blend
    from resgrid.planning.field import field_of

    scene = job.scene
    fields: dict[str, Field] = {}

    def field(boundary: str) -> Field:
        if boundary not in fields:
            chips[boundary] = solve_chip(job, report, boundary, ideal=True)
            fields[boundary] = field_of(chips[boundary].point)
        return fields[boundary]

    if not scene.k:
        return [field(scene.boundary)]
    driven = _driven_boundary(scene)
    pure = {1.0: driven, 0.0: "neumann"}
    return [field(pure[k]) if k in pure else blend(field(driven), field("neumann"), k) for k in scene.k]


def _driven_boundary(scene: Scene) -> str:
    """What k = 1 means: the obstacle rail, behind its wall where the scene has one."""
    return "wall" if scene.boundary == "wall" else "dirichlet"


def start_cell(job: Job, number: int) -> tuple[int, ...]:
    """Cell of a start, free if it touches a free one."""
    from resgrid.planning.trace import start_cells, start_points

    cells, _ = start_cells(job.space, start_points(job.space, job.scene.starts[number]))
    return tuple(int(index) for index in cells[0])


def solve_seconds(nodes: int) -> float:
    """Rough time of a direction-safe solution, in seconds, for the bar."""
    return 0.5 + 4e-6 * nodes


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
