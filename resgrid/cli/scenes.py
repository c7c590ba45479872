"""Functions of subcommands that accept scenes: read, change by options, solve, and report ignored keys."""

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
from resgrid.cli.options import CommandInput, accepts_decks
from resgrid.cli.piped_scenes import piped_scene, refuse_map_options
from resgrid.cli.terminal import compute, say, stage
from resgrid.cli.workers import workers_for
from resgrid.errors import InputError, suggestion
from resgrid.spice.dialects import DECK_SUFFIXES

if TYPE_CHECKING:
    from resgrid.chip.build import Form
    from resgrid.planning.petsc_fields import Ranked
    from resgrid.planning.pipeline import Problem, Solution, SolveOptions
    from resgrid.scene.reading import Document


@dataclass(frozen=True, eq=False)
class Job:
    """A scene with its configuration space and the options of its solution.

    `scene`: the scene; `space`: its cells; `threads`: largest number of threads of the solver; `method`: solution
    method, "auto", "direct", "multigrid" or "petsc"; `ranks`: number of processes of method petsc, None for the default
    of 2; `launcher`: command that starts these processes, None for mpiexec.
    """

    scene: rg.Scene
    space: rg.ConfigurationSpace
    threads: int = 1
    method: str = "auto"
    ranks: int | None = None
    launcher: str | None = None

    @cached_property
    def problem(self) -> Problem:
        """Planning problem of the scene: space, wirings of the circuits to be solved, weights k and starts."""
        from resgrid.planning.pipeline import problem_of

        return problem_of(self.scene, space=self.space)

    @cached_property
    def is_ideal(self) -> bool:
        """Whether the scene's chip has no imperfections, so that it consists of nominal resistors and ideal rails."""
        from resgrid.chip.effects import of_chip

        return not of_chip(self.scene.chip)

    def solution(self) -> Solution:
        """Return the solved ideal circuits of the scene with their fields.

        Injected currents are scaled such that the highest node voltage is the supply.
        """
        from resgrid.planning.pipeline import solve_problem

        return solve_problem(self.problem, scaled=True, work=self._work)

    def solve(self, wiring: rg.Wiring, *, ideal: bool = False) -> rg.OperatingPoint:
        """Return the operating point of one circuit of the scene.

        `wiring`: boundary conditions and drive of the circuit; `ideal`: True solves the ideal grid, False the chip with
        its imperfections.
        """
        return self._work.solve(self.compile(wiring, ideal=ideal), f"solve the {wiring.boundary} chip")

    def compile(self, wiring: rg.Wiring, *, ideal: bool = False, scaled: bool = True) -> rg.Netlist:
        """Return the netlist of one circuit of the scene.

        `wiring`: boundary conditions and drive of the circuit; `ideal`: True compiles the ideal grid, False the chip
        with its imperfections; `scaled`: whether the injected currents of an ideal grid are scaled such that the
        highest node voltage is the supply.  A chip with imperfections always gets the currents that are scaled for the
        ideal grid.
        """
        from resgrid.planning.pipeline import compile_circuit

        if ideal or self.is_ideal:
            return compile_circuit(self.space, wiring, scaled=scaled, work=self._work)
        build_chip = partial(rg.chip.build_chip, chip=self.scene.chip)
        return compile_circuit(self.space, replace(wiring, rails="cells"), build_chip=build_chip, work=self._work)

    def solve_ranked(self, wiring: rg.Wiring) -> Ranked:
        """Return the field of one circuit of the scene, solved by method petsc, with a report on the processes.

        `wiring`: boundary conditions of the circuit.  Raises InputError unless the chip is ideal.
        """
        if not self.is_ideal:
            raise InputError(
                "--method petsc solves only the ideal grid: remove the keys of [chip], or choose another --method"
            )
        return self._work.solve_ranked(self.space, wiring)

    @property
    def _work(self) -> SolveOptions:
        from resgrid.planning.pipeline import solve_options

        return solve_options(self.method, self.ranks, self.launcher, threads=self.threads, observe=_observe)


