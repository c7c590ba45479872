"""The deck and its subcircuits as blocks of cards, and the scopes in which their parameters have values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

from resgrid.errors import BudgetError
from resgrid.spice.dialects.record import ReadingRules, Words
from resgrid.spice.read.cards import Card, Setting, Token, refuse_quotes
from resgrid.spice.read.diagnostics import CardError, Diagnostics, Spot
from resgrid.spice.read.expressions import ExpressionError, Lookup, ReservedNameError, evaluate, folded_name
from resgrid.spice.read.numerals import parse_numeral

MAX_CHAIN = 40
"""How deep parameters may refer to each other (in order of their lines they may do so without end)."""

_MOST_NOTED = 5

MAX_CALLS = 10_000
"""How many calls of the deck's functions one value may take."""


@dataclass(frozen=True, eq=False)
class Definition:
    """What a parameter or a function is: an expression and where it stands."""

    card: Card
    token: Token
    arguments: tuple[str, ...] = ()

    def error(self, text: str) -> CardError:
        """Make an error about it."""
        return self.card.error(self.token.offset, text)


@dataclass(frozen=True, eq=False)
class Model:
    """A ``.model`` card, and the block that it stands in."""

    name: str
    kind: str
    settings: tuple[Setting, ...]
    card: Card
    block: Block


@dataclass(eq=False)
class Block:
    """The deck, or a subcircuit.

    `name`: of the subcircuit; empty for the deck; `outer`: the block that it is defined in; `ports`: names of its
    terminals, as spelt; `parameters`: defaults of the subcircuit and its ``.param`` lines, keys in lower case;
    `functions, models, blocks`: by name in lower case; `cards`: its elements.
    """

    name: str
    outer: Block | None = None
    ports: list[str] = field(default_factory=list)
    defaults: set[str] = field(default_factory=set)
    parameters: dict[str, Definition] = field(default_factory=dict)
    functions: dict[str, Definition] = field(default_factory=dict)
    models: dict[str, Model] = field(default_factory=dict)
    blocks: dict[str, Block] = field(default_factory=dict)
    cards: list[Card] = field(default_factory=list)
    spot: Spot = field(default_factory=lambda: Spot("", 0))

    def model(self, name: str) -> Model | None:
        """Find a model here or further out."""
        model = self.models.get(name)
        return model if model is not None or self.outer is None else self.outer.model(name)

    def home_of_function(self, name: str) -> Block:
        """The block, here or further out, that defines a function; the outermost if none does."""
        return self if name in self.functions or self.outer is None else self.outer.home_of_function(name)

    def block(self, name: str) -> Block | None:
        """Find a subcircuit here or further out."""
        block = self.blocks.get(name)
        return block if block is not None or self.outer is None else self.outer.block(name)


@dataclass
class TemperatureUse:
    """What an evaluation used: the simulation temperature, and a function or operator that does not go with it."""

    used: bool = False
    cold: str = ""

    def add(self, other: TemperatureUse) -> None:
        """Take up what another evaluation used."""
        self.used |= other.used
        self.cold = self.cold or other.cold


@dataclass(eq=False)
class BuiltIns:
    """Reserved names of a dialect and their values in one deck.

    `rules`: the dialect's, with its names; `label`: the simulator's name; `temperature, nominal`: functions that
    return the simulation and the nominal temperature in degrees Celsius, given the deck's own scope; `swept`: names
    that a command sweeps, with the command and its place; `redefined`: a parameter that is defined twice, if there
    is one; `watch`: what the present evaluation used.
    """

    rules: ReadingRules
    label: str
    temperature: Callable[[Scope], float]
    nominal: Callable[[Scope], float]
    swept: Mapping[str, tuple[str, Spot]] = field(default_factory=dict)
    redefined: str = ""
    watch: TemperatureUse = field(default_factory=TemperatureUse)
    _known: dict[str, float] = field(default_factory=dict)
    _busy: bool = False

    @property
    def words(self) -> Words:
        """The dialect's names."""
        return self.rules.words

    def value(self, name: str, scope: Scope) -> float | None:
        """Return the value of a built-in name, or None for other names; raise ReservedNameError where there is none."""
        words = self.words
        if name in words.temperature or name in words.nominal:
            self._refuse_redefined(name, scope, "its temperature")
            return self._celsius(name, scope)
        if name in words.variables:
            raise ReservedNameError(
                f"{name!r} is a reserved name of {self.label} ({words.variables[name]}), which has no value here: "
                f"{'rename the parameter' if scope.defines(name) else 'write the number that is meant'}"
            )
        if name in words.functions:
            text = f"{self.label} takes {name!r} for its function of that name: "
            remedy = "rename the parameter" if scope.defines(name) else f"write {name}(...)"
            raise ReservedNameError(text + remedy)
        if name in self.swept and not scope.defines(name):
            command, place = self.swept[name]
            text = f"{name!r} is given by {command} ({place}) only, which asks for several runs: add .param {name}=..."
            raise ReservedNameError(text)
        if name in words.constants and not scope.defines(name):
            return words.constants[name]
        return None

    def _refuse_redefined(self, name: str, scope: Scope, what: str) -> None:
        if scope.defines(name):
            text = f"{self.label} takes {name!r} for {what}, whatever the deck defines: rename the parameter"
            raise ReservedNameError(text)

    def _celsius(self, name: str, scope: Scope) -> float:
        kind = "nominal" if name in self.words.nominal else "temperature"
        self.watch.used |= kind == "temperature"
        if kind not in self._known:
            if self._busy:
                raise ReservedNameError(f"the temperature of the deck is defined by {name!r} itself: write the number")
            self._busy = True
            try:
                self._known[kind] = getattr(self, kind)(scope.outermost)
            finally:
                self._busy = False
        return self._known[kind]


