"""
Basins of two goals
===================

A flat has two charging stations. The current from a start determines the station that it reaches.
"""

from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# One solve is sufficient for all starts: `basins` follows the current from the centre of every cell.

scene = rg.read_scene(SCENES / "rooms.toml")
planner = rg.plan(scene)
basin = rg.basins(planner.field)
space = planner.space
free = space.goal_connected & (space.cell == rg.Cell.FREE)
share = [float(np.mean(basin[free] == goal)) for goal in range(space.goal_count)]
print(", ".join(f"goal {goal} serves {part:.0%}" for goal, part in enumerate(share)))
assert abs(sum(share) - 1.0) < 1e-12

# %%
# `hitting_probability` is the corresponding figure for a random walk with reflecting obstacles: the probability of
# reaching goal 0 before goal 1.

chance = rg.planning.hitting_probability(rg.compile_space(space, boundary="neumann")).probability[0]
assert 0.0 <= np.nanmin(chance[free]) <= np.nanmax(chance[free]) <= 1.0

axes = rg.draw(space)
picture = np.where(free, basin, np.nan).T
x, y = space.axes
image = axes.imshow(
    picture, origin="lower", extent=(x.lower, x.upper, y.lower, y.upper), cmap="Pastel1", vmin=0, vmax=8, zorder=1
)
for goal in range(space.goal_count):
    centre = space.centre(np.argwhere(space.goal_region == goal)).mean(axis=0)
    axes.text(*centre, goal, ha="center", va="center", fontsize=8, zorder=9)
    axes.plot([], [], "s", color=image.to_rgba(goal), label=f"served by goal {goal}")
rg.draw(planner.paths(scene.starts), axes)
axes.set_title("Basins of the two goals", fontsize=9)
rg.plot.save_figure(axes, "out/basins.png")
