"""Content of a deck (`Contents`) and the dot commands that change it, such as ``.subckt`` and ``.param``.

The commands define subcircuits, parameters, functions, models, global nodes, options, temperatures and the title.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field

from resgrid.spice.dialects import DIALECTS
from resgrid.spice.dialects.record import ReadingRules
from resgrid.spice.read.assignments import assignments, misplaced_comma
from resgrid.spice.read.cards import Card, Setting, Token, refuse_quotes, settings, split_call, tokenise
from resgrid.spice.read.diagnostics import CardError, Diagnostics, Spot
from resgrid.spice.read.expressions import folded_name
from resgrid.spice.read.models import RESISTOR_KINDS, SWITCH_KINDS
from resgrid.spice.read.scopes import Block, BuiltIns, Definition, Model, Scope
from resgrid.spice.read.spectre import word_for

_WITH_UNIT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?[A-Za-z]*")
_PLAIN_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


@dataclass(eq=False)
class Contents:
    """The content of a deck, sorted by kind of statement.

    `rules`: reading rules of the dialect; `diagnostics`: collected errors, warnings and notes; `top`: the block of the
    deck itself (a block is the deck or a subcircuit); `open`: the blocks that contain the line being read, `top` first;
    `title`: title of the deck, None if it has no title; `first`: card of a first line that may be an element, otherwise
    None; `global_nodes`: names of the global nodes, in lower case; `grounds`: names of ground; `options`: values of the
    options by name in lower case, ``""`` for a flag.
    """

    rules: ReadingRules
    diagnostics: Diagnostics
    top: Block = field(default_factory=lambda: Block(""))
    open: list[Block] = field(init=False)
    title: str | None = None
    first: Card | None = None
    global_nodes: set[str] = field(default_factory=set)
    grounds: frozenset[str] = field(init=False)
    options: dict[str, str] = field(default_factory=dict)
    _temperatures: dict[str, tuple[Card, Token]] = field(default_factory=dict)
    _spellings: dict[str, str] = field(default_factory=dict)
    _swept: dict[str, tuple[str, Spot]] = field(default_factory=dict)
    _redefined: str = ""

    def __post_init__(self) -> None:
        self.open = [self.top]
        self.grounds = self.rules.grounds
        self.global_nodes |= self.rules.words.common_nodes

    @property
    def block(self) -> Block:
        """The innermost open block: the subcircuit whose lines are being read, or the deck."""
        return self.open[-1]

    def temperature(self, key: str, scope: Scope) -> float | None:
        """Return the deck's temperature for `key`, in degrees Celsius; None if the deck states none or it has an error.

        `key`: ``temp`` for the simulation temperature, ``tnom`` for the nominal one.  `scope`: the scope of the deck.
        """
        try:
            return self._stated(key, scope)
        except CardError as error:
            self.diagnostics.error(error)
            return None

    def _stated(self, key: str, scope: Scope) -> float | None:
        """Return a temperature that the deck states, in degrees Celsius; None if the deck does not state it.

        `key`: ``temp`` for the simulation temperature, ``tnom`` for the nominal one; `scope`: the scope of the deck.
        """
        stated = self._temperatures.get(f".{key}") or self._temperatures.get(key)
        return None if stated is None else scope.number(*stated)

    def built_ins(self) -> BuiltIns:
        """Return the dialect's reserved names (constants, variables, temperatures) with their values in this deck."""
        dialect = DIALECTS[self.rules.name]

        def nominal(scope: Scope) -> float:
            """Return the deck's nominal temperature, in degrees Celsius, by default that of the dialect."""
            stated = self._stated("tnom", scope)
            return dialect.nominal_temperature if stated is None else stated

        def temperature(scope: Scope) -> float:
            """Return the deck's simulation temperature, in degrees Celsius, by default the dialect's nominal one."""
            stated = self._stated("temp", scope)
            return dialect.nominal_temperature if stated is None else stated

        return BuiltIns(self.rules, dialect.label, temperature, nominal, self._swept, self._redefined)

    def note_swept(self, card: Card) -> None:
        """Record the names of the parameters that a command sweeps; `card`: the command, such as ``.step``."""
        command, *words = card.text.lower().split()
        self._swept.update({word: (command, card.spot()) for word in words if word.isidentifier()})

    def _spell(self, card: Card, name: str, offset: int) -> None:
        """Raise CardError in a case-sensitive dialect if an earlier name of the deck differs from `name` only by case.

        The names are those of subcircuits and parameters.  `offset`: position of `name` in the text of `card`.
        """
        if card.rules.instances and self._spellings.setdefault(name.lower(), name) != name:
            other = self._spellings[name.lower()]
            raise card.error(
                offset, f"{name} and {other} are two names in {card.rules.name}, but one name here: rename one"
            )

    def _subcircuit(self, card: Card) -> None:
        """Begin the subcircuit of a ``.subckt`` card, and record its name, terminals and default parameters."""
        positional, tail = split_call(tokenise(card)[1:])
        if not positional or any(token.kind != "word" for token in positional):
            raise card.error(0, f"{word_for(card.rules, '.subckt')} needs a name and its terminals")
        outer = self.block
        name = positional[0]
        block = Block(name.text, outer, [token.text for token in positional[1:]], spot=card.spot())
        self.open.append(block)
        self._spell(card, name.text, name.offset)
        self.refuse_misread(card, "subcircuit", positional[:1])
        self.refuse_misread(card, "node", positional[1:])
        folded = [port.lower() for port in block.ports]
        if len(set(folded)) != len(folded):
            raise card.error(name.offset, f"the subcircuit {name.text} has two terminals of one name")
        if name.text.lower() in outer.blocks:
            raise card.error(name.offset, f"the subcircuit {name.text} is defined twice")
        outer.blocks[name.text.lower()] = block
        pairs = assignments(card, tail)
        self.note_comma(card, pairs)
        for setting in pairs:
            self._refuse_name(card, setting.key, setting.offset)
            if setting.key in block.parameters:
                self._note_redefined(card, setting)
            block.defaults.add(setting.key)
            block.parameters[setting.key] = Definition(card, setting.values[0])

    def note_comma(self, card: Card, pairs: list[Setting]) -> None:
        """Add a warning if a comma directly after a value makes the dialect's simulator hang.

        `pairs`: the definitions ``key=value`` of `card`.
        """
        place = misplaced_comma(card, pairs) if card.rules.refusals.commas else None
        if place is not None:
            text = f"{card.rules.name} does not terminate at a comma directly after a value: write a blank instead"
            self.diagnostics.refuse(card.spot(place), text)

    def _refuse_name(self, card: Card, key: str, offset: int) -> None:
        """Raise CardError if the dialect does not allow the name `key` for a parameter, argument or function.

        `offset`: position of the name in the text of `card`.
        """
        words, label = card.rules.words, DIALECTS[card.rules.name].label
        name = card.text[offset : offset + len(key)]
        if re.fullmatch(words.parameter, name) is None:
            text = f"{name!r} is not a valid parameter name in {label}: use letters, digits and underscores"
            raise card.error(offset, text)
        if folded_name(name, card.rules.instances) in words.undefinable:
            raise card.error(offset, f"{name!r} is a reserved name of {label}: rename the parameter")

    def refuse_misread(self, card: Card, kind: str, names: list[Token]) -> None:
        """Raise CardError if the dialect's simulator misreads one of some names.

        `kind`: use of the names, "node", "model" or "subcircuit"; `names`: tokens of the names in `card`.
        """
        misread = card.rules.words.misread.get(kind, frozenset())
        for token in names:
            if token.text.lower() in misread:
                raise card.error(token.offset, f"{card.rules.name} misreads a {kind} called {token.text!r}: rename it")

    def _ends(self, card: Card) -> None:
        """End the innermost open subcircuit, as the card ``.ends`` demands.

        Raises CardError if no subcircuit is open, or if the card names another one.
        """
        words = card.text.split()
        if len(self.open) == 1:
            raise card.error(0, f"{words[0]} closes no open subcircuit: remove it, or add the missing beginning")
        block = self.open.pop()
        if len(words) > 1 and words[1].lower() != block.name.lower():
            raise card.error(0, f"{words[0]} {words[1]} closes the subcircuit {block.name}: one is missing or misspelt")

    def _parameters(self, card: Card) -> None:
        """Add the definitions of a ``.param`` card to the innermost open subcircuit, or to the deck outside of all."""
        tokens = tokenise(card)[1:]
        if len(tokens) > 1 and tokens[0].kind == "word" and tokens[1].is_mark("(") and not card.rules.instances:
            self._function(card)
            return
        parameters = self.block.parameters
        pairs = assignments(card, tokens, blanks=True)
        self.note_comma(card, pairs)
        for setting in pairs:
            refuse_quotes(card, setting.values[0])
            self._refuse_name(card, setting.key, setting.offset)
            self._spell(card, card.text[setting.offset : setting.offset + len(setting.key)], setting.offset)
            if setting.key in parameters:
                self._note_redefined(card, setting)
            parameters[setting.key] = Definition(card, setting.values[0])

    def _note_redefined(self, card: Card, setting: Setting) -> None:
        """Warn that `setting` defines a parameter again; raise CardError in a dialect that forbids redefinitions."""
        if card.rules.instances:
            raise card.error(setting.offset, f"the parameter {setting.key} is defined twice: delete one definition")
        self._redefined = self._redefined or setting.key
        self.diagnostics.warn(card.spot(setting.offset), "a parameter is defined again: the last definition counts")

    def _function(self, card: Card) -> None:
        """Add the function of a card to the innermost open subcircuit, or to the deck outside of all.

        The forms are ``.func f(x, y) {body}`` and ``.param f(x, y) = 'body'``.
        """
        tokens = tokenise(card)[1:]
        texts = [token.text if token.kind in ("mark", "word") else "" for token in tokens]
        if len(tokens) < 4 or texts[1] != "(" or ")" not in texts:
            raise card.error(0, "the definition of a function must have the form .func f(x) {2*x}")
        close = texts.index(")")
        body = tokens[close + 1 :]
        body = body[1:] if body and body[0].is_mark("=") else body
        arguments = tuple(text.lower() for text in texts[2:close])
        for token in (tokens[0], *tokens[2:close]):
            self._refuse_name(card, token.text, token.offset)
        name, words = texts[0].lower(), card.rules.words
        if name in words.functions | card.rules.functions.keys() and not words.redefines_functions:
            text = f"{texts[0]} is a function of {DIALECTS[card.rules.name].label} itself: rename the function"
            raise card.error(tokens[0].offset, text)
        expression = self._body(card, body)
        called = [
            argument for argument in arguments if re.search(rf"\b{argument}\s*\(", expression.text, re.IGNORECASE)
        ]
        if called and card.rules.puts_in_text:
            text = f"{card.rules.name} also replaces the function {called[0]} by the argument: rename the argument"
            raise card.error(expression.offset, text)
        self.block.functions[name] = Definition(card, expression, arguments)

    def _body(self, card: Card, body: list[Token]) -> Token:
        """Return the expression that defines a function as one token; raise CardError if it lacks necessary quotes.

        `card`: the definition; `body`: tokens of the definition after the argument list and an equals sign.
        """
        if len(body) == 1 and body[0].kind != "mark":
            refuse_quotes(card, body[0])
            return body[0]
        loose = body and all(token.kind in ("word", "mark") for token in body)
        if not loose or not card.rules.words.loose_functions:
            raise card.error(
                body[0].offset if body else 0, "the body of a function must be one expression in braces or quotes"
            )
        begin, end = body[0].offset, body[-1].offset + len(body[-1].text)
        return Token("expression", card.text[begin:end], begin)

    def _model(self, card: Card) -> None:
        """Add the model of a ``.model`` card to the innermost open subcircuit, or to the deck outside of all."""
        tokens = tokenise(card)[1:]
        if len(tokens) < 2 or tokens[0].kind != "word" or tokens[1].kind != "word":
            raise card.error(0, f"{word_for(card.rules, '.model')} needs a name and a kind")
        models, name, kind = self.block.models, tokens[0].text.lower(), tokens[1].text.lower()
        if kind in RESISTOR_KINDS:
            self.refuse_misread(card, "model", tokens[:1])
        if name in models:
            counts = "first" if self.rules.first_counts else "last"
            self.diagnostics.warn(card.spot(), f"a model is defined again: the {counts} definition counts")
            if self.rules.first_counts:
                return
        try:
            keys = tuple(settings(card, tokens[2:]))
        except CardError:
            if kind in RESISTOR_KINDS | SWITCH_KINDS:
                raise
            keys = ()
        models[name] = Model(tokens[0].text, kind, keys, card, self.block)

    def _global(self, card: Card) -> None:
        """Add the node names of a ``.global`` card to the global nodes, which all subcircuits share.

        In Spectre, the first name is another name of ground.
        """
        names = [word.lower() for word in card.text.split()[1:]]
        if card.rules.instances and names:  # the first one is ground
            self.grounds |= {names.pop(0)}
        self.global_nodes.update(names)

    def _title(self, card: Card) -> None:
        """Set the title of the deck to the text of a ``.title`` card."""
        self.title = card.text.split(maxsplit=1)[1] if " " in card.text.strip() else self.title

    def _connect(self, card: Card) -> None:
        """Raise CardError because ``.connect`` is not supported."""
        raise card.error(0, ".connect is not supported; connect the two nodes by a source of 0 V")

    def _options(self, card: Card) -> None:
        """Record the options of an ``.option`` card; set the temperatures from its keys ``temp`` and ``tnom``."""
        tokens = tokenise(card)[1 + card.rules.instances :]
        seen: set[str] = set()
        i = 0
        while i < len(tokens):
            key = tokens[i].text.lower()
            keyed = i + 2 < len(tokens) and tokens[i + 1].is_mark("=")
            if key not in seen or not self.rules.first_counts:
                self._set_option(key, card, tokens[i], tokens[i + 2] if keyed else None)
            seen.add(key)
            i += 3 if keyed else 1
        self.diagnostics.inform(card.spot(), "options are recorded, but only temp and tnom are applied")

    def _set_option(self, key: str, card: Card, token: Token, value: Token | None) -> None:
        """Record one option of an ``.option`` card.

        `key`: name of the option in lower case; `token`: token of the name; `value`: token of the value, None for a
        flag.
        """
        option = word_for(card.rules, ".option")
        if key in self.rules.refused_options:
            raise card.error(
                token.offset, f"{option} {key} adds elements, which is not supported: add them to the deck"
            )
        if key in DIALECTS[self.rules.name].quirks.shunt_options:
            text = f"{option} {key} connects every node to ground, which is ignored here"
            self.diagnostics.warn(card.spot(token.offset), text)
        self.options[key] = "" if value is None else value.text
        if key in ("temp", "tnom") and value is not None:
            self._set_temperature(key, card, value)

    def _temperature(self, card: Card) -> None:
        """Record the temperature of a ``.temp`` card; raise CardError if the card has none."""
        tokens = tokenise(card)[1:]
        if not tokens:
            raise card.error(0, ".temp needs a temperature")
        if len(tokens) > 1:
            if self.rules.braced_temperatures:
                text = f"{self.rules.name} ignores .temp with several temperatures: give one"
                raise card.error(tokens[1].offset, text)
            self.diagnostics.warn(card.spot(), ".temp requests several runs; the first temperature counts")
        self._set_temperature(".temp" if self.rules.temp_command_first else "temp", card, tokens[0])

    def _set_temperature(self, key: str, card: Card, token: Token) -> None:
        """Record `token`, a temperature on `card`, which is evaluated later, when all parameters are known.

        `key`: ``temp`` (simulation) or ``tnom`` (nominal temperature), or ``.temp`` for the command in a dialect where
        the command overrides the option.  Raises CardError for a form that the dialect's simulator ignores.
        """
        unit = _WITH_UNIT.match(token.text) if token.kind == "word" and key[0] != "." else None
        if unit is not None and self.rules.braced_temperatures:  # ngspice drops all text after a number and its suffix
            token = token._replace(text=unit.group())
        elif token.kind == "word" and self.rules.braced_temperatures and _PLAIN_NUMBER.fullmatch(token.text) is None:
            text = f"{self.rules.name} ignores a temperature that is not a plain number: write it in braces"
            raise card.error(token.offset, text)
        self._temperatures[key] = (card, token)

    def _preprocess(self, card: Card) -> None:
        """Apply ``.preprocess replaceground true``: ``gnd``, ``gnd!`` and ``ground`` become names of ground.

        For other preprocessing, a note states that it is ignored.
        """
        words = card.text.lower()
        if "replaceground" in words and "true" in words:
            self.grounds = frozenset({"0", "gnd", "gnd!", "ground"})
        else:
            self.diagnostics.inform(card.spot(), ".preprocess is ignored: the operating point is solved")


COMMANDS: dict[str, Callable[[Contents, Card], None]] = {
    ".subckt": Contents._subcircuit,
    ".macro": Contents._subcircuit,
    ".ends": Contents._ends,
    ".eom": Contents._ends,
    ".param": Contents._parameters,
    ".params": Contents._parameters,
    ".parameters": Contents._parameters,
    ".global_param": Contents._parameters,
    ".func": Contents._function,
    ".model": Contents._model,
    ".global": Contents._global,
    ".temp": Contents._temperature,
    ".option": Contents._options,
    ".options": Contents._options,
    ".opt": Contents._options,
    ".title": Contents._title,
    ".connect": Contents._connect,
    ".preprocess": Contents._preprocess,
}
"""Methods of `Contents` that apply a command which changes the circuit, by the command in lower case."""
