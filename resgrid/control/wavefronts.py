"""Propagation of a change of the map through the potential of a settling grid: `Wavefront` and `wavefront`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen, picture_html
from resgrid.control.relaxation import RelaxingGrid
from resgrid.control.simulation import Simulation
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError


@frozen
@dataclass(frozen=True, eq=False)
class Wavefront:
    """Propagation of a change of the map through the potential of a settling grid.

    Returned by `resgrid.control.wavefront`.

    Attributes
    ----------
    before, after : ConfigurationSpace
        The maps before and after the change.
    cells : ndarray of float64, shape (t,)
        Times since the change, as numbers of cells that the robot at nominal speed could have crossed.
    potential : ndarray of float64, shape (t,) + shape of the space
        Normalised potential (0 to 1) at each time; NaN in cells without a node.
    distance : ndarray of float64, shape (t,)
        At each time, the largest difference of a cell's normalised potential from its final value.
    first : ndarray of float64, shape of the space
        Normalised potential (0 to 1) before the change.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml").replace(hidden=(rg.Box((5.0, 2.2), (6.0, 3.0)),))
    >>> world = rg.simulation(scene, k=1.0, announce=True, settle="sor")
    >>> front = rg.control.wavefront(world, np.array([0.0, 0.5, 4.0]))
    >>> front.distance.round(3)
    array([0.112, 0.03 , 0.   ])
    >>> (front.potential[1] - front.first)[5, 3:6].round(3)
    array([0.102, 0.036, 0.025])
    """

    before: ConfigurationSpace
    after: ConfigurationSpace
    cells: NDArray[np.float64]
    potential: NDArray[np.float64]
    distance: NDArray[np.float64]
    first: NDArray[np.float64]

    _repr_html_ = picture_html


def wavefront(simulation: Simulation, cells: NDArray[np.float64]) -> Wavefront:
    """Compute the propagation of a change of the map through the potential of a settling grid.

    Parameters
    ----------
    simulation : Simulation
        A simulation in the plane, made with ``announce=True``: the hidden obstacles enter the map at time 0.  Its
        ``settle`` and ``pace`` give the mechanism and the speed of settling.
    cells : ndarray of float64, shape (t,)
        Times since the change, as numbers of cells that the robot at nominal speed could have crossed, ascending.

    Returns
    -------
    Wavefront
        Potentials of all cells at every time, and their differences from the final potentials.

    Raises
    ------
    InputError
        If no change was announced, or the times do not ascend.
    CircuitError
        If the circuit has no drive.

    Examples
    --------
    >>> scene = rg.read_scene("examples/scenes/lesson.toml").replace(hidden=(rg.Box((5.0, 2.2), (6.0, 3.0)),))
    >>> world = rg.simulation(scene, k=1.0, announce=True, settle="sor")
    >>> front = rg.control.wavefront(world, np.array([0.0, 0.5, 4.0]))
    >>> front.potential[:, 5, 3].round(3)
    array([0.843, 0.945, 0.955])
    """
    when = np.asarray(cells, dtype=np.float64)
    if when.ndim != 1 or not len(when) or not np.isfinite(when).all() or when[0] < 0 or np.any(when[1:] < when[:-1]):
        raise InputError("times of a wavefront must be finite, at least 0 and ascending, in cells crossed")
    if simulation.relaxation is None or simulation.before is None:
        raise InputError("no change was announced in this simulation: make it with rg.simulation(scene, announce=True)")
    grid = RelaxingGrid(simulation.relaxation, simulation.before)
    first = grid.field.potential
    grid.change(simulation.space)
    frames, distance = [], []
    for step in np.diff(when, prepend=0.0).tolist():
        grid.advance(step)
        frames.append(grid.field.potential)
        distance.append(grid.distance)
    return Wavefront(grid.before.space, simulation.space, when.copy(), np.array(frames), np.array(distance), first)
