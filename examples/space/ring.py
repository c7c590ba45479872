"""
A periodic axis
===============

A periodic axis has no border, so paths can cross its seam.
"""

from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The path leaves the picture on one side and enters it on the other side.

scene = rg.read_scene(SCENES / "ring.toml")
planner = rg.plan(scene)
paths = planner.paths()
for path in paths:
    rg.certify(path)
assert all(path.outcome == "reached" for path in paths)

# %%
# `unwrap` returns continuous coordinates: the angle leaves the range of 0 to 2 pi.

angles = [rg.planning.unwrap(path)[:, 0] for path in paths]
assert any(angle.min() < 0 or angle.max() > 2 * np.pi for angle in angles)

axes = rg.draw(planner)
rg.draw(paths, axes)
rg.plot.save_figure(axes, "out/ring.png")
