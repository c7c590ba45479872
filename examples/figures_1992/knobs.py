"""
Clearance against k
===================

Compare the mean clearance of two parameters: the blend k of two chips, and the wall resistance of a single chip, a
resistor in series with every obstacle contact.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The grid is coarser than in the figures, to reduce the run time to seconds.

scene = rg.read_scene(SCENES / "problem_a.toml")
scene = scene.replace(axes=tuple(rg.Axis(a.name, a.lower, a.upper, 60, a.periodic, a.unit) for a in scene.axes))
planner = rg.plan(scene, k=1.0)
cell = planner.space.spacing[0]
curve = rg.planning.clearance_curve(planner, (0.0, 0.1, 0.5, 0.9, 1.0))
walls = rg.planning.clearance_curve(planner, wall_resistances=(0.0, 1e4, 1e5, 1e6, 1e8))

# %%
# Mean clearance does not decrease with k (by more than a fraction of a cell), and a wall of 0 ohm equals Dirichlet.

assert np.max(curve.mean[:-1] - curve.mean[1:]) < 0.5 * cell
assert abs(walls.mean[0] - curve.mean[-1]) < 1e-9

figure = Figure((9.0, 3.8), layout="constrained")
left = figure.add_subplot(1, 2, 1)
rg.draw(curve, left, unit="rad", cell=cell)
rg.draw(walls, figure.add_subplot(1, 2, 2, sharey=left), unit="rad", cell=cell)
rg.plot.save_figure(figure, "out/clearance.png")
