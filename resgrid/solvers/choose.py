"""Which methods there are, and which one suits a laplacian."""

from __future__ import annotations

from typing import NamedTuple

from resgrid.budget import require_memory
from resgrid.errors import InputError
from resgrid.solvers import costs
from resgrid.solvers.connections import count_connections
from resgrid.solvers.decay import VOLUME, foresee_decades, h_transform_reaches
from resgrid.solvers.factors.direct import factor_direct
from resgrid.solvers.factors.factor import Factor
from resgrid.solvers.factors.multigrid import factor_multigrid
from resgrid.solvers.factors.reduced import ReducedFactor
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.star_mesh import may_shrink, shrink
from resgrid.solvers.supernodal import Symbolic, order_by_degree, order_by_distance
from resgrid.solvers.team import ALONE, Team

METHODS = ("direct", "multigrid")


class Choice(NamedTuple):
    """A method, and the order of a direct one, if it has been found; None where the first that suits is to be taken."""

    method: str
    order: Symbolic | None


_SMALL = 2000
"""Rows up to which the direct method is always quicker."""

_ROUGH, _ROUGH_VOLUME = 0.25, 0.5
"""Share of weak conductances above which cycles are too many; in a volume direct factors cost so much more."""

_LEAST_DECADES, _MOST_DECADES = 30.0, 250.0
"""By how many decades any maze's potential falls, and from how many on refinement takes too long."""

_FAIR_SHARE = 0.2
"""Share of the rows that elimination must take to be worth its way back and forth."""

_LONG = 20_000
"""Rows from which factors along corridors take half of the time of elimination."""

_REDUCING = 220.0
"""Peak memory of elimination, in bytes a row."""


def factor_laplacian(
    laplacian: Laplacian, method: str, *, reduce: bool = True, accuracy: str = "direction", team: Team = ALONE
) -> Factor:
    """Make a system ready to be solved, on a team's threads, unless it would not fit in memory.

    Nodes with at most two neighbours are eliminated first where that pays (`resgrid.solvers.star_mesh`), which it does
    not for directions along large mazes (`resgrid.solvers.supernodal`); the method then solves what is left.  Where
    nothing is left, the factor's name is ``"elimination"`` whatever was asked for.
    """
    if method != "auto" and method not in METHODS:
        raise InputError(f"method = {method!r} is unknown; it may be one of auto, {', '.join(METHODS)}")
    if team.size > 1 and laplacian.grid is not None:
        count_connections(laplacian, team)
    if reduce and may_shrink(laplacian):
        long = _along_corridors(laplacian, method, accuracy) if laplacian.size >= _LONG else None
        if long is not None:
            return _factor_whole(laplacian, long, accuracy, team)
        _require(_REDUCING * laplacian.size, laplacian, "elimination")
        mesh, core = shrink(laplacian)
        if core is None:
            return ReducedFactor(laplacian, mesh, None)
        if mesh.count >= _FAIR_SHARE * laplacian.size:
            inner = _factor_whole(core, _choose(core, method, accuracy), accuracy, team)
            return ReducedFactor(laplacian, mesh, inner)
    return _factor_whole(laplacian, _choose(laplacian, method, accuracy), accuracy, team)


def _along_corridors(laplacian: Laplacian, method: str, accuracy: str) -> Choice | None:
    """The direct method, where that takes less time than rows are eliminated and put back."""
    if accuracy != "direction" or method == "multigrid":
        return None
    name, order = _choose(laplacian, method, accuracy)
    order = order_by_distance(laplacian) if order is None and name == "direct" else order
    return None if order is None else Choice("direct", order)


def _factor_whole(laplacian: Laplacian, choice: Choice, accuracy: str, team: Team) -> Factor:
    if choice.method == "multigrid":
        _require(costs.estimate_memory(laplacian, "multigrid", accuracy), laplacian, "multigrid")
        return factor_multigrid(laplacian, accuracy, team)
    order = choice.order or order_by_distance(laplacian)
    _require(order.memory if order is not None else costs.wide_memory(laplacian), laplacian, "direct")
    return factor_direct(laplacian, order or order_by_degree(laplacian))


def _require(needed: float, laplacian: Laplacian, name: str) -> None:
    require_memory(
        needed,
        f"solving for {laplacian.size:,} unknowns by method = {name!r}",
        "use a coarser grid, or a machine with more memory",
    )


def choose_method(laplacian: Laplacian, accuracy: str = "direction") -> str:
    """Choose a method beforehand: the one that would take less time.

    Direct where the laplacian is small, or narrow; where conductances differ so wildly from node to node that no coarse
    grid stands for them; and between two rails where the potential falls by more decades than refinement wins back in
    that time, some twelve a pass.
    """
    return _choose(laplacian, "auto", accuracy).method


def _choose(laplacian: Laplacian, method: str, accuracy: str) -> Choice:
    """As `choose_method`, with the order of elimination that was found on the way."""
    if method != "auto":
        return Choice(method, None)
    found = count_connections(laplacian)
    if laplacian.size < _SMALL or not found.entries:
        return Choice("direct", None)
    if found.weak > (_ROUGH_VOLUME if found.entries > VOLUME * laplacian.size else _ROUGH):
        return Choice("direct", None)
    return _direct_in_time(laplacian) if accuracy == "direction" else Choice("multigrid", None)


def _direct_in_time(laplacian: Laplacian) -> Choice:
    """The direct method in the order by distance or by degree, if it takes less time than multigrid would."""
    decades = _LEAST_DECADES
    seconds = costs.multigrid_seconds(laplacian, decades)
    along = costs.corridor_seconds(laplacian, costs.corridor_width(laplacian))
    if laplacian.rails is not None and not along < seconds:
        decades = foresee_decades(laplacian).most
        seconds = costs.multigrid_seconds(laplacian, decades, scaled=h_transform_reaches(laplacian))
    if decades > _MOST_DECADES:
        return Choice("direct", None)
    if along < seconds:
        narrow = order_by_distance(laplacian)
        if narrow is not None and costs.direct_seconds(narrow) < seconds:
            return Choice("direct", narrow)
    most = costs.most_entries(laplacian, seconds)
    wide = order_by_degree(laplacian, most) if most > 0.0 else None
    if wide is not None and costs.direct_seconds(wide) + costs.SECONDS.order * laplacian.size < seconds:
        return Choice("direct", wide)
    return Choice("multigrid", None)
