"""From a card to an element: what the letters R, V, I, C, L and S mean, and why the others are refused."""

from __future__ import annotations

import math
import re
import string
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial

from resgrid.spice.circuit import rebase_one
from resgrid.spice.dialects import DIALECTS
from resgrid.spice.read import spectre
from resgrid.spice.read.cards import (
    Card,
    Setting,
    Token,
    joined_names,
    settings,
    split_positional,
    tokenise,
    without_parentheses,
)
from resgrid.spice.read.element_tables import Elements
from resgrid.spice.read.models import RESISTOR_KINDS, SWITCH_KINDS, modelled_resistor, modelled_switch
from resgrid.spice.read.scopes import Block, Model, Scope
from resgrid.spice.read.temperature import refuse_cold, refuse_dropped, refuse_temperature
from resgrid.spice.read.waveforms import SourceValue, source_value

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
_WARM_KEYS = frozenset({"r", "resistance", "c", "l"})
"""Keys of a value, which may depend on the simulation temperature in every dialect."""

_FREE_KEYS = frozenset({"ac", "noisy", "noise", "ic", "temp_ac", "isnoisy"})
_VALUE_KEYS = frozenset({"tc", "tc1", "tc2", "m", "scale", "temp", "dtemp"})
_SPECTRE_KEYS = {"trise": "dtemp"}


@dataclass(frozen=True, eq=False)
class Element:
    """An element's card, cut.

    `positional`: what stands without a key behind the nodes; `pairs`: what has one; `keys`: the values of those.
    """

    card: Card
    name: str
    nodes: list[str]
    positional: list[Token]
    pairs: list[Setting]
    keys: dict[str, list[float]]

    def value(self, key: str, default: float) -> float:
        """First value of a key."""
        return self.keys[key][0] if key in self.keys else default


def letter_of(card: Card, block: Block) -> str:
    """Letter of an element, in lower case."""
    return spectre.letter_of(card, block) if card.rules.instances else card.text[0].lower()


def read_element(card: Card, letter: str, scope: Scope, elements: Elements) -> None:
    """Read one element into those of its block."""
    refused = card.rules.refused_elements.get(letter)
    if refused is not None:
        raise card.error(0, f"{card.text.split()[0]} is {refused}")
    reader = _READERS.get(letter)
    if reader is not None:
        reader(card, scope, elements)
    elif letter == "k":
        scope.diagnostics.inform(card.spot(), "coupled inductors (K) do nothing at direct current")
    elif not _read_nonlinear(card, scope, elements):
        name = card.text.split()[0][:60]
        if letter not in REFUSED:
            raise card.error(0, f"{name!r} is no element and no command that is known")
        kinds = "R, V, I, C, L, S and X"
        if card.rules.instances:
            kinds = f"{', '.join(master for master in spectre.PRIMITIVES if master != 'bsource')} and subcircuits"
        if letter in "bg":
            form = DIALECTS[card.rules.name].nonlinear_resistor
            kinds += f" and {form.format(name='B1', a='a', b='b', current='I0', voltage='V0')}"
        raise card.error(0, f"{name} is {REFUSED[letter]}; only {kinds} can be read")


def read_nodes(card: Card, tokens: list[Token], count: int) -> tuple[list[str], list[Token]]:
    """Take the names of the terminals, which may stand in parentheses or quotes, and return what follows them."""
    tokens = joined_names(card, tokens, count + 1)
    names: list[str] = []
    i = 1
    while len(names) < count and i < len(tokens):
        token = tokens[i]
        if token.kind in ("word", "string"):
            names.append(token.text)
        elif not token.is_mark("()"):
            raise card.error(token.offset, f"{token.text!r} was not expected here; a node was")
        i += 1
    if len(names) < count:
        raise card.error(None, f"{tokens[0].text} has {len(names)} node(s); it needs {count}")
    return names, tokens[i + (i < len(tokens) and tokens[i].is_mark(")")) :]


def multiplier(card: Card, value: float) -> float:
    """Check ``m=``: how many elements lie in parallel."""
    if value <= 0:
        raise card.error(None, f"m = {value:g} must be positive: it is a number of elements in parallel")
    return value


