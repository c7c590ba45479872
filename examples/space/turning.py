"""
A robot that rotates
====================

An L-shaped robot passes a gap that is narrower than the robot is long. Its configuration space has three axes.
"""

from pathlib import Path

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The third coordinate is the angle times a length, so rotation contributes to the length of a path.

scene = rg.read_scene(SCENES / "turning.toml")
planner = rg.plan(scene)
path = planner.path(scene.starts[0])
rg.certify(path)
assert path.outcome == "reached"

# %%
# `check_collisions` moves the polygon along the path, and checks it against the exact geometry of the obstacles.

assert rg.check_collisions(path, scene.obstacles) is None
clearance = rg.planning.workspace_clearance(path, scene.obstacles)
print(f"the robot keeps {clearance * 100:.1f} cm away from the walls")
assert clearance > 0
rg.plot.save_figure(rg.plot.draw_robot(path, scene, ghosts=24), "out/turning.png")
