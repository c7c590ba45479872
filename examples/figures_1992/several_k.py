"""
Figures 17 and 18: several k
============================

Reach over a chair, without and with the hidden obstacle. Far from the goal, k = 0.98 acts almost like Neumann.
"""

from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)
# sphinx_gallery_thumbnail_number = 3

# %%
# Repeat both runs at four blends.

scene = rg.read_scene(SCENES / "chair.toml")
planner = rg.plan(scene, k=0.98)
blends = (0.98, 0.0, 0.5, 1.0)
fields = [planner.at(k).field for k in blends]
for world, number, kind in ((scene.replace(hidden=()), 17, "the free run"), (scene, 18, "with the hidden obstacle")):
    runs = [rg.simulation(world, k=k, field=f, learn=False).run() for k, f in zip(blends, fields, strict=True)]
    print(f"figure {number}: " + ", ".join(f"k = {k:g} {run.ending}" for k, run in zip(blends, runs, strict=True)))
    assert all(run.ending == rg.control.TerminationReason.ARRIVED for run in runs)
    rg.plot.save_figure(
        rg.draw(runs, title=f"As figure {number}: {kind}, at several k"), f"out/1_figure_{number}_by_k.png"
    )

# %%
# Dirichlet currents decay exponentially away from the goal, and Neumann currents do not. The map shows the Dirichlet
# fraction of the current.

share = planner.dirichlet_fraction()[planner.space.goal_connected]
print(f"Neumann dominates in {np.mean(share < 0.5):.0%} of the cells, although k = 0.98")
assert np.mean(share < 0.5) > 0.4
axes = rg.plot.draw_dirichlet_fraction(planner.obstacle_field, planner.open_field, 0.98)
rg.plot.save_figure(axes, "out/2_share.png")
