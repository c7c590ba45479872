"""Error messages for invalid scene files, from pydantic's errors: key path, line, problem and remedy."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from resgrid._internal.validation import short
from resgrid.errors import suggestion
from resgrid.scene.toml_lines import Path, line_of

if TYPE_CHECKING:
    from pydantic import ValidationError
    from pydantic_core import ErrorDetails

Problem = tuple[Path, str]
"""Key path of a problem in a scene file (tuple of names and indices), and the message for the problem."""

MAX_SHOWN = 40
"""Largest number of problems that one message lists; the message states the number of the others."""


def key_path(path: Sequence[str | int]) -> str:
    """Return a key path (names, and indices from 0) as text, such as ``obstacle[2].radius``; "the scene" if empty."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".") or "the scene"


def report(problems: Sequence[Problem], source: str, lines: Mapping[Path, int] | None = None) -> str:
    """Return one message with all problems of a document, sorted by line.

    `problems`: pairs of key path (tuple of names and indices) and message; `source`: name of the document; `lines`:
    line numbers by key path, None for a document without lines.
    """
    placed = [(line_of(lines or {}, path) or 0, key_path(path), message) for path, message in problems]
    placed.sort(key=lambda entry: entry[0])
    listed = [f"{f'line {line}: ' if line else ''}{key}: {message}" for line, key, message in placed[:MAX_SHOWN]]
    if len(placed) > MAX_SHOWN:
        listed.append(f"... and {len(placed) - MAX_SHOWN} more")
    if len(listed) == 1:
        return f"{source}: {listed[0]}"
    return f"{source}: {len(placed)} errors\n" + "\n".join(f"  {entry}" for entry in listed)


def message_of(detail: ErrorDetails) -> str:
    """Return the message for one of pydantic's errors: the invalid value, and the allowed values."""
    if detail["type"] == "literal_error":
        return _choice_message(detail)
    template, got = _TEMPLATES.get(detail["type"]), shown(detail["input"])
    if template == _LIST and detail["loc"][0] == "starts" and len(detail["loc"]) == 2:
        return f"must be a point, as in starts = [[1, 2]], got {got}"
    if template == _LIST and isinstance(detail["input"], Mapping):
        return f"must be a list of tables: write [[{key_path(detail['loc'])}]], or put [ ] around the table"
    if template is not None:
        return template.format(**detail.get("ctx", {}), shown=got)
    message = detail["msg"].removeprefix("Value error, ")
    return message if detail["type"] == "value_error" else f"{message[:1].lower()}{message[1:]}, got {got}"


def problems_of(error: ValidationError, message: Callable[[ErrorDetails], str] = message_of) -> list[Problem]:
    """Return the key path and message of each problem of a failed validation.

    A key path is a tuple of names and indices.  `error`: the failure; `message`: function that returns the message for
    one of pydantic's errors.  If entries of a list have errors, an error about too few entries of this list is omitted,
    because it is a consequence.
    """
    details = error.errors(include_url=False)
    inner = {each["loc"][:size] for each in details for size in range(len(each["loc"]))}
    kept = (each for each in details if each["type"] != "too_short" or each["loc"] not in inner)
    return [(each["loc"], message(each)) for each in kept]


def unknown_option(words: str, given: Any, choice: str, options: Sequence[str]) -> str:
    """Return the message for a value that is not among its options, with the option of the nearest spelling.

    `words`: the value as text, the subject of the message; `given`: the value; `choice`: the options as text, such as
    ``a or b``; `options`: the options, searched for the nearest spelling.
    """
    meant = _ALIASES.get(given.lower(), given) if isinstance(given, str) else ""
    near = suggestion(meant, options)
    return f"{words} is unknown: it may be {choice}{near and f'; {near}'}"


def shown(value: Any) -> str:
    """Return an invalid value as short text for a message; for a table or a list only its kind, with its length."""
    if isinstance(value, Mapping):
        return "a table"
    return f"a list of {len(value)}" if isinstance(value, list) else short(value)


def _choice_message(detail: ErrorDetails) -> str:
    """Return the message for one of pydantic's errors about a value that is not among a key's options."""
    expected = str(detail.get("ctx", {}).get("expected", ""))
    options = [option.strip(" '") for option in expected.replace(" or ", ", ").split(",")]
    if detail["input"] in options:  # the option is a number, the input is text
        return f"must be the number {detail['input']}, without quotes, got {shown(detail['input'])}"
    return unknown_option(shown(detail["input"]), detail["input"], " or ".join(options), options)


_ALIASES = {"ros2": "nav2", "ros": "nav2"}
"""Common wrong names of options, mapped to the options."""

_NUMBER = "must be a number, got {shown}"
_WHOLE = "must be a whole number, got {shown}"
_LIST = "must be a list, such as [1, 2], got {shown}"
_TABLE = "must be a table of keys, got {shown}"
_TEMPLATES = {
    "missing": "this key is missing; add it",
    "float_type": _NUMBER,
    "float_parsing": _NUMBER,
    "finite_number": "must be a finite number, got {shown}",
    "int_type": _WHOLE,
    "int_from_float": _WHOLE,
    "bool_type": "must be true or false, got {shown}",
    "string_type": 'must be text in quotes, such as "abc", got {shown}',
    "string_pattern_mismatch": "must be a name: a letter, then letters, digits or _, got {shown}",
    "string_too_short": "must not be empty",
    "list_type": _LIST,
    "tuple_type": _LIST,
    "model_type": _TABLE,
    "model_attributes_type": _TABLE,
    "dict_type": _TABLE,
    "greater_than": "must be greater than {gt:g}, got {shown}",
    "greater_than_equal": "must be at least {ge:g}, got {shown}",
    "less_than": "must be below {lt:g}, got {shown}",
    "less_than_equal": "must be at most {le:g}, got {shown}",
    "too_short": "needs at least {min_length} entries, got {actual_length}",
    "too_long": "needs at most {max_length} entries, got {actual_length}",
}
"""Message templates by pydantic's type of error; the placeholders are keys of the error's context."""
