from dataclasses import replace

import numpy as np
import pytest
from matplotlib.contour import ContourSet
from matplotlib.image import AxesImage
from matplotlib.quiver import Quiver

import resgrid as rg
from resgrid.compiler import compile_space
from resgrid.errors import InputError
from resgrid.frame import Frame
from resgrid.nodal.solve import solve
from resgrid.planning.fields import Field
from resgrid.planning.trace import streamline
from resgrid.plot import plot_currents, plot_path, plot_potential, plot_scene_page, plot_space
from resgrid.plot.arrows import current_arrows, nearest_to_middles
from resgrid.plot.blocks import block_colours, block_means
from resgrid.plot.ghosts import add_border, fill_open_walls
from resgrid.plot.shading import nice_step, shading_of, span
from resgrid.space import Axis, Cell, ConfigurationSpace


def images(axes) -> list[AxesImage]:
    return [artist for artist in axes.images if isinstance(artist, AxesImage)]


def legend_of(axes) -> list[str]:
    return [text.get_text() for text in axes.get_legend().get_texts()]


def coloured(axes, point: tuple[float, float]) -> tuple[int, ...]:
    """Colour of the rendered picture at a point in data coordinates."""
    axes.figure.canvas.draw()
    pixels = np.asarray(axes.figure.canvas.buffer_rgba())
    x, y = axes.transData.transform(point)
    return tuple(int(v) for v in pixels[len(pixels) - 1 - int(y), int(x), :3])


def test_the_image_is_the_potential_first_axis_right_second_up(field: Field) -> None:
    axes = plot_potential(field, scale="linear")
    image = images(axes)[0]
    assert np.array_equal(np.asarray(image.get_array()), field.potential.T)
    assert image.origin == "lower"
    assert image.get_extent() == pytest.approx([1.0, 4.5, -1.0, 0.25])
    assert axes.get_xlim() == pytest.approx((1.0, 4.5))
    assert axes.get_ylim() == pytest.approx((-1.0, 0.25))
    assert axes.get_aspect() == 1.0
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x (m)", "y (m)")


def test_dots_on_paper_lie_where_the_cells_are(space: ConfigurationSpace) -> None:
    axes = plot_space(space)
    assert coloured(axes, tuple(space.centre((2, 1)))) == (0x3D, 0x3D, 0x3D)
    assert coloured(axes, tuple(space.centre((6, 0)))) == (0xE6, 0x9F, 0x00)
    assert coloured(axes, tuple(space.centre((5, 3)))) == (0xC4, 0xC4, 0xC4)
    assert coloured(axes, tuple(space.centre((0, 4)))) == (255, 255, 255)
    assert legend_of(axes) == ["obstacle", "goal", "no way to a goal"]


def test_a_frame_turns_the_picture(space: ConfigurationSpace) -> None:
    turned = ConfigurationSpace(space.axes, space.cell, frame=Frame(10.0, -5.0, np.pi / 6))
    axes = plot_space(turned)
    for index, colour in {(2, 1): 0x3D, (6, 0): 0xE6, (0, 4): 255}.items():
        assert coloured(axes, tuple(turned.centre(index)))[0] == colour
    assert axes.get_xlabel() == "x, world (m)"


def test_decades_are_shown_where_the_drop_spans_them(field: Field) -> None:
    axes = plot_potential(field, scale="log")
    shown = np.ma.asarray(images(axes)[0].get_array())
    free = field.space.goal_connected | (field.space.cell == Cell.GOAL)
    assert np.allclose(shown.T[free], np.log10(1.0 - field.potential[free]), atol=1e-9)
    assert np.all(np.ma.getmaskarray(shown).T[~free])


def test_auto_takes_decades_only_for_a_wide_span(field: Field, neumann: Field) -> None:
    narrow = replace(field, log_drop=np.maximum(field.log_drop, np.log(0.05)))
    wide = replace(field, log_drop=np.where(np.isfinite(field.log_drop), field.log_drop * 300, -np.inf))
    assert not shading_of(narrow).is_log
    assert shading_of(wide).is_log
    assert shading_of(wide).lower < -300
    assert not shading_of(neumann).is_log
    with pytest.raises(InputError, match="needs a drop"):
        shading_of(neumann, "log")
    with pytest.raises(InputError, match="may be one of auto, linear, log"):
        shading_of(field, "logarithmic")


def test_a_drop_far_below_float64_is_drawn(field: Field) -> None:
    deep = replace(field, log_drop=np.where(np.isfinite(field.log_drop), field.log_drop * 1000, -np.inf))
    axes = plot_potential(deep)
    levels = next(artist for artist in axes.collections if isinstance(artist, ContourSet)).levels
    assert levels.min() < -400
    assert len(levels) < 20
    plot_scene_page(deep).canvas.draw()


