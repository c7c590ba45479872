"""Paths of several legs, compared with brute-force distances, flood fill and shapely."""

import json
from pathlib import Path

import numpy as np
import pytest
import shapely
import yaml
from PIL import Image
from scipy import ndimage
from support.cli import call

import resgrid as rg

AXES = (rg.Axis("x", 0.0, 4.0, 40), rg.Axis("y", 0.0, 3.0, 30))
HEAD = (
    'schema = 1\ngrid.axes = [\n{ name = "x", lower = 0, upper = 4, cells = 40 },\n'
    '{ name = "y", lower = 0, upper = 3, cells = 30 } ]\n'
)


MAP_KEYS = "image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


def random_scene(rng, radius=0.0):
    walls = tuple(
        rg.Box(tuple(corner), tuple(corner + rng.uniform(0.1, 0.9, 2)))
        for corner in rng.uniform((-0.2, -0.2), (3.8, 2.8), (9, 2))
    )
    robot = rg.PointRobot(radius)
    return rg.Scene(AXES, robot=robot, obstacles=walls, goals=(rg.GoalPoint(tuple(rng.uniform((0, 0), (4, 3)))),))


def free_of(scene):
    return rg.build_space(rg.Scene(AXES, robot=scene.robot, obstacles=scene.obstacles), require_goal=False)


def certify_legs(path):
    for leg in path.legs:
        assert leg.certified == isinstance(leg.path, rg.Streamline)
        if leg.certified:
            rg.certify(leg.path)
    ends = [leg.path.points[-1] for leg in path.legs[:-1]]
    starts = [leg.path.points[0] for leg in path.legs[1:]]
    assert np.allclose(ends, starts) if ends else True


@pytest.mark.slow
def test_the_nearest_reachable_place_equals_brute_force():
    """The reference labels the start's region by scipy and takes the smallest distance of its boxes from the goal."""
    rng, seen = np.random.default_rng(0), set()
    for number in range(60):
        scene, start = random_scene(rng, float(rng.choice([0.0, 0.12]))), rng.uniform((0, 0), (4, 3))
        if number % 2:
            scene = scene.replace(obstacles=(*scene.obstacles, rg.Box((2.0, -1.0), (2.1, 4.0))))
        space = free_of(scene)
        path = rg.plan_legs(scene, start, approximate=True)
        certify_legs(path)
        seen.add(str(path.outcome))
        cell, goal = tuple(space.locate(start)), scene.goals[0].point
        if space.cell[cell] == rg.Cell.OBSTACLE:
            assert path.outcome == "start_blocked" and path.legs == () and path.distance is None
            continue
        region, _ = ndimage.label(space.cell != rg.Cell.OBSTACLE)
        own = region == region[cell]
        if own[tuple(space.locate(goal))]:
            assert path.outcome == "reached" and path.distance is None
            assert path.points[-1] == pytest.approx(goal)
            continue
        centres = np.array([axis.centres[index] for axis, index in zip(AXES, np.nonzero(own), strict=True)])
        gap = np.maximum(np.abs(centres.T - goal) - 0.05, 0)
        assert path.distance == pytest.approx(np.linalg.norm(gap, axis=1).min(), abs=1e-6)
        assert np.linalg.norm(path.points[-1] - goal) == pytest.approx(path.distance, abs=1e-6)
        is_enclosed = space.cell[tuple(space.locate(goal))] == rg.Cell.OBSTACLE
        assert path.outcome == ("goal_blocked" if is_enclosed else "no_path") and path.reason
        assert [leg.kind for leg in path.legs] == ["approximate"]
    assert seen == {"reached", "no_path", "goal_blocked", "start_blocked"}


def test_without_approximate_a_blocked_goal_is_an_error_and_a_cut_off_one_has_no_legs():
    scene = rg.Scene(AXES, obstacles=(rg.Box((2.0, -1.0), (2.2, 4.0)),), goals=(rg.GoalPoint((3.0, 1.0)),))
    path = rg.plan_legs(scene, (1.0, 1.0))
    assert path.outcome == "no_path" and path.legs == () and "separate" in path.reason
    assert path.points.tolist() == [[1.0, 1.0]] and path.certified
    with pytest.raises(rg.InputError, match=r"goal\[0\].* lies in an obstacle"):
        rg.plan_legs(scene.replace(goal=(2.1, 1.0)), (1.0, 1.0))


