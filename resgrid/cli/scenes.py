"""Scenes on the command line: read, changed as options say, cut into cells; keys that a verb ignores are reported."""

from __future__ import annotations

import importlib
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import resgrid as rg
from resgrid.cli.options import CommandInput
from resgrid.cli.terminal import compute, say, stage
from resgrid.errors import InputError, suggestion
from resgrid.spice.dialects import DECK_SUFFIXES

if TYPE_CHECKING:
    from resgrid.chip.build import Form
    from resgrid.planning.petsc_fields import Ranked
    from resgrid.planning.pipeline import Problem, Solution, SolveOptions


@dataclass(frozen=True, eq=False)
class Job:
    """A scene, its space, and the options of its solver: threads, method, ranks and their launcher."""

    scene: rg.Scene
    space: rg.ConfigurationSpace
    threads: int = 1
    method: str = "auto"
    ranks: int | None = None
    launcher: str | None = None

    @cached_property
    def problem(self) -> Problem:
        """What the scene asks for."""
        from resgrid.planning.pipeline import problem_of

        return problem_of(self.scene, space=self.space)

    @cached_property
    def is_ideal(self) -> bool:
        """Whether the scene's chip is nothing but its resistors and ideal rails."""
        from resgrid.chip.effects import of_chip

        return not of_chip(self.scene.chip)

    def solution(self) -> Solution:
        """The ideal circuits and fields that the scene asks for, with their drives scaled to the supply."""
        from resgrid.planning.pipeline import solve_problem

        return solve_problem(self.problem, scaled=True, work=self._work)

    def solve(self, wiring: rg.Wiring, *, ideal: bool = False) -> rg.OperatingPoint:
        """One circuit of the scene, as its chip is or as an ideal grid."""
        return self._work.solve(self.compile(wiring, ideal=ideal), f"solve the {wiring.boundary} chip")

    def compile(self, wiring: rg.Wiring, *, ideal: bool = False, scaled: bool = True) -> rg.Netlist:
        """The same circuit unsolved; not scaled, the drive of an ideal one is left as it was compiled."""
        from resgrid.planning.pipeline import compile_circuit

        if ideal or self.is_ideal:
            return compile_circuit(self.space, wiring, scaled=scaled, work=self._work)
        passes = partial(rg.chip.build_chip, chip=self.scene.chip)
        return compile_circuit(self.space, replace(wiring, rails="cells"), passes=passes, work=self._work)

    def solve_ranked(self, wiring: rg.Wiring) -> Ranked:
        """One circuit of the scene by method "petsc"; its chip must be ideal."""
        if not self.is_ideal:
            raise InputError("method 'petsc' solves the ideal grid, and [chip] describes another: remove its keys")
        return self._work.solve_ranked(self.space, wiring)

    @property
    def _work(self) -> SolveOptions:
        from resgrid.planning.pipeline import solve_options

        return solve_options(self.method, self.ranks, self.launcher, threads=self.threads, observe=_observe)


def open_job(
    source: CommandInput, *, require_goal: bool = True, method: str | None = None, ranks: int | None = None,
    launcher: str | None = None,
) -> Job:  # fmt: skip
    """Read a scene with its changes, and cut it into cells, if what its method takes fits in memory."""
    with stage("read the scene"):
        scene = _load_scene(source)
    _say_degrees(scene)
    if method not in (None, "petsc"):
        from resgrid.core.compiler import require_netlist_memory
        from resgrid.scene.sampling import remedy_of_size

        require_netlist_memory(tuple(axis.cells for axis in scene.axes), remedy_of_size(scene))
    cells = math.prod(axis.cells for axis in scene.axes)
    with stage("cut it into cells", seconds=3e-7 * cells) as progress:
        space = rg.build_space(scene, require_goal=require_goal, progress=progress.count)
    return Job(scene, space, source.threads, method or "auto", ranks, launcher)


def _say_degrees(scene: rg.Scene) -> None:
    """Say so where a start has an angle of more than two turns, which is most often one in degrees."""
    turning = scene.robot.turning_length
    for number, start in enumerate(scene.starts):
        for axis, value in zip(scene.axes, start, strict=True):
            angle = value if axis.unit == "rad" else value / turning if turning and axis is scene.axes[-1] else 0.0
            if abs(angle) > 4 * math.pi:
                turns, meant = f"{angle / math.tau:.3g} turns", f"{angle:g} degrees are {math.radians(angle):.6g} rad"
                say(
                    f"starts[{number}]: {axis.name} = {value:g} is an angle of {turns}: angles are in radians ({meant})"
                )


