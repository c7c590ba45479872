"""Work on executors: the same results in order for every executor, order of completion and death of workers.

Tests internals: `resgrid._internal.parallel`.
"""

from __future__ import annotations

import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from distributed import LocalCluster
from hypothesis import given, settings, strategies as st
from support.executors import Shuffled, deadly_sums, dying_sums, failing_sums, slow_sums, squared, sums, two_workers

import resgrid as rg
from resgrid._internal.parallel import JobPart, in_order

REAL = ["processes", "forkserver", "loky", "dask"]


@settings(max_examples=15)
@given(
    st.lists(st.integers(0, 10), max_size=4), st.integers(0, 2**32), st.booleans(), st.sampled_from([sums, slow_sums])
)
def test_results_are_in_order_for_every_order_of_completion(
    lengths: list[int], seed: int, remote: bool, function: Any
) -> None:
    shared = [{"offset": 100 * k, "ballast": bytes(200_000)} for k in range(len(lengths))]
    parts = [
        JobPart(function, value, range(k, k + n)) for k, (value, n) in enumerate(zip(shared, lengths, strict=True))
    ]
    expected = list(in_order(parts))
    with Shuffled(seed, remote=remote) as executor, pytest.MonkeyPatch.context() as patch:
        if remote:  # a constant clock keeps the number of submitted tasks independent of the machine
            patch.setattr("resgrid._internal.parallel.time", SimpleNamespace(perf_counter=lambda: 0.0))
        assert list(in_order(iter(parts), executor)) == expected
    heavy = sum(size > 200_000 for size in executor.sizes)
    assert heavy <= 4 * len(lengths) if remote else heavy == 0


@pytest.mark.slow
def test_shared_data_is_sent_only_a_few_times_to_workers_without_the_file() -> None:
    shared = {"offset": 1, "ballast": np.random.default_rng(0).bytes(100_000)}
    with Shuffled(0, remote=True) as executor:
        assert list(in_order([JobPart(slow_sums, shared, range(200))], executor)) == list(range(1, 201))
    assert len(executor.sizes) > 10
    assert sum(size > 100_000 for size in executor.sizes) <= 4


@pytest.mark.slow
@pytest.mark.parametrize("kind", REAL)
def test_tasks_of_a_killed_worker_are_repeated(kind: str, tmp_path: Path) -> None:
    shared = {"offset": 5, "mark": str(tmp_path / "died")}
    with two_workers(kind, tmp_path) as executor:
        assert list(in_order([JobPart(dying_sums, shared, range(60))], executor)) == list(range(5, 65))
    assert (tmp_path / "died").exists()


