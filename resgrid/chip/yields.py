"""Yield: from how many starts, and on how many chips, a robot that only sees the read-out reaches the goal."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from typing import Annotated, Any

import numpy as np
from annotated_types import Gt, Lt
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.checkpoints import Journal
from resgrid._internal.validation import Between, Count
from resgrid.chip.figures_of_merit import Figure, Proportion, Result, defined, effective_trials, proportion, wilson
from resgrid.chip.monte_carlo import Series, prepare, run_series
from resgrid.core.netlist import Netlist
from resgrid.core.random_sites import seed_of
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError
from resgrid.scene.chip import Chip

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
    reached : ndarray of int64, shape of the space
        On how many of the chips a robot from there reached a goal; 0 where none starts.
    served : ndarray of int64, shape (trials,)
        How many starts every chip serves.
    random : bool
        Whether chips differ at all; if not, one was tried, and the numbers are exact.
    confidence : float
        Of all intervals.
    """

    space: ConfigurationSpace
    starts: NDArray[np.bool_]
    reached: NDArray[np.int64]
    served: NDArray[np.int64]
    random: bool
    confidence: float

    @property
    def trials(self) -> int:
        """Chips that were tried."""
        return len(self.served)

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
        return overall_share(self.served, int(self.starts.sum()), self.confidence, random=self.random)

    @property
    def perfect(self) -> Proportion:
        """Share of the chips that serve every start."""
        share = float(np.mean(self.served == self.starts.sum()))
        return proportion(share, self.trials, self.confidence, random=self.random)

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
    half_width: Annotated[float, Gt(0), Lt(0.5)] = 0.01,
    confidence: Between = 0.95,
    trials: Count = 10_000,
    batch: Count = 64,
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
    ``(seed, k)``, by default the chip's own; `executor`: trials are shared among its workers, and the numbers do not
    depend on it; `checkpoint`: file with a line of JSON for every chip as soon as it and those before it are known,
    from which a run that was killed at any moment is taken up, and ends in the same numbers and the same file;
    `progress`: called after every new batch with the trials done, those expected in all, and the overall yield so far.

    A checkpoint of another kind of chip is refused; one of more trials than are needed counts as far as they are.  A
    chip that a defect leaves without an operating point serves no start; a flawless chip without one is a CircuitError.
    """
    if starts is not None:
        starts = checked_starts(netlist.cells.space, starts)
    chip = chip or Chip()
    experiment = prepare(netlist, chip, [chip.readout], None if seed is None else seed_of(seed), starts)
    space, random = netlist.cells.space, experiment.random
    most, count = trials if random else 1, int(experiment.starts.sum())
    journal = None
    if checkpoint is not None and random:
        journal = Journal(checkpoint, {"resgrid": "chips", "fingerprint": experiment.fingerprint()})
    reached = np.zeros(space.cell.size, dtype=np.int64)
    served: list[int] = []
    with closing(run_series([Series(most, 1, lambda: experiment)], count, executor, journal)) as results:
        for (starts_served,), new in islice(results, most):
            reached[experiment.starts] += starts_served
            served.append(int(starts_served.sum()))
            if len(served) % batch:
                continue
            share = overall_share(np.array(served), count, confidence, random=random)
            if progress is not None and new:
                # Intervals shrink as the square root of the trials.
                needed = int(len(served) * max(share.half_width / half_width, 1.0) ** 2)
                progress(len(served), min(-(-needed // batch) * batch, most), share)
            if share.half_width <= half_width:
                break
    shape, counts = space.shape, np.array(served, dtype=np.int64)
    return Yield(space, experiment.starts.reshape(shape), reached.reshape(shape), counts, random, confidence)


def overall_share(served: NDArray[np.int64], starts: int, confidence: float, *, random: bool) -> Proportion:
    """Share of all starts that are served, from how many every chip serves: clusters.  Shapes: `served` (trials,)."""
    share = int(served.sum()) / (len(served) * starts)
    return proportion(share, len(served), confidence, effective_trials(served, starts), random=random)


def checked_starts(space: ConfigurationSpace, starts: ArrayLike) -> NDArray[np.bool_]:
    """A mask of cells to start from, shape of the space."""
    mask = np.asarray(starts)
    if mask.dtype != np.bool_ or mask.shape != space.shape:
        raise InputError(f"starts must be True or False for every cell, shape {space.shape}")
    return mask
