"""Drawings of circuits, compared with the netlist: elements, positions, values, and texts without overlaps.

Tests internals: `resgrid.plot.circuits`.
"""

import networkx as nx
import numpy as np
import pytest
from support.spaces import space_of

import resgrid as rg
from resgrid.plot.circuits import HALF, rail_areas, resistor_ends, voltage_texts


def drawn_resistors(axes) -> list[np.ndarray]:
    """Both ends and the middle of every zigzag, shape (3, 2)."""
    paths = [np.asarray(line.get_xydata()) for line in axes.lines]
    zigzags = [path for path in paths if len(path) == 10 and np.isfinite(path).all()]
    return [np.stack([path[0], path.mean(axis=0), path[-1]]) for path in zigzags]


def texts(axes) -> list[str]:
    return [text.get_text() for text in axes.texts]


SMALL = [[0, 0, 0], [0, 1, 0], [0, 0, 1], [0, 2, 0]]


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"edge": "open"},
        {"rails": "cells"},
        {"boundary": "wall", "wall_resistance": 5e4},
        {"boundary": "neumann"},
        {"boundary": "neumann", "rails": "cells"},
        {"boundary": "neumann", "drive": "start", "start": (0, 0)},
    ],
)
@pytest.mark.parametrize("periodic", [False, True])
def test_every_resistor_is_drawn_once_between_its_nodes(options: dict, periodic: bool) -> None:
    space = space_of(SMALL, periodic=(periodic, False))
    netlist = rg.compile_space(space, **options)
    drawn = drawn_resistors(rg.draw(rg.solve(netlist)))
    assert len(drawn) == len(netlist.conductance)
    *_, seam = resistor_ends(netlist.cells)
    cell_of = netlist.cell_of_node()
    ends = np.array([resistor[[0, -1]] for resistor in drawn])
    for number, (a, b) in enumerate(netlist.resistor_nodes.tolist()):
        for node in (a, b):
            cell = cell_of[node]
            if cell < 0 or seam[number]:
                continue
            centre = np.array(np.unravel_index(cell, space.shape)) + 0.5
            gap = 0.0 if space.cell.ravel()[cell] == rg.Cell.FREE else HALF
            assert np.abs(ends[number] - centre).sum(axis=1).min() == pytest.approx(gap)
    assert len({tuple(np.round(middle, 6)) for _, middle, _ in drawn}) == len(drawn)


def test_voltages_and_names_are_written_next_to_their_nodes() -> None:
    netlist = rg.compile_space(space_of(SMALL))
    point = rg.solve(netlist)
    axes = rg.draw(point)
    node = int(netlist.cells.node[2, 0])
    places = {text.get_text(): text.get_position() for text in axes.texts}
    assert np.allclose(places["n_2_0"], (2.5, 0.5), atol=0.2)
    volts = [text for text in axes.texts if text.get_gid() == "volts"]
    assert len(volts) == len(netlist.cells.free_node)
    mine = min(volts, key=lambda text: np.hypot(text.get_position()[0] - 2.5, text.get_position()[1] - 0.5))
    assert float(mine.get_text()) == pytest.approx(point.voltage[node], abs=5e-5)
    assert any(text.startswith("obstacle\n1 V\ngives") for text in texts(axes))
    assert any(text.startswith("goal_0\n0 V\ntakes") for text in texts(axes))


def test_texts_of_the_largest_circuit_do_not_overlap() -> None:
    """The grid has the largest size that `rg.draw` accepts."""
    cell = np.zeros((10, 10), dtype=int)
    cell[3, 2:8], cell[7, 7] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    netlist = rg.compile_space(space_of(cell))
    axes = rg.draw(rg.solve(netlist))
    figure = axes.figure
    figure.canvas.draw()
    boxes = [text.get_window_extent() for text in axes.texts if text.get_text() not in "+\N{MINUS SIGN}"]
    overlaps = [(i, j) for i, a in enumerate(boxes) for j, b in enumerate(boxes[:i]) if a.overlaps(b)]
    assert not overlaps
    assert all(box.x0 >= 0 and box.x1 <= figure.bbox.width for box in boxes)


def test_a_netlist_is_drawn_with_names_but_without_voltages() -> None:
    axes = rg.draw(rg.compile_space(space_of(SMALL)))
    assert "n_0_0" in texts(axes)
    assert not any(text.get_text() for text in axes.texts if text.get_gid() == "volts")


