"""Readers of element cards: R, V, I, C, L, S and nonlinear resistors; other elements are rejected."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

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
from resgrid.spice.read.name_conflicts import is_literal, refuse_hidden_model, refuse_model_as_key
from resgrid.spice.read.nonlinear_resistors import read_nonlinear
from resgrid.spice.read.scopes import Block, Model, Scope
from resgrid.spice.read.temperature import (
    note_bare,
    refuse_dropped,
    refuse_temperature,
    refuse_unspaced,
    refuse_unsupported,
)
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
"""Descriptions for error messages of the elements that cannot be read, by the first letter of the card."""

_SEVERAL = frozenset({"tc"})
_WARM_KEYS = frozenset({"r", "resistance", "c", "l"})
"""Keys of elements whose values may depend on the simulation temperature in every dialect."""

_FREE_KEYS = frozenset({"ac", "noisy", "noise", "ic", "temp_ac", "isnoisy"})
_VALUE_KEYS = frozenset({"tc", "tc1", "tc2", "m", "scale", "temp", "dtemp"})
_SPECTRE_KEYS = {"trise": "dtemp"}


@dataclass(frozen=True, eq=False)
class Element:
    """The card (statement) of an element with two nodes, split into name, nodes and values.

    `card`: the card; `name`: name of the element; `nodes`: names of the nodes; `positional`: tokens after the nodes
    that have no key; `pairs`: the ``key=value`` pairs; `keys`: numerical values of the pairs, by key in lower case.
    """

    card: Card
    name: str
    nodes: list[str]
    positional: list[Token]
    pairs: list[Setting]
    keys: dict[str, list[float]]

    def value(self, key: str, default: float) -> float:
        """Return the first number that the card of this element states for a key, or `default` without this key."""
        return self.keys[key][0] if key in self.keys else default


def letter_of(card: Card, block: Block) -> str:
    """Return an element's SPICE letter, such as "r" or "x" (instance); `block`: deck or subcircuit of `card`."""
    return spectre.letter_of(card, block) if card.rules.instances else card.text[0].lower()


def read_element(card: Card, letter: str, scope: Scope, elements: Elements) -> None:
    """Add the element of a card to `elements`; raise CardError if elements of its kind cannot be read.

    Coupled inductors add nothing, because they have no effect at direct current.  `letter`: letter of the element's
    kind, in lower case; `scope`: parameter values of the deck or subcircuit that contains the card.
    """
    refused = card.rules.refused_elements.get(letter)
    if refused is not None:
        raise card.error(0, f"{card.text.split()[0]} is {refused}")
    reader = _READERS.get(letter)
    if reader is not None:
        reader(card, scope, elements)
    elif letter == "k":
        scope.diagnostics.inform(card.spot(), "coupled inductors (K) have no effect at direct current")
    elif not read_nonlinear(card, scope, elements):
        name = card.text.split()[0][:60]
        if letter not in REFUSED:
            raise card.error(0, f"{name!r} is neither a known element nor a known command")
        kinds = "R, V, I, C, L, S and X"
        if card.rules.instances:
            kinds = f"{', '.join(master for master in spectre.PRIMITIVES if master != 'bsource')} and subcircuits"
        if letter in "bg":
            form = DIALECTS[card.rules.name].nonlinear_resistor
            kinds += f" and {form.format(name='B1', a='a', b='b', current='I0', voltage='V0')}"
        raise card.error(0, f"{name} is {REFUSED[letter]}; only {kinds} can be read")


def read_nodes(card: Card, tokens: list[Token], count: int) -> tuple[list[str], list[Token]]:
    """Return the names of the first `count` terminals of a card, and the tokens after them.

    `tokens`: all tokens of the card, the element's name first.  The terminals may be in parentheses or quotes.
    """
    tokens = joined_names(card, tokens, count + 1)
    names: list[str] = []
    i = 1
    while len(names) < count and i < len(tokens):
        token = tokens[i]
        if token.kind in ("word", "string"):
            names.append(token.text)
        elif not token.is_mark("()"):
            raise card.error(token.offset, f"unexpected {token.text!r}; expected a node")
        i += 1
    if len(names) < count:
        raise card.error(None, f"{tokens[0].text} has {len(names)} node(s); it needs {count}")
    if sum(token.is_mark("(") for token in tokens[1:i]) != sum(token.is_mark(")") for token in tokens[1 : i + 1]):
        raise card.error(tokens[1].offset, "the parentheses around the nodes do not match: write one pair, or none")
    return names, tokens[i + (i < len(tokens) and tokens[i].is_mark(")")) :]


def multiplier(card: Card, value: float) -> float:
    """Return `value`, the number of parallel elements that ``m=`` states; raise CardError unless it is positive."""
    if value <= 0:
        raise card.error(None, f"m = {value:g} must be positive: it is the number of parallel elements")
    return value


