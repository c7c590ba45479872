"""Names of the files to which the document of a scene refers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any


def needs_files(document: Mapping[str, Any]) -> bool:
    """Return whether the document of a scene refers to a map file or to files of obstacles."""
    return "map" in document or any("file" in table for table in _obstacle_tables(document))


def with_absolute_files(raw: Mapping[str, Any], folder: Path) -> Mapping[str, Any]:
    """Return a document in which the names of files of obstacles are absolute; `folder`: base of relative names."""
    if not any("file" in table for table in _obstacle_tables(raw)):
        return raw
    return {**raw, "obstacle": [_absolute(table, folder) for table in raw["obstacle"]]}


def _obstacle_tables(raw: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the tables of obstacles of a document that may be invalid."""
    tables = raw.get("obstacle")
    return [table for table in tables if isinstance(table, Mapping)] if isinstance(tables, list) else []


def _absolute(table: Any, folder: Path) -> Any:
    if not isinstance(table, Mapping) or not isinstance(table.get("file"), str) or not table["file"]:
        return table
    return {**table, "file": str(folder.resolve() / table["file"])}
