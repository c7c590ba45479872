"""What the keys of a chip mean, for its report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from resgrid.chip.build import chip_keys
from resgrid.chip.figures import formatted
from resgrid.scene.chip import Chip
from resgrid.scene.table import described_keys


def described(chip: Chip, shape: Sequence[int], boundary: str) -> list[tuple[str, str, str]]:
    """What a chip is made of, key by key, without what is ideal: key, value, meaning."""
    meaning = {"dirichlet": "are a rail", "neumann": "are open", "wall": "are a rail behind a resistance"}[boundary]
    size = f"{' x '.join(map(str, shape))} cells"
    rows = [("grid", size, "one node each"), ("boundary", boundary, f"obstacles {meaning}")]
    values, about = dict(chip_keys(chip)), described_keys(type(chip))
    if chip.sheet_resistance is None:
        del values["drawing_grid"]
    for key, value in values.items():
        unit, meaning = about[key]
        if value is not None:
            rows.append((key, value_text(value, unit), meaning))
    return rows


def value_text(value: Any, unit: str) -> str:
    """A value of a chip for people."""
    if isinstance(value, tuple):
        return ", ".join(value_text(part, unit) for part in value)
    if value is None:
        return "none"
    if unit in ("% µm", "1/K", "1/K^2") or isinstance(value, str):
        return f"{value} {unit}".strip()
    return formatted(value, unit)
