"""The one road from a scene or a space to its circuits, operating points and fields, one for each k.

All who need a field take it: the planner, control, the chip's analyses and the command line.  What ``k`` means, which
circuits a scene asks for, and when a drive is scaled to the supply is said here only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.validation import with_article
from resgrid._internal.values import frozen
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import PETSC, scale_drive, solve
from resgrid.core.compiler import NO_GOAL, compile_space, why_undriven
from resgrid.core.netlist import Netlist
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Boundary, Wiring
from resgrid.errors import CircuitError, InputError
from resgrid.planning import fields
from resgrid.planning.blend import blend, check_k
from resgrid.planning.fields import Field, undriven_field
from resgrid.planning.petsc_fields import Ranked, solve_ranked
from resgrid.planning.trace import start_cell
from resgrid.scene import Scene, sample

Passes = Callable[[Netlist], Netlist]
"""What makes a real chip of an ideal netlist."""

Solver = Callable[..., OperatingPoint]
"""Finds the operating point of a netlist; `resgrid.solve`, or that with other options."""

Observe = Callable[..., Any]
"""Runs a stage, and shows meanwhile what it likes: ``observe(stage, function, *arguments, seconds, iterates)``.

`seconds`: about how long it takes; `iterates`: whether the function takes a ``progress`` of its iterations.
"""


def unobserved(_stage: str, function: Callable[..., Any], *arguments: Any, **_: Any) -> Any:
    """Run a stage and show nothing."""
    return function(*arguments)


@dataclass(frozen=True)
class SolveOptions:
    """How circuits are solved: by what (`resgrid.solve`, perhaps with options), on how many threads, who looks on.

    `by_petsc`: whether PETSc's ranks solve fields instead, without a netlist; `ranks`: their number; `launcher`:
    command that starts them and sets their number.
    """

    solver: Solver = solve
    threads: int = 1
    observe: Observe = unobserved
    by_petsc: bool = False
    ranks: int | None = None
    launcher: str | None = None

    def solve(self, netlist: Netlist, stage: str) -> OperatingPoint:
        """Solve a circuit, a stage of that name."""
        run, seconds = partial(self.solver, threads=self.threads), 0.5 + 4e-6 * netlist.node_count
        op: OperatingPoint = self.observe(stage, run, netlist, seconds=seconds, iterates=True)
        return op

    def solve_ranked(self, space: ConfigurationSpace, wiring: Wiring) -> Ranked:
        """Solve a circuit of a space on the ranks."""
        by = f"on {self.ranks} ranks" if self.launcher is None else f"by {self.launcher}"
        stage, seconds = f"solve the {wiring.boundary} chip {by}", 2.0 + 1e-5 * space.cell.size
        ranked: Ranked = self.observe(stage, solve_ranked, space, wiring, self.ranks, self.launcher, seconds=seconds)
        return ranked


UNWATCHED = SolveOptions()


def work_by(method: str, ranks: int | None = None, launcher: str | None = None, **options: Any) -> SolveOptions:
    """Return the options of a method; `ranks` (2 by default) and `launcher` are options of method "petsc" only."""
    if method == PETSC:
        if ranks is not None and launcher is not None:
            raise InputError(
                f"ranks = {ranks!r} and launcher = {launcher!r}: the launcher sets the number of ranks; leave out ranks"
            )
        ranks = 2 if ranks is None and launcher is None else ranks
        return SolveOptions(by_petsc=True, ranks=ranks, launcher=launcher, **options)
    if ranks is not None:
        raise InputError(f"ranks = {ranks!r} belong to method = 'petsc', not to {method!r}")
    if launcher is not None:
        raise InputError(f"launcher = {launcher!r} belongs to method = 'petsc', not to {method!r}")
    return SolveOptions(partial(solve, method=method), **options)


@frozen
@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be solved: a space, how it is wired, and for which blends and starts.

    `wiring`: of the circuit where only one is asked for; `ks`: shares of the Dirichlet field, none for that circuit's
    own field; `starts` (n, ndim): in world coordinates; `start_driven`: whether starts, one by one, drive open
    obstacles.
    """

    space: ConfigurationSpace
    wiring: Wiring
    ks: tuple[float, ...]
    starts: NDArray[np.float64]
    start_driven: bool = False

    @property
    def halves(self) -> dict[float, Wiring]:
        """What k means: at 1 obstacles are a rail, behind walls if the wiring has some; at 0 they are open."""
        wiring = self.wiring
        closed = replace(wiring, boundary="dirichlet", drive=None, start=None) if wiring.is_driven else wiring
        return {1.0: closed, 0.0: wiring.opened()}

    @property
    def wirings(self) -> dict[str, Wiring]:
        """The circuits that the fields are made of, by name: the boundary, or the start that drives it."""
        if self.start_driven:
            return dict(self.driven_by(number) for number in range(len(self.starts)))
        if not self.ks:
            return {self.wiring.boundary: self.wiring}
        halves = self.halves
        ends = [end for k in self.ks for end in ((k,) if k in halves else (1.0, 0.0))]
        return {halves[end].boundary: halves[end] for end in ends}

    def only_wiring(self) -> tuple[str, Wiring]:
        """Return name and wiring of the one circuit: of a single k, which must be 0 or 1, or the problem's own.

        Raises
        ------
        InputError
            If k is a blend, or several starts drive circuits of their own.
        CircuitError
            If nothing drives the circuit, with one message for every boundary.
        """
        name, wiring = self._only()
        if self.space.goal_count and (why := why_undriven(self.space, wiring)) is not None:
            raise CircuitError(why)
        return name, wiring

    def _only(self) -> tuple[str, Wiring]:
        """Name and wiring of the one circuit, driven or not."""
        wiring = self.wiring
        if len(self.ks) == 1:
            if self.ks[0] not in self.halves:
                raise InputError(
                    f"k = {self.ks[0]} blends two chips, and this makes one: choose boundary = 'dirichlet' or "
                    "'neumann' ('resgrid run' makes both and blends them)"
                )
            wiring = self.halves[self.ks[0]]
        if wiring.boundary != "neumann" or not self.start_driven:
            return wiring.boundary, wiring
        if len(self.starts) != 1:
            raise InputError(
                f"drive = 'start' ties one start to the supply, and the scene has {len(self.starts)}; choose one of "
                "them with --start X,Y"
            )
        return self.driven_by(0)

    def driven_by(self, number: int) -> tuple[str, Wiring]:
        """Name and wiring of the circuit that a start drives."""
        cell = start_cell(self.space, self.starts[number])
        return f"neumann_start_{number}", replace(self.wiring.opened(), drive="start", start=cell)