def _split(card: Card, scope: Scope, known: str = "") -> Element:
    """Return the card of an element with two nodes, split into name, nodes and values.

    `scope`: parameter values; `known`: keys that this kind of element may have, separated by blanks, in addition to
    the keys of all elements (`_VALUE_KEYS`: temperature coefficients, temperatures, ``m`` and ``scale``); if `known` is
    empty, the keys are not evaluated, and the result has no values of keys.
    """
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
    """Add a warning that the dialect's simulator stops at a key of this kind of element.

    `key`: the key; `offset`: its position in the text of `card`; `scope`: scope whose diagnostics receive the warning.
    """
    text = f"{card.rules.name} has no {key}= for {card.text[0].upper()}, and stops at it"
    scope.diagnostics.refuse(card.spot(offset), text)


def _values_of(
    card: Card, pairs: list[Setting], known: frozenset[str] | set[str], scope: Scope
) -> dict[str, list[float]]:
    """Return the values of the keys in `pairs`, by key; raise CardError for unknown and repeated keys.

    `card`: the card of the element; `known`: the keys that the element may have; `scope`: parameter values.  Keys
    without effect at direct current are left out of the result.
    """
    values: dict[str, list[float]] = {}
    for pair in pairs:
        if pair.key in card.rules.refusals.keys.get(card.text[0].lower(), ()):
            _note_key(card, pair.key, pair.offset, scope)
        if pair.key in card.rules.annotations:
            scope.diagnostics.inform(card.spot(pair.offset), f"{pair.key}= has no effect at direct current")
            continue
        if pair.key in _FREE_KEYS:
            continue
        if pair.key not in known:
            theirs = {ours: key for key, ours in _SPECTRE_KEYS.items()} if card.rules.instances else {}
            names = ", ".join(sorted(theirs.get(key, key) for key in known))
            label = DIALECTS[card.rules.name].label
            text = f"{pair.key!r} is not supported by the rules of {label}; supported here are {names}"
            raise card.error(pair.offset, text)
        if pair.key in values:
            raise card.error(pair.offset, f"{pair.key!r} is given twice: leave one out")
        with scope.recorded() as use:
            values[pair.key] = [scope.number(card, token) for token in pair.values]
        if use.used and pair.key not in _WARM_KEYS:
            refuse_temperature(card, pair.offset, f"{pair.key}=")
    return values


def _read_resistor(card: Card, scope: Scope, elements: Elements) -> None:
    """Add the resistor of a card to `elements`: its ohms at the nominal temperature, tc1 and tc2, all keys applied."""
    with scope.recorded() as use:
        element = _split(card, scope, "r resistance l w")
        model, ohms = _model_and_value(element, scope, RESISTOR_KINDS, "resistance", "r", "resistance")
    refuse_unsupported(card, use, ohms)
    parts = {*element.keys, *(["model"] if model is not None else [])}
    refuse_dropped(card, use, parts, element.nodes, elements.nominal)
    note_bare(card, use, element.positional, scope.diagnostics)
    if card.rules.spaced_lists:
        refuse_unspaced(card, element.pairs)
    first, second, nominal, exponential = 0.0, 0.0, math.nan, 0.0
    if model is not None:
        length, width = (element.keys[key][0] if key in element.keys else None for key in ("l", "w"))
        ohms, first, second, nominal, exponential = modelled_resistor(model, scope, ohms, length, width, card)
    elif ohms is None:
        raise card.error(None, f"{element.name} has no value: give it ohms, r=, or a model")
    elif "l" in element.keys or "w" in element.keys:
        raise card.error(None, "l and w need a model: name it, or give the resistance")
    several = element.keys.get("tc", [])
    if len(several) > 2:
        raise card.error(None, f"tc= takes one or two values, not {len(several)}")
    first, second = several + [first, second][len(several) :]
    first, second = element.value("tc1", first), element.value("tc2", second)
    if "scale" in element.keys and not card.rules.scale_key:
        raise card.error(None, f"scale= is not supported for {card.rules.name}; put it into the value")
    ohms *= element.value("scale", 1.0) / multiplier(card, element.value("m", 1.0))
    if not math.isfinite(ohms):
        raise card.error(None, f"{element.name} has {ohms} ohm")
    own = element.value("temp", elements.nominal + element.value("dtemp", 0.0))
    shift = own - (elements.nominal if math.isnan(nominal) else nominal)
    exponential = element.value("tce", exponential)
    if exponential:
        if use.used:
            raise card.error(
                None, f"{card.rules.name} drops tce= with an expression of the temperature: multiply there"
            )
        heating = 0.0 if "temp" in element.keys else elements.heating
        ohms *= 1.01 ** (exponential * (shift + heating))
        scope.diagnostics.warn(card.spot(), "tce= is evaluated at the temperature of the deck only")
        first = second = 0.0
    if shift and (first or second):
        ohms, first, second = rebase_one(ohms, first, second, shift)
    if "temp" in element.keys:
        first = second = 0.0
    elements.add("resistor", element.name, element.nodes, (ohms, first, second), card)


