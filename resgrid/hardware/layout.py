"""The type `Layout`, a chip layout of a compiled space, and its builder `build_layout`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import solve
from resgrid.core.compiler import compile_space
from resgrid.core.drive_checks import require_drive
from resgrid.core.lattice import require_square
from resgrid.core.netlist import Netlist
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring, WiringOptions, wiring_of
from resgrid.errors import InputError
from resgrid.hardware.layout_array import TileArray, array_placements, node_labels, tile_array
from resgrid.hardware.layout_drops import rail_currents, rail_drops
from resgrid.hardware.layout_process import layout_rules
from resgrid.hardware.layout_rails import RailPlan, draw_rails, plan_rails
from resgrid.hardware.layout_resistors import Head, Serpentine, body_width, head_of, size_resistors
from resgrid.hardware.layout_rules import Box, CellPlacement, DrawnCell, Label, LayoutRules
from resgrid.hardware.layout_tiles import TileGeometry, tile_cells, tile_geometry

TOP = "resgrid"
"""Name of the top cell of a layout, which contains all its other cells."""

MOST_LABELS = 20_000
"""Largest number of grid cells for which `build_layout` labels the nodes of free cells by default."""

MARGIN = 5000
"""Distance of the outline from the rails, the array and the pads, in nanometres."""

DROP_FRACTION = 0.01
"""Largest voltage drop along a rail without a warning, as a fraction of the supply voltage."""


@frozen
@dataclass(frozen=True, eq=False)
class Layout:
    """A chip layout of a compiled space: a drawing, and the circuit that the drawing realises.

    Attributes
    ----------
    process : str
        Name of the process and its resistor, such as ``"ihp-sg13g2:rppd"``.
    rules : LayoutRules
        Design rules of the process.
    op : OperatingPoint
        Operating point of the circuit with the drawn resistances.  Its netlist has merged rails.
    array : TileArray
        Contents of all tiles; a tile is the drawing of one cell of the grid.
    tile : TileGeometry
        Measures of a tile.
    resistors : tuple of Serpentine
        One drawn resistor for each different resistance of the circuit, in ascending order.
    value : ndarray of int64, shape (resistors of the netlist,)
        Index in `resistors` of every resistor of the netlist.
    nominal : ndarray of float, shape (length of `resistors`,)
        Resistance of each entry of `resistors` before rounding to the manufacturing grid, in ohms.
    rails : RailPlan
        Measures of rails and pads.
    cells : tuple of DrawnCell
        Cells of the GDSII or OASIS file, the top cell last.

    Examples
    --------
    >>> space = rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))
    >>> layout = rg.hardware.build_layout(space, "toy:poly")
    >>> layout.op.netlist
    <Netlist of 59 nodes: 140 resistors, 2 voltage sources>
    """

    process: str
    rules: LayoutRules
    op: OperatingPoint
    array: TileArray
    tile: TileGeometry
    resistors: tuple[Serpentine, ...]
    value: NDArray[np.int64]
    nominal: NDArray[np.float64]
    rails: RailPlan
    cells: tuple[DrawnCell, ...]

    def __repr__(self) -> str:
        width, height = self.size
        cells = " x ".join(map(str, self.op.netlist.cells.space.shape))
        return (
            f"<Layout of {cells} cells in {self.process}: {len(self.value):,} resistors, "
            f"{width * 1e6:.4g} x {height * 1e6:.4g} um>"
        )

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the outline of the whole layout, in metres."""
        x0, y0, x1, y1 = self.outline
        return (x1 - x0) * 1e-9, (y1 - y0) * 1e-9

    @property
    def outline(self) -> tuple[int, int, int, int]:
        """Corners x0, y0 (lower left), x1, y1 (upper right) of the outline, in nm from the node of cell (0, 0).

        Cell (0, 0) is the lower left cell of the grid.
        """
        return next(box[1:] for box in self.cells[-1].boxes if box[0] == self.rules.outline)

    @property
    def pitch(self) -> tuple[float, float]:
        """Distances between the centres of neighbouring cells along x and y, in metres."""
        return self.tile.px * 1e-9, self.tile.py * 1e-9

    @cached_property
    def drops(self) -> dict[str, float]:
        """Largest estimated voltage drop along the rail of each net, in volts, by the name of the net.

        The nets are the obstacle rail, the goal regions and the start. The wires between rails and pads are not
        counted.
        """
        return rail_drops(self.rules, self.array, self.tile, self.rails, self.op)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Messages about voltage drops above 1 % of the supply, and about trunks that are too thin for their current.

        A trunk is the vertical wire of a goal region or of the start. Trunks are too thin if they are narrower than the
        width that the current density limits of the metals demand for the largest current of a trunk.
        """
        return tuple(_warnings(self.rails, self.op, self.drops))

    def summary(self) -> dict[str, Any]:
        """Return measures of the layout by name, for reports; lengths in metres, areas in square metres.

        Returns
        -------
        dict
            ``process``, ``cells`` (columns and rows), ``resistors`` (number), ``values`` (number of different
            resistances), ``pitch`` (of cells along x and y), ``array_size`` (without rails and pads), ``array_area``,
            ``size`` (of the outline), ``area``, ``resistor`` (mapping: ``width``; smallest and largest ``length``,
            ``rows`` and ``resistance`` in ohms; ``rounding``, the largest relative error of a resistance), ``rails``
            (mapping: ``trunk_width``, ``stripe_width``, ``side_width``, None without such wires; magnitudes of
            ``current`` in amperes and ``drop`` in volts, by net), ``pads`` (mappings with ``net`` and centre ``at``),
            ``warnings`` (messages).
        """
        shape = self.op.netlist.cells.space.shape
        array_size = [shape[0] * self.tile.px * 1e-9, shape[1] * self.tile.py * 1e-9]
        lengths = [shape.area / shape.width * 1e-9 for shape in self.resistors]
        ohms = [shape.resistance for shape in self.resistors]
        error = max(abs(drawn / wanted - 1) for drawn, wanted in zip(ohms, self.nominal.tolist(), strict=True))
        rails = self.rails
        return {
            "process": self.process,
            "cells": list(shape),
            "resistors": len(self.value),
            "values": len(self.resistors),
            "pitch": list(self.pitch),
            "array_size": array_size,
            "array_area": array_size[0] * array_size[1],
            "size": list(self.size),
            "area": self.size[0] * self.size[1],
            "resistor": {
                "width": self.resistors[0].width * 1e-9,
                "length": [min(lengths), max(lengths)],
                "rows": [min(shape.rows for shape in self.resistors), max(shape.rows for shape in self.resistors)],
                "resistance": [min(ohms), max(ohms)],
                "rounding": error,
            },
            "rails": {
                "trunk_width": rails.trunks[0].width * 1e-9 if rails.trunks else None,
                "stripe_width": (self.tile.stripe[1] - self.tile.stripe[0]) * 1e-9 if rails.ring else None,
                "side_width": rails.ring * 1e-9 if rails.ring else None,
                "current": {net: abs(amps) for net, amps in rail_currents(self.op).items()},
                "drop": self.drops,
            },
            "pads": [{"net": pad.net, "at": [pad.x * 1e-9, pad.y * 1e-9]} for pad in rails.pads],
            "warnings": list(self.warnings),
        }


def build_layout(
    space: ConfigurationSpace,
    process: str,
    wiring: Wiring | None = None,
    *,
    width: float | None = None,
    matching: float | None = None,
    labels: bool | None = None,
    **options: Unpack[WiringOptions],
) -> Layout:
    """Return the layout of a space of two axes in a chip process.

    Every resistor of the circuit with merged rails is drawn as a serpentine of its own; its length is rounded to the
    manufacturing grid.  Obstacles are connected to stripes of metal 2, goal regions and the start to a trunk of metal 3
    each, and all of them to pads.

    Parameters
    ----------
    space : ConfigurationSpace
        Space with two axes that are not periodic.
    process : str
        Name of the process and its resistor, such as ``"ihp-sg13g2:rppd"`` or ``"toy:poly"``.
    wiring : Wiring, optional
        Boundary conditions, drive and element values; by default those of `resgrid.Wiring`.
    width : float, optional
        Width of the resistors, in metres; by default the smallest width that the process and `matching` permit.
    matching : float, optional
        Required standard deviation of a resistance, relative to its mean, such as 0.01; determines the width, for the
        smallest resistance.  Not together with `width`.
    labels : bool, optional
        Whether the node of every free cell gets a label such as ``n_3_4`` (column, row); by default on grids of at most
        20,000 cells.  Pads always have labels; the start has only that of its pad.
    **options
        Fields of `Wiring`, instead of `wiring` or as changes to it.

    Returns
    -------
    Layout
        The layout; `resgrid.save` writes it as GDSII or OASIS.

    Raises
    ------
    InputError
        If the space has other than two axes or a periodic axis, the circuit needs current sources in its cells (uniform
        drive) or has a leak, a resistance cannot be drawn, the trunks do not fit, `width` and `matching` are both
        given, or the process is unknown.

    Examples
    --------
    >>> space = rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))
    >>> layout = rg.hardware.build_layout(space, "ihp-sg13g2:rppd", resistance=20e3)
    >>> layout.process, len(layout.rails.pads)
    ('ihp-sg13g2:rppd', 3)
    """
    rules = layout_rules(process)
    wiring = _drawable_wiring(space, wiring_of(wiring, options))
    netlist = compile_space(space, wiring)
    ohms, value = _distinct(1.0 / netlist.conductance)
    drawn_width = body_width(rules, ohms.tolist(), width, matching)
    head = head_of(rules, drawn_width)
    shapes = size_resistors(rules, head, drawn_width, ohms.tolist())
    drawn = np.array([shape.resistance for shape in shapes])
    op = solve(netlist.replace(conductance=1.0 / drawn[value]))
    tile, array = tile_geometry(rules, head, shapes), tile_array(netlist, value)
    rails = plan_rails(rules, array, tile, rail_currents(op), abs(wiring.supply))
    labelled = space.cell.size <= MOST_LABELS if labels is None else labels
    cells = _draw(rules, head, tile, shapes, array, rails, labelled)
    return Layout(process, rules, op, array, tile, tuple(shapes), value, ohms, rails, tuple(cells))


def _drawable_wiring(space: ConfigurationSpace, wiring: Wiring) -> Wiring:
    """Return the wiring with merged rails; raise InputError if the space or the wiring cannot be drawn as a layout."""
    require_square(wiring.lattice, "a layout")
    require_drive(wiring, "a layout")
    if space.ndim != 2:
        raise InputError(f"a layout needs a space of two axes, and this space has {space.ndim}; choose another scene")
    for axis in space.axes:
        if axis.periodic:
            raise InputError(
                f"axis {axis.name!r} is periodic: the ring needs a wire across the whole array in every row, which a "
                "layout does not draw; choose a scene without periodic axes"
            )
    if wiring.drive == "uniform":
        raise InputError(
            "boundary = 'neumann' with drive = 'uniform' injects a current into every cell, and a layout of resistors "
            "has no current sources; set drive = 'start' with a start, or choose boundary = 'dirichlet' or 'wall'"
        )
    if wiring.leak:
        raise InputError(
            f"leak = {wiring.leak:g} adds a resistor from every free cell to the obstacle rail, which a layout does "
            "not draw; set leak = 0, or write a deck with 'resgrid compile'"
        )
    return wiring_of(wiring, {"rails": "merged"})


def _distinct(ohms: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the different resistances in ohms, ascending, and for each resistor the index of its resistance there.

    Resistances are equal if they agree after rounding to a relative precision of 1e-9. `ohms` (resistors,): resistances
    in ohms.
    """
    keys, first, number = np.unique(np.round(np.log(ohms) * 1e9), return_index=True, return_inverse=True)
    del keys
    return ohms[first], number.astype(np.int64)


