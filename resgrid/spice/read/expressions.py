r"""Evaluation of arithmetic expressions in braces or quotes.

Precedence as in ngspice's manual (section 2.8, ``.param``), tightest first: power, sign and ``!``, ``* / % \``,
``+ -``, comparisons, ``&&``, ``||``, ``? :``.  Expressions on which simulators disagree are rejected: a chain of
powers, and a negative number to an odd or fractional power.  Expressions that ngspice misreads are rejected for
ngspice: a sign after an operator unless a number follows, and a conditional in the first branch of a conditional.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

from resgrid.spice.dialects.record import ReadingRules
from resgrid.spice.read.expression_functions import FUNCTIONS
from resgrid.spice.read.expression_tokens import ExpressionError, ExpressionToken, tokens_of
from resgrid.spice.read.numerals import parse_numeral
from resgrid.spice.read.unknown_values import unknown_parameter

_PARENS = "write parentheses"

MAX_NESTING = 60
"""Maximum nesting depth of parentheses and conditionals in an expression; deeper ones raise ExpressionError."""

MAX_LENGTH = 10_000
"""Maximum length of an expression, in characters; longer ones raise ExpressionError."""

_NAME = re.compile(r"(?<![\w.])[^\W\d]\w*")
_PRODUCT = 5
_POWERS = frozenset({"**", "^"})
_STATISTICS = frozenset(
    ("agauss", "gauss", "aunif", "unif", "limit", "mc", "flat", "rand", "random", "normal", "table", "v", "i", "ddt")
)

Lookup = Callable[[str], float | None]
Call = Callable[[str, list[float], Lookup], float | None]


class ReservedNameError(ValueError):
    """Error for a name that the simulator reserves and resgrid has no value for; the message gives the reason."""


def evaluate(text: str, rules: ReadingRules, lookup: Lookup, call: Call) -> float:
    """Return the value of an expression.

    `rules`: reading rules of the dialect; `lookup`: function from the name of a parameter to its value; `call`:
    function from the name of a function that the deck defines, its argument values and `lookup` to its value; both
    return None for unknown names.  Raises ExpressionError.

    Examples
    --------
    >>> from resgrid.spice.dialects import DIALECTS
    >>> rules = DIALECTS["ngspice"].reading
    >>> evaluate("2*r + 1k", rules, {"r": 3.0}.get, lambda name, values, lookup: None)
    1006.0
    """
    if len(text) > MAX_LENGTH:
        raise ExpressionError(0, f"an expression of {len(text)} characters; at most {MAX_LENGTH} are supported")
    names = _names(text, rules.instances)
    if names is not None:
        try:
            values = tuple(map(lookup, names))
        except ReservedNameError:
            return _value(text, rules, lookup, call)  # the evaluation by tokens adds the position to the error
        if None not in values:
            return _value_with(text, rules, values)
    return _value(text, rules, lookup, call)


@lru_cache(maxsize=4096)
def _names(text: str, exact: bool) -> tuple[str, ...] | None:
    """Return the parameter names in an expression, in order; None if the expression calls functions.

    The deck may define functions, so such an expression must be parsed at every evaluation.  `exact`: whether the
    names of Spectre's constants (``M_PI``, ...) keep their case; all other names are in lower case.
    """
    tokens = tokens_of(text)
    if any(token.kind == "name" and after.text == "(" for token, after in pairwise(tokens)):
        return None
    return tuple(folded_name(token.text, exact) for token in tokens if token.kind == "name")


def names_in(text: str) -> frozenset[str]:
    """Return the names of parameters and functions in an expression, in lower case."""
    return frozenset(match.group().lower() for match in _NAME.finditer(text))


def folded_name(name: str, exact: bool) -> str:
    """Return a name in lower case; with `exact`, a name of one of Spectre's constants (``M_``, ``P_``) unchanged.

    Examples
    --------
    >>> folded_name("W", True), folded_name("M_PI", True), folded_name("M_PI", False)
    ('w', 'M_PI', 'm_pi')
    """
    return name if exact and name[:2] in ("M_", "P_") else name.lower()


@lru_cache(maxsize=65536)
def _value_with(text: str, rules: ReadingRules, values: tuple[float, ...]) -> float:
    """Return the value of an expression without function calls; `values`: of the parameters, in order of occurrence."""
    given = dict(zip(_names(text, rules.instances) or (), values, strict=True))
    return _value(text, rules, given.get, lambda *_: None)


def _value(text: str, rules: ReadingRules, lookup: Lookup, call: Call) -> float:
    """Return the finite value of the expression `text`; raise ExpressionError if its syntax or its value is invalid."""
    reader = _Reader(tokens_of(text), rules, lookup, call)
    try:
        value = reader.choice()
        reader.expect_end()
    except (OverflowError, ZeroDivisionError) as error:
        raise ExpressionError(0, f"{text!r} has no finite value ({error})") from None
    if not math.isfinite(value):
        raise ExpressionError(0, f"{text!r} has no finite value")
    return value


@dataclass
class _Reader:
    """A precedence-climbing parser that evaluates the tokens of one expression.

    `tokens`: the tokens, with an end token last; `rules`: reading rules of the dialect; `lookup`: function that returns
    the value of a name, or None; `call`: function that returns the value of one of the deck's functions, or None;
    `position`: index of the next token; `depth`: present nesting depth of conditionals and parentheses.
    """

    tokens: tuple[ExpressionToken, ...]
    rules: ReadingRules
    lookup: Lookup
    call: Call
    position: int = 0
    depth: int = 0

    def choice(self, *, within: bool = False) -> float:
        """Return the value of ``condition ? this : that``, or of the condition alone if no ``?`` follows.

        `within`: whether the expression is the first branch (``this``) of another conditional.
        """
        self.depth += 1
        if self.depth > MAX_NESTING:
            raise ExpressionError(self._now.offset, f"nested more than {MAX_NESTING} deep")
        value = self._binary(1)
        if self._now.text == "?":
            if within and self.rules.narrow_parser:
                raise ExpressionError(
                    self._now.offset, f"{self.rules.name} misreads a conditional within a conditional: {_PARENS}"
                )
            self.position += 1
            self._check_truth(value)
            this = self.choice(within=True)
            self._expect(":")
            that = self.choice()
            value = this if value else that
        self.depth -= 1
        return value

    def expect_end(self) -> None:
        """Raise ExpressionError unless all tokens of the expression are consumed."""
        if self._now.kind != "end":
            raise ExpressionError(self._now.offset, f"unexpected {self._now.text!r}")

    @property
    def _now(self) -> ExpressionToken:
        """The next token to consume."""
        return self.tokens[self.position]

    def _expect(self, text: str) -> None:
        """Consume the next token; raise ExpressionError if it is not `text`."""
        if self._now.text != text:
            raise ExpressionError(self._now.offset, f"{text!r} was expected, found {self._now.shown}")
        self.position += 1

    def _binary(self, level: int) -> float:
        """Consume operands and operators of precedence at least `level` (1 weakest, 5 tightest); return the value."""
        left = self._signed()
        while self._now.text in _BINARY and level <= _BINARY[self._now.text][0]:
            token = self._now
            self.position += 1
            own_level, function = _BINARY[self.rules.operators.get(token.text, token.text)]
            right = self._binary(own_level + 1)
            if token.text in ("/", "\\", "%") and right == 0:
                raise ExpressionError(token.offset, "division by zero")
            if token.text in ("&&", "||"):
                self._check_truth(left, right)
            left = float(function(left, right))
        return left

    def _check_truth(self, *values: float) -> None:
        """Raise ExpressionError for a nonzero condition of at most 0.5, in dialects where values above 0.5 are true."""
        if self.rules.words.true_above_half and any(bool(value) != (value > 0.5) for value in values):
            label = self.rules.name
            raise ExpressionError(self._now.offset, f"in {label} only values above 0.5 are true: write a comparison")

    def _signed(self) -> float:
        """Consume leading ``+``, ``-`` and ``!`` and the operand after these; return the value of the whole."""
        sign = self._now
        if sign.kind != "operator" or sign.text not in ("-", "+", "!"):
            return self._power()
        leads = self.position == 0 or self.tokens[self.position - 1].text in ("(", ",")
        if self.rules.narrow_parser and sign.text != "!" and not leads:
            self._refuse_misread(sign)
        self.position += 1
        if sign.text == "!":
            negated = self._signed()
            self._check_truth(negated)
            return float(not negated)
        value = self._binary(_PRODUCT) if leads else self._signed()
        return -value if sign.text == "-" else value

    def _refuse_misread(self, sign: ExpressionToken) -> None:
        """Raise ExpressionError unless `sign` is a minus before a plain number and not after ``!``."""
        number, after = (self.tokens[min(self.position + i, len(self.tokens) - 1)] for i in (1, 2))
        is_plain = number.kind == "number" and after.text not in _POWERS
        if sign.text == "+" or not is_plain or self.tokens[self.position - 1].text == "!":
            raise ExpressionError(sign.offset, f"{self.rules.name} misreads a sign after an operator: {_PARENS}")

    def _power(self) -> float:
        """Consume a base, and perhaps a power operator with an exponent; return the value of the power or the base."""
        negated = self.position > 0 and self.tokens[self.position - 1].text == "!"
        base = self._atom()
        sign = self._now
        if sign.text not in _POWERS:
            return base
        if sign.text not in self.rules.powers:
            raise ExpressionError(
                sign.offset,
                f"{sign.text!r} is not the power operator of {self.rules.name} (perhaps exclusive or); write **",
            )
        if negated and self.rules.narrow_parser:
            raise ExpressionError(sign.offset, f"{self.rules.name} applies ! before the power: {_PARENS}")
        self.position += 1
        negative = self._now
        if negative.text == "-":
            if self.rules.narrow_parser:
                self._refuse_misread(negative)
            self.position += 1
        exponent = self._atom()
        if self._now.text in _POWERS:
            raise ExpressionError(self._now.offset, "simulators disagree about a power of a power: write parentheses")
        exponent = -exponent if negative.text == "-" else exponent
        if base < 0 and exponent % 2:
            text = f"simulators disagree about {base!r} to the power {exponent!r}: rewrite the expression"
            raise ExpressionError(sign.offset, text)
        return float(base**exponent)

    def _atom(self) -> float:
        """Consume a number, a name, a function call or an expression in parentheses; return its value."""
        token = self._now
        self.position += token.kind != "end"
        if token.kind == "number":
            numeral = parse_numeral(token.text, self.rules, computed=True)
            if numeral is None or isinstance(numeral, str):
                raise ExpressionError(token.offset, numeral or f"{token.text!r} is not a number")
            return numeral.value
        if token.kind == "name":
            return self._call_function(token) if self._now.text == "(" else self._parameter(token)
        if token.text == "(":
            value = self.choice()
            self._expect(")")
            return value
        raise ExpressionError(token.offset, f"a number or a name was expected, found {token.shown}")

    def _parameter(self, token: ExpressionToken) -> float:
        """Return the value of the parameter that `token` names; raise ExpressionError if the parameter is undefined."""
        try:
            value = self.lookup(folded_name(token.text, self.rules.instances))
        except ReservedNameError as reserved:
            raise ExpressionError(token.offset, str(reserved)) from None
        if value is None:
            raise ExpressionError(token.offset, unknown_parameter(token.text, self.rules))
        return value

    def _call_function(self, token: ExpressionToken) -> float:
        """Return the value of the function call whose name is `token`; the deck's functions precede built-in ones."""
        try:
            values = self._arguments()
        except ExpressionError:
            if token.text.lower() not in _STATISTICS:
                raise
            raise _no_function(token, self.rules) from None  # its arguments may be nodes, as in v(a, b)
        value = self.call(token.text.lower(), values, self.lookup)
        return _built_in(token, values, self.rules) if value is None else value

    def _arguments(self) -> list[float]:
        """Return the values of the arguments of a function call; consume the tokens from ``(`` to ``)``."""
        self.position += 1
        if self._now.text == ")":
            self.position += 1
            return []
        values = [self.choice()]
        while self._now.text == ",":
            self.position += 1
            values.append(self.choice())
        self._expect(")")
        return values


