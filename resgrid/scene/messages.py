"""What is wrong with a value, in this package's words instead of pydantic's."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from resgrid.arguments import short, suggestion
from resgrid.scene.toml_lines import Path, line_of

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

Problem = tuple[Path, str]
"""Where something is wrong, and what."""

MAX_SHOWN = 40


def key_path(path: Sequence[str | int]) -> str:
    """A key path as people write it, such as ``obstacle[2].radius`` (elements from 0)."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".") or "the scene"


def report(problems: Sequence[Problem], source: str, lines: Mapping[Path, int] | None = None) -> str:
    """All problems of a document in one message, in the order of its lines."""
    placed = [(line_of(lines or {}, path) or 0, key_path(path), message) for path, message in problems]
    placed.sort(key=lambda entry: entry[0])
    listed = [f"{f'line {line}: ' if line else ''}{key}: {message}" for line, key, message in placed[:MAX_SHOWN]]
    if len(placed) > MAX_SHOWN:
        listed.append(f"... and {len(placed) - MAX_SHOWN} more")
    if len(listed) == 1:
        return f"{source}: {listed[0]}"
    return f"{source}: {len(placed)} errors\n" + "\n".join(f"  {entry}" for entry in listed)


def complaint(detail: ErrorDetails) -> str:
    """What is wrong with a value, and what it may be."""
    describe = _COMPLAINTS.get(detail["type"])
    if describe is not None:
        return describe(detail)
    message = detail["msg"].removeprefix("Value error, ")
    return message if detail["type"] == "value_error" else f"{message[:1].lower()}{message[1:]}, got {shown(detail)}"


def unknown(words: str, given: Any, choice: str, options: Sequence[str]) -> str:
    """That something is none of its options, and which of them was probably meant."""
    near = suggestion(given, options) if isinstance(given, str) else ""
    return f"{words} is unknown: it may be {choice}{near and f'; {near}'}"


def shown(detail: ErrorDetails) -> str:
    """A wrong value, cut short."""
    value = detail["input"]
    if isinstance(value, Mapping):
        return "a table"
    return f"a list of {len(value)}" if isinstance(value, list) else short(value)


def _choice(detail: ErrorDetails) -> str:
    expected = str(detail.get("ctx", {}).get("expected", ""))
    options = [option.strip(" '") for option in expected.replace(" or ", ", ").split(",")]
    if detail["input"] in options:  # of which it would be one, were it no text
        return f"must be the number {detail['input']}, without quotes, got {shown(detail)}"
    return unknown(shown(detail), detail["input"], " or ".join(options), options)


def _must(what: str) -> Callable[[ErrorDetails], str]:
    return lambda detail: f"must be {what}, got {shown(detail)}"


def _bound(words: str, key: str) -> Callable[[ErrorDetails], str]:
    return lambda detail: f"must be {words} {detail['ctx'][key]:g}, got {shown(detail)}"


def _length(words: str, key: str) -> Callable[[ErrorDetails], str]:
    return lambda detail: f"needs {words} {detail['ctx'][key]} entries, got {detail['ctx']['actual_length']}"


_NUMBER, _WHOLE, _LIST, _TABLE = (
    _must(what) for what in ("a number", "a whole number", "a list, such as [1, 2]", "a table of keys")
)
_COMPLAINTS: dict[str, Callable[[ErrorDetails], str]] = {
    "missing": lambda _: "this key is missing; add it",
    "literal_error": _choice,
    "float_type": _NUMBER,
    "float_parsing": _NUMBER,
    "finite_number": _must("a finite number"),
    "int_type": _WHOLE,
    "int_from_float": _WHOLE,
    "bool_type": _must("true or false"),
    "string_type": _must('text in quotes, such as "abc"'),
    "string_pattern_mismatch": _must("a name: a letter, then letters, digits or _"),
    "string_too_short": lambda _: "must not be empty",
    "list_type": _LIST,
    "tuple_type": _LIST,
    "model_type": _TABLE,
    "model_attributes_type": _TABLE,
    "dict_type": _TABLE,
    "greater_than": _bound("greater than", "gt"),
    "greater_than_equal": _bound("at least", "ge"),
    "less_than": _bound("below", "lt"),
    "less_than_equal": _bound("at most", "le"),
    "too_short": _length("at least", "min_length"),
    "too_long": _length("at most", "max_length"),
}
