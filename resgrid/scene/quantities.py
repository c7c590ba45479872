"""Engineering values such as ``10k``, ``4k7``, ``100n``: parsing, formatting, and annotations of keys for pydantic."""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import floor, isfinite, log10
from typing import TYPE_CHECKING, Any

from resgrid._internal.validation import short
from resgrid.errors import InputError

if TYPE_CHECKING:
    from pydantic_core import CoreSchema

SMALLEST, LARGEST = 1e-30, 1e30
"""Smallest and largest magnitude of a value in SI units, except 0; products and squares thus stay in the range of
doubles."""

EXPONENTS = {"T": 12, "G": 9, "M": 6, "meg": 6, "k": 3, "m": -3, "u": -6, "µ": -6, "μ": -6, "n": -9, "p": -12, "f": -15}
PREFIXES = dict(zip(range(-24, 13, 3), ("y", "z", "a", "f", "p", "n", "µ", "m", "", "k", "M", "G", "T"), strict=True))
PATTERN = r"([+-]?(?:\d+(?:\.\d*)?|\.\d+))([eE][+-]?\d+|meg|[TGMkmuµμnpf])?|([+-]?\d+)([TGMkmuµμnpf])(\d+)"
"""Regular expression of a number with an optional exponent or suffix, or with a suffix in place of the point."""

_VALUE = re.compile(PATTERN, re.ASCII)


@dataclass(frozen=True)
class Quantity:
    """Annotation of a number with its SI unit, which may be written as an engineering value such as ``4k7``.

    `unit`: SI unit, empty for a dimensionless number; `is_fraction`: whether the number may also be written as a
    percentage, such as ``10 %``.
    """

    unit: str
    is_fraction: bool = False

    def read(self, value: object) -> float:
        """Return a number, an engineering value or (for a fraction) a percentage as a float.

        ValueError is raised for all other values, as pydantic expects.
        """
        try:
            number = parse_fraction(value) if self.is_fraction else parse_quantity(value)
        except InputError as error:
            raise ValueError(str(error)) from None
        if abs(number) > LARGEST:
            raise ValueError(f"must not exceed {LARGEST:g}, got {number:g}")
        if 0 < abs(number) < SMALLEST:
            raise ValueError(f"must be 0 or have a magnitude of at least {SMALLEST:g}, got {number:g}")
        return number

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        """Return pydantic's validator, which converts an engineering value to a number."""
        from pydantic_core import core_schema

        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        """Return the JSON Schema of the number: a number, or text that matches the pattern."""
        text = f"(({PATTERN}) *%|{PATTERN})" if self.is_fraction else f"({PATTERN})"
        described = {"anyOf": [handler(schema), {"type": "string", "pattern": f"^{text}$"}]}
        return {**described, "unit": self.unit} if self.unit else described


@dataclass(frozen=True)
class Listed:
    """Annotation of a list that may also be written as its only entry, without brackets."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        """Return pydantic's validator, which converts a single entry to a list."""
        from pydantic_core import core_schema

        def listed(value: Any) -> Any:
            return value if isinstance(value, list | tuple | dict) else [value]

        return core_schema.no_info_before_validator_function(listed, handler(source))

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        """Return the JSON Schema of the list: an entry, or a list of entries."""
        several = handler(schema)
        return {"anyOf": [several["items"], several]}


def parse_quantity(value: object) -> float:
    """Return the double nearest to a number or an engineering value; raise InputError if `value` is neither.

    The suffix is case-sensitive: ``M`` and ``meg`` are mega, ``m`` is milli (in a SPICE deck ``M`` is milli, too).  The
    suffix may replace the decimal point, as in ``4k7`` (IEC 60062).
    """
    number = _parsed(value)
    if number is None or not isfinite(number):
        raise InputError(
            f"{short(value)} is not a number; write a finite number such as 3.3 or 1e4, or a number with one of the "
            "suffixes T G M (or meg) k m u n p f, such as 10k, 4k7, 2.2meg or 100n"
        )
    return number


def parse_fraction(value: object) -> float:
    """Return the fraction of a percentage (``"10 %"``) or a number (0.1); raise InputError for other values."""
    if isinstance(value, str) and value.endswith("%"):
        number = _parsed(value[:-1].rstrip(" "))
        if number is not None and isfinite(number):
            return float(f"{number!r}e-2") if "e" not in repr(number) else number / 100
        raise InputError(
            f'{short(value)} is not a fraction; write a percentage such as "10 %", or a number such as 0.1'
        )
    return parse_quantity(value)


def prefix_of(value: float) -> tuple[int, str]:
    """Return the exponent of a value's SI prefix and the prefix: (3, "k") for 4700.

    The exponent is the multiple of three for which ``value / 10**exponent`` has a magnitude from 1 to below 1000,
    limited to the range from -24 to 12; it is 0 for 0 and for values that are not finite.
    """
    power = 3 * floor(log10(abs(value)) / 3) if value and isfinite(value) else 0
    power = min(max(power, min(PREFIXES)), max(PREFIXES))
    return power, PREFIXES[power]


def format_quantity(value: float, unit: str = "", digits: int = 4) -> str:
    """Return a value as text with an SI prefix: ``38.1 µA``, ``10 kΩ``.

    `unit`: SI unit, empty for none; `digits`: number of significant digits.
    """
    power, prefix = prefix_of(float(f"{value:.{digits}g}"))
    gap = " " if unit else ""
    return f"{value / 10.0**power:.{digits}g}{gap}{prefix}{unit}"


def _parsed(value: object) -> float | None:
    if isinstance(value, int | float) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            return None
    match = _VALUE.fullmatch(value) if isinstance(value, str) and len(value) <= 64 else None
    if match is None:
        return None
    number, end, before, suffix, after = match.groups()
    if number is None:
        return float(f"{before}.{after}e{EXPONENTS[suffix]}")
    return float(f"{number}e{EXPONENTS[end]}" if end in EXPONENTS else match[0])
