"""Recordings: formats, topics, updates, transforms, damaged files.

Tests internals: `resgrid.scene.recordings.transforms`, whose rules are those of tf2.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

import resgrid as rg
from resgrid.scene.recordings.transforms import TransformBuffer, UncoveredError

pytest.importorskip("rosbags")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from support.bags import GRID, SECOND, Messages

EMPTY = np.zeros((4, 6), dtype=np.int8)
S = SECOND


def _typical(ros: int = 2) -> Messages:
    """A recording with a map, two updates, and a robot that moves from (0.2, 0.2) to (1.2, 0.2) within 2 s."""
    made = Messages(ros)
    made.transform(0, "map", "base_link", 0.2, 0.2)
    made.grid(S, EMPTY, 0.05, (-1.0, 2.0, 0.3))
    made.update(S + S // 2, 1, 2, [[100, -1, 7]])
    made.transform(2 * S, "map", "base_link", 1.2, 0.2, 1.0)
    made.update(2 * S, 5, 3, [[100]])
    return made


@pytest.mark.parametrize(
    ("ros", "storage", "compression"),
    [(1, "bag", ""), (1, "bag", "bz2"), (1, "bag", "lz4"), (2, "sqlite3", ""), (2, "mcap", ""), (2, "sqlite3", "file"),
     (2, "sqlite3", "message"), (2, "mcap", "file"), (2, "mcap", "message"), (2, "mcap", "storage")],
)  # fmt: skip
def test_every_format_and_compression_gives_the_same_snapshots(
    tmp_path: Path, ros: int, storage: str, compression: str
) -> None:
    file = _typical(ros).write(tmp_path / ("in.bag" if ros == 1 else "in"), storage=storage, compression=compression)
    recording = rg.maps.read_bag(file)
    assert (recording.ros, recording.storage, len(recording)) == (ros, storage, 3)
    assert (recording.map_topic, recording.updates_topic) == ("/map", "/map_updates")
    first, second, third = recording
    rows = EMPTY.copy()
    np.testing.assert_array_equal(first.occupancy, rows)
    rows[2, 1:4] = [100, -1, 7]
    np.testing.assert_array_equal(second.occupancy, rows)
    rows[3, 5] = 100
    np.testing.assert_array_equal(third.occupancy, rows)
    assert first.resolution == 0.05 and first.origin == pytest.approx((-1.0, 2.0, 0.3))
    assert first.start == pytest.approx((0.7, 0.2, 0.5)) and third.start == pytest.approx((1.2, 0.2, 1.0))
    assert [each.kind for each in recording] == ["map", "update", "update"] and third.note is None
    assert [each.stamp for each in recording] == [S, S + S // 2, 2 * S]


def test_single_files_of_ros_2_are_read(tmp_path: Path) -> None:
    for storage, suffix in (("mcap", "mcap"), ("sqlite3", "db3")):
        folder = _typical().write(tmp_path / storage, storage=storage)
        assert len(list(rg.maps.read_bag(next(folder.glob(f"*.{suffix}"))))) == 3


def test_updates_that_do_not_fit_are_ignored_as_by_nav2(tmp_path: Path) -> None:
    made = Messages()
    made.update(0, 0, 0, [[100]])
    made.grid(S, EMPTY)
    made.update(2 * S, 5, 0, [[100, 100]])
    made.update(3 * S, -1, 0, [[100]])
    made.update(4 * S, 0, 0, [[100]], frame="odom")
    made.update(5 * S, 0, 0, [[100]])
    made.grid(6 * S, np.full((2, 2), -1), 1.0, (3.0, 0.0, 0.5))
    made.update(7 * S, 1, 1, [[50]])
    found = list(rg.maps.read_bag(made.write(tmp_path / "in"), poses=False))
    assert not found[0].has_map and "precedes the first usable map" in str(found[0].note)
    assert [str(each.note) for each in found[2:5]] == [
        "update ignored: 2 x 1 cells at (5, 0) extend beyond the map of 6 x 4 cells",
        "update ignored: 1 x 1 cells at (-1, 0) extend beyond the map of 6 x 4 cells",
        "update ignored: its frame is 'odom', but that of the map is 'map'",
    ]
    assert all((each.occupancy == EMPTY).all() for each in found[1:5])
    assert found[5].occupancy[0, 0] == 100 and found[5].note is None
    np.testing.assert_array_equal(found[7].occupancy, [[-1, -1], [-1, 50]])
    assert found[7].resolution == 1.0 and found[7].origin == pytest.approx((3.0, 0.0, 0.5))


def test_updates_without_cells_change_nothing(tmp_path: Path) -> None:
    made = Messages()
    made.grid(S, EMPTY)
    for time, shape in enumerate([(0, 2), (2, 0), (0, 0)], 2):
        made.update(time * S, 1, 1, np.zeros(shape))
    made.update(5 * S, 1, 1, np.zeros((0, 2)))
    made.entries[-1][-1].data = np.array([100], dtype=np.int8)
    made.update(6 * S, 0, 0, [[100]])
    found = list(rg.maps.read_bag(made.write(tmp_path / "in"), poses=False))
    assert all((each.occupancy == EMPTY).all() for each in found[:5])
    assert [each.note for each in found] == [None] * 4 + ["update ignored: it has 1 values for 2 x 0 cells", None]
    assert found[5].occupancy[0, 0] == 100


def test_unusable_maps_are_snapshots_with_a_reason(tmp_path: Path) -> None:
    made = Messages()
    made.grid(S, np.zeros((0, 0)))
    made.grid(2 * S, EMPTY, size=(5, 5))
    made.grid(3 * S, EMPTY, 0.0)
    made.grid(4 * S, EMPTY, 0.5, (0.0, 0.0, (0.0, 0.3, 0.0, 1.0)))
    made.grid(5 * S, EMPTY, 0.5, (float("nan"), 0.0, 0.0))
    made.update(6 * S, 0, 0, [[100]])
    made.grid(7 * S, EMPTY, 0.5, (0.0, 0.0, (0.0, 0.0, 0.0, 0.0)))
    found = list(rg.maps.read_bag(made.write(tmp_path / "in"), poses=False))
    assert [each.has_map for each in found] == [False] * 6 + [True]
    reasons = ("no cells", "24 values for 5 x 5", "resolution of the map is 0", "tilted", "finite", "precedes")
    for part, each in zip(reasons, found, strict=False):
        assert part in str(each.note)
    assert found[6].origin == (0.0, 0.0, 0.0)


def test_interpolation_along_a_chain_agrees_with_slerp(tmp_path: Path) -> None:
    """map -> odom at 1 Hz, odom -> base_footprint at 10 Hz with tilts, base_footprint -> base_link static."""
    rng, made = np.random.default_rng(3), Messages()
    tilts = Rotation.random(41, random_state=5).as_quat()
    shifts = rng.normal(size=(41, 2))
    drift = rng.normal(size=(5, 3))
    made.transform(50 * S, "/base_footprint", "/base_link", 0.3, -0.1, 0.4, topic="/tf_static", received=0)
    for k in rng.permutation(41):  # out of order
        made.transform(int(k) * S // 10, "odom", "base_footprint", *shifts[k], tuple(tilts[k]), received=S)
    for k in range(5):
        made.transform(k * S, "map", "odom", *drift[k], received=S)
    times = rng.integers(0, 4 * S, 20).tolist()
    for time in times:
        made.grid(int(time), EMPTY, received=5 * S)
    found = [each.start for each in rg.maps.read_bag(made.write(tmp_path / "in"), base_frame="base_link")]

    def homogeneous(shift: np.ndarray, turn: Rotation) -> np.ndarray:
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = turn.as_matrix(), [*shift, 0.25]
        return out

    for time, start in zip(times, found, strict=True):
        t = time / S
        odom = [np.interp(t, range(5), drift[:, axis]) for axis in range(3)]
        base = [np.interp(t, np.arange(41) / 10, shifts[:, axis]) for axis in range(2)]
        whole = homogeneous(odom[:2], Slerp(range(5), Rotation.from_euler("z", drift[:, 2:]))(t))
        whole = whole @ homogeneous(base, Slerp(np.arange(41) / 10, Rotation.from_quat(tilts))(t))
        whole = whole @ homogeneous((0.3, -0.1), Rotation.from_euler("z", 0.4))
        assert start is not None
        assert start[:2] == pytest.approx(whole[:2, 3], abs=1e-9)
        heading = np.arctan2(whole[1, 0], whole[0, 0])
        assert np.angle(np.exp(1j * (start[2] - heading))) == pytest.approx(0, abs=1e-9)


def _buffer(*samples: tuple[str, str, int, float]) -> TransformBuffer:
    buffer = TransformBuffer()
    for parent, child, stamp, x in samples:
        buffer.add(parent, child, stamp, (x, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    return buffer


def test_times_without_transforms_are_replaced_by_the_nearest_and_noted() -> None:
    buffer = _buffer(
        ("map", "odom", 5, 1.0), ("map", "odom", 9, 5.0), ("odom", "base", 0, 0.0), ("odom", "base", 8, 8.0)
    )
    assert buffer.pose("map", "base", 6) == ((8.0, 0.0, 0.0), None)
    (x, _, _), note = buffer.pose("map", "base", 2)
    assert x == 1.0 + 5.0 and note == "the pose of the robot is 3e-09 s later than the message"
    assert buffer.pose("map", "base", 9 * S)[0][0] == 4.0 + 8.0
    assert buffer.pose("base", "map", 6)[0] == (-8.0, 0.0, 0.0)
    assert buffer.pose("map", "map", 6)[0] == (0.0, 0.0, 0.0)
    with pytest.raises(UncoveredError, match="no transforms connect 'map' and 'lidar'"):
        buffer.pose("map", "lidar", 6)
    apart = _buffer(("map", "odom", 0, 1.0), ("map", "odom", 2, 1.0), ("odom", "base", 5, 0.0))
    with pytest.raises(UncoveredError, match="never exist together"):
        apart.pose("map", "base", 1)


def test_rules_of_tf2_for_repeated_stamps_parents_cycles_and_gaps() -> None:
    repeated = _buffer(("map", "base", 1, 1.0), ("map", "base", 1, 9.0), ("map", "base", 3, 3.0))
    assert [repeated.pose("map", "base", time)[0][0] for time in (1, 2, 3)] == [1.0, 2.0, 3.0]
    moved = _buffer(
        ("map", "base", 0, 1.0), ("other", "base", 10, 5.0), ("map", "other", 0, 1.0), ("map", "other", 20, 1.0)
    )
    assert [moved.pose("map", "base", time)[0][0] for time in (9, 10)] == [1.0, 6.0]
    with pytest.raises(UncoveredError):
        _buffer(("a", "b", 0, 1.0), ("b", "a", 0, 1.0)).pose("map", "a", 0)
    gap = _buffer(("map", "base", 0, 0.0), ("map", "base", 20 * S, 2.0))
    assert gap.pose("map", "base", 10 * S) == ((1.0, 0.0, 0.0), "the pose of the robot is interpolated over 20 s")
    odd = _buffer(("map", "map", 0, 1.0), ("map", "base", 0, float("nan")), ("", "base", 0, 1.0))
    assert not odd.tracks


def test_unusable_transforms_are_ignored_as_by_tf2_and_noted(tmp_path: Path) -> None:
    made = Messages()
    made.grid(S, EMPTY)
    made.grid(2 * S, EMPTY)
    nan = float("nan")
    for turn in ((0, 0, 0, 0), (0, 0, 0, 0), (nan, 0, 0, 1), (0, 0, 0, 1.02)):
        made.transform(S, "map", "base_link", 5.0, 5.0, turn)
    made.transform(S, "map", "map", 5.0, 5.0)
    words = (
        "transforms ignored, as by tf2: 3 with a quaternion whose length is not 1 ('map' to 'base_link'), 1 with a "
        "number that is not finite ('map' to 'base_link'), 1 from a frame to itself ('map' to 'map')"
    )
    for options in ({}, {"base_frame": "base_link"}):
        with pytest.raises(rg.InputError) as caught:
            rg.maps.read_bag(made.write(tmp_path / f"bad{len(options)}"), **options)  # type: ignore[arg-type]
        assert f"the recording has no usable transform on /tf ({words}); give a fixed start" in str(caught.value)
    made.amcl(S, 2.0, 0.0)
    (first, _) = rg.maps.read_bag(made.write(tmp_path / "amcl"))
    assert (first.start, first.note) == ((2.0, 0.0, 0.0), words)
    made.transform(S, "map", "base_link", 1.0, 0.0, (0, 0, 0, 1.001))
    made.transform(2 * S, "map", "base_link", 1.0, 0.0)
    found = list(rg.maps.read_bag(made.write(tmp_path / "good")))
    assert [each.start for each in found] == [(1.0, 0.0, 0.0)] * 2
    assert [each.note for each in found] == [words, None]


def test_latched_maps_and_stamps_of_zero_use_the_nearest_pose(tmp_path: Path) -> None:
    made = Messages()
    made.grid(0, EMPTY, received=102 * S)
    made.grid(5 * S, EMPTY, received=103 * S)
    for time in (100, 104):
        made.transform(time * S, "map", "base_link", time, 0.0)
    first, second = rg.maps.read_bag(made.write(tmp_path / "in"))
    assert first.start == pytest.approx((102.0, 0.0, 0.0)) and first.note is None
    assert second.start == pytest.approx((100.0, 0.0, 0.0)) and "95 s later" in str(second.note)


def test_poses_and_goals_of_topics(tmp_path: Path) -> None:
    made = Messages(1)
    made.amcl(S, 0.5, 0.5, 0.2)
    made.grid(2 * S, EMPTY)
    made.goal(3 * S, 2.0, 1.0, 1.5, topic="/move_base_simple/goal")
    made.amcl(4 * S, 1.0, 0.5)
    made.grid(5 * S, EMPTY)
    made.goal(6 * S, 2.0, 1.0, topic="/move_base_simple/goal", frame="odom")
    recording = rg.maps.read_bag(made.write(tmp_path / "in.bag"), goals=True)
    assert recording.pose_source == "topic /amcl_pose" and recording.goal_topic == "/move_base_simple/goal"
    found = list(recording)
    assert [each.kind for each in found] == ["map", "goal", "map", "goal"]
    assert [None if each.goal is None else each.goal[:2] for each in found] == [None, (2.0, 1.0), (2.0, 1.0), None]
    assert found[1].goal == pytest.approx((2.0, 1.0, 1.5)) and found[1].start == pytest.approx((0.5, 0.5, 0.2))
    assert found[2].start == pytest.approx((1.0, 0.5, 0.0)) and "the goal is ignored: its frame" in str(found[3].note)
    assert rg.maps.read_bag(tmp_path / "in.bag", pose_topic="move_base_simple/goal").pose_source is not None


def test_topics_are_chosen_by_namespace_and_named_errors_list_them(tmp_path: Path) -> None:
    made = Messages()
    for space in ("/a", "/b/c"):
        made.grid(S, EMPTY, topic=f"{space}/map", frame="map")
        made.transform(S, "map", "base_link", 1.0 if space == "/a" else 2.0, 0.0, topic=f"{space}/tf")
    made.goal(S, 1.0, 1.0)
    file = made.write(tmp_path / "in")
    with pytest.raises(rg.InputError, match=r"several topics have maps; .* /a/map \(1 message\), /b/c/map"):
        rg.maps.read_bag(file)
    for topic, x in (("/a/map", 1.0), ("b/c/map", 2.0)):
        (snapshot,) = rg.maps.read_bag(file, map_topic=topic)
        assert snapshot.start is not None and snapshot.start[0] == x
    for words, options in (
        ("did you mean '/a/map'", {"map_topic": "/a/mapp"}),
        ("/goal_pose has messages of type geometry_msgs/PoseStamped", {"map_topic": "/goal_pose"}),
        ("no topic of type map_msgs/OccupancyGridUpdate", {"map_topic": "/a/map", "updates_topic": "/a/ups"}),
        ("did you mean 'base_link'", {"map_topic": "/a/map", "base_frame": "baselink"}),
        ("there is no topic /c/tf", {"map_topic": "/a/map", "tf_topic": "/c/tf"}),
        ("leave out tf_topic", {"map_topic": "/a/map", "tf_topic": "/a/tf", "pose_topic": "/goal_pose"}),
    ):
        with pytest.raises(rg.InputError, match=words):
            rg.maps.read_bag(file, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["", "/", "bad topic", "/a/", "//a", "/a//b", "/3d", "/a/3d", "/a-b", "/plän", "/a\n"])
def test_topics_with_names_that_ros_refuses_are_not_written(name: str, tmp_path: Path) -> None:
    maps = [rg.maps.MapSnapshot(EMPTY, 0.5)]
    with pytest.raises(rg.InputError, match=r"map_topic = .* is not a topic name of ROS"):
        rg.maps.write_bag(maps, tmp_path / "a.mcap", map_topic=name)
    assert not list(tmp_path.iterdir())
    recording = rg.maps.read_bag(rg.maps.write_bag(maps, tmp_path / "b.mcap", map_topic="robot_1/_map2"), poses=False)
    assert recording.map_topic == "robot_1/_map2"


def test_recordings_without_maps_transforms_or_messages_are_named(tmp_path: Path) -> None:
    with pytest.raises(rg.InputError, match="the recording has no messages"):
        rg.maps.read_bag(Messages().write(tmp_path / "nothing"))
    for ros, name in ((1, "empty.bag"), (2, "empty")):
        with pytest.raises(rg.InputError, match="no messages"):
            rg.maps.read_bag(Messages(ros).write(tmp_path / name))
    goals = Messages()
    goals.goal(S, 1.0, 1.0)
    with pytest.raises(rg.InputError, match=r"no topic has maps .*topics: /goal_pose \(geometry_msgs/PoseStamped\)"):
        rg.maps.read_bag(goals.write(tmp_path / "goals"))
    alone = Messages()
    alone.grid(S, EMPTY)
    with pytest.raises(rg.InputError, match="no transforms of the robot on /tf; give a fixed start"):
        rg.maps.read_bag(alone.write(tmp_path / "alone"))
    with pytest.raises(rg.InputError, match=r"no topic has goals .*--goal-topic"):
        rg.maps.read_bag(tmp_path / "alone", poses=False, goals=True)
    alone.transform(S, "map", "robot", 0.0, 0.0)
    with pytest.raises(rg.InputError, match=r"no frame is named base_link or base_footprint.*map, robot"):
        rg.maps.read_bag(alone.write(tmp_path / "odd"))
    assert len(rg.maps.read_bag(tmp_path / "odd", base_frame="/robot")) == 1


def test_files_of_other_kinds_are_refused_with_a_remedy(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    for name, text in (("a.txt", "a .bag, .db3 or .mcap file"), ("a.bag.active", "reindex"), ("a.db3.zstd", "folder")):
        (tmp_path / name).write_bytes(b"x")
        with pytest.raises(rg.InputError, match=text):
            rg.maps.read_bag(tmp_path / name)
    (tmp_path / "empty.mcap").touch()
    for name, text in (("empty.mcap", "is empty"), ("folder", "no metadata.yaml"), ("none.bag", "no such recording")):
        with pytest.raises(rg.InputError, match=text):
            rg.maps.read_bag(tmp_path / name)
    folder = _typical().write(tmp_path / "lost", storage="sqlite3")
    (folder / "metadata.yaml").unlink()
    with pytest.raises(rg.InputError, match=r"ros2 bag reindex .*lost.db3"):
        rg.maps.read_bag(folder)


@pytest.mark.parametrize(("ros", "storage"), [(1, "bag"), (2, "sqlite3"), (2, "mcap")])
def test_damaged_recordings_raise_input_error_only(tmp_path: Path, ros: int, storage: str) -> None:
    folder = _typical(ros).write(tmp_path / ("in.bag" if ros == 1 else "in"), storage=storage)
    file = folder if ros == 1 else next(path for path in folder.iterdir() if path.suffix != ".yaml")
    data, rng, failures = file.read_bytes(), np.random.default_rng(ros), 0
    for trial in range(40):
        if trial % 2:
            changed = bytearray(data)
            for place in rng.integers(0, len(data), 8):
                changed[place] = rng.integers(256)
        else:
            changed = bytearray(data[: rng.integers(1, len(data))])
        file.write_bytes(changed)
        try:
            for _ in rg.maps.read_bag(folder):
                pass
        except rg.InputError as error:
            failures += 1
            assert str(folder) in str(error)
    assert failures > 10


def test_an_unknown_definition_of_a_message_is_named(tmp_path: Path) -> None:
    made = _typical()
    with Writer2(tmp_path / "in", version=9) as opened:
        strange = opened.add_connection("/odd", "x/msg/Y", msgdef="this is no definition", rihs01="RIHS01_0")
        opened.write(strange, S, b"\0\1\0\0")
        encode = made.types.serialize_cdr
        for topic, kind, received, message in made.entries[:2]:
            connection = opened.add_connection(topic, kind, typestore=made.types)
            opened.write(connection, received, encode(message, kind))
    assert len(list(rg.maps.read_bag(tmp_path / "in"))) == 1
    with Writer1(tmp_path / "in.bag") as opened:
        connection = opened.add_connection("/map", GRID, msgdef="uint8 level\nint8[] data", md5sum="0" * 32)
        opened.write(connection, S, b"\0" * 9)
    with pytest.raises(rg.InputError, match="nav_msgs/OccupancyGrid has another definition"):
        list(rg.maps.read_bag(tmp_path / "in.bag", poses=False))


def test_without_rosbags_one_sentence_says_how_to_install_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = _typical().write(tmp_path / "in")
    monkeypatch.setitem(sys.modules, "rosbags", None)
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    for call in (lambda: rg.maps.read_bag(file), lambda: rg.maps.write_bag([], tmp_path / "out")):
        with pytest.raises(rg.ToolMissingError, match=r"recordings need the package rosbags; .* pip install"):
            call()
    assert not (tmp_path / "out").exists()
