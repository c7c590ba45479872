"""The options every verb shares: what stands in for a scene's keys, how a map is read, and how results are told."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import click

from resgrid.cli.report import Report
from resgrid.errors import InputError

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

SOURCE = click.Path(path_type=str, allow_dash=True)

SCENE_OPTIONS: tuple[Decorator, ...] = (
    click.option("--boundary", metavar="RULE", help="What obstacles are: dirichlet (a rail), neumann (open) or wall."),
    click.option("--drive", metavar="DRIVE", help="What drives open obstacles: uniform, or start."),
    click.option("--edge", metavar="RULE", help="The border of the grid: obstacle or open; one per axis with commas."),
    click.option("--resistance", metavar="OHMS", help="Resistance between neighbours, such as 10k."),
    click.option("--goal", metavar="X,Y", multiple=True, help="Goal instead of the scene's; repeatable."),
    click.option("--start", metavar="X,Y", multiple=True, help="Start instead of the scene's; repeatable."),
    click.option("--robot-radius", metavar="R", help="Radius of the robot (a disc) instead of the scene's."),
    click.option("--cells", is_flag=True, help="Goals and starts are cell indices, not world coordinates."),
    click.option("--k", metavar="K", multiple=True, help="Share of the Dirichlet field, 0 to 1; repeatable."),
    click.option("--set", "settings", metavar="KEY=VALUE", multiple=True, help="Any other key, as in the scene file."),
    click.option("--format", metavar="NAME", help="Map: ros, movingai, image, epic or npy, where the name hides it."),
    click.option("--map-dialect", metavar="NAME", help="Map: read a ROS map as nav2 or as ros1."),
    click.option("--unknown", metavar="POLICY", help="Map: unknown ROS cells are an obstacle, or free."),
    click.option("--lethal", metavar="N", help="Map: ROS occupancy (1 to 100) from which a cell is an obstacle."),
    click.option("--passable", metavar="LETTERS", help="Map: MovingAI terrain that is free, such as '.GS'."),
    click.option("--threshold", metavar="N", help="Map: grey values of a picture from here on are free."),
    click.option("--spacing", metavar="H", help="Map: width of a cell, where the map does not say."),
    click.option("--origin", metavar="X,Y", help="Map: lower corner, where the map does not say."),
    click.option("--unit", metavar="NAME", help="Map: unit of lengths, where the map does not say."),
    click.option("--threads", metavar="N", default="1", show_default=True, help="Threads that may solve at a time."),
)
REPORT_OPTIONS: tuple[Decorator, ...] = (
    click.option("--json", "as_json", is_flag=True, help="Print one JSON object on standard output."),
    click.option("-q", "--quiet", is_flag=True, help="Print no messages but errors."),
    click.option("-v", "--verbose", is_flag=True, help="Tell each stage and how long it took."),
    click.option("--debug", is_flag=True, help="Show the traceback of a fault of resgrid itself."),
)

_MAP_KEYS = {
    "format": "format",
    "map_dialect": "dialect",
    "unknown": "unknown",
    "lethal": "lethal",
    "passable": "passable",
    "threshold": "threshold",
    "spacing": "spacing",
    "origin": "origin",
    "unit": "unit",
}
_TEXTS = ("unknown", "passable", "unit", "dialect", "format")


@dataclass(frozen=True)
class SceneChoice:
    """Which scene, and what the command line changes in it.

    `source`: file, or ``-``; `map_options`: how to read a map, for `read_scene`; `changes`: keys of the scene to
    change, for `apply_overrides`; `threads`: how many may solve at a time, for `solve`.
    """

    source: str
    map_options: Mapping[str, Any]
    changes: Mapping[str, Any]
    threads: int = 1


def with_scene(*, required: bool = True, metavar: str = "SCENE") -> Decorator:
    """Give a verb the SCENE argument and the shared options, bundled as ``choice`` (None where SCENE is left out)."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def verb(source: str | None, **values: Any) -> Any:
            given = {key: values.pop(key) for key in _NAMES}
            choice = None if source is None else scene_choice(source, given)
            return function(choice=choice, **values)

        argument = click.argument("source", metavar=metavar, type=SOURCE, required=required)
        return argument(_decorated(verb, SCENE_OPTIONS))

    return decorate


