"""The class `Study`: one method per analysis of a chip, with defaults from the chip description."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterable
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Unpack

import numpy as np
from annotated_types import Gt, Lt
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import Between, Count, Positive
from resgrid.chip.build import conductance_samples, ideal_netlist
from resgrid.chip.decks import write_decks
from resgrid.chip.fault_analysis import FaultAnalysis, analyse_faults
from resgrid.chip.study_circuit import CircuitStudy
from resgrid.chip.study_inputs import checked_method
from resgrid.chip.sweeps import Sweep, SweptKey, sweep_yield
from resgrid.chip.yield_loss import YieldLoss, analyse_yield_loss
from resgrid.chip.yields import Progress, Yield, analyse_yield
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.core.netlist import Netlist
from resgrid.core.space import ConfigurationSpace
from resgrid.core.wiring import Wiring, WiringOptions, wiring_of
from resgrid.errors import InputError
from resgrid.planning.pipeline import problem_of
from resgrid.scene import Scene
from resgrid.scene.chip import Chip, Readout
from resgrid.spice.write.files import WrittenDeck


@dataclass(frozen=True, eq=False, repr=False)
class Study(CircuitStudy):
    """One chip and its analyses; made by `study`.

    Attributes
    ----------
    ideal : Netlist
        The circuit before the effects of the chip; a uniform drive is scaled to the supply.
    chip : Chip or None
        The chip description; None for a netlist or an operating point that is studied as it is.
    scene : Scene or None
        The scene that the chip comes from.
    solved : OperatingPoint or None
        Operating point of the circuit, if it was given; None if it is computed when an analysis needs it.

    Examples
    --------
    >>> study = rg.study(rg.read_scene("examples/scenes/lesson.toml"), rg.Chip(capacitance="100f", mismatch="2 %"))
    >>> print(study.settling().figures["settle_time"])
    11.28 ns
    >>> print(study.power().figures["power"])
    246.4 µW
    >>> print(study.yields(trials=64).overall)
    100.0 % (94.3 to 100.0 %)
    """

    @checked_method
    def yields(
        self,
        *,
        starts: ArrayLike | None = None,
        half_width: Annotated[float, Gt(0), Lt(0.5)] = 0.01,
        confidence: Between = 0.95,
        trials: Count = 10_000,
        batch: Count = 64,
        seed: Any = None,
        executor: Executor | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        progress: Progress | None = None,
    ) -> Yield:
        """Estimate the yield by Monte Carlo trials: draw chips and let robots walk on them.

        A robot measures its cell and the face neighbours through the read-out of the chip, and steps to the lowest
        reading.  With an ideal read-out it compares the currents through the faces.

        Parameters
        ----------
        starts : array_like of bool, shape of the space, optional
            Mask of the start cells; by default every free cell with a path to a goal.
        half_width : float
            Trials stop after the first whole batch after which half the width of the confidence interval of the overall
            yield (a fraction) is at most this value.
        confidence : float
            Confidence of all intervals, between 0 and 1.
        trials : int
            Maximum number of trials (chips).
        batch : int
            Number of trials between two tests of the interval.
        seed : int, sequence of int or numpy.random.SeedSequence, optional
            Trial ``k`` is the chip of seed ``(seed, k)``; by default the seed of the chip description.
        executor : concurrent.futures.Executor, optional
            Workers that run the trials.  The result does not depend on it.
        checkpoint : path, optional
            File with one line of JSON for every finished trial, in order.  A later run with the same arguments
            continues from this file, with the same result and the same file as an uninterrupted run.
        progress : callable, optional
            Called after every new batch with the number of trials, the expected number of trials, and the overall
            yield (`Proportion`).

        Returns
        -------
        Yield
            Yield and its interval.  A chip on which a defect leaves no operating point serves no start.

        Raises
        ------
        InputError
            If no start has a path to a goal, or if the checkpoint belongs to another chip or other arguments.
        CircuitError
            If the chip has no operating point even without random errors.
        """
        return analyse_yield(
            self.ideal,
            self.description,
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

    @checked_method
    def yield_loss(
        self,
        *,
        target: Annotated[float, Gt(0), Lt(1)] = 0.99,
        trials: Count | None = None,
        confidence: Between = 0.95,
        executor: Executor | None = None,
        progress: Progress | None = None,
    ) -> YieldLoss:
        """Find the causes of yield loss, and the largest mismatch and offset and the fewest bits that reach a yield.

        Each effect of the chip is switched off in turn, on chips with the same random numbers.  The limits change one
        value of the chip description and leave all others as they are.  An effect is left out if without it the chip
        has no operating point or the description is invalid.

        Parameters
        ----------
        target : float
            Yield that the limits reach, as a fraction.
        trials : int, optional
            Number of chips for each variant; by default 400, fewer (at least 16) for grids of more than 650 cells.
        confidence : float
            Confidence of all intervals.
        executor : concurrent.futures.Executor, optional
            Workers that run the trials.  The result does not depend on it.
        progress : callable, optional
            Called after the trials of each variant with the number of trials, their expected number, and the yield.

        Returns
        -------
        YieldLoss
            Yield without each effect, and the limits of mismatch, offset and bits.
        """
        return analyse_yield_loss(
            self.ideal,
            self.description,
            target=target,
            trials=trials,
            confidence=confidence,
            executor=executor,
            progress=progress,
        )

    @checked_method
    def sweep(
        self,
        first: SweptKey | None = None,
        second: SweptKey | None = None,
        *,
        trials: Count = 64,
        confidence: Between = 0.95,
        executor: Executor | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        progress: Progress | None = None,
    ) -> Sweep:
        """Estimate the yield for all pairs of values of two keys of the chip description, on the same random numbers.

        Parameters
        ----------
        first, second : tuple of str and sequence, optional
            A key of the chip description, with dots (``"readout.bits"``), and its values.  List the values of `second`
            in ascending cost (`Sweep.cheapest`).  By default `first` is the read-out's offset or ``pelgrom`` if the
            chip has one, else the mismatch, and `second` the bits of the converter.
        trials : int
            Number of chips for each pair of values.
        confidence : float
            Confidence of all intervals.
        executor : concurrent.futures.Executor, optional
            Workers that run the trials.  The result does not depend on it.
        checkpoint : path, optional
            File with one line of JSON for every finished trial.  A later run with the same arguments continues from it.
        progress : callable, optional
            Called after every group of pairs that share a circuit, with the number of finished and of all trials, and
            the yield of the last pair.

        Returns
        -------
        Sweep
            Yield and its interval for every pair of values.

        Raises
        ------
        InputError
            If a key is unknown or has no values, or a value is out of range.
        """
        return sweep_yield(
            self.ideal,
            self.description,
            first,
            second,
            trials=trials,
            confidence=confidence,
            executor=executor,
            checkpoint=checkpoint,
            progress=progress,
        )

    @checked_method
    def conductances(self, seeds: Iterable[Any]) -> tuple[Netlist, NDArray[np.float64]]:
        """Draw the conductances of several chips that share one circuit, without a netlist for each.

        Parameters
        ----------
        seeds : iterable of int, sequence of int or numpy.random.SeedSequence
            One seed for each chip.

        Returns
        -------
        netlist : Netlist
            The circuit without mismatch.
        conductances : ndarray of float64, shape (chips, resistors)
            Conductances in siemens, equal to those of ``build_chip(study.ideal, study.chip, seed)``; input of
            `resgrid.circuit.solve_many`.

        Raises
        ------
        InputError
            If the chip has defects or saturation, which change the circuit.
        """
        return conductance_samples(self.ideal, seeds, chip=self.description)

    @checked_method
    def faults(
        self,
        *,
        readout: Readout | None = None,
        starts: ArrayLike | None = None,
        short_resistance: Positive | None = None,
        seconds: float | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> FaultAnalysis:
        """Simulate an open and a short of every resistor and switch, and count the starts that are lost.

        Parameters
        ----------
        readout : Readout, optional
            The read-out, whose offset and noise are ignored; by default that of the chip.  An ideal read-out has 40
            bits, which resolve 1e-12 of the range of its converter.
        starts : array_like of bool, shape of the space, optional
            Mask of the start cells; by default every free cell with a path to a goal.
        short_resistance : float, optional
            Resistance of a short, in ohms; by default that of the chip.
        seconds : float, optional
            Time limit in seconds; by default no limit.  Elements with the largest currents come first.
        progress : callable, optional
            Called with the number of finished elements and the number of all elements.

        Returns
        -------
        FaultAnalysis
            Number of starts that each fault loses.
        """
        if short_resistance is None:
            short_resistance = self.description.defects.short_resistance
        return analyse_faults(
            self.netlist,
            self.description.readout if readout is None else readout,
            short_resistance,
            starts=starts,
            seconds=seconds,
            progress=progress,
        )

    @checked_method
    def write_decks(
        self, folder: str | os.PathLike[str], *, title: str | None = None, dialect: str = "ngspice"
    ) -> dict[str, WrittenDeck]:
        """Write the SPICE decks of the chip, each with its expected results in a sidecar file.

        Parameters
        ----------
        folder : path
            An existing folder.
        title : str, optional
            First line of the decks; by default the title of the scene.
        dialect : {"ngspice", "ltspice", "xyce", "hspice", "spectre"}
            Name of the simulator's dialect.

        Returns
        -------
        dict of str to WrittenDeck
            Decks by name: ``"op"``, ``"transient"`` and ``"noise"`` (chips with capacitance), ``"temperature"``.
        """
        settling = self.usual_settling if self.netlist.capacitance.any() else None
        words = {"title": title or self.title, "dialect": dialect}
        return write_decks(self.op, self.linear, settling, self.ideal, self.description, Path(folder), words)


def study(
    source: Scene | ConfigurationSpace | Netlist | OperatingPoint,
    chip: Chip | None = None,
    wiring: Wiring | None = None,
    *,
    space: ConfigurationSpace | None = None,
    **options: Unpack[WiringOptions],
) -> Study:
    """Put a chip under study, to find out whether it is accurate enough to drive a robot.

    Parameters
    ----------
    source : Scene, ConfigurationSpace, Netlist or OperatingPoint
        Origin of the chip.  A scene describes the chip in its ``[chip]`` table.  A space is compiled with one node per
        cell.  A netlist (or the netlist of an operating point) is the ideal circuit to which the effects of `chip` are
        applied; without `chip` the netlist is studied as it is.
    chip : Chip, optional
        The chip description, in place of that of the scene.
    wiring : Wiring, optional
        Boundary conditions of a scene or a space, and the wall resistance; by default those of the scene and the chip.
        Resistance and supply come from the chip description instead, unless `options` contains them.
    space : ConfigurationSpace, optional
        The space of the scene, where it has been built already.
    **options
        Fields of `Wiring`, such as ``boundary="neumann"``: instead of a wiring, or changes to it.  A resistance, a
        supply or a wall resistance replaces that of the chip.

    Returns
    -------
    Study
        The chip with a method for each analysis.

    Raises
    ------
    InputError
        If the chip or an option does not fit the source.
    CircuitError
        If nothing drives the circuit of a scene.

    Examples
    --------
    >>> chip = rg.Chip(mismatch=0.02, readout=rg.chip.Readout(bits=8))
    >>> study = rg.study(rg.read_scene("examples/scenes/lesson.toml"), chip)
    >>> study
    Study(Eight by eight: 8 x 8 cells, dirichlet, 66 nodes)
    >>> study.adc_resolution().sentence(12)
    'a 12-bit read-out serves 100 % of the starts'
    """
    if isinstance(source, Netlist | OperatingPoint):
        given = [*options, *(name for name, value in (("wiring", wiring), ("space", space)) if value is not None)]
        if given:
            raise InputError(f"{', '.join(given)}: a circuit is wired already; give a scene or a space")
        netlist = source if isinstance(source, Netlist) else source.netlist
        solved = source if chip is None and isinstance(source, OperatingPoint) else None
        return Study(netlist, chip, solved=solved)
    if isinstance(source, ConfigurationSpace):
        chip = chip or Chip()
        default = {"wall_resistance": chip.wall_resistance} if options.get("boundary") == "wall" else {}
        own = wiring_of(wiring, options, default)
        chip = _with_values(chip, own, options)
        return Study(ideal_netlist(source, chip, own), chip)
    scene = source if chip is None else dataclasses.replace(source, chip=chip)
    problem = problem_of(scene, wiring, space=space, **options)
    own = problem.only_wiring()[1]
    chip = _with_values(scene.chip, own, options)
    return Study(ideal_netlist(problem.space, chip, own), chip, source)


def _with_values(chip: Chip, wiring: Wiring, options: WiringOptions) -> Chip:
    """Return the chip description with the resistance and the supply in `options` and the wall resistance of `wiring`.

    Values that are not given do not change the description.
    """
    given: dict[str, Any] = {"resistance": options.get("resistance"), "supply": options.get("supply")}
    given["wall_resistance"] = wiring.wall_resistance
    changes = {name: value for name, value in given.items() if value is not None and value != getattr(chip, name)}
    return dataclasses.replace(chip, **changes) if changes else chip
