"""
Propagation of a new obstacle
=============================

The change of the potential spreads through the grid by diffusion.
"""

from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The hidden obstacle of the chair scene is added to the map at time 0.

scene = rg.read_scene(SCENES / "chair.toml")
world = rg.simulation(scene, k=0.98, announce=True, pace=4.0)
front = rg.control.wavefront(world, np.array([0, 1, 3, 10, 30, 100.0]))
assert len(front.potential) == 6
rg.plot.save_figure(rg.draw(front), "out/wavefront.png")