@pytest.mark.slow
def test_a_disc_leaves_the_inflated_zone_by_the_shortest_line():
    """The reference searches all free cells with a path whose line to the start crosses no obstacle (shapely)."""
    rng, count = np.random.default_rng(3), 0
    for _ in range(150):
        scene, start = random_scene(rng, 0.2), rng.uniform((0.1, 0.1), (3.9, 2.9))
        solid = shapely.union_all([shapely.box(*wall.lower, *wall.upper) for wall in scene.obstacles])
        space = free_of(scene)
        if space.cell[tuple(space.locate(scene.goals[0].point))] == rg.Cell.OBSTACLE:
            continue
        path = rg.plan_legs(scene, start, escape=True)
        certify_legs(path)
        if space.cell[tuple(space.locate(start))] != rg.Cell.OBSTACLE:
            assert path.certified and all(leg.kind == "goal" for leg in path.legs)
            continue
        if not path.legs:
            assert path.outcome == "start_blocked"
            continue
        count += 1
        first = path.legs[0]
        assert first.kind == "escape" and not first.certified and not path.certified
        line = shapely.LineString(first.path.points)
        assert line.distance(solid) > 0 and path.points[0] == pytest.approx(start)
        goal_space = rg.build_space(scene)
        for cell in np.argwhere(goal_space.goal_connected | (goal_space.cell == rg.Cell.GOAL)):
            centre = space.centre(cell)
            nearest = np.clip(start, centre - 0.05, centre + 0.05)
            if np.linalg.norm(nearest - start) < line.length - 1e-6:  # a shorter line must cross an obstacle's cells
                assert shapely.LineString([start, nearest]).distance(solid) < 0.15
        assert path.outcome == "reached" and path.legs[1].kind == "goal"
    assert count > 15


def test_starts_inside_obstacles_stay_blocked():
    wall = rg.Box((1.0, 1.0), (2.0, 2.0))
    scene = rg.Scene(AXES, robot=rg.PointRobot(0.2), obstacles=(wall,), goals=(rg.GoalPoint((3.5, 2.5)),))
    inside = rg.plan_legs(scene, (1.5, 1.5), escape=True)
    assert inside.outcome == "start_blocked" and inside.legs == ()
    near = rg.plan_legs(scene, (2.15, 1.45), escape=True)
    assert [leg.kind for leg in near.legs] == ["escape", "goal"] and near.legs[0].path.points[-1][0] > 2.2
    assert rg.plan_legs(scene, (2.15, 1.45)).outcome == "start_blocked"
    with pytest.raises(rg.InputError, match="escape applies to discs"):
        rg.plan_legs(scene.replace(robot=rg.PointRobot()), (1.5, 1.5), escape=True)


def test_intermediate_places_are_visited_in_order_by_certified_legs():
    scene = rg.Scene(AXES, obstacles=(rg.Box((1.9, 0.0), (2.1, 2.0)),), goals=(rg.GoalPoint((3.5, 0.5)),))
    via = [(0.5, 2.5), (3.5, 2.5), (2.5, 0.5)]
    path = rg.plan_legs(scene, (0.5, 0.5), via=via)
    certify_legs(path)
    assert path.outcome == "reached" and path.certified
    assert [leg.kind for leg in path.legs] == ["via", "via", "via", "goal"]
    assert np.allclose([leg.path.points[-1] for leg in path.legs], [*via, (3.5, 0.5)])
    assert path.length == pytest.approx(sum(leg.path.length for leg in path.legs))
    rg.certify_collision_free(path.line)
    assert rg.time_parameterize(path.line, velocity_limits=1.0).duration == pytest.approx(path.length)
    changes = np.flatnonzero(np.diff(path.leg_of_points)) + 1
    assert np.allclose(path.points[changes - 1], via)


