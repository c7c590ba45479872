"""
A hall in three dimensions
==========================

A drone between two walls, over the first and under the second.
"""

from pathlib import Path

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The same four calls in three dimensions: 24 x 24 x 24 cells.

scene = rg.read_scene(SCENES / "voxels.toml")
planner = rg.plan(scene)
paths = planner.paths()
for path in paths:
    rg.certify(path)
    print(f"{path.outcome}: {path.length:.2f} m, {path.clearance:.3f} m clear")
assert all(path.outcome == "reached" for path in paths)

# %%
# Slices through the hall, one for every few heights.

rg.plot.save_figure(rg.plot.draw_summary(planner.field, paths, title=scene.title), "out/voxels.png")