def open_job(
    source: CommandInput, *, require_goal: bool = True, method: str | None = None, ranks: int | None = None,
    launcher: str | None = None,
) -> Job:  # fmt: skip
    """Return the job of an input: read the scene with its changes, check the memory, and build the space.

    Raises BudgetError if `method` needs a netlist (all methods but petsc) that would not fit in memory.

    `source`: the input with its options; `require_goal`: whether a scene without a goal is an error; `method`: solution
    method, None if nothing is solved; `ranks`: number of processes of method petsc; `launcher`: command that starts
    these processes.
    """
    with stage("read the scene"):
        scene = load_scene(source)
    _report_large_angles(scene)
    if method not in (None, "petsc"):
        from resgrid.core.compiler import require_netlist_memory
        from resgrid.scene.sampling import remedy_of_size

        require_netlist_memory(tuple(axis.cells for axis in scene.axes), remedy_of_size(scene))
    cells = math.prod(axis.cells for axis in scene.axes)
    with stage("build the space", seconds=3e-7 * cells) as progress, workers_for(scene, cells) as workers:
        space = rg.build_space(scene, require_goal=require_goal, progress=progress.count, executor=workers)
    return Job(scene, space, source.threads, method or "auto", ranks, launcher)


def _report_large_angles(scene: rg.Scene) -> None:
    """Print a message for each start angle of more than two turns, which is probably given in degrees, not radians."""
    turning = scene.robot.turning_length
    for number, start in enumerate(scene.starts):
        for axis, value in zip(scene.axes, start, strict=True):
            angle = value if axis.unit == "rad" else value / turning if turning and axis is scene.axes[-1] else 0.0
            if abs(angle) > 4 * math.pi:
                turns, degrees = f"{angle / math.tau:.3g} turns", f"{angle:g} degrees are {math.radians(angle):.6g} rad"
                say(
                    f"starts[{number}]: {axis.name} = {value:g} is an angle of {turns}; give angles in radians "
                    f"({degrees})"
                )


def load_scene(source: CommandInput) -> rg.Scene:
    """Return the scene of an input, with the changes that its options describe; raise InputError for a deck."""
    from resgrid.scene.overrides import build_changed
    from resgrid.scene.reading import is_link, link_document

    if source.dialect != "auto" or source.root is not None:
        hint = ", or add --read-as if the file is a deck" if source.dialect == "auto" else ""
        raise InputError(f"{source.name} is not a deck: --read-as and --root are for decks; remove them{hint}")
    if source.file == "-":
        return piped_scene(source)
    if is_link(source.file):
        refuse_map_options(source)
        document = link_document(source.file)
    elif Path(source.file).suffix.lower() in DECK_SUFFIXES:
        raise InputError(f"{source.name} is a deck, but a scene or a map is needed; use 'resgrid check' for decks")
    else:
        document = _read_file(source)
    return build_changed(document, source.changes)


def _read_file(source: CommandInput) -> Document:
    """Return the unvalidated document of a scene file or map; raise InputError, with all possible kinds, for others."""
    from resgrid.scene.maps.formats import MAP_SUFFIXES, UnknownFormatError
    from resgrid.scene.reading import read_document

    try:
        return read_document(_named_file(source.file), source.map_options)
    except UnknownFormatError:
        if not accepts_decks():
            raise
    decks, maps = ", ".join(DECK_SUFFIXES), ", ".join(MAP_SUFFIXES)
    raise InputError(
        f"{source.file}: this is not a scene, deck or map of a known format; scenes end in .toml, decks in {decks}, "
        f"maps in {maps}; rename the file, or give the dialect of a deck (--read-as) or the format of a map (--format)"
    )


