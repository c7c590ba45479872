"""Trials of a kind of chip: fabricate one, let robots that only see its read-out walk from every cell, and count.

A robot measures its cell and the neighbours, and steps to the lowest.  The converter floors every voltage into
``2**bits`` equal steps of its range.  The robot steps only to a strictly lower reading; of equal ones to the first
along the axes in their order, the lower side first.  Where no neighbour measures lower it is stuck, and stuck or back
in a cell it has been to, it is lost.  Every read-out of a cell keeps its offset; noise is drawn anew for every
measurement.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import zlib
from collections.abc import Callable, Generator, Iterator, Mapping, MutableMapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.checkpoints import Journal
from resgrid._internal.parallel import JobPart, in_order
from resgrid.chip.adc_resolution import enterable, steps_of
from resgrid.chip.build import build_chip, conductance_samples
from resgrid.chip.effects import Faults
from resgrid.chip.effects.base import cells_with_nodes
from resgrid.chip.effects.values import NOMINAL_CELSIUS
from resgrid.chip.noise import ROOM, analyse_noise
from resgrid.circuit.batch import Batch, prepare_batch, solve_batch
from resgrid.circuit.nonlinear import linearize
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import solve
from resgrid.core.netlist import CellMap, Netlist
from resgrid.core.random_sites import NOISE, OFFSET, Seed, generator, seed_of
from resgrid.core.regions import cells_at_faces, slab, with_margin
from resgrid.core.space import Cell
from resgrid.errors import CircuitError, InputError
from resgrid.scene.chip import Chip, Defects, Readout

_SCHEMA = 2

_TOGETHER = 16
"""Chips that are solved together, and are in memory at a time."""


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Where a robot may walk.

    `around` (cells, 2 ndim): free or goal cells that a free cell touches, -1 for none, axis by axis, the lower side
    first; `goal` (cells,); `node` (cells,): node of every cell; ground's where a cell has none.
    """

    around: NDArray[np.int64]
    goal: NDArray[np.bool_]
    node: NDArray[np.int64]


def neighbours_of(cells: CellMap) -> Neighbours:
    """Lay out the cells of a netlist for a walk."""
    space = cells.space
    walkable = enterable(space) & (cells.node >= 0)
    flat = np.where(walkable, np.arange(space.cell.size).reshape(space.shape), -1)
    wide, around = with_margin(flat, space.periodic, beyond=-1), []
    for axis, count in enumerate(space.shape):
        below, above = cells_at_faces(wide, axis)
        around += [slab(below, axis, 0, count), slab(above, axis, 1, count + 1)]
    around = [np.where(space.cell == Cell.FREE, there, -1).ravel() for there in around]
    node = np.where(cells.node >= 0, cells.node, 0)
    return Neighbours(np.stack(around, axis=1), (space.cell == Cell.GOAL).ravel(), node.ravel())


@dataclass(frozen=True, eq=False)
class Converter:
    """What a robot sees of voltages, in shares of the converter's range.

    `low, span`: lower end and width of the range, in volts; `steps`: ``2**bits``; 0 without a converter; `offset`:
    standard deviation of the offsets; `noise` (cells,): deviation of every measurement; `falling`: 1, or -1 where the
    goal rail lies above the other.
    """

    low: float
    span: float
    steps: float
    offset: float
    noise: NDArray[np.float64]
    falling: float

    @property
    def random(self) -> bool:
        """Whether two robots see different things on one chip."""
        return self.offset > 0 or bool(self.noise.any())


def converter_of(readout: Readout, cells: CellMap, noise: NDArray[np.float64] | None = None) -> Converter:
    """Bring a read-out to shares of its range; ``noise`` in volts, shape (cells,)."""
    wiring = cells.wiring
    low, high = readout.range or sorted((wiring.goal_voltage, wiring.high))
    deviation = np.zeros(cells.space.cell.size) if noise is None else noise / (high - low)
    steps = 0.0 if readout.bits is None else 2.0**readout.bits
    offset = (readout.offset or 0.0) / (high - low)
    return Converter(low, high - low, steps, offset, deviation, float(np.sign(wiring.supply)))


def arrivals(
    volts: NDArray[np.float64], neighbours: Neighbours, converter: Converter, seed: Seed = 0
) -> NDArray[np.bool_]:
    """Which cells a robot reaches the goal from.  Shapes: `volts` (nodes,); returns (cells,)."""
    from resgrid.chip.kernels import step_down

    cells, ways = neighbours.around.shape
    height = (volts[neighbours.node] - converter.low) / converter.span
    if converter.offset:
        height += converter.offset * generator(seed, OFFSET).standard_normal(cells)
    draw = np.empty((0, ways + 1))
    if converter.noise.any():
        draw = generator(seed, NOISE).standard_normal((cells, ways + 1))
    following = np.empty(cells, dtype=np.int64)
    step_down(height, converter.noise, draw, converter.steps, converter.falling, neighbours.around, following)
    return arrivals_along(following, neighbours)


