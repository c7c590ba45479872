"""On which line of a TOML document each key stands; tomllib does not say."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping

Path = tuple[str | int, ...]


def key_lines(text: str) -> dict[Path, int]:
    r"""Line of every table, key and array element of a TOML document."""
    return _Scanner(text).run()


def line_of(lines: Mapping[Path, int], path: Path) -> int | None:
    """Line of a key path, or of the nearest thing around it."""
    for length in range(len(path), 0, -1):
        if path[:length] in lines:
            return lines[path[:length]]
    return None


class _Scanner:
    """Walks once through a document that is known to be valid."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.lines: dict[Path, int] = {}
        self.tables: dict[Path, int] = {}
        self.line_starts = [0, *(i + 1 for i, character in enumerate(text) if character == "\n")]

    def run(self) -> dict[Path, int]:
        prefix: Path = ()
        self.skip_blank()
        while self.at < len(self.text):
            prefix = self.header() if self.peek() == "[" else self.pair(prefix)
            self.skip_blank()
        return self.lines

    def peek(self, length: int = 1) -> str:
        return self.text[self.at : self.at + length]

    def note(self, path: Path) -> None:
        self.lines.setdefault(path, bisect_right(self.line_starts, self.at))

    def skip_blank(self) -> None:
        while self.at < len(self.text):
            if self.peek() == "#":
                end = self.text.find("\n", self.at)
                self.at = len(self.text) if end < 0 else end
            elif self.peek() in " \t\n\r":
                self.at += 1
            else:
                return

    def skip_spaces(self) -> None:
        while self.peek() in (" ", "\t"):
            self.at += 1

    def header(self) -> Path:
        brackets = 2 if self.peek(2) == "[[" else 1
        start = self.at
        self.at += brackets
        parts = self.key()
        self.at += brackets
        path = self.resolve(parts[:-1])
        path = (*path, parts[-1])
        if brackets == 2:
            number = self.tables[path] = self.tables.get(path, -1) + 1
            after, self.at = self.at, start
            self.note(path)
            path = (*path, number)
        else:
            path = self.resolve(parts)
            after, self.at = self.at, start
        self.note(path)
        self.at = after
        return path

    def resolve(self, parts: list[str]) -> Path:
        path: Path = ()
        for part in parts:
            path = (*path, part)
            if path in self.tables:
                path = (*path, self.tables[path])
        return path

    def pair(self, prefix: Path) -> Path:
        start = self.at
        path = prefix
        parts = self.key()
        after, self.at = self.at, start
        for part in parts:
            path = (*path, part)
            self.note(path)
        self.at = after + 1
        self.skip_spaces()
        self.value(path)
        return prefix

    def key(self) -> list[str]:
        parts: list[str] = []
        while True:
            self.skip_spaces()
            if self.peek() in ("'", '"'):
                parts.append(self.string())
            else:
                start = self.at
                while self.peek() and (self.peek().isalnum() or self.peek() in "_-"):
                    self.at += 1
                parts.append(self.text[start : self.at])
            self.skip_spaces()
            if self.peek() != ".":
                return parts
            self.at += 1

    def string(self) -> str:
        quote = self.peek()
        fence = quote * 3 if self.peek(3) == quote * 3 else quote
        self.at += len(fence)
        start = self.at
        while self.at < len(self.text) and not self.text.startswith(fence, self.at):
            self.at += 2 if quote == '"' and self.peek() == "\\" else 1
        end = self.at
        self.at += len(fence)
        while len(fence) == 3 and self.peek() == quote:
            self.at += 1
        return self.text[start:end]

    def value(self, path: Path) -> None:
        opening = self.peek()
        if opening == "[":
            self.items(path, "]")
        elif opening == "{":
            self.items(path, "}")
        elif opening in ("'", '"'):
            self.string()
        else:
            while self.at < len(self.text) and self.peek() not in ",]}#\n":
                self.at += 1

    def items(self, path: Path, closing: str) -> None:
        self.at += 1
        number = 0
        self.skip_blank()
        while self.at < len(self.text) and self.peek() != closing:
            if closing == "]":
                self.note((*path, number))
                self.value((*path, number))
            else:
                self.pair(path)
            number += 1
            self.skip_blank()
            if self.peek() == ",":
                self.at += 1
                self.skip_blank()
        self.at += 1
