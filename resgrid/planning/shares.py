"""How much of a blend is Dirichlet where: the weight k is one thing, the gradients that it weighs are another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.planning.blend import check_pair, check_share
from resgrid.planning.field import Field


def dirichlet_share(dirichlet: Field, neumann: Field, k: float) -> NDArray[np.float64]:
    """Share of the Dirichlet gradient in a blend ``k phi_D + (1 - k) phi_N``.

    Away from the goals the Dirichlet gradient falls off exponentially, and the Neumann one does not: with a weight of
    0.98 the blend is still almost Neumann there.

    Parameters
    ----------
    dirichlet, neumann : Field
        Of one space, as `blend` takes them.
    k : float
        In [0, 1].

    Returns
    -------
    ndarray of float64, shape of the space
        ``|k g_D| / (|k g_D| + |(1 - k) g_N|)`` at the centre of every cell from the currents through its faces and
        the cell's widths, in logarithms; NaN where neither flows.

    Raises
    ------
    InputError
        If k is out of range, or the two fields do not go together, as in `blend`.
    """
    check_share(k)
    check_pair(dirichlet, neumann)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_d, log_n = _log_gradient(dirichlet) + np.log(k), _log_gradient(neumann) + np.log1p(-k)
        return np.asarray(np.exp(log_d - np.logaddexp(log_d, log_n)))


def _log_gradient(field: Field) -> NDArray[np.float64]:
    """Natural logarithm of the gradient at the centre of every cell, up to a common factor; -inf where none is.

    A current is ``(h_ref / h_a)**2`` times the difference of the potential: the gradient is the current times ``h_a``.
    """
    logs, signs = [], []
    for axis, (direction, log_current) in enumerate(zip(field.face_direction, field.face_log_current, strict=True)):
        size, log_width = field.space.shape[axis], np.log(field.space.spacing[axis])
        for part in (range(size), range(1, size + 1)):
            logs.append(np.take(log_current, part, axis) + log_width)
            signs.append(np.take(direction, part, axis))
    scale = np.max(logs, axis=0)
    base = np.where(np.isfinite(scale), scale, 0.0)
    faces = np.array(signs) * np.exp(np.array(logs) - base)
    centre = 0.5 * (faces[::2] + faces[1::2])
    return np.asarray(base + np.log(np.linalg.norm(centre, axis=0)))
