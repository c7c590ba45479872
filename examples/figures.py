"""Figures 1 to 19 of Connolly & Grupen, "Applications of Harmonic Functions to Robotics" (1992).

Run it with ``python examples/figures.py``: some five minutes, or one with ``--short``, which leaves out settling and
the animations.  The pictures go into ``out/figures``, laid out as in the paper: the workspace on the left, the
configuration space of a planar arm with two links on the right.  The paper gives no coordinates; the scenes fix a
geometry, and starts, that tell the same story.

Figures 14 to 19 are about control: contact with obstacles that the map does not show, and planning while the grid still
settles; with them come two animations.

The paper's captions and text disagree about which k is which.  Here the formula decides: phi = k phi_D + (1 - k) phi_N,
so that k = 1 is Dirichlet (obstacles repel) and k = 0 is Neumann (paths may slide along them).
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import resgrid as rg
from resgrid.control.announced import relaxation_sweep
from resgrid.control.relaxation import Relaxation
from resgrid.grids import label_regions
from resgrid.plot import add_title, new_figure
from resgrid.plot.plane import paint_cells
from resgrid.plot.style import refresh_legend

SCENES = Path(__file__).resolve().parent / "scenes"


def main(folder: Path = Path("out/figures"), *, long: bool = False) -> dict[str, float]:
    folder.mkdir(parents=True, exist_ok=True)
    numbers: dict[str, float] = {}
    chair = rg.read_scene(SCENES / "chair.toml")
    stages: list[tuple[str, Callable[[], dict[str, float] | None]]] = [
        ("figures 1 to 7, problem A", lambda: problem_a(folder)),
        ("figures 8 to 10, two goals", lambda: two_goals(folder)),
        ("figures 11 to 13, problem B", lambda: problem_b(folder)),
        ("figure 14, velocities at a contact", lambda: figure_14(folder)),
        (
            "figures 15 and 16, container",
            lambda: control_problem(folder, "container", free=15, blind=16, learning=None),
        ),
        ("figures 17 to 19, chair", lambda: control_problem(folder, "chair", free=17, blind=18, learning=19)),
        ("motion while the grid settles (two minutes)", lambda: settling(folder, chair)),
        ("two animations (a minute)", lambda: animations(folder)),
    ]
    for what, draw in stages if long else stages[:-2]:
        print(what, flush=True)
        numbers |= draw() or {}
    print(f"the figures are in {folder}")
    return numbers


def problem_a(folder: Path) -> dict[str, float]:
    """Figures 1 to 7: one obstacle, and a small goal just above it."""
    scene = rg.read_scene(SCENES / "problem_a.toml")
    # Two solves, one with obstacles on the rail and one with open obstacles; every blend k is made of them.
    planner = rg.plan(scene, k=1.0)
    space = planner.space
    virtual = strips(scene, space)

    # The arm's configurations form a torus: both angles turn all the way round.  Where the arm is stretched or folded
    # the Jacobian is singular; a strip of virtual obstacle there cuts the torus into two bands.  In one the arm turns
    # left at its elbow, in the other right.  The goal has an inverse solution in each, so no start is without one.
    turn = np.sin(np.subtract.outer(space.axes[1].centres, space.axes[0].centres)).T
    bands = {"turns left at the elbow": turn > 0, "turns right at the elbow": turn < 0}
    for band in bands.values():
        assert (band & (space.cell == rg.Cell.GOAL)).any()
        assert label_regions(band & (space.cell != rg.Cell.OBSTACLE), space.periodic).max() == 1
    figure_1(folder, scene, space, virtual, bands)

    # Every connected start reaches a goal, whatever k: a sum of harmonic functions is harmonic.
    starts = spread(space)
    for number, k, kind in ((2, 1.0, "Dirichlet"), (3, 0.0, "Neumann, driven uniformly"), (4, 0.5, "k = 0.5")):
        paths = planner.at(k).paths(starts)
        for path in paths:
            rg.certify(path)
        family(folder, number, paths, scene, space, virtual, f"Problem A, {kind}: {len(paths)} streamlines.")

    clearance = {}
    for number, k in ((5, 0.99), (6, 0.5), (7, 0.01)):
        path = planner.at(k).path(scene.starts[0])
        # Not only the point in configuration space: the links themselves must stay clear of the obstacle.
        assert rg.replay(path, scene.obstacles, step=1e-3) is None
        clearance[k] = rg.workspace_clearance(path, scene.obstacles, step=1e-3)
        caption = f"Problem A, k = {k:g}: the links keep {clearance[k]:.3f} m away from the obstacle."
        save(folder, number, path, scene, virtual, caption)

    curve = rg.clearance_curve(planner, (0.0, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0))
    # The one-chip version of the same knob: a resistor in series with every obstacle contact.
    walls = rg.clearance_curve(planner, wall_resistances=(0.0, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8))
    rg.save_figure(draw_knobs(curve, walls, space.spacing[0]), folder / "clearance.png")
    return {
        "goals": space.goal_count,
        "streamlines": len(starts),
        "wall_clearance": float(walls.mean[0] - curve.mean[-1]),
        "largest_fall": float(np.max(curve.mean[:-1] - curve.mean[1:]) / space.spacing[0]),
        **{f"clearance_{k:g}": distance for k, distance in clearance.items()},
    }


def draw_knobs(curve: object, walls: object, cell: float) -> object:
    """Mean clearance against both knobs, side by side: the blend of two chips, and the wall resistor of one."""
    figure = new_figure(9.0, 3.8)
    left = figure.add_subplot(1, 2, 1)
    rg.draw(curve, left, unit="rad", cell=cell)
    rg.draw(walls, figure.add_subplot(1, 2, 2, sharey=left), unit="rad", cell=cell)
    return figure


def two_goals(folder: Path) -> dict[str, float]:
    """Figures 8 to 10: two goals, three starts; each goes to the goal whose basin it lies in."""
    scene = rg.read_scene(SCENES / "problem_two_goals.toml")
    planner = rg.plan(scene, boundary="dirichlet")
    virtual = strips(scene, planner.space)
    reached = []
    for number, path in enumerate(planner.paths(), 8):
        assert rg.replay(path, scene.obstacles, step=1e-3) is None
        tip = rg.workspace_path(path)[-1]
        upper = bool(tip[1] > 0)
        reached.append(upper)
        place = "upper" if upper else "lower"
        save(folder, number, path, scene, virtual, f"Two goals: this start takes the {place} one.")
    return {"upper": sum(reached), "lower": len(reached) - sum(reached)}


def problem_b(folder: Path) -> dict[str, float]:
    """Figures 11 to 13: two goals, two obstacles; one start has a path, two have none."""
    scene = rg.read_scene(SCENES / "problem_b.toml")
    planner = rg.plan(scene, boundary="dirichlet")
    space, virtual = planner.space, strips(scene, planner.space)
    outcomes = []
    for number, start in enumerate(scene.starts, 11):
        path = planner.path(start)
        rg.certify(path)
        outcomes.append(str(path.outcome))
        if path.outcome == rg.Outcome.REACHED:
            assert rg.replay(path, scene.obstacles, step=1e-3) is None
            save(folder, number, path, scene, virtual, "Problem B: this start has a path.")
            continue
        # No path is decided by connectivity, and the field agrees.  Of configuration space we see which cells must go,
        # and of the workspace which obstacle: without it there would be a way.
        verdict = rg.separation(space, start, virtual=virtual)
        parts = rg.separation(scene, start)
        one = max(parts.alone, key=lambda name: (parts.parts[name] & verdict.mask).sum(), default="")
        names = (one,) if one else parts.separating
        caption = f"Problem B: no path. Without {' and '.join(names)} (red) this start would have one."
        save(folder, number, path, scene, virtual, caption, verdict, blamed(scene, names))
    free = space.cell == rg.Cell.FREE
    return {"cut_off": float((free & ~space.goal_connected).sum() / free.sum()), "paths": outcomes.count("reached")}


def figure_14(folder: Path) -> None:
    """Velocity, force and admittance at one contact, and the equipotential that a robot may follow instead."""
    cell = np.zeros((40, 32), dtype=np.uint8)
    cell[34, 4:6] = rg.Cell.GOAL
    space = rg.ConfigurationSpace([rg.Axis("x", 0, 4, 40, unit="m"), rg.Axis("y", 0, 3.2, 32, unit="m")], cell)
    field = rg.plan(space, k=0.2).field
    axes = rg.draw_velocities(field, point=(1.65, 1.84), force=(0.15, 1.0), admittance=0.15)
    axes.fill([1.2, 2.1, 2.1, 1.2], [1.2, 1.2, 1.78, 1.78], color="#b96b6b", zorder=3, label="obstacle not on the map")
    axes.set_title("Figure 14", fontsize=10)
    refresh_legend(axes)
    rg.save_figure(axes, folder / "figure_14.png")
    print("figure 14: a contact force F turns the velocity V0 by A F, or onto the equipotential")


def control_problem(folder: Path, name: str, *, free: int, blind: int, learning: int | None) -> dict[str, float]:
    """Figures 15 to 19: a free run, the same with an obstacle that is not on the map, and with what touch teaches."""
    scene = rg.read_scene(SCENES / f"{name}.toml")
    planner = rg.plan(scene, k=0.98)
    start, bare = scene.starts[0], scene.replace(hidden=())
    numbers = {}

    # The map's field alone: no contact, all the way on a streamline.
    run = rg.simulation(bare, k=0.98, field=planner.field).run(start)
    control_figure(folder, free, run, f"{scene.title}, k = 0.98: the free run.")
    numbers[f"figure_{free}_arrived"] = run.ending == rg.Ending.ARRIVED

    # The hidden obstacle is felt; while it is, the robot follows the equipotential.  Nothing is computed again.
    sim = rg.simulation(scene, k=0.98, field=planner.field, learn=False)
    run = sim.run(start)
    parts = sorted({int(part) + 1 for part in run.contacts.part})
    caption = f"A hidden obstacle deflects link {parts[0]} (force in red); nothing is recomputed."
    control_figure(folder, blind, run, f"{scene.title}, k = 0.98. {caption}")
    tip = scene.robot.reference_point(run.configuration[run.contacts.step])
    numbers[f"figure_{blind}_arrived"] = run.ending == rg.Ending.ARRIVED
    numbers[f"figure_{blind}_from_tip"] = float(np.linalg.norm(tip - run.contacts.point, axis=1).min())

    # The same with learning: each contact proves cells to be obstacle, and the field is solved again.
    taught = replace(sim, learn=True).run(start)
    numbers[f"{name}_learnt"] = int(taught.learnt.sum())
    numbers[f"{name}_wrong"] = int((taught.learnt & (sim.plant.true_space(sim.space).cell != rg.Cell.OBSTACLE)).sum())
    if learning is not None:
        numbers[f"figure_{learning}_arrived"] = taught.ending == rg.Ending.ARRIVED
        caption = f"{numbers[f'{name}_learnt']} cells learnt (circles) in {len(taught.lessons)} re-solve."
        control_figure(folder, learning, taught, f"{scene.title}, k = 0.98. {caption}")

    # Other blends.  Far from the goal a weight of 0.98 acts almost as Neumann: the map of shares shows where.
    shares = (0.98, 0.0, 0.5, 1.0)
    for world, number, kind in ((bare, free, "the free run"), (scene, blind, "with the hidden obstacle")):
        fields = [planner.at(k).field for k in shares]
        runs = [rg.simulation(world, k=k, field=f, learn=False).run(start) for k, f in zip(shares, fields, strict=True)]
        figure = rg.draw(runs, title=f"As figure {number}: {kind}, at several k")
        rg.save_figure(figure, folder / f"figure_{number}_by_k.png")
        numbers[f"{name}_by_k_{number}"] = sum(run.ending == rg.Ending.ARRIVED for run in runs)
    rg.save_figure(
        rg.draw_dirichlet_share(planner.obstacle_field, planner.open_field, 0.98), folder / f"share_{name}.png"
    )
    share = planner.at(0.98).dirichlet_share()[planner.space.goal_connected]
    numbers[f"{name}_mostly_neumann"] = float(np.mean(share < 0.5))
    return numbers


def control_figure(folder: Path, number: int, run: rg.Run, caption: str) -> None:
    rg.save_figure(rg.draw(run, title=f"Figure {number}", caption=caption), folder / f"figure_{number}.png")
    print(f"figure {number}: {caption}")


RATIOS = (1, 10, 100, 300, 1e3, 2e3, 3e3, 1e4, 1e5)


def settling(folder: Path, scene: rg.Scene, ratios: tuple[float, ...] = RATIOS) -> dict[str, float]:
    """The hidden obstacle is put on the map while the robot is on its way; how fast may it be against the grid."""
    sim, numbers, sweeps = rg.simulation(scene, k=0.98), {}, []
    for method in ("chip", "jacobi", "sor"):
        sweep = relaxation_sweep(sim, scene.starts[0], Relaxation(method), ratios)
        sweeps.append(sweep)
        numbers |= {f"{method}_safe": sweep.safe_ratio, f"{method}_fails": sweep.failing_ratio}
        print(f"{method}: arrives up to {sweep.safe_ratio} cells a settling time, fails from {sweep.failing_ratio}")
    rg.save_figure(rg.draw(sweeps), folder / "settling.png")
    front = rg.wavefront(rg.simulation(scene, k=0.98, announce=True, pace=4.0), np.array([0, 1, 3, 10, 30, 100.0]))
    rg.save_figure(rg.draw(front), folder / "wavefront.png")
    return numbers


def animations(folder: Path) -> None:
    """The robot that learns; and the wavefront of an obstacle that is put on the map while the robot moves."""
    scene = rg.read_scene(SCENES / "chair.toml")
    sim = rg.simulation(scene, k=0.98)
    rg.animate(sim.run(scene.starts[0]), folder / "chair.gif")
    world = rg.simulation(scene, k=0.98, announce=True, pace=4.0)
    front = rg.wavefront(world, np.arange(80) * 0.75)
    rg.animate(front, folder / "wavefront.gif", run=world.run(scene.starts[0]), rate=10)


def strips(scene: rg.Scene, space: rg.ConfigurationSpace) -> np.ndarray:
    """Cells that are obstacles for the singularity's sake alone: no link touches anything there."""
    bare = replace(scene.robot, singularity_cells=None, singularity_width=None)
    return scene.robot.singular_cells(space.axes) & ~bare.occupancy(space.axes, scene.obstacles, scene.sampling)