def test_intermediate_places_in_obstacles_or_without_a_path_are_named():
    wall = rg.Box((2.0, -1.0), (2.2, 4.0))
    scene = rg.Scene(AXES, obstacles=(wall,), goals=(rg.GoalPoint((1.5, 0.5)),))
    with pytest.raises(rg.InputError, match=r"via\[1\]: the point \[2.1, 1.0\] lies in an obstacle"):
        rg.plan_legs(scene, (0.5, 0.5), via=[(1.0, 1.0), (2.1, 1.0)])
    path = rg.plan_legs(scene, (0.5, 0.5), via=[(1.0, 1.0), (3.0, 1.0)], approximate=True)
    assert path.outcome == "no_path" and path.reason.startswith("obstacles separate via[0] from via[1]; ")
    assert len(path.legs) == 1


@pytest.mark.parametrize(
    ("start", "via", "goal", "ends"),
    [
        ("0,0", ["1,3"], "6,2", ("via[0] from every goal", "to a goal that via[0] can reach is cell (2, 2);")),
        ("6,0", ["1,3"], "6,2", ("the start from via[0]", "to via[0] that the start can reach is cell (4, 3);")),
        ("0,0", ["6,3"], "6,2", ("the start from via[0]", "with a path to via[0] is (4.5, 0.5), cell (4, 0);")),
        ("0,0", ["1,1", "6,3"], "1,2", ("via[0] from via[1]", "to via[1] that via[0] can reach is cell (2, 3);")),
    ],
)
def test_a_leg_without_a_path_names_its_ends_and_a_remedy_that_opens_it(tmp_path, start, via, goal, ends):
    """The remedy for the named end, applied as given, leads to the goal."""
    cell = np.zeros((7, 5), np.uint8)
    cell[3] = 1
    np.save(tmp_path / "wall.npy", cell)
    places = {"start": start, "goal": goal, **{f"via[{number}]": place for number, place in enumerate(via)}}

    def run():
        words = [f"--{name.partition('[')[0]}={place}" for name, place in places.items()]
        return call("path", tmp_path / "wall.npy", "--cells", *words)

    failed = run()
    assert (
        failed.exit_code == 1 and f"no_path: obstacles separate {ends[0]}; the nearest place {ends[1]}" in failed.stdout
    )
    moved = "start" if "with a path to" in ends[1] else "goal" if "to a goal" in ends[1] else ends[1].split()[1]
    places[moved] = ends[1].rpartition("cell (")[2].partition(")")[0].replace(" ", "")
    assert run().exit_code == 0


def test_remedies_of_paths_through_intermediate_places_open_every_leg(tmp_path):
    """A gap of three cells for a disc; twice as many cells resolve it for the leg that passes the gap."""
    grey = np.full((20, 30), 254, np.uint8)
    grey[:8, 15] = grey[11:, 15] = 0
    Image.fromarray(grey).save(tmp_path / "map.pgm")
    (tmp_path / "map.yaml").write_text(MAP_KEYS)
    words = ("path", tmp_path / "map.yaml", "--robot-radius", "0.12", "--start", "0.3,1", "--goal", "0.3,0.5")
    failed = call(*words, "--via", "2.5,1")
    assert failed.exit_code == 1 and "obstacles separate the start from via[0]" in failed.stdout
    count = failed.stdout.partition("--refine ")[2].partition(" ")[0]
    assert call(*words, "--via", "2.5,1", "--refine", count).exit_code == 0


def test_a_start_in_the_inflated_zone_has_the_same_reason_with_every_option(tmp_path):
    grey = np.full((20, 30), 254, np.uint8)
    grey[:, 0] = 0
    Image.fromarray(grey).save(tmp_path / "map.pgm")
    (tmp_path / "map.yaml").write_text(MAP_KEYS)
    words = ("path", tmp_path / "map.yaml", "--robot-radius", "0.35", "--cells", "--start", "2,10", "--goal")
    why = "start_blocked: the start lies too near to an obstacle for the robot's radius of 0.35 (cell (2, 10)); "
    for options in (["20,10"], ["20,10", "--approximate"], ["0,10", "--approximate"], ["20,10", "--via", "10,5"]):
        blocked = call(*words, *options)
        assert blocked.exit_code == 1 and why in blocked.stdout and "--escape of 'resgrid path'" in blocked.stdout
    assert call(*words, "20,10", "--via", "10,5", "--escape").exit_code == 0
    scene = rg.read_scene(tmp_path / "map.yaml", goal=rg.GoalCell((20, 10)), robot=rg.DiscRobot(0.35))
    assert why.removeprefix("start_blocked: ") in rg.plan_legs(scene, (0.25, 1.05), via=[rg.GoalCell((10, 5))]).reason
    assert "or too near to one for the robot's radius of 0.35" in rg.plan(scene).path((0.25, 1.05)).reason
    snapshot = rg.maps.MapSnapshot(np.where(grey == 0, 100, 0), 0.1, start=(0.25, 1.05, 0.0))
    streamed = rg.maps.StreamPlanner(goal=(2.05, 1.05), robot=rg.DiscRobot(0.35)).plan(snapshot)
    assert streamed.outcome == "start_blocked" and why.removeprefix("start_blocked: ") in streamed.reason
    inside = call(*words[:-2], "0,10", "--goal", "20,10")
    assert "the start lies in an obstacle (cell (0, 10))" in inside.stdout and "--escape" not in inside.stdout


