"""Files of recordings, read with the package rosbags: topics and decoded messages."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from resgrid._internal.extras import install_command
from resgrid.errors import InputError, ToolMissingError

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.typesys.store import Typestore

Storage = Literal["bag", "sqlite3", "mcap"]
"""Kind of recording: a bag of ROS 1, or a recording of ROS 2 in an SQLite database or in MCAP files."""

STORAGES: dict[str, Storage] = {".bag": "bag", ".db3": "sqlite3", ".mcap": "mcap"}
"""Kind of recording by suffix of the file."""

GRID, UPDATE = "nav_msgs/msg/OccupancyGrid", "map_msgs/msg/OccupancyGridUpdate"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
POSE, POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
PATH = "nav_msgs/msg/Path"
READ = (GRID, UPDATE, *TRANSFORMS, POSE, POSE_WITH_COVARIANCE)
"""Message types that `Bag.messages` decodes; other types are rejected."""

_TOPIC_NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
"""Pattern of the names of topics that both ROS 1 and ROS 2 allow."""

_DEFINITIONS = {
    UPDATE: "std_msgs/Header header\nint32 x\nint32 y\nuint32 width\nuint32 height\nint8[] data\n",
    TRANSFORMS[0]: "geometry_msgs/TransformStamped[] transforms\n",
    TRANSFORMS[1]: "geometry_msgs/TransformStamped[] transforms\n",
}
"""Definitions of message types that the package rosbags lacks for ROS 1 or ROS 2, by name of the type."""

_REINDEX = {
    "bag": "repair a copy with 'rosbag reindex'",
    "sqlite3": "repair a copy with 'ros2 bag reindex -s sqlite3'",
    "mcap": "repair a copy with 'mcap recover'",
}


@dataclass(frozen=True)
class Topic:
    """A topic of a recording.

    `kind`: message type, such as ``nav_msgs/msg/OccupancyGrid``; `count`: number of messages.
    """

    kind: str
    count: int


def check_topic_name(name: str, option: str) -> None:
    """Raise InputError unless ROS allows a topic of the name `name`.

    `option`: option that gave the name, for the message.
    """
    if not _TOPIC_NAME.fullmatch(name):
        raise InputError(
            f"{option} = {name!r} is not a topic name of ROS; write letters, digits and underscores, with single "
            "slashes between parts that do not begin with a digit, such as /robot/plan"
        )


def require_rosbags() -> None:
    """Raise ToolMissingError, which contains the install command, unless the package rosbags can be imported."""
    try:
        import rosbags.typesys  # noqa: F401
    except ImportError as error:
        raise ToolMissingError(
            f"recordings need the package rosbags; install it with: {install_command('bags')} ({error})"
        ) from None


@cache
def type_store(ros: Literal[1, 2]) -> Typestore:
    """Return the message types of ROS 1 or 2 (`ros`) from rosbags, extended by map updates and transforms."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    for name, text in _DEFINITIONS.items():
        if name not in store.types:
            store.register(get_types_from_msg(text, name))
    return store


def storage_of(path: Path) -> Storage:
    """Return the kind of a recording by its suffix (of a folder by ``metadata.yaml``); raise InputError for others."""
    if not path.exists():
        raise InputError(f"{path}: there is no such recording; check the name and the folder")
    if path.is_dir():
        inside = sorted(file.name for file in path.iterdir() if file.suffix in {".db3", ".mcap"})
        if not (path / "metadata.yaml").exists():
            remedy = (
                f"type 'ros2 bag reindex {path}', or give the file inside ({inside[0]})"
                if inside
                else "give a .bag file of ROS 1, or the folder of a recording of ROS 2"
            )
            raise InputError(f"{path}: this folder has no metadata.yaml; {remedy}")
        text = (path / "metadata.yaml").read_text(encoding="utf-8", errors="replace")
        return "mcap" if "storage_identifier: mcap" in text else "sqlite3"
    if path.suffix in STORAGES:
        if not path.stat().st_size:
            raise InputError(f"{path}: the file is empty; copy or record it again")
        return STORAGES[path.suffix]
    if path.suffix == ".active":
        raise InputError(f"{path}: this recording was not closed; {_REINDEX['bag']}, and rename it to .bag")
    if path.suffix in {".zstd", ".zst"}:
        raise InputError(f"{path}: give the folder of this compressed recording, which has a metadata.yaml")
    raise InputError(f"{path}: a recording is a .bag, .db3 or .mcap file, or a folder with a metadata.yaml")


