"""A raw scene document checked as a whole: every error at once, with its key path, its line and a remedy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

from resgrid.errors import InputError
from resgrid.scene.laws import broken_laws
from resgrid.scene.toml_lines import Path, line_of

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

    from resgrid.scene.document import SceneDocument

Problem = tuple[Path, str]
MAX_SHOWN = 40
_PLACES = ("point", "cell", "joints", "joints_lower")
_KINDS = ("obstacle", "hidden", "goal", "start", "area", "robot")


def validate(
    raw: Mapping[str, Any], source: str, lines: dict[Path, int] | None = None, ndim: int | None = None
) -> SceneDocument:
    """Check a document and give its typed form."""
    from pydantic import ValidationError

    from resgrid.scene.document import SceneDocument

    problems: list[Problem] = []
    document = None
    try:
        document = SceneDocument.model_validate(dict(raw))
    except ValidationError as error:
        problems = [_problem(detail, raw) for detail in error.errors(include_url=False)]
    taken = {path for path, _ in problems}
    problems += [problem for problem in broken_laws(raw, ndim) if problem[0] not in taken]
    if problems or document is None:
        raise InputError(_report(problems, source, lines or {}))
    return document


def key_path(path: Path) -> str:
    """A key path as people write it, such as ``obstacle[2].radius`` (elements from 0)."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".") or "the scene"


def _report(problems: list[Problem], source: str, lines: dict[Path, int]) -> str:
    placed = [(line_of(lines, path) or 0, key_path(path), message) for path, message in problems]
    placed.sort(key=lambda entry: entry[0])
    shown = [f"{f'line {line}: ' if line else ''}{key}: {message}" for line, key, message in placed[:MAX_SHOWN]]
    if len(placed) > MAX_SHOWN:
        shown.append(f"... and {len(placed) - MAX_SHOWN} more")
    if len(shown) == 1:
        return f"{source}: {shown[0]}"
    return f"{source}: {len(placed)} errors\n" + "\n".join(f"  {entry}" for entry in shown)


def _problem(detail: ErrorDetails, raw: Mapping[str, Any]) -> Problem:
    path = _real_path(detail["loc"], raw, detail["type"])
    describe = _MESSAGES.get(detail["type"], _plain)
    return path, describe(detail, path)


def _tag_at(location: tuple[int | str, ...]) -> int | None:
    """Where pydantic's location names the kind of a table instead of a key, such as 1 in ("robot", "arm", ...)."""
    at = {"robot": 1}.get(str(location[0]), 2) if location and location[0] in _KINDS else None
    return at if at is not None and at < len(location) else None


def _real_path(location: tuple[int | str, ...], raw: Any, kind: str) -> Path:
    """Pydantic's location without the tags of the unions it went through."""
    path: list[str | int] = []
    node = raw
    for position, part in enumerate(location):
        if position == _tag_at(location):
            continue
        last = position == len(location) - 1
        if isinstance(node, Mapping) and part in node:
            node = node[str(part)]
        elif isinstance(node, list) and isinstance(part, int) and part < len(node):
            node = node[part]
        elif not (last and kind == "missing"):
            continue
        path.append(part)
    return tuple(path)


def _plain(detail: ErrorDetails, _path: Path) -> str:
    message = detail["msg"].removeprefix("Value error, ")
    return message if detail["type"] == "value_error" else f"{message[:1].lower()}{message[1:]}, got {_short(detail)}"


def _missing(_detail: ErrorDetails, _path: Path) -> str:
    return "this key is missing; add it"


def _unknown(detail: ErrorDetails, path: Path) -> str:
    from resgrid.scene.document import SceneDocument, table_keys

    name = str(path[-1])
    known = _siblings(detail["loc"], path)
    near = get_close_matches(name, known, 1, 0.6)
    if near:
        return f"unknown key; did you mean {near[0]!r}?"
    if len(path) > 1 and name in table_keys(SceneDocument):
        return f"this key belongs at the top level of the scene, above the first [table]; move {name!r} there"
    at = _tag_at(detail["loc"])
    if at is not None and len(known) == 1:  # a place
        return f"nothing else goes with {known[0]} = [...]; remove {name!r}"
    whose = "" if at is None else f" of {_a(str(detail['loc'][at]))}"
    return f"unknown key{whose}; there are {', '.join(known)}" if known else "unknown key; remove it"


def _a(kind: str) -> str:
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind.replace('_', '-')}"


