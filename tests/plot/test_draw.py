"""`rg.draw` for every type: data, labels, legible text and reproducible bytes; registration, options and notebooks.

Tests internals: `resgrid.plot`, `resgrid.plot.figures`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from support.dynamics import small_scene
from support.spaces import space_of

import resgrid as rg
from resgrid.plot import pictures
from resgrid.plot.figures import figure_of, render_figure

CHIP = rg.Chip(mismatch=0.05, goal_switch_on=200.0, readout=rg.chip.Readout(bits=7))


def small_space() -> rg.ConfigurationSpace:
    cell = np.zeros((7, 6), dtype=np.uint8)
    cell[2:5, 3], cell[1, 1] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    return space_of(cell)


@cache
def small_op() -> rg.OperatingPoint:
    return rg.solve(small_scene())


@cache
def small_planner() -> rg.planning.Planner:
    return rg.plan(small_space(), k=0.5)


def chip_result(what: str) -> Any:
    netlist = rg.chip.build_chip(rg.study(small_space(), CHIP).ideal, CHIP)
    match what:
        case "yield":
            return rg.study(small_space(), CHIP).yields(trials=8, batch=8)
        case "faults":
            return rg.study(netlist).faults(readout=rg.chip.Readout(bits=7), seconds=5.0)
    return rg.study(small_space(), CHIP).sweep(("mismatch", [0.0, 0.1]), ("readout.bits", [4, 8]), trials=2)


def paths() -> list[rg.Streamline]:
    return [small_planner().path(start) for start in ((0.5, 5.5), (6.5, 4.5))]


def lattice_path(lattice: Any) -> rg.planning.NodePath:
    return rg.plan(small_space(), lattice=lattice).path((6.5, 4.5))


def trajectory() -> Any:
    return rg.time_parameterize(paths()[0], velocity_limits=1.0, acceleration_limits=2.0)


ALBUM: dict[str, Callable[[rg.control.Run], Any]] = {
    "scene": lambda run: rg.draw(run.scene),
    "space": lambda _: rg.draw(small_space()),
    "potential": lambda _: rg.draw(small_planner().field),
    "currents": lambda _: rg.draw(small_planner().field, quantity="currents"),
    "paths": lambda _: rg.draw(paths(), k=[0.5, 0.5]),
    "page": lambda _: rg.plot.draw_summary(small_planner().field, paths(), title="Page"),
    "netlist": lambda _: rg.draw(rg.compile_space(small_space())),
    "hexagonal lattice": lambda _: rg.draw(lattice_path("hexagonal").field),
    "lattice with diagonals": lambda _: rg.draw(rg.compile_space(small_space(), lattice="square8")),
    "node path": lambda _: rg.draw(lattice_path("square8")),
    "page of a lattice": lambda _: rg.plot.draw_summary(lattice_path("hexagonal").field, [lattice_path("hexagonal")]),
    "circuit": lambda _: rg.draw(rg.solve(rg.compile_space(small_space(), boundary="neumann"))),
    "trajectory": lambda _: rg.draw(trajectory()),
    "speed": lambda _: rg.draw(trajectory(), quantity="speed"),
    "separation": lambda _: rg.draw(rg.find_blocking_obstacles(small_space(), (6.5, 0.5))),
    "clearance": lambda _: rg.draw(rg.planning.clearance_curve(small_planner(), (0.0, 1.0), [(0.5, 5.5)]), unit="m"),
    "share": lambda _: rg.plot.draw_dirichlet_fraction(small_planner().obstacle_field, small_planner().open_field, 0.5),
    "velocities": lambda _: rg.plot.draw_velocities(small_planner().field, (5.2, 4.8), (0.3, 1.0), 0.1),
    "run": lambda run: rg.draw(run, title="Run", caption="Two\nlines"),
    "runs": lambda run: rg.draw([run, run]),
    "robot": lambda run: rg.plot.draw_robot(run.configuration, run.scene),
    "wavefront": lambda run: rg.draw(
        rg.control.wavefront(rg.simulation(run.scene, announce=True, pace=2.0), np.array([0.0, 5.0]))
    ),
    "settling": lambda _: rg.draw(rg.study(small_scene()).settling(bits=8)),
    "settling curve": lambda _: rg.draw(rg.study(small_scene()).settling(bits=8), quantity="curve"),
    "noise": lambda _: rg.draw(rg.study(small_scene()).noise(band=(0.0, 1e6))),
    "power": lambda _: rg.draw(rg.study(small_op()).power()),
    "adc_resolution": lambda _: rg.draw(rg.study(small_op()).adc_resolution()),
    "precisions": lambda _: rg.draw({"Dirichlet": rg.study(small_op()).adc_resolution()}, title="Precision"),
    "sensitivity": lambda _: rg.draw(rg.study(small_op()).sensitivity((5, 5)), drift=0.8),
    "yield": lambda _: rg.draw(chip_result("yield")),
    "faults": lambda _: rg.draw(chip_result("faults"), fault="short"),
    "sweep": lambda _: rg.draw(chip_result("sweep"), share=0.9),
}


@pytest.mark.parametrize("name", ALBUM)
@pytest.mark.quick_cases(10)
def test_every_picture_has_data_labels_legible_text_and_reproducible_bytes(name: str, run: rg.control.Run) -> None:
    first, second = (figure_of(ALBUM[name](run)) for _ in range(2))
    assert render_figure(first, "png", dpi=60) == render_figure(second, "png", dpi=60)
    drawn = [axes for axes in first.findobj(Axes) if axes.axison]
    assert drawn or first.axes[0].lines  # a circuit has no axes
    for axes in drawn:
        assert axes.has_data()
        assert axes.get_xlabel() or axes.get_ylabel() or axes in first.axes[0].child_axes or axes.get_title()
    sizes = [text.get_fontsize() for text in first.findobj(Text) if text.get_text() and text.get_visible()]
    assert min(sizes) >= 7


def test_a_registered_picture_without_a_default_ax_gets_the_axes_of_a_new_figure() -> None:
    class Level(float):
        pass

    @rg.draw.register(Level)
    def draw_level(level: Level, ax: Axes) -> Axes:
        ax.axhline(level)
        return ax

    given = Figure().add_subplot()
    assert rg.draw(Level(1.0), given) is given
    assert len(rg.draw(Level(1.0)).lines) == 1


def test_draw_register_adds_pictures_of_a_type_and_its_subclasses() -> None:
    class Reading:
        value = 3.0

    class FineReading(Reading):
        value = 3.14

    @rg.draw.register(Reading)
    def draw_reading(reading: Reading, ax: Axes | None = None, *, colour: str = "black") -> Axes:
        axes = Figure().add_subplot() if ax is None else ax
        axes.plot([0, reading.value], color=colour)
        return axes

    @rg.draw.register(Reading, several=True)
    def draw_readings(readings: list[Reading]) -> Figure:
        figure = Figure()
        figure.suptitle(f"{len(readings)} readings")
        return figure

    axes = rg.draw(FineReading(), colour="red")
    assert axes.lines[0].get_color() == "red"
    assert rg.draw(Reading(), axes) is axes
    assert rg.draw([Reading(), FineReading()]).get_suptitle() == "2 readings"
    with pytest.raises(rg.InputError, match="size is not an option of a picture of a FineReading; it takes colour"):
        rg.draw(FineReading(), size=3)
    with pytest.raises(rg.InputError, match="omit ax"):
        rg.draw([Reading()], axes)


@pytest.mark.parametrize("table", [pictures.PICTURES, pictures.PICTURES_OF_SEVERAL, pictures.SHOWN_PARTS])
def test_tables_of_pictures_name_existing_types_and_functions(table: dict[str, Any]) -> None:
    for kind, picture in table.items():
        module, name = kind.split(":")
        assert isinstance(getattr(import_module(module), name), type)
        if isinstance(picture, str):
            module, name = picture.split(":")
            assert callable(getattr(import_module(f"resgrid.plot.{module}"), name))


def test_a_registered_picture_takes_precedence_over_a_built_in_one(monkeypatch) -> None:
    class Wall(rg.ConfigurationSpace):
        pass

    @rg.draw.register(Wall)
    def draw_wall(wall: Wall, ax: Axes | None = None) -> Axes:
        axes = Figure().add_subplot() if ax is None else ax
        axes.set_title("wall")
        return axes

    space = small_space()
    assert rg.draw(Wall(space.axes, space.cell)).get_title() == "wall"
    assert rg.draw(space).get_title() == ""


def test_types_without_a_picture_and_unknown_options_raise_input_error(run: rg.control.Run, space, field, cube) -> None:
    with pytest.raises(rg.InputError, match=r"a dict has no picture; there are pictures of .*Field"):
        rg.draw({})
    with pytest.raises(rg.InputError, match=r"colour is not an option of a picture of a ConfigurationSpace; .*virtual"):
        rg.draw(space, colour="red")
    with pytest.raises(rg.InputError, match="contours = 3 must be True or False"):
        rg.draw(field, contours=3)
    for value in (run, cube):
        with pytest.raises(rg.InputError, match="omit ax"):
            rg.draw(value, rg.draw(space))
    with pytest.raises(rg.InputError, match="indices of slices need the axis that is normal"):
        rg.draw(cube.space, indices=[0])


def test_decks_planners_and_studies_are_drawn_as_their_main_part(tmp_path) -> None:
    (tmp_path / "a.cir").write_text("* divider\nv1 a 0 5\nr1 a b 1k\nr2 b 0 1k\n.end\n")
    deck = rg.draw(rg.read_spice(tmp_path / "a.cir"))
    assert {"5 V", "1 kΩ"} <= {text.get_text() for text in deck.texts}
    for whole, part in ((small_planner(), small_planner().field), (rg.study(small_op()), small_op())):
        assert render_figure(rg.draw(whole), "png") == render_figure(rg.draw(part), "png")


def test_a_trajectory_is_drawn_as_speed_and_position_with_units() -> None:
    timed = trajectory()
    figure = rg.draw(timed)
    speed, position = figure.axes
    assert speed.get_ylabel() == "speed (m/s)" and position.get_ylabel() == "position (m)"
    assert position.get_xlabel() == "time (s)" and len(position.lines) == 2
    times, values = speed.lines[0].get_data()
    assert times[-1] == timed.duration and max(values) == pytest.approx(1.0) and values[0] == values[-1] == 0.0
    ax = Figure().add_subplot()
    assert rg.draw(timed, ax) is ax and ax.get_ylabel() == "speed (m/s)"
    with pytest.raises(rg.InputError, match="several panels"):
        rg.draw(timed, ax, quantity="page")


def test_axes_of_different_units_have_separate_panels() -> None:
    space = space_of(np.array([[0, 0, 2]] * 3))
    mixed = rg.ConfigurationSpace([space.axes[0], rg.Axis("theta", 0, 3, 3, unit="rad")], space.cell)
    timed = rg.time_parameterize(rg.Polyline([(0.5, 0.5), (2.5, 1.5)], mixed), velocity_limits=[1.0, 2.0])
    labels = [axes.get_ylabel() for axes in rg.draw(timed).axes]
    assert labels[0] == "velocity of x (m/s)" and labels[1].endswith("(rad/s)")
    assert labels[2:] == ["position (m)", "position (rad)"]
    with pytest.raises(rg.InputError, match="different units"):
        rg.draw(timed, Figure().add_subplot())


def spaces_of_one_and_three_axes() -> dict[int, rg.ConfigurationSpace]:
    rod, cube = np.zeros(8, np.uint8), np.zeros((6, 5, 4), np.uint8)
    rod[[2, 5, 7]] = rg.Cell.GOAL, rg.Cell.OBSTACLE, rg.Cell.OBSTACLE
    cube[3, :, :2], cube[5, 4, 3] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    grading = np.full(cube.shape, 2.0)
    return {1: space_of(rod, conductivity=np.arange(1.0, 9.0)), 3: space_of(cube, conductivity=grading)}


@pytest.mark.parametrize("ndim", [1, 3])
def test_spaces_paths_and_blocking_obstacles_of_1_and_3_axes_are_drawn(ndim: int) -> None:
    space = spaces_of_one_and_three_axes()[ndim]
    path = rg.plan(space).path((0.5,) * ndim)
    walled = space_of(np.where(np.arange(space.shape[0]).reshape(-1, *(1,) * (ndim - 1)) == 1, 1, space.cell))
    verdict = rg.find_blocking_obstacles(walled, (0.5,) * ndim)
    separated = (verdict, "to be removed for a path to a goal")
    for value, what in [(space, "goal"), (path, "path"), separated, (rg.shortcut(path), "path")]:
        figure = figure_of(rg.draw(value))
        panels = [axes for axes in figure.axes if axes.get_xlabel()]
        assert len(panels) == ndim
        labels = {label for axes in panels for label in axes.get_legend_handles_labels()[1]}
        assert any(label.startswith(what) for label in labels)
        if ndim == 3:
            assert "path in the slice" in labels or what != "path"
            one = figure_of(rg.draw(value, axis=0, indices=[4, 5]))
            assert [axes.get_title() for axes in one.axes if axes.get_title()] == [
                "x = 4.5 m",
                "x = 5.5 m (through a goal)",
            ]
            with pytest.raises(rg.InputError, match="omit ax"):
                rg.draw(value, panels[0])


def test_labels_of_slices_name_the_axes_of_a_turned_map() -> None:
    space = spaces_of_one_and_three_axes()[3]
    turned = rg.ConfigurationSpace(space.axes, space.cell, frame=rg.Frame(1.0, 2.0, 0.3, turning_length=1.0))
    first, own = figure_of(rg.draw(turned)).axes[0], figure_of(rg.draw(space)).axes[0]
    assert (first.get_xlabel(), first.get_ylabel()) == ("x of the map (m)", "y of the map (m)")
    assert first.get_title() == "z of the map = 3.5 m (through a goal)"
    assert (own.get_xlabel(), own.get_title()) == ("x (m)", "z = 3.5 m (through a goal)")


def test_draw_uses_and_returns_the_given_axes(field: rg.Field) -> None:
    axes = rg.draw(field.space)
    assert rg.draw(field, axes) is axes
    assert [text.get_text() for text in axes.get_legend().get_texts()].count("obstacle") == 1


@pytest.mark.slow
def test_png_representations_equal_the_rendered_figure(field: rg.Field, cube: rg.Field) -> None:
    for draw in (lambda: rg.draw(field), lambda: rg.draw(field).figure, lambda: rg.draw(cube)):
        assert draw()._repr_png_() == render_figure(draw(), "png", dpi=100)


@pytest.mark.slow
def test_central_types_have_a_one_line_repr_and_an_html_picture(run: rg.control.Run, field: rg.Field) -> None:
    op = rg.solve(rg.compile_space(small_space()))
    pictured = (run.scene, field.space, field, op, small_op(), run, rg.study(small_op()).power())
    for value in (*pictured, op.netlist, op.netlist.cells, rg.streamline(field, cell=(0, 4)), run.contacts):
        text = repr(value)
        assert "\n" not in text
        assert "array" not in text
        assert len(text) < 500
    for value in pictured:
        text = value._repr_html_()
        assert '<img src="data:image/png;base64,' in text and type(value).__name__ in text
    solid = rg.Scene(tuple(rg.Axis(name, 0, 3, 3) for name in "xyz"), obstacles=(rg.Ball((1.0, 1.0, 1.0), 0.4),))
    assert '<img src="data:image/png;base64,' in solid._repr_html_()
    assert render_figure(rg.draw(solid), "png") == render_figure(
        rg.draw(rg.build_space(solid, require_goal=False)), "png"
    )
    deep = space_of(np.ones((3, 3, 3, 3), int))
    assert "<img" in deep._repr_html_()
    assert repr(field.space).startswith(
        "<ConfigurationSpace of 7 x 5 cells, x 1 to 4.5 m, y -1 to 0.25 m: 11 obstacle, 1"
    )
    with pytest.raises(ValueError, match="read-only"):
        field.potential[0, 0] = 3.0
