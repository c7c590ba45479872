"""The type `Board`, a printed circuit board that realises a resistor grid, and its builder `build_board`."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass, replace
from functools import cached_property
from math import sqrt
from typing import Annotated, Unpack

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from resgrid._internal.numbers import Count
from resgrid.chip.figures_of_merit import Proportion
from resgrid.chip.study_analyses import study
from resgrid.chip.yields import Yield
from resgrid.core.cell import Cell
from resgrid.core.lattice import require_square
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring, WiringOptions, wiring_of
from resgrid.errors import InputError
from resgrid.hardware.board_circuit import BoardCircuit, Kind, board_circuit
from resgrid.hardware.e_series import resistance_text
from resgrid.hardware.kicad.footprints import PlacedFootprint
from resgrid.hardware.placement import USUAL_PITCH, Index, Placement, cell_of
from resgrid.hardware.record import GROUND, HardwareRecord, Part, PartType, Supply
from resgrid.hardware.silkscreen import SEE_BACK
from resgrid.planning.pipeline import problem_of
from resgrid.planning.trace import start_cell
from resgrid.scene import Scene
from resgrid.scene.chip import Chip, Readout

FILE = "grid.kicad_pcb"
"""Name of the file of the board in the folder of the KiCad project."""

REVISION = "A"
"""Revision letter that is printed on the board and stated in its files."""

BITS = 10
"""Assumed resolution of the converter that reads the voltages, in bits, if the scene states no resolution.

The yield of boards is predicted for this converter.
"""

_RESOLUTIONS = (12, 16)
"""Resolutions of the converter, in bits, for which the yield is predicted in addition to the scene's resolution."""

_TRIALS, _MANY_CELLS = 128, 400
"""Largest number of simulated boards for each resolution in `Board.predicted_yields`, and a number of grid cells.

A grid of more than `_MANY_CELLS` cells gets a third of the boards.
"""


