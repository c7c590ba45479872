"""
Figure 1: a torus in two bands
==============================

Problem A: a small goal just above an obstacle, and an arm with two links.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The arm's configurations form a torus: both angles turn all the way round. Where the arm is stretched or folded the
# Jacobian is singular; a strip of virtual obstacle there cuts the torus into two bands. In one the arm turns left at
# its elbow, in the other right. The goal has an inverse solution in each, so no start is without one.

scene = rg.read_scene(SCENES / "problem_a.toml")
space = rg.build_space(scene)
turn = np.sin(np.subtract.outer(space.axes[1].centres, space.axes[0].centres)).T
bands = {"turns left at the elbow": turn > 0, "turns right at the elbow": turn < 0}
for band in bands.values():
    alone = rg.ConfigurationSpace(space.axes, np.where(band, space.cell, rg.Cell.OBSTACLE))
    assert alone.goal_count == 1 and alone.goal_connected[alone.cell == rg.Cell.FREE].all()
assert space.goal_count == 2

# %%
# Cells that are obstacles for the singularity's sake alone are drawn paler: no link touches anything there.

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
