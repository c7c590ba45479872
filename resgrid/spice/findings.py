"""Findings about decks and circuits: remarks of the deck reader, and violations of electrical rules."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning", "info"]

SEVERITIES: tuple[Severity, ...] = ("error", "warning", "info")
"""All severities of notes and violations, the most severe first; a note of the deck reader never has "error"."""


@dataclass(frozen=True)
class Note:
    r"""A remark of the deck reader about one place of a deck.

    An entry of `Circuit.notes`.

    Attributes
    ----------
    severity : {"error", "warning", "info"}
        ``"warning"`` for text that simulators read differently, or a probable mistake; ``"info"`` for the rest.  The
        deck reader makes no note of severity ``"error"``: an error ends the reading with an exception.
    file : str
        Name of the file, as messages show it.
    line, column : int
        Position, counted from 1; column 0 means the whole line.
    text : str
        The remark.
    outcome : {"", "fails", "unsure"}
        Consequence of the text in the simulator of the deck's dialect: ``"fails"`` for no result, ``"unsure"`` for
        perhaps another result than that of resgrid, ``""`` for none of these.
    place : str
        ``file:line``, or ``file:line:column`` if the column is not 0.

    Examples
    --------
    >>> import io
    >>> deck = rg.read_spice(io.StringIO("one resistor\nV1 a 0 1\nR1 a 0 1k\n.tran 1u 1m\n"))
    >>> print(deck.notes[0])
    <text>:4: .tran is ignored: the operating point is solved
    >>> deck.notes[0].severity, deck.notes[0].line
    ('info', 4)
    """

    severity: Severity
    file: str
    line: int
    column: int
    text: str
    outcome: Literal["", "fails", "unsure"] = ""

    @property
    def place(self) -> str:
        """Position of the text in the form ``file:line``, or ``file:line:column`` if the column is not 0."""
        return f"{self.file}:{self.line}" + (f":{self.column}" if self.column else "")

    def __str__(self) -> str:
        return f"{self.place}: {self.text}"


@dataclass(frozen=True)
class Violation:
    """One violation of an electrical rule.

    Returned by `resgrid.check_erc`, one for each finding.

    Attributes
    ----------
    severity : {"error", "warning", "info"}
        With an error the circuit has no operating point, or a simulator reads its deck wrongly; a warning is a probable
        mistake; ``"info"`` is a remark without a need for action.
    rule : str
        Short name of the rule, such as ``"floating"``.
    place : str
        ``file:line`` in a deck, the cell of a scene, otherwise the nodes or elements concerned; may be empty.
    message : str
        Sentence that states the problem.
    remedy : str
        Sentence that states the correction.
    nodes : tuple of str
        Names of the nodes concerned, at most the first thousand; may be empty for rules on values and on names.

    Examples
    --------
    >>> circuit = rg.Netlist(3, [[1, 0]], [1.0], source_nodes=[[1, 0]], source_volts=[1.0])
    >>> violation = rg.check_erc(circuit)[0]
    >>> violation.severity, violation.rule, violation.nodes
    ('warning', 'floating', ('node_2',))
    >>> violation.remedy
    'they are left out of decks; join them to the circuit by a resistor if they belong to it'
    """

    severity: Severity
    rule: str
    place: str
    message: str
    remedy: str
    nodes: tuple[str, ...] = ()

    def __str__(self) -> str:
        where = f"{self.place}: " if self.place else ""
        return f"{self.severity} [{self.rule}] {where}{self.message}; {self.remedy}"
