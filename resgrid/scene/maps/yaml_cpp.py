"""Reader of YAML by the rules of yaml-cpp: scalars are text, converted to numbers by the rules of C++ streams.

ROS map readers use yaml-cpp, whose scalars have no type: ``node.as<double>()`` and ``node.as<int>()`` convert the text.
PyYAML's conversion follows YAML 1.1 instead, in which ``010`` is octal for all types of numbers and ``1:30`` is 90.
Source read: yaml-cpp 0.7, ``include/yaml-cpp/node/convert.h`` and ``src/convert.cpp``.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterable
from math import inf, isinf, nan
from pathlib import Path
from typing import TypeAlias

import yaml

from resgrid._internal.files import MAX_TEXT_BYTES, read_bytes
from resgrid.errors import InputError

Scalar: TypeAlias = "str | dict[str, str] | None"
"""Value of a YAML node: text; None for null; or an empty dictionary, which stands for any node that is not a scalar."""

Value: TypeAlias = "Scalar | list[Scalar]"

_BOMS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_DOUBLE = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?[ \t\n\v\f\r]*", re.ASCII)
_INT = re.compile(r"([+-]?)(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9]\d*)[ \t\n\v\f\r]*", re.ASCII)
_INT_LIMIT = 2**31
_SPECIAL = {
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf", "+.Inf", "+.INF"), inf),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), -inf),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), nan),
}
_TRUTHS = {"y": True, "yes": True, "true": True, "on": True, "n": False, "no": False, "false": False, "off": False}


class _Loader(yaml.SafeLoader):
    """YAML loader that keeps scalars as text, and accepts the same deviations from the YAML standard as yaml-cpp."""

    def check_printable(self, data: str) -> None:
        """Accept all characters without an error, such as bytes of a comment in another encoding."""

    def scan_to_next_token(self) -> None:
        """Skip blanks, comments and tabs before the next token; indentation by tabs is still an error."""
        super().scan_to_next_token()
        while self.peek() == "\t" and (self.flow_level or self.column or self._is_blank_line()):
            if self.column and not self.flow_level:
                self.allow_simple_key = False
            while self.peek() == "\t":
                self.forward()
            super().scan_to_next_token()

    def _is_blank_line(self) -> bool:
        """Return whether the rest of the line is blank or a comment."""
        ahead = 0
        while self.peek(ahead) in (" ", "\t"):
            ahead += 1
        return self.peek(ahead) in ("#", "\n", "\r", "\0")


def read_mapping(path: Path, keys: Iterable[str]) -> dict[str, Value]:
    """Return the values of `keys` in the first document of a YAML file by key; other keys are ignored.

    A value is a text, None for null, a list, or an empty dictionary for a mapping.  Entries of a list are texts, None,
    or empty dictionaries for lists and mappings.

    Raises
    ------
    InputError
        If the file is not YAML, is not a mapping, or repeats a key.
    """
    node = _first_document(path)
    if not isinstance(node, yaml.MappingNode):
        found = {yaml.ScalarNode: "a single value", yaml.SequenceNode: "a list"}.get(type(node), "no content")
        raise InputError(f"{path}: a map.yaml must have keys and values (image: ..., resolution: ...), got {found}")
    lines: dict[str, int] = {}
    values: dict[str, Value] = {}
    wanted = set(keys)
    for key, value in node.value:
        if not isinstance(key, yaml.ScalarNode):
            continue
        line = key.start_mark.line + 1
        if key.value in lines:
            raise InputError(
                f"{path}: line {line}: {key.value}: this key is already on line {lines[key.value]}; remove one"
            )
        lines[key.value] = line
        if key.value in wanted:
            values[key.value] = _value(value)
    return values


def double(text: str) -> float:
    """Return the number of a text by the rules of ``node.as<double>()`` in yaml-cpp.

    Raises
    ------
    ValueError
        If the text is not a number.
    """
    if text in _SPECIAL:
        return _SPECIAL[text]
    number = float(text) if _DOUBLE.fullmatch(text) else inf
    if isinf(number):
        raise ValueError(f"must be a number, got {text[:40]!r}")
    return number


def whole(text: str) -> int:
    """Return the integer of a text by the rules of ``node.as<int>()`` in yaml-cpp.

    The text is decimal, octal (``0...``) or hexadecimal (``0x...``).

    Raises
    ------
    ValueError
        If the text is not a whole number of 32 bits.
    """
    match = _INT.fullmatch(text)
    if match is None:
        raise ValueError(f"must be a whole number, got {text[:40]!r}")
    sign, digits = match.groups()
    base = 16 if digits[:2] in ("0x", "0X") else 8 if digits[0] == "0" else 10
    number = int(digits, base) * (-1 if sign == "-" else 1)
    if not -_INT_LIMIT <= number < _INT_LIMIT:
        raise ValueError(f"must be a whole number of 32 bits, got {text[:40]!r}")
    return number


def truth(text: str) -> bool:
    """Return the boolean of a text (yes, true, on, y, no, false, off, n) by the rules of yaml-cpp's ``as<bool>()``.

    Raises
    ------
    ValueError
        If the text is not a boolean.
    """
    is_flexible = text in (text.lower(), text.upper(), text.capitalize())
    if not (is_flexible and text.lower() in _TRUTHS):
        raise ValueError(f"must be true or false, got {text[:40]!r}")
    return _TRUTHS[text.lower()]


def _first_document(path: Path) -> yaml.Node | None:
    text = _text(path)
    try:
        loader = _Loader(_without_directives(text))
        return loader.get_node() if loader.check_node() else None
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise InputError(f"{path}: {line}this is not YAML ({error.problem})") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise InputError(f"{path}: this is not YAML ({type(error).__name__})") from None


def _text(path: Path) -> str:
    """Return the text of a file; bytes that are not UTF-8 become surrogates, so that file names remain valid."""
    data = read_bytes(path, MAX_TEXT_BYTES)
    encoding = next((name for mark, name in _BOMS if data.startswith(mark)), None)
    text = data.decode("utf-8-sig", "surrogateescape") if encoding is None else data.decode(encoding, "replace")
    return text.replace("\r\n", "\n")


def _without_directives(text: str) -> str:
    """Return YAML text in which directives such as OpenCV's ``%YAML:1.0``, which PyYAML rejects, are comments."""
    lines = text.split("\n")
    for number, line in enumerate(lines):
        if line.startswith("%"):
            lines[number] = f"#{line}"
        elif line.strip() and not line.lstrip().startswith("#"):
            break
    return "\n".join(lines)


def _value(node: yaml.Node) -> Value:
    if isinstance(node, yaml.SequenceNode):
        return [_scalar(entry) for entry in node.value]
    return _scalar(node)


def _scalar(node: yaml.Node) -> Scalar:
    if not isinstance(node, yaml.ScalarNode):
        return {}
    is_null = node.style is None and node.tag == "tag:yaml.org,2002:null"
    return None if is_null else str(node.value)
