"""Replanning of recordings: equality with fresh plans, outcomes, new recordings, and the subcommand."""

from __future__ import annotations

import csv
import json
import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.cli import answer, call

import resgrid as rg

pytest.importorskip("rosbags")

from support.bags import SECOND, Messages, paths_of

S = SECOND
ORIGIN = (-3.0, 2.0, 0.4)
GOAL = rg.Frame(*ORIGIN).to_world((10.75, 6.25))


def _rows(rng: np.random.Generator) -> np.ndarray:
    """Occupancies of 24 x 16 cells: a wall with two doors, a box at a random place, unknown corners."""
    rows = np.zeros((16, 24), dtype=np.int8)
    rows[:, 12], rows[2:6, 12], rows[10:14, 12] = 100, 0, 0
    i, j = rng.integers(2, 12), rng.integers(4, 20)
    rows[i : i + 2, j : j + 2] = 100
    rows[-3:, :3] = -1
    return rows


def _recording(folder: Path, ros: int = 2, frames: int = 12, name: str = "in") -> Path:
    """Write a recording with maps and updates, whose robot moves along the left wall."""
    rng, made, world = np.random.default_rng(ros), Messages(ros), rg.Frame(*ORIGIN)
    for k in range(frames):
        made.transform(k * S, "map", "base_link", *world.to_world((1.25, 1.25 + 0.3 * k)), 0.4)
        if k % 3:
            made.update(k * S, 1, 13, np.full((1, 4), 100 if k % 2 else 0))
        else:
            made.grid(k * S, _rows(rng), 0.5, ORIGIN)
    return made.write(folder / (f"{name}.bag" if ros == 1 else name))


def _fresh(snapshot: rg.maps.MapSnapshot, **options: Any) -> rg.planning.Planner:
    """Return the planner of a space that is made without recordings, from thresholds and numpy alone."""
    rows = snapshot.occupancy.T
    x, y, yaw = snapshot.origin
    lower = (0.0, 0.0) if yaw else (x, y)
    axes = [
        rg.Axis(name, low, low + cells * snapshot.resolution, cells, unit="m")
        for name, low, cells in zip("xy", lower, rows.shape, strict=True)
    ]
    blocked = (rows < 0) | (rows > 25)
    cell = blocked.astype(np.uint8)
    frame = rg.Frame(x, y, yaw) if yaw else rg.Frame()
    index = np.floor((frame.from_world(GOAL) - lower) / snapshot.resolution).astype(int)
    assert cell[tuple(index)] == 0
    cell[tuple(index)] = 2
    points = np.array([frame.from_world(GOAL)])
    return rg.plan(rg.ConfigurationSpace(axes, cell, frame=frame, goal_points=points), **options)


@pytest.mark.parametrize("ros", [1, 2])
@pytest.mark.parametrize("options", [{}, {"k": 0.7}, {"boundary": "neumann"}])
@pytest.mark.quick_cases(3)
def test_every_frame_equals_a_fresh_plan_cell_by_cell(tmp_path: Path, ros: int, options: dict[str, Any]) -> None:
    recording = rg.maps.read_bag(_recording(tmp_path, ros))
    planner = rg.maps.StreamPlanner(goal=GOAL, **options)
    file = tmp_path / ("out.bag" if ros == 1 else "out")
    report = rg.maps.stream_bag(recording, planner, file)
    assert report.reached == report.frames == 12 and set(report.table["method"][1:]) == {"elimination"}
    written = paths_of(file, ros)
    for number, (result, (received, message)) in enumerate(zip(planner.paths(recording), written, strict=True)):
        snapshot, fresh = result.snapshot, _fresh(result.snapshot, **options)
        assert result.planner is not None and result.path is not None and snapshot.start is not None
        np.testing.assert_array_equal(result.planner.space.cell, fresh.space.cell)
        np.testing.assert_allclose(result.planner.field.potential, fresh.field.potential, rtol=1e-7, atol=1e-9)
        path = fresh.path(snapshot.start[:2])
        rg.certify(result.path)
        np.testing.assert_allclose(result.points, path.points, atol=1e-6)
        assert report.table["length"][number] == pytest.approx(path.length)
        assert report.table["clearance"][number] == pytest.approx(path.clearance)
        places = [(pose.pose.position.x, pose.pose.position.y) for pose in message.poses]
        np.testing.assert_allclose(places, result.points)
        stamp = message.header.stamp
        assert received == snapshot.received and stamp.sec * S + stamp.nanosec == snapshot.stamp
        assert message.header.frame_id == "map"
        turn = message.poses[0].pose.orientation
        step = np.array(places[1]) - places[0]
        assert np.arctan2(2 * turn.w * turn.z, 1 - 2 * turn.z**2) == pytest.approx(np.arctan2(step[1], step[0]))


