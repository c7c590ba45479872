"""Expansion of subcircuits: each one is flattened once per set of parameter values and copied to its instances."""

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
from resgrid.spice.read.name_conflicts import check_called_name, note_blank, refuse_overridden
from resgrid.spice.read.scopes import Block, Scope
from resgrid.spice.read.spectre import PRIMITIVES, word_for
from resgrid.spice.read.temperature import refuse_temperature

MAX_DEPTH = 50
"""Maximum nesting depth of instances of subcircuits; deeper nesting is an error of the deck."""
MAX_ELEMENTS = 20_000_000
"""Upper bound of the default limit of `read_spice` on the number of elements of a deck after expansion."""
FREE_GROWTH, MAX_GROWTH = 500_000, 5000
"""Default limit on the elements after expansion: 500,000, or 5,000 per card if more, up to `MAX_ELEMENTS`."""
_OWN_MULTIPLIER = re.compile(r"^[^vs].*[\s,]m\s*=", re.IGNORECASE)
_BLANK = re.compile(r"\s")


@dataclass(frozen=True, eq=False)
class Instance:
    """An instance of a subcircuit (``X`` card).

    `card`: the card; `name`: name of the instance; `nodes`: names of the connected nodes, in the order of the
    terminals; `block`: the subcircuit; `given`: ``key=value`` pairs of the parameters that the instance passes.
    """

    card: Card
    name: str
    nodes: tuple[str, ...]
    block: Block
    given: tuple[Setting, ...]


@dataclass(frozen=True, eq=False)
class FlatSubcircuit:
    """A flattened subcircuit with given parameter values.

    `names`: names of its n nodes, terminals first; `ports`: number of terminals; `is_global`: for each node whether it
    is global or ground, and no terminal; `parts`: arrays of the elements by kind, with node indices into `names`.
    """

    names: tuple[str, ...]
    ports: int
    is_global: tuple[bool, ...]
    parts: dict[str, ElementArrays]


