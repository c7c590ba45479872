"""Colour scale of a field's picture: the potential, or the logarithm of a drop of many orders of magnitude."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.colors import Colormap
from numpy.typing import NDArray

from resgrid.core.cell import Cell
from resgrid.errors import InputError
from resgrid.planning.fields import Field
from resgrid.planning.lattice_fields import LatticeField
from resgrid.plot.style import height_map

Scale = Literal["auto", "linear", "log"]
_DECADES_WORTH_A_LOG = 2.0
"""Smallest number of orders of magnitude of the drop for which the scale "auto" is logarithmic."""
_LINES = 16
"""Approximate number of equipotentials on a logarithmic scale."""
_TAIL = 0.02
"""Fraction of values below the lower limit of the colour scale if the others span less than half of the whole range.

Otherwise the lower limit is the smallest value.
"""


@dataclass(frozen=True, eq=False)
class Shading:
    """Values of a field's picture with their colour scale.

    `values`: potential, or log10 of the drop ``u = 1 - phi``, shape of the space, NaN in cells without a value;
    `lower`, `upper`: limits of the colour scale; `levels` (n,): values of the equipotentials, strictly between the
    limits; `label`: label of the colour bar; `lines`: legend entry of the equipotentials; `is_log`: whether the values
    are logarithms of the drop; `wall`: value of obstacle cells, NaN if they have no value on this scale, None if
    obstacles are open; `edge`: boundary of each axis, ``"periodic"``, ``"obstacle"`` or ``"open"``.
    """

    values: NDArray[np.float64]
    lower: float
    upper: float
    levels: NDArray[np.float64]
    label: str
    lines: str
    is_log: bool
    wall: float | None
    edge: tuple[str, ...]

    @property
    def colours(self) -> Colormap:
        """Colour map of the values, in which the goal is yellow on a linear and on a logarithmic scale."""
        return height_map().reversed() if self.is_log else height_map()


def shading_of(field: Field | LatticeField, scale: Scale = "auto") -> Shading:
    """Return the values of a field's picture with their colour scale.

    `scale`: "linear" (potential), "log" (log10 of the drop) or "auto" ("log" if the drop spans two orders of magnitude
    or more, otherwise "linear").  Raises InputError for "log" if the field has no drop.
    """
    if field.log_drop is None:
        if scale == "log":
            kind = "a blend" if field.boundary == "blend" else f"drive = {field.wiring.drive!r}"
            raise InputError(
                f"scale = 'log' needs a drop from a high rail, and this field ({kind}) has none; use 'linear'"
            )
        return _linear(field)
    decades = np.where(np.isfinite(field.log_drop), field.log_drop / np.log(10.0), np.nan)
    shown = decades[at_nodes(field, field.space.goal_connected)]
    smallest = span(shown)[0] if np.isfinite(shown).any() else 0.0
    if scale == "linear" or (scale == "auto" and smallest > -_DECADES_WORTH_A_LOG):
        return _linear(field)
    return _logarithmic(field, decades, smallest)


def at_nodes(field: Field | LatticeField, value: NDArray[Any]) -> NDArray[Any]:
    """Return values of cells (shape of the space) at the nodes of a field: the cells, or the sites of a lattice."""
    return field.lattice.at_sites(value) if isinstance(field, LatticeField) else value


def no_drop(field: Field, shading: Shading) -> NDArray[np.bool_]:
    """Return the mask of goal-connected free cells at the high rail, where the drop is 0 and has no logarithm.

    The mask has the shape of the space; all its values are False if `shading` is a linear scale.
    """
    if field.log_drop is None or not shading.is_log:
        return np.zeros(field.space.shape, dtype=np.bool_)
    return np.asarray(field.space.goal_connected & np.isneginf(field.log_drop))


def _linear(field: Field | LatticeField) -> Shading:
    """Return a linear scale from 0 to 1 with the potential as values."""
    step = 0.05 if max(field.space.shape) > 24 else 0.1
    return Shading(
        values=field.potential,
        lower=0.0,
        upper=1.0,
        levels=np.linspace(0.0, 1.0, round(1 / step) + 1)[1:-1],
        label=_potential_label(field),
        lines=rf"equipotential, every {step:g}",
        is_log=False,
        wall=1.0 if field.boundary == "dirichlet" else None if field.boundary == "neumann" else np.nan,
        edge=field.edge,
    )


def _potential_label(field: Field | LatticeField) -> str:
    """Return the colour bar's label for the potential, by the boundary and the drive of the field."""
    if field.boundary == "blend":
        return rf"potential $\phi$ of the blend, $k$ = {field.k:g}"
    if field.wiring.drive == "uniform":
        return r"$\phi$: height above the goal rail, scaled to 1"
    high = "start" if field.wiring.drive == "start" else "obstacle rail" if field.wiring.is_open else "obstacles"
    return rf"potential $\phi$ (1: {high}, 0: goals)"