def _maps(*grids: Any, **options: Any) -> list[rg.maps.MapSnapshot]:
    """Return snapshots of grids whose robot stands in the first cell; an entry may be a pair (grid, options)."""
    made = []
    for k, grid in enumerate(grids):
        rows, own = grid if isinstance(grid, tuple) else (grid, {})
        values = {"resolution": 0.5, "stamp": k, "received": k, "start": (0.25, 0.25, 0.0), **options, **own}
        made.append(rg.maps.MapSnapshot(np.asarray(rows), **values))
    return made


FREE = np.zeros((6, 8), dtype=np.int8)


def test_frames_without_a_path_are_rows_with_a_reason(tmp_path: Path) -> None:
    wall, unknown, start, goal = FREE.copy(), np.full_like(FREE, -1), FREE.copy(), FREE.copy()
    wall[:, 4], start[0, 0], goal[5, 7] = 100, 100, 100
    grids = (
        FREE, wall, unknown, start, goal, (FREE, {"start": None}), (FREE, {"start": (9.0, 0.25, 0.0)}), FREE[:3],
        (FREE, {"frame_id": "odom"}), (FREE[:0], {}), FREE,
    )  # fmt: skip
    planner = rg.maps.StreamPlanner(goal=(3.75, 2.75))
    results = list(planner.paths(_maps(*grids)))
    assert [str(result.outcome) for result in results] == [
        "reached", "no_path", "start_blocked", "start_blocked", "goal_blocked", "None", "start_blocked", "goal_blocked",
        "None", "None", "reached",
    ]  # fmt: skip
    words = (
        "",
        "",
        "",
        "obstacle",
        "lies in an obstacle",
        "place of the robot",
        "outside",
        "outside",
        "frame",
        "no cells",
    )
    for word, result in zip(words, results[:-1], strict=True):
        assert word in str(result.reason) and (result.reached or not len(result.points))
    assert results[-1].replanning is not None and results[-1].replanning.method == "elimination"
    assert all(result.certified for result in results if result.path is not None)


def test_a_robot_radius_grows_obstacles_in_every_frame() -> None:
    planner = rg.maps.StreamPlanner(goal=(9.75, 7.75), robot=rg.DiscRobot(0.6), start=(0.75, 0.75))
    rng, h = np.random.default_rng(0), 0.5
    step = np.arange(-3, 4)
    apart = np.maximum(np.abs(step) - 1, 0) * h
    reach = np.hypot(*np.meshgrid(apart, apart)) <= 0.6
    for _ in range(6):
        rows = np.where(rng.random((16, 20)) < 0.03, 100, 0).astype(np.int8)
        rows[:5, :5] = rows[-5:, -5:] = 0
        (result,) = planner.paths(_maps(rows))
        padded = np.pad(rows.T == 100, 3)
        grown = np.zeros(rows.T.shape, dtype=bool)
        for (i, j), touches in np.ndenumerate(reach):
            if touches:
                grown |= padded[i : i + 20, j : j + 16]
        assert result.planner is not None
        np.testing.assert_array_equal(result.planner.space.cell == rg.Cell.OBSTACLE, grown)


