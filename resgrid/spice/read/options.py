"""Options and temperatures that a deck asks for, and which of several requests counts."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from resgrid.spice.read.cards import Card, Token, tokenise
from resgrid.spice.read.diagnostics import Journal
from resgrid.spice.read.rules import ReadingRules
from resgrid.spice.read.scopes import Scope

_PLAIN_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


@dataclass(eq=False)
class Options:
    """What ``.option`` and ``.temp`` lines say.

    `values`: options by name in lower case; a flag has the value ``""``.
    """

    rules: ReadingRules
    journal: Journal
    values: dict[str, str] = field(default_factory=dict)
    _temperatures: dict[str, tuple[Card, Token]] = field(default_factory=dict)

    def read(self, card: Card) -> None:
        """Take an ``.option`` line in."""
        tokens = tokenise(card)[1:]
        seen: set[str] = set()
        i = 0
        while i < len(tokens):
            key = tokens[i].text.lower()
            keyed = i + 2 < len(tokens) and tokens[i + 1].kind == "mark" and tokens[i + 1].text == "="
            if key not in seen or not self.rules.first_counts:
                self._take(key, card, tokens[i], tokens[i + 2] if keyed else None)
            seen.add(key)
            i += 3 if keyed else 1
        self.journal.note("info", card.spot(), "options are noted, not obeyed, but for temp and tnom")

    def _take(self, key: str, card: Card, token: Token, value: Token | None) -> None:
        if key in self.rules.refused_options:
            raise card.error(token.offset, f".option {key} adds elements, which is not done here: write them out")
        if key in self.rules.shunt_options:
            self.journal.note(
                "warning", card.spot(token.offset), f".option {key} ties every node to ground, which is not done here"
            )
        self.values[key] = "" if value is None else value.text
        if key in ("temp", "tnom") and value is not None:
            self._set_temperature(key, card, value)

    def read_temperature(self, card: Card) -> None:
        """Take a ``.temp`` line in."""
        tokens = tokenise(card)[1:]
        if not tokens:
            raise card.error(0, ".temp needs a temperature")
        if len(tokens) > 1:
            if self.rules.braced_temperatures:
                raise card.error(
                    tokens[1].offset, f"{self.rules.name} ignores a .temp of several temperatures: name one"
                )
            self.journal.note("warning", card.spot(), ".temp asks for several runs; the first temperature counts")
        self._set_temperature(".temp" if self.rules.temp_command_first else "temp", card, tokens[0])

    def _set_temperature(self, key: str, card: Card, token: Token) -> None:
        if token.kind == "word" and self.rules.braced_temperatures and _PLAIN_NUMBER.fullmatch(token.text) is None:
            raise card.error(
                token.offset, f"{self.rules.name} ignores a temperature that is no plain number: use braces"
            )
        self._temperatures[key] = (card, token)

    def temperature(self, key: str, scope: Scope) -> float | None:
        """The deck's temperature (``temp``) or nominal temperature (``tnom``), in degrees Celsius, if it says one."""
        found = self._temperatures.get(f".{key}") or self._temperatures.get(key)
        return None if found is None else scope.value(*found)[0]
