"""Line numbers of the keys of a TOML document, which tomllib does not report."""

from __future__ import annotations

import re
from collections.abc import Mapping

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


def key_lines(text: str) -> dict[Path, int]:
    """Return the line number, from 1, of every table, key and array element of a valid TOML document, by key path.

    A key path is a tuple of names and indices, such as ``("obstacle", 2, "radius")``.  `text`: the document, with line
    feeds as line ends.
    """
    scanner = _Scanner(text)
    prefix: Path = ()
    while scanner.skip():
        if scanner.peek() == "[":
            prefix = scanner.header()
        else:
            scanner.pair(prefix)
    return scanner.lines


def line_of(lines: Mapping[Path, int], path: Path) -> int | None:
    """Return the line number of a key path, or of the innermost enclosing table or list with a line number.

    `lines`: line numbers by key path; `path`: names and indices, such as ``("obstacle", 2, "radius")``.  The result is
    None if neither the path nor an enclosing table or list has a line number.
    """
    return next((lines[path[:size]] for size in range(len(path), 0, -1) if path[:size] in lines), None)


class _Scanner:
    """Scanner of the tokens of a TOML document that records the line numbers of keys in a single pass over the text.

    `tokens`: pairs of text and line number, the next one last; `lines`: line numbers from 1 by key path; `tables`:
    index of the current table of each array of tables, by key path.
    """

    def __init__(self, text: str) -> None:
        tokens, line = [], 1
        for match in _TOKEN.finditer(text):
            if match.lastgroup != "blank":
                tokens.append((match[0], line))
            line += match[0].count("\n")
        self.tokens = [("", 0), *reversed(tokens)]  # the next token is the last entry
        self.lines: dict[Path, int] = {}
        self.tables: dict[Path, int] = {}

    def peek(self) -> str:
        return self.tokens[-1][0]

    def skip(self) -> str:
        """Remove line ends and commas before the next token, and return this token, which stays in the input."""
        while self.peek() in ("\n", ","):
            self.tokens.pop()
        return self.peek()

    def header(self) -> Path:
        _, line = self.tokens.pop()
        is_array = self.peek() == "["
        if is_array:
            self.tokens.pop()
        parts = self.key()
        del self.tokens[-1 - is_array :]
        if is_array:
            path = (*self.resolved(parts[:-1]), parts[-1])
            self.lines.setdefault(path, line)
            self.tables[path] = self.tables.get(path, -1) + 1
        path = self.resolved(parts)
        self.lines.setdefault(path, line)
        return path

    def resolved(self, parts: list[str]) -> Path:
        """Return a key path in which each array of tables is followed by the index of its current table.

        `parts`: names of the key path, such as ``["obstacle", "radius"]``; the result is ``("obstacle", 2, "radius")``.
        """
        path: Path = ()
        for part in parts:
            path = (*path, part)
            if path in self.tables:
                path = (*path, self.tables[path])
        return path

    def key(self) -> list[str]:
        parts = [self.tokens.pop()[0].strip("'\"")]
        while self.peek() == ".":
            self.tokens.pop()
            parts.append(self.tokens.pop()[0].strip("'\""))
        return parts

    def pair(self, path: Path) -> None:
        line = self.tokens[-1][1]
        for part in self.key():
            path = (*path, part)
            self.lines.setdefault(path, line)
        self.tokens.pop()
        self.value(path)

    def value(self, path: Path) -> None:
        opening, _ = self.tokens.pop()
        number = 0
        if opening in ("[", "{"):
            while self.skip() not in ("]", "}"):
                if opening == "{":
                    self.pair(path)
                else:
                    self.lines.setdefault((*path, number), self.tokens[-1][1])
                    self.value((*path, number))
                    number += 1
            self.tokens.pop()
        else:  # a number with a point or a date with a blank has several tokens
            while self.peek() not in (",", "]", "}", "\n", ""):
                self.tokens.pop()
