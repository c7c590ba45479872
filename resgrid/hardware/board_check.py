"""Verification of a board against its record, by kicad-cli, ngspice and the copper of its Gerber files."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path

from resgrid._internal.files import read_bytes, temporary_folder
from resgrid.errors import CircuitError, InputError, ToolMissingError
from resgrid.hardware.comparison import (
    VoltageComparison,
    compare_nets,
    compare_values,
    compare_voltages,
    pads_of,
    short_circuit,
)
from resgrid.hardware.extracted_circuit import read_kicad_spice, simulate_kicad_spice, solve_extracted
from resgrid.hardware.hardware_check import HardwareCheck
from resgrid.hardware.kicad_reports import BoardReports, copper_nets, report_board, stated_nets
from resgrid.hardware.list_checks import check_lists
from resgrid.hardware.record import HardwareRecord, read_record
from resgrid.hardware.tools import TIMEOUT, find_kicad
from resgrid.scene.quantities import parse_quantity

TOLERANCE = 1e-9
"""Default of the largest accepted absolute error of a net's voltage, as a fraction of the supply voltage."""


@dataclass
class _Work:
    """Results that the stages of a verification collect.

    `findings`: messages about differences from the record, and about violated rules; `remarks`: messages about stages
    that could not be done, and warnings; `voltages`: comparisons of the record's voltages with those of other circuits;
    `tools`: version of each outside program by its name; `complete`: whether every stage was done.
    """

    findings: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    voltages: list[VoltageComparison] = field(default_factory=list)
    tools: dict[str, str] = field(default_factory=dict)
    complete: bool = True


def check_board(
    file: str | os.PathLike[str], *, tolerance: float = TOLERANCE, timeout: float = TIMEOUT
) -> HardwareCheck:
    """Verify a board by outside programs, and return the differences from its record.

    kicad-cli checks the rules of board and schematic, and writes IPC-D-356, Gerber, drill and placement files and a
    SPICE netlist.  The record beside the board is a JSON file that lists the intended parts, nets and voltages.  Four
    results are compared with the record, part by part and net by net: the nets that the board file states (IPC-D-356),
    the nets that the copper of the Gerber and drill files connects, the schematic (SPICE netlist), and the values on
    the board.  The voltages of the connected copper (by `resgrid.solve`) and of the SPICE netlist (by ngspice) are
    compared with the record's voltages, and these with the solution of the record's own circuit.  The bill of
    materials, the list of expected voltages and the archive ``gerbers.zip`` are compared if they lie next to the board.

    Parameters
    ----------
    file : str or path
        The board ``NAME.kicad_pcb``, its project ``NAME.kicad_pro``, or a folder with one board.
    tolerance : float
        Largest accepted absolute error of a voltage, as a fraction of the supply.
    timeout : float
        Longest run of an outside program, in seconds.

    Returns
    -------
    HardwareCheck
        Findings with their places.  `verified` is False without kicad-cli, without ngspice, or without a schematic.

    Raises
    ------
    InputError
        If the board or its record is absent or damaged.
    BudgetError
        If a program exceeds the time limit.

    Examples
    --------
    >>> rg.hardware.check_board("nowhere.kicad_pcb")
    Traceback (most recent call last):
        ...
    resgrid.errors.InputError: nowhere.kicad_pcb: there is no such file; check the name and the folder
    """
    board = find_board(Path(file))
    record = read_record(board)
    if record.kind != "board":
        raise InputError(f"{board}: its record describes a {record.kind}; write the board again")
    work = _Work()
    _check_record(work, record, tolerance)
    work.findings += check_lists(record, board.parent)
    try:
        kicad = find_kicad()
    except ToolMissingError as error:
        return HardwareCheck(False, tuple(work.findings), tolerance=tolerance, remark=str(error))
    work.tools["kicad-cli"] = kicad.version
    with temporary_folder() as folder:
        reports = report_board(kicad, board, folder, timeout)
    _check_nets(work, record, reports)
    _check_board_circuit(work, record, reports, tolerance)
    _check_schematic(work, record, reports, tolerance, timeout)
    _check_rules(work, reports)
    work.findings += reports.order
    return _result(work, record, tolerance)


def find_board(path: Path) -> Path:
    """Return the file ``.kicad_pcb`` of a board; raise InputError unless there is exactly one.

    `path`: this file, a project ``.kicad_pro`` or schematic ``.kicad_sch`` of the same name, or a folder.
    """
    if path.is_dir():
        boards = sorted(path.glob("*.kicad_pcb"))
        if len(boards) != 1:
            names = ", ".join(board.name for board in boards[:3])
            raise InputError(
                f"{path} holds {len(boards)} boards ({names}); name one of the files" if boards else
                f"{path} holds no board (.kicad_pcb); write one with 'resgrid board SCENE -o {path}'"
            )  # fmt: skip
        return boards[0]
    board = path.with_suffix(".kicad_pcb") if path.suffix in (".kicad_pro", ".kicad_sch") else path
    read_bytes(board, first=0, piped=False)  # raises InputError if the board is absent
    return board


def _check_record(work: _Work, record: HardwareRecord, tolerance: float) -> None:
    """Add a finding for each voltage in a record that differs from the solution of the record's own circuit.

    `work`: results, changed in place; `tolerance`: largest accepted absolute error as a fraction of the supply voltage.
    """
    values = {part.reference: part.value for part in record.parts}
    volts = solve_extracted(record, dict(pads_of(record)), values)
    compared = compare_voltages(record, volts, tolerance, "resgrid")
    work.findings += [f"the record contradicts itself: {finding}" for finding in compared.findings]


