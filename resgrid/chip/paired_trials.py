"""Paired trials: several chip descriptions on the same random numbers, so that yields can be compared chip by chip.

A point is one of the compared chip descriptions, and its key is any hashable name.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Generator, Hashable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from itertools import islice
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.checkpoints import Journal
from resgrid.chip.build import ideal_netlist
from resgrid.chip.monte_carlo import Experiment, Noises, TrialSeries, differs, prepare_experiment, run_series
from resgrid.core.netlist import Netlist
from resgrid.scene.chip import Chip, Readout

Key = TypeVar("Key", bound=Hashable)


class SharedCircuit(NamedTuple, Generic[Key]):
    """Points (chip descriptions) of a comparison that have the same circuit and different read-outs.

    The chips of a group are solved once for all points.  `keys`: key of every point; `random`: for every point, whether
    its trials differ; `series`: trials of the circuit, with one read-out for each point.
    """

    keys: list[Key]
    random: list[bool]
    series: TrialSeries


class StartsServed(NamedTuple):
    """Number of starts from which the robot reaches a goal, for each chip.

    `counts` (trials,): the numbers, shape (1,) if all trials are equal; `random`: whether trials differ, by the circuit
    of the chip or by random errors of its read-out.
    """

    counts: NDArray[np.int64]
    random: bool


def groups_of(
    netlist: Netlist, points: Mapping[Key, Chip], trials: int, known: Noises | None = None
) -> list[SharedCircuit[Key]]:
    """Return the points (chip descriptions) of a comparison, grouped by the circuit of their chips.

    `netlist`: ideal circuit; `points`: chip description of every point; the keys identify the points in results;
    `trials`: number of chips per point; `known`: rms noise voltages (cells,) in volts that earlier calls have computed,
    by chip description and noise bandwidth in hertz, to which new ones are added; None for none.
    """
    kinds: dict[Chip, list[Key]] = {}
    for key, chip in points.items():
        load = Readout(input_resistance=chip.readout.input_resistance)
        kinds.setdefault(dataclasses.replace(chip.with_process(), readout=load), []).append(key)
    return [
        _group(netlist, kind, keys, [points[key].readout for key in keys], trials, known)
        for kind, keys in kinds.items()
    ]


def run_groups(
    groups: Sequence[SharedCircuit[Key]], starts: int, executor: Executor | None, journal: Journal | None = None
) -> Generator[dict[Key, StartsServed], None, None]:
    """Run the trials of all groups, and yield for each group the numbers of served starts, by the key of the point.

    A start is served if the robot reaches a goal from there.  A value of the dict has one number per trial, or a single
    one if all chips of the point are equal.  `groups`: points with the same circuit; `starts`: number of starts;
    `executor`: workers, None for this process; `journal`: checkpoint file, None for no checkpoint.
    """
    with closing(run_series([group.series for group in groups], starts, executor, journal)) as results:
        for keys, random, series in groups:
            counts = np.array([served.sum(axis=1) for served, _ in islice(results, series.trials)])
            points = zip(keys, random, counts.T, strict=True)
            yield {key: StartsServed(count if differ else count[:1], differ) for key, differ, count in points}


def _group(
    netlist: Netlist, kind: Chip, keys: list[Key], readouts: Sequence[Readout], trials: int, known: Noises | None
) -> SharedCircuit[Key]:
    """Return the trials of one circuit with several read-outs, as a SharedCircuit.

    `netlist`: ideal circuit; `kind`: chip description whose read-out has only the input resistance; `keys, readouts`:
    key and read-out of every point of the analysis; `trials`: number of chips; `known`: rms noise voltages (cells,) in
    volts that earlier calls have computed, by chip description and noise bandwidth in hertz, to which new ones are
    added; None for none.
    """
    cells = netlist.cells
    random = [differs(kind) or bool(item.offset or item.noise_bandwidth) for item in readouts]

    def prepared() -> Experiment:
        return prepare_experiment(ideal_netlist(cells.space, kind, cells.wiring), kind, readouts, known=known)

    series = TrialSeries(trials if any(random) else 1, len(readouts), prepared, f"chips of {kind},", random=any(random))
    return SharedCircuit(keys, random, series)
