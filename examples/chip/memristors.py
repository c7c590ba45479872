"""
A maze solved by memristors
===========================

Every link of a maze is a pair of antiparallel memristors. A voltage between entrance and exit drives current along all
routes. The resistance falls along the shortest route first (Pershin & Di Ventra 2011).
"""

from pathlib import Path

import networkx as nx
import numpy as np
from matplotlib.figure import Figure

import resgrid as rg

Path("out").mkdir(exist_ok=True)

# %%
# A random maze is a spanning tree of the rooms; further doors open loops. Rooms have even coordinates on the map.


def random_maze(side: int, extra_doors: int, seed: int) -> nx.Graph:
    """Return the graph of a maze with `side` x `side` rooms and some doors more than a spanning tree has."""
    random = np.random.default_rng(seed)
    grid = nx.grid_2d_graph(side, side)
    for edge in grid.edges:
        grid.edges[edge]["weight"] = random.random()
    maze = nx.Graph(nx.minimum_spanning_tree(grid).edges)
    closed = [edge for edge in grid.edges if not maze.has_edge(*edge)]
    maze.add_edges_from(closed[door] for door in random.permutation(len(closed))[:extra_doors])
    return maze


def space_of(maze: nx.Graph, side: int) -> rg.ConfigurationSpace:
    """Return the map of a maze: rooms and doors are free cells, and the last room is the goal."""
    cell = np.full((2 * side - 1, 2 * side - 1), rg.Cell.OBSTACLE)
    for first, second in maze.edges:
        for place in (2 * np.array(first), np.add(first, second), 2 * np.array(second)):
            cell[tuple(place)] = rg.Cell.FREE
    cell[-1, -1] = rg.Cell.GOAL
    return rg.ConfigurationSpace([rg.Axis(name, 0, len(cell), len(cell)) for name in "xy"], cell)


# %%
# With open obstacles and the start as the source, the compiled netlist has one resistor per link. Each becomes two
# antiparallel memristors, because the direction of the current is not known beforehand.

side = 6
maze = random_maze(side, 4, seed=5)
law = rg.circuit.Memristor(on_resistance=1e3, off_resistance=1e5, rate=1e6)
netlist = rg.compile_space(space_of(maze, side), boundary="neumann", drive="start", start=(0, 0))
circuit = rg.circuit.MemristiveCircuit.antiparallel(netlist, law)
shortest = nx.shortest_path(maze, (0, 0), (side - 1, side - 1))
links = 2 * (len(shortest) - 1)

# %%
# A chain of ``n`` memristors in the state 0 at the voltage ``V`` reaches the state 1 after
# ``n (R_on + R_off) / (2 k V)``: the time is proportional to the length of the route.

alone = links * (law.on_resistance + law.off_resistance) / 2 / law.rate
times = np.linspace(0, 3 * alone, 61)
run = rg.circuit.memristive_transient(circuit, times, tolerance=1e-4)

# %%
# Links whose state has passed 0.5 are switched. The first route of switched links from entrance to exit is compared
# with the shortest path of networkx.


def first_route(links: np.ndarray, switched: np.ndarray, start: int, end: int) -> tuple[float, list[int]]:
    """Return the time at which switched links first join two nodes, and the shortest route of such links."""
    found = nx.Graph()
    found.add_nodes_from((start, end))
    for link in np.argsort(switched)[: np.count_nonzero(np.isfinite(switched))]:
        found.add_edge(*links[link].tolist())
        if nx.has_path(found, start, end):
            return switched[link], nx.shortest_path(found, start, end)
    raise ValueError("no route has switched")


def switching_times(run: rg.circuit.MemristiveTransient) -> np.ndarray:
    """Return the switching time of every pair, NaN if neither memristor has switched."""
    forward, backward = np.split(run.switching_time, 2)
    return np.fmin(forward, backward)


source, sink = int(netlist.source_nodes[np.argmax(netlist.source_volts), 0]), netlist.cells.goal_nodes[0]
emerged, route = first_route(netlist.resistor_nodes, switching_times(run), source, sink)
print(f"shortest route {links} links; the first route of switched links has {len(route) - 1}, after {emerged:.2f} s")
assert len(route) - 1 == links

# %%
# The statement of the paper that routes are sorted by their length has a closed form for separate routes: their
# switching times have the ratio of their lengths.

lengths = (4, 6, 9)
nodes, resistors = 2, []
for length in lengths:
    inner = list(range(nodes, nodes + length - 1))
    resistors += list(zip([1, *inner], [*inner, 0], strict=True))
    nodes += length - 1
routes = rg.Netlist(nodes, resistors, np.ones(len(resistors)), source_nodes=[[1, 0]], source_volts=[1.0])
separate = rg.circuit.memristive_transient(rg.circuit.MemristiveCircuit(routes, law), [1.0], tolerance=1e-8)
first = separate.switching_time[np.cumsum([0, *lengths[:-1]])]
print("switching times relative to the shortest route:", (first / first[0]).round(6))
assert np.allclose(first / first[0], np.divide(lengths, lengths[0]), rtol=1e-7)

# %%
# Random mazes, as graphs: the fraction in which the first route is a shortest one.

agreed, count = 0, 10
for seed in range(count):
    graph = nx.convert_node_labels_to_integers(random_maze(5, 6, seed))
    nx.set_edge_attributes(graph, 1.0, "conductance")
    last = len(graph) - 1
    resistors = rg.Netlist.from_networkx(graph, ground=last)
    entrance = resistors.node_names.index("0")
    driven = resistors.replace(source_nodes=[[entrance, 0]], source_volts=[1.0])
    length = nx.shortest_path_length(graph, 0, last)
    pairs = rg.circuit.MemristiveCircuit.antiparallel(driven, law)
    end = length * (law.on_resistance + law.off_resistance) / law.rate
    switched = switching_times(rg.circuit.memristive_transient(pairs, [end], tolerance=1e-3))
    _, way = first_route(driven.resistor_nodes, switched, entrance, 0)
    agreed += len(way) - 1 == length
print(f"the first route is a shortest one in {agreed} of {count} random mazes")
assert agreed == count

# %%
# The links at three times, and the total current. The current rises as routes switch one after another.

figure = Figure((11.0, 6.4), layout="constrained")
upper, lower = figure.subfigures(2, 1, height_ratios=(1.25, 1))
shown = [int(np.searchsorted(times, time)) for time in (0.9 * emerged, 1.05 * emerged, times[-1])]
for axes, at in zip(upper.subplots(1, 3), shown, strict=True):
    rg.draw(run, axes, at=at)
left, right = lower.subplots(1, 2)
rail = int(np.argmax(netlist.source_volts))
amps = [-rg.solve(circuit.netlist_at(state)).source_current[rail] for state in run.state]
left.plot(times, 1e6 * np.array(amps), color="#0072b2")
left.axvline(emerged, color="black", ls="--", lw=1, label="first route switched")
left.set(xlabel="time (s)", ylabel="total current (\N{MICRO SIGN}A)")
left.legend(fontsize=7, frameon=False)
rg.draw(run, right, quantity="states")
rg.plot.save_figure(figure, "out/memristors.png")
