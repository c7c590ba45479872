"""The planning pipeline: scene or space, wiring, netlist, operating point, field, for one or several blends k.

The planner, control, the chip analyses and the command line all use it.  Only this module defines the meaning of
``k``, the circuits that a scene needs, and when a drive is scaled to the supply.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.validation import with_article
from resgrid._internal.values import frozen
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import PETSC, normalize_drive, solve
from resgrid.core.compiler import compile_space
from resgrid.core.drive_checks import NO_GOAL, require_drive, why_undriven
from resgrid.core.lattice import require_square
from resgrid.core.netlist import Netlist
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring, WiringOptions, wiring_of
from resgrid.errors import CircuitError, InputError
from resgrid.planning.any_field import AnyField, blended, field_of, require_faces, undriven
from resgrid.planning.blend import check_k
from resgrid.planning.fields import Field
from resgrid.planning.petsc_fields import Ranked, solve_ranked
from resgrid.planning.trace import start_cell
from resgrid.scene import Scene, build_space

ChipBuilder = Callable[[Netlist], Netlist]
"""Function that adds non-idealities of a chip to an ideal netlist."""

Solver = Callable[..., OperatingPoint]
"""Function that returns the operating point of a netlist: `resgrid.solve`, possibly with fixed options."""

Observe = Callable[..., Any]
"""Function that runs one stage of the pipeline and may display progress.