def _named_file(name: str) -> str | Path:
    """Return the file of the shipped scene with the name of an input, or the name unchanged for all other inputs.

    A file in the working folder takes precedence over a shipped scene of the same name.  A message reports the shipped
    scene.  Raises InputError for a name without a folder that is neither a file nor a shipped scene.
    """
    from resgrid.scene.shipped import shipped_scene, shipped_scenes

    shipped = shipped_scene(name)
    if shipped is None and name == Path(name).name and not Path(name).exists():
        near = suggestion(name.removesuffix(".toml"), shipped_scenes())
        raise InputError(f"{name}: there is no such file; {near or 'check the name and the folder'}")
    if shipped is not None:
        say(f"{name} is not a file in this folder; reading the shipped scene {shipped}")
    return shipped or name


FIRST_RUN = (
    "the first solution after an installation compiles its kernels, which takes 10 to 60 s, longer on a busy machine "
    "('python -m resgrid.cli.warm' compiles all kernels in advance, on all cores)"
)
_FIRST_KERNEL = "csr_kernels.conductances_by_row*.nbi"
"""File name pattern of numba's cache of one kernel; every solution compiles this kernel before all others."""


def is_first_run() -> bool:
    """Return whether the next solution compiles the kernels for circuits, because the cache does not hold them yet.

    The result is False if caching is disabled; an empty or missing cache folder gives True.
    """
    from resgrid._internal.jit import cache_folder
    from resgrid.solvers.csr_kernels import conductances_by_row

    folder = cache_folder(conductances_by_row)
    return folder is not None and not any(folder.glob(_FIRST_KERNEL))


def _load_numba() -> None:
    """Import numba without scipy.linalg, whose import takes 0.2 s and which no kernel uses.

    During its import, numba checks whether scipy.linalg exists, which ``np.cov`` in kernels would need.
    """
    if "numba.np.arraymath" in sys.modules or "scipy.linalg" in sys.modules:
        return
    sys.modules["scipy.linalg"] = None  # type: ignore[assignment]
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        del sys.modules["scipy.linalg"]


def _observe(name: str, function: Callable[..., Any], *arguments: Any, iterates: bool = False, **options: Any) -> Any:
    """Call a function of the library as a stage (step of a subcommand) with a progress bar, and return its value.

    `name`: name of the stage; `arguments`: arguments of the function; `iterates`: whether the function takes a keyword
    ``progress``, a function that is called in every iteration; `options`: further keywords of `terminal.compute`.
    """
    _load_numba()
    if iterates and is_first_run():
        say(FIRST_RUN)
    return compute(name, function, *arguments, iterates=iterates, **options)


def require_starts(scene: rg.Scene) -> None:
    """Raise InputError, with a remedy, for a scene without a start."""
    if not scene.starts:
        from resgrid.scene.sampling import adding

        remedy = adding(scene, "starts = [[...]]", "--start")
        raise InputError(f"{scene.source or 'scene'}: there is no start; {remedy}")


def size_of(shape: Sequence[int]) -> str:
    """Return the numbers of cells of a grid as text, such as ``8 x 8``."""
    return " x ".join(str(size) for size in shape)


def place_of(point: Sequence[float]) -> str:
    """Return a point as text in parentheses, with at least six significant digits and three decimals."""
    from resgrid.scene.nearest_place import place_text

    return place_text(point)


def element_counts(netlist: rg.Netlist) -> dict[str, int]:
    """Return the numbers of nodes and of each kind of element of a circuit as a dictionary for JSON.

    Keys: ``nodes`` and plurals of the kinds, such as ``voltage_sources``.
    """
    return {
        "nodes": netlist.node_count,
        "resistors": len(netlist.conductance),
        "voltage_sources": len(netlist.source_volts),
        "current_sources": len(netlist.current_amps),
        "capacitors": len(netlist.capacitance),
        "nonlinear_resistors": len(netlist.nonlinear_current),
    }


def free_counts(space: rg.ConfigurationSpace) -> dict[str, int]:
    """Return a dictionary for JSON with the numbers of ``free_cells`` and of ``unreachable_cells`` among them.

    An unreachable cell is a free cell without a path to a goal.
    """
    free = space.cell == rg.Cell.FREE
    return {"free_cells": int(free.sum()), "unreachable_cells": int((free & ~space.goal_connected).sum())}


