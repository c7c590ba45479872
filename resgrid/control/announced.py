"""Hidden obstacles that are announced: how the change spreads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.control.relaxation import RelaxingGrid
from resgrid.control.simulation import Simulation
from resgrid.errors import InputError
from resgrid.frozen import frozen, picture_html
from resgrid.space import ConfigurationSpace


@frozen
@dataclass(frozen=True, eq=False)
class Wavefront:
    """How a change of the map spreads.

    `before, after`: the map that the grid had settled to, and the one it is settling to; `cells` (t,): when: in cells
    that the robot could have crossed; `potential` (t, *shape of the space): at those times; NaN in cells without a
    node; `distance` (t,): largest distance of a potential from its end; `first` as the space: potential before the
    change.
    """

    before: ConfigurationSpace
    after: ConfigurationSpace
    cells: NDArray[np.float64]
    potential: NDArray[np.float64]
    distance: NDArray[np.float64]
    first: NDArray[np.float64]

    _repr_html_ = picture_html


def wavefront(simulation: Simulation, cells: NDArray[np.float64]) -> Wavefront:
    """Follow a change of the map through the grid.

    Parameters
    ----------
    simulation : Simulation
        Of a plane, made with ``announce=True`` and a ``settle``.
    cells : ndarray of float64, shape (t,)
        When to look: in cells that the robot could have crossed since the change, ascending.

    Returns
    -------
    Wavefront

    Raises
    ------
    InputError
        If nothing was announced, or the times do not ascend.
    CircuitError
        If nothing can be driven.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml").replace(hidden=(rg.Box((5.0, 2.2), (6.0, 3.0)),))
    >>> world = rg.simulation(scene, k=1.0, announce=True, settle="sor")
    >>> front = rg.wavefront(world, np.array([0.0, 0.5, 4.0]))
    >>> front.potential[:, 5, 3].round(3)
    array([0.843, 0.945, 0.955])
    """
    when = np.asarray(cells, dtype=np.float64)
    if when.ndim != 1 or not len(when) or not np.isfinite(when).all() or when[0] < 0 or np.any(when[1:] < when[:-1]):
        raise InputError("times of a wavefront must be finite, at least 0 and ascending, in cells crossed")
    if simulation.relaxation is None or simulation.before is None:
        raise InputError("nothing was announced in this simulation: make it with rg.simulation(scene, announce=True)")
    grid = RelaxingGrid(simulation.relaxation, simulation.before)
    first = grid.field.potential
    grid.change(simulation.space)
    frames, distance = [], []
    for step in np.diff(when, prepend=0.0).tolist():
        grid.advance(step)
        frames.append(grid.field.potential)
        distance.append(grid.distance)
    return Wavefront(grid.before.space, simulation.space, when.copy(), np.array(frames), np.array(distance), first)
