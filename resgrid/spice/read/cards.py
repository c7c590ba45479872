"""Lexer of decks: lines to cards, cards to tokens.

A card is one statement.  Comments are removed and continuation lines joined; line and column of every character are
kept.  Tokens are words, marks, expressions and strings.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

from resgrid.spice.dialects.record import ReadingRules
from resgrid.spice.read.diagnostics import CardError, Diagnostics, Spot
from resgrid.spice.read.files import SourceFile

Line = tuple[int, str]
"""Pair of the number of a line in its file, counted from 1, and the text of the line."""

_LANGUAGE = re.compile(r"\s*simulator\s+lang\s*=\s*(\w+)\s*")


@dataclass(frozen=True, eq=False)
class Card:
    """A card, which is one statement of a deck: a line and its continuation lines.

    `text`: the lines joined by blanks, without comments; `file`: index of the file among the files of the deck; `name`:
    name of the file for messages; `rules`: reading rules of the dialect; `joins`: for each line the offset of its first
    character in `text`, and the line number and column of this character in the file, counted from 1.
    """

    text: str
    file: int
    name: str
    rules: ReadingRules
    joins: tuple[tuple[int, int, int], ...]

    @property
    def line(self) -> int:
        """Number of the card's first line in the file, counted from 1."""
        return self.joins[0][1]

    @property
    def first_word(self) -> str:
        """The first word of the card, in lower case."""
        return self.text.split(maxsplit=1)[0].lower()

    def spot(self, offset: int | None = None) -> Spot:
        """Return the position in the file of the character at `offset` in `text`; None means the whole card."""
        if offset is None:
            return Spot(self.name, self.line)
        start, line, column = next(join for join in reversed(self.joins) if join[0] <= max(offset, 0))
        return Spot(self.name, line, column + max(offset, 0) - start)

    def error(self, offset: int | None, text: str) -> CardError:
        """Return an error with the message `text` at the offset `offset` in this card's text; None: the whole card."""
        return CardError(self.spot(offset), text)


def cards(lines: Iterable[Line], source: SourceFile, rules: ReadingRules, diagnostics: Diagnostics) -> Iterator[Card]:
    """Yield the cards (statements) that some lines form; skip blank lines and comments.

    The Spectre statement ``simulator lang=spice`` (or ``spectre``) is skipped, too, and changes the rules for the lines
    after it.  `lines`: number (counted from 1) and text of each line; `source`: the file that contains the lines;
    `rules`: reading rules of the dialect; `diagnostics`: receives errors and warnings.
    """
    pieces: list[tuple[int, int, str]] = []
    language, glued = rules, False
    for number, line in lines:
        text = strip_comment(line, language)
        bare = text.strip()
        if not bare:
            glued = glued and not language.instances  # Spectre's mark joins the next line, and there is nothing on it
            continue
        column = len(text) - len(text.lstrip()) + 1
        if text.lstrip(" \t")[0] in "\f\v":
            words = "a form feed or vertical tab begins this line, which ngspice then skips or rejects: remove it"
            diagnostics.error(CardError(Spot(source.name, number, column - 1), words))
        if not text.isascii():
            _check_letters(text.rstrip(" \t"), Spot(source.name, number), source, language, diagnostics)
        change = _LANGUAGE.fullmatch(text) if rules.spice is not None and not glued else None
        continues = bare[0] == "+"
        if (continues or glued) and not pieces:
            diagnostics.error(
                CardError(
                    Spot(source.name, number, column),
                    "there is no card that this line (+) continues: remove the + or add the card",
                )
            )
            continue
        if pieces and not (continues or glued):
            yield _joined(pieces, source, language)
            pieces = []
        if change is not None:
            if change[1] not in ("spectre", "spice"):
                text = f"the language {change[1]!r} is not read; spectre and spice are"
                raise CardError(Spot(source.name, number, column), text)
            language = rules if change[1] == "spectre" else rules.spice or rules
            continue
        if continues and not glued:
            bare, column = bare[1:], column + 1
        mark = "\\" if language.instances else "\\\\"
        glued = bare.endswith(mark)
        bare = bare.removesuffix(mark).rstrip() if glued else bare
        if pieces or bare.strip():
            pieces.append((number, column, bare))
        else:
            glued = False
    if pieces:
        yield _joined(pieces, source, language)


_WIDE_BLANK = re.compile(r"[^\S\x00-\x7f]")
_MICRO = "\N{MICRO SIGN}"


