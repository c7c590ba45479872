"""What `resgrid` hands out: public functions, and values a user makes, refuse types other than their signatures say.

Annotations are the contract: they are read once, when a door is first passed, and turned into one test a parameter.
"""

from __future__ import annotations

import builtins
import functools
import os
import sys
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from typing import IO, Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike

from resgrid.arguments import is_number, is_whole
from resgrid.errors import InputError

Record = TypeVar("Record")
Accepts = Callable[[Any], bool]
"""Whether a value is of a type."""

Checks = dict[str, tuple[Accepts, Any]]
"""What parameters accept, and their types, by name."""

SOURCES = {
    "Chip": "scene.chip, or rg.Chip(...)",
    "ConfigurationSpace": "rg.sample(scene)",
    "Controller": "rg.make_controller(field)",
    "Field": "rg.field(rg.solve(netlist)), or rg.plan(scene).field",
    "Netlist": "rg.compile_space(space), or rg.read_spice(file).netlist()",
    "OperatingPoint": "rg.solve(netlist)",
    "Circuit": "rg.read_spice(file)",
    "Planner": "rg.plan(scene)",
    "Robot": "scene.robot, or rg.PointRobot(radius)",
    "Run": "rg.simulation(scene).run(start)",
    "Scene": "rg.read_scene(file), or rg.parse_scene(text)",
    "Simulation": "rg.simulation(scene)",
    "Streamline": "rg.streamline(field, start)",
    "Wavefront": "rg.wavefront(rg.simulation(scene, announce=True), cells)",
}
"""How to get what functions most often ask for."""

_WORDS: dict[Any, str] = {
    float: "a finite number",
    int: "a whole number",
    str: "text",
    bool: "True or False",
    types.NoneType: "None",
    os.PathLike: "a path",
    Mapping: "a mapping",
}
_ARRAY = frozenset(get_args(ArrayLike))
_SHOWN = 60
_LARGEST = 2**63 - 1


def guarded(name: str, value: Any) -> Any:
    """A public function behind a check of its arguments' types; anything else as it is."""
    if not isinstance(value, types.FunctionType):
        return value
    code = value.__code__
    door = _door(value, code.co_varnames[: code.co_argcount], lambda: _checks_of(value))
    door.__module__, door.__qualname__, door.__name__ = "resgrid", name, name  # where pickle finds it again
    return door


def checked(record: type[Record]) -> type[Record]:
    """Let a dataclass refuse values of another type than its fields have, before it looks at them itself."""
    names = ("self", *(field.name for field in fields(record) if field.init))  # type: ignore[arg-type]
    made = record.__init__
    record.__init__ = _door(made, names, lambda: _checks_of(made))  # type: ignore[method-assign]
    return record


def _door(function: Callable[..., Any], names: Sequence[str], find: Callable[[], Checks]) -> Callable[..., Any]:
    """A function behind a check of its arguments; what they must be is found at the first call."""
    checks: Checks = {}

    @functools.wraps(function)
    def door(*arguments: Any, **options: Any) -> Any:
        if not checks:
            checks.update(find())
        for key, argument in (*zip(names, arguments, strict=False), *options.items()):
            if key in checks and not checks[key][0](argument):
                raise InputError(_complaint(key, argument, checks[key][1]))
        return function(*arguments, **options)

    return door


def _checks_of(value: Any) -> Checks:
    """What each parameter of a function, or field of a class, accepts, and its type, by name; at least one entry."""
    names = _Names(vars(sys.modules[value.__module__]))
    hints = {
        key: eval(text, {"__builtins__": builtins}, names) if isinstance(text, str) else text
        for key, text in value.__annotations__.items()
    }
    return {key: (_accepts(hint), hint) for key, hint in hints.items()}


class _Names(dict[str, Any]):
    """What names in annotations mean: of the module, or, where only a type checker imports them, of the package."""

    def __missing__(self, key: str) -> Any:
        if hasattr(builtins, key):
            return getattr(builtins, key)
        package = sys.modules["resgrid"]
        return getattr(package, key) if key in package.__all__ else Any


