"""Findings of the electrical rule check and verdicts on simulators, for people and for programs."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from resgrid.spice.check.predictions import Prediction
    from resgrid.spice.check.violation import Severity, Violation


def rules_data(findings: Sequence[Violation], verdicts: Sequence[Prediction]) -> dict[str, Any]:
    """Findings and verdicts as ``--json`` gives them."""
    return {
        "passes": not any(finding.severity == "error" for finding in findings),
        "findings": [dataclasses.asdict(finding) for finding in findings],
        "simulators": [dataclasses.asdict(verdict) for verdict in verdicts],
    }


def rules_lines(findings: Sequence[Violation], verdicts: Sequence[Prediction]) -> Iterable[str]:
    """Findings and verdicts for people."""
    counts = {severity: sum(f.severity == severity for f in findings) for severity in ("error", "warning", "info")}
    yield f"electrical rules: {counts['error']} errors, {counts['warning']} warnings, {counts['info']} remarks"
    yield from finding_lines(findings)
    yield "will your simulator get it right?"
    yield from (f"  {verdict}" for verdict in verdicts)


def finding_lines(findings: Iterable[Violation], least: Severity = "info") -> Iterable[str]:
    """One line a finding, down to a severity."""
    from resgrid.spice.check.violation import SEVERITIES

    worst = SEVERITIES[: SEVERITIES.index(least) + 1]
    return (f"  {finding}" for finding in findings if finding.severity in worst)
