"""
A picture as a map
==================

A picture with dark obstacles is a map, and an array of cells is a configuration space.
"""

from pathlib import Path

import numpy as np

import resgrid as rg

Path("out").mkdir(exist_ok=True)

# %%
# Generate a cave of 90 x 60 cells of 0.1 m from smoothed noise.

rng = np.random.default_rng(4)
rock = rng.random((90, 60))
for _ in range(6):
    rock = sum(np.roll(rock, shift, axis) for shift in (-1, 0, 1) for axis in (0, 1)) / 6
cell = np.where(rock > np.quantile(rock, 0.62), rg.Cell.OBSTACLE, rg.Cell.FREE).astype(np.uint8)
cell[80:84, 45:49] = rg.Cell.GOAL

space = rg.ConfigurationSpace([rg.Axis("x", 0, 9, 90), rg.Axis("y", 0, 6, 60)], cell)
print(space)

# %%
# Every free cell that is connected to the goal has a path. Compute and certify forty of these paths.

planner = rg.plan(space)
connected = np.argwhere(space.goal_connected & (cell == rg.Cell.FREE))
starts = space.centre(connected[:: len(connected) // 40])
paths = planner.paths(starts)
for path in paths:
    rg.certify(path)
assert all(path.outcome == "reached" for path in paths)

axes = rg.draw(planner)
rg.draw(paths, axes)
axes.set_title(f"{len(paths)} streamlines through a cave", fontsize=9)
rg.plot.save_figure(axes, "out/cave.png")
