"""All kinds of robots on ROS maps, compared with shapely intersections, and scenes made in Python.

Tests internals: `resgrid.scene.overrides`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from shapely import affinity
from support.dumbbell import Dumbbell

import resgrid as rg
from resgrid.scene.overrides import apply_overrides

HEADER = "image: map.pgm\nresolution: 0.1\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
FOOTPRINT = ((-0.35, -0.15), (0.35, -0.15), (0.35, 0.15), (-0.35, 0.15))
YAW = 0.7


def ros_map(folder: Path, origin: str, mode: str = "trinary") -> Path:
    """Two rooms of 2.8 x 4 m joined by a gap of 1.1 m; in scale mode the upper quarter of the second is grey."""
    rows = np.full((40, 60), 255, dtype=np.uint8)
    rows[:, 28:31] = 0
    rows[15:26, 28:31] = 255
    if mode == "scale":
        rows[:10, 31:] = 150
    (folder / "map.pgm").write_bytes(b"P5 60 40 255 " + rows.tobytes())
    (folder / "map.yaml").write_text(f"{HEADER}origin: {origin}\nmode: {mode}\n")
    return folder / "map.yaml"


@pytest.fixture
def turned(tmp_path: Path) -> Path:
    return ros_map(tmp_path, f"[3.0, -2.0, {YAW}]")


def walls_in_world(scene: rg.Scene) -> shapely.Geometry:
    """Obstacle cells of the map, in world coordinates."""
    assert scene.map is not None
    cells = [shapely.box(x / 10, y / 10, (x + 1) / 10, (y + 1) / 10) for x, y in np.argwhere(scene.map.cell == 1)]
    inside = affinity.rotate(shapely.unary_union(cells), scene.frame.yaw, origin=(0, 0), use_radians=True)
    return affinity.translate(inside, scene.frame.x, scene.frame.y)


def test_a_footprint_on_a_turned_map_passes_a_gap_without_collision(turned: Path) -> None:
    frame = rg.read_scene(turned).frame
    goal, start = (tuple(map(float, frame.to_world(place))) for place in ((5.0, 2.0), (1.0, 2.0)))
    scene = rg.read_scene(turned, robot=rg.PolygonRobot(FOOTPRINT), headings=24, goal=goal, start=(*start, YAW + 1.2))
    assert [axis.cells for axis in scene.axes] == [60, 40, 24]
    path = rg.plan(scene).path(scene.starts[0])
    assert path.outcome == "reached"
    assert np.allclose(path.points[0], (*start, YAW + 1.2))
    assert np.allclose(path.points[-1][:2], goal)
    walls = walls_in_world(scene)
    assert max(scene.robot.shapes_at(pose)[0].intersection(walls).area for pose in path.points[::3]) < 1e-12
    narrow = scene.replace(robot=rg.PolygonRobot(tuple((2 * x, 4 * y) for x, y in FOOTPRINT)))
    assert rg.plan(narrow).path(scene.starts[0]).outcome == "no_path"


def test_a_user_defined_robot_turns_by_its_turning_length(turned: Path) -> None:
    robot = Dumbbell(0.7, 0.15)
    frame = rg.read_scene(turned).frame
    goal, start = (tuple(map(float, frame.to_world(place))) for place in ((5.0, 2.0), (1.0, 2.0)))
    scene = rg.read_scene(turned, robot=robot, headings=24, goal=goal, start=(*start, 0.35 * (YAW + 1.2)))
    assert scene.axes[2] == rg.Axis("theta", 0.0, 0.7 * np.pi, 24, periodic=True)
    path = rg.plan(scene).path(scene.starts[0])
    assert path.outcome == "reached"
    walls = walls_in_world(scene)
    assert max(part.intersection(walls).area for pose in path.points[::3] for part in robot.shapes_at(pose)) < 1e-12
    with pytest.raises(rg.InputError, match="a robot that turns needs 3 axes"):
        rg.Scene(scene.axes[:2], robot=robot)


def test_the_frame_of_a_scene_moves_its_map(turned: Path) -> None:
    frame = rg.Frame(5.0, 6.0, 0.3)
    moved = rg.read_scene(turned).replace(frame=frame)
    assert moved.map is not None
    assert moved.map.frame == frame
    assert moved.replace(robot=rg.DiscRobot(0.1)).frame == frame
    assert apply_overrides(moved, {"title": "moved"}).frame == frame


def test_a_footprint_in_a_file_has_headings_of_start_and_goal(turned: Path) -> None:
    x, y = rg.read_scene(turned).frame.to_world((5.05, 2.05))
    file = turned.with_name("scene.toml")
    file.write_text(
        f"schema = 1\n[map]\nfile = 'map.yaml'\nheadings = 24\n[robot]\nfootprint = {[list(p) for p in FOOTPRINT]}\n"
        f"turning_length = 0.5\n[[goal]]\npoint = [{x}, {y}, {0.5 * (YAW + 0.1)}]\n[[obstacle]]\nshape = 'circle'\n"
        f"centre = [{x}, {y - 1.2}]\nradius = 0.2\n"
    )
    scene = rg.read_scene(file)
    space = rg.build_space(scene)
    assert np.argwhere(space.cell == rg.Cell.GOAL).tolist() == [[50, 20, 0]]
    assert np.allclose(space.goal_points, [(5.05, 2.05, 0.05)])
    bare = rg.build_space(scene.replace(obstacles=()))
    assert (space.cell == rg.Cell.OBSTACLE).sum() > (bare.cell == rg.Cell.OBSTACLE).sum()
    changed = apply_overrides(scene, {"start": f"{x},{y},1.0", "map.headings": "12"})
    assert (changed.axes[2].cells, changed.robot, changed.frame) == (12, scene.robot, scene.frame)
    assert changed.starts == ((x, y, 1.0),)
    square = apply_overrides(rg.read_scene(turned), {"robot.footprint": "[[0, 0], [0.2, 0], [0, 0.2]]"})
    assert (square.ndim, square.robot.turning_length) == (3, 1.0)
    disc = rg.build_space(scene.replace(robot=rg.DiscRobot(0.2), goal=(x, y)))
    assert disc.shape == (60, 40)


def test_an_arm_uses_a_map_as_its_workspace(tmp_path: Path) -> None:
    ros_map(tmp_path, "[0, 0, 0]")
    text = (
        "schema = 1\n[robot]\ntype = 'arm'\nbase = [1.5, 2.0]\nlinks = [{ length = 1.0 }, { length = 0.9 }]\n"
        "[map]\nfile = 'map.yaml'\n[[goal]]\npoint = [3.2, 2.2]\n"
    )
    with pytest.raises(rg.InputError, match=r"needs a \[grid\] for its joints"):
        rg.parse_scene(text, folder=tmp_path)
    scene = rg.parse_scene(text + "[grid]\ncells = 48\n", folder=tmp_path)
    space = rg.build_space(scene)
    free = space.axis_centre(np.argwhere(space.cell != rg.Cell.OBSTACLE))
    walls = walls_in_world(scene)
    poses = np.concatenate([free, space.goal_points])
    assert not any(shapely.intersects(walls, scene.robot.shapes_at(pose)).any() for pose in poses)
    assert 0 < (space.cell == rg.Cell.OBSTACLE).sum() < space.cell.size
    longer = rg.Arm((1.0, 1.0), base=(1.5, 2.0))
    assert scene.replace(robot=longer, start=(0, 0)).axes == apply_overrides(scene, {"title": "x"}).axes == scene.axes


def test_axes_of_a_map_may_be_periodic(tmp_path: Path) -> None:
    file = ros_map(tmp_path, "[0, 0, 0]")
    scene = rg.read_scene(file, periodic="y", goal=(5, 2))
    assert [axis.periodic for axis in scene.axes] == [False, True]
    assert scene.edge == ("obstacle", "periodic")
    with pytest.raises(rg.InputError, match=r"map\.periodic: there is no axis 'z'; the map has x, y"):
        rg.read_scene(file, periodic=["z"])


def test_occupancies_below_lethal_become_conductivities_on_request(tmp_path: Path) -> None:
    file = ros_map(tmp_path, "[0, 0, 0]", "scale")
    assert rg.build_space(rg.read_scene(file, goal=(5, 2))).conductivity is None
    space = rg.build_space(rg.read_scene(file, goal=(5, 2), least_conductivity=0.01))
    occupancy = rg.maps.from_occupancy_grid(file).T[40, 35]
    assert 0 < occupancy < 65
    assert space.conductivity[40, 35] == pytest.approx(0.01 ** (occupancy / 65))
    assert space.conductivity[10, 10] == 1.0
    turning = rg.read_scene(file, goal=(5, 2), least_conductivity=0.01, robot=rg.PolygonRobot(FOOTPRINT), headings=8)
    assert np.array_equal(rg.build_space(turning).conductivity[..., 3], space.conductivity)


def test_a_complete_scene_is_made_in_python() -> None:
    axes = (rg.Axis("x", 0.0, 4.0, 20), rg.Axis("y", 0.0, 3.0, 15))
    scene = rg.Scene(
        axes=axes,
        robot=rg.DiscRobot(0.1),
        obstacles=[rg.Box((1.0, 0.0), (1.4, 2.0)), rg.Ball((3.0, 1.5), 0.3)],
        goals=[rg.GoalPoint((3.5, 0.5))],
        starts=((0.5, 0.5),),
        areas=(rg.CostArea(rg.HalfSpace((0.0, 1.0), 1.0), 0.5),),
        boundary="wall",
        chip=rg.Chip(resistance="4k7", wall_resistance=1e3),
        control=rg.control.Control(speed=0.2),
    )
    assert (scene.chip.resistance, scene.edge) == (4700.0, ("obstacle", "obstacle"))
    assert isinstance(scene.obstacles, tuple)
    assert rg.plan(scene).path(scene.starts[0]).outcome == "reached"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"boundary": "wall"}, "scene: boundary: boundary = \"wall\" needs wall_resistance in [chip]"),
        ({"edge": "periodic"}, "edge[0]: axis 0 is not periodic"),
        ({"axes": ()}, "grid.axes: a scene has 1 to 4 axes, got 0"),
        ({"axes": tuple(rg.Axis(name, 0.0, 1.0, 1) for name in "abcde")}, "a scene has 1 to 4 axes, got 5"),
        ({"k": 2.0}, "k[0] = 2.0 must be a finite number at least 0 and at most 1"),
        ({"goal": (1, 2, 3)}, "goal[0].point: needs 2 coordinates, one for each axis, got 3"),
        ({"start": [(1, 2), (1,)]}, "starts[1]: needs 2 coordinates, one for each axis, got 1"),
        ({"goal": 3}, "goal = 3 must be a list of numbers, a goal, or a list of these"),
        ({"robot": rg.PolygonRobot(FOOTPRINT)}, "grid: a robot that turns needs 3 axes (x, y, theta), got 2"),
        ({"drive": "start", "boundary": "neumann"}, 'drive: drive = "start" needs a start'),
        ({"start": rg.GoalCell((9, 9))}, "start: cell [9, 9] is not in the grid of 4 x 3 cells"),
    ],
)  # fmt: skip
def test_a_scene_made_in_python_is_checked(changes: dict[str, object], message: str) -> None:
    scene = rg.Scene((rg.Axis("x", 0.0, 4.0, 4), rg.Axis("y", 0.0, 3.0, 3)))
    with pytest.raises(rg.InputError) as caught:
        scene.replace(**changes)
    assert message in str(caught.value)
    assert scene.replace(goal=[(3.5, 0.5), rg.GoalCell((0, 2))], start=np.array([0.5, 0.5]), k=[0, 1]).k == (0, 1)