def test_cells_at_the_high_rail_have_their_own_legend_entry(space: ConfigurationSpace) -> None:
    driven = rg.field(solve(compile_space(space, boundary="neumann", drive="start", start=(0, 4))))
    assert "at the high rail" in legend_of(plot_potential(driven, scale="log"))
    assert "at the high rail" not in legend_of(plot_potential(driven, scale="linear"))


def test_equipotentials_lie_where_the_potential_says() -> None:
    """Between plates the potential is linear: the line phi = 0.5 lies half-way, up to both edges."""
    cell = np.zeros((11, 4), dtype=np.uint8)
    cell[0], cell[10] = Cell.GOAL, Cell.OBSTACLE
    plates = ConfigurationSpace([Axis("x", 0, 11, 11), Axis("y", 0, 4, 4)], cell)
    axes = plot_potential(rg.field(solve(compile_space(plates, edge="open"))), scale="linear")
    lines = next(artist for artist in axes.collections if isinstance(artist, ContourSet))
    line = lines.get_paths()[list(np.round(lines.levels, 9)).index(0.5)].vertices
    assert np.allclose(line[:, 0], 5.5)
    assert line[:, 1].min() <= 0
    assert line[:, 1].max() >= 4


def test_arrows_point_along_the_current(field: Field) -> None:
    arrows = current_arrows(field, 1)
    assert len(arrows.tail) == field.space.goal_connected.sum()
    for (i, j), vector, decades in zip(arrows.tail, arrows.vector, arrows.decades, strict=True):
        x, y = field.face_current(0), field.face_current(1)
        mean = np.array([x[i, j] + x[i + 1, j], y[i, j] + y[i, j + 1]]) / 2
        assert np.hypot(*mean) == pytest.approx(10.0**decades)
        velocity = mean * field.space.spacing
        cosine = velocity @ vector / np.linalg.norm(velocity) / np.linalg.norm(vector)
        assert cosine == pytest.approx(1.0)
    lengths = np.linalg.norm(arrows.vector / field.space.spacing, axis=1)
    assert np.allclose(lengths, lengths[0])


def test_currents_below_float64_still_have_arrows(field: Field) -> None:
    faint = replace(field, face_log_current=tuple(part - 2000.0 for part in field.face_log_current))
    strong, weak = current_arrows(field, 1), current_arrows(faint, 1)
    assert np.allclose(strong.vector, weak.vector)
    assert np.allclose(strong.decades - 2000 / np.log(10), weak.decades)


def test_arrows_are_drawn_once_each(field: Field) -> None:
    axes = plot_currents(field)
    quiver = next(artist for artist in axes.collections if isinstance(artist, Quiver))
    assert field.space.goal_connected.sum() == quiver.N


def test_each_block_shows_the_eligible_cell_nearest_to_its_middle() -> None:
    rng = np.random.default_rng(3)
    eligible = rng.random((17, 11)) < 0.2
    found = {tuple(cell) for cell in nearest_to_middles(eligible, 4).tolist()}
    expected = 0
    for row in range(0, 17, 4):
        for column in range(0, 11, 4):
            inside = [
                tuple(c) for c in np.argwhere(eligible[row : row + 4, column : column + 4]) + np.array([row, column])
            ]
            if not inside:
                continue
            expected += 1
            distance = {c: np.hypot(c[0] - row - 1.5, c[1] - column - 1.5) for c in inside}
            assert min(distance.values()) == min(distance[c] for c in inside if c in found)
    assert len(found) == expected


def test_means_over_blocks() -> None:
    values = np.array([[1.0, 3.0, 5.0], [np.nan, 2.0, np.nan], [np.nan, np.nan, 7.0]])
    assert np.array_equal(block_means(values, 2), [[2.0, 5.0], [np.nan, 7.0]], equal_nan=True)
    colours = np.zeros((2, 2, 4), dtype=np.uint8)
    colours[0, 0] = (200, 100, 0, 255)
    assert block_colours(colours, 2).tolist() == [[[200, 100, 0, 64]]]


