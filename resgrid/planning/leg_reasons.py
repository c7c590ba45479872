"""Messages about legs of a path that reach neither an intermediate place nor a goal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from resgrid.core.axis import Point
from resgrid.core.cell import Cell
from resgrid.core.regions import label_regions
from resgrid.core.space import ConfigurationSpace
from resgrid.planning.advice import Advisor
from resgrid.planning.failure_reasons import kind_of_place, nearest_start, undecided_reason
from resgrid.planning.trace import start_cell
from resgrid.scene.goals import Goal
from resgrid.scene.nearest_place import form_of, text_of_cell


def separation_reason(
    advisor: Advisor, space: ConfigurationSpace, final: NDArray[np.bool_], at: Point, start: Point, leg: int
) -> str:
    """Return the reason why a leg of a path with intermediate places does not exist, and remedies, as a message.

    The end of the leg is moved to the region of its begin.  Only at the first leg, the start is moved in its place if
    the goals lie on the other side, so that no later leg fails for this move.  `space`: space whose goals are the end
    of the leg; `final`: mask of the goal cells of the scene; `at`: begin of the leg, and `start`: begin of the first
    leg, in world coordinates; `leg`: number of legs before this one.
    """
    via = advisor.via
    begin = "the start" if leg == 0 else f"via[{leg - 1}]"
    end, targets = (f"via[{leg}]", via[leg : leg + 1]) if leg < len(via) else ("every goal", advisor.scene.goals)
    cell = start_cell(space, at)
    region = label_regions(space.cell != Cell.OBSTACLE, space.periodic)
    own, other = region == region[cell], np.isin(region, region[space.cell == Cell.GOAL])
    parts = [undecided_reason("no_path", space, cell, (begin, end)) or f"obstacles separate {begin} from {end}"]
    is_own, is_other = bool(final[own].any()), bool(final[other].any())
    if advisor.scene.robot.base is None and (leg > 0 or is_own or not is_other):
        parts.append(_nearest_end(space, own, targets, (begin, "a goal" if end == "every goal" else end)))
    if leg == 0 and not is_own:
        parts.append(nearest_start(space, cell, end))
    return "; ".join([*parts, *advisor.openings(start)])


def _nearest_end(
    space: ConfigurationSpace, own: NDArray[np.bool_], targets: tuple[Goal, ...], ends: tuple[str, str]
) -> str:
    """Return a phrase with the place nearest to the end of a leg that its begin can reach.

    The place is a cell if all ends are given as cells.  `space`: space whose goals are the end of the leg; `own`: mask
    of the cells that the begin can reach; `targets`: the end as goals; `ends`: names of begin and end.
    """
    cells = np.argwhere(own)
    turn = np.where(space.periodic, space.upper - space.lower, 0.0)
    tree = cKDTree(space.axis_centre(cells) - space.lower, boxsize=turn)
    apart, row = tree.query(space.axis_centre(np.argwhere(space.cell == Cell.GOAL)) - space.lower)
    nearest = tuple(cells[np.atleast_1d(row)[np.argmin(apart)]].tolist())
    is_cell = bool(targets) and all(form_of(target) == "cell" for target in targets)
    place = text_of_cell(nearest, space.axes, space.frame, "cell" if is_cell else "place")
    return f"the nearest {kind_of_place(space)} to {ends[1]} that {ends[0]} can reach is {place}"
