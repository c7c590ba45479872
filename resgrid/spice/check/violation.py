"""What an electrical rule finds."""

from __future__ import annotations

from dataclasses import dataclass

from resgrid.spice.circuit import Severity

SEVERITIES: tuple[Severity, ...] = ("error", "warning", "info")
"""Worst first."""


@dataclass(frozen=True)
class Violation:
    """One violation of an electrical rule.

    Attributes
    ----------
    severity : {"error", "warning", "info"}
        An error keeps the circuit from having an operating point, or a deck from being simulated rightly.
    rule : str
        Short name of the rule.
    place : str
        ``file:line`` in a deck, the cell of a scene, otherwise the nodes or elements concerned.
    message : str
        What is wrong.
    remedy : str
        What to do.
    nodes : tuple of str
        The nodes concerned, at most the first thousand.
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
