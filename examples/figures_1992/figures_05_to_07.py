"""
Figures 5 to 7: clearance of the links
======================================

Problem A from one start, with k = 0.99, 0.5 and 0.01.
"""

from dataclasses import replace
from pathlib import Path

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The links must also be clear of the obstacle. `check_collisions` moves the arm along the path with exact geometry.
# `workspace_clearance` is the smallest distance of any link from the obstacle.

scene = rg.read_scene(SCENES / "problem_a.toml")
planner = rg.plan(scene, k=1.0)
space = planner.space
bare = scene.replace(robot=replace(scene.robot, singularity_cells=None))
virtual = (space.cell == rg.Cell.OBSTACLE) & (rg.build_space(bare).cell != rg.Cell.OBSTACLE)
clearance = []
for number, k in ((5, 0.99), (6, 0.5), (7, 0.01)):
    path = planner.at(k).path(scene.starts[0])
    assert rg.check_collisions(path, scene.obstacles, step=1e-3) is None
    clearance.append(rg.planning.workspace_clearance(path, scene.obstacles, step=1e-3))
    caption = f"Problem A, k = {k:g}: the links keep {clearance[-1]:.3f} m away from the obstacle."
    figure = rg.plot.draw_workspace_and_space(path, scene, virtual=virtual, title=f"Figure {number}", caption=caption)
    rg.plot.save_figure(figure, f"out/figure_{number:02}.png")

assert clearance[0] > clearance[1] > clearance[2] > 0
