"""Reader of nonlinear resistors ``I = I0 tanh(V / V0)``, which are behavioural sources in decks."""

from __future__ import annotations

import re
import string
from functools import lru_cache

from resgrid.spice.dialects import DIALECTS
from resgrid.spice.read.cards import Card, Token
from resgrid.spice.read.element_tables import Elements
from resgrid.spice.read.scopes import Scope

_MEMRISTOR = re.compile(r"v\([^()]*\)/max\([-+.e\d]+-[-+.e\d]+\*v\(x[^()]*\),", re.IGNORECASE)
"""Regular expression of the current through a memristor: voltage divided by a resistance that depends on a state."""


def read_nonlinear(card: Card, scope: Scope, elements: Elements) -> bool:
    """Add a nonlinear resistor ``I = current tanh(V / voltage)`` to `elements`; return whether the card describes one.

    I flows from the first node to the second, and V is the voltage between them; the card states `current` in amperes
    and `voltage` in volts.  Only the form that resgrid writes is recognized.  `scope`: parameter values.  Raises
    InputError for a memristor, and for values that are not positive.
    """
    match = _nonlinear_form(card.rules.name).fullmatch(card.text.strip())
    if match is None:
        _refuse_memristor(card)
        return False
    shift = len(card.text) - len(card.text.lstrip())
    tokens = (Token("word", match[key], match.start(key) + shift) for key in ("current", "voltage"))
    amps, volts = (scope.number(card, token) for token in tokens)
    if amps <= 0 or volts <= 0:
        raise card.error(None, f"{match['name']} carries {amps:g} A at {volts:g} V; both must be positive")
    elements.add("nonlinear resistor", match["name"], (match["a"], match["b"]), (amps, volts), card)
    return True


def _refuse_memristor(card: Card) -> None:
    """Raise InputError if a card is a behavioural source of a memristor, in the form that resgrid writes."""
    if _MEMRISTOR.search(card.text):
        raise card.error(
            None,
            f"{card.text.split()[0]} belongs to a memristor, whose resistance depends on its history; resgrid checks "
            "the transient of such a deck by its sidecar (check_deck), but cannot read it as a circuit of resistors",
        )


@lru_cache(maxsize=64)
def _nonlinear_form(dialect: str) -> re.Pattern[str]:
    """Return the regular expression of a nonlinear resistor's card in a dialect, which ignores case and extra blanks.

    The groups are ``name``, ``a``, ``b`` (nodes), ``current`` and ``voltage``.  `dialect`: name of the dialect.
    """
    groups = {"name": r"b\S*", "a": r"[^\s,()]+", "b": r"[^\s,()]+"}
    pattern, seen = "", set()
    for literal, key, *_ in string.Formatter().parse(DIALECTS[dialect].nonlinear_resistor):
        pattern += re.escape(literal).replace(r"\ ", r"\s+")
        if key is not None:
            pattern += f"(?P={key})" if key in seen else f"(?P<{key}>{groups.get(key, r'[^*/()]+')})"
            seen.add(key)
    return re.compile(pattern, re.IGNORECASE)
