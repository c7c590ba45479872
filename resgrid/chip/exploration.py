"""How the yield depends on any two values of a chip, on the same dies throughout."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.chip.build import ideal_netlist
from resgrid.chip.figures import Proportion, Reading, json_form
from resgrid.chip.trials import Experiment, Tally, prepare, run_trials
from resgrid.chip.yields import Progress, count_trials, overall_of
from resgrid.errors import InputError
from resgrid.frozen import frozen, picture_html
from resgrid.scene.chip import Chip, Readout
from resgrid.space import ConfigurationSpace

_TABLES = ("readout", "defects")
Point = tuple[int, int]


@frozen
@dataclass(frozen=True, eq=False)
class Exploration:
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

    _repr_html_ = picture_html

    def cheapest(self, share: float = 0.99) -> list[Any]:
        """The first of the second values from which on the yield stays at or above a share, for each first value.

        None where there is none.
        """
        if not 0 <= share <= 1:
            raise InputError(f"share = {share} must lie between 0 and 1")
        result: list[Any] = []
        for row in self.share:
            enough = np.logical_and.accumulate((row >= share)[::-1])[::-1]
            result.append(self.second_values[int(np.argmax(enough))] if enough.any() else None)
        return result

    @property
    def readings(self) -> Mapping[str, Reading]:
        """The least second value for 99 % at every first value, with definitions."""
        return {
            f"least_{self.second.rpartition('.')[2]}_at_{value}": Reading(
                least,
                "",
                f"smallest {self.second} tried from which on the yield is at least 99 %, at {self.first} = {value}; "
                f"{self.trials} chips a point",
            )
            for value, least in zip(self.first_values, self.cheapest(), strict=True)
        }

    def to_json(self) -> dict[str, Any]:
        """All points, as plain values."""
        return {
            **json_form(self.readings),
            "first": self.first,
            "first_values": list(self.first_values),
            "second": self.second,
            "second_values": list(self.second_values),
            "yield": self.share.tolist(),
            "low": self.low.tolist(),
            "high": self.high.tolist(),
            "trials": self.trials,
            "confidence": self.confidence,
        }


def explore_yield(
    space: ConfigurationSpace,
    chip: Chip,
    first: tuple[str, Sequence[Any]],
    second: tuple[str, Sequence[Any]],
    *,
    boundary: str = "dirichlet",
    drive: str | None = None,
    edge: str | Sequence[str] = "obstacle",
    start: Sequence[int] | None = None,
    trials: int = 64,
    confidence: float = 0.95,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Exploration:
    """Find the yield over a grid of any two values of a chip.

    Points that differ in the read-out only share their chips, which are solved once.

    Parameters
    ----------
    space : ConfigurationSpace
    chip : Chip
        All other values.
    first, second : tuple of (str, sequence)
        A key of the chip, with dots (``"readout.bits"``, ``"defects.open_density"``), and its values in ascending
        order of cost; for `Exploration.cheapest` the second is what is paid for.
    boundary, drive, edge, start
        As in `compile_chip`.
    trials : int
        Chips at every point.
    confidence : float
        Of the intervals.
    executor : concurrent.futures.Executor, optional
        As in `analyse_yield`.
    progress : callable, optional
        Called after every group of points with the trials done, those in all, and the last point's yield.

    Returns
    -------
    Exploration

    Raises
    ------
    InputError
        If a key is unknown or a value is not admissible.
    """
    if trials < 1:
        raise InputError(f"trials = {trials} must be at least 1")
    if not len(first[1]) or not len(second[1]):
        raise InputError("both keys need at least one value")
    points = {
        (i, j): chip_with(chip, {first[0]: a, second[0]: b})
        for i, a in enumerate(first[1])
        for j, b in enumerate(second[1])
    }
    shape = (len(first[1]), len(second[1]))
    share, low, high = np.empty((3, *shape))
    done = 0
    for kind, members in _groups(points).items():
        netlist = ideal_netlist(space, kind, boundary=boundary, drive=drive, edge=edge, start=start)
        experiment = prepare(netlist, kind, [points[place].readout for place in members])
        tally = _counted(experiment, trials, executor)
        for number, place in enumerate(members):
            overall = overall_of(tally, experiment, confidence, number)
            share[place], low[place], high[place] = overall.value, overall.low, overall.high
        done += len(members)
        if progress is not None:
            progress(done * trials, share.size * trials, _last(share, low, high, members[-1], trials, confidence))
    return Exploration(first[0], second[0], tuple(first[1]), tuple(second[1]), share, low, high, trials, confidence)


def _counted(experiment: Experiment, trials: int, executor: Executor | None) -> Tally:
    start = run_trials(experiment, [])
    return sum(count_trials(experiment, range(trials if experiment.random else 1), executor), start=start)


def _last(
    share: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    place: Point,
    trials: int,
    confidence: float,
) -> Proportion:
    return Proportion(float(share[place]), float(low[place]), float(high[place]), trials, confidence)


def _groups(points: Mapping[Point, Chip]) -> dict[Chip, list[Point]]:
    """Points by what their chips are without the read-out's own errors."""
    groups: dict[Chip, list[Point]] = {}
    for place, chip in points.items():
        load = Readout(input_resistance=chip.readout.input_resistance)
        groups.setdefault(dataclasses.replace(chip, readout=load), []).append(place)
    return groups


def chip_with(chip: Chip, values: Mapping[str, Any]) -> Chip:
    """The same chip with other values.

    Parameters
    ----------
    chip : Chip
    values : mapping of str to object
        By key, with dots: ``{"mismatch": 0.02, "readout.bits": 8}``.

    Returns
    -------
    Chip

    Raises
    ------
    InputError
        If a key is unknown or a value is not admissible.
    """
    tables: dict[str, dict[str, Any]] = {"": {}, **{table: {} for table in _TABLES}}
    for key, value in values.items():
        table, _, name = key.rpartition(".")
        if key not in chip_keys():
            near = get_close_matches(key, chip_keys(), 1)
            hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(chip_keys())}"
            raise InputError(f"a chip has no key {key!r}; {hint}")
        tables[table][name] = value.item() if isinstance(value, np.generic) else value
    inner = {
        table: dataclasses.replace(getattr(chip, table), **changes)
        for table, changes in tables.items()
        if table and changes
    }
    return dataclasses.replace(chip, **tables[""], **inner)


def chip_keys() -> list[str]:
    """Keys of a chip that hold one value each."""
    names = [item.name for item in dataclasses.fields(Chip) if item.name not in _TABLES]
    return [
        *names,
        *(f"{table}.{item.name}" for table in _TABLES for item in dataclasses.fields(getattr(Chip(), table))),
    ]
