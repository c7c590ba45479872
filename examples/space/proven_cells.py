"""
Sampled and proven cells of an arm
==================================

Compare cells whose centre is free with cells that a bound on distances proves free, for an arm from a URDF file.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

import resgrid as rg

EXAMPLES = Path(__file__).resolve().parents[1]
Path("out").mkdir(exist_ok=True)

# %%
# The robot is a turntable with an upper arm and a forearm of non-convex meshes. Three joints move. The space has
# 24 x 24 x 24 cells, and the obstacles are the floor, a table and a post. The extra ``resgrid[robots]`` is required.

robot = rg.URDFRobot(
    str(EXAMPLES / "robots" / "elbow.urdf"),
    moving=("turn", "shoulder", "elbow"),
    packages=(str(EXAMPLES),),
    mounted=("base",),
    tool="tip",
)
obstacles = (
    rg.HalfSpace((0.0, 0.0, 1.0), 0.0),
    rg.Box((0.30, -0.40, 0.25), (0.60, 0.10, 0.29)),
    rg.Cylinder((0.05, 0.45, 0.0), (0.05, 0.45, 0.9), radius=0.04),
)
scene = rg.Scene(
    robot.axes(24),
    robot=robot,
    obstacles=obstacles,
    goals=(rg.GoalPose((-0.35, 0.40, 0.30), radius=0.03),),
    starts=((-1.8, 0.5, 1.2),),
    boundary="neumann",
)

# %%
# With ``sampling="conservative"``, the default, a cell is *proven free*, *contains a collision* or is *undecided*.
# With ``sampling="centre"``, a cell counts as free if its centre is free.

proven = rg.build_space(scene)
sampled = rg.build_space(replace(scene, sampling="centre"))

undecided = proven.undecided
collides = (proven.cell == rg.Cell.OBSTACLE) & ~undecided
centre_free = sampled.cell != rg.Cell.OBSTACLE
wrong = centre_free & collides
proven_free = proven.cell != rg.Cell.OBSTACLE
fraction = wrong.sum() / centre_free.sum()
print(f"{proven_free.size} cells: {proven_free.mean():.1%} proven free, {undecided.sum()} undecided")
print(f"{wrong.sum()} of {centre_free.sum()} cells with a free centre contain a collision ({fraction:.1%})")
assert wrong.any()
assert not np.any(proven_free & ~centre_free)

# %%
# The slice that contains the largest number of these cells: the post lies between the centres of two neighbouring turn
# angles. No centre of an orange cell collides, but another configuration in the cell does.

turn = int(wrong.sum(axis=(1, 2)).argmax())
_, shoulder, elbow = scene.axes
extent = (shoulder.lower, shoulder.upper, elbow.lower, elbow.upper)
colours = ListedColormap(["white", "#b4b4b4", "#e69f00", "#7fb2d6"])
classes = {
    "free": np.where(centre_free, 0, 1),
    "proven": np.where(wrong, 2, np.where(collides, 1, np.where(undecided, 3, 0))),
}
figure, axes = plt.subplots(1, 2, figsize=(7.0, 4.2), sharey=True, layout="constrained")
for panel, (kind, title) in zip(axes, (("free", "centres tested"), ("proven", "cells proven")), strict=True):
    panel.imshow(classes[kind][turn].T, origin="lower", extent=extent, cmap=colours, vmin=0, vmax=3, aspect="auto")
    panel.set_title(f"{title}, turn = {scene.axes[0].centres[turn]:.2f} rad", fontsize=9)
    panel.set_xlabel("shoulder (rad)")
axes[0].set_ylabel("elbow (rad)")
labels = ("free", "obstacle", "contains a collision, but its centre is free", "undecided")
swatches = [Patch(facecolor=c, edgecolor="#808080", label=text) for c, text in zip(colours.colors, labels, strict=True)]
figure.legend(handles=swatches, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
rg.plot.save_figure(figure, "out/proven_cells.png")

# %%
# Paths from random starts, with open obstacles (Neumann), which let paths graze obstacles. `check_collisions` moves the
# exact solids along every path, in steps of at most 5 mm.


def count_collisions(space: rg.ConfigurationSpace, starts: int = 150) -> int:
    """Return the number of paths from random free cells that collide."""
    cells = np.argwhere(space.goal_connected & (space.cell == rg.Cell.FREE))
    chosen = np.random.default_rng(1).choice(len(cells), starts, replace=False)
    paths = rg.plan(space, boundary="neumann").paths(space.centre(cells[chosen]))
    assert all(path.outcome == "reached" for path in paths)
    return sum(rg.check_collisions(path, scene.obstacles, step=0.005) is not None for path in paths)


on_sampled, on_proven = count_collisions(sampled), count_collisions(proven)
print(f"paths that collide: {on_sampled} of 150 on sampled cells, {on_proven} of 150 on proven cells")
assert on_proven == 0 < on_sampled

# %%
# The arm along a path through proven cells. The goal is the ball of radius 3 cm around a point, for the tip.

path = rg.plan(scene).path(scene.starts[0])
rg.certify(path)
assert path.outcome == "reached"
assert rg.check_collisions(path, scene.obstacles) is None
clearance = rg.planning.workspace_clearance(path, scene.obstacles)
tip = robot.tool_poses(path.points[-1:])[0, :3, 3]
print(f"clearance {clearance:.3f} m; the tip ends {np.linalg.norm(tip - (-0.35, 0.40, 0.30)):.3f} m from the point")
rg.plot.save_figure(rg.plot.draw_robot(path, scene, ghosts=6), "out/proven_cells_arm.png")
