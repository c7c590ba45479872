"""Yield: from how many starts, and on how many chips, a robot that only sees the read-out reaches the goal."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.arguments import check_number, check_whole
from resgrid.chip.figures import Proportion, Reading, effective_trials, json_form, proportion, quantile, wilson
from resgrid.chip.trials import Experiment, Tally, fingerprint, load_tally, prepare, run_trials, save_tally
from resgrid.die import seed_of
from resgrid.errors import InputError
from resgrid.frozen import frozen, picture_html
from resgrid.netlist import Netlist
from resgrid.scene.chip import Chip
from resgrid.space import ConfigurationSpace

TASK = 16
"""Trials that one task of an executor does."""

Progress = Callable[[int, int, Proportion], None]
"""Told after every batch: trials done, trials expected in all, and the overall yield so far."""


@frozen
@dataclass(frozen=True, eq=False)
class Yield:
    """How many robots reach the goal on chips of one kind.

    Attributes
    ----------
    space : ConfigurationSpace
    starts : ndarray of bool, shape of the space
        Cells that robots start from: free ones with a way to a goal.
    trials : int
        Chips that were tried.
    reached : ndarray of int64, shape of the space
        On how many of them a robot from there reached a goal; 0 where none starts.
    complete : int
        Chips on which all did.
    squares : int
        Sum over the chips of the square of the number of starts they serve.
    random : bool
        Whether chips differ at all; if not, one was tried, and the numbers are exact.
    confidence : float
        Of all intervals.
    """

    space: ConfigurationSpace
    starts: NDArray[np.bool_]
    trials: int
    reached: NDArray[np.int64]
    complete: int
    squares: int
    random: bool
    confidence: float

    _repr_html_ = picture_html

    @property
    def probability(self) -> NDArray[np.float64]:
        """Share of the chips on which a start is served, shape of the space; NaN where none starts."""
        return np.where(self.starts, self.reached / self.trials, np.nan)

    @property
    def interval(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Ends of the Wilson interval of every start, shape of the space; NaN where none starts."""
        share = self.probability
        return wilson(share, self.trials, self.confidence) if self.random else (share, share)

    @property
    def overall(self) -> Proportion:
        """Share of all starts on all chips; its interval allows for starts of a chip not being independent."""
        total, starts = int(self.reached.sum()), int(self.starts.sum())
        if not self.random:
            return _exact(total / starts, self.confidence)
        return _overall(total, self.squares, self.trials, starts, self.confidence)

    @property
    def perfect(self) -> Proportion:
        """Share of the chips that serve every start."""
        share = self.complete / self.trials
        return proportion(share, self.trials, self.confidence) if self.random else _exact(share, self.confidence)

    @property
    def readings(self) -> Mapping[str, Reading]:
        """The figures, with units and definitions."""
        sure = f"{self.confidence:.0%} confidence (Wilson)"
        worst = np.nanmin(self.probability) if self.starts.any() else np.nan
        return {
            "yield": Reading(
                self.overall.value,
                "",
                "share of all starts, averaged over chips, from which a robot that sees the read-out only reaches a "
                "goal; starts are the free cells with a way to one",
            ),
            "yield_low": Reading(
                self.overall.low, "", f"lower end of the interval of the yield, {sure}, for chips as clusters"
            ),
            "yield_high": Reading(
                self.overall.high, "", f"upper end of the interval of the yield, {sure}, for chips as clusters"
            ),
            "perfect_chips": Reading(self.perfect.value, "", "share of the chips that serve every start"),
            "perfect_chips_low": Reading(self.perfect.low, "", f"lower end of the interval of perfect_chips, {sure}"),
            "perfect_chips_high": Reading(self.perfect.high, "", f"upper end of the interval of perfect_chips, {sure}"),
            "worst_start": Reading(
                float(worst) if np.isfinite(worst) else None, "", "share of the chips that serve the worst start"
            ),
            "chips": Reading(self.trials, "", "chips that were tried"),
        }

    def to_json(self) -> dict[str, Any]:
        """The readings, as plain values."""
        return {**json_form(self.readings), "confidence": self.confidence, "random": self.random}


