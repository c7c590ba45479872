"""`read_bag`: a recording as an iterator over its maps in the order of arrival, each with the robot's pose."""

from __future__ import annotations

import os
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from resgrid.errors import InputError, suggestion
from resgrid.scene.recordings.snapshot import MapSnapshot, Pose, frame_name, pose_of, stamp_of
from resgrid.scene.recordings.storage import (
    GRID,
    POSE,
    POSE_WITH_COVARIANCE,
    TRANSFORMS,
    UPDATE,
    Bag,
    Storage,
    open_bag,
    short_type,
)
from resgrid.scene.recordings.transforms import TransformBuffer, UncoveredError, read_transforms

BASE_FRAMES = ("base_link", "base_footprint")
"""Default names of the robot's frame; the first one that the transforms of a recording contain is used."""

_GOAL_TOPICS = ("goal_pose", "goal", "move_base_simple/goal")
"""Last parts of the names of topics that carry goals, in Nav2 and in the navigation stack of ROS 1."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of the robot in a recording, from transforms or from a topic of poses.

    `buffer`: transforms, None if a topic of poses is used; `base_frame`: frame of the robot in the transforms, empty
    without `buffer`; `stamped`: for a topic of poses, sorted time stamps in nanoseconds and the poses at these times,
    by coordinate frame; `ignored`: text about unusable transforms, None if there are none.
    """

    buffer: TransformBuffer | None = None
    base_frame: str = ""
    stamped: Mapping[str, tuple[list[int], list[Pose]]] = field(default_factory=dict)
    ignored: str | None = None

    def at(self, frame: str, stamp: int) -> tuple[Pose | None, str | None]:
        """Return the pose of the robot at a time, and a text about deviations (a pose from another time) or None.

        `frame`: coordinate frame of the pose; `stamp`: time in nanoseconds. Without a pose in this frame the first
        result is None, and the text gives the reason.
        """
        if self.buffer is not None:
            try:
                return self.buffer.pose(frame, self.base_frame, stamp)
            except UncoveredError as error:
                return None, f"the place of the robot is unknown: {error}"
        if frame not in self.stamped:
            return None, f"the place of the robot is unknown: no pose has the frame {frame!r} of the map"
        stamps, poses = self.stamped[frame]
        position = bisect_right(stamps, stamp) - 1
        if position >= 0:
            return poses[position], None
        return poses[0], f"the pose of the robot is {(stamps[0] - stamp) / 1e9:.3g} s later than the message"


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording of a robot, which `read_bag` returns: an iterable of `MapSnapshot`.

    Every iteration reads the file again, one message at a time, so that long recordings need little memory.

    Attributes
    ----------
    file : Path
        The file or folder.
    ros : {1, 2}
        1 for ROS 1, 2 for ROS 2.
    storage : {"bag", "sqlite3", "mcap"}
        Kind of recording: a bag of ROS 1, or a database or MCAP file of ROS 2.
    map_topic : str
        Topic of the maps.
    updates_topic : str or None
        Topic of the updates of the map; None without one.
    goal_topic : str or None
        Topic of the goals; None without one.
    pose_source : str or None
        Source of the robot's poses: a topic, or the frame of the robot in the transforms; None if they were not read.
    count : int
        Number of snapshots; ``len(recording)`` is the same number.

    Examples
    --------
    >>> snapshots = [rg.maps.MapSnapshot(np.zeros((2, 3)), 0.5, stamp=k, received=k) for k in range(4)]
    >>> recording = rg.maps.read_bag(rg.maps.write_bag(snapshots, "in.mcap"), poses=False)
    >>> recording
    <Recording in.mcap: ROS 2, mcap, topic /map, 4 snapshots>
    >>> [snapshot.stamp for snapshot in recording]
    [0, 1, 2, 3]
    """

    file: Path
    ros: Literal[1, 2]
    storage: Storage
    map_topic: str
    updates_topic: str | None
    goal_topic: str | None
    pose_source: str | None
    count: int
    _poses: Poses | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        kind = f"ROS {self.ros}, {self.storage}"
        return f"<Recording {self.file}: {kind}, topic {self.map_topic}, {self.count} snapshots>"

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[MapSnapshot]:
        topics = [name for name in (self.map_topic, self.updates_topic, self.goal_topic) if name is not None]
        last = MapSnapshot(np.zeros((0, 0), np.int8), 1.0, frame_id="", note="there is no map yet")
        extra = None if self._poses is None else self._poses.ignored
        goal, goal_frame = None, ""
        with open_bag(self.file) as bag:
            for topic, received, message in bag.messages(topics):
                if topic == self.goal_topic:
                    goal, goal_frame, note = _goal(message)
                    stamp = stamp_of(message) or received
                    last = replace(last, kind="goal", stamp=stamp, received=received, note=note or last.note)
                elif topic == self.updates_topic:
                    last = last.updated(message, received=received)
                else:
                    last = _mapped(message, received)
                yield self._placed(last, goal, goal_frame, extra)
                extra = None
                if last.has_map:
                    last = replace(last, note=None)

    def _placed(self, snapshot: MapSnapshot, goal: Pose | None, goal_frame: str, extra: str | None) -> MapSnapshot:
        """Return a snapshot with the robot's pose at the snapshot's time, and the goal if it is in the map's frame.

        `goal_frame`: coordinate frame of the goal; `extra`: text to add to the snapshot's `note`, or None.
        """
        notes, start = [snapshot.note], None
        if goal is not None and snapshot.has_map and goal_frame != snapshot.frame_id:
            notes.append(f"the goal is ignored: its frame is {goal_frame!r}, but that of the map {snapshot.frame_id!r}")
            goal = None
        if self._poses is not None and snapshot.has_map:
            start, note = self._poses.at(snapshot.frame_id, snapshot.stamp or snapshot.received)
            notes.append(note)
        return replace(snapshot, start=start, goal=goal, note="; ".join(filter(None, (*notes, extra))) or None)


def _mapped(message: Any, received: int) -> MapSnapshot:
    """Return the snapshot of a map message; for an unusable one, a snapshot without cells whose `note` says why."""
    try:
        snapshot = MapSnapshot.of_message(message, received=received)
        return snapshot if snapshot.has_map else replace(snapshot, note="the map has no cells")
    except InputError as error:
        frame = frame_name(message.header.frame_id)
        empty = np.zeros((0, 0), np.int8)
        return MapSnapshot(empty, 1.0, frame_id=frame, stamp=stamp_of(message), received=received, note=str(error))


def _goal(message: Any) -> tuple[Pose | None, str, str | None]:
    """Return pose, frame and None for a goal message; None, the frame and the reason if the pose is not finite."""
    frame = frame_name(message.header.frame_id)
    try:
        return pose_of(message.pose), frame, None
    except InputError as error:
        return None, frame, f"the goal is ignored: {error}"


def read_bag(
    file: str | os.PathLike[str],
    *,
    map_topic: str | None = None,
    updates_topic: str | None = None,
    goal_topic: str | None = None,
    pose_topic: str | None = None,
    tf_topic: str | None = None,
    base_frame: str | None = None,
    poses: bool = True,
    goals: bool = False,
) -> Recording:
    """Open a recording of a robot (a bag), with the package rosbags and without ROS.

    Maps and updates are snapshots in the order of their arrival.  The pose of the robot belongs to the time stamp of
    each message (to the time of arrival if the stamp is 0).  Transforms are interpolated as by tf2: translations
    linearly, rotations by slerp, static transforms at any time.  If the transforms do not cover the time stamp, the
    nearest covered time is used, and `MapSnapshot.note` gives the difference.  Transforms that tf2 ignores, such as one
    with the quaternion (0, 0, 0, 0), are left out, and the note of the first snapshot counts them.

    Parameters
    ----------
    file : path-like
        A ``.bag`` file of ROS 1, or the folder of a recording of ROS 2, or one of its ``.db3`` or ``.mcap`` files.
    map_topic : str, optional
        Topic of type ``nav_msgs/OccupancyGrid``; by default the only one of this type.
    updates_topic : str, optional
        Topic of type ``map_msgs/OccupancyGridUpdate``; by default the map topic followed by ``_updates``, if it exists.
    goal_topic : str, optional
        Topic of type ``geometry_msgs/PoseStamped`` with goals; each goal makes a snapshot.  See `goals`.
    pose_topic : str, optional
        Topic with poses of the robot, of type ``geometry_msgs/PoseWithCovarianceStamped`` (such as ``/amcl_pose``) or
        ``PoseStamped``, in place of transforms.  The newest pose up to the time stamp counts.
    tf_topic : str, optional
        Topic of the transforms; that of the static ones has ``_static`` appended.  By default ``tf`` in the namespace
        of the map topic or in the nearest namespace around it.
    base_frame : str, optional
        Frame of the robot; by default ``base_link`` or ``base_footprint``.
    poses : bool
        Whether to read poses of the robot.  Without transforms and without `base_frame`, the only topic of poses with
        covariance is used; ``initialpose`` does not count.
    goals : bool
        Whether to use the only topic of goals (``/goal_pose``, ``/move_base_simple/goal``) without `goal_topic`.

    Returns
    -------
    Recording
        The recording; its maps are read during iterations.

    Raises
    ------
    InputError
        If the recording is damaged or has no map, or a topic or frame is missing or ambiguous (with the candidates).
    ToolMissingError
        If the package rosbags is not installed.

    Examples
    --------
    >>> grid = np.zeros((2, 3))
    >>> file = rg.maps.write_bag([rg.maps.MapSnapshot(grid, 0.5, start=(0.2, 0.4, 0.0))], "room.bag")
    >>> for snapshot in rg.maps.read_bag(file):
    ...     print(snapshot, snapshot.start)
    <MapSnapshot map: 3 x 2 cells of 0.5 m in frame 'map' at 0.000000000 s> (0.2, 0.4, 0.0)
    """
    path = Path(file)
    with open_bag(path) as bag:
        maps = _topic(bag, map_topic, (GRID,), "maps", "map_topic (--map)")
        if not bag.topics[maps].count:
            raise InputError(f"{path}: topic {maps} has no messages; choose another topic, or record it again")
        updates = _updates(bag, maps, updates_topic)
        wanted = goal_topic is not None or goals
        aim = _topic(bag, goal_topic, (POSE,), "goals", "goal_topic (--goal-topic)", _GOAL_TOPICS) if wanted else None
        read, source = _poses(bag, maps, pose_topic, tf_topic, base_frame) if poses else (None, None)
        count = sum(bag.topics[name].count for name in (maps, updates, aim) if name is not None)
        return Recording(path, bag.ros, bag.storage, maps, updates, aim, source, count, read)


def _names(bag: Bag, kinds: Sequence[str]) -> list[str]:
    """Return the names of the topics of a recording whose message type is one of `kinds`, sorted."""
    return sorted(name for name, topic in bag.topics.items() if topic.kind in kinds)


def _listed(bag: Bag, names: Sequence[str]) -> str:
    """Return the given topics with their numbers of messages as text for an error message."""
    counts = ((name, bag.topics[name].count) for name in names)
    return ", ".join(f"{name} ({count} message{'' if count == 1 else 's'})" for name, count in counts)


def _topic(bag: Bag, name: str | None, kinds: Sequence[str], noun: str, option: str, ends: Sequence[str] = ()) -> str:
    """Return the topic that a user has named, or the only one of some types; raise InputError without such a topic.

    `name`: name, with or without leading slash, None for the only topic; `kinds`: message types; `noun`: contents of
    the topic and `option`: name of the option, for messages; `ends`: possible ends of the name of the only topic.
    """
    known = _names(bag, kinds)
    short = " or ".join(map(short_type, kinds))
    if name is not None:
        found = next((each for each in (name, f"/{name}", name.removeprefix("/")) if each in bag.topics), None)
        if found in known:
            return str(found)
        if found is not None:
            problem = (
                f"topic {found} has messages of type {short_type(bag.topics[found].kind)}, but {noun} need {short}"
            )
        else:
            problem = f"there is no topic {name}"
        hint = suggestion(name, known)
        listed = f"topics of {noun}: {_listed(bag, known)}" if known else f"the recording has no topic of type {short}"
        raise InputError(f"{bag.path}: {problem}; {hint + '; ' if hint else ''}{listed}")
    fitting = [each for each in known if not ends or any(each.removeprefix("/").endswith(end) for end in ends)]
    filled = [each for each in fitting if bag.topics[each].count]
    candidates = filled or fitting
    if len(candidates) == 1:
        return candidates[0]
    if candidates:
        raise InputError(
            f"{bag.path}: several topics have {noun}; choose one with {option}: {_listed(bag, candidates)}"
        )
    if not any(topic.count for topic in bag.topics.values()):
        raise InputError(f"{bag.path}: the recording has no messages; record it again")
    has = ", ".join(f"{each} ({short_type(topic.kind)})" for each, topic in sorted(bag.topics.items())[:12])
    raise InputError(f"{bag.path}: no topic has {noun} (type {short}); name one with {option}; topics: {has}")


def _updates(bag: Bag, maps: str, name: str | None) -> str | None:
    """Return the topic `name` of updates; by default topic `maps` plus ``_updates``, None if this one is missing."""
    default = f"{maps}_updates"
    if name is None and (default not in bag.topics or bag.topics[default].kind != UPDATE):
        return None
    return _topic(bag, name or default, (UPDATE,), "updates", "updates_topic (--updates)")


def _poses(
    bag: Bag, maps: str, pose_topic: str | None, tf_topic: str | None, base_frame: str | None
) -> tuple[Poses, str]:
    """Return the poses of the robot, and their source as text; raise InputError if there are none.

    `maps`: topic of the maps; `pose_topic`, `tf_topic`: topics of poses and of transforms, `base_frame`: frame of the
    robot in the transforms; for None, transforms come first, then the only topic of poses with covariance.
    """
    if pose_topic is not None:
        if tf_topic is not None or base_frame is not None:
            raise InputError("pose_topic replaces the transforms; leave out tf_topic and base_frame")
        return _stamped(
            bag, _topic(bag, pose_topic, (POSE_WITH_COVARIANCE, POSE), "poses", "pose_topic (--pose-topic)")
        )
    topics, ignored = _tf_topics(bag, maps, tf_topic), None
    if topics:
        buffer = read_transforms(bag, topics)
        ignored = buffer.ignored
        if buffer.tracks:
            base = _base_frame(bag, buffer, base_frame)
            return Poses(buffer, base, ignored=ignored), f"frame {base}"
    others = [name for name in _names(bag, (POSE_WITH_COVARIANCE,)) if not name.endswith("initialpose")]
    if len(others) == 1 and base_frame is None:
        poses, source = _stamped(bag, others[0])
        return replace(poses, ignored=ignored), source
    listed = f"; topics of poses: {_listed(bag, others)}" if others else ""
    problem = f"the recording has no transforms of the robot on {maps.rpartition('/')[0]}/tf"
    if ignored is not None:
        problem = f"the recording has no usable transform on {' and '.join(topics)} ({ignored})"
    raise InputError(
        f"{bag.path}: {problem}; give a fixed start (--start X,Y; poses=False in Python), or a topic of poses "
        f"(--pose-topic){listed}"
    )


def _stamped(bag: Bag, topic: str) -> tuple[Poses, str]:
    """Return the finite poses of the robot on a topic of poses, and the text ``topic NAME``."""
    entries = []
    for _, received, message in bag.messages([topic]):
        pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
        try:
            entries.append((stamp_of(message) or received, frame_name(message.header.frame_id), pose_of(pose)))
        except InputError:  # a pose that is not finite
            continue
    stamped: dict[str, tuple[list[int], list[Pose]]] = {}
    for stamp, frame, pose in sorted(entries, key=lambda entry: entry[0]):
        stamps, poses = stamped.setdefault(frame, ([], []))
        stamps.append(stamp)
        poses.append(pose)
    return Poses(stamped=stamped), f"topic {topic}"


def _tf_topics(bag: Bag, maps: str, name: str | None) -> list[str]:
    """Return the topics of moving and static transforms; empty if the recording has none.

    `maps`: topic of the maps; ``tf`` is searched in its namespace, then in outer ones; `name`: given topic, or None.
    """
    known = _names(bag, TRANSFORMS)
    if name is not None:
        moving = name if name in known else f"/{name}"
        found = [each for each in (moving, f"{moving}_static") if each in known]
        return found or [_topic(bag, name, TRANSFORMS, "transforms", "tf_topic (--tf)")]
    space = maps
    while space:
        space = space.rpartition("/")[0]
        found = [each for each in (f"{space}/tf", f"{space}/tf_static") if each in known]
        if found:
            return found
    heads = sorted({each.removesuffix("_static") for each in known})
    if len(heads) > 1:
        raise InputError(
            f"{bag.path}: several topics have transforms; choose one with tf_topic (--tf): {_listed(bag, known)}"
        )
    return known


def _base_frame(bag: Bag, buffer: TransformBuffer, name: str | None) -> str:
    """Return the robot's frame `name`, by default base_link or base_footprint; raise InputError if it is missing."""
    frames = buffer.frames
    if name is not None:
        if frame_name(name) in frames:
            return frame_name(name)
        hint = suggestion(name, frames)
        raise InputError(f"{bag.path}: there is no frame {name!r}; {hint or 'frames: ' + ', '.join(frames)}")
    found = [frame for frame in BASE_FRAMES if frame in frames]
    spaced = [frame for frame in frames if frame.endswith(tuple(f"/{base}" for base in BASE_FRAMES))]
    if found or len(spaced) == 1:
        return (found or spaced)[0]
    raise InputError(
        f"{bag.path}: no frame is named {' or '.join(BASE_FRAMES)}; name the frame of the robot with base_frame "
        f"(--base-frame): {', '.join(frames)}"
    )
