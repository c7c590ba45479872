"""
How fast may a robot be?
========================

It drives while the grid still settles; how many cells may pass in a settling time?
"""

from pathlib import Path

import resgrid as rg
from resgrid.control.announced import relaxation_sweep
from resgrid.control.relaxation import Relaxation

Path("out").mkdir(exist_ok=True)

# %%
# A hidden obstacle is put on the map while the robot is on its way, and the grid relaxes towards the new field.

scene = rg.Scene(
    (rg.Axis("x", 0, 8, 16), rg.Axis("y", 0, 8, 16)),
    hidden=(rg.Box((2.0, 3.0), (6.5, 4.0)),),
    goals=(rg.GoalPoint((4.2, 0.7)),),
    starts=((4.2, 7.2),),
)
world = rg.simulation(scene, k=0.98)
ratios = (30.0, 300.0, 3000.0, 1e6)
sweeps = [relaxation_sweep(world, scene.starts[0], Relaxation(method), ratios) for method in ("chip", "jacobi", "sor")]
for sweep in sweeps:
    print(f"arrives up to {sweep.safe_ratio:g} cells a settling time, fails from {sweep.failing_ratio:g}")
    assert sweep.safe_ratio < sweep.failing_ratio
rg.save_figure(rg.draw(sweeps), "out/settling.png")