def test_options_of_maps_apply_as_to_map_files(tmp_path: Path) -> None:
    rows = np.array([[0, 30, 60, 64], [65, 100, -1, 25], [0, 0, 0, 0]], dtype=np.int8)
    (plain,) = rg.maps.StreamPlanner(goal=(1.75, 1.25)).paths(_maps(rows))
    assert plain.scene is not None and plain.scene.map is not None
    np.testing.assert_array_equal(plain.scene.map.cell.T, [[0, 1, 1, 1], [1, 1, 1, 0], [0, 0, 0, 0]])
    options: dict[str, Any] = {"unknown": "free", "lethal": 64, "least_conductivity": 0.1}
    (other,) = rg.maps.StreamPlanner(goal=(1.75, 1.25), **options).paths(_maps(rows))
    assert other.scene is not None and other.scene.map is not None and other.scene.map.conductivity is not None
    np.testing.assert_array_equal(other.scene.map.cell.T, [[0, 0, 0, 1], [1, 1, 0, 0], [0, 0, 0, 0]])
    assert other.scene.map.conductivity[1, 0] == pytest.approx(0.1 ** (30 / 64))
    cropped = rg.maps.StreamPlanner(goal=(1.75, 1.25), crop=(0, 0, 2, 1.5), coarsen=2, robot=rg.DiscRobot(0.1))
    (result,) = cropped.paths(_maps(np.zeros((9, 9))))
    assert result.planner is not None and result.planner.space.shape == (2, 2)
    known = rg.maps.StreamPlanner(goal=(1.75, 1.25), crop="known")
    first, second = known.paths(
        _maps(np.full((9, 9), -1), np.pad(np.zeros((4, 4)), ((0, 5), (0, 5)), constant_values=-1))
    )
    assert first.outcome is None and "no cell of this map is known" in str(first.reason) and second.reached
    for wrong, words in (
        ({"threshold": 3}, "map.threshold does not apply"), ({"crop": (0, 0, 1)}, "corners of a box"),
        ({"crop": 5}, "corners of a box"), ({"crop": ("a", 0, 1, 1)}, "corners of a box"),
        ({"crop": (2, 0, 1, 1)}, "lower corner"), ({"gaol": (0, 0)}, "did you mean 'goal'"),
        ({"axes": ()}, "axes does not"),
    ):  # fmt: skip
        with pytest.raises(rg.InputError, match=words):
            rg.maps.StreamPlanner(**wrong)  # type: ignore[arg-type]
    for options, words in (
        ({"drive": "start", "boundary": "neumann"}, "drive = "),
        ({"start": [(0.1, 0.1), (0.2, 0.2)]}, "2 starts"),
    ):  # fmt: skip
        with pytest.raises(rg.InputError, match=words):
            rg.maps.StreamPlanner(goal=(1.75, 1.25), **options).plan(_maps(rows)[0])
    with pytest.raises(rg.InputError, match="another StreamPlanner"):
        rg.maps.StreamPlanner(goal=(1.75, 1.25)).plan(_maps(rows)[0], after=plain)


def test_maps_that_change_size_resolution_or_origin_are_planned_afresh() -> None:
    grids = (
        FREE,
        (np.zeros((12, 16)), {"resolution": 0.25}),
        np.zeros((7, 9)),
        (FREE, {"origin": (-0.5, 0.0, 0.2)}),
        FREE,
    )
    results = list(rg.maps.StreamPlanner(goal=(3.0, 1.75)).paths(_maps(*grids)))
    assert all(result.reached for result in results)
    methods = [result.replanning.method for result in results if result.replanning is not None]
    assert methods == ["fresh", "fresh", "fresh", "elimination"]  # the last map differs only by its place in the world
    assert all(result.scene is not None and result.scene.map is not None for result in results)
    assert [result.scene.map.axes[0].cells for result in results if result.scene and result.scene.map] == [
        8,
        16,
        9,
        8,
        8,
    ]


def test_goals_of_the_recording_and_a_turning_robot(tmp_path: Path) -> None:
    made = Messages()
    made.transform(0, "map", "base_link", 0.75, 0.75, 3.0)
    made.grid(S, np.zeros((8, 8)))
    made.goal(2 * S, 3.25, 3.25, 1.25)
    made.goal(3 * S, 3.25, 0.75, -2.0)
    recording = rg.maps.read_bag(made.write(tmp_path / "in"), goals=True)
    report = rg.maps.stream_bag(recording, rg.maps.StreamPlanner(), tmp_path / "out")
    assert report.table["outcome"] == ["not_planned", "reached", "reached"]
    assert report.table["reason"][0] == "there is no goal yet" and report.table["kind"] == ["map", "goal", "goal"]
    paths = [message for _, message in paths_of(tmp_path / "out", 2)]
    assert [len(message.poses) > 0 for message in paths] == [False, True, True]
    ends = [message.poses[-1].pose for message in paths[1:]]
    assert [2 * np.arctan2(end.orientation.z, end.orientation.w) for end in ends] == pytest.approx([1.25, -2.0])
    box = rg.PolygonRobot([(0.3, 0.2), (-0.3, 0.2), (-0.3, -0.2), (0.3, -0.2)], turning_length=0.5)
    results = list(rg.maps.StreamPlanner(robot=box, headings=12).paths(recording))
    assert results[1].reached and results[1].points[0] == pytest.approx((0.75, 0.75, 1.5))