def solution_summary(name: str, op: rg.OperatingPoint, space: rg.ConfigurationSpace) -> dict[str, Any]:
    """Return the summary of an operating point as a dictionary for JSON.

    Keys: ``chip`` (the name of the circuit), counts (``nodes``, ``resistors`` and those of `free_counts`), ``power`` in
    watts, ``seconds`` by stage, and fields of `OperatingPoint` such as ``kcl_residual``; ``entry_error``, the bound on
    the relative error of every voltage, is None without a finite bound.  `name`: name of the circuit; `space`: space
    from which the circuit was compiled.
    """
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
    """Return the summary of a solution by method petsc as a dictionary for JSON; `name`: name of the circuit.

    Keys: ``chip`` (the name), counts of cells, ``solver``, ``ranks`` (number of processes), ``iterations``,
    ``residual`` (norm relative to that of the right-hand side), ``peak_bytes`` (largest memory of each process) and
    ``seconds`` by stage.
    """
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


_READ_OUT = "they describe the measurement of voltages, which is not part of the circuit; 'resgrid chip' applies them"
_REASONS = {
    "circuit": _READ_OUT,
    "tiles": _READ_OUT,
    "grid": "fields and paths are those of the ideal grid (decks contain the chip); 'resgrid chip' computes their "
    "effect on a robot",
}
"""Reasons why keys of the chip are ignored, by the form of the circuit: "circuit", "tiles", or "grid" (the ideal grid).
"""


def report_ignored(
    job: Job, form: Form | Literal["chip"], *, k: Sequence[float] = (), wiring: rg.Wiring | None = None
) -> dict[str, list[str]]:
    """Print the keys of a scene that a subcommand ignores, with reasons; return ``{"ignored": keys}`` for JSON.

    `form`: form of the circuit that the subcommand uses: "circuit" (all elements of the chip, without its read-out),
    "tiles" (array of subcircuits), "grid" (ideal grid), or "chip" if no key of the chip is ignored; `k`: weights k that
    the subcommand ignores, for "grid".  In the other forms, a scene with several circuits (a blend) has all its weights
    ignored; `wiring`: wiring of the circuit, None for that of a scene with one circuit.
    """
    from resgrid.chip.build import keys_not_held

    scene, problem = job.scene, job.problem
    keys = [] if form == "chip" else [f"chip.{key}" for key in keys_not_held(scene.chip, form)]
    if keys:
        say(f"ignored: {', '.join(keys)}: {_REASONS[form]}")
    if scene.map is not None and "headings" in scene.map.table and scene.robot.turning_length is None:
        keys.append("map.headings")
        say("ignored: map.headings: this robot does not turn")
    if form != "grid":
        k = several_k(scene)
    if k:
        say(
            f"ignored: k = {', '.join(f'{weight:g}' for weight in k)}: this command uses one chip or one blend; choose "
            "it with --boundary or --k ('resgrid run' uses all)"
        )
    wirings = problem.wirings.values() if form == "grid" else [wiring or problem.only_wiring()[1]]
    drive = scene.drive is not None and not any(each.is_driven for each in wirings)
    if drive:
        no_need = any(each.has_islands for each in wirings)
        why = "a resistance needs no drive" if no_need else "the obstacles are tied to a rail, which drives the grid"
        say(f"ignored: drive = {scene.drive!r}: {why}")
    wall = form != "chip" and scene.chip.wall_resistance is not None
    if wall and not any(each.boundary == "wall" for each in wirings):
        keys.append("chip.wall_resistance")
        say("ignored: chip.wall_resistance: it only applies with boundary = 'wall'")
    return {"ignored": [*keys, *(["k"] if k else []), *(["drive"] if drive else [])]}


def several_k(scene: rg.Scene) -> tuple[float, ...]:
    """Return the weights k of a scene with several weights; an empty tuple for a scene with at most one."""
    return scene.k if len(scene.k) > 1 else ()