_BINARY: dict[str, tuple[int, Callable[[float, float], float | bool]]] = {
    "||": (1, lambda a, b: bool(a or b)),
    "&&": (2, lambda a, b: bool(a and b)),
    "==": (3, operator.eq),
    "!=": (3, operator.ne),
    "<>": (3, operator.ne),
    "<": (3, operator.lt),
    ">": (3, operator.gt),
    "<=": (3, operator.le),
    ">=": (3, operator.ge),
    "+": (4, operator.add),
    "-": (4, operator.sub),
    "*": (_PRODUCT, operator.mul),
    "/": (_PRODUCT, operator.truediv),
    "%": (_PRODUCT, math.fmod),
    "% of the quotient": (_PRODUCT, lambda a, b: a - b * math.trunc(a / b)),
    "\\": (_PRODUCT, lambda a, b: math.trunc(a / b)),
    "\\ of the magnitude": (_PRODUCT, lambda a, b: math.trunc(abs(a / b))),
}
"""Precedence (1 weakest, 5 tightest) and function by operator; ``% of the quotient`` stands for ngspice's ``%``."""


def _no_function(token: ExpressionToken, rules: ReadingRules) -> ExpressionError:
    """Return the error for a call of an unknown or unsupported function; `token`: the name of the function."""
    statistical = "is statistical, or depends on the solution, and is not evaluated: write a number"
    why = statistical if token.text.lower() in _STATISTICS else "is unknown"
    return ExpressionError(token.offset, f"the function {token.text!r} {why} ({rules.name})")


def _built_in(token: ExpressionToken, values: list[float], rules: ReadingRules) -> float:
    """Return the value of a built-in function of the dialect.

    `token`: name of the function; `values`: values of the arguments.
    """
    own = rules.functions.get(token.text.lower())
    if own is None:
        raise _no_function(token, rules)
    count, function = FUNCTIONS[own]
    if own in ("min", "max") and len(values) == 3 and rules.words.ends_of_three:
        ends = [values[0], values[2]]
        if function(*ends) != function(*values):
            text = f"{rules.name} compares the first and the last argument of {token.text} only: nest two calls"
            raise ExpressionError(token.offset, text)
        values = ends
    if len(values) != count:
        raise ExpressionError(token.offset, f"{token.text} takes {count} argument(s), not {len(values)}")
    try:
        return float(function(*values))
    except (ValueError, OverflowError, ZeroDivisionError):
        shown = ", ".join(f"{value:g}" for value in values)
        raise ExpressionError(token.offset, f"{token.text}({shown}) has no value") from None
