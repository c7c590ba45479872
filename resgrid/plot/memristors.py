"""Pictures of circuits with memristors: resistances between the cells of a grid, and states over time."""

from __future__ import annotations

from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.ticker import EngFormatter
from numpy.typing import NDArray

from resgrid.circuit.transients.memristive import MemristiveTransient
from resgrid.core.cell_map import CellMap
from resgrid.errors import InputError
from resgrid.plot.circuits import resistor_ends
from resgrid.plot.figures import axes_or_new
from resgrid.plot.panels import draw_space
from resgrid.plot.style import PATHS, add_colour_bar, dress, refresh_legend, strength_map

_MOST_CURVES = 400
"""Largest number of memristors whose states are drawn over time."""


def draw_memristive(
    result: MemristiveTransient,
    ax: Axes | None = None,
    *,
    quantity: Literal["auto", "map", "states"] = "auto",
    at: int = -1,
) -> Axes:
    """Draw the resistances of the links of a grid at an output time, or the states over time; return the axes.

    A link holds the parallel memristors between two neighbour cells; a state lies between 0 (largest resistance) and 1
    (smallest resistance).  `ax`: axes to draw on, by default those of a new figure; `quantity`: "map" of the links,
    "states", or "auto" for a map of a grid with two axes and for states otherwise; `at`: index of the output time of a
    map, negative from the end.  Raise InputError for a map of a circuit without a grid of two axes, for an index that
    does not exist, and for an index with a picture of states.
    """
    cells = result.circuit.netlist.cell_map
    is_grid = cells is not None and cells.space.ndim == 2
    if quantity == "states" or (quantity == "auto" and not is_grid):
        if at != -1:
            raise InputError(f"at = {at} chooses the output time of a map; states are drawn over all times, so omit at")
        return _draw_states(result, axes_or_new(ax, 0.7))
    if cells is None or not is_grid:
        raise InputError("quantity = 'map' needs a netlist compiled from a space with two axes; use 'states'")
    if not -len(result.times) <= at < len(result.times):
        raise InputError(f"at = {at} is not the index of one of the {len(result.times)} output times")
    return _draw_map(result, cells, at, ax)


def _draw_map(result: MemristiveTransient, cells: CellMap, at: int, ax: Axes | None) -> Axes:
    """Draw the resistance, in ohms, of every link (parallel memristors) between two cells; return the axes.

    `cells`: cell map of the netlist; `at`: index of the output time; `ax`: axes to draw on, None for a new figure.
    """
    axes = draw_space(cells.space, ax)
    assert isinstance(axes, Axes)
    number, lower, upper, _ = resistor_ends(cells)
    siemens = np.zeros(len(cells.resistor_face))
    siemens[result.circuit.memristors] = 1 / result.resistance[at]
    memristive = siemens[number] > 0
    number, ends = number[memristive], np.stack([lower, upper], axis=1)[memristive]
    links, first, which = np.unique(cells.resistor_face[number], return_index=True, return_inverse=True)
    ohms = 1 / np.bincount(which.ravel(), siemens[number], len(links))
    segments = cells.space.to_world(cells.space.lower + cells.space.spacing * ends[first])
    lines = LineCollection(
        list(segments), array=ohms, cmap=strength_map().reversed(), norm=LogNorm(*_range(result)), linewidths=2.2
    )
    axes.add_collection(lines)
    add_colour_bar(lines, axes, "resistance of a link (ohm)")
    if cells.wiring.start is not None:
        x, y = cells.space.centre(cells.wiring.start)
        axes.scatter(x, y, s=34, facecolor="white", edgecolor="black", linewidth=0.9, zorder=6, label="start")
        refresh_legend(axes)
    axes.set_title(f"after {EngFormatter('s', places=1)(result.times[at])}", fontsize="medium")
    return axes


def _range(result: MemristiveTransient) -> tuple[float, float]:
    """Return the smallest and the largest resistance in ohms that a link of one or two parallel memristors can have."""
    law = result.circuit.law
    return law.on_resistance / 2, law.off_resistance


def _draw_states(result: MemristiveTransient, axes: Axes) -> Axes:
    """Draw the states of the memristors, from 0 (largest resistance) to 1 (smallest), over time; return the axes.

    Of more than 400 memristors, those with the largest change from the first to the last time are drawn.
    """
    change = np.abs(result.state[-1] - result.state[0])
    shown: NDArray[np.int64] = np.argsort(change)[-_MOST_CURVES:]
    for memristor in shown.tolist():
        axes.plot(result.times, result.state[:, memristor], color=PATHS[3], alpha=0.5, linewidth=0.8)
    axes.set(xlabel="time", ylabel="state (1: conducting)", ylim=(-0.03, 1.03))
    axes.xaxis.set_major_formatter(EngFormatter("s"))
    dress(axes)
    return axes
