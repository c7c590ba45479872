"""What the keys of a chip mean, for its report."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from resgrid.cli.chip_report import shown

if TYPE_CHECKING:
    from resgrid.scene import Chip


def described(chip: Chip, size: str, boundary: str) -> list[tuple[str, str, str]]:
    """What a chip is made of, key by key, without what is ideal: key, value, meaning."""
    from resgrid.chip.build import chip_keys
    from resgrid.scene.table import described_keys

    meaning = {"dirichlet": "are a rail", "neumann": "are open", "wall": "are a rail behind a resistance"}[boundary]
    rows = [("grid", size, "one node each"), ("boundary", boundary, f"obstacles {meaning}")]
    values, about = dict(chip_keys(chip)), described_keys(type(chip))
    if chip.sheet_resistance is None:
        del values["drawing_grid"]
    for key, value in values.items():
        unit, meaning = about[key]
        if value is not None:
            rows.append((key, written(value, unit), meaning))
    return rows


def written(value: Any, unit: str) -> str:
    """A value of a chip for people."""
    if isinstance(value, tuple):
        return ", ".join(written(part, unit) for part in value)
    if value is None:
        return "none"
    if unit in ("% µm", "1/K", "1/K^2") or isinstance(value, str):
        return f"{value} {unit}".strip()
    return shown(value, unit)
