"""Single keys of a scene changed from outside: what the command line's options do."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from resgrid.errors import InputError
from resgrid.scene.build import build_scene, document_of, map_data
from resgrid.scene.scene import Scene

SHORT = {"resistance": "chip.resistance", "supply": "chip.supply", "radius": "robot.radius"}
PLACES = {"goal": "point", "goal_cell": "cell", "start": "point", "start_cell": "cell"}


def apply_overrides(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """The same scene with some keys changed, checked like a scene file.

    Parameters
    ----------
    scene : Scene
        The scene.
    changes : mapping of str to object
        From key path to new value.  A path is written as in error messages (``chip.resistance``,
        ``obstacle[2].radius``, or with dots: ``obstacle.2.radius``); ``resistance``, ``supply`` and ``radius`` alone
        are enough.  ``goal``, ``goal_cell``, ``start`` and ``start_cell`` take one place or a list of them and replace
        all goals or starts; world coordinates, or cell indices counted from 0.  A text is read as TOML would read it
        (``"4.5"`` is a number, ``"[0, 1]"`` a list), as numbers separated by commas, or else as itself.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        If a key or a value is wrong; one message lists all problems.
    BudgetError
        If a map is read anew and would not fit in memory.
    """
    document = document_of(scene)
    changes_by_key = {SHORT.get(key, key): value for key, value in changes.items()}
    edge = changes_by_key.get("edge")
    if isinstance(edge, str) and "," in edge and "[" not in edge:
        changes_by_key["edge"] = [rule.strip() for rule in edge.split(",")]
    for key in ("goal", "start"):
        places = _places(key, changes_by_key)
        if places is not None:
            document[key] = places
            if key == "start":
                document["starts"] = []
    for key, value in changes_by_key.items():
        if key not in PLACES:
            _set(document, key, value)
    if "grid.cells" in changes_by_key and isinstance(document.get("grid"), dict):
        for axis in document["grid"].get("axes", []):
            axis.pop("cells", None)
    same_map = scene.map is not None and document.get("map") == dict(scene.map.table)
    known = map_data(scene) if same_map and "grid" not in document else None
    return build_scene(document, scene.source or "scene", Path(), known=known)


def parse_value(text: str) -> Any:
    """The value that a text from a command line stands for.

    Examples
    --------
    >>> parse_value("0.5, 2"), parse_value("4k7"), parse_value("false")
    ([0.5, 2], '4k7', False)
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
        entries = _plain(value)
        nested = isinstance(entries, list) and bool(entries) and isinstance(entries[0], list | dict | str)
        for entry in entries if nested else [entries]:
            parsed = _plain(_parsed(entry))
            places.append(parsed if isinstance(parsed, dict) else {PLACES[name]: parsed})
    return places


def _set(document: dict[str, Any], key: str, value: Any) -> None:
    parts = key.replace("[", ".").replace("]", "").split(".")
    node: Any = document
    for position, part in enumerate(parts[:-1]):
        step = _step(node, part, ".".join(parts[: position + 1]))
        node = node.setdefault(step, {}) if isinstance(node, dict) else node[step]
    last = _step(node, parts[-1], key)
    parsed = _plain(_parsed(value))
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


def _plain(value: Any) -> Any:
    """Lists for tuples and arrays, Python numbers for NumPy's: what TOML could have held."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    return value
