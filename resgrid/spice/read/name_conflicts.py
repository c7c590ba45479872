"""Checks for names with two meanings, of which the dialect's simulator chooses another one than resgrid."""

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

    `card`: card of a resistor; `token`: its token with the name of the model; `block`: the block of the card.
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

    `card`: card of an element without a model; `pair`: its first ``key=value`` pair; `block`: the block of the card.
    """
    if card.rules.parameters_first and block.model(pair.key) is not None:
        text = f"{card.rules.name} takes {pair.key} for the model of this name, and not for a key: rename the model"
        raise card.error(pair.offset, text)


def note_hidden_word(card: Card, token: Token, scope: Scope) -> None:
    """Add a warning if ``DC`` or ``AC`` of a source is also a parameter's name, at which the dialect's simulator stops.

    `card`: card of the source; `token`: a word of the source, of which only these two are checked; `scope`: scope of
    the card.
    """
    is_checked = card.rules.parameters_first and token.text.lower() in ("dc", "ac")
    if is_checked and _is_parameter(token.text, scope.block):
        text = f"{card.rules.name} takes {token.text} for the parameter of this name, and stops: rename the parameter"
        scope.diagnostics.refuse(card.spot(token.offset), text)


def check_called_name(card: Card, name: Token, block: Block, diagnostics: Diagnostics) -> None:
    """Check the name of the subcircuit on an ``X`` card for a parameter of its name and for commas at the name.

    A parameter of this name stops the dialect's simulator, and is reported as a warning.  At a comma next to the name
    the simulator stops, or ignores the parameters after the comma: raises CardError.  `name`: token of the name;
    `block`: the block of the card; `diagnostics`: receives the warning.
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
    """Raise CardError if a parameter of a subcircuit has another value in the circuit that contains the instance.

    HSPICE then uses the value of the higher level, also against a value that the instance passes, unless the deck has
    ``.option parhier=local`` (Star-Hspice Manual 2001.2, Table 7-1).  `card`: card of the instance;
    `scope`: scope of the instance; `options`: values of the deck's options, by name.
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
    """Return whether `block` or an enclosing block defines a parameter `name`; None stands for no block."""
    return block is not None and (name.lower() in block.parameters or _is_parameter(name, block.outer))


def note_blank(card: Card, name: str, offset: int, diagnostics: Diagnostics) -> None:
    """Warn of a quoted name that a simulator may cut at a blank.

    `name`: with quotes; `offset`: its place in the text of `card`; `diagnostics`: receives the warning.
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
