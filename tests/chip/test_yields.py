"""Yields of robots that see only the read-out, against a robot simulated step by step; parallel and resumed runs.

Tests internals: `resgrid.chip.figures_of_merit`, `resgrid.chip.monte_carlo`, `resgrid.chip.report`,
`resgrid.chip.walk`, `resgrid.core.random_sites`.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.executors import two_workers
from support.spaces import space_of, spaces

import resgrid as rg
from resgrid.chip.figures_of_merit import effective_trials, wilson
from resgrid.chip.monte_carlo import prepare_experiment, run_trials, unpacked
from resgrid.chip.report import checkpoints_beside
from resgrid.chip.walk import converter_of, neighbours_of, reaches_goal
from resgrid.core.random_sites import NOISE, OFFSET, generator


def random_space(side: int = 12, seed: int = 0, density: float = 0.1) -> rg.ConfigurationSpace:
    rng = np.random.default_rng(seed)
    cell = (rng.random((side, side)) < density).astype(np.uint8)
    cell[side // 3, side // 2] = 2
    return space_of(cell)


def robot_reaches_goal(
    netlist: rg.Netlist, volts: np.ndarray, readout: rg.chip.Readout, start: tuple[int, ...], offset: np.ndarray,
    noise: np.ndarray,
) -> bool:  # fmt: skip
    """Return whether one robot reaches a goal, cell by cell, by the documented rules."""
    cell_map = netlist.cell_map
    space = cell_map.space
    rails = sorted((cell_map.wiring.goal_voltage, cell_map.wiring.goal_voltage + cell_map.wiring.supply))
    low, high = readout.range or rails
    turned = -1 if cell_map.wiring.supply < 0 else 1

    def measure(cell: tuple[int, ...], error: float) -> float:
        seen = volts[cell_map.node[cell]] + offset[cell] + error
        if readout.bits is None:
            return turned * seen
        step = np.floor((seen - low) / (high - low) * 2**readout.bits)
        return turned * float(np.clip(step, 0, 2**readout.bits - 1))

    here, been = start, set()
    while space.cell[here] != 2:
        if here in been:
            return False
        been.add(here)
        best, lowest = None, measure(here, noise[(*here, -1)])
        for axis in range(space.ndim):
            for side, step in enumerate((-1, 1)):
                there = list(here)
                there[axis] += step
                if space.axes[axis].periodic:
                    there[axis] %= space.shape[axis]
                elif not 0 <= there[axis] < space.shape[axis]:
                    continue
                if space.cell[tuple(there)] == 1:
                    continue
                reading = measure(tuple(there), noise[(*here, 2 * axis + side)])
                if reading < lowest:
                    best, lowest = tuple(there), reading
        if best is None:
            return False
        here = best
    return True


@settings(max_examples=25)
@given(spaces(max_cells=6, conductive=False), st.integers(0, 1000), st.sampled_from([1.0, -2.5]))
def test_reached_goals_equal_those_of_the_robot_simulated_step_by_step(
    space: rg.ConfigurationSpace, seed: int, supply: float
) -> None:
    try:
        netlist = rg.study(space, rg.Chip(supply=supply)).ideal
        volts = rg.solve(netlist).voltage
    except rg.CircuitError:  # no part of the circuit is driven
        return
    rng = np.random.default_rng(seed)
    readout = rg.chip.Readout(
        bits=[None, 3, 6, 10][rng.integers(4)],
        offset=[None, 0.01][rng.integers(2)],
        noise_bandwidth=[None, 1.0][rng.integers(2)],
        range=[None, (-0.1, 0.8)][rng.integers(2)],
    )
    sigma = np.full(space.cell.size, 0.02 if readout.noise_bandwidth else 0.0)
    converter = converter_of(readout, netlist.cells, sigma)
    ways = 2 * space.ndim + 1
    offset, noise = np.zeros(space.shape), np.zeros((*space.shape, ways))
    if readout.offset:
        offset = 0.01 * generator((seed, 0), OFFSET).standard_normal(space.shape)
    if readout.noise_bandwidth:
        noise = 0.02 * generator((seed, 0), NOISE).standard_normal((*space.shape, ways))
    found = reaches_goal(volts, neighbours_of(netlist.cells), converter, (seed, 0)).reshape(space.shape)
    for start in map(tuple, np.argwhere(space.goal_connected).tolist()):
        assert found[start] == robot_reaches_goal(netlist, volts, readout, start, offset, noise)


@settings(max_examples=15)
@given(spaces(max_cells=7), st.sampled_from(["dirichlet", "neumann"]), st.sampled_from([None, 0.2]))
def test_an_ideal_readout_serves_every_start_with_a_path(
    space: rg.ConfigurationSpace, boundary: str, mismatch: float | None
) -> None:
    chip = rg.Chip(mismatch=mismatch)
    try:
        netlist = rg.study(space, chip, boundary=boundary).ideal
        result = rg.study(netlist, chip).yields(trials=3, batch=3)
    except rg.CircuitError:
        return
    except rg.InputError as error:
        assert "no start" in str(error)
        return
    driven = ~np.isin(netlist.cell_map.node, rg.solve(netlist).undriven)
    assert np.all(result.probability[space.goal_connected & driven] == 1.0)
    if driven[space.goal_connected].all():
        assert result.overall.value == result.perfect.value == 1.0
    if mismatch is None:
        assert (result.trials, result.overall.low) == (1, result.overall.value)


def test_fewer_bits_never_raise_the_yield() -> None:
    bits = range(20, 0, -1)
    for seed in range(40):
        space = random_space(int(np.random.default_rng(seed).integers(4, 16)), seed, (seed % 4) / 10)
        if not space.goal_connected.any():
            continue
        for boundary in ("dirichlet", "neumann"):
            chip = rg.Chip(mismatch=0.05)
            netlist = rg.study(space, chip, boundary=boundary).ideal
            experiment = prepare_experiment(netlist, chip, [rg.chip.Readout(bits=b) for b in bits])
            starts = int(experiment.starts.sum())
            served = sum(unpacked(bits, starts).sum(axis=1) for bits in run_trials(experiment, range(2)))
            assert np.all(np.diff(served) <= 0)
            assert served[0] > served[-1] or served[0] == 2 * experiment.starts.sum()


def test_leaks_lower_the_yield_of_an_ideal_readout() -> None:
    """A load on every node creates local minima of the voltage, where robots get stuck."""
    chip = rg.Chip(readout=rg.chip.Readout(input_resistance=50e3))
    cell = np.zeros((16, 16), dtype=np.uint8)
    cell[1, 1] = 2
    netlist = rg.study(space_of(cell), chip).ideal
    result = rg.study(netlist, chip).yields()
    assert 0.0 < result.overall.value < 1.0


def test_yield_with_opens_equals_robots_simulated_on_every_chip() -> None:
    chip = rg.Chip(defects=rg.chip.Defects(open_density=0.3), seed=4)
    netlist = rg.study(random_space(), chip).ideal
    result = rg.study(netlist, chip).yields(trials=20, batch=20)
    assert 0.3 < result.overall.value < 1.0
    assert result.perfect.value < result.overall.value
    reached = np.zeros(result.space.shape)
    for trial in range(20):
        point = rg.solve(rg.chip.build_chip(netlist, chip, (4, trial)))
        volts = point.voltage[netlist.cells.node]
        zero = np.zeros(result.space.shape)
        for start in map(tuple, np.argwhere(result.starts).tolist()):
            noise = np.zeros((*result.space.shape, 5))
            reached[start] += not np.isnan(volts[start]) and robot_reaches_goal(
                netlist, point.voltage, rg.chip.Readout(), start, zero, noise
            )
    assert np.abs(reached - result.reached).sum() <= 0.01 * result.reached.sum()


def test_the_interval_is_that_of_wilson_with_chips_as_clusters() -> None:
    low, high = wilson(0.5, 100, 0.95)
    assert (low, high) == pytest.approx((0.40383, 0.59617), abs=1e-5)  # Wilson 1927; tables of Newcombe 1998
    assert wilson(1.0, 10, 0.95)[0] == pytest.approx(1 / (1 + 1.959964**2 / 10))
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(300):
        shares = rng.beta(8, 2, 40)  # chips differ
        counts = rng.binomial(50, shares)
        n = effective_trials(counts, 50)
        low, high = wilson(counts.sum() / 2000, n, 0.95)
        inside += low <= 0.8 <= high
    assert 0.92 <= inside / 300 <= 0.98
    assert effective_trials(np.full(40, 12), 50) == 40
    assert effective_trials(np.array([7]), 50) == 1


CHIP = rg.Chip(
    mismatch=0.03, goal_switch_on=500.0, readout=rg.chip.Readout(bits=8, offset=1e-3, noise_bandwidth=1e9), seed=7
)


def numbers(result: rg.chip.Yield) -> tuple[object, ...]:
    return (result.trials, result.reached.tolist(), result.served.tolist())


@pytest.mark.slow
def test_trials_are_independent_chips_with_the_same_results_on_every_executor(processes: Executor) -> None:
    made = rg.study(random_space(), CHIP)
    alone = made.yields(trials=40, batch=20, half_width=1e-4)
    assert alone.trials == 40
    with ThreadPoolExecutor(2) as threads:
        assert numbers(made.yields(trials=40, batch=20, half_width=1e-4, executor=threads)) == numbers(alone)
    assert numbers(made.yields(trials=40, batch=20, half_width=1e-4, executor=processes)) == numbers(alone)
    other = made.yields(trials=40, batch=20, half_width=1e-4, seed=8)
    assert numbers(other) != numbers(alone)
    one = rg.chip.build_chip(made.ideal, CHIP, (7, 3))
    experiment = prepare_experiment(made.ideal, CHIP, [CHIP.readout])
    by_hand = (
        reaches_goal(rg.solve(one).voltage, experiment.neighbours, experiment.converters[0], (7, 3)) & experiment.starts
    )
    served = unpacked(run_trials(experiment, [3])[0], int(experiment.starts.sum()))[0]
    np.testing.assert_array_equal(served, by_hand[experiment.starts])


def test_trials_stop_at_the_first_batch_with_the_requested_half_width() -> None:
    made = rg.study(random_space(), CHIP)
    reports = []
    result = made.yields(
        half_width=0.006, batch=16, progress=lambda done, total, share: reports.append((done, total, share))
    )
    assert [done for done, _, _ in reports] == list(range(16, result.trials + 1, 16))
    assert all(share.half_width > 0.006 for _, _, share in reports[:-1])
    assert reports[-1][2].half_width <= 0.006
    assert reports[-1][2] == result.overall
    assert all(done <= total for done, total, _ in reports)
    assert result.trials < 10_000


_SCRIPT = """
import sys, time
sys.path.insert(0, {tests!r})
import resgrid as rg
from test_yields import CHIP, numbers, random_space
made = rg.study(random_space(), CHIP)
def pause(done, *_):
    if done >= {most}:
        print("here", flush=True)
        time.sleep(600)

