"""The type `MapSnapshot`: the map of a recording at one time, with the poses of the robot and of its goal."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import atan2, hypot, isfinite
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen
from resgrid.errors import InputError

Pose = tuple[float, float, float]
"""Pose in the plane: x and y in metres, heading in radians."""

_FLAT = 1e-6
"""Largest deviation from 1 of the cosine between the vertical and the normal of a map; steeper maps are rejected."""


@frozen
@dataclass(frozen=True, eq=False)
class MapSnapshot:
    """Occupancies of a map at one time, with the poses of the robot and of its goal at this time.

    A `Recording` consists of snapshots.  A node of a robot makes them from its messages (`of_message`, `updated`).

    Attributes
    ----------
    occupancy : ndarray of int8, shape (height, width)
        Occupancies in percent as in ``nav_msgs/OccupancyGrid``, -1 for unknown; row 0 is at the bottom.  The shape is
        (0, 0) where there is no usable map, and `note` then gives the reason.
    resolution : float
        Width of a cell in metres.
    origin : tuple of float
        Lower left corner of the map (x, y) in metres, and its yaw in radians.
    frame_id : str
        Coordinate frame of the map; starts and goals are in this frame.
    stamp : int
        Time stamp of the message in nanoseconds.
    received : int
        Time of arrival of the message in nanoseconds.
    kind : {"map", "update", "goal"}
        Message that led to this snapshot: a whole map, an update of a part, or a new goal on the same map.
    start : tuple of float or None
        Pose of the robot (x, y, yaw); None if it is unknown.
    goal : tuple of float or None
        Pose of the goal (x, y, yaw) from the recording; None without one.
    note : str or None
        Text about deviations, such as an ignored update, or a pose from another time than `stamp`; None without one.

    Raises
    ------
    InputError
        If the occupancies have not two dimensions, the resolution is not positive, or a number is not finite.

    Examples
    --------
    >>> rg.maps.MapSnapshot(np.zeros((2, 3)), resolution=0.5, start=(0.2, 0.2, 0.0))
    <MapSnapshot map: 3 x 2 cells of 0.5 m in frame 'map' at 0.000000000 s>
    """

    occupancy: NDArray[np.int8]
    resolution: float
    origin: Pose = (0.0, 0.0, 0.0)
    frame_id: str = "map"
    stamp: int = 0
    received: int = 0
    kind: Literal["map", "update", "goal"] = "map"
    start: Pose | None = None
    goal: Pose | None = None
    note: str | None = None

    def __post_init__(self) -> None:
        values = np.asarray(self.occupancy)
        if values.ndim != 2 or values.dtype.kind not in "biuf":
            raise InputError(
                f"occupancy has shape {values.shape} and dtype {values.dtype}; give numbers (height, width)"
            )
        if not (isfinite(self.resolution) and self.resolution > 0):
            raise InputError(
                f"the resolution of the map is {self.resolution:g}; it must be a positive number of metres"
            )
        for name, pose in (("origin", self.origin), ("start", self.start), ("goal", self.goal)):
            if pose is not None and not (len(pose) == 3 and all(map(isfinite, pose))):
                raise InputError(f"{name} = {tuple(pose)} must be three finite numbers: x, y and yaw")
        if not _is_clean(values):
            values = np.where((values >= -1) & (values <= 100), values, -1).astype(np.int8)
        object.__setattr__(self, "occupancy", values)

    def __repr__(self) -> str:
        height, width = self.occupancy.shape
        size = f"{width} x {height} cells of {self.resolution:g} m" if self.has_map else "no map"
        return f"<MapSnapshot {self.kind}: {size} in frame {self.frame_id!r} at {seconds_text(self.stamp)} s>"

    @property
    def has_map(self) -> bool:
        """Whether there is a map with at least one cell."""
        return self.occupancy.size > 0

    @classmethod
    def of_message(cls, message: Any, *, received: int | None = None, start: Pose | None = None) -> MapSnapshot:
        """Return the snapshot of a ``nav_msgs/OccupancyGrid`` message.

        Parameters
        ----------
        message : nav_msgs.msg.OccupancyGrid
            Message of rclpy or of rosbags, or an object with the same attributes.
        received : int, optional
            Time of arrival in nanoseconds; by default the time stamp of the message.
        start : tuple of float, optional
            Pose of the robot (x, y, yaw) in the frame of the map.

        Returns
        -------
        MapSnapshot

        Raises
        ------
        InputError
            If the message is inconsistent, or the map is not horizontal.

        Examples
        --------
        >>> from types import SimpleNamespace as Message
        >>> pose = Message(position=Message(x=-1.0, y=0.0), orientation=Message(x=0.0, y=0.0, z=0.0, w=1.0))
        >>> info = Message(width=3, height=2, resolution=0.5, origin=pose)
        >>> header = Message(stamp=Message(sec=7, nanosec=0), frame_id="map")
        >>> rg.maps.MapSnapshot.of_message(Message(header=header, info=info, data=[0, 0, 100, 0, -1, 0])).occupancy
        array([[  0,   0, 100],
               [  0,  -1,   0]], dtype=int8)
        """
        info, stamp = message.info, stamp_of(message)
        values = _rows(message.data, info.height, info.width)
        place, turn = info.origin.position, info.origin.orientation
        yaw, tilt = yaw_of((turn.x, turn.y, turn.z, turn.w))
        if tilt < 1 - _FLAT:
            raise InputError("the origin of the map is tilted; planning needs a horizontal map")
        return cls(
            values, resolution=_plain(float(info.resolution)), origin=(float(place.x), float(place.y), yaw),
            frame_id=frame_name(message.header.frame_id), stamp=stamp,
            received=stamp if received is None else received, start=start,
        )  # fmt: skip

    def updated(self, message: Any, *, received: int | None = None, start: Pose | None = None) -> MapSnapshot:
        """Return the snapshot after a ``map_msgs/OccupancyGridUpdate`` message.

        As in Nav2 and RViz, an update that extends beyond the map, or belongs to another frame, is ignored as a whole.
        An update without cells changes nothing.

        Parameters
        ----------
        message : map_msgs.msg.OccupancyGridUpdate
            Message of rclpy or of rosbags, or an object with the same attributes.
        received : int, optional
            Time of arrival in nanoseconds; by default the time stamp of the message.
        start : tuple of float, optional
            Pose of the robot (x, y, yaw) in the frame of the map.

        Returns
        -------
        MapSnapshot
            The changed map, with the goal of this snapshot; the same map, with a `note`, for an ignored update.

        Examples
        --------
        >>> from types import SimpleNamespace as Message
        >>> header = Message(stamp=Message(sec=7, nanosec=0), frame_id="map")
        >>> update = Message(header=header, x=1, y=0, width=2, height=1, data=[100, -1])
        >>> rg.maps.MapSnapshot(np.zeros((2, 3)), resolution=0.5).updated(update).occupancy
        array([[  0, 100,  -1],
               [  0,   0,   0]], dtype=int8)
        """
        stamp = stamp_of(message)
        moved = replace(
            self, kind="update", stamp=stamp, received=stamp if received is None else received, start=start, note=None
        )
        reason = self._why_ignored(message)
        if reason is not None:
            return replace(moved, note=f"update ignored: {reason}")
        if not message.width * message.height:
            return moved
        values = self.occupancy.copy()
        rows = slice(message.y, message.y + message.height)
        values[rows, message.x : message.x + message.width] = _rows(message.data, message.height, message.width)
        return replace(moved, occupancy=values)

    def placed(self, start: Any = None, goal: Any = None) -> MapSnapshot:
        """Return the snapshot with the places of the robot and of its goal from messages.

        Parameters
        ----------
        start, goal : geometry_msgs.msg.Pose or geometry_msgs.msg.Transform, optional
            Messages of rclpy or of rosbags, or objects with the same attributes, in the frame of the map.

        Returns
        -------
        MapSnapshot
            The snapshot with these poses; a pose whose message is missing is None.

        Raises
        ------
        InputError
            If a number is not finite.

        Examples
        --------
        >>> from types import SimpleNamespace as Message
        >>> turn = Message(x=0.0, y=0.0, z=1.0, w=0.0)
        >>> transform = Message(translation=Message(x=0.2, y=0.4, z=0.0), rotation=turn)
        >>> rg.maps.MapSnapshot(np.zeros((2, 3)), resolution=0.5).placed(transform).start
        (0.2, 0.4, 3.141592653589793)
        """
        first, last = (None if message is None else pose_of(message) for message in (start, goal))
        return replace(self, start=first, goal=last)

    def _why_ignored(self, message: Any) -> str | None:
        """Return the reason why a message of an update cannot be applied to this map; None if it can."""
        if not self.has_map:
            return "it precedes the first usable map"
        frame = frame_name(message.header.frame_id)
        if frame != self.frame_id:
            return f"its frame is {frame!r}, but that of the map is {self.frame_id!r}"
        height, width = self.occupancy.shape
        if min(message.x, message.y) < 0 or message.x + message.width > width or message.y + message.height > height:
            return (
                f"{message.width} x {message.height} cells at ({message.x}, {message.y}) extend beyond the map of "
                f"{width} x {height} cells"
            )
        if len(message.data) != message.width * message.height:
            return f"it has {len(message.data)} values for {message.width} x {message.height} cells"
        return None


def _is_clean(values: NDArray[Any]) -> bool:
    """Return whether an array can be used without a copy: read-only int8, owner of its data, values from -1 to 100."""
    if values.dtype != np.int8 or values.flags.writeable or not values.flags.owndata:
        return False
    return not values.size or (int(values.min()) >= -1 and int(values.max()) <= 100)


def _plain(resolution: float) -> float:
    """Return a single-precision resolution as the shortest decimal number with this value: 0.05, not 0.0500001.

    A map with this resolution has exactly the axes of the map file from which the message was made.
    """
    single = np.float32(resolution)
    return float(str(single)) if float(single) == resolution else resolution


def _rows(data: Any, height: int, width: int) -> NDArray[np.int8]:
    """Return the values of a message as an array (height, width); raise InputError for a wrong number of values."""
    values = np.asarray(data)
    if values.size != height * width:
        raise InputError(f"the message has {values.size} values for {width} x {height} cells")
    return values.reshape(height, width) if values.size else np.zeros((0, 0), dtype=np.int8)


def stamp_of(message: Any) -> int:
    """Return the time stamp in the header of a ROS message, in nanoseconds."""
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def frame_name(text: str) -> str:
    """Return the name of a coordinate frame without a leading slash, as tf2 compares names."""
    return text.removeprefix("/")


def seconds_text(nanoseconds: int) -> str:
    """Return a time in nanoseconds as text in seconds with nine decimals."""
    sign = "-" if nanoseconds < 0 else ""
    return f"{sign}{abs(nanoseconds) // 10**9}.{abs(nanoseconds) % 10**9:09d}"


def yaw_of(quaternion: tuple[float, float, float, float]) -> tuple[float, float]:
    """Return the heading in radians of a rotation, and the cosine of the angle between its z axis and the vertical.

    `quaternion`: (x, y, z, w) of any positive length; (0, 0, 0, 0), which many nodes send, stands for no rotation.
    Raises InputError for numbers that are not finite.
    """
    norm = hypot(*quaternion)
    if not isfinite(norm):
        raise InputError(f"the orientation {quaternion} is not finite")
    if norm == 0:
        return 0.0, 1.0
    x, y, z, w = (part / norm for part in quaternion)
    return atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)), 1 - 2 * (x * x + y * y)


def pose_of(pose: Any) -> Pose:
    """Return the pose in the plane of a ``geometry_msgs`` Pose or Transform; raise InputError if it is not finite."""
    place = pose.position if hasattr(pose, "position") else pose.translation
    turn = pose.orientation if hasattr(pose, "orientation") else pose.rotation
    yaw, _ = yaw_of((turn.x, turn.y, turn.z, turn.w))
    if not (isfinite(place.x) and isfinite(place.y)):
        raise InputError(f"the position ({place.x}, {place.y}) is not finite")
    return float(place.x), float(place.y), yaw
