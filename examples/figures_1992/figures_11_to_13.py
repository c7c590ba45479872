"""
Figures 11 to 13: starts without a path
=======================================

Problem B: two goals and two obstacles. One start has a path, and two starts have no path.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# Connectivity decides whether a path exists, and the field agrees. For a start without a path, the figure shows the
# blocking cells in the configuration space, and the blocking obstacle in the workspace: without this obstacle a path
# would exist.

scene = rg.read_scene(SCENES / "problem_b.toml")
planner = rg.plan(scene, boundary="dirichlet")
space = planner.space
bare = scene.replace(robot=replace(scene.robot, singularity_cells=None))
virtual = (space.cell == rg.Cell.OBSTACLE) & (rg.build_space(bare).cell != rg.Cell.OBSTACLE)
outcomes = []
for number, start in enumerate(scene.starts, 11):
    path = planner.path(start)
    rg.certify(path)
    outcomes.append(str(path.outcome))
    options, caption = {}, "Problem B: this start has a path."
    if path.outcome != rg.Outcome.REACHED:
        parts = rg.find_blocking_obstacles(scene, start)
        verdict = rg.find_blocking_obstacles(space, start, virtual=virtual)
        names = parts.alone[:1] or parts.separating
        blamed = [shape for i, shape in enumerate(scene.obstacles) if f"obstacle[{i}]" in names]
        options = {"verdict": verdict, "separating": blamed}
        caption = f"Problem B: no path. Without {' and '.join(names)} (red) this start would have one."
    print(f"figure {number}: {caption}")
    figure = rg.plot.draw_workspace_and_space(
        path, scene, virtual=virtual, **options, title=f"Figure {number}", caption=caption
    )
    rg.plot.save_figure(figure, f"out/figure_{number:02}.png")

# %%
# A sixth of the free configurations is separated from both goals.

free = space.cell == rg.Cell.FREE
cut_off = np.mean(~space.goal_connected[free])
print(f"{cut_off:.1%} of the free cells are separated from both goals")
assert outcomes.count("reached") == 1
assert abs(cut_off - 1 / 6) < 0.02