result = made.yields(trials=400, batch=10, half_width=1e-4, checkpoint={checkpoint!r}, progress=pause)
print(numbers(result))
"""


@pytest.mark.slow
def test_a_killed_run_resumes_from_its_checkpoint_with_the_same_results(tmp_path: Path) -> None:
    here = Path(__file__).parent
    checkpoint = tmp_path / "chips.jsonl"
    words = {"tests": str(here), "checkpoint": str(checkpoint)}
    environment = {**os.environ, "PYTHONPATH": f"{here.parent}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    sizes = []
    for most in (30, 120):
        slow = subprocess.Popen(
            [sys.executable, "-c", _SCRIPT.format(**words, most=most)],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        assert slow.stdout is not None
        slow.stdout.readline()  # the run has reported this number of trials and pauses
        slow.send_signal(signal.SIGKILL)
        _, errors = slow.communicate()
        assert checkpoint.exists(), errors.decode()
        sizes.append(checkpoint.read_bytes().count(b"\n") - 1)
    assert 0 < sizes[0] < sizes[1] < 400
    made = rg.study(random_space(), CHIP)
    resumed = made.yields(trials=400, batch=10, half_width=1e-4, checkpoint=checkpoint)
    whole = made.yields(trials=400, batch=10, half_width=1e-4, checkpoint=tmp_path / "whole.jsonl")
    assert numbers(resumed) == numbers(whole)
    assert checkpoint.read_bytes() == (tmp_path / "whole.jsonl").read_bytes()
    assert numbers(made.yields(trials=400, batch=10, half_width=1e-4, checkpoint=checkpoint)) == (numbers(whole))


def test_a_run_that_ended_within_a_batch_is_resumed_at_its_last_trial(tmp_path: Path) -> None:
    made = rg.study(random_space(), CHIP)
    checkpoint = tmp_path / "chips.jsonl"
    rule = {"batch": 7, "half_width": 0.02}
    once = made.yields(trials=200, **rule)
    assert 10 < once.trials < 200
    for trials in (3, 10):
        assert made.yields(trials=trials, checkpoint=checkpoint, **rule).trials == trials
    reports: list[int] = []
    resumed = made.yields(trials=200, checkpoint=checkpoint, **rule, progress=lambda done, *_: reports.append(done))
    assert reports == list(range(14, once.trials + 1, 7))
    assert numbers(resumed) == numbers(once)
    assert numbers(made.yields(trials=5, checkpoint=checkpoint, **rule)) == numbers(made.yields(trials=5, **rule))
    assert numbers(made.yields(trials=200, checkpoint=checkpoint, batch=50)) == numbers(
        made.yields(trials=200, batch=50)
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["processes", "loky", "parsl"])
def test_results_and_checkpoint_are_the_same_when_a_worker_process_is_killed(kind: str, tmp_path: Path) -> None:
    """For dask and MPI, see the tests of the command line."""
    made = rg.study(random_space(), CHIP)
    rule = {"trials": 300, "half_width": 1e-4}
    alone = made.yields(**rule, checkpoint=tmp_path / "alone.jsonl")
    died = []

    def kill(*_done: object) -> None:
        pools = getattr(executor, "_processes", None)
        if pools and not died:
            died.append(next(iter(pools)))
            os.kill(died[0], signal.SIGKILL)

    with two_workers(kind, tmp_path) as executor:
        shared = made.yields(**rule, executor=executor, checkpoint=tmp_path / "shared.jsonl", progress=kill)
    assert numbers(shared) == numbers(alone)
    assert (tmp_path / "shared.jsonl").read_bytes() == (tmp_path / "alone.jsonl").read_bytes()
    assert bool(died) == (kind in ("processes", "loky"))


def test_checkpoint_names_depend_on_everything_that_defines_the_chips(tmp_path: Path) -> None:
    space = random_space()
    costly = replace(space, conductivity=np.where(space.cell == 0, 0.5, 1.0))
    wide = replace(space, axes=tuple(replace(axis, upper=2 * axis.upper) for axis in space.axes))
    opened = [rg.Chip(defects=rg.chip.Defects(open_at=tuple((k, row, 0) for k in range(14)))) for row in (1, 2)]
    studies = [
        rg.study(space, CHIP),
        rg.study(costly, CHIP),
        rg.study(wide, CHIP),
        *(rg.study(space, c) for c in opened),
    ]
    kept = [checkpoints_beside(tmp_path / "out", made, ())["yield"] for made in studies]
    assert len(set(kept)) == len(kept)
    assert checkpoints_beside(tmp_path / "out", rg.study(random_space(), CHIP), ())["yield"] == kept[0]


def test_damaged_checkpoints_and_those_of_other_runs_raise_input_error(tmp_path: Path) -> None:
    made = rg.study(random_space(), CHIP)
    file = tmp_path / "chips.jsonl"
    made.yields(trials=10, batch=10, checkpoint=file)
    with pytest.raises(rg.InputError, match="belongs to another run"):
        made.yields(trials=10, batch=10, seed=3, checkpoint=file)
    data = file.read_bytes()
    other = data.replace(b'"served":', b'"served":1', 1)
    swapped = b"".join(data.splitlines(keepends=True)[i] for i in (0, 2, 1))
    for damaged in (b"no archive", b"[1]\n", b"\xff\xfe\n", other, swapped):
        file.write_bytes(damaged)
        with pytest.raises(rg.InputError, match="cannot read the checkpoint"):
            made.yields(trials=10, batch=10, checkpoint=file)
    file.write_bytes(data.splitlines(keepends=True)[0] + b'{"x": NaN}\n')
    with pytest.raises(rg.InputError, match="line 2: the key 'starts' is missing; remove it"):
        made.yields(trials=10, batch=10, checkpoint=file)
    with pytest.raises(rg.InputError, match="Is a directory"):
        made.yields(trials=10, batch=10, checkpoint=tmp_path)
    with pytest.raises(rg.InputError, match="there is no folder"):
        made.yields(trials=10, batch=10, checkpoint=tmp_path / "none" / "chips.jsonl")


def test_invalid_arguments_of_yields_raise_input_error() -> None:
    made = rg.study(random_space(), CHIP)
    for options, message in (
        ({"half_width": 0.0}, "half_width"),
        ({"confidence": 1.0}, "confidence"),
        *(({"trials": value}, "trials = ") for value in (0, np.nan, np.inf, 2.5, "x", None, True)),
        *(({"batch": value}, "batch = ") for value in (0, np.inf, 2.5, "x", None)),
        *(({"half_width": value}, "half_width = ") for value in (np.nan, "x", None, 0.5)),
        *(({"confidence": value}, "confidence = ") for value in (np.nan, "x", None)),
        ({"seed": -1}, "seed"),
        ({"starts": [True]}, "starts must be"),
        ({"starts": np.zeros((12, 12), dtype=bool)}, "no start"),
    ):
        with pytest.raises(rg.InputError, match=message):
            made.yields(**options)  # type: ignore[arg-type]
    with pytest.raises(rg.InputError, match="one node per cell"):
        rg.study(rg.compile_space(random_space()), CHIP).yields()


def test_yield_json_has_definitions_and_intervals_contain_the_probability() -> None:
    made = rg.study(random_space(), CHIP)
    result = made.yields(trials=32, batch=32)
    data = result.to_json()
    assert data["yield"]["value"] == pytest.approx(np.nanmean(result.probability))
    assert all(entry["definition"] for entry in data.values() if isinstance(entry, dict))
    low, high = result.interval
    inside = result.starts
    assert np.all(low[inside] <= result.probability[inside] + 1e-12)
    assert np.all(high[inside] >= result.probability[inside] - 1e-12)
    assert np.isnan(low[~inside]).all()


@pytest.mark.parametrize("bits", [1, 8, 32])
@pytest.mark.parametrize("volts", [1.0, 1e10, 1e300, np.inf])
def test_every_voltage_above_the_range_reads_full_scale(bits: int, volts: float) -> None:
    netlist = rg.compile_space(
        space_of(np.array([[2], [0]], dtype=np.uint8)), rails="cells", edge="open", boundary="neumann"
    )
    high = np.zeros(netlist.node_count)
    high[netlist.cells.node[1, 0]] = volts
    neighbours, converter = neighbours_of(netlist.cells), converter_of(rg.chip.Readout(bits=bits), netlist.cells, None)
    assert reaches_goal(high, neighbours, converter).all()
    assert not reaches_goal(-high, neighbours, converter)[1]