def _logarithmic(field: Field | LatticeField, decades: NDArray[np.float64], smallest: float) -> Shading:
    """Return a logarithmic scale with log10 of the drop as values, NaN in obstacle cells.

    `decades`: log10 of the drop, shape of the space; `smallest`: lowest value of `decades` that the colour scale must
    contain.
    """
    step = nice_step(-smallest / _LINES)
    lower = min(np.floor(smallest / step) * step, -step)
    rail = "start" if field.wiring.drive == "start" else "obstacle"
    return Shading(
        values=np.where(at_nodes(field, field.space.cell) == Cell.OBSTACLE, np.nan, decades),
        lower=lower,
        upper=0.0,
        levels=np.arange(round(lower / step) + 1, 0) * step,
        label=rf"$\log_{{10}}\,u$, drop from the {rail} rail",
        lines=f"equipotential, every {'' if step == 1 else f'{step:g} '}decade{'s' if step > 1 else ''}",
        is_log=True,
        wall=None if field.boundary == "neumann" else np.nan,
        edge=field.edge,
    )


def span(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return the limits of the colour scale: minimum and maximum of the finite values.

    The lower limit is the 2nd percentile instead if the values above it span less than half of the whole range.
    """
    finite = values[np.isfinite(values)]
    lowest, low, high = (float(value) for value in (finite.min(), np.quantile(finite, _TAIL), finite.max()))
    return (low if high - lowest > 2 * (high - low) > 0 else lowest), high


def nice_step(smallest: float) -> float:
    """Return the smallest number of the form 1, 2 or 5 times a power of ten that is at least `smallest`."""
    power = 10.0 ** np.floor(np.log10(smallest))
    return float(next(factor * power for factor in (1, 2, 5, 10) if factor * power >= smallest * (1 - 1e-9)))


def fill_open_walls(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return values in which cells without a value have the mean of their face neighbours with a value.

    Equipotentials then meet open obstacles at right angles. `values` (n, m): NaN in cells without a value; the result
    has the same shape, and is NaN in cells without such a neighbour.
    """
    padded = np.pad(values, 1, constant_values=np.nan)
    around = np.stack([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]])
    known = np.isfinite(around)
    count = known.sum(axis=0)
    mean = np.where(known, around, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(np.isfinite(values) | (count == 0), values, mean)


def add_border(values: NDArray[np.float64], edge: tuple[str, ...], wall: float | None) -> NDArray[np.float64]:
    """Return values padded by one layer of cells: periodic copies, copies of the outermost cells, or `wall`.

    `values` (n, m): value per cell; `edge`: boundary of each axis, "periodic", "obstacle" or "open"; `wall`: value of
    obstacle cells, None for open obstacles.  The result has the shape (n + 2, m + 2).
    """
    padded = values
    for axis, rule in enumerate(edge):
        width = [(1, 1) if number == axis else (0, 0) for number in range(values.ndim)]
        if rule == "periodic":
            padded = np.pad(padded, width, mode="wrap")
        elif rule == "open" or wall is None:
            padded = np.pad(padded, width, mode="edge")
        else:
            padded = np.pad(padded, width, constant_values=wall)
    return padded
