"""Sweeps: the yield of a chip for all pairs of values of two keys of its description."""

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
from resgrid._internal.numbers import check_fraction
from resgrid.chip.build import chip_with
from resgrid.chip.figures_of_merit import Figure, Result
from resgrid.chip.paired_trials import groups_of, run_groups
from resgrid.chip.yields import Progress, overall_yield
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.scene.chip import Chip

SweptKey = tuple[str, Sequence[Any]]
"""A key of a chip description, such as ``"readout.bits"``, and the values to try."""

_BITS = (6, 8, 10, 12, 14, 16)
"""Values of the key ``readout.bits`` that a sweep tries by default, in bits."""
_SHARES = (0.0, 0.01, 0.02, 0.05, 0.1)
"""Values of the key ``mismatch`` that a sweep tries by default: standard deviations of a resistance as fractions of its
mean.
"""
_MULTIPLES = (0.0, 0.3, 1.0, 3.0, 10.0)
"""Default values of the key ``readout.offset`` or ``pelgrom`` in a sweep, as multiples of its value in the chip
description.
"""


@dataclass(frozen=True, eq=False, repr=False)
class Sweep(Result):
    """Yield of a chip for all pairs of values of two keys of its description.

    Returned by `resgrid.chip.Study.sweep`.

    Attributes
    ----------
    first, second : str
        Keys of the chip description, such as ``"mismatch"`` or ``"readout.bits"``.
    first_values, second_values : tuple
        Values of the first and of the second key, in the order of the sweep.
    share, low, high : ndarray of float64, shape (first values, second values)
        Overall yield (`Yield.overall`) for each pair of values, and the ends of its Wilson interval.
    trials : int
        Number of chips for each pair of values; all pairs have the same random numbers.
    confidence : float
        Confidence of the intervals, between 0 and 1.
    figures : mapping of str to Figure
        For each first value, the first of the second values from which on the yield is at least 99 %.

    Examples
    --------
    >>> study = rg.study(rg.read_scene("examples/scenes/lesson.toml"), rg.Chip())
    >>> sweep = study.sweep(("mismatch", (0.0, 0.1)), ("readout.bits", (6, 8, 10, 12)), trials=16)
    >>> sweep.share.round(2)
    array([[0.5 , 0.71, 0.95, 1.  ],
           [0.5 , 0.72, 0.93, 1.  ]])
    >>> sweep.cheapest(0.9)
    [10, 10]
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

    def cheapest(self, fraction: float = 0.99) -> list[Any]:
        """Return, for each first value, the first of the second values from which on the yield is at least `fraction`.

        Parameters
        ----------
        fraction : float
            The yield to reach, in [0, 1].

        Returns
        -------
        list
            One entry for each of `first_values`: the earliest of `second_values` such that the yield at this value and
            all later ones is at least `fraction`; None if there is no such value.

        Raises
        ------
        InputError
            If `fraction` is out of range.
        """
        check_fraction("fraction", fraction)
        result: list[Any] = []
        for row in self.share:
            enough = np.logical_and.accumulate((row >= fraction)[::-1])[::-1]
            result.append(self.second_values[int(np.argmax(enough))] if enough.any() else None)
        return result

    @property
    def figures(self) -> Mapping[str, Figure]:
        """For each first value, the first of the second values from which on the yield is at least 99 %, as a Figure.

        The key is ``least_<second key>_at_<first value>``, with the last word of the second key, such as
        ``least_bits_at_0.02``. The figure's value is None if no second value has such a yield.
        """
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
        """Return the sweep as a dictionary for JSON.

        Keys: the names of `figures`, each with the keys ``value``, ``unit`` and ``definition``; ``yield`` for the
        attribute `share`; and the other attributes by their names, arrays as nested lists.
        """
        plain = {**vars(self), "yield": self.share}
        del plain["share"]
        arrays = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in plain.items()}
        return {**super().to_json(), **arrays}


def sweep_yield(
    netlist: Netlist,
    chip: Chip,
    first: SweptKey | None = None,
    second: SweptKey | None = None,
    *,
    trials: int = 64,
    confidence: float = 0.95,
    executor: Executor | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Sweep:
    """Estimate the yield of a chip for all pairs of values of two keys; return the yields as a Sweep.

    `netlist`: ideal circuit; `chip`: chip description; `first, second`: a key of the description and its values.  None
    as `first` means the read-out's offset or ``pelgrom`` if the chip has one, else the mismatch; None as `second` means
    the bits of the converter.  `trials`: number of chips for each pair; `confidence`: of the intervals, between 0 and
    1; `executor`: workers, None for this process; `checkpoint`: file of finished trials, None for no file;
    `progress`: function called after each group of pairs that share a circuit, with the numbers of finished and of all
    trials, and the yield of the last pair.
    """
    cells = netlist.cells
    first, second = first or _usual_sweep(chip), second or ("readout.bits", _BITS)
    if not len(first[1]) or not len(second[1]):
        raise InputError(f"{first[0]} and {second[0]} need at least one value each; give values such as [8, 10, 12]")
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
                overall = overall_yield(counts, starts, confidence, random=random)
                share[place], low[place], high[place] = overall.value, overall.low, overall.high
            done += len(served)
            if progress is not None:
                progress(done * trials, share.size * trials, overall)
    return Sweep(first[0], second[0], tuple(first[1]), tuple(second[1]), share, low, high, trials, confidence)


def _usual_sweep(chip: Chip) -> SweptKey:
    """Return the default first key of a sweep and its values.

    The key is ``readout.offset`` or ``pelgrom``, the first of them that the chip description sets, with multiples of
    the value that it sets; else ``mismatch``, with fixed values from 0 to 10 %.
    """
    for key, value in (("readout.offset", chip.readout.offset), ("pelgrom", chip.with_process().pelgrom)):
        if value:
            return key, tuple(float(f"{value * multiple:.3g}") for multiple in _MULTIPLES)
    return "mismatch", _SHARES
