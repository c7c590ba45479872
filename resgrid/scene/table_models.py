"""Pydantic models of the tables of a scene file, generated from dataclasses and functions, and their conversions.

The annotations of a dataclass (or of a function's options) give types, ranges (`annotated_types`) and units
(`Quantity`); its docstring gives the descriptions.  Validated tables become values of the dataclass; `plain` is the
inverse.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from inspect import cleandoc, signature
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from annotated_types import Len
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Strict, ValidationError, create_model

from resgrid.core.axis import Point
from resgrid.errors import InputError
from resgrid.scene.messages import key_path, problems_of
from resgrid.scene.quantities import Quantity

_ENTRY = re.compile(r"^(\w[\w, ]*?)(?: : .*)?$")


class TableModel(BaseModel):
    """Base of all tables: unknown keys, other types (text for a number), and numbers that are not finite are errors."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def meanings(value: Callable[..., Any]) -> dict[str, str]:
    """Return the descriptions of a class's attributes or a function's parameters by name, from a numpydoc docstring."""
    described: dict[str, str] = {}
    names: list[str] = []
    for line in cleandoc(value.__doc__ or "").split("\n"):
        entry = _ENTRY.match(line)
        if entry:
            names = entry[1].split(", ")
        elif line.startswith("    "):
            for name in names:
                described[name] = f"{described.get(name, '')} {line.strip()}".strip()
    return described


def unit_of(hint: Any) -> str:
    """Return the unit in the type annotation of a field as text, such as ``ohm``; empty without a unit."""
    units = [mark.unit for mark in getattr(hint, "__metadata__", ()) if isinstance(mark, Quantity)]
    return next(filter(None, [*units, *map(unit_of, get_args(hint))]), "")


def described_keys(value: type) -> dict[str, tuple[str, str]]:
    """Return unit and description of every key of a dataclass's table, by key.

    Nested keys have dots (``readout.bits``).  The unit is a text such as ``ohm``, empty without one; the description is
    that of the attribute in the class's docstring.
    """
    hints, about = get_type_hints(value, include_extras=True), meanings(value)
    described: dict[str, tuple[str, str]] = {}
    for item in dataclasses.fields(value):
        hint = hints[item.name]
        if isinstance(hint, type) and dataclasses.is_dataclass(hint):
            described |= {f"{item.name}.{key}": entry for key, entry in described_keys(hint).items()}
        else:
            described[item.name] = unit_of(hint), about.get(item.name, "")
    return described


def file_type(hint: Any, *, planar: bool = False) -> Any:
    """Return the type of a field in a scene file: lists for tuples, tables for dataclasses, or the type unchanged.

    `hint`: type annotation of the field; `planar`: whether points have exactly two coordinates.
    """
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return Annotated[(file_type(parts[0], planar=planar), *parts[1:])]
    if origin in (Union, UnionType):
        return Union[tuple(file_type(part, planar=planar) for part in parts)]  # noqa: UP007
    if origin is tuple:
        size = len(parts) if parts[-1] is not Ellipsis else 2 if planar and hint == Point else None
        entry: Any = file_type(parts[0], planar=planar)
        return Annotated[(tuple[entry, ...], Strict(False), *(() if size is None else (Len(size, size),)))]
    return value_of(hint) if isinstance(hint, type) and dataclasses.is_dataclass(hint) else hint


@cache
def table_of(value: type, kind: tuple[str, str] | None = None, planar: bool = False) -> type[TableModel]:
    """Return the pydantic model of a dataclass's table.

    `value`: the dataclass; `kind`: pair of a key and the value by which files select this table among other kinds, such
    as ``("type", "arm")``; None without such a key; `planar`: whether points have exactly two coordinates.
    """
    keys = fields_from(value, planar=planar)
    if kind is not None:
        keys = {kind[0]: (Literal[kind[1]], Field(kind[1], description=f"Selects this {kind[0]}."))} | keys
    sentence = cleandoc(value.__doc__ or "").split("\n")[0]
    return create_model(
        value.__name__ if kind is None else "_".join(kind), __base__=TableModel, __doc__=sentence, **keys
    )


def fields_from(value: Callable[..., Any], names: Sequence[str] = (), *, planar: bool = False) -> dict[str, Any]:
    """Return the pydantic fields for a dataclass or a function's options, as pairs of type and field by name.

    A field holds default and description.  `value`: the class or function; `names`: names of fields to include, empty
    for all; `planar`: whether points have exactly two coordinates.
    """
    if isinstance(value, type):
        defaults = {item.name: _default(item) for item in dataclasses.fields(value)}
    else:
        options = (item for item in signature(value).parameters.values() if item.default is not item.empty)
        defaults = {item.name: {"default": item.default} for item in options}
    hints, about = get_type_hints(value, include_extras=True), meanings(value)
    return {
        name: (file_type(hints[name], planar=planar), Field(description=about.get(name), **default))
        for name, default in defaults.items()
        if not names or name in names
    }


def _default(item: dataclasses.Field[Any]) -> dict[str, Any]:
    if item.default_factory is not dataclasses.MISSING:
        return {"default_factory": item.default_factory}
    return {} if item.default is dataclasses.MISSING else {"default": item.default}


def value_of(value: type, kind: tuple[str, str] | None = None, planar: bool = False) -> Any:
    """Return the pydantic annotation of a key that holds the table of a dataclass.

    `value`: the dataclass; `kind`: pair of a key and the value by which files select this table among other kinds, such
    as ``("type", "arm")``; None without such a key; `planar`: whether points have exactly two coordinates.
    """
    return filled_as(table_of(value, kind, planar), value, *(kind or ())[:1])


def filled_as(table: Any, build: Callable[..., Any], *left_out: str) -> Any:
    """Return the pydantic annotation of a key whose table is validated and then replaced by ``build(**keys)``.

    `table`: model of the table; `build`: function or class that makes the value from the table's keys; `left_out`: keys
    that are not passed to `build`.
    """

    def fill(filled: TableModel) -> Any:
        try:
            return build(**{key: getattr(filled, key) for key in table.model_fields if key not in left_out})
        except InputError as error:
            raise ValueError(str(error)) from None

    return Annotated[table, AfterValidator(fill)]


def check_fields(value: Any) -> None:
    """Validate the fields of a dataclass instance, and store the converted values in the instance.

    Fields with a default factory are not validated.  Raises one InputError that lists all problems.
    """
    single = [item.name for item in dataclasses.fields(value) if item.default_factory is dataclasses.MISSING]
    given = {name: getattr(value, name) for name in single}
    filled = fields_of(type(value), given)
    for name in given:
        object.__setattr__(value, name, filled[name])


def fields_of(kind: type, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a dataclass by name, validated by the model of its table.

    `kind`: the dataclass; `given`: unvalidated values by name.  Raises one InputError that lists all problems.
    """
    try:
        table = table_of(kind).model_validate(given)
    except ValidationError as error:
        raise InputError("; ".join(f"{key_path(path)}: {text}" for path, text in problems_of(error))) from None
    return {name: getattr(table, name) for name in table_of(kind).model_fields}


def plain(value: Any) -> Any:
    """Return a value in the form of a scene file: dataclasses as dictionaries, tuples and arrays as lists.

    Keys of dataclasses whose value is None are omitted.
    """
    if dataclasses.is_dataclass(value):
        table = {item.name: getattr(value, item.name) for item in dataclasses.fields(value) if item.init}
        return {key: plain(entry) for key, entry in table.items() if entry is not None}
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    if hasattr(value, "tolist"):
        return value.tolist()
    return [plain(entry) for entry in value] if isinstance(value, list | tuple) else value
