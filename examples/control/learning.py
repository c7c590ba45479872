"""
Learning by touch
=================

Detect a hidden obstacle by contact, add it to the map, and plan around it.
"""

from pathlib import Path

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The obstacle is not on the map. Each contact proves that cells are obstacles, and the field is solved again.

scene = rg.read_scene(SCENES / "chair.toml")
run = rg.simulation(scene, k=0.98).run()
print(f"{run.ending} after {run.time[-1]:.1f} s, {int(run.learnt.sum())} cells learnt")
assert run.ending == rg.control.TerminationReason.ARRIVED and run.learnt.any()
rg.animate(run, "out/learning.gif", count=40, rate=10)
