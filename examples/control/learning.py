"""
Learning by touch
=================

A hidden obstacle is felt, marked, and planned around.
"""

from pathlib import Path

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The obstacle is in no map. Each contact proves cells to be obstacle, and the field is solved again.

scene = rg.read_scene(SCENES / "chair.toml")
run = rg.simulation(scene, k=0.98).run()
print(f"{run.ending} after {run.time[-1]:.1f} s, {int(run.learnt.sum())} cells learnt")
assert run.ending == rg.control.TerminationReason.ARRIVED and run.learnt.any()
rg.animate(run, "out/learning.gif", count=40, rate=10)
