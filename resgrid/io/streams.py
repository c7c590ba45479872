"""`stream_bag`: plans a path for every map of a recording, and writes a new recording and a latency table."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from resgrid._internal.values import frozen
from resgrid.errors import InputError
from resgrid.io.bags import BagWriter, check_bag_output, whole_bag
from resgrid.io.tables import Views, suffix_of, write
from resgrid.planning.stream_planner import StreamedPath, StreamPlanner
from resgrid.scene.recordings.recording import Recording
from resgrid.scene.recordings.storage import PATH, check_topic_name

_VIEWS = ("table", "record", "arrays")

NOT_PLANNED = "not_planned"
"""Value of the column ``outcome`` for a message (map, update or goal) at which map, start or goal are still unknown."""


@frozen
@dataclass(frozen=True, eq=False)
class StreamReport:
    """Results for all frames of a recording, i.e. its maps, updates of maps and goals.

    Returned by `resgrid.maps.stream_bag`.

    Attributes
    ----------
    table : dict of list
        One column per name, with one entry per frame: ``frame`` (index), ``stamp`` and ``received`` (nanoseconds),
        ``kind`` (map, update, goal), ``changed`` (number of cells of the configuration space that changed between free,
        obstacle and goal), ``method`` of the solution (fresh, elimination, unchanged; none if nothing was solved),
        ``outcome`` (``not_planned`` if map, start or goal are missing), ``certified``, ``length`` and ``clearance`` in
        metres (NaN without a path), ``x``, ``y`` (start), ``milliseconds`` (processor time from the occupancies to the
        certified path), ``reason`` (why no goal is reached), ``note`` (problems of the message, such as an ignored
        update or a pose from another time than the map; None without any).
    last : StreamedPath or None
        Result for the last frame; None if the recording has no frame.
    frames : int
        Number of frames.
    reached : int
        Number of frames with a certified path to a goal.
    median, percentile_95 : float
        Median and 95th percentile of the processor time of the solved frames in milliseconds, without the first one
        unless it is the only one; NaN if no frame was solved.

    Examples
    --------
    >>> maps = [rg.maps.MapSnapshot(np.zeros((4, 6)), 0.5, start=(0.2, 0.2, 0.0), stamp=k) for k in range(3)]
    >>> recording = rg.maps.read_bag(rg.maps.write_bag(maps, "in.mcap"))
    >>> report = rg.maps.stream_bag(recording, rg.maps.StreamPlanner(goal=(2.75, 1.75)))
    >>> report
    <StreamReport of 3 frames: 3 with a path>
    >>> report.table["method"]
    ['fresh', 'elimination', 'elimination']
    """

    table: dict[str, list[Any]]
    last: StreamedPath | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        return f"<StreamReport of {self.frames} frames: {self.reached} with a path>"

    @property
    def frames(self) -> int:
        """Number of frames: maps, updates of maps and goals in the recording."""
        return len(self.table["frame"])

    @property
    def reached(self) -> int:
        """Number of frames (maps, updates and goals) with a certified path to a goal."""
        pairs = zip(self.table["outcome"], self.table["certified"], strict=True)
        return sum(outcome == "reached" and certified for outcome, certified in pairs)

    @cached_property
    def _times(self) -> list[float]:
        """Processor time of each frame (map, update or goal) that required a solve, in milliseconds.

        The first such frame is left out unless it is the only one, because it cannot reuse earlier work.
        """
        pairs = zip(self.table["method"], self.table["milliseconds"], strict=True)
        times = [milliseconds for method, milliseconds in pairs if method != "none"]
        return times[1:] or times

    @property
    def median(self) -> float:
        """Median of the processor time per solved frame, in milliseconds; NaN if no frame was solved.

        The first solved frame is left out unless it is the only one.
        """
        return float(np.median(self._times)) if self._times else float("nan")

    @property
    def percentile_95(self) -> float:
        """95th percentile of the processor time per solved frame, in milliseconds; NaN if no frame was solved.

        The first solved frame is left out unless it is the only one.
        """
        return float(np.percentile(self._times, 95)) if self._times else float("nan")

    def summary(self) -> dict[str, Any]:
        """Return counts and times as a dictionary for JSON.

        Returns
        -------
        dict
            ``frames``, ``reached``, ``outcomes`` and ``methods`` (numbers of frames by name), ``median_ms``,
            ``percentile_95_ms``.
        """
        counts = {
            name: {value: self.table[column].count(value) for value in dict.fromkeys(self.table[column])}
            for name, column in (("outcomes", "outcome"), ("methods", "method"))
        }
        times = {"median_ms": self.median, "percentile_95_ms": self.percentile_95}
        return {"frames": self.frames, "reached": self.reached, **counts, **times}

    def save(self, file: str | os.PathLike[str]) -> Path:
        """Write the table to a file, atomically.

        Parameters
        ----------
        file : path-like
            ``.csv``, ``.json`` or ``.npz``.

        Returns
        -------
        pathlib.Path
            The file.

        Raises
        ------
        InputError
            If the suffix is unknown or the file cannot be written.
        """
        views: Views = {
            "table": lambda: self.table,
            "record": lambda: {**self.summary(), "columns": self.table},
            "arrays": lambda: {name: np.array(_without_none(column)) for name, column in self.table.items()},
        }
        return write(file, views, "a table of latencies")


def check_latency_file(file: str) -> None:
    """Raise InputError unless the suffix of a file is ``.csv``, ``.json`` or ``.npz``."""
    suffix_of(file, _VIEWS, "a table of latencies")


def stream_bag(
    recording: Recording,
    planner: StreamPlanner,
    file: str | os.PathLike[str] | None = None,
    *,
    topic: str = "/plan",
    progress: Callable[[int, int], object] | None = None,
) -> StreamReport:
    """Plan every frame of a recording, write the paths to a new recording, and report the latencies.

    A frame is a map, an update of a map, or a goal.  For every frame one ``nav_msgs/Path`` is written, with the time of
    arrival and the time stamp of the frame, in the coordinate frame of the map.  The message has no poses if there is
    no certified path, so that no outdated path remains.

    Parameters
    ----------
    recording : Recording
        The recording, from `read_bag`.
    planner : StreamPlanner
        Planner with the options of the scene.
    file : path-like, optional
        New recording, which replaces an existing one at the end; after an error, nothing is changed.  By default no
        recording is written.  A name that ends in ``.bag`` is a file of ROS 1, and needs an input of ROS 1; ``.mcap``
        and ``.db3`` are files of ROS 2; other names are folders of ROS 2.
    topic : str
        Topic of the paths, a name that ROS allows.
    progress : callable, optional
        Called as ``progress(done, total)`` after every frame.

    Returns
    -------
    StreamReport
        One row per frame.

    Raises
    ------
    InputError
        If the recording is damaged, the new one cannot be written, the name of the topic is not allowed, or an option
        does not fit the map.

    Examples
    --------
    >>> maps = [rg.maps.MapSnapshot(np.zeros((4, 6)), 0.5, start=(0.2, 0.2, 0.0), stamp=k) for k in range(3)]
    >>> recording = rg.maps.read_bag(rg.maps.write_bag(maps, "in.bag"))
    >>> report = rg.maps.stream_bag(recording, rg.maps.StreamPlanner(goal=(2.75, 1.75)), "out.bag")
    >>> report.reached, report.table["outcome"]
    (3, ['reached', 'reached', 'reached'])
    """
    check_topic_name(topic, "topic (--plan-topic)")
    table: dict[str, list[Any]] = {name: [] for name in _COLUMNS}
    total, last = len(recording), None
    if file is not None:
        _require_other(recording, check_bag_output(file, recording.storage))
    with nullcontext() if file is None else _paths_bag(file, recording, topic) as bag:
        for done, result in enumerate(planner.paths(recording)):
            if bag is not None:
                bag.write(topic, result.snapshot.received, bag.path(result))
            for name, value in zip(_COLUMNS, _row(done, result), strict=True):
                table[name].append(value)
            last = result
            if progress is not None:
                progress(done + 1, total)
    return StreamReport(table, last)


def _require_other(recording: Recording, target: Path) -> None:
    """Raise InputError if the new recording `target` would replace `recording`, from which it is made."""
    if target.exists() and (target.samefile(recording.file) or target.samefile(recording.file.absolute().parent)):
        raise InputError(f"cannot write {target}: this is the input; name another recording")


@contextmanager
def _paths_bag(file: str | os.PathLike[str], recording: Recording, topic: str) -> Iterator[BagWriter]:
    """Yield the writer of a new recording, which has a topic of paths; after an error, no new recording exists.

    `recording`: recording from which the paths are made; `topic`: name of the topic.
    """
    with whole_bag(file, recording.storage) as bag:
        bag.add(topic, PATH)
        yield bag


_COLUMNS = (
    "frame", "stamp", "received", "kind", "changed", "method", "outcome", "certified", "length", "clearance", "x", "y",
    "milliseconds", "reason", "note",
)  # fmt: skip
"""Names of the columns of the table of results, with one row per frame (map, update or goal of a recording)."""


def _row(number: int, result: StreamedPath) -> tuple[Any, ...]:
    """Return the row of the table of results for one frame, from its index and time stamp to the note on the message.

    `number`: index of the frame (a map, an update or a goal); `result`: the planned path and its times.
    """
    snapshot, nan, report = result.snapshot, float("nan"), result.replanning
    method = "none" if not result.solved else "fresh" if report is None else report.method
    changed = 0
    if result.solved and result.planner is not None:
        changed = result.planner.space.cell.size if report is None else report.changed
    x, y = (result.start or snapshot.start or (nan, nan))[:2]
    return (
        number, snapshot.stamp, snapshot.received, snapshot.kind, changed, method,
        NOT_PLANNED if result.outcome is None else str(result.outcome), result.certified,
        nan if result.length is None else result.length, nan if result.clearance is None else result.clearance, x, y,
        round(1e3 * result.seconds, 3), result.reason, snapshot.note,
    )  # fmt: skip


def _without_none(column: list[Any]) -> list[Any]:
    """Return the entries of a column as a list with empty texts in place of None."""
    return ["" if value is None else value for value in column]
