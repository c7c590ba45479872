"""Threads within one solve: results equal to those of one thread to the bit, and no threads left after errors.

Tests internals: `resgrid.solvers`, `resgrid.solvers.multigrid`, `resgrid.solvers.multigrid.levels`,
`resgrid.solvers.threads`.
"""

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numba import njit
from numpy.typing import NDArray
from support.spaces import space_of

import resgrid as rg
from resgrid.solvers import llvm_intrinsics, method_choice
from resgrid.solvers.multigrid import hierarchy, krylov, levels
from resgrid.solvers.multigrid.levels import Slab
from resgrid.solvers.threads import ThreadTeam

SHAPES = [(448, 384), (56, 64, 48)]
WIRINGS = [{}, {"boundary": "neumann"}, {"boundary": "wall", "wall_resistance": 2e4}]


ROWS = dict(method_choice.THREADED_ROWS)


@pytest.fixture(autouse=True, scope="module")
def small_problems_use_threads() -> Iterator[None]:
    """Use several threads also for small problems."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(method_choice, "THREADED_ROWS", dict.fromkeys(ROWS, 0))
        yield


def room(shape: tuple[int, ...], seed: int, *, rings: bool = False) -> rg.ConfigurationSpace:
    """Space with random boxes and a goal in the first corner."""
    rng = np.random.default_rng(seed)
    cell = np.zeros(shape, dtype=np.uint8)
    while np.mean(cell) < 0.2:
        low = rng.integers(0, shape)
        size = rng.integers(1, np.array(shape) // 6 + 2)
        cell[tuple(slice(a, a + b) for a, b in zip(low, size, strict=True))] = 1
    cell[(slice(0, 3),) * len(shape)] = 0
    cell[(1,) * len(shape)] = 2
    return space_of(cell, periodic=(rings,) * len(shape))


def maze(width: int, size: int) -> rg.ConfigurationSpace:
    """Walls with random gaps: coarse grids have additional nodes outside the lattice."""
    rng = np.random.default_rng(width)
    cell = np.zeros((size, size), dtype=np.uint8)
    cell[width :: width + 1] = 1
    for row in range(width, size, width + 1):
        for gap in rng.integers(0, size - width, 8):
            cell[row, gap : gap + width] = 0
    cell[0, 0] = 2
    return space_of(cell)


def assert_same(one: rg.OperatingPoint, other: rg.OperatingPoint) -> None:
    """Assert that all results are equal to the bit."""
    assert one.iterations == other.iterations
    np.testing.assert_array_equal(one.voltage, other.voltage)
    np.testing.assert_array_equal(one.resistor_current, other.resistor_current)
    if one.log_drop is not None:
        np.testing.assert_array_equal(one.log_drop, other.log_drop)


@pytest.fixture
def cuts(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Record the number of slabs of every level."""
    noted: list[int] = []
    cut = hierarchy.slabs_of

    def noting(*arguments: object) -> list[Slab]:
        parts = cut(*arguments)
        noted.append(len(parts))
        return parts

    monkeypatch.setattr(hierarchy, "slabs_of", noting)
    return noted


@pytest.mark.parametrize("accuracy", ["normwise", "direction"])
@pytest.mark.parametrize("rings", [False, True])
@pytest.mark.parametrize("wiring", WIRINGS)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.quick_cases(8)
def test_results_do_not_depend_on_the_number_of_threads(
    shape: tuple[int, ...], wiring: dict[str, object], rings: bool, accuracy: str, cuts: list[int]
) -> None:
    netlist = rg.compile_space(room(shape, 11, rings=rings), **wiring)
    one, *others = (
        rg.solve(netlist, accuracy=accuracy, method="multigrid", rtol=1e-4, threads=threads) for threads in (1, 3, 8)
    )
    for other in others:
        assert_same(one, other)
    assert max(cuts, default=1) > 2


@pytest.mark.parametrize("width", [3, 9])
def test_results_with_disconnected_blocks_do_not_depend_on_threads(width: int, cuts: list[int]) -> None:
    netlist = rg.compile_space(maze(width, 501), boundary="neumann")
    one, *others = (
        rg.solve(netlist, accuracy="normwise", method="multigrid", rtol=1e-8, threads=threads) for threads in (1, 2, 5)
    )
    for other in others:
        assert_same(one, other)
    assert max(cuts, default=1) > 2


