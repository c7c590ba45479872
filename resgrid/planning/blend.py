"""Blends ``k phi_D + (1 - k) phi_N`` of Dirichlet and Neumann fields (Connolly & Grupen 1992, section 3.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.numbers import is_number
from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.planning.fields import Field
from resgrid.planning.lattice_fields import LatticeField

_CANCELLED = 1e-12
"""Magnitude of a blended current below which it is rounding error and counts as zero, as a fraction of the larger of
``k |I_D|`` and ``(1 - k) |I_N|``, the two currents that are added."""


def blend(dirichlet: Field, neumann: Field, k: float, *, allow_start_drive: bool = False) -> Field:
    """Blend two fields of one space: ``phi = k phi_D + (1 - k) phi_N`` on free cells.

    A sum of superharmonic functions is superharmonic, so streamlines of a blend have the guarantees of both fields:
    they enter no obstacle and end only in a goal.  Currents are blended face by face.  Their signs, not differences
    of the blended potential, decide which neighbour of a cell is lower.

    Parameters
    ----------
    dirichlet : Field
        Field with obstacles at the high rail (``boundary`` ``"dirichlet"`` or ``"wall"``).
    neumann : Field
        Field with open obstacles and a uniform drive, or the leak of the Dirichlet field.
    k : float
        Weight of the Dirichlet field, in [0, 1].
    allow_start_drive : bool
        Whether a Neumann field driven by a start is accepted for 0 < k < 1; streamlines then have no guarantees.

    Returns
    -------
    Field
        The given Dirichlet field for k = 1 and the given Neumann field for k = 0.  Otherwise a new field, whose
        potential is NaN on obstacles and in cells where either field has no potential.

    Raises
    ------
    InputError
        If k is out of range, the fields have the wrong boundaries, or they differ in space, edge rule or leak.

    Examples
    --------
    >>> space = rg.build_space(rg.read_scene("examples/scenes/lesson.toml"))
    >>> fields = [rg.field(rg.solve(rg.compile_space(space, boundary=name))) for name in ("dirichlet", "neumann")]
    >>> half = rg.blend(*fields, k=0.5)
    >>> half
    <Field on 8 x 8 cells: blend, k = 0.5>
    >>> [round(rg.streamline(field, (0.5, 6.5)).clearance, 2) for field in (*fields, half)]
    [0.41, 0.33, 0.35]
    """
    check_k(k)
    check_pair(dirichlet, neumann)
    if k in (0.0, 1.0):
        return dirichlet if k == 1.0 else neumann
    if neumann.wiring.drive == "start" and not allow_start_drive:
        raise InputError("a start-driven Neumann field serves one start only: blend with drive = 'uniform'")
    potential = k * dirichlet.potential + (1.0 - k) * neumann.potential
    potential = np.where(dirichlet.space.cell == Cell.OBSTACLE, np.nan, potential)
    masks = [field.safe for field in (dirichlet, neumann) if field.safe is not None]
    currents = (dirichlet.face_direction, dirichlet.face_log_current, neumann.face_direction, neumann.face_log_current)
    parts = [add_currents(*four, k) for four in zip(*currents, strict=True)]
    return Field(
        space=dirichlet.space,
        wiring=dirichlet.wiring,
        potential=potential,
        log_drop=None,
        face_direction=tuple(direction for direction, _ in parts),
        face_log_current=tuple(log_current for _, log_current in parts),
        k=float(k),
        safe=np.logical_and.reduce(masks) if masks else None,
    )


def check_k(k: float) -> None:
    """Raise InputError unless k, the weight of the Dirichlet field, is a number in [0, 1]."""
    if not (is_number(k) and 0.0 <= k <= 1.0):
        raise InputError(f"k = {k!r}, but a blend needs 0 <= k <= 1 (1 is Dirichlet, 0 is Neumann)")


def check_pair(dirichlet: Field | LatticeField, neumann: Field | LatticeField) -> None:
    """Raise InputError unless the fields are Dirichlet and Neumann, in this order, of one space, edge rule and leak."""
    if dirichlet.boundary not in {"dirichlet", "wall"} or neumann.boundary != "neumann":
        raise InputError(
            f"a blend takes a Dirichlet and a Neumann field, in this order; got {dirichlet.boundary!r} and "
            f"{neumann.boundary!r}"
        )
    if not _is_same_space(dirichlet.space, neumann.space):
        raise InputError("the two fields belong to different spaces; compile both from one space")
    if dirichlet.wiring.leak != neumann.wiring.leak:
        raise InputError(
            f"the two fields have leak = {dirichlet.wiring.leak:g} and {neumann.wiring.leak:g}; compile both with the "
            "same leak"
        )
    if dirichlet.edge != neumann.edge:
        raise InputError(
            f"the two fields have edges {dirichlet.edge} and {neumann.edge}; compile both with the same edge"
        )


def _is_same_space(first: ConfigurationSpace, second: ConfigurationSpace) -> bool:
    """Return whether two spaces have equal axes, frames, cells and conductivities.

    Missing conductivities count as 1.
    """
    if first is second:
        return True
    one, other = (np.float64(1.0) if space.conductivity is None else space.conductivity for space in (first, second))
    placed = first.axes == second.axes and first.frame == second.frame
    return placed and np.array_equal(first.cell, second.cell) and bool(np.all(one == other))


def add_currents(
    direction_d: NDArray[np.int8],
    log_d: NDArray[np.float64],
    direction_n: NDArray[np.int8],
    log_n: NDArray[np.float64],
    k: float,
) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
    """Return signs and natural log magnitudes of the currents ``k I_D + (1 - k) I_N``, arrays of one shape.

    `direction_d`, `log_d`, `direction_n`, `log_n`: signs and natural log magnitudes of the currents ``I_D`` and ``I_N``
    of the Dirichlet and the Neumann field.  Sums within rounding error are set to zero, with the logarithm -inf.
    """
    log_d, log_n = log_d + np.log(k), log_n + np.log1p(-k)
    largest = np.maximum(log_d, log_n)
    base = np.where(np.isfinite(largest), largest, 0.0)
    total = direction_d * np.exp(log_d - base) + direction_n * np.exp(log_n - base)
    total[np.abs(total) < _CANCELLED] = 0.0
    with np.errstate(divide="ignore"):
        return np.sign(total).astype(np.int8), np.log(np.abs(total)) + base


def dirichlet_fraction(dirichlet: Field, neumann: Field, k: float) -> NDArray[np.float64]:
    """Return the fraction of a blend's gradient that comes from the Dirichlet field.

    The fraction is ``|k grad phi_D| / (|k grad phi_D| + |(1 - k) grad phi_N|)`` at the centre of every cell.

    Parameters
    ----------
    dirichlet, neumann : Field
        Dirichlet field and Neumann field of one space.
    k : float
        Weight of the Dirichlet field, in [0, 1].

    Returns
    -------
    ndarray of float64, shape of the space
        Fraction in [0, 1]; NaN in cells where both gradients vanish.

    Raises
    ------
    InputError
        If k is out of range or the fields cannot be blended.
    """
    check_k(k)
    check_pair(dirichlet, neumann)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_d, log_n = _log_gradient(dirichlet) + np.log(k), _log_gradient(neumann) + np.log1p(-k)
        return np.asarray(np.exp(log_d - np.logaddexp(log_d, log_n)))


def _log_gradient(field: Field) -> NDArray[np.float64]:
    """Return the natural log norm of the gradient at every cell centre, shape of the space, up to a constant.

    The constant is equal for all cells and for all fields of one space; -inf where the gradient vanishes.
    """
    cells = np.indices(field.space.shape).reshape(field.space.ndim, -1).T
    gradient, log_scale = field.gradient(cells, np.full(cells.shape, 0.5))
    return np.reshape(log_scale + np.log(np.linalg.norm(gradient, axis=1)), field.space.shape)