class Bag:
    """An open recording.

    `path`: file or folder; `storage`: kind of recording; `ros`: 1 or 2 for ROS 1 or ROS 2; `topics`: topics by name.
    """

    def __init__(self, path: Path, storage: Storage, reader: Any) -> None:
        self.path, self.storage, self._reader = path, storage, reader
        self.ros: Literal[1, 2] = 1 if storage == "bag" else 2
        self._store = type_store(self.ros)
        self._by_topic: dict[str, list[Connection]] = {}
        for connection in reader.connections:
            self._by_topic.setdefault(connection.topic, []).append(connection)
        self.topics = {
            name: Topic(several[0].msgtype, sum(each.msgcount for each in several))
            for name, several in self._by_topic.items()
        }

    def messages(self, names: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        """Yield topic, time of arrival in nanoseconds and decoded message of every message, in the order of arrival.

        `names`: names of topics whose types are in `READ`. Raises InputError for a damaged recording, and for a message
        type that the recording defines otherwise than ROS.
        """
        chosen = [connection for name in names for connection in self._by_topic[name]]
        for connection in chosen:
            self._require_known(connection)
        if not chosen:
            return
        decode = self._store.deserialize_ros1 if self.ros == 1 else self._store.deserialize_cdr
        counts = dict.fromkeys(names, 0)
        source = self._reader.messages(connections=chosen)
        while True:
            with reading(self.path, self.storage, counts):
                item = next(source, None)
                if item is None:
                    return
                connection, received, data = item
                message = decode(data, connection.msgtype)
            counts[connection.topic] += 1
            yield connection.topic, received, message

    def _require_known(self, connection: Connection) -> None:
        """Raise InputError unless the type of a topic is in `READ` and the recording defines it as ROS does.

        `connection`: the topic with its message type, as rosbags returns it.
        """
        from rosbags.interfaces import MessageDefinitionFormat
        from rosbags.typesys import get_types_from_msg

        name, place = connection.msgtype, f"{self.path}: topic {connection.topic}"
        if name not in READ:
            raise InputError(f"{place} has messages of type {short_type(name)}, which are not read")
        if connection.msgdef.format != MessageDefinitionFormat.MSG:
            return
        try:
            found = get_types_from_msg(connection.msgdef.data, name)
            other = next((each for each in found if found[each][1] != self._store.fielddefs[each][1]), None)
        except Exception:  # the parser raises errors of several types for a damaged text, and KeyError is a new type
            other = name
        if other is not None:
            raise InputError(
                f"{place}: the type {short_type(other)} has another definition in this recording than in ROS; convert "
                "the recording to the usual definition"
            )


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a recording, and yield it during the block.

    Raises InputError if the recording is damaged, and ToolMissingError without the package rosbags.
    """
    storage = storage_of(path)
    require_rosbags()
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    with reading(path, storage):
        reader = Reader1(path) if storage == "bag" else Reader2(path)
        reader.open()
    try:
        with reading(path, storage):
            bag = Bag(path, storage, reader)
        yield bag
    finally:
        with reading(path, storage):
            reader.close()


@contextmanager
def reading(path: Path, storage: Storage, counts: dict[str, int] | None = None) -> Iterator[None]:
    """Convert all errors of rosbags in the block to InputError, because damaged files raise errors of many types.

    `path`, `storage`: name and kind of the recording, for the message; `counts`: number of messages read so far by
    topic, None to leave it out of the message.
    """
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as error:
        after = ""
        if counts is not None:
            after = " after " + ", ".join(f"{count} messages of {name}" for name, count in counts.items())
        text = str(error).rstrip(".") or type(error).__name__
        raise InputError(
            f"{path}: the recording is damaged or incomplete{after}: {text}; {_REINDEX[storage]}"
        ) from None


def short_type(name: str) -> str:
    """Return the name of a message type without ``/msg``, such as ``nav_msgs/OccupancyGrid``."""
    return name.replace("/msg/", "/")
