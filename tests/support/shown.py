"""Command lines in pages, docstrings and help texts, with the code cells that create their inputs."""

from __future__ import annotations

import ast
import inspect
import io
import json
import re
import shlex
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import click

from resgrid.cli.entry import SUBCOMMANDS, main

PROJECT = Path(__file__).resolve().parents[2]

_FENCE = re.compile(r"^(?P<mark>```+|:::+)(?P<kind>[^\n]*)\n(?P<body>.*?)^(?P=mark)\s*$", re.MULTILINE | re.DOTALL)
_INLINE = re.compile(r"(?<!`)(?P<ticks>`{1,2})(?P<text>[^`]+?)(?P=ticks)(?!`)", re.DOTALL)
_QUOTED = re.compile(r"'(?P<text>(?:python -m )?resgrid [^']+)'")
_COMMAND = re.compile(r"(?:\S*bin/)?(?:python -m )?resgrid (?P<verb>[a-z]+)\b")
_LINE = re.compile(r"^(?:#? *\$ |#? +|)(?P<text>(?:\S*bin/)?(?:python -m )?resgrid [^\n]*)", re.MULTILINE)


@dataclass(frozen=True)
class Piece:
    """A part of a page: Python code, shell code, or a command of running text."""

    place: str
    kind: str
    text: str


def is_command(text: str) -> bool:
    """Return whether a text begins with a command of resgrid."""
    found = _COMMAND.match(text)
    return found is not None and found["verb"] in SUBCOMMANDS


def runs_resgrid(line: str) -> bool:
    """Return whether a line of a shell runs resgrid, maybe by another program such as mpiexec."""
    found = re.match(r"(?!echo|printf)(?:\S+ )*?resgrid (?P<verb>[a-z]+)\b", line.strip())
    return found is not None and found["verb"] in SUBCOMMANDS


def pieces_of_markdown(text: str, place: str) -> Iterator[Piece]:
    """Yield code cells, shell blocks and commands of a page, in their order."""
    end = 0
    for fence in _FENCE.finditer(text):
        yield from _inline(text[end : fence.start()], place)
        end = fence.end()
        kind, body = fence["kind"].strip(), re.sub(r"\A(?::[^\n]*\n)+", "", fence["body"])
        if "code-cell" in kind and body.startswith("%%bash"):
            yield Piece(place, "shell", body.partition("\n")[2])
        elif "code-cell" in kind:
            yield Piece(place, "python", body)
        elif kind in ("bash", "console", "sh", "shell", "text", ""):
            lines = (line.removeprefix("$ ") for line in body.replace("\\\n", " ").splitlines())
            yield from (Piece(place, "command", _bare(line)) for line in lines if runs_resgrid(line))
    yield from _inline(text[end:], place)


def _inline(text: str, place: str) -> Iterator[Piece]:
    """Yield the commands of running text and of indented lines."""
    for line in re.findall(r"^(?:    |\t)+(resgrid [^\n]*)", text, re.MULTILINE):
        if is_command(line):
            yield Piece(place, "command", _bare(line))
    for found in _INLINE.finditer(text):
        words = " ".join(found["text"].split())
        if is_command(words):
            yield Piece(place, "command", words)


def _bare(line: str) -> str:
    """Return a line without its comment."""
    return re.split(r"\s{2,}#|\s#\s", line)[0].strip()


def pages() -> dict[str, list[Piece]]:
    """Return the pieces of every page by its name."""
    files = [*PROJECT.glob("*.md"), *(PROJECT / "docs").rglob("*.md"), *(PROJECT / "docs").rglob("*.rst")]
    files += [*(PROJECT / "benchmarks").rglob("*.md"), *(PROJECT / "examples").rglob("*.rst")]
    found = {}
    for file in sorted(files):
        place = str(file.relative_to(PROJECT))
        if "_build" not in place and "gallery" not in place:
            found[place] = list(pieces_of_markdown(file.read_text(encoding="utf-8"), place))
    for file in sorted((PROJECT / "docs" / "notebooks").glob("*.ipynb")):
        place = str(file.relative_to(PROJECT))
        cells = json.loads(file.read_text(encoding="utf-8"))["cells"]
        found[place] = [piece for cell in cells for piece in _cell(cell, place)]
    return {place: pieces for place, pieces in found.items() if any(piece.kind != "python" for piece in pieces)}


