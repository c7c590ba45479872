import numpy as np
import pytest
from matplotlib.collections import LineCollection

from resgrid.compiler import compile_space
from resgrid.errors import InputError
from resgrid.netlist import Netlist
from resgrid.nodal.solve import solve
from resgrid.plot import plot_circuit, plot_scene_page, render_figure
from resgrid.plot.schematic import HALF, MARGIN, schematic_of
from resgrid.plot.symbols import engineering, zigzag
from resgrid.plot.voltages import voltage_texts
from resgrid.space import Axis, Cell, ConfigurationSpace


def space_of(cell, periodic: bool = False) -> ConfigurationSpace:
    cell = np.asarray(cell)
    axes = [Axis("xy"[a], 0.0, float(n), n, periodic=periodic and a == 0) for a, n in enumerate(cell.shape)]
    return ConfigurationSpace(axes, cell)


def zigzags(axes) -> np.ndarray:
    return np.array(next(c for c in axes.collections if isinstance(c, LineCollection)).get_segments())


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
        {"boundary": "neumann", "drive": "start", "start": (0, 0)},
    ],
)
@pytest.mark.parametrize("periodic", [False, True])
def test_every_resistor_is_drawn_once_between_its_nodes(options: dict, periodic: bool) -> None:
    space = space_of(SMALL, periodic)
    netlist = compile_space(space, **options)
    axes = plot_circuit(netlist, solve(netlist))
    drawn = zigzags(axes)
    assert len(drawn) == len(netlist.conductance)
    plan = schematic_of(netlist.cells)
    cell_of = netlist.cell_of_node()
    for number, (a, b) in enumerate(netlist.resistor_nodes.tolist()):
        for node in (a, b):
            cell = cell_of[node]
            if cell < 0 or plan.seam[number]:
                continue
            centre = np.array(np.unravel_index(cell, space.shape)) + 0.5
            gap = 0.0 if space.cell.ravel()[cell] == Cell.FREE else HALF
            nearest = min(np.abs(drawn[number, end] - centre).sum() for end in (0, -1))
            assert nearest == pytest.approx(gap)
    assert len({tuple(np.round(line.mean(axis=0), 6)) for line in drawn}) == len(drawn)


def test_voltages_and_names_are_written_beside_their_nodes() -> None:
    netlist = compile_space(space_of(SMALL))
    point = solve(netlist)
    axes = plot_circuit(netlist, point)
    node = int(netlist.cells.node[2, 0])
    places = {text.get_text(): text.get_position() for text in axes.texts}
    assert np.allclose(places["n_2_0"], (2.5, 0.5), atol=0.2)
    volts = [text for text in axes.texts if text.get_gid() == "volts"]
    assert len(volts) == len(netlist.cells.free_node)
    mine = min(volts, key=lambda text: np.hypot(text.get_position()[0] - 2.5, text.get_position()[1] - 0.5))
    assert float(mine.get_text()) == pytest.approx(point.voltage[node], abs=5e-5)
    assert any(text.startswith("obstacle\n1 V\ngives") for text in texts(axes))
    assert any(text.startswith("goal_0\n0 V\ntakes") for text in texts(axes))


def test_no_two_texts_overlap() -> None:
    """The largest circuit that is drawn."""
    cell = np.zeros((10, 10), dtype=int)
    cell[3, 2:8], cell[7, 7] = Cell.OBSTACLE, Cell.GOAL
    netlist = compile_space(space_of(cell))
    axes = plot_circuit(netlist, solve(netlist))
    figure = axes.figure
    figure.canvas.draw()
    boxes = [text.get_window_extent() for text in axes.texts if text.get_text() not in "+\N{MINUS SIGN}"]
    overlaps = [(i, j) for i, a in enumerate(boxes) for j, b in enumerate(boxes[:i]) if a.overlaps(b)]
    assert not overlaps
    assert all(box.x0 >= 0 and box.x1 <= figure.bbox.width for box in boxes)


def test_a_circuit_without_an_operating_point_has_names_only() -> None:
    axes = plot_circuit(compile_space(space_of(SMALL)))
    assert "n_0_0" in texts(axes)
    assert not any(text.get_text() for text in axes.texts if text.get_gid() == "volts")


def test_uniform_drive_is_drawn_as_arrows() -> None:
    netlist = compile_space(space_of(SMALL), boundary="neumann")
    axes = plot_circuit(netlist, solve(netlist))
    arrows = [text for text in axes.texts if getattr(text, "arrow_patch", None) is not None]
    assert len(arrows) == len(netlist.current_amps)
    tips = {tuple(np.round(np.asarray(arrow.xy) + 0.05 - 0.5, 6)) for arrow in arrows}
    assert tips == {tuple(map(float, cell)) for cell in np.argwhere(np.array(SMALL) == 0)}


