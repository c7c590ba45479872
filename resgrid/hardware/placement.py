"""Places of all parts of a board, in millimetres, from the indices of cells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from resgrid.errors import InputError
from resgrid.hardware.board_circuit import BoardCircuit, Kind
from resgrid.hardware.e_series import resistance_text
from resgrid.hardware.kicad.footprints import (
    HOLE,
    PIN_SPACING,
    RESISTOR,
    SOLDER_JUMPER,
    TERMINAL,
    TEST_PAD,
    Footprint,
    PlacedFootprint,
    pin_header,
)
from resgrid.hardware.record import GROUND

Point = tuple[float, float]
Index = tuple[int, int]

SMALLEST_PITCH: dict[Kind, float] = {"fixed": 5.08, "jumpers": 6.35}
"""Smallest distance of the centres of neighbouring cells on a board, in millimetres.

At smaller distances parts cannot be soldered by hand, and labels do not fit.
"""

USUAL_PITCH = 6.35
"""Default distance of the centres of neighbouring cells on a board, in millimetres."""

LARGEST_PITCH = 25.4
"""Largest distance of the centres of neighbouring cells on a board, in millimetres."""

_ORIGIN = (20.0, 20.0)
_LEFT, _RIGHT, _TOP, _BOTTOM = 11.0, 7.0, 9.0, 16.0
"""Widths of the margins between the ring of the high rail and the edges of the board, in millimetres.

The ring is the track around the grid on the net of the positive supply.
"""

LANE = 0.6
"""Distance between neighbouring vertical tracks outside the ring of the high rail, in millimetres.

