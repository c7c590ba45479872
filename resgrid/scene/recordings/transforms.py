"""Transforms between coordinate frames over time, with the rules of tf2, and their reading from a recording.

Rules: between two samples, translations are interpolated linearly and rotations on the shortest arc (slerp); there is
no extrapolation; static transforms hold at any time; of several samples with one time stamp, the first one counts; if
the parent changes between two samples, the older sample holds until the newer one; transforms with numbers that are not
finite, with a quaternion whose length is not 1, or without two different frames, are ignored.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import acos, hypot, isfinite, sin

from resgrid.scene.recordings.snapshot import Pose, frame_name, stamp_of, yaw_of
from resgrid.scene.recordings.storage import Bag

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

_LONG_GAP = 10 * 10**9
"""Longest time between two samples of a transform, in nanoseconds, without a note that a pose is interpolated.

The buffer of tf2 covers 10 s by default.
"""

_MAX_DEPTH = 1000
"""Largest number of frames that a search for the root of the frames visits, so that it ends at a cycle; as in tf2."""

_UNIT = 0.01
"""Smallest deviation from 1 of the squared length of a quaternion at which tf2 ignores a transform."""


class UncoveredError(Exception):
    """The transforms do not connect two frames at a time; the message gives the reason."""


@dataclass(frozen=True)
class Transform:
    """Rigid motion: the pose of a child frame in its parent frame.

    `shift`: translation in metres; `turn`: rotation as a unit quaternion (x, y, z, w).
    """

    shift: Vector = (0.0, 0.0, 0.0)
    turn: Quaternion = (0.0, 0.0, 0.0, 1.0)

    def after(self, inner: Transform) -> Transform:
        """Return the composition of two transforms: first `inner`, then this one."""
        x, y, z = _rotated(self.turn, inner.shift)
        a, b, c = self.shift
        return Transform((a + x, b + y, c + z), _product(self.turn, inner.turn))

    def inverse(self) -> Transform:
        """Return the inverse transform: the pose of the parent frame in the child frame."""
        x, y, z, w = self.turn
        back = (-x, -y, -z, w)
        a, b, c = _rotated(back, self.shift)
        return Transform((-a, -b, -c), back)

    def towards(self, other: Transform, fraction: float) -> Transform:
        """Return the transform between this one (`fraction` 0) and `other` (1), by linear interpolation and slerp."""
        shift = tuple(a + fraction * (b - a) for a, b in zip(self.shift, other.shift, strict=True))
        return Transform(shift, _slerp(self.turn, other.turn, fraction))  # type: ignore[arg-type]

    @property
    def pose(self) -> Pose:
        """Pose in the plane: x and y in metres, heading in radians."""
        return self.shift[0], self.shift[1], yaw_of(self.turn)[0]


def _product(one: Quaternion, two: Quaternion) -> Quaternion:
    """Return the product of two unit quaternions (x, y, z, w): the rotation by `two`, followed by that by `one`."""
    x, y, z, w = one
    a, b, c, d = two
    return (
        w * a + x * d + y * c - z * b, w * b - x * c + y * d + z * a,
        w * c + x * b - y * a + z * d, w * d - x * a - y * b - z * c,
    )  # fmt: skip


def _rotated(turn: Quaternion, vector: Vector) -> Vector:
    """Return a vector after its rotation by a unit quaternion (x, y, z, w)."""
    x, y, z, w = turn
    return _product(_product(turn, (*vector, 0.0)), (-x, -y, -z, w))[:3]


def _slerp(one: Quaternion, two: Quaternion, fraction: float) -> Quaternion:
    """Return the rotation at a fraction of the shortest arc from rotation `one` (0) to rotation `two` (1)."""
    cosine = sum(a * b for a, b in zip(one, two, strict=True))
    if cosine < 0:
        two, cosine = tuple(-part for part in two), -cosine  # type: ignore[assignment]
    angle = acos(min(cosine, 1.0))
    lead, rest = 1 - fraction, fraction
    if angle > 1e-8:  # below, slerp is linear interpolation to rounding error
        lead, rest = sin(lead * angle) / sin(angle), sin(rest * angle) / sin(angle)
    mixed = [lead * a + rest * b for a, b in zip(one, two, strict=True)]
    norm = hypot(*mixed)
    return tuple(part / norm for part in mixed)  # type: ignore[return-value]


@dataclass(eq=False)
class PoseTrack:
    """Samples of the pose of one frame in its parent frame.

    `is_static`: whether the samples come from static transforms, each of which holds until the next one and the first
    one also before; `stamps`: times in nanoseconds, in the order of arrival; `values`: seven numbers per sample,
    translation in metres and quaternion (x, y, z, w); `parents`: parent frame of each sample.
    """

    is_static: bool
    stamps: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))
    parents: list[str] = field(default_factory=list)
    _order: list[int] | None = None

    def add(self, stamp: int, parent: str, transform: Transform) -> None:
        """Append a sample.

        `stamp`: time stamp in nanoseconds, of a static transform the time of arrival; `parent`: name of the parent
        frame; `transform`: pose of the child frame in the parent frame.
        """
        self.stamps.append(stamp)
        self.values.extend((*transform.shift, *transform.turn))
        self.parents.append(parent)
        self._order = None

    @property
    def order(self) -> list[int]:
        """Indices of the samples in the order of their time stamps; of equal time stamps, only the first one counts."""
        if self._order is None:
            first: dict[int, int] = {}
            for index, stamp in enumerate(self.stamps):
                first.setdefault(stamp, index)
            self._order = [first[stamp] for stamp in sorted(first)]
            self._sorted = [self.stamps[index] for index in self._order]
        return self._order

    @property
    def span(self) -> tuple[int, int]:
        """First and last time stamp of the samples, in nanoseconds."""
        order = self.order
        return self.stamps[order[0]], self.stamps[order[-1]]

    def at(self, stamp: int, *, nearest: bool = False) -> tuple[str, Transform, int]:
        """Return parent frame and pose at a time, and the time in nanoseconds between the samples around it.

        The last result is 0 at a sample, outside the samples, and for a static transform. `stamp`: time in nanoseconds;
        `nearest`: whether the first or last sample replaces a time outside the samples; otherwise such a time raises
        UncoveredError.
        """
        order = self.order
        position = bisect_right(self._sorted, stamp) - 1
        if self.is_static or nearest:
            position = max(position, 0)
        elif position < 0 or stamp > self._sorted[-1]:
            raise UncoveredError("the time lies outside the transforms")
        older = order[position]
        if self.is_static or position + 1 == len(order) or self._sorted[position] >= stamp:
            return self.parents[older], self._transform(older), 0
        newer, begin, end = order[position + 1], self._sorted[position], self._sorted[position + 1]
        if self.parents[newer] != self.parents[older]:
            return self.parents[older], self._transform(older), end - begin
        fraction = (stamp - begin) / (end - begin)
        pose = self._transform(older).towards(self._transform(newer), fraction)
        return self.parents[older], pose, end - begin

    def _transform(self, index: int) -> Transform:
        values = self.values[7 * index : 7 * index + 7]
        return Transform(tuple(values[:3]), tuple(values[3:]))  # type: ignore[arg-type]


class TransformBuffer:
    """All usable transforms of a recording; `tracks`: samples of the pose of each child frame, by its name."""

    def __init__(self) -> None:
        self.tracks: dict[str, PoseTrack] = {}
        self._ignored: dict[str, tuple[int, str]] = {}  # number and frames of the first one, by reason

    def add(
        self, parent: str, child: str, stamp: int, shift: Vector, turn: Quaternion, *, is_static: bool = False
    ) -> None:
        """Add a sample of the pose of the frame `child` in the frame `parent`.

        Transforms that tf2 would ignore are left out, and `ignored` counts them. `stamp`: time in nanoseconds; `shift`:
        translation in metres; `turn`: unit quaternion (x, y, z, w); `is_static`: whether the transform comes from a
        static topic.
        """
        parent, child, norm = frame_name(parent), frame_name(child), hypot(*turn)
        reason = _why_unusable(parent, child, shift, norm)
        if reason is not None:
            count, first = self._ignored.get(reason, (0, f"{parent!r} to {child!r}"))
            self._ignored[reason] = count + 1, first
            return
        unit = tuple(part / norm for part in turn)
        track = self.tracks.setdefault(child, PoseTrack(is_static))
        track.add(stamp, parent, Transform(shift, unit))  # type: ignore[arg-type]

    @property
    def ignored(self) -> str | None:
        """Text with the numbers of transforms that were left out, by reason; None if there are none."""
        if not self._ignored:
            return None
        parts = [f"{count} {reason} ({first})" for reason, (count, first) in self._ignored.items()]
        return f"transforms ignored, as by tf2: {', '.join(parts)}"

    @property
    def frames(self) -> list[str]:
        """Names of all coordinate frames that occur as a parent or child, sorted."""
        return sorted({*self.tracks, *(parent for track in self.tracks.values() for parent in track.parents)})

    def pose(self, frame: str, base: str, stamp: int) -> tuple[Pose, str | None]:
        """Return the pose of the frame `base` in the frame `frame` at a time, and a text about deviations or None.

        `stamp`: time in nanoseconds. If the transforms do not cover this time, the nearest covered time is used, and
        the text gives the difference. Raises UncoveredError if the frames are not connected at any time.
        """
        try:
            transform, gap, _ = self._lookup(frame, base, stamp, nearest=False)
            apart = 0
        except UncoveredError:
            _, _, spans = self._lookup(frame, base, stamp, nearest=True)
            first, last = max(span[0] for span in spans), min(span[1] for span in spans)
            if first > last:
                raise UncoveredError(f"the transforms between {frame!r} and {base!r} never exist together") from None
            nearest = min(max(stamp, first), last)
            transform, gap, _ = self._lookup(frame, base, nearest, nearest=False)
            apart = nearest - stamp
        notes = []
        if apart:
            word = "later" if apart > 0 else "earlier"
            notes.append(f"the pose of the robot is {abs(apart) / 1e9:.3g} s {word} than the message")
        if gap > _LONG_GAP:
            notes.append(f"the pose of the robot is interpolated over {gap / 1e9:.3g} s")
        return transform.pose, "; ".join(notes) or None

    def _lookup(
        self, frame: str, base: str, stamp: int, *, nearest: bool
    ) -> tuple[Transform, int, list[tuple[int, int]]]:
        """Return the pose of `base` in `frame`, the longest time between interpolated samples, and spans of samples.

        `stamp`: time in nanoseconds; `nearest`: whether the first or last sample replaces times outside the samples.
        All times are in nanoseconds; a span is the first and last time stamp of the samples of one frame that is not
        static. Raises UncoveredError if no transforms connect the frames.
        """
        up = self._ancestors(base, stamp, nearest, until={frame})
        down = self._ancestors(frame, stamp, nearest, until=set(up))
        common = next((name for name in down if name in up), None)
        if common is None:
            raise UncoveredError(f"no transforms connect {frame!r} and {base!r}")
        inner, outer = up[common], down[common]
        spans = [*inner[2], *outer[2]] or [(stamp, stamp)]
        return outer[0].inverse().after(inner[0]), max(inner[1], outer[1]), spans

    def _ancestors(
        self, frame: str, stamp: int, nearest: bool, until: set[str]
    ) -> dict[str, tuple[Transform, int, list[tuple[int, int]]]]:
        """Return data of the frame `frame` and its ancestors (parent, parent of the parent, and so on), by their names.

        The data are the pose of the first frame in the ancestor, the longest time between interpolated samples, and the
        first and last time stamps of the samples, in nanoseconds. `stamp`: time; `nearest`: whether the first or last
        sample replaces times outside the samples; `until`: frames at which the search ends. The search also ends at the
        root, at a cycle, and where the samples do not cover the time.
        """
        pose, gap, spans = Transform(), 0, list[tuple[int, int]]()
        found = {frame: (pose, gap, spans)}
        while frame not in until and frame in self.tracks and len(found) < _MAX_DEPTH:
            track = self.tracks[frame]
            try:
                parent, step, between = track.at(stamp, nearest=nearest)
            except UncoveredError:
                break
            if parent in found:  # a cycle of frames
                break
            frame, pose, gap = parent, step.after(pose), max(gap, between)
            spans = spans if track.is_static else [*spans, track.span]
            found[frame] = (pose, gap, spans)
        return found


def _why_unusable(parent: str, child: str, shift: Vector, norm: float) -> str | None:
    """Return the reason for which tf2 ignores a transform, None for a usable one.

    `parent`, `child`: names of the frames; `shift`: translation in metres; `norm`: length of the quaternion.
    """
    if not parent or not child:
        return "without the name of a frame"
    if parent == child:
        return "from a frame to itself"
    if not (isfinite(norm) and all(map(isfinite, shift))):
        return "with a number that is not finite"
    return "with a quaternion whose length is not 1" if abs(norm**2 - 1) >= _UNIT else None


def read_transforms(bag: Bag, topics: Sequence[str]) -> TransformBuffer:
    """Return all transforms on some topics; transforms on topics that end in ``_static`` hold at any time."""
    buffer = TransformBuffer()
    for topic, received, message in bag.messages(topics):
        is_static = topic.endswith("_static")
        for item in message.transforms:
            shift, turn = item.transform.translation, item.transform.rotation
            buffer.add(
                item.header.frame_id, item.child_frame_id, received if is_static else stamp_of(item),
                (shift.x, shift.y, shift.z), (turn.x, turn.y, turn.z, turn.w), is_static=is_static,
            )  # fmt: skip
    return buffer
