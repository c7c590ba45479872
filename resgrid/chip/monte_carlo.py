"""Monte Carlo trials: draw random chips, solve them, and walk from every cell by read-out voltages.

The stages, in the order in which they run: `prepare_experiment` computes everything that does not depend on the trial.
`run_trials` then takes the trials in blocks: `draw_chips`, `solve_chips`, `read_out` and `walk`.  `run_series`
distributes the blocks over an executor and keeps the results in a checkpoint.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import zlib
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.checkpoints import Journal
from resgrid._internal.parallel import JobPart, in_order
from resgrid.chip.adc_resolution import steps_of
from resgrid.chip.build import ConductanceModel, build_chip
from resgrid.chip.effects import Faults
from resgrid.chip.effects.base import cells_with_nodes
from resgrid.chip.effects.values import NOMINAL_CELSIUS
from resgrid.chip.noise import NOMINAL_KELVIN, analyse_noise
from resgrid.chip.walk import Converter, Neighbours, converter_of, neighbours_of, read_out, walk
from resgrid.circuit.batch import BatchSetup, prepare_batch, solve_batch
from resgrid.circuit.nonlinear import linearize
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.solve import solve
from resgrid.core.netlist import Netlist
from resgrid.core.random_sites import Seed, seed_of
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import CircuitError, InputError
from resgrid.scene.chip import Chip, Defects, Readout

_SCHEMA = 2
"""Version number of the algorithm of the trials; a checkpoint of another version is rejected."""

_BLOCK = 16
"""Maximum number of chips that are drawn and solved together; limits the memory of a worker."""


class ChipSolution(NamedTuple):
    """Solution of one chip: the values that its read-outs need.

    `voltage` (nodes,): node voltages in volts, all NaN if the chip has no operating point; None if every read-out under
    test is ideal; `lowest` (cells,): flat index of the face neighbour with the lowest potential according to the face
    currents, -1 if no neighbour is lower; None if no read-out under test is ideal.  An ideal read-out has no
    quantization, offset or noise, and needs only `lowest`.
    """

    voltage: NDArray[np.float64] | None
    lowest: NDArray[np.int64] | None


class DrawnChips(NamedTuple):
    """A block of randomly drawn chips.

    `seeds`: seed of every chip; `conductance` (chips, resistors): conductances in siemens of chips that differ only in
    conductances and are solved as one batch, None for other chips; `netlists`: iterator over the netlists of the same
    chips, each built when it is requested.
    """

    seeds: Sequence[Seed]
    conductance: NDArray[np.float64] | None
    netlists: Iterator[Netlist]


@dataclass(frozen=True, eq=False)
class Experiment:
    """A chip description, the read-outs under test, and everything that does not depend on the trial.

    `netlist`: the ideal circuit, with one node per cell; `chip`: description of the errors; `seed`: trial ``k`` is the
    chip with the seed ``(seed, k)``; `neighbours`: face neighbours of every cell; `starts` (cells,): mask of the start
    cells; `converters`: converter of each read-out, None for an ideal read-out; `model, batch`: distribution of the
    conductances and the prepared batch solve, for chips that differ only in conductances, otherwise None; `fixed`: the
    common solution if all chips are equal, otherwise None.
    """

    netlist: Netlist
    chip: Chip
    seed: Seed
    neighbours: Neighbours
    starts: NDArray[np.bool_]
    converters: tuple[Converter | None, ...]
    model: ConductanceModel | None
    batch: BatchSetup | None
    fixed: ChipSolution | None

    @property
    def random(self) -> bool:
        """Whether trials differ: the chips are random, or a read-out has random errors."""
        return differs(self.chip) or any(converter is not None and converter.random for converter in self.converters)

    def seeds(self, numbers: Sequence[int]) -> list[Seed]:
        """Return the seeds of the trials with the given numbers."""
        base = self.seed if isinstance(self.seed, tuple) else (self.seed,)
        return [(*base, number) for number in numbers]

    def fingerprint(self) -> str:
        """Return a hexadecimal SHA-256 hash of all inputs of the trials, which identifies a checkpoint."""
        digest = hashlib.sha256(f"{_SCHEMA} {self.seed} {self.chip}".encode())
        digest.update(self.starts.tobytes())
        digest.update(self.neighbours.around.tobytes())
        for item in dataclasses.fields(Netlist):
            value = getattr(self.netlist, item.name)
            if isinstance(value, np.ndarray):
                digest.update(item.name.encode() + value.tobytes())
        for each in self.converters:
            digest.update(repr(each and (each.low, each.span, each.steps, each.offset)).encode())
        return digest.hexdigest()


def differs(chip: Chip) -> bool:
    """Return whether chips of one description may differ in their circuits, by mismatch or by defects."""
    return bool(chip.mismatch or chip.pelgrom or Faults.of(chip, 0))


def die_temperature(chip: Chip) -> float:
    """Return the temperature of the die in kelvin; 300.15 K (27 degrees Celsius) if the description states none."""
    return NOMINAL_KELVIN if chip.temperature is None else NOMINAL_KELVIN + chip.temperature - NOMINAL_CELSIUS


Noises = dict[tuple[Chip, float], NDArray[np.float64]]
"""Rms noise voltages (cells,) in volts of chips without random errors, by chip description and bandwidth in hertz."""


def prepare_experiment(
    netlist: Netlist,
    chip: Chip,
    readouts: Sequence[Readout],
    seed: Seed | None = None,
    starts: NDArray[np.bool_] | None = None,
    known: Noises | None = None,
) -> Experiment:
    """Precompute everything that does not depend on the trial; return it as an Experiment.

    `netlist`: the ideal circuit; `chip`: description of the errors; `readouts`: read-outs under test; `seed`: seed of
    the trials, None for that of the chip; `starts` (shape of the space): mask of the start cells, None for all cells
    with a path to a goal; `known`: rms noise voltages (cells,) in volts, by chip description and noise bandwidth in
    hertz, to which this function adds those of this chip.
    """
    cells = cells_with_nodes(netlist, "robots that see the read-out")
    mask = _checked_mask(cells.space, starts)
    flawless = dataclasses.replace(chip, mismatch=None, pelgrom=None, defects=Defects())
    op = solve(build_chip(netlist, flawless))
    converters = _converters(op, chip, flawless, readouts, {} if known is None else known)
    has_ideal, has_real = None in converters, any(converter is not None for converter in converters)
    model = batch = fixed = None
    if not differs(chip):
        fixed = ChipSolution(op.voltage if has_real else None, _lowest(op) if has_ideal else None)
    elif has_real and chip.saturation_voltage is None and not Faults.of(chip, 0):
        model = ConductanceModel.of(netlist, chip)
        batch = prepare_batch(model.netlist)
    return Experiment(
        netlist=netlist,
        chip=chip,
        seed=seed_of(chip.seed if seed is None else seed),
        neighbours=neighbours_of(cells),
        starts=mask.ravel(),
        converters=converters,
        model=None if batch is None else model,
        batch=batch,
        fixed=fixed,
    )


def _checked_mask(space: ConfigurationSpace, starts: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
    """Return the mask of the starts with a path to a goal, shape of the space; raise InputError if there are none.

    `starts` (shape of the space): mask of the requested starts, or None for all cells.
    """
    mask = space.goal_connected if starts is None else space.goal_connected & starts
    if not mask.any():
        raise InputError("there is no start: no free cell has a path to a goal")
    return mask


def _converters(
    op: OperatingPoint, chip: Chip, flawless: Chip, readouts: Sequence[Readout], known: Noises
) -> tuple[Converter | None, ...]:
    """Return the converter of every read-out, None for an ideal one.

    `op`: operating point of the chip without random errors; `chip`: full description; `flawless`: description without
    random errors; `readouts`: read-outs; `known`: rms noise voltages (cells,) in volts from earlier calls, by chip
    description and noise bandwidth in hertz, to which new ones are added.
    """
    bands = {readout.noise_bandwidth for readout in readouts if readout.noise_bandwidth is not None}
    for band in bands:
        if (flawless, band) not in known:
            known[flawless, band] = _noise(op, chip, band)
    return tuple(
        None
        if _is_ideal(readout)
        else converter_of(readout, op.netlist.cells, known.get((flawless, readout.noise_bandwidth or 0.0)))
        for readout in readouts
    )


def _is_ideal(readout: Readout) -> bool:
    """Return whether a read-out has no quantization, offset or noise.

    With an ideal read-out the robot compares the currents through the faces of its cell instead of readings.
    """
    return readout.bits is None and not readout.offset and readout.noise_bandwidth is None


def _noise(op: OperatingPoint, chip: Chip, bandwidth: float) -> NDArray[np.float64]:
    """Return the rms thermal noise voltage of one measurement in every cell, in volts, shape (cells,).

    `op`: operating point of the chip without random errors; `chip`: gives the temperature; `bandwidth`: upper limit of
    the noise band, in hertz.  Cells without a node have noise 0.
    """
    linear = linearize(op) if op.netlist.nonlinear_nodes.size else op.netlist
    noise = analyse_noise(linear, band=(0.0, bandwidth), temperature=die_temperature(chip))
    assert noise.total is not None
    node = op.netlist.cells.node.ravel()
    return np.where(node >= 0, np.nan_to_num(noise.total)[node], 0.0)


def run_trials(experiment: Experiment, numbers: Sequence[int]) -> list[NDArray[np.uint8]]:
    """Run trials (draw chips, solve them, read them out, walk); return the starts that reach a goal in each.

    `experiment`: from `prepare_experiment`; `numbers`: numbers of the trials.  The result has one array per trial, of
    shape (readouts, bytes), with one bit for every start and read-out; `unpacked` turns it into a mask.
    """
    results: list[NDArray[np.uint8]] = []
    for begin in range(0, len(numbers), _BLOCK):
        chips = draw_chips(experiment, experiment.seeds(numbers[begin : begin + _BLOCK]))
        for seed, solution in zip(chips.seeds, solve_chips(experiment, chips), strict=True):
            served = [
                walk(following, experiment.neighbours)[experiment.starts]
                for following in _steps(experiment, solution, seed)
            ]
            results.append(np.packbits(np.array(served), axis=-1))
    return results


def draw_chips(experiment: Experiment, seeds: Sequence[Seed]) -> DrawnChips:
    """Draw the chips with the given seeds at random; return them as a DrawnChips block.

    `experiment`: gives the ideal circuit and the distribution of the errors.
    """
    conductance = None if experiment.model is None else experiment.model.draw(seeds)
    return DrawnChips(seeds, conductance, (build_chip(experiment.netlist, experiment.chip, seed) for seed in seeds))


def solve_chips(experiment: Experiment, chips: DrawnChips) -> Iterator[ChipSolution]:
    """Solve the circuits of chips that were drawn together, and yield the solution of each chip.

    `experiment`: gives the read-outs under test, which determine the values of a solution; `chips`: the chips.
    """
    converters, batch = experiment.converters, experiment.batch
    if experiment.fixed is not None:
        yield from (experiment.fixed for _ in chips.seeds)
    elif batch is None or chips.conductance is None:
        for netlist in chips.netlists:
            voltage = _voltage(netlist) if any(item is not None for item in converters) else None
            yield ChipSolution(voltage, _lowest_of(netlist) if None in converters else None)
    else:
        for voltage in solve_batch(batch, chips.conductance):
            yield ChipSolution(voltage, _lowest_of(next(chips.netlists)) if None in converters else None)


def _voltage(netlist: Netlist) -> NDArray[np.float64]:
    """Return the node voltages of a chip in volts, shape (nodes,); all NaN if the circuit has no operating point."""
    try:
        return solve(netlist, accuracy="normwise").voltage
    except CircuitError:
        return np.full(netlist.node_count, np.nan)


def _lowest_of(netlist: Netlist) -> NDArray[np.int64]:
    """Return the flat index of the lowest face neighbour of every cell of a chip by the face currents, shape (cells,).

    The index is -1 where no neighbour is lower; all indices are -1 if the chip has no operating point.
    """
    try:
        return _lowest(solve(netlist))
    except CircuitError:
        return np.full(netlist.cells.space.cell.size, -1, dtype=np.int64)


def _lowest(op: OperatingPoint) -> NDArray[np.int64]:
    """Return the flat index of the lowest face neighbour of every cell according to the face currents, shape (cells,).

    The index is -1 where no neighbour is lower than the cell.
    """
    return steps_of(op).lowest()[0]


def _steps(experiment: Experiment, solution: ChipSolution, seed: Seed) -> Iterator[NDArray[np.int64]]:
    """Yield for each read-out the flat index of the robot's next cell from every cell, shape (cells,).

    The index is -1 where the robot is stuck.  `experiment`: gives the converters of the read-outs; `solution`: solution
    of the chip; `seed`: seed of the chip, from which offsets and noise are drawn.
    """
    for converter in experiment.converters:
        following = solution.lowest
        if converter is not None:
            assert solution.voltage is not None
            following = read_out(solution.voltage, experiment.neighbours, converter, seed)
        assert following is not None
        yield following


def unpacked(bits: NDArray[np.uint8], starts: int) -> NDArray[np.bool_]:
    """Return the mask of the starts that reach a goal, shape (readouts, starts).

    `bits` (readouts, bytes): result of one trial, an entry of the list that `run_trials` returns; `starts`: number of
    starts.
    """
    return np.unpackbits(bits, axis=-1, count=starts).view(np.bool_)


class TrialSeries(NamedTuple):
    """Trials of one chip description.

    `trials`: number of trials; `readouts`: number of read-outs that each trial tests; `prepare`: function without
    arguments that returns the `Experiment`, called when the first trial runs; `name`: noun for messages, in the plural;
    `random`: whether trials differ.
    """

    trials: int
    readouts: int
    prepare: Callable[[], Experiment]
    name: str = "chips"
    random: bool = True


def run_series(
    series: Sequence[TrialSeries], starts: int, executor: Executor | None, journal: Journal | None
) -> Generator[tuple[NDArray[np.bool_], bool], None, None]:
    """Run several series of trials, and yield the result of every trial: all of the first series, then the next.

    `series`: the series; `starts`: number of starts; `executor`: workers that run blocks of trials, None for this
    process; `journal`: checkpoint file, None for no checkpoint.  A result is a pair: the mask of the starts that reach
    a goal, shape (readouts, starts), and whether the trial was run now (True) or read from the journal (False).  The
    trials in the journal come first; new trials are appended to the journal.
    """
    done = 0
    for served in _recorded_trials(series, starts, journal):
        yield served, False
        done += 1
    with closing(in_order(_remaining(series, done), executor)) as results:
        for number, bits in enumerate(results, done):
            served = unpacked(bits, starts)
            if journal is not None:
                text = base64.b64encode(zlib.compress(bits.tobytes())).decode()
                journal.append({"chip": number, "served": int(served.sum()), "starts": text})
            yield served, True


def _recorded_trials(
    series: Sequence[TrialSeries], starts: int, journal: Journal | None
) -> Iterator[NDArray[np.bool_]]:
    """Yield for every trial in a journal the mask of the starts that reach a goal, shape (readouts, starts).

    `series`: all series, in the order of the journal; `starts`: number of starts; `journal`: checkpoint file, None for
    no trials.  Raises InputError for a damaged line.
    """
    readouts = [each.readouts for each in series for _ in range(each.trials)]
    for number, record in enumerate(journal or ()):
        assert journal is not None
        try:
            served = _recorded(record, number, (readouts[number], starts))
        except (KeyError, TypeError, ValueError, zlib.error) as error:
            why = f"the key {error} is missing" if isinstance(error, KeyError) else error
            raise journal.damaged(f"line {number + 2}: {why}") from error
        yield served


def _recorded(record: Mapping[str, Any], number: int, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the mask of the starts that reach a goal from a line of a journal, shape (readouts, starts).

    `record`: the parsed line with the keys ``chip`` (trial number), ``served`` (count) and ``starts`` (packed mask);
    `number`: expected trial number; `shape`: numbers of read-outs and starts. Raises ValueError for a contradiction.
    """
    data = zlib.decompress(base64.b64decode(record["starts"], validate=True))
    bits = np.frombuffer(data, dtype=np.uint8).reshape(shape[0], -1)
    if bits.shape[1] != -(-shape[1] // 8) or (record["chip"], record["served"]) != (number, np.unpackbits(bits).sum()):
        raise ValueError("its parts do not agree")
    return unpacked(bits, shape[1])


def _remaining(series: Sequence[TrialSeries], done: int) -> Iterator[JobPart]:
    """Yield the remaining trials of every series as a JobPart, without the first `done` trials of all series together.

    A JobPart is the function `run_trials` with its arguments.  `series`: all series, in order.
    """
    for each in series:
        if done < each.trials:
            yield JobPart(run_trials, each.prepare(), range(done, each.trials), each.name)
        done = max(0, done - each.trials)
