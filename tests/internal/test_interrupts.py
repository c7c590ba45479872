"""Interrupts arrive at the end of code that must not be left halfway.

Tests internals: `resgrid._internal.interrupts`, `resgrid._internal.parallel`.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import pytest
from support.executors import slow_sums, sums

from resgrid._internal.interrupts import interrupts_deferred, interrupts_ignored
from resgrid._internal.parallel import JobPart, in_order


@contextmanager
def default_handler() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        assert signal.signal(signal.SIGINT, before) is signal.default_int_handler


def test_an_interrupt_is_raised_at_the_end_of_the_block() -> None:
    done: list[str] = []
    with default_handler(), pytest.raises(KeyboardInterrupt), interrupts_deferred(wake=lambda: done.append("woken")):
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        done.append("end")
    assert done == ["woken", "woken", "end"]


def test_nested_blocks_raise_the_interrupt_at_the_end_of_the_outer_one() -> None:
    done: list[str] = []
    with default_handler(), pytest.raises(KeyboardInterrupt), interrupts_deferred():
        with interrupts_deferred():
            signal.raise_signal(signal.SIGINT)
            done.append("inner")
        done.append("outer")
    assert done == ["inner", "outer"]


def test_ignored_interrupts_stay_ignored() -> None:
    with default_handler(), interrupts_ignored(), interrupts_deferred():
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
        signal.raise_signal(signal.SIGINT)


def test_an_interrupt_leaves_no_lock_of_an_executor_held() -> None:
    """The interrupt arrives while the main thread holds a lock that the thread of the executor needs."""
    lock = threading.Lock()

    class Locking(ThreadPoolExecutor):
        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            lock.acquire()  # a library may write 'try' only after this line
            signal.raise_signal(signal.SIGINT)
            lock.release()
            return super().submit(fn, *args, **kwargs)

    with default_handler(), Locking(1) as executor, pytest.raises(KeyboardInterrupt):
        list(in_order([JobPart(sums, {"offset": 0}, range(9))], executor))
    assert not lock.locked()


def test_an_interrupt_ends_the_waiting_for_results() -> None:
    with default_handler(), ThreadPoolExecutor(1) as executor, pytest.raises(KeyboardInterrupt):
        results = in_order([JobPart(slow_sums, {"offset": 0}, range(3000))], executor)
        timer = threading.Timer(0.3, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT))
        timer.start()
        assert len(list(results)) < 3000