@pytest.mark.parametrize("name", ["out.bag", "out.mcap", "out.db3", "out"])
def test_an_interrupted_run_leaves_the_old_recording_and_nothing_else(tmp_path: Path, name: str) -> None:
    recording = rg.maps.read_bag(_recording(tmp_path, 1 if name == "out.bag" else 2))
    planner = rg.maps.StreamPlanner(goal=GOAL)
    before = sorted(tmp_path.iterdir())

    def interrupt(done: int, total: int) -> None:
        assert total == 12
        if done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rg.maps.stream_bag(recording, planner, tmp_path / name, progress=interrupt)
    assert sorted(tmp_path.iterdir()) == before
    rg.maps.stream_bag(recording, planner, tmp_path / name)
    ros = 1 if name == "out.bag" else 2
    assert len(paths_of(tmp_path / name, ros)) == 12
    with pytest.raises(KeyboardInterrupt):
        rg.maps.stream_bag(recording, planner, tmp_path / name, topic="/never", progress=interrupt)
    assert len(paths_of(tmp_path / name, ros)) == 12
    rg.maps.stream_bag(recording, planner, tmp_path / name, topic="/again")
    assert len(paths_of(tmp_path / name, ros, "/again")) == 12 and not paths_of(tmp_path / name, ros)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted({name, recording.file.name})


def test_outputs_that_would_replace_other_data_are_refused(tmp_path: Path) -> None:
    file = _recording(tmp_path)
    recording, planner = rg.maps.read_bag(file), rg.maps.StreamPlanner(goal=GOAL)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").touch()
    (tmp_path / "note").touch()
    for name, words in (
        ("full", "no recording"), ("note", "it is a file"), ("in", "this is the input"), ("no/where", "no folder"),
        ("full.mcap", "a directory"),
    ):  # fmt: skip
        if name == "full.mcap":
            (tmp_path / name).mkdir()
        with pytest.raises(rg.InputError, match=words):
            rg.maps.stream_bag(recording, planner, tmp_path / name)
    assert (tmp_path / "full" / "thesis.txt").exists()


def test_the_subcommand_writes_paths_table_and_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    _recording(tmp_path)
    goal = f"--goal={GOAL[0]:.3f},{GOAL[1]:.3f}"
    result = call("stream", "in", "--map", "/map", goal, "--robot-radius", 0.3, "-o", "out", "--table", "latency.csv")
    assert result.exit_code == 0, result.stderr
    assert result.stdout.startswith(
        "12 frames: 12 with a certified path\nsolved: fresh 1, elimination 11\nprocessor time"
    )
    rows = list(csv.DictReader(Path("latency.csv").read_text().splitlines()))
    assert len(rows) == 12 and rows[1]["method"] == "elimination" and float(rows[1]["length"]) > 5
    assert len(paths_of(tmp_path / "out", 2)) == 12
    data = answer("stream", "in", goal, "--k", 0.5, "--start=-1.5,4", "--crop", "known", "--set", "robot.radius=0.2")
    assert data["frames"] == data["reached"] == 12 and data["rows"][3]["x"] == -1.5
    assert json.dumps(data["rows"][0]["note"]) == "null"
    none = answer("stream", "in", "--goal", "90,90", "-o", "out", code=1)
    assert none["outcomes"] == {"goal_blocked": 12} and "outside the grid" in none["rows"][0]["reason"]
    assert all(not message.poses for _, message in paths_of(tmp_path / "out", 2))


