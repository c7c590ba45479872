"""Pictures of spaces and fields, compared with their arrays: pixels, colours, contours, arrows, slices.

Tests internals: `resgrid._internal.colours`, `resgrid.plot.fields`, `resgrid.plot.plane`, `resgrid.plot.shading`.
"""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.colors import to_hex, to_rgb
from matplotlib.contour import ContourSet
from matplotlib.quiver import Quiver
from support.spaces import space_of

import resgrid as rg
from resgrid._internal.colours import GOAL, HEIGHT
from resgrid.plot.fields import current_arrows, nearest_to_middles
from resgrid.plot.plane import block_colours, block_means
from resgrid.plot.shading import add_border, fill_open_walls, nice_step, shading_of, span


def legend_of(axes) -> list[str]:
    return [text.get_text() for text in axes.get_legend().get_texts()]


def shown(axes) -> np.ndarray:
    """Values of an image, shape of the space."""
    return np.ma.filled(axes.images[0].get_array().astype(float), np.nan).T


def coloured(axes, point: tuple[float, float]) -> tuple[int, ...]:
    """Colour of the rendered picture at a point in data coordinates."""
    axes.figure.canvas.draw()
    pixels = np.asarray(axes.figure.canvas.buffer_rgba())
    x, y = axes.transData.transform(point)
    return tuple(int(v) for v in pixels[len(pixels) - 1 - int(y), int(x), :3])


def solved(space: rg.ConfigurationSpace, **options) -> rg.Field:
    return rg.field(rg.solve(rg.compile_space(space, **options)))


def test_the_image_equals_the_potential_with_the_first_axis_horizontal(field: rg.Field) -> None:
    axes = rg.draw(field, scale="linear")
    assert np.array_equal(shown(axes), field.potential)
    assert axes.images[0].origin == "lower"
    assert axes.images[0].get_extent() == pytest.approx([1.0, 4.5, -1.0, 0.25])
    assert (*axes.get_xlim(), *axes.get_ylim()) == pytest.approx((1.0, 4.5, -1.0, 0.25))
    assert axes.get_aspect() == 1.0
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x (m)", "y (m)")


def test_rendered_colours_are_those_of_the_cells_at_their_centres(space: rg.ConfigurationSpace) -> None:
    virtual = np.zeros(space.shape, dtype=bool)
    virtual[2, 3] = True
    axes = rg.draw(space, virtual=virtual)
    for index, colour in {(2, 1): 0x3D, (6, 0): 0xE8, (5, 3): 0xC4, (0, 4): 255, (2, 3): 0x8C}.items():
        assert coloured(axes, tuple(space.centre(index)))[0] == colour
    assert legend_of(axes) == ["free", "obstacle", "goal", "no path to a goal", "virtual obstacle"]


def test_a_frame_rotates_the_picture(space: rg.ConfigurationSpace) -> None:
    turned = rg.ConfigurationSpace(space.axes, space.cell, frame=rg.Frame(10.0, -5.0, np.pi / 6))
    axes = rg.draw(turned)
    for index, colour in {(2, 1): 0x3D, (6, 0): 0xE8, (0, 4): 255}.items():
        assert coloured(axes, tuple(turned.centre(index)))[0] == colour
    assert axes.get_xlabel() == "x, world (m)"


@pytest.mark.parametrize(("radius", "name"), [(0.0, "obstacle"), (0.2, "obstacle, grown by the robot")])
def test_the_legend_names_obstacles_grown_by_the_robot(radius: float, name: str) -> None:
    axes = [rg.Axis(name, 0, 6, 6) for name in "xy"]
    wall, goal = rg.Box((4, 0), (5, 1)), rg.GoalCell((0, 0))
    scene = rg.Scene(axes, robot=rg.PointRobot(radius), obstacles=[wall], goals=[goal])
    assert legend_of(rg.draw(rg.build_space(scene))) == ["free", name, "goal"]


