"""Blocks (the deck and its subcircuits) with their definitions, and scopes that give values to parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

from resgrid.errors import BudgetError
from resgrid.spice.dialects.record import ReadingRules, Words
from resgrid.spice.read.cards import Card, Setting, Token, refuse_quotes
from resgrid.spice.read.diagnostics import CardError, Diagnostics, Spot
from resgrid.spice.read.expression_functions import shown_call
from resgrid.spice.read.expression_tokens import ExpressionError
from resgrid.spice.read.expressions import Lookup, ReservedNameError, evaluate, folded_name
from resgrid.spice.read.lost_calls import check_calls
from resgrid.spice.read.numerals import parse_numeral
from resgrid.spice.read.unknown_values import in_braces, unknown_value

MAX_CHAIN = 40
"""Maximum length of a chain of parameters in which each refers to one that a later line defines (else CardError)."""

_MOST_NOTED = 5
"""Maximum number of warnings about parameters without a value, per scope (deck or instance of a subcircuit)."""

MAX_CALLS = 10_000
"""Maximum number of calls of the deck's functions during the evaluation of one value; more raise BudgetError."""


@dataclass(frozen=True, eq=False)
class Definition:
    """Definition of a parameter or function.

    `card`: card with the definition; `token`: the expression; `arguments`: names of a function's arguments, else ().
    """

    card: Card
    token: Token
    arguments: tuple[str, ...] = ()

    def error(self, text: str) -> CardError:
        """Return an error with the message `text` at the position of the expression."""
        return self.card.error(self.token.offset, text)


@dataclass(frozen=True, eq=False)
class Model:
    """Content of the ``.model`` card `card`: name, kind, ``key=value`` pairs, and the deck or subcircuit (`block`)."""

    name: str
    kind: str
    settings: tuple[Setting, ...]
    card: Card
    block: Block


