"""S-expressions, the text format of KiCad's files, and identifiers that depend only on names."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from uuid import NAMESPACE_URL, uuid5

Node = list[Any]
"""A list of an S-expression: its keyword, then words, numbers, texts and nested lists."""

_NAMESPACE = uuid5(NAMESPACE_URL, "resgrid board")
_DIGITS = 6
"""Number of decimal places of lengths in files; KiCad resolves 1e-6 mm."""


class Word(str):
    """A word that is written without quotes, such as ``signal`` or ``F.Cu`` in a list of layers."""

    __slots__ = ()


YES, NO = Word("yes"), Word("no")


def identity(*names: object) -> str:
    """Return a UUID that depends only on the given names, so that the same scene gives the same bytes."""
    return str(uuid5(_NAMESPACE, "/".join(map(str, names))))


def uuid_of(*names: object) -> Node:
    """Return the S-expression ``(uuid "...")`` with a UUID that depends only on the given names."""
    return ["uuid", identity(*names)]


def format_tree(tree: Node) -> str:
    """Return the text of an S-expression.

    Lists that contain other lists take several lines, except short ones; one tab indents a level.
    """
    return "".join(_lines(tree, 0)) + "\n"


def number_text(value: float) -> str:
    """Return a number with at most six decimal places, without trailing zeros and without a negative zero."""
    text = f"{value:.{_DIGITS}f}".rstrip("0").rstrip(".") if isinstance(value, float) else str(value)
    return "0" if text in ("-0", "") else text


def _lines(tree: Node, level: int) -> Iterator[str]:
    """Yield parts of the text of an S-expression, to be joined; `level`: number of tabs before its lines."""
    head, *rest = tree
    yield f"({head}"
    nested = False
    for entry in rest:
        if isinstance(entry, list):
            if _is_short(entry):
                yield " " if not nested and _is_short(tree) else "\n" + "\t" * (level + 1)
                yield "".join(_lines(entry, level + 1))
            else:
                yield "\n" + "\t" * (level + 1)
                yield from _lines(entry, level + 1)
            nested = nested or not _is_short(tree)
        else:
            yield " " + _atom(entry)
    yield "\n" + "\t" * level + ")" if nested else ")"


def _is_short(tree: Node) -> bool:
    """Return whether an S-expression is written on one line.

    This holds if it contains no lists, or has at most four entries and its lists contain no further lists.
    """
    lists = [entry for entry in tree if isinstance(entry, list)]
    return not lists or (len(tree) <= 4 and not any(isinstance(part, list) for entry in lists for part in entry))


def _atom(value: object) -> str:
    """Return an entry of an S-expression that is not a list as text; texts are quoted, words and numbers are not."""
    if isinstance(value, Word):
        return str(value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return number_text(value)
    text = str(value).replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{text}"'
