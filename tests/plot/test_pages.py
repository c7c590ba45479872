from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from support.spaces import spaces

import resgrid as rg
from resgrid.compiler import compile_space
from resgrid.errors import CircuitError, InputError
from resgrid.nodal.solve import solve
from resgrid.planning.fields import Field
from resgrid.planning.trace import streamline
from resgrid.plot import plot_profile, plot_scene_page, plot_slices
from resgrid.space import Axis, Cell, ConfigurationSpace


@pytest.fixture(scope="module")
def cube() -> Field:
    cell = np.zeros((6, 5, 4), dtype=np.uint8)
    cell[3, :, :2], cell[5, 4, 3] = Cell.OBSTACLE, Cell.GOAL
    axes = [Axis(name, 0, size, size) for name, size in zip("xyz", cell.shape, strict=True)]
    return rg.field(solve(compile_space(ConfigurationSpace(axes, cell))))


@pytest.fixture(scope="module")
def line() -> Field:
    return rg.field(solve(compile_space(ConfigurationSpace([Axis("x", 0, 8, 8)], [0, 0, 2, 0, 0, 1, 0, 1]))))


def panels(figure) -> list:
    return [axes for axes in figure.axes if axes.images]


def test_the_page_of_a_plane_has_two_panels_side_by_side_or_stacked(field: Field) -> None:
    figure = plot_scene_page(field, [streamline(field, cell=(0, 4))], title="Title")
    assert [axes.get_title() for axes in figure.axes[:2]] == ["Potential and paths", "Current"]
    assert figure.get_suptitle() == "Title"
    figure.canvas.draw()
    above, below = (axes.get_position() for axes in figure.axes[:2])
    assert above.y0 > below.y1  # 3.5 m x 1.25 m: wide, so stacked
    square = ConfigurationSpace([Axis("x", 0, 4, 4), Axis("y", 0, 4, 4)], np.eye(4, dtype=int) * 2)
    figure = plot_scene_page(rg.field(solve(compile_space(square))))
    figure.canvas.draw()
    left, right = (axes.get_position() for axes in figure.axes[:2])
    assert left.x1 < right.x0


def test_no_text_is_smaller_than_seven_points(field: Field, cube: Field, line: Field) -> None:
    for each in (field, cube, line):
        figure = plot_scene_page(each, [streamline(each, cell=(0,) * each.space.ndim)])
        figure.canvas.draw()
        sizes = [text.get_fontsize() for text in figure.findobj(lambda artist: hasattr(artist, "get_fontsize"))]
        assert min(sizes) >= 7
        assert figure.dpi >= 150


def test_slices_show_what_is_cut(cube: Field) -> None:
    figure = plot_slices(cube, scale="linear")
    shown = panels(figure)
    assert [axes.get_title() for axes in shown] == [
        "z = 3.5 m (through a goal)", "y = 4.5 m (through a goal)", "x = 5.5 m (through a goal)",
    ]  # fmt: skip
    assert np.array_equal(np.asarray(shown[0].images[0].get_array()), cube.potential[:, :, 3].T)
    assert np.array_equal(np.asarray(shown[1].images[0].get_array()), cube.potential[:, 4, :].T)
    assert np.array_equal(np.asarray(shown[2].images[0].get_array()), cube.potential[5].T)
    assert (shown[1].get_xlabel(), shown[1].get_ylabel()) == ("x (m)", "z (m)")


def test_slices_along_an_axis_hold_the_goal(cube: Field) -> None:
    assert sum("goal" in axes.get_title() for axes in panels(plot_slices(cube, 0))) == 1
    chosen = panels(plot_slices(cube, 0, indices=[0, 2]))
    assert [axes.get_title() for axes in chosen] == ["x = 0.5 m", "x = 2.5 m"]


def test_a_path_is_bold_only_in_its_slice(cube: Field) -> None:
    path = streamline(cube, cell=(0, 0, 0))
    figure = plot_slices(cube, 2, indices=[0, 1, 2, 3], paths=[path])
    bold = [
        line.get_xydata() for axes in panels(figure) for line in axes.lines if line.get_label() == "path in the slice"
    ]
    assert len(bold) == 4
    first = bold[0][~np.isnan(bold[0][:, 0])]
    assert np.allclose(first, path.points[path.points[:, 2] <= 1.0][:, :2])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"axis": 3}, "axes 0, 1 and 2"),
        ({"axis": 1, "indices": [5]}, "cells 0 to 4"),
        ({"axis": 1, "indices": []}, "cells 0 to 4"),
        ({"indices": [1]}, "need the axis"),
    ],
)
def test_wrong_slices_are_refused(cube: Field, arguments: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        plot_slices(cube, **arguments)


def test_a_profile_is_the_potential_over_the_coordinate(line: Field) -> None:
    axes = plot_profile(line, scale="linear", paths=[streamline(line, start=[0.25]), streamline(line, start=[6.5])])
    curve = next(artist for artist in axes.lines if artist.get_label() == "cells")
    assert np.array_equal(curve.get_xdata(), np.arange(8) + 0.5)
    free = line.space.cell != Cell.OBSTACLE
    assert np.array_equal(np.asarray(curve.get_ydata())[free], line.potential[free])
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["obstacle", "goal", "no way to a goal", "cells", "start", "no path"]
    assert axes.get_xlabel() == "x (m)"


def test_wrong_dimensions_are_refused(field: Field, line: Field) -> None:
    with pytest.raises(InputError, match="three axes"):
        plot_slices(field)
    with pytest.raises(InputError, match="one axis"):
        plot_profile(field)
    cell = np.zeros((2, 2, 2, 2), dtype=int)
    cell[0, 0, 0, 0] = Cell.GOAL
    four = rg.field(solve(compile_space(ConfigurationSpace([Axis(n, 0, 2, 2) for n in "xyzw"], cell))))
    with pytest.raises(InputError, match=r"4 axes has no overview.*plot_slices"):
        plot_scene_page(four)


def test_paths_of_another_space_are_refused(field: Field, cube: Field, line: Field) -> None:
    for each, other in ((field, cube), (cube, line), (line, field)):
        path = streamline(other, cell=(0,) * other.space.ndim)
        with pytest.raises(InputError, match="coordinates, the space"):
            plot_scene_page(each, [path])


@settings(max_examples=12)
@given(spaces(), st.sampled_from(["dirichlet", "neumann", "wall"]), st.booleans())
def test_every_field_has_a_page(space: ConfigurationSpace, boundary: str, periodic: bool) -> None:
    """Whatever the shape: thin, tiny, without obstacles, all of one value."""
    assume(space.ndim < 4)
    axes = [replace(axis, periodic=periodic and number == 0) for number, axis in enumerate(space.axes)]
    space = ConfigurationSpace(axes, space.cell, space.conductivity)
    options = {"wall_resistance": 1e4} if boundary == "wall" else {}
    try:
        field = rg.field(solve(compile_space(space, boundary=boundary, **options)))
    except CircuitError:
        assume(False)
    paths = [streamline(field, cell=cell) for cell in np.argwhere(space.cell != Cell.GOAL)[::3].tolist()]
    figure = plot_scene_page(field, paths)
    figure.canvas.draw()
    assert figure.axes
