"""Blends of the Dirichlet and the Neumann field of a lattice (Connolly & Grupen 1992, section 3.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.core.cell import Cell
from resgrid.errors import InputError
from resgrid.planning.blend import CANCELLED, check_k, is_same_space
from resgrid.planning.lattice_fields import LatticeField


def blend_lattice_fields(dirichlet: LatticeField, neumann: LatticeField, k: float) -> LatticeField:
    """Return the field ``phi = k phi_D + (1 - k) phi_N`` of a lattice.

    Steps have equal conductances in both circuits, so that blended currents are those of the blended potential.  The
    sum of superharmonic functions is superharmonic: from every site with a path to a goal, a current leads to a lower
    potential.  `k`: weight of the Dirichlet field; 1 and 0 return the given fields.
    """
    check_k(k)
    if dirichlet.boundary not in {"dirichlet", "wall"} or neumann.boundary != "neumann":
        raise InputError(
            f"a blend takes a Dirichlet and a Neumann field, in this order; got {dirichlet.boundary!r} and "
            f"{neumann.boundary!r}"
        )
    if dirichlet.lattice.name != neumann.lattice.name or not is_same_space(dirichlet.space, neumann.space):
        raise InputError("the two fields belong to different spaces or lattices; compile both from one space")
    if dirichlet.edge != neumann.edge:
        raise InputError(
            f"the two fields have edges {dirichlet.edge} and {neumann.edge}; compile both with the same edge"
        )
    if k in (0.0, 1.0):
        return dirichlet if k == 1.0 else neumann
    if neumann.wiring.drive == "start":
        raise InputError("a start-driven Neumann field serves one start only: blend with drive = 'uniform'")
    potential = k * dirichlet.potential + (1.0 - k) * neumann.potential
    potential[dirichlet.lattice.at_sites(dirichlet.space.cell) == Cell.OBSTACLE] = np.nan
    parts = [_add_currents(dirichlet, neumann, step, k) for step in range(len(dirichlet.lattice.steps))]
    return LatticeField(
        lattice=dirichlet.lattice,
        wiring=dirichlet.wiring,
        potential=potential,
        log_drop=None,
        step_direction=tuple(direction for direction, _ in parts),
        step_log_current=tuple(log_current for _, log_current in parts),
        k=float(k),
        read_out=dirichlet.read_out,
    )


def _add_currents(
    dirichlet: LatticeField, neumann: LatticeField, step: int, k: float
) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
    """Return signs and natural log magnitudes of the currents ``k I_D + (1 - k) I_N`` along a step, lattice's shape.

    Sums within rounding error are set to zero, with the logarithm -inf.
    """
    log_d = dirichlet.step_log_current[step] + np.log(k)
    log_n = neumann.step_log_current[step] + np.log1p(-k)
    largest = np.maximum(log_d, log_n)
    base = np.where(np.isfinite(largest), largest, 0.0)
    total = dirichlet.step_direction[step] * np.exp(log_d - base) + neumann.step_direction[step] * np.exp(log_n - base)
    total[np.abs(total) < CANCELLED] = 0.0
    with np.errstate(divide="ignore"):
        return np.sign(total).astype(np.int8), np.log(np.abs(total)) + base