def test_the_rail_is_drawn_around_an_obstacle_edge_only() -> None:
    closed, opened = (schematic_of(compile_space(space_of(SMALL), edge=edge).cells) for edge in ("obstacle", "open"))
    assert len(closed.frame) == 4
    assert not opened.frame
    ring = schematic_of(compile_space(space_of(SMALL, periodic=True)).cells)
    assert len(ring.frame) == 2
    assert ring.seam.sum() == 3
    assert closed.start.min() == pytest.approx(-MARGIN) or closed.end.min() == pytest.approx(-MARGIN)


def test_one_axis_is_drawn_in_a_row() -> None:
    netlist = compile_space(space_of([0, 0, 1, 0, 2]))
    assert len(zigzags(plot_circuit(netlist, solve(netlist)))) == len(netlist.conductance)


def test_large_and_deep_circuits_are_refused() -> None:
    cell = np.zeros((11, 3), dtype=int)
    cell[0, 0] = Cell.GOAL
    with pytest.raises(InputError, match=r"11 x 3 cells cannot be read; at most 10 a side .*plot_potential"):
        plot_circuit(compile_space(space_of(cell)))
    cube = ConfigurationSpace([Axis(n, 0, 2, 2) for n in "xyz"], [[[0, 0], [0, 0]], [[0, 0], [0, 2]]])
    with pytest.raises(InputError, match="plot_slices"):
        plot_circuit(compile_space(cube))
    chain = [[i, i + 1] for i in range(49)]
    with pytest.raises(InputError, match="50 nodes cannot be read; at most 40"):
        plot_circuit(Netlist(50, np.array(chain), np.ones(49)))
    netlist = compile_space(space_of(SMALL))
    with pytest.raises(InputError, match="another netlist"):
        plot_circuit(netlist, solve(compile_space(space_of(cell))))


def test_a_netlist_without_a_layout_is_placed_by_its_graph() -> None:
    netlist = Netlist(
        5,
        [[1, 2], [2, 3], [2, 3], [3, 4], [4, 0], [1, 4]],
        [1e-3, 1e-4, 2e-4, 1e-3, 1e-3, 5e-4],
        [[1, 0]], [5.0], [[0, 3]], [1e-3], [[2, 4]], [1e-7],
    )  # fmt: skip
    axes = plot_circuit(netlist, solve(netlist))
    assert len(zigzags(axes)) == 6
    assert {"5 V", "1 mA", "100 nF", "10 kΩ"} <= set(texts(axes))
    assert any(text.startswith("node_1\n5.0000 V") for text in texts(axes))
    assert render_figure(axes.figure, "png") == render_figure(plot_circuit(netlist, solve(netlist)).figure, "png")


def test_zigzags_start_and_end_where_they_should() -> None:
    start, end = np.array([[0.0, 0.0], [1.0, 1.0]]), np.array([[1.0, 0.0], [1.0, 3.0]])
    lines = zigzag(start, end)
    assert np.array_equal(lines[:, 0], start)
    assert np.array_equal(lines[:, -1], end)
    assert np.abs(lines[0, :, 1]).max() == pytest.approx(0.08)
    assert ((lines[0, 1:, 1] * lines[0, :-1, 1]) < 0).sum() == 5


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
    netlist = compile_space(space_of([0, 2, 0]), supply=largest)
    assert voltage_texts(solve(netlist), np.array([netlist.cells.obstacle_node])) == ([text], unit)


def test_engineering_prefixes() -> None:
    assert engineering(38.123e-6, "A") == "38.1 µA"
    assert engineering(1e4, "Ω") == "10 kΩ"
    assert engineering(0.0, "V") == "0 V"


def test_a_scene_page_of_a_small_scene_has_no_overlapping_text(field) -> None:
    figure = plot_scene_page(field, title="A title")
    figure.canvas.draw()
    titles = [axes.title.get_window_extent() for axes in figure.axes[:2]]
    assert not titles[0].overlaps(titles[1])
    assert not figure._suptitle.get_window_extent().overlaps(titles[0])


def test_a_real_chip_is_drawn_without_what_is_not_on_its_grid() -> None:
    from resgrid.chip.studies import study
    from resgrid.scene import Chip

    chip = study(space_of(SMALL), Chip(goal_switch_on=50.0, rail_resistance=1.0)).netlist
    notes = [text.get_text() for text in plot_circuit(chip, solve(chip)).get_legend().get_texts()]
    hidden = int((chip.cells.resistor_face < 0).sum())
    assert f"resistor, 10 kΩ; not drawn: {hidden} of switches, rails, loads" in notes
    with pytest.raises(InputError, match="nonlinear resistors is not drawn"):
        plot_circuit(study(space_of(SMALL), Chip(saturation_voltage=0.1)).netlist)