@settings(max_examples=25)
@given(
    st.sampled_from([(96, 112), (160, 64), (16, 24, 32)]),
    st.integers(0, 1000),
    st.booleans(),
    st.sampled_from(WIRINGS),
    st.sampled_from([2, 3, 5]),
)
def test_results_with_thin_slabs_do_not_depend_on_threads(
    shape: tuple[int, ...], seed: int, rings: bool, wiring: dict[str, object], threads: int
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(levels, "_LEAST", 0)
        patch.setattr(levels, "_THICK", 0.1)
        patch.setattr("resgrid.solvers.multigrid.grid_level.BLOCK", 64)
        netlist = rg.compile_space(room(shape, seed, rings=rings), **wiring)
        one, other = (rg.solve(netlist, method="multigrid", threads=count) for count in (1, threads))
        assert_same(one, other)


def test_concurrent_solves_give_the_results_of_a_single_one() -> None:
    netlist = rg.compile_space(room((420, 380), 3), boundary="neumann")
    alone = rg.solve(netlist, accuracy="normwise", method="multigrid")
    with ThreadPoolExecutor(4) as pool:
        jobs = [
            pool.submit(rg.solve, netlist, accuracy="normwise", method="multigrid", threads=1 + k % 3) for k in range(8)
        ]
        for job in jobs:
            assert_same(alone, job.result())


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_an_exception_in_a_slab_ends_the_solve_and_its_threads(
    error: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    netlist = rg.compile_space(room((420, 380), 3), boundary="neumann")
    calls, part = iter(range(10**6)), krylov.sweep_colour

    def failing(*arguments: object) -> None:
        if next(calls) == 4:
            raise error("slab")
        part(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(krylov, "sweep_colour", failing)
        with pytest.raises(error, match="slab"):
            rg.solve(netlist, accuracy="normwise", method="multigrid", threads=3)
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("resgrid")]
    one, two = (rg.solve(netlist, accuracy="normwise", method="multigrid", threads=threads) for threads in (1, 2))
    assert_same(one, two)


def test_parts_are_completed_without_a_blocked_helper() -> None:
    with ThreadTeam(2) as team:
        release, done = threading.Event(), []
        assert team._pool is not None
        blocked = team._pool.submit(release.wait)
        team.run_parts(done.append, 5)
        assert sorted(done) == [0, 1, 2, 3, 4]
        release.set()
        assert blocked.result()


@pytest.mark.parametrize("in_helper", [False, True])
def test_an_error_in_any_thread_cancels_the_parts_that_have_not_begun(in_helper: bool) -> None:
    begun, failed = [], threading.Event()

    def part(number: int) -> None:
        begun.append(number)
        is_helper = threading.current_thread() is not threading.main_thread()
        if is_helper == in_helper:
            failed.set()
            raise ValueError("part")
        failed.wait()
        time.sleep(0.05)  # until the other thread has left its loop

    with ThreadTeam(2) as team, pytest.raises(ValueError, match="part"):
        team.run_parts(part, 100)
    assert len(begun) < 10


@pytest.mark.parametrize("shape", [(40, 40), (300, 300), (48, 48, 48)])
def test_small_problems_use_one_thread(shape: tuple[int, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(method_choice, "THREADED_ROWS", ROWS)
    netlist = rg.compile_space(room(shape, 3), boundary="neumann")
    alone, four = (rg.solve(netlist, accuracy="normwise", threads=threads) for threads in (1, 4))
    assert alone.threads == four.threads == 1
    assert_same(alone, four)


@pytest.mark.parametrize(("shape", "threads"), [((600, 500), 2), ((3, 400, 300), 1), ((84, 84, 84), 2)])
def test_large_grids_use_all_threads(shape: tuple[int, ...], threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(method_choice, "THREADED_ROWS", ROWS)
    cell = np.zeros(shape, dtype=np.uint8)
    cell[(0,) * len(shape)] = rg.Cell.GOAL
    netlist = rg.compile_space(space_of(cell), boundary="neumann")
    assert rg.solve(netlist, accuracy="normwise", method="multigrid", threads=2).threads == threads


def test_the_direct_method_uses_one_thread() -> None:
    netlist = rg.compile_space(room((60, 60), 3), boundary="wall", wall_resistance=2e4)
    assert rg.solve(netlist, method="direct", threads=2).threads == 1


@pytest.mark.parametrize("shape", [(26, 25, 24), (40, 41)])
def test_results_do_not_depend_on_the_order_of_parts(shape: tuple[int, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """Periodic axes with an odd number of cells have no two-colouring; parts run in reversed order."""
    rng = np.random.default_rng(3)
    space = room(shape, 3)
    periodic = tuple(n % 2 == 1 for n in shape)
    space = space_of(space.cell, periodic=periodic, conductivity=rng.uniform(0.2, 5.0, shape))
    netlist = rg.compile_space(space)
    one = rg.solve(netlist, method="multigrid")

    def backwards(_: ThreadTeam, part: Callable[[int], object], parts: int) -> None:
        for number in reversed(range(parts)):
            part(number)

    monkeypatch.setattr(ThreadTeam, "run_parts", backwards)
    assert_same(one, rg.solve(netlist, method="multigrid", threads=2))


@njit(nogil=True)
def lead(state: NDArray[np.int64], jobs: int, parts: int, done: NDArray[np.int64]) -> None:
    """Announce the jobs one by one and count executions of every part."""
    for job in range(jobs):
        llvm_intrinsics.announce(state, 0, job, 0, parts)
        part = llvm_intrinsics.claim(state)
        while part >= 0:
            done[job, part] += 1
            llvm_intrinsics.finish(state)
            part = llvm_intrinsics.claim(state)
        llvm_intrinsics.wait_for(state, parts)
        for part in range(parts):
            done[job, part] *= 10
    llvm_intrinsics.end_jobs(state)


@njit(nogil=True)
def help_with_jobs(state: NDArray[np.int64], done: NDArray[np.int64]) -> int:
    """Execute parts until the jobs end; return their number."""
    count = 0
    part = llvm_intrinsics.await_part(state)
    while part >= 0:
        done[state[llvm_intrinsics.LEVEL], part] += 1
        llvm_intrinsics.finish(state)
        count += 1
        part = llvm_intrinsics.await_part(state)
    return count


def test_every_part_is_executed_once_before_the_next_job_begins() -> None:
    state, done = np.zeros(llvm_intrinsics.PLACES, dtype=np.int64), np.zeros((300, 7), dtype=np.int64)
    llvm_intrinsics.begin_jobs(state)
    with ThreadPoolExecutor(3) as pool:
        helpers = [pool.submit(help_with_jobs, state, done) for _ in range(3)]
        lead(state, *done.shape, done)
        for helper in helpers:
            helper.result()
    assert np.all(done == 10)


def test_a_helper_returns_without_a_leader() -> None:
    state = np.zeros(llvm_intrinsics.PLACES, dtype=np.int64)
    llvm_intrinsics.begin_jobs(state)
    assert help_with_jobs(state, np.zeros((1, 1), dtype=np.int64)) == 0
