"""The type `HardwareCheck`: result of the verification of a board or layout by outside tools."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class HardwareCheck:
    """Result of the verification of a board or layout.

    Returned by `check_board` and `check_layout`.

    Attributes
    ----------
    reference : {"record"}
        Source of the expected circuit and voltages: the record, a JSON file beside the board or layout.
    agrees : bool or None
        Whether every check was done and none has a finding.  False as soon as there is a finding; None if there is no
        finding, but a check could not be done.
    verified : bool
        Whether every check was done.
    max_abs_error : float or None
        Largest absolute difference of a net's voltage from the record, in volts; None if no voltages could be compared.
    max_relative_error : float or None
        ``max_abs_error`` relative to the supply (the largest voltage difference in the circuit).
    nodes : int
        Number of nets whose voltages were compared.
    parts : int
        Number of parts that were compared.
    tools : mapping of str to str
        Version of each program that was run, such as ``{"kicad-cli": "9.0.8", "ngspice": "39"}``.
    tolerance : float
        Largest accepted absolute error of a voltage, as a fraction of the supply.
    findings : tuple of str
        One message for each difference, with its place; empty if there is no difference.
    worst : tuple of (str, float, float)
        Net, expected and found voltage in volts, for the six nets with the largest differences, the largest first;
        nets without a difference are left out.
    remark : str
        Reason why a check could not be done, and warnings of the tools; or empty.
    kind : {"board", "layout"}
        Kind of the file.

    Examples
    --------
    >>> check = rg.hardware.HardwareCheck(False, remark="kicad-cli is not installed")
    >>> print(check.agrees, check.verified)
    None False
    """

    verified: bool
    findings: tuple[str, ...] = ()
    max_abs_error: float | None = None
    max_relative_error: float | None = None
    nodes: int = 0
    parts: int = 0
    tools: Mapping[str, str] = field(default_factory=dict)
    tolerance: float = 1e-9
    worst: tuple[tuple[str, float, float], ...] = ()
    remark: str = ""
    kind: Literal["board", "layout"] = "board"
    reference: Literal["record"] = "record"

    @property
    def agrees(self) -> bool | None:
        """Whether every check was done without a finding; None without a finding if a check could not be done."""
        return False if self.findings else True if self.verified else None
