"""A first lesson: a robot finds its way by letting a current flow.

Run it with ``python examples/lesson.py``; it writes its figure and a SPICE deck into ``out/lesson``.
"""

from pathlib import Path

import resgrid as rg

HERE = Path(__file__).resolve().parent


def main(folder: Path = Path("out/lesson")) -> dict[str, float]:
    # 1. A scene.  Eight by eight squares, a wall, a block, a pillar, one goal, and a robot that starts at the upper
    #    left.  Open scenes/lesson.toml beside this page: it holds nothing else.
    scene = rg.read_scene(HERE / "scenes" / "lesson.toml")

    # 2. The space.  Every square becomes a cell: free, obstacle or goal.  Cells are counted from the lower left, first
    #    to the right, then upwards, so (6, 1) is the seventh column and the second row.
    space = rg.sample(scene)
    assert space.cell[6, 1] == rg.Cell.GOAL

    # 3. The circuit.  A node for every free cell, a resistor of 10 kohm between neighbours.  All obstacles, and the
    #    border, are one piece of metal held at 1 V; the goal is held at 0 V.  That is all there is to the chip.
    netlist = rg.compile_space(space, boundary="dirichlet", resistance=10e3, supply=1.0)
    print(f"{len(space.cell[space.cell == rg.Cell.FREE])} free cells, {len(netlist.conductance)} resistors")

    # 4. Switch it on.  Current runs from the obstacles to the goal, and every node settles at some voltage.
    point = rg.solve(netlist)
    node = netlist.cells.node
    for cell in [(0, 6), (5, 3), (5, 1), (6, 2)]:
        print(f"{netlist.node_name(node[cell])} is at {point.voltage[node[cell]]:.4f} V")

    # 5. Why is there no trap?  Take the node above the goal, n_6_2.  Kirchhoff says that what flows in flows out, and
    #    all four resistors are equal, so its voltage is the mean of its four neighbours (the goal below is one: 0 V).
    #    A mean lies between the smallest and the largest: at every node some neighbour is lower, down to the goal.
    above_goal = point.voltage[node[6, 2]]
    neighbours = point.voltage[node[[5, 7, 6, 6], [2, 2, 3, 1]]]
    print(f"n_6_2: {above_goal:.6f} V, mean of its neighbours {neighbours.mean():.6f} V")
    assert abs(above_goal - neighbours.mean()) < 1e-12

    # 6. The same number has another meaning.  Let a drunkard stagger from cell to cell, each neighbour equally likely.
    #    1 - V is the probability that he finds the goal before he bumps into anything.  So the current leads where
    #    staggering is least dangerous: it keeps clear of walls.
    survives = 1.0 - above_goal
    print(f"from n_6_2 a drunkard reaches the goal with probability {survives:.4f}")

    # 7. The current into the goal.  Four resistors end there, each with the voltage of its other end across it.
    into_goal = point.source_current[-1]
    by_hand = point.voltage[node[[5, 7, 6, 6], [1, 1, 0, 2]]].sum() / 10e3
    print(f"current into the goal: {into_goal * 1e6:.2f} uA")
    assert abs(into_goal - by_hand) < 1e-15

    # 8. The path.  Start where the robot stands, in the coordinates of the world, and follow the current.  It never
    #    stops before the goal, and it cannot enter an obstacle, since current leaves obstacles and never enters them.
    field = rg.field(point)
    path = rg.streamline(field, start=scene.starts[0])
    rg.certify(path)
    print(f"path: {path.outcome}, {path.length:.2f} cells long, {path.clearance:.2f} cells clear of obstacles")
    assert path.outcome == "reached"

    # 9. Look at it: the circuit with the voltages on its nodes; beside it the same voltages as a landscape, and the
    #    path downhill.
    folder.mkdir(parents=True, exist_ok=True)
    rg.save_figure(draw(point, field, path), folder / "lesson.png")

    # 10. Do not take our word for it: this deck runs in any SPICE.
    rg.write_spice(netlist, folder / "lesson.cir")
    print(f"the figure and the deck are in {folder}")
    return {"above_goal": above_goal, "into_goal": into_goal, "length": path.length}


def draw(point: rg.OperatingPoint, field: rg.Field, path: rg.Streamline) -> object:
    from resgrid.plot import new_figure

    figure = new_figure(12.0, 7.6)
    grid = figure.add_gridspec(2, 2, width_ratios=[2.1, 1.0])
    circuit = figure.add_subplot(grid[:, 0])
    picture, arrows = (figure.add_subplot(grid[row, 1]) for row in range(2))
    rg.draw(point, circuit)
    circuit.set_title("The circuit: one node a cell, one resistor between neighbours", fontsize=10)
    rg.draw(field, picture, scale="linear")
    rg.draw(path, picture)
    picture.set_title("Its voltages, and the path", fontsize=10)
    rg.draw(field, arrows, quantity="currents")
    arrows.set_title("Its currents", fontsize=10)
    return figure


if __name__ == "__main__":
    main()
