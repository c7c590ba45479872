"""Effects of fabrication: a gradient over the die, mismatch, open and shorted resistors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Len, Lt
from numpy.typing import NDArray

from resgrid.chip.effects.base import Effect, without_stranded_currents
from resgrid.core import random_sites
from resgrid.core.cell_map import CellMap
from resgrid.core.netlist import Netlist, add_elements, crossed_by, select_elements
from resgrid.core.random_sites import DEFECTS, Seed, generator, mismatch_factors
from resgrid.core.regions import face_counts, face_shape
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.scene.chip import Chip, Density, Metres, Ohms, Place
from resgrid.scene.quantities import Listed, Quantity


@dataclass(frozen=True)
class ResistanceGradient(Effect):
    """Let the resistances of the grid change linearly across the die; the centre keeps the nominal value.

    `shares` (axes,): change of the resistance from the lower to the upper end of each axis, as a fraction of the
    nominal resistance; 0 for further axes of the space.
    """

    KEYS = {"shares": "gradient"}

    shares: Annotated[tuple[Annotated[float, Quantity("", is_fraction=True)], ...], Len(1, 4), Listed()]

    def __post_init__(self) -> None:
        super().__post_init__()
        if sum(abs(share) for share in self.shares) >= 2:
            raise InputError(
                f"gradient = {list(self.shares)} makes a resistance negative in a corner of the die; the magnitudes "
                "must add up to less than 2"
            )

    def apply(self, netlist: Netlist) -> Netlist:
        ndim = netlist.cells.space.ndim
        if len(self.shares) > ndim:
            raise InputError(f"gradient has {len(self.shares)} entries, but the space has {ndim} axes")
        share = np.zeros(ndim)
        share[: len(self.shares)] = self.shares
        return random_sites.scale_resistances(netlist, 1 + (_site_centres(netlist.cells) - 0.5) @ share)


def _site_centres(cells: CellMap) -> NDArray[np.float64]:
    """Return the centres of all cell faces, shape (sites, axes), as fractions of the length of the die along each axis.

    The lower end of the die is 0, the upper end 1.  Faces are in the order of their numbers in `cells`: axis by axis,
    in C order.  In a circuit with a leak, the centres of all cells follow, in C order.
    """
    shape = cells.space.shape
    parts = []
    for axis in range(len(shape) + bool(cells.wiring.leak)):
        ticks = [(np.arange(n) + 0.5) / n for n in shape]
        if axis < len(shape):
            ticks[axis] = np.arange(shape[axis] + 1) / shape[axis]
        parts.append(np.stack([part.ravel() for part in np.meshgrid(*ticks, indexing="ij")], axis=1))
    return np.concatenate(parts)


@dataclass(frozen=True)
class Mismatch(Effect):
    """Let every resistance of the grid deviate from its mean, independently and log-normally.

    Either `sigma` or `pelgrom` is given.  `sigma`: standard deviation of a resistance as a fraction of its mean.
    `pelgrom`: coefficient ``A_R`` in % µm, for the deviation ``A_R / sqrt(W L)`` (Pelgrom, Duinmaijer & Welbers 1989),
    with the `width` ``W`` of a resistor in metres, and either the `length` ``L`` in metres or the `sheet_resistance`
    ``Rs`` in ohms per square, for ``L = R W / Rs`` with the resistance ``R``.  `seed`: seed of the chip.
    """

    sigma: Annotated[float, Ge(0), Lt(1), Quantity("", is_fraction=True)] | None = None
    pelgrom: Annotated[float, Ge(0), Quantity("% µm")] | None = None
    width: Metres | None = None
    length: Metres | None = None
    sheet_resistance: Ohms | None = None
    seed: Seed = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.sigma is None) == (self.pelgrom is None):
            raise InputError("mismatch needs either sigma or pelgrom")
        if self.pelgrom is not None and (
            self.width is None or (self.length is None) == (self.sheet_resistance is None)
        ):
            raise InputError("pelgrom needs width and either length or sheet_resistance")

    @classmethod
    def of(cls, chip: Chip, seed: Seed) -> Mismatch | None:
        """Return the mismatch of a chip description; None if its `mismatch` and `pelgrom` are both unset or 0.

        `seed`: seed of the chip.
        """
        if chip.mismatch:
            return cls(sigma=chip.mismatch, seed=seed)
        return cls(None, chip.pelgrom, chip.width, chip.length, chip.sheet_resistance, seed) if chip.pelgrom else None

    def deviation(self, netlist: Netlist) -> float | NDArray[np.float64]:
        """Return the standard deviation of the resistance at every resistor site, as a fraction of its mean.

        Sites are the cell faces (axis by axis, in C order) and, with a leak, the cells after them; in a netlist without
        cells, the resistors, linear ones first.  The shape is () if all sites have the same deviation, else (sites,).
        """
        if self.sigma is not None:
            return self.sigma
        assert self.pelgrom is not None
        assert self.width is not None
        if self.length is not None:
            return float(1e-8 * self.pelgrom / np.sqrt(self.width * self.length))
        assert self.sheet_resistance is not None
        linear, nonlinear = random_sites.resistor_sites(netlist)
        own = linear >= 0
        resistance = np.full(random_sites.site_count(netlist), np.inf)
        resistance[linear[own]] = 1 / netlist.conductance[own]
        resistance[nonlinear] = netlist.nonlinear_voltage / netlist.nonlinear_current
        metres = resistance * self.width / self.sheet_resistance
        return np.asarray(1e-8 * self.pelgrom / np.sqrt(self.width * metres))

    def factors(self, netlist: Netlist) -> NDArray[np.float64]:
        """Return random factors of the resistances at all resistor sites, with mean 1, shape (sites,).

        Sites are the cell faces (axis by axis, in C order) and, with a leak, the cells after them; in a netlist without
        cells, the resistors, linear ones first.
        """
        return mismatch_factors(random_sites.site_count(netlist), self.deviation(netlist), self.seed)

    def apply(self, netlist: Netlist) -> Netlist:
        return random_sites.scale_resistances(netlist, self.factors(netlist))


@dataclass(frozen=True)
class Faults(Effect):
    """Open some resistors of the grid, and short others.

    A resistor that is open (or shorted) at one density is also open (or shorted) at every higher density with the same
    seed.  A current source into nodes that are isolated by open resistors is removed, because its current has no return
    path.

    `open_density, short_density`: fractions of the grid's resistors, with a sum of at most 1; `short_resistance`:
    resistance of a short, in ohms; `seed`: seed of the chip; `open_at`: further open resistors, each given by the
    indices of a cell and the number of an axis: the resistor crosses the cell's lower face along this axis.  A face
    without a resistor, such as the contact of an open obstacle, is allowed.
    """

    open_density: Density = 0.0
    short_density: Density = 0.0
    short_resistance: Ohms = 1.0
    seed: Seed = 0
    open_at: tuple[Place, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.open_density + self.short_density > 1:
            raise InputError(
                f"open_density = {self.open_density:g} and short_density = {self.short_density:g} must be fractions "
                "of the resistors with a sum of at most 1"
            )

    @classmethod
    def of(cls, chip: Chip, seed: Seed) -> Faults | None:
        """Return the faults of a chip description; None if it has no open and no shorted resistors.

        `seed`: seed of the chip.
        """
        defects = chip.defects
        if not (defects.open_density or defects.short_density or defects.open_at):
            return None
        return cls(**vars(defects), seed=seed)

    def places(self, netlist: Netlist) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return two masks, shape (sites,), of the open and of the shorted resistors of a netlist.

        Sites are the cell faces (axis by axis, in C order) and, with a leak, the cells after them; in a netlist without
        cells, the resistors, linear ones first.
        """
        draw = generator(self.seed, DEFECTS).random(random_sites.site_count(netlist))
        opened = draw < self.open_density
        opened[[self._face(netlist.cells.space, place) for place in self.open_at]] = True
        return opened, ~opened & (draw >= 1 - self.short_density)

    def _face(self, space: ConfigurationSpace, place: tuple[int, ...]) -> int:
        """Return the number of a cell face; raise InputError if the space has no such face.

        Faces are numbered from 0, axis by axis; along an axis of n cells there are n + 1 faces, in C order of the cells
        (see `CellMap.resistor_face`). `space`: space of the chip; `place`: indices of a cell, then the number of an
        axis: the lower face of the cell along this axis is meant. An index equal to the number of cells means the upper
        face of the last cell; on a periodic axis this is the lower face of cell 0.
        """
        *cell, axis = place
        if len(cell) == space.ndim > axis:
            if space.periodic[axis]:
                cell[axis] %= space.shape[axis]
            shape = face_shape(space.shape, axis)
            if all(part < size for part, size in zip(cell, shape, strict=True)):
                return sum(face_counts(space.shape)[:axis]) + int(np.ravel_multi_index(cell, shape))
        raise InputError(f"defects.open_at: {list(place)} is no cell of {space.shape} and an axis of it")

    def apply(self, netlist: Netlist) -> Netlist:
        opened, shorted = (np.append(mask, False) for mask in self.places(netlist))
        linear, nonlinear = random_sites.resistor_sites(netlist)
        short = shorted[linear]
        faulty = netlist.replace(
            conductance=np.where(short, 1 / self.short_resistance, netlist.conductance),
            tc1=None if netlist.tc1 is None else np.where(short, 0.0, netlist.tc1),
            tc2=None if netlist.tc2 is None else np.where(short, 0.0, netlist.tc2),
        )
        bridged = shorted[nonlinear]
        faulty = select_elements(faulty, "resistor", ~opened[linear])
        faulty = select_elements(faulty, "nonlinear resistor", ~(opened[nonlinear] | bridged))
        if bridged.any():
            crossed = crossed_by(netlist, "nonlinear resistor", bridged)
            ends = netlist.nonlinear_nodes[bridged]
            faulty = add_elements(faulty, "resistor", ends, 1 / self.short_resistance, **crossed)
        return without_stranded_currents(faulty)
