"""Yield over many chips: the fraction of starts from which a robot reaches the goal by read-out voltages."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.checkpoints import Journal
from resgrid.chip.figures_of_merit import Figure, Proportion, Result, defined, effective_trials, proportion, wilson
from resgrid.chip.monte_carlo import Experiment, TrialSeries, prepare_experiment, run_series
from resgrid.core.netlist import Netlist
from resgrid.core.random_sites import seed_of
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.scene.chip import Chip

Progress = Callable[[int, int, Proportion], None]
"""Function called after every batch of trials with the number of finished trials, the expected number of trials, and
the yield of the finished trials.
"""


@dataclass(frozen=True, eq=False, repr=False)
class Yield(Result):
    """Yield of chips of one description.

    Returned by `resgrid.chip.Study.yields`.

    Attributes
    ----------
    space : ConfigurationSpace
        The space of the chip.
    starts : ndarray of bool, shape of the space
        Mask of the start cells: the requested cells that are free and have a path to a goal, by default all such cells.
    reached : ndarray of int64, shape of the space
        Number of chips on which a robot that starts in the cell reaches a goal; 0 outside the starts.
    served : ndarray of int64, shape (trials,)
        Number of starts that reach a goal, for every chip.
    random : bool
        Whether trials (chips) may differ.  If not, a single chip was tried, and the numbers are exact.
    confidence : float
        Confidence of all intervals, between 0 and 1.
    trials : int
        Number of chips that were tried.
    probability : ndarray of float64, shape of the space
        Fraction of the chips on which a start reaches a goal; NaN outside the starts.
    interval : tuple of two ndarray of float64, shape of the space
        Lower and upper ends of the Wilson interval of `probability`; NaN outside the starts.
    overall : Proportion
        Fraction of all starts on all chips that reach a goal.
    perfect : Proportion
        Fraction of the chips on which every start reaches a goal.
    figures : mapping of str to Figure
        Figures of merit by name.

    Examples
    --------
    >>> chip = rg.Chip(mismatch=0.02, readout=rg.chip.Readout(bits=8))
    >>> yields = rg.study(rg.read_scene("examples/scenes/lesson.toml"), chip).yields(trials=32)
    >>> print(yields.overall)
    70.8 % (68.6 to 72.8 %)
    >>> yields.trials, yields.probability[6].round(2)
    (32, array([1.  ,  nan, 1.  , 1.  , 1.  , 1.  ,  nan, 0.75]))
    """

    space: ConfigurationSpace
    starts: NDArray[np.bool_]
    reached: NDArray[np.int64]
    served: NDArray[np.int64]
    random: bool
    confidence: float

    @property
    def trials(self) -> int:
        """Number of chips that were tried."""
        return len(self.served)

    @property
    def probability(self) -> NDArray[np.float64]:
        """Fraction of the chips on which a start reaches a goal, shape of the space; NaN outside the starts."""
        return np.where(self.starts, self.reached / self.trials, np.nan)

    @property
    def interval(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper ends of the Wilson interval of every start, shape of the space; NaN outside the starts."""
        share = self.probability
        return wilson(share, self.trials, self.confidence) if self.random else (share, share)

    @property
    def overall(self) -> Proportion:
        """Fraction of all starts on all chips that reach a goal; its interval treats each chip as a cluster."""
        return overall_yield(self.served, int(self.starts.sum()), self.confidence, random=self.random)

    @property
    def perfect(self) -> Proportion:
        """Fraction of the chips on which every start reaches a goal, with its interval."""
        share = float(np.mean(self.served == self.starts.sum()))
        return proportion(share, self.trials, self.confidence, random=self.random)

    @property
    def figures(self) -> Mapping[str, Figure]:
        """Figures of merit by name: fractions of starts and of chips, between 0 and 1, and the number of chips.

        ``yield``: fraction of starts that reach a goal; ``perfect_chips``: fraction of chips that serve every start;
        both also with the endings ``_low`` and ``_high`` for the ends of their intervals; ``worst_start``: fraction of
        the chips that serve the worst start, None without starts; ``chips``: number of chips.
        """
        overall, perfect = self.overall, self.perfect
        interval = f"{self.confidence:.0%} confidence (Wilson)"
        worst = np.nanmin(self.probability) if self.starts.any() else np.nan
        shares = {
            "yield": (
                overall.value,
                "fraction of all starts, averaged over chips, from which a robot that sees only the read-out reaches a "
                "goal; starts are the free cells with a path to a goal",
            ),
            "yield_low": (overall.low, f"lower end of the interval of the yield, {interval}, with chips as clusters"),
            "yield_high": (overall.high, f"upper end of the interval of the yield, {interval}, with chips as clusters"),
            "perfect_chips": (perfect.value, "fraction of the chips that serve every start"),
            "perfect_chips_low": (perfect.low, f"lower end of the interval of perfect_chips, {interval}"),
            "perfect_chips_high": (perfect.high, f"upper end of the interval of perfect_chips, {interval}"),
            "worst_start": (defined(worst), "fraction of the chips that serve the worst start"),
            "chips": (self.trials, "number of chips that were tried"),
        }
        return {name: Figure(value, "", definition) for name, (value, definition) in shares.items()}

    def to_json(self) -> dict[str, Any]:
        """Return the result as a dictionary for JSON.

        Keys: the names of `figures`, each with a dictionary of ``value``, ``unit`` and ``definition``; ``confidence``:
        of the intervals, between 0 and 1; ``random``: whether chips of the description may differ.
        """
        return {**super().to_json(), "confidence": self.confidence, "random": self.random}


