"""
The lesson
==========

A robot follows the current in a grid of resistors. The grid has eight by eight cells, so every resistor can be drawn.
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
# The scene has a wall, a block, a pillar, one goal, and a robot that starts at the upper left. Every square is a cell:
# free, obstacle or goal. A cell index is (column, row), counted from 0 at the lower left, so (6, 1) is the seventh
# column and the second row.

scene = rg.read_scene(SCENES / "lesson.toml")
space = rg.build_space(scene)
assert space.cell[6, 1] == rg.Cell.GOAL
rg.plot.save_figure(rg.draw(scene), "out/1_scene.png")

# %%
# A circuit
# ---------
# The circuit has a node for every free cell, and a resistor of 10 kohm between neighbours. All obstacles and the border
# are one conductor at 1 V. The goal is at 0 V.

netlist = rg.compile_space(space, boundary="dirichlet", resistance=10e3, supply=1.0)
print(f"{np.count_nonzero(space.cell == rg.Cell.FREE)} free cells, {len(netlist.conductance)} resistors")

# %%
# Solve the circuit: current flows from the obstacles to the goal, and every node has a voltage.

op = rg.solve(netlist)
node = netlist.cells.node
for cell in [(0, 6), (5, 3), (5, 1), (6, 2)]:
    print(f"{netlist.node_name(node[cell])} is at {op.voltage[node[cell]]:.4f} V")

# %%
# No local minima
# ---------------
# Consider the node above the goal, n_6_2. By Kirchhoff's current law, the currents into the node sum to zero. All four
# resistors are equal, so the voltage of the node is the mean of its four neighbours (the goal below it is at 0 V). A
# mean lies between the smallest and the largest value. Therefore every node has a lower neighbour, and descent ends at
# the goal.

above_goal = op.voltage[node[6, 2]]
neighbours = op.voltage[node[[5, 7, 6, 6], [2, 2, 3, 1]]]
print(f"n_6_2: {above_goal:.6f} V, mean of its neighbours {neighbours.mean():.6f} V")
assert abs(above_goal - neighbours.mean()) < 1e-12

# %%
# Voltages as probabilities
# -------------------------
# A random walk moves from cell to cell, and all four neighbours are equally likely. 1 - V is the probability that the
# walk reaches the goal before it reaches an obstacle. So the current leads along cells where a random walk is least
# likely to hit an obstacle: it keeps away from walls. A simulation of many walks confirms this within its statistical
# error. The standard error of a fraction p of n walks is sqrt(p (1 - p) / n); in one experiment of twenty the error
# exceeds two standard errors.

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
print(f"of 20,000 random walks {lucky:.4f} +- {error:.4f} reached the goal, {away:.1f} standard errors away")
assert away < 4

# %%
# Four resistors end at the goal. The current of each one is the voltage of its other end divided by its resistance.

into_goal = op.source_current[-1]
by_hand = op.voltage[node[[5, 7, 6, 6], [1, 1, 0, 2]]].sum() / 10e3
print(f"current into the goal: {into_goal * 1e6:.2f} uA")
assert abs(into_goal - by_hand) < 1e-15

# %%
# The path
# --------
# Start at the position of the robot, in world coordinates, and follow the current. The streamline never stops before
# the goal. It cannot enter an obstacle, because current leaves obstacles and never enters them.

field = rg.field(op)
path = rg.streamline(field, scene.starts[0])
rg.certify(path)
print(f"path: {path.outcome}, {path.length:.2f} cells long, {path.clearance:.2f} cells clear of obstacles")
assert path.outcome == "reached"

# %%
# The figure shows the circuit with its node voltages. The panels on the right show the potential with the path, and the
# currents.

figure = Figure((12.0, 7.6), layout="constrained")
grid = figure.add_gridspec(2, 2, width_ratios=[2.1, 1.0])
circuit = rg.draw(op, figure.add_subplot(grid[:, 0]))
circuit.set_title("The circuit: one node per cell, one resistor between neighbours", fontsize=10)
picture = rg.draw(field, figure.add_subplot(grid[0, 1]), scale="linear")
rg.draw(path, picture)
picture.set_title("Its voltages, and the path", fontsize=10)
arrows = rg.draw(field, figure.add_subplot(grid[1, 1]), quantity="currents")
arrows.set_title("Its currents", fontsize=10)
rg.plot.save_figure(figure, "out/2_lesson.png")

# %%
# Write the circuit as a SPICE deck, to check the voltages with any SPICE simulator.

rg.write_spice(op, "out/lesson.cir")
print("\n".join(Path("out/lesson.cir").read_text().splitlines()[:6]))