def _load_scene(source: CommandInput) -> rg.Scene:
    from resgrid.scene.overrides import build_changed
    from resgrid.scene.reading import is_link, link_document, read_document

    if source.dialect != "auto" or source.root is not None:
        raise InputError(f"{source.file} is no deck: --read-as and --root say how decks are read; remove them")
    if source.file == "-":
        return _piped_scene(source)
    if is_link(source.file):
        _refuse_map_options(source)
        document = link_document(source.file)
    elif Path(source.file).suffix.lower() in DECK_SUFFIXES:
        raise InputError(f"{source.file}: this is a deck, and a scene or a map is needed; decks go to 'resgrid check'")
    else:
        document = read_document(_named_file(source.file), source.map_options)
    return build_changed(document, source.changes)


def _named_file(name: str) -> str | Path:
    """Return the file of a shipped scene, and report its place, or else the name itself."""
    from resgrid.scene.shipped import shipped_scene, shipped_scenes

    shipped = shipped_scene(name)
    if shipped is None and name == Path(name).name and not Path(name).exists():
        near = suggestion(name.removesuffix(".toml"), shipped_scenes())
        raise InputError(f"{name}: there is no such file; {near or 'check the name and the folder'}")
    if shipped is not None:
        say(f"{name} is not a file in this folder; reading the shipped scene {shipped}")
    return shipped or name


def _refuse_map_options(source: CommandInput) -> None:
    if source.map_options:
        options = ", ".join(source.map_options)
        raise InputError(f"{source.file}: this scene reads no map, so {options} would do nothing; leave that out")


def _piped_scene(source: CommandInput) -> rg.Scene:
    """A scene from standard input: TOML, or a map known by its first bytes."""
    import tempfile

    from resgrid._internal.files import decode
    from resgrid.scene.maps.formats import FORMATS
    from resgrid.scene.overrides import build_changed
    from resgrid.scene.reading import parse_document, read_document

    data = sys.stdin.buffer.read()
    if not data.strip():
        raise InputError("standard input: nothing was piped in; give a scene file, or pipe one")
    if (
        not data.startswith(tuple(begin for entry in FORMATS.values() for begin in entry.magic))
        and source.map_options.get("format") is None
    ):
        _refuse_map_options(source)
        return build_changed(parse_document(decode(data, Path("standard input")), "standard input"), source.changes)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "standard_input"
        file.write_bytes(data)
        return build_changed(read_document(file, source.map_options), source.changes)


FIRST_RUN = (
    "the first solution after an installation also compiles its kernels, once: 10 to 60 s, longer on a busy machine "
    "('python -m resgrid.cli.warm' compiles all of them beforehand, on all cores)"
)
_FIRST_KERNEL = "csr_kernels.conductances_by_row*.nbi"
"""Cache index of the first kernel that every solution compiles."""


def is_first_run() -> bool:
    """Return whether numba has not cached the kernels of a solution yet."""
    from resgrid._internal.jit import cache_folder
    from resgrid.solvers.csr_kernels import conductances_by_row

    folder = cache_folder(conductances_by_row)
    return folder is None or not any(folder.glob(_FIRST_KERNEL))


def _load_numba() -> None:
    """Load numba without scipy's linear algebra, which takes a fifth of a second, and which none of our loops calls.

    numba looks once whether it is there, for ``np.cov`` in loops.
    """
    if "numba.np.arraymath" in sys.modules or "scipy.linalg" in sys.modules:
        return
    sys.modules["scipy.linalg"] = None  # type: ignore[assignment]
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        del sys.modules["scipy.linalg"]


def _observe(name: str, function: Callable[..., Any], *arguments: Any, iterates: bool = False, **options: Any) -> Any:
    """Report a stage of the library."""
    _load_numba()
    if iterates and is_first_run():
        say(FIRST_RUN)
    return compute(name, function, *arguments, iterates=iterates, **options)


def require_starts(scene: rg.Scene) -> None:
    """Refuse a scene without a start."""
    if not scene.starts:
        from resgrid.scene.sampling import adding

        remedy = adding(scene, "starts = [[...]]", "--start")
        raise InputError(f"{scene.source or 'scene'}: there is no start; {remedy}")


