"""
Three storeys
=============

A maze whose exponentially small potentials a plain solver would round away.
"""

from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The drop from the obstacle rail falls by decades from storey to storey; its logarithm is kept.

scene = rg.read_scene(SCENES / "voxel_maze.toml")
planner = rg.plan(scene)
field = planner.field
decades = -np.min(field.log_drop[np.isfinite(field.log_drop)]) / np.log(10)
print(f"the drop spans {decades:.0f} decades; doubles resolve 16 below 1")
assert decades > 16

path = planner.path(scene.starts[0])
rg.certify(path)
assert path.outcome == "reached"
rg.plot.save_figure(rg.plot.draw_summary(field, [path], title=scene.title), "out/voxel_maze.png")
