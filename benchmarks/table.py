"""Printed tables and saved results."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from benchmarks.peers import PEERS
from benchmarks.rows import Row, Scale, Spread

PLANNERS = ("networkx", "ompl", "pathfinding", "scikit-fmm")
SCHEMA = 2
DIGITS = 4


def format_rows(rows: Iterable[Row], last: Mapping[tuple[str, str], float]) -> str:
    """Return the lines of a table: name, contender, seconds, value with its range, unit, previous value, remarks."""
    cells = [_cells(row, last.get((row.name, row.contender))) for row in rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)] if cells else []
    right = (False, False, True, True, True, False, True, False)
    lines = []
    for line in cells:
        aligned = [c.rjust(w) if r else c.ljust(w) for c, w, r in zip(line, widths, right, strict=True)]
        lines.append("  ".join(aligned).rstrip())
    return "".join(f"{line}\n" for line in lines)


def _cells(row: Row, last: float | None) -> tuple[str, ...]:
    seconds = "" if row.seconds is None else f"{row.seconds:.3g} s"
    before = "" if last is None else f"(was {_number(last)})"
    value, ends = ("-", "") if row.value is None else (_number(row.value.median), _range(row.value))
    return row.name, row.contender, seconds, value, ends, row.unit, before, row.note


def _range(value: Spread) -> str:
    return "" if value.low == value.high else f"{_number(value.low)} .. {_number(value.high)}"


def _number(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.2f}" if value < 10 else f"{value:.1f}"


def read_results(path: Path) -> dict[str, Any]:
    """Return the sections saved in a file; empty if the file does not exist or has another schema."""
    if not path.exists():
        return {}
    kept = json.loads(path.read_text(encoding="utf-8"))
    return dict(kept["sections"]) if kept.get("schema") == SCHEMA else {}


def last_values(sections: Mapping[str, Any]) -> dict[tuple[str, str], float]:
    """Return the median of every saved row by name and contender."""
    rows = [row for section in sections.values() for row in section["rows"] if row["value"] is not None]
    return {(row["name"], row["contender"]): row["value"]["median"] for row in rows}


def section_record(rows: Iterable[Row], scale: Scale) -> dict[str, Any]:
    """Return the record of a section: its rows, the machine and the versions."""
    return {"scale": scale.name, "seed": scale.seed, "machine": machine(), "rows": [_record(row) for row in rows]}


def write_results(path: Path, sections: Mapping[str, Any]) -> None:
    """Save the sections in a file."""
    path.write_text(json.dumps({"schema": SCHEMA, "sections": sections}, indent=1) + "\n", encoding="utf-8")


def rows_of(section: Mapping[str, Any]) -> list[Row]:
    """Return the rows of a saved section."""
    return [
        Row(**{**row, "value": None if row["value"] is None else Spread(**row["value"])}) for row in section["rows"]
    ]


def machine() -> dict[str, object]:
    """Return the processor, the interpreter, and the versions of the contenders."""
    packages = ("resgrid", "numba", "numpy", *sorted({peer.package for peer in PEERS.values()}), *PLANNERS)
    versions = {name: found for name in packages if (found := _version(name))}
    return {"cpu": _cpu(), "cores": os.cpu_count(), "python": platform.python_version(), "versions": versions}


def _record(row: Row) -> dict[str, Any]:
    record = asdict(row)
    record["seconds"] = None if row.seconds is None else _rounded(row.seconds)
    if row.value is not None:
        record["value"] = {key: _rounded(value) for key, value in asdict(row.value).items()}
    return record


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
