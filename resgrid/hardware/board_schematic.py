"""The schematic of a board: the grid as a grid of resistors, terminals, and sources for the simulation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from math import ceil

from resgrid.core.cell import Cell
from resgrid.hardware.board_circuit import BoardCircuit, GridResistor
from resgrid.hardware.e_series import resistance_text
from resgrid.hardware.kicad import symbols
from resgrid.hardware.kicad.footprints import LIBRARY, PlacedFootprint
from resgrid.hardware.kicad.schematic import PlacedSymbol, Point, Sheet, TextPlace
from resgrid.hardware.placement import Index, Placement, cell_of
from resgrid.hardware.record import GROUND

_STEP = 25.4
"""Distance of the centres of neighbouring cells on a sheet, in millimetres."""

_MOST_COLUMNS, _MOST_ROWS = 12, 8
"""Largest numbers of columns and rows of cells on one sheet; a larger grid is divided into blocks, one per sheet."""

_ON_ROOT = 8
"""Largest number of columns of a grid that is drawn on the root sheet, next to the terminals.

A grid with more columns is drawn on further sheets.
"""

_CORNER = (38.1, 38.1)
"""Place (x, y) of the node of the upper left cell, in millimetres from the upper left corner of the sheet."""

_OBSTACLE, _GOAL, _START = (205, 205, 205), (255, 224, 130), (187, 222, 251)
"""Fill colours of obstacle cells, goal cells and the start cell: red, green and blue from 0 to 255."""

_SMALL = 1.0
"""Height of the letters at resistors and pads, in millimetres."""


def draw_schematic(placement: Placement) -> list[Sheet]:
    """Return the sheets of a board's schematic, the root sheet first.

    The root sheet contains the terminals, the sources of the simulation, and a grid of at most 8 x 8 cells. A larger
    grid is divided into blocks of at most 12 columns and 8 rows, each on a further sheet.
    """
    circuit = placement.circuit
    columns, rows = placement.shape
    blocks = [(a, b) for b in reversed(_parts(rows, _MOST_ROWS)) for a in _parts(columns, _MOST_COLUMNS)]
    root = Sheet("", "A3")
    sheets = [root]
    drawing = _Drawing(placement)
    if len(blocks) == 1 and columns <= _ON_ROOT:
        drawing.draw_block(root, *blocks[0])
        left = _CORNER[0] + columns * _STEP + 30.48
    else:
        left = 38.1
        across = len(_parts(columns, _MOST_COLUMNS))
        for number, block in enumerate(blocks):
            (i0, i1), (j0, j1) = block
            sheet = Sheet(f"columns {i0}-{i1 - 1} rows {j0}-{j1 - 1}", "A3")
            drawing.draw_block(sheet, *block)
            at = (165.1 + number % across * 58.42, 38.1 + number // across * 33.02)
            root.children.append((sheet, at, (50.8, 20.32)))
            sheets.append(sheet)
    _draw_terminals(root, placement, left)
    _draw_sources(root, circuit, left)
    for sheet in sheets:  # a junction wherever at least three ends of wires meet
        ends = Counter(place for wire in sheet.wires for place in wire)
        sheet.junctions += [place for place, count in ends.items() if count > 2]
    return sheets


def _parts(cells: int, most: int) -> list[tuple[int, int]]:
    """Return ranges (first, end) that divide `cells` cells into nearly equal parts of at most `most` cells.

    The cell `end` is not part of a range.
    """
    count = ceil(cells / most)
    bounds = [round(part * cells / count) for part in range(count + 1)]
    return list(pairwise(bounds))


class _Drawing:
    """Draws blocks of the grid on sheets; `placement`: parts of the board, which are looked up by their cell."""

    def __init__(self, placement: Placement) -> None:
        self._placement, self._circuit = placement, placement.circuit
        columns, rows = placement.shape
        self._resistors: dict[Index, list[GridResistor]] = {}
        for part in placement.circuit.resistors:
            # The sheet of the lower end, or of the upper one if the lower end is outside or has no node.
            low, high = part.ends
            inside = 0 <= low[0] < columns and 0 <= low[1] < rows and low in placement.circuit.cell_nets
            self._resistors.setdefault(low if inside else high, []).append(part)
        self._pads = {cell_of(pad): pad for pad in placement.test_pads}
        self._jumpers = {cell_of(jumper): jumper for jumper in placement.jumpers}
        self._powers = Counter[str]()

    def draw_block(self, sheet: Sheet, across: tuple[int, int], up: tuple[int, int]) -> None:
        """Draw the cells of a block, with their resistors, on `sheet`.

        `across`, `up`: ranges (first, end), without `end`, of the columns and rows of the block; the last row is drawn
        at the top.
        """
        cells = self._circuit.space.cell
        start = self._circuit.wiring.start
        for i in range(*across):
            for j in range(*up):
                x, y = at = (_CORNER[0] + (i - across[0]) * _STEP, _CORNER[1] + (up[1] - 1 - j) * _STEP)
                shown = self._circuit.kind == "fixed"
                colour = {Cell.OBSTACLE: _OBSTACLE, Cell.GOAL: _GOAL}.get(Cell(int(cells[i, j]))) if shown else None
                colour = _START if (i, j) == start else colour
                if colour is not None:
                    half = 3.81
                    sheet.areas.append(((x - half, y - half), (x + half, y + half), colour))
                if (i, j) in self._circuit.cell_nets:
                    self._draw_node(sheet, (i, j), at)
                for part in self._resistors.get((i, j), ()):
                    self._draw_resistor(sheet, part, (i, j), at, across, up)

    def _draw_node(self, sheet: Sheet, cell: Index, at: Point) -> None:
        """Draw the node of a cell on `sheet`: its label, its test pad, and its solder jumper if the board has jumpers.

        `cell`: (column, row); `at`: place (x, y) of the node in millimetres from the upper left corner of the sheet, y
        downwards.
        """
        net, (x, y) = self._circuit.cell_nets[cell], at
        pad = self._pads[cell]
        sheet.wires.append((at, (x + 2.54, y - 2.54)))
        text = TextPlace(1.27, -1.9, _SMALL, "left")
        sheet.symbols.append(_part(symbols.TEST_PAD, pad, x + 2.54, y - 2.54, text))
        sheet.wires.append((at, (x + 2.54, y + 2.54)))
        sheet.labels.append((net, (x + 2.54, y + 2.54), 0))
        jumper = self._jumpers.get(cell)
        if jumper is None:
            return
        x, y = x + 15.24, y + 7.62
        state = self._circuit.space.cell[cell]
        model = None if state == Cell.FREE else _closed(1 if state == Cell.OBSTACLE else 3)
        sheet.symbols.append(_part(symbols.SOLDER_JUMPER, jumper, x, y, TextPlace(2.2, 2.9, _SMALL, "left"), model))
        sheet.wires.append(((x, y + 3.81), (x, y + 5.08)))
        sheet.labels.append((net, (x, y + 5.08), 270))
        self._power(sheet, jumper.nets[0], (x - 5.08, y), 0, shown=True)
        self._power(sheet, jumper.nets[2], (x + 5.08, y), 0, shown=True)

    def _draw_resistor(
        self, sheet: Sheet, part: GridResistor, cell: Index, at: Point, across: tuple[int, int], up: tuple[int, int]
    ) -> None:
        """Draw a resistor from the cell at one end, with a wire, a rail or the label of a net at its other end.

        `part`: the resistor; `cell`: the cell (column, row) at one end; `at`: place (x, y) of this cell in millimetres;
        `across`, `up`: ranges of columns and rows of the sheet, within which the other end is joined by a wire.
        """
        low, high = part.ends
        other, forward = (high, 1) if cell == low else (low, -1)
        step = (forward, 0) if part.axis == 0 else (0, -forward)
        x, y = at[0] + step[0] * _STEP / 2, at[1] + step[1] * _STEP / 2
        above, below = (TextPlace(0, -2.0, _SMALL), TextPlace(0, 2.2, _SMALL))
        if part.axis == 1:
            above, below = TextPlace(3.9, -1.0, _SMALL), TextPlace(3.9, 1.0, _SMALL)
        sheet.symbols.append(
            PlacedSymbol(
                symbols.RESISTOR, part.reference, resistance_text(part.ohms), x, y, 90 if part.axis == 0 else 180,
                f"{LIBRARY}:R_0603_1608Metric_HandSolder", above, below,
            )
        )  # fmt: skip
        near = (x - 3.81 * step[0], y - 3.81 * step[1])
        far = (x + 3.81 * step[0], y + 3.81 * step[1])
        sheet.wires.append((at, near))
        net = part.upper if forward > 0 else part.lower
        if other in self._circuit.cell_nets and across[0] <= other[0] < across[1] and up[0] <= other[1] < up[1]:
            sheet.wires.append((far, (at[0] + step[0] * _STEP, at[1] + step[1] * _STEP)))
            return
        end = (far[0] + 2.54 * step[0], far[1] + 2.54 * step[1])
        sheet.wires.append((far, end))
        turn = {(1, 0): 0, (-1, 0): 180, (0, -1): 90, (0, 1): 270}[step]
        if net == self._circuit.high_net and other not in self._circuit.cell_nets:
            self._power(sheet, net, end, (turn - 90) % 360)
        else:
            sheet.labels.append((net, end, turn))

    def _power(self, sheet: Sheet, net: str, at: Point, turn: int, *, shown: bool = False) -> None:
        """Draw the symbol of a rail on `sheet`.

        `net`: net of the rail; `at`: place (x, y) of the pin in millimetres; `turn`: rotation in degrees, 0 if the bar
        is above the pin; `shown`: whether the name of the net is shown.
        """
        self._powers[sheet.name] += 1
        reference = f"#PWR{sheet.name.replace(' ', '')}_{self._powers[sheet.name]}"
        sheet.symbols.append(_power(net, at, turn, reference, shown=shown))


def _part(
    symbol: symbols.Symbol,
    placed: PlacedFootprint,
    x: float,
    y: float,
    text: TextPlace,
    model: dict[str, str] | None = None,
) -> PlacedSymbol:
    """Return a placed symbol of the schematic for a part of the board.

    `symbol`: the symbol to place; `placed`: the part; `x`, `y`: place on the sheet in millimetres, y downwards; `text`:
    place of the reference; `model`: fields of the simulation model by name, None if the part is not simulated.
    """
    footprint = f"{LIBRARY}:{placed.footprint.name}"
    return PlacedSymbol(symbol, placed.reference, placed.value, x, y, 0, footprint, text, None, model)


def _closed(pin: int) -> dict[str, str]:
    """Return the simulation model of a solder bridge from the middle pin to pin 1 or 3: a voltage source of 0 V."""
    pins = "1=+ 2=-" if pin == 1 else "2=+ 3=-"
    return {"Sim.Device": "V", "Sim.Type": "DC", "Sim.Params": "dc=0", "Sim.Pins": pins}


def _power(net: str, at: Point, turn: int, reference: str, *, shown: bool) -> PlacedSymbol:
    """Return the symbol of ground or a rail, which gives the wire at its pin the name of the net.

    `net`: name of the net; `at`: place (x, y) of the pin in millimetres, y downwards; `turn`: rotation in degrees,
    counterclockwise; `reference`: name of the symbol; `shown`: whether the name of the net is shown next to it.
    """
    symbol = symbols.GROUND if net == GROUND else symbols.RAIL
    text = TextPlace(0.0, 3.9 if symbol is symbols.GROUND else -2.5, _SMALL) if shown else None
    return PlacedSymbol(symbol, reference, net, *at, turn, value_at=text)


def _draw_terminals(root: Sheet, placement: Placement, left: float) -> None:
    """Draw supply terminal, headers and mounting holes on the root sheet; `left`: their left end, in millimetres."""
    y, numbers = 45.72, iter(range(1, 1000))
    rails = {placement.circuit.high_net, GROUND, *placement.circuit.goal_nets}
    for placed in placement.headers:
        x = left + 35.56
        symbol = symbols.connector(len(placed.nets))
        root.symbols.append(
            PlacedSymbol(
                symbol, placed.reference, placed.value, x, y, 0, f"{LIBRARY}:{placed.footprint.name}",
                TextPlace(0.0, -2.6), TextPlace(2.54, 1.27, 1.27, "left"), None,
            )
        )  # fmt: skip
        for pin, net in enumerate(placed.nets):
            place = (x - 5.08, y + 2.54 * pin)
            end = (place[0] - 5.08, place[1])
            root.wires.append((place, end))
            if net in rails:
                text = TextPlace(-4.6, 0.0, _SMALL)
                root.symbols.append(
                    PlacedSymbol(
                        symbols.GROUND if net == GROUND else symbols.RAIL, f"#PWRJ{next(numbers)}", net, *end,
                        270 if net == GROUND else 90, value_at=text,
                    )
                )  # fmt: skip
            else:
                root.labels.append((net, end, 180))
        y += 2.54 * len(placed.nets) + 8.89
    for number, placed in enumerate(placement.holes):
        root.symbols.append(_part(symbols.HOLE, placed, left + 10.16 + 10.16 * number, y + 2.54, TextPlace(0.0, -2.6)))


def _sources(circuit: BoardCircuit) -> Iterator[tuple[str, float]]:
    """Yield net, and voltage against ground in volts, of every source of the board: the supply and each goal rail."""
    yield circuit.high_net, circuit.wiring.high
    for net in circuit.goal_nets:
        yield net, circuit.wiring.goal_voltage


def _draw_sources(root: Sheet, circuit: BoardCircuit, left: float) -> None:
    """Draw the voltage sources of the simulation on the root sheet, in rows of six.

    Each net with a source, and ground, get a power flag, so that KiCad's electrical rules accept the net as driven.
    `left`: x of the left end of the rows, in millimetres.
    """
    y = 213.36
    nets = [*_sources(circuit)]
    root.notes.append(("Supply and closed links, for the simulation only", (left, y - 12.7), 1.8))
    for number, (net, volts) in enumerate(nets, start=1):
        x = left + 5.08 + 20.32 * ((number - 1) % 6)
        top = y + 33.02 * ((number - 1) // 6)
        model = {"Sim.Device": "V", "Sim.Type": "DC", "Sim.Params": f"dc={volts!r}", "Sim.Pins": "1=+ 2=-"}
        name, value = TextPlace(5.08, -1.27), TextPlace(5.08, 1.27)
        root.symbols += [
            PlacedSymbol(symbols.SOURCE, f"V{number}", f"{volts:g} V", x, top, 0, "", name, value, model),
            PlacedSymbol(symbols.RAIL, f"#PWRV{number}", net, x, top - 5.08, value_at=TextPlace(0.0, -2.5, _SMALL)),
            PlacedSymbol(symbols.GROUND, f"#PWRW{number}", GROUND, x, top + 5.08),
            PlacedSymbol(symbols.FLAG, f"#FLG{number}", "PWR_FLAG", x + 2.54, top - 5.08),
        ]
        root.wires.append(((x, top - 5.08), (x + 2.54, top - 5.08)))
    x = left + 5.08 + 20.32 * min(len(nets), 6)
    root.symbols += [
        PlacedSymbol(symbols.FLAG, "#FLG0", "PWR_FLAG", x, y),
        PlacedSymbol(symbols.GROUND, "#PWRG", GROUND, x, y + 2.54),
    ]
    root.wires.append(((x, y), (x, y + 2.54)))