def _check_letters(text: str, spot: Spot, source: SourceFile, rules: ReadingRules, diagnostics: Diagnostics) -> None:
    """Add an error for a non-ASCII blank in a line, and a warning for letters that may stop the dialect's simulator.

    These are non-ASCII letters in general, or only those of a file in Latin-1.  `text`: the line; `spot`: position of
    the line; `source`: the file; `rules`: rules of the dialect; `diagnostics`: receives the error and the warning.
    """
    blank = _WIDE_BLANK.search(text)
    if blank is not None:
        place, character = Spot(spot.file, spot.line, blank.start() + 1), f"U+{ord(blank.group()):04X}"
        words = f"a non-ASCII blank ({character}): simulators read it as a letter; replace it by a blank"
        diagnostics.error(CardError(place, words))
    letters = {letter for letter in text if letter > "\x7f"} - {_MICRO}
    latin = max(letters, default="") <= "\xff" and text.encode() not in source.data
    if letters and latin and "latin-1" in rules.refusals.encodings:
        text = f"{rules.name} stops at non-ASCII letters that are not UTF-8: save the file as UTF-8"
        diagnostics.refuse(spot, text)
    elif letters and rules.refusals.letters:
        diagnostics.warn_ignored(spot, f"{rules.name} may not read non-ASCII letters")


def _joined(pieces: list[tuple[int, int, str]], source: SourceFile, rules: ReadingRules) -> Card:
    """Return the card that consists of a line and its continuation lines.

    `pieces`: a tuple for each of these lines: line number, column of the first character (both counted from 1), and
    text without comment; `source`: the file; `rules`: reading rules of the dialect.
    """
    joins: list[tuple[int, int, int]] = []
    offset = 0
    for line, column, text in pieces:
        joins.append((offset, line, column))
        offset += len(text) + 1
    return Card(" ".join([text for *_, text in pieces]), source.number, source.name, rules, tuple(joins))


_DOLLAR = re.compile(r"(?:^|[\s,])\$")


def strip_comment(line: str, rules: ReadingRules) -> str:
    """Return a line without its comment, empty for a line that is a comment; `rules`: reading rules of the dialect.

    Examples
    --------
    >>> from resgrid.spice.dialects import DIALECTS
    >>> strip_comment("R1 a 0 1k ; load", DIALECTS["ngspice"].reading)
    'R1 a 0 1k '
    """
    if line.lstrip()[:1] == "*":
        return ""
    ends = [place for mark in rules.comments if (place := line.find(mark)) >= 0]
    if rules.dollar_comments and "$" in line and (match := _DOLLAR.search(line)):
        ends.append(match.end() - 1)
    return line[: min(ends)] if ends else line


_TOKEN = re.compile(
    r"[\s,]*(?:\{(?P<expression>[^{}]*)\}|'(?P<quoted>[^']*)'|\"(?P<string>[^\"]*)\"|(?P<mark>[=()])"
    r"|(?P<word>[^\s=(),{}'\"]+)|(?P<wrong>[{}'\"]))"
)


class Token(NamedTuple):
    """A token of a card.

    `kind`: "word", "mark" (``=``, ``(`` or ``)``), "expression" (in braces or single quotes) or "string" (in double
    quotes); `text`: characters of the token without quotes or braces; `offset`: position in the text of the card.
    """

    kind: str
    text: str
    offset: int

    def is_mark(self, text: str) -> bool:
        """Return whether the token is a mark whose character is in `text`, such as ``"()"``."""
        return self.kind == "mark" and self.text in text


def tokenise(card: Card) -> list[Token]:
    """Return the tokens of a card, separated by blanks or commas; raise CardError for an unbalanced quote or brace."""
    tokens = _split(card.text)
    for token in tokens:
        if token.kind == "wrong":
            raise card.error(token.offset, f"{token.text!r} is unbalanced: add or remove one")
    return list(tokens)


@lru_cache(maxsize=8192)
def _split(text: str) -> tuple[Token, ...]:
    """Return the tokens of a card's text; a quote or brace without its partner becomes a token of kind "wrong"."""
    found = ((match.lastgroup or "", match) for match in _TOKEN.finditer(text))
    return tuple(
        [Token("expression" if kind == "quoted" else kind, match[kind], match.start(kind)) for kind, match in found]
    )


def refuse_quotes(card: Card, token: Token) -> None:
    """Raise CardError if the value `token` is in double quotes and the dialect's simulator drops such quotes."""
    if token.kind == "string" and card.rules.words.drops_quotes:
        raise card.error(token.offset, f"{card.rules.name} misreads a value in double quotes: write it in braces")


def without_parentheses(tokens: Iterable[Token]) -> list[Token]:
    """Return the given tokens without parentheses, in the same order."""
    return [token for token in tokens if not token.is_mark("()")]


class Setting(NamedTuple):
    """A ``key=value`` pair of a card.

    `key`: the key in lower case; `offset`: position of the key in the text of the card; `values`: tokens of one or
    several values.
    """

    key: str
    offset: int
    values: tuple[Token, ...]


