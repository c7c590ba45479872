"""Reports and manufacturing files of kicad-cli for a board: rule checks, netlists, values, and connected copper."""

from __future__ import annotations

import csv
import io
import json
import re
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from resgrid._internal.files import read_text
from resgrid.errors import InputError
from resgrid.hardware.copper import Copper, connect_copper
from resgrid.hardware.excellon import Hole, read_excellon
from resgrid.hardware.gerber import CopperShape, read_gerber
from resgrid.hardware.ipc_d356 import NO_NET, TestPoint, read_ipc_d356
from resgrid.hardware.order_files import compare_order, copper_layer
from resgrid.hardware.tools import KicadCli

_PROJECT = (".kicad_pcb", ".kicad_sch", ".kicad_pro", ".kicad_dru", ".kicad_sym")
_TABLES = ("fp-lib-table", "sym-lib-table")
_DRC, _ERC, _TEST, _PLACES, _SPICE = "drc.json", "erc.json", "board.d356", "places.csv", "board.cir"
_ORIGIN = re.compile(r"\(aux_axis_origin\s+(\S+)\s+([^\s)]+)\s*\)")
_RUNS = 2
"""Number of kicad-cli processes that run at the same time; each needs about 200 MB of memory."""


@dataclass(frozen=True)
class RuleReport:
    """Result of kicad-cli's rule checks.

    `errors`: one message per violation; `warnings`: number of warnings by KiCad's name of their type.
    """

    errors: tuple[str, ...] = ()
    warnings: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class BoardReports:
    """Reports and files of kicad-cli about a board.

    `rules`: violations of design rules, and of electrical rules of the schematic; `points`: test points of the
    IPC-D-356 file; `copper`: connected copper of the Gerber layers and drill files; `order`: one message for each
    difference of ``gerbers.zip``, the archive for a manufacturer, from the board; `values`: text of each part's value
    on the board, by reference; `spice`: SPICE netlist of the schematic, None without a schematic.
    """

    rules: RuleReport
    points: tuple[TestPoint, ...]
    copper: Copper
    order: tuple[str, ...]
    values: Mapping[str, str]
    spice: str | None


def report_board(kicad: KicadCli, board: Path, folder: Path, timeout: float) -> BoardReports:
    """Run kicad-cli on a copy of a board, and return the reports and files of kicad-cli.

    `board`: the file ``.kicad_pcb``; `folder`: empty temporary folder; `timeout`: longest run of kicad-cli, in seconds.
    Raises InputError if kicad-cli cannot read the board.
    """
    copy = _copy_project(board, folder)
    schematic = copy.with_suffix(".kicad_sch")
    gerbers = folder / "gerbers"
    gerbers.mkdir()
    parity = ["--schematic-parity"] if schematic.exists() else []
    runs: list[list[str | Path]] = [
        ["pcb", "drc", "--format", "json", "--severity-all", *parity, "-o", folder / _DRC, copy],
        ["pcb", "export", "gerbers", "-l", "*.Cu", "-o", f"{gerbers}/", copy],
        ["pcb", "export", "drill", "--excellon-separate-th", "-o", f"{gerbers}/", copy],
        ["pcb", "export", "ipcd356", "-o", folder / _TEST, copy],
        ["pcb", "export", "pos", "--format", "csv", "--units", "mm", "-o", folder / _PLACES, copy],
    ]
    if schematic.exists():
        runs += [
            ["sch", "erc", "--format", "json", "--severity-all", "-o", folder / _ERC, schematic],
            ["sch", "export", "netlist", "--format", "spice", "-o", folder / _SPICE, schematic],
        ]
    try:
        with ThreadPoolExecutor(_RUNS) as pool:
            list(pool.map(lambda arguments: kicad.run(*arguments, timeout=timeout), runs))
    except InputError as error:
        raise InputError(str(error).replace(str(copy), str(board))) from None
    layers, plated, unplated = _layers(gerbers), _holes(gerbers, "PTH"), _holes(gerbers, "NPTH")
    return BoardReports(
        rules=_rules(folder),
        points=_on_board(read_ipc_d356(folder / _TEST), read_text(copy)),
        copper=connect_copper([layers[number] for number in sorted(layers)], plated, unplated),
        order=tuple(compare_order(board.parent, layers, [*plated, *unplated])),
        values=_values(read_text(folder / _PLACES)),
        spice=read_text(folder / _SPICE) if schematic.exists() else None,
    )


