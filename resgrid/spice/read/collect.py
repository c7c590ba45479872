"""Cards sorted into blocks: what dot commands say, files included, sections of libraries chosen."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain

from resgrid.errors import BudgetError, InputError
from resgrid.spice.read.cards import Card, Token, cards, settings, split_positional, tokenise
from resgrid.spice.read.diagnostics import CardError, Journal, Spot, TooManyErrorsError
from resgrid.spice.read.files import Library, Source, decode
from resgrid.spice.read.options import Options
from resgrid.spice.read.plain import Bulk, plain_lines, scan
from resgrid.spice.read.rules import ReadingRules
from resgrid.spice.read.scopes import Block, Definition, Model

MAX_INCLUDES = 20
"""How deep files may include each other."""

MAX_INCLUSIONS = 2000
"""How many times a file may be included, whichever."""

_ANALYSES = frozenset(
    (
        ".op",
        ".dc",
        ".ac",
        ".tran",
        ".noise",
        ".disto",
        ".sens",
        ".tf",
        ".pz",
        ".four",
        ".fft",
        ".hb",
        ".sp",
        ".sampling",
    )
)
_OUTPUTS = frozenset(
    (".save", ".print", ".plot", ".probe", ".meas", ".measure", ".width", ".graph", ".wave", ".backanno")
)
_HARMLESS = _ANALYSES | _OUTPUTS | {".end", ".control"}
"""What may stand after ``.end`` without changing the circuit."""
_HINTS = frozenset(
    (".nodeset", ".ic", ".preprocess", ".protect", ".unprotect", ".prot", ".unprot", ".csparam", ".machine")
)
_SWEEPS = frozenset((".step", ".data", ".enddata", ".mc", ".wcase", ".variation", ".sampling"))
_CONDITIONS = frozenset((".if", ".elseif", ".else", ".endif"))


@dataclass(eq=False)
class Collector:
    """What was gathered from the files of a deck."""

    library: Library
    rules: ReadingRules
    journal: Journal
    quick: bool
    top: Block = field(default_factory=lambda: Block(""))
    bulks: list[tuple[Source, Bulk]] = field(default_factory=list)
    title: str | None = None
    first: Card | None = None
    common: set[str] = field(default_factory=set)
    options: Options = field(init=False)
    _stack: list[Block] = field(default_factory=list)
    _open: list[tuple[Source, str | None]] = field(default_factory=list)
    _inclusions: int = 0
    _told: set[Spot] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.options = Options(self.rules, self.journal)

    def deck(self, source: Source) -> None:
        """Collect the deck itself: its first line is a title, unless it is plainly something else."""
        self._stack = [self.top]
        start = source.data.index(b"\n") + 1
        line = _first_line(source.data[:start])
        continued = source.data[start : start + _LOOKED_AT].lstrip(b" \t\n")[:1] == b"+"
        has_title = not _could_be_statement(line, continued)
        if has_title:
            self.title = line.strip().lstrip("*").strip() or None
        aside = not has_title and line.lstrip()[0] != "."
        lines = self._lines(source, start if has_title or aside else 0)
        if aside:
            lines = chain([(1, line.rstrip("\n"))], lines)
        stream = cards(lines, source.number, source.name, self.rules, self.journal)
        if not has_title:
            stream = self._without_first(stream)
        self._open.append((source, None))
        self._take(stream, source)
        self._open.pop()

    def _without_first(self, stream: Iterator[Card]) -> Iterator[Card]:
        """Keep a first line that may be an element aside; a first line that is a command is one."""
        first = next(stream, None)
        if first is None:
            return
        if first.text[0] != ".":
            self.first = first
        elif first.text.split()[0].lower() == ".title":
            self.title = first.text.split(maxsplit=1)[1] if " " in first.text else None
        else:
            self.journal.note(
                "warning", first.spot(), "the first line is a command, not a title: it is obeyed; SPICE would ignore it"
            )
            yield first
        yield from stream

    def _lines(self, source: Source, start: int) -> Iterator[tuple[int, str]]:
        """Lines that need a closer look; plain cards of the deck's own level go the short way."""
        bulk = None
        if self.quick and len(self._stack) == 1:
            bulk = scan(source.data, start, self.rules)
        if bulk is None:
            return plain_lines(source.data, start)
        self.bulks.append((source, bulk))
        return bulk.others(source.data)

    def _take(self, stream: Iterable[Card], source: Source) -> None:
        depth = len(self._stack)
        end: Card | None = None
        for card in stream:
            if end is not None and card.text.split(maxsplit=1)[0].lower() not in _HARMLESS:
                self._note_text_after(end)
            try:
                if card.text[0] != ".":
                    self._stack[-1].cards.append(card)
                    continue
                outcome = self._command(card, source, stream)
                if outcome == "stop":
                    break
                if outcome == "end":
                    end = end or card
            except TooManyErrorsError:
                raise
            except CardError as error:
                self.journal.error(error)
            except InputError as error:
                self.journal.error(card.error(0, str(error)))
        if end is not None and any((bulk.line > end.line).any() for origin, bulk in self.bulks if origin is source):
            self._note_text_after(end)
        for block in self._stack[depth:]:
            self.journal.error(CardError(block.spot, f".subckt {block.name} has no .ends"))
        del self._stack[depth:]

    def _note_text_after(self, end: Card) -> None:
        """Say once that ``.end`` ends nothing."""
        if end.spot() not in self._told:
            text = f"what stands after .end is read, as {self.rules.name} does; others stop here"
            self.journal.note("warning", end.spot(), text)
        self._told.add(end.spot())

    def _command(self, card: Card, source: Source, stream: Iterable[Card]) -> str:
        word = card.text.split(maxsplit=1)[0].lower()
        if word == ".end":
            return "end" if self.rules.end_is_comment else "stop"
        if word == ".alter":
            if self.rules.end_is_comment:
                self.journal.error(card.error(0, f"{self.rules.name} has no .alter: remove it and what follows"))
            self.journal.note("warning", card.spot(), "what follows .alter is another run, and is not read")
            return "stop"
        if word == ".control":
            self._skip(card, stream, ".endc")
            self.journal.note("info", card.spot(), "the commands of .control ... .endc are not run")
        elif word in (".lib", ".inc", ".include", ".incl"):
            self._include(card, word, source, stream)
        elif word in _COMMANDS:
            _COMMANDS[word](self, card)
        elif word in (".endl", ".endc"):
            raise card.error(0, f"{word} ends nothing")
        elif word in _ANALYSES or word in _OUTPUTS or word in _HINTS:
            self._ignored(card, word)
        elif word in _SWEEPS:
            if word == ".data":
                self._skip(card, stream, ".enddata")
            self.journal.note("warning", card.spot(), f"{word} asks for several runs; the deck is read as it stands")
        elif word in _CONDITIONS:
            raise card.error(0, f"conditions ({word}) are not evaluated; keep the branch that is meant")
        else:
            raise card.error(0, f"the command {word[:40]} is not known")
        return ""

    def _ignored(self, card: Card, word: str) -> None:
        if word == ".preprocess" and "replaceground" in card.text.lower() and "true" in card.text.lower():
            self.options.values["replaceground"] = "true"
        elif word == ".ic" and self.rules.name == "hspice":
            self.journal.note("warning", card.spot(), "HSPICE holds nodes at their .ic; not done here")
        else:
            self.journal.note("info", card.spot(), f"{word} is noted, not obeyed: the operating point is solved")

    def _skip(self, card: Card, stream: Iterable[Card], until: str) -> None:
        for skipped in stream:
            if skipped.text.split(maxsplit=1)[0].lower() == until:
                return
        raise card.error(0, f"{card.text.split()[0]} has no {until}")

    def _include(self, card: Card, word: str, source: Source, stream: Iterable[Card]) -> None:
        words = tokenise(card)[1:] if any(q in card.text for q in "\"'") else _bare_words(card)
        section = words[1].text.lower() if len(words) == 2 and word == ".lib" else None
        if len(words) != 1 and section is None:
            raise card.error(
                0, f"{word} needs the name of one file" + (" and perhaps a section" if word == ".lib" else "")
            )
        if word == ".lib" and section is None and b".endl" in source.data.lower():
            self._skip(card, stream, ".endl")  # a section that was not asked for
            return
        path, name = self.library.find(words[0].text, source)
        if any(other.path == path and wanted in (None, section) for other, wanted in self._open):
            circle = " -> ".join([other.name for other, _ in self._open] + [name])
            raise card.error(words[0].offset, f"files include each other in a circle: {circle}")
        if len(self._open) >= MAX_INCLUDES:
            raise card.error(words[0].offset, f"files include each other more than {MAX_INCLUDES} deep")
        self._inclusions += 1
        if self._inclusions > MAX_INCLUSIONS:
            raise BudgetError(
                f"{card.spot(words[0].offset)}: more than {MAX_INCLUSIONS:,} files are included; let each file be "
                "included once"
            )
        inner = self.library.open(path, name)
        if section is None:
            stream = cards(self._lines(inner, 0), inner.number, inner.name, self.rules, self.journal)
        else:
            stream = self._section(inner, section, card.spot(words[1].offset))
        self._open.append((inner, section))
        try:
            self._take(stream, inner)
        finally:
            self._open.pop()

    def _section(self, source: Source, section: str, asked: Spot) -> Iterator[Card]:
        """Cards between ``.lib section`` and ``.endl``."""
        inside = found = False
        for card in cards(plain_lines(source.data, 0), source.number, source.name, self.rules, self.journal):
            words = card.text.lower().split()
            if words[0] == ".endl":
                inside = False
            elif words[0] == ".lib" and len(words) == 2 and not inside:
                inside = words[1].strip("'\"") == section
                found |= inside
            elif inside:
                yield card
        if not found:
            self.journal.error(CardError(asked, f"{source.name} has no section {section!r}"))

    def _subcircuit(self, card: Card) -> None:
        tokens = [token for token in tokenise(card)[1:] if not (token.kind == "mark" and token.text in "()")]
        positional, tail = split_positional(tokens)
        if positional and positional[-1].text.lower() == "params:":
            positional = positional[:-1]
        if not positional or any(token.kind != "word" for token in positional):
            raise card.error(0, ".subckt needs a name and its terminals")
        outer = self._stack[-1]
        name = positional[0]
        block = Block(name.text, outer, [token.text for token in positional[1:]], spot=card.spot())
        self._stack.append(block)
        folded = [port.lower() for port in block.ports]
        if len(set(folded)) != len(folded):
            raise card.error(name.offset, f"the subcircuit {name.text} has two terminals of one name")
        if not self.rules.grounds.isdisjoint(folded):
            raise card.error(
                name.offset, f"the subcircuit {name.text} has ground among its terminals; ground is global"
            )
        if name.text.lower() in outer.blocks:
            raise card.error(name.offset, f"the subcircuit {name.text} is defined twice")
        outer.blocks[name.text.lower()] = block
        for setting in settings(card, tail):
            block.defaults.add(setting.key)
            token = setting.values[0]
            block.parameters[setting.key] = Definition(token.text, card, token.offset)

    def _ends(self, card: Card) -> None:
        if len(self._stack) == 1:
            raise card.error(0, f"{card.text.split()[0]} ends nothing")
        block = self._stack.pop()
        words = card.text.split()
        if len(words) > 1 and words[1].lower() != block.name.lower():
            raise card.error(0, f"{words[0]} {words[1]} ends the subcircuit {block.name}: one is missing, or misspelt")

    def _parameters(self, card: Card) -> None:
        block = self._stack[-1]
        tokens = tokenise(card)[1:]
        if any(token.kind == "mark" and token.text == "(" for token in tokens):
            self._function(card)
            return
        for setting in settings(card, tokens):
            token = setting.values[0]
            if setting.key in block.parameters:
                self.journal.note("warning", card.spot(setting.offset), "a parameter is defined again: the last counts")
            block.parameters[setting.key] = Definition(token.text, card, token.offset)

    def _function(self, card: Card) -> None:
        """``.func f(x, y) {body}`` and ``.param f(x, y) = 'body'``."""
        tokens = tokenise(card)[1:]
        texts = [token.text if token.kind in ("mark", "word") else "" for token in tokens]
        if len(tokens) < 4 or texts[1] != "(" or ")" not in texts:
            raise card.error(0, "a function is defined like this: .func f(x) {2*x}")
        close = texts.index(")")
        body = [token for token in tokens[close + 1 :] if not (token.kind == "mark" and token.text == "=")]
        if len(body) != 1 or body[0].kind == "mark":
            raise card.error(body[0].offset if body else 0, "the body of a function stands in braces or quotes, once")
        arguments = tuple(text.lower() for text in texts[2:close])
        self._stack[-1].functions[texts[0].lower()] = Definition(body[0].text, card, body[0].offset, arguments)

    def _model(self, card: Card) -> None:
        tokens = tokenise(card)[1:]
        if len(tokens) < 2 or tokens[0].kind != "word" or tokens[1].kind != "word":
            raise card.error(0, ".model needs a name and a kind")
        models = self._stack[-1].models
        name = tokens[0].text.lower()
        if name in models:
            counts = "first" if self.rules.first_counts else "last"
            self.journal.note("warning", card.spot(), f"a model is defined again: the {counts} one counts")
            if self.rules.first_counts:
                return
        kind = tokens[1].text.lower()
        try:
            keys = tuple(settings(card, tokens[2:]))
        except CardError:
            if kind in ("r", "res", "sw", "vswitch"):
                raise
            keys = ()
        models[name] = Model(tokens[0].text, kind, keys, card, self._stack[-1])

    def _global(self, card: Card) -> None:
        self.common.update(word.lower() for word in card.text.split()[1:])

    def _temperature(self, card: Card) -> None:
        self.options.read_temperature(card)

    def _options(self, card: Card) -> None:
        self.options.read(card)

    def _titled(self, card: Card) -> None:
        self.title = card.text.split(maxsplit=1)[1] if " " in card.text.strip() else self.title

    def _refuse_connect(self, card: Card) -> None:
        raise card.error(0, ".connect is not understood; join the two nodes by a source of 0 V")