def _draw(
    rules: LayoutRules,
    head: Head,
    tile: TileGeometry,
    shapes: list[Serpentine],
    array: TileArray,
    rails: RailPlan,
    labelled: bool,
) -> list[DrawnCell]:
    """Return all cells of the GDSII or OASIS file, the top cell last.

    `head`: measures of the ends of all resistors; `tile`: measures of a tile, the drawing of one cell of the grid;
    `shapes`: the drawn resistor of each different resistance; `array`: contents of all tiles; `rails`: measures of
    rails and pads; `labelled`: whether the nodes of free cells get labels.
    """
    cells = tile_cells(rules, head, tile, shapes)
    drawing = draw_rails(rules, array, tile, rails)
    body = DrawnCell("array", (), tuple(array_placements(array, tile, len(shapes))))
    boxes: list[Box] = list(drawing.boxes)
    left, right = rails.sides[0] - rails.ring // 2, rails.sides[1] + rails.ring // 2
    top = (array.node.shape[1] - 1) * tile.py
    for cover in rules.covers:
        over = max(cover.beside, cover.beyond)
        boxes.append((cover.layer, left - over, rails.bottom - over, right + over, top + over))
    reach = rules.pad // 2 + MARGIN
    xs = [pad.x for pad in rails.pads]
    outline = (
        rules.up(min([left - MARGIN, *(x - reach for x in xs)])),
        rules.up(rails.pad_top - rules.pad - MARGIN),
        rules.up(max([right + MARGIN, *(x + reach for x in xs)])),
        rules.up(top + MARGIN),
    )
    boxes.append((rules.outline, *outline))
    labels = [*drawing.labels, Label(f"tile {tile.px} {tile.py} {tile.upper} nm", 0, 0, rules.outline)]
    if labelled:
        labels += node_labels(array, tile, rules.metals[0])
    placed = (CellPlacement("array", 0, 0), *drawing.placements)
    return _placed_cells([*cells, *drawing.cells, body, DrawnCell(TOP, tuple(boxes), placed, tuple(labels))])


