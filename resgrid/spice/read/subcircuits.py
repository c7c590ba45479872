"""Subcircuits in place of their calls: each block is flattened once per set of parameters, and then stamped."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import BudgetError, InputError
from resgrid.spice.read.assignments import assignments
from resgrid.spice.read.cards import Card, Setting, joined_names, split_call, tokenise
from resgrid.spice.read.commands import Contents
from resgrid.spice.read.diagnostics import CardError
from resgrid.spice.read.element_tables import RESISTIVE, WIDTHS, ElementArrays, Elements, NodeTable, order_of, widened
from resgrid.spice.read.elements import letter_of, multiplier, read_element
from resgrid.spice.read.expressions import names_in
from resgrid.spice.read.scopes import Block, Scope
from resgrid.spice.read.spectre import PRIMITIVES, word_for
from resgrid.spice.read.temperature import refuse_temperature

MAX_DEPTH = 50
MAX_ELEMENTS = 20_000_000
FREE_GROWTH, MAX_GROWTH = 500_000, 5000
"""Elements that a deck may grow to whatever its size, and per card beyond."""

_OWN_MULTIPLIER = re.compile(r"^[^vs].*[\s,]m\s*=", re.IGNORECASE)

_BLANK = re.compile(r"\s")


@dataclass(frozen=True, eq=False)
class Call:
    """An ``X`` card: nodes, the subcircuit, what it is given."""

    card: Card
    name: str
    nodes: tuple[str, ...]
    block: Block
    given: tuple[Setting, ...]


@dataclass(frozen=True, eq=False)
class Flat:
    """A subcircuit with given parameters, flattened: its nodes (ports first) and its elements."""

    names: tuple[str, ...]
    ports: int
    common: tuple[bool, ...]
    parts: dict[str, ElementArrays]


@dataclass(eq=False)
class Expander:
    """Flattens blocks, each once per set of parameters.

    `nominal`: the deck's nominal temperature, in degrees Celsius; `heating`: how far its temperature lies above
    that, in kelvin; `used`: names of blocks that are called.
    """

    contents: Contents
    nominal: float
    heating: float = 0.0
    used: set[str] = field(default_factory=set)
    _flats: dict[tuple[Scope, Block, tuple[tuple[str, float], ...]], Flat] = field(default_factory=dict)
    _calls: dict[Card, Call] = field(default_factory=dict)
    _sizes: dict[Block, int] = field(default_factory=dict)

    def elements(self) -> Elements:
        """Elements of a block, none yet."""
        nodes = NodeTable(self.contents.grounds, exact=self.contents.rules.instances)
        return Elements(nodes, self.nominal, self.heating)

    def fill(self, scope: Scope, elements: Elements, cards: Iterable[Card]) -> None:
        """Read the cards of a block into its elements, calls expanded."""
        groups: dict[Flat, list[tuple[Call, float]]] = {}
        names: set[str] = set()
        for card in cards:
            try:
                letter = letter_of(card, scope.block)
                self._judge_names(card, letter)
                if letter == "x":
                    call = self._call(card, scope.block)
                    if call.name.lower() in names:
                        raise card.error(0, f"{call.name} is called twice; instances need names of their own")
                    names.add(call.name.lower())
                    given, factor = self._given(call, scope)
                    groups.setdefault(self._flat(call, given, scope), []).append((call, factor))
                else:
                    read_element(card, letter, scope, elements)
            except CardError as error:
                scope.diagnostics.error(error)
        for flat, calls in groups.items():
            _stamp(flat, calls, elements)
        if elements.nodes.clashes:
            raise InputError(
                f"{', '.join(sorted(set(elements.nodes.clashes)))} and nodes that differ by case alone are different "
                f"nodes in {self.contents.rules.name}, one here: rename some"
            )

    def _judge_names(self, card: Card, letter: str) -> None:
        """Raise CardError for a node whose name the dialect's simulator misreads; note blanks in quoted names."""
        misread = card.rules.words.misread.get("node", ())
        if any(name in card.text.lower() for name in misread):
            tokens = [token for token in tokenise(card)[1:] if token.kind != "mark"]
            self.contents.refuse_misread(card, "node", tokens if letter == "x" else tokens[:2])
        if card.rules.refusals.blank_names and '"' in card.text:
            for token in tokenise(card):
                if token.kind == "string" and _BLANK.search(token.text):
                    self._note_blank(card, f'"{token.text}"', token.offset - 1)
                    break

    def _note_blank(self, card: Card, name: str, offset: int) -> None:
        """Note a blank in a quoted name, by its consequence for the dialect's simulator."""
        rules, diagnostics = card.rules, self.contents.diagnostics
        if rules.refusals.blank_names == "fails":
            diagnostics.refuse(card.spot(offset), f"{rules.name} cuts the quoted name {name} at its blank, and stops")
        else:
            text = f"it is not known here whether {rules.name} reads the blank in the quoted name {name}"
            diagnostics.doubt(card.spot(offset), text)

    def check_size(self, limit: int | None) -> None:
        """Refuse decks that call themselves or grow beyond measure, before anything is expanded."""
        top = self.contents.top
        count = self._size(top, [])
        cards = len(self._calls) + len(top.cards)
        allowed = min(MAX_ELEMENTS, max(FREE_GROWTH, MAX_GROWTH * cards)) if limit is None else limit
        if count > allowed:
            raise BudgetError(
                f"the deck has {count:.3g} elements once subcircuits are expanded; at most {allowed:,} are read from "
                "one of its size; if that is meant, allow more (max_elements)"
            )

    def _size(self, block: Block, path: list[Block]) -> int:
        if block in self._sizes:
            return self._sizes[block]
        count = 0
        for card in block.cards:
            try:
                if letter_of(card, block) != "x":
                    count += 1
                    continue
                call = self._call(card, block)
                if call.block in path or call.block is block:
                    raise card.error(0, f"the subcircuit {call.block.name!r} contains itself")
                if len(path) >= MAX_DEPTH:
                    raise card.error(0, f"subcircuits are nested more than {MAX_DEPTH} deep")
            except CardError as error:
                self.contents.diagnostics.error(error)
                continue
            count += max(1, self._size(call.block, [*path, block]))
        self._sizes[block] = count
        return count

    def _call(self, card: Card, block: Block) -> Call:
        if card in self._calls:
            return self._calls[card]
        tokens = tokenise(card)
        positional, tail = split_call(joined_names(card, tokens, len(tokens)))
        if len(positional) < 2 or any(token.kind not in ("word", "string") for token in positional):
            raise card.error(None, f"{card.text.split()[0]} needs its nodes and the name of a subcircuit")
        instance, *terminals, name = positional
        target = block.block(name.text.lower())
        if target is None:
            known_masters = f", or write {', '.join(PRIMITIVES)}" if card.rules.instances else ""
            text = f"there is no subcircuit {name.text!r}; define it, or include its file{known_masters}"
            raise card.error(name.offset, text)
        nodes = tuple(token.text for token in terminals)
        if len(nodes) != len(target.ports):
            text = f"{instance.text} has {len(nodes)} node(s), but {target.name} has {len(target.ports)}"
            raise card.error(name.offset, text)
        for port, node in zip(target.ports, nodes, strict=True):
            grounds = self.contents.grounds - self.contents.common
            if port.lower() in grounds and node.lower() not in grounds:
                text = f"the terminal {port} of {target.name} is ground itself, and {node} is not: rename the terminal"
                raise card.error(name.offset, text)
        pairs = assignments(card, tail)
        self.contents.note_comma(card, pairs)
        call = Call(card, instance.text, nodes, target, tuple(pairs))
        self._calls[card] = call
        return call

    def _given(self, call: Call, scope: Scope) -> tuple[dict[str, float], float]:
        """Return the values that a call gives to the subcircuit's parameters, and the number of copies in parallel."""
        rules, block = call.card.rules, call.block
        given: dict[str, float] = {}
        factor = 1.0
        named: dict[str, set[str]] = {}
        for setting in self._ordered(call, scope):
            names = named.setdefault(setting.key, set())
            value = self._given_value(call, setting, scope, given, names)
            if setting.key == "m" and "m" not in block.defaults:
                factor = multiplier(call.card, value)
                if rules.replaces_multipliers:
                    self._refuse_multiplier(call, setting, scope, factor)
            elif setting.key in block.parameters:
                given[setting.key] = value
            else:
                text = f"{block.name} has no parameter {setting.key!r}; only {sorted(block.parameters)}"
                raise call.card.error(setting.offset, text)
        if rules.puts_in_text:
            self._refuse_captured(call, scope, given, named)
        return given, factor

    def _given_value(
        self, call: Call, setting: Setting, scope: Scope, given: dict[str, float], names: set[str]
    ) -> float:
        """Evaluate one value of a call; enter the names that it refers to."""
        inner: list[Scope] = []

        def looked_up(name: str) -> float | None:
            names.add(name)
            value = scope.named(name)
            if value is None and call.card.rules.words.inner_names and name != setting.key:
                inner[:] = inner or [Scope(call.block, scope.diagnostics, scope, given)]
                return inner[0].named(name)
            return value

        with scope.watched() as watch:
            value = scope.number(call.card, setting.values[0], looked_up)
        if watch.used:
            refuse_temperature(call.card, setting.offset, f"{setting.key}= of {call.name}")
        return value

    def _ordered(self, call: Call, scope: Scope) -> list[Setting]:
        """Return what a call gives, the last of several values of one name, each behind those that it refers to."""
        last = {setting.key: setting for setting in call.given}
        if not call.card.rules.words.inner_names or len(last) < 2:
            return list(last.values())
        ordered: dict[str, Setting] = {}

        def visit(setting: Setting, path: tuple[str, ...]) -> None:
            for name in sorted(names_in(setting.values[0].text)):
                if name in last and name not in ordered and name not in path and not scope.defines(name):
                    visit(last[name], (*path, name))
            ordered.setdefault(setting.key, setting)

        for setting in last.values():
            visit(setting, (setting.key,))
        return list(ordered.values())

    def _refuse_captured(self, call: Call, scope: Scope, given: dict[str, float], named: dict[str, set[str]]) -> None:
        """Refuse names in what a call gives that mean another value in the subcircuit, where they are looked up."""
        doubtful = [
            (setting, name)
            for setting in call.given
            for name in named[setting.key] - {setting.key}
            if name in call.block.parameters and scope.defines(name)
        ]
        if not doubtful:
            return
        inside = Scope(call.block, scope.diagnostics, scope, given)
        for setting, name in sorted(doubtful, key=lambda one: (one[0].offset, one[1])):
            if inside.parameter(name) != scope.parameter(name):
                raise call.card.error(
                    setting.offset,
                    f"{call.card.rules.name} takes {name} in {setting.key}= for the {name} of {call.block.name}, other "
                    f"simulators for the one where {call.name} stands: rename one of them",
                )

    def _refuse_multiplier(self, call: Call, setting: Setting, scope: Scope, factor: float) -> None:
        """Refuse ``m=`` of a call where it is not the number of subcircuits in parallel."""
        dialect = call.card.rules.name
        texts = [card.text for card in call.block.cards]
        own = [text for text in texts if _OWN_MULTIPLIER.search(text)]
        deep = [text for text in texts if text[0] in "xX" or (text[0] in "sS" and factor != 1)]
        if own or deep:
            what = f"takes the place of that of {own[0].split()[0]}" if own else f"does not reach {deep[0].split()[0]}"
            text = f"in {dialect} this m= {what}: call {call.block.name} several times instead"
            raise call.card.error(setting.offset, text)
        if "m" in call.block.parameters or scope.parameter("m") is not None:
            text = f"in {dialect} this m= changes the parameter m, too: rename the parameter"
            raise call.card.error(setting.offset, text)

    def _flat(self, call: Call, given: dict[str, float], outer: Scope) -> Flat:
        block = call.block
        key = (outer, block, tuple(sorted(given.items())))
        if key in self._flats:
            return self._flats[key]
        self.used.add(block.name)
        contents = self.contents
        shared = next((port for port in block.ports if port.lower() in contents.common), None)
        if shared is not None:
            command = word_for(contents.rules, ".global")
            kind = command if shared.lower() not in contents.rules.words.common_nodes else "a node of all subcircuits"
            words = f"{shared} is a terminal of {block.name} and {kind}; simulators differ on that: rename one"
            raise CardError(block.spot, words)
        scope = Scope(block, outer.diagnostics, outer, given)
        elements = self.elements()
        table = elements.nodes
        for i, port in enumerate(block.ports):
            table.names.append(port)
            table.number[port.lower()] = i
        self.fill(scope, elements, block.cards)
        everywhere = contents.common | contents.grounds
        common = tuple(i >= len(block.ports) and name.lower() in everywhere for i, name in enumerate(table.names))
        parts = {kind: part for kind in WIDTHS if len(part := elements.joined(kind))}
        self._flats[key] = Flat(tuple(table.names), len(block.ports), common, parts)
        return self._flats[key]


