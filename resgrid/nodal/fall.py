"""By how many decades a potential falls, foreseen from the graph alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from resgrid.nodal.system import NodalSystem

VOLUME = 4.2
"""Neighbours a node above which corridors have two dimensions across."""

WHOLE_STEPS = 0.7
"""Potentials fall over straight distances, ways on a grid are longer."""

_ROUNDS = 30
"""Rounds in which depths are found where rows are numbered as it happens, at most."""


def foresee_decades(system: NodalSystem) -> float:
    """Rough number of decades that a potential between two rails falls over the graph; 0 for other circuits.

    Along a corridor ``w`` cells wide it falls by ``exp(-pi sqrt(d) / w)`` a cell, in ``d = 1`` or 2 cross dimensions;
    behind walls of ``k`` times the resistance between cells by ``exp(-sqrt(2 d / (k w)))`` where that is less.  On 20
    spaces and maps the estimate was 0.9 to 1.7 times the true number, in volumes 2 times.
    """
    if system.rails is None or not system.connections.entries:
        return 0.0
    from resgrid.nodal.kernels import decay

    coupling, rails = system.coupling, system.rails
    cross = 2.0 if system.connections.entries > VOLUME * system.size else 1.0
    tied = rails.to_high[rails.to_high > 0]
    wall = max(float(coupling.data.mean() / tied.mean()) - 1.0, 0.0) if tied.size else 0.0
    factors = decay(
        coupling.indptr, coupling.indices, rails.to_low > 0, rails.to_high > 0, np.pi * np.sqrt(cross),
        wall / (2.0 * cross), 1 if system.netlist.layout is not None else _ROUNDS,
    )  # fmt: skip
    return float(WHOLE_STEPS * factors / np.log(10.0))
