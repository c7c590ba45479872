"""
Figures 15 and 16: reach into a container
=========================================

A free run, and the same with an obstacle that nobody knows of.
"""

from pathlib import Path

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The map's field alone: no contact, all the way on a streamline.

scene = rg.read_scene(SCENES / "container.toml")
field = rg.plan(scene, k=0.98).field
free = rg.simulation(scene.replace(hidden=()), k=0.98, field=field).run()
assert free.ending == rg.Ending.ARRIVED and not len(free.contacts.step)
caption = f"{scene.title}, k = 0.98: the free run."
rg.save_figure(rg.draw(free, title="Figure 15", caption=caption), "out/figure_15.png")

# %%
# The hidden obstacle is felt; while it is, the robot follows the equipotential. Nothing is computed again.

simulation = rg.simulation(scene, k=0.98, field=field, learn=False)
blind = simulation.run()
parts = sorted({int(part) + 1 for part in blind.contacts.part})
assert blind.ending == rg.Ending.ARRIVED
caption = f"{scene.title}, k = 0.98. A hidden obstacle deflects link {parts[0]} (force in red); nothing is recomputed."
rg.save_figure(rg.draw(blind, title="Figure 16", caption=caption), "out/figure_16.png")
