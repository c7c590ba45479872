"""``resgrid stream``: plan a path for every map of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

import resgrid as rg
from resgrid.cli.options import (
    OUTPUT,
    OUTPUT_FILE,
    OUTPUT_FOLDER,
    CommandInput,
    SharedOption,
    subcommand,
    with_source,
)
from resgrid.cli.scenes import FIRST_RUN, Job, is_first_run, report_ignored, several_k
from resgrid.cli.terminal import NEGATIVE, counted, finish, say, stage
from resgrid.errors import InputError

if TYPE_CHECKING:
    from resgrid.io.streams import StreamReport


@dataclass(frozen=True)
class _Topics:
    """Options that name topics and the frame of the robot; None: chosen from the recording by type or usual name.

    `map_topic, updates_topic, goal_topic, pose_topic, tf_topic`: topics of maps, of map updates, of goals, of poses of
    the robot, and of transformations between coordinate frames; `base_frame`: name of the robot's frame.
    """

    map_topic: str | None
    updates_topic: str | None
    goal_topic: str | None
    pose_topic: str | None
    tf_topic: str | None
    base_frame: str | None


@subcommand(
    "stream",
    examples=(
        "resgrid stream in.mcap --map /map --goal 5,0 -o out.mcap",
        "resgrid stream in.mcap --goal 5,0 --robot-radius 0.2 --k 0.9 --table latency.csv",
        "resgrid stream in.mcap --goal 5,0 --start=-5,-4 --json",
    ),
)
@with_source("BAG")
@click.option(
    "-o", "--output", cls=SharedOption, group=OUTPUT, metavar="BAG", type=OUTPUT_FOLDER,
    help="Recording of the paths: a file .mcap or .db3 of ROS 2, a file .bag if BAG is one, or a folder of ROS 2.",
)  # fmt: skip
@click.option("--table", metavar="FILE", type=OUTPUT_FILE, help="Table of latencies: FILE.csv, .json or .npz.")
@click.option("--map", "map_topic", metavar="TOPIC", help="Topic of the maps.  [default: the only one]")
@click.option("--updates", metavar="TOPIC", help="Topic of map updates.  [default: that of the maps with _updates]")
@click.option("--goal-topic", metavar="TOPIC", help="Topic of goals, in place of --goal.")
@click.option("--pose-topic", metavar="TOPIC", help="Topic of poses of the robot, such as /amcl_pose.")
@click.option("--tf", metavar="TOPIC", help="Topic of the transforms.  [default: tf in the namespace of the maps]")
@click.option("--base-frame", metavar="FRAME", help="Frame of the robot.  [default: base_link or base_footprint]")
@click.option("--plan-topic", metavar="TOPIC", default="/plan", help="Topic of the paths in the new recording.")
def command(
    source: CommandInput, output: str | None, table: str | None, map_topic: str | None, updates: str | None,
    goal_topic: str | None, pose_topic: str | None, tf: str | None, base_frame: str | None, plan_topic: str,
) -> int:  # fmt: skip
    """Plan a path for every map and map update of the recording BAG, from the place of the robot at this time.

    BAG is a .bag file of ROS 1, or a folder, .db3 or .mcap file of ROS 2. ROS is not needed. The work of each frame is
    reused for the next one. The new recording has one nav_msgs/Path per frame, which has no poses if no goal is
    reached. The table has outcome, length, clearance and processor time of every frame. Coordinates are those of the
    frame of the map. Exits with 1 if no frame has a path.
    """
    from resgrid.io.streams import check_latency_file

    if table is not None:
        check_latency_file(table)
    topics = _Topics(map_topic, updates, goal_topic, pose_topic, tf, base_frame)
    report = _streamed(source, topics, output, plan_topic)
    if table is not None:
        report.save(table)
        say(f"wrote {table}")
    rows = [dict(zip(report.table, row, strict=True)) for row in zip(*report.table.values(), strict=True)]
    data = {"recording": source.file, **report.summary(), "rows": rows, **_report_ignored(report)}
    finish(data, _lines(report), written=output, more=True)
    return 0 if report.reached else NEGATIVE


def _streamed(source: CommandInput, topics: _Topics, output: str | None, plan_topic: str) -> StreamReport:
    """Plan a path for every frame (map or map update) of a recording, and return the results of all frames.

    `source`: the recording with the changes of the scene; `topics`: options that name topics; `output`: new recording
    of the paths, None for none; `plan_topic`: topic of the paths in the new recording.
    """
    if source.file == "-":
        raise InputError("a recording cannot be read from standard input; give a file or folder")
    changes = dict(source.changes)
    has_goal, has_start = (_has(changes, key) for key in ("goal", "start"))
    if has_goal and topics.goal_topic is not None:
        raise InputError("--goal and --goal-topic exclude each other; leave one of them out")
    if has_start and (topics.pose_topic or topics.tf_topic or topics.base_frame):
        raise InputError("--start fixes the place of the robot: leave out --pose-topic, --tf and --base-frame")
    tolerance = 0.0 if has_goal else changes.pop("goal_tolerance", 0.0)
    planner = rg.maps.StreamPlanner.of_changes(source.map_options, changes, source.file, tolerance)
    with stage("read the recording"):
        recording = rg.maps.read_bag(source.file, **vars(topics), poses=not has_start, goals=not has_goal)
    if source.threads > 1:
        say("ignored: --threads: updates of a map use one thread")
    if is_first_run():
        say(FIRST_RUN)
    with stage("plan the frames") as running:
        return rg.maps.stream_bag(recording, planner, output, topic=plan_topic, progress=running.count)


def _has(changes: Mapping[str, Any], key: str) -> bool:
    """Return whether options give the goals or the starts of the scene.

    `changes`: new values by key path; `key`: "goal" or "start".
    """
    names = {name.replace("[", ".").partition(".")[0] for name in changes}
    return bool(names & {key, f"{key}_cell", f"{key}s"})


def _report_ignored(report: StreamReport) -> dict[str, list[str]]:
    """Print the keys of the scene that have no effect on paths; return ``{"ignored": keys}`` for JSON.

    The dictionary is empty if no frame was solved.
    """
    last = report.last
    if last is None or last.scene is None or last.planner is None:
        return {}
    if several_k(last.scene):
        say(f"ignored: k = {', '.join(f'{k:g}' for k in last.scene.k[1:])}: the paths follow one blend")
    return report_ignored(Job(last.scene, last.planner.space), "grid")


def _lines(report: StreamReport) -> list[str]:
    """Return the summary of a report as lines of text: counts, reasons, solution methods, and times per frame.

    Each outcome without a certified path (such as ``no_path``) has a line with the reason of its first frame.
    """
    lines = [f"{counted(report.frames, 'frame')}: {report.reached} with a certified path"]
    columns = (report.table[name] for name in ("frame", "outcome", "certified", "reason"))
    seen = set[str]()
    for frame, outcome, certified, reason in zip(*columns, strict=True):
        word = "not certified" if outcome == "reached" else outcome
        if (outcome != "reached" or not certified) and word not in seen:
            seen.add(word)
            lines.append(f"{word}: {report.table['outcome'].count(outcome)}, first in frame {frame}: {reason}")
    counts = [f"{name} {count}" for name, count in report.summary()["methods"].items() if name != "none"]
    lines.append(f"solved: {', '.join(counts) or 'no frame'}")
    if report.median == report.median:
        lines.append(
            f"processor time per frame: median {report.median:.1f} ms, 95 % within {report.percentile_95:.1f} ms"
        )
    return lines