def _cell(cell: dict[str, object], place: str) -> Iterator[Piece]:
    text = "".join(cell["source"])  # type: ignore[arg-type]
    if cell["cell_type"] == "markdown":
        yield from pieces_of_markdown(text, place)
    elif text.startswith("%%bash"):
        yield Piece(place, "shell", text.partition("\n")[2])
    else:
        yield Piece(place, "python", text)


@cache
def sources() -> list[Piece]:
    """Return the commands of docstrings and comments of all Python files, of scenes, and of the live page."""
    found: list[Piece] = []
    for folder in ("resgrid", "examples", "benchmarks", "docs"):
        for file in sorted((PROJECT / folder).rglob("*.py")):
            place = str(file.relative_to(PROJECT))
            if "_build" not in place and "gallery" not in place:
                for text in _words(file.read_text(encoding="utf-8")):
                    found += _inline(inspect.cleandoc(text), place)
                    found += (Piece(place, "command", each["text"]) for each in _QUOTED.finditer(text))
    for file in sorted((PROJECT / "examples").rglob("*.toml")):
        lines = _LINE.finditer("\n".join(re.findall(r"^# .*", file.read_text(encoding="utf-8"), re.MULTILINE)))
        place = str(file.relative_to(PROJECT))
        found += (Piece(place, "command", _bare(line["text"])) for line in lines if is_command(line["text"]))
    for file in sorted((PROJECT / "resgrid" / "page" / "static").rglob("*.*")):
        if file.suffix in (".js", ".html"):
            place = str(file.relative_to(PROJECT))
            for each in _QUOTED.finditer(file.read_text(encoding="utf-8")):
                found.append(Piece(place, "command", each["text"]))
    return [piece for piece in found if is_command(piece.text)]


def _words(source: str) -> Iterator[str]:
    """Yield docstrings and comments of a Python file that may contain a command."""
    if not any(verb in SUBCOMMANDS for verb in re.findall(r"resgrid\s+([a-z]+)\b", source)):
        return  # tokenizing all files takes 3 s
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield ast.get_docstring(node) or ""
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.string.lstrip("# ")


def helps(verb: str) -> list[Piece]:
    """Return the examples of a command, and the commands that its help texts name."""
    command = main.get_command(click.Context(main, info_name="resgrid"), verb)  # type: ignore[attr-defined]
    place = f"resgrid {verb} --help"
    found = [Piece(place, "command", example) for example in command.examples]
    for text in (command.help or "", *(getattr(option, "help", "") or "" for option in command.params)):
        lines = (" ".join(each["text"].split()) for each in _QUOTED.finditer(text))
        found += (Piece(place, "command", line) for line in lines if is_command(line))
    return found


def fragments() -> list[tuple[str, str]]:
    """Return the options that running text of the documentation shows without a command, with their pages."""
    files = [PROJECT / "README.md", *sorted((PROJECT / "docs").rglob("*.md"))]
    found = []
    for file in files:
        text = _FENCE.sub("", file.read_text(encoding="utf-8"))
        if "_build" not in str(file):
            place = str(file.relative_to(PROJECT))
            found += [(place, each["text"]) for each in _INLINE.finditer(text) if each["text"].startswith("--")]
    return found


def words_of(command: str) -> list[str]:
    """Return the words after ``resgrid``, up to a pipe, a redirection or the end of a command substitution."""
    text = re.sub(r'^eval "\$\((.*)\)"$', r"\1", command)
    text = re.sub(r"\s\d?>&?\s?\S+", "", text)
    lexer = shlex.shlex(text, posix=True, punctuation_chars="|&;<>")
    lexer.whitespace_split = True
    words: list[str] = []
    for word in lexer:
        if set(word) <= set("|&;<>"):
            break
        words.append(word)
    while words and words[0] != "resgrid":
        if words[0].endswith("/resgrid"):
            break
        words.pop(0)
    return words[1:]
