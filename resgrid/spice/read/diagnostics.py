"""Diagnostics of the deck reader: errors, collected up to a limit, and notes; equal notes are one note with a count."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from resgrid.errors import InputError
from resgrid.spice.findings import Note, Severity

MAX_ERRORS = 20
"""Number of errors in a deck at which reading stops with DeckError."""

_MAX_TEXT = 300
"""Maximum length of the message of one error, in characters; longer messages are cut."""


@dataclass(frozen=True)
class Spot:
    """A position in a deck: file name for messages, line and column, counted from 1; column 0 means the whole line."""

    file: str
    line: int
    column: int = 0

    def __str__(self) -> str:
        return f"{self.file}:{self.line}" + (f":{self.column}" if self.column else "")


class CardError(InputError):
    """Error for a card that cannot be read; the message begins with the position of the error."""

    def __init__(self, spot: Spot, text: str) -> None:
        super().__init__(spot, text)

    def __str__(self) -> str:
        spot, text = self.args
        return f"{spot}: {text[:_MAX_TEXT]}"


class DeckError(InputError):
    """Error for a deck that cannot be read; the message has one line for each error in the deck."""


@dataclass
class Diagnostics:
    """Collector of the errors and notes (remarks) about one deck; `errors`: messages of the errors."""

    errors: list[str] = field(default_factory=list)
    _notes: dict[tuple[Severity, str], tuple[Spot, int]] = field(default_factory=dict)
    _outcomes: dict[str, Literal["fails", "unsure"]] = field(default_factory=dict)

    def error(self, error: CardError) -> None:
        """Add an error; raise DeckError, which lists all errors, when their number reaches 20 (`MAX_ERRORS`)."""
        self.errors.append(str(error))
        if len(self.errors) >= MAX_ERRORS:
            self.errors.append(f"and there may be more: reading stopped after {MAX_ERRORS} errors")
            self.raise_errors()

    def raise_errors(self) -> None:
        """Raise DeckError with one line per error if errors have been added."""
        if self.errors:
            raise DeckError("\n".join(self.errors))

    def warn(self, spot: Spot, text: str, count: int = 1) -> None:
        """Add a warning about text that simulators read differently, or that is probably a mistake.

        `spot`: position of the text; `text`: the message; `count`: number of occurrences.
        """
        self._note("warning", spot, text, count)

    def refuse(self, spot: Spot, text: str) -> None:
        """Add a warning about text that resgrid reads, but that stops the dialect's own simulator.

        `spot`: position of the text; `text`: the message.
        """
        self._outcomes[text] = "fails"
        self._note("warning", spot, text, 1)

    def warn_ignored(self, spot: Spot, text: str) -> None:
        """Add a warning about text that resgrid ignores, but that may change the result of the dialect's simulator.

        `spot`: position of the text; `text`: the message.
        """
        self._outcomes[text] = "unsure"
        self._note("warning", spot, text, 1)

    def inform(self, spot: Spot, text: str) -> None:
        """Add a note of severity "info"; `spot`: position in the deck; `text`: the message."""
        self._note("info", spot, text, 1)

    def _note(self, severity: Severity, spot: Spot, text: str, count: int) -> None:
        """Add a note, or add `count` to the number of occurrences of a note with the same text and severity.

        `spot`: position; `text`: the message.
        """
        first, seen = self._notes.get((severity, text), (spot, 0))
        self._notes[severity, text] = (first, seen + count)

    def notes(self) -> tuple[Note, ...]:
        """Return all notes in the order of their first occurrence; equal notes are one note with their number."""
        return tuple(
            Note(
                severity,
                spot.file,
                spot.line,
                spot.column,
                text if count == 1 else f"{text} ({count} times)",
                self._outcomes.get(text, ""),
            )
            for (severity, text), (spot, count) in self._notes.items()
        )
