"""Context managers that delay or ignore Ctrl-C (SIGINT) in code that must not be interrupted halfway."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def interrupts_deferred(wake: Callable[[], object] | None = None) -> Iterator[None]:
    """Handle SIGINT and SIGTERM at the end of the block instead of inside it.

    Outside the main thread this has no effect. Python raises KeyboardInterrupt between any two instructions of the main
    thread, also where a library has just acquired a lock: the lock is then never released, and other threads wait for
    it forever.

    `wake`: called in the signal handler when a signal arrives, to end a wait in the block; None if the block does not
    wait. If several signals arrive, only the first one is handled. Signals that are ignored, or that end the process by
    default, keep their effect.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    arrived: list[int] = []

    def record(number: int, _frame: object) -> None:
        arrived.append(number)
        if wake is not None:
            wake()

    handlers = {each: signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)}
    replaced = {each: handler for each, handler in handlers.items() if callable(handler)}
    try:
        for each in replaced:
            signal.signal(each, record)
        yield
    finally:
        for each, handler in replaced.items():
            signal.signal(each, handler)
        if arrived:
            signal.raise_signal(arrived[0])


@contextmanager
def interrupts_ignored() -> Iterator[None]:
    """Make this process, and processes that are started in the block, ignore Ctrl-C until the block ends.

    The started processes also ignore Ctrl-C after the block.  Outside the main thread this has no effect.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