_COMMANDS: dict[str, Callable[[Collector, Card], None]] = {
    ".subckt": Collector._subcircuit,
    ".macro": Collector._subcircuit,
    ".ends": Collector._ends,
    ".eom": Collector._ends,
    ".param": Collector._parameters,
    ".params": Collector._parameters,
    ".parameters": Collector._parameters,
    ".global_param": Collector._parameters,
    ".func": Collector._function,
    ".model": Collector._model,
    ".global": Collector._global,
    ".temp": Collector._temperature,
    ".option": Collector._options,
    ".options": Collector._options,
    ".opt": Collector._options,
    ".title": Collector._titled,
    ".connect": Collector._refuse_connect,
}


_LOOKED_AT = 200
_ELEMENT_LETTERS = frozenset("rvilcsxRVILCSX")
_STATEMENTS = frozenset((*_COMMANDS, *_ANALYSES, *_OUTPUTS, ".lib", ".inc", ".include", ".control", ".end", *_HINTS))


def _first_line(data: bytes) -> str:
    return decode(data)


def _could_be_statement(line: str, continued: bool) -> bool:
    """Whether a first line may be more than a title: a known command, or a name and at least three words more."""
    words = line.split()
    if not words or words[0][0] == "*":
        return False
    if words[0][0] == ".":
        return words[0].lower() in _STATEMENTS
    return words[0][0] in _ELEMENT_LETTERS and (len(words) >= 4 or continued)


def _bare_words(card: Card) -> list[Token]:
    words: list[Token] = []
    offset = 0
    for word in card.text.split():
        offset = card.text.index(word, offset)
        words.append(Token("word", word, offset))
        offset += len(word)
    return words[1:]
