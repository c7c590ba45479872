"""Tables of a file, made from the dataclasses they describe: the same keys, ranges and meanings, the value's own laws.

The annotations of a dataclass say what its fields may be (`annotated_types` for ranges, `Quantity` for units), its
docstring says what they mean; this is the only place where a schema is made of both.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from functools import cache
from inspect import cleandoc
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from annotated_types import Len
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Strict, ValidationError, create_model

from resgrid.errors import InputError
from resgrid.scene.quantities import Quantity
from resgrid.scene.words import complaint, key_path

_ENTRY = re.compile(r"^(\w[\w, ]*?)(?: : .*)?$")


class Table(BaseModel):
    """Base of every table: unknown keys are errors, and nothing is converted silently."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def meanings(value: type) -> dict[str, str]:
    """What the fields of a class mean, from the lists in its docstring."""
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
    """The unit of a field, by its annotation."""
    marks = [*getattr(hint, "__metadata__", ()), *(mark for part in get_args(hint) for mark in [unit_of(part)] if mark)]
    return next((mark.unit if isinstance(mark, Quantity) else mark for mark in marks if isinstance(mark, Quantity | str)), "")


def file_type(hint: Any) -> Any:
    """What a file holds for a field: lists for tuples, tables for dataclasses, the rest as it is."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return Annotated[(file_type(parts[0]), *parts[1:])]
    if origin in (Union, UnionType):
        return Union[tuple(map(file_type, parts))]
    if origin is tuple:
        entry = file_type(parts[0])
        size = () if parts[-1] is Ellipsis else (Len(len(parts), len(parts)),)
        return Annotated[(tuple[entry, ...], Strict(False), *size)]
    return described_by(hint) if dataclasses.is_dataclass(hint) else hint


@cache
def table_of(value: type, kind: tuple[str, str] | None = None) -> type[Table]:
    """The table that describes a value; `kind`: a key that says which of several it is, and what it says."""
    hints, texts = get_type_hints(value, include_extras=True), meanings(value)
    keys: dict[str, Any] = {} if kind is None else {kind[0]: (Literal[kind[1]], ...)}
    for item in dataclasses.fields(value):
        if item.init:
            default = {} if item.default is dataclasses.MISSING else {"default": item.default}
            if item.default_factory is not dataclasses.MISSING:
                default = {"default_factory": item.default_factory}
            keys[item.name] = (file_type(hints[item.name]), Field(description=texts.get(item.name), **default))
    title = value.__name__ if kind is None else kind[1]
    return create_model(title, __base__=Table, __doc__=_first_sentence(value), **keys)


def described_by(value: type, table: type[Table] | None = None, kind: tuple[str, str] | None = None) -> Any:
    """The annotation of a key whose table stands for a value; what makes the value impossible is the file's error."""

    def build(filled: Table) -> Any:
        keys = {key: getattr(filled, key) for key in type(filled).model_fields if kind is None or key != kind[0]}
        try:
            return value(**keys)
        except InputError as error:
            raise ValueError(str(error)) from None

    return Annotated[table or table_of(value, kind), AfterValidator(build)]


def check_fields(value: Any) -> None:
    """Check the fields of a value made in Python as those of its table are, and take over how they are read."""
    table = table_of(type(value))
    given = {name: getattr(value, name) for name in table.model_fields}
    nested = {name: field for name, field in given.items() if dataclasses.is_dataclass(type(field))}
    try:
        read = table.model_validate({key: field for key, field in given.items() if key not in nested})
    except ValidationError as error:
        details = error.errors(include_url=False)
        raise InputError("; ".join(f"{key_path(each['loc'])}: {complaint(each)}" for each in details)) from None
    for name in given.keys() - nested.keys():
        object.__setattr__(value, name, getattr(read, name))


def plain(value: Any) -> Any:
    """A value as a file holds it: dataclasses as tables without the keys that say nothing, tuples as lists."""
    if dataclasses.is_dataclass(value):
        table = {item.name: getattr(value, item.name) for item in dataclasses.fields(value) if item.init}
        return {key: plain(entry) for key, entry in table.items() if entry is not None}
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    if hasattr(value, "tolist"):
        return value.tolist()
    return [plain(entry) for entry in value] if isinstance(value, list | tuple) else value


def _first_sentence(value: type) -> str:
    return cleandoc(value.__doc__ or "").split("\n")[0]
