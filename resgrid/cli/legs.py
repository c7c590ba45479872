"""``resgrid path`` for paths of several legs, such as through intermediate poses: computation and report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import resgrid as rg
from resgrid.cli.options import CommandInput, cell_indices
from resgrid.cli.scenes import load_scene, place_of, require_starts
from resgrid.cli.terminal import NEGATIVE, finish, say, stage

if TYPE_CHECKING:
    from collections.abc import Sequence

    from resgrid.planning.legs import LegPath


def answer_legs(
    source: CommandInput, output: str | None, via: Sequence[Sequence[float]], *, in_cells: bool, approximate: bool,
    escape: bool,
) -> int:  # fmt: skip
    """Compute and report the paths of several legs from all starts of a scene; return the exit code.

    The exit code is 0 if all paths reach a goal, otherwise 1.  `source`: input with its options; `output`: file of the
    paths, None for none; `via`: intermediate places in world coordinates, or, with `in_cells`, cell indices;
    `approximate`: whether to end at the reachable place nearest to a goal that cannot be reached; `escape`: whether a
    robot that touches an obstacle at the start first leaves it on a straight line, which is not certified.
    """
    from resgrid.io.leg_paths import leg_record, write_leg_paths
    from resgrid.io.tables import suffix_of
    from resgrid.scene.tolerances import goal_heading

    if output is not None:
        suffix_of(output, ("table", "record", "arrays", "message"), "a path of several legs")
    with stage("read the scene"):
        scene = load_scene(source)
    require_starts(scene)
    if len(scene.k) > 1:
        say(f"ignored: k = {', '.join(f'{k:g}' for k in scene.k[1:])}: a path of several legs follows one blend")
    places: Sequence[Sequence[float] | rg.GoalCell] = via
    if in_cells:
        places = [rg.GoalCell(cell_indices("--via", place)) for place in via]
    paths = []
    for start in scene.starts:
        with stage("plan the legs"):
            paths.append(rg.plan_legs(scene, start, via=places, approximate=approximate, escape=escape))
    ends = [path.legs[-1] if path.legs else None for path in paths]
    headings = [goal_heading(scene, leg.path.points[-1]) if leg and leg.kind == "goal" else None for leg in ends]
    written = output is not None
    if output is not None and Path(output).suffix.lower() == ".yaml":
        written = any(path.outcome == "reached" or path.distance is not None for path in paths)
        if not written:
            say(f"{output} is not written, because no path reaches a goal")
    if output is not None and written:
        write_leg_paths(paths, output, headings=headings)
    data = {"scene": scene.title, "paths": [leg_record(path) for path in paths]}
    finish(data, [_line(path) for path in paths], written=output if written else None)
    return 0 if all(path.outcome == "reached" for path in paths) else NEGATIVE


def _line(path: LegPath) -> str:
    """Return the line of text about a path: start, outcome, end, length, and the kinds of its legs.

    Legs without a certificate are marked.
    """
    head = f"start {place_of(path.start)}: {path.outcome}"
    if path.reason is not None:
        head += f": {path.reason}"
    if not path.legs:
        return head
    legs = ", ".join(leg.kind + ("" if leg.certified else " (not certified)") for leg in path.legs)
    away = "" if path.distance is None else f", {path.distance:.4g} from the goal"
    return f"{head}; ends at {place_of(path.points[-1])}{away}, length {path.length:.6g}, legs: {legs}"
