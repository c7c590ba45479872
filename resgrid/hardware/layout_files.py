"""Writer of layout files: GDSII and OASIS by gdstk, and the record of the circuit in the same folder."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from types import ModuleType
from typing import Any

from resgrid._internal.extras import install_command
from resgrid._internal.files import atomic_path
from resgrid.core.netlist import Netlist
from resgrid.core.regions import crossed_faces
from resgrid.errors import InputError, ToolMissingError
from resgrid.hardware.layout import TOP, Layout, circuit_hash
from resgrid.hardware.layout_rails import pad_name
from resgrid.hardware.layout_rules import DrawnCell
from resgrid.hardware.record import GROUND, HardwareRecord, Part, Supply, record_path, write_record

SUFFIXES = (".gds", ".oas")
"""Suffixes of layout files: GDSII and OASIS."""

DATE = datetime(2000, 1, 1)
"""Time stamp of every cell of a GDSII file, so that the same layout gives the same bytes."""

COMPRESSION = 9
"""Compression level of an OASIS file."""

MOST_RECORDED = 65_536
"""Largest number of grid cells for which a layout gets a record by default."""


def write_layout(layout: Layout, file: str | os.PathLike[str], *, record: bool | None = None) -> Path:
    """Write a layout as GDSII or OASIS, and its record; return the path of the layout.

    Parameters
    ----------
    layout : Layout
        The layout.
    file : path-like
        The file; ``.gds`` is GDSII, ``.oas`` is OASIS.  The record of ``chip.gds`` is ``chip.record.json``.
    record : bool, optional
        Whether to write the record, which `check_layout` needs; by default for grids of up to 65,536 cells, because the
        record of a larger array takes longer than its layout.  If no record is written, an older record is removed.

    Returns
    -------
    Path
        The path of the layout.

    Raises
    ------
    InputError
        If the suffix is unknown, or a file cannot be written.
    ToolMissingError
        If gdstk is not installed.
    """
    path = Path(file)
    require_suffix(path)
    gdstk = load_gdstk()
    with atomic_path(path) as temporary:
        library = _library(gdstk, layout)
        if path.suffix.lower() == ".gds":
            library.write_gds(str(temporary), timestamp=DATE)
        else:
            library.write_oas(str(temporary), compression_level=COMPRESSION)
        if has_record(layout, record):
            write_record(path, record_of(layout, path.name))
        else:  # an outdated record would contradict the layout
            record_path(path).unlink(missing_ok=True)
    return path


def has_record(layout: Layout, record: bool | None = None) -> bool:
    """Return whether the record of a layout is written.

    `record`: True or False as the user chose; None: only for grids of at most 65,536 cells.
    """
    return layout.op.netlist.cells.space.cell.size <= MOST_RECORDED if record is None else record


def require_suffix(path: Path) -> None:
    """Raise InputError unless the suffix of a path is ``.gds`` or ``.oas``."""
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: the name of a layout ends in .gds (GDSII) or .oas (OASIS); change the suffix")


def load_gdstk() -> ModuleType:
    """Return the module gdstk; raise ToolMissingError with the install command if it is not installed."""
    try:
        import gdstk
    except ImportError:
        raise ToolMissingError(
            f"layouts are written by gdstk, which is not installed: '{install_command('layout')}'"
        ) from None
    module: ModuleType = gdstk
    return module


def _library(gdstk: Any, layout: Layout) -> Any:
    """Return the gdstk library of a layout, with micrometres as unit and nanometres as precision."""
    library = gdstk.Library(TOP, unit=1e-6, precision=1e-9)
    made: dict[str, Any] = {}
    for cell in layout.cells:
        made[cell.name] = _cell(gdstk, cell, made)
        library.add(made[cell.name])
    return library


def _cell(gdstk: Any, cell: DrawnCell, made: dict[str, Any]) -> Any:
    """Return a cell of a layout as a cell of gdstk.

    `gdstk`: the module; `made`: gdstk cells by name that were made before, among them all that `cell` contains.
    """
    drawn = gdstk.Cell(cell.name)
    for (layer, kind), x0, y0, x1, y1 in cell.boxes:
        drawn.add(gdstk.rectangle((x0 / 1e3, y0 / 1e3), (x1 / 1e3, y1 / 1e3), layer=layer, datatype=kind))
    for placed in cell.placements:
        array = {} if placed.columns * placed.rows == 1 else {
            "columns": placed.columns, "rows": placed.rows, "spacing": (placed.dx / 1e3, placed.dy / 1e3)
        }  # fmt: skip
        drawn.add(gdstk.Reference(made[placed.cell], (placed.x / 1e3, placed.y / 1e3), **array))
    for label in cell.labels:
        layer, kind = label.layer
        drawn.add(gdstk.Label(label.text, (label.x / 1e3, label.y / 1e3), layer=layer, texttype=kind))
    return drawn


def record_of(layout: Layout, name: str) -> HardwareRecord:
    """Return the record of the circuit that a layout realises; `name`: name of the layout's file."""
    netlist, op = layout.op.netlist, layout.op
    nets = netlist.names_of(range(netlist.node_count))
    parts = tuple(
        Part(reference, "resistor", ohms, (nets[a], nets[b]))
        for reference, ohms, (a, b) in zip(
            part_names(netlist), (1.0 / netlist.conductance).tolist(), netlist.resistor_nodes.tolist(), strict=True
        )
    )
    parts += tuple(_pad_parts(layout))
    touched = {net for part in parts for net in part.nets}
    pads = tuple(dict.fromkeys(pad.net for pad in layout.rails.pads))
    volts = dict(zip(nets, op.voltage.tolist(), strict=True))
    cell_of = netlist.cell_of_node().tolist()
    columns = netlist.cells.space.shape[1]
    return HardwareRecord(
        kind="layout",
        variant=None,
        file=name,
        scene_hash=circuit_hash(netlist),
        process=layout.process,
        parts=parts,
        sources=tuple(Supply(net, net, GROUND, volts[net]) for net in pads if net in touched),
        voltages={net: volts[net] for net in nets if net in touched},
        nodes={
            net: divmod(cell, columns) for net, cell in zip(nets, cell_of, strict=True) if cell >= 0 and net in touched
        },
    )


def part_names(netlist: Netlist) -> list[str]:
    """Return the name of every resistor of a netlist, in the order of the netlist.

    ``RX_3_4`` lies between the cells (2, 4) and (3, 4), ``RY_3_4`` between (3, 3) and (3, 4).
    """
    axes, faces = crossed_faces(netlist.cells.resistor_face, netlist.cells.space.shape)
    return [f"R{'XY'[axis]}_{i}_{j}" for axis, (i, j) in zip(axes.tolist(), faces.tolist(), strict=True)]


def _pad_parts(layout: Layout) -> Iterator[Part]:
    """Yield the pads of a layout as parts of its record, from left to right."""
    seen: Counter[str] = Counter()
    for pad in layout.rails.pads:
        seen[pad.net] += 1
        yield Part(pad_name(pad.net, seen[pad.net]), "test_pad", None, (pad.net,))
