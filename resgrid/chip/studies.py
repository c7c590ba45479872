"""One chip under study: its circuit, made once, and what the analyses say of it."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterable
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.arguments import is_whole
from resgrid.chip.build import build_chip, conductance_samples, ideal_netlist
from resgrid.chip.criticality import Criticality, analyse_criticality
from resgrid.chip.decks import noise_band, write_decks
from resgrid.chip.exploration import Exploration, Sweep, explore_yield
from resgrid.chip.figures import html_table
from resgrid.chip.noise import ROOM, Noise, analyse_noise, noise_covariance, noise_density
from resgrid.chip.parameters import described
from resgrid.chip.power import Power, analyse_power
from resgrid.chip.precision import Precision, analyse_precision
from resgrid.chip.sensitivity import Sensitivity, analyse_sensitivity, voltage_sensitivity
from resgrid.chip.settling import Settling, analyse_settling
from resgrid.chip.trials import die_temperature
from resgrid.chip.yields import Progress, Yield, analyse_yield
from resgrid.errors import InputError
from resgrid.frozen import picture_of
from resgrid.netlist import Netlist
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.nodal.secant import small_signal
from resgrid.nodal.solve import solve
from resgrid.planning.road import problem_of
from resgrid.planning.trace import start_cell
from resgrid.scene import Scene
from resgrid.scene.chip import Chip, Readout
from resgrid.space import ConfigurationSpace
from resgrid.spice.write.files import WrittenDeck


@dataclass(frozen=True, eq=False, repr=False)
class Study:
    """One chip, and every question that can be asked about it; made by `study`.

    Attributes
    ----------
    ideal : Netlist
        The circuit before the chip's effects, a uniform drive scaled to the supply.
    chip : Chip or None
        What its maker says about it; None for a netlist or an operating point as it is.
    scene : Scene or None
        Where it comes from.
    netlist : Netlist
        The chip's circuit.
    op : OperatingPoint
        The circuit's operating point, solved when it is first asked for.
    linear : Netlist
        The circuit, or its small signals around the operating point where it is nonlinear.
    """

    ideal: Netlist
    chip: Chip | None = None
    scene: Scene | None = None
    solved: OperatingPoint | None = None

    @cached_property
    def netlist(self) -> Netlist:
        """The chip's circuit."""
        return self.ideal if self.chip is None else build_chip(self.ideal, self.chip)

    @cached_property
    def op(self) -> OperatingPoint:
        """The circuit's operating point."""
        return solve(self.netlist) if self.solved is None else self.solved

    @cached_property
    def linear(self) -> Netlist:
        """The circuit, or its small signals around the operating point where it is nonlinear."""
        return small_signal(self.op) if self.netlist.nonlinear_nodes.size else self.netlist

    @property
    def title(self) -> str:
        """The scene's, for headings."""
        return (self.scene and (self.scene.title or Path(self.scene.source or "").stem)) or "chip"

    @property
    def bits(self) -> int:
        """Of the converter; 10 where it is ideal, for comparison."""
        return self._readout.bits or 10

    @property
    def span(self) -> float | None:
        """Range of the converter, in volts; None where no description says it."""
        if self.chip is None:
            return None
        low, high = self._readout.range or (0.0, abs(self.chip.supply))
        return high - low

    @property
    def parameters(self) -> list[tuple[str, str, str]]:
        """What is said of the chip, key by key, without what is ideal: key, value, meaning."""
        cells = self.ideal.cells
        return described(self.chip or Chip(), cells.space.shape, cells.wiring.boundary)

    @property
    def _readout(self) -> Readout:
        return Readout() if self.chip is None else self.chip.readout

    def settling(
        self,
        *,
        bits: int | None = None,
        span: float | None = None,
        initial: OperatingPoint | ArrayLike | None = None,
        modes: int = 6,
        method: str = "auto",
    ) -> Settling:
        """How long the chip takes to settle after its supplies are switched on, and what a plan costs.

        `bits`: how well, 1 to 24, by default the converter's, or 10; `span`: range of the converter, in volts, without
        a chip's description the largest difference of final voltages; `initial`: voltages of all nodes, or the
        operating point, before the switch (as in `resgrid.transient`; by default all capacitors are discharged);
        `modes`: how many slow time constants to find; `method`: as in `resgrid.solve`.

        Raises
        ------
        InputError
            If there is no capacitance, or an argument is not admissible.
        CircuitError
            If a part of the circuit never settles.
        AccuracyError
            If the conductances span so many decades that rounding decides the slowest time constant, if an iteration
            does not converge, or if a figure is beyond what doubles hold.
        """
        if bits is None and span is None and initial is None and is_whole(modes) and (modes, method) == (6, "auto"):
            return self._settling
        return analyse_settling(
            self.linear,
            bits=min(self.bits, 24) if bits is None else bits,
            span=self.span if span is None else span,
            initial=initial,
            modes=modes,
            method=method,
        )

    @cached_property
    def _settling(self) -> Settling:
        return analyse_settling(self.linear, bits=min(self.bits, 24), span=self.span)

    def noise(
        self,
        *,
        band: tuple[float, float] | None = None,
        temperature: float | None = None,
        method: str = "auto",
        samples: int = 64,
        seed: int = 0,
    ) -> Noise:
        """Thermal noise of every node's voltage.

        `band`: limits of the integral, in hertz (a read-out of noise bandwidth ``B`` takes ``(0, B)``); by default that
        of the read-out, else all that capacitances let through; none without a chip's description; `temperature`: in
        kelvin, by default the die's; `method`: "exact", the diagonal of the inverse from the factors, or "estimate",
        from products with so many `samples` of random signs of a `seed`, for grids of three or more dimensions whose
        factors are large.

        Raises
        ------
        CircuitError
            If a node is tied to no rail by resistors.
        AccuracyError
            If conductances span so many decades that rounding may be more than 1e-3 of a density within the band, or a
            tenth of what is estimated.
        """
        return analyse_noise(
            self.linear,
            band=self._band if band is None else band,
            temperature=self._temperature if temperature is None else temperature,
            method=method,
            samples=samples,
            seed=seed,
        )

    @property
    def _temperature(self) -> float:
        return ROOM if self.chip is None else die_temperature(self.chip)

    @cached_property
    def _band(self) -> tuple[float, float] | None:
        if self._readout.noise_bandwidth is not None:
            return 0.0, self._readout.noise_bandwidth
        if self.chip is None or not self.netlist.capacitance.any():
            return None
        return 0.0, noise_band(self.settling())[1]

    def noise_density(
        self, nodes: ArrayLike, frequencies: ArrayLike, *, temperature: float | None = None
    ) -> NDArray[np.float64]:
        """Spot density of thermal noise, ``4 k T Re Z(f)``, in V^2/Hz; 0 on rails, NaN where a node floats.

        `nodes` (k,); `frequencies` (f,): in hertz, at least 0; `temperature`: in kelvin, by default the die's; returns
        (f, k).

        Raises
        ------
        CircuitError
            If a frequency is 0, and resistors tie some part to no rail.
        AccuracyError
            If a density may be off by more than 1e-6 of itself.
        """
        kelvin = self._temperature if temperature is None else temperature
        return noise_density(self.linear, nodes, frequencies, temperature=kelvin)

    def noise_covariance(self, nodes: ArrayLike, *, temperature: float | None = None) -> NDArray[np.float64]:
        """Covariance ``k T C^-1`` of node voltages from 0 Hz to infinity, in V^2; 0 on rails, NaN where a node floats.

        `nodes` (k,): each tied to a rail by capacitances, for the noise of others is unbounded; `temperature`: in
        kelvin, by default the die's; returns (k, k).
        """
        kelvin = self._temperature if temperature is None else temperature
        return noise_covariance(self.linear, nodes, temperature=kelvin)

    def power(self) -> Power:
        """Where the chip's power comes from and where it becomes heat."""
        return analyse_power(self.op)

    def precision(self, *, span: float | None = None) -> Precision:
        """How many bits a read-out needs.

        `span`: range of the converter, in volts; without a chip's description the supply or, with a uniform drive, the
        height of the highest node above the goal rail.
        """
        return analyse_precision(self.op, span=self.span if span is None else span)

    def sensitivity(self, cells: ArrayLike | None = None) -> Sensitivity:
        """Which resistors can change a robot's steps.

        `cells` (axes,) or (k, axes): one cell, or all cells of a path (goal cells among them are left out), each of
        which costs one solution; by default those on the way from the scene's starts, or from the start that needs most
        bits.

        Raises
        ------
        InputError
            If a cell is outside the grid, is no free cell, or has no lower neighbour.
        AccuracyError
            If the derivatives cannot be found well enough.
        """
        if cells is None:
            space = self.netlist.cells.space
            starts = () if self.scene is None else self.scene.starts
            cells = self.precision().cells_passed([start_cell(space, start) for start in starts])
        return analyse_sensitivity(self.op, cells)

    def voltage_sensitivity(self, weights: ArrayLike) -> NDArray[np.float64]:
        """Derivatives of ``c .  V`` with respect to the logarithm of every resistance, in volts, shape (resistors,).

        `weights` (nodes,): ``c``, a single 1 for one node's voltage, 1 and -1 for a difference.  None is off by more
        than 1e-5 of the largest, to which the errors of the operating point's currents are added; those that cannot be
        told from 0 are 0.  Nonlinear resistors follow the others; for them it is the derivative with respect to ``-ln
        I0``.
        """
        return voltage_sensitivity(self.op, weights)

    def yields(
        self,
        *,
        trials: int = 10_000,
        half_width: float = 0.01,
        confidence: float = 0.95,
        batch: int = 64,
        starts: ArrayLike | None = None,
        seed: Any = None,
        executor: Executor | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        progress: Progress | None = None,
    ) -> Yield:
        """Fabricate chips and let robots walk on them until the yield is known well enough.

        A robot measures its cell and the face neighbours through the chip's read-out and steps to the lowest; through
        an ideal one it compares the currents through the faces.

        `trials`: chips after which trials stop in any case; `half_width`: they stop at the first whole `batch` after
        which the interval of the overall yield is no wider than twice this; `confidence`: of the intervals; `starts`: a
        mask of cells, by default every free cell with a way to a goal; `seed`: trial ``k`` is the chip of the seed
        spawned from it, ``(seed, k)``, by default the chip's own; `executor`: trials are shared among its processes (or
        threads), and the numbers do not depend on it; `checkpoint`: file that holds the counts after every batch, from
        which a run that was interrupted is taken up and ends in the same numbers; `progress`: called after every batch
        with the trials done, those expected in all, and the overall yield so far.

        Raises
        ------
        InputError
            If an argument is not admissible, the netlist does not suit the chip, or the checkpoint is of another run or
            holds more trials than asked for.
        CircuitError
            If the flawless chip has no operating point; a chip that a defect leaves without one serves no start.
        """
        return analyse_yield(
            self.ideal,
            self.chip or Chip(),
            starts=starts,
            half_width=half_width,
            confidence=confidence,
            trials=trials,
            batch=batch,
            seed=seed,
            executor=executor,
            checkpoint=checkpoint,
            progress=progress,
        )

    def criticality(
        self,
        *,
        readout: Readout | None = None,
        starts: ArrayLike | None = None,
        short_resistance: float | None = None,
        seconds: float | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Criticality:
        """Make every resistor and switch of the chip faulty, one at a time, and count the starts that are lost.

        `readout`: what the robot sees, by default the chip's; its offset and noise do not count, and an ideal one has
        40 bits, which tell steps of 1e-12 of the supply; `starts`: a mask of cells, by default every free cell with a
        way to a goal; `short_resistance`: in ohms, by default the chip's; `seconds`: after which no further element is
        examined, those with the largest currents being the first; `progress`: called with the elements done and those
        in all.
        """
        if short_resistance is None:
            short_resistance = (self.chip or Chip()).defects.short_resistance
        return analyse_criticality(
            self.netlist,
            readout or self._readout,
            starts=starts,
            short_resistance=short_resistance,
            seconds=seconds,
            progress=progress,
        )

    def exploration(
        self,
        first: Sweep | None = None,
        second: Sweep | None = None,
        *,
        trials: int = 64,
        confidence: float = 0.95,
        executor: Executor | None = None,
        progress: Progress | None = None,
    ) -> Exploration:
        """How the yield depends on any two values of the chip, on the same dies throughout.

        `first, second`: a key of the chip, with dots (``"readout.bits"``), and its values in ascending order of cost,
        the second being what is paid for (`Exploration.cheapest`); by default the offset or the mismatch, and the bits
        of the converter; `trials`: chips at every point; `confidence`: of the intervals; `executor`: as in `yields`;
        `progress`: called after every group of points with the trials done, those in all, and the last point's yield.
        """
        cells, chip = self.ideal.cells, self.chip or Chip()

        def ideal_of(kind: Chip) -> Netlist:
            return ideal_netlist(cells.space, kind, cells.wiring)

        return explore_yield(
            ideal_of,
            chip,
            first,
            second,
            trials=trials,
            confidence=confidence,
            executor=executor,
            progress=progress,
        )

    def conductances(self, seeds: Iterable[Any]) -> tuple[Netlist, NDArray[np.float64]]:
        """The chip without mismatch, and the conductances of many chips in siemens, shape (chips, resistors).

        `seeds`: one for each chip; row ``k`` is that of ``build_chip(study.ideal, study.chip, seed k)``, for
        `solve_many`.  Refused where defects or saturation change the circuit.
        """
        return conductance_samples(self.ideal, self.chip or Chip(), seeds)

    def write_decks(
        self, folder: str | os.PathLike[str], *, title: str | None = None, dialect: str = "ngspice"
    ) -> dict[str, WrittenDeck]:
        """Write the chip's decks into a folder that exists, each with its expected answer in the sidecar.

        `title`: first line of the decks, the scene's by default; `dialect`: which simulator they are for.  Returns what
        was written, by ``"op"``, ``"transient"`` and ``"noise"`` (chips with capacitance) and ``"temperature"``.
        """
        settling = self.settling() if self.netlist.capacitance.any() else None
        words = {"title": title or self.title, "dialect": dialect}
        return write_decks(self.op, self.linear, settling, self.ideal, self.chip or Chip(), Path(folder), words)

    def __repr__(self) -> str:
        cells = self.ideal.cell_map
        shape = "" if cells is None else f"{' x '.join(map(str, cells.space.shape))} cells, {cells.wiring.boundary}, "
        return f"Study({self.title}: {shape}{self.netlist.node_count} nodes)"

    def _repr_html_(self) -> str:
        picture = "" if self.ideal.cell_map is None else picture_of(self.ideal.cells.space)
        return picture + html_table(("key", "value", "meaning"), self.parameters)


def study(
    source: Scene | ConfigurationSpace | Netlist | OperatingPoint,
    chip: Chip | None = None,
    *,
    space: ConfigurationSpace | None = None,
    **wiring: Any,
) -> Study:
    """Put a chip under study, to find out whether it is good enough to drive a robot.

    Parameters
    ----------
    source : Scene, ConfigurationSpace, Netlist or OperatingPoint
        Where the chip comes from.  A scene describes it in ``[chip]``; a space is compiled with one node per cell; a
        netlist (of a deck, say) is an ideal one where a chip is given, else it is studied as it is.
    chip : Chip, optional
        Its description, in place of the scene's.
    space : ConfigurationSpace, optional
        Of the scene, where it has been sampled already.
    **wiring
        How a scene or a space is wired, in place of what the scene says: fields of `Wiring`.

    Returns
    -------
    Study

    Raises
    ------
    InputError
        If the chip or an option does not fit the source, or no free cell of a scene has a way to a goal.

    Examples
    --------
    >>> import numpy as np
    >>> import resgrid as rg
    >>> cell = np.zeros((8, 8), dtype=np.uint8)
    >>> cell[1:5, 4], cell[6, 1] = rg.Cell.OBSTACLE, rg.Cell.GOAL
    >>> space = rg.ConfigurationSpace([rg.Axis("x", 0, 8, 8), rg.Axis("y", 0, 8, 8)], cell)
    >>> study = rg.study(space, rg.Chip(mismatch=0.02, readout=rg.Readout(bits=8)))
    >>> study
    Study(chip: 8 x 8 cells, dirichlet, 66 nodes)
    >>> study.precision().sentence(12)
    'a 12-bit read-out serves 100 % of the starts'
    """
    if isinstance(source, Netlist | OperatingPoint):
        if wiring or space is not None:
            raise InputError(f"{', '.join([*wiring, 'space'])}: a circuit is wired already; give a scene or a space")
        netlist = source if isinstance(source, Netlist) else source.netlist
        solved = source if chip is None and isinstance(source, OperatingPoint) else None
        return Study(netlist, chip, solved=solved)
    if isinstance(source, ConfigurationSpace):
        chip = chip or Chip()
        return Study(ideal_netlist(source, chip, wiring), chip)
    problem = problem_of(source if chip is None else dataclasses.replace(source, chip=chip), space=space, **wiring)
    if not problem.space.goal_connected.any():
        raise InputError("no free cell has a way to a goal, so there is nothing for a chip to do; open one")
    chip = chip or source.chip
    return Study(ideal_netlist(problem.space, chip, problem.only_wiring()[1]), chip, source)
