"""Writer of the README in a board's folder: ordering, soldering, measuring, expected values, troubleshooting."""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import sqrt
from textwrap import fill
from typing import TYPE_CHECKING

from resgrid.chip.figures_of_merit import Proportion, formatted
from resgrid.hardware.bill import SPARE, bill_rows
from resgrid.hardware.board_circuit import MOST_HEAT
from resgrid.hardware.e_series import resistance_text

if TYPE_CHECKING:
    from resgrid.hardware.board import Board

_MOST_VOLTS = 12.0
"""Upper limit, in volts, of the supply voltages that the README permits in place of the scene's own.

The power that the resistors withstand may lower this limit.
"""

CHEAP = 100.0
"""Largest width and height of boards, in millimetres, for which manufacturers charge least."""


def format_readme(board: Board, yields: Mapping[int, Proportion], *, manufactured: bool) -> str:
    """Return the text of ``README.md`` in the folder of a board.

    `yields`: fraction of starts on simulated boards from which a robot arrives at a goal, by the resolution of the
    converter in bits; `manufactured`: whether the folder contains the files for a manufacturer; otherwise the text
    explains how to make them.
    """
    parts = (
        _head(board),
        _order(board, manufactured=manufactured),
        _solder(board),
        _measure(board),
        _yield(board, yields),
    )
    blocks = "\n\n".join((*parts, _help(board), _files(board, manufactured=manufactured))).split("\n\n")
    return "\n\n".join(map(_filled, blocks)) + "\n"


def _filled(block: str) -> str:
    """Return a paragraph or list with lines of at most 100 characters; return headings and tables unchanged."""
    if block.startswith(("#", "|")):
        return block
    items: list[str] = []
    for line in block.splitlines():
        begins = re.match(r"(- |\d+\. )", line)
        if begins or not items:
            items.append(line)
        else:
            items[-1] += " " + line.strip()
    indents = [" " * len(begins[0]) if (begins := re.match(r"(- |\d+\. )", item)) else "" for item in items]
    return "\n".join(
        fill(item, 100, subsequent_indent=indent, break_on_hyphens=False)
        for item, indent in zip(items, indents, strict=True)
    )


def _head(board: Board) -> str:
    """Return title and purpose of the board as Markdown."""
    width, height = board.size
    wiring = board.circuit.wiring
    high = f"obstacles are at {wiring.supply:g} V"
    if wiring.is_driven:
        high = f"obstacles have no resistors, the start is at {wiring.supply:g} V"
    small = max(width, height) <= CHEAP
    price = (
        "It fits into 100 x 100 mm, the size up to which manufacturers charge least."
        if small
        else "It is larger than 100 x 100 mm, so ask for the price before you order; a scene with fewer cells, or "
        "`--pitch 5.08` for a fixed board, makes it smaller."
    )
    about = {
        "fixed": "The board shows one scene: its obstacles are hatched, and starts and goals are named.",
        "jumpers": "The board serves every scene of its size: solder bridges make cells obstacles or goals. "
        "`jumper_plan.pdf` shows the bridges of this scene.",
    }[board.kind]
    return f"""# {board.title}: a resistor grid for the classroom

A robot finds its way in this circuit: every cell of the map is a point of a grid of resistors,
{high}, and the goal is at 0 V. The voltage has no local minimum, so a
robot that always steps to the neighbour with the lowest voltage arrives at the goal (Tarassenko & Blake 1991). {about}

- size: {width:.1f} x {height:.1f} mm, two layers. {price}
- cells: {board.subtitle}
- supply: {wiring.supply:g} V, {formatted(board.supply_current, "A")}, {formatted(board.power, "W")}
- largest deviation of a resistor (E96 series) from its exact value: {100 * board.largest_deviation:.2g} %"""


def _order(board: Board, *, manufactured: bool) -> str:
    """Return the section about ordering the board and its parts as Markdown.

    `manufactured`: whether the folder contains the files for a manufacturer; otherwise the section explains how to make
    them.
    """
    rows = "\n".join(
        f"| {quantity} | {value} | {package} | {tolerance} | {about} |"
        for _, quantity, value, package, tolerance, about in bill_rows(board)
    )
    spare = len(board.circuit.resistors)
    upload = (
        "Upload `gerbers.zip` to a manufacturer of printed circuit boards. All of its default settings are suitable: "
        "2 layers, 1.6 mm, any colour."
        if manufactured
        else "Open `grid.kicad_pro` with KiCad 9 and plot the Gerber and drill files (File, Fabrication Outputs), "
        "or install kicad-cli and write this folder again."
    )
    return f"""## What to order

{upload} Then buy the parts of one board (`bill_of_materials.csv` has the references):

| quantity | value | package | tolerance | part |
|---|---|---|---|---|
{rows}

Order some more resistors, about {max(5, round(spare * SPARE))}: some get lost. All parts are on the front. The
header rows are only needed for a converter, the screws only for a case."""


def _solder(board: Board) -> str:
    """Return the section about soldering as Markdown."""
    values = sorted({part.ohms for part in board.circuit.resistors})
    first = (
        f"All resistors have the same value, {resistance_text(values[0])}, so no resistor can be exchanged for another."
        if len(values) == 1
        else f"There are {len(values)} values, so solder one value after the other by the list of references."
    )
    text = f"""## How to solder

1. Resistors first, row by row. Wet one pad with solder, push the resistor into it with tweezers, solder the other
   side, and touch up the first one. {first} Their direction does not matter.
2. Then the screw terminal J1, wire entries towards the edge, and the pin headers.
3. Plug a jumper cap onto each goal link. It ties the goal to ground; an ammeter in its place measures the current
   of that goal."""
    if board.kind == "jumpers":
        text += """
4. Bridge the solder jumpers of the plan with a drop of solder: middle pad and O for an obstacle, middle pad and G
   for a goal. The jumper of a cell is at the upper right of its test pad. Never bridge all three pads: this joins
   supply and ground. Solder wick removes a bridge."""
    return text


