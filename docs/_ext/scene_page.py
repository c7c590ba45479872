"""The reference page of scene files, generated from their schema."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from resgrid.scene.schema import KINDS, TABLES, SceneFile
from resgrid.scene.table_models import TableModel

_HEAD = """# Scene files

A scene is a TOML file; `resgrid info --schema` prints its JSON Schema. Lengths are in the unit of the axes, angles in
radians. A number with a unit may also be written as an engineering value such as `"4k7"`, `"2.2meg"` or `"100n"`. All
keys have a default except those marked *required*. On the command line, `--set key.path=value` changes any key. This
page is generated from the schema by `make reference`.
"""
_SECTIONS = {
    "grid": "## `[grid]`",
    "axes": "### `grid.axes`",
    "map": "## `[map]`",
    "mask": "## `[[mask]]`",
    "chip": "## `[chip]`",
    "readout": "### `[chip.readout]`",
    "defects": "### `[chip.defects]`",
    "control": "## `[control]`",
}
_RANGES = {
    "exclusiveMinimum": "above {:g}",
    "minimum": "at least {:g}",
    "exclusiveMaximum": "below {:g}",
    "maximum": "at most {:g}",
}

_FAR = 1e9
"""Limits from here on only prevent overflow, and are not listed."""

_SHAPES = """Tables of `[[obstacle]]`, `[[hidden]]`, `[[goal]]` and `[[area]]`; an area has a `conductivity`.
Cylinders, capsules and oriented boxes are shapes in space, and not for goals. Meshes, point clouds and OctoMaps are
obstacles only."""
_PLACES = "Further tables of `[[goal]]`; `[[start]]` takes a `point` or a `cell`."


def scene_reference() -> str:
    """Return the text of the page ``docs/reference/scene.md``."""
    parts = [_HEAD, *_table("## The scene", SceneFile)]
    for name, kind in KINDS["robot"].items():
        parts += _table(f"## `[robot]` of type `{name}`", kind.__origin__)
    parts += _table("### `robot.links` of an arm", TABLES["links"])
    for key, heading in _SECTIONS.items():
        parts += _table(heading, TABLES[key])
    parts.append(f"\n## Shapes\n\n{_SHAPES}")
    shapes = KINDS["obstacle"]
    parts += [line for name, kind in shapes.items() for line in _table(f"### `{name}`", kind.__origin__)]
    parts.append(f"\n## Places\n\n{_PLACES}")
    places = {key: kind for key, kind in KINDS["goal"].items() if key not in shapes}
    parts += [line for key, kind in places.items() for line in _table(f"### `{key}`", kind.__origin__)]
    return "\n".join(parts) + "\n"


def _table(heading: str, table: type[TableModel]) -> list[str]:
    schema = table.model_json_schema()
    needed = schema.get("required", ())
    rows = [
        f"| `{key}` | {_kind(described)} | {_default(key, described, needed)} | {_meaning(described)} |"
        for key, described in schema["properties"].items()
    ]
    sentence = schema.get("description", "").replace("``", "`")
    return [f"\n{heading}\n", f"{sentence}\n", "| key | type | default | meaning |", "|---|---|---|---|", *rows]


def _default(key: str, described: Mapping[str, Any], needed: Any) -> str:
    if key in needed:
        return "*required*"
    default = described.get("default")
    return "" if default in (None, [], "") or isinstance(default, dict) else f"`{default}`".replace("'", '"')


def _meaning(described: Mapping[str, Any]) -> str:
    return str(described.get("description", "")).replace("``", "`").replace("|", "\\|")


def _kind(described: Mapping[str, Any]) -> str:
    """Return words for the type and range of a key."""
    if "anyOf" in described:
        kinds = [_kind(part) for part in described["anyOf"] if part.get("type") != "null" and "pattern" not in part]
        unit = f", {described['unit']}" if "unit" in described else ""
        return " or ".join(dict.fromkeys(kinds)) + unit
    if "enum" in described or "const" in described:
        options = described.get("enum", [described.get("const")])
        return " or ".join(f"`{option!r}`".replace("'", '"') for option in options)
    if "oneOf" in described or "$ref" in described:
        return "a table"
    if described.get("type") == "array":
        low, high = described.get("minItems"), described.get("maxItems")
        if low is None:
            return f"a list: {_kind(described.get('items', {}))}"
        count = f"{low}" if low == high else f"{low} to {high}" if high else f"{low} or more"
        return f"a list of {count}: {_kind(described.get('items', {}))}"
    ranges = [words.format(described[key]) for key, words in _RANGES.items() if abs(described.get(key, _FAR)) < _FAR]
    kind = {"number": "number", "integer": "whole number", "string": "text", "boolean": "`true` or `false`"}
    return " ".join([kind.get(str(described.get("type")), "anything"), ", ".join(ranges)]).strip()


if __name__ == "__main__":
    print(scene_reference(), end="")
