"""Risk: whether a robot that wanders at random meets a goal before an obstacle, and when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.netlist import Netlist
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.nodal.scaled import Scaled, power
from resgrid.planning.walk import Walk, random_walk


@dataclass(frozen=True, eq=False)
class Risk:
    """What happens to a random walk from the centre of every cell.  All arrays have the shape of the space.

    Times are in units of ``R C``: the resistance between the cells that lie closest together, at conductivity 1, times
    the capacitance of a cell; a Brownian motion of diffusivity ``h_ref**2 / (R C)`` takes about as long.  Steps are
    jumps of the walk, the last one onto a rail included.

    Attributes
    ----------
    success : ndarray of float64
        Probability ``u`` of meeting a goal before an obstacle; 0 where it underflows.
    log_success : ndarray of float64
        Its natural logarithm, right to the last digits where ``u`` underflows; -inf where no goal can be met.
    time, steps : ndarray of float64
        Expected time, in ``R C``, and number of jumps until either is met: ``G t = C``, ``G n = D 1`` with ``D`` the
        diagonal of ``G``.  0 on goals and obstacles; infinite where the walk meets neither.
    time_given_success, steps_given_success : ndarray of float64
        The same, of those walks only that meet a goal: ``s / u`` with ``G s = C u``, or ``G s = D u``.  NaN where no
        goal can be met.
    """

    success: NDArray[np.float64]
    log_success: NDArray[np.float64]
    time: NDArray[np.float64]
    steps: NDArray[np.float64]
    time_given_success: NDArray[np.float64]
    steps_given_success: NDArray[np.float64]

    def __post_init__(self) -> None:
        for array in vars(self).values():
            array.flags.writeable = False


def risk(circuit: Netlist | OperatingPoint | Walk) -> Risk:
    """Read the risk of every cell off one factorisation.

    The drop ``u`` of the potential is the probability that a random walk, which jumps along a resistor with probability
    proportional to its conductance, meets a goal before an obstacle (C. I. Connolly, Harmonic functions and collision
    probabilities, Int. J. Robotics Research 16(4), 1997).  With open obstacles it is 1 and the expected time is
    proportional to the uniformly driven potential.

    Parameters
    ----------
    circuit : Netlist, OperatingPoint or Walk
        As `random_walk` takes it.

    Returns
    -------
    Risk

    Raises
    ------
    InputError
        As `random_walk`.
    AccuracyError
        If the conductances differ by more decades than the factors can hold.
    """
    walk = random_walk(circuit)
    second = 1.0 / walk.cell_map.wiring.resistance
    degree = walk.degree
    u = walk.solve(walk.to_goal.T @ np.ones(walk.to_goal.shape[0]))
    log_u = np.minimum(u.log, 0.0)
    ones = np.ones(len(degree))
    return Risk(
        success=_placed(walk, np.exp(log_u), 0.0, 1.0, 0.0),
        log_success=_placed(walk, log_u, -np.inf, 0.0, -np.inf),
        time=_placed(walk, walk.solve(second * ones).plain, 0.0, 0.0, np.inf),
        steps=_placed(walk, walk.solve(degree).plain, 0.0, 0.0, np.inf),
        time_given_success=_placed(walk, _ratio(walk.solve(_times(u, second * ones)), u), np.nan, 0.0, np.nan),
        steps_given_success=_placed(walk, _ratio(walk.solve(_times(u, degree)), u), np.nan, 0.0, np.nan),
    )


def _placed(
    walk: Walk, values: NDArray[np.float64], obstacle: float, goal: float, cut_off: float
) -> NDArray[np.float64]:
    """Values on cells; ``cut_off`` is that of free cells without a node, from where a walk never ends."""
    out = walk.per_cell(values, obstacle=obstacle, goal=goal)
    out[(walk.row < 0) & (walk.cell_map.space.cell == 0)] = cut_off
    return out


def _times(value: Scaled, by: NDArray[np.float64]) -> Scaled:
    return Scaled(value.hi * by, value.lo * by, value.exponent, value.noise)


def _ratio(numerator: Scaled, denominator: Scaled) -> NDArray[np.float64]:
    """Quotient of scaled numbers; NaN where the denominator is 0."""
    with np.errstate(invalid="ignore", divide="ignore"):
        quotient = numerator.hi / denominator.hi
    exponent = np.where(denominator.hi > 0, numerator.exponent - denominator.exponent, 0)
    return np.asarray(quotient * power(exponent), dtype=np.float64)
