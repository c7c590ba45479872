"""The examples of the live page: shipped scenes with two axes, each with a title and a sentence on its result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from resgrid._internal.values import frozen
from resgrid.errors import InputError
from resgrid.scene import Scene, read_scene
from resgrid.scene.overrides import apply_overrides
from resgrid.scene.shipped import shipped_scenes


@frozen
@dataclass(frozen=True)
class Example:
    """An example of the live page.

    `scene`: name of the shipped scene; `title`: title in the menu and of the opened scene; `about`: one sentence on the
    result to observe; `group`: heading in the menu; `changes`: values of scene keys that differ from those of the file.
    """

    scene: str
    title: str
    about: str
    group: str
    changes: Mapping[str, Any] = field(default_factory=dict)


_FIRST, _BOUNDARY, _CHIP, _ARM = "First examples", "Obstacles and costs", "Chips", "Robots with two joints"

EXAMPLES: Mapping[str, Example] = {
    "lesson": Example(
        "lesson", "Eight by eight",
        "All resistors of the grid: every node voltage is the mean of its four neighbours, and the path goes downhill.",
        _FIRST,
    ),
    "rooms": Example(
        "rooms", "Rooms",
        "Three starts and two goals in a flat: every path reaches a goal, and keeps away from walls and furniture.",
        _FIRST,
    ),
    "maze": Example(
        "maze", "Maze",
        "The drop decreases by more than 60 decades, and the path still leads through every turn, past all dead ends.",
        _FIRST,
    ),
    "ring": Example(
        "ring", "Ring",
        "The angle is periodic: the path from the first start leaves at the left edge and enters at the right edge.",
        _FIRST,
    ),
    "corridor": Example(
        "corridor", "Corridor, k = 1 (Dirichlet)",
        "All paths turn to the middle of the corridor, and the drop decreases by a factor of about 20 per metre.",
        _BOUNDARY, {"k": [1.0]},
    ),
    "corridor_open": Example(
        "corridor", "Corridor, k = 0 (Neumann)",
        "The same corridor with open obstacles: paths keep their distance from the walls until they are near the goal.",
        _BOUNDARY, {"k": [0.0]},
    ),
    "blend": Example(
        "rooms", "Rooms, a blend with k = 0.97",
        "Tick Paths for k = 0 and k = 1: the clearance of path 2 is 0.11 m at k = 0, 0.22 m here, and 0.25 m at k = 1.",
        _BOUNDARY, {"k": [0.97]},
    ),
    "mud": Example(
        "mud", "Cost map",
        "Mud has 0.03 of the conductivity of the ground: the paths from the left bend around the mud.",
        _BOUNDARY,
    ),
    "mismatch": Example(
        "lesson", "Chip with a mismatch of 20 %",
        "Every resistor differs from its nominal value: the path (white) differs from that of the ideal chip (thin).",
        _CHIP, {"chip.mismatch": 0.2, "chip.seed": 3},
    ),
    "chip": Example(
        "chip", "A planning chip of 16 x 16 cells",
        "Press Show transient: with 100 kΩ and 60 fF per node, the voltages settle in less than a microsecond.",
        _CHIP,
    ),
    "problem_a": Example(
        "problem_a", "Problem A",
        "The grid is the space of an arm's joint angles; both are periodic, and the arm moves around a rectangle.",
        _ARM,
    ),
    "problem_b": Example(
        "problem_b", "Problem B",
        "One start has a path, and two have none: grey configurations are separated from every goal.",
        _ARM,
    ),
    "problem_two_goals": Example(
        "problem_two_goals", "Two goals",
        "Starts 1 and 2 are neighbours and reach different goals, because each lies in the basin of another goal.",
        _ARM,
    ),
    "chair": Example(
        "chair", "Problem 2: a chair",
        "The arm reaches over the seat of a chair: drag the seat in the workspace, and the cells are computed again.",
        _ARM,
    ),
    "container": Example(
        "container", "Problem 1: a container",
        "Dark cells are angles at which the arm touches the container; the path leads around them to a goal inside it.",
        _ARM,
    ),
    "scara": Example(
        "scara", "SCARA among a post and a bin",
        "The cells of this robot from a URDF file are proven free: a bound on distances excludes every collision.",
        _ARM,
    ),
}  # fmt: skip
"""Examples by name, in the order of the menu."""


def examples() -> Mapping[str, Example]:
    """Return the examples, by name, whose scenes are installed with resgrid; other examples are left out."""
    shipped = shipped_scenes()
    return {name: example for name, example in EXAMPLES.items() if example.scene in shipped}


def example_menu() -> list[dict[str, str]]:
    """Return the entries of the menu for JSON: ``name``, ``title``, ``about`` and ``group`` of every example."""
    return [
        {"name": name, "title": example.title, "about": example.about, "group": example.group}
        for name, example in examples().items()
    ]


def open_example(name: str | None) -> Scene:
    """Return the scene of an example; raise InputError for an unknown name or None."""
    if name is None or name not in examples():
        raise InputError(f"there is no example {name!r}; the examples are {', '.join(examples())}")
    example = EXAMPLES[name]
    scene = read_scene(shipped_scenes()[example.scene])
    return apply_overrides(scene, {"title": example.title, **example.changes}) if example.changes else scene