def test_every_source_of_a_uniform_drive_is_drawn_as_an_arrow() -> None:
    netlist = rg.compile_space(space_of(SMALL), boundary="neumann")
    axes = rg.draw(rg.solve(netlist))
    arrows = [text for text in axes.texts if getattr(text, "arrow_patch", None) is not None]
    assert len(arrows) == len(netlist.current_amps)
    tips = {tuple(np.round(np.asarray(arrow.xy) + 0.05 - 0.5, 6)) for arrow in arrows}
    assert tips == {tuple(map(float, cell)) for cell in np.argwhere(np.array(SMALL) == 0)}


def test_the_obstacle_rail_is_drawn_around_obstacle_edges_only() -> None:
    for edge, bounds in (("obstacle", (-HALF, -HALF, 4 + HALF, 3 + HALF)), ("open", (1.2, 1.2, 2.8, 2.8))):
        rail, *_ = rail_areas(rg.compile_space(space_of(SMALL), edge=edge).cells)
        assert rail.bounds == pytest.approx(bounds)
    ring = rg.compile_space(space_of(SMALL, periodic=(True, False))).cells
    assert rail_areas(ring)[0].bounds == pytest.approx((0.2, -HALF, 3.8, 3 + HALF))
    assert resistor_ends(ring)[3].sum() == 3


def test_one_axis_is_drawn_in_a_row() -> None:
    netlist = rg.compile_space(space_of([0, 0, 1, 0, 2]))
    assert len(drawn_resistors(rg.draw(netlist))) == len(netlist.conductance)


def test_large_circuits_and_those_of_three_axes_raise_input_error() -> None:
    cell = np.zeros((11, 3), dtype=int)
    cell[0, 0] = rg.Cell.GOAL
    with pytest.raises(rg.InputError, match=r"11 x 3 cells is not legible; at most 10 per axis"):
        rg.draw(rg.compile_space(space_of(cell)))
    cube = space_of([[[0, 0], [0, 0]], [[0, 0], [0, 2]]])
    with pytest.raises(rg.InputError, match="one or two axes"):
        rg.draw(rg.compile_space(cube))
    chain = [[i, i + 1] for i in range(49)]
    with pytest.raises(rg.InputError, match="50 nodes is not legible; at most 40"):
        rg.draw(rg.Netlist(50, np.array(chain), np.ones(49)))
    netlist = rg.compile_space(space_of(SMALL))
    with pytest.raises(rg.InputError, match="another netlist"):
        rg.draw(netlist, op=rg.solve(rg.compile_space(space_of(cell))))


def test_a_netlist_without_cells_is_drawn_with_a_graph_layout() -> None:
    netlist = rg.Netlist(
        5,
        [[1, 2], [2, 3], [2, 3], [3, 4], [4, 0], [1, 4]],
        [1e-3, 1e-4, 2e-4, 1e-3, 1e-3, 5e-4],
        [[1, 0]], [5.0], [[0, 3]], [1e-3], [[2, 4]], [1e-7],
    )  # fmt: skip
    axes = rg.draw(rg.solve(netlist))
    assert len(drawn_resistors(axes)) == 6
    assert {"5 V", "1 mA", "100 nF", "10 kΩ"} <= set(texts(axes))
    assert any(text.startswith("node_1\n5.0000 V") for text in texts(axes))


BRIDGE = [[1, 2], [1, 3], [2, 3], [2, 0], [3, 0]]
LADDER = [[1, 2], [2, 3], [3, 4], [4, 5], [1, 0], [2, 0], [3, 0], [4, 0], [5, 0], [5, 0]]
STAR = [[1, 2], [1, 3], [1, 4], [1, 5], [1, 6], [1, 7], [2, 0]]
RING = [[1, 2], [2, 3], [3, 4], [4, 5], [5, 6], [6, 7], [7, 8], [8, 1]]
RANDOM = [[1, 2], [1, 3], [2, 4], [4, 5], [5, 6], [3, 7], [2, 8], [7, 9], [7, 9], [7, 10], [3, 10], [3, 11], [9, 12],
          [1, 9], [9, 10], [4, 0]]  # fmt: skip


