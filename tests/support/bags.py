"""Recordings for tests, written with rosbags from plain numbers, independently of the writers of resgrid."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from math import cos, sin
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

GRID, UPDATE, TF = "nav_msgs/msg/OccupancyGrid", "map_msgs/msg/OccupancyGridUpdate", "tf2_msgs/msg/TFMessage"
POSE, AMCL = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
SECOND = 10**9


@cache
def store(ros: int) -> Any:
    """Return the message types of a version of ROS, with map updates and transforms."""
    types = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    types.register(
        get_types_from_msg("Header header\nint32 x\nint32 y\nuint32 width\nuint32 height\nint8[] data", UPDATE)
    )
    if TF not in types.types:
        types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    return types


class Messages:
    """Messages of a recording: (topic, type, time of arrival, message) in `entries`."""

    def __init__(self, ros: int = 2) -> None:
        self.ros, self.types, self.entries = ros, store(ros), list[tuple[str, str, int, Any]]()

    def _new(self, kind: str, **values: Any) -> Any:
        return self.types.types[kind](**values)

    def header(self, stamp: int, frame: str) -> Any:
        time = self._new("builtin_interfaces/msg/Time", sec=stamp // SECOND, nanosec=stamp % SECOND)
        also = {"seq": 7} if self.ros == 1 else {}
        return self._new("std_msgs/msg/Header", stamp=time, frame_id=frame, **also)

    def pose(self, x: float, y: float, turn: Any = 0.0) -> Any:
        q = (0.0, 0.0, sin(turn / 2), cos(turn / 2)) if isinstance(turn, float | int) else turn
        point = self._new("geometry_msgs/msg/Point", x=float(x), y=float(y), z=0.0)
        quaternion = self._new("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", map(float, q), strict=True)))
        return self._new("geometry_msgs/msg/Pose", position=point, orientation=quaternion)

    def grid(
        self, stamp: int, rows: Any, resolution: float = 0.5, origin: tuple[Any, ...] = (0.0, 0.0, 0.0), *,
        frame: str = "map", topic: str = "/map", received: int | None = None, size: tuple[int, int] | None = None,
    ) -> None:  # fmt: skip
        rows = np.asarray(rows, dtype=np.int8)
        height, width = size or rows.shape
        header = self.header(stamp, frame)
        info = self._new(
            "nav_msgs/msg/MapMetaData", map_load_time=header.stamp, resolution=resolution, width=width, height=height,
            origin=self.pose(*origin),
        )  # fmt: skip
        message = self._new(GRID, header=header, info=info, data=rows.ravel())
        self.entries.append((topic, GRID, stamp if received is None else received, message))

    def update(self, stamp: int, x: int, y: int, rows: Any, frame: str = "map", topic: str = "/map_updates") -> None:
        rows = np.asarray(rows, dtype=np.int8)
        message = self._new(
            UPDATE, header=self.header(stamp, frame), x=x, y=y, width=rows.shape[1], height=rows.shape[0],
            data=rows.ravel(),
        )  # fmt: skip
        self.entries.append((topic, UPDATE, stamp, message))

    def transform(
        self, stamp: int, parent: str, child: str, x: float, y: float, turn: Any = 0.0, *, topic: str = "/tf",
        received: int | None = None,
    ) -> None:  # fmt: skip
        pose = self.pose(x, y, turn)
        shift = self._new("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=0.25)
        motion = self._new("geometry_msgs/msg/Transform", translation=shift, rotation=pose.orientation)
        item = self._new(
            "geometry_msgs/msg/TransformStamped", header=self.header(stamp, parent), child_frame_id=child,
            transform=motion,
        )  # fmt: skip
        message = self._new(TF, transforms=[item])
        self.entries.append((topic, TF, stamp if received is None else received, message))

    def goal(
        self, stamp: int, x: float, y: float, turn: float = 0.0, *, topic: str = "/goal_pose", frame: str = "map"
    ) -> None:
        message = self._new(POSE, header=self.header(stamp, frame), pose=self.pose(x, y, turn))
        self.entries.append((topic, POSE, stamp, message))

    def amcl(self, stamp: int, x: float, y: float, turn: float = 0.0, topic: str = "/amcl_pose") -> None:
        pose = self._new("geometry_msgs/msg/PoseWithCovariance", pose=self.pose(x, y, turn), covariance=np.zeros(36))
        message = self._new(AMCL, header=self.header(stamp, "map"), pose=pose)
        self.entries.append((topic, AMCL, stamp, message))

    def write(self, file: Path | str, *, storage: str = "mcap", compression: str = "") -> Path:
        """Write a .bag file of ROS 1, or a folder of ROS 2; `compression`: bz2, lz4, file, message or storage."""
        path = Path(file)
        writer: Any
        if self.ros == 1:
            writer = Writer1(path)
            if compression:
                writer.set_compression(Writer1.CompressionFormat[compression.upper()])
        else:
            writer = Writer2(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
            if compression:
                writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
        encode = self.types.serialize_ros1 if self.ros == 1 else self.types.serialize_cdr
        with writer as opened:
            connections: dict[str, Any] = {}
            for topic, kind, received, message in self.entries:
                if topic not in connections:
                    connections[topic] = opened.add_connection(topic, kind, typestore=self.types)
                opened.write(connections[topic], received, encode(message, kind))
        return path


def paths_of(file: Path, ros: int, topic: str = "/plan") -> list[tuple[int, Any]]:
    """Return time of arrival and message of every path in a recording."""
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    types = store(ros)
    decode = types.deserialize_ros1 if ros == 1 else types.deserialize_cdr
    with (Reader1 if ros == 1 else Reader2)(file) as opened:
        chosen: Iterable[Any] = [each for each in opened.connections if each.topic == topic]
        found = opened.messages(connections=list(chosen)) if chosen else ()
        return [(when, decode(data, each.msgtype)) for each, when, data in found]