def _placed_cells(cells: list[DrawnCell]) -> list[DrawnCell]:
    """Return the cells that the last of `cells` contains, directly or inside other cells, and the last cell itself.

    A cell comes after its contents.
    """
    kept, used = [], {cells[-1].name}
    for cell in reversed(cells):
        if cell.name in used:
            kept.append(cell)
            used |= {placed.cell for placed in cell.placements}
    return kept[::-1]


def _warnings(rails: RailPlan, op: OperatingPoint, drops: dict[str, float]) -> list[str]:
    """Return messages about rails with a drop above `DROP_FRACTION` of the supply, and about too thin trunks.

    A trunk (a vertical wire to a goal region or the start) is too thin if it is narrower than `rails.wire`. In this
    case `rails.wire` is the width that current density limits demand for the largest current of a trunk. `drops`:
    largest voltage drop along the rail of each net, in volts.
    """
    supply = abs(op.netlist.cells.wiring.supply)
    found = [
        f"the voltage drop along the rail of {net} is up to {drop:.3g} V, {drop / supply:.2g} of the supply, and the "
        "expected voltages assume ideal rails; raise the resistance of the grid"
        for net, drop in drops.items()
        if drop > DROP_FRACTION * supply
    ]
    currents = rail_currents(op)
    for trunk in rails.trunks:
        if trunk.width < rails.wire:
            found.append(
                f"the trunk of {trunk.net} is {trunk.width * 1e-3:g} um wide, but {abs(currents[trunk.net]):.3g} A "
                f"need {rails.wire * 1e-3:g} um; raise the resistance of the grid or the width of its resistors"
            )
    return found


def circuit_hash(netlist: Netlist) -> str:
    """Return the SHA-256 of the cells, nodes and conductances of a netlist, in hexadecimal digits."""
    digest = sha256(netlist.cells.space.cell.tobytes())
    digest.update(repr(netlist.cells.space.shape).encode())
    digest.update(netlist.resistor_nodes.tobytes())
    digest.update(netlist.conductance.tobytes())
    return digest.hexdigest()
