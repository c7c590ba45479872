"""Basins: which goal each cell belongs to, by its streamline or by a random walk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.budget import require_memory
from resgrid.netlist import Netlist
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.planning.field import Field
from resgrid.planning.trace import follow_many
from resgrid.planning.walk import Walk, random_walk
from resgrid.space import Cell

_BATCH = 1 << 18


@dataclass(frozen=True, eq=False)
class Absorption:
    """Where a random walk from the centre of every cell ends.

    Attributes
    ----------
    probability : ndarray of float64, shape (goals, ...), the rest of the space
        Probability of being absorbed at each goal region, before any obstacle; 0 where it underflows.
    log_probability : ndarray of float64, same shape
        Its natural logarithm; -inf where that goal cannot be met.
    """

    probability: NDArray[np.float64]
    log_probability: NDArray[np.float64]

    def __post_init__(self) -> None:
        self.probability.flags.writeable = False
        self.log_probability.flags.writeable = False

    @property
    def likeliest(self) -> NDArray[np.int32]:
        """The goal region each cell's walk most probably ends at, -1 for none; shape of the space, int32.

        The lower number where two are equally likely.
        """
        best = np.argmax(self.log_probability, axis=0).astype(np.int32)
        return np.where(np.isneginf(self.log_probability.max(axis=0)), np.int32(-1), best)


def basins(field: Field) -> NDArray[np.int32]:
    """Which goal the streamline from the centre of every cell reaches.

    Only cells from which the current leads to several goals are traced.

    Parameters
    ----------
    field : Field

    Returns
    -------
    ndarray of int32, shape of the space
        Number of the goal region; -1 on obstacles, and where no streamline reaches a goal.

    Raises
    ------
    AccuracyError
        If a streamline does not end, which a direction-safe field rules out.
    """
    from resgrid.planning.kernels import MIXED, only_goal

    space = field.space
    flat_goal = only_goal(field.flow, space.goal_region.ravel().astype(np.int64), space.periodic)
    goal = np.where(space.cell == Cell.OBSTACLE, -1, flat_goal.reshape(space.shape)).astype(np.int32)
    cells = np.argwhere(goal == MIXED)
    for first in range(0, len(cells), _BATCH):
        some = cells[first : first + _BATCH]
        goal[tuple(some.T)] = follow_many(field, space.axis_centre(some)).goal
    return goal


def absorption(circuit: Netlist | OperatingPoint | Walk) -> Absorption:
    """Find the probability to be absorbed at each goal: one solve a goal, one factorisation for all.

    Summed over the goals it is `Risk.success`.

    Parameters
    ----------
    circuit : Netlist, OperatingPoint or Walk
        As `random_walk` takes it.

    Returns
    -------
    Absorption

    Raises
    ------
    InputError
        As `random_walk`.
    AccuracyError
        If the conductances differ by more decades than the factors can hold.
    BudgetError
        If the answer would not fit in memory.
    """
    walk = random_walk(circuit)
    space = walk.cell_map.space
    require_memory(
        16.0 * space.goal_count * space.cell.size,
        f"a probability for each of {space.goal_count:,} goals in every cell",
        "merge goals, or use a coarser grid",
    )
    log_probability = np.full((space.goal_count, *space.shape), -np.inf)
    for goal in range(space.goal_count):
        contact = walk.to_goal[[goal]].toarray().ravel()
        if contact.any():
            at = walk.solve(contact)
            values = np.minimum(at.log, 0.0)
            log_probability[goal] = walk.per_cell(values, obstacle=-np.inf, goal=-np.inf)
        log_probability[goal][space.goal_region == goal] = 0.0
    log_probability[:, (walk.row < 0) & (space.cell == Cell.FREE)] = -np.inf
    return Absorption(np.exp(log_probability), log_probability)
