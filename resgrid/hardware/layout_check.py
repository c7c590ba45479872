"""Verification of a layout: klayout extracts its circuit, which is compared with the record of the layout."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from resgrid._internal.files import read_bytes
from resgrid.errors import CircuitError, InputError, ToolMissingError
from resgrid.hardware.comparison import (
    VoltageComparison,
    compare_nets,
    compare_values,
    compare_voltages,
    match_nets,
    pads_of,
)
from resgrid.hardware.extracted_circuit import solve_extracted
from resgrid.hardware.hardware_check import HardwareCheck
from resgrid.hardware.layout_extraction import Extraction, extract_layout
from resgrid.hardware.layout_process import layout_rules
from resgrid.hardware.record import HardwareRecord, read_record
from resgrid.hardware.tools import TIMEOUT, find_klayout

TOLERANCE = 1e-12
"""Default of the largest accepted absolute error of a net's voltage, as a fraction of the supply voltage."""

_NAME = re.compile(r"\b(?:R([XY])_(\d+)_(\d+)|(?:P_)?(goal_\d+(?:_\d+)?|obstacle(?:_\d+)?)|n_(\d+)_(\d+))")
"""Pattern that finds the names of resistors, pads, rails and nodes in messages about differences."""


def check_layout(
    file: str | os.PathLike[str], *, tolerance: float = TOLERANCE, timeout: float = TIMEOUT
) -> HardwareCheck:
    """Compare a layout with its record: devices, connections, labels, design rules, resistances and voltages.

    An outside Python interpreter with klayout extracts resistors and connections from the shapes of the layout alone,
    and checks widths, spacings and enclosures by the rules of the process.

    Parameters
    ----------
    file : path-like
        GDSII or OASIS file from `resgrid.save` or ``resgrid layout``, with its record in the same folder.
    tolerance : float
        Largest accepted absolute difference of a voltage, as a fraction of the supply.
    timeout : float
        Longest run of klayout, in seconds.

    Returns
    -------
    HardwareCheck
        The result; a finding names the part or net and its place in the layout.  `verified` is False without klayout.

    Raises
    ------
    InputError
        If the layout or its record cannot be read.
    BudgetError
        If klayout does not finish in time.

    Examples
    --------
    >>> space = rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))
    >>> file = rg.save(rg.hardware.build_layout(space, "toy:poly"), "lesson.gds")
    >>> rg.hardware.check_layout(file).agrees
    True
    """
    path = Path(file)
    read_bytes(path, first=0, piped=False)  # raises InputError if the layout is absent
    record = read_record(path)
    if record.kind != "layout" or record.process is None:
        state = "names no process" if record.kind == "layout" else "describes a board"
        raise InputError(f"{file}: its record {state}; write the layout again with 'resgrid layout'")
    try:
        tool = find_klayout()
    except ToolMissingError as error:
        return HardwareCheck(verified=False, tolerance=tolerance, remark=str(error), kind="layout")
    extraction = extract_layout(tool, path, layout_rules(record.process), timeout=timeout)
    owner = match_nets(pads_of(record), extraction.nets)
    findings = [
        *compare_nets(record, extraction.nets),
        *compare_values(record, extraction.ohms),
        *_wrong_labels(record, extraction, owner),
    ]
    voltages = _compare_voltages(record, extraction, tolerance)
    findings = [_located(message, extraction) for message in [*findings, *voltages.findings]]
    findings += [*extraction.messages, *extraction.violations]
    return HardwareCheck(
        verified=True,
        findings=tuple(findings),
        max_abs_error=voltages.max_abs_error,
        max_relative_error=voltages.max_relative_error,
        nodes=voltages.nodes,
        parts=len(record.parts),
        tools={"klayout": tool.version},
        tolerance=tolerance,
        worst=voltages.worst,
        kind="layout",
    )


def _wrong_labels(record: HardwareRecord, extraction: Extraction, owner: Mapping[object, str]) -> Iterator[str]:
    """Yield a message for every label of a node that lies on another net than its text names.

    `record`: its nets are the texts that are compared; `extraction`: the extracted circuit with its labels; `owner`:
    name of the expected net by the number of the net in the extraction.
    """
    for text, x, y, net in extraction.labels:
        if text in record.voltages and owner.get(net) != text:
            on = "no metal" if net is None else owner.get(net, "an unknown net")
            yield f"the label {text} at ({x:.3f}, {y:.3f}) um is on {on}"


def _compare_voltages(record: HardwareRecord, extraction: Extraction, tolerance: float) -> VoltageComparison:
    """Return the comparison of the voltages of the extracted circuit with the record.

    The comparison is empty if the extracted circuit has no solution, for instance with two sources on one net; the
    comparison of nets reports such faults. `tolerance`: largest accepted difference as a fraction of the supply.
    """
    try:
        found = solve_extracted(record, extraction.nets, extraction.ohms)
    except (CircuitError, InputError):
        return VoltageComparison()
    return compare_voltages(record, found, tolerance, "the extracted circuit")


def _located(message: str, extraction: Extraction) -> str:
    """Return a message with the places, in micrometres, of the parts and nodes that it names.

    A message about a split net names the first pad of every part of the net: the fault lies between their places.
    """
    if " um" in message:
        return message
    matches = [_NAME.search(words) for words in message.rsplit(" pads ", maxsplit=1)[-1].split(" | ")]
    found = {match.group(0): _place(match, extraction) for match in matches if match is not None}
    shown = {name: place for name, place in found.items() if math.isfinite(place[0])}
    places = " and ".join(f"{name} at ({x:.3f}, {y:.3f}) um" for name, (x, y) in shown.items())
    return f"{message}; {places}" if places else message


def _place(match: re.Match[str], extraction: Extraction) -> tuple[float, float]:
    """Return the place of a part or node in micrometres: the extracted place, or else the place of its tile.

    `match`: match of `_NAME` with the name. A pad that klayout did not find has the place (NaN, NaN).
    """
    axis, i, j, net, column, row = match.groups()
    px, py, upper = extraction.pitch
    name = f"P_{net}" if net else match.group(0)
    if name in extraction.place or net:
        return extraction.place.get(name, (math.nan, math.nan))
    if axis is None:
        return int(column) * px * 1e-3, int(row) * py * 1e-3
    if axis == "X":
        return (int(i) - 1) * px * 1e-3, int(j) * py * 1e-3
    return int(i) * px * 1e-3, ((int(j) - 1) * py + upper) * 1e-3
