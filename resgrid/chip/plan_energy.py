"""Energy and time of one plan: settling of the grid, supply during the read-out, and conversions along the path.

In each cell of its path, the robot compares the voltages of the cell and of the free and goal neighbours.  The reading
of one voltage is a conversion; it costs
``FOM 2**bits`` joules, with the figure of merit ``FOM`` of the converter in joules per conversion step (Walden 1999,
IEEE J. Sel. Areas Commun. 17(4), 539-550).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.chip.adc_resolution import ADCResolution
from resgrid.chip.figures_of_merit import Figure, Result, formatted
from resgrid.chip.settling import Settling
from resgrid.chip.walk import neighbours_of
from resgrid.core.cell_map import CellMap
from resgrid.scene.chip import Readout

DIGITAL_ENERGY = 1.5e-6
"""Energy of one plan on 100 x 100 cells of a 40 nm digital processor, in joules ("A 1.5-uJ/Task Path-Planning Processor
for 2-D/3-D Autonomous Navigation of Microrobots", 2M gates, 3.65 mm^2, 0.9 V, 200 MHz).
"""
DIGITAL_TIME = 1e-3
"""Upper bound of the time, in seconds, of one plan on 100 x 100 cells of the digital processor of `DIGITAL_ENERGY`."""


@dataclass(frozen=True, eq=False, repr=False)
class PlanEnergy(Result):
    """Energy and time of one plan; returned by `resgrid.chip.Study.plan_energy`.

    Attributes
    ----------
    bits : int
        Resolution of the converter, in bits.
    conversions : int
        Number of conversions: for each cell of the path but the goal, one for the cell and one for each of its free or
        goal neighbours.  It is the mean over the starts of the scene that have a path to a goal, rounded up.  If there
        is no such start, it is the mean over all free cells with a path.
    conversion_energy : float or None
        Energy of one conversion in joules; None without a figure of merit of the converter.
    settling_energy, settle_time : float
        Energy in joules that the sources deliver until all voltages have settled (to half a step of the converter),
        and the time until then in seconds.
    power : float
        Power that all sources deliver to the settled grid, in watts.
    conversion_time : float or None
        Time of one conversion in seconds; None if it is not given, and the time of the read-out then counts as 0.
    figures : mapping of str to Figure
        Figures of merit by name.

    Examples
    --------
    >>> readout = rg.chip.Readout(bits=8, figure_of_merit="50f", conversion_time="100n")
    >>> chip = rg.Chip(capacitance="100f", readout=readout)
    >>> energy = rg.study(rg.read_scene("examples/scenes/lesson.toml"), chip).plan_energy()
    >>> energy.conversions, f"{energy.readout_energy:.3g} J", f"{energy.total:.3g} J"
    (52, '6.66e-10 J', '1.95e-09 J')
    """

    bits: int
    conversions: int
    conversion_energy: float | None
    settling_energy: float
    settle_time: float
    power: float
    conversion_time: float | None

    @property
    def readout_time(self) -> float:
        """Time of all conversions, one after the other, in seconds; 0 without a conversion time."""
        return self.conversions * (self.conversion_time or 0.0)

    @property
    def readout_energy(self) -> float:
        """Energy of all conversions, in joules; 0 if the energy of one conversion is unknown."""
        return self.conversions * (self.conversion_energy or 0.0)

    @property
    def supply_energy(self) -> float:
        """Energy that the settled grid dissipates during the conversions, in joules."""
        return self.power * self.readout_time

    @property
    def total(self) -> float:
        """Energy of the plan in joules: settling, conversions, and supply during the conversions."""
        return self.settling_energy + self.supply_energy + self.readout_energy

    @property
    def time(self) -> float:
        """Time of the plan in seconds: settling time plus time of all conversions."""
        return self.settle_time + self.readout_time

    @property
    def figures(self) -> Mapping[str, Figure]:
        """Figures of merit by name: energies and times of the plan and of its parts, and number of conversions.

        ``plan_energy`` and its parts ``settling_energy``, ``supply_energy`` (power of the settled grid during the
        read-out) and ``readout_energy`` (all conversions), in joules; ``conversions``: their number; ``plan_time`` and
        its part ``readout_time``, in seconds.
        """
        missing = "" if self.conversion_energy is not None else "; 0 without chip.readout.figure_of_merit"
        untimed = "" if self.conversion_time is not None else "; 0 without chip.readout.conversion_time"
        return {
            "plan_energy": Figure(self.total, "J", "settling, supply during the read-out, and conversions"),
            "settling_energy": Figure(self.settling_energy, "J", "energy of all sources until every node has settled"),
            "supply_energy": Figure(self.supply_energy, "J", f"power of the settled grid times read-out time{untimed}"),
            "readout_energy": Figure(
                self.readout_energy, "J", f"conversions times figure of merit times 2**{self.bits}{missing}"
            ),
            "conversions": Figure(self.conversions, "", "readings of each cell of the path and of its free neighbours"),
            "plan_time": Figure(self.time, "s", "settling time plus read-out time"),
            "readout_time": Figure(self.readout_time, "s", f"conversions one after the other{untimed}"),
        }


def analyse_plan_energy(
    settling: Settling, resolution: ADCResolution, readout: Readout, starts: Sequence[tuple[int, ...]]
) -> PlanEnergy:
    """Return the energy and time of one plan, as a PlanEnergy.

    `settling`: settling of the chip, which gives energy, time and power of the grid; `resolution`: ADCResolution of the
    chip, which gives the robot's next cell from every cell; `readout`: description of the converter; `starts`: indices
    of the start cells.  The number of conversions is the mean over the starts with a path to a goal; without such a
    start, over all free cells with a path.
    """
    counts = readings_from(resolution, settling.netlist.cells)
    space = resolution.space
    begins = [start for start in starts if space.goal_connected[start] and np.isfinite(counts[start])]
    chosen = np.array([counts[start] for start in begins]) if begins else counts[np.isfinite(counts) & (counts > 0)]
    conversions = int(np.ceil(chosen.mean())) if chosen.size else 0
    each = None if readout.figure_of_merit is None else readout.figure_of_merit * 2.0**settling.bits
    return PlanEnergy(
        settling.bits, conversions, each, settling.energy, settling.settle_time, settling.power, readout.conversion_time
    )


def readings_from(resolution: ADCResolution, cells: CellMap) -> NDArray[np.float64]:
    """Return the number of voltage readings on the ideal path from every cell to a goal, in the shape of the space.

    The number is infinite for a cell without a path, and 0 for a goal cell. The ideal path steps to the neighbour of
    lowest voltage. Each cell before the goal needs one reading of its own and one for each free or goal neighbour.
    `resolution`: gives the next cell of every cell; `cells`: map of the chip's cells.
    """
    neighbours = neighbours_of(cells)
    readings = 1.0 + (neighbours.around >= 0).sum(axis=1)
    following = resolution.following.ravel()
    total = np.where(neighbours.goal, 0.0, np.where(following >= 0, readings, np.inf))
    step = np.where(neighbours.goal | (following < 0), np.arange(len(following)), following)
    while not np.array_equal(step, step[step]):  # doubling: each pass adds a path twice as long
        total = total + np.where(step == np.arange(len(step)), 0.0, total[step])
        step = step[step]
    return np.asarray(total + np.where(neighbours.goal[step], 0.0, np.inf)).reshape(resolution.space.shape)


def energy_sentences(result: PlanEnergy, readout: Readout, shape: Sequence[int]) -> list[str]:
    """Return sentences on the energy of a plan, compared with a published digital processor.

    `result`: energy of the plan; `readout`: description of the converter; `shape`: number of cells along each axis.
    """
    parts = (
        f"{formatted(result.settling_energy, 'J')} until the grid has settled, {formatted(result.supply_energy, 'J')} "
        f"of supply during {result.conversions} conversions of {result.bits} bits, and "
        f"{formatted(result.readout_energy, 'J')} of conversions"
    )
    text = [f"A plan takes {formatted(result.total, 'J')} and {formatted(result.time, 's')}: {parts}."]
    lacking = [key for key in ("figure_of_merit", "conversion_time") if getattr(readout, key) is None]
    if lacking:
        keys = " and ".join(f"`chip.readout.{key}`" for key in lacking)
        text.append(f"The cost of the read-out is incomplete; give {keys}.")
    text.append(
        f"For comparison: a digital processor in 40 nm CMOS plans on 100 x 100 cells for "
        f"{formatted(DIGITAL_ENERGY, 'J')} in less than {formatted(DIGITAL_TIME, 's')} (1.5-uJ/Task Path-Planning "
        f"Processor); this grid has {' x '.join(map(str, shape))} cells."
    )
    return text