def test_ghosts_follow_the_edges() -> None:
    values = np.array([[1.0, 2.0], [3.0, 4.0]])
    assert add_border(values, ("periodic", "open"), 9.0)[:, 1].tolist() == [3.0, 1.0, 3.0, 1.0]
    assert add_border(values, ("obstacle", "open"), 9.0)[0].tolist() == [9.0] * 4
    assert add_border(values, ("obstacle", "open"), None)[:, 0].tolist() == [1.0, 1.0, 3.0, 3.0]
    holed = np.array([[1.0, np.nan, 3.0], [np.nan, np.nan, 5.0], [np.nan, np.nan, np.nan]])
    filled = fill_open_walls(holed)
    assert filled[0, 1] == 2.0
    assert filled[1, 1] == 5.0
    assert np.isnan(filled[2, 0])


@pytest.mark.parametrize(("smallest", "step"), [(0.011, 0.02), (0.5, 0.5), (1.0, 1.0), (2.1, 5.0), (7.0, 10.0)])
def test_steps_between_lines_are_round(smallest: float, step: float) -> None:
    assert nice_step(smallest) == pytest.approx(step)


def test_conductivity_is_drawn_with_its_scale(space: ConfigurationSpace) -> None:
    costly = ConfigurationSpace(space.axes, space.cell, np.linspace(0.1, 10.0, 35).reshape(7, 5))
    axes = plot_space(costly)
    assert np.array_equal(np.asarray(images(axes)[0].get_array()), costly.conductivity.T)
    assert axes.child_axes[0].get_ylabel() == "conductivity (relative)"


def test_units_that_differ_are_not_drawn_to_scale(space: ConfigurationSpace) -> None:
    axes = [replace(space.axes[0], unit="rad", name="theta_1"), space.axes[1]]
    drawn = plot_space(ConfigurationSpace(axes, space.cell))
    assert drawn.get_aspect() == "auto"
    assert drawn.get_xlabel() == r"$\theta_{1}$ (rad)"


def test_an_axes_given_is_used_and_returned(field: Field) -> None:
    axes = plot_space(field.space)
    assert plot_potential(field, axes) is axes
    assert legend_of(axes).count("obstacle") == 1


@pytest.mark.parametrize("draw", [plot_space, plot_potential, plot_currents])
def test_other_dimensions_are_refused_with_what_there_is(draw) -> None:
    cube = ConfigurationSpace([Axis(name, 0, 3, 3) for name in "xyz"], np.eye(27)[0].reshape(3, 3, 3).astype(int) * 2)
    value = cube if draw is plot_space else rg.field(solve(compile_space(cube)))
    with pytest.raises(InputError, match="three axes: plot_slices"):
        draw(value)


def test_a_large_map_is_drawn_from_block_means() -> None:
    size = 1500
    cell = np.zeros((size, size), dtype=np.uint8)
    cell[700:800, 100:1400], cell[3, 4] = Cell.OBSTACLE, Cell.GOAL
    plain = ConfigurationSpace([Axis("x", 0, size, size), Axis("y", 0, size, size)], cell)
    axes = plot_space(plain)
    assert images(axes)[0].get_array().shape == (750, 750, 4)
    assert coloured(axes, (750.0, 750.0)) == (0x3D, 0x3D, 0x3D)
    assert coloured(axes, (750.0, 50.0)) == (255, 255, 255)


def test_a_thin_tail_does_not_swallow_the_colours(field: Field) -> None:
    values = np.append(np.linspace(-3.0, 0.0, 1000), [-900.0, np.nan])
    assert span(values)[0] == pytest.approx(-2.94, abs=0.01)
    assert span(values[:1000]) == (-3.0, 0.0)
    assert span(np.array([2.0])) == (2.0, 2.0)


def test_a_small_room_in_a_large_map_fills_the_picture() -> None:
    cell = np.full((100, 80), Cell.OBSTACLE, dtype=np.uint8)
    cell[40:64, 20:32], cell[50, 25] = Cell.FREE, Cell.GOAL
    axes = plot_space(ConfigurationSpace([Axis("x", 0, 100, 100), Axis("y", 0, 80, 80)], cell))
    assert axes.get_xlim() == (38, 66)
    assert axes.get_ylim() == (18, 34)
    assert coloured(axes, (50.5, 25.5)) == (0xE6, 0x9F, 0x00)


def test_a_blocked_start_outside_the_room_is_still_shown() -> None:
    cell = np.full((100, 80), Cell.OBSTACLE, dtype=np.uint8)
    cell[40:64, 20:32], cell[50, 25] = Cell.FREE, Cell.GOAL
    field = rg.field(solve(compile_space(ConfigurationSpace([Axis("x", 0, 100, 100), Axis("y", 0, 80, 80)], cell))))
    axes = plot_path(streamline(field, cell=(90, 70)), field.space)
    assert axes.get_xlim() == (38, 90.5)
    assert axes.get_ylim() == (18, 70.5)