def analyse_yield(
    netlist: Netlist,
    chip: Chip,
    *,
    starts: ArrayLike | None = None,
    half_width: float = 0.01,
    confidence: float = 0.95,
    most: int = 10_000,
    batch: int = 64,
    seed: Any = None,
    executor: Executor | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Yield:
    """Fabricate chips and let robots walk on them until the yield is known well enough.

    A robot measures its cell and the face neighbours through the chip's read-out and steps to the lowest
    (`resgrid.chip.readout`); through an ideal one it compares the currents through the faces.

    Parameters
    ----------
    netlist : Netlist
        The ideal one, compiled with ``rails="cells"`` and the chip's resistance and supply.
    chip : Chip
    starts : array_like of bool, shape of the space, optional
        By default every free cell with a way to a goal.
    half_width : float
        Trials stop at the first whole batch after which the interval of the overall yield is no wider than twice this.
    confidence : float
        Of the intervals.
    most : int
        Trials after which they stop in any case.
    batch : int
        Trials between two looks at the interval.
    seed : int, sequence of int or numpy.random.SeedSequence, optional
        Trial ``k`` is the chip of the seed spawned from it, ``(seed, k)``; the chip's own by default.
    executor : concurrent.futures.Executor, optional
        Trials are shared among its processes (or threads); the numbers do not depend on it.
    checkpoint : path-like, optional
        File that holds the counts after every batch, written whole or not at all.  If it exists, the run is taken up
        from there, and ends in the numbers of one that was never interrupted; counts of a run that asked for a
        narrower interval are kept whole.
    progress : callable, optional
        Called after every batch with the trials done, those expected in all, and the overall yield so far.

    Returns
    -------
    Yield

    Raises
    ------
    InputError
        If an argument is not admissible, the netlist does not suit the chip, or the checkpoint is of another run or
        holds more trials than ``most``.
    CircuitError
        If the flawless chip has no operating point; a chip that a defect leaves without one serves no start.
    """
    _check(half_width, confidence, most, batch)
    experiment = prepare(
        netlist,
        chip,
        [chip.readout],
        None if seed is None else seed_of(seed),
        None if starts is None else _checked_starts(netlist, starts),
    )
    count = int(experiment.starts.sum())
    if not count:
        raise InputError("there is no start: no free cell has a way to a goal")
    tally = _counted(experiment, (half_width, confidence, most, batch), executor, checkpoint, progress)
    space = netlist.cells.space
    return Yield(
        space=space,
        starts=experiment.starts.reshape(space.shape),
        trials=tally.trials,
        reached=tally.reached[0].reshape(space.shape),
        complete=int(tally.complete[0]),
        squares=int(tally.squares[0]),
        random=experiment.random,
        confidence=confidence,
    )


def _counted(
    experiment: Experiment,
    rule: tuple[float, float, int, int],
    executor: Executor | None,
    checkpoint: str | os.PathLike[str] | None,
    progress: Progress | None,
) -> Tally:
    half_width, confidence, most, batch = rule
    if not experiment.random:
        return run_trials(experiment, [0])
    mark = fingerprint(experiment, batch)
    tally = None if checkpoint is None else load_tally(checkpoint, mark)
    if tally is None:
        tally = run_trials(experiment, [])
    if tally.trials > most:
        raise InputError(
            f"the checkpoint {str(checkpoint)!r} holds {tally.trials} trials, more than most = {most}; ask for no "
            "fewer, or name another"
        )
    while tally.trials < most:
        if tally.trials and tally.trials % batch == 0:
            share = overall_of(tally, experiment, confidence)
            if progress is not None:
                progress(tally.trials, _expected(tally.trials, share.half_width / half_width, batch, most), share)
            if share.half_width <= half_width:
                break
        # A run before may have ended within a batch.
        numbers = range(tally.trials, min((tally.trials // batch + 1) * batch, most))
        tally = sum(count_trials(experiment, numbers, executor), start=tally)
        if checkpoint is not None:
            save_tally(checkpoint, tally, mark)
    return tally


def overall_of(tally: Tally, experiment: Experiment, confidence: float, readout: int = 0) -> Proportion:
    """The overall yield of the counts so far."""
    total, starts = int(tally.reached[readout].sum()), int(experiment.starts.sum())
    if not experiment.random:
        return _exact(total / (tally.trials * starts), confidence)
    return _overall(total, int(tally.squares[readout]), tally.trials, starts, confidence)


def _overall(total: int, squares: int, trials: int, starts: int, confidence: float) -> Proportion:
    effective = effective_trials(total, squares, trials, starts)
    return proportion(total / (trials * starts), trials, confidence, effective)


def _exact(share: float, confidence: float) -> Proportion:
    return Proportion(share, share, share, 1, confidence)


def _expected(trials: int, excess: float, batch: int, most: int) -> int:
    """Trials in all, since intervals shrink as their square root."""
    return min(-(-int(trials * max(excess, 1.0) ** 2) // batch) * batch, most)


def count_trials(experiment: Experiment, numbers: range, executor: Executor | None) -> Iterable[Tally]:
    """Counts of some trials, task by task."""
    tasks = [numbers[begin : begin + TASK] for begin in range(0, len(numbers), TASK)]
    run: Callable[..., Iterable[Tally]] = map if executor is None else executor.map
    return run(partial(run_trials, experiment), tasks)


def _check(half_width: float, confidence: float, most: int, batch: int) -> None:
    check_number("half_width", half_width, "a number between 0 and 0.5, such as 0.01", above=0.0, below=0.5)
    check_whole("most", most, 1)
    check_whole("batch", batch, 1)
    quantile(confidence)


def _checked_starts(netlist: Netlist, starts: ArrayLike) -> NDArray[np.bool_]:
    mask = np.asarray(starts)
    shape = None if netlist.cell_map is None else netlist.cells.space.shape
    if mask.dtype != np.bool_ or mask.shape != shape:
        raise InputError(f"starts must be True or False for every cell, shape {shape}")
    return mask
