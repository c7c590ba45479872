"""Collection of the cards (statements) of a deck from its file, include files and library sections.

Elements are collected; commands are applied, noted as ignored, or rejected.
"""

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
"""Maximum nesting depth of include files; deeper nesting is an error of the deck."""

MAX_INCLUSIONS = 2000
"""Maximum number of inclusions of files in one deck, repeated ones included; more raise BudgetError."""

_ANALYSES = frozenset(
    ".op .dc .ac .tran .noise .disto .sens .tf .pz .four .fft .hb .sp .sampling".split()  # noqa: SIM905
)
_OUTPUTS = frozenset(".save .print .plot .probe .meas .measure .width .graph .wave .backanno".split())  # noqa: SIM905
_HARMLESS = _ANALYSES | _OUTPUTS | {".end", ".control"}
"""Commands that may follow ``.end`` without a warning, because they do not change the circuit."""
_HINTS = frozenset(
    ".nodeset .ic .protect .unprotect .prot .unprot .csparam .machine .savebias .loadbias".split()  # noqa: SIM905
)
_SWEEPS = frozenset((".step", ".data", ".enddata", ".mc", ".wcase", ".variation", ".sampling"))
_CONDITIONS = frozenset((".if", ".elseif", ".else", ".endif"))
_BLOCKS = {".control": ".endc", ".data": ".enddata"}
"""Last command of a group of lines that is skipped, by the first command of the group."""
_CHANGING = frozenset(
    "alter altermod alterparam mc_source reset source remcirc codemodel setseed".split()  # noqa: SIM905
)
"""Commands of a control block (``.control`` to ``.endc``) that change the circuit."""
_SETS_TEMPERATURE = re.compile(r"(set|option|options)\s+temp\b", re.IGNORECASE)
_INCLUSIONS = frozenset((".lib", ".inc", ".include", ".incl"))
_STATEMENTS = frozenset((*COMMANDS, *_ANALYSES, *_OUTPUTS, *_INCLUSIONS, *_HINTS, ".control", ".end"))

_LOOKED_AT = 200
"""Number of bytes after the first line of a deck that are searched for a ``+``, which continues the first line."""

_FORMS = {
    "utf-16": "UTF-16",
    "cr": "lines that end in carriage returns alone",
    "bom": "a byte order mark at the beginning of an included file",
}
"""Descriptions, for messages, of encodings and line ends that some simulators do not read, by a short key."""

_ELEMENT_LETTERS = frozenset("rvilcsxRVILCSX")