@frozen
@dataclass(frozen=True, eq=False)
class Solution:
    """The circuits of a problem and their own fields, by name."""

    problem: Problem
    operating_points: Mapping[str, OperatingPoint]
    pure: Mapping[str, Field]

    @cached_property
    def fields(self) -> tuple[Field, ...]:
        """The fields that were asked for: one for each k, or where starts drive for each start."""
        ks = self.problem.ks
        if self.problem.start_driven or not ks:
            return tuple(self.pure.values())
        if len(self.pure) == 1:
            return tuple(self.pure.values()) * len(ks)
        return tuple(blend(*self.halves, k) for k in ks)

    @property
    def halves(self) -> tuple[Field, Field]:
        """The fields of k = 1 and k = 0, from which every other is blended."""
        if len(self.pure) != 2 or self.problem.start_driven:
            raise InputError("this holds one field only: make it with a k to blend, as plan(..., k=...)")
        obstacle, opened = (self.pure[wiring.boundary] for wiring in self.problem.halves.values())
        return obstacle, opened

    @property
    def flat(self) -> tuple[str, ...]:
        """Halves of blends that nothing drives, where the other half carries current."""
        idle = tuple(name for name, field in self.pure.items() if not field.is_flowing)
        return () if self.problem.start_driven or len(idle) == len(self.pure) else idle

    @property
    def tasks(self) -> list[tuple[Field, int]]:
        """Every field with the number of every start that it serves."""
        numbers = range(len(self.problem.starts))
        if self.problem.start_driven:
            return list(zip(self.fields, numbers, strict=True))
        return [(field, number) for field in self.fields for number in numbers]


