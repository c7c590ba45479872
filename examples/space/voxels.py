"""
A drone in three dimensions
===========================

Plan paths for a drone over one wall and under another.
"""

from pathlib import Path

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# Three dimensions use the same functions. The grid has 24 x 24 x 24 cells.

scene = rg.read_scene(SCENES / "voxels.toml")
planner = rg.plan(scene)
paths = planner.paths()
for path in paths:
    rg.certify(path)
    print(f"{path.outcome}: {path.length:.2f} m, {path.clearance:.3f} m clear")
assert all(path.outcome == "reached" for path in paths)

# %%
# The figure shows slices through the hall at several heights.

rg.plot.save_figure(rg.plot.draw_summary(planner.field, paths, title=scene.title), "out/voxels.png")