@dataclass(eq=False)
class Collector:
    """The reader of a deck's files, which collects the cards (statements) and applies the commands.

    `library`: files of the deck, which opens include files; `contents`: receives the cards; `quick`: True if lines of
    the form ``name node node value`` (plain cards) outside subcircuits are read in bulk, False if each is read like
    other cards, with the same result; `plain`: the plain cards that were read in bulk, one entry for each file.
    """

    library: Library
    contents: Contents
    quick: bool
    plain: list[PlainCards] = field(default_factory=list)
    _skipping: bool = False
    _including: list[tuple[SourceFile, str | None]] = field(default_factory=list)
    _inclusions: int = 0
    _noted: set[Spot] = field(default_factory=set)

    def deck(self, source: SourceFile) -> None:
        """Collect the cards (statements) of the deck file `source` and of the files that it includes.

        The first line is the title unless it is a command or may be an element; the latter is decided later.
        """
        self._note_encoding(source, begins=False)
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

    def _note_encoding(self, source: SourceFile, *, begins: bool) -> None:
        """Add warnings about encodings, line ends and comments that the dialect's simulator treats differently.

        `source`: the file to examine; `begins`: True for an included file whose first line is read, where a byte order
        mark is reported; False for the deck's own file, or if the first line of an included file is skipped.
        """
        rules = self.contents.rules
        harmless = set[str]() if begins else {"bom"}
        for oddity in sorted(source.oddities & rules.refusals.encodings - harmless):
            text = f"{rules.name} does not read {_FORMS[oddity]}: save the file as UTF-8 with line feeds"
            self.contents.diagnostics.refuse(Spot(source.name, 1), text)
        commands = rules.refusals.commands_in_comments
        found = re.search(commands, source.data, re.MULTILINE) if commands else None
        if found is not None:
            spot = Spot(source.name, source.data.count(b"\n", 0, found.start()) + 1)
            text = f"a comment that begins with *# is a command of {rules.name}, which is not run here"
            self.contents.diagnostics.warn_ignored(spot, text)

    def _role(self, line: str, continued: bool) -> str:
        """Return the role of the first line of a deck: "title", "command", "element" or "language".

        An "element" is a line that looks like an element card and may still be the title; "language" is the statement
        ``simulator lang=...`` of Spectre.  `line`: the first line; `continued`: whether the second line continues it.
        """
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
        """Yield all cards of `stream`; add a warning if the first one is a command, except ``.title``."""
        for first in islice(stream, 1):
            if first.first_word != ".title":
                text = "the first line is a command, not a title: it is applied; SPICE would ignore it"
                self.contents.diagnostics.warn(first.spot(), text)
            yield first
        yield from stream

    def _cards(self, lines: Iterable[tuple[int, str]], source: SourceFile) -> Iterator[Card]:
        """Yield the cards (statements) that some lines of a file form; `lines`: number and text of each line."""
        return cards(lines, source, self.contents.rules, self.contents.diagnostics)

    def _lines(self, source: SourceFile, start: int) -> Iterator[tuple[int, str]]:
        """Return the numbers (counted from 1) and texts of the lines of a file from the byte offset `start` on.

        Lines of the form ``name node node value`` (plain cards) are left out if they are read in bulk; `plain` then
        holds their elements.  `source`: the file.
        """
        words = self.contents.rules.words
        misread = words.misread.get("node", frozenset()) | words.common_nodes
        lower = source.data.lower() if self.quick and misread else b""
        if not self.quick or self.contents.rules.instances or any(name.encode() in lower for name in misread):
            return plain_lines(source.data, start)
        self.plain.append(PlainCards(source, start, self.contents.rules))
        return self.plain[-1].other_lines(lambda: len(self.contents.open) == 1 and not self._skipping)

    def _take(self, stream: Iterable[Card], source: SourceFile) -> None:
        """Collect the cards of a file: apply commands, and add elements to the innermost subcircuit that is not closed.

        Outside subcircuits, elements are added to the deck.  Errors are collected; one reports each subcircuit that the
        file opens and does not close.  `stream`: the cards; `source`: the file that contains the cards.
        """
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
        """Add a warning that cards after ``.end`` are read, because the dialect's simulator reads them, too.

        `end`: the card ``.end``, for which at most one warning is added.
        """
        if end.spot() not in self._noted:
            text = f"cards after .end are read, as in {end.rules.name}; other simulators stop here"
            self.contents.diagnostics.warn(end.spot(), text)
        self._noted.add(end.spot())

    def _command(self, card: Card, word: str, source: SourceFile, stream: Iterable[Card]) -> str:
        """Apply a command; return "stop" or "end" if the deck ends at the command, otherwise an empty string.

        After "stop" no further card is read; after "end" (in dialects that read on after ``.end``) the next element
        causes a warning.  `card`: the card of the command; `word`: the command in lower case; `source`: the file that
        contains the card; `stream`: the cards after it.
        """
        rules, diagnostics = self.contents.rules, self.contents.diagnostics
        if word == ".end":
            return "end" if rules.end_is_comment else "stop"
        if word in rules.refusals.commands:
            diagnostics.refuse(card.spot(), f"{rules.name} has no command {word}, and stops at it")
        if word == ".alter":
            if rules.end_is_comment:
                diagnostics.error(card.error(0, f"{rules.name} has no .alter: remove it and the cards after it"))
            diagnostics.warn(card.spot(), "cards after .alter describe another run, and are not read")
            return "stop"
        if word in rules.refusals.foreign_commands:
            diagnostics.warn_ignored(card.spot(), f"the manual of {rules.name} has no command {word}")
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
        """Add a note that a command is ignored; raise CardError for conditions, stray ends of blocks, unknown commands.

        `card`: the card of the command; `word`: the command in lower case.
        """
        diagnostics, shown = self.contents.diagnostics, spectre.command_of(card, word)
        if word == ".control":
            pass  # noted where it is skipped
        elif word == ".ic" and card.rules.holds_initial:
            diagnostics.warn(card.spot(), "HSPICE holds nodes at their .ic; it is ignored here")
        elif word in _ANALYSES or word in _OUTPUTS or word in _HINTS:
            diagnostics.inform(card.spot(), f"{shown} is ignored: the operating point is solved")
        elif word in _SWEEPS:
            diagnostics.warn(card.spot(), f"{shown} requests several runs; only the deck's own values are read")
        elif word in (".endl", ".endc"):
            raise card.error(0, f"{word} closes no open block: remove it, or add the missing beginning")
        elif word in _CONDITIONS:
            raise card.error(0, f"conditions ({word}) are not evaluated; keep only the branch that applies")
        else:
            raise card.error(0, f"unknown command {word[:40]}")

    def _skip(self, card: Card, stream: Iterable[Card], until: str) -> None:
        """Skip the cards of `stream` up to the command `until`; raise CardError if that command is missing.

        For a control block (``.control`` to ``.endc``), a note states that its commands are not run; the note is a
        warning if one of them would change the circuit.  `card`: the card that begins the skipped group.
        """
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
            text = f"the commands of .control ... .endc are not run: {changing[0]} would change the circuit"
            self.contents.diagnostics.warn_ignored(card.spot(), text)
        elif until == ".endc":
            self.contents.diagnostics.inform(card.spot(), "the commands of .control ... .endc are not run")

    def _skip_braces(self, card: Card, stream: Iterable[Card]) -> None:
        """Skip the cards of `stream` up to the closing brace of the block that `card` opens."""
        if not any(depth <= 0 for depth in accumulate(map(_opened, chain([card], stream)))):
            raise card.error(0, f"the brace of {card.text.split()[0]} is not closed")

    def _include(self, card: Card, word: str, source: SourceFile, stream: Iterable[Card]) -> None:
        """Collect the cards of the include file or library section that `card` names.

        A ``.lib`` card that begins the definition of a section is skipped, with the cards up to ``.endl``.  `word`: the
        command in lower case; `source`: the file that contains `card`; `stream`: the cards after `card`.
        """
        words, section, place = _file_and_section(card, word)
        if len(words) != 1:
            more = " and perhaps a section" if word == ".lib" else ""
            raise card.error(0, f"{spectre.command_of(card, word)} needs the name of one file{more}")
        if word == ".lib" and section is None:
            self._note_library(card, "without the name of a section")
            if b".endl" in source.data.lower():
                self._skip(card, stream, ".endl")  # a section that is defined here, and not included
                return
        path, name = self.library.find(words[0].text, source, starts=card.rules.parameters_first)
        if any(other.path == path and part in (None, section) for other, part in self._including):
            circle = " -> ".join([other.name for other, _ in self._including] + [name])
            raise card.error(words[0].offset, f"files include each other in a cycle: {circle}")
        if len(self._including) >= MAX_INCLUDES:
            raise card.error(words[0].offset, f"include files are nested more than {MAX_INCLUDES} deep")
        self._inclusions += 1
        if self._inclusions > MAX_INCLUSIONS:
            raise BudgetError(
                f"{card.spot(words[0].offset)}: more than {MAX_INCLUSIONS:,} files are included; include each file once"
            )
        inner = self.library.open(path, name)
        self._note_encoding(inner, begins=section is None or inner.data[:4].lower() == b".lib")
        if section is None:
            included = self._cards(self._lines(inner, 0), inner)
        else:
            included = self._section(inner, section, card.spot(place))
        self._including.append((inner, section))
        try:
            self._take(included, inner)
        finally:
            self._including.pop()

    def _note_library(self, card: Card, form: str) -> None:
        """Add a warning that the dialect's simulator stops at a form of ``.lib`` card, in dialects where this is so.

        `form`: text for the form of `card`, such as "without the name of a section".
        """
        if card.rules.refusals.loose_libraries:
            text = f"{card.rules.name} stops at .lib {form}"
            self.contents.diagnostics.refuse(card.spot(), text)

    def _section(self, source: SourceFile, section: str, asked: Spot) -> Iterator[Card]:
        """Yield the cards of a library section: those between ``.lib section`` and ``.endl`` (Spectre: ``endsection``).

        `source`: the library file; `section`: name in lower case; `asked`: position of the request, for the error about
        a missing section.
        """
        begin, end = ("section", "endsection") if self.contents.rules.instances else (".lib", ".endl")
        inside = exists = False
        opening: Card | None = None
        for card in self._cards(plain_lines(source.data, 0), source):
            words = card.text.lower().split()
            if words[0] == end:
                inside = False
            elif words[0] == begin and len(words) == 2 and not inside:
                inside = words[1].strip("'\"") == section
                if inside and exists and self.contents.rules.first_counts:
                    text = f"the section {section} is defined again, and {card.rules.name} reads only the first one"
                    self.contents.diagnostics.warn(card.spot(), text)
                    inside = False
                exists |= inside
                opening = card
            elif inside:
                yield card
        if inside and opening is not None:
            self._note_library(opening, f"{section} without {end}")
        if not exists:
            self.contents.diagnostics.error(CardError(asked, f"{source.name} has no section {section!r}"))


def _opened(card: Card) -> int:
    """Return the number of opening braces in a card minus the number of closing braces."""
    return card.text.count("{") - card.text.count("}")


def _file_and_section(card: Card, word: str) -> tuple[list[Token], str | None, int]:
    """Return an inclusion's file name as tokens, the section's name or None, and the offset of that name in the card.

    `word`: the command in lower case.  The offset is 0 without a section.
    """
    if card.rules.instances:
        words, tail = split_positional(tokenise(card)[1:])
        pairs = {pair.key: pair for pair in settings(card, tail)}
        section = pairs.pop("section", None)
        if pairs:
            raise card.error(next(iter(pairs.values())).offset, "only section= is supported here")
        return (words, None, 0) if section is None else (words, section.values[0].text.lower(), section.offset)
    quoted = any(mark in card.text for mark in "\"'")
    bare = [Token("word", match.group(), match.start()) for match in re.finditer(r"\S+", card.text)]
    words = (tokenise(card) if quoted else bare)[1:]
    if len(words) == 2 and word == ".lib":
        return words[:1], words[1].text.lower(), words[1].offset
    return words, None, 0
