"""
Figures 8 to 10: two goals
==========================

Three starts, each with a path to the goal whose basin contains the start.
"""

from dataclasses import replace
from pathlib import Path

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The first two starts are neighbours with different goals. The third start lies in the other band.

scene = rg.read_scene(SCENES / "problem_two_goals.toml")
planner = rg.plan(scene, boundary="dirichlet")
space = planner.space
bare = scene.replace(robot=replace(scene.robot, singularity_cells=None))
virtual = (space.cell == rg.Cell.OBSTACLE) & (rg.build_space(bare).cell != rg.Cell.OBSTACLE)
upper = []
for number, path in enumerate(planner.paths(), 8):
    rg.certify(path)
    assert rg.check_collisions(path, scene.obstacles, step=1e-3) is None
    upper.append(bool(rg.planning.workspace_path(path)[-1][1] > 0))
    caption = f"Two goals: this start reaches the {'upper' if upper[-1] else 'lower'} goal."
    figure = rg.plot.draw_workspace_and_space(path, scene, virtual=virtual, title=f"Figure {number}", caption=caption)
    rg.plot.save_figure(figure, f"out/figure_{number:02}.png")

assert sum(upper) == 1
