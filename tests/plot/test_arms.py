"""Pictures of arms in space, of their surroundings, and of slices with undecided cells.

Tests internals: `resgrid.plot.arms`, `resgrid.plot.raster`, `resgrid.plot.style`, `resgrid.robots.surfaces`.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image
from support.hand_made_robot import HandMadeRobot
from support.spaces import space_of

import resgrid as rg
from resgrid.plot.arms import END, SOLID, ArmPicture
from resgrid.plot.figures import figure_of
from resgrid.plot.raster import Camera, Window, composite, render
from resgrid.plot.style import UNDECIDED
from resgrid.robots.body import bodies_of
from resgrid.robots.surfaces import floor_height, link_surfaces, shape_surfaces

ROBOT = HandMadeRobot(tool="hand")
WALL, TARGET = rg.Box((0.3, 0.45, 0.0), (0.5, 0.65, 0.6)), rg.Ball((-0.6, 0.4, 0.3), 0.12)
FRONT = Camera(azimuth=-90.0, elevation=0.0)


@pytest.fixture(scope="module")
def scene() -> rg.Scene:
    return rg.Scene(ROBOT.axes(20), robot=ROBOT, obstacles=(WALL,), goals=(TARGET,), starts=((-0.3, 0.2),))


@pytest.fixture(scope="module")
def planner(scene: rg.Scene) -> rg.planning.Planner:
    return rg.plan(scene, boundary="neumann")


def legend_of(picture) -> list[str]:
    figure = figure_of(picture)
    legends = [*figure.legends, *(axes.get_legend() for axes in figure.axes if axes.get_legend() is not None)]
    return [text.get_text() for legend in legends for text in legend.get_texts()]


@pytest.mark.parametrize(
    ("shape", "volume", "rtol"),
    [
        (rg.Box((1.0, 2.0, 3.0), (2.0, 4.0, 6.0)), 6.0, 1e-12),
        (rg.OrientedBox((1.0, 0.0, 0.0), (1.0, 2.0, 3.0), (0.3, 0.2, 0.1)), 6.0, 1e-12),
        (rg.Ball((1.0, 2.0, 3.0), 0.5), pi / 6, 0.03),
        (rg.Cylinder((0.0, 0.0, 1.0), (1.0, 0.0, 1.0), 0.2), 0.04 * pi, 0.02),
        (rg.Capsule((0.0, 0.0, 1.0), (0.0, 1.0, 1.0), 0.2), 0.04 * pi + 4 / 3 * pi * 0.008, 0.03),
    ],
)
def test_surfaces_are_closed_and_turned_outwards(shape, volume: float, rtol: float) -> None:
    (body,) = bodies_of(shape, "shape")
    (surface,) = link_surfaces(replace(ROBOT.tree, bodies=(body,)))
    a, b, c = surface.points[surface.triangles].swapaxes(0, 1)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(volume, rel=rtol)
    edges = np.concatenate([surface.triangles[:, pair] for pair in ((0, 1), (1, 2), (2, 0))])
    assert sorted(map(tuple, edges.tolist())) == sorted(map(tuple, edges[:, ::-1].tolist()))


def test_a_half_space_is_shown_as_the_part_of_its_border_in_a_box() -> None:
    floor = rg.HalfSpace((0, 0, 2), 1.0)
    (surface,) = shape_surfaces([floor], "floor", ((-1.0, 0.0, 0.0), (3.0, 4.0, 5.0)))
    assert (surface.name, surface.joint) == ("floor[0]", -1)
    assert surface.points[:, 2] == pytest.approx(0.5)
    assert np.ptp(surface.points, axis=0) == pytest.approx([4, 4, 0])
    assert floor_height([WALL, floor, rg.HalfSpace((0, 1, 1), 9.0)], -1.0) == 0.5
    assert floor_height([WALL], -1.0) == -1.0


def square(y: float, low: float, high: float) -> np.ndarray:
    """Return two triangles of a square normal to y."""
    a, b, c, d = ((x, y, z) for x, z in ((low, low), (high, low), (high, high), (low, high)))
    return np.array([(a, b, c), (a, c, d)])


def test_near_surfaces_hide_far_ones_and_areas_are_true() -> None:
    window = Window(-1.0, -1.0, 1.0, 1.0, 400)
    far = render(square(1.0, -0.8, 0.8), np.zeros(2, int), "#ff0000", FRONT, window, 1.0)
    near = render(square(0.0, -0.4, 0.4), np.zeros(2, int), "#0000ff", FRONT, window, 1.0)
    for layer, side in ((far, 1.6), (near, 0.8)):
        assert np.isfinite(layer.depth).mean() * 4 == pytest.approx(side**2, rel=0.01)
    assert far.depth[200, 200] - near.depth[200, 200] == pytest.approx(1.0)
    for layers in ([far, near], [near, far]):
        image = composite(layers)
        assert image.shape == (200, 200, 4)
        assert image[100, 100, :3].argmax() == 2 and image[100, 100, 3] == 255
        assert image[30, 100, :3].argmax() == 0 and image[30, 100, 0] > 100
        assert image[5, 5].tolist() == [0, 0, 0, 0]


def test_a_translucent_surface_shows_the_one_behind_it() -> None:
    window = Window(-1.0, -1.0, 1.0, 1.0, 100)
    far = render(square(1.0, -0.8, 0.8), np.zeros(2, int), "#ff0000", FRONT, window, 1.0)
    near = render(square(0.0, -0.8, 0.8), np.zeros(2, int), "#0000ff", FRONT, window, 0.25)
    red, _, blue, opacity = composite([near, far])[25, 25].tolist()
    assert opacity == 255
    assert blue / red == pytest.approx(1 / 3, rel=0.05)


def test_a_picture_contains_the_robot_at_the_positions_of_its_tool(scene: rg.Scene) -> None:
    pose = np.array([0.4, -0.9])
    picture = ArmPicture(scene, pose[np.newaxis], Camera(azimuth=0.0, elevation=90.0))
    corners = picture.moved(pose).triangles.reshape(-1, 3)
    tool = ROBOT.reference_point(pose[np.newaxis])[0]
    assert np.linalg.norm(corners[:, :2] - tool[:2], axis=1).min() < 0.03
    layer = picture.layer(picture.moved(pose), END)
    column, row, _ = picture.window.pixels(picture.camera.seen(tool * (0.98, 0.98, 1.0)))
    assert np.isfinite(layer.depth[int(row), int(column)])


@pytest.mark.slow
def test_scene_path_and_tool_are_drawn_for_arms_in_space(scene: rg.Scene, planner: rg.planning.Planner) -> None:
    path = planner.path(scene.starts[0])
    assert path.outcome is rg.Outcome.REACHED
    shown = rg.draw(scene)
    assert {"obstacle", "goal", "robot at the start", "tool at the start"} <= set(legend_of(shown))
    axes = rg.plot.draw_robot(path, scene)
    assert {"robot at the start", "robot between", "robot at the end", "path of the tool"} <= set(legend_of(axes))
    assert axes.get_aspect() == 1.0
    line = max(
        (np.asarray(line.get_xydata()) for line in axes.lines if line.get_label() != "path of the tool"), key=len
    )
    tool = ROBOT.reference_point(path.points)
    np.testing.assert_allclose(line[[0, -1]], Camera().seen(tool[[0, -1]])[:, :2], atol=1e-9)
    (image,) = axes.images
    colours = np.asarray(image.get_array())[..., :3].reshape(-1, 3)
    for colour in (END, SOLID):
        best = np.abs(colours - 255 * np.array(to_rgb(colour)) * 0.9).max(axis=1).min()
        assert best < 40
    assert "paths of the tool" in legend_of(rg.plot.draw_tip_paths([path], scene))
    single = rg.plot.draw_robot([scene.starts[0]], scene, ghosts=1)
    assert "robot at the end" not in legend_of(single)
    with pytest.raises(rg.InputError, match="ghosts = 0"):
        rg.plot.draw_robot(path, scene, ghosts=0)


@pytest.mark.slow
def test_goals_are_drawn_as_regions_or_marked_at_their_place(scene: rg.Scene) -> None:
    centre = (-0.6, 0.4, 0.3)
    for goal in (rg.GoalPose(centre, radius=0.1), rg.Ball(centre, 0.1)):
        assert not rg.draw(scene.replace(goal=goal)).findobj(
            lambda artist: artist.get_label() == "goal" and hasattr(artist, "get_offsets")
        )
    place = Camera().seen(np.array(centre))[:2]
    joints = rg.GoalJoints((0.3, 0.4), (0.3, 0.4))
    tool = Camera().seen(ROBOT.reference_point(np.array([[0.3, 0.4]]))[0])[:2]
    for goal, at in ((rg.GoalPose(centre), place), (rg.GoalPoint(centre), place), (joints, tool)):
        (marks,) = [marks for marks in rg.draw(scene.replace(goal=goal)).collections if marks.get_label() == "goal"]
        np.testing.assert_allclose(marks.get_offsets(), [at])


def test_an_arm_of_two_joints_is_drawn_left_of_its_space(scene: rg.Scene, planner: rg.planning.Planner) -> None:
    figure = rg.plot.draw_workspace_and_space(planner.path(scene.starts[0]), scene, title="Title")
    assert [axes.get_title() for axes in figure.axes] == ["Workspace", "Configuration space"]


def test_an_animation_of_a_trajectory_moves_the_arm(tmp_path, scene: rg.Scene, planner: rg.planning.Planner) -> None:
    motion = rg.time_parameterize(rg.shortcut(planner.path(scene.starts[0])))
    seen: list[int] = []
    file = rg.animate(motion, tmp_path / "arm.gif", scene=scene, count=3, progress=seen.append)
    with Image.open(file) as film:
        assert len(seen) == 15
        frames = []
        for number in (0, 1, 2):
            film.seek(number)
            frames.append(np.asarray(film.convert("RGB")).astype(int))
    assert all(np.abs(frames[number] - frames[number + 1]).max() > 60 for number in (0, 1))
    with pytest.raises(rg.InputError, match="give scene"):
        rg.animate(motion, tmp_path / "arm.gif")


def test_proven_colliding_and_undecided_cells_are_counted_in_the_legend() -> None:
    cell = np.zeros((4, 4, 5), dtype=np.uint8)
    cell[1, 1, :4], cell[3, 3, 3] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    plain = space_of(cell)
    undecided = np.zeros(cell.shape, dtype=bool)
    undecided[1, 1, 3] = True
    proven = rg.ConfigurationSpace(plain.axes, cell, undecided=undecided)
    assert {
        "proven free: 75 (93.8 %)",
        "contains a collision: 3 (3.8 %)",
        "undecided: 1 (1.2 %)",
        "goal: 1 (1.2 %)",
    } == set(legend_of(rg.draw(proven)))
    assert {"free", "obstacle", "goal"} == set(legend_of(rg.draw(plain)))
    (panel, *_), pixel = figure_of(rg.draw(proven, axis=2, indices=[3])).axes, np.array(to_rgb(UNDECIDED)) * 255
    assert np.abs(panel.images[-1].get_array()[1, 1, :3] - pixel).max() <= 1
    path = rg.plan(proven).path((0.5, 0.5, 0.5))
    assert "cell of the path" in legend_of(rg.draw(path))
    assert "undecided: 1 (1.2 %)" in legend_of(rg.plot.draw_summary(path.field, [path]))


def test_spaces_of_four_axes_are_drawn_in_slices_of_all_pairs_of_axes() -> None:
    cell = np.zeros((3, 4, 5, 6), dtype=np.uint8)
    cell[0, 1, 2, 3] = rg.Cell.GOAL
    space = space_of(cell)
    field = rg.plan(space, boundary="neumann").field
    panels = [axes for axes in figure_of(rg.draw(field)).axes if axes.get_title()]
    assert len(panels) == 6
    assert "2.5" in panels[0].get_title() and "3.5" in panels[0].get_title() and "goal" in panels[0].get_title()
    chosen = [axes for axes in figure_of(rg.draw(space, axis=3, indices=[0, 3])).axes if axes.get_title()]
    assert ["goal" in axes.get_title() for axes in chosen] == [False, True]
    with pytest.raises(rg.InputError, match=r"axis = 4, but the space has axes 0, 1, 2 and 3"):
        rg.draw(space, axis=4)
    for shown in (rg.draw(space), rg.plot.draw_summary(field, [rg.streamline(field, cell=(2, 3, 0, 0))])):
        assert len([axes for axes in figure_of(shown).axes if axes.get_title()]) == 6
