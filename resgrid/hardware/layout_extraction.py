"""Extraction of the circuit of a layout, by klayout in a separate Python process."""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from resgrid._internal.files import temporary_folder
from resgrid.errors import InputError
from resgrid.hardware.layout_rails import pad_name
from resgrid.hardware.layout_rules import Layer, LayoutRules
from resgrid.hardware.tools import TIMEOUT, KlayoutPython

SCRIPT = Path(__file__).with_name("klayout_extraction.py")
"""Path of the script that extracts the circuit, and runs in a separate Python interpreter with klayout."""

_TILE = re.compile(r"tile (\d+) (\d+) (\d+) nm")
"""Pattern of the label that states the measures of tiles, in nanometres.

They are the distances of tiles along x and y, and the y of the resistor along y in its tile. A tile is the drawing of
one cell of the grid.
"""


@dataclass(frozen=True)
class Extraction:
    """Circuit of a layout as klayout extracts it.

    `pitch`: distances of tiles (drawings of one cell each) along x and y, and y of the resistor along y in its tile, in
    nanometres; `nets`: number of the net of every pad, by reference of the part and number of the pad, None without a
    net; `ohms`: resistance of every resistor in ohms, by reference; `place`: lower left corner (x, y) of every
    resistor's body, and place of the label of every bond pad, in micrometres; `labels`: text, x and y in micrometres
    and number of the net of each other label; the number is None on no metal; `violations`: messages about violated
    design rules; `messages`: problems of the extraction.
    """

    pitch: tuple[int, ...]
    nets: Mapping[tuple[str, int], int | None]
    ohms: Mapping[str, float]
    place: Mapping[str, tuple[float, float]]
    labels: tuple[tuple[str, float, float, int | None], ...]
    violations: tuple[str, ...]
    messages: tuple[str, ...]


def extract_layout(
    tool: KlayoutPython,
    file: str | os.PathLike[str],
    rules: LayoutRules,
    *,
    check_rules: bool = True,
    timeout: float = TIMEOUT,
) -> Extraction:
    """Return the circuit that klayout extracts from the shapes of a layout, and the violated design rules.

    `tool`: Python interpreter with klayout; `file`: GDSII or OASIS file; `rules`: design rules of its process;
    `check_rules`: whether the design rules are checked; `timeout`: longest run of klayout, in seconds.
    """
    with temporary_folder() as folder:
        job = folder / "job.json"
        job.write_text(json.dumps(_job(rules, check_rules)), encoding="utf-8")
        printed = tool.run(SCRIPT, Path(file), job, timeout=timeout)
    return _extraction(Path(file), rules, json.loads(printed))


def _job(rules: LayoutRules, check_rules: bool) -> dict[str, Any]:
    """Return layers, connections and rules as input of the script that extracts the circuit.

    Keys: ``layers`` (GDSII numbers by name), ``body`` and ``ends`` (names of the layers of resistor bodies and ends),
    ``conductors`` (names), ``connections`` (pairs of names of connected conductors), ``texts`` (name of a metal and
    GDSII numbers of its labels), ``outline`` (GDSII numbers) and ``rules``. `check_rules`: whether the script checks
    design rules; otherwise the list of rules is empty.
    """
    layers: dict[str, Layer] = {**rules.body, **rules.ends, "contact": rules.contact}
    layers |= {cover.name: cover.layer for cover in (*rules.body_covers, *rules.covers)}
    if rules.passivation is not None:
        layers["opening"] = rules.passivation
    connections = [("ends", "contact"), ("contact", rules.metals[0].name)]
    conductors = ["ends", "contact"]
    for metal, upper in zip(rules.metals, [*rules.metals[1:], None], strict=True):
        layers[metal.name] = metal.layer
        conductors.append(metal.name)
        if upper is not None:
            layers[metal.via] = metal.via_layer
            conductors.append(metal.via)
            connections += [(metal.name, metal.via), (metal.via, upper.name)]
    names = [rules.metals[0], rules.metals[-1]]
    return {
        "layers": layers,
        "body": list(rules.body),
        "ends": list(rules.ends),
        "conductors": conductors,
        "connections": connections,
        "texts": [(metal.name, metal.text) for metal in names],
        "outline": rules.outline,
        "rules": list(_rules(rules)) if check_rules else [],
    }