def _cut(card: Card, scope: Scope, known: str = "") -> Element:
    """Cut the card of an element of two nodes, whose keys are the usual ones and those that are known."""
    tokens = tokenise(card)
    if card.rules.instances:
        head, tail = split_positional(without_parentheses(tokens))
        if len(head) != 4:
            raise card.error(None, f"{tokens[0].text} has {len(head) - 2} node(s); it needs 2")
        nodes, positional = [token.text for token in head[1:3]], head[3:]
        if positional[0].text in spectre.PRIMITIVES:
            positional = []
        pairs = [Setting(_SPECTRE_KEYS.get(s.key, s.key), s.offset, s.values) for s in settings(card, tail)]
    else:
        nodes, rest = read_nodes(card, tokens, 2)
        positional, tail = split_positional(rest)
        pairs = settings(card, tail, _SEVERAL)
    tce = {"tce"} if card.rules.words.exponential_coefficient and "r" in known.split() else set()
    keys = _values_of(card, pairs, _VALUE_KEYS | set(known.split()) | tce, scope) if known else {}
    return Element(card, tokens[0].text, nodes, positional, pairs, keys)


def _note_key(card: Card, key: str, offset: int, scope: Scope) -> None:
    """Note a key at which the dialect's simulator stops."""
    text = f"{card.rules.name} knows no {key}= of {card.text[0].upper()}, and stops at it"
    scope.diagnostics.refuse(card.spot(offset), text)


def _values_of(
    card: Card, pairs: list[Setting], known: frozenset[str] | set[str], scope: Scope
) -> dict[str, list[float]]:
    values: dict[str, list[float]] = {}
    for pair in pairs:
        if pair.key in card.rules.refusals.keys.get(card.text[0].lower(), ()):
            _note_key(card, pair.key, pair.offset, scope)
        if pair.key in card.rules.annotations:
            scope.diagnostics.inform(card.spot(pair.offset), f"{pair.key}= changes nothing at direct current")
            continue
        if pair.key in _FREE_KEYS:
            continue
        if pair.key not in known:
            theirs = {ours: key for key, ours in _SPECTRE_KEYS.items()} if card.rules.instances else {}
            names = ", ".join(sorted(theirs.get(key, key) for key in known))
            label = DIALECTS[card.rules.name].label
            text = f"{pair.key!r} is not understood here (by the rules of {label}); known are {names}"
            raise card.error(pair.offset, text)
        if pair.key in values:
            raise card.error(pair.offset, f"{pair.key!r} is given twice")
        with scope.watched() as watch:
            values[pair.key] = [scope.number(card, token) for token in pair.values]
        if watch.used and pair.key not in _WARM_KEYS:
            refuse_temperature(card, pair.offset, f"{pair.key}=")
    return values


def _read_resistor(card: Card, scope: Scope, elements: Elements) -> None:
    with scope.watched() as watch:
        element = _cut(card, scope, "r resistance l w")
        model, ohms = _model_and_value(element, scope, RESISTOR_KINDS, "resistance", "r", "resistance")
    refuse_cold(card, watch, ohms)
    parts = {*element.keys, *(["model"] if model is not None else [])}
    refuse_dropped(card, watch, parts, element.nodes, elements.nominal)
    if card.rules.spaced_lists:
        _refuse_unspaced(card, element.pairs)
    first, second, nominal, exponential = 0.0, 0.0, math.nan, 0.0
    if model is not None:
        length, width = (element.keys[key][0] if key in element.keys else None for key in ("l", "w"))
        ohms, first, second, nominal, exponential = modelled_resistor(model, scope, ohms, length, width, card)
    elif ohms is None:
        raise card.error(None, f"{element.name} has no value: give it ohms, r=, or a model")
    elif "l" in element.keys or "w" in element.keys:
        raise card.error(None, "l and w mean something together with a model only")
    several = element.keys.get("tc", [])
    if len(several) > 2:
        raise card.error(None, f"tc= takes one or two values, not {len(several)}")
    first, second = several + [first, second][len(several) :]
    first, second = element.value("tc1", first), element.value("tc2", second)
    if "scale" in element.keys and not card.rules.scale_key:
        raise card.error(None, f"scale= is not understood for {card.rules.name}; put it into the value")
    ohms *= element.value("scale", 1.0) / multiplier(card, element.value("m", 1.0))
    if not math.isfinite(ohms):
        raise card.error(None, f"{element.name} has {ohms} ohm")
    own = element.value("temp", elements.nominal + element.value("dtemp", 0.0))
    shift = own - (elements.nominal if math.isnan(nominal) else nominal)
    exponential = element.value("tce", exponential)
    if exponential:
        if watch.used:
            raise card.error(
                None, f"{card.rules.name} drops tce= with an expression of the temperature: multiply there"
            )
        heating = 0.0 if "temp" in element.keys else elements.heating
        ohms *= 1.01 ** (exponential * (shift + heating))
        scope.diagnostics.warn(card.spot(), "tce= is evaluated at the temperature of the deck, and at no other")
        first = second = 0.0
    if shift and (first or second):
        ohms, first, second = rebase_one(ohms, first, second, shift)
    if "temp" in element.keys:
        first = second = 0.0
    elements.add("resistor", element.name, element.nodes, (ohms, first, second), card)