def _measure(board: Board) -> str:
    """Return the section about measurements and expected values as Markdown."""
    circuit = board.circuit
    goals = ", ".join(f"{name}: {formatted(amps, 'A')}" for name, amps in circuit.goal_currents.items())
    volts = circuit.wiring.supply
    most = min(_MOST_VOLTS, abs(volts) * sqrt(0.5 * MOST_HEAT / circuit.hottest))
    examples = [
        placed for placed in board.placement.test_pads
        if placed.nets[0] not in (circuit.high_net, *circuit.goal_nets)
        and circuit.voltages[placed.nets[0]] < 0.95 * volts
    ]  # fmt: skip
    rows = "\n".join(
        f"| {placed.value} | {circuit.voltages[placed.nets[0]]:.3f} V |"
        for placed in examples[:: max(1, len(examples) // 6)][:6]
    )
    table = (
        f"\n\nSome pads with clear differences:\n\n| pad (column, row) | expected |\n|---|---|\n{rows}" if rows else ""
    )
    back = " They are also printed on the back of the board." if board.kind == "fixed" else ""
    return f"""## What to measure

Connect {volts:g} V to J1: plus to `{volts:+g}V`, minus to `GND`. Exchanged wires do no harm, but all voltages
are negative then. Any other supply of up to {most:.2g} V also works: all voltages are proportional to it.

- Supply current: {formatted(circuit.supply_current, "A")}. Current into each goal: {goals}.
- Voltage of each pad against GND: `expected_voltages.csv`, by column (x) and row (y).{back} With resistors of
  {100 * board.tolerance:g} % most pads agree within {100 * board.tolerance:g} % of the supply.
- The path: put a counter on a start, measure the four neighbours, move to the lowest one, and repeat.
- The converter headers bring out the voltages of cells that are spread over the board; their pins name the cell.
  J2 has the supply for the converter's reference, and ground.{table}"""


def _yield(board: Board, yields: Mapping[int, Proportion]) -> str:
    """Return the section about the predicted yield as Markdown.

    `yields`: fraction of starts on simulated boards from which a robot arrives at a goal, by the resolution of the
    converter in bits.
    """
    advice = "If too few starts arrive, take a finer converter."
    if board.circuit.wiring.boundary == "dirichlet":
        advice = (
            "Obstacles at the supply flatten the voltages far from the goal. If too few starts arrive, take a finer "
            "converter, or write a fixed board with `--boundary wall --set chip.wall_resistance=100k`, or with "
            "`--boundary neumann --drive start`: their voltages differ more."
        )
    rows = "\n".join(f"| {bits} bits | {share} |" for bits, share in sorted(yields.items()))
    return f"""## Predicted yield

The fraction of starts from which a robot that reads the voltages with a converter arrives, for resistors with
{100 * board.tolerance:g} % tolerance (values uniformly distributed within the tolerance, simulated boards):

| converter from 0 V to the supply | starts that arrive |
|---|---|
{rows}

A multimeter with 2000 counts corresponds to 11 bits. {advice}"""


def _help(board: Board) -> str:
    """Return the section about troubleshooting as Markdown."""
    volts = board.circuit.wiring.supply
    jumper = (
        "\n| a whole area at one voltage | a bridge at a wrong cell | compare with the jumper plan |"
        if board.kind == "jumpers"
        else ""
    )
    return f"""## Troubleshooting

| observation | cause | remedy |
|---|---|---|
| all pads at {volts:g} V | the goal is not tied to ground | plug the caps onto the goal links |
| all pads at 0 V | no supply | measure between the pins of J2 |
| large supply current | short circuit between supply and ground | look for solder between pads |
| one pad far from its value | a cold joint or a missing resistor next to it | measure the resistors around it |
| a row of pads slightly off | one wrong value | compare the code on the resistors |
| a pad reads differently each time | the meter loads the grid | use a meter with at least 10 Mohm |{jumper}"""


def _files(board: Board, *, manufactured: bool) -> str:
    """Return the table of files in the board's folder as Markdown.

    `manufactured`: whether the folder contains the files for a manufacturer.
    """
    lines = [
        "| `grid.kicad_pro`, `.kicad_sch`, `.kicad_pcb` | the KiCad 9 project: open the first one |",
        "| `resgrid.kicad_sym`, `resgrid.pretty` | its symbols and footprints |",
        "| `bill_of_materials.csv` | parts to buy |",
        "| `expected_voltages.csv` | voltage of every pad |",
        "| `grid.record.json` | parts, nets and voltages for `resgrid check` |",
    ]
    if board.kind == "jumpers":
        lines.append("| `jumper_plan.pdf`, `jumper_plan.png` | the bridges of this scene |")
    if manufactured:
        lines += [
            "| `gerbers.zip` | files for the manufacturer |",
            "| `gerbers` | the same files, unpacked |",
            "| `positions.csv`, `grid.d356` | for assembly and electrical test by the manufacturer |",
            "| `schematic.pdf`, `board_front.png`, `board_back.png` | to print and to show |",
        ]
    return "## Files\n\n| file | contents |\n|---|---|\n" + "\n".join(lines)
