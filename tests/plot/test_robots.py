"""What is drawn of a robot is where the robot is."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba

import resgrid as rg
from resgrid.compiler import compile_space
from resgrid.errors import InputError
from resgrid.nodal.solve import solve
from resgrid.planning.fields import Field
from resgrid.planning.planner import clearance_curve, plan
from resgrid.planning.separation import separation
from resgrid.planning.trace import streamline
from resgrid.plot import (
    plot_clearance_curve,
    plot_configurations,
    plot_pair,
    plot_robot_path,
    plot_separation,
    plot_tip_ways,
    plot_workspace,
)
from resgrid.plot.paint import VIRTUAL
from resgrid.plot.style import FAILURE
from resgrid.robots import Arm, Ball, Box, DiscRobot, HalfSpace, Polygon, PolygonRobot
from resgrid.space import Axis, Cell, ConfigurationSpace

ARM = Arm((1.0, 0.5), widths=(0.1, 0.0))
OBSTACLE, TARGET = Box((-1.2, 0.4), (-0.9, 0.9)), Ball((0.0, 1.2), 0.15)


@pytest.fixture(scope="module")
def torus() -> ConfigurationSpace:
    axes = ARM.axes(40)
    cell = ARM.occupancy(axes, [OBSTACLE], "conservative").astype(np.uint8)
    cell[ARM.goal_cells(axes, TARGET).cells & (cell == 0)] = Cell.GOAL
    return ConfigurationSpace(axes, cell)


@pytest.fixture(scope="module")
def field_(torus: ConfigurationSpace) -> Field:
    return rg.field(solve(compile_space(torus)))


def lines_of(axes) -> dict[str, np.ndarray]:
    return {line.get_label(): np.asarray(line.get_xydata()) for line in axes.lines}


def test_links_are_drawn_where_the_joints_are(torus, field_) -> None:
    path = streamline(field_, start=(-0.5, 0.6))
    axes = plot_robot_path(path, ARM, torus, [OBSTACLE], [TARGET], ghosts=5)
    lines = lines_of(axes)
    np.testing.assert_allclose(lines["robot at the start"], ARM.joints(path.points[0]))
    np.testing.assert_allclose(lines["robot at the end"], ARM.joints(path.points[-1]))
    tip = lines["way of the tip"]
    np.testing.assert_allclose(tip[[0, -1]], ARM.tip(path.points[[0, -1]]))
    assert np.linalg.norm(np.diff(tip, axis=0), axis=1).max() < 0.02
    assert sum(len(line) == 3 for line in lines_all(axes)) == 5
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert left < -1.5 < 1.5 < right
    assert bottom < -1.5 < 1.5 < top


def lines_all(axes) -> list[np.ndarray]:
    return [np.asarray(line.get_xydata()) for line in axes.lines]


def test_a_pose_alone_has_no_way(torus) -> None:
    lines = lines_of(plot_robot_path(rg.Polyline([(0.0, pi / 2)], torus), ARM, torus))
    assert "way of the tip" not in lines
    np.testing.assert_allclose(lines["robot at the start"], [(0, 0), (1, 0), (1, 0.5)], atol=1e-12)


def test_polygons_and_discs_are_filled_where_they_are() -> None:
    bar = PolygonRobot(((-0.2, -0.1), (0.2, -0.1), (0.0, 0.3)))
    poses = ConfigurationSpace([Axis("x", 0, 4, 4), Axis("y", 0, 4, 4), bar.turning_axis(4)], np.zeros((4, 4, 4)))
    axes = plot_robot_path(rg.Polyline([(1, 1, 0), (3, 2, pi)], poses), bar, poses, ghosts=3)
    drawn = [patch.get_path().vertices[:3] for patch in axes.patches]
    assert len(drawn) == 3
    assert any(np.allclose(corners, bar.corners((1, 1, 0))) for corners in drawn)
    plane = ConfigurationSpace([Axis("x", 0, 4, 4), Axis("y", 0, 4, 4)], np.zeros((4, 4)))
    disc = plot_robot_path(rg.Polyline([(1, 1), (3, 2)], plane), DiscRobot(0.5), plane, ghosts=2).patches
    assert disc[0].get_extents().width == pytest.approx(disc[1].get_extents().width)
    with pytest.raises(InputError, match="ghosts = 0"):
        plot_robot_path(rg.Polyline([(1, 1)], plane), DiscRobot(0.5), plane, ghosts=0)


def test_shapes_of_all_kinds_are_drawn_with_their_holes() -> None:
    ring = Polygon(((0, 0), (3, 0), (3, 3), (0, 3)), (((1, 1), (2, 1), (2, 2), (1, 2)),))
    axes = plot_workspace([ring, Box((4, 0), (5, 1)), Ball((6, 0), 1), HalfSpace((0, 1), -2)], [TARGET])
    assert len(axes.patches) == 5
    assert colour_at(axes, (0.5, 1.5)) != (255, 255, 255)
    assert colour_at(axes, (1.5, 1.5)) == (255, 255, 255)


def colour_at(axes, point: tuple[float, float]) -> tuple[int, ...]:
    axes.figure.canvas.draw()
    image = np.asarray(axes.figure.canvas.buffer_rgba())
    column, row = axes.transData.transform(point)
    return tuple(int(part) for part in image[len(image) - 1 - int(row), int(column), :3])


def test_a_pair_has_the_workspace_left_and_the_configurations_right(torus, field_) -> None:
    path = streamline(field_, start=(-0.5, 0.6))
    virtual = np.zeros(torus.shape, dtype=bool)
    virtual[3, 3] = True
    figure = plot_pair(path, ARM, torus, [OBSTACLE], [TARGET], virtual=virtual, title="Title", caption="Caption")
    figure.canvas.draw()
    left, right = figure.axes
    assert [left.get_title(), right.get_title()] == ["Workspace", "Configuration space"]
    assert left.get_position().x1 < right.get_position().x0
    assert figure.get_suptitle() == "Title"
    pixels = right.images[-1].get_array()
    assert np.allclose(pixels[3, 3] / 255, to_rgba(VIRTUAL), atol=0.01)
    assert (pixels[..., 3] > 0).sum() == 1
    sizes = [text.get_fontsize() for text in figure.findobj(lambda artist: hasattr(artist, "get_fontsize"))]
    assert min(sizes) >= 7


def test_what_separates_is_red_in_both_halves() -> None:
    cell = np.zeros((8, 6), dtype=np.uint8)
    cell[4, :], cell[7, 0] = Cell.OBSTACLE, Cell.GOAL
    space = ConfigurationSpace([Axis("x", 0, 8, 8), Axis("y", 0, 6, 6)], cell)
    verdict = separation(space, cell=(1, 1))
    wall = Box((4, 0), (5, 6))
    path = streamline(rg.field(solve(compile_space(space))), cell=(1, 1))
    figure = plot_pair(path, DiscRobot(0.1), space, [wall], verdict=verdict, separating=[wall])
    left, right = figure.axes
    red = np.round(255 * np.array(to_rgba(FAILURE)))
    np.testing.assert_array_equal(np.all(right.images[-1].get_array() == red, axis=2).T, cell == Cell.OBSTACLE)
    assert any(patch.get_facecolor() == to_rgba(FAILURE) for patch in left.patches)
    reachable = plot_separation(separation(space, cell=(6, 1)))
    assert any("reached" in text.get_text() for text in reachable.get_legend().get_texts())
    cube = ConfigurationSpace([Axis(n, 0, 2, 2) for n in "xyz"], np.diag([2, 0])[:, :, None] * np.ones((1, 1, 2), int))
    with pytest.raises(InputError, match="two axes"):
        plot_separation(separation(cube, cell=(1, 1, 0)))


def test_many_ways_are_those_of_the_tip(torus, field_) -> None:
    paths = [streamline(field_, start=start) for start in ((-0.5, 0.6), (1.0, 0.2))]
    axes = plot_tip_ways(paths, ARM, torus, [OBSTACLE], [TARGET])
    (lines,) = (c.get_segments() for c in axes.collections if isinstance(c, LineCollection))
    for line, path in zip(lines, paths, strict=True):
        np.testing.assert_allclose(line[[0, -1]], ARM.tip(path.points[[0, -1]]))
    assert plot_configurations(paths, torus).get_title() == "Configuration space"


def test_the_curve_shows_its_means() -> None:
    cell = np.zeros((12, 9), dtype=np.uint8)
    cell[5, 2:], cell[11, 8] = Cell.OBSTACLE, Cell.GOAL
    space = ConfigurationSpace([Axis("x", 0, 12, 12), Axis("y", 0, 9, 9)], cell)
    curve = clearance_curve(plan(space, k=0.5), (0.0, 0.5, 1.0), [(1.5, 7.5), (2.5, 4.5)])
    axes = plot_clearance_curve(curve, unit="m", cell=1.0)
    np.testing.assert_allclose(lines_of(axes)["mean of 2 starts"], np.stack([curve.value, curve.mean], axis=1))
    assert axes.get_ylabel().endswith("(m)")