def _stamp(flat: Flat, calls: list[tuple[Call, float]], elements: Elements) -> None:
    """Put a flattened subcircuit in place of every call of it, at once."""
    factor = np.array([factor for _, factor in calls])
    place = np.array([(call.card.file, call.card.line) for call, _ in calls], dtype=np.int64)
    order = order_of(place)
    nodes = _node_map(flat, [call for call, _ in calls], order.tolist(), elements.nodes)
    for kind, part in flat.parts.items():
        values = np.tile(widened(kind, part.values), (len(calls), 1))
        each = np.repeat(factor, len(part))[:, np.newaxis]
        if kind in RESISTIVE:
            values[:, : RESISTIVE[kind]] /= each
        elif kind != "voltage source":
            values[:, :1] *= each
        elements.parts[kind].append(
            ElementArrays(
                partial(_names_of_instances, calls, part),
                nodes[:, part.nodes].reshape(-1, part.nodes.shape[1]),
                values,
                np.tile(part.place, (len(calls), 1)),
                np.repeat(order, len(part)),
            )
        )


def _names_of_instances(calls: list[tuple[Call, float]], part: ElementArrays) -> list[str]:
    names = part.names()
    return [f"{call.name}.{name}" for call, _ in calls for name in names]


def _node_map(flat: Flat, calls: list[Call], orders: list[int], table: NodeTable) -> NDArray[np.int64]:
    """Numbers in the table of the subcircuit's nodes, for every call; shape (calls, nodes)."""
    of = table.of
    numbers = np.empty((len(calls), len(flat.names)), dtype=np.int64)
    numbers[:, : flat.ports] = [
        [of(name, order) for name in call.nodes] for call, order in zip(calls, orders, strict=True)
    ]
    common = np.array(flat.common, dtype=np.bool_)
    numbers[:, common] = [of(flat.names[i], orders[0]) for i in np.flatnonzero(common).tolist()]
    own = np.flatnonzero(~common)[flat.ports :]
    names = [flat.names[i] for i in own.tolist()]
    inner = table.of_instances(
        [f"{call.name}.{name}" for call in calls for name in names], [order for order in orders for _ in names]
    )
    numbers[:, own] = inner.reshape(len(calls), len(own))
    return numbers
