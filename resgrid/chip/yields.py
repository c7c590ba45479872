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
from resgrid.chip.figures import Figure, Proportion, Result, defined, effective_trials, proportion, quantile, wilson
from resgrid.chip.trials import Experiment, Tally, prepare, run_trials
from resgrid.die import seed_of
from resgrid.errors import InputError
from resgrid.netlist import Netlist
from resgrid.scene.chip import Chip
from resgrid.space import ConfigurationSpace

_TASK = 16
"""Trials that one task of an executor does."""

Progress = Callable[[int, int, Proportion], None]
"""Called after every batch: trials done, trials expected in all, and the overall yield so far."""


@dataclass(frozen=True, eq=False, repr=False)
class Yield(Result):
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
        counts = int(self.reached.sum()), self.squares, self.trials, int(self.starts.sum())
        return _overall(*counts, self.confidence, random=self.random)

    @property
    def perfect(self) -> Proportion:
        """Share of the chips that serve every start."""
        share = self.complete / self.trials
        return proportion(share, self.trials, self.confidence) if self.random else _exact(share, self.confidence)

    @property
    def figures(self) -> Mapping[str, Figure]:
        """The figures of merit by name, with units and definitions."""
        overall, perfect = self.overall, self.perfect
        sure = f"{self.confidence:.0%} confidence (Wilson)"
        worst = np.nanmin(self.probability) if self.starts.any() else np.nan
        shares = {
            "yield": (
                overall.value,
                "share of all starts, averaged over chips, from which a robot that sees the read-out only reaches a "
                "goal; starts are the free cells with a way to one",
            ),
            "yield_low": (overall.low, f"lower end of the interval of the yield, {sure}, for chips as clusters"),
            "yield_high": (overall.high, f"upper end of the interval of the yield, {sure}, for chips as clusters"),
            "perfect_chips": (perfect.value, "share of the chips that serve every start"),
            "perfect_chips_low": (perfect.low, f"lower end of the interval of perfect_chips, {sure}"),
            "perfect_chips_high": (perfect.high, f"upper end of the interval of perfect_chips, {sure}"),
            "worst_start": (defined(worst), "share of the chips that serve the worst start"),
            "chips": (self.trials, "chips that were tried"),
        }
        return {name: Figure(value, "", definition) for name, (value, definition) in shares.items()}

    def to_json(self) -> dict[str, Any]:
        """The figures, as plain values."""
        return {**super().to_json(), "confidence": self.confidence, "random": self.random}


def analyse_yield(
    netlist: Netlist,
    *,
    chip: Chip | None = None,
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
    """Fabricate chips and let robots walk on them until the yield is known well enough.

    A robot measures its cell and the face neighbours through the chip's read-out and steps to the lowest; through an
    ideal one it compares the currents through the faces.

    `trials`: chips after which trials stop in any case; `half_width`: they stop at the first whole `batch` after which
    the interval of the overall yield is no wider than twice this; `confidence`: of the intervals; `starts`: a mask of
    cells, by default every free cell with a way to a goal; `seed`: trial ``k`` is the chip of the seed spawned from it,
    ``(seed, k)``, by default the chip's own; `executor`: trials are shared among its processes (or threads), and the
    numbers do not depend on it; `checkpoint`: file that holds the counts after every batch, from which a run that was
    interrupted is taken up and ends in the same numbers; `progress`: called after every batch with the trials done,
    those expected in all, and the overall yield so far.

    A checkpoint of another run, or one that holds more trials than asked for, is refused.  A chip that a defect leaves
    without an operating point serves no start; a flawless chip without one is a CircuitError.
    """
    check_number("half_width", half_width, "a number between 0 and 0.5, such as 0.01", above=0.0, below=0.5)
    check_whole("trials", trials, 1)
    check_whole("batch", batch, 1)
    quantile(confidence)
    if starts is not None:
        starts = checked_starts(netlist.cells.space, starts)
    chip = chip or Chip()
    experiment = prepare(netlist, chip, [chip.readout], None if seed is None else seed_of(seed), starts)
    if not experiment.starts.any():
        raise InputError("there is no start: no free cell has a way to a goal")
    if experiment.random:
        rule = _Rule(half_width, confidence, trials, batch)
        tally = _count(experiment, rule, executor, checkpoint, progress)
    else:
        tally = run_trials(experiment, [0])
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


@dataclass(frozen=True)
class _Rule:
    """When trials stop: `half_width` of the interval at a `confidence`, or `trials`; looked at after every batch."""

    half_width: float
    confidence: float
    trials: int
    batch: int

    def expected(self, done: int, half_width: float) -> int:
        """Trials in all, since intervals shrink as their square root."""
        needed = int(done * max(half_width / self.half_width, 1.0) ** 2)
        return min(-(-needed // self.batch) * self.batch, self.trials)


def _count(
    experiment: Experiment,
    rule: _Rule,
    executor: Executor | None,
    checkpoint: str | os.PathLike[str] | None,
    progress: Progress | None,
) -> Tally:
    fingerprint = experiment.fingerprint(rule.batch)
    saved = None if checkpoint is None else Tally.load(checkpoint, fingerprint)
    tally = saved or run_trials(experiment, [])
    if tally.trials > rule.trials:
        raise InputError(
            f"the checkpoint {str(checkpoint)!r} holds {tally.trials} trials, more than trials = {rule.trials}; ask "
            "for no fewer, or name another"
        )
    while tally.trials < rule.trials:
        if tally.trials and tally.trials % rule.batch == 0:
            share = overall_of(tally, experiment, rule.confidence)
            if progress is not None:
                progress(tally.trials, rule.expected(tally.trials, share.half_width), share)
            if share.half_width <= rule.half_width:
                break
        # A run before may have ended within a batch.
        numbers = range(tally.trials, min((tally.trials // rule.batch + 1) * rule.batch, rule.trials))
        tally = sum(count_trials(experiment, numbers, executor), start=tally)
        if checkpoint is not None:
            tally.save(checkpoint, fingerprint)
    return tally


def count_trials(experiment: Experiment, numbers: range, executor: Executor | None) -> Iterable[Tally]:
    """Counts of some trials, task by task."""
    tasks = [numbers[begin : begin + _TASK] for begin in range(0, len(numbers), _TASK)]
    run: Callable[..., Iterable[Tally]] = map if executor is None else executor.map
    return run(partial(run_trials, experiment), tasks)


def overall_of(tally: Tally, experiment: Experiment, confidence: float, readout: int = 0) -> Proportion:
    """The overall yield of the counts so far."""
    reached, squares = int(tally.reached[readout].sum()), int(tally.squares[readout])
    counts = reached, squares, tally.trials, int(experiment.starts.sum())
    return _overall(*counts, confidence, random=experiment.random)


def _overall(reached: int, squares: int, trials: int, starts: int, confidence: float, *, random: bool) -> Proportion:
    share = reached / (trials * starts)
    if not random:
        return _exact(share, confidence)
    return proportion(share, trials, confidence, effective_trials(reached, squares, trials, starts))


def _exact(share: float, confidence: float) -> Proportion:
    return Proportion(share, share, share, 1, confidence)


def checked_starts(space: ConfigurationSpace, starts: ArrayLike) -> NDArray[np.bool_]:
    """A mask of cells to start from, shape of the space."""
    mask = np.asarray(starts)
    if mask.dtype != np.bool_ or mask.shape != space.shape:
        raise InputError(f"starts must be True or False for every cell, shape {space.shape}")
    return mask