def size_of(shape: Sequence[int]) -> str:
    """A grid's size, for people."""
    return " x ".join(str(size) for size in shape)


def place_of(point: Sequence[float]) -> str:
    """A point, for people."""
    return "(" + ", ".join(f"{value:.6g}" for value in point) + ")"


def element_counts(netlist: rg.Netlist) -> dict[str, int]:
    """How many nodes and elements a circuit has, as ``--json`` gives it."""
    return {
        "nodes": netlist.node_count,
        "resistors": len(netlist.conductance),
        "voltage_sources": len(netlist.source_volts),
        "current_sources": len(netlist.current_amps),
        "capacitors": len(netlist.capacitance),
        "nonlinear_resistors": len(netlist.nonlinear_current),
    }


def free_counts(space: rg.ConfigurationSpace) -> dict[str, int]:
    """How many cells are free, and how many of these lead to no goal, as ``--json`` gives it."""
    free = space.cell == rg.Cell.FREE
    return {"free_cells": int(free.sum()), "unreachable_cells": int((free & ~space.goal_connected).sum())}


def solution_summary(name: str, op: rg.OperatingPoint, space: rg.ConfigurationSpace) -> dict[str, Any]:
    """The figures of a solved chip, as ``--json`` gives them."""
    return {
        "chip": name,
        "nodes": op.netlist.node_count,
        "resistors": len(op.netlist.conductance),
        **free_counts(space),
        "kcl_residual": op.kcl_residual,
        "power": op.power,
        "solver": op.method,
        "threads": op.threads,
        "iterations": op.iterations,
        "backward_error": op.backward_error,
        "entry_error": op.entry_error if math.isfinite(op.entry_error) else None,
        "seconds": dict(op.seconds),
    }


def ranked_summary(name: str, ranked: Ranked) -> dict[str, Any]:
    """The figures of a field that ranks solved, as ``--json`` gives them."""
    field, report = ranked.field, ranked.report
    assert field.safe is not None
    return {
        "chip": name,
        **free_counts(field.space),
        "direction_safe_cells": int(field.safe.sum()),
        "solver": f"petsc, {report.preconditioner}",
        "ranks": len(report.peaks),
        "iterations": report.iterations,
        "residual": report.error,
        "peak_bytes": list(report.peaks),
        "seconds": dict(report.seconds),
    }


_READ = "they say how voltages are read, and a circuit holds no meter; 'resgrid chip' applies them"
_WHY = {
    "circuit": _READ,
    "tiles": _READ,
    "grid": "fields and paths are those of the ideal grid (decks hold the chip); 'resgrid chip' asks what they do to a "
    "robot",
}


def report_ignored(job: Job, form: Form | Literal["chip"], *, k: Sequence[float] = ()) -> dict[str, list[str]]:
    """Report the keys of a scene that a verb ignores, with reasons, and return them for JSON."""
    from resgrid.chip.build import keys_not_held

    scene, problem = job.scene, job.problem
    keys = [] if form == "chip" else [f"chip.{key}" for key in keys_not_held(scene.chip, form)]
    if keys:
        say(f"ignored: {', '.join(keys)}: {_WHY[form]}")
    if scene.map is not None and "headings" in scene.map.table and scene.robot.turning_length is None:
        keys.append("map.headings")
        say("ignored: map.headings: this robot does not turn")
    if form != "grid":
        k = several_k(scene)
    if k:
        say(
            f"ignored: k = {', '.join(f'{share:g}' for share in k)}: this is one chip or one blend; choose it with "
            "--boundary or --k ('resgrid run' makes them all)"
        )
    wirings = problem.wirings.values() if form == "grid" else [problem.only_wiring()[1]]
    drive = scene.drive is not None and not any(wiring.is_driven for wiring in wirings)
    if drive:
        say(f"ignored: drive = {scene.drive!r}: here obstacles are a rail, and that drives the grid")
    wall = form != "chip" and scene.chip.wall_resistance is not None
    if wall and not any(wiring.boundary == "wall" for wiring in wirings):
        keys.append("chip.wall_resistance")
        say("ignored: chip.wall_resistance: obstacles have walls where boundary = 'wall'")
    return {"ignored": [*keys, *(["k"] if k else []), *(["drive"] if drive else [])]}


def several_k(scene: rg.Scene) -> tuple[float, ...]:
    """The blends of a scene that asks for several."""
    return scene.k if len(scene.k) > 1 else ()
