"""What the person at the terminal sees: results, messages and progress, and how a command line ends."""

from __future__ import annotations

import os
import re
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, TypeVar, cast

import click

from resgrid import errors
from resgrid.errors import InputError

if TYPE_CHECKING:
    from rich.progress import Progress

Value = TypeVar("Value")

NEGATIVE, USAGE, TOOL_MISSING, OUT_OF_BUDGET, NOT_VERIFIED, UNEXPECTED = 1, 2, 3, 4, 5, 70
INTERRUPTED, LEFT, TERMINATED = 130, 141, 143  # 128 + the number of the signal: SIGINT, SIGPIPE, SIGTERM

_CODES: tuple[tuple[type[BaseException], int], ...] = (
    (errors.AccuracyError, NEGATIVE),
    (errors.CertificateError, NEGATIVE),
    (errors.ToolMissingError, TOOL_MISSING),
    (errors.BudgetError, OUT_OF_BUDGET),
    (errors.WorkerError, OUT_OF_BUDGET),
    (errors.ResgridError, USAGE),
    (MemoryError, OUT_OF_BUDGET),
)

PATIENCE = 1.0
"""Seconds before a bar appears."""

_WORKER = "resgrid computes"


@dataclass(frozen=True)
class Verbosity:
    """How results and progress are reported, kept by the command's context.

    `json`: results are one JSON object instead of lines; `quiet`: no messages, no progress; `verbose`: every stage and
    its time.
    """

    json: bool = False
    quiet: bool = False
    verbose: bool = False


def verbosity() -> Verbosity:
    """How the running command reports."""
    context = click.get_current_context(silent=True)
    return (context.find_object(Verbosity) if context else None) or Verbosity()


@contextmanager
def quietly() -> Iterator[None]:
    """Report nothing of many small jobs."""
    context = click.get_current_context()
    before, context.obj = context.obj, replace(verbosity(), quiet=True)
    try:
        yield
    finally:
        context.obj = before


def say(message: str) -> None:
    """A message for people."""
    if not verbosity().quiet:
        click.echo(message, err=True)