def problem_of(
    where: ConfigurationSpace | Scene,
    *,
    boundary: Boundary | None = None,
    k: float | None = None,
    space: ConfigurationSpace | None = None,
    **wiring: Any,
) -> Problem:
    """What a scene or a bare space asks for, with some options changed.

    `boundary`: without a k one circuit, whatever the scene says of blends; `space`: in place of sampling the scene;
    `wiring`: other fields of `Wiring`, None for the scene's.
    """
    if k is not None:
        check_k(k)
        if boundary == "neumann":
            raise InputError("a blend has its obstacles on the rail at k = 1: choose boundary = 'dirichlet' or 'wall'")
    ks = () if k is None else (float(k),)
    if isinstance(where, ConfigurationSpace):
        given = {key: value for key, value in wiring.items() if value is not None}
        return Problem(where, Wiring(boundary or "dirichlet", **given), ks, np.empty((0, where.ndim)))
    if not isinstance(where, Scene):
        raise InputError(f"a configuration space or a scene is needed, not {with_article(type(where).__name__)}")
    return Problem(
        space=sample(where) if space is None else space,
        wiring=scene_wiring(where, boundary, **wiring),
        ks=ks or (where.k if boundary is None else ()),
        starts=np.array(where.starts, dtype=np.float64).reshape(-1, where.ndim),
        start_driven=where.drive == "start",
    )


def scene_wiring(scene: Scene, boundary: Boundary | None = None, **given: Any) -> Wiring:
    """How a scene is wired, or with another boundary; open obstacles with a uniform drive."""
    boundary, chip = boundary or scene.boundary, scene.chip
    options: dict[str, Any] = {"edge": scene.edge, "resistance": chip.resistance, "supply": chip.supply}
    if boundary == "wall":
        options["wall_resistance"] = chip.wall_resistance
    return Wiring(boundary, **(options | {key: value for key, value in given.items() if value is not None}))


def require_uniform(scene: Scene, what: str) -> None:
    """Refuse a scene whose starts drive it one by one."""
    if scene.drive == "start":
        raise InputError(f"a scene with drive = 'start' serves one start at a time; {what} needs drive = 'uniform'")


def compile_circuit(
    space: ConfigurationSpace,
    wiring: Wiring,
    *,
    scaled: bool = True,
    passes: Passes | None = None,
    work: SolveOptions = UNWATCHED,
) -> Netlist:
    """Compile one circuit.

    `scaled`: solve a uniformly driven one, so that its drive can be scaled and its highest node sits at the supply;
    `passes`: then made a real chip of.
    """
    seconds, stage = 4e-8 * space.cell.size * space.ndim, f"compile the {wiring.boundary} chip"
    netlist: Netlist = work.observe(stage, compile_space, space, wiring, seconds=seconds)
    if scaled and netlist.current_nodes.size:
        netlist = scale_drive(netlist, work.solve(netlist, "scale its drive to the supply"))
    return netlist if passes is None else passes(netlist)


def solve_problem(problem: Problem, *, scaled: bool = False, work: SolveOptions = UNWATCHED) -> Solution:
    """Solve the ideal circuits of a problem.

    A circuit that nothing drives has a field in which nothing flows: no free cell touches a goal, the start that drives
    it is blocked or cut off, or no obstacle (or edge that counts as one) touches a free cell with a way to a goal.
    Streamlines of that field have an outcome.  Where only the Dirichlet half of a blend is flat, its streamlines follow
    the Neumann half.

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
    points, pure = dict[str, OperatingPoint](), dict[str, Field]()
    for name, wiring in wirings.items():
        if why_undriven(space, wiring) is not None:
            pure[name] = undriven_field(space, wiring)
        elif work.by_petsc:
            pure[name] = work.solve_ranked(space, wiring).field
        else:
            netlist = compile_circuit(space, wiring, scaled=scaled, work=work)
            points[name] = work.solve(netlist, f"solve the {wiring.boundary} chip")
            pure[name] = fields.field(points[name])
    return Solution(problem, points, pure)


def solve_field(space: ConfigurationSpace, wiring: Wiring, k: float | None = None) -> Field:
    """The field of a space: of one circuit, or with a k of the blend whose k = 1 is that circuit."""
    starts = np.empty((0, space.ndim))
    return solve_problem(Problem(space, wiring, () if k is None else (k,), starts)).fields[0]
