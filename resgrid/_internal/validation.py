"""What `resgrid` hands out: public functions, and values a user makes, refuse types other than their signatures say.

Annotations are the contract: they are read once, when a door is first passed, and turned into one test a parameter.
"""

from __future__ import annotations

import builtins
import functools
import inspect
import math
import operator
import os
import re
import sys
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from importlib import import_module
from numbers import Integral, Real
from typing import (
    IO,
    Annotated,
    Any,
    ForwardRef,
    Literal,
    NamedTuple,
    TypeVar,
    Union,
    Unpack,
    get_args,
    get_origin,
)

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import ArrayLike, NDArray

from resgrid.errors import InputError, suggestion

Record = TypeVar("Record")


class TypeCheck(NamedTuple):
    """What a type accepts.

    `accepts`: whether a value is of it; `words`: what it is called, one for each part of a union; `entry`: the kind of
    all entries of a list.
    """

    accepts: Callable[[Any], bool]
    words: tuple[str, ...]
    entry: TypeCheck | None = None


Kinds = dict[str, TypeCheck]
"""What parameters accept, by name."""

Positive = Annotated[float, Gt(0), Lt(math.inf)]
NotNegative = Annotated[float, Ge(0), Lt(math.inf)]
Between = Annotated[float, Gt(0), Lt(1)]
Count = Annotated[int, Ge(1)]
Natural = Annotated[int, Ge(0)]
"""Numbers that functions most often ask for."""

SOURCES = {
    "Chip": "scene.chip, or rg.Chip(...)",
    "ConfigurationSpace": "rg.build_space(scene)",
    "Controller": "rg.control.make_controller(field)",
    "Field": "rg.field(rg.solve(netlist)), or rg.plan(scene).field",
    "Netlist": "rg.compile_space(space), or rg.read_spice(file).netlist()",
    "OperatingPoint": "rg.solve(netlist)",
    "Circuit": "rg.read_spice(file)",
    "Deck": "rg.read_spice(file)",
    "Planner": "rg.plan(scene)",
    "Robot": "scene.robot, or rg.PointRobot(radius)",
    "Run": "rg.simulation(scene).run(start)",
    "Scene": "rg.read_scene(file), or rg.parse_scene(text)",
    "Simulation": "rg.simulation(scene)",
    "Streamline": "rg.streamline(field, start)",
    "Wavefront": "rg.control.wavefront(rg.simulation(scene, announce=True), cells)",
}
"""How to get what functions most often ask for."""

_NAMESPACES = tuple(f"resgrid.{name}" for name in ("planning", "circuit", "chip", "control", "spice", "maps"))
"""Packages with public names, which annotations may use without importing them at run time."""

_ARRAY = frozenset(get_args(ArrayLike))
_SHOWN = 60
_LARGEST = 2**63 - 1
_HUGE = sys.float_info.max


def is_number(value: Any) -> bool:
    """Whether a value is a finite real number (True and False are none)."""
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # a whole number beyond all floating-point ones
        return False