def with_report(function: Callable[..., Any]) -> Callable[..., Any]:
    """Give a verb ``--json``, ``-q`` and ``-v``, bundled as ``report``."""

    @functools.wraps(function)
    def verb(as_json: bool, quiet: bool, verbose: bool, debug: bool, **values: Any) -> Any:
        del debug  # read by the group, where errors end
        return function(report=Report(json=as_json, quiet=quiet, verbose=verbose), **values)

    return _decorated(verb, REPORT_OPTIONS)


def output_option(help_text: str, *, required: bool = False, metavar: str = "FILE") -> Decorator:
    """The option ``-o``."""
    return click.option(
        "-o", "--output", metavar=metavar, type=SOURCE, required=required, help=help_text, callback=_not_empty
    )


def _not_empty(_context: click.Context, _option: click.Parameter, value: str | None) -> str | None:
    if value is not None and not value.strip():
        raise InputError("-o: the name is empty; name a file, or - for standard output")
    return value


def scene_choice(source: str, given: Mapping[str, Any]) -> SceneChoice:
    """Sort the values of `SCENE_OPTIONS` into map options and changes of the scene."""
    changes: dict[str, Any] = {}
    for key in ("boundary", "drive", "resistance"):
        if given[key] is not None:
            changes[key] = given[key]
    if given["edge"] is not None:
        changes["edge"] = [word.strip() for word in given["edge"].split(",")]
        if len(changes["edge"]) == 1:
            changes["edge"] = changes["edge"][0]
    for key in ("goal", "start"):
        if given[key]:
            name = f"{key}_cell" if given["cells"] else key
            changes[name] = [_place(f"--{key}", text, whole=given["cells"]) for text in given[key]]
    if given["k"]:
        changes["k"] = [_number("--k", word) for text in given["k"] for word in text.split(",")]
    if given["robot_radius"] is not None:
        changes["robot.radius"] = _number("--robot-radius", given["robot_radius"])
    for setting in given["settings"]:
        key, equals, value = setting.partition("=")
        if not equals or not key.strip():
            raise InputError(f"--set {setting!r}: expected KEY=VALUE, such as chip.supply=3.3")
        changes[key.strip()] = value.strip()
    return SceneChoice(source, _map_options(given), _consistent(changes), _threads(given["threads"]))


def _threads(text: str) -> int:
    if not text.strip().isdecimal() or int(text) < 1:
        raise InputError(f"--threads {text!r}: expected a whole number, at least 1")
    return int(text)


def _consistent(changes: dict[str, Any]) -> dict[str, Any]:
    """A boundary asked for here stands alone: the scene's blends and drive belong to the scene's own boundary."""
    if "boundary" in changes:
        changes.setdefault("k", [])
        if changes["boundary"] != "neumann":
            changes.setdefault("drive", None)
    return changes


def _map_options(given: Mapping[str, Any]) -> dict[str, Any]:
    options: dict[str, Any] = {}
    for name, key in _MAP_KEYS.items():
        text = given[name]
        if text is None:
            continue
        if key in _TEXTS:
            options[key] = text
        elif key == "origin":
            options[key] = list(_place("--origin", text, whole=False))
        else:
            number = _number(f"--{name}", text)
            options[key] = int(number) if key != "spacing" and number == int(number) else number
    return options


def _place(option: str, text: str, *, whole: bool) -> tuple[float, ...]:
    try:
        return tuple(int(word) if whole else float(word) for word in text.split(","))
    except ValueError:
        kind = "whole numbers (cell indices)" if whole else "numbers"
        raise InputError(f"{option} {text!r}: expected {kind} separated by commas, such as 3,4") from None


def _number(option: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        raise InputError(f"{option} {text!r}: expected a number") from None
    if not abs(number) < float("inf"):
        raise InputError(f"{option} {text!r}: expected a finite number")
    return number


def _decorated(function: Callable[..., Any], options: tuple[Decorator, ...]) -> Callable[..., Any]:
    for option in reversed(options):
        function = option(function)
    return function


_NAMES = (
    "boundary", "drive", "edge", "resistance", "goal", "start", "robot_radius", "cells", "k", "settings", "threads",
    *_MAP_KEYS,
)  # fmt: skip
