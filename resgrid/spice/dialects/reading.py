"""How a dialect of SPICE is read, as data; its traps stand on the pages of the simulators.

What they disagree about, and what follows:

- A suffix ``x`` is mega in HSPICE and Xyce and an ignored unit in ngspice and LTspice; ``a`` is atto in HSPICE alone.
  ``M`` is milli in all of them, but mega in Spectre.  ``4k7`` is 4700 in LTspice and 4000 in ngspice, so it is refused
  outside LTspice.
- ``;``, ``//`` and ``$`` (after a blank) end a line of ngspice; HSPICE knows ``$`` alone, LTspice and Xyce ``;``.
- Ground is ``0``; ``gnd`` is another name of it except in Xyce (unless ``.preprocess replaceground true``).
- ``^`` is a power in ngspice and exclusive or in LTspice and Xyce.  ``log`` is the natural logarithm, but
  Xyce's manuals differ between versions, so there it is refused.  HSPICE's ``pow`` cuts its exponent to an integer.
- The ``r`` of a resistor's model is a resistance in ngspice and a factor in Xyce.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

SUFFIXES = {"t": 12, "g": 9, "meg": 6, "k": 3, "m": -3, "u": -6, "µ": -6, "μ": -6, "n": -9, "p": -12, "f": -15}
"""Powers of ten of the suffixes that all but Spectre know, in lower case."""

_NAMES = (
    "sqrt exp ln log10 abs int floor ceil min max pow pwr sgn atan2 hypot "
    "sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh"
)
FUNCTIONS = {name: name for name in _NAMES.split()}
"""Functions that mean the same everywhere."""

ARCS = {"arctan": "atan", "arcsin": "asin", "arccos": "acos"}


@dataclass(frozen=True, eq=False)
class ReadingRules:
    """How decks of one dialect are read.

    `name`: the dialect; `signs`: what only its decks hold, in lower case, and `suffix`: what their names end in;
    `comments`: marks that end a line wherever they stand; `dollar_comments`: whether ``$`` after a blank or a comma,
    or first in a line, ends it too; `suffixes`: power of ten of a suffix; `infix_suffixes`: whether ``4k7`` is 4700;
    `d_exponents`: whether ``1d3`` is 1000; `milli_mil`: whether ``mil`` is milli in expressions, 25.4e-6 elsewhere;
    `grounds`: names of node 0, in lower case; `no_grounds`: names that are ground elsewhere; `powers`: operators that
    raise to a power; `functions`: what functions in expressions are called and which of
    `resgrid.spice.read.expressions.FUNCTIONS` they are; `model_factor`: whether the ``r`` of a resistor's model
    multiplies; `lengths_twice`: whether a model's ``narrow`` and ``short`` are taken off at both ends; `annotations`:
    what may be written behind an element without meaning anything to a simulation; `operators`: operators that are
    not what `resgrid.spice.read.expressions` takes their symbols for; `narrow_parser`: whether signs after operators
    and choices within choices are misread; `puts_in_text`: whether functions, and what an ``X`` line gives, are put
    in as text: their names are looked up where they land; `replaces_multipliers`: whether ``m=`` of an ``X`` line
    takes the place of ``m=`` within, and does not reach switches; `end_is_comment`: whether what stands after
    ``.end`` is read; `first_counts`: whether the first of several models of one name counts, and the first of several
    options on a line; `temp_command_first`: whether ``.temp`` counts before ``.option temp``, wherever they stand;
    `braced_temperatures`: whether a temperature must be a number, or stand in braces; `sheet_first`: whether a
    model's ``rsh`` counts before its ``r``, even without length and width; `models_first`: whether a model's name is
    overlooked after a value that does not begin with a digit; `ignored_model_keys`: parameters of resistors' models
    that others obey, and what to write instead (nothing: they are obeyed, and not read here); `spaced_lists`: whether
    the values of ``tc=`` are parted by blanks, without parentheses; `scale_key`: whether ``scale=`` of a resistor is
    obeyed; `refused_options`: options that change the circuit in a way that is not followed here; `refused_elements`:
    what else a letter means; `series_resistance`: whether voltage sources may have ``rser=``; `inductor_ohms`: what
    an inductor has unless it says ``rser=0``; `off_ohms`: resistance of a switch that is off; `holds_initial`:
    whether ``.ic`` holds nodes at the operating point; `instances`: whether elements are instances of a master, as in
    Spectre, whose names and suffixes differ by case, too; `spice`: how such a deck is read behind ``simulator
    lang=spice``.
    """

    name: str
    signs: tuple[bytes, ...] = ()
    suffix: str = ""
    comments: tuple[str, ...] = (";",)
    dollar_comments: bool = False
    suffixes: Mapping[str, int] = field(default_factory=lambda: SUFFIXES)
    grounds: frozenset[str] = frozenset({"0", "gnd"})
    no_grounds: frozenset[str] = frozenset()
    functions: Mapping[str, str] = field(default_factory=lambda: FUNCTIONS)
    infix_suffixes: bool = False
    d_exponents: bool = False
    milli_mil: bool = False
    powers: frozenset[str] = frozenset({"**"})
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
    ignored_model_keys: Mapping[str, str] = field(default_factory=dict)
    spaced_lists: bool = False
    scale_key: bool = False
    refused_options: frozenset[str] = frozenset()
    refused_elements: Mapping[str, str] = field(default_factory=dict)
    series_resistance: bool = False
    inductor_ohms: float = 0.0
    off_ohms: float = 1e12
    holds_initial: bool = False
    instances: bool = False
    spice: ReadingRules | None = None
