"""Scenes on the command line: read, changed as options say, cut into cells; what a verb does not heed is named."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import resgrid
from resgrid.cli.options import Source
from resgrid.cli.report import compute, say, stage
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.chip.build import Form
    from resgrid.netlist import Netlist
    from resgrid.nodal.operating_point import OperatingPoint
    from resgrid.planning.field import Field
    from resgrid.scene import Chip as ChipTable, Scene
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


def open_job(source: Source, *, require_goal: bool = True) -> Job:
    """Read a scene with its changes, and cut it into cells."""
    from resgrid.scene import sample

    with stage("read the scene"):
        scene = load_scene(source)
    cells = math.prod(axis.cells for axis in scene.axes)
    with stage("cut it into cells", seconds=3e-7 * cells) as progress:
        space = sample(scene, require_goal=require_goal, progress=progress.count)
    return Job(scene, space, source.threads)


def load_scene(source: Source) -> Scene:
    """Read a scene and change the keys that the command line names."""
    from resgrid.scene import apply_overrides, read_scene

    if Path(source.file).suffix.lower() in DECK_SUFFIXES:
        raise InputError(f"{source.file}: this is a deck, and a scene or a map is needed; decks go to 'resgrid check'")
    scene = _piped_scene(source) if source.file == "-" else read_scene(source.file, **source.map_options)
    return apply_overrides(scene, source.changes) if source.changes else scene


def _piped_scene(source: Source) -> Scene:
    """A scene from standard input: TOML, or a map known by its first bytes."""
    import tempfile

    from resgrid.files import decode
    from resgrid.scene import parse_scene, read_scene

    data = sys.stdin.buffer.read()
    if not data.strip():
        raise InputError("standard input: nothing was piped in; give a scene file, or pipe one")
    if _is_toml(data) and source.map_options.get("format") is None:
        return parse_scene(decode(data, Path("standard input")), "standard input")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "standard_input"
        file.write_bytes(data)
        return read_scene(file, **source.map_options)


def _is_toml(data: bytes) -> bool:
    magic = (b"\x93NUMPY", b"type ", b"\x89PNG", b"P2", b"P5", b"BM", b"GIF8")
    return not data.startswith(magic)


def solve_chip(job: Job, boundary: str | None = None, start: int | None = None, *, ideal: bool = False) -> Chip:
    """Compile one circuit of a scene and solve it."""
    from resgrid.nodal.drive import scale_drive

    boundary = boundary or job.scene.boundary
    netlist = compile_chip(job, boundary, start, ideal=ideal)
    point = _solved(f"solve the {boundary} chip", netlist, job.threads)
    if netlist.current_nodes.size and (ideal or is_ideal(job)):
        netlist = scale_drive(netlist, point)
        point = _solved("solve it with its drive scaled to the supply", netlist, job.threads)
    return Chip(boundary, start, netlist, point)


def _solved(name: str, netlist: Netlist, threads: int) -> OperatingPoint:
    from resgrid.nodal.solve import solve

    if is_first_run():
        say(FIRST_RUN)
    seconds = 0.5 + 4e-6 * netlist.node_count
    return compute(name, lambda stage: solve(netlist, threads=threads, progress=stage.follow), seconds=seconds)


def compile_chip(job: Job, boundary: str, start: int | None = None, *, ideal: bool = False) -> Netlist:
    """Compile one circuit of a scene; as `solve_chip` otherwise, but the drive of an ideal one is not yet scaled."""
    from resgrid.chip.build import build_chip, ideal_netlist
    from resgrid.compiler import compile_space

    space, chip, rules = job.space, job.scene.chip, compile_options(job, boundary, start)
    with stage(f"compile the {boundary} chip", seconds=4e-8 * space.cell.size * space.ndim):
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


def blend_fields(job: Job, chips: dict[str, Chip]) -> list[Field]:
    """The fields that a scene asks for: of its boundary, or one for each k."""
    from resgrid.planning.blend import blend
    from resgrid.planning.field import field_of

    scene = job.scene
    fields: dict[str, Field] = {}

    def field(boundary: str) -> Field:
        if boundary not in fields:
            chips[boundary] = solve_chip(job, boundary, ideal=True)
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


FIRST_RUN = "the first solution on this machine also compiles its loops: half a minute, once"
_KEPT_LOOP = "row_kernels.conductances_by_row*.nbi"


def is_first_run() -> bool:
    """Whether no compiled loops are kept yet, where numba keeps them."""
    kept = os.environ.get("NUMBA_CACHE_DIR")
    if kept:
        return not any(Path(kept).glob(f"*/{_KEPT_LOOP}"))
    return not any((Path(resgrid.__file__).parent / "nodal" / "__pycache__").glob(_KEPT_LOOP))


_READ = "they say how voltages are read, and a circuit holds no meter; 'resgrid chip' heeds them"
_WHY = {
    "circuit": _READ,
    "tiles": _READ,
    "grid": "fields and paths are those of the ideal grid (decks hold the chip); 'resgrid chip' asks what they do to a "
    "robot",
}


def tell_unheeded(job: Job, form: Form | Literal["chip"], *, k: Sequence[float] = ()) -> dict[str, list[str]]:
    """Say which keys of a scene make no difference to what a verb makes of it."""
    from resgrid.chip.build import keys_not_held

    keys = [] if form == "chip" else [f"chip.{key}" for key in keys_not_held(job.scene.chip, form)]
    if keys:
        say(f"not heeded: {', '.join(keys)}: {_WHY[form]}")
    k = k if form == "grid" else several_k(job)
    if k:
        say(
            f"not heeded: k = {', '.join(f'{share:g}' for share in k)}: this is one chip or one blend; choose it with "
            "--boundary or --k ('resgrid run' makes them all)"
        )
    drive = job.scene.drive is not None and not _is_driven(job, form)
    if drive:
        say(f"not heeded: drive = {job.scene.drive!r}: here obstacles are a rail, and that drives the grid")
    return {"not_heeded": [*keys, *(["k"] if k else []), *(["drive"] if drive else [])]}


def _is_driven(job: Job, form: Form | Literal["chip"]) -> bool:
    """Whether anything is made whose obstacles are open."""
    if form != "grid":
        return only_boundary(job)[0] == "neumann"
    return any(share < 1 for share in job.scene.k) if job.scene.k else job.scene.boundary == "neumann"


def several_k(job: Job) -> tuple[float, ...]:
    """The blends of a scene that asks for several."""
    return job.scene.k if len(job.scene.k) > 1 else ()


def require_tiles(chip: ChipTable) -> None:
    """Refuse a chip that an array of tiles cannot be."""
    from resgrid.chip.build import READING, keys_not_held

    keys = [f"chip.{key}" for key in keys_not_held(chip, "tiles") if key not in READING]
    if keys:
        raise InputError(
            f"tiles cannot hold {', '.join(keys)}: write the flat form, which does, or remove them from [chip]"
        )


def tell_assumed(told: ChipTable, circuit: Chip) -> dict[str, dict[str, Any]]:
    """Say which switches the tiles of a circuit have that its scene does not describe."""
    from resgrid.spice.write.tiles import Tile, complete_tile

    tile = complete_tile(Tile.of(vars(told)), circuit.netlist.cells)
    assumed = {
        f"chip.{key}": ohms
        for key, ohms in vars(tile).items()
        if "_switch_" in key and ohms is not None and getattr(told, key) is None
    }
    if assumed:
        values = ", ".join(f"{key} = {ohms:g}" for key, ohms in assumed.items())
        say(f"tiles have switches, and [chip] does not describe all; assumed, in ohms: {values}")
    return {"assumed": assumed}


def element_counts(netlist: Netlist) -> dict[str, int]:
    """How many nodes and elements a circuit has, as ``--json`` gives it."""
    return {
        "nodes": netlist.node_count,
        "resistors": len(netlist.conductance),
        "voltage_sources": len(netlist.source_volts),
        "current_sources": len(netlist.current_amps),
    }


def require_starts(scene: Scene) -> None:
    """Refuse a scene without a start."""
    if not scene.starts:
        where = scene.source or "scene"
        raise InputError(f"{where}: there is no start; add starts = [[...]] to the scene, or say --start X,Y")
