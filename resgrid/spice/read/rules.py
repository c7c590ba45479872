"""How dialects of SPICE are read, as data.

What they disagree about, and what follows:

- A suffix ``x`` is mega in HSPICE and Xyce and an ignored unit in ngspice and LTspice; ``a`` is atto in HSPICE alone.
  ``M`` is milli in all of them.  ``4k7`` is 4700 in LTspice and 4000 in ngspice, so it is refused outside LTspice.
- ``;``, ``//`` and ``$`` (after a blank) end a line of ngspice; HSPICE knows ``$`` alone, LTspice and Xyce ``;``.
- Ground is ``0``; ``gnd`` is another name of it except in Xyce (unless ``.preprocess replaceground true``).
- ``^`` is a power in ngspice and exclusive or in LTspice and Xyce.  ``log`` is the natural logarithm, but
  Xyce's manuals differ between versions, so there it is refused.  HSPICE's ``pow`` cuts its exponent to an integer.
- HSPICE's nominal temperature is 25 degrees Celsius, that of the others 27.
- The ``r`` of a resistor's model is a resistance in ngspice and a factor in Xyce.
- ngspice has ways of its own, measured with versions 39 and 46, which agree wherever a value is read here.  Functions
  and what an ``X`` line gives are put in as text, so that names in them are looked up where they land; ``m=`` of an
  ``X`` line takes the place of that of the elements within; ``.end`` ends nothing; ``.temp`` counts before
  ``.option temp``; the first of two models counts; ``rsh`` counts before ``r``.  Where nobody can have meant it (a
  parameter that means another one where it lands), the deck is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from resgrid.errors import InputError


@dataclass(frozen=True)
class ReadingRules:
    """How one dialect is read.

    `name`: the dialect; `comments`: marks that end a line wherever they stand; `dollar_comments`: whether ``$`` after
    a blank or a comma, or first in a line, ends it too; `suffixes`: power of ten of a suffix, in lower case;
    `infix_suffixes`: whether ``4k7`` is 4700; `d_exponents`: whether ``1d3`` is 1000; `milli_mil`: whether ``mil`` is
    milli in expressions, 25.4e-6 elsewhere; `grounds`: names of node 0, in lower case; `powers`: operators that raise
    to a power; `functions`: what functions in expressions are called and which of
    `resgrid.spice.read.expressions.FUNCTIONS` they are; `model_factor`: whether the ``r`` of a resistor's model
    multiplies; `lengths_twice`: whether a model's ``narrow`` and ``short`` are taken off at both ends; `annotations`:
    what may be written behind an element without meaning anything to a simulation; `operators`: operators that are
    not what `resgrid.spice.read.expressions` takes their symbols for; `narrow_parser`: whether signs after
    operators and choices within choices are misread; `puts_in_text`: whether functions, and what an ``X`` line gives,
    are put in as text: their names are looked up where they land; `replaces_multipliers`: whether ``m=`` of an ``X``
    line takes the place of ``m=`` within, and does not reach switches; `end_is_comment`: whether what stands after
    ``.end`` is read; `first_counts`: whether the first of several models of one name counts, and the first of several
    options on a line; `temp_command_first`: whether ``.temp`` counts before ``.option temp``, wherever they stand;
    `braced_temperatures`: whether a temperature must be a number, or stand in braces; `sheet_first`: whether a
    model's ``rsh`` counts before its ``r``, even without length and width; `models_first`: whether a model's name is
    overlooked after a value that does not begin with a digit; `ignored_model_keys`: parameters of resistors' models
    that others obey; `spaced_lists`: whether the values of ``tc=`` are parted by blanks, without parentheses;
    `refused_options`: options that change the circuit in a way that is not followed here; `shunt_options`: options
    that tie every node to ground, which is not done here.
    """

    name: str
    comments: tuple[str, ...]
    dollar_comments: bool
    suffixes: Mapping[str, int]
    grounds: frozenset[str]
    functions: Mapping[str, str]
    infix_suffixes: bool = False
    d_exponents: bool = False
    milli_mil: bool = False
    powers: frozenset[str] = field(default=frozenset({"**"}))
    model_factor: bool = False
    lengths_twice: bool = False
    annotations: frozenset[str] = frozenset()
    operators: Mapping[str, str] = field(default_factory=dict)
    narrow_parser: bool = False
    puts_in_text: bool = False
    replaces_multipliers: bool = False
    end_is_comment: bool = False
    first_counts: bool = False
    temp_command_first: bool = False
    braced_temperatures: bool = False
    sheet_first: bool = False
    models_first: bool = False
    ignored_model_keys: frozenset[str] = frozenset()
    spaced_lists: bool = False
    refused_options: frozenset[str] = frozenset()
    shunt_options: frozenset[str] = frozenset()


MIL = 25.4e-6
"""The suffix ``mil``, a thousandth of an inch, in metres."""

_SUFFIXES = {"t": 12, "g": 9, "meg": 6, "k": 3, "m": -3, "u": -6, "µ": -6, "μ": -6, "n": -9, "p": -12, "f": -15}
_FUNCTIONS = {
    name: name
    for name in (
        *("sqrt", "exp", "ln", "log10", "abs", "int", "floor", "ceil", "min", "max", "pow", "pwr", "sgn", "atan2"),
        *("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "hypot"),
    )
}
_LN = {"log": "ln"}
_ARCS = {"arctan": "atan", "arcsin": "asin", "arccos": "acos"}

NGSPICE = ReadingRules(
    name="ngspice",
    comments=(";", "//"),
    dollar_comments=True,
    suffixes=_SUFFIXES,
    grounds=frozenset({"0", "gnd"}),
    functions={
        **{name: name for name in _FUNCTIONS if name not in ("atan2", "hypot")},
        **_LN,
        "arctan": "atan",
        "nint": "nint",
        "ternary_fcn": "if",
    },
    milli_mil=True,
    powers=frozenset({"**", "^"}),
    lengths_twice=True,
    operators={"%": "% of the quotient", "\\": "\\ of the magnitude"},
    narrow_parser=True,
    puts_in_text=True,
    replaces_multipliers=True,
    end_is_comment=True,
    first_counts=True,
    temp_command_first=True,
    braced_temperatures=True,
    sheet_first=True,
    models_first=True,
    ignored_model_keys=frozenset({"defl", "dl", "tref"}),
    spaced_lists=True,
    refused_options=frozenset({"rseries"}),
    shunt_options=frozenset({"rshunt"}),
)
LTSPICE = ReadingRules(
    name="ltspice",
    comments=(";",),
    dollar_comments=False,
    suffixes=_SUFFIXES,
    grounds=frozenset({"0", "gnd"}),
    functions={
        **_FUNCTIONS,
        **_LN,
        **_ARCS,
        "if": "if",
        "limit": "limit",
        "round": "nint",
        "u": "step",
        "uramp": "ramp",
        "buf": "step_half",
    },
    infix_suffixes=True,
    annotations=frozenset({"tol", "pwr", "mfg", "pn", "type"}),
    shunt_options=frozenset({"gshunt"}),
)
XYCE = ReadingRules(
    name="xyce",
    comments=(";",),
    dollar_comments=False,
    suffixes={**_SUFFIXES, "x": 6},
    grounds=frozenset({"0"}),
    functions={**_FUNCTIONS, **_ARCS, "if": "if", "limit": "limit", "nint": "nint", "stp": "step", "uramp": "ramp"},
    model_factor=True,
)
HSPICE = ReadingRules(
    name="hspice",
    comments=(),
    dollar_comments=True,
    suffixes={**_SUFFIXES, "x": 6, "a": -18},
    grounds=frozenset({"0", "gnd", "gnd!", "ground"}),
    functions={**_FUNCTIONS, **_LN, "nint": "nint", "pow": "pow_integer", "pwr": "pwr_signed"},
    d_exponents=True,
    lengths_twice=True,
    shunt_options=frozenset({"gshunt"}),
)

RULES = {rules.name: rules for rules in (NGSPICE, LTSPICE, XYCE, HSPICE)}

_SIGNS = (
    (b"simulator lang", "spectre"),
    (b"\n.backanno", "ltspice"),
    (b"ltspice", "ltspice"),
    (b"\n.preprocess", "xyce"),
    (b"\n.options device ", "xyce"),
    (b"\n.options linsol", "xyce"),
    (b"\n.option post", "hspice"),
    (b"\n.options post", "hspice"),
    (b"\n.option parhier", "hspice"),
)
_LOOKED_AT = 65536


def rules_named(name: str) -> ReadingRules:
    """Look the rules of a dialect up."""
    if name not in RULES:
        raise InputError(f"decks of dialect {name!r} cannot be read; those of {', '.join(RULES)} can")
    return RULES[name]


def guess_dialect(data: bytes) -> str:
    """Dialect that a deck shows signs of: words that only one simulator knows; ngspice without any."""
    text = b"\n" + (data[:_LOOKED_AT] + data[-_LOOKED_AT:] if len(data) > 2 * _LOOKED_AT else data).lower()
    return next((name for sign, name in _SIGNS if sign in text), "ngspice")