It is called as ``observe(stage, function, *arguments, seconds, iterates)`` and returns ``function(*arguments)``.
`stage`: name for the display; `seconds`: estimated duration; `iterates`: whether the function accepts a ``progress``
callback for its iterations.
"""


def run_silently(_stage: str, function: Callable[..., Any], *arguments: Any, **_: Any) -> Any:
    """Return ``function(*arguments)`` without display of progress.

    The name of the stage and the options are ignored.
    """
    return function(*arguments)


@dataclass(frozen=True)
class SolveOptions:
    """Options of the solve stages of the pipeline.

    `solver`: function that solves a netlist; `threads`: number of threads of a solve; `observe`: function that runs and
    displays each stage; `by_petsc`: whether PETSc processes solve fields without a netlist; `ranks`: number of PETSc
    processes, None with a launcher; `launcher`: command that starts the PETSc processes and sets their number.
    """

    solver: Solver = solve
    threads: int = 1
    observe: Observe = run_silently
    by_petsc: bool = False
    ranks: int | None = None
    launcher: str | None = None

    def solve(self, netlist: Netlist, stage: str) -> OperatingPoint:
        """Return the operating point of a netlist; `stage`: name of the stage for the display of progress."""
        run, seconds = partial(self.solver, threads=self.threads), 0.5 + 4e-6 * netlist.node_count
        op: OperatingPoint = self.observe(stage, run, netlist, seconds=seconds, iterates=True)
        return op

    def solve_ranked(self, space: ConfigurationSpace, wiring: Wiring) -> Ranked:
        """Return the field of a space, solved by PETSc processes, with the statistics of the solve."""
        by = f"on {self.ranks} ranks" if self.launcher is None else f"by {self.launcher}"
        stage, seconds = f"solve the {wiring.boundary} chip {by}", 2.0 + 1e-5 * space.cell.size
        ranked: Ranked = self.observe(stage, solve_ranked, space, wiring, self.ranks, self.launcher, seconds=seconds)
        return ranked


DEFAULT_OPTIONS = SolveOptions()


def solve_options(method: str, ranks: int | None = None, launcher: str | None = None, **options: Any) -> SolveOptions:
    """Return the solve options for a solution method.

    `method`: "petsc", or a method of `resgrid.solve`; `ranks`, `launcher`: for method "petsc" only, number of processes
    (2 by default), or the command that starts them; `options`: other fields of `SolveOptions`.
    """
    if method == PETSC:
        if ranks is not None and launcher is not None:
            raise InputError(
                f"ranks = {ranks!r} and launcher = {launcher!r}: the launcher sets the number of ranks; leave out ranks"
            )
        ranks = 2 if ranks is None and launcher is None else ranks
        return SolveOptions(by_petsc=True, ranks=ranks, launcher=launcher, **options)
    if ranks is not None:
        raise InputError(f"ranks = {ranks!r} needs method = 'petsc', not {method!r}; leave ranks out")
    if launcher is not None:
        raise InputError(f"launcher = {launcher!r} needs method = 'petsc', not {method!r}; leave launcher out")
    return SolveOptions(partial(solve, method=method), **options)


@frozen
@dataclass(frozen=True, eq=False)
class Problem:
    """A planning problem: a configuration space, the wiring of a circuit on it, blends of two fields, and starts.

    `space`: the space; `wiring`: wiring of the circuit, in a blend of the circuit with k = 1; `ks`: weights of the
    Dirichlet field, one per blend, empty if only the field of `wiring` is needed; `starts` (n, ndim): in world
    coordinates; `start_driven`: whether each start drives a circuit of its own, with open obstacles.
    """

    space: ConfigurationSpace
    wiring: Wiring
    ks: tuple[float, ...]
    starts: NDArray[np.float64]
    start_driven: bool = False

    def __post_init__(self) -> None:
        require_drive(self.wiring, "planning")

    @property
    def halves(self) -> dict[float, Wiring]:
        """Wirings by weight k: 1 (obstacles on the rail, through wall resistances if any) and 0 (open obstacles)."""
        wiring = self.wiring
        closed = wiring_of(wiring, {"boundary": "dirichlet"}) if wiring.is_open else wiring
        return {1.0: closed, 0.0: wiring.opened()}

    @property
    def wirings(self) -> dict[str, Wiring]:
        """Wirings of all circuits to solve, by name: the boundary, or ``neumann_start_N`` if start N drives it."""
        if self.start_driven:
            return dict(self.driven_by(number) for number in range(len(self.starts)))
        if not self.ks:
            return {self.wiring.boundary: self.wiring}
        halves = self.halves
        ends = [end for k in self.ks for end in ((k,) if k in halves else (1.0, 0.0))]
        return {halves[end].boundary: halves[end] for end in ends}

    def only_wiring(self) -> tuple[str, Wiring]:
        """Return name and wiring of the problem's only circuit; a single k must be 0 or 1.

        The name is that of the boundary, or ``neumann_start_N`` if start N drives the circuit.

        Raises
        ------
        InputError
            If the problem has several circuits: a blend, or several starts that drive a circuit each.
        CircuitError
            If no current flows in the circuit.
        """
        name, wiring = self._only()
        if self.space.goal_count and (why := why_undriven(self.space, wiring)) is not None:
            raise CircuitError(why)
        return name, wiring

    def wiring_without_drive(self) -> Wiring:
        """Return the wiring of the problem's only circuit with the drive "none", for effective resistances.

        A start that drives the circuit is left out.  Raise InputError for a blend of two circuits.
        """
        return replace(self._single(), drive="none", start=None)

    def _single(self) -> Wiring:
        """Return the wiring of the problem, or for a single k of its circuit; raise InputError for a blend."""
        if len(self.ks) != 1:
            return self.wiring
        if self.ks[0] not in self.halves:
            raise InputError(
                f"k = {self.ks[0]} blends the fields of two circuits, but one circuit is needed here: choose "
                "boundary = 'dirichlet' or 'neumann' ('resgrid run' solves both and blends their fields)"
            )
        return self.halves[self.ks[0]]

    def _only(self) -> tuple[str, Wiring]:
        """Return name and wiring of the problem's only circuit, which may carry no current.

        The name is that of the boundary, or ``neumann_start_N`` if start N drives the circuit.  Raise InputError if the
        problem has several circuits: a blend, or several starts that drive a circuit each.
        """
        wiring = self._single()
        if wiring.boundary != "neumann" or not self.start_driven:
            return wiring.boundary, wiring
        if len(self.starts) != 1:
            raise InputError(
                f"drive = 'start' connects a single start to the supply, but the scene has {len(self.starts)}; choose "
                "one of them with --start X,Y"
            )
        return self.driven_by(0)

    def driven_by(self, number: int) -> tuple[str, Wiring]:
        """Return name and wiring of the circuit with open obstacles that the start with index `number` drives.

        The name is ``neumann_start_N`` with the number ``N``.
        """
        cell = start_cell(self.space, self.starts[number])
        return f"neumann_start_{number}", replace(self.wiring.opened(), drive="start", start=cell)


@frozen
@dataclass(frozen=True, eq=False)
class Solution:
    """Solution of a planning problem: the fields of its circuits.

    `problem`: the solved problem; `operating_points`, `pure`: operating point and field (not blended) of every solved
    circuit, by name of the circuit: its boundary, or ``neumann_start_N`` if start N drives it.  Circuits without
    currents and circuits solved by PETSc have no operating point.
    """

    problem: Problem
    operating_points: Mapping[str, OperatingPoint]
    pure: Mapping[str, AnyField]

    @cached_property
    def fields(self) -> tuple[AnyField, ...]:
        """Fields that the problem asks for: one per weight k, one per start if starts drive circuits, or only one."""
        ks = self.problem.ks
        if self.problem.start_driven or not ks:
            return tuple(self.pure.values())
        if len(self.pure) == 1:
            return tuple(self.pure.values()) * len(ks)
        return tuple(blended(*self.halves, k) for k in ks)

    @property
    def halves(self) -> tuple[AnyField, AnyField]:
        """Fields of k = 1 and k = 0, from which all other fields are blended."""
        if len(self.pure) != 2 or self.problem.start_driven:
            raise InputError("a blend needs two fields, but one circuit was solved: use plan(..., k=...)")
        obstacle, opened = (self.pure[wiring.boundary] for wiring in self.problem.halves.values())
        return obstacle, opened

    @property
    def flat(self) -> tuple[str, ...]:
        """Names of the circuits without currents in a blend whose other circuit carries current; otherwise empty.

        A name is that of the boundary: ``dirichlet``, ``wall`` or ``neumann``.
        """
        idle = tuple(name for name, field in self.pure.items() if not field.is_flowing)
        return () if self.problem.start_driven or len(idle) == len(self.pure) else idle

    @property
    def tasks(self) -> list[tuple[AnyField, int]]:
        """Pairs of a field and the index of a start whose streamline follows this field, for all requested paths."""
        numbers = range(len(self.problem.starts))
        if self.problem.start_driven:
            return list(zip(self.fields, numbers, strict=True))
        return [(field, number) for field in self.fields for number in numbers]


def problem_of(
    where: ConfigurationSpace | Scene,
    wiring: Wiring | None = None,
    *,
    k: float | None = None,
    space: ConfigurationSpace | None = None,
    **options: Unpack[WiringOptions],
) -> Problem:
    """Return the planning problem of a scene or a space.

    `wiring`: wiring that replaces the scene's, None for the scene's; `options`: fields of `Wiring` that override those
    of the wiring; `k`: weight of the Dirichlet field.  Without `k`, a wiring or a boundary selects a single circuit,
    even if the scene has blends; otherwise the weights of the scene apply.  `space`: space of the scene, None to build
    the space.
    """
    boundary = options.get("boundary") if wiring is None else options.get("boundary") or wiring.boundary
    if k is not None:
        check_k(k)
        if boundary == "neumann":
            raise InputError(
                "boundary = 'neumann' does not fit a k: at k = 1 obstacles are on the rail; choose boundary = "
                "'dirichlet' or 'wall', or leave k out"
            )
    ks = () if k is None else (float(k),)
    if isinstance(where, ConfigurationSpace):
        return Problem(where, wiring_of(wiring, options), ks, np.empty((0, where.ndim)))
    if not isinstance(where, Scene):
        raise InputError(f"a ConfigurationSpace or a Scene is needed, not {with_article(type(where).__name__)}")
    return Problem(
        space=build_space(where) if space is None else space,
        wiring=scene_wiring(where, wiring, **options),
        ks=ks or (where.k if boundary is None else ()),
        starts=np.array(where.starts, dtype=np.float64).reshape(-1, where.ndim),
        start_driven=where.drive == "start",
    )


def scene_wiring(scene: Scene, wiring: Wiring | None = None, **options: Unpack[WiringOptions]) -> Wiring:
    """Return `wiring`, by default the scene's wiring, with the fields in `options` replaced.

    Open obstacles without a leak get a uniform drive.
    """
    boundary, chip = options.get("boundary") or scene.boundary, scene.chip.with_process()
    default: dict[str, Any] = {
        "boundary": boundary,
        "edge": scene.edge,
        "leak": scene.leak,
        "resistance": chip.resistance,
        "supply": chip.supply,
        "lattice": scene.lattice,
    }
    if boundary == "wall":
        default["wall_resistance"] = chip.wall_resistance
    return wiring_of(wiring, options, default)


def require_uniform(scene: Scene, subject: str) -> None:
    """Raise InputError for a scene with drive = 'start'.

    `subject`: name of the calling function, for the message.
    """
    if scene.drive == "start":
        raise InputError(f"a scene with drive = 'start' serves one start at a time; {subject} needs drive = 'uniform'")


def compile_circuit(
    space: ConfigurationSpace,
    wiring: Wiring,
    *,
    scaled: bool = True,
    build_chip: ChipBuilder | None = None,
    work: SolveOptions = DEFAULT_OPTIONS,
) -> Netlist:
    """Return the netlist of one circuit of a space.

    `space, wiring`: the space and the rules of the circuit; `scaled`: True solves a uniformly driven circuit once, and
    scales the injected currents so that the highest node is at the supply; False leaves their sum at supply /
    resistance; `build_chip`: function from the ideal netlist to a netlist with the non-idealities of a chip, None for
    an ideal circuit; `work`: solve options.
    """
    seconds, stage = 4e-8 * space.cell.size * space.ndim, f"compile the {wiring.boundary} chip"
    netlist: Netlist = work.observe(stage, compile_space, space, wiring, seconds=seconds)
    if scaled and netlist.current_nodes.size:
        netlist = normalize_drive(netlist, work.solve(netlist, "scale its drive to the supply"))
    return netlist if build_chip is None else build_chip(netlist)


def solve_problem(problem: Problem, *, scaled: bool = False, work: SolveOptions = DEFAULT_OPTIONS) -> Solution:
    """Solve the ideal circuits of a problem, and return operating points and fields.

    `scaled`: True scales the injected currents of uniformly driven circuits so that the highest node is at the supply;
    False leaves their sum at supply / resistance; `work`: solve options.  A circuit without a driving voltage or
    current has a field without currents, whose streamlines still have an outcome.  This happens if no free cell touches
    a goal, if the driving start is blocked or disconnected, or if no obstacle (or edge that counts as one) touches a
    goal-connected free cell.  If only the Dirichlet field of a blend has no currents, streamlines follow the Neumann
    field.

    Raises
    ------
    InputError
        If the space has no goal cell, or the options do not fit each other.
    """
    if problem.start_driven and any(problem.ks):
        raise InputError(
            f"k = {', '.join(f'{k:g}' for k in problem.ks)} asks for a Dirichlet field, and drive = 'start' serves one "
            "start of a Neumann field only: use drive = 'uniform', or k = 0"
        )
    space, wirings = problem.space, problem.wirings
    if not space.goal_count:
        raise InputError(NO_GOAL)
    points, pure = dict[str, OperatingPoint](), dict[str, AnyField]()
    for name, wiring in wirings.items():
        if why_undriven(space, wiring) is not None:
            pure[name] = undriven(space, wiring)
        elif work.by_petsc:
            require_square(wiring.lattice, "method = 'petsc'")
            pure[name] = work.solve_ranked(space, wiring).field
        else:
            netlist = compile_circuit(space, wiring, scaled=scaled, work=work)
            points[name] = work.solve(netlist, f"solve the {wiring.boundary} chip")
            pure[name] = field_of(points[name])
    return Solution(problem, points, pure)


def solve_field(space: ConfigurationSpace, wiring: Wiring, k: float | None = None) -> Field:
    """Return the field of one circuit (`k` None) or, with a weight `k` in [0, 1], a blend.

    The blend has the field of this circuit for k = 1 and the field with open obstacles for k = 0.
    """
    starts = np.empty((0, space.ndim))
    field = solve_problem(Problem(space, wiring, () if k is None else (k,), starts)).fields[0]
    return require_faces(field, "this computation")