@dataclass(eq=False)
class Block:
    """The deck or a subcircuit.

    `name`: name of the subcircuit, empty for the deck; `outer`: the block that contains the definition, None for the
    deck; `ports`: names of the terminals of the subcircuit, as written; `defaults`: names of the parameters in the
    first line of the subcircuit; `parameters`: these parameters and those of ``.param`` lines, by name in lower case;
    `functions, models, blocks`: other definitions by name in lower case; `cards`: the elements; `spot`: position of the
    first line.
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
        """Return the model `name` of this block or of the nearest enclosing block; None if there is no such model.

        `name`: in lower case.
        """
        model = self.models.get(name)
        return model if model is not None or self.outer is None else self.outer.model(name)

    def block_of_function(self, name: str) -> Block:
        """Return the innermost of this block and those around it that defines the function `name`, else the deck."""
        return self if name in self.functions or self.outer is None else self.outer.block_of_function(name)

    def has_function(self, name: str) -> bool:
        """Return whether this block or one around it defines the function `name` (in lower case)."""
        return name in self.block_of_function(name).functions

    def block(self, name: str) -> Block | None:
        """Return the subcircuit `name` (lower case) of this or the nearest enclosing block; None if there is none."""
        block = self.blocks.get(name)
        return block if block is not None or self.outer is None else self.outer.block(name)


@dataclass
class TemperatureUse:
    """Record of the use of the simulation temperature in the evaluation of an expression.

    `used`: whether the value depends on the simulation temperature; `unsupported`: name of a function or operator in
    the expression that the dialect does not support together with the temperature; empty if there is none.
    """

    used: bool = False
    unsupported: str = ""

    def add(self, other: TemperatureUse) -> None:
        """Merge `other`, the record of another evaluation, into this record."""
        self.used |= other.used
        self.unsupported = self.unsupported or other.unsupported


@dataclass(eq=False)
class BuiltIns:
    """Reserved names of a dialect and their values in one deck.

    `rules`: the dialect's rules, which include the names; `label`: the simulator's name; `temperature, nominal`:
    functions that return the simulation and the nominal temperature in degrees Celsius, given the scope of the deck;
    `swept`: command and position, by the name that the command sweeps; `redefined`: name of a parameter that the deck
    defines twice, or empty; `use`: record of the temperature use of the evaluation that is running.
    """

    rules: ReadingRules
    label: str
    temperature: Callable[[Scope], float]
    nominal: Callable[[Scope], float]
    swept: Mapping[str, tuple[str, Spot]] = field(default_factory=dict)
    redefined: str = ""
    use: TemperatureUse = field(default_factory=TemperatureUse)
    _known: dict[str, float] = field(default_factory=dict)
    _busy: bool = False

    @property
    def words(self) -> Words:
        """The reserved names of the dialect."""
        return self.rules.words

    def value(self, name: str, scope: Scope) -> float | None:
        """Return the value of the built-in constant or temperature `name`; None for other names.

        The result is also None for a constant that `scope` redefines as a parameter.  Raises ReservedNameError for a
        built-in variable or function, for a name that only a sweep defines, and for a temperature that the deck
        redefines.
        """
        words = self.words
        if name in words.temperature or name in words.nominal:
            self._refuse_redefined(name, scope, "its temperature")
            return self._celsius(name, scope)
        if name in words.variables:
            raise ReservedNameError(
                f"{name!r} is a reserved name of {self.label} ({words.variables[name]}), which has no value here: "
                f"{'rename the parameter' if scope.defines(name) else 'write a number'}"
            )
        if name in words.functions:
            text = f"{name!r} is a function of {self.label}: "
            remedy = "rename the parameter" if scope.defines(name) else f"write {name}(...)"
            raise ReservedNameError(text + remedy)
        if name in self.swept and not scope.defines(name):
            command, place = self.swept[name]
            text = (
                f"{name!r} is defined only by {command} ({place}), which requests several runs: add .param {name}=..."
            )
            raise ReservedNameError(text)
        if name in words.constants and not scope.defines(name):
            return words.constants[name]
        return None

    def _refuse_redefined(self, name: str, scope: Scope, meaning: str) -> None:
        """Raise ReservedNameError if the deck defines `name`; `meaning`: meaning of the name in the dialect, a text."""
        if scope.defines(name):
            text = f"{self.label} takes {name!r} for {meaning} even if the deck defines it: rename the parameter"
            raise ReservedNameError(text)

    def _celsius(self, name: str, scope: Scope) -> float:
        """Return the simulation or nominal temperature, in degrees Celsius; record that the simulation one is used.

        `name`: reserved name of one of the two temperatures.
        """
        kind = "nominal" if name in self.words.nominal else "temperature"
        self.use.used |= kind == "temperature"
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
    """Values of the parameters of the deck, or of a subcircuit in one of its instances.

    `block`: deck or subcircuit; `diagnostics`: receives errors; `outer`: scope that contains the instance, None for the
    deck; `given`: values that the instance passes, by name in lower case; `built_ins`: reserved names of the dialect,
    None for those of `outer`.
    """

    block: Block
    diagnostics: Diagnostics
    outer: Scope | None = None
    given: Mapping[str, float] = field(default_factory=dict)
    built_ins: BuiltIns | None = None
    _known: dict[str, float] = field(default_factory=dict)
    _temperature_uses: dict[str, TemperatureUse] = field(default_factory=dict)  # of parameters that depend on it
    _busy: list[str] = field(default_factory=list)
    _deep: bool = False
    _calls: int = 0  # of functions during one evaluation; counted by the outermost scope

    def __post_init__(self) -> None:
        if self.built_ins is None and self.outer is not None:
            self.built_ins = self.outer.built_ins
        # in order, then in reverse order for parameters that refer to later ones; each evaluation is one step deep
        for name in (*self.block.parameters, *reversed(self.block.parameters)):
            try:
                self.parameter(name)
            except (ExpressionError, CardError, ReservedNameError):
                continue  # reported where the parameter is used
        self._deep = True
        if self.built_ins is not None and self.built_ins.rules.refusals.idle_parameters:
            self._note_idle()

    def _note_idle(self) -> None:
        """Add at most 5 warnings about parameters without a value, used or not: the simulator may stop at these."""
        idle = [name for name in self.block.parameters if name not in self._known]
        for name in idle[:_MOST_NOTED]:
            definition = self.block.parameters[name]
            try:
                self._value_of(definition, name, self.named)
            except (ExpressionError, CardError, ReservedNameError) as error:
                if "statistical" not in str(error):
                    label = definition.card.rules.name
                    text = f"the parameter {name} has no value, and {label} may stop at it even if it is unused"
                    self.diagnostics.warn_ignored(definition.card.spot(definition.token.offset), text)

    def parameter(self, name: str) -> float | None:
        """Return the value of a parameter in this scope or in the nearest enclosing scope; None if it is undefined.

        `name`: in lower case.  Raises CardError if the definition has no value.
        """
        if name in self.given:
            return self.given[name]
        if name in self._known:
            if self.built_ins is not None and name in self._temperature_uses:
                self.built_ins.use.add(self._temperature_uses[name])
            return self._known[name]
        definition = self.block.parameters.get(name)
        if definition is None:
            return None if self.outer is None else self.outer.parameter(name)
        if name in self._busy:
            raise definition.error(f"parameters define each other in a cycle: {' -> '.join([*self._busy, name])}")
        if len(self._busy) >= (MAX_CHAIN if self._deep else 1):
            raise definition.error(f"parameters refer to each other more than {MAX_CHAIN} deep: define them in order")
        self.outermost._calls = 0
        with self.recorded() as use:
            self._known[name] = self._value_of(definition, name, self.named)
        if use.used:
            self._temperature_uses[name] = use
        return self._known[name]

    def defines(self, name: str) -> bool:
        """Return whether this scope or an enclosing one defines a parameter `name` (in lower case)."""
        own = name in self.given or name in self.block.parameters
        return own or (self.outer is not None and self.outer.defines(name))

    def named(self, name: str) -> float | None:
        """Return the value of a name in an expression: a built-in name, or else a parameter; None if undefined."""
        value = None if self.built_ins is None else self.built_ins.value(name, self)
        return self.parameter(name) if value is None else value

    @contextmanager
    def recorded(self) -> Iterator[TemperatureUse]:
        """Yield a record of the temperature use inside the ``with`` block; enclosing records include this use, too."""
        use, built_ins = TemperatureUse(), self.built_ins
        if built_ins is None:
            yield use
            return
        outer, built_ins.use = built_ins.use, use
        try:
            yield use
        finally:
            built_ins.use = outer
            if use.used:
                outer.add(use)

    def function(self, name: str, values: list[float], lookup: Lookup) -> float | None:
        """Return the value of a function that the deck defines, None if the deck does not define it.

        `name`: in lower case; `values`: values of the arguments; `lookup`: returns the value of a name at the call.
        Dialects that insert functions as text use `lookup` for other names; the others look in the function's block.
        """
        home = self.scope_of(self.block.block_of_function(name))
        if home is not self:
            return home.function(name, values, lookup)
        definition = self.block.functions.get(name)
        if definition is None:
            self._note_unsupported(shown_call(name, values))
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
                "functions that call each other; define a parameter for the repeated part"
            )
        given = dict(zip(definition.arguments, values, strict=True))
        other_names = lookup if definition.card.rules.puts_in_text else self.named
        return self._value_of(definition, key, lambda name: given[name] if name in given else other_names(name))

    def _value_of(self, definition: Definition, key: str, lookup: Lookup) -> float:
        """Return the value of the definition of a parameter or function; raise CardError if it has none.

        `key`: name of the parameter or function on the stack of evaluations, which detects cycles; `lookup`: function
        that returns the value of a name in the definition, or None.
        """
        self._busy.append(key)
        try:
            return self._evaluated(definition.card, definition.token, lookup)
        finally:
            self._busy.pop()

    def _note_unsupported(self, name: str) -> None:
        """Record the function or operator `name` if the dialect does not support it together with the temperature."""
        if self.built_ins is not None and (name in self.built_ins.words.cold or " of " in name):
            self.built_ins.use.add(TemperatureUse(unsupported=name))

    def _evaluated(self, card: Card, token: Token, lookup: Lookup) -> float:
        """Return the value of the expression `token`, a token of `card`; raise CardError at the position of an error.

        `lookup`: function that returns the value of a name, or None.
        """
        for operator in card.rules.words.cold & set(token.text):
            self._note_unsupported(operator)
        try:
            check_calls(card, token, self.block.has_function, self.diagnostics)
            return evaluate(token.text, card.rules, lookup, self.function)
        except ExpressionError as error:
            raise card.error(token.offset + error.offset, str(error)) from None

    @property
    def outermost(self) -> Scope:
        """The scope of the deck itself."""
        return self if self.outer is None else self.outer.outermost

    def scope_of(self, block: Block) -> Scope:
        """Return, of this scope and the scopes around it, that of the deck or subcircuit `block`."""
        return self if self.block is block or self.outer is None else self.outer.scope_of(block)

    def number(self, card: Card, token: Token, lookup: Lookup | None = None) -> float:
        """Return the value of a numeral, name or expression; raise CardError if it has none.

        `token`: a token of `card`; `lookup`: function that returns the value of a name, None to look in this scope.
        """
        computed = lookup is not None
        lookup = lookup or self.named
        self.outermost._calls = 0
        if token.kind == "expression" or (token.kind == "string" and (computed or not card.rules.words.drops_quotes)):
            return self._evaluated(card, token, lookup)
        if token.kind == "mark":
            remedy = f", or an expression in {in_braces('...', card.rules)}" if token.text == "(" else ""
            raise card.error(token.offset, f"unexpected {token.text!r}; expected a value{remedy}")
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
                token.offset, f"{card.rules.name} knows {token.text!r} in braces only: write {{{token.text}}}"
            )
        try:
            value = lookup(name)
        except ReservedNameError as reserved:
            raise card.error(token.offset, str(reserved)) from None
        if card.rules.refusals.redefinitions and self.built_ins is not None and self.built_ins.redefined:
            text = (
                f"{card.rules.name} may lose {token.text!r} here, because {self.built_ins.redefined} is defined twice: "
                f"write {{{token.text}}}, or delete the first definition"
            )
            raise card.error(token.offset, text)
        if value is None:
            raise card.error(token.offset, unknown_value(token.text, card.rules))
        return value