def analyse_yield(
    netlist: Netlist,
    chip: Chip,
    *,
    starts: ArrayLike | None = None,
    half_width: float = 0.01,
    confidence: float = 0.95,
    trials: int = 10_000,
    batch: int = 64,
    seed: Any = None,
    executor: Executor | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Yield:
    """Estimate the yield of an ideal circuit with the effects of a chip by Monte Carlo trials; return it as a Yield.

    The stages: precompute everything that does not depend on the trial; for each chip draw, solve, read out and walk
    (`resgrid.chip.monte_carlo.run_trials`); count the starts that reach a goal; stop at a narrow enough interval.

    `netlist`: ideal circuit; `chip`: chip description; `starts` (shape of the space): mask of the start cells, None for
    all with a path to a goal; `half_width`: trials stop once half the width of the yield's confidence interval (a
    fraction) is at most this value; `confidence`: of the intervals, between 0 and 1; `trials`: maximum number of chips;
    `batch`: number of chips between two tests of the width; `seed`: seed of the trials, None for that of the chip;
    `executor`: workers, None for this process; `checkpoint`: file of finished trials, None for no file; `progress`:
    function called after every batch with the number of finished trials, the expected number, and their yield.
    """
    chip = chip.with_process()
    mask = None if starts is None else checked_starts(netlist.cells.space, starts)
    experiment = prepare_experiment(netlist, chip, [chip.readout], None if seed is None else seed_of(seed), mask)
    tally = _Tally(experiment, confidence)
    series = TrialSeries(trials if experiment.random else 1, 1, lambda: experiment)
    journal = _journal(checkpoint, experiment)
    with closing(run_series([series], tally.starts, executor, journal)) as results:
        for (served,), is_new in islice(results, series.trials):
            tally.add(served)
            if tally.trials % batch:
                continue
            overall = tally.overall
            if progress is not None and is_new:
                progress(tally.trials, _expected_trials(overall, half_width, batch, series.trials), overall)
            if overall.half_width <= half_width:
                break
    return tally.result()


class _Tally:
    """Running counts of the starts that reach a goal.

    `experiment`: prepared trials, with the mask of the starts; `confidence`: confidence of the intervals, between 0 and
    1.
    """

    def __init__(self, experiment: Experiment, confidence: float) -> None:
        self._experiment, self._confidence = experiment, confidence
        self._reached = np.zeros(len(experiment.starts), dtype=np.int64)
        self._served: list[int] = []
        self.starts = int(experiment.starts.sum())

    def add(self, served: NDArray[np.bool_]) -> None:
        """Add one trial to the counts; `served` (starts,): mask of the starts that reach a goal."""
        self._reached[self._experiment.starts] += served
        self._served.append(int(served.sum()))

    @property
    def trials(self) -> int:
        """Number of trials that have been added."""
        return len(self._served)

    @property
    def overall(self) -> Proportion:
        """Fraction of all starts that reach a goal, over all added trials, with its confidence interval."""
        return overall_yield(np.array(self._served), self.starts, self._confidence, random=self._experiment.random)

    def result(self) -> Yield:
        """Return the yield over all trials that have been added."""
        experiment = self._experiment
        space, counts = experiment.netlist.cells.space, np.array(self._served, dtype=np.int64)
        starts, reached = experiment.starts.reshape(space.shape), self._reached.reshape(space.shape)
        return Yield(space, starts, reached, counts, experiment.random, self._confidence)


def _journal(checkpoint: str | os.PathLike[str] | None, experiment: Experiment) -> Journal | None:
    """Return the open checkpoint of an experiment, or None if no file is given or the trials do not differ.

    `checkpoint`: path of the file, None for no file.
    """
    if checkpoint is None or not experiment.random:
        return None
    return Journal(checkpoint, {"resgrid": "chips", "fingerprint": experiment.fingerprint()})


def _expected_trials(overall: Proportion, half_width: float, batch: int, trials: int) -> int:
    """Return an estimate of the number of trials for the wanted interval: a multiple of `batch`, at most `trials`.

    Interval widths are inversely proportional to the square root of the number of trials.  `overall`: yield of the
    finished trials; `half_width`: wanted half width of its interval, as a fraction; `batch`: number of trials between
    two tests; `trials`: maximum number of trials.
    """
    needed = int(overall.trials * max(overall.half_width / half_width, 1.0) ** 2)
    return min(-(-needed // batch) * batch, trials)


def overall_yield(served: NDArray[np.int64], starts: int, confidence: float, *, random: bool) -> Proportion:
    """Return the fraction of all starts that reach a goal, with an interval that treats each chip as a cluster.

    `served` (trials,): number of starts that reach a goal, for each chip; `starts`: number of starts on one chip;
    `confidence`: of the interval, between 0 and 1; `random`: whether trials differ; if not, the interval has no width.
    """
    fraction = int(served.sum()) / (len(served) * starts)
    return proportion(fraction, len(served), confidence, effective_trials(served, starts), random=random)


def checked_starts(space: ConfigurationSpace, starts: ArrayLike) -> NDArray[np.bool_]:
    """Return the mask of start cells, shape of the space; raise InputError for another type or shape.

    `starts`: array of True and False with the shape of the space.
    """
    mask = np.asarray(starts)
    if mask.dtype != np.bool_ or mask.shape != space.shape:
        raise InputError(f"starts must be True or False for every cell, shape {space.shape}")
    return mask