def arrivals_along(following: NDArray[np.int64], neighbours: Neighbours) -> NDArray[np.bool_]:
    """Which cells lead to a goal when every cell leads to the one given, -1 for none; shape (cells,)."""
    from resgrid.chip.kernels import follow

    reached = np.empty(len(following), dtype=np.bool_)
    follow(following, neighbours.goal, reached)
    return reached


@dataclass(frozen=True, eq=False)
class Experiment:
    """A kind of chip, and the read-outs that are tried on every chip of it.

    `netlist`: the ideal one, with one node per cell; `seed`: trial ``k`` is chip ``(seed, k)``; `starts` (cells,):
    where robots start; `converters`: one for each read-out; None for an ideal one; `batch`: what chips that differ in
    their conductances only share; `volts` (nodes,): voltages where all chips are the same, and some read-out is not
    ideal.
    """

    netlist: Netlist
    chip: Chip
    seed: Seed
    neighbours: Neighbours
    starts: NDArray[np.bool_]
    converters: tuple[Converter | None, ...]
    batch: Batch | None
    volts: NDArray[np.float64] | None

    @property
    def random(self) -> bool:
        """Whether trials differ."""
        return differs(self.chip) or any(seen is not None and seen.random for seen in self.converters)

    def fingerprint(self) -> str:
        """A hash of everything that trials depend on, hexadecimal."""
        digest = hashlib.sha256(f"{_SCHEMA} {self.seed} {self.chip}".encode())
        digest.update(self.starts.tobytes())
        digest.update(self.neighbours.around.tobytes())
        for item in dataclasses.fields(Netlist):
            value = getattr(self.netlist, item.name)
            if isinstance(value, np.ndarray):
                digest.update(item.name.encode() + value.tobytes())
        for seen in self.converters:
            digest.update(repr(seen and (seen.low, seen.span, seen.steps, seen.offset)).encode())
        return digest.hexdigest()


def differs(chip: Chip) -> bool:
    """Whether chips of a kind differ from each other."""
    return bool(chip.mismatch or chip.pelgrom or Faults.of(chip, 0))


def die_temperature(chip: Chip) -> float:
    """Temperature of the die, in kelvin."""
    return ROOM if chip.temperature is None else ROOM + chip.temperature - NOMINAL_CELSIUS


def prepare(
    netlist: Netlist,
    chip: Chip,
    readouts: Sequence[Readout],
    seed: Seed | None = None,
    starts: NDArray[np.bool_] | None = None,
    known: MutableMapping[tuple[Chip, float], NDArray[np.float64]] | None = None,
) -> Experiment:
    """Precompute everything that does not depend on the trial.

    Shapes: `starts` as the space.  `known`: noise of flawless chips of the same space, by the chip and the bandwidth;
    new ones are added.
    """
    cells = cells_with_nodes(netlist, "robots that see the read-out")
    mask = cells.space.goal_connected if starts is None else cells.space.goal_connected & starts
    if not mask.any():
        raise InputError("there is no start: no free cell has a way to a goal")
    flawless = dataclasses.replace(chip, mismatch=None, pelgrom=None, defects=Defects())
    op = solve(build_chip(netlist, flawless))
    bands = {readout.noise_bandwidth for readout in readouts if readout.noise_bandwidth is not None}
    known = {} if known is None else known
    for band in bands:
        if (flawless, band) not in known:
            known[flawless, band] = _noise(op, chip, band)
    noise = {band: known[flawless, band] for band in bands}
    converters = tuple(
        None if _is_ideal(readout) else converter_of(readout, cells, noise.get(readout.noise_bandwidth or 0.0))
        for readout in readouts
    )
    blurred = any(converter is not None for converter in converters)
    linear = chip.saturation_voltage is None and not Faults.of(chip, 0)
    batch = blurred and linear and differs(chip)
    return Experiment(
        netlist=netlist,
        chip=chip,
        seed=seed_of(chip.seed if seed is None else seed),
        neighbours=neighbours_of(cells),
        starts=mask.ravel(),
        converters=converters,
        batch=prepare_batch(conductance_samples(netlist, [], chip=chip)[0]) if batch else None,
        volts=op.voltage if blurred and not differs(chip) else None,
    )


