"""The reference page and the JSON Schema of scenes, compared with the dataclasses they describe.

Tests internals: `resgrid.robots`, `resgrid.scene.schema`, `resgrid.scene.table_models`.
"""

from __future__ import annotations

import dataclasses
import json
import runpy
from pathlib import Path

import pytest

import resgrid as rg
from resgrid.robots import ROBOTS
from resgrid.scene.schema import KINDS
from resgrid.scene.table_models import described_keys

DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "reference" / "scene.md"


def test_the_reference_page_equals_its_generator() -> None:
    scene_reference = runpy.run_path(str(DOCS / "_ext" / "scene_page.py"))["scene_reference"]
    assert PAGE.read_text() == scene_reference(), "make reference"


def test_every_key_of_the_reference_page_has_a_description() -> None:
    rows = [line.split(" | ") for line in PAGE.read_text().splitlines() if line.startswith("| `")]
    assert len(rows) > 120
    assert [row[0] for row in rows if len(row[-1].removesuffix(" |")) < 8] == []


@pytest.mark.parametrize("value", [rg.Chip, rg.chip.Readout, rg.chip.Defects, rg.control.Control])
def test_every_field_is_a_key_of_the_schema(value: type) -> None:
    keys = json.loads(json.dumps(rg.scene_schema()))["$defs"][value.__name__]["properties"]
    assert list(keys) == [item.name for item in dataclasses.fields(value)]
    assert all(entry.get("description") for entry in keys.values())


def test_described_keys_contains_units_and_descriptions() -> None:
    keys = described_keys(rg.Chip)
    assert keys["capacitance"] == ("F", "Capacitance from every cell's node to ground.")
    assert keys["readout.range"][0] == "V"
    assert list(KINDS["robot"]) == list(ROBOTS)