def _refuse_unspaced(card: Card, pairs: list[Setting]) -> None:
    """Refuse lists in parentheses, without a blank between their values, or going on with a point."""
    for first, second in (pair.values[:2] for pair in pairs if len(pair.values) > 1):
        gap = card.text[first.offset + len(first.text) : second.offset].strip("{}'")
        bracketed = card.text[: first.offset].rstrip(" {'").endswith("(")
        parted = gap.isspace() or (first.kind == "word" and gap[0] == "," and gap[1:].isspace())
        if bracketed or second.text[0] == "." or not parted:
            raise card.error(
                first.offset, f"{card.rules.name} reads this list otherwise, or not at all: write tc1=... tc2=..."
            )


def _model_and_value(
    element: Element, scope: Scope, kinds: frozenset[str], what: str, *keys: str
) -> tuple[Model | None, float | None]:
    """The model that an element names, and its value, without a key or behind one of these.

    `what`: what the value is; empty where it does not matter how many there are.
    """
    card, model, values = element.card, None, []
    for token in element.positional:
        if token.kind == "word" and token.text.lower() in card.rules.flags:
            continue
        named = scope.block.model(token.text.lower()) if token.kind == "word" else None
        if named is None:
            values.append(scope.number(card, token))
        elif named.kind not in kinds:
            raise card.error(
                token.offset, f"the model {token.text} is one of kind {named.kind!r}, not {sorted(kinds)[0]!r}"
            )
        elif model is not None:
            raise card.error(token.offset, "two models are given")
        elif values and card.rules.models_first and not _is_literal(element.positional[0]):
            raise card.error(
                token.offset,
                f"{card.rules.name} overlooks the model {token.text} after a value like this: write it first",
            )
        else:
            model = named
    values += [element.keys[key][0] for key in keys if key in element.keys]
    if len(values) > 1 and what:
        offset = element.positional[-1].offset if element.positional else None
        raise card.error(offset, f"more than one {what} is given")
    return model, values[0] if values else None


def _is_literal(token: Token) -> bool:
    return token.kind == "word" and re.match(r"[+-]?\d", token.text) is not None


def _read_source(kind: str, card: Card, scope: Scope, elements: Elements) -> None:
    tokens = tokenise(card)
    if card.rules.instances:
        element = _cut(card, scope)
        source = SourceValue(*spectre.source_value(card, element.pairs, scope))
        name, nodes = element.name, element.nodes
    else:
        name = tokens[0].text
        nodes, rest = read_nodes(card, tokens, 2)
        with scope.watched() as watch:
            source = source_value(card, rest, scope)
        if watch.used:
            refuse_temperature(card, None, f"{name}")
    value = source.volts_or_amps
    if kind == "current source":
        value *= multiplier(card, source.count)
    elif source.count != 1:
        multiplier(card, source.count)
        if "m" in card.rules.refusals.keys.get("v", ()):
            _note_key(card, "m", 0, scope)
        scope.diagnostics.inform(card.spot(), "m= changes nothing in a voltage source")
    if source.series:
        inner = f"{name}.rser"
        elements.add("resistor", inner, (nodes[0], inner), (source.series, 0.0, 0.0), card)
        nodes = [inner, nodes[1]]
    elements.add(kind, name, nodes, (value,) if kind == "current source" else (value, 0.0), card)


