"""
Figure 1: a torus divided into two bands
========================================

Problem A: an arm with two links, and a small goal just above an obstacle.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The configuration space of the arm is a torus: both angles are periodic. The Jacobian is singular where the arm is
# stretched or folded. A strip of virtual obstacles there divides the torus into two bands: the arm turns left at its
# elbow in one band, and right in the other. The goal has an inverse solution in each band, so a goal exists for every
# start.

scene = rg.read_scene(SCENES / "problem_a.toml")
space = rg.build_space(scene)
turn = np.sin(np.subtract.outer(space.axes[1].centres, space.axes[0].centres)).T
bands = {"turns left at the elbow": turn > 0, "turns right at the elbow": turn < 0}
for band in bands.values():
    alone = rg.ConfigurationSpace(space.axes, np.where(band, space.cell, rg.Cell.OBSTACLE))
    assert alone.goal_count == 1 and alone.goal_connected[alone.cell == rg.Cell.FREE].all()
assert space.goal_count == 2

# %%
# Cells that are obstacles only because of the singularity have a lighter colour: no link is in collision there.

bare = scene.replace(robot=replace(scene.robot, singularity_cells=None))
virtual = (space.cell == rg.Cell.OBSTACLE) & (rg.build_space(bare).cell != rg.Cell.OBSTACLE)

figure = rg.plot.draw_workspace_and_space(
    rg.Polyline([scene.starts[0]], space), scene, virtual=virtual, title="Figure 1"
)
torus = figure.axes[1]
extent = [bound for axis in space.axes for bound in (axis.lower, axis.upper)]
for band, colour in zip(bands.values(), ("Blues", "Oranges"), strict=True):
    shown = np.where(band & (space.cell == rg.Cell.FREE), 0.2, np.nan).T
    torus.imshow(shown, origin="lower", extent=extent, cmap=colour, vmin=0, vmax=1, zorder=2.2)
torus.set_title("blue: turns left at the elbow; orange: right", fontsize=8)
rg.plot.save_figure(figure, "out/figure_01.png")