def is_whole(value: Any) -> bool:
    """Whether a value is a whole number (True and False are none)."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def check_number(
    name: str, value: Any, words: str, *, least: float = -math.inf, above: float = -math.inf, below: float = math.inf
) -> None:
    """Refuse what is no finite real number within limits."""
    if not (is_number(value) and value >= least and above < value < below):
        raise InputError(f"{name} = {value!r} must be {words}")


def check_share(name: str, value: Any) -> None:
    """Refuse what is no number from 0 to 1."""
    if not (is_number(value) and 0 <= value <= 1):
        raise InputError(f"{name} = {value!r} must lie between 0 and 1")


def check_whole(name: str, value: Any, least: int) -> None:
    """Refuse what is no whole number of at least ``least``."""
    if not (is_whole(value) and int(value) >= least):
        raise InputError(f"{name} = {value!r} must be a whole number, at least {least}")


def real_numbers(name: str, value: ArrayLike) -> NDArray[Any]:
    """Real numbers; no complex ones, whose imaginary parts would be lost, none that are masked, no text or dates."""
    try:
        array = np.asarray(value)
        if array.size and array.dtype.kind not in "biuf":
            array = array.astype(np.float64, casting="unsafe" if array.dtype.kind == "O" else "same_kind")
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} must be an array of real numbers") from None
    if value is None or np.ma.is_masked(value):
        raise InputError(f"{name} must be an array of real numbers, {'not None' if value is None else 'none masked'}")
    return array


def per_axis(
    name: str, value: ArrayLike, ndim: int, words: str, *, least: float = -_HUGE, above: float = -math.inf,
    most: float = _HUGE,
) -> NDArray[np.float64]:  # fmt: skip
    """A number for every axis, shape (ndim,), of one for all or one for each; refuse those beyond limits."""
    try:
        given = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        given = np.full(1, np.nan)
    if given.shape not in ((), (1,), (ndim,)) or not np.all((given >= least) & (given > above) & (given <= most)):
        raise InputError(f"{name} = {value!r} must be {words}, one for all or one for each of the {ndim} axes")
    return np.array(np.broadcast_to(given, (ndim,)))


def guarded(name: str, value: Any, module: str = "resgrid") -> Any:
    """Return a public function of a module that checks the types of its arguments; any other value unchanged."""
    if not isinstance(value, types.FunctionType):
        return value
    code = value.__code__
    door = _door(value, name, code.co_varnames[: code.co_argcount], lambda: kinds_of(value))
    door.__module__, door.__qualname__, door.__name__ = module, name, name  # where pickle finds it again
    return door


def checked(record: type[Record]) -> type[Record]:
    """Let a dataclass refuse values of another type than its fields have, before it looks at them itself."""
    names = ("self", *(field.name for field in fields(record) if field.init))  # type: ignore[arg-type]
    init = record.__init__
    record.__init__ = _door(init, record.__name__, names, lambda: kinds_of(init))  # type: ignore[method-assign]
    return record


def check_call(
    name: str, function: Callable[..., Any], arguments: Sequence[Any], options: Iterable[str], *, bound: int = 0,
    known: Iterable[str] = (),
) -> None:  # fmt: skip
    """Raise TypeError if a function does not take some arguments or options, under its public name.

    `bound`: number of first arguments that are not the caller's own, such as the object of a method; `known`: names of
    options that its keyword arguments (``**options``) take, if they do not take any.
    """
    parameters = list(inspect.signature(function).parameters.values())
    kinds = [each.kind for each in parameters]
    variable = [each for each in parameters if each.kind is inspect.Parameter.VAR_KEYWORD]
    takes_any = bool(variable) and "Unpack" not in str(variable[0].annotation)
    names = [each.name for each in parameters[bound:] if each.name != "self" and each not in variable]
    known = [*dict.fromkeys([*names, *known])]
    for option in () if takes_any else options:
        if option not in known:
            hint = suggestion(option, known) or (f"it takes {', '.join(known)}" if known else "it takes none")
            raise TypeError(f"{name}() has no option {option!r}; {hint}")
    most = kinds.count(inspect.Parameter.POSITIONAL_OR_KEYWORD)
    if len(arguments) > most and inspect.Parameter.VAR_POSITIONAL not in kinds:
        hint = f"; give these by name: {', '.join(known[most - bound :])}" if known[most - bound :] else ""
        count = f"{most - bound} argument{'s' * (most - bound > 1)}" if most > bound else "no arguments"
        raise TypeError(f"{name}() takes {count} by position, got {len(arguments) - bound}{hint}")


def _door(
    function: Callable[..., Any], name: str, names: Sequence[str], find: Callable[[], Kinds]
) -> Callable[..., Any]:
    """A function with a public name behind a check of its arguments; their kinds are found at the first call."""
    checks: Kinds = {}

    @functools.wraps(function)
    def door(*arguments: Any, **options: Any) -> Any:
        if not checks:
            checks.update(find())
        for key, argument in (*zip(names, arguments, strict=False), *options.items()):
            if key in checks and not checks[key].accepts(argument):
                raise InputError(_complaint(key, argument, checks[key]))
        if not options.keys() <= checks.keys():
            check_call(name, function, (), options, known=checks)
        return function(*arguments, **options)

    return door


def kinds_of(value: Any) -> Kinds:
    """What each parameter of a function, or field of a class, accepts, by name; at least one entry."""
    names = _Names(vars(sys.modules[value.__module__]))
    kinds: Kinds = {}
    for key, given in value.__annotations__.items():
        text = given.__forward_arg__ if isinstance(given, ForwardRef) else given
        hint = eval(text, {"__builtins__": builtins}, names) if isinstance(text, str) else text
        if get_origin(hint) is Unpack:  # keyword arguments that a TypedDict lists
            kinds |= kinds_of(get_args(hint)[0])
        else:
            kinds[key] = kind_of(hint)
    return kinds


class _Names(dict[str, Any]):
    """What names in annotations mean: of the module, or, where only a type checker imports them, of the package."""

    def __missing__(self, key: str) -> Any:
        if hasattr(builtins, key):
            return getattr(builtins, key)
        for module in ("resgrid", *_NAMESPACES):
            package = import_module(module)
            if key in package.__all__:
                return getattr(package, key)
        return Any


def kind_of(hint: Any) -> TypeCheck:  # noqa: PLR0911
    """What a type accepts; unknown kinds of types accept anything."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _limited(kind_of(parts[0]), parts[1:])
    if origin in (Union, types.UnionType):
        has_arrays = set(parts) >= _ARRAY
        kinds = [kind_of(part) for part in parts if not (has_arrays and part in _ARRAY)] + [_NUMBERS] * has_arrays
        words = tuple(word for kind in kinds for word in kind.words)
        return TypeCheck(lambda value: any(kind.accepts(value) for kind in kinds), words)
    if hint in _PLAIN:
        return _PLAIN[hint]
    if origin in (tuple, list, Sequence, Iterable):
        return _list_of(origin, parts)
    if origin is Mapping:
        fits = kind_of(parts[1]).accepts
        return TypeCheck(lambda value: isinstance(value, Mapping) and all(map(fits, value.values())), ("a mapping",))
    if origin is Literal:
        return TypeCheck(lambda value: isinstance(value, str) and value in parts, (" or ".join(map(repr, parts)),))
    if origin is np.ndarray:
        if np.bool_ in get_args(parts[1]):
            return TypeCheck(lambda value: isinstance(value, np.ndarray) and value.dtype.kind == "b", _NUMBERS.words)
        return _NUMBERS
    return _plain_kind(hint, origin or hint)


