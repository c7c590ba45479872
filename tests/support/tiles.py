"""Chips with switches in their tiles."""

from __future__ import annotations

import resgrid as rg
from resgrid.spice.write.tiles import with_tile_switches


def tiled(space: rg.ConfigurationSpace, chip: rg.Chip | None = None, **options: object) -> tuple[rg.Netlist, rg.Chip]:
    """Return the netlist of a space in the form of tiles, and its chip; the drive is not scaled."""
    boundary = str(options.get("boundary", "dirichlet"))
    wall = options.get("wall_resistance")
    supply = options.get("supply", 1.0)
    chip = with_tile_switches(chip or rg.Chip(wall_resistance=wall, supply=supply), boundary)
    return rg.chip.build_chip(rg.compile_space(space, rails="cells", **options), chip), chip