def settings(card: Card, tokens: list[Token], several: frozenset[str] = frozenset()) -> list[Setting]:
    """Return the ``key=value`` pairs that `tokens`, a part of the tokens of `card`, consist of; ignore parentheses.

    `several`: keys that may have several values, up to the next key; other keys have one.  Raises CardError for tokens
    of another form.
    """
    if card.rules.instances:
        return _unquoted_settings(card, tokens)
    plain = without_parentheses(tokens)
    pairs: list[Setting] = []
    i = 0
    while i < len(plain):
        key = plain[i]
        if key.kind != "word" or not _begins_pair(plain, i):
            raise card.error(key.offset, f"unexpected {key.text!r}; expected key=value")
        first = i + 2
        i = first + 1
        if key.text.lower() in several:
            while i < len(plain) and not _begins_pair(plain, i):
                i += 1
        values = tuple(plain[first:i])
        if not values or values[0].kind == "mark":
            raise card.error(key.offset, f"{key.text!r} has no value")
        pairs.append(Setting(key.text.lower(), key.offset, values))
    return pairs


_WORD = re.compile(r"[+-]?[\d.]+(?:[eE][+-]?\d+)?\w*|[^\W\d]\w*")
_KEY = re.compile(r"([^\W\d]\w*)\s*=(?!=)\s*")


def _unquoted_settings(card: Card, tokens: list[Token]) -> list[Setting]:
    """Return the ``key=value`` pairs of a Spectre card; a value without quotes ends where the next key begins.

    `tokens`: the tokens of the card from the first key on.
    """
    if not tokens:
        return []
    begin = tokens[0].offset
    if tokens[0].kind == "mark" or _KEY.match(card.text, begin) is None:
        raise card.error(begin, f"unexpected {tokens[0].text!r}; expected key=value")
    keys = list(_KEY.finditer(card.text, begin))
    pairs: list[Setting] = []
    for key, stop in zip(keys, [*(key.start() for key in keys[1:]), len(card.text)], strict=True):
        value = card.text[key.end() : stop].strip()
        if not value:
            raise card.error(key.start(), f"{key[1]!r} has no value")
        token = Token("word" if _WORD.fullmatch(value) else "expression", value, key.end())
        pairs.append(Setting(key[1].lower(), key.start(), (token,)))
    return pairs


def _begins_pair(tokens: list[Token], i: int) -> bool:
    """Return whether the token after ``tokens[i]`` is ``=``, so that ``tokens[i]`` may be a key."""
    return i + 1 < len(tokens) and tokens[i + 1].is_mark("=")


def split_positional(tokens: list[Token]) -> tuple[list[Token], list[Token]]:
    """Return two lists of tokens: those before the first ``key=``, and all others, from that key on."""
    first = next((i for i in range(len(tokens)) if tokens[i].kind == "word" and _begins_pair(tokens, i)), len(tokens))
    return tokens[:first], tokens[first:]


def split_call(tokens: list[Token]) -> tuple[list[Token], list[Token]]:
    """Return two lists of tokens of a ``.subckt`` line or an instance: the positional ones and the ``key=value`` ones.

    Parentheses and the word ``params:`` are left out.  `tokens`: tokens of the card, without the word ``.subckt``.
    """
    positional, tail = split_positional(tokens)
    positional = without_parentheses(positional)
    if positional and positional[-1].text.lower() == "params:":
        positional.pop()
    opened = sum(token.is_mark("(") - token.is_mark(")") for token in tail)
    return positional, tail[:-1] if opened < 0 and tail[-1].is_mark(")") else tail


def joined_names(card: Card, tokens: list[Token], count: int) -> list[Token]:
    """Return `tokens`, the tokens of `card`, with names in parentheses such as ``Net-(R1-Pad2)`` as single tokens.

    Only some dialects have such names; for the others the tokens are returned unchanged.  `count`: number of leading
    tokens of the result that may be such names.
    """
    if not card.rules.words.joins_brackets or "(" not in card.text:
        return tokens
    joined: list[Token] = []
    i = 0
    while i < len(tokens):
        stop = i + 1
        if len(joined) < count and tokens[i].kind == "word":
            while stop + 2 < len(tokens) and _is_tight(tokens[stop - 1 : stop + 3]):
                stop += 3
        end = tokens[stop - 1].offset + len(tokens[stop - 1].text)
        joined.append(
            tokens[i] if stop == i + 1 else Token("word", card.text[tokens[i].offset : end], tokens[i].offset)
        )
        i = stop
    return joined


def _is_tight(tokens: list[Token]) -> bool:
    """Return whether four tokens are a word and, without gaps, a word in parentheses, such as ``net(1)``."""
    kinds = [token.text if token.kind == "mark" else token.kind for token in tokens]
    adjoin = all(after.offset == token.offset + len(token.text) for token, after in pairwise(tokens))
    return kinds[1:] == ["(", "word", ")"] and adjoin