def _accepts(hint: Any) -> Accepts:  # noqa: PLR0911
    """Whether values are of a type; unknown kinds of types accept anything."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _accepts(parts[0])
    if origin in (Union, types.UnionType):
        rest, takes_arrays = _without_array(parts)
        accepted = [*map(_accepts, rest), *([_is_array] if takes_arrays else [])]
        return lambda value: any(accept(value) for accept in accepted)
    if hint in _PLAIN:
        return _PLAIN[hint]
    if origin is Literal:
        return lambda value: isinstance(value, str) and value in parts
    if origin is np.ndarray:
        masks = np.bool_ in get_args(parts[1])
        return (lambda value: isinstance(value, np.ndarray) and value.dtype.kind == "b") if masks else _is_array
    if origin in (tuple, list, Sequence, Iterable):
        return _accepts_entries(origin, parts)
    if origin is Mapping:
        entry = _accepts(parts[1])
        return lambda value: isinstance(value, Mapping) and all(map(entry, value.values()))
    if origin is IO:
        return lambda value: hasattr(value, "read")
    if origin in (Callable, os.PathLike):
        return lambda value: isinstance(value, origin)
    if getattr(hint, "_is_protocol", False):
        wanted = [key for key in vars(hint) if not key.startswith("_")]
        return lambda value: not isinstance(value, type) and all(hasattr(value, key) for key in wanted)
    checked = isinstance(hint, type) and hint not in (Any, object)
    return (lambda value: isinstance(value, hint)) if checked else lambda _: True


def _accepts_entries(origin: Any, parts: tuple[Any, ...]) -> Accepts:
    """Whether values hold entries of a type; what can be read only once is taken on trust."""
    if origin is tuple and parts[-1] is not Ellipsis:
        each = [_accepts(part) for part in parts]
        return lambda value: (
            _is_listed(value, parts[0])
            and len(value) == len(each)
            and all(accept(entry) for accept, entry in zip(each, value, strict=True))
        )
    entry = _accepts(parts[0])
    once = origin is Iterable
    return lambda value: (
        all(map(entry, value))
        if _is_listed(value, parts[0])
        else once and isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping | np.ndarray)
    )


def _is_listed(value: Any, hint: Any) -> bool:
    """Whether a value is a list of something, or, where that are numbers or words, an array."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0 and hint in (float, int, str, Any)
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


def _without_array(parts: tuple[Any, ...]) -> tuple[list[Any], bool]:
    """The parts of a union without those of ``ArrayLike``, and whether it holds those."""
    takes_arrays = set(parts) >= _ARRAY
    return [part for part in parts if not (takes_arrays and part in _ARRAY)], takes_arrays


def _is_real(value: Any) -> bool:
    """Whether a value is a real number, infinite ones included; limits are for the function itself to know."""
    infinite = isinstance(value, float | np.floating) and abs(value) == np.inf
    return infinite or (is_number(value) and not (is_whole(value) and abs(int(value)) > _LARGEST))


def _is_count(value: Any) -> bool:
    """Whether a value is a whole number that arrays can hold."""
    return is_whole(value) and abs(int(value)) <= _LARGEST


def _is_array(value: Any) -> bool:
    """Whether a value is a number, or a table of numbers or truth values."""
    if value is None or isinstance(value, str | bytes):
        return False
    try:
        return np.asarray(value).dtype.kind in "biuf"
    except (TypeError, ValueError, OverflowError):
        return False


_PLAIN: dict[Any, Accepts] = {
    float: _is_real,
    int: _is_count,
    bool: lambda value: isinstance(value, bool | np.bool_),
    None: lambda value: value is None,
}


def _complaint(key: str, value: Any, hint: Any) -> str:
    origin, parts = get_origin(hint), get_args(hint)
    if origin in (tuple, list, Sequence, Iterable) and len({*parts} - {...}) == 1 and _is_listed(value, parts[0]):
        entry = parts[0]
        if all(map(_accepts(entry), value)):
            return f"{key} = {_short(value)} must be a list of {len(parts)}, got {len(value)}"
        number = next(number for number, one in enumerate(value) if not _accepts(entry)(one))
        return _complaint(f"{key}[{number}]", value[number], entry)
    words = sorted(dict.fromkeys(_words(hint)), key=lambda word: word == "None")
    sources = [SOURCES.get(word.split()[-1]) for word in words]
    ways = [f"{word} ({source})" if source else word for word, source in zip(words, sources, strict=True)]
    return f"{key} = {_short(value)} must be {', or '.join(ways)}"


def _words(hint: Any) -> list[str]:  # noqa: PLR0911
    """What a type is called."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _words(parts[0])
    if origin in (Union, types.UnionType):
        rest, takes_arrays = _without_array(parts)
        return [word for part in rest for word in _words(part)] + ["numbers"] * takes_arrays
    if origin is Literal:
        return [" or ".join(map(repr, parts))]
    if origin is np.ndarray:
        return ["numbers"]
    if origin in (tuple, list, Sequence, Iterable) and parts:
        count = f"{len(parts)} " if origin is tuple and parts[-1] is not Ellipsis else ""
        return [f"a list of {count}{_words(parts[0])[0].removeprefix('a ').removeprefix('an ')} values"]
    if hint in _WORDS or origin in _WORDS:
        return [_WORDS[hint if hint in _WORDS else origin]]
    name = getattr(origin or hint, "__name__", "another value")
    return ["callable" if origin is Callable else f"{'an' if name[:1] in 'AEIOU' else 'a'} {name}"]


def _short(value: Any) -> str:
    """A value in a message: itself if it is short, its type if it is not."""
    if value is None or isinstance(value, str | int | float | os.PathLike):
        text = repr(value)
        return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
    name = type(value).__name__
    return f"<{'an' if name[:1] in 'AEIOU' else 'a'} {name}>"
