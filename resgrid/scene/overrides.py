"""Changes of single keys of a scene, as by the options of the command line, and the document of a scene."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from resgrid.errors import InputError
from resgrid.robots import ROBOTS, Mesh, Robot, Voxels
from resgrid.scene.goals import CostArea, GoalJoints, GoalPoint
from resgrid.scene.reading import Document, MapReader, build_scene, with_axes, with_footprint
from resgrid.scene.scene import IN_FILES, LISTS, Scene
from resgrid.scene.table_models import plain
from resgrid.scene.toml_lines import Path as KeyPath

SHORT_KEYS = {"resistance": "chip.resistance", "supply": "chip.supply", "radius": "robot.radius"}
"""Full key paths of the keys that may be given without the name of their table."""

PLACE_KEYS = {"goal": "point", "goal_cell": "cell", "start": "point", "start_cell": "cell"}
"""Keys that replace all goals or starts, mapped to the key that holds the value in the table of a goal or start."""


def document_of(scene: Scene) -> dict[str, Any]:
    """Return the keys and tables of a scene's file as a dictionary, from which `build_scene` builds an equal scene.

    Raises InputError for a robot or a shape that a scene file cannot describe.
    """
    document = {"schema": 1, "robot": _robot_table(scene.robot), "starts": plain(scene.starts)}
    for key in IN_FILES:
        value = getattr(scene, key)
        if value is not None:
            document[key] = plain(value)
    rules = [*dict.fromkeys(rule for rule in scene.edge if rule != "periodic")]
    document["edge"] = rules if len(rules) == 1 else list(scene.edge)  # one rule also fits another robot's axes
    if scene.map is not None:
        document["map"] = plain(scene.map.table)
    if scene.map is None or scene.axes[: len(scene.map.axes)] != scene.map.axes:
        document["grid"] = {"axes": [plain(axis) for axis in scene.axes]}
    for key, attribute in LISTS.items():
        document[key] = [_table(value) for value in getattr(scene, attribute)]
    return document


def _table(value: Any) -> dict[str, Any]:
    """Return a shape, a goal or a cost area as a dictionary with the keys of its table in a scene file.

    For a shape these are ``shape``, the name of the shape in files, and the attributes of its class.
    """
    from resgrid.scene.shape_tables import SHAPES

    if isinstance(value, CostArea):
        return _table(value.shape) | {"conductivity": value.conductivity}
    if isinstance(value, GoalJoints):
        lower, upper = list(value.lower), list(value.upper)
        return {"joints": lower} if lower == upper else {"joints_lower": lower, "joints_upper": upper}
    if isinstance(value, Mesh | Voxels):
        if not value.table:
            raise InputError(f"a scene file describes a {type(value).__name__} by its file; read the shape from a file")
        return plain(value.table)  # type: ignore[no-any-return]
    if isinstance(value, GoalPoint):
        return {key: entry for key, entry in plain(value).items() if key != "tolerance" or entry}
    names = [name for name, (kind, _) in SHAPES.items() if kind is type(value)]
    return {**({"shape": names[0 if value.ndim == 2 else -1]} if names else {}), **plain(value)}


def _robot_table(robot: Robot) -> dict[str, Any]:
    kinds = {kind: name for name, kind in ROBOTS.items()}
    if type(robot) not in kinds:
        raise InputError(f"a scene file cannot describe a {type(robot).__name__}; register it in resgrid.robots.ROBOTS")
    table = {"type": kinds[type(robot)], **plain(robot)}
    if "lengths" in table:  # a file has one list of links
        columns = zip(table.pop("lengths"), table.pop("widths"), table.pop("limits"), strict=True)
        links = [{"length": length, "width": width, "limits": limits} for length, width, limits in columns]
        table["links"] = [{key: value for key, value in link.items() if value is not None} for link in links]
    return table


def apply_overrides(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """Return a scene with some keys changed, validated like a scene file.

    Key paths have the form of error messages (``chip.resistance``, ``obstacle[2].radius``) or use dots only
    (``obstacle.2.radius``); ``resistance``, ``supply`` and ``radius`` need no table.  ``goal``, ``goal_cell``,
    ``start`` and ``start_cell`` take one place or a list of places, in world coordinates or as cell indices from 0,
    and replace all goals or starts.  ``goal_tolerance`` is the tolerance of all goals that are points.  A text is
    parsed as a TOML value (``"4.5"`` is a number, ``"[0, 1]"`` a list) or as numbers separated by commas, and stays a
    text otherwise; None removes the key.  ``robot.type`` and ``robot.footprint`` replace the whole robot.  The order
    of the changes has no effect.  `changes`: new values by key path.
    """
    document = _apply(document_of(scene), changes)
    is_same_map = scene.map is not None and document.get("map") == plain(scene.map.table)
    return build_scene(document, scene.source or "scene", Path(), known=scene.map if is_same_map else None)


def build_changed(document: Document, changes: Mapping[str, Any], known: MapReader | None = None) -> Scene:
    """Return the validated scene of a document with some keys changed.

    `document`: the unvalidated document; `changes`: new values by key path, a text such as ``chip.supply``; values that
    are texts are parsed as TOML values; `known`: function that reads the map, None for a map file.  Only the changed
    document is validated, so the unchanged document may be incomplete.
    """
    lines = _lines_of_file(document.lines, changes)
    return build_scene(_apply(document.raw, changes), document.source, document.folder, lines, known)


def _lines_of_file(lines: Mapping[KeyPath, int], changes: Mapping[str, Any]) -> dict[KeyPath, int]:
    """Return the line number of every key from the scene file, and 0 (no line) for every changed key, by key path.

    `lines`: line numbers in the file by key path (tuple of names and indices); `changes`: new values by key path, a
    text such as ``chip.supply``.
    """
    changed = {_parts(key) for key in _by_key(changes)}
    if ("start",) in changed:
        changed.add(("starts",))
    kept = {path: line for path, line in lines.items() if not any(path[: len(key)] == key for key in changed)}
    return kept | dict.fromkeys(changed, 0)


def _parts(key: str) -> KeyPath:
    """Return the parts of a key path as a tuple: ``obstacle.2.radius`` becomes ``("obstacle", 2, "radius")``.

    ``goal_cell`` and ``start_cell`` become ``("goal",)`` and ``("start",)``, the keys that they replace.
    """
    head, *rest = key.split(".")
    head = head.removesuffix("_cell") if head in PLACE_KEYS else head
    return (head, *(int(part) if part.isascii() and part.isdigit() else part for part in rest))


def _by_key(changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the changes by full key path with dots, sorted so that a table precedes the keys inside this table.

    `changes`: new values by key path, also short (``radius`` for ``robot.radius``) or with brackets.  A text of several
    edge rules becomes a list.  InputError is raised if a key is given twice with different values.
    """
    by_key: dict[str, Any] = {}
    for key, value in changes.items():
        full = SHORT_KEYS.get(key, key).replace("[", ".").replace("]", "")
        if full in by_key and by_key[full] != value:
            raise InputError(f"{full} is given twice, as {by_key[full]!r} and as {value!r}; leave one of them out")
        by_key[full] = value
    edge = by_key.get("edge")
    if isinstance(edge, str) and "," in edge and "[" not in edge:
        by_key["edge"] = [rule.strip() for rule in edge.split(",")]
    return dict(sorted(by_key.items(), key=lambda change: (change[0].count("."), change[0])))


