"""The type `Refusals` (text that resgrid reads but that stops a dialect's simulator), and LTspice's own commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True, eq=False)
class Refusals:
    """Text that resgrid can read, but that stops the simulator (``"fails"``) or may stop it (``"unsure"``).

    The consequence ``""`` means that the simulator reads the text, too.

    Attributes
    ----------
    commands : frozenset of str
        Commands (first words of a line) that end the run.
    foreign_commands : frozenset of str
        Commands of other simulators that are not in this simulator's manual, so that they may stop it.
    blank_names : {"", "fails", "unsure"}
        Consequence of a blank in a quoted name.
    letters : {"", "unsure"}
        Consequence of non-ASCII letters in the deck.
    encodings : frozenset of str
        Encodings of files that end the run: ``"latin-1"``, ``"utf-16"``, ``"cr"`` (carriage returns between lines),
        ``"bom"`` (a byte order mark of UTF-8 in an included file).
    commas : bool
        Whether the simulator hangs at a comma directly after a value and before the next name.
    idle_parameters : bool
        Whether a parameter without a value ends the run even if no expression refers to it.
    redefinitions : bool
        Whether the run may end where a parameter is defined twice.
    glued_names : bool
        Whether a parameter's name directly after the parenthesis of a waveform ends the run.
    loose_libraries : bool
        Whether ``.lib`` without a section, a section in the deck itself, and a section without ``.endl`` end the run.
    keys : mapping of str to frozenset of str
        Keys (``key=value``) of an element that end the run, by the first letter of the element.
    before_calls : frozenset of str
        Operators directly after which the simulator does not recognise a call of a function that the deck defines: it
        calls its own function of this name, or stops.
    commands_in_comments : bytes
        Regular expression of comments that the simulator executes as commands and resgrid ignores; empty for none.
    """

    commands: frozenset[str] = frozenset()
    foreign_commands: frozenset[str] = frozenset()
    blank_names: Literal["", "fails", "unsure"] = ""
    letters: Literal["", "unsure"] = ""
    encodings: frozenset[str] = frozenset()
    commas: bool = False
    idle_parameters: bool = False
    redefinitions: bool = False
    glued_names: bool = False
    loose_libraries: bool = False
    keys: Mapping[str, frozenset[str]] = field(default_factory=dict)
    before_calls: frozenset[str] = frozenset()
    commands_in_comments: bytes = b""


LTSPICE_COMMANDS = frozenset({".backanno", ".loadbias", ".machine", ".savebias", ".wave"})
"""Commands (first words of a line) that LTspice has and the other simulators do not have."""
