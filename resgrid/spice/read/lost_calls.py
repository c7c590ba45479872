"""Calls of a deck's functions that its simulator does not recognise, because of the operator before the call."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise

from resgrid.spice.read.cards import Card, Token
from resgrid.spice.read.diagnostics import Diagnostics
from resgrid.spice.read.expression_tokens import tokens_of


def check_calls(card: Card, token: Token, is_defined: Callable[[str], bool], diagnostics: Diagnostics) -> None:
    """Add a warning for each call of a deck's function that the simulator does not recognise, and stops at.

    `card`, `token`: the line and the expression in it; `is_defined`: whether the deck defines a function, by name in
    lower case; `diagnostics`: receives the warnings.  Raises CardError if the simulator has a function of this name
    itself, and would call this function.
    """
    operators = card.rules.refusals.before_calls
    if not operators or "(" not in token.text:
        return
    for operator, name, offset in _calls_after(token.text, operators):
        if not is_defined(name.lower()):
            continue
        spot, remedy = token.offset + offset, f"write ({name}(...))"
        if name.lower() in card.rules.words.functions:
            text = f"{card.rules.name} calls its own function {name} directly after {operator!r}, not that of the deck"
            raise card.error(spot, f"{text}: {remedy}")
        text = f"{card.rules.name} does not recognise the call of {name} directly after {operator!r}, and stops"
        diagnostics.refuse(card.spot(spot), f"{text}: {remedy}")


@lru_cache(maxsize=4096)
def _calls_after(text: str, operators: frozenset[str]) -> tuple[tuple[str, str, int], ...]:
    """Return operator, function name and position of the name for each function call directly after an operator.

    `text`: the expression; `operators`: the operators to consider; blanks between operator and name do not matter.
    """
    tokens = tokens_of(text)
    return tuple(
        (before.text, name.text, name.offset)
        for (before, name), after in zip(pairwise(tokens), tokens[2:], strict=False)
        if name.kind == "name" and after.text == "(" and before.text in operators
    )