def _apply(raw: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of the document `raw` with some keys changed; goals and starts replace all goals or starts.

    `raw`: keys and tables of a scene file; `changes`: new values by key path; a path is a text with dots or brackets,
    such as ``obstacle.2.radius`` or ``obstacle[2].radius``, and a value that is a text is parsed as a TOML value.  Keys
    of the robot are set first, because the robot may imply axes, whose keys the changes may contain.
    """
    document, by_key = copy.deepcopy(dict(raw)), _by_key(changes)
    if {"robot.type", "robot.footprint"} & by_key.keys():
        document["robot"] = {}
    elif any(key.startswith("robot.") for key in by_key):
        document = dict(with_footprint(document))
    rest = {}
    for key, value in by_key.items():
        if key.partition(".")[0] == "robot":
            _set(document, key, value)
        elif key not in (*PLACE_KEYS, "goal_tolerance"):
            rest[key] = value
    _drop_sizes(document, [key for key in rest if key.startswith("grid.")])
    for key, value in rest.items():
        _set(document, key, value)
    for key in ("goal", "start"):
        places = _places(key, by_key)
        if places is not None:
            document[key] = places
            if key == "start":
                document["starts"] = []
    if "goal_tolerance" in by_key:
        _set_tolerance(document, _parsed(by_key["goal_tolerance"]))
    return document


def _set_tolerance(document: dict[str, Any], tolerance: Any) -> None:
    """Set the tolerance of all goals of a document that are points; raise InputError if no goal is a point.

    `document`: keys and tables of a scene file, changed in place; `tolerance`: the new value, not validated.
    """
    goals = document.get("goal")
    points = [goal for goal in goals if isinstance(goal, dict) and "point" in goal] if isinstance(goals, list) else []
    if not points:
        raise InputError("--goal-tolerance applies to goals that are points, and this scene has none; give --goal X,Y")
    for goal in points:
        goal["tolerance"] = tolerance


def parse_value(text: str) -> Any:
    """Return the value of a text from the command line.

    A text of a TOML value gives this value (``false`` is False), numbers separated by commas give a list (``0.5, 2``),
    and any other text is returned unchanged (``4k7``).
    """
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
            places.append(parsed if isinstance(parsed, dict) else {PLACE_KEYS[name]: parsed})
    return places


def _set(document: dict[str, Any], key: str, value: Any) -> None:
    parts = key.split(".")
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


def _drop_sizes(document: dict[str, Any], keys: Sequence[str]) -> None:
    """Remove ``cells`` and ``spacing`` from those axes of a document of which one of these two keys is changed.

    `document`: keys and tables of a scene file, changed in place; `keys`: changed key paths, such as
    ``grid.axes.0.cells``; ``grid.cells`` changes all axes, because it applies only to axes without the two keys.  Axes
    that the robot implies are first written into the document.
    """
    from resgrid.scene.schema import robot_of

    if any(key.startswith("grid.axes.") for key in keys):
        document |= with_axes(document, robot_of(document.get("robot", {})))
    grid = document.get("grid")
    axes = grid.get("axes") if isinstance(grid, dict) else None
    for number, axis in enumerate(axes if isinstance(axes, list) else ()):
        changed = {"grid.cells", f"grid.axes.{number}.cells", f"grid.axes.{number}.spacing"}
        if isinstance(axis, dict) and changed & set(keys):
            axis.pop("cells", None)
            axis.pop("spacing", None)


def _step(node: Any, part: str, key: str) -> Any:
    if isinstance(node, dict):
        return part
    if isinstance(node, list) and part.isascii() and part.isdigit() and int(part) < len(node):
        return int(part)
    if isinstance(node, list):
        raise InputError(f"{key}: there is no entry {part!r}; the list has {len(node)} entries, counted from 0")
    raise InputError(f"{key}: there is no such key: the value before {part!r} is not a table or list; shorten the path")


def _parsed(value: Any) -> Any:
    return parse_value(value) if isinstance(value, str) else value
