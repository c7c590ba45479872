"""On which line of a TOML document each key stands; tomllib does not say."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

Path = tuple[str | int, ...]

_TOKEN = re.compile(
    r'''
      (?P<blank> [ \t\r]+ | \#[^\n]* )
    | (?P<text> """(?:\\.|[^\\])*?"{3,5} | \'\'\'.*?\'{3,5} | "(?:\\.|[^"\\])*" | '[^']*' )
    | (?P<mark> [\[\]{},=.\n] )
    | (?P<bare> [^\s\[\]{},=."'\#]+ )
    ''',
    re.VERBOSE | re.DOTALL,
)


class _Token(NamedTuple):
    text: str
    line: int


def key_lines(text: str) -> dict[Path, int]:
    """Line of every table, key and array element of a TOML document that is known to be valid."""
    return _Scanner(text).run()


def line_of(lines: Mapping[Path, int], path: Path) -> int | None:
    """Line of a key path, or of the nearest thing around it."""
    for length in range(len(path), 0, -1):
        if path[:length] in lines:
            return lines[path[:length]]
    return None


def _tokens(text: str) -> list[_Token]:
    tokens, line = [], 1
    for match in _TOKEN.finditer(text):
        if match.lastgroup != "blank":
            tokens.append(_Token(match[0], line))
        line += match[0].count("\n")
    return tokens


class _Scanner:
    """Walks once through the tokens of a document."""

    def __init__(self, text: str) -> None:
        self.tokens = [*_tokens(text), _Token("", 0)]
        self.at = 0
        self.lines: dict[Path, int] = {}
        self.tables: dict[Path, int] = {}

    def run(self) -> dict[Path, int]:
        prefix: Path = ()
        while self.skip_lines():
            if self.peek() == "[":
                prefix = self.header()
            else:
                self.pair(prefix)
        return self.lines

    def peek(self) -> str:
        return self.tokens[self.at].text

    def take(self) -> _Token:
        self.at += 1
        return self.tokens[self.at - 1]

    def skip_lines(self) -> str:
        """The next token that is no end of a line."""
        while self.peek() == "\n":
            self.at += 1
        return self.peek()

    def header(self) -> Path:
        line = self.take().line
        is_array = self.peek() == "["
        self.at += is_array
        parts = self.key()
        self.at += 1 + is_array
        if is_array:
            path = (*self.resolved(parts[:-1]), parts[-1])
            self.lines.setdefault(path, line)
            self.tables[path] = self.tables.get(path, -1) + 1
        path = self.resolved(parts)
        self.lines.setdefault(path, line)
        return path

    def resolved(self, parts: list[str]) -> Path:
        """A key path with the numbers of the last tables of arrays in it."""
        path: Path = ()
        for part in parts:
            path = (*path, part)
            if path in self.tables:
                path = (*path, self.tables[path])
        return path

    def key(self) -> list[str]:
        parts = [self.take().text.strip("'\"")]
        while self.peek() == ".":
            self.at += 1
            parts.append(self.take().text.strip("'\""))
        return parts

    def pair(self, path: Path) -> None:
        line = self.tokens[self.at].line
        for part in self.key():
            path = (*path, part)
            self.lines.setdefault(path, line)
        self.at += 1
        self.value(path)

    def value(self, path: Path) -> None:
        opening = self.take().text
        if opening == "[":
            number = 0
            while self.skip_lines() != "]":
                if self.peek() != ",":
                    self.lines.setdefault((*path, number), self.tokens[self.at].line)
                    self.value((*path, number))
                    number += 1
                else:
                    self.at += 1
            self.at += 1
        elif opening == "{":
            while self.skip_lines() != "}":
                if self.peek() != ",":
                    self.pair(path)
                else:
                    self.at += 1
            self.at += 1
        else:  # a number with a point or a date with a blank is several
            while self.peek() not in (",", "]", "}", "\n", ""):
                self.at += 1
