"""Writers of recordings: maps and paths as bags of ROS 1 and ROS 2, with the package rosbags."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

from resgrid._internal.files import temporary_place, unwritable
from resgrid.errors import InputError
from resgrid.io.ros_paths import path_poses, ros_quaternion, ros_time
from resgrid.planning.stream_planner import StreamedPath
from resgrid.scene.recordings.recording import BASE_FRAMES
from resgrid.scene.recordings.snapshot import MapSnapshot
from resgrid.scene.recordings.storage import (
    GRID,
    PATH,
    STORAGES,
    TRANSFORMS,
    Storage,
    check_topic_name,
    require_rosbags,
    type_store,
)

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


class _File(Protocol):
    """The methods of rosbags' writers of ROS 1 and ROS 2 that this module calls on an open recording."""

    def add_connection(self, topic: str, msgtype: str, **options: Any) -> Any:
        """Add a topic of a message type, and return the connection for its messages."""

    def write(self, connection: Any, timestamp: int, data: Any) -> None:
        """Write an encoded message on a topic.

        `connection`: result of `add_connection` for the topic; `timestamp`: time of arrival in nanoseconds; `data`: the
        encoded message.
        """


class BagWriter:
    """Writer of messages into an open recording.

    `file`: writer of rosbags; `ros`: 1 or 2 for ROS 1 or ROS 2.
    """

    def __init__(self, file: _File, ros: Literal[1, 2]) -> None:
        self._file, self._ros, self._store = file, ros, type_store(ros)
        self._connections: dict[str, tuple[Any, str]] = {}

    @property
    def store(self) -> Typestore:
        """Store of rosbags with the definitions of all message types of the ROS version, standard ones included."""
        return self._store

    def add(self, topic: str, kind: str, *, is_latched: bool = False) -> None:
        """Add a topic of the message type `kind`.

        `is_latched`: whether a late subscriber also gets the last message (latched in ROS 1, transient-local in ROS 2).
        """
        options: dict[str, Any] = {"typestore": self._store}
        if is_latched and self._ros == 1:
            options["latching"] = 1
        elif is_latched:
            options["offered_qos_profiles"] = [_latched_profile()]
        self._connections[topic] = self._file.add_connection(topic, kind, **options), kind

    def write(self, topic: str, received: int, message: Any) -> None:
        """Write a message on a topic that was added with `add`; `received`: time of arrival in nanoseconds."""
        connection, kind = self._connections[topic]
        encode = self._store.serialize_ros1 if self._ros == 1 else self._store.serialize_cdr
        self._file.write(connection, received, encode(message, kind))

    def header(self, stamp: int, frame_id: str) -> Any:
        """Return a ``std_msgs/Header``; `stamp`: time in nanoseconds; `frame_id`: coordinate frame."""
        time = self.new("builtin_interfaces/msg/Time", **ros_time(stamp))
        sequence = {"seq": 0} if self._ros == 1 else {}
        return self.new("std_msgs/msg/Header", **sequence, stamp=time, frame_id=frame_id)

    def pose(self, x: float, y: float, yaw: float) -> Any:
        """Return a ``geometry_msgs/Pose`` in the plane; `x`, `y`: in metres; `yaw`: heading in radians."""
        place = self.new("geometry_msgs/msg/Point", x=x, y=y, z=0.0)
        return self.new("geometry_msgs/msg/Pose", position=place, orientation=self.turn(yaw))

    def turn(self, yaw: float) -> Any:
        """Return the ``geometry_msgs/Quaternion`` of a heading in radians."""
        return self.new("geometry_msgs/msg/Quaternion", **ros_quaternion(yaw))

    def new(self, kind: str, **values: Any) -> Any:
        """Return a message of the type `kind`; `values`: its fields by name."""
        return self._store.types[kind](**values)

    def grid(self, snapshot: MapSnapshot) -> Any:
        """Return the ``nav_msgs/OccupancyGrid`` message of a snapshot (a map, its resolution and its origin)."""
        height, width = snapshot.occupancy.shape
        header = self.header(snapshot.stamp, snapshot.frame_id)
        info = self.new(
            "nav_msgs/msg/MapMetaData", map_load_time=header.stamp, resolution=snapshot.resolution, width=width,
            height=height, origin=self.pose(*snapshot.origin),
        )  # fmt: skip
        return self.new(GRID, header=header, info=info, data=snapshot.occupancy.ravel())

    def path(self, result: StreamedPath) -> Any:
        """Return the ``nav_msgs/Path`` message of a planned path; without poses if no certified path reaches a goal."""
        snapshot = result.snapshot
        header = self.header(snapshot.stamp or snapshot.received, snapshot.frame_id)
        poses = []
        if result.reached and result.path is not None:
            poses = [
                self.new("geometry_msgs/msg/PoseStamped", header=header, pose=self.pose(*pose))
                for pose in path_poses(result.path, heading=result.heading).tolist()
            ]
        return self.new(PATH, header=header, poses=poses)

    def transform(self, snapshot: MapSnapshot, child: str) -> Any:
        """Return a ``tf2_msgs/TFMessage`` with the robot's pose ``snapshot.start``, which must not be None.

        `child`: name of the robot's coordinate frame, such as ``base_link``.
        """
        assert snapshot.start is not None
        x, y, yaw = snapshot.start
        shift = self.new("geometry_msgs/msg/Vector3", x=x, y=y, z=0.0)
        motion = self.new("geometry_msgs/msg/Transform", translation=shift, rotation=self.turn(yaw))
        header = self.header(snapshot.stamp, snapshot.frame_id)
        item = self.new("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=motion)
        return self.new(TRANSFORMS[0], transforms=[item])


def _latched_profile() -> Any:
    """Return the quality of service of a latched topic: reliable, transient local, depth 1.

    A late subscriber of such a topic also gets the last message.
    """
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    endless = QosTime(9223372036, 854775807)
    return Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, endless, endless,
        QosLiveliness.AUTOMATIC, endless, False,
    )  # fmt: skip