def test_unknown_obstacle_cells_have_their_own_colour(space: rg.ConfigurationSpace) -> None:
    unknown = np.ones(space.shape, dtype=bool)  # only obstacle cells are painted
    unknown[2, 3] = False
    axes = rg.draw(space, unknown=unknown)
    for index, colour in {(2, 1): 0x9D, (2, 3): 0x3D, (6, 0): int(GOAL[1:3], 16), (0, 4): 255}.items():
        assert coloured(axes, tuple(space.centre(index)))[0] == colour
    assert legend_of(axes) == ["free", "obstacle", "goal", "no path to a goal", "unknown"]


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_the_goal_has_the_yellow_end_of_every_scale(field: rg.Field, scale: str) -> None:
    image = rg.draw(field, scale=scale).images[0]
    goal, far = image.get_clim() if scale == "linear" else image.get_clim()[::-1]
    assert [to_hex(image.to_rgba(value)) for value in (goal, far)] == [HEIGHT[0], HEIGHT[-1]]


def test_height_colours_are_equidistant_in_viridis() -> None:
    stops = np.array([to_rgb(stop) for stop in HEIGHT])
    distance = np.abs(stops[:, np.newaxis] - colormaps["viridis"].colors).sum(axis=2)
    numbers = distance.argmin(axis=1)
    assert distance.min(axis=1).max() < 0.02
    assert numbers[0] == 255 and np.ptp(np.diff(numbers)) <= 2  # equidistant in viridis, from its yellow end


def test_the_logarithmic_image_equals_the_logarithm_of_the_drop(field: rg.Field) -> None:
    drop = shown(rg.draw(field, scale="log"))
    free = field.space.goal_connected | (field.space.cell == rg.Cell.GOAL)
    assert np.allclose(drop[free], np.log10(1.0 - field.potential[free]), atol=1e-9)
    assert np.isnan(drop[~free]).all()


def test_scale_auto_is_logarithmic_only_for_a_wide_span(field: rg.Field, neumann: rg.Field) -> None:
    narrow = replace(field, log_drop=np.maximum(field.log_drop, np.log(0.05)))
    wide = replace(field, log_drop=np.where(np.isfinite(field.log_drop), field.log_drop * 300, -np.inf))
    assert not shading_of(narrow).is_log
    assert shading_of(wide).is_log
    assert shading_of(wide).lower < -300
    assert not shading_of(neumann).is_log
    with pytest.raises(rg.InputError, match="needs a drop"):
        rg.draw(neumann, scale="log")
    with pytest.raises(rg.InputError, match="must be 'auto' or 'linear' or 'log'"):
        rg.draw(field, scale="logarithmic")


def test_a_drop_below_the_range_of_float64_is_drawn(field: rg.Field) -> None:
    deep = replace(field, log_drop=np.where(np.isfinite(field.log_drop), field.log_drop * 1000, -np.inf))
    levels = next(artist for artist in rg.draw(deep).collections if isinstance(artist, ContourSet)).levels
    assert levels.min() < -400
    assert len(levels) < 20


def test_cells_at_the_high_rail_have_their_own_legend_entry(space: rg.ConfigurationSpace) -> None:
    driven = solved(space, boundary="neumann", drive="start", start=(0, 4))
    assert "at the high rail" in legend_of(rg.draw(driven, scale="log"))
    assert "at the high rail" not in legend_of(rg.draw(driven, scale="linear"))


def test_equipotentials_of_a_plate_capacitor_are_straight_lines() -> None:
    """Between plates the potential is linear: the line phi = 0.5 lies half-way and ends at both edges."""
    cell = np.zeros((11, 4), dtype=np.uint8)
    cell[0], cell[10] = rg.Cell.GOAL, rg.Cell.OBSTACLE
    axes = rg.draw(solved(space_of(cell), edge="open"), scale="linear")
    lines = next(artist for artist in axes.collections if isinstance(artist, ContourSet))
    line = lines.get_paths()[list(np.round(lines.levels, 9)).index(0.5)].vertices
    assert np.allclose(line[:, 0], 5.5)
    assert line[:, 1].min() <= 0
    assert line[:, 1].max() >= 4


