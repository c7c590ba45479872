"""Writer of two CSV lists for a board: the bill of materials, and the expected voltages of the test pads."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from resgrid.core.cell import Cell
from resgrid.hardware.e_series import resistance_text
from resgrid.hardware.kicad.footprints import TERMINAL
from resgrid.hardware.placement import cell_of
from resgrid.hardware.record import natural_order

if TYPE_CHECKING:
    from resgrid.hardware.board import Board

BILL = "bill_of_materials.csv"
"""File name of the list with the parts to order."""

VOLTAGES = "expected_voltages.csv"
"""File name of the list with the expected voltage of every test pad."""

VOLTAGE_DIGITS = 6
"""Number of digits after the decimal point of the voltages in the list of expected voltages; voltages are in volts."""

SPARE = 0.05
"""Number of spare resistors to order, as a fraction of the number on the board; some are lost while soldering."""


def bill_rows(board: Board) -> list[tuple[str, int, str, str, str, str]]:
    """Return the rows of the bill of materials, one for each kind of part.

    A row contains the references of the parts as text such as ``R1-R3 R7``, the quantity, and as texts the value, the
    package, the tolerance and the description. Package and tolerance are empty for a kind of part without them.
    """
    by_value: dict[float, list[str]] = {}
    for part in board.circuit.resistors:
        by_value.setdefault(part.ohms, []).append(part.reference)
    tolerance = f"{100 * board.tolerance:g} %"
    rows = [
        (reference_ranges(names), len(names), f"{resistance_text(ohms)} ohm", "0603", tolerance, "resistor, E96 series")
        for ohms, names in sorted(by_value.items())
    ]
    headers: dict[int, list[str]] = {}
    for placed in board.placement.headers:
        if placed.footprint is TERMINAL:
            rows.append((placed.reference, 1, "2 poles", "5.08 mm", "", "screw terminal for the supply"))
        else:
            headers.setdefault(len(placed.nets), []).append(placed.reference)
    for pins, names in sorted(headers.items()):
        size = f"1 x {pins}, 2.54 mm"
        rows.append((reference_ranges(names), len(names), f"{pins} pins", size, "", "pin header, straight"))
    links = [placed.reference for placed in board.placement.headers if placed.value.startswith("LINK")]
    rows.append((reference_ranges(links), len(links), "shunt", "2.54 mm", "", "jumper cap that ties a goal to ground"))
    rows.append(("H1-H4", 4, "M3", "", "", "screw and spacer"))
    return rows


def reference_ranges(references: Iterable[str]) -> str:
    """Return references of parts as text, sorted and with ranges of consecutive numbers: ``R1-R3 R7``."""
    runs: list[list[str]] = []
    for name in sorted(references, key=natural_order):
        number = int(name.lstrip("RJHTP"))
        if runs and int(runs[-1][-1].lstrip("RJHTP")) == number - 1:
            runs[-1].append(name)
        else:
            runs.append([name])
    return " ".join(run[0] if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)


def format_bill(board: Board) -> str:
    """Return the bill of materials as CSV text, with one line for each kind of part.

    The columns are references, quantity, value, package, tolerance and description.
    """
    names = ("references", "quantity", "value", "package", "tolerance", "description")
    return _csv(names, bill_rows(board))


def format_voltages(board: Board) -> str:
    """Return the expected voltage of every test pad as CSV text.

    A line contains the reference of the pad; its cell (column from the left, row from the bottom, world coordinates of
    the cell's centre, and kind: free, obstacle or goal); its net; the voltage against ground, in volts; and the pin of
    a converter header on this net, such as J3.2. A converter header is a pin header for an analogue-to-digital
    converter; the pin is empty if no converter header has the net.
    """
    circuit, space = board.circuit, board.circuit.space
    pins = {
        placed.nets[pin]: f"{placed.reference}.{pin + 1}"
        for placed in board.placement.headers
        if placed.value.startswith("CONVERTER")
        for pin in range(len(placed.nets))
    }
    kinds = {Cell.FREE: "free", Cell.OBSTACLE: "obstacle", Cell.GOAL: "goal"}
    rows = []
    for placed in board.placement.test_pads:
        i, j = cell_of(placed)
        net = placed.nets[0]
        x, y = space.centre((i, j))
        kind = kinds[Cell(int(space.cell[i, j]))]
        rows.append(
            (
                placed.reference,
                i,
                j,
                f"{x:.6g}",
                f"{y:.6g}",
                kind,
                net,
                f"{circuit.voltages[net]:.{VOLTAGE_DIGITS}f}",
                pins.get(net, ""),
            )
        )
    names = (
        "pad",
        "column",
        "row",
        *(f"{axis.name}_of_cell" for axis in space.axes),
        "cell",
        "net",
        "volts",
        "header_pin",
    )
    return _csv(names, rows)


def _csv(names: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as CSV text: one line of column names `names`, then one line for each row of `rows`."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(rows)
    return text.getvalue()
