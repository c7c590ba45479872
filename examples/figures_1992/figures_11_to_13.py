"""
Figures 11 to 13: no path, and why
==================================

Problem B: two goals, two obstacles; one start has a path, two have none.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# No path is decided by connectivity, and the field agrees. Of configuration space we see which cells must go, and of
# the workspace which obstacle: without it there would be a way.

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
# A sixth of the free configurations is cut off from both goals.

free = space.cell == rg.Cell.FREE
cut_off = np.mean(~space.goal_connected[free])
print(f"{cut_off:.1%} of the free cells are cut off")
assert outcomes.count("reached") == 1
assert abs(cut_off - 1 / 6) < 0.02
