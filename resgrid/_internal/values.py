"""What values have in common: arrays that nobody changes, a repr of one line, a picture in a notebook."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from html import escape
from typing import Any, TypeVar

Record = TypeVar("Record")
_SHOWN = 60
_FEW = 4
_MANY = 12
_renderers: list[Callable[[object], str | None]] = []


def frozen(record: type[Record]) -> type[Record]:
    """Let a frozen dataclass make its arrays read-only, and have a repr without them unless it brings its own."""
    made = record.__init__

    @functools.wraps(made)
    def init(self: Any, *arguments: Any, **options: Any) -> None:
        made(self, *arguments, **options)
        for field in fields(self):
            lock(getattr(self, field.name))

    record.__init__ = init  # type: ignore[method-assign]
    if hasattr(record.__repr__, "__wrapped__"):  # the dataclass's, which guards itself against recursion
        record.__repr__ = _repr  # type: ignore[method-assign]
    return record


def brief(record: type[Record]) -> type[Record]:
    """Let a dataclass's repr leave out what is as by default, and the entries of long lists."""
    record.__repr__ = _brief_repr  # type: ignore[method-assign]
    return record


def _brief_repr(self: Any) -> str:
    values = {field.name: getattr(self, field.name) for field in fields(self) if field.repr}
    usual = {field.name: field.default_factory() if callable(field.default_factory) else field.default
             for field in fields(self)}  # fmt: skip
    said = (
        f"{name}=<{len(value)} entries>" if isinstance(value, tuple) and len(value) > _MANY else f"{name}={value!r}"
        for name, value in values.items()
        if value != usual[name]
    )
    return f"{type(self).__name__}({', '.join(said)})"


def lock(value: Any) -> None:
    """Make an array read-only, or all of a tuple or mapping."""
    if _is_array(value):
        value.setflags(write=False)
    elif isinstance(value, tuple | Mapping):
        for part in value.values() if isinstance(value, Mapping) else value:
            lock(part)


def _is_array(value: Any) -> bool:
    """Whether it is an array with axes; asked without numpy, which takes a while to import."""
    return hasattr(value, "setflags") and value.ndim > 0


def _repr(self: Any) -> str:
    parts = (f"{field.name}={_short(getattr(self, field.name))}" for field in fields(self) if field.repr)
    return f"{type(self).__name__}({', '.join(parts)})"


def _short(value: Any) -> str:
    """An array by its type and shape, a long list by its length, another value by its type; else its repr."""
    if _is_array(value):
        return f"{value.dtype}{value.shape}"
    if isinstance(value, tuple | list | Mapping) and len(value) > _FEW:
        return f"<{len(value)} entries>"
    if isinstance(value, tuple):
        return f"({', '.join(map(_short, value))})"
    text = repr(str(value) if isinstance(value, str) else value)
    if len(text) <= _SHOWN and "\n" not in text:
        return text
    return f"<{type(value).__name__}>" if is_dataclass(value) else f"{text.splitlines()[0][:_SHOWN]}..."


def show_with(renderer: Callable[[object], str | None]) -> None:
    """Say what makes pictures for notebooks: a function from a value to HTML, or None where it has no picture."""
    _renderers[:] = [renderer]


def picture_of(value: object) -> str:
    """A value's picture as HTML, empty where it has none."""
    return (_renderers[0](value) if _renderers else None) or ""


def picture_html(self: object) -> str | None:
    """A value's picture above its repr, for notebooks; None where it has none."""
    picture = picture_of(self)
    return f"<div>{picture}<pre>{escape(repr(self))}</pre></div>" if picture else None
