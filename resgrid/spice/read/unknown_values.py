"""Error messages for words of a deck that should be values, but are neither numbers nor defined names."""

from __future__ import annotations

import re

from resgrid.spice.dialects import DIALECTS
from resgrid.spice.dialects.record import ReadingRules
from resgrid.spice.read.expression_tokens import ExpressionError, tokens_of

_OHMS_POINT = re.compile(r"([+-]?\d++)R(\d++)", re.IGNORECASE)
_OPERATORS = frozenset("+-*/%^\\&|<>=!?:()")
_ENDS = frozenset({"number", "name"})


def unknown_value(text: str, rules: ReadingRules) -> str:
    """Return the message for a word `text` that has no value, with a remedy; `rules`: reading rules of the dialect."""
    return f"{text!r} is neither a number nor a known parameter or model; {_remedy(text, rules)}"


def unknown_parameter(name: str, rules: ReadingRules) -> str:
    """Return the message for an undefined parameter of an expression, with a remedy.

    The message names the dialects in which `name` is a constant.  `rules`: reading rules of the deck's dialect.
    """
    text = f"there is no parameter {name!r}; define it with {'parameters' if rules.instances else '.param'}"
    others = [
        dialect for dialect, item in DIALECTS.items()
        if name.lower() in item.reading.words.constants and not item.reading.instances
    ]  # fmt: skip
    if rules.instances or not others:
        return text
    known = ", ".join(others[:-1]) + " and " * (len(others) > 1) + others[-1]
    return (
        f"{text}, or read the deck in its own dialect (--read-as, in Python dialect=): it is a constant of {known}, "
        f"not of {rules.name}"
    )


def _remedy(text: str, rules: ReadingRules) -> str:
    """Return the remedy for a word that has no value: a number, an expression in braces, or a definition."""
    point = _OHMS_POINT.fullmatch(text)
    if point is not None:
        return f"write the decimal point: {point[1]}.{point[2]}"
    if _OPERATORS & set(text[1:] if text[:1] in "+-" else text):
        example = text if _is_whole(text) else "..."
        whole = "the expression" if example == text else "the whole expression"
        return f"write {whole} in {in_braces(example, rules)}"
    if not text[:1].isalpha() and text[:1] != "_":
        return "write a number, such as 4.7k"
    return "define it with parameters" if rules.instances else "define it with .param or .model"


def in_braces(text: str, rules: ReadingRules) -> str:
    """Return the words "braces: {text}", or "quotes: 'text'" for a dialect that writes expressions in quotes."""
    return f"quotes: '{text}'" if rules.quoted_expressions else f"braces: {{{text}}}"


def _is_whole(text: str) -> bool:
    """Return whether a text begins and ends like a whole expression, and not within an operation or a call."""
    try:
        tokens = tokens_of(text)[:-1]
    except ExpressionError:
        return False
    balanced = text.count("(") == text.count(")")
    return (
        bool(tokens)
        and balanced
        and (tokens[-1].kind in _ENDS or tokens[-1].text == ")")
        and (tokens[0].kind in _ENDS or tokens[0].text in ("(", "+", "-", "!"))
    )
