"""
The same motion at several k
============================

And why k = 0.98 acts almost as Neumann far from the goal.
"""

from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# Figure 17's free run at four blends: all arrive.

scene = rg.read_scene(SCENES / "chair.toml").replace(hidden=())
planner = rg.plan(scene, k=0.98)
runs = [rg.simulation(scene, k=k, field=planner.at(k).field, learn=False).run() for k in (0.98, 0.0, 0.5, 1.0)]
assert {run.ending for run in runs} == {rg.Ending.ARRIVED}
rg.save_figure(rg.draw(runs, title="As figure 17, at several k"), "out/by_k.png")

# %%
# Dirichlet currents decay exponentially away from the goal, Neumann currents do not: the map shows where which decides.

share = planner.dirichlet_share()[planner.space.goal_connected]
print(f"Neumann decides in {np.mean(share < 0.5):.0%} of the cells, though k = 0.98")
assert np.mean(share < 0.5) > 0.4
axes = rg.draw_dirichlet_share(planner.obstacle_field, planner.open_field, 0.98)
rg.save_figure(axes, "out/share.png")
