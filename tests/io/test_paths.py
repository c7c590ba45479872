"""Files are read back by somebody else: csv, json, NumPy, PyYAML.

Tests internals: `resgrid.io.paths`, `resgrid.io.ros_paths`.
"""

from __future__ import annotations

import csv
import json
from math import atan2, pi, sqrt

import numpy as np
import pytest
import yaml
from support.spaces import space_of

import resgrid as rg
from resgrid.io.paths import Route, path_columns, write_path, write_routes
from resgrid.io.ros_paths import headings

PLANE = space_of(np.zeros((10, 10)))
WAY = [(0.5, 1e-5), (3.5, 4.0), (3.5, 8.0)]
ARM = rg.Arm((1.0, 1.0))
TORUS = rg.ConfigurationSpace(ARM.axes(8), np.zeros((8, 8)), robot=ARM)


@pytest.mark.parametrize("suffix", [".csv", ".json", ".npz"])
def test_a_timed_path_of_an_arm_is_read_back_as_it_was(tmp_path, suffix) -> None:
    motion = rg.time_parameterize(
        rg.Polyline([(3.0, 0.0), (3.5, 1.0), (4.0, 1.0)], TORUS), velocity_limits=1.0, acceleration_limits=2.0
    )
    file = write_path(motion, tmp_path / f"path{suffix}")
    if suffix == ".csv":
        rows = list(csv.DictReader(file.read_text().splitlines()))
        own = [{row.pop(name) for row in rows} for name in ("path", "k", "outcome")]
        assert own == [{"0"}, {""}, {""}]  # a path without a field
        found = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    elif suffix == ".json":
        record = json.loads(file.read_text())
        assert [record.pop(name) for name in ("schema", "k", "outcome")] == [1, None, None]
        found = {name: np.array(column) for name, column in record.items()}
    else:
        with np.load(file) as arrays:
            found = dict(arrays)
        assert np.isnan(found.pop("k")) and found.pop("outcome") == ""
    assert list(found) == ["t", "theta_1", "theta_2", "tip_x", "tip_y", "theta_1_rate", "theta_2_rate"]
    np.testing.assert_array_equal(found["t"], motion.times)
    np.testing.assert_array_equal(found["theta_1"], motion.positions[:, 0])
    np.testing.assert_array_equal(found["theta_2_rate"], motion.velocities[:, 1])
    np.testing.assert_allclose(found["tip_x"], np.cos(found["theta_1"]) + np.cos(found["theta_1"] + found["theta_2"]))
    assert [entry.name for entry in tmp_path.iterdir()] == [file.name]