def blamed(scene: rg.Scene, names: tuple[str, ...]) -> list:
    """The obstacles of a scene by their names, such as obstacle[1]."""
    return [shape for number, shape in enumerate(scene.obstacles) if f"obstacle[{number}]" in names]


def spread(space: rg.ConfigurationSpace, every: int = 10) -> np.ndarray:
    """Centres of cells on a coarse grid from which a goal can be reached."""
    cells = np.argwhere(space.goal_connected)
    return space.centre(cells[np.all(cells % every == every // 2, axis=1)])


def figure_1(folder, scene, space, virtual, bands) -> None:
    caption = (
        "Problem A, a small goal just above an obstacle. Strips along the singularities part the torus of angles into\n"
        "two bands: the arm cannot pass from one to the other, but the goal has an inverse solution in each."
    )
    pose = rg.Polyline([scene.starts[0]], space)
    figure = rg.draw_pair(pose, scene, virtual=virtual, title="Figure 1", caption=caption)
    for (label, band), colour in zip(bands.items(), ("#dcebf5", "#f7e6d3"), strict=True):
        paint_cells(space, band & (space.cell == rg.Cell.FREE), colour, label, figure.axes[1])
    refresh_legend(figure.axes[1])
    rg.save_figure(figure, folder / "figure_01.png")
    print(f"figure 1: {caption}".replace("\n", " "))


def save(folder, number, path, scene, virtual, caption, verdict=None, separating=()) -> None:
    options = {"virtual": virtual, "verdict": verdict, "separating": separating}
    figure = rg.draw_pair(path, scene, **options, title=f"Figure {number}", caption=caption)
    rg.save_figure(figure, folder / f"figure_{number:02}.png")
    print(f"figure {number}: {caption}")


def family(folder, number, paths, scene, space, virtual, caption) -> None:
    figure = new_figure(7.4, 4.6)
    left, right = figure.subplots(1, 2)
    rg.draw_tips(paths, scene, left)
    rg.draw(space, right, virtual=virtual)
    rg.draw(paths, right)
    right.set_title("Configuration space", fontsize=8)
    add_title(figure, f"Figure {number}", caption)
    rg.save_figure(figure, folder / f"figure_{number:02}.png")
    print(f"figure {number}: {caption}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Draw figures 1 to 19 of Connolly & Grupen (1992): some five minutes.")
    parser.add_argument("-o", "--output", metavar="FOLDER", type=Path, default=Path("out/figures"))
    parser.add_argument("--short", action="store_true", help="no settling, no animations: about a minute")
    words = parser.parse_args()
    main(words.output, long=not words.short)