def test_arrows_have_the_direction_and_magnitude_of_the_current(field: rg.Field) -> None:
    arrows = current_arrows(field, 1)
    assert len(arrows.tail) == field.space.goal_connected.sum()
    for (i, j), vector, decades in zip(arrows.tail, arrows.vector, arrows.decades, strict=True):
        x, y = field.face_current(0), field.face_current(1)
        mean = np.array([x[i, j] + x[i + 1, j], y[i, j] + y[i, j + 1]]) / 2
        assert np.hypot(*mean) == pytest.approx(10.0**decades)
        velocity = mean * field.space.spacing
        assert velocity @ vector / np.linalg.norm(velocity) / np.linalg.norm(vector) == pytest.approx(1.0)
    assert np.ptp(np.linalg.norm(arrows.vector / field.space.spacing, axis=1)) < 1e-9
    quiver = next(artist for artist in rg.draw(field, quantity="currents").collections if isinstance(artist, Quiver))
    assert len(arrows.tail) == quiver.N
    faint = replace(field, face_log_current=tuple(part - 2000.0 for part in field.face_log_current))
    weak = current_arrows(faint, 1)
    assert np.allclose(arrows.vector, weak.vector)
    assert np.allclose(arrows.decades - 2000 / np.log(10), weak.decades)


def test_each_block_has_an_arrow_at_the_cell_nearest_to_its_centre() -> None:
    eligible = np.random.default_rng(3).random((17, 11)) < 0.2
    chosen = {tuple(cell) for cell in nearest_to_middles(eligible, 4).tolist()}
    expected = 0
    for row in range(0, 17, 4):
        for column in range(0, 11, 4):
            inside = np.argwhere(eligible[row : row + 4, column : column + 4]) + np.array([row, column])
            distance = {tuple(c): np.hypot(c[0] - row - 1.5, c[1] - column - 1.5) for c in inside.tolist()}
            if distance:
                expected += 1
                assert min(distance.values()) == min(distance[c] for c in distance if c in chosen)
    assert len(chosen) == expected


def test_block_means_and_colours_skip_missing_values() -> None:
    values = np.array([[1.0, 3.0, 5.0], [np.nan, 2.0, np.nan], [np.nan, np.nan, 7.0]])
    assert np.array_equal(block_means(values, 2), [[2.0, 5.0], [np.nan, 7.0]], equal_nan=True)
    colours = np.zeros((2, 2, 4), dtype=np.uint8)
    colours[0, 0] = (200, 100, 0, 255)
    assert block_colours(colours, 2).tolist() == [[[200, 100, 0, 64]]]


def test_values_beyond_the_grid_follow_the_edge_conditions() -> None:
    values = np.array([[1.0, 2.0], [3.0, 4.0]])
    assert add_border(values, ("periodic", "open"), 9.0)[:, 1].tolist() == [3.0, 1.0, 3.0, 1.0]
    assert add_border(values, ("obstacle", "open"), 9.0)[0].tolist() == [9.0] * 4
    assert add_border(values, ("obstacle", "open"), None)[:, 0].tolist() == [1.0, 1.0, 3.0, 3.0]
    filled = fill_open_walls(np.array([[1.0, np.nan, 3.0], [np.nan, np.nan, 5.0], [np.nan, np.nan, np.nan]]))
    assert (filled[0, 1], filled[1, 1]) == (2.0, 5.0)
    assert np.isnan(filled[2, 0])


@pytest.mark.parametrize(("smallest", "step"), [(0.011, 0.02), (0.5, 0.5), (1.0, 1.0), (2.1, 5.0), (7.0, 10.0)])
def test_contour_steps_are_round_numbers(smallest: float, step: float) -> None:
    assert nice_step(smallest) == pytest.approx(step)


def test_the_colour_range_ignores_rare_outliers() -> None:
    values = np.append(np.linspace(-3.0, 0.0, 1000), [-900.0, np.nan])
    assert span(values)[0] == pytest.approx(-2.94, abs=0.01)
    assert span(values[:1000]) == (-3.0, 0.0)
    assert span(np.array([2.0])) == (2.0, 2.0)


