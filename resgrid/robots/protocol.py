"""What every robot can do: say which cells of its configuration space are blocked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from resgrid.robots.shapes import Shape
from resgrid.space import Axis

Sampling = Literal["conservative", "centre"]
"""How a cell is judged: by its whole square, or by its centre alone."""


@runtime_checkable
class Robot(Protocol):
    """A robot seen from its configuration space.

    A point robot's axes are those of the workspace; an arm's are its joint angles, a turning polygon's are
    ``(x, y, theta)``.  The obstacles are always shapes of the workspace.
    """

    def occupancy(self, axes: Sequence[Axis], obstacles: Sequence[Shape], rule: Sampling) -> NDArray[np.bool_]:
        """Cells in which the robot would touch an obstacle.

        Parameters
        ----------
        axes : sequence of Axis
            The axes of the configuration space.
        obstacles : sequence of Shape
            What stands in the workspace.
        rule : {"conservative", "centre"}
            Whether a cell is blocked when the robot touches an obstacle anywhere inside it, or at its centre.

        Returns
        -------
        ndarray of bool
            One entry per cell, True where blocked.

        Raises
        ------
        InputError
            If a shape does not fit the robot's workspace.
        """
        ...
