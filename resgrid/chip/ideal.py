"""The ideal netlist that a chip's flaws are then added to."""

from __future__ import annotations

from collections.abc import Sequence

from resgrid.compiler import compile_space
from resgrid.netlist import Netlist
from resgrid.nodal.drive import scale_drive
from resgrid.nodal.solve import solve
from resgrid.scene.chip import Chip
from resgrid.space import ConfigurationSpace


def compile_cells(
    space: ConfigurationSpace,
    chip: Chip,
    *,
    boundary: str,
    drive: str | None,
    edge: str | Sequence[str],
    start: Sequence[int] | None,
) -> Netlist:
    """Compile a configuration space with one node per cell and the chip's resistance, supply and wall."""
    return compile_space(
        space,
        boundary=boundary,
        drive=drive,
        edge=edge,
        rails="cells",
        resistance=chip.resistance,
        supply=chip.supply,
        wall_resistance=chip.wall_resistance if boundary == "wall" else None,
        start=start,
    )


def ideal_netlist(
    space: ConfigurationSpace,
    chip: Chip,
    *,
    boundary: str = "dirichlet",
    drive: str | None = None,
    edge: str | Sequence[str] = "obstacle",
    start: Sequence[int] | None = None,
) -> Netlist:
    """Compile a configuration space with one node per cell, for `build_chip` and the analyses of many chips.

    Parameters
    ----------
    space : ConfigurationSpace
    chip : Chip
        Its resistance, supply and wall resistance count.
    boundary, drive, edge, start
        As in `compile_space`.  A uniform drive is scaled so that the highest node of the ideal chip sits at the supply.

    Returns
    -------
    Netlist

    Raises
    ------
    InputError, CircuitError
        As `compile_space`.
    """
    netlist = compile_cells(space, chip, boundary=boundary, drive=drive, edge=edge, start=start)
    return scale_drive(netlist, solve(netlist)) if netlist.current_nodes.size else netlist