def test_the_picture_of_a_conductivity_has_its_values_and_labels(space: rg.ConfigurationSpace) -> None:
    turning = [replace(space.axes[0], unit="rad", name="theta_1"), space.axes[1]]
    costly = rg.ConfigurationSpace(turning, space.cell, np.linspace(0.1, 10.0, 35).reshape(7, 5))
    axes = rg.draw(costly)
    assert np.array_equal(shown(axes), costly.conductivity)
    assert axes.child_axes[0].get_ylabel() == "conductivity (relative)"
    assert axes.get_aspect() == "auto"
    assert axes.get_xlabel() == r"$\theta_{1}$ (rad)"


def test_a_large_map_is_drawn_from_block_means() -> None:
    cell = np.zeros((1500, 1500), dtype=np.uint8)
    cell[700:800, 100:1400], cell[3, 4] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    axes = rg.draw(space_of(cell))
    assert axes.images[0].get_array().shape == (750, 750, 4)
    assert coloured(axes, (750.0, 750.0)) == (0x3D, 0x3D, 0x3D)
    assert coloured(axes, (750.0, 50.0)) == (255, 255, 255)


def test_the_picture_is_cropped_to_free_cells_and_paths() -> None:
    cell = np.full((100, 80), rg.Cell.OBSTACLE, dtype=np.uint8)
    cell[40:64, 20:32], cell[50, 25] = rg.Cell.FREE, rg.Cell.GOAL
    space = space_of(cell)
    axes = rg.draw(space)
    assert (*axes.get_xlim(), *axes.get_ylim()) == (38, 66, 18, 34)
    assert coloured(axes, (50.5, 25.5)) == (0xE8, 0x49, 0x1D)
    blocked = rg.streamline(solved(space), cell=(90, 70))  # a start outside the free cells is still shown
    axes = rg.draw(blocked)
    assert (*axes.get_xlim(), *axes.get_ylim()) == (38, 90.5, 18, 70.5)


def panels(figure) -> list:
    return [axes for axes in figure.axes if axes.images]


@pytest.mark.slow
def test_slices_equal_the_potential_in_their_planes(cube: rg.Field) -> None:
    drawn = panels(rg.draw(cube, scale="linear"))
    assert [axes.get_title() for axes in drawn] == [
        "z = 3.5 m (through a goal)", "y = 4.5 m (through a goal)", "x = 5.5 m (through a goal)",
    ]  # fmt: skip
    assert np.array_equal(shown(drawn[0]), cube.potential[:, :, 3])
    assert np.array_equal(shown(drawn[1]), cube.potential[:, 4, :])
    assert np.array_equal(shown(drawn[2]), cube.potential[5])
    assert (drawn[1].get_xlabel(), drawn[1].get_ylabel()) == ("x (m)", "z (m)")
    assert sum("goal" in axes.get_title() for axes in panels(rg.draw(cube, axis=0))) == 1
    chosen = panels(rg.draw(cube, axis=0, indices=[0, 2]))
    assert [axes.get_title() for axes in chosen] == ["x = 0.5 m", "x = 2.5 m"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"axis": 3}, "axes 0, 1 and 2"),
        ({"axis": 1, "indices": [5]}, "cells 0 to 4"),
        ({"axis": 1, "indices": []}, "cells 0 to 4"),
        ({"indices": [1]}, "need the axis"),
        ({"quantity": "currents"}, "two axes"),
        ({"quantity": "sound"}, "'potential' or 'currents'"),
    ],
)
def test_invalid_slices_raise_input_error(cube: rg.Field, options: dict, message: str) -> None:
    with pytest.raises(rg.InputError, match=message):
        rg.draw(cube, **options)


def test_the_profile_of_one_axis_equals_the_potential_at_cell_centres(line: rg.Field) -> None:
    paths = [rg.streamline(line, start=[0.25]), rg.streamline(line, start=[6.5])]
    (axes,) = rg.plot.draw_summary(line, paths, scale="linear").axes
    curve = next(artist for artist in axes.lines if artist.get_label() == "cells")
    assert np.array_equal(curve.get_xdata(), np.arange(8) + 0.5)
    free = line.space.cell != rg.Cell.OBSTACLE
    assert np.array_equal(np.asarray(curve.get_ydata())[free], line.potential[free])
    assert legend_of(axes) == ["obstacle", "goal", "no path to a goal", "cells", "start", "no path"]
