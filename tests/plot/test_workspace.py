"""Pictures of robots, compared with their joints and corners; pairs of workspace and configuration space.

Tests internals: `resgrid.plot.panels`, `resgrid.plot.style`.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from support.cli import ROOM
from support.spaces import space_of

import resgrid as rg
from resgrid.plot.panels import VIRTUAL
from resgrid.plot.style import FAILURE

ARM = rg.Arm((1.0, 0.5), widths=(0.1, 0.0))
OBSTACLE, TARGET = rg.Box((-1.2, 0.4), (-0.9, 0.9)), rg.Ball((0.0, 1.2), 0.15)
PLANE = (rg.Axis("x", 0, 4, 4), rg.Axis("y", 0, 4, 4))


@pytest.fixture(scope="module")
def arm() -> rg.Scene:
    return rg.Scene(ARM.axes(40), robot=ARM, obstacles=(OBSTACLE,), goals=(TARGET,))


@pytest.fixture(scope="module")
def planner(arm: rg.Scene) -> rg.planning.Planner:
    return rg.plan(arm)


def lines_of(axes) -> dict[str, np.ndarray]:
    return {line.get_label(): np.asarray(line.get_xydata()) for line in axes.lines}


def colour_at(axes, point: tuple[float, float]) -> tuple[int, ...]:
    axes.figure.canvas.draw()
    image = np.asarray(axes.figure.canvas.buffer_rgba())
    column, row = axes.transData.transform(point)
    return tuple(int(part) for part in image[len(image) - 1 - int(row), int(column), :3])


def test_links_are_drawn_between_their_joints(arm, planner) -> None:
    path = planner.path((-0.5, 0.6))
    axes = rg.plot.draw_robot(path, arm, ghosts=5)
    lines = lines_of(axes)
    np.testing.assert_allclose(lines["robot at the start"], ARM.joints(path.points[0]))
    np.testing.assert_allclose(lines["robot at the end"], ARM.joints(path.points[-1]))
    tip = lines["path of the tip"]
    np.testing.assert_allclose(tip[[0, -1]], ARM.tip(path.points[[0, -1]]))
    assert np.linalg.norm(np.diff(tip, axis=0), axis=1).max() < 0.02
    assert sum(len(line.get_xydata()) == 3 for line in axes.lines) == 5
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert left < -1.5 < 1.5 < right
    assert bottom < -1.5 < 1.5 < top


def test_a_single_pose_is_drawn_without_a_path(arm) -> None:
    lines = lines_of(rg.plot.draw_robot([(0.0, pi / 2)], arm))
    assert "path of the tip" not in lines
    np.testing.assert_allclose(lines["robot at the start"], [(0, 0), (1, 0), (1, 0.5)], atol=1e-12)


def test_polygon_and_disc_robots_are_drawn_at_their_poses() -> None:
    bar = rg.PolygonRobot(((-0.2, -0.1), (0.2, -0.1), (0.0, 0.3)))
    turning = rg.Scene((*PLANE, bar.turning_axis(4)), robot=bar)
    axes = rg.plot.draw_robot([(1, 1, 0), (3, 2, pi)], turning, ghosts=3)
    drawn = [patch.get_path().vertices[:3] for patch in axes.patches]
    assert len(drawn) == 3
    assert any(np.allclose(sorted(corners.tolist()), sorted(bar.corners((1, 1, 0)).tolist())) for corners in drawn)
    disc = rg.Scene(PLANE, robot=rg.DiscRobot(0.5))
    drawn = rg.plot.draw_robot([(1, 1), (3, 2)], disc, ghosts=2).patches
    assert drawn[0].get_extents().width == pytest.approx(drawn[1].get_extents().width)
    with pytest.raises(rg.InputError, match="ghosts = 0"):
        rg.plot.draw_robot([(1, 1)], disc, ghosts=0)


def test_a_scene_is_drawn_with_shapes_of_all_kinds_and_holes() -> None:
    ring = rg.Polygon(((0, 0), (3, 0), (3, 3), (0, 3)), (((1, 1), (2, 1), (2, 2), (1, 2)),))
    axes = [rg.Axis(name, -4, 8, 12) for name in "xy"]
    shapes = (ring, rg.Box((4, 0), (5, 1)), rg.Ball((6, 0), 1), rg.HalfSpace((0, 1), -2))
    scene = rg.Scene(axes, obstacles=shapes, goals=(TARGET, rg.GoalPoint((7, 7))), starts=((-3, 7),))
    drawn = rg.draw(scene)
    assert len(drawn.patches) == 5
    assert colour_at(drawn, (0.5, 1.5)) != (255, 255, 255)
    assert colour_at(drawn, (1.5, 1.5)) == (255, 255, 255)
    marks = {mark.get_label(): mark.get_offsets().tolist() for mark in drawn.collections}
    assert marks == {"start": [[-3, 7]], "goal": [[7, 7]]}
    with pytest.raises(rg.InputError, match="not a plane"):
        rg.plot.draw_robot([(1, 1, 1)], rg.Scene([rg.Axis(name, 0, 4, 4) for name in "xyz"]))


def test_the_workspace_is_drawn_left_of_the_configuration_space(arm, planner) -> None:
    path = planner.path((-0.5, 0.6))
    virtual = np.zeros(planner.space.shape, dtype=bool)
    virtual[3, 3] = True
    figure = rg.plot.draw_workspace_and_space(path, arm, virtual=virtual, title="Title", caption="Caption")
    figure.canvas.draw()
    left, right = figure.axes
    assert [left.get_title(), right.get_title()] == ["Workspace", "Configuration space"]
    assert left.get_position().x1 < right.get_position().x0
    assert figure.get_suptitle() == "Title\nCaption"
    pixels = right.images[-1].get_array()
    assert np.allclose(pixels[3, 3] / 255, to_rgba(VIRTUAL), atol=0.01)
    assert (pixels[..., 3] > 0).sum() == 1


@pytest.mark.slow
def test_titles_panels_and_legends_of_pairs_do_not_overlap(arm, planner, run) -> None:
    path = planner.path((-0.5, 0.6))
    runs = [run, replace(run, field=replace(run.field, k=0.5)), replace(run, field=replace(run.field, k=0.0))]
    for figure in (
        rg.plot.draw_workspace_and_space(path, arm, title="Title", caption="Caption"),
        rg.plot.draw_workspace_and_space(path, arm, title="Title"),
        rg.draw(run, title="Title", caption="Caption"), rg.draw(runs, title="Title"),
    ):  # fmt: skip
        figure.canvas.draw()
        for axes in figure.axes:
            legend = axes.get_legend().get_window_extent()
            assert legend.y0 >= 0 and legend.y1 < axes.get_window_extent().y0
            gap = figure._suptitle.get_window_extent().y0 - axes.title.get_window_extent().y1
            assert 0 < gap < 40  # pixels at 200 dots per inch


def test_blocking_obstacles_are_red_in_both_panels() -> None:
    cell = np.zeros((8, 6), dtype=np.uint8)
    cell[4, :], cell[7, 0] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    space = space_of(cell)
    verdict = rg.find_blocking_obstacles(space, cell=(1, 1))
    wall = rg.Box((4, 0), (5, 6))
    scene = rg.Scene(space.axes, robot=rg.DiscRobot(0.1), obstacles=(wall,))
    path = rg.streamline(rg.field(rg.solve(rg.compile_space(space))), cell=(1, 1))
    figure = rg.plot.draw_workspace_and_space(path, scene, verdict=verdict, separating=[wall])
    left, right = figure.axes
    red = np.round(255 * np.array(to_rgba(FAILURE)))
    np.testing.assert_array_equal(
        np.all(right.images[-1].get_array() == red, axis=2).T, cell == rg.Cell.OBSTACLE
    )  # fmt: skip
    assert any(patch.get_facecolor() == to_rgba(FAILURE) for patch in left.patches)
    reachable = rg.draw(rg.find_blocking_obstacles(space, cell=(6, 1)))
    assert any("reached" in text.get_text() for text in reachable.get_legend().get_texts())
    cube = space_of(np.diag([2, 0])[:, :, None] * np.ones((1, 1, 2), int))
    with pytest.raises(rg.InputError, match="two axes"):
        rg.plot.draw_workspace_and_space(path, scene, verdict=rg.find_blocking_obstacles(cube, cell=(1, 1, 0)))


def test_paths_of_an_arm_are_drawn_as_paths_of_the_tip(arm, planner) -> None:
    paths = planner.paths([(-0.5, 0.6), (1.0, 0.2)])
    axes = rg.plot.draw_tip_paths(paths, arm)
    (lines,) = (c.get_segments() for c in axes.collections if isinstance(c, LineCollection))
    for line, path in zip(lines, paths, strict=True):
        np.testing.assert_allclose(line[[0, -1]], ARM.tip(path.points[[0, -1]]))


def test_the_clearance_curve_shows_the_means() -> None:
    cell = np.zeros((12, 9), dtype=np.uint8)
    cell[5, 2:], cell[11, 8] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    curve = rg.planning.clearance_curve(rg.plan(space_of(cell), k=0.5), (0.0, 0.5, 1.0), [(1.5, 7.5), (2.5, 4.5)])
    axes = rg.draw(curve, unit="m", cell=1.0)
    np.testing.assert_allclose(lines_of(axes)["mean of 2 starts"], np.stack([curve.value, curve.mean], axis=1))
    assert axes.get_ylabel().endswith("(m)")


def test_shortcuts_and_blocking_obstacles_of_scenes_are_drawn() -> None:
    scene = rg.parse_scene(ROOM, "room")
    short = rg.shortcut(rg.plan(scene).path((0.5, 0.5)))
    for path in (short, rg.Polyline(short.points, short.space)):
        (lines,) = [lines for lines in rg.draw(path).collections if lines.get_label() == "path"]
        assert any(np.array_equal(line, short.points) for line in lines.get_segments())
    verdict = rg.find_blocking_obstacles(scene, (5.5, 4.5))
    assert verdict.separating == ("obstacle[0]",) and rg.draw(verdict).get_legend() is not None
    for value in (
        short,
        rg.Polyline(short.points, short.space),
        rg.plan(scene),
        rg.time_parameterize(short, velocity_limits=1.0),
    ):
        assert len(repr(value)) < 500 and "[" not in repr(value)
