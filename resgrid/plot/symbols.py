"""Circuit symbols as polylines, and numbers with engineering prefixes."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from matplotlib.ticker import EngFormatter
from numpy.typing import ArrayLike, NDArray

INK = "#202020"
_PEAKS = 6
_RADIUS = 0.2


def zigzag(start: NDArray[np.float64], end: NDArray[np.float64], body: float = 0.4) -> NDArray[np.float64]:
    """Resistor symbols: a straight lead, six half waves, a straight lead.

    Shapes: `start, end` (m, 2); returns (m, 10, 2).
    """
    along = end - start
    length = np.linalg.norm(along, axis=1, keepdims=True)
    unit = np.divide(along, length, out=np.zeros_like(along), where=length > 0)
    across = unit[:, ::-1] * (-1.0, 1.0)
    reach = np.minimum(body, 0.6 * length)
    lead = (length - reach) / 2
    peak = (np.arange(_PEAKS) + 0.5) / _PEAKS
    height = np.where(np.arange(_PEAKS) % 2, -0.2, 0.2)
    distance = np.concatenate([0 * lead, lead, lead + reach * peak, length - lead, length], axis=1)
    offset = np.concatenate([0 * lead, 0 * lead, reach * height, 0 * lead, 0 * lead], axis=1)
    return np.asarray(start[:, None] + distance[..., None] * unit[:, None] + offset[..., None] * across[:, None])


def draw_ground(axes: Axes, at: ArrayLike, size: float = 0.16) -> None:
    """Draw the ground symbol, three bars, below a point."""
    x, y = np.asarray(at, dtype=np.float64)
    for rank in range(3):
        half, depth = size * (1 - rank / 3), 0.06 * rank
        axes.plot([x - half, x + half], [y - depth, y - depth], color=INK, linewidth=1.0, zorder=3)


def draw_supply(axes: Axes, top: ArrayLike, bottom: ArrayLike) -> None:
    """Draw a voltage source, plus on the side of ``top``."""
    first, last = np.asarray(top, dtype=np.float64), np.asarray(bottom, dtype=np.float64)
    middle, unit = _draw_round(axes, first, last)
    for sign, where in (("+", middle - 0.45 * _RADIUS * unit), ("\N{MINUS SIGN}", middle + 0.45 * _RADIUS * unit)):
        axes.text(float(where[0]), float(where[1]), sign, ha="center", va="center", fontsize=7, color=INK, zorder=5)


def draw_current_source(axes: Axes, start: ArrayLike, end: ArrayLike) -> None:
    """Draw a current source whose arrow points from ``start`` to ``end``."""
    first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    middle, unit = _draw_round(axes, first, last)
    arrow = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.0, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 7}
    tail, head = middle - 0.7 * _RADIUS * unit, middle + 0.7 * _RADIUS * unit
    axes.annotate("", (float(head[0]), float(head[1])), (float(tail[0]), float(tail[1])), arrowprops=arrow, zorder=5)


def draw_capacitor(axes: Axes, start: ArrayLike, end: ArrayLike) -> None:
    """Draw a capacitor between two points."""
    first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    unit = (last - first) / np.linalg.norm(last - first)
    across = np.array([-unit[1], unit[0]])
    middle = (first + last) / 2
    for lead, plate in ((first, middle - 0.05 * unit), (last, middle + 0.05 * unit)):
        axes.plot(*np.stack([lead, plate], axis=1), color=INK, linewidth=0.9, zorder=2)
        ends = np.stack([plate - 0.15 * across, plate + 0.15 * across], axis=1)
        axes.plot(*ends, color=INK, linewidth=1.6, zorder=3)


def engineering(value: float, unit: str) -> str:
    """Format a value to three digits with an engineering prefix, e.g. ``"38.1 µA"``."""
    return EngFormatter(unit)(float(f"{value:.3g}"))


def _draw_round(
    axes: Axes, first: NDArray[np.float64], last: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    middle, unit = (first + last) / 2, (last - first) / np.linalg.norm(last - first)
    axes.plot(*np.stack([first, last], axis=1), color=INK, linewidth=0.9, zorder=2)
    centre = (float(middle[0]), float(middle[1]))
    axes.add_patch(Circle(centre, _RADIUS, facecolor="white", edgecolor=INK, linewidth=0.9, zorder=4))
    return middle, unit
