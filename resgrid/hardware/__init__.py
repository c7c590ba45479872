"""Printed circuit boards (KiCad) and chip layouts (GDSII, OASIS) of a compiled space, with checks.

A board is a KiCad project, and a layout a GDSII or OASIS file.  A record beside each file lists its parts, its sources
and the expected voltages, so that `resgrid check` can compare them with the netlist that an independent tool extracts.

Examples
--------
>>> scene = rg.read_scene("examples/scenes/lesson.toml")
>>> rg.hardware.build_board(scene, kind="jumpers")
<Board of kind jumpers: 8 x 8 cells, 144 resistors, 75.2 x 82.2 mm>
>>> rg.hardware.build_layout(rg.build_space(scene), "toy:poly")
<Layout of 8 x 8 cells in toy:poly: 140 resistors, 230 x 111.3 um>
"""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
