"""Parser of numerals with suffixes: ``2.2k``, ``10uF``, ``1meg``."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

from resgrid.spice.dialects.record import ReadingRules

_NUMBER = re.compile(r"([+-]?)(\d++(?:\.\d*+)?|\.\d++)(?:([eEdD])([+-]?\d{1,9}))?([^\W\d_]*+)")
_INFIX = re.compile(r"([+-]?)(\d++)(meg|[tgkmunpfµμ])(\d++)[^\W\d_]*+", re.IGNORECASE)
MIL = 25.4e-6
"""Value of the suffix ``mil``, a thousandth of an inch, in metres."""

_UNIT = "Ω"


class Numeral(NamedTuple):
    """The value of a numeral.

    `value`: the value without its unit, such as 2200 for ``2.2kOhm``; `warning`: how other simulators or readers may
    interpret the numeral, empty if they agree.
    """

    value: float
    warning: str = ""


def parse_numeral(text: str, rules: ReadingRules, *, computed: bool = False) -> Numeral | str | None:
    """Return the value of a numeral with suffix and unit; an error message if it is ambiguous; None for other text.

    The error message is a str.  `rules`: reading rules of the dialect; `computed`: whether the numeral is part of an
    expression, where some dialects read the suffix ``mil`` as milli, so that this suffix is ambiguous.

    Examples
    --------
    >>> from resgrid.spice.dialects import DIALECTS
    >>> parse_numeral("2.2kOhm", DIALECTS["ngspice"].reading)
    Numeral(value=2200.0, warning='')
    >>> parse_numeral("out", DIALECTS["ngspice"].reading) is None
    True
    """
    match = _NUMBER.fullmatch(text)
    if match is None:
        return _infix(text, rules)
    sign, digits, mark, exponent, letters = match.groups()
    if mark in ("d", "D") and not rules.d_exponents:
        return f"{text!r}: {rules.name} does not everywhere take D for an exponent; write e"
    power, unit, warning = _suffix(letters, rules)
    if rules.instances and unit:
        return f"{text!r} has letters after its suffix: in Spectre M is mega, m is milli, and units are not written"
    if power is None and computed and rules.milli_mil:
        return f"{text!r}: mil is milli in an expression of {rules.name}, and 25.4e-6 elsewhere; write a plain number"
    if not unit.isascii() and unit != _UNIT:
        return f"{text!r} has the unit {unit!r}; a unit must consist of ASCII letters"
    value = float(f"{sign}{digits}e{int(exponent or 0) + (power or 0)}")
    return _checked(text, value * MIL if power is None else value, digits, warning)


def _suffix(letters: str, rules: ReadingRules) -> tuple[int | None, str, str]:
    """Return the exponent of ten of a suffix (None for ``mil``), the unit after the suffix, and a warning or "".

    `letters`: suffix and unit, such as ``kOhm``, which gives 3, ``Ohm`` and no warning; `rules`: reading rules of the
    dialect.  Letters without a suffix are a unit with the exponent 0.
    """
    if rules.instances:
        return rules.suffixes.get(letters[:1], 0), letters[letters[:1] in rules.suffixes :], ""
    folded = letters.lower()
    if folded.startswith("meg") and "meg" in rules.suffixes:
        return rules.suffixes["meg"], letters[3:], ""
    if folded.startswith("mil"):
        return None, letters[3:], ""
    if not folded or folded[0] not in rules.suffixes:
        warning = f"{rules.name} takes x for a unit and ignores it, where others read mega" if folded == "x" else ""
        return 0, letters, warning
    warning = ""
    if letters[0] == "M":
        warning = "M is milli, a thousandth; mega is MEG"
    elif letters == "F":
        warning = "F is femto, 1e-15, not farad"
    return rules.suffixes[folded[0]], letters[1:], warning


def _infix(text: str, rules: ReadingRules) -> Numeral | str | None:
    """Return the value of a numeral whose suffix stands for the decimal point (``4k7`` is 4700); None for other text.

    In a dialect without such numerals, the result is an error message (str).  `rules`: reading rules of the dialect.
    """
    match = _INFIX.fullmatch(text)
    if match is None:
        return None
    if not rules.infix_suffixes:
        return f"{text!r}: LTspice reads a suffix as a decimal point, {rules.name} drops digits after it; write a point"
    sign, whole, suffix, fraction = match.groups()
    return _checked(text, float(f"{sign}{whole}.{fraction}e{rules.suffixes[suffix.lower()]}"), whole + fraction, "")


def _checked(text: str, value: float, digits: str, warning: str) -> Numeral | str:
    """Return `value` as a numeral with the warning, or an error message if the value overflows or underflows.

    `text`: the numeral as written; `digits`: digits of the numeral without sign and exponent.
    """
    if math.isinf(value):
        return f"{text} is larger than the largest double (1.8e308)"
    if value == 0 and digits.strip("0."):
        return f"{text} is smaller than the smallest double (4.9e-324), but not zero"
    return Numeral(value, warning)