@dataclass(eq=False)
class Expander:
    """Expander of instances; each subcircuit is flattened once per set of parameter values and copied to its instances.

    `contents`: content of the deck; `nominal`: nominal temperature of the deck, in degrees Celsius; `heating`:
    simulation temperature minus nominal temperature, in kelvin; `used`: names of the subcircuits with instances.
    """

    contents: Contents
    nominal: float
    heating: float = 0.0
    used: set[str] = field(default_factory=set)
    _flats: dict[tuple[Scope, Block, tuple[tuple[str, float], ...]], FlatSubcircuit] = field(default_factory=dict)
    _instances: dict[Card, Instance] = field(default_factory=dict)
    _sizes: dict[Block, int] = field(default_factory=dict)

    def elements(self) -> Elements:
        """Return an empty collection of elements with the deck's names of ground and temperatures."""
        nodes = NodeTable(self.contents.grounds, exact=self.contents.rules.instances)
        return Elements(nodes, self.nominal, self.heating)

    def fill(self, scope: Scope, elements: Elements, cards: Iterable[Card]) -> None:
        """Add the elements of `cards`, instances expanded, to `elements`; `scope`: gives values and collects errors."""
        groups: dict[FlatSubcircuit, list[tuple[Instance, float]]] = {}
        names: set[str] = set()
        for card in cards:
            try:
                letter = letter_of(card, scope.block)
                self._check_names(card, letter)
                if letter == "x":
                    instance = self._instance(card, scope.block)
                    if instance.name.lower() in names:
                        raise card.error(0, f"two instances are named {instance.name}: rename one")
                    names.add(instance.name.lower())
                    given, factor = self._given(instance, scope)
                    groups.setdefault(self._flat(instance, given, scope), []).append((instance, factor))
                else:
                    read_element(card, letter, scope, elements)
            except CardError as error:
                scope.diagnostics.error(error)
        for flat, instances in groups.items():
            _stamp(flat, instances, elements)
        if elements.nodes.clashes:
            raise InputError(
                f"{', '.join(sorted(set(elements.nodes.clashes)))} and nodes that differ by case alone are different "
                f"nodes in {self.contents.rules.name}, but one node here: rename some"
            )

    def _check_names(self, card: Card, letter: str) -> None:
        """Raise CardError for a node name that the simulator misreads; warn about a blank in a quoted name.

        The simulator may cut such a name, ``"a b"``, at the blank.  `card`: an element's card; `letter`: first letter
        of the element's kind, ``x`` for an instance of a subcircuit.
        """
        misread = card.rules.words.misread.get("node", ())
        if any(name in card.text.lower() for name in misread):
            tokens = [token for token in tokenise(card)[1:] if token.kind != "mark"]
            self.contents.refuse_misread(card, "node", tokens if letter == "x" else tokens[:2])
        if card.rules.refusals.blank_names and '"' in card.text:
            for token in tokenise(card):
                if token.kind == "string" and _BLANK.search(token.text):
                    note_blank(card, f'"{token.text}"', token.offset - 1, self.contents.diagnostics)
                    break

    def check_size(self, limit: int | None) -> None:
        """Check the number of elements before the expansion.

        `limit`: maximum number of elements, None for a limit that grows with the number of cards.  Raises BudgetError
        if the number exceeds the limit.  Recursive subcircuits are collected as errors.
        """
        top = self.contents.top
        count = self._size(top, [])
        cards = len(self._instances) + len(top.cards)
        allowed = min(MAX_ELEMENTS, max(FREE_GROWTH, MAX_GROWTH * cards)) if limit is None else limit
        if count > allowed:
            raise BudgetError(
                f"the deck has {count:.3g} elements after its subcircuits are expanded; at most {allowed:,} are read "
                "from a deck of its size; to read it, raise max_elements"
            )

    def _size(self, block: Block, path: list[Block]) -> int:
        """Return the number of elements of `block` after expansion; `path`: the blocks that contain it, deck first."""
        if block in self._sizes:
            return self._sizes[block]
        count = 0
        for card in block.cards:
            try:
                if letter_of(card, block) != "x":
                    count += 1
                    continue
                instance = self._instance(card, block)
                if instance.block in path or instance.block is block:
                    raise card.error(0, f"the subcircuit {instance.block.name!r} contains itself")
                if len(path) >= MAX_DEPTH:
                    raise card.error(0, f"subcircuits are nested more than {MAX_DEPTH} deep")
            except CardError as error:
                self.contents.diagnostics.error(error)
                continue
            count += max(1, self._size(instance.block, [*path, block]))
        self._sizes[block] = count
        return count

    def _instance(self, card: Card, block: Block) -> Instance:
        """Return the instance that a card of `block` describes; raise CardError if it does not match its subcircuit."""
        if card in self._instances:
            return self._instances[card]
        tokens = tokenise(card)
        positional, tail = split_call(joined_names(card, tokens, len(tokens)))
        if len(positional) < 2 or any(token.kind not in ("word", "string") for token in positional):
            raise card.error(None, f"{card.text.split()[0]} needs its nodes and the name of a subcircuit")
        label, *terminals, name = positional
        target = block.block(name.text.lower())
        if target is None:
            known_masters = f", or write {', '.join(PRIMITIVES)}" if card.rules.instances else ""
            text = f"there is no subcircuit {name.text!r}; define it, or include its file{known_masters}"
            raise card.error(name.offset, text)
        check_called_name(card, name, block, self.contents.diagnostics)
        nodes = tuple(token.text for token in terminals)
        if len(nodes) != len(target.ports):
            text = f"{label.text} has {len(nodes)} node(s), but {target.name} has {len(target.ports)}"
            raise card.error(name.offset, text)
        for port, node in zip(target.ports, nodes, strict=True):
            grounds = self.contents.grounds - self.contents.global_nodes
            if port.lower() in grounds and node.lower() not in grounds:
                text = f"the terminal {port} of {target.name} is ground itself, and {node} is not: rename the terminal"
                raise card.error(name.offset, text)
        pairs = assignments(card, tail)
        self.contents.note_comma(card, pairs)
        instance = Instance(card, label.text, nodes, target, tuple(pairs))
        self._instances[card] = instance
        return instance

    def _given(self, instance: Instance, scope: Scope) -> tuple[dict[str, float], float]:
        """Return the values that an instance passes to parameters, by name, and its multiplier (number of copies)."""
        rules, block = instance.card.rules, instance.block
        given: dict[str, float] = {}
        factor = 1.0
        named: dict[str, set[str]] = {}
        for setting in self._ordered(instance, scope):
            names = named.setdefault(setting.key, set())
            value = self._given_value(instance, setting, scope, given, names)
            if setting.key == "m" and "m" not in block.defaults:
                factor = multiplier(instance.card, value)
                if rules.replaces_multipliers:
                    self._refuse_multiplier(instance, setting, scope, factor)
            elif setting.key in block.parameters:
                given[setting.key] = value
            else:
                text = f"{block.name} has no parameter {setting.key!r}; only {sorted(block.parameters)}"
                raise instance.card.error(setting.offset, text)
        if rules.puts_in_text:
            self._refuse_captured(instance, scope, given, named)
        return given, factor

    def _given_value(
        self, instance: Instance, setting: Setting, scope: Scope, given: dict[str, float], names: set[str]
    ) -> float:
        """Return the value that an instance passes to one parameter; add the names in its expression to `names`.

        `setting`: the parameter; `scope`: scope around the instance; `given`: values evaluated before, by name.
        """
        inner: list[Scope] = []

        def looked_up(name: str) -> float | None:
            """Return the value of a name outside the subcircuit, or in some dialects inside; None if undefined."""
            names.add(name)
            value = scope.named(name)
            if value is None and instance.card.rules.words.inner_names and name != setting.key:
                inner[:] = inner or [Scope(instance.block, scope.diagnostics, scope, given)]
                return inner[0].named(name)
            return value

        with scope.recorded() as use:
            value = scope.number(instance.card, setting.values[0], looked_up)
        if use.used:
            refuse_temperature(instance.card, setting.offset, f"{setting.key}= of {instance.name}")
        return value

    def _ordered(self, instance: Instance, scope: Scope) -> list[Setting]:
        """Return the parameters of an instance in an order in which each one follows those that its expression uses.

        `scope`: scope that contains the instance.  If a parameter is given twice, only the last one is returned.
        """
        last = {setting.key: setting for setting in instance.given}
        if not instance.card.rules.words.inner_names or len(last) < 2:
            return list(last.values())
        ordered: dict[str, Setting] = {}

        def visit(setting: Setting, path: tuple[str, ...]) -> None:
            """Append the parameters that `setting` refers to, then `setting`, to `ordered` (depth-first).

            `path`: names in the chain of references that leads to `setting`; it breaks cycles.
            """
            for name in sorted(names_in(setting.values[0].text)):
                if name in last and name not in ordered and name not in path and not scope.defines(name):
                    visit(last[name], (*path, name))
            ordered.setdefault(setting.key, setting)

        for setting in last.values():
            visit(setting, (setting.key,))
        return list(ordered.values())

    def _refuse_captured(
        self, instance: Instance, scope: Scope, given: dict[str, float], named: dict[str, set[str]]
    ) -> None:
        """Raise CardError for a name in an instance's expression with different values outside and in the subcircuit.

        The dialect's simulator takes the value in the subcircuit.  `scope`: scope that contains the instance; `given`:
        parameter values that it passes; `named`: for each parameter, the names in its expression.
        """
        ambiguous = [
            (setting, name)
            for setting in instance.given
            for name in named[setting.key] - {setting.key}
            if name in instance.block.parameters and scope.defines(name)
        ]
        if not ambiguous:
            return
        inside = Scope(instance.block, scope.diagnostics, scope, given)
        for setting, name in sorted(ambiguous, key=lambda one: (one[0].offset, one[1])):
            if inside.parameter(name) != scope.parameter(name):
                dialect, block = instance.card.rules.name, instance.block.name
                raise instance.card.error(
                    setting.offset,
                    f"{dialect} takes {name} in {setting.key}= for the {name} of {block}, other simulators for the "
                    f"{name} outside: rename one of them",
                )

    def _refuse_multiplier(self, instance: Instance, setting: Setting, scope: Scope, factor: float) -> None:
        """Raise CardError if the dialect's simulator does not take ``m=`` of an instance for the number of copies.

        `setting`: the pair ``m=value``; `factor`: the value of ``m=``; `scope`: scope that contains the instance.
        """
        dialect = instance.card.rules.name
        texts = [card.text for card in instance.block.cards]
        own = [text for text in texts if _OWN_MULTIPLIER.search(text)]
        deep = [text for text in texts if text[0] in "xX" or (text[0] in "sS" and factor != 1)]
        if own or deep:
            effect = f"replaces that of {own[0].split()[0]}" if own else f"does not reach {deep[0].split()[0]}"
            text = f"in {dialect} this m= {effect}: use {instance.block.name} several times instead"
            raise instance.card.error(setting.offset, text)
        if instance.block.model("m") is not None:
            text = f"in {dialect} this m= is also the model m inside of {instance.block.name}: rename the model"
            raise instance.card.error(setting.offset, text)
        if "m" in instance.block.parameters or scope.parameter("m") is not None:
            text = f"in {dialect} this m= also changes the parameter m: rename the parameter"
            raise instance.card.error(setting.offset, text)

    def _flat(self, instance: Instance, given: dict[str, float], outer: Scope) -> FlatSubcircuit:
        """Return the flattened subcircuit of an instance.

        `given`: parameter values that the instance passes, by name; `outer`: scope that contains the instance.
        """
        block = instance.block
        key = (outer, block, tuple(sorted(given.items())))
        if key in self._flats:
            return self._flats[key]
        self.used.add(block.name)
        contents = self.contents
        shared = next((port for port in block.ports if port.lower() in contents.global_nodes), None)
        if shared is not None:
            command = word_for(contents.rules, ".global")
            kind = command if shared.lower() not in contents.rules.words.common_nodes else "a node of all subcircuits"
            words = f"{shared} is a terminal of {block.name} and {kind}; simulators differ on that: rename one"
            raise CardError(block.spot, words)
        scope = Scope(block, outer.diagnostics, outer, given)
        refuse_overridden(instance.card, scope, contents.options)
        elements = self.elements()
        table = elements.nodes
        for i, port in enumerate(block.ports):
            table.names.append(port)
            table.number[port.lower()] = i
        self.fill(scope, elements, block.cards)
        everywhere = contents.global_nodes | contents.grounds
        is_global = tuple(i >= len(block.ports) and name.lower() in everywhere for i, name in enumerate(table.names))
        parts = {kind: part for kind in WIDTHS if len(part := elements.joined(kind))}
        self._flats[key] = FlatSubcircuit(tuple(table.names), len(block.ports), is_global, parts)
        return self._flats[key]


