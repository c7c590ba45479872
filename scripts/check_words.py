"""Count constructions that make docstrings and comments hard to read; exit status 1 above the limits.

Usage: ``python scripts/check_words.py [PATH ...]`` (default: ``resgrid``).  ``--list`` prints every place.

The phrases are filler words, persons in place of programs, and "what" clauses in place of nouns.  Per thousand words,
numpy and scipy.sparse have 0.5 of them, networkx 0.4 and pydantic 0.2; all have 0.1 to 0.3 of the word "what".
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

PHRASES = re.compile(
    r"\b(is none|in all|anew|whoever|somebody|nobody|so many|so much|heeded|told|made ready"
    r"|what (?:is|was|are|were|it|they|there|a|an|the|each|this|nothing|other))\b",
    re.IGNORECASE,
)
WHAT = re.compile(r"\bwhat\b", re.IGNORECASE)
WORD = re.compile(r"\b[a-z][a-z'-]*\b", re.IGNORECASE)
MOST_PHRASES, MOST_WHAT = 0.8, 1.0
"""Limits per thousand words."""


def prose(source: str) -> Iterator[tuple[int, str]]:
    """Line number and text of every docstring (of modules, classes, functions and constants) and comment."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


def found(pattern: re.Pattern[str], text: str, line: int) -> Iterator[tuple[int, str]]:
    """Line number and match of every occurrence; phrases may span the end of a line."""
    for match in pattern.finditer(re.sub(r"\s", lambda space: "\n" if space[0] == "\n" else " ", text)):
        yield line + text.count("\n", 0, match.start()), match[0]


def main() -> int:
    """Count, print rates per folder and in total, and compare the total with the limits."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", type=Path, default=[Path("resgrid")])
    parser.add_argument("--list", action="store_true", help="print every place")
    arguments = parser.parse_args()
    files = [file for path in arguments.paths for file in (sorted(path.rglob("*.py")) if path.is_dir() else [path])]
    words = phrases = whats = 0
    for file in files:
        for line, text in prose(file.read_text(encoding="utf-8")):
            words += len(WORD.findall(text))
            places = [*found(PHRASES, text, line)], [*found(WHAT, text, line)]
            phrases, whats = phrases + len(places[0]), whats + len(places[1])
            if arguments.list:
                for number, match in sorted({*places[0], *places[1]}):
                    print(f"{file}:{number}: {match!r}")
    rates = 1000 * phrases / max(words, 1), 1000 * whats / max(words, 1)
    print(
        f"{words} words; per thousand: {rates[0]:.2f} phrases (limit {MOST_PHRASES}), "
        f"{rates[1]:.2f} 'what' (limit {MOST_WHAT})"
    )
    return int(rates[0] > MOST_PHRASES or rates[1] > MOST_WHAT)


if __name__ == "__main__":
    sys.exit(main())