@pytest.mark.parametrize(
    ("resistors", "sources", "currents", "capacitors"),
    [
        (BRIDGE, [[1, 0]], [[2, 3]], [[3, 0]]),
        (LADDER, [[1, 0]], [], []),
        (STAR, [[3, 0]], [], []),
        (RING, [[1, 0], [5, 0]], [], []),
        ([[1, 2], [2, 0]], [[1, 2]], [[1, 2]], [[1, 2]]),
        ([[1, 0], [2, 0]], [[1, 0]], [[2, 0]], []),
        (RANDOM, [[1, 0]], [[9, 0]], [[4, 0]]),
    ],
    ids=["bridge", "ladder", "star", "ring", "parallel", "apart", "random"],
)
def test_texts_and_symbols_of_a_graph_layout_do_not_overlap(resistors, sources, currents, capacitors) -> None:
    elements = []
    for nodes, value in ((resistors, 1e-3), (sources, 5.0), (currents, 1e-3), (capacitors, 1e-7)):
        elements += [np.array(nodes, dtype=int).reshape(-1, 2), np.full(len(nodes), value)]
    axes = rg.draw(rg.solve(rg.Netlist(int(np.max(resistors)) + 1, *elements)))
    axes.figure.canvas.draw()
    written = [text for text in axes.texts if text.get_text() not in "+\N{MINUS SIGN}"]
    boxes = [text.get_window_extent() for text in written]
    assert not [(i, j) for i, a in enumerate(boxes) for j, b in enumerate(boxes[:i]) if a.overlaps(b)]
    for line in axes.lines:
        path = line.get_path().transformed(axes.transData).interpolated(20)
        crossed = [t.get_text() for t, box in zip(written, boxes, strict=True) if box.count_contains(path.vertices)]
        assert not crossed
    circles = [np.array(patch.center) for patch in axes.patches if hasattr(patch, "radius")]
    assert len(circles) == len(sources) + len(currents)
    centres = np.array([*circles, *(middle for _, middle, _ in drawn_resistors(axes))])
    distance = np.linalg.norm(centres[:, None] - centres, axis=2) + np.eye(len(centres))
    assert distance.min() > 0.3


@pytest.mark.parametrize(
    ("largest", "text", "unit"),
    [
        (1.0, "1.0000", "V"),
        (3.3e-3, "3.3000", "mV"),
        (12.0, "12.000", "V"),
        (0.8, "0.8000", "V"),
        (2e4, "20.000", "kV"),
        (-5.0, "-5.0000", "V"),
    ],
)
def test_voltages_have_a_fitting_unit(largest: float, text: str, unit: str) -> None:
    netlist = rg.compile_space(space_of([0, 2, 0]), supply=largest)
    assert voltage_texts(rg.solve(netlist), np.array([netlist.cells.obstacle_node])) == ([text], unit)


def test_the_legend_of_a_chip_counts_resistors_outside_the_grid() -> None:
    chip = rg.study(space_of(SMALL), rg.Chip(goal_switch_on=50.0, rail_resistance=1.0)).netlist
    notes = [text.get_text() for text in rg.draw(rg.solve(chip)).get_legend().get_texts()]
    hidden = int((chip.cells.resistor_face < 0).sum())
    assert f"resistor, 10 kΩ; not drawn: {hidden} of switches, rails, loads" in notes
    with pytest.raises(rg.InputError, match="no symbol for nonlinear resistors"):
        rg.draw(rg.study(space_of(SMALL), rg.Chip(saturation_voltage=0.1)).netlist)


def test_elements_with_both_terminals_on_one_node_are_drawn() -> None:
    graph = nx.MultiGraph()
    for first, second, kind, values in (
        (1, 0, "voltage source", {"volts": 5.0}), (1, 2, "resistor", {"conductance": 1e-3}),
        (2, 0, "resistor", {"conductance": 1e-3}), (2, 2, "resistor", {"conductance": 1e-4}),
        (1, 1, "resistor", {"conductance": 2e-4}), (1, 1, "capacitor", {"capacitance": 1e-9}),
    ):  # fmt: skip
        graph.add_edge(first, second, kind=kind, nodes=[first, second], **values)
    netlist = rg.Netlist.from_networkx(graph)
    for value in (netlist, rg.solve(netlist)):
        axes = rg.draw(value)
        assert len(drawn_resistors(axes)) == 4
        assert {"5 V", "1 kΩ", "10 kΩ", "5 kΩ", "1 nF"} <= set(texts(axes))
    alone = nx.MultiGraph()
    alone.add_edge(1, 1, kind="resistor", nodes=[1, 1], conductance=1e-3)
    assert len(drawn_resistors(rg.draw(rg.Netlist.from_networkx(alone)))) == 1