def run_trials(experiment: Experiment, numbers: Sequence[int]) -> list[NDArray[np.uint8]]:
    """Which starts are served, for every read-out of every chip: bits, shape (readouts, bytes) (`unpacked`)."""
    base = experiment.seed if isinstance(experiment.seed, tuple) else (experiment.seed,)
    results: list[NDArray[np.uint8]] = []
    starts = int(experiment.starts.sum())
    for begin in range(0, len(numbers), _TOGETHER):
        seeds = [(*base, number) for number in numbers[begin : begin + _TOGETHER]]
        served = np.zeros((len(seeds), len(experiment.converters), -(-starts // 8)), dtype=np.uint8)
        for trial, readout, cells in _walks(experiment, seeds):
            served[trial, readout] = np.packbits(cells[experiment.starts])
        results += list(served)
    return results


def unpacked(bits: NDArray[np.uint8], starts: int) -> NDArray[np.bool_]:
    """Whether each start is served, shape (readouts, starts)."""
    return np.unpackbits(bits, axis=-1, count=starts).view(np.bool_)


class Series(NamedTuple):
    """Trials of one kind of chip: how many, through how many read-outs, and what they share when it is their turn."""

    trials: int
    readouts: int
    prepare: Callable[[], Experiment]
    name: str = "chips"
    random: bool = True


def run_series(
    series: Sequence[Series], starts: int, executor: Executor | None, journal: Journal | None
) -> Generator[tuple[NDArray[np.bool_], bool], None, None]:
    """Whether each start is served, shape (readouts, starts), chip by chip, and whether the chip is new.

    Those in the journal come first; the others are added to it.
    """
    readouts = [each.readouts for each in series for _ in range(each.trials)]
    done = 0
    for record in journal or ():
        assert journal is not None
        try:
            served = _recorded(record, done, (readouts[done], starts))
        except (KeyError, TypeError, ValueError, zlib.error) as error:
            why = f"the key {error} is missing" if isinstance(error, KeyError) else error
            raise journal.damaged(f"line {done + 2}: {why}") from error
        yield served, False
        done += 1
    with closing(in_order(_parts(series, done), executor)) as results:
        for number, bits in enumerate(results, done):
            served = unpacked(bits, starts)
            if journal is not None:
                text = base64.b64encode(zlib.compress(bits.tobytes())).decode()
                journal.append({"chip": number, "served": int(served.sum()), "starts": text})
            yield served, True


def _recorded(record: Mapping[str, Any], number: int, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """What a line of a journal says of a chip, shape (readouts, starts)."""
    data = zlib.decompress(base64.b64decode(record["starts"], validate=True))
    bits = np.frombuffer(data, dtype=np.uint8).reshape(shape[0], -1)
    if bits.shape[1] != -(-shape[1] // 8) or (record["chip"], record["served"]) != (number, np.unpackbits(bits).sum()):
        raise ValueError("its parts do not agree")
    return unpacked(bits, shape[1])


def _parts(series: Sequence[Series], done: int) -> Iterator[JobPart]:
    """The trials of all series but the first ones, which are `done`."""
    for each in series:
        if done < each.trials:
            yield JobPart(run_trials, each.prepare(), range(done, each.trials), each.name)
        done = max(0, done - each.trials)


def _walks(experiment: Experiment, seeds: Sequence[Seed]) -> Iterator[tuple[int, int, NDArray[np.bool_]]]:
    """Numbers of the trial and of the read-out, and which cells lead to a goal."""
    ideal = [number for number, seen in enumerate(experiment.converters) if seen is None]
    if ideal:
        once = None if differs(experiment.chip) else _ideal_walk(experiment, experiment.seed)
        for trial, seed in enumerate(seeds):
            arrived = _ideal_walk(experiment, seed) if once is None else once
            yield from ((trial, number, arrived) for number in ideal)
    if len(ideal) == len(experiment.converters):
        return
    for trial, (seed, volts) in enumerate(zip(seeds, _voltages(experiment, seeds), strict=True)):
        for number, seen in enumerate(experiment.converters):
            if seen is not None:
                yield trial, number, arrivals(volts, experiment.neighbours, seen, seed)


def _ideal_walk(experiment: Experiment, seed: Seed) -> NDArray[np.bool_]:
    try:
        op = solve(build_chip(experiment.netlist, experiment.chip, seed))
    except CircuitError:  # so broken that nothing flows
        return experiment.neighbours.goal
    return arrivals_along(steps_of(op).lowest()[0], experiment.neighbours)


def _voltages(experiment: Experiment, seeds: Sequence[Seed]) -> Iterator[NDArray[np.float64]]:
    """Node voltages of one chip after the other."""
    if experiment.volts is not None:
        yield from (experiment.volts for _ in seeds)
    elif experiment.batch is not None:
        conductance = conductance_samples(experiment.netlist, seeds, chip=experiment.chip)[1]
        yield from solve_batch(experiment.batch, conductance)
    else:
        for seed in seeds:
            try:
                netlist = build_chip(experiment.netlist, experiment.chip, seed)
                yield solve(netlist, accuracy="normwise").voltage
            except CircuitError:
                yield np.full(experiment.netlist.node_count, np.nan)


def _is_ideal(readout: Readout) -> bool:
    """Whether a robot sees what there is: currents through faces, without error."""
    return readout.bits is None and not readout.offset and readout.noise_bandwidth is None


def _noise(op: OperatingPoint, chip: Chip, bandwidth: float) -> NDArray[np.float64]:
    """Deviation of a measurement at every cell, in volts: thermal noise of the flawless chip in the read-out's band."""
    linear = linearize(op) if op.netlist.nonlinear_nodes.size else op.netlist
    noise = analyse_noise(linear, band=(0.0, bandwidth), temperature=die_temperature(chip))
    assert noise.total is not None
    node = op.netlist.cells.node.ravel()
    return np.where(node >= 0, np.nan_to_num(noise.total)[node], 0.0)