def _stamp(flat: FlatSubcircuit, instances: list[tuple[Instance, float]], elements: Elements) -> None:
    """Add the elements of a flattened subcircuit to `elements`, once for every instance.

    `flat`: the flattened subcircuit; `instances`: pairs of an instance and its multiplier ``m``.
    """
    factor = np.array([factor for _, factor in instances])
    place = np.array([(instance.card.file, instance.card.line) for instance, _ in instances], dtype=np.int64)
    order = order_of(place)
    nodes = _node_map(flat, [instance for instance, _ in instances], order.tolist(), elements.nodes)
    for kind, part in flat.parts.items():
        values = np.tile(widened(kind, part.values), (len(instances), 1))
        each = np.repeat(factor, len(part))[:, np.newaxis]
        if kind in RESISTIVE:
            values[:, : RESISTIVE[kind]] /= each
        elif kind != "voltage source":
            values[:, :1] *= each
        elements.parts[kind].append(
            ElementArrays(
                partial(_names_of_instances, instances, part),
                nodes[:, part.nodes].reshape(-1, part.nodes.shape[1]),
                values,
                np.tile(part.place, (len(instances), 1)),
                np.repeat(order, len(part)),
            )
        )


def _names_of_instances(instances: list[tuple[Instance, float]], part: ElementArrays) -> list[str]:
    """Return the names ``instance.element`` of the copies of `part`; `instances`: pairs of instance and multiplier."""
    names = part.names()
    return [f"{instance.name}.{name}" for instance, _ in instances for name in names]


def _node_map(
    flat: FlatSubcircuit, instances: list[Instance], orders: list[int], table: NodeTable
) -> NDArray[np.int64]:
    """Return the node numbers, in the enclosing block, of a subcircuit's nodes for each instance: (instances, nodes).

    `orders`: position of each instance (file index times ``2**40`` plus line), which decides between spellings of a
    node's name; `table`: node table of the enclosing block, to which new nodes are added.
    """
    number_of = table.number_of
    numbers = np.empty((len(instances), len(flat.names)), dtype=np.int64)
    numbers[:, : flat.ports] = [
        [number_of(name, order) for name in instance.nodes] for instance, order in zip(instances, orders, strict=True)
    ]
    is_global = np.array(flat.is_global, dtype=np.bool_)
    numbers[:, is_global] = [number_of(flat.names[i], orders[0]) for i in np.flatnonzero(is_global).tolist()]
    own = np.flatnonzero(~is_global)[flat.ports :]
    names = [flat.names[i] for i in own.tolist()]
    inner = table.numbers_in_instances(
        [f"{instance.name}.{name}" for instance in instances for name in names],
        [order for order in orders for _ in names],
    )
    numbers[:, own] = inner.reshape(len(instances), len(own))
    return numbers
