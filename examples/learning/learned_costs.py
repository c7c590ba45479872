"""
Costs of terrain from demonstrated paths
========================================

A cost map is learned from paths of an expert, and used on maps that the expert has not seen. A grid with a leak is a
random walk that may end in every cell. It ends more often in cells of low conductivity, so that walks that reach the
goal avoid such cells (maximum-entropy inverse reinforcement learning, Ziebart et al. 2008). The log-likelihood of a
path contains the conductances of its steps and the log drop at its start, whose derivatives `pullback` returns.
"""

import itertools
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch
from scipy import ndimage, optimize, sparse

import resgrid as rg

Path("out").mkdir(exist_ok=True)

# %%
# Maps of 40 x 30 cells with four kinds of terrain and a wall; the costs per cell are known to the expert only.

TERRAIN = ["road", "grass", "mud", "scree"]
COST = np.array([1.0, 2.5, 6.0, 12.0])
SHAPE = (40, 30)


def make_map(seed: int) -> tuple[np.ndarray, np.ndarray, tuple[int, int], np.ndarray]:
    """Return terrain, cells, goal and starts of a random map."""
    rng = np.random.default_rng(seed)
    height = ndimage.gaussian_filter(rng.normal(size=SHAPE), 2.5, mode="wrap")
    terrain = np.digitize(height, np.quantile(height, [0.25, 0.55, 0.8]))
    cell = np.zeros(SHAPE, dtype=np.uint8)
    column = int(rng.integers(14, 26))
    cell[column, int(rng.integers(2, 10)) : int(rng.integers(16, 28))] = rg.Cell.OBSTACLE
    goal = (int(rng.integers(1, 8)), int(rng.integers(1, 29)))
    cell[goal] = rg.Cell.GOAL
    free = np.argwhere(cell == rg.Cell.FREE)
    far = free[np.abs(free - goal).sum(axis=1) > 20]
    return terrain, cell, goal, far[rng.choice(len(far), 8, replace=False)]


