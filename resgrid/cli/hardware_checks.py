"""Verification of boards and layouts by outside programs, and its report, for ``resgrid check``."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import resgrid as rg
from resgrid.cli.decks import refuse_deck_options, refuse_scene_options
from resgrid.cli.terminal import NEGATIVE, NOT_VERIFIED, counted, finish, stage

if TYPE_CHECKING:
    from collections.abc import Iterable

    from resgrid.cli.options import CommandInput
    from resgrid.hardware.hardware_check import HardwareCheck

_BOARDS = (".kicad_pcb", ".kicad_pro", ".kicad_sch")
_LAYOUTS = (".gds", ".oas")
_SHOWN = 20
"""Maximum number of findings (differences) that are printed as text; JSON has all."""


def is_hardware(file: str) -> bool:
    """Return whether an input is a board, a layout, or a folder with a board."""
    path = Path(file)
    return path.suffix.lower() in (*_BOARDS, *_LAYOUTS) or (path.is_dir() and any(path.glob("*.kicad_pcb")))


def check_hardware(source: CommandInput, tolerance: float, timeout: float) -> int:
    """Verify a board or layout, print the result, and return the exit code.

    The code is 0 for agreement, 1 for a difference and 5 if a check could not be done.  `source`: the input;
    `tolerance`: largest accepted error of a voltage, relative to the supply; `timeout`: limit of each run of an outside
    program, in seconds.
    """
    refuse_scene_options(source, "board or layout")
    refuse_deck_options(source, "a board or layout")
    path = Path(source.file)
    is_layout = path.suffix.lower() in _LAYOUTS
    with stage("extract and compare the circuit"):
        verify = rg.hardware.check_layout if is_layout else rg.hardware.check_board
        result = verify(path, tolerance=tolerance, timeout=timeout)
    finish(hardware_data(result), hardware_lines(result))
    return NOT_VERIFIED if result.agrees is None else 0 if result.agrees else NEGATIVE


def hardware_data(result: HardwareCheck) -> dict[str, Any]:
    """Return the result of a verification as a dictionary for JSON: ``agrees``, and the fields of `HardwareCheck`.

    ``agrees`` is False if there is a finding, and None if there is no finding but a check could not be done.
    """
    worst = [{"node": net, "expected": expected, "got": got} for net, expected, got in result.worst]
    return {"agrees": result.agrees} | dataclasses.asdict(result) | {"worst": worst}


def hardware_lines(result: HardwareCheck) -> Iterable[str]:
    """Yield the lines of text about a verification: the verdict, then the differences, then remarks."""
    tools = " and ".join(f"{name} {version}" for name, version in result.tools.items()) or "the record"
    if result.agrees:
        error = result.max_relative_error
        largest = "" if error is None else f"; the largest error of a voltage is {error:.1e} of the supply"
        counts = f"{counted(result.parts, 'part')} and {counted(result.nodes, 'net')}"
        verb = "confirm" if len(result.tools) > 1 else "confirms"
        yield f"{tools} {verb} the record with {counts}{largest}"
    elif result.findings:
        yield f"the {result.kind} DISAGREES with its record: {counted(len(result.findings), 'finding')} ({tools})"
    if not result.verified:
        yield f"not verified: {result.remark}"
    yield from (f"  {finding}" for finding in result.findings[:_SHOWN])
    if len(result.findings) > _SHOWN:
        yield f"  and {len(result.findings) - _SHOWN:,} more; --json lists all findings"
    if result.verified and result.remark:
        yield f"  {result.remark}"