def _limited(kind: TypeCheck, marks: Sequence[Any]) -> TypeCheck:
    """Numbers within the limits that annotations set, or whatever else was annotated."""
    limits = [
        (*_LIMITS[type(mark)], getattr(mark, type(mark).__name__.lower())) for mark in marks if type(mark) in _LIMITS
    ]
    if not limits:
        return kind
    said = [f"{word} {bound:g}" for _, word, bound in limits if math.isfinite(bound)]
    words = f"{kind.words[0]} {' and '.join(said)}"

    def accepts(value: Any) -> bool:
        if not kind.accepts(value):
            return False
        number = float(value)
        return all(fits(number, bound) for fits, _, bound in limits)

    return TypeCheck(accepts, (words,))


def _plain_kind(hint: Any, base: Any) -> TypeCheck:
    """A class, or whatever else stands in annotations."""
    words = (_WORDS[base] if base in _WORDS else with_article(getattr(base, "__name__", "other value")),)
    if base is IO:
        return TypeCheck(lambda value: hasattr(value, "read"), words)
    if getattr(hint, "_is_protocol", False):
        names = [key for key in vars(hint) if not key.startswith("_")]
        return TypeCheck(lambda value: not isinstance(value, type) and all(hasattr(value, key) for key in names), words)
    is_class = isinstance(base, type) and hint not in (Any, object)
    return TypeCheck((lambda value: isinstance(value, base)) if is_class else lambda _: True, words)


