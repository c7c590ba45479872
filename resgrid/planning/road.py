"""The one road from a scene or a space to its circuits, operating points and fields, one for each k.

All who need a field take it: the planner, control, the chip's analyses and the command line.  What ``k`` means, which
circuits a scene asks for, and when a drive is scaled to the supply is said here only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.compiler import compile_space
from resgrid.errors import CircuitError, InputError
from resgrid.netlist import Netlist
from resgrid.nodal.drive import scale_drive
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.nodal.solve import solve
from resgrid.planning import fields
from resgrid.planning.blend import blend, check_share
from resgrid.planning.fields import Field, undriven_field
from resgrid.planning.trace import start_cell
from resgrid.scene import Scene, sample
from resgrid.space import ConfigurationSpace
from resgrid.wiring import Wiring

Passes = Callable[[Netlist], Netlist]
"""What makes a real chip of an ideal netlist."""


Observe = Callable[..., Any]
"""Runs a stage, and shows meanwhile what it likes: ``observe(stage, function, *arguments, seconds, iterates)``.

`seconds`: about how long it takes; `iterates`: whether the function takes a ``progress`` of its iterations.
"""


def unobserved(_stage: str, function: Callable[..., Any], *arguments: Any, **_: Any) -> Any:
    """Run a stage and show nothing."""
    return function(*arguments)


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be solved: a space, how it is wired, and for which blends and starts.

    `wiring`: of the only circuit, or of k = 1; `ks`: shares of the Dirichlet field, none for the only circuit; `starts`
    (n, ndim): in world coordinates; `start_driven`: whether starts, one by one, drive open obstacles.
    """

    space: ConfigurationSpace
    wiring: Wiring
    ks: tuple[float, ...]
    starts: NDArray[np.float64]
    start_driven: bool = False

    @property
    def wirings(self) -> dict[str, Wiring]:
        """The circuits that the fields are blended from, by name, which is their boundary."""
        if not self.ks:
            return {self.wiring.boundary: self.wiring}
        pure = {1.0: self.wiring, 0.0: self.wiring.opened()}
        ends = [end for k in self.ks for end in ((k,) if k in pure else (1.0, 0.0))]
        return {pure[end].boundary: pure[end] for end in ends}

    def only_wiring(self) -> tuple[str, Wiring]:
        """Name and wiring of the circuit, where only one is asked for."""
        if len(self.ks) > 1 or any(0.0 < k < 1.0 for k in self.ks):
            raise InputError(
                f"k = {', '.join(f'{k:g}' for k in self.ks)} blends two circuits, and this makes one: choose "
                "boundary = 'dirichlet' or 'neumann' ('resgrid run' makes both and blends them)"
            )
        ((name, wiring),) = self.wirings.items()
        if name != "neumann" or not self.start_driven:
            return name, wiring
        if len(self.starts) != 1:
            raise InputError(
                f"drive = 'start' ties one start to the supply, and the scene has {len(self.starts)}; "
                "choose one of them"
            )
        return self.driven_by(0)

    def driven_by(self, number: int) -> tuple[str, Wiring]:
        """Name and wiring of the circuit that a start drives."""
        cell = start_cell(self.space, self.starts[number])
        return f"neumann_start_{number}", replace(self.wiring.opened(), drive="start", start=cell)


@dataclass(frozen=True, eq=False)
class Solution:
    """The circuits of a problem, by name, and its fields: one for each k, or where starts drive for each start."""

    problem: Problem
    operating_points: Mapping[str, OperatingPoint]
    fields: tuple[Field, ...]

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
    boundary: str | None = None,
    k: float | None = None,
    space: ConfigurationSpace | None = None,
    **wiring: Any,
) -> Problem:
    """What a scene or a bare space asks for, with some options changed.

    `boundary`: without a k one circuit, whatever the scene says of blends; `space`: in place of sampling the scene;
    `wiring`: other fields of `Wiring`, None for the scene's.
    """
    if k is not None:
        check_share(k)
        if boundary == "neumann":
            raise InputError("a blend has its obstacles on the rail at k = 1: choose boundary = 'dirichlet' or 'wall'")
    if not isinstance(where, Scene | ConfigurationSpace):
        raise InputError(f"a configuration space or a scene is needed, not a {type(where).__name__}")
    scene = where if isinstance(where, Scene) else None
    ks = (float(k),) if k is not None else scene.k if scene is not None and boundary is None else ()
    if boundary is None:
        boundary = "dirichlet" if scene is None else scene.boundary
        boundary = "dirichlet" if ks and boundary == "neumann" else boundary
    given = {key: value for key, value in wiring.items() if value is not None}
    if scene is None:
        assert isinstance(where, ConfigurationSpace)
        return Problem(where, Wiring(boundary, **given), ks, np.empty((0, where.ndim)))
    chip = scene.chip
    options = {"edge": scene.edge, "resistance": chip.resistance, "supply": chip.supply}
    if boundary == "wall":
        options["wall_resistance"] = chip.wall_resistance
    return Problem(
        space=sample(scene) if space is None else space,
        wiring=Wiring(boundary, **(options | given)),
        ks=ks,
        starts=np.array(scene.starts, dtype=np.float64).reshape(-1, scene.ndim),
        start_driven=scene.drive == "start",
    )