def counted(count: int, noun: str) -> str:
    """How many there are of something, for people."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def detail(message: str) -> None:
    """A message for people who want to know more."""
    if verbosity().verbose:
        say(message)


def finish(data: Mapping[str, Any], lines: Iterable[str] = (), *, written: object = None, more: bool = False) -> None:
    """The result: one JSON object, or lines; nothing where standard output has the data.

    `written`: the file with the result, beside which ``-q`` prints no lines, unless they say `more` than it does.
    """
    if written == "-":
        return
    if written is not None:
        say(f"wrote {written}")
    if verbosity().json:
        from resgrid.io.tables import json_text

        click.echo(json_text(data))
    elif more or written is None or not verbosity().quiet:
        for line in lines:
            click.echo(line)


def require_one_output(output: str | None) -> None:
    """Refuse ``-o -`` beside ``--json``."""
    if output == "-" and verbosity().json:
        raise InputError("-o - and --json both want standard output; choose one, or write to a file")


class Stage:
    """How far a stage is: by steps counted, by what an iteration says, or by the time it was estimated to take.

    `seconds`: estimate for the whole stage, unless it is below `PATIENCE`: such a stage is late by something else than
    its size, such as kernels that are compiled; `steps`: number of equal steps.
    """

    def __init__(self, seconds: float | None = None, steps: int | None = None) -> None:
        self._seconds = seconds if seconds is not None and seconds >= PATIENCE else None
        self._steps, self._done = steps, 0
        self._note = ""
        self._counted: tuple[float, int] | None = None
        self._begin = time.perf_counter()

    def advance(self) -> None:
        """One more step is done."""
        self._done += 1

    def count(self, done: int, total: int, note: object = "") -> None:
        """Steps as the library counts them, and what is known so far, for people."""
        self._done, self._steps = done, total
        self._counted = self._counted or (time.perf_counter(), done)  # what a run before had done took no time
        self._note = f"{note}  " if note else self._note

    def follow(self, _steps: int, residual: float, seconds_left: float | None) -> None:
        """An iteration: how small its residual is, and about how long it still takes."""
        self._note = f"residual {residual:.0e}  "
        self._seconds = None if seconds_left is None else time.perf_counter() - self._begin + seconds_left

    def fraction(self) -> float | None:
        """Part of the stage that is done, in [0, 0.99]; None where nobody knows."""
        if self._steps:
            return min(self._done / self._steps, 0.99)
        return min((time.perf_counter() - self._begin) / self._seconds, 0.99) if self._seconds else None

    def outlook(self) -> str:
        """What is known so far, and the time left."""
        elapsed, fraction = time.perf_counter() - self._begin, self.fraction()
        if not fraction:
            return f"{self._note}{elapsed:.0f} s so far"
        left = elapsed * (1 - fraction) / fraction
        if self._counted and self._steps and self._done > self._counted[1]:
            seconds = time.perf_counter() - self._counted[0]
            left = seconds * (self._steps - self._done) / (self._done - self._counted[1])
        late = self._seconds is not None and not self._steps and elapsed > self._seconds
        return (
            f"{self._note}{elapsed:.0f} s so far, longer than expected"
            if late
            else f"{self._note}about {left:.0f} s left"
        )


@contextmanager
def stage(name: str, *, seconds: float | None = None, steps: int | None = None) -> Iterator[Stage]:
    """Show a stage that takes long, on a terminal, with the time that is left."""
    running, begin = Stage(seconds, steps), time.perf_counter()
    bars: list[Progress] = []
    timer = threading.Timer(PATIENCE, lambda: bars.append(_started_bar(name, running)))
    timer.daemon = True
    if sys.stderr.isatty() and not verbosity().quiet:
        timer.start()
    try:
        yield running
    finally:
        timer.cancel()
        if timer.ident is not None:
            timer.join()
        for bar in bars:
            bar.stop()
    detail(f"{name}: {time.perf_counter() - begin:.2f} s")


def _started_bar(name: str, running: Stage) -> Progress:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    class Bar(Progress):
        """A bar that asks the stage how far it is, whenever it is drawn."""

        def get_renderables(self) -> Iterable[Any]:
            for task in self.tasks:
                fraction = running.fraction()
                task.total, task.completed = None if fraction is None else 1.0, fraction or 0.0
                task.fields["outlook"] = running.outlook()
            return super().get_renderables()

    columns = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[outlook]}")
    bar = Bar(*columns, console=Console(stderr=True), transient=True, refresh_per_second=5)
    bar.add_task(name, outlook="")
    bar.start()
    return bar


def compute(
    name: str,
    function: Callable[..., Value],
    *arguments: Any,
    seconds: float | None = None,
    iterates: bool = False,
) -> Value:
    """A stage that is one long call of the library, which an interrupt need not wait for.

    `iterates`: the function takes a ``progress`` of its iterations.
    """
    context = click.get_current_context(silent=True)
    outcome: list[tuple[Value | None, BaseException | None]] = []

    def work(options: dict[str, Any]) -> None:
        try:
            with context.scope(cleanup=False) if context else nullcontext():
                outcome.append((function(*arguments, **options), None))
        except BaseException as error:  # carried over to the thread that waits
            outcome.append((None, error))

    with stage(name, seconds=seconds) as running:
        options = {"progress": running.follow} if iterates else {}
        worker = threading.Thread(target=work, args=(options,), name=_WORKER, daemon=True)
        worker.start()
        worker.join()
    value, error = outcome[0]
    if error is not None:
        raise error
    return cast("Value", value)


def is_computing(patience: float = 0.0) -> bool:
    """Whether a call made by `compute`, or for the live page, has been left behind, and is busy for so many seconds."""
    until = time.perf_counter() + patience
    while any(thread.name.startswith((_WORKER, "resgrid answers")) for thread in threading.enumerate()):
        if time.perf_counter() >= until:
            return True
        time.sleep(0.01)
    return False


def end_at_once(code: int) -> NoReturn:
    """End the process: the interpreter cannot shut down beside a thread that is busy in compiled code."""
    weakref.finalize._exitfunc()  # type: ignore[attr-defined]  # other processes and folders end
    os._exit(code)


class Failure(NamedTuple):
    """How a command line ends that could not do its work."""

    code: int
    kind: str
    message: str


def failure_of(error: Exception) -> Failure:
    """What an error means to the person at the terminal."""
    kind = type(error).__name__
    if isinstance(error, click.Abort):
        return Failure(INTERRUPTED, kind, "interrupted")
    if isinstance(error, click.ClickException):
        message, context = error.format_message(), getattr(error, "ctx", None)
        if re.fullmatch(r"Got unexpected extra arguments? \([-\d., ]+\)", message.rstrip(".")):
            message += "; numbers of one option are joined by commas, without spaces, such as 3,4"
        if re.fullmatch(r"No such option:? '?-[\d.].*", message):
            message = f"{message.rstrip('.')}: a place that begins with a minus sign is written --start=-1.5,2"
        if context and kind != "NoArgsIsHelpError":
            message = f"{message.rstrip('.')}; see '{context.command_path} --help'"
        return Failure(USAGE, kind, message)
    if isinstance(error, MemoryError) and not isinstance(error, errors.ResgridError):
        detail = f" ({error})" if str(error) else ""
        return Failure(OUT_OF_BUDGET, kind, f"out of memory{detail}; use fewer cells, or allow more memory (ulimit -v)")
    for class_, code in _CODES:
        if isinstance(error, class_):
            return Failure(code, kind, str(error))
    if isinstance(error, OSError) and error.errno is not None:
        place = f"{error.filename}: " if error.filename else ""
        return Failure(USAGE, kind, f"{place}{error.strerror}; check the path, its permissions and the free space")
    fault = f"this is a fault of resgrid ({kind}: {error}); please report it with the output of the same command"
    return Failure(UNEXPECTED, kind, f"{fault} and --debug")
