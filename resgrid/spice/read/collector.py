"""Cards sorted into what a deck says: files included, sections of libraries chosen, other commands noted."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import accumulate, chain, islice

from resgrid.errors import BudgetError, InputError
from resgrid.spice.read import spectre
from resgrid.spice.read.cards import Card, Token, cards, settings, split_positional, tokenise
from resgrid.spice.read.commands import COMMANDS, Contents
from resgrid.spice.read.diagnostics import CardError, DeckError, Spot
from resgrid.spice.read.files import Library, SourceFile, decode
from resgrid.spice.read.plain_cards import PlainCards, plain_lines

MAX_INCLUDES = 20
"""How deep files may include each other."""

MAX_INCLUSIONS = 2000
"""How many times a file may be included, whichever."""

_ANALYSES = frozenset(
    ".op .dc .ac .tran .noise .disto .sens .tf .pz .four .fft .hb .sp .sampling".split()  # noqa: SIM905
)
_OUTPUTS = frozenset(".save .print .plot .probe .meas .measure .width .graph .wave .backanno".split())  # noqa: SIM905
_HARMLESS = _ANALYSES | _OUTPUTS | {".end", ".control"}
"""What may stand after ``.end`` without changing the circuit."""
_HINTS = frozenset(
    ".nodeset .ic .protect .unprotect .prot .unprot .csparam .machine .savebias .loadbias".split()  # noqa: SIM905
)
_SWEEPS = frozenset((".step", ".data", ".enddata", ".mc", ".wcase", ".variation", ".sampling"))
_CONDITIONS = frozenset((".if", ".elseif", ".else", ".endif"))
_BLOCKS = {".control": ".endc", ".data": ".enddata"}
"""Commands whose lines are skipped, and where they end."""
_CHANGING = frozenset(
    "alter altermod alterparam mc_source reset source remcirc codemodel setseed".split()  # noqa: SIM905
)
"""Commands of a control block after which the circuit is another one."""
_SETS_TEMPERATURE = re.compile(r"(set|option|options)\s+temp\b", re.IGNORECASE)
_INCLUSIONS = frozenset((".lib", ".inc", ".include", ".incl"))
_STATEMENTS = frozenset((*COMMANDS, *_ANALYSES, *_OUTPUTS, *_INCLUSIONS, *_HINTS, ".control", ".end"))

_LOOKED_AT = 200
_ELEMENT_LETTERS = frozenset("rvilcsxRVILCSX")


@dataclass(eq=False)
class Collector:
    """Reads the files of a deck; plain cards of its own level go the short way where that is quick."""

    library: Library
    contents: Contents
    quick: bool
    plain: list[PlainCards] = field(default_factory=list)
    _skipping: bool = False
    _including: list[tuple[SourceFile, str | None]] = field(default_factory=list)
    _inclusions: int = 0
    _noted: set[Spot] = field(default_factory=set)

    def deck(self, source: SourceFile) -> None:
        """Collect the deck itself: its first line is a title, unless it is plainly something else."""
        self._note_oddities(source)
        start = source.data.index(b"\n") + 1
        line = decode(source.data[:start])
        continued = source.data[start : start + _LOOKED_AT].lstrip(b" \t\n")[:1] == b"+"
        role = self._role(line, continued)
        lines = self._lines(source, start if role in ("title", "element") else 0)
        if role == "title":
            self.contents.title = line.strip().lstrip("*/" if self.contents.rules.instances else "*").strip() or None
        if role == "element":
            lines = chain([(1, line.rstrip("\n"))], lines)
        stream = self._cards(lines, source)
        if role == "element":
            self.contents.first = next(stream, None)
        if role == "command":
            stream = self._with_first_command(stream)
        self._including.append((source, None))
        self._take(stream, source)
        self._including.pop()

    def _note_oddities(self, source: SourceFile) -> None:
        """Note encodings and line ends that stop the dialect's simulator."""
        rules = self.contents.rules
        for oddity in sorted(source.oddities & rules.refusals.encodings):
            what = "UTF-16" if oddity == "utf-16" else "lines that end in carriage returns alone"
            text = f"{rules.name} does not read {what}: save the file as UTF-8 with line feeds"
            self.contents.diagnostics.refuse(Spot(source.name, 1), text)
        commands = rules.refusals.commands_in_comments
        found = re.search(commands, source.data, re.MULTILINE) if commands else None
        if found is not None:
            spot = Spot(source.name, source.data.count(b"\n", 0, found.start()) + 1)
            text = f"a comment that begins with *# is a command of {rules.name}, which is not run here"
            self.contents.diagnostics.doubt(spot, text)

    def _role(self, line: str, continued: bool) -> str:
        """What a first line is: a title, a command, perhaps an element, or the name of a language."""
        words = line.split()
        if not words or words[0][0] == "*":
            return "title"
        if self.contents.rules.instances:
            if words[0] == "simulator":
                return "language"
            if words[0] in spectre.STATEMENTS:
                return "command"
            return "element" if "=" in line and len(words) > 3 and words[0][:2] != "//" else "title"
        if words[0][0] == ".":
            return "command" if words[0].lower() in _STATEMENTS else "title"
        return "element" if words[0][0] in _ELEMENT_LETTERS and (len(words) > 3 or continued) else "title"

    def _with_first_command(self, stream: Iterator[Card]) -> Iterator[Card]:
        for first in islice(stream, 1):
            if first.first_word != ".title":
                text = "the first line is a command, not a title: it is obeyed; SPICE would ignore it"
                self.contents.diagnostics.warn(first.spot(), text)
            yield first
        yield from stream

    def _cards(self, lines: Iterable[tuple[int, str]], source: SourceFile) -> Iterator[Card]:
        return cards(lines, source, self.contents.rules, self.contents.diagnostics)

    def _lines(self, source: SourceFile, start: int) -> Iterator[tuple[int, str]]:
        """Lines that need a closer look."""
        words = self.contents.rules.words
        misread = words.misread.get("node", frozenset()) | words.common_nodes
        lower = source.data.lower() if self.quick and misread else b""
        if not self.quick or self.contents.rules.instances or any(name.encode() in lower for name in misread):
            return plain_lines(source.data, start)
        self.plain.append(PlainCards(source, start, self.contents.rules))
        return self.plain[-1].other_lines(lambda: len(self.contents.open) == 1 and not self._skipping)

    def _take(self, stream: Iterable[Card], source: SourceFile) -> None:
        contents = self.contents
        depth = len(contents.open)
        end: Card | None = None
        for card in stream:
            try:
                if card.rules.instances:
                    word = spectre.statement_of(card)
                else:
                    word = card.first_word if card.text[0] == "." else ""
                if end is not None and word not in _HARMLESS:
                    self._note_text_after(end)
                if not word:
                    contents.block.cards.append(card)
                    continue
                outcome = self._command(card, word, source, stream)
                if outcome == "stop":
                    break
                if outcome == "end":
                    end = end or card
            except DeckError:
                raise
            except CardError as error:
                contents.diagnostics.error(error)
            except InputError as error:
                contents.diagnostics.error(card.error(0, str(error)))
        begin, end_word = (spectre.word_for(contents.rules, dot) for dot in (".subckt", ".ends"))
        for block in contents.open[depth:]:
            contents.diagnostics.error(CardError(block.spot, f"{begin} {block.name} has no {end_word}"))
        del contents.open[depth:]

    def _note_text_after(self, end: Card) -> None:
        """Note once that ``.end`` ends nothing."""
        if end.spot() not in self._noted:
            text = f"what stands after .end is read, as {end.rules.name} does; others stop here"
            self.contents.diagnostics.warn(end.spot(), text)
        self._noted.add(end.spot())

    def _command(self, card: Card, word: str, source: SourceFile, stream: Iterable[Card]) -> str:
        rules, diagnostics = self.contents.rules, self.contents.diagnostics
        if word == ".end":
            return "end" if rules.end_is_comment else "stop"
        if word in rules.refusals.commands:
            diagnostics.refuse(card.spot(), f"{rules.name} knows no command {word}, and stops at it")
        if word == ".alter":
            if rules.end_is_comment:
                diagnostics.error(card.error(0, f"{rules.name} has no .alter: remove it and what follows"))
            diagnostics.warn(card.spot(), "what follows .alter is another run, and is not read")
            return "stop"
        if word in rules.refusals.foreign_commands:
            diagnostics.doubt(card.spot(), f"the manual of {rules.name} has no command {word}")
        if word in (".step", ".data"):
            self.contents.note_swept(card)
        if word in _BLOCKS:
            self._skip(card, stream, _BLOCKS[word])
        if rules.instances and _opened(card) > 0:
            self._skip_braces(card, stream)
        if word in _INCLUSIONS:
            self._include(card, word, source, stream)
        elif word in COMMANDS:
            COMMANDS[word](self.contents, card)
        else:
            self._note(card, word)
        return ""

    def _note(self, card: Card, word: str) -> None:
        """Note a command that does not change the operating point, or refuse it."""
        diagnostics, shown = self.contents.diagnostics, spectre.command_of(card, word)
        if word == ".control":
            pass  # noted where it is skipped
        elif word == ".ic" and card.rules.holds_initial:
            diagnostics.warn(card.spot(), "HSPICE holds nodes at their .ic; not done here")
        elif word in _ANALYSES or word in _OUTPUTS or word in _HINTS:
            diagnostics.inform(card.spot(), f"{shown} is noted, not obeyed: the operating point is solved")
        elif word in _SWEEPS:
            diagnostics.warn(card.spot(), f"{shown} asks for several runs; the deck is read as it stands")
        elif word in (".endl", ".endc"):
            raise card.error(0, f"{word} ends nothing")
        elif word in _CONDITIONS:
            raise card.error(0, f"conditions ({word}) are not evaluated; keep the branch that is meant")
        else:
            raise card.error(0, f"the command {word[:40]} is not known")

    def _skip(self, card: Card, stream: Iterable[Card], until: str) -> None:
        self._skipping = True
        changing: list[str] = []
        for skipped in stream:
            if skipped.first_word == until:
                break
            if skipped.first_word in _CHANGING or _SETS_TEMPERATURE.match(skipped.text):
                changing.append(skipped.first_word)
        else:
            raise card.error(0, f"{card.text.split()[0]} has no {until}")
        self._skipping = False
        if until == ".endc" and changing:
            text = f"the commands of .control ... .endc are not run: {changing[0]} changes the circuit there, not here"
            self.contents.diagnostics.doubt(card.spot(), text)
        elif until == ".endc":
            self.contents.diagnostics.inform(card.spot(), "the commands of .control ... .endc are not run")

    def _skip_braces(self, card: Card, stream: Iterable[Card]) -> None:
        if not any(depth <= 0 for depth in accumulate(map(_opened, chain([card], stream)))):
            raise card.error(0, f"the brace of {card.text.split()[0]} is not closed")

    def _include(self, card: Card, word: str, source: SourceFile, stream: Iterable[Card]) -> None:
        words, section, place = _file_and_section(card, word)
        if len(words) != 1:
            more = " and perhaps a section" if word == ".lib" else ""
            raise card.error(0, f"{spectre.command_of(card, word)} needs the name of one file{more}")
        if word == ".lib" and section is None and b".endl" in source.data.lower():
            self._skip(card, stream, ".endl")  # a section that was not asked for
            return
        path, name = self.library.find(words[0].text, source)
        if any(other.path == path and part in (None, section) for other, part in self._including):
            circle = " -> ".join([other.name for other, _ in self._including] + [name])
            raise card.error(words[0].offset, f"files include each other in a circle: {circle}")
        if len(self._including) >= MAX_INCLUDES:
            raise card.error(words[0].offset, f"files include each other more than {MAX_INCLUDES} deep")
        self._inclusions += 1
        if self._inclusions > MAX_INCLUSIONS:
            raise BudgetError(
                f"{card.spot(words[0].offset)}: more than {MAX_INCLUSIONS:,} files are included; let each file be "
                "included once"
            )
        inner = self.library.open(path, name)
        self._note_oddities(inner)
        if section is None:
            included = self._cards(self._lines(inner, 0), inner)
        else:
            included = self._section(inner, section, card.spot(place))
        self._including.append((inner, section))
        try:
            self._take(included, inner)
        finally:
            self._including.pop()

    def _section(self, source: SourceFile, section: str, asked: Spot) -> Iterator[Card]:
        """Cards between ``.lib section`` and ``.endl``; in Spectre, ``section`` and ``endsection``."""
        begin, end = ("section", "endsection") if self.contents.rules.instances else (".lib", ".endl")
        inside = exists = False
        for card in self._cards(plain_lines(source.data, 0), source):
            words = card.text.lower().split()
            if words[0] == end:
                inside = False
            elif words[0] == begin and len(words) == 2 and not inside:
                inside = words[1].strip("'\"") == section
                exists |= inside
            elif inside:
                yield card
        if not exists:
            self.contents.diagnostics.error(CardError(asked, f"{source.name} has no section {section!r}"))


def _opened(card: Card) -> int:
    """How many braces it opens and does not close."""
    return card.text.count("{") - card.text.count("}")


def _file_and_section(card: Card, word: str) -> tuple[list[Token], str | None, int]:
    """Words that an inclusion names a file by, the section of it that is meant, and where that stands."""
    if card.rules.instances:
        words, tail = split_positional(tokenise(card)[1:])
        pairs = {pair.key: pair for pair in settings(card, tail)}
        section = pairs.pop("section", None)
        if pairs:
            raise card.error(next(iter(pairs.values())).offset, "only section= is understood here")
        return (words, None, 0) if section is None else (words, section.values[0].text.lower(), section.offset)
    quoted = any(mark in card.text for mark in "\"'")
    bare = [Token("word", match.group(), match.start()) for match in re.finditer(r"\S+", card.text)]
    words = (tokenise(card) if quoted else bare)[1:]
    if len(words) == 2 and word == ".lib":
        return words[:1], words[1].text.lower(), words[1].offset
    return words, None, 0