@dataclass(frozen=True, eq=False, repr=False)
class Board:
    """A printed circuit board that realises the resistor grid of a space.

    Returned by `build_board`; `resgrid.save` writes it as a KiCad project.

    Attributes
    ----------
    circuit : BoardCircuit
        Circuit of the board with resistors of the E96 series, its operating point and the names of its nets.
    placement : Placement
        Places of all parts, in millimetres.
    title : str
        Title, printed on the board.
    tolerance : float
        Tolerance of the resistors, as a fraction of their nominal values.
    starts : tuple of tuple of int
        Cells (column, row) of the scene's starts, row 0 at the bottom; empty without starts.  A board of kind "fixed"
        has the word START printed at these cells.
    readout : Readout
        Analogue-to-digital converter that reads the voltages; the predicted yield depends on it.
    kind : {"fixed", "jumpers"}
        Whether the board serves one scene, or every scene of its size.
    size : tuple of float
        Width and height of the board, in millimetres.
    voltages : mapping of str to float
        Expected voltage of every net against ground, in volts.
    supply_current : float
        Current from the supply, in amperes.
    power : float
        Power from the supply, in watts.
    largest_deviation : float
        Largest absolute deviation of a resistor's E96 value from the compiled resistance, as a fraction of the latter.

    Examples
    --------
    >>> board = rg.hardware.build_board(rg.read_scene("examples/scenes/lesson.toml"))
    >>> board
    <Board of kind fixed: 8 x 8 cells, 140 resistors, 75.2 x 82.2 mm>
    >>> f"{board.voltages['n_0_6']:.3f} V, {1e6 * board.supply_current:.1f} uA"
    '1.000 V, 246.2 uA'
    """

    circuit: BoardCircuit
    placement: Placement
    title: str
    tolerance: float
    starts: tuple[Index, ...]
    readout: Readout

    def __repr__(self) -> str:
        width, height = self.size
        cells = " x ".join(map(str, self.circuit.space.shape))
        return (
            f"<Board of kind {self.kind}: {cells} cells, {len(self.circuit.resistors)} resistors, "
            f"{width:.1f} x {height:.1f} mm>"
        )

    @property
    def kind(self) -> Kind:
        """Whether the board serves one scene ("fixed"), or every scene of its size ("jumpers")."""
        return self.circuit.kind

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the board, in millimetres."""
        return self.placement.size

    @property
    def voltages(self) -> dict[str, float]:
        """Expected voltage of every net against ground, in volts, by the name of the net."""
        return self.circuit.voltages

    @property
    def supply_current(self) -> float:
        """Current that the supply delivers, in amperes."""
        return self.circuit.supply_current

    @property
    def power(self) -> float:
        """Power that the supply delivers, in watts."""
        return self.circuit.power

    @property
    def largest_deviation(self) -> float:
        """Largest absolute deviation of a resistor's E96 value from the compiled resistance, relative to the latter."""
        return self.circuit.largest_deviation

    @property
    def mismatch(self) -> float:
        """Standard deviation of a resistance, as a fraction of the nominal value: ``tolerance / sqrt(3)``.

        The resistances are assumed to be uniformly distributed within the tolerance.
        """
        return self.tolerance / sqrt(3.0)

    def yields(self, *, trials: Count = 400, bits: Annotated[int, Ge(1), Le(32)] | None = None) -> Yield:
        """Predict the yield of boards with resistors of the chosen tolerance.

        Parameters
        ----------
        trials : int
            Largest number of simulated boards; the simulation ends earlier once half the width of the yield's interval
            of 95 % confidence is at most 0.01.
        bits : int, optional
            Resolution of the converter, 1 to 32; by default the resolution of the board's `readout`.

        Returns
        -------
        Yield
            Fraction of the simulated boards on which a simulated robot reaches a goal, for every start and over all
            starts.  The robot sees only the voltages that the converter reports.  Starts are all free cells with a path
            to a goal.  The resistances have the standard deviation ``tolerance / sqrt(3)`` of their nominal values.
        """
        wiring = self.circuit.wiring
        readout = self.readout if bits is None else replace(self.readout, bits=bits)
        chip = Chip(resistance=wiring.resistance, supply=wiring.supply, mismatch=self.mismatch, readout=readout)
        return study(self.circuit.cells_netlist, chip).yields(trials=trials)

    @cached_property
    def predicted_yields(self) -> dict[int, Proportion]:
        """Fraction of starts on simulated boards that reach a goal, by the converter's resolution in bits.

        Every simulated board is tried from all starts: all free cells with a path to a goal. The resolutions are 12 and
        16 bits and the resolution of `readout`. Each fraction has a confidence interval.
        """
        trials = _TRIALS if self.circuit.space.cell.size <= _MANY_CELLS else _TRIALS // 3
        resolutions = sorted({self.readout.bits or BITS, *_RESOLUTIONS})
        return {bits: self.yields(trials=trials, bits=bits).overall for bits in resolutions}

    @cached_property
    def closed(self) -> dict[str, tuple[int, ...]]:
        """Pads that solder joins on each solder jumper in this scene, as pad numbers by reference of the jumper.

        Pads 1 and 2 tie the cell to the obstacle rail, pads 2 and 3 to the goal rail. A jumper of a free cell has no
        entry. A board of kind "fixed" has no solder jumpers, so that the dictionary is empty.
        """
        pads = {Cell.OBSTACLE: (1, 2), Cell.GOAL: (2, 3)}
        cells = self.circuit.space.cell
        joined = dict[str, tuple[int, ...]]()
        for placed in self.placement.jumpers:
            state = cells[cell_of(placed)]
            if state != Cell.FREE:
                joined[placed.reference] = pads[Cell(int(state))]
        return joined

    def record(self) -> HardwareRecord:
        """Return the record of the board: parts, sources, and expected voltages.

        Returns
        -------
        HardwareRecord
            The record, which `resgrid check` compares with the netlist that KiCad extracts from the board.
        """
        circuit = self.circuit
        ohms = {part.reference: part.ohms for part in circuit.resistors}
        parts = tuple(self._part(placed, ohms) for placed in self.placement.parts)
        wiring = circuit.wiring
        sources = [Supply("supply", circuit.high_net, GROUND, wiring.high)]
        sources += [Supply(net, net, GROUND, wiring.goal_voltage) for net in circuit.goal_nets]
        nodes = {net: cell for cell, net in circuit.cell_nets.items() if net.startswith("n_")}
        touched = {net for part in circuit.resistors for net in (part.lower, part.upper)}
        volts = {net: value for net, value in circuit.voltages.items() if net in touched}
        return HardwareRecord("board", self.kind, FILE, self.scene_hash, None, parts, tuple(sources), volts, nodes)

    def _part(self, placed: PlacedFootprint, ohms: dict[str, float]) -> Part:
        """Return the record's entry for a part of the board; `placed`: the part; `ohms`: resistances by reference."""
        kinds: dict[str, PartType] = {"R": "resistor", "J": "connector", "JP": "jumper", "TP": "test_pad", "H": "hole"}
        kind = kinds[placed.reference.rstrip("0123456789")]
        closed = self.closed.get(placed.reference, ())
        return Part(placed.reference, kind, ohms.get(placed.reference), placed.nets, closed)

    @property
    def scene_hash(self) -> str:
        """SHA-256 of cells, conductivity, wiring, kind and pitch of the board, in hexadecimal digits."""
        space = self.circuit.space
        text = f"{space.shape} {self.circuit.wiring} {self.kind} {self.placement.pitch!r}"
        digest = hashlib.sha256(text.encode() + space.cell.tobytes())
        if space.conductivity is not None:
            digest.update(np.ascontiguousarray(space.conductivity).tobytes())
        return digest.hexdigest()

    @property
    def subtitle(self) -> str:
        """Second line of the board's title: numbers of cells, boundary condition, resistances and revision.

        A board of kind "jumpers" has the words "any scene" in place of the boundary condition.
        """
        wiring = self.circuit.wiring
        values = sorted({part.ohms for part in self.circuit.resistors})
        span = resistance_text(values[0])
        span += f" to {resistance_text(values[-1])}" if len(values) > 1 else ""
        cells = " x ".join(map(str, self.circuit.space.shape))
        kind = wiring.boundary if self.kind == "fixed" else "any scene"
        return f"{cells} cells, {kind}, {span}, rev {REVISION}"

    @property
    def legend(self) -> tuple[str, ...]:
        """Lines of text, printed on the board, that explain its voltages."""
        volts = f"{self.circuit.wiring.supply:+g} V"
        walk = "path: always to the neighbour with the lowest voltage"
        if self.kind == "jumpers":
            return (
                f"O: obstacle rail {volts}, G: goal rail 0 V",
                "bridge the middle pad with O or G; the cell is at the lower left",
                walk,
            )
        if self.circuit.wiring.is_driven:
            return (
                f"START {volts}, GOAL 0 V (GND)",
                "hatched: obstacles, without resistors",
                walk,
                SEE_BACK,
            )
        return (f"hatched: obstacles {volts}, GOAL 0 V (GND)", walk, SEE_BACK)


