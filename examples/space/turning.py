"""
A robot that turns
==================

An L-shaped robot, longer than the gap is wide, which its configuration space of three axes leads through.
"""

from pathlib import Path

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The third coordinate is the angle times a length, so that turning has a cost, too.

scene = rg.read_scene(SCENES / "turning.toml")
planner = rg.plan(scene)
path = planner.path(scene.starts[0])
rg.certify(path)
assert path.outcome == "reached"

# %%
# Geometry, not cells, has the last word: the polygon itself is driven along the path.

assert rg.check_collisions(path, scene.obstacles) is None
clearance = rg.planning.workspace_clearance(path, scene.obstacles)
print(f"the robot keeps {clearance * 100:.1f} cm away from the walls")
assert clearance > 0
rg.plot.save_figure(rg.plot.draw_robot(path, scene, ghosts=24), "out/turning.png")