@pytest.mark.slow
@pytest.mark.parametrize("kind", REAL)
def test_items_that_kill_every_worker_raise_worker_error_with_their_range(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("resgrid._internal.parallel._SECONDS_WITHOUT_WORKERS", 20.0)
    with (
        two_workers(kind, tmp_path) as executor,
        pytest.raises(rg.WorkerError, match=r"computing chips (\d) to (\d+) .*memory|all workers .* gone") as caught,
    ):
        list(in_order([JobPart(deadly_sums, {"offset": 0}, range(12), "chips")], executor))
    if kind == "dask" and "all workers" in str(caught.value):  # dask gives up a worker that dies while it starts
        return
    words = str(caught.value).split()
    first, last = (int(words[words.index("chips") + k]) for k in (1, 3))
    assert first <= 7 <= last


@pytest.fixture
def cluster() -> Iterator[LocalCluster]:
    """A dask scheduler with one worker, both threads of this process."""
    with LocalCluster(
        n_workers=1,
        processes=False,
        protocol="tcp://",
        dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
    ) as started:
        yield started


def test_a_dask_scheduler_that_loses_all_workers_raises_worker_error(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("resgrid._internal.parallel._SECONDS_BETWEEN_COUNTS", 0.05)
    monkeypatch.setattr("resgrid._internal.parallel._SECONDS_WITHOUT_WORKERS", 0.5)
    with rg.open_executor(cluster.scheduler_address.replace("tcp", "dask")) as executor:
        results = in_order([JobPart(slow_sums, {"offset": 0}, range(10_000))], executor)
        assert next(results) == 0
        cluster.scale(0)
        with pytest.raises(rg.WorkerError, match=r"all workers of the dask scheduler have gone.* in 0\.5 s"):
            list(results)


def test_a_dask_executor_without_workers_shuts_down_with_unfinished_calls(cluster: LocalCluster) -> None:
    with rg.open_executor(cluster.scheduler_address.replace("tcp", "dask")) as executor:
        assert executor.submit(sums, {"offset": 0}, [1]).result() == [1]
        cluster.scale(0)
        while cluster.scheduler.workers:
            time.sleep(0.01)
        unfinished = executor.submit(sums, {"offset": 0}, [2])
    assert not unfinished.done() or unfinished.cancelled()


def test_a_task_that_fails_inside_dask_is_sent_again() -> None:
    """Dask may raise ValueError on an invalid result while it cancels tasks; ValueError of the task is still raised."""
    cascade: dict[str, object] = {"__name__": "distributed.cfexecutor"}
    exec("def fetch(result):\n    typ, exc, tb = result", cascade)

    class Forgetful(ThreadPoolExecutor):
        forgotten = False

        def submit(self, function: Callable[..., Any], /, *given: Any, **options: Any) -> Future[Any]:
            if self.forgotten:
                return super().submit(function, *given, **options)
            self.forgotten = True
            return super().submit(cascade["fetch"], (1, 2))

    def unpacked(_offset: object, _items: object) -> None:
        _first, _second, _third = (1, 2)

    with Forgetful(1) as executor:
        assert list(in_order([JobPart(sums, {"offset": 1}, range(3))], executor)) == [1, 2, 3]
        with pytest.raises(ValueError, match="to unpack"):
            list(in_order([JobPart(unpacked, {"offset": 1}, range(3))], executor))


def test_a_broken_executor_that_cannot_be_restarted_raises_worker_error() -> None:
    def broken() -> None:
        raise RuntimeError("no thread starts")

    with (
        ThreadPoolExecutor(1, initializer=broken) as executor,
        pytest.raises(rg.WorkerError, match="ThreadPoolExecutor cannot be restarted"),
    ):
        list(in_order([JobPart(sums, {"offset": 0}, range(3))], executor))


def test_an_executor_that_cancels_all_tasks_raises_worker_error() -> None:
    class Closing(ThreadPoolExecutor):
        def submit(self, *_work: Any) -> Future[Any]:
            future: Future[Any] = Future()
            future.cancel()
            future.set_running_or_notify_cancel()
            return future

    with pytest.raises(rg.WorkerError, match="Closing cannot be restarted"):
        list(in_order([JobPart(sums, {"offset": 0}, range(3))], Closing(1)))


@pytest.mark.parametrize("threads", [True, False])
def test_the_exception_of_an_item_is_raised_at_its_position(threads: bool) -> None:
    with ThreadPoolExecutor(2) if threads else Shuffled(0) as executor:
        results = in_order([JobPart(failing_sums, {"offset": 0}, range(20))], executor)
        seen = []
        with pytest.raises(ValueError, match="item 7"):
            for result in results:
                seen.append(result)
    assert seen == list(range(len(seen))) and len(seen) <= 7


def test_closing_the_results_cancels_tasks_that_have_not_begun() -> None:
    began = []

    def work(_shared: None, items: Any) -> list[int]:
        began.extend(items)
        time.sleep(0.02)
        return list(items)

    with ThreadPoolExecutor(1) as executor:
        results = in_order([JobPart(work, None, range(10_000))], executor)
        assert next(results) == 0
        results.close()
    assert len(began) < 100


@pytest.mark.parametrize("dying", [0, 1])
def test_a_pool_shuts_down_when_a_worker_is_killed_meanwhile(dying: int) -> None:
    """One of two idle workers holds the lock of their queue while the pool shuts down."""
    opened = rg.open_executor("processes:2")
    executor: Any = opened.__enter__()
    assert list(executor.map(slow_sums, [{"offset": 0}] * 4, [[k] for k in range(4)])) == [[0], [1], [2], [3]]
    time.sleep(0.2)
    workers = list(executor._processes)
    for worker in workers:
        os.kill(worker, signal.SIGSTOP)
    ending = threading.Thread(target=opened.__exit__, args=(None, None, None), daemon=True)
    ending.start()
    time.sleep(0.3)
    os.kill(workers[dying], signal.SIGKILL)
    os.kill(workers[1 - dying], signal.SIGCONT)
    ending.join(300)
    assert not ending.is_alive()


def test_results_of_an_executor_without_cancel_can_be_closed_early() -> None:
    class Uncancelled(Future[Any]):  # as those of parsl
        def cancel(self) -> bool:
            raise NotImplementedError("Cancel not implemented")

    class Stubborn(ThreadPoolExecutor):
        def submit(self, *work: Any) -> Future[Any]:
            future, inner = Uncancelled(), super().submit(*work)
            inner.add_done_callback(lambda done: future.set_result(done.result()))
            return future

    with Stubborn(1) as executor:
        results = in_order([JobPart(sums, {"offset": 0}, range(100))], executor)
        assert next(results) == 0
        results.close()


def test_the_number_of_submitted_tasks_grows_until_all_workers_are_busy(monkeypatch: pytest.MonkeyPatch) -> None:
    """A task whose elapsed time is about its computing time did not wait, so that more tasks may be submitted."""
    most = 0

    class Instant(Executor):
        def submit(self, _do: Any, _function: Any, _shared: Any, items: Any) -> Future[Any]:
            future: Future[Any] = Future()
            future.set_result((list(items), 1000.0))
            return future

    class Counting(queue.SimpleQueue[Any]):
        def put(self, item: Any, *options: Any) -> None:
            nonlocal most
            super().put(item, *options)
            most = max(most, self.qsize())

    monkeypatch.setattr("resgrid._internal.parallel.queue", SimpleNamespace(SimpleQueue=Counting))
    assert list(in_order([JobPart(sums, {"offset": 0}, range(200))], Instant())) == list(range(200))
    assert most >= 20


@pytest.mark.slow
def test_spread_gives_the_same_plans_and_paths_in_worker_processes(scenes: Path, processes: Executor) -> None:
    maps = [rg.read_scene(scenes / name) for name in ("lesson.toml", "rooms.toml")]
    planners = list(rg.spread(rg.plan, maps))
    starts = planners[1].space.centre(np.argwhere(planners[1].space.goal_connected)[::500])
    here = [planners[1].path(start).length for start in starts]
    shapes = [planner.space.shape for planner in rg.spread(rg.plan, maps, executor=processes)]
    there = [path.length for path in rg.spread(_path, starts, planners[1], executor=processes)]
    assert list(rg.spread(squared, [1, 2, 3], 10, executor=processes)) == [11, 14, 19]
    with pytest.raises(rg.InputError, match="cannot be pickled for worker"):
        list(rg.spread(squared, [1], lambda: 0, executor=processes))
    assert shapes == [planner.space.shape for planner in planners]
    assert there == here


def _path(start: Any, planner: Any) -> Any:
    return planner.path(start)