def expert(terrain: np.ndarray, cell: np.ndarray, goal: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the cost-to-go of every cell and its successor on a cheapest path, by Dijkstra's algorithm."""
    number, cost = np.arange(cell.size).reshape(SHAPE), COST[terrain]
    open_ = cell != rg.Cell.OBSTACLE
    pairs, steps = [], []
    for axis in (0, 1):
        a, b = np.take(number, range(SHAPE[axis] - 1), axis), np.take(number, range(1, SHAPE[axis]), axis)
        both = open_.ravel()[a] & open_.ravel()[b]
        pairs.append(np.stack([a[both], b[both]]))
        steps.append((cost.ravel()[a] + cost.ravel()[b])[both] / 2)
    (a, b), step = np.concatenate(pairs, axis=1), np.concatenate(steps)
    graph = sparse.csr_array((step, (a, b)), shape=(cell.size, cell.size))
    value, successor = sparse.csgraph.dijkstra(graph, directed=False, indices=number[goal], return_predecessors=True)
    return value, successor


def follow(successor: np.ndarray, start: int, goal: int) -> list[int]:
    """Return the cells of a path, as flat indices."""
    path = [start]
    while path[-1] != goal and len(path) < 500:
        path.append(int(successor[path[-1]]))
    return path


# %%
# The circuit: conductivities exp(theta) of the terrains, open obstacles and edges, and a leak that drives the grid.

LEAK = 100.0
AXES = [rg.Axis("x", 0, SHAPE[0], SHAPE[0]), rg.Axis("y", 0, SHAPE[1], SHAPE[1])]


def solve(theta: np.ndarray, terrain: np.ndarray, cell: np.ndarray) -> rg.OperatingPoint:
    """Return the operating point of a map."""
    space = rg.ConfigurationSpace(AXES, cell, conductivity=np.exp(theta[terrain]))
    return rg.solve(rg.compile_space(space, boundary="neumann", leak=LEAK, resistance=1.0))


def likelihood(
    theta: np.ndarray, terrain: np.ndarray, cell: np.ndarray, paths: list[list[int]]
) -> tuple[float, np.ndarray]:
    """Return the mean log-likelihood per step of the paths, and its derivatives with respect to theta.

    A step from ``a`` to ``b`` has the probability ``g_ab u_b / (D_a u_a)`` given that the walk reaches the goal, with
    the drop ``u`` and the sum ``D_a`` of the conductances at ``a``. On a path only the ``u`` of the start remains.
    """
    op = solve(theta, terrain, cell)
    netlist, node = op.netlist, op.netlist.cells.node.ravel()
    g, ends = netlist.conductance, netlist.resistor_nodes
    degree = np.bincount(ends.ravel(), np.repeat(g, 2), netlist.node_count)
    number = {frozenset(pair): k for k, pair in enumerate(ends.tolist())}
    used = [number[frozenset((int(node[a]), int(node[b])))] for path in paths for a, b in itertools.pairwise(path)]
    visited = np.array([node[a] for path in paths for a in path[:-1]])
    seed = np.bincount([node[path[0]] for path in paths], minlength=netlist.node_count).astype(float)
    drops = rg.circuit.pullback(op, log_drop=seed)
    value = np.log(g[used]).sum() - np.log(degree[visited]).sum() - drops.value
    per_degree = np.bincount(visited, minlength=netlist.node_count) / np.maximum(degree, 1e-300)
    slope = np.bincount(used, minlength=len(g)) / g - per_degree[ends].sum(axis=1) - drops.conductance
    by_cell = rg.circuit.conductivity_gradient(netlist, slope) * netlist.cells.space.conductivity
    steps = len(used)
    return value / steps, np.bincount(terrain.ravel(), by_cell.ravel(), len(COST)) / steps


# %%
# Training on six maps with eight paths each.

training = []
for seed in range(6):
    terrain, cell, goal, starts = make_map(seed)
    successor, flat = expert(terrain, cell, goal)[1], int(np.ravel_multi_index(goal, SHAPE))
    numbers = np.ravel_multi_index(starts.T, SHAPE).tolist()
    training.append((terrain, cell, [follow(successor, start, flat) for start in numbers]))


def loss(theta: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the negative log-likelihood per step over all maps, and its derivatives."""
    parts = [likelihood(theta, *each) for each in training]
    return -np.mean([value for value, _ in parts]), -np.mean([slope for _, slope in parts], axis=0)


found = optimize.minimize(loss, np.zeros(len(COST)), jac=True, method="L-BFGS-B", options={"maxiter": 40})
print(
    f"{found.nit} iterations, {found.nfev} gradients; mean probability of a demonstrated step: "
    f"{np.exp(-loss(np.zeros(4))[0]):.3f} before, {np.exp(-found.fun):.3f} after training"
)
learned = np.log(4 + LEAK * np.exp(-found.x))  # minus the log-probability c / (4 c + leak) of a step
for name, cost, theta, guess in zip(TERRAIN, COST, found.x, learned / learned[0], strict=True):
    print(f"{name:6} true cost {cost:4.1f}, learned cost {guess:5.2f}, conductivity {np.exp(theta):.2e}")

# %%
# The success on twelve unseen maps: from every start, walk to the most probable next cell until the goal, and compare
# the true cost of the path with the cost of the cheapest path. The baseline is a map with equal conductivities.


def most_probable(op: rg.OperatingPoint, start: int, goal: int) -> list[int]:
    """Return the cells of the path of the largest currents, as flat indices."""
    netlist = op.netlist
    cell_of = netlist.cell_of_node()
    cell_of[netlist.cells.goal_nodes[0]] = goal
    away = np.where(op.resistor_direction > 0, netlist.resistor_nodes[:, 0], netlist.resistor_nodes[:, 1])
    towards = np.where(op.resistor_direction > 0, netlist.resistor_nodes[:, 1], netlist.resistor_nodes[:, 0])
    order = np.lexsort([op.resistor_log_current, away])
    best = dict(zip(away[order].tolist(), towards[order].tolist(), strict=True))
    return follow({int(cell_of[a]): int(cell_of[b]) for a, b in best.items() if cell_of[a] >= 0}, start, goal)


def true_cost(path: list[int], terrain: np.ndarray) -> float:
    """Return the expert's cost of a path: the mean cost of both cells, per step."""
    costs = COST[terrain.ravel()[path]]
    return float((costs[:-1] + costs[1:]).sum() / 2)


excess: dict[str, list[float]] = {"learned": [], "equal": []}
for seed in range(100, 112):
    terrain, cell, goal, starts = make_map(seed)
    (value, successor), flat = expert(terrain, cell, goal), int(np.ravel_multi_index(goal, SHAPE))
    points = {"learned": solve(found.x, terrain, cell), "equal": solve(np.zeros(len(COST)), terrain, cell)}
    shown = {name: [] for name in ("expert", *points)}
    for start in np.ravel_multi_index(starts.T, SHAPE).tolist():
        shown["expert"].append(follow(successor, start, flat))
        for name, op in points.items():
            path = most_probable(op, start, flat)
            assert path[-1] == flat
            excess[name].append(true_cost(path, terrain) / value.ravel()[start] - 1)
            shown[name].append(path)
for name, above in excess.items():
    print(
        f"{name:7} conductivities: {np.mean(above):6.1%} above the cheapest cost (median {np.median(above):.1%}, "
        f"worst {np.max(above):.0%}); {np.mean(np.array(above) < 1e-9):.0%} of {len(above)} paths are cheapest paths"
    )
print(f"log drops of the last map reach down to {points['learned'].log_drop[2:].min():.0f}")
assert np.mean(excess["learned"]) < 0.02
assert np.mean(excess["equal"]) > 0.3

# %%
# One of the unseen maps, and the learned costs relative to a cell of road.

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), width_ratios=(1.5, 1), layout="constrained")
colours = ["#efe6d2", "#b7d49a", "#a98467", "#7d7f83"]
left.imshow(np.ma.masked_where(cell == rg.Cell.OBSTACLE, terrain).T, origin="lower", cmap=ListedColormap(colours))
left.set_facecolor("black")
for name, style in (("equal", "-C3"), ("expert", "-k"), ("learned", "--C0")):
    for number, path in enumerate(shown[name]):
        cells = np.array(np.unravel_index(path, SHAPE))
        left.plot(*cells, style, lw=1.2 if name == "learned" else 2.2, label=None if number else name)
left.plot(*goal, "*w", ms=14, mec="k")
left.set(title="Paths on an unseen map", xlabel="x", ylabel="y")
terrains = [Patch(color=colour, label=name) for colour, name in zip(colours, TERRAIN, strict=True)]
left.legend(handles=[*left.get_legend_handles_labels()[0], *terrains], loc="upper left", bbox_to_anchor=(1.0, 1.0))
right.plot(COST, learned / learned[0], "o", label="learned")
right.plot([0, 14], [0, 14], "k:", label="true")
for name, cost, guess in zip(TERRAIN, COST, learned / learned[0], strict=True):
    right.annotate(name, (cost, guess), textcoords="offset points", xytext=(6, -10))
right.set(title="Cost of a cell", xlabel="true cost", ylabel="learned cost (road = 1)")
right.legend()
figure.savefig("out/learned_costs.png", dpi=120)
