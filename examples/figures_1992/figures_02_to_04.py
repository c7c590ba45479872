"""
Figures 2 to 4: streamlines from many starts
============================================

Problem A with Dirichlet obstacles, with Neumann obstacles (uniform drive), and with the blend k = 0.5.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# Two solves are sufficient for all blends: one with obstacles on the rail, and one with open obstacles. Every connected
# start reaches a goal for every k, because blends of these fields have no local minima.

scene = rg.read_scene(SCENES / "problem_a.toml")
planner = rg.plan(scene, k=1.0)
space = planner.space
cells = np.argwhere(space.goal_connected)
starts = space.centre(cells[np.all(cells % 10 == 5, axis=1)])
assert len(starts) > 100

for number, k, kind in ((2, 1.0, "Dirichlet"), (3, 0.0, "Neumann, uniform drive"), (4, 0.5, "k = 0.5")):
    paths = planner.at(k).paths(starts)
    for path in paths:
        rg.certify(path)
    assert all(path.outcome == "reached" for path in paths)
    figure = Figure((7.4, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    rg.plot.draw_tip_paths(paths, scene, left)
    rg.draw(paths, rg.draw(space, right))
    right.set_title("Configuration space", fontsize=8)
    figure.suptitle(f"Figure {number}. Problem A, {kind}: {len(paths)} streamlines", fontsize=9)
    rg.plot.save_figure(figure, f"out/figure_{number:02}.png")
