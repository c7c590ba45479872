"""
Figures 17 to 19: reach over a chair
====================================

A run without obstacle, a run in which a link touches a hidden obstacle, and a run with learning.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The first run has no hidden obstacle. In the second run a link, not the tip, touches the obstacle, and the map is not
# changed.

scene = rg.read_scene(SCENES / "chair.toml")
field = rg.plan(scene, k=0.98).field
simulation = rg.simulation(scene, k=0.98, field=field, learn=False)
free = rg.simulation(scene.replace(hidden=()), k=0.98, field=field).run()
blind = simulation.run()
tip = np.array([scene.robot.reference_point(q) for q in blind.configuration[blind.contacts.step]])
from_tip = np.linalg.norm(tip - blind.contacts.point, axis=1).min()
print(f"the contact is {from_tip:.2f} m from the tip")
assert from_tip > 0.2

# %%
# With learning, each contact proves that cells are obstacles, and the field is solved again. No free cell is marked.

taught = replace(simulation, learn=True).run()
truth = simulation.plant.true_space(simulation.space).cell == rg.Cell.OBSTACLE
learnt = int(taught.learnt.sum())
print(f"{learnt} cells learnt in {len(taught.lessons)} re-solve")
assert learnt > 0 and not (taught.learnt & ~truth).any()

runs = {
    17: (free, "the free run."),
    18: (blind, "a hidden obstacle deflects a link (force in red); nothing is recomputed."),
    19: (taught, f"{learnt} cells learnt (circles)."),
}
for number, (run, caption) in runs.items():
    assert run.ending == rg.control.TerminationReason.ARRIVED
    picture = rg.draw(run, title=f"Figure {number}", caption=f"{scene.title}, k = 0.98: {caption}")
    rg.plot.save_figure(picture, f"out/figure_{number}.png")
