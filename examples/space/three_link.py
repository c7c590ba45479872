"""
An arm with three links
=======================

Plan a path in the three-dimensional space of joint angles, with self-collision.
"""

from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The goal is a disc for the tip; every configuration with the tip in the disc is a solution.

scene = rg.read_scene(SCENES / "three_link.toml")
planner = rg.plan(scene)
path = planner.path(scene.starts[0])
rg.certify(path)
assert path.outcome == "reached"
assert rg.check_collisions(path, scene.obstacles) is None

# %%
# The tip ends in the goal, a disc of radius 0.2 m around (-1, -0.6), up to the width of a cell.

tip = rg.planning.workspace_path(path)[-1]
print(f"the tip ends {np.hypot(tip[0] + 1.0, tip[1] + 0.6):.3f} m from the centre of the goal")
assert np.hypot(tip[0] + 1.0, tip[1] + 0.6) < 0.4
rg.plot.save_figure(rg.plot.draw_robot(path, scene, ghosts=16), "out/three_link.png")