def build_board(
    source: Scene | ConfigurationSpace,
    *,
    kind: Kind = "fixed",
    pitch: Annotated[float, Gt(0)] = USUAL_PITCH,
    tolerance: Annotated[float, Gt(0), Lt(1)] = 0.01,
    space: ConfigurationSpace | None = None,
    wiring: Wiring | None = None,
    **options: Unpack[WiringOptions],
) -> Board:
    """Build a printed circuit board that realises the resistor grid of a scene or a space with two axes.

    Parameters
    ----------
    source : Scene or ConfigurationSpace
        The scene, whose ``[chip]`` table gives resistance, supply and converter, or a space.
    kind : {"fixed", "jumpers"}
        "fixed": a board for this scene.  "jumpers": a board with every resistor, on which solder bridges connect each
        cell to the obstacle rail, to the goal rail, or to neither; it serves every scene of its size.
    pitch : float
        Distance of neighbouring cells on the board, in millimetres; at least 5.08 (fixed) or 6.35 (jumpers).
    tolerance : float
        Tolerance of the resistors, as a fraction of their nominal values.
    space : ConfigurationSpace, optional
        The space of the scene, if it was built before; by default it is built.  Only with a scene as `source`.
    wiring : Wiring, optional
        Boundary conditions, resistance and supply; by default those of the scene, or for a space the defaults of
        `Wiring`.
    **options
        Fields of `Wiring`, such as ``boundary="wall"``: instead of `wiring`, or as changes to it.

    Returns
    -------
    Board
        The board.

    Raises
    ------
    InputError
        If a board cannot realise the space or the wiring: other than two axes of 3 to 64 cells, a periodic axis, a
        uniform drive, a leak, a negative supply, or a goal voltage other than 0; for jumpers also unequal
        conductivities, or a boundary other than "dirichlet".  Also if a resistor has a resistance or power outside the
        range of size 0603, the pitch is outside its range, or the goal regions leave no room for their tracks.
    CircuitError
        If no current flows.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml")
    >>> board = rg.hardware.build_board(scene, kind="jumpers", resistance=22e3)
    >>> len(board.circuit.resistors), sorted({part.ohms for part in board.circuit.resistors})
    (144, [22100.0])
    >>> rg.save(board, "class").name
    'class'
    """
    if isinstance(source, Scene):
        problem = problem_of(source, wiring, space=space, **options)
        space, readout = problem.space, source.chip.readout
        own = problem.only_wiring()[1]
        starts = tuple(start_cell(space, start) for start in source.starts)
        title = _printable(source.title) or "Resistor grid"
    else:
        if space is not None:
            raise InputError("space = ... belongs to a scene; the first argument is a space already, leave it out")
        space, readout, starts, title = source, Readout(), (), "Resistor grid"
        own = wiring_of(wiring, options)
    require_square(own.lattice, "a board")
    if readout.bits is None:
        readout = replace(readout, bits=BITS)
    circuit = board_circuit(space, kind, own.on(space))
    cells = tuple((int(start[0]), int(start[1])) for start in starts)
    return Board(circuit, Placement(circuit, float(pitch)), title, float(tolerance), cells, readout)


def _printable(title: str) -> str:
    """Return a title on one line, without control characters and without marks that KiCad would expand as variables."""
    words = "".join(letter if letter.isprintable() else " " for letter in title).split()
    return re.sub(r"[$@](?=\{)|%(?=\w)", "", " ".join(words))
