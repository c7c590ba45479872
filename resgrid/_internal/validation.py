"""Run-time checks of argument types for public functions and dataclasses, from their annotations.

The annotations of a function are translated at its first call into one `TypeCheck` per parameter.  Limits of numbers
stand in annotations (``Annotated[float, Gt(0)]``).  A failed check raises InputError with the parameter, its value, the
accepted types and a way to obtain them.

The checks differ from those of general libraries.  Numpy scalars are numbers, True and NaN are not, text is not an
array of numbers, every entry of a list is checked, and values are passed on unchanged.  Of 5746 pairs of a public
parameter and a test value, beartype 0.23 decides 399 and pydantic 2.14 decides 434 differently; pydantic has no schema
for 30 of 221 annotations, and beartype ignores the limits.  Importing either takes 0.07 to 0.1 s.
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
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from importlib import import_module
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
from numpy.typing import ArrayLike

from resgrid._internal.numbers import is_number, is_whole
from resgrid.errors import InputError, suggestion

Checked = TypeVar("Checked")


class TypeCheck(NamedTuple):
    """Check of the values that one annotation allows.

    `accepts`: function that returns whether a value has the type; `words`: descriptions of the type for messages, one
    per member of a union; `entry`: check of every entry of a list; None for other types and for tuples of different
    types.
    """

    accepts: Callable[[Any], bool]
    words: tuple[str, ...]
    entry: TypeCheck | None = None


TypeChecks = dict[str, TypeCheck]
"""Checks of argument types, by the name of the parameter or of the attribute of a dataclass."""

SOURCES = {
    "Chip": "scene.chip, or rg.Chip(...)",
    "ConfigurationSpace": "rg.build_space(scene)",
    "Controller": "rg.control.make_controller(field)",
    "Field": "rg.field(rg.solve(netlist)), or rg.plan(scene).field, with lattice = 'square'",
    "LatticeField": "rg.planning.lattice_field(rg.solve(netlist)), or rg.plan(scene, lattice=...).field",
    "Memristor": "rg.circuit.Memristor(on_resistance, off_resistance, rate)",
    "MemristiveCircuit": "rg.circuit.MemristiveCircuit(netlist, law)",
    "Netlist": "rg.compile_space(space), or rg.read_spice(file).netlist()",
    "OperatingPoint": "rg.solve(netlist)",
    "Circuit": "rg.read_spice(file)",
    "Planner": "rg.plan(scene)",
    "Robot": "scene.robot, or rg.PointRobot(radius)",
    "Run": "rg.simulation(scene).run(start)",
    "Scene": "rg.read_scene(file), or rg.parse_scene(text)",
    "Simulation": "rg.simulation(scene)",
    "Streamline": "rg.streamline(field, start)",
    "Wiring": "rg.Wiring(...)",
    "Wavefront": "rg.control.wavefront(rg.simulation(scene, announce=True), cells)",
}
"""Expressions that return a value of a class, by class name; messages about a wrong argument quote them."""

_NAMESPACES = tuple(f"resgrid.{name}" for name in ("planning", "circuit", "chip", "control", "spice", "maps"))
"""Packages whose public names annotations may use although the annotated module imports them only for type checkers."""

_ARRAY = frozenset(get_args(getattr(ArrayLike, "__value__", ArrayLike)))
"""Types in the union `numpy.typing.ArrayLike`, which numpy 2.5 defines by a type statement."""
_MAX_TEXT = 60
"""Maximum number of characters of a value in a message; the rest is cut off."""
_LARGEST = 2**63 - 1
"""Largest magnitude of a whole number in an argument; larger ones raise InputError."""


def guarded(name: str, value: Any, module: str = "resgrid") -> Any:
    """Return a public function with checks of its arguments; return other values unchanged.

    `name`: public name of the function; `value`: function or other object; `module`: public module of the function.
    """
    if not isinstance(value, types.FunctionType):
        return value
    call = _with_checks(value, name)
    call.__module__, call.__qualname__, call.__name__ = module, name, name  # pickle looks it up by these names
    return call


def checked(cls: type[Checked]) -> type[Checked]:
    """Add checks of the argument types to the constructor of a class, and return the class."""
    cls.__init__ = _with_checks(cls.__init__, cls.__name__)  # type: ignore[method-assign]
    return cls


def check_call(
    name: str, function: Callable[..., Any], arguments: Sequence[Any], options: Iterable[str], *, bound: int = 0,
    known: Iterable[str] = (),
) -> None:  # fmt: skip
    """Raise TypeError, with the public name of a function, for unknown options or too many positional arguments.

    `name`: public name; `function`: the function; `arguments`: positional arguments; `options`: names of the keyword
    arguments; `bound`: number of leading arguments that are passed implicitly, such as the object of a method; `known`:
    names of the keyword arguments that ``**options`` takes, if a TypedDict lists them.
    """
    parameters = list(inspect.signature(function).parameters.values())
    kinds = [each.kind for each in parameters]
    variable = [each for each in parameters if each.kind is inspect.Parameter.VAR_KEYWORD]
    takes_any = bool(variable) and "Unpack" not in str(variable[0].annotation)
    names = [each.name for each in parameters[bound:] if each.name != "self" and each not in variable]
    known = [*dict.fromkeys([*names, *known])]
    for option in () if takes_any else options:
        if option not in known:
            hint = suggestion(option, known) or (f"it takes {', '.join(known)}" if known else "it takes no options")
            raise TypeError(f"{name}() has no option {option!r}; {hint}")
    most = kinds.count(inspect.Parameter.POSITIONAL_OR_KEYWORD)
    if len(arguments) > most and inspect.Parameter.VAR_POSITIONAL not in kinds:
        hint = f"; give these by name: {', '.join(known[most - bound :])}" if known[most - bound :] else ""
        count = f"{most - bound} argument{'s' * (most - bound > 1)}" if most > bound else "no arguments"
        raise TypeError(f"{name}() takes {count} by position, got {len(arguments) - bound}{hint}")


def _with_checks(function: Callable[..., Any], name: str) -> Callable[..., Any]:
    """Return a function that checks its arguments by the annotations of `function`, and then calls `function`.

    `name`: public name of the function.
    """
    code = inspect.unwrap(function).__code__
    names, checks = code.co_varnames[: code.co_argcount], TypeChecks()

    @functools.wraps(function)
    def call(*arguments: Any, **options: Any) -> Any:
        if not checks:
            checks.update(_allow_defaults(function, type_checks_of(function)))
        for key, argument in (*zip(names, arguments, strict=False), *options.items()):
            if key in checks and not checks[key].accepts(argument):
                raise InputError(_message(key, argument, checks[key]))
        if not options.keys() <= checks.keys():
            check_call(name, function, (), options, known=checks)
        return function(*arguments, **options)

    return call


def _allow_defaults(function: Callable[..., Any], checks: TypeChecks) -> TypeChecks:
    """Return the checks of a function, with None accepted for parameters whose default is None.

    The annotation of such a parameter may not contain None: an attribute of a dataclass is annotated with the type that
    it has after ``__post_init__``, which replaces None.
    """
    unset = {key for key, each in inspect.signature(function).parameters.items() if each.default is None}
    return {key: _or_none(kind) if key in unset and not kind.accepts(None) else kind for key, kind in checks.items()}


def _or_none(kind: TypeCheck) -> TypeCheck:
    """Return a check that accepts None and the values that `kind` accepts."""
    return TypeCheck(lambda value: value is None or kind.accepts(value), (*kind.words, "None"), kind.entry)


def type_checks_of(value: Any) -> TypeChecks:
    """Return the checks of all parameters of a function or attributes of a class, `value`, by their names.

    A check tests whether a value has the annotated type, and describes this type for messages.
    """
    names = _Names(vars(sys.modules[value.__module__]))
    checks: TypeChecks = {}
    for key, given in value.__annotations__.items():
        if key == "return":
            continue
        text = given.__forward_arg__ if isinstance(given, ForwardRef) else given
        hint = eval(text, {"__builtins__": builtins}, names) if isinstance(text, str) else text
        if get_origin(hint) is Unpack:  # keyword arguments that a TypedDict lists
            checks |= type_checks_of(get_args(hint)[0])
        else:
            checks[key] = type_check_of(hint)
    return checks


class _Names(dict[str, Any]):
    """Namespace for the evaluation of annotations: the names of a module, then the public names of resgrid.

    The module imports the public names only for type checkers.  Unknown names evaluate to `Any`.
    """

    def __missing__(self, key: str) -> Any:
        if hasattr(builtins, key):
            return getattr(builtins, key)
        for module in ("resgrid", *_NAMESPACES):
            package = import_module(module)
            if key in package.__all__:
                return getattr(package, key)
        return Any


def type_check_of(hint: Any) -> TypeCheck:  # noqa: PLR0911
    """Return the check of an annotation (a type); unsupported annotations accept every value."""
    origin, parts = get_origin(hint), get_args(hint)
    if hasattr(origin or hint, "__value__"):  # an alias that a type statement defines
        value = (origin or hint).__value__
        return type_check_of(value[parts] if parts else value)
    if origin is Annotated:
        return _limited(type_check_of(parts[0]), parts[1:])
    if origin in (Union, types.UnionType):
        has_arrays = set(parts) >= _ARRAY
        kinds = [type_check_of(part) for part in parts if not (has_arrays and part in _ARRAY)] + [_NUMBERS] * has_arrays
        words = tuple(word for kind in kinds for word in kind.words)
        return TypeCheck(lambda value: any(kind.accepts(value) for kind in kinds), words)
    if hint in _PLAIN:
        return _PLAIN[hint]
    if origin in (tuple, list, Sequence, Collection, Iterable):
        return _list_of(origin, parts)
    if origin is Mapping:
        fits = type_check_of(parts[1]).accepts
        return TypeCheck(lambda value: isinstance(value, Mapping) and all(map(fits, value.values())), ("a mapping",))
    if origin is Literal:
        return TypeCheck(lambda value: isinstance(value, str) and value in parts, (" or ".join(map(repr, parts)),))
    if origin is np.ndarray:
        if np.bool_ in get_args(parts[1]):
            return TypeCheck(lambda value: isinstance(value, np.ndarray) and value.dtype.kind == "b", _NUMBERS.words)
        return _NUMBERS
    return _plain_kind(hint, origin or hint)


def _limited(kind: TypeCheck, marks: Sequence[Any]) -> TypeCheck:
    """Return the check of an annotated number, with the limits that `marks` contains, or `kind` itself without limits.

    `kind`: check of the type; `marks`: metadata of the ``Annotated``, such as ``Gt(0)``.
    """
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
    """Return the check of a class, protocol or file object; `base`: the annotation `hint` without parameters."""
    words = (_WORDS[base] if base in _WORDS else with_article(getattr(base, "__name__", "other value")),)
    if base is IO:
        return TypeCheck(lambda value: hasattr(value, "read"), words)
    if getattr(hint, "_is_protocol", False):
        names = [key for key in vars(hint) if not key.startswith("_")]
        words = (with_article(hint.__name__.removesuffix("Like")),)  # CircuitLike: a Circuit
        return TypeCheck(lambda value: not isinstance(value, type) and all(hasattr(value, key) for key in names), words)
    is_class = isinstance(base, type) and hint not in (Any, object)
    return TypeCheck((lambda value: isinstance(value, base)) if is_class else lambda _: True, words)


def _list_of(origin: Any, parts: tuple[Any, ...]) -> TypeCheck:
    """Return the check of a tuple, list, sequence or iterable; the entries of an iterator are not checked.

    `origin`: type without parameters, such as ``tuple``; `parts`: parameters of the type.
    """
    is_fixed = origin is tuple and parts[-1] is not Ellipsis
    entries = [type_check_of(part) for part in (parts if is_fixed else parts[:1])]

    def accepts(value: Any) -> bool:
        if not _is_list(value):
            is_iterable = origin is Iterable and isinstance(value, Iterable)
            return is_iterable and not isinstance(value, str | bytes | Mapping | np.ndarray)
        if not is_fixed:
            return all(map(entries[0].accepts, value))
        return len(value) == len(entries) and all(
            kind.accepts(entry) for kind, entry in zip(entries, value, strict=True)
        )

    count = f"{len(parts)} " if is_fixed else ""
    entry = entries[0] if len({*parts} - {...}) == 1 else None
    words = "a list" if parts[0] is Any and not is_fixed else f"a list of {count}{_plural(entries[0].words)}"
    return TypeCheck(accepts, (words,), entry)


def _plural(words: Sequence[str]) -> str:
    """Return descriptions of types as a plural text, such as "finite numbers above 0" or "Box or Ball values"."""
    *others, last = dict.fromkeys(word.removeprefix("a ").removeprefix("an ") for word in words)
    if others:
        return f"{', '.join(others)} or {last} values"
    if "number" in last:
        return re.sub(r"\bnumber\b", "numbers", last, count=1)
    return last if last.startswith("list") else f"{last} values"


def _is_list(value: Any) -> bool:
    """Return whether a value is a sequence other than text, or a numpy array with at least one axis."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


