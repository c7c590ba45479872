"""Measure harmonic control: arrivals, map updates, penetration, rate.  ``python -m benchmarks.control [part ...]``."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import shapely.affinity

import resgrid as rg
from resgrid.circuit.solve import solve
from resgrid.control.controller import make_controller
from resgrid.control.external_forces import random_forces
from resgrid.control.plant import make_plant
from resgrid.control.run_log import Run, TerminationReason
from resgrid.control.simulation import Simulation, simulation
from resgrid.core.axis import Axis
from resgrid.core.cell import Cell
from resgrid.core.compiler import compile_space
from resgrid.core.regions import label_regions
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring
from resgrid.planning.pipeline import solve_field
from resgrid.planning.trace import streamline
from resgrid.robots import Arm, Ball, Box, DiscRobot, PointRobot, Polygon, PolygonRobot, Robot, Shape, to_shapely
from resgrid.scene import read_scene

SCENES = Path(__file__).parents[1] / "examples" / "scenes"


def spread(mask: np.ndarray, count: int) -> np.ndarray:
    """Return cells spread evenly over the marked cells."""
    cells = np.argwhere(mask)
    return cells[np.unique(np.linspace(0, len(cells) - 1, count).round().astype(int))]


def said(name: str, runs: list[Run], bound: float, false: int = 0) -> None:
    """Return one line that summarizes many runs."""
    endings = ", ".join(f"{count} {ending}" for ending, count in Counter(str(run.ending) for run in runs).most_common())
    lessons = [len(run.lessons) for run in runs]
    sys.stdout.write(
        f"{name}: {len(runs)} runs: {endings}; {sum(lessons)} re-solves (at most {max(lessons)} in a run), "
        f"{sum(int(run.learnt.sum()) for run in runs)} cells learnt, {false} of them free in truth; deepest entry "
        f"{max(run.penetration for run in runs):.2g} m (bound {bound:.2g} m)\n"
    )
    sys.stdout.flush()


def false_cells(run: Run, truth: ConfigurationSpace) -> int:
    """Return the number of learnt cells that are not obstacles in the true world."""
    return int((run.learnt & (truth.cell != Cell.OBSTACLE)).sum())


def problems() -> None:
    """Run problems 1 and 2 from 100 spread starts, with and without learning, at three blends."""
    for name in ("container", "chair"):
        scene = read_scene(SCENES / f"{name}.toml")
        for k in (0.98, 0.5, 1.0):
            sim = simulation(scene, k=k)
            truth = sim.plant.true_space(sim.space)
            starts = sim.space.centre(spread(truth.goal_connected, 100))
            for learn in (True, False):
                runs = [replace(sim, learn=learn).run(start, max_steps=6000) for start in starts]
                wrong = sum(false_cells(run, truth) for run in runs)
                said(f"{name}, k {k:g}, {'learning' if learn else 'following'}", runs, sim.plant.cell_motion, wrong)


def pushes() -> None:
    """Apply eight random pushes in each of 100 runs among known obstacles."""
    for name in ("container", "chair"):
        sim = simulation(read_scene(SCENES / f"{name}.toml").replace(hidden=()))
        starts = sim.space.centre(spread(sim.space.goal_connected, 100))
        runs = []
        for seed, start in enumerate(starts):
            speed = sim.controller.speed
            until = max(streamline(sim.controller.field, start).length / speed, 1.0)
            shoves = random_forces(seed, 2, until=until, size=4.0, duration=0.05 * until + 0.2)
            runs.append(sim.run(start, pushes=shoves, seed=seed))
        said(f"{name}, eight pushes of 4 V0", runs, sim.plant.cell_motion)


def belief() -> None:
    """Add a position bias or noise of up to one cell, among known obstacles, without and with learning."""
    for name in ("container", "chair"):
        sim = simulation(read_scene(SCENES / f"{name}.toml").replace(hidden=()))
        rng = np.random.default_rng(5)
        for learn in (False, True):
            for what in ("bias", "noise"):
                runs = []
                for seed, start in enumerate(sim.space.centre(spread(sim.space.goal_connected, 100))):
                    off = sim.space.spacing * (rng.uniform(-1, 1, 2) if what == "bias" else 1.0)
                    case = replace(sim, learn=learn)
                    runs.append(case.run(start, seed=seed, max_steps=8000, **{what: off}))
                said(f"{name}, {what} of a cell, {'learning' if learn else 'following'}", runs, sim.plant.cell_motion)


def box_and_u() -> None:
    """Run 25 starts above a hidden box and 25 inside a hidden U, with the goal below, without and with learning."""
    axes = [Axis("x", 0, 10, 40), Axis("y", 0, 10, 40)]
    cell = np.zeros((40, 40), np.uint8)
    cell[18:22, 2:4] = Cell.GOAL
    solids = {
        "box": [Box((3.6, 4.0), (5.1, 5.0))],
        "U": [Box((2.5, 3.0), (7.5, 3.5)), Box((2.5, 3.0), (3.0, 7.0)), Box((7.0, 3.0), (7.5, 7.0))],
    }
    field = solve_field(space := ConfigurationSpace(axes, cell), Wiring(), 0.98)
    for name, hidden in solids.items():
        plant = make_plant(DiscRobot(0.2), axes, [], hidden)
        lower, upper = ((1.0, 6.0), (9.0, 9.5)) if name == "box" else ((3.5, 4.5), (6.5, 6.5))
        starts = [
            (x, y) for x in np.linspace(lower[0], upper[0], 5) + 0.03 for y in np.linspace(lower[1], upper[1], 5) + 0.01
        ]
        truth = plant.true_space(space)
        for learn in (False, True):
            for response in ("equipotential", "admittance"):
                controller = make_controller(field, response=response)
                sim = Simulation(controller, plant, learn=learn)
                runs = [sim.run(start, max_steps=6000) for start in starts]
                wrong = sum(false_cells(run, truth) for run in runs)
                how = f"hidden {name}, {'learning' if learn else 'not learning'}, {response}"
                said(how, runs, plant.cell_motion, wrong)


def random_shape(rng: np.random.Generator, size: float, near: tuple[float, float], away: float) -> Shape:
    """Return a box, disc or triangle at a random position."""
    x, y = near[0] + rng.uniform(-away, away), near[1] + rng.uniform(-away, away)
    w, h = size * rng.uniform(0.3, 1.5, 2)
    kind = rng.integers(3)
    if kind == 0:
        return Box((x - w, y - h), (x + w, y + h))
    if kind == 1:
        return Ball((x, y), float(w))
    turns = np.sort(rng.uniform(0, 2 * np.pi, 3)) + np.array([0.0, 0.3, 0.6])
    return Polygon(tuple((x + 1.3 * w * np.cos(a), y + 1.3 * h * np.sin(a)) for a in turns.tolist()))


def world(seed: int) -> Simulation | None:
    """Return a random world: a robot, known and hidden obstacles, a goal."""
    rng = np.random.default_rng(seed)
    kind = ["point", "disc", "point", "disc", "arm", "polygon"][seed % 6]
    robot: Robot
    if kind in {"point", "disc"}:
        axes = tuple(Axis(name, 0, 6, 12, periodic=bool(rng.random() < 0.15)) for name in "xy")
        robot = DiscRobot(0.2) if kind == "disc" else PointRobot()
        shapes = [random_shape(rng, 0.7, (3.0, 3.0), 3.0) for _ in range(rng.integers(2, 7))]
    elif kind == "arm":
        robot = Arm((1.0, 0.9), widths=(0.06, 0.04), angles="relative" if rng.random() < 0.5 else "absolute")
        axes = robot.axes(36)
        shapes = [random_shape(rng, 0.15, (0.0, 0.0), 1.8) for _ in range(rng.integers(2, 6))]
    else:
        robot = PolygonRobot(((-0.4, -0.1), (0.4, -0.1), (0.4, 0.1), (-0.4, 0.1)), turning_length=0.5)
        axes = (Axis("x", 0, 4, 12), Axis("y", 0, 4, 12), robot.turning_axis(12))
        shapes = [random_shape(rng, 0.4, (2.0, 2.0), 2.0) for _ in range(rng.integers(1, 4))]
    split = int(rng.integers(0, len(shapes)))
    known, hidden = shapes[:split], shapes[split:]
    blocked = robot.occupancy(axes, known, "conservative")
    cell = np.where(blocked, Cell.OBSTACLE, Cell.FREE).astype(np.uint8)
    free = np.argwhere(~blocked)
    if len(free) < 2:
        return None
    cell[tuple(free[rng.integers(len(free))])] = Cell.GOAL
    space = ConfigurationSpace(axes, cell)
    if not space.goal_connected.any():
        return None
    controller = make_controller(solve_field(space, Wiring(), 0.98))
    plant = make_plant(robot, axes, known, hidden)
    return Simulation(controller, plant, friction=float(rng.uniform(0, 0.5)))


def connected(cell: np.ndarray, periodic: np.ndarray) -> np.ndarray:
    """Return the cells with a path to a goal cell."""
    region = label_regions(cell != Cell.OBSTACLE, periodic)
    return (region > 0) & np.isin(region, np.unique(region[(cell == Cell.GOAL) & (region > 0)]))


def optimistic(sim: Simulation) -> np.ndarray | None:
    """Return the cells with a path if every cell with a free configuration counts as free; for points and discs."""
    if not isinstance(sim.plant.robot, PointRobot | DiscRobot):
        return None
    x, y = sim.space.axes
    radius = sim.plant.robot.radius
    solids = [to_shapely(shape) for shape in sim.plant.obstacles]
    grown = [solid.buffer(radius, quad_segs=64) if radius else solid for solid in solids]
    shifts = product(*([0.0] if not a.periodic else [a.lower - a.upper, 0.0, a.upper - a.lower] for a in (x, y)))
    solid = shapely.union_all([shapely.affinity.translate(shape, *by) for by in shifts for shape in grown])
    i, j = np.meshgrid(np.arange(x.cells), np.arange(y.cells), indexing="ij")
    boxes = shapely.box(x.edges[i], y.edges[j], x.edges[i + 1], y.edges[j + 1])
    full = shapely.area(shapely.difference(boxes, solid)) <= 1e-12
    cell = np.where(full, Cell.OBSTACLE, np.where(sim.space.cell == Cell.GOAL, Cell.GOAL, Cell.FREE))
    return connected(cell, sim.space.periodic)


def world_runs(sim: Simulation, most: int | None) -> Iterator[tuple[tuple[int, ...], Run]]:
    """Run from the centres of free cells at which the robot is not in collision."""
    cells = np.argwhere(sim.space.cell == Cell.FREE)
    if most is not None and len(cells) > most:
        cells = cells[np.unique(np.linspace(0, len(cells) - 1, most).round().astype(int))]
    fits = sim.plant.penetration(sim.space.centre(cells)) == 0
    for cell in cells[fits]:
        yield tuple(cell.tolist()), sim.run(sim.space.centre(cell), max_steps=10_000)


def worlds(last: int = 200, most: int | None = 40) -> None:
    """Compare expected and actual outcomes in random worlds with hidden obstacles."""
    count, deepest, wrong, resolves, learnt = 0, 0.0, 0, 0, 0
    tally: Counter[str] = Counter()
    seed = 0
    while count < last:
        sim = world(seed)
        seed += 1
        if sim is None:
            continue
        count += 1
        truth = sim.plant.true_space(sim.space)
        sure = connected(truth.cell, truth.periodic)
        maybe = optimistic(sim)
        for cell, run in world_runs(sim, most):
            what = "connected" if sure[cell] else "between" if maybe is None or maybe[cell] else "cut off"
            tally[f"{what}: {run.ending}"] += 1
            if run.ending is TerminationReason.NO_PATH and connected(run.space.cell, run.space.periodic)[cell]:
                tally["no path announced though the map has one"] += 1
            if (what == "connected") != (run.ending is TerminationReason.ARRIVED) and what != "between":
                sys.stdout.write(f"world {seed - 1}, start {cell}: {what}, but {run.ending}: {run.message}\n")
            deepest = max(deepest, run.penetration / sim.plant.cell_motion)
            wrong += false_cells(run, truth)
            resolves += len(run.lessons)
            learnt += int(run.learnt.sum())
        if count % 20 == 0:
            sys.stdout.write(f"{count} worlds, {sum(tally.values())} starts\n")
            for what, number in sorted(tally.items()):
                sys.stdout.write(f"  {what}: {number}\n")
            sys.stdout.write(
                f"  {resolves} re-solves, {learnt} cells learnt, {wrong} of them free in truth; deepest entry "
                f"{deepest:.2g} of the motion across a cell\n"
            )
            sys.stdout.flush()


def rate() -> None:
    """Measure commands per second on a configuration space of 256 x 256 cells."""
    rng = np.random.default_rng(3)
    cell = np.zeros((256, 256), np.uint8)
    for _ in range(30):
        x, y = rng.integers(0, 240, 2)
        cell[x : x + 14, y : y + 10] = Cell.OBSTACLE
    cell[120:124, 120:124] = Cell.GOAL
    space = ConfigurationSpace([Axis("x", 0, 256, 256), Axis("y", 0, 256, 256)], cell)
    controller = make_controller(rg.field(solve(compile_space(space))))
    cells = np.argwhere(space.goal_connected)
    points = space.centre(cells[rng.integers(0, len(cells), 20_000)]) + rng.uniform(-0.5, 0.5, (20_000, 2))
    forces = rng.normal(size=(20_000, 2))
    controller.command(points[0], forces[0])
    begun = time.perf_counter()
    for point, force in zip(points, forces, strict=True):
        controller.command(point, force)
    seconds = time.perf_counter() - begun
    sys.stdout.write(f"command: {len(points) / seconds:,.0f} a second, {1e6 * seconds / len(points):.1f} us each\n")


def every_start() -> None:
    """Run problems 1 and 2 from every free cell; this takes an hour."""
    worlds(most=None)


PARTS: dict[str, Callable[[], None]] = {
    "rate": rate, "box_and_u": box_and_u, "problems": problems, "pushes": pushes, "belief": belief, "worlds": worlds,
    "every_start": every_start,
}  # fmt: skip


def main() -> None:
    """Run the parts named on the command line, or all parts."""
    for name in sys.argv[1:] or [part for part in PARTS if part != "every_start"]:
        begun = time.perf_counter()
        PARTS[name]()
        sys.stdout.write(f"[{name}: {time.perf_counter() - begun:.0f} s]\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