def compile_circuit(
    space: ConfigurationSpace,
    wiring: Wiring,
    *,
    scaled: bool = True,
    passes: Passes | None = None,
    threads: int = 1,
    observe: Observe = unobserved,
) -> Netlist:
    """Compile one circuit.

    `scaled`: solve a uniformly driven one, so that its drive can be scaled and its highest node sits at the supply;
    `passes`: then made a real chip of.
    """
    seconds = 4e-8 * space.cell.size * space.ndim
    netlist: Netlist = observe(f"compile the {wiring.boundary} chip", compile_space, space, wiring, seconds=seconds)
    if scaled and netlist.current_nodes.size:
        netlist = scale_drive(netlist, _solved(netlist, "scale its drive to the supply", threads, observe))
    return netlist if passes is None else passes(netlist)


def solve_circuit(
    space: ConfigurationSpace,
    wiring: Wiring,
    *,
    scaled: bool = True,
    passes: Passes | None = None,
    threads: int = 1,
    observe: Observe = unobserved,
) -> OperatingPoint:
    """Compile one circuit and solve it; arguments as `compile_circuit`."""
    netlist = compile_circuit(space, wiring, scaled=scaled, passes=passes, threads=threads, observe=observe)
    return _solved(netlist, f"solve the {wiring.boundary} chip", threads, observe)


def solve_problem(
    problem: Problem, *, scaled: bool = False, threads: int = 1, observe: Observe = unobserved
) -> Solution:
    """Solve the ideal circuits of a problem, and blend their fields."""
    run = partial(solve_circuit, problem.space, scaled=scaled, threads=threads, observe=observe)
    if problem.start_driven:
        return _solve_start_driven(problem, run)
    points, pure = _solve_wirings(problem.space, problem.wirings, run)
    if not problem.ks:
        return Solution(problem, points, tuple(pure.values()))
    ends = pure.get(problem.wiring.boundary), pure.get("neumann")
    return Solution(problem, points, tuple(_blended(*ends, k) for k in problem.ks))


def solve_halves(problem: Problem) -> tuple[Field, Field]:
    """The fields of k = 1 and k = 0, from which every other is blended."""
    wirings = {wiring.boundary: wiring for wiring in (problem.wiring, problem.wiring.opened())}
    _, pure = _solve_wirings(problem.space, wirings, partial(solve_circuit, problem.space, scaled=False))
    return pure[problem.wiring.boundary], pure["neumann"]


def solve_field(space: ConfigurationSpace, wiring: Wiring, k: float | None = None) -> Field:
    """The field of a space: of one circuit, or with a k of the blend whose k = 1 is that circuit."""
    starts = np.empty((0, space.ndim))
    return solve_problem(Problem(space, wiring, () if k is None else (k,), starts)).fields[0]


def solve_seconds(nodes: int) -> float:
    """Rough time of a direction-safe solution, in seconds."""
    return 0.5 + 4e-6 * nodes


def _solved(netlist: Netlist, stage: str, threads: int, observe: Observe) -> OperatingPoint:
    run = partial(solve, threads=threads)
    op: OperatingPoint = observe(stage, run, netlist, seconds=solve_seconds(netlist.node_count), iterates=True)
    return op


def _solve_wirings(
    space: ConfigurationSpace, wirings: Mapping[str, Wiring], run: Callable[[Wiring], OperatingPoint]
) -> tuple[dict[str, OperatingPoint], dict[str, Field]]:
    """Operating points and fields, by name.

    Where nothing drives the Dirichlet half of a blend (no obstacle, no edge that counts as one) it is flat, and what
    flows is the share ``1 - k`` of the Neumann half.
    """
    points, pure = dict[str, OperatingPoint](), dict[str, Field]()
    for name, wiring in wirings.items():
        try:
            points[name] = run(wiring)
            pure[name] = fields.field(points[name])
        except CircuitError:
            if name == "neumann" or "neumann" not in wirings:
                raise
            pure[name] = undriven_field(space, wiring)
    return points, pure


def _solve_start_driven(problem: Problem, run: Callable[[Wiring], OperatingPoint]) -> Solution:
    """Each start is tied to the supply in turn, by a circuit of its own; none that is blocked or cut off."""
    if any(problem.ks):
        raise InputError(
            f"k = {', '.join(f'{k:g}' for k in problem.ks)} asks for a Dirichlet field, and drive = 'start' serves one "
            "start of a Neumann field only: use drive = 'uniform', or k = 0"
        )
    space, points, found = problem.space, dict[str, OperatingPoint](), list[Field]()
    for number in range(len(problem.starts)):
        name, wiring = problem.driven_by(number)
        if space.goal_connected[wiring.start]:
            points[name] = run(wiring)
            found.append(fields.field(points[name]))
        else:
            found.append(undriven_field(space, problem.wiring.opened()))
    return Solution(problem, points, tuple(found))


def _blended(obstacle: Field | None, opened: Field | None, k: float) -> Field:
    if obstacle is None or opened is None:
        pure = obstacle if k == 1.0 else opened
        assert pure is not None
        return pure
    return blend(obstacle, opened, k)
