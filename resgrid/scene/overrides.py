"""Single keys of a scene changed from outside: what the command line's options do."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from resgrid.errors import InputError
from resgrid.robots import ROBOTS, Robot
from resgrid.scene.goals import CostArea, GoalJoints
from resgrid.scene.read import Document, build_scene
from resgrid.scene.scene import IN_FILES, LISTS, Scene
from resgrid.scene.table import plain

SHORT = {"resistance": "chip.resistance", "supply": "chip.supply", "radius": "robot.radius"}
_WIRING = re.compile(r"(boundary|drive|k|start|start_cell|chip\..*)$")
PLACES = {"goal": "point", "goal_cell": "cell", "start": "point", "start_cell": "cell"}


def document_of(scene: Scene) -> dict[str, Any]:
    """The document that describes a scene; the inverse of `build_scene`."""
    document = {"schema": 1, "robot": _robot_table(scene.robot), "starts": plain(scene.starts)}
    for key in IN_FILES:
        value = getattr(scene, key)
        if value is not None:
            document[key] = plain(value)
    rules = [*dict.fromkeys(rule for rule in scene.edge if rule != "periodic")]
    document["edge"] = rules if len(rules) == 1 else list(scene.edge)  # one for all axes, also those of another robot
    if scene.map is not None:
        document["map"] = plain(scene.map.table)
    if scene.map is None or scene.axes[: len(scene.map.axes)] != scene.map.axes:
        document["grid"] = {"axes": [plain(axis) for axis in scene.axes]}
    for key, attribute in LISTS.items():
        document[key] = [_table(value) for value in getattr(scene, attribute)]
    return document


def _table(value: Any) -> dict[str, Any]:
    """The table of a shape, a goal or an area."""
    from resgrid.scene.schema import SHAPES

    if isinstance(value, CostArea):
        return _table(value.shape) | {"conductivity": value.conductivity}
    if isinstance(value, GoalJoints):
        lower, upper = list(value.lower), list(value.upper)
        return {"joints": lower} if lower == upper else {"joints_lower": lower, "joints_upper": upper}
    names = [name for name, (kind, _) in SHAPES.items() if kind is type(value)]
    return {**({"shape": names[0 if value.ndim == 2 else -1]} if names else {}), **plain(value)}


def _robot_table(robot: Robot) -> dict[str, Any]:
    kinds = {kind: name for name, kind in ROBOTS.items()}
    if type(robot) not in kinds:
        raise InputError(f"a scene file cannot describe a {type(robot).__name__}; register it in resgrid.robots.ROBOTS")
    table = {"type": kinds[type(robot)], **plain(robot)}
    if "lengths" in table:  # one list of links in place of three
        columns = zip(table.pop("lengths"), table.pop("widths"), table.pop("limits"), strict=True)
        links = [{"length": length, "width": width, "limits": limits} for length, width, limits in columns]
        table["links"] = [{key: value for key, value in link.items() if value is not None} for link in links]
    return table


def apply_overrides(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """The same scene with some keys changed, checked like a scene file.

    A key path is written as in error messages (``chip.resistance``, ``obstacle[2].radius``, or with dots:
    ``obstacle.2.radius``); ``resistance``, ``supply`` and ``radius`` alone are enough.  ``goal``, ``goal_cell``,
    ``start`` and ``start_cell`` take one place or a list of them and replace all goals or starts; world coordinates, or
    cell indices counted from 0.  A text is read as TOML would read it (``"4.5"`` is a number, ``"[0, 1]"`` a list), as
    numbers separated by commas, or else as itself.  Another ``robot.type`` or ``robot.footprint`` is another robot.
    """
    document, changes = document_of(scene), _by_key(changes)
    if {"robot.type", "robot.footprint"} & changes.keys():
        document["robot"] = {}
    _apply(document, changes)
    grid = document.get("grid")
    if "grid.cells" in changes and isinstance(grid, dict) and isinstance(grid.get("axes"), list):
        for axis in grid["axes"]:
            if isinstance(axis, dict):
                axis.pop("cells", None)
    is_same_map = scene.map is not None and document.get("map") == plain(scene.map.table)
    return build_scene(document, scene.source or "scene", Path(), known=scene.map if is_same_map else None)


def build_changed(document: Document, changes: Mapping[str, Any]) -> Scene:
    """The scene of a document with some keys changed, as by `apply_overrides`.

    How it is wired may be said by both together: a wall here, its resistance there.
    """
    by_key = _by_key(changes)
    wiring = {key: value for key, value in by_key.items() if _WIRING.match(key)}
    _apply(document.raw, wiring)
    said = {("start" if key in PLACES else key.partition(".")[0],) for key in wiring}
    lines = {path: line for path, line in document.lines.items() if path[:1] not in said}
    scene = build_scene(document.raw, document.source, document.folder, lines)
    return apply_overrides(scene, changes) if changes else scene


def _by_key(changes: Mapping[str, Any]) -> dict[str, Any]:
    """Changes by whole keys, rules of edges as a list."""
    by_key = {SHORT.get(key, key): value for key, value in changes.items()}
    edge = by_key.get("edge")
    if isinstance(edge, str) and "," in edge and "[" not in edge:
        by_key["edge"] = [rule.strip() for rule in edge.split(",")]
    return by_key


def _apply(document: dict[str, Any], changes: Mapping[str, Any]) -> None:
    """Set keys of a document; goals and starts replace all that there are."""
    for key in ("goal", "start"):
        places = _places(key, changes)
        if places is not None:
            document[key] = places
            if key == "start":
                document["starts"] = []
    for key, value in changes.items():
        if key not in PLACES:
            _set(document, key, value)


def parse_value(text: str) -> Any:
    """The value that a text from a command line stands for: ``0.5, 2`` a list, ``4k7`` text, ``false`` False."""
    for attempt in (text, f"[{text}]") if "," in text else (text,):
        try:
            table = tomllib.loads(f"value = {attempt}")
        except (tomllib.TOMLDecodeError, RecursionError, ValueError):
            continue
        if list(table) == ["value"]:
            return table["value"]
    return text


def _places(key: str, changes: Mapping[str, Any]) -> list[dict[str, Any]] | None:
    given = [(name, _parsed(changes[name])) for name in (key, f"{key}_cell") if name in changes]
    if not given:
        return None
    places = []
    for name, value in given:
        entries = plain(value)
        nested = isinstance(entries, list) and bool(entries) and isinstance(entries[0], list | dict | str)
        for entry in entries if nested else [entries]:
            parsed = plain(_parsed(entry))
            places.append(parsed if isinstance(parsed, dict) else {PLACES[name]: parsed})
    return places


def _set(document: dict[str, Any], key: str, value: Any) -> None:
    parts = key.replace("[", ".").replace("]", "").split(".")
    node: Any = document
    for position, part in enumerate(parts[:-1]):
        step = _step(node, part, ".".join(parts[: position + 1]))
        node = node.setdefault(step, {}) if isinstance(node, dict) else node[step]
    last = _step(node, parts[-1], key)
    parsed = plain(_parsed(value))
    if parsed is None and isinstance(node, dict):
        node.pop(last, None)
    else:
        node[last] = parsed
    if last in ("cells", "spacing") and isinstance(node, dict) and parts[0] == "grid":
        node.pop("spacing" if last == "cells" else "cells", None)


def _step(node: Any, part: str, key: str) -> Any:
    if isinstance(node, dict):
        return part
    if isinstance(node, list) and part.isascii() and part.isdigit() and int(part) < len(node):
        return int(part)
    if isinstance(node, list):
        raise InputError(f"{key}: there is no entry {part!r}; the list has {len(node)}, counted from 0")
    raise InputError(f"{key}: there is no such key: what stands before {part!r} is a plain value")


def _parsed(value: Any) -> Any:
    return parse_value(value) if isinstance(value, str) else value