def _siblings(location: tuple[int | str, ...], path: Path) -> list[str]:
    """The keys that could stand where this one does."""
    from resgrid.scene import chip_tables, document as schema, robot_tables

    at = _tag_at(location)
    tables: dict[str, Any] = {
        "": schema.SceneDocument,
        "links": robot_tables.LinkTable,
        "grid": schema.GridTable,
        "axes": schema.AxisTable,
        "map": schema.MapTable,
        "chip": chip_tables.ChipTable,
        "readout": chip_tables.ReadoutTable,
        "defects": chip_tables.DefectsTable,
    }
    names = [part for part in path[:-1] if isinstance(part, str)]
    model = tables.get(names[-1] if names else "")
    if model is None and at is not None:
        model = schema.KINDS[str(location[0])].get(str(location[at]))
    return [] if model is None else list(schema.table_keys(model))


def _choice(detail: ErrorDetails, path: Path) -> str:
    context = detail.get("ctx", {})
    expected = str(context.get("expected") or context.get("expected_tags") or "")
    options = [option.strip(" '") for option in expected.replace(" or ", ", ").split(",")]
    near = get_close_matches(str(detail["input"]), options, 1, 0.6) if isinstance(detail["input"], str) else []
    if detail["type"] == "union_tag_invalid":
        tag = str(context.get("tag"))
        options = [option for option in options if option not in _PLACES or path == ("robot",)]
        near = get_close_matches(tag, options, 1, 0.6)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        key = "type" if path == ("robot",) else "shape"
        return f"{key} = {tag!r} is unknown: it may be one of {', '.join(options)}{hint}"
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"{_short(detail)} is unknown: it may be {' or '.join(options)}{hint}"


def _no_tag(detail: ErrorDetails, path: Path) -> str:
    if path[:1] == ("robot",):
        return 'the robot needs type = "point", "disc", "polygon" or "arm"'
    places = {"goal": _PLACES, "start": _PLACES[:2]}.get(str(path[0]), ())
    table = detail["input"] if isinstance(detail["input"], Mapping) else {}
    shape = table.get("shape")
    if shape in places:
        remedy = "remove this key" if shape in table else f"write {shape} = [...] instead"
        return f"shape = {shape!r} is no shape, for a place needs none; {remedy}"
    for name in table:
        near = get_close_matches(str(name), ("shape", *places), 1, 0.6)
        if near and near[0] not in table:
            return f"{name!r} is unknown; did you mean {near[0]!r}?"
    if path[:1] == ("start",):
        return "a start needs point = [...] or cell = [...]"
    kinds = "rectangle, circle, polygon, box, sphere or half_plane"
    extra = ", or point = [...], or cell = [...], or joints = [...]" if places else ""
    return f"this needs shape = one of {kinds}{extra}"


def _must(what: str) -> Callable[[ErrorDetails, Path], str]:
    return lambda detail, _path: f"must be {what}, got {_short(detail)}"


def _bound(words: str, key: str) -> Callable[[ErrorDetails, Path], str]:
    return lambda detail, _path: f"must be {words} {detail['ctx'][key]:g}, got {_short(detail)}"


def _length(words: str, key: str) -> Callable[[ErrorDetails, Path], str]:
    return lambda detail, _path: f"needs {words} {detail['ctx'][key]} entries, got {detail['ctx']['actual_length']}"


_MESSAGES: dict[str, Callable[[ErrorDetails, Path], str]] = {
    "missing": _missing,
    "extra_forbidden": _unknown,
    "literal_error": _choice,
    "union_tag_invalid": _choice,
    "union_tag_not_found": _no_tag,
    "float_type": _must("a number"),
    "float_parsing": _must("a number"),
    "finite_number": _must("a finite number"),
    "int_type": _must("a whole number"),
    "int_from_float": _must("a whole number"),
    "bool_type": _must("true or false"),
    "string_type": _must('text in quotes, such as "abc"'),
    "string_pattern_mismatch": _must("a name: a letter, then letters, digits or _"),
    "string_too_short": _must("not empty"),
    "list_type": _must("a list, such as [1, 2]"),
    "model_type": _must("a table of keys"),
    "model_attributes_type": _must("a table of keys"),
    "dict_type": _must("a table of keys"),
    "greater_than": _bound("greater than", "gt"),
    "greater_than_equal": _bound("at least", "ge"),
    "less_than_equal": _bound("at most", "le"),
    "too_short": _length("at least", "min_length"),
    "too_long": _length("at most", "max_length"),
}


def _short(detail: ErrorDetails) -> str:
    value = detail["input"]
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    try:
        text = repr(value)
    except ValueError:
        return "a number of absurd length"
    return text if len(text) <= 60 else f"{text[:50]}..."
