"""Lazy imports: a package imports its public names, listed in ``__init__.pyi``, at their first use."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.util import resolve_name
from pathlib import Path
from typing import Any

from resgrid.errors import suggestion

Attribute = Callable[[str], Any]
Names = Callable[[], list[str]]


def attach(package: str, file: str) -> tuple[Attribute, Names, list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package that imports names at their first use.

    The first returned function maps a name to its object, the second returns all names; the list contains the same
    names, sorted.  `package`: name of the package; `file`: path of the ``__init__.py`` of the package.  The stub next
    to `file` has a line ``from .module import name as name`` for each public name.  Public functions check the types of
    their arguments (`resgrid._internal.validation.guarded`).
    """
    places = _places(package, Path(file).with_suffix(".pyi"))
    names = sorted(places)

    def attribute(name: str) -> Any:
        if name not in places:
            hint = suggestion(name, names) or f"dir({package}) lists its names"
            raise AttributeError(f"module {package!r} has no attribute {name!r}; {hint}")
        from resgrid._internal.validation import guarded

        module, original = places[name]
        value = import_module(module)
        if original is not None:
            value = guarded(name, getattr(value, original), package)
        setattr(sys.modules[package], name, value)
        return value

    return attribute, lambda: names, names


def _places(package: str, stub: Path) -> dict[str, tuple[str, str | None]]:
    """Return for every public name a pair: name of its module, and its name in this module.

    The second entry is None if the public name is the module itself. `package`: name of the package; `stub`: path of
    the stub file of the package.
    """
    places: dict[str, tuple[str, str | None]] = {}
    for node in ast.parse(stub.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            module = resolve_name("." * node.level + (node.module or ""), package)
            for alias in node.names:
                place = (module, alias.name) if node.module else (f"{module}.{alias.name}", None)
                places[alias.asname or alias.name] = place
    return places