def _copy_project(board: Path, folder: Path) -> Path:
    """Copy the files of a KiCad project to `folder`, because kicad-cli writes next to them.

    Return the path of the copied board.
    """
    for file in sorted(board.parent.iterdir()):
        if file.suffix == ".pretty" and file.is_dir():
            shutil.copytree(file, folder / file.name)
        elif (file.suffix in _PROJECT or file.name in _TABLES) and file.is_file():
            shutil.copyfile(file, folder / file.name)
    return folder / board.name


def _rules(folder: Path) -> RuleReport:
    """Return the errors and warnings of kicad-cli's rule checks of a board.

    Errors are violations of design rules, of electrical rules, and differences between schematic and board. `folder`:
    folder with the JSON reports of kicad-cli.
    """
    design = json.loads(read_text(folder / _DRC))
    electrical = folder / _ERC
    sheets = json.loads(read_text(electrical))["sheets"] if electrical.exists() else []
    groups = [
        ("design rules", design["violations"] + design["unconnected_items"], False),
        ("schematic and board differ", design["schematic_parity"], True),
        ("electrical rules", [violation for sheet in sheets for violation in sheet["violations"]], False),
    ]
    errors: list[str] = []
    warnings: Counter[str] = Counter()
    for words, violations, strict in groups:
        for violation in violations:
            if violation["severity"] == "error" or (strict and violation["severity"] == "warning"):
                errors.append(f"{words}: {_violation(violation)}")
            elif violation["severity"] == "warning":
                warnings[violation["type"]] += 1
    return RuleReport(tuple(dict.fromkeys(errors)), dict(warnings))


def _violation(violation: Mapping[str, Any]) -> str:
    """Return one line of text about a violation in a report of kicad-cli, with its items and their places in mm."""
    items = [
        f"{item['description']} at ({item['pos']['x']:.2f}, {item['pos']['y']:.2f}) mm" for item in violation["items"]
    ]
    return f"{violation['description'].rstrip('.')}: {'; '.join(items)}" if items else str(violation["description"])


def _on_board(points: Iterable[TestPoint], board: str) -> tuple[TestPoint, ...]:
    """Return test points with positions in mm from the upper left corner of the sheet, y upwards, as in Gerber files.

    KiCad writes IPC-D-356 files relative to the drill origin, a point that the board file states (the corner of the
    sheet if it does not). `points`: test points of the IPC-D-356 file; `board`: text of the board file, in which y
    points downwards.
    """
    match = _ORIGIN.search(board)
    x, y = (float(match[1]), -float(match[2])) if match else (0.0, 0.0)
    return tuple(replace(point, position=(point.position[0] + x, point.position[1] + y)) for point in points)


def _layers(gerbers: Path) -> dict[int, list[CopperShape]]:
    """Return the copper shapes of each layer, by the number of the layer, 1 for the front.

    `gerbers`: folder of Gerber files.
    """
    layers = {}
    for file in sorted(gerbers.iterdir()):
        if file.suffix.startswith((".g", ".G")) and (number := copper_layer(read_text(file))):
            layers[number] = read_gerber(file)
    if not layers:
        raise InputError("kicad-cli wrote no Gerber layer of copper; does the board have copper layers?")
    return layers


def _holes(gerbers: Path, kind: str) -> list[Hole]:
    """Return the holes of a board.

    `gerbers`: folder of drill files; `kind`: "PTH" for plated holes, "NPTH" for others.
    """
    return [hole for file in sorted(gerbers.glob(f"*-{kind}.drl")) for hole in read_excellon(file)]


def _values(text: str) -> dict[str, str]:
    """Return the value text of each part, such as ``10k``, by reference; `text`: CSV file of placements."""
    return {row["Ref"]: row["Val"] for row in csv.DictReader(io.StringIO(text))}


def stated_nets(points: Iterable[TestPoint]) -> dict[tuple[str, int], str | None]:
    """Return the net that an IPC-D-356 file states for every numbered pad, None for a pad that is not connected.

    The key is the reference of the part and the number of the pad. `points`: test points of the file.
    """
    return {pad: None if point.net == NO_NET else point.net for pad, point in _pads(points)}


def copper_nets(points: Iterable[TestPoint], copper: Copper) -> dict[tuple[str, int], int | None]:
    """Return the number of the set of connected copper shapes at every numbered pad, None for a pad without copper.

    The key is the reference of the part and the number of the pad. `points`: test points, which give the places of
    pads.
    """
    return {pad: copper.probe(point.position, point.access) for pad, point in _pads(points)}


def _pads(points: Iterable[TestPoint]) -> Iterator[tuple[tuple[str, int], TestPoint]]:
    """Yield the key (reference, pad number) and the test point of every pad with a number; vias have no number."""
    for point in points:
        if point.pin.isdecimal():
            yield (point.reference, int(point.pin)), point