def _list_of(origin: Any, parts: tuple[Any, ...]) -> TypeCheck:
    """Lists of entries of a type; what can be read only once is taken on trust."""
    is_fixed = origin is tuple and parts[-1] is not Ellipsis
    entries = [kind_of(part) for part in (parts if is_fixed else parts[:1])]

    def accepts(value: Any) -> bool:
        if not _is_list(value):
            once = origin is Iterable and isinstance(value, Iterable)
            return once and not isinstance(value, str | bytes | Mapping | np.ndarray)
        if not is_fixed:
            return all(map(entries[0].accepts, value))
        return len(value) == len(entries) and all(
            kind.accepts(entry) for kind, entry in zip(entries, value, strict=True)
        )

    count = f"{len(parts)} " if is_fixed else ""
    entry = entries[0] if len({*parts} - {...}) == 1 else None
    return TypeCheck(accepts, (f"a list of {count}{_plural(entries[0].words)}",), entry)


def _plural(words: Sequence[str]) -> str:
    """Return kinds of entries in words: finite numbers above 0; Box or Ball values."""
    *others, last = dict.fromkeys(word.removeprefix("a ").removeprefix("an ") for word in words)
    if others:
        return f"{', '.join(others)} or {last} values"
    if "number" in last:
        return re.sub(r"\bnumber\b", "numbers", last, count=1)
    return last if last.startswith("list") else f"{last} values"


def _is_list(value: Any) -> bool:
    """Whether a value is a list or an array, of whatever."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


def _is_real(value: Any) -> bool:
    """Whether a value is a real number, infinite ones included; limits are for the function itself to know."""
    if isinstance(value, float | np.floating):
        return not math.isnan(value)
    return is_number(value) and not (is_whole(value) and abs(int(value)) > _LARGEST)


def _is_array(value: Any) -> bool:
    """Whether a value is a number, or a table of numbers or truth values."""
    if value is None or isinstance(value, str | bytes):
        return False
    try:
        return np.asarray(value).dtype.kind in "biuf"
    except (TypeError, ValueError, OverflowError):
        return False


_NUMBERS = TypeCheck(_is_array, ("numbers",))
_PLAIN: dict[Any, TypeCheck] = {
    float: TypeCheck(_is_real, ("a finite number",)),
    int: TypeCheck(lambda value: is_whole(value) and abs(int(value)) <= _LARGEST, ("a whole number",)),
    bool: TypeCheck(lambda value: isinstance(value, bool | np.bool_), ("True or False",)),
    types.NoneType: TypeCheck(lambda value: value is None, ("None",)),
    None: TypeCheck(lambda value: value is None, ("None",)),
}
_LIMITS = {
    Gt: (operator.gt, "above"),
    Ge: (operator.ge, "at least"),
    Lt: (operator.lt, "below"),
    Le: (operator.le, "at most"),
}
_WORDS: dict[Any, str] = {str: "text", os.PathLike: "a path", Callable: "callable"}


def _complaint(key: str, value: Any, kind: TypeCheck) -> str:
    """Which value is wrong, and what is needed, with the way to get it."""
    if kind.entry is not None and _is_list(value):
        for number, one in enumerate(value):
            if not kind.entry.accepts(one):
                return _complaint(f"{key}[{number}]", one, kind.entry)
        return f"{key} = {short(value)} must be {kind.words[0]}, got {len(value)}"
    words = sorted(dict.fromkeys(kind.words), key=lambda word: word == "None")
    sources = [SOURCES.get(word.split()[-1]) for word in words]
    choices = [f"{word} ({source})" if source else word for word, source in zip(words, sources, strict=True)]
    return f"{key} = {short(value)} must be {', or '.join(choices)}"


def short(value: Any) -> str:
    """A value in a message: itself if it is short, what it is if it is not."""
    if value is None or isinstance(value, str | int | float | os.PathLike):
        try:
            text = repr(value)
        except ValueError:
            return "a number of absurd length"
        return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
    return f"<{with_article(type(value).__name__)}>"


def with_article(name: str) -> str:
    """Return a name with "a" or "an", by its sound: an int, an ndarray, a unit, an Axis."""
    vowel = re.match(r"(?!uni|use|usu|ufunc|eu|one)[aeiou]|nd|np", name, re.IGNORECASE)
    return f"{'an' if vowel else 'a'} {name}"
