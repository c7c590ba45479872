"""Checks for names that the dialect's simulator reads differently from resgrid.

Such names have two meanings (parameter, model, key, number), stand next to a comma, or contain a blank in quotes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from resgrid.errors import InputError
from resgrid.spice.dialects import DIALECTS
from resgrid.spice.read.cards import Card, Setting, Token
from resgrid.spice.read.diagnostics import Diagnostics
from resgrid.spice.read.scopes import Block, Scope


def refuse_hidden_model(card: Card, token: Token, block: Block) -> None:
    """Raise CardError if the dialect's simulator takes the name of a model for a parameter or a number.

    `card`: card of a resistor; `token`: token of the card with the name of the model; `block`: the deck or subcircuit
    that contains the card.
    """
    if not card.rules.parameters_first:
        return
    if _is_parameter(token.text, block):
        text = f"{token.text} for the parameter of this name, and not for the model: rename one of them"
    elif is_literal(token):
        text = f"{token.text} for a number, and not for the name of a model: rename the model"
    else:
        return
    raise card.error(token.offset, f"{card.rules.name} takes {text}")


def refuse_model_as_key(card: Card, pair: Setting, block: Block) -> None:
    """Raise CardError if the dialect's simulator takes the first key after a value for the name of a model.

    `card`: card of an element without a model; `pair`: first ``key=value`` pair of the card; `block`: the deck or
    subcircuit that contains the card.
    """
    if card.rules.parameters_first and block.model(pair.key) is not None:
        text = f"{card.rules.name} takes {pair.key} for the model of this name, and not for a key: rename the model"
        raise card.error(pair.offset, text)


def note_hidden_word(card: Card, token: Token, scope: Scope) -> None:
    """Add a warning if the word ``DC`` or ``AC`` of a source is also the name of a parameter.

    The dialect's simulator then stops.  `card`: card of the source; `token`: a token of the card, of which only these
    two words are checked; `scope`: parameter values at the card, and receiver of the warning.
    """
    is_checked = card.rules.parameters_first and token.text.lower() in ("dc", "ac")
    if is_checked and _is_parameter(token.text, scope.block):
        text = f"{card.rules.name} takes {token.text} for the parameter of this name, and stops: rename the parameter"
        scope.diagnostics.refuse(card.spot(token.offset), text)


def check_called_name(card: Card, name: Token, block: Block, diagnostics: Diagnostics) -> None:
    """Check the name of the called subcircuit on an ``X`` card: no parameter has this name, and no comma is next to it.

    A parameter of this name stops the dialect's simulator, and is reported as a warning.  At a comma next to the name
    the simulator stops, or ignores the parameters after the comma: raises CardError.  `name`: token of the name;
    `block`: the deck or subcircuit that contains the card; `diagnostics`: receives the warning.
    """
    if not card.rules.parameters_first:
        return
    if _is_parameter(name.text, block):
        text = f"{card.rules.name} takes {name.text} for the parameter of this name, and finds no subcircuit"
        diagnostics.refuse(card.spot(name.offset), text)
    after = card.text[name.offset + len(name.text) :].lstrip(" \t\"'")
    if card.text[name.offset - 1] == "," or after.startswith(","):
        text = f"{card.rules.name} misreads a comma next to the name of a subcircuit: write a blank instead"
        raise card.error(name.offset, text)


def refuse_overridden(card: Card, scope: Scope, options: Mapping[str, str]) -> None:
    """Raise CardError if HSPICE takes the value of a subcircuit's parameter from the circuit with the instance.

    If a parameter of the same name exists there (the higher level), HSPICE uses that one, also against a value that the
    instance passes, unless the deck has ``.option parhier=local`` (Star-Hspice Manual 2001.2, Table 7-1).  Equal values
    are not an error.  `card`: card of the instance; `scope`: parameter values inside the instance; `options`: values of
    the deck's options, by name.
    """
    if not card.rules.outer_parameters_win or scope.outer is None or options.get("parhier", "").lower() == "local":
        return
    for name in scope.block.parameters:
        if not scope.outer.defines(name):
            continue
        try:
            inner, outer = scope.parameter(name), scope.outer.parameter(name)
        except InputError:
            continue  # reported where the parameter is used
        if inner != outer:
            label = DIALECTS[card.rules.name].label
            raise card.error(
                None,
                f"{label} takes the {name} of the higher level ({outer:g}) for the {name} of {scope.block.name} "
                f"({inner:g}): rename one of them, or write .option parhier=local",
            )


def _is_parameter(name: str, block: Block | None) -> bool:
    """Return whether `block` (the deck or a subcircuit) or a block around it defines the parameter `name`.

    The result is False if `block` is None.
    """
    return block is not None and (name.lower() in block.parameters or _is_parameter(name, block.outer))


def note_blank(card: Card, name: str, offset: int, diagnostics: Diagnostics) -> None:
    """Add a warning that the dialect's simulator cuts, or may cut, a quoted name at its blank.

    `name`: the name with quotes; `offset`: position of the name in the text of `card`; `diagnostics`: receives the
    warning.
    """
    rules = card.rules
    if rules.refusals.blank_names == "fails":
        diagnostics.refuse(card.spot(offset), f"{rules.name} cuts the quoted name {name} at its blank, and stops")
    else:
        text = f"it is not known here whether {rules.name} reads the blank in the quoted name {name}"
        diagnostics.warn_ignored(card.spot(offset), text)


def is_literal(token: Token) -> bool:
    """Return whether a token is a word that begins with a digit, perhaps after a sign."""
    return token.kind == "word" and re.match(r"[+-]?\d", token.text) is not None