def test_a_plan_for_ros_has_poses_in_the_world_that_look_ahead() -> None:
    space = rg.ConfigurationSpace(PLANE.axes, PLANE.cell, frame=rg.Frame(x=10.0, y=-2.0, yaw=pi / 2))
    motion = rg.time_parameterize(rg.Polyline(space.to_world(WAY), space), velocity_limits=(1.0, 1.0))
    plan = yaml.safe_load(rg.maps.to_ros_path(motion))
    assert plan["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "map"}
    places = [(p["pose"]["position"]["x"], p["pose"]["position"]["y"]) for p in plan["poses"]]
    np.testing.assert_allclose(places, [(10 - y, -2 + x) for x, y in WAY])
    yaws = [
        2 * atan2(p["pose"]["orientation"]["z"], p["pose"]["orientation"]["w"]) for p in plan["poses"]
    ]  # fmt: skip
    np.testing.assert_allclose(np.cos(yaws), np.cos([atan2(4 - 1e-5, 3) + pi / 2, pi, pi]))
    assert [p["header"]["stamp"] for p in plan["poses"]][1:] == [
        {"sec": 3, "nanosec": 999990000}, {"sec": 7, "nanosec": 999990000},
    ]  # fmt: skip
    assert all(type(value) is float for p in plan["poses"] for value in p["pose"]["position"].values())


def test_a_turning_polygon_keeps_its_own_heading() -> None:
    bar = rg.PolygonRobot(((0, 0), (1, 0), (0, 1)), turning_length=2.0)
    poses = rg.ConfigurationSpace(
        [rg.Axis("x", 0, 4, 4), rg.Axis("y", 0, 4, 4), bar.turning_axis(4)], np.zeros((4, 4, 4)), robot=bar
    )
    plan = yaml.safe_load(rg.maps.to_ros_path(rg.Polyline([(1, 1, pi), (2, 1, pi)], poses)))
    quaternion = plan["poses"][0]["pose"]["orientation"]
    assert (quaternion["z"], quaternion["w"]) == (pytest.approx(sqrt(0.5)), pytest.approx(sqrt(0.5)))


def test_headings_outlast_repeated_points() -> None:
    places = np.array([(0, 0), (0, 0), (0, 1), (0, 1), (1, 1), (1, 1)], dtype=float)
    np.testing.assert_allclose(headings(places), [pi / 2, pi / 2, 0, 0, 0, 0])
    np.testing.assert_array_equal(headings(np.ones((2, 2))), [0, 0])


def test_velocities_turn_with_the_frame() -> None:
    space = rg.ConfigurationSpace(PLANE.axes, PLANE.cell, frame=rg.Frame(5.0, 5.0, pi / 2))
    columns = path_columns(
        rg.time_parameterize(rg.Polyline(space.to_world([(0, 0), (2, 0)]), space), velocity_limits=1.0)
    )
    np.testing.assert_allclose((columns["x_rate"], columns["y_rate"]), [(0, 0), (1, 0)], atol=1e-12)
    np.testing.assert_allclose((columns["x"], columns["y"]), [(5, 5), (5, 7)], atol=1e-12)


@pytest.mark.parametrize(
    ("names", "suffix", "robot", "timed"),
    [
        (("t", "x"), ".csv", None, True),
        (("x", "x_rate"), ".npz", None, True),
        (("schema", "x"), ".json", None, False),
        (("tip_x", "x"), ".csv", ARM, False),
    ],
)
def test_no_column_is_lost_to_an_axis_of_its_name(tmp_path, names, suffix, robot, timed) -> None:
    space = rg.ConfigurationSpace([rg.Axis(name, 0.0, 4.0, 4) for name in names], np.zeros((4, 4)), robot=robot)
    own = rg.Polyline([(1, 1), (2, 2)], space)
    way = rg.time_parameterize(own, velocity_limits=1.0) if timed else own
    named = next(name for name in names if name != "x")
    with pytest.raises(rg.InputError, match=f"axis '{named}' has the name"):
        write_path(way, tmp_path / f"path{suffix}")
    assert not list(tmp_path.iterdir())
    plain = rg.Polyline([(1, 1), (2, 2)], rg.ConfigurationSpace(space.axes, space.cell))
    head = write_path(plain, tmp_path / "path.csv").read_text().splitlines()[0]
    assert head == ",".join(("path", "k", "outcome", *names))


@pytest.mark.parametrize("name", ["k", "outcome"])
def test_no_axis_has_the_name_of_a_figure(tmp_path, name) -> None:
    space = rg.ConfigurationSpace([rg.Axis(name, 0.0, 4.0, 4), rg.Axis("x", 0.0, 4.0, 4)], np.zeros((4, 4)))
    for suffix in (".csv", ".json", ".npz"):
        with pytest.raises(rg.InputError, match=f"axis '{name}' has the name"):
            write_path(rg.Polyline([(1, 1), (2, 2)], space), tmp_path / f"path{suffix}")


def test_what_cannot_be_written_is_refused(tmp_path) -> None:
    with pytest.raises(rg.InputError, match=r"must end in \.csv, \.json, \.npz or \.yaml"):
        write_path(rg.Polyline(WAY, PLANE), tmp_path / "path.txt")
    with pytest.raises(rg.InputError, match="Arm with axes theta_1, theta_2"):
        write_path(rg.Polyline(WAY, TORUS), tmp_path / "path.yaml")
    with pytest.raises(rg.InputError, match="poses in the plane"):
        rg.maps.to_ros_path(rg.Polyline([(0, 0, 0)], space_of(np.zeros((2, 2, 2)))))
    with pytest.raises(rg.InputError, match="directory"):
        (tmp_path / "folder.csv").mkdir()
        write_path(rg.Polyline(WAY, PLANE), tmp_path / "folder.csv")
    with pytest.raises(rg.InputError, match="shape"):
        write_path(rg.Polyline([(1, 2, 3)], PLANE), tmp_path / "path.csv")


RING = """schema = 1
robot = { type = "arm", links = [{ length = 1.0, width = 0.04 }, { length = 0.6, width = 0.04 }] }
starts = [[3.0, 0.3]]
[grid]
cells = [48, 48]
[[obstacle]]
shape = "circle"
centre = [0.3, -1.0]
radius = 0.15
[[goal]]
joints = [-3.0, 0.3]
"""


@pytest.fixture(scope="module")
def ring_path() -> rg.Streamline:
    """A streamline of an arm that crosses the seam of its first joint."""
    scene = rg.parse_scene(RING)
    return rg.plan(scene).path(scene.starts[0])


@pytest.mark.parametrize("kind", ["streamline", "short", "timed"])
def test_files_of_one_format_hold_the_same_whatever_writes_them(ring_path, tmp_path, kind) -> None:
    """Coordinates go on across a seam; the start lies in the range of the axis."""
    path = ring_path if kind == "streamline" else rg.shortcut(ring_path)
    path = rg.time_parameterize(path, velocity_limits=1.0) if kind == "timed" else path
    routes = [Route(path, tuple(ring_path.points[0].tolist()))]
    names = ["t"] * (kind == "timed") + ["theta_1", "theta_2", "tip_x", "tip_y"]
    for suffix in (".csv", ".json", ".npz"):
        write_path(path, tmp_path / f"one{suffix}")
        write_routes(routes, tmp_path / f"many{suffix}")
    assert (tmp_path / "one.csv").read_bytes() == (tmp_path / "many.csv").read_bytes()
    one, many = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("one", "many"))
    (record,) = many["paths"]
    with np.load(tmp_path / "one.npz") as single, np.load(tmp_path / "many.npz") as several:
        rows = list(csv.DictReader((tmp_path / "one.csv").read_text().splitlines()))
        for name in names:
            column = [float(row[name]) for row in rows]
            assert one[name] == record["columns"][name] == column
            np.testing.assert_array_equal(single[name], column)
            np.testing.assert_array_equal(several[f"{name}_0"], column)
        assert {str(single["outcome"]), str(several["outcome"][0]), rows[0]["outcome"]} == {"reached"}
        np.testing.assert_array_equal(several["points_0"][:, 0], one["theta_1"])
    assert record["points"] == [list(point) for point in zip(one["theta_1"], one["theta_2"], strict=True)]
    assert one["outcome"] == record["outcome"] == "reached" and one["k"] == record["k"] == 1.0
    assert one["theta_1"][0] == 3.0 and one["theta_1"][-1] > pi
    assert np.abs(np.diff(one["theta_1"])).max() < 1.0
    figures = {name: several_ for name, several_ in record.items() if name in ("length", "clearance")}
    points = np.array(record["points"])
    assert figures["length"] == pytest.approx(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    assert ("streamline" in record) == (kind != "streamline")


def test_a_path_without_a_goal_says_so_in_every_file(tmp_path) -> None:
    cell = np.zeros((6, 3))
    cell[2, :], cell[5, 1] = 1, 2
    planner = rg.plan(space_of(cell))
    lost, blocked = planner.path((0.5, 0.5)), planner.path((2.5, 0.5))
    rg.certify(lost)
    for path, outcome in ((lost, "no_path"), (blocked, "start_blocked")):
        rows = list(csv.DictReader(write_path(path, tmp_path / "path.csv").read_text().splitlines()))
        assert {row["outcome"] for row in rows} == {outcome}
        assert json.loads(write_path(path, tmp_path / "path.json").read_text())["outcome"] == outcome
        with np.load(write_path(path, tmp_path / "path.npz")) as arrays:
            assert arrays["outcome"] == outcome
        for refused in (path, rg.time_parameterize(path, velocity_limits=1.0)):
            with pytest.raises(rg.InputError, match=f"ended with '{outcome}'.*cannot hold an outcome"):
                write_path(refused, tmp_path / "path.yaml")
            with pytest.raises(rg.InputError, match="cannot hold an outcome"):
                rg.maps.to_ros_path(refused)
    assert not (tmp_path / "path.yaml").exists()


def test_messages_of_several_routes_name_their_starts_and_outcomes(tmp_path) -> None:
    cell = np.zeros((6, 3))
    cell[2, :], cell[5, 1] = 1, 2
    planner = rg.plan(space_of(cell))
    starts = [(0.5, 0.5), (3.5, 0.5), (2.5, 0.5), (4.5, 2.5), (1.5, 2.5)]
    routes = [Route(planner.path(start), start) for start in starts]
    text = write_routes(routes, tmp_path / "paths.yaml").read_text()
    messages = list(yaml.safe_load_all(text))
    assert messages == [yaml.safe_load(rg.maps.to_ros_path(routes[number].path)) for number in (1, 3)]
    assert [line for line in text.splitlines() if line.startswith("#")] == [
        "# start (0.5, 0.5), k = 1: no_path",
        "# start (3.5, 0.5), k = 1: reached",
        "# start (2.5, 0.5), k = 1: start_blocked",
        "# start (4.5, 2.5), k = 1: reached",
        "# start (1.5, 2.5), k = 1: no_path",
    ]
    assert write_routes(routes[1:2], tmp_path / "one.yaml").read_text() == rg.maps.to_ros_path(routes[1].path)
    with pytest.raises(rg.InputError, match="no path reaches a goal"):
        write_routes(routes[::2], tmp_path / "none.yaml")
    assert not (tmp_path / "none.yaml").exists()
