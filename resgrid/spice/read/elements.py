"""From a card to an element: what the letters R, V, I, C, L and S mean, and why the others are refused."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

from resgrid.spice.read.cards import Card, Setting, Token, settings, split_positional, tokenise
from resgrid.spice.read.diagnostics import Journal
from resgrid.spice.read.expressions import Lookup
from resgrid.spice.read.models import RESISTOR_KINDS, SWITCH_KINDS, modelled_resistor, modelled_switch
from resgrid.spice.read.scopes import Model, Scope
from resgrid.spice.read.tables import Sheet
from resgrid.spice.read.waveforms import source_value

REFUSED = {
    "d": "a diode",
    "q": "a bipolar transistor",
    "m": "a MOS transistor",
    "j": "a junction field-effect transistor",
    "z": "a field-effect transistor (MESFET)",
    "e": "a controlled voltage source",
    "f": "a controlled current source",
    "g": "a controlled current source",
    "h": "a controlled voltage source",
    "b": "a behavioural source",
    "w": "a switch controlled by a current",
    "t": "a transmission line",
    "o": "a lossy transmission line",
    "u": "a distributed line or digital device",
    "p": "a coupled line or port",
    "y": "a device of its simulator's own",
    "n": "a device of its simulator's own",
    "a": "a code model",
}
"""Elements that are not linear resistive ones, by their letter."""

_SEVERAL = frozenset({"tc"})
_FREE_KEYS = frozenset({"ac", "noisy", "noise", "ic", "temp_ac"})
_RESISTOR_KEYS = frozenset({"r", "resistance", "tc", "tc1", "tc2", "m", "scale", "temp", "dtemp", "l", "w"})
_INDUCTOR_KEYS = frozenset({"l", "tc", "tc1", "tc2", "m", "scale", "temp", "dtemp", "nt", "rser", "ipk"})
_CAPACITOR_KEYS = frozenset({"c", "tc", "tc1", "tc2", "m", "scale", "temp", "dtemp", "l", "w", "rser", "v", "irms"})


def read_element(card: Card, scope: Scope, sheet: Sheet, journal: Journal) -> None:
    """Read one element into the sheet of its block."""
    letter = card.text[0].lower()
    reader = _READERS.get(letter)
    if reader is not None:
        reader(card, tokenise(card), scope, sheet, journal)
    elif letter == "k":
        journal.note("info", card.spot(), "coupled inductors (K) do nothing at direct current")
    elif letter in REFUSED:
        name = card.text.split()[0]
        raise card.error(0, f"{name[:60]} is {REFUSED[letter]}; only R, V, I, C, L, S and X can be read")
    else:
        raise card.error(0, f"{card.text.split()[0][:60]!r} is no element and no command that is known")


def read_nodes(card: Card, tokens: list[Token], count: int) -> tuple[list[str], list[Token]]:
    """Take the names of the terminals, which may stand in parentheses, and return what follows them."""
    names: list[str] = []
    i = 1
    while len(names) < count and i < len(tokens):
        token = tokens[i]
        if token.kind == "word":
            names.append(token.text)
        elif token.kind != "mark" or token.text == "=":
            raise card.error(token.offset, f"{token.text!r} was not expected here; a node was")
        i += 1
    if len(names) < count:
        raise card.error(None, f"{tokens[0].text} has {len(names)} node(s); it needs {count}")
    if i < len(tokens) and tokens[i].kind == "mark" and tokens[i].text == ")":
        i += 1
    return names, tokens[i:]


def number(scope: Scope, card: Card, token: Token, journal: Journal, lookup: Lookup | None = None) -> float:
    """Value of a token; its names are looked up in the scope, or by ``lookup``, and its warning goes to the journal."""
    value, warning = scope.value(card, token, lookup)
    if warning:
        journal.note("warning", card.spot(token.offset), warning)
    return value


def _keyed(
    card: Card, pairs: list[Setting], known: frozenset[str], scope: Scope, journal: Journal
) -> dict[str, list[float]]:
    values: dict[str, list[float]] = {}
    for setting in pairs:
        if setting.key in scope.rules.annotations:
            journal.note("info", card.spot(setting.offset), f"{setting.key}= changes nothing at direct current")
            continue
        if setting.key in _FREE_KEYS:
            continue
        if setting.key not in known:
            raise card.error(
                setting.offset, f"{setting.key!r} is not understood here; known are {', '.join(sorted(known))}"
            )
        if setting.key in values:
            raise card.error(setting.offset, f"{setting.key!r} is given twice")
        values[setting.key] = [number(scope, card, token, journal) for token in setting.values]
    return values


def multiplier(card: Card, value: float) -> float:
    """Check ``m=``: how many elements lie in parallel."""
    if value <= 0:
        raise card.error(None, f"m = {value:g} must be positive: it is a number of elements in parallel")
    return value


def _read_resistor(card: Card, tokens: list[Token], scope: Scope, sheet: Sheet, journal: Journal) -> None:
    nodes, rest = read_nodes(card, tokens, 2)
    positional, tail = split_positional(rest)
    pairs = settings(card, tail, _SEVERAL)
    if scope.rules.spaced_lists:
        _refuse_unspaced(card, pairs, scope.rules.name)
    keyed = _keyed(card, pairs, _RESISTOR_KEYS, scope, journal)
    model, stated = _model_and_values(card, positional, scope, journal, RESISTOR_KINDS)
    stated += [keyed[key][0] for key in ("r", "resistance") if key in keyed]
    if len(stated) > 1:
        raise card.error(positional[-1].offset if positional else None, "more than one resistance is given")
    ohms = stated[0] if stated else None
    first, second, nominal = 0.0, 0.0, math.nan
    if model is not None:
        length, width = (keyed[key][0] if key in keyed else None for key in ("l", "w"))
        modelled = modelled_resistor(model, scope, ohms, length, width, card)
        ohms, first, second, nominal = modelled.ohms, modelled.tc1, modelled.tc2, modelled.nominal
    elif ohms is None:
        raise card.error(None, f"{tokens[0].text} has no value: give it ohms, r=, or a model")
    elif "l" in keyed or "w" in keyed:
        raise card.error(None, "l and w mean something together with a model only")
    first, second = _coefficients(card, keyed, first, second)
    if "scale" in keyed and scope.rules.name != "ngspice":
        raise card.error(None, f"scale= is understood for ngspice, not for {scope.rules.name}; put it into the value")
    ohms *= keyed.get("scale", [1.0])[0] / multiplier(card, keyed.get("m", [1.0])[0])
    if not math.isfinite(ohms):
        raise card.error(None, f"{tokens[0].text} has {ohms} ohm")
    own = (keyed.get("dtemp", [0.0])[0], keyed.get("temp", [math.nan])[0], nominal)
    sheet.add("resistor", tokens[0].text, nodes, (ohms, first, second, *own), _at(card))


def _refuse_unspaced(card: Card, pairs: list[Setting], dialect: str) -> None:
    """Refuse lists in parentheses, without a blank between their values, or going on with a point."""
    for first, second in (setting.values[:2] for setting in pairs if len(setting.values) > 1):
        gap = card.text[first.offset + len(first.text) : second.offset].strip("{}'")
        bracketed = card.text[: first.offset].rstrip(" {'").endswith("(")
        parted = gap.isspace() or (first.kind == "word" and gap[0] == "," and gap[1:].isspace())
        if bracketed or second.text[0] == "." or not parted:
            raise card.error(first.offset, f"{dialect} reads this list otherwise, or not at all: write tc1=... tc2=...")


def _coefficients(card: Card, keyed: dict[str, list[float]], first: float, second: float) -> tuple[float, float]:
    several = keyed.get("tc", [])
    if len(several) > 2:
        raise card.error(None, f"tc= takes one or two values, not {len(several)}")
    if several:
        first, second = several[0], several[1] if len(several) > 1 else second
    return keyed.get("tc1", [first])[0], keyed.get("tc2", [second])[0]


def _model_and_values(
    card: Card, positional: list[Token], scope: Scope, journal: Journal, kinds: frozenset[str]
) -> tuple[Model | None, list[float]]:
    """What stands without a key: the name of a model, values."""
    model: Model | None = None
    values: list[float] = []
    for token in positional:
        found = scope.block.model(token.text.lower()) if token.kind == "word" else None
        if found is None:
            values.append(number(scope, card, token, journal))
        elif found.kind not in kinds:
            raise card.error(
                token.offset, f"the model {token.text} is one of kind {found.kind!r}, not {sorted(kinds)[0]!r}"
            )
        elif model is not None:
            raise card.error(token.offset, "two models are given")
        elif values and scope.rules.models_first and not _is_literal(positional[0]):
            raise card.error(
                token.offset,
                f"{scope.rules.name} overlooks the model {token.text} after a value like this: write it first",
            )
        else:
            model = found
    return model, values


def _is_literal(token: Token) -> bool:
    return token.kind == "word" and re.match(r"[+-]?\d", token.text) is not None


def _read_source(card: Card, tokens: list[Token], scope: Scope, sheet: Sheet, journal: Journal) -> None:
    nodes, rest = read_nodes(card, tokens, 2)
    current = card.text[0] in "iI"
    value, count = source_value(card, rest, scope, journal)
    if current:
        value *= multiplier(card, count)
    elif count != 1:
        multiplier(card, count)
        journal.note("info", card.spot(), "m= changes nothing in a voltage source")
    sheet.add("current source" if current else "voltage source", tokens[0].text, nodes, (value,), _at(card))


def _read_capacitor(card: Card, tokens: list[Token], scope: Scope, sheet: Sheet, journal: Journal) -> None:
    nodes, rest = read_nodes(card, tokens, 2)
    positional, tail = split_positional(rest)
    pairs = settings(card, tail, _SEVERAL)
    keyed = _keyed(card, pairs, _CAPACITOR_KEYS, scope, journal)
    model, stated = _model_and_values(card, positional, scope, journal, frozenset({"c", "cap"}))
    stated += keyed.get("c", [])
    if len(stated) > 1:
        raise card.error(None, "more than one capacitance is given")
    if not stated and model is None:
        raise card.error(None, f"{tokens[0].text} has no value")
    if not stated:
        journal.note("info", card.spot(), "the capacitance of a model is not computed: it is open at direct current")
    farads = stated[0] * multiplier(card, keyed.get("m", [1.0])[0]) if stated else 0.0
    if not 0 <= farads < math.inf:
        raise card.error(None, f"{tokens[0].text} has {farads:g} F; a capacitance must not be negative")
    sheet.add("capacitor", tokens[0].text, nodes, (farads,), _at(card))


def _read_inductor(card: Card, tokens: list[Token], scope: Scope, sheet: Sheet, journal: Journal) -> None:
    nodes, rest = read_nodes(card, tokens, 2)
    positional, tail = split_positional(rest)
    keyed = _keyed(card, settings(card, tail, _SEVERAL), _INDUCTOR_KEYS, scope, journal)
    model, stated = _model_and_values(card, positional, scope, journal, frozenset({"l", "ind"}))
    if not stated and model is None and "l" not in keyed:
        raise card.error(None, f"{tokens[0].text} has no value")
    series = keyed.get("rser", [0.0])[0]
    if series:
        journal.note("info", card.spot(), "an inductor with rser is a resistor at direct current")
        sheet.add("resistor", tokens[0].text, nodes, (series, 0.0, 0.0, 0.0, math.nan, math.nan), _at(card))
        return
    if scope.rules.name == "ltspice":
        journal.note(
            "warning", card.spot(), "LTspice gives an inductor 1 milliohm unless rser=0 is said; it is a short here"
        )
    journal.note("info", card.spot(), "an inductor is a short at direct current: a source of 0 V bears its name")
    sheet.add("voltage source", tokens[0].text, nodes, (0.0,), _at(card))


def _read_switch(card: Card, tokens: list[Token], scope: Scope, sheet: Sheet, _: Journal) -> None:
    if scope.rules.name == "hspice":
        raise card.error(0, f"{tokens[0].text} is an S element, which HSPICE takes for scattering parameters")
    nodes, rest = read_nodes(card, tokens, 4)
    words = [token for token in rest if token.kind == "word"]
    if not words or len(words) != len(rest) or len(words) > 2:
        raise card.error(None, f"{tokens[0].text} needs the name of its model, and may have ON or OFF after it")
    model = scope.block.model(words[0].text.lower())
    if model is None or model.kind not in SWITCH_KINDS:
        raise card.error(words[0].offset, f"there is no model {words[0].text!r} of a switch (sw)")
    state = 0.0
    if len(words) == 2:
        if words[1].text.lower() not in ("on", "off"):
            raise card.error(words[1].offset, f"{words[1].text!r} was not expected here; ON or OFF was")
        state = float(words[1].text.lower() == "on")
    sheet.add("switch", tokens[0].text, nodes, modelled_switch(model, scope, state, card), _at(card))


def _at(card: Card) -> tuple[int, int]:
    return card.file, card.line


_READERS: dict[str, Callable[[Card, list[Token], Scope, Sheet, Journal], None]] = {
    "r": _read_resistor,
    "v": _read_source,
    "i": _read_source,
    "c": _read_capacitor,
    "l": _read_inductor,
    "s": _read_switch,
}