def _is_real(value: Any) -> bool:
    """Return whether a value is a real number, which may be infinite.

    The result is False for NaN, bools, and integers beyond 64 bits.
    """
    if isinstance(value, float | np.floating):
        return not math.isnan(value)
    return is_number(value) and not (is_whole(value) and abs(int(value)) > _LARGEST)


def _is_array(value: Any) -> bool:
    """Return whether a value is a real number, a truth value, or an array of real numbers or truth values."""
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


def _message(key: str, value: Any, kind: TypeCheck) -> str:
    """Return the message for an argument of a wrong type, with the accepted types and expressions that return them.

    `key`: name of the parameter; `value`: wrong argument; `kind`: check that failed.
    """
    if kind.entry is not None and _is_list(value):
        for number, one in enumerate(value):
            if not kind.entry.accepts(one):
                return _message(f"{key}[{number}]", one, kind.entry)
        return f"{key} = {short(value)} must be {kind.words[0]}, got {len(value)}"
    words = sorted(dict.fromkeys(kind.words), key=lambda word: word == "None")
    sources = [SOURCES.get(word.split()[-1]) for word in words]
    choices = [f"{word} ({source})" if source else word for word, source in zip(words, sources, strict=True)]
    return f"{key} = {short(value)} must be {', or '.join(choices)}"


def short(value: Any) -> str:
    """Return the text of a value for a message: the ``repr`` (cut off after 60 characters), or only the class.

    Numbers, texts and paths are shown by their ``repr``, other values by their class.
    """
    if value is None or isinstance(value, str | int | float | os.PathLike):
        try:
            text = repr(value)
        except ValueError:
            return "a number with too many digits"
        return text if len(text) <= _MAX_TEXT else f"{text[:_MAX_TEXT]}..."
    return f"<{with_article(type(value).__name__)}>"


def with_article(name: str) -> str:
    """Return a name after "a" or "an", whichever the pronunciation needs: an int, an ndarray, a unit, an Axis."""
    vowel = re.match(r"(?!uni|use|usu|ufunc|eu|one)[aeiou]|nd|np", name, re.IGNORECASE)
    return f"{'an' if vowel else 'a'} {name}"