def _read_capacitor(card: Card, scope: Scope, elements: Elements) -> None:
    element = _cut(card, scope, " ".join(("c l w", *card.rules.capacitor_keys)))
    model, farads = _model_and_value(element, scope, frozenset({"c", "cap", "capacitor"}), "capacitance", "c")
    if farads is None:
        if model is None:
            raise card.error(None, f"{element.name} has no value")
        text = "the capacitance of a model is not computed: it is open at direct current"
        scope.diagnostics.inform(card.spot(), text)
    farads = (farads or 0.0) * multiplier(card, element.value("m", 1.0))
    if not 0 <= farads < math.inf:
        raise card.error(None, f"{element.name} has {farads:g} F; a capacitance must not be negative")
    elements.add("capacitor", element.name, element.nodes, (farads,), card)


def _read_inductor(card: Card, scope: Scope, elements: Elements) -> None:
    element = _cut(card, scope, " ".join(("l nt", *card.rules.inductor_keys)))
    model, henries = _model_and_value(element, scope, frozenset({"l", "ind", "inductor"}), "", "l")
    if henries is None and model is None:
        raise card.error(None, f"{element.name} has no value")
    series = element.value("rser", element.value("r", 0.0))
    if series:
        scope.diagnostics.inform(card.spot(), "an inductor with rser is a resistor at direct current")
        elements.add("resistor", element.name, element.nodes, (series, 0.0, 0.0), card)
        return
    if card.rules.inductor_ohms:
        scope.diagnostics.warn(
            card.spot(),
            f"{DIALECTS[card.rules.name].label} gives an inductor {card.rules.inductor_ohms:g} ohm unless rser=0 "
            "is said; it is a short here",
        )
    scope.diagnostics.inform(card.spot(), "an inductor is a short at direct current: a source of 0 V bears its name")
    elements.add("voltage source", element.name, element.nodes, (0.0, 1.0), card)


def _read_switch(card: Card, scope: Scope, elements: Elements) -> None:
    tokens = tokenise(card)
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
    elements.add("switch", tokens[0].text, nodes, modelled_switch(model, scope, state, card), card)


def _read_nonlinear(card: Card, scope: Scope, elements: Elements) -> bool:
    """Read ``I = current tanh(V / voltage)`` in the form that this package writes; whether it is one."""
    match = _nonlinear_form(card.rules.name).fullmatch(card.text.strip())
    if match is None:
        return False
    shift = len(card.text) - len(card.text.lstrip())
    tokens = (Token("word", match[key], match.start(key) + shift) for key in ("current", "voltage"))
    amps, volts = (scope.number(card, token) for token in tokens)
    if amps <= 0 or volts <= 0:
        raise card.error(None, f"{match['name']} carries {amps:g} A at {volts:g} V; both must be positive")
    elements.add("nonlinear resistor", match["name"], (match["a"], match["b"]), (amps, volts), card)
    return True


@lru_cache(maxsize=64)
def _nonlinear_form(dialect: str) -> re.Pattern[str]:
    """What the dialect's template of a nonlinear resistor writes, blanks and case aside."""
    groups = {"name": r"b\S*", "a": r"[^\s,()]+", "b": r"[^\s,()]+"}
    pattern, seen = "", set()
    for literal, key, *_ in string.Formatter().parse(DIALECTS[dialect].nonlinear_resistor):
        pattern += re.escape(literal).replace(r"\ ", r"\s+")
        if key is not None:
            pattern += f"(?P={key})" if key in seen else f"(?P<{key}>{groups.get(key, r'[^*/()]+')})"
            seen.add(key)
    return re.compile(pattern, re.IGNORECASE)


_READERS: dict[str, Callable[[Card, Scope, Elements], None]] = {
    "r": _read_resistor,
    "v": partial(_read_source, "voltage source"),
    "i": partial(_read_source, "current source"),
    "c": _read_capacitor,
    "l": _read_inductor,
    "s": _read_switch,
}
