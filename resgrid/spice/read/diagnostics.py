"""What reading has to say: errors, collected up to a limit, and notes, each kind once with its count."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from resgrid.errors import InputError
from resgrid.spice.circuit import Note, Severity

MAX_ERRORS = 20
_MAX_TEXT = 300


@dataclass(frozen=True)
class Spot:
    """A place in a deck: file, line and column as displayed, counted from 1; column 0 means the whole line."""

    file: str
    line: int
    column: int = 0

    def __str__(self) -> str:
        return f"{self.file}:{self.line}" + (f":{self.column}" if self.column else "")


class CardError(InputError):
    """A card that cannot be read; the message says where it stands."""

    def __init__(self, spot: Spot, text: str) -> None:
        super().__init__(f"{spot}: {text[:_MAX_TEXT]}")


class DeckError(InputError):
    """A deck that cannot be read; an error a line."""


@dataclass
class Diagnostics:
    """Errors and notes while a deck is being read."""

    errors: list[str] = field(default_factory=list)
    _notes: dict[tuple[Severity, str], tuple[Spot, int]] = field(default_factory=dict)
    _outcomes: dict[str, Literal["fails", "unsure"]] = field(default_factory=dict)

    def error(self, error: CardError) -> None:
        """Keep an error; gives up when there are too many."""
        self.errors.append(str(error))
        if len(self.errors) >= MAX_ERRORS:
            self.errors.append(f"and there may be more: reading stopped after {MAX_ERRORS} errors")
            self.raise_errors()

    def raise_errors(self) -> None:
        """Raise everything that was kept as one InputError."""
        if self.errors:
            raise DeckError("\n".join(self.errors))

    def warn(self, spot: Spot, text: str, count: int = 1) -> None:
        """Note something that simulators disagree about, or that was probably not meant."""
        self._note("warning", spot, text, count)

    def refuse(self, spot: Spot, text: str) -> None:
        """Note text that is read here, but stops the dialect's own simulator."""
        self._outcomes[text] = "fails"
        self._note("warning", spot, text, 1)

    def doubt(self, spot: Spot, text: str) -> None:
        """Note text that is not followed here, with which the dialect's own simulator finds perhaps another answer."""
        self._outcomes[text] = "unsure"
        self._note("warning", spot, text, 1)

    def inform(self, spot: Spot, text: str) -> None:
        """Note something that is merely worth knowing."""
        self._note("info", spot, text, 1)

    def _note(self, severity: Severity, spot: Spot, text: str, count: int) -> None:
        """Keep a note; one with the same words as another is counted only."""
        first, seen = self._notes.get((severity, text), (spot, 0))
        self._notes[severity, text] = (first, seen + count)

    def notes(self) -> tuple[Note, ...]:
        """Everything that was noted, in the order in which it first was."""
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
