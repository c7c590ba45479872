"""Tokens of arithmetic expressions in decks: numbers, names and operators."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import NamedTuple

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][+-]?\d+|[dD][+-]?\d+)?(?:[^\W\d_]\w*)?)"
    r"|(?P<name>[A-Za-z_][\w.$#@]*)"
    r"|(?P<operator>\*\*|==|!=|<>|<=|>=|&&|\|\||[-+*/%\\^!<>?:(),])|(?P<end>$))"
)


class ExpressionError(ValueError):
    """An error in an expression; `offset`: zero-based position of the error in the text, in characters."""

    def __init__(self, offset: int, text: str) -> None:
        super().__init__(text)
        self.offset = offset


class ExpressionToken(NamedTuple):
    """A token of an expression.

    `kind`: "number", "name", "operator" or "end"; `text`: characters of the token; `offset`: position in the
    expression.
    """

    kind: str
    text: str
    offset: int

    @property
    def shown(self) -> str:
        """The text of this token as error messages display it: quoted, or ``the end``."""
        return repr(self.text) if self.kind != "end" else "the end"


@lru_cache(maxsize=4096)
def tokens_of(text: str) -> tuple[ExpressionToken, ...]:
    """Return the tokens of the expression `text`; the last token has the kind "end"."""
    tokens: list[ExpressionToken] = []
    position = 0
    while not tokens or tokens[-1].kind != "end":
        match = _TOKEN.match(text, position)
        if match is None:
            position += len(text[position:]) - len(text[position:].lstrip())
            raise ExpressionError(position, f"unexpected {text[position]!r} in an expression")
        kind = match.lastgroup or "end"
        tokens.append(ExpressionToken(kind, match.group(kind), match.start(kind)))
        position = match.end()
    return tuple(tokens)
