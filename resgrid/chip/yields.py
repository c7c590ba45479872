"""Yield: from how many starts, and on how many chips, a robot that only sees the read-out reaches the goal."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.arguments import check_number, check_share, check_whole
from resgrid.chip.build import chip_keys, ideal_netlist
from resgrid.chip.figures import Figure, Proportion, Result, defined, effective_trials, proportion, quantile, wilson
from resgrid.chip.trials import Experiment, Tally, prepare, run_trials
from resgrid.die import seed_of
from resgrid.errors import InputError
from resgrid.netlist import Netlist
from resgrid.scene.chip import Chip, Readout
from resgrid.scene.messages import suggestion
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


Point = tuple[int, int]
Sweep = tuple[str, Sequence[Any]]
"""A key of a chip, and its values."""

_BITS = (6, 8, 10, 12, 14, 16)
_SHARES = (0.0, 0.01, 0.02, 0.05, 0.1)
_MULTIPLES = (0.0, 0.3, 1.0, 3.0, 10.0)


@dataclass(frozen=True, eq=False, repr=False)
class Exploration(Result):
    """Yield over two values of a chip.

    Attributes
    ----------
    first, second : str
        Keys of the chip, such as ``"mismatch"`` or ``"readout.bits"``.
    first_values, second_values : tuple
        Values of either.
    share, low, high : ndarray of float64, shape (first, second)
        Overall yield, and its Wilson interval (`Yield.overall`).
    trials : int
        Chips at every point; the same dies at all of them.
    confidence : float
        Of the intervals.
    """

    first: str
    second: str
    first_values: tuple[Any, ...]
    second_values: tuple[Any, ...]
    share: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    trials: int
    confidence: float

    def cheapest(self, share: float = 0.99) -> list[Any]:
        """The first of the second values from which on the yield stays at or above a share, for each first value.

        None where there is none.
        """
        check_share("share", share)
        result: list[Any] = []
        for row in self.share:
            enough = np.logical_and.accumulate((row >= share)[::-1])[::-1]
            result.append(self.second_values[int(np.argmax(enough))] if enough.any() else None)
        return result

    @property
    def figures(self) -> Mapping[str, Figure]:
        """The least second value for 99 % at every first value, with definitions."""
        return {
            f"least_{self.second.rpartition('.')[2]}_at_{value}": Figure(
                least,
                "",
                f"smallest {self.second} tried from which on the yield is at least 99 %, at {self.first} = {value}; "
                f"{self.trials} chips a point",
            )
            for value, least in zip(self.first_values, self.cheapest(), strict=True)
        }

    def to_json(self) -> dict[str, Any]:
        """All points, as plain values."""
        plain = {**vars(self), "yield": self.share}
        del plain["share"]
        arrays = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in plain.items()}
        return {**super().to_json(), **arrays}


def explore_yield(
    netlist: Netlist,
    first: Sweep | None = None,
    second: Sweep | None = None,
    *,
    chip: Chip | None = None,
    trials: int = 64,
    confidence: float = 0.95,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Exploration:
    """How the yield depends on any two values of the chip, on the same dies throughout.

    `first, second`: a key of the chip, with dots (``"readout.bits"``), and its values in ascending order of cost, the
    second being what is paid for (`Exploration.cheapest`); by default the offset or the mismatch, and the bits of the
    converter; `trials`: chips at every point; `confidence`: of the intervals; `executor`: as in `yields`; `progress`:
    called after every group of points with the trials done, those in all, and the last point's yield.
    """
    cells, chip = netlist.cells, chip or Chip()
    first, second = first or _usual_sweep(chip), second or ("readout.bits", _BITS)
    if trials < 1:
        raise InputError(f"trials = {trials} must be at least 1")
    if not len(first[1]) or not len(second[1]):
        raise InputError("both keys need at least one value")
    points = {
        (i, j): chip_with(chip, {first[0]: a, second[0]: b})
        for i, a in enumerate(first[1])
        for j, b in enumerate(second[1])
    }
    share, low, high = np.empty((3, len(first[1]), len(second[1])))
    done = 0
    for kind, members in _groups(points).items():
        # Points that differ in the read-out only share their chips, which are solved once.
        ideal = ideal_netlist(cells.space, kind, cells.wiring)
        experiment = prepare(ideal, kind, [points[place].readout for place in members])
        numbers = range(trials if experiment.random else 1)
        tally = sum(count_trials(experiment, numbers, executor), start=run_trials(experiment, []))
        for number, place in enumerate(members):
            overall = overall_of(tally, experiment, confidence, number)
            share[place], low[place], high[place] = overall.value, overall.low, overall.high
        done += len(members)
        if progress is not None:
            progress(done * trials, share.size * trials, overall)
    return Exploration(first[0], second[0], tuple(first[1]), tuple(second[1]), share, low, high, trials, confidence)


def _usual_sweep(chip: Chip) -> Sweep:
    for key, value in (("readout.offset", chip.readout.offset), ("pelgrom", chip.pelgrom)):
        if value:
            return key, tuple(float(f"{value * multiple:.3g}") for multiple in _MULTIPLES)
    return "mismatch", _SHARES


def _groups(points: Mapping[Point, Chip]) -> dict[Chip, list[Point]]:
    """Points by what their chips are without the read-out's own errors."""
    groups: dict[Chip, list[Point]] = {}
    for place, chip in points.items():
        load = Readout(input_resistance=chip.readout.input_resistance)
        groups.setdefault(dataclasses.replace(chip, readout=load), []).append(place)
    return groups


def chip_with(chip: Chip, values: Mapping[str, Any]) -> Chip:
    """The same chip with other values by key, with dots: ``{"mismatch": 0.02, "readout.bits": 8}``."""
    known = [key for key, _ in chip_keys(chip)]
    tables: dict[str, dict[str, Any]] = {"": {}}
    for key, value in values.items():
        if key not in known:
            hint = suggestion(key, known) or f"there are {', '.join(known)}"
            raise InputError(f"a chip has no key {key!r}; {hint}")
        table, _, name = key.rpartition(".")
        tables.setdefault(table, {})[name] = value.item() if isinstance(value, np.generic) else value
    changes = tables.pop("")
    inner = {table: dataclasses.replace(getattr(chip, table), **parts) for table, parts in tables.items()}
    return dataclasses.replace(chip, **changes, **inner)