def test_an_intermediate_cell_is_passed_at_its_centre():
    scene = rg.Scene(AXES, goals=(rg.GoalPoint((3.5, 0.5)),))
    path = rg.plan_legs(scene, (0.5, 0.5), via=[rg.GoalCell((20, 15))])
    assert path.legs[0].path.points[-1] == pytest.approx((2.05, 1.55))


def test_poses_of_a_footprint_are_visited_with_their_heading():
    robot = rg.PolygonRobot(((-0.2, -0.1), (0.2, -0.1), (0.2, 0.1), (-0.2, 0.1)))
    axes, turn = (*AXES, robot.turning_axis(12)), robot.turning_length
    scene = rg.Scene(axes, robot=robot, goals=(rg.GoalPoint((3.0, 2.0)),))
    path = rg.plan_legs(scene, (0.6, 0.6, 0.1 * turn), via=[(2.0, 1.0, 2.0 * turn), (1.0, 2.0)])
    certify_legs(path)
    assert path.legs[0].path.points[-1] == pytest.approx((2.0, 1.0, 2.0 * turn))
    assert path.legs[1].path.points[-1][:2] == pytest.approx((1.0, 2.0)) and path.outcome == "reached"
    assert np.abs(np.diff(path.points[:, 2])).max() < np.pi * turn


def test_rotated_maps_give_the_same_legs_as_straight_ones(tmp_path):
    from PIL import Image

    grey = np.full((30, 40), 254, np.uint8)
    grey[:, 20] = 0
    Image.fromarray(grey).save(tmp_path / "map.pgm")
    ends = []
    for yaw in (0.0, 0.6):
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        keys = "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
        (tmp_path / "map.yaml").write_text(f"image: map.pgm\nresolution: 0.1\norigin: [0, 0, {yaw}]\n{keys}")
        scene = rg.read_scene(tmp_path / "map.yaml", goal=tuple(turn @ (3.0, 1.0)), robot=rg.PointRobot(0.15))
        path = rg.plan_legs(scene, turn @ (1.82, 2.0), via=[turn @ (0.5, 0.5)], approximate=True, escape=True)
        certify_legs(path)
        assert [leg.kind for leg in path.legs] == ["escape", "via", "approximate"]
        ends.append((path.points @ turn, path.distance))
    assert ends[0][0] == pytest.approx(ends[1][0], abs=1e-6) and ends[0][1] == pytest.approx(ends[1][1])


def write_scene(folder, extra=""):
    text = HEAD + "goal = [{ point = [3.0, 1.5], heading = 1.0 }]\nstarts = [[1.82, 1.5]]\n" + extra
    text += 'robot = { type = "disc", radius = 0.15 }\n[[obstacle]]\nshape = "rectangle"\n'
    (folder / "a.toml").write_text(text + "lower = [2.0, 0.0]\nupper = [2.1, 2.0]\n")
    return folder / "a.toml"