def _check_rules(work: _Work, reports: BoardReports) -> None:
    """Add violations of design and electrical rules to `work.findings`, and counts of warnings to `work.remarks`.

    `reports`: files of kicad-cli about the board.
    """
    work.findings += reports.rules.errors
    if reports.rules.warnings:
        counts = ", ".join(f"{count} {kind}" for kind, count in sorted(reports.rules.warnings.items()))
        work.remarks.append(f"warnings of kicad-cli: {counts}")


def _check_nets(work: _Work, record: HardwareRecord, reports: BoardReports) -> None:
    """Add the differences of nets between the board and the record to `work.findings`.

    Two sets of nets are compared with the record: the nets that the copper connects, and the nets that the board file
    states. Touching copper of different stated nets also gives a finding. `reports`: files of kicad-cli about the
    board.
    """
    copper = compare_nets(record, copper_nets(reports.points, reports.copper))
    stated = compare_nets(record, stated_nets(reports.points))
    contacts = {short_circuit(*contact.nets): contact for contact in reports.copper.contacts}
    for message in copper:
        work.findings.append(f"copper: {message}" + (f" at {contacts.pop(message)}" if message in contacts else ""))
    work.findings += [f"IPC-D-356: {message}" for message in stated if message not in copper]
    work.findings += [
        f"copper: the board file states {' and '.join(contact.nets)} for touching copper at {contact}"
        for contact in contacts.values()
    ]


def _check_board_circuit(work: _Work, record: HardwareRecord, reports: BoardReports, tolerance: float) -> None:
    """Compare the circuit of the board's copper and part values with the record, and add the differences to `work`.

    `reports`: files of kicad-cli about the board; `tolerance`: largest accepted voltage error relative to the supply.
    """
    values = {reference: _ohms(text) for reference, text in reports.values.items()}
    resistors = [part.reference for part in record.parts if part.type == "resistor"]
    stated = {point.reference for point in reports.points}
    work.findings += [
        f"{reference} has no value in the placement file; remove 'exclude from position files'"
        for reference in resistors
        if reference in stated and reference not in values
    ]
    work.findings += [f"board: {message}" for message in compare_values(record, values)]
    try:
        volts = solve_extracted(record, copper_nets(reports.points, reports.copper), values)
    except (CircuitError, InputError) as error:
        work.findings.append(f"copper: the circuit has no operating point: {error}")
        return
    _add_voltages(work, compare_voltages(record, volts, tolerance, "the copper's circuit"))


def _ohms(text: str) -> float | None:
    """Return the value text of a part on a board in ohms, None if it is not a number."""
    try:
        return parse_quantity(text.strip().removesuffix("Ω").strip())
    except InputError:
        return None


def _check_schematic(
    work: _Work, record: HardwareRecord, reports: BoardReports, tolerance: float, timeout: float
) -> None:
    """Compare KiCad's SPICE netlist of the schematic, and its voltages from ngspice, with the record; add to `work`.

    `reports`: files of kicad-cli, which contain the netlist; `tolerance`: largest accepted error of a voltage relative
    to the supply; `timeout`: longest run of ngspice, in seconds. Without a schematic or ngspice, `work.complete`
    becomes False.
    """
    if reports.spice is None:
        work.remarks.append("the folder has no schematic, so KiCad's SPICE netlist was not compared")
        work.complete = False
        return
    netlist = read_kicad_spice(reports.spice)
    resistors = replace(record, parts=tuple(part for part in record.parts if part.type == "resistor"))
    work.findings += [f"schematic: {message}" for message in compare_nets(resistors, netlist.nets)]
    work.findings += [f"schematic: {message}" for message in compare_values(record, netlist.values)]
    try:
        volts, run = simulate_kicad_spice(record, netlist, timeout)
    except ToolMissingError as error:
        work.remarks.append(str(error))
        work.complete = False
        return
    work.tools[run.simulator] = run.version
    work.findings += [f"schematic: {complaint}" for complaint in run.complaints]
    _add_voltages(work, compare_voltages(record, volts, tolerance, run.simulator))


def _add_voltages(work: _Work, compared: VoltageComparison) -> None:
    """Add a comparison of voltages to `work`, and its findings if `work` has no finding yet.

    An earlier finding, such as a wrong net, is the cause of wrong voltages.
    """
    work.voltages.append(compared)
    if not work.findings:
        work.findings += compared.findings


def _result(work: _Work, record: HardwareRecord, tolerance: float) -> HardwareCheck:
    """Return the result of a verification from the collected results `work`.

    `record`: the record of the board; `tolerance`: largest accepted error of a voltage relative to the supply.
    """
    compared = [each for each in work.voltages if each.max_abs_error is not None]
    worst = max(compared, key=lambda each: each.max_abs_error or 0.0, default=VoltageComparison())
    return HardwareCheck(
        verified=work.complete,
        findings=tuple(dict.fromkeys(work.findings)),
        max_abs_error=worst.max_abs_error,
        max_relative_error=worst.max_relative_error,
        nodes=max((compared.nodes for compared in work.voltages), default=0),
        parts=len(record.parts),
        tools=work.tools,
        tolerance=tolerance,
        worst=worst.worst,
        remark="; ".join(work.remarks),
    )
