"""The field of a configuration space: a potential in every cell and a current through every cell face."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.space import ConfigurationSpace


@dataclass(frozen=True, eq=False)
class Field:
    """Potential and face currents on a configuration space.

    Attributes
    ----------
    space : ConfigurationSpace
        The space.
    potential : ndarray of float64, shape of the space
        ``phi``: 1 on obstacles, 0 on goals; NaN in a cell without a node.  With a uniform drive it is the height above
        the goal rail, scaled to a maximum of 1.
    log_drop : ndarray of float64, shape of the space, or None
        Natural logarithm of ``u = 1 - phi``, right to the last digits where ``phi`` rounds to 1; -inf where nothing
        arrives, NaN in a cell without a node.  None where no obstacle rail exists (uniform drive, blends).
    face_direction : tuple of ndarray of int8
        Per axis ``a``, shape of the space with one more along ``a``: the sign of the current through the lower face of
        every cell, positive in the direction of the axis, 0 where none flows.  On a periodic axis the last face
        repeats the first.
    face_log_current : tuple of ndarray of float64
        Same shapes: natural logarithm of its magnitude in units of supply / resistance; -inf where none flows.
    boundary : str
        ``"dirichlet"``, ``"neumann"``, ``"wall"`` or ``"blend"``.
    drive : str or None
        ``"uniform"``, ``"start"`` or None.
    k : float
        Share of the Dirichlet field: 1 for Dirichlet and walls, 0 for Neumann.
    """

    space: ConfigurationSpace
    potential: NDArray[np.float64]
    log_drop: NDArray[np.float64] | None
    face_direction: tuple[NDArray[np.int8], ...]
    face_log_current: tuple[NDArray[np.float64], ...]
    boundary: str
    drive: str | None
    k: float

    def __post_init__(self) -> None:
        for array in (self.potential, self.log_drop, *self.face_direction, *self.face_log_current):
            if array is not None:
                array.flags.writeable = False

    def face_current(self, axis: int) -> NDArray[np.float64]:
        """Current through every face across one axis, positive along it.

        Parameters
        ----------
        axis : int

        Returns
        -------
        ndarray of float64
            Shape of the space with one more along ``axis``; in units of supply / resistance; 0 where it underflows.
        """
        return np.asarray(self.face_direction[axis] * np.exp(self.face_log_current[axis]), dtype=np.float64)