@pytest.mark.parametrize("suffix", ["csv", "json", "npz", "yaml"])
def test_files_hold_all_legs_and_mark_the_uncertified_one(tmp_path, suffix):
    file, target = write_scene(tmp_path), tmp_path / f"path.{suffix}"
    done = call("path", file, "--escape", "--via", "1.0,2.5", "-o", target)
    assert done.exit_code == 0, done.stderr
    assert "reached; ends at (3, 1.5)" in done.stdout and "legs: escape (not certified), via, goal" in done.stdout
    path = rg.plan_legs(rg.read_scene(file), (1.82, 1.5), via=[(1.0, 2.5)], escape=True)
    if suffix == "csv":
        table = np.genfromtxt(target, delimiter=",", names=True, dtype=None, encoding="utf-8")
        assert np.allclose(np.column_stack([table["x"], table["y"]]), path.points)
        assert (table["certified"] == (table["leg"] != 0)).all() and set(table["kind"]) == {"escape", "via", "goal"}
    elif suffix == "json":
        (record,) = json.loads(target.read_text())["paths"]
        assert np.allclose(record["points"], path.points) and record["outcome"] == "reached"
        assert [leg["certified"] for leg in record["legs"]] == [False, True, True] and not record["certified"]
        assert record["distance"] is None and record["approximate"] is False
    elif suffix == "npz":
        with np.load(target) as arrays:
            assert np.allclose(arrays["x_0"], path.points[:, 0]) and arrays["outcome"].tolist() == ["reached"]
    else:
        assert target.read_text().startswith("# reached, not certified: leg 0\n")
        poses = yaml.safe_load(target.read_text())["poses"]
        assert len(poses) == len(path.points)
        last = poses[-1]["pose"]["orientation"]
        assert 2 * np.arctan2(last["z"], last["w"]) == pytest.approx(1.0)
    saved = rg.save(path, tmp_path / f"own.{suffix}")
    assert saved.stat().st_size > 100


def test_approximate_paths_exit_with_1_and_report_the_distance(tmp_path):
    file = write_scene(tmp_path)
    words = ("path", file, "--goal", "2.05,1.0", "--start", "1.0,1.0")
    assert call(*words).exit_code == 2
    done = call(*words, "--approximate", "-o", tmp_path / "a.yaml")
    assert done.exit_code == 1 and "goal_blocked" in done.stdout and "from the goal, length" in done.stdout
    assert (tmp_path / "a.yaml").read_text().startswith("# goal_blocked, ends 0.25")
    data = json.loads(call(*words, "--approximate", "--json").stdout)["paths"][0]
    assert data["outcome"] == "goal_blocked" and data["distance"] == pytest.approx(0.25, abs=1e-3)
    assert data["approximate"] is True and data["certified"] is True
    blocked = call("path", file, "--start", "2.05,1.0", "--approximate", "-o", tmp_path / "b.yaml")
    assert blocked.exit_code == 1 and not Path(tmp_path / "b.yaml").exists() and "start_blocked" in blocked.stdout


@pytest.mark.parametrize("words", [("--shorten",), ("--speed", "1"), ("--method", "direct")])
def test_options_that_do_not_fit_legs_are_rejected(tmp_path, words):
    done = call("path", write_scene(tmp_path), "--approximate", *words)
    assert done.exit_code == 2 and "paths of several legs" in done.stderr


def test_arms_and_scenes_without_goals_are_rejected():
    arm = rg.Arm(lengths=(1.0, 1.0))
    scene = rg.Scene(arm.axes(16), robot=arm, goals=(rg.GoalPoint((1.0, 1.0)),))
    with pytest.raises(rg.InputError, match="not to arms"):
        rg.plan_legs(scene, (0.5, 0.5), approximate=True)
    with pytest.raises(rg.InputError, match="there is no goal"):
        rg.plan_legs(rg.Scene(AXES), (0.5, 0.5))


def test_the_reason_of_a_blocked_goal_is_kept():
    wall = rg.Box((2.0, 0.0), (2.2, 2.0))
    scene = rg.Scene(AXES, obstacles=(wall,), goals=(rg.GoalPoint((2.1, 1.0)),), starts=((1.0, 1.0),))
    path = rg.plan_legs(scene, (1.0, 1.0), approximate=True)
    assert path.reason.startswith("goal[0]: the point [2.1, 1.0] lies in an obstacle")
    outside = rg.plan_legs(scene.replace(goal=(4.5, 1.0)), (1.0, 1.0), approximate=True)
    assert "lies outside the grid" in outside.reason and outside.distance == pytest.approx(0.5, abs=1e-6)