The ring is the track around the grid on the net of the positive supply.
"""

CHANNELS = 4
"""Largest number of pins of a header row for an analogue-to-digital converter, and largest number of such rows."""

_LINK_SPACING = 4.2
"""Distance between the links (two-pin headers) that tie goal regions to ground, in millimetres."""


@dataclass(frozen=True)
class Channel:
    """A pin of a header row for a converter.

    The converter is an analogue-to-digital converter. `cell`: the cell (column, row) whose voltage the pin carries;
    `net`: net of the cell; `pin`: place (x, y) of the pin, in millimetres from the upper left corner of the sheet, y
    downwards.
    """

    cell: Index
    net: str
    pin: Point


@dataclass(frozen=True)
class GoalTap:
    """The cell at which the track of a goal region begins.

    The track leads to the header that ties the region to ground. `net`: net of the region; `cell`: (column, row);
    `lane`: 0, or 1 for the second of two tracks that begin in the same row of the grid.
    """

    net: str
    cell: Index
    lane: int


@dataclass(frozen=True, eq=False)
class Placement:
    """Places of the parts of a board, in millimetres from the upper left corner of the sheet.

    x points to the right and y downwards; cell (0, 0) is at the lower left of the grid. `circuit`: circuit of the
    board; `pitch`: distance of neighbouring cells, in millimetres.
    """

    circuit: BoardCircuit
    pitch: float

    def __post_init__(self) -> None:
        smallest = SMALLEST_PITCH[self.circuit.kind]
        if not smallest <= self.pitch <= LARGEST_PITCH:
            raise InputError(
                f"pitch = {self.pitch:g} mm; a board of kind {self.circuit.kind!r} that can be soldered by hand needs "
                f"{smallest:g} to {LARGEST_PITCH:g} mm"
            )
        width, needed = self.ring[2] - self.ring[0], 17.5 + _LINK_SPACING * len(self.circuit.goal_nets)
        if width < needed:
            raise InputError(
                f"{len(self.circuit.goal_nets)} goal regions need a board with {needed:.0f} mm between its borders, "
                f"but there are {width:.0f} mm; join goal regions, or choose a larger --pitch"
            )
        _ = self.goal_taps  # raises InputError for goal regions without room for their tracks

    @property
    def shape(self) -> Index:
        """Numbers of columns and rows of the grid of cells."""
        columns, rows = self.circuit.space.shape
        return columns, rows

    def at(self, i: float, j: float) -> Point:
        """Return the place (x, y) of a cell's centre, in millimetres from the upper left corner of the sheet.

        x points to the right and y downwards. `i`: column from the left; `j`: row from the bottom. Both may be
        fractions or lie outside the grid.
        """
        left, top = _ORIGIN[0] + _LEFT + self.pitch, _ORIGIN[1] + _TOP + self.pitch
        return rounded(left + i * self.pitch, top + (self.shape[1] - 1 - j) * self.pitch)

    @cached_property
    def ring(self) -> tuple[float, float, float, float]:
        """Left x, upper y, right x and lower y of the track around the grid, in millimetres on the sheet, y downwards.

        This track belongs to the high rail, the net of the positive supply.
        """
        (x0, y0), (x1, y1) = self.at(-1, self.shape[1]), self.at(self.shape[0], -1)
        return x0, y0, x1, y1

    @property
    def origin(self) -> Point:
        """Place (x, y) of the upper left corner of the board, in millimetres from that of the sheet."""
        return _ORIGIN

    @property
    def size(self) -> Point:
        """Width and height of the board, in millimetres."""
        lanes = max(0, len(self.circuit.goal_nets) - 4) * LANE
        x0, y0, x1, y1 = self.ring
        return rounded(x1 - x0 + _LEFT + _RIGHT + lanes, y1 - y0 + _TOP + _BOTTOM)

    @property
    def corner(self) -> Point:
        """Place (x, y) of the lower right corner of the board, in millimetres from the sheet's upper left corner."""
        return rounded(_ORIGIN[0] + self.size[0], _ORIGIN[1] + self.size[1])

    @property
    def resistors(self) -> list[PlacedFootprint]:
        """All resistors in the order of the circuit, with their references next to them on the silkscreen."""
        placed = []
        size = label_size(max(len(part.reference) for part in self.circuit.resistors))
        for part in self.circuit.resistors:
            x, y = self.at(part.cell[0] - 0.5 * (part.axis == 0), part.cell[1] - 0.5 * (part.axis == 1))
            label = (x, y - 1.05) if part.axis == 0 else (x + 1.05, y - 0.25)
            placed.append(
                PlacedFootprint(
                    RESISTOR, part.reference, resistance_text(part.ohms), x, y, (part.lower, part.upper),
                    turn=90 * part.axis, label=rounded(*label), label_turn=90 * part.axis, label_size=size,
                )
            )  # fmt: skip
        return placed

    @property
    def test_pads(self) -> list[PlacedFootprint]:
        """The test pads of all cells with a test pad, row by row from the top; the value text is the cell: ``"3,4"``.

        These are the free cells and goal cells with a node; on a board with jumpers, all cells.
        """
        cells = sorted(self.circuit.cell_nets, key=lambda cell: (-cell[1], cell[0]))
        return [
            PlacedFootprint(
                TEST_PAD, f"TP{number}", "{},{}".format(*cell), *self.at(*cell), (self.circuit.cell_nets[cell],)
            )
            for number, cell in enumerate(cells, start=1)
        ]

    @property
    def jumpers(self) -> list[PlacedFootprint]:
        """The solder jumpers of all cells, row by row from the top; empty on a board of kind "fixed".

        Pad 1 is on the obstacle rail, pad 2 on the cell's node, pad 3 on the goal rail.
        """
        if self.circuit.kind == "fixed":
            return []
        cells = sorted(self.circuit.cell_nets, key=lambda cell: (-cell[1], cell[0]))
        high, (goal,) = self.circuit.high_net, self.circuit.goal_nets
        return [
            PlacedFootprint(
                SOLDER_JUMPER, f"JP{number}", "{},{}".format(*cell), *self.at(cell[0] + 0.5, cell[1] + 0.5),
                (high, self.circuit.cell_nets[cell], goal), turn=90,
            )
            for number, cell in enumerate(cells, start=1)
        ]  # fmt: skip

    @cached_property
    def channels(self) -> list[list[Channel]]:
        """Header rows for a converter, from the top, each with the pins for at most four cells of one row of the grid.

        There are at most four header rows. The pins of a header row are listed from the top: the pin of the rightmost
        cell comes first.
        """
        result, lowest = list[list[Channel]](), self.ring[1] + 0.5
        for j in self._channel_rows():
            cells = self._spread([i for i in range(self.shape[0]) if self._can_be_read((i, j))])
            half = (len(cells) - 1) / 2
            first = max(lowest, self.at(0, j)[1] - self.lane(half) - half * PIN_SPACING)
            lowest = first + len(cells) * PIN_SPACING
            # The rightmost cell has the uppermost lane, and therefore the uppermost pin.
            result.append(
                [
                    Channel((i, j), self.circuit.cell_nets[i, j], rounded(self.ring[0] - 5.2, first + k * PIN_SPACING))
                    for k, i in enumerate(reversed(cells))
                ]
            )
        return [group for group in result if group]

    def _channel_rows(self) -> list[int]:
        """Return the rows of the grid that get a header row for a converter, from the top.

        They are far enough apart for the pins of the headers. Rows in which the track of a goal region begins are left
        out, because this track and the tracks to the header would cut the copper plane between them into pieces.
        """
        rows = self.shape[1]
        taken = {tap.cell[1] for tap in self.goal_taps}
        count = max(1, min(CHANNELS, rows // 2))
        chosen: list[int] = []
        for number in reversed(range(count)):
            target = int((number + 0.5) * rows / count)
            limit = chosen[-1] - CHANNELS * PIN_SPACING / self.pitch if chosen else rows
            free = [j for j in range(rows) if j not in taken and j <= limit + 1e-9]
            if free:
                chosen.append(min(free, key=lambda j: (abs(j - target), j)))
        return chosen

    def lane(self, number: float) -> float:
        """Return the distance in millimetres of a horizontal track to a converter header above its row of cells.

        The distance is measured from the centres of the cells. `number`: number of the track, from 0 for the lowest
        track of the row; a fraction gives a height between tracks.
        """
        first = 1.5 if self.circuit.kind == "fixed" else self.pitch / 2 - 0.325
        return first + 0.45 * number

    def _can_be_read(self, cell: Index) -> bool:
        """Return whether a cell (column, row) has a node that is not on a rail."""
        net = self.circuit.cell_nets.get(cell)
        return net is not None and net != self.circuit.high_net and net not in self.circuit.goal_nets

    def _spread(self, columns: list[int]) -> list[int]:
        """Return at most `CHANNELS` of the given columns, evenly spread, in ascending order."""
        count = min(CHANNELS, len(columns))
        return [columns[int((k + 0.5) * len(columns) / count)] for k in range(count)]

    @cached_property
    def goal_taps(self) -> list[GoalTap]:
        """The cells at which the tracks of the goal regions begin, from the lowest row; empty on a board with jumpers.

        A region begins in a row without other tracks of goals if possible. Two tracks in one row have different lanes.
        """
        if self.circuit.kind == "jumpers":
            return []
        regions = self.circuit.space.goal_region
        used: dict[int, list[GoalTap]] = {}
        for number, net in enumerate(self.circuit.goal_nets):
            cells = [(int(i), int(j)) for i, j in np.argwhere(regions == number)]
            cell = min(cells, key=lambda cell: (len(used.get(cell[1], ())), cell[1], -cell[0]))
            used.setdefault(cell[1], []).append(GoalTap(net, cell, 0))
        for row, taps in used.items():
            if len(taps) > 2:
                raise InputError(
                    f"{len(taps)} goal regions lie in row {row} only, and a board has tracks for 2 in one row; join "
                    "goal regions, or move one to another row"
                )
            ordered = sorted(taps, key=lambda tap: tap.cell)
            used[row] = [GoalTap(tap.net, tap.cell, lane) for lane, tap in enumerate(ordered)]
        return [tap for row in sorted(used) for tap in used[row]]

    @property
    def linked_goals(self) -> tuple[str, ...]:
        """Nets of the goal rails in the order of their links (headers that tie them to ground), from the left."""
        return tuple(tap.net for tap in self.goal_taps) or self.circuit.goal_nets

    @property
    def headers(self) -> list[PlacedFootprint]:
        """Supply terminal J1, header J2 for the supply as reference, goal links to ground, and converter headers."""
        left, _, right, bottom = self.ring
        high, goals = self.circuit.high_net, self.linked_goals
        parts: list[tuple[Footprint, str, float, float, tuple[str, ...], int]] = []
        parts.append((TERMINAL, "SUPPLY", left + 4.2, bottom + 6.5, (high, GROUND), 0))
        parts.append((pin_header(3), "REFERENCE", left + 12.0, bottom + 4.4, (high, GROUND, GROUND), 0))
        for number, net in enumerate(goals):
            x = right - 2.5 - _LINK_SPACING * (len(goals) - 1 - number)
            parts.append((pin_header(2), f"LINK {net}", x, bottom + 5.0 + PIN_SPACING, (GROUND, net), 180))
        for group in self.channels:
            row = group[0].cell[1]
            pins = tuple(channel.net for channel in group)
            parts.append((pin_header(len(group)), f"CONVERTER row {row}", *group[0].pin, pins, 0))
        placed = []
        for number, (part, value, x, y, nets, turn) in enumerate(parts, start=1):
            sideways = value.startswith("CONVERTER")
            above = -2.6 if part is TERMINAL else -4.6 if turn else -2.0
            label = (x + 2.0, y + (len(nets) - 1) * PIN_SPACING / 2) if sideways else (x, y + above)
            placed.append(
                PlacedFootprint(
                    part, f"J{number}", value, *rounded(x, y), nets, turn=turn, label=rounded(*label),
                    label_turn=90 if sideways else 0,
                )
            )  # fmt: skip
        return placed

    @property
    def holes(self) -> list[PlacedFootprint]:
        """Four mounting holes in the corners of the board."""
        (x0, y0), (x1, y1) = self.origin, self.corner
        places = ((x0 + 4, y0 + 4), (x1 - 4, y0 + 4), (x0 + 4, y1 - 4), (x1 - 4, y1 - 4))
        return [
            PlacedFootprint(HOLE, f"H{number}", "M3", *rounded(*place)) for number, place in enumerate(places, start=1)
        ]

    @cached_property
    def parts(self) -> list[PlacedFootprint]:
        """All parts of the board: resistors, solder jumpers, test pads, headers and mounting holes, in this order."""
        return [*self.resistors, *self.jumpers, *self.test_pads, *self.headers, *self.holes]


def cell_of(placed: PlacedFootprint) -> Index:
    """Return the cell (column, row) of a test pad or solder jumper, which its value text states: ``"3,4"``."""
    i, j = map(int, placed.value.split(","))
    return i, j


def label_size(characters: int) -> Point:
    """Return width and height, in millimetres, of the letters of a label next to a part.

    `characters`: number of characters of the label.
    """
    return (0.8 if characters <= 3 else 0.7 if characters == 4 else 0.6), 0.8


def rounded(x: float, y: float) -> Point:
    """Return a place (x, y) in millimetres rounded to 1e-4 mm, so that equal places have equal numbers."""
    return round(x, 4), round(y, 4)