def _output_storage(file: str | os.PathLike[str], source: Storage | None = None) -> tuple[Storage, bool]:
    """Return the kind of a new recording ("bag", "mcap" or "sqlite3"), and whether it is a folder.

    ``.bag`` is a file of ROS 1, ``.mcap`` and ``.db3`` are single files of ROS 2, other names are folders of ROS 2. A
    folder has the kind "mcap" if `source` is "mcap", else "sqlite3". `file`: name of the recording; `source`: kind of
    the recording from which the new one is made, None without one.
    """
    suffix = Path(file).suffix
    if suffix in STORAGES:
        return STORAGES[suffix], False
    return ("mcap" if source == "mcap" else "sqlite3"), True


def check_bag_output(file: str | os.PathLike[str], source: Storage | None = None) -> Path:
    """Return the path of a new recording; raise InputError if it cannot be written or would replace other data.

    An existing recording may be replaced: a file by a file, and a folder that is empty or has a ``metadata.yaml`` by a
    folder. `source`: kind of the recording from which the new one is made, None without one; from ROS 2, no ``.bag``
    file can be made.
    """
    if os.fspath(file) == "-":
        raise InputError("-o -: a recording cannot be written to standard output; name a file or a folder")
    target, (storage, is_folder) = Path(file), _output_storage(file, source)
    if storage == "bag" and source not in (None, "bag"):
        raise InputError(
            f"cannot write {target}: a .bag file belongs to ROS 1, but the input is a recording of ROS 2; name a "
            ".mcap file, or a folder (a name without suffix)"
        )
    if not target.absolute().parent.is_dir():
        raise InputError(f"cannot write {target}: there is no folder {target.absolute().parent}; make it first")
    if target.is_dir() and not is_folder:
        raise InputError(f"cannot write {target}: it is a directory; name a file")
    if target.exists() and is_folder and not target.is_dir():
        raise InputError(f"cannot write {target}: it is a file, and a recording of ROS 2 is a folder; name another")
    if target.is_dir() and any(target.iterdir()) and not (target / "metadata.yaml").exists():
        raise InputError(f"cannot write {target}: this folder is no recording; name another, or remove it first")
    return target


@contextmanager
def whole_bag(file: str | os.PathLike[str], source: Storage | None = None) -> Iterator[BagWriter]:
    """Yield the writer of a new recording, which replaces `file` if the block succeeds; otherwise nothing is changed.

    `source`: kind of the recording from which the new one is made, None without one; a folder of ROS 2 gets this kind,
    or sqlite3.
    """
    target = check_bag_output(file, source).resolve()
    require_rosbags()
    storage, is_folder = _output_storage(file, source)
    temporary = temporary_place(target.parent, target.name)
    try:
        temporary.mkdir()
        inside = temporary / (target.name if is_folder or storage == "bag" else "recording")
        with _open(inside, storage) as opened:
            yield BagWriter(opened, 1 if storage == "bag" else 2)
        if not is_folder and storage != "bag":  # rosbags writes the file into a folder
            inside = next(file for file in inside.iterdir() if file.suffix in {".mcap", ".db3"})
        _exchange(inside, target, temporary / "replaced")
    except OSError as error:
        raise unwritable(target, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _exchange(new: Path, target: Path, old: Path) -> None:
    """Move the file or folder `new` to `target`.

    An existing folder `target` is first moved to `old`, and back if the move of `new` fails.
    """
    if target.is_dir():
        target.rename(old)
    try:
        new.replace(target)
    except BaseException:
        if old.exists():
            old.rename(target)
        raise


def _open(path: Path, storage: Storage) -> Any:
    """Return the rosbags writer of a new recording at `path`; `storage`: its kind, "bag", "mcap" or "sqlite3"."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin, Writer as Writer2

    if storage == "bag":
        return Writer1(path)
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    return Writer2(path, version=9, storage_plugin=plugin)


def write_bag(snapshots: Iterable[MapSnapshot], file: str | os.PathLike[str], *, map_topic: str = "/map") -> Path:
    """Write maps as a recording, with the package rosbags; after an error, no new recording exists.

    Parameters
    ----------
    snapshots : iterable of MapSnapshot
        Maps.  The robot's pose in a snapshot, if it is known, is written as the transform from the coordinate frame of
        the map to ``base_link``.
    file : path-like
        ``.bag``: a file of ROS 1; ``.mcap`` or ``.db3``: a file of ROS 2; otherwise a folder of ROS 2.  An existing
        recording is replaced.
    map_topic : str
        Topic of the maps, a name that ROS allows.

    Returns
    -------
    pathlib.Path
        The file or folder.

    Raises
    ------
    InputError
        If the recording cannot be written, or the name of the topic is not allowed.
    ToolMissingError
        If the package rosbags is not installed.

    Examples
    --------
    >>> rg.maps.write_bag([rg.maps.MapSnapshot(np.zeros((2, 3)), 0.5)], "maps.mcap").name
    'maps.mcap'
    """
    check_topic_name(map_topic, "map_topic")
    with whole_bag(file) as bag:
        bag.add(map_topic, GRID, is_latched=True)
        bag.add("/tf", TRANSFORMS[0])
        for snapshot in snapshots:
            if snapshot.start is not None:
                bag.write("/tf", snapshot.received, bag.transform(snapshot, BASE_FRAMES[0]))
            bag.write(map_topic, snapshot.received, bag.grid(snapshot))
    return Path(file)
