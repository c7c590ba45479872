"""
Figure 14: velocities at a contact
==================================

A contact force F changes the velocity :math:`V_0` by :math:`A F`, or projects it onto the equipotential.
"""

from pathlib import Path

import numpy as np

import resgrid as rg

Path("out").mkdir(exist_ok=True)

# %%
# The map is an empty room with a goal; it does not contain the obstacle.

cell = np.zeros((40, 32), dtype=np.uint8)
cell[34, 4:6] = rg.Cell.GOAL
space = rg.ConfigurationSpace([rg.Axis("x", 0, 4, 40), rg.Axis("y", 0, 3.2, 32)], cell)
field = rg.plan(space, k=0.2).field

# %%
# Along the equipotential the potential is constant, and the speed is unchanged.

velocity = rg.control.make_controller(field, speed=1.0).command((1.65, 1.84), (0.0, 0.0))
along = rg.control.equipotential_velocity(velocity, (0.15, 1.0))
assert abs(along @ velocity) < 1e-12 and along @ (0.15, 1.0) > 0

axes = rg.plot.draw_velocities(field, point=(1.65, 1.84), force=(0.15, 1.0), admittance=0.15)
axes.fill([1.2, 2.1, 2.1, 1.2], [1.2, 1.2, 1.78, 1.78], color="#b96b6b", zorder=3, label="obstacle not on the map")
axes.set_title("Figure 14", fontsize=10)
axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), fontsize=7, frameon=False, ncols=2)
rg.plot.save_figure(axes, "out/figure_14.png")
