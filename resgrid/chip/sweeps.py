"""Exploration: how the yield depends on two values of a chip."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.checkpoints import Journal
from resgrid._internal.validation import Between, Count, check_share
from resgrid.chip.build import chip_with
from resgrid.chip.figures_of_merit import Figure, Result
from resgrid.chip.paired_trials import groups_of, run_groups
from resgrid.chip.yields import Progress, overall_share
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.scene.chip import Chip

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
    trials: Count = 64,
    confidence: Between = 0.95,
    executor: Executor | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Exploration:
    """How the yield depends on any two values of the chip, on the same dies throughout.

    `first, second`: a key of the chip, with dots (``"readout.bits"``), and its values in ascending order of cost, the
    second being what is paid for (`Exploration.cheapest`); by default the offset or the mismatch, and the bits of the
    converter; `trials`: chips at every point; `confidence`: of the intervals; `executor, checkpoint`: as in `yields`;
    `progress`: called after every group of points with the trials done, those in all, and the last point's yield.
    """
    cells, chip = netlist.cells, chip or Chip()
    first, second = first or _usual_sweep(chip), second or ("readout.bits", _BITS)
    if not len(first[1]) or not len(second[1]):
        raise InputError("both keys need at least one value")
    points = {
        (i, j): chip_with(chip, {first[0]: a, second[0]: b})
        for i, a in enumerate(first[1])
        for j, b in enumerate(second[1])
    }
    starts = int(cells.space.goal_connected.sum())
    groups = groups_of(netlist, points, trials)
    journal = None
    if checkpoint is not None:
        digest = hashlib.sha256(f"{points} {trials} {groups[0].series.prepare().fingerprint()}".encode())
        journal = Journal(checkpoint, {"resgrid": "sweep", "fingerprint": digest.hexdigest()})
    share, low, high = np.empty((3, len(first[1]), len(second[1])))
    done = 0
    with closing(run_groups(groups, starts, executor, journal)) as results:
        for served in results:
            for place, (counts, random) in served.items():
                overall = overall_share(counts, starts, confidence, random=random)
                share[place], low[place], high[place] = overall.value, overall.low, overall.high
            done += len(served)
            if progress is not None:
                progress(done * trials, share.size * trials, overall)
    return Exploration(first[0], second[0], tuple(first[1]), tuple(second[1]), share, low, high, trials, confidence)


def _usual_sweep(chip: Chip) -> Sweep:
    for key, value in (("readout.offset", chip.readout.offset), ("pelgrom", chip.pelgrom)):
        if value:
            return key, tuple(float(f"{value * multiple:.3g}") for multiple in _MULTIPLES)
    return "mismatch", _SHARES
