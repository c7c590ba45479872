"""
A maze with three storeys
=========================

A maze in which the potential drop is smaller than the rounding error of a normwise solver.
"""

from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The drop from the obstacle rail decreases by orders of magnitude from storey to storey. The field stores its
# logarithm.

scene = rg.read_scene(SCENES / "voxel_maze.toml")
planner = rg.plan(scene)
field = planner.field
decades = -np.min(field.log_drop[np.isfinite(field.log_drop)]) / np.log(10)
print(f"the drop spans {decades:.0f} orders of magnitude; doubles resolve 16 near 1")
assert decades > 16

path = planner.path(scene.starts[0])
rg.certify(path)
assert path.outcome == "reached"
rg.plot.save_figure(rg.plot.draw_summary(field, [path], title=scene.title), "out/voxel_maze.png")
