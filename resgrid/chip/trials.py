"""Trials of a kind of chip: fabricate one, let robots with only its read-out walk from every cell, and count."""

from __future__ import annotations

import dataclasses
import hashlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from resgrid.chip.build import build_chip, conductance_samples
from resgrid.chip.noise import ROOM, analyse_noise
from resgrid.chip.passes.editing import tiled_layout
from resgrid.chip.passes.values import NOMINAL_CELSIUS
from resgrid.chip.precision import steps_of
from resgrid.chip.readout import Eyes, Floor, eyes_of, floor_of, follow, walk
from resgrid.die import Seed, seed_of
from resgrid.errors import CircuitError, InputError
from resgrid.files import atomic_path
from resgrid.netlist import Netlist
from resgrid.nodal.many import Batch, prepare_batch, solve_batch
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.nodal.secant import small_signal
from resgrid.nodal.solve import solve
from resgrid.scene.chip import Chip, Readout


@dataclass(frozen=True, eq=False)
class Experiment:
    """A kind of chip, and the read-outs that are tried on every chip of it.

    `netlist`: the ideal one, with one node per cell; `seed`: trial ``k`` is chip ``(seed, k)``; `starts` (cells,):
    where robots start; `eyes`: one for each read-out; None for an ideal one; `batch`: what chips that differ in their
    conductances only share; `volts` (nodes,): voltages where all chips are the same, and some read-out is not ideal.
    """

    netlist: Netlist
    chip: Chip
    seed: Seed
    floor: Floor
    starts: NDArray[np.bool_]
    eyes: tuple[Eyes | None, ...]
    batch: Batch | None
    volts: NDArray[np.float64] | None

    @property
    def random(self) -> bool:
        """Whether trials differ."""
        return differs(self.chip) or any(eyes is not None and eyes.random for eyes in self.eyes)


@dataclass(frozen=True, eq=False)
class Tally:
    """Counts of trials; whole numbers, so that sums do not depend on their order.

    `reached` (readouts, cells): from how many trials a start reached the goal; `complete` (readouts,): trials in
    which every start did; `squares` (readouts,): sum over the trials of the square of the number of starts that did.
    """

    trials: int
    reached: NDArray[np.int64]
    complete: NDArray[np.int64]
    squares: NDArray[np.int64]

    def __add__(self, other: Tally) -> Tally:
        return Tally(
            self.trials + other.trials,
            self.reached + other.reached,
            self.complete + other.complete,
            self.squares + other.squares,
        )


def differs(chip: Chip) -> bool:
    """Whether chips of a kind differ from each other."""
    return bool(chip.mismatch or chip.pelgrom or _is_faulty(chip))


def is_ideal(readout: Readout) -> bool:
    """Whether a robot sees what there is: currents through faces, without error."""
    return readout.bits is None and not readout.offset and readout.noise_bandwidth is None


def prepare(
    netlist: Netlist,
    chip: Chip,
    readouts: Sequence[Readout],
    seed: Seed | None = None,
    starts: NDArray[np.bool_] | None = None,
) -> Experiment:
    """Do once what all trials share.  Shapes: `starts` as the space."""
    cell_map = tiled_layout(netlist, "robots that see the read-out")
    mask = cell_map.space.goal_connected if starts is None else cell_map.space.goal_connected & starts
    blurred = not all(is_ideal(readout) for readout in readouts)
    alike = not differs(chip)
    linear = chip.saturation_voltage is None and not _is_faulty(chip)
    nominal = build_chip(netlist, _flawless(chip))
    point = solve(nominal)
    bands = {readout.noise_bandwidth for readout in readouts} - {None}
    noise = {band: _noise(nominal, point, chip, band) for band in bands if band is not None}
    return Experiment(
        netlist=netlist,
        chip=chip,
        seed=seed_of(chip.seed if seed is None else seed),
        floor=floor_of(cell_map),
        starts=mask.ravel(),
        eyes=tuple(
            None if is_ideal(readout) else eyes_of(readout, cell_map, noise.get(readout.noise_bandwidth or 0.0))
            for readout in readouts
        ),
        batch=prepare_batch(conductance_samples(netlist, chip, [])[0]) if blurred and linear and not alike else None,
        volts=point.voltage if blurred and alike else None,
    )


def run_trials(experiment: Experiment, numbers: Sequence[int]) -> Tally:
    """Try some chips."""
    reached = np.zeros((len(experiment.eyes), len(experiment.starts)), dtype=np.int64)
    complete, squares = np.zeros((2, len(experiment.eyes)), dtype=np.int64)
    wanted = int(experiment.starts.sum())
    seeds = [_trial_seed(experiment.seed, number) for number in numbers]
    for eyes, walks in _walks(experiment, seeds):
        arrived = walks & experiment.starts
        reached[eyes] += arrived
        served = int(arrived.sum())
        complete[eyes] += served == wanted
        squares[eyes] += served * served
    return Tally(len(seeds), reached, complete, squares)


