"""Figures 1 to 13 of Connolly & Grupen, "Applications of Harmonic Functions to Robotics" (1992).

Run it with ``python examples/figures.py``; the pictures go into ``out/figures``, laid out as in the paper: the
workspace on the left, the configuration space of a planar arm with two links on the right.  The paper gives no
coordinates; the scenes fix a geometry, and starts, that tell the same story.

The paper's captions and text disagree about which k is which.  Here the formula decides: phi = k phi_D + (1 - k) phi_N,
so that k = 1 is Dirichlet (obstacles repel) and k = 0 is Neumann (paths may slide along them).
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import resgrid as rg
from resgrid.plot import new_figure
from resgrid.plot.paint import paint_cells
from resgrid.plot.style import refresh_legend
from resgrid.robots.arm_cells import singular_cells
from resgrid.space import label_regions

SCENES = Path(__file__).resolve().parent / "scenes"


def main(folder: Path = Path("out/figures")) -> dict[str, float]:
    folder.mkdir(parents=True, exist_ok=True)
    numbers = problem_a(folder) | two_goals(folder) | problem_b(folder)
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
            rg.certify(path, planner.at(k).field)
        family(folder, number, paths, scene, space, virtual, f"Problem A, {kind}: {len(paths)} streamlines.")

    clearance = {}
    for number, k in ((5, 0.99), (6, 0.5), (7, 0.01)):
        path = planner.at(k).path(scene.starts[0])
        # Not only the point in configuration space: the links themselves must stay clear of the obstacle.
        assert rg.replay(path, scene.robot, scene.obstacles, space, step=1e-3) is None
        clearance[k] = rg.workspace_clearance(path, scene.robot, scene.obstacles, space, step=1e-3)
        caption = f"Problem A, k = {k:g}: the links keep {clearance[k]:.3f} m away from the obstacle."
        save(folder, number, path, scene, space, virtual, caption)

    curve = rg.clearance_curve(planner, (0.0, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0))
    # The one-chip version of the same knob: a resistor in series with every obstacle contact.
    walls = rg.wall_clearance_curve(space, (0.0, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8), edge=scene.edge)
    rg.save_figure(draw_knobs(curve, walls, space.spacing[0]), folder / "clearance.png")
    return {
        "goals": space.goal_count,
        "streamlines": len(starts),
        "wall_clearance": float(walls.mean[0] - curve.mean[-1]),
        "largest_fall": float(np.max(curve.mean[:-1] - curve.mean[1:]) / space.spacing[0]),
        **{f"clearance_{k:g}": distance for k, distance in clearance.items()},
    }


def draw_knobs(curve: rg.ClearanceCurve, walls: rg.ClearanceCurve, cell: float) -> object:
    """Mean clearance against both knobs, side by side: the blend of two chips, and the wall resistor of one."""
    figure = new_figure(9.0, 3.8)
    left = figure.add_subplot(1, 2, 1)
    rg.plot_clearance_curve(curve, left, unit="rad", cell=cell)
    rg.plot_clearance_curve(walls, figure.add_subplot(1, 2, 2, sharey=left), unit="rad", cell=cell)
    return figure


def two_goals(folder: Path) -> dict[str, float]:
    """Figures 8 to 10: two goals, three starts; each goes to the goal whose basin it lies in."""
    scene = rg.read_scene(SCENES / "problem_two_goals.toml")
    planner = rg.plan(scene, boundary="dirichlet")
    virtual = strips(scene, planner.space)
    reached = []
    for number, path in enumerate(planner.paths(), 8):
        assert rg.replay(path, scene.robot, scene.obstacles, planner.space, step=1e-3) is None
        tip = rg.workspace_path(path, scene.robot, planner.space)[-1]
        upper = bool(tip[1] > 0)
        reached.append(upper)
        place = "upper" if upper else "lower"
        save(folder, number, path, scene, planner.space, virtual, f"Two goals: this start takes the {place} one.")
    return {"upper": sum(reached), "lower": len(reached) - sum(reached)}


def problem_b(folder: Path) -> dict[str, float]:
    """Figures 11 to 13: two goals, two obstacles; one start has a path, two have none."""
    scene = rg.read_scene(SCENES / "problem_b.toml")
    planner = rg.plan(scene, boundary="dirichlet")
    space, virtual = planner.space, strips(scene, planner.space)
    outcomes = []
    for number, start in enumerate(scene.starts, 11):
        path = planner.path(start)
        rg.certify(path, planner.field)
        outcomes.append(str(path.outcome))
        if path.outcome == rg.Outcome.REACHED:
            assert rg.replay(path, scene.robot, scene.obstacles, space, step=1e-3) is None
            save(folder, number, path, scene, space, virtual, "Problem B: this start has a path.")
            continue
        # No path is decided by connectivity, and the field agrees.  Of configuration space we see which cells must go,
        # and of the workspace which obstacle: without it there would be a way.
        verdict = rg.separation(space, start, virtual=virtual)
        parts = rg.blocking(scene, start)
        one = max(parts.alone, key=lambda name: (parts.parts[name] & verdict.mask).sum(), default="")
        names = (one,) if one else parts.least
        caption = f"Problem B: no path. Without {' and '.join(names)} (red) this start would have one."
        save(folder, number, path, scene, space, virtual, caption, verdict, blamed(scene, names))
    free = space.cell == rg.Cell.FREE
    return {"cut_off": float((free & ~space.goal_connected).sum() / free.sum()), "paths": outcomes.count("reached")}


def strips(scene: rg.Scene, space: rg.ConfigurationSpace) -> np.ndarray:
    """Cells that are obstacles for the singularity's sake alone: no link touches anything there."""
    bare = replace(scene.robot, singularity_cells=None, singularity_width=None)
    return singular_cells(scene.robot, space.axes) & ~bare.occupancy(space.axes, scene.obstacles, scene.sampling)


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
    figure = rg.plot_pair(
        [scene.starts[0]], scene.robot, space, scene.obstacles, scene.goals, virtual=virtual, title="Figure 1",
        caption=caption,
    )  # fmt: skip
    for (label, band), colour in zip(bands.items(), ("#dcebf5", "#f7e6d3"), strict=True):
        paint_cells(space, band & (space.cell == rg.Cell.FREE), colour, label, figure.axes[1])
    refresh_legend(figure.axes[1])
    rg.save_figure(figure, folder / "figure_01.png")
    print(f"figure 1: {caption}".replace("\n", " "))


def save(folder, number, path, scene, space, virtual, caption, verdict=None, separating=()) -> None:
    figure = rg.plot_pair(
        path, scene.robot, space, scene.obstacles, scene.goals, virtual=virtual, verdict=verdict,
        separating=separating, title=f"Figure {number}", caption=caption,
    )  # fmt: skip
    rg.save_figure(figure, folder / f"figure_{number:02}.png")
    print(f"figure {number}: {caption}")


def family(folder, number, paths, scene, space, virtual, caption) -> None:
    figure = new_figure(7.4, 4.6)
    left, right = figure.subplots(1, 2)
    rg.plot_tip_ways(paths, scene.robot, space, scene.obstacles, scene.goals, left)
    rg.plot_configurations(paths, space, right, virtual=virtual)
    figure.suptitle(f"Figure {number}", fontsize=10)
    figure.supxlabel("\n" + caption, fontsize=7, x=0.02, ha="left")
    rg.save_figure(figure, folder / f"figure_{number:02}.png")
    print(f"figure {number}: {caption}")


if __name__ == "__main__":
    main()