@pytest.mark.parametrize(
    ("words", "part"),
    [(["-"], "standard input"), (["nothing.bag"], "no such recording"),
     (["in", "--map", "/mapp"], "did you mean '/map'"),
     (["in", "--threshold", "3"], "map.threshold does not apply"), (["in", "--table", "a.txt"], ".csv, .json or .npz"),
     (["in", "--goal-topic", "/g"], "exclude each other"), (["in", "--start", "1,1", "--tf", "/tf"], "leave out"),
     (["in", "-o", "out.bag"], "out.bag: a .bag file belongs to ROS 1, but the input is a recording of ROS 2; name"),
     (["in", "--plan-topic", "bad topic"], "(--plan-topic) = 'bad topic' is not a topic name of ROS"),
     (["in", "-o", "in"], "is the input"), (["in", "--set", "robot.radiu=1"], "robot.radiu"),
     (["in", "-o", "-"], "-o -"), (["in", "--goal", "1,2,3"], "goal"), (["in", "--lethal", "500"], "lethal")],
)  # fmt: skip
def test_wrong_options_of_the_subcommand_give_one_message(
    words: list[str], part: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    _recording(tmp_path, frames=2)
    goal = [] if "--goal" in words else ["--goal", "1,5"]
    result = call("stream", *words, *goal)
    assert result.exit_code == 2 and part in result.stderr, result.stderr
    assert "Traceback" not in result.stderr and len(result.stderr.strip().splitlines()) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in"]


def _node() -> str:
    """Return the text of the node in the how-to page, without the last two lines, which start it."""
    page = (Path(__file__).parents[2] / "docs" / "howto" / "recordings.md").read_text()
    (text,) = re.findall(r"```python\n(import numpy as np\nimport rclpy.*?)```", page, re.DOTALL)
    return text.partition("rclpy.init()")[0]


def test_the_node_of_the_page_plans_with_stand_ins_of_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    """The node itself needs ROS 2; here simple objects replace its modules."""

    class Node:
        def __init__(self, _name: str) -> None:
            self.published = list[Any]()

        def create_subscription(self, *_words: object) -> None:
            pass

        def create_publisher(self, *_words: object) -> Any:
            return SimpleNamespace(publish=self.published.append)

        def get_logger(self) -> Any:
            return SimpleNamespace(warning=self.published.append)

    def message(header: Any = None) -> Any:
        pose = SimpleNamespace(position=SimpleNamespace(), orientation=SimpleNamespace())
        return SimpleNamespace(header=header, pose=pose, poses=[])

    turn = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    place = SimpleNamespace(transform=SimpleNamespace(translation=SimpleNamespace(x=0.7, y=0.7, z=0.0), rotation=turn))
    known: list[Any] = []

    class MissingError(Exception):
        pass

    def lookup(frame: str, base: str, _time: object) -> Any:
        assert (frame, base) == ("map", "base_link")
        if not known:
            raise MissingError("no transform")
        return known[0]

    fakes = {
        "rclpy": {}, "rclpy.node": {"Node": Node}, "rclpy.time": {"Time": object},
        "rclpy.qos": {"QoSProfile": SimpleNamespace, "DurabilityPolicy": SimpleNamespace(TRANSIENT_LOCAL=1)},
        "geometry_msgs.msg": {"PoseStamped": message}, "map_msgs.msg": {"OccupancyGridUpdate": None},
        "nav_msgs.msg": {"OccupancyGrid": None, "Path": message},
        "tf2_ros": {"Buffer": lambda: SimpleNamespace(lookup_transform=lookup), "TransformException": MissingError,
                    "TransformListener": lambda *_words: None},
    }  # fmt: skip
    for name, values in fakes.items():
        module = ModuleType(name)
        vars(module).update(values)
        monkeypatch.setitem(sys.modules, name, module)
    scope: dict[str, Any] = {}
    exec(_node(), scope)
    node = scope["Replanner"]()
    made = Messages()
    made.grid(S, np.zeros((8, 8)))
    made.update(2 * S, 4, 0, np.full((5, 1), 100))
    made.goal(3 * S, 3.2, 0.7, 1.0)
    grid, update, goal = (entry[3] for entry in made.entries)
    node.on_map(grid)
    known.append(place)
    node.on_map(grid)
    node.on_goal(goal)
    node.on_update(update)
    warning, empty, straight, around = node.published
    assert warning == "no transform" and not empty.poses and around.header.stamp.sec == 2
    ends = [(path.poses[0].pose.position, path.poses[-1].pose.position) for path in (straight, around)]
    assert all((first.x, first.y, last.x, last.y) == pytest.approx((0.7, 0.7, 3.2, 0.7)) for first, last in ends)
    assert max(pose.pose.position.y for pose in around.poses) > 2.5
