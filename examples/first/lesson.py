"""
The lesson
==========

A robot finds its way by letting a current flow. Eight by eight squares, small enough to draw every resistor.
"""

# sphinx_gallery_thumbnail_number = 2

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# A scene
# -------
# A wall, a block, a pillar, one goal, and a robot that starts at the upper left. Every square becomes a cell: free,
# obstacle or goal. Cells are counted from the lower left, first to the right, then upwards, so (6, 1) is the seventh
# column and the second row.

scene = rg.read_scene(SCENES / "lesson.toml")
space = rg.build_space(scene)
assert space.cell[6, 1] == rg.Cell.GOAL
rg.plot.save_figure(rg.draw(scene), "out/1_scene.png")

# %%
# A circuit
# ---------
# A node for every free cell, a resistor of 10 kohm between neighbours. All obstacles, and the border, are one piece of
# metal held at 1 V; the goal is held at 0 V. That is all there is to the chip.

netlist = rg.compile_space(space, boundary="dirichlet", resistance=10e3, supply=1.0)
print(f"{np.count_nonzero(space.cell == rg.Cell.FREE)} free cells, {len(netlist.conductance)} resistors")

# %%
# Switch it on: current runs from the obstacles to the goal, and every node settles at some voltage.

op = rg.solve(netlist)
node = netlist.cells.node
for cell in [(0, 6), (5, 3), (5, 1), (6, 2)]:
    print(f"{netlist.node_name(node[cell])} is at {op.voltage[node[cell]]:.4f} V")

# %%
# Why is there no trap?
# ---------------------
# Take the node above the goal, n_6_2. Kirchhoff says that what flows in flows out, and all four resistors are equal, so
# its voltage is the mean of its four neighbours (the goal below is one: 0 V). A mean lies between the smallest and the
# largest: at every node some neighbour is lower, down to the goal.

above_goal = op.voltage[node[6, 2]]
neighbours = op.voltage[node[[5, 7, 6, 6], [2, 2, 3, 1]]]
print(f"n_6_2: {above_goal:.6f} V, mean of its neighbours {neighbours.mean():.6f} V")
assert abs(above_goal - neighbours.mean()) < 1e-12

# %%
# The same number has another meaning
# -----------------------------------
# Let a drunkard stagger from cell to cell, each neighbour equally likely. 1 - V is the probability that he finds the
# goal before he bumps into anything. So the current leads where staggering is least dangerous: it keeps clear of walls.
# Many drunkards say so, too, within the error of counting: the standard error of a share p of n walks is
# sqrt(p (1 - p) / n), and one experiment in twenty is off by more than two of them.

rng = np.random.default_rng(1)
rail = np.pad(space.cell, 1, constant_values=rg.Cell.OBSTACLE)
walkers = np.tile([7, 3], (20_000, 1))
steps = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
while (moving := rail[tuple(walkers.T)] == rg.Cell.FREE).any():
    walkers[moving] += steps[rng.integers(4, size=moving.sum())]
lucky = np.mean(rail[tuple(walkers.T)] == rg.Cell.GOAL)
error = np.sqrt(lucky * (1 - lucky) / len(walkers))
away = abs(lucky - (1 - above_goal)) / error
print(f"1 - V = {1 - above_goal:.4f}")
print(f"of 20,000 drunkards {lucky:.4f} +- {error:.4f} reached the goal, {away:.1f} standard errors away")
assert away < 4

# %%
# The current into the goal: four resistors end there, each with the voltage of its other end across it.

into_goal = op.source_current[-1]
by_hand = op.voltage[node[[5, 7, 6, 6], [1, 1, 0, 2]]].sum() / 10e3
print(f"current into the goal: {into_goal * 1e6:.2f} uA")
assert abs(into_goal - by_hand) < 1e-15

# %%
# The path
# --------
# Start where the robot stands, in the coordinates of the world, and follow the current. It never stops before the goal,
# and it cannot enter an obstacle, since current leaves obstacles and never enters them.

field = rg.field(op)
path = rg.streamline(field, scene.starts[0])
rg.certify(path)
print(f"path: {path.outcome}, {path.length:.2f} cells long, {path.clearance:.2f} cells clear of obstacles")
assert path.outcome == "reached"

# %%
# Look at it: the circuit with the voltages on its nodes; beside it the same voltages as a landscape, and the path
# downhill.

figure = Figure((12.0, 7.6), layout="constrained")
grid = figure.add_gridspec(2, 2, width_ratios=[2.1, 1.0])
circuit = rg.draw(op, figure.add_subplot(grid[:, 0]))
circuit.set_title("The circuit: one node a cell, one resistor between neighbours", fontsize=10)
picture = rg.draw(field, figure.add_subplot(grid[0, 1]), scale="linear")
rg.draw(path, picture)
picture.set_title("Its voltages, and the path", fontsize=10)
arrows = rg.draw(field, figure.add_subplot(grid[1, 1]), quantity="currents")
arrows.set_title("Its currents", fontsize=10)
rg.plot.save_figure(figure, "out/2_lesson.png")

# %%
# Do not take our word for it: this deck runs in any SPICE.

rg.write_spice(op, "out/lesson.cir")
print("\n".join(Path("out/lesson.cir").read_text().splitlines()[:6]))