def _rules(rules: LayoutRules) -> Iterator[dict[str, Any]]:
    """Yield the design rules that the extraction script checks, as dictionaries.

    Keys: ``name``, ``kind`` ("width", "space", "size", "enclosure", "separation", "margin", "area" or "grid"),
    ``layer``, ``other`` (second layer, or None) and ``value`` in nanometres (nm^2 for an area).
    """

    def rule(kind: str, layer: str, value: int, other: str | None = None) -> dict[str, Any]:
        relation = {"enclosure": "by", "margin": "by", "separation": "from"}.get(kind)
        words = f"{kind} of {layer}" + (f" {relation} {other}" if relation else "")
        limit = f"{value * 1e-6:g} um^2" if kind == "area" else f"{value * 1e-3:g} um"
        return {"name": f"{words}: {limit}", "kind": kind, "layer": layer, "other": other, "value": value}

    yield rule("width", "resistor", rules.width)
    yield rule("space", "resistor", rules.space)
    yield rule("size", "contact", rules.contact_size)
    yield rule("space", "contact", rules.contact_space)
    yield rule("enclosure", "contact", rules.contact_enclosure, "end")
    yield rule("separation", "contact", rules.contact_distance, "body")
    yield rule("enclosure", "contact", rules.contact_metal, rules.metals[0].name)
    if rules.passivation is not None:
        yield rule("enclosure", "opening", rules.pad_opening, rules.metals[-1].name)
    for cover in (*rules.body_covers, *rules.covers):
        kind = "margin" if cover in rules.body_covers else "enclosure"
        yield rule(kind, "resistor", cover.beside, cover.name)
        yield from (rule(kind, cover.name, value) for kind in ("width", "space") if (value := getattr(cover, kind)))
    for metal, upper in zip(rules.metals, [*rules.metals[1:], None], strict=True):
        yield rule("width", metal.name, metal.width)
        yield rule("space", metal.name, metal.space)
        if metal.area:
            yield rule("area", metal.name, metal.area)
        yield rule("grid", metal.name, rules.grid)
        if upper is not None:
            yield rule("size", metal.via, metal.via_size)
            yield rule("space", metal.via, metal.via_space)
            yield rule("enclosure", metal.via, metal.via_enclosure, metal.name)
            yield rule("enclosure", metal.via, metal.via_enclosure, upper.name)
    for layer in ("resistor", "contact"):
        yield rule("grid", layer, rules.grid)


def _extraction(file: Path, rules: LayoutRules, data: dict[str, Any]) -> Extraction:
    """Return the extracted circuit from `data`, the JSON object that the extraction script prints.

    `file`: name of the layout, for messages; `rules`: design rules of its process, which give the resistances. Raises
    InputError if the layout has another unit than 1 nm, or no label with the measures of tiles.
    """
    if abs(data["dbu"] - 1e-3) > 1e-12:
        raise InputError(f"{file}: its unit is {data['dbu']} um, expected 0.001 um; write the layout again")
    tile = next((match for text, *_ in data["texts"] if (match := _TILE.fullmatch(text))), None)
    if tile is None:
        raise InputError(f"{file}: the label with the pitch of the tiles is absent; write the layout again")
    pitch = tuple(int(number) for number in tile.groups())
    nets: dict[tuple[str, int], int | None] = {}
    ohms: dict[str, float] = {}
    place: dict[str, tuple[float, float]] = {}
    for x, y, area, width, corners, left, right in data["resistors"]:
        name = _resistor_name(x, y, pitch)
        while name in ohms:
            name += "_again"
        ohms[name] = rules.resistance(area, width, corners)
        nets[name, 1], nets[name, 2] = left, right
        place[name] = (x * 1e-3, y * 1e-3)
    labels = []
    pads: Counter[str] = Counter()
    for text, metal, x, y, net in data["labels"]:
        if metal == rules.metals[-1].name:
            pads[text] += 1
            name = pad_name(text, pads[text])
            nets[name, 1] = net
            place[name] = (x * 1e-3, y * 1e-3)
        else:
            labels.append((text, x * 1e-3, y * 1e-3, net))
    violations = tuple(
        f"{name}: {count} {'place violates' if count == 1 else 'places violate'} this rule, the first at "
        f"({places[0][0] * 1e-3:.3f}, {places[0][1] * 1e-3:.3f}) um"
        for name, count, places in data["violations"]
    )
    return Extraction(pitch, nets, ohms, place, tuple(labels), violations, tuple(data["messages"]))


def _resistor_name(x: int, y: int, pitch: tuple[int, ...]) -> str:
    """Return the reference of a resistor, such as ``RX_3_4``, from the lower left corner (x, y) of its body, in nm.

    `pitch`: distances of tiles along x and y, and y of the resistor along y in its tile, in nanometres.
    """
    px, py, upper = pitch
    i = round(x / px - 0.25)
    candidates = [(abs(y - j * py - offset), axis, j) for axis, offset in ((0, 0), (1, upper)) for j in
                  (round((y - offset) / py),)]  # fmt: skip
    _, axis, j = min(candidates)
    return f"RX_{i + 1}_{j}" if axis == 0 else f"RY_{i}_{j + 1}"