def _model_and_value(
    element: Element, scope: Scope, kinds: frozenset[str], quantity: str, *keys: str
) -> tuple[Model | None, float | None]:
    """Return the model that an element's card names and the value that it states, each None if missing.

    The value has no key or one of the `keys`.  `scope`: parameter values; `kinds`: kinds of model that fit the element;
    `quantity`: name of the value for the error about a second value; empty if several values are allowed, of which the
    first is returned.
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
            raise card.error(token.offset, "two models are given: leave one out")
        elif values and card.rules.models_first and not is_literal(element.positional[0]):
            raise card.error(
                token.offset,
                f"{card.rules.name} ignores the model {token.text} after a value like this: write the model first",
            )
        else:
            model = named
            if card.text[0] in "rR":
                refuse_hidden_model(card, token, scope.block)
    if model is None and element.positional and element.pairs:
        refuse_model_as_key(card, element.pairs[0], scope.block)
    values += [element.keys[key][0] for key in keys if key in element.keys]
    if len(values) > 1 and quantity:
        offset = element.positional[-1].offset if element.positional else None
        raise card.error(offset, f"more than one {quantity} is given: leave one out")
    return model, values[0] if values else None


def _read_source(kind: str, card: Card, scope: Scope, elements: Elements) -> None:
    """Add the source of a card to `elements`, with its value at direct current.

    A series resistance (``rser=``) is added as a resistor, with a new node between it and the source.  `kind`: "voltage
    source" or "current source"; `scope`: parameter values.
    """
    tokens = tokenise(card)
    if card.rules.instances:
        element = _split(card, scope)
        source = SourceValue(*spectre.source_value(card, element.pairs, scope))
        name, nodes = element.name, element.nodes
    else:
        name = tokens[0].text
        nodes, rest = read_nodes(card, tokens, 2)
        with scope.recorded() as use:
            source = source_value(card, rest, scope)
        if use.used:
            refuse_temperature(card, None, f"{name}")
    value = source.volts_or_amps
    if kind == "current source":
        value *= multiplier(card, source.count)
    elif source.count != 1:
        multiplier(card, source.count)
        if "m" in card.rules.refusals.keys.get("v", ()):
            _note_key(card, "m", 0, scope)
        scope.diagnostics.inform(card.spot(), "m= has no effect on a voltage source")
    if source.series:
        inner = f"{name}.rser"
        elements.add("resistor", inner, (nodes[0], inner), (source.series, 0.0, 0.0), card)
        nodes = [inner, nodes[1]]
    elements.add(kind, name, nodes, (value,) if kind == "current source" else (value, 0.0), card)


def _read_capacitor(card: Card, scope: Scope, elements: Elements) -> None:
    """Add the capacitor of a card to `elements`, in farads; a capacitance that only a model gives is entered as 0 F."""
    element = _split(card, scope, " ".join(("c l w", *card.rules.capacitor_keys)))
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
    """Add the inductor of a card to `elements`: a resistor if it has a series resistance, else a source of 0 V."""
    element = _split(card, scope, " ".join(("l nt", *card.rules.inductor_keys)))
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
            f"{DIALECTS[card.rules.name].label} gives an inductor {card.rules.inductor_ohms:g} ohm without "
            "rser=0; it is a short here",
        )
    scope.diagnostics.inform(card.spot(), "an inductor is a short at direct current: a source of 0 V has its name")
    elements.add("voltage source", element.name, element.nodes, (0.0, 1.0), card)


def _read_switch(card: Card, scope: Scope, elements: Elements) -> None:
    """Add the switch of a card to `elements`: two nodes of its contact, two of its control, and its model's values.

    Its ``ON`` or ``OFF``, by default off, is the state between the thresholds.
    """
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
            raise card.error(words[1].offset, f"unexpected {words[1].text!r}; expected ON or OFF")
        state = float(words[1].text.lower() == "on")
    elements.add("switch", tokens[0].text, nodes, modelled_switch(model, scope, state, card), card)


_READERS: dict[str, Callable[[Card, Scope, Elements], None]] = {
    "r": _read_resistor,
    "v": partial(_read_source, "voltage source"),
    "i": partial(_read_source, "current source"),
    "c": _read_capacitor,
    "l": _read_inductor,
    "s": _read_switch,
}
