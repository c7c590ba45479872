"""Findings of the electrical rule check and verdicts on simulators, for people and for programs."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from resgrid.spice.finding import Finding, Severity
    from resgrid.spice.verdicts import Verdict


def rules_data(findings: Sequence[Finding], verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """Findings and verdicts as ``--json`` gives them."""
    return {
        "passes": not any(finding.severity == "error" for finding in findings),
        "findings": [dataclasses.asdict(finding) for finding in findings],
        "simulators": [dataclasses.asdict(verdict) for verdict in verdicts],
    }


def rules_lines(findings: Sequence[Finding], verdicts: Sequence[Verdict]) -> Iterable[str]:
    """Findings and verdicts for people."""
    counts = {severity: sum(f.severity == severity for f in findings) for severity in ("error", "warning", "info")}
    yield f"electrical rules: {counts['error']} errors, {counts['warning']} warnings, {counts['info']} remarks"
    yield from finding_lines(findings)
    yield "will your simulator get it right?"
    yield from (f"  {verdict}" for verdict in verdicts)


def finding_lines(findings: Iterable[Finding], least: Severity = "info") -> Iterable[str]:
    """One line a finding, down to a severity."""
    from resgrid.spice.finding import SEVERITIES

    worst = SEVERITIES[: SEVERITIES.index(least) + 1]
    return (f"  {finding}" for finding in findings if finding.severity in worst)