@dataclass(eq=False)
class Scope:
    """The values that a block's parameters have in one of its uses."""

    block: Block
    diagnostics: Diagnostics
    outer: Scope | None = None
    given: Mapping[str, float] = field(default_factory=dict)
    built_ins: BuiltIns | None = None
    _known: dict[str, float] = field(default_factory=dict)
    _warm: dict[str, TemperatureUse] = field(
        default_factory=dict
    )  # parameters that depend on the simulation temperature
    _busy: list[str] = field(default_factory=list)
    _deep: bool = False
    _calls: int = 0  # of functions, for one value; counted by the outermost scope

    def __post_init__(self) -> None:
        if self.built_ins is None and self.outer is not None:
            self.built_ins = self.outer.built_ins
        # forwards and, for those that refer to later ones, backwards, one step at a time
        for name in (*self.block.parameters, *reversed(self.block.parameters)):
            try:
                self.parameter(name)
            except (ExpressionError, CardError, ReservedNameError):
                continue  # reported where it is used
        self._deep = True
        if self.built_ins is not None and self.built_ins.rules.refusals.idle_parameters:
            self._note_idle()

    def _note_idle(self) -> None:
        """Note definitions without a value, at which the simulator stops whether or not they are needed."""
        idle = [name for name in self.block.parameters if name not in self._known]
        for name in idle[:_MOST_NOTED]:
            definition = self.block.parameters[name]
            try:
                self._value_of(definition, name, self.named)
            except (ExpressionError, CardError, ReservedNameError) as error:
                if "statistical" not in str(error):
                    label = definition.card.rules.name
                    text = f"the parameter {name} has no value, and {label} may stop at it even if nothing needs it"
                    self.diagnostics.doubt(definition.card.spot(definition.token.offset), text)

    def parameter(self, name: str) -> float | None:
        """Value of a parameter, here or further out; None if there is none."""
        if name in self.given:
            return self.given[name]
        if name in self._known:
            if self.built_ins is not None and name in self._warm:
                self.built_ins.watch.add(self._warm[name])
            return self._known[name]
        definition = self.block.parameters.get(name)
        if definition is None:
            return None if self.outer is None else self.outer.parameter(name)
        if name in self._busy:
            raise definition.error(f"parameters define each other in a circle: {' -> '.join([*self._busy, name])}")
        if len(self._busy) >= (MAX_CHAIN if self._deep else 1):
            raise definition.error(f"parameters refer to each other over {MAX_CHAIN} deep")
        self.outermost._calls = 0
        with self.watched() as watch:
            self._known[name] = self._value_of(definition, name, self.named)
        if watch.used:
            self._warm[name] = watch
        return self._known[name]

    def defines(self, name: str) -> bool:
        """Return whether the deck defines a parameter of this name, here or further out."""
        own = name in self.given or name in self.block.parameters
        return own or (self.outer is not None and self.outer.defines(name))

    def named(self, name: str) -> float | None:
        """Return the value of a name in an expression: a built-in one or a parameter; None for unknown names."""
        value = None if self.built_ins is None else self.built_ins.value(name, self)
        return self.parameter(name) if value is None else value

    @contextmanager
    def watched(self) -> Iterator[TemperatureUse]:
        """Record what evaluations within the block use; what depends on the temperature reaches the block around."""
        watch, built_ins = TemperatureUse(), self.built_ins
        if built_ins is None:
            yield watch
            return
        around, built_ins.watch = built_ins.watch, watch
        try:
            yield watch
        finally:
            built_ins.watch = around
            if watch.used:
                around.add(watch)

    def function(self, name: str, values: list[float], lookup: Lookup) -> float | None:
        """Value of a function that the deck defines, None if it does not; ``lookup`` knows names where it is called."""
        home = self.of(self.block.home_of_function(name))
        if home is not self:
            return home.function(name, values, lookup)
        definition = self.block.functions.get(name)
        if definition is None:
            self._note_cold(_shown_call(name, values))
            return None
        key = f"{name}()"
        if len(values) != len(definition.arguments):
            raise definition.error(f"{name} takes {len(definition.arguments)} argument(s), not {len(values)}")
        if key in self._busy or len(self._busy) >= MAX_CHAIN:
            raise definition.error(f"the function {name} calls itself")
        self.outermost._calls += 1
        if self.outermost._calls > MAX_CALLS:
            raise BudgetError(
                f"{definition.card.spot(definition.token.offset)}: one value takes more than {MAX_CALLS:,} calls of "
                "functions that call each other; give what they repeat a parameter of its own"
            )
        given = dict(zip(definition.arguments, values, strict=True))
        further = lookup if definition.card.rules.puts_in_text else self.named
        return self._value_of(definition, key, lambda name: given[name] if name in given else further(name))

    def _value_of(self, definition: Definition, key: str, lookup: Lookup) -> float:
        self._busy.append(key)
        try:
            return self._evaluated(definition.card, definition.token, lookup)
        finally:
            self._busy.pop()

    def _note_cold(self, name: str) -> None:
        """Note a function or operator that the dialect does not have in expressions of the temperature."""
        if self.built_ins is not None and (name in self.built_ins.words.cold or " of " in name):
            self.built_ins.watch.add(TemperatureUse(cold=name))

    def _evaluated(self, card: Card, token: Token, lookup: Lookup) -> float:
        for operator in card.rules.words.cold & set(token.text):
            self._note_cold(operator)
        try:
            return evaluate(token.text, card.rules, lookup, self.function)
        except ExpressionError as error:
            raise card.error(token.offset + error.offset, str(error)) from None

    @property
    def outermost(self) -> Scope:
        """The scope of the deck itself."""
        return self if self.outer is None else self.outer.outermost

    def of(self, block: Block) -> Scope:
        """The scope of a block here or further out."""
        return self if self.block is block or self.outer is None else self.outer.of(block)

    def number(self, card: Card, token: Token, lookup: Lookup | None = None) -> float:
        """Value of a token of a card; ``lookup`` knows the names in formulas, the scope's own if it is None."""
        computed = lookup is not None
        lookup = lookup or self.named
        self.outermost._calls = 0
        if token.kind == "expression" or (token.kind == "string" and (computed or not card.rules.words.drops_quotes)):
            return self._evaluated(card, token, lookup)
        if token.kind == "mark":
            raise card.error(token.offset, f"{token.text!r} was not expected here; a value was")
        numeral = parse_numeral(token.text, card.rules, computed=computed)
        if numeral is None:
            refuse_quotes(card, token)
        if isinstance(numeral, str):
            raise card.error(token.offset, numeral)
        if numeral is not None:
            if numeral.warning:
                self.diagnostics.warn(card.spot(token.offset), numeral.warning)
            return numeral.value
        name = folded_name(token.text, card.rules.instances)
        words = card.rules.words
        if words.temperature_in_values and name in words.temperature:
            raise card.error(
                token.offset, f"{card.rules.name} knows {token.text!r} within braces only: {{{token.text}}}"
            )
        try:
            value = lookup(name)
        except ReservedNameError as reserved:
            raise card.error(token.offset, str(reserved)) from None
        if card.rules.refusals.redefinitions and self.built_ins is not None and self.built_ins.redefined:
            text = (
                f"{card.rules.name} may forget {token.text!r} here, for {self.built_ins.redefined} is defined twice: "
                f"write {{{token.text}}}, or delete the first definition"
            )
            raise card.error(token.offset, text)
        if value is None:
            raise card.error(token.offset, f"{token.text!r} is neither a number nor a parameter nor a known model")
        return value


def _shown_call(name: str, values: list[float]) -> str:
    """Return the name of a function, with what is special in its arguments."""
    if name in ("min", "max") and len(values) == 3:
        return f"{name} of three arguments"
    return f"{name} of a negative number" if name in ("pow", "pwr") and values and values[0] < 0 else name
