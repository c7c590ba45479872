"""Blends of the Dirichlet and the Neumann field of a lattice (Connolly & Grupen 1992, section 3.3)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from resgrid.core.cell import Cell
from resgrid.errors import InputError
from resgrid.planning.blend import add_currents, check_k, check_pair
from resgrid.planning.lattice_fields import LatticeField


def blend_lattice_fields(dirichlet: LatticeField, neumann: LatticeField, k: float) -> LatticeField:
    """Return the field ``phi = k phi_D + (1 - k) phi_N`` of a lattice.

    Steps have equal conductances in both circuits, so that blended currents are those of the blended potential.  The
    sum of superharmonic functions is superharmonic: from every site with a path to a goal, a current leads to a lower
    potential.  The potential is NaN in obstacles.  `dirichlet`, `neumann`: fields with the potentials ``phi_D`` and
    ``phi_N``; `k`: weight of the Dirichlet field; for 1 and 0 the given field is returned.
    """
    check_k(k)
    check_pair(dirichlet, neumann)
    if dirichlet.lattice.name != neumann.lattice.name:
        raise InputError(
            f"the two fields have lattice = {dirichlet.lattice.name!r} and {neumann.lattice.name!r}; compile both with "
            "the same lattice"
        )
    if k in (0.0, 1.0):
        return dirichlet if k == 1.0 else neumann
    if neumann.wiring.drive == "start":
        raise InputError("a start-driven Neumann field serves one start only: blend with drive = 'uniform'")
    potential = k * dirichlet.potential + (1.0 - k) * neumann.potential
    potential[dirichlet.lattice.at_sites(dirichlet.space.cell) == Cell.OBSTACLE] = np.nan
    currents = (dirichlet.step_direction, dirichlet.step_log_current, neumann.step_direction, neumann.step_log_current)
    parts = [add_currents(*four, k) for four in zip(*currents, strict=True)]
    return replace(
        dirichlet,
        potential=potential,
        log_drop=None,
        step_direction=tuple(direction for direction, _ in parts),
        step_log_current=tuple(log_current for _, log_current in parts),
        k=float(k),
    )