def _walks(experiment: Experiment, seeds: Sequence[Seed]) -> Iterator[tuple[int, NDArray[np.bool_]]]:
    """Number of the read-out, and which cells lead to a goal, trial by trial."""
    ideal = [number for number, eyes in enumerate(experiment.eyes) if eyes is None]
    if ideal:
        once = None if differs(experiment.chip) else _ideal_walk(experiment, experiment.seed)
        for seed in seeds:
            arrived = _ideal_walk(experiment, seed) if once is None else once
            yield from ((number, arrived) for number in ideal)
    if len(ideal) == len(experiment.eyes):
        return
    for seed, volts in zip(seeds, _voltages(experiment, seeds), strict=True):
        for number, eyes in enumerate(experiment.eyes):
            if eyes is not None:
                yield number, walk(volts, experiment.floor, eyes, seed)


def _ideal_walk(experiment: Experiment, seed: Seed) -> NDArray[np.bool_]:
    try:
        point = solve(build_chip(experiment.netlist, experiment.chip, seed))
    except CircuitError:  # so broken that nothing flows
        return experiment.floor.goal
    return follow(steps_of(point).lowest()[0], experiment.floor)


def _voltages(experiment: Experiment, seeds: Sequence[Seed]) -> Iterator[NDArray[np.float64]]:
    """Node voltages of one chip after the other."""
    if experiment.volts is not None:
        yield from (experiment.volts for _ in seeds)
    elif experiment.batch is not None:
        conductance = conductance_samples(experiment.netlist, experiment.chip, seeds)[1]
        yield from solve_batch(experiment.batch, conductance)
    else:
        for seed in seeds:
            try:
                netlist = build_chip(experiment.netlist, experiment.chip, seed)
                yield solve(netlist, accuracy="normwise").voltage
            except CircuitError:
                yield np.full(experiment.netlist.node_count, np.nan)


def _trial_seed(seed: Seed, number: int) -> Seed:
    return (*(seed if isinstance(seed, tuple) else (seed,)), number)


def _is_faulty(chip: Chip) -> bool:
    return bool(chip.defects.open_density or chip.defects.short_density)


def _flawless(chip: Chip) -> Chip:
    """The chip that all others of its kind scatter around."""
    healthy = dataclasses.replace(chip.defects, open_density=0.0, short_density=0.0)
    return dataclasses.replace(chip, mismatch=None, pelgrom=None, defects=healthy)


def die_temperature(chip: Chip) -> float:
    """Temperature of the die, in kelvin."""
    return ROOM if chip.temperature is None else ROOM + chip.temperature - NOMINAL_CELSIUS


def _noise(nominal: Netlist, point: OperatingPoint, chip: Chip, bandwidth: float) -> NDArray[np.float64]:
    """Deviation of a measurement at every cell, in volts: thermal noise of the flawless chip in the read-out's band."""
    linear = small_signal(point) if nominal.nonlinear_nodes.size else nominal
    noise = analyse_noise(linear, band=(0.0, bandwidth), temperature=die_temperature(chip))
    assert noise.total is not None
    node = nominal.cells.node.ravel()
    return np.where(node >= 0, np.nan_to_num(noise.total)[node], 0.0)


_SCHEMA = 1


def fingerprint(experiment: Experiment, batch: int) -> str:
    """A hash of everything that the counts of an experiment depend on, hexadecimal."""
    digest = hashlib.sha256(f"{_SCHEMA} {experiment.seed} {batch} {experiment.chip}".encode())
    digest.update(experiment.starts.tobytes())
    digest.update(experiment.floor.around.tobytes())
    for item in dataclasses.fields(Netlist):
        value = getattr(experiment.netlist, item.name)
        if isinstance(value, np.ndarray):
            digest.update(item.name.encode() + value.tobytes())
    for eyes in experiment.eyes:
        digest.update(repr(None if eyes is None else (eyes.low, eyes.span, eyes.steps, eyes.offset)).encode())
    return digest.hexdigest()


def save_tally(path: str | os.PathLike[str], tally: Tally, mark: str) -> None:
    """Write the counts so far, whole or not at all."""
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(
            file,
            fingerprint=np.array(mark),
            trials=np.array(tally.trials),
            reached=tally.reached,
            complete=tally.complete,
            squares=tally.squares,
        )


def load_tally(path: str | os.PathLike[str], mark: str) -> Tally | None:
    """Read the counts so far; None if there is no such file."""
    try:
        with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as data:
            found, trials = str(data["fingerprint"]), int(data["trials"])
            counts = [data[name] for name in ("reached", "complete", "squares")]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        raise InputError(f"cannot read the checkpoint {str(path)!r}: {error}; remove it or name another") from error
    if found != mark:
        raise InputError(
            f"the checkpoint {str(path)!r} belongs to another run: the scene, the chip, the seed or the batch differs; "
            "remove it or name another"
        )
    return Tally(trials, *counts)
