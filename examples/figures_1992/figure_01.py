"""
Figure 1: a torus in two bands
==============================

Problem A: a small goal just above an obstacle, and an arm with two links.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import resgrid as rg
from resgrid.grids import label_regions
from resgrid.plot.plane import paint_cells
from resgrid.plot.style import refresh_legend

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The arm's configurations form a torus: both angles turn all the way round. Where the arm is stretched or folded the
# Jacobian is singular; a strip of virtual obstacle there cuts the torus into two bands. In one the arm turns left at
# its elbow, in the other right. The goal has an inverse solution in each, so no start is without one.

scene = rg.read_scene(SCENES / "problem_a.toml")
space = rg.sample(scene)
turn = np.sin(np.subtract.outer(space.axes[1].centres, space.axes[0].centres)).T
bands = {"turns left at the elbow": turn > 0, "turns right at the elbow": turn < 0}
for band in bands.values():
    assert (band & (space.cell == rg.Cell.GOAL)).any()
    assert label_regions(band & (space.cell != rg.Cell.OBSTACLE), space.periodic).max() == 1
assert space.goal_count == 2

# %%
# Cells that are obstacles for the singularity's sake alone are drawn paler: no link touches anything there.

bare = scene.replace(robot=replace(scene.robot, singularity_cells=None))
virtual = (space.cell == rg.Cell.OBSTACLE) & (rg.sample(bare).cell != rg.Cell.OBSTACLE)

figure = rg.draw_pair(rg.Polyline([scene.starts[0]], space), scene, virtual=virtual, title="Figure 1")
for (label, band), colour in zip(bands.items(), ("#dcebf5", "#f7e6d3"), strict=True):
    paint_cells(space, band & (space.cell == rg.Cell.FREE), colour, label, figure.axes[1])
refresh_legend(figure.axes[1])
rg.save_figure(figure, "out/figure_01.png")
