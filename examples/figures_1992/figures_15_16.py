"""
Figures 15 and 16: reach into a container
=========================================

A run without and with an obstacle that is not on the map, at several k.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# Without the hidden obstacle there is no contact, and the robot follows a streamline to the goal.

scene = rg.read_scene(SCENES / "container.toml")
bare = scene.replace(hidden=())
planner = rg.plan(scene, k=0.98)
free = rg.simulation(bare, k=0.98, field=planner.field).run()
assert free.ending == rg.control.TerminationReason.ARRIVED and not len(free.contacts.step)
caption = f"{scene.title}, k = 0.98: the free run."
rg.plot.save_figure(rg.draw(free, title="Figure 15", caption=caption), "out/1_figure_15.png")

# %%
# A link, not the tip, touches the hidden obstacle. During contact the robot follows the equipotential. The field is not
# solved again.

simulation = rg.simulation(scene, k=0.98, field=planner.field, learn=False)
blind = simulation.run()
tip = np.array([scene.robot.reference_point(q) for q in blind.configuration[blind.contacts.step]])
from_tip = np.linalg.norm(tip - blind.contacts.point, axis=1).min()
print(f"the contact is {from_tip:.2f} m from the tip")
assert blind.ending == rg.control.TerminationReason.ARRIVED and from_tip > 0.1
caption = f"{scene.title}, k = 0.98. A hidden obstacle deflects a link (force in red); nothing is recomputed."
rg.plot.save_figure(rg.draw(blind, title="Figure 16", caption=caption), "out/2_figure_16.png")

# %%
# With learning, the robot adds touched cells to its map. It never marks a cell that is free.

taught = replace(simulation, learn=True).run()
truth = simulation.plant.true_space(simulation.space).cell == rg.Cell.OBSTACLE
print(f"{int(taught.learnt.sum())} cells learnt")
assert taught.learnt.any() and not (taught.learnt & ~truth).any()

# %%
# Repeat both runs at four blends.

blends = (0.98, 0.0, 0.5, 1.0)
fields = [planner.at(k).field for k in blends]
for world, number, kind in ((bare, 15, "the free run"), (scene, 16, "with the hidden obstacle")):
    runs = [rg.simulation(world, k=k, field=f, learn=False).run() for k, f in zip(blends, fields, strict=True)]
    print(f"figure {number}: " + ", ".join(f"k = {k:g} {run.ending}" for k, run in zip(blends, runs, strict=True)))
    assert all(run.ending == rg.control.TerminationReason.ARRIVED for run in runs)
    rg.plot.save_figure(
        rg.draw(runs, title=f"As figure {number}: {kind}, at several k"), f"out/3_figure_{number}_by_k.png"
    )

# %%
# Dirichlet currents decay exponentially away from the goal, and Neumann currents do not. The map shows the Dirichlet
# fraction of the current.

share = planner.dirichlet_fraction()[planner.space.goal_connected]
print(f"Neumann dominates in {np.mean(share < 0.5):.0%} of the cells, although k = 0.98")
assert np.mean(share < 0.5) > 0.4
axes = rg.plot.draw_dirichlet_fraction(planner.obstacle_field, planner.open_field, 0.98)
rg.plot.save_figure(axes, "out/4_share.png")
