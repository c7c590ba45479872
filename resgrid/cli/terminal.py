"""Output on the terminal: results, messages, progress bars, and the mapping of errors to messages and exit codes."""

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
INTERRUPTED, BROKEN_PIPE, TERMINATED = 130, 141, 143  # 128 + number of the signal: SIGINT, SIGPIPE, SIGTERM

_CODES: tuple[tuple[type[BaseException], int], ...] = (
    (errors.AccuracyError, NEGATIVE),
    (errors.CertificateError, NEGATIVE),
    (errors.ToolMissingError, TOOL_MISSING),
    (errors.BudgetError, OUT_OF_BUDGET),
    (errors.WorkerError, OUT_OF_BUDGET),
    (errors.ResgridError, USAGE),
    (MemoryError, OUT_OF_BUDGET),
)

BAR_DELAY = 1.0
"""Time before a progress bar appears, in seconds."""

_WORKER = "resgrid computes"
"""Prefix of the names of threads that compute."""


@dataclass(frozen=True)
class Verbosity:
    """Options for the output of results and progress, stored in the command's context.

    `json`: results are one JSON object instead of lines; `quiet`: no messages and progress bars; `verbose`: messages
    with the time of every stage.
    """

    json: bool = False
    quiet: bool = False
    verbose: bool = False


def verbosity() -> Verbosity:
    """Return the output options of the running command; defaults outside a command."""
    context = click.get_current_context(silent=True)
    return (context.find_object(Verbosity) if context else None) or Verbosity()


@contextmanager
def quietly() -> Iterator[None]:
    """Suppress messages and progress bars inside the context."""
    context = click.get_current_context()
    before, context.obj = context.obj, replace(verbosity(), quiet=True)
    try:
        yield
    finally:
        context.obj = before


def say(message: str) -> None:
    """Print a message on standard error, unless the command is quiet."""
    if not verbosity().quiet:
        click.echo(message, err=True)


def counted(count: int, noun: str) -> str:
    """Return a count with its noun in singular or plural: ``1 cell``, ``2,000 cells``."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def detail(message: str) -> None:
    """Print a message on standard error if the command is verbose."""
    if verbosity().verbose:
        say(message)


def finish(data: Mapping[str, Any], lines: Iterable[str] = (), *, written: object = None, more: bool = False) -> None:
    """Print the result on standard output, as one JSON object or as lines.

    `written`: file that already has the result; "-" is standard output, to which this function then adds no output.
    With such a file, ``-q`` suppresses the lines, unless they contain `more` than the file.
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
    """Raise InputError for ``-o -`` together with ``--json``."""
    if output == "-" and verbosity().json:
        raise InputError("-o - and --json both write to standard output; remove one of them, or name a file with -o")


class Stage:
    """Progress of a stage, from counted steps, from the residual of an iteration, or from the estimated time.

    `seconds`: estimated time of the whole stage; ignored below `BAR_DELAY`, because a delay of so short a stage has
    other causes than its size, such as the compilation of kernels; `steps`: number of equal steps.
    """

    def __init__(self, seconds: float | None = None, steps: int | None = None) -> None:
        self._seconds = seconds if seconds is not None and seconds >= BAR_DELAY else None
        self._steps, self._done = steps, 0
        self._note = ""
        self._counted: tuple[float, int] | None = None
        self._begin = time.perf_counter()

    def advance(self) -> None:
        """Add one finished step."""
        self._done += 1

    def count(self, done: int, total: int, note: object = "") -> None:
        """Set the number of finished steps and of all steps, and a note with intermediate results."""
        self._done, self._steps = done, total
        self._counted = self._counted or (time.perf_counter(), done)  # steps of an interrupted run took no time
        self._note = f"{note}  " if note else self._note

    def follow(self, _steps: int, residual: float, seconds_left: float | None) -> None:
        """Record the relative residual of an iteration, and the estimated remaining time in seconds."""
        self._note = f"residual {residual:.0e}  "
        self._seconds = None if seconds_left is None else time.perf_counter() - self._begin + seconds_left

    def fraction(self) -> float | None:
        """Return the finished fraction of the stage, in [0, 0.99]; None if it is unknown."""
        if self._steps:
            return min(self._done / self._steps, 0.99)
        return min((time.perf_counter() - self._begin) / self._seconds, 0.99) if self._seconds else None

    def status(self) -> str:
        """Return the note with intermediate results, and the elapsed or remaining time."""
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
    """Show a progress bar with the remaining time for a long stage, on a terminal; yields its `Stage`."""
    running, begin = Stage(seconds, steps), time.perf_counter()
    bars: list[Progress] = []
    timer = threading.Timer(BAR_DELAY, lambda: bars.append(_started_bar(name, running)))
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
        """A bar that reads the progress of the stage whenever it is drawn."""

        def get_renderables(self) -> Iterable[Any]:
            for task in self.tasks:
                fraction = running.fraction()
                task.total, task.completed = None if fraction is None else 1.0, fraction or 0.0
                task.fields["status"] = running.status()
            return super().get_renderables()

    columns = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[status]}")
    bar = Bar(*columns, console=Console(stderr=True), transient=True, refresh_per_second=5)
    bar.add_task(name, status="")
    bar.start()
    return bar


def compute(
    name: str,
    function: Callable[..., Value],
    *arguments: Any,
    seconds: float | None = None,
    iterates: bool = False,
) -> Value:
    """Call a function in a thread and return its value; an interrupt does not wait for the end of the call.

    `name`: of the stage; `seconds`: its estimated time; `iterates`: the function takes a keyword ``progress``, which it
    calls in every iteration.
    """
    context = click.get_current_context(silent=True)
    outcome: list[tuple[Value | None, BaseException | None]] = []

    def work(options: dict[str, Any]) -> None:
        try:
            with context.scope(cleanup=False) if context else nullcontext():
                outcome.append((function(*arguments, **options), None))
        except BaseException as error:  # raised again in the waiting thread
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
    """Return whether a thread of `compute` or of the live page still runs after `patience` seconds."""
    until = time.perf_counter() + patience
    while any(thread.name.startswith((_WORKER, "resgrid answers")) for thread in threading.enumerate()):
        if time.perf_counter() >= until:
            return True
        time.sleep(0.01)
    return False


def end_at_once(code: int) -> NoReturn:
    """End the process without interpreter shutdown, which would wait for threads in compiled code."""
    weakref.finalize._exitfunc()  # type: ignore[attr-defined]  # ends child processes and removes temporary folders
    os._exit(code)


class Failure(NamedTuple):
    """Exit code, error class and message of a failed command."""

    code: int
    kind: str
    message: str


def failure_of(error: Exception) -> Failure:
    """Return exit code, class name and message of an exception."""
    kind = type(error).__name__
    if isinstance(error, click.Abort):
        return Failure(INTERRUPTED, kind, "interrupted")
    if isinstance(error, click.ClickException):
        message, context = error.format_message(), getattr(error, "ctx", None)
        if re.fullmatch(r"Got unexpected extra arguments? \([-\d., ]+\)", message.rstrip(".")):
            message += "; separate the numbers of one option by commas, without spaces, such as 3,4"
        if re.fullmatch(r"No such option:? '?-[\d.].*", message):
            message = f"{message.rstrip('.')}: write a place that begins with a minus sign as --start=-1.5,2"
        message = re.sub(r"is not a valid integer(?: range)?\.?$", "is not a whole number; give digits only", message)
        if context and kind != "NoArgsIsHelpError":
            message = f"{message.rstrip('.')}; see '{context.command_path} --help'"
        return Failure(USAGE, kind, message)
    if isinstance(error, MemoryError) and not isinstance(error, errors.ResgridError):
        detail = f" ({error})" if str(error) else ""
        return Failure(OUT_OF_BUDGET, kind, f"out of memory{detail}; use fewer cells, or raise the limit (ulimit -v)")
    for class_, code in _CODES:
        if isinstance(error, class_):
            return Failure(code, kind, str(error))
    if isinstance(error, OSError) and error.errno is not None:
        place = f"{error.filename}: " if error.filename else ""
        return Failure(USAGE, kind, f"{place}{error.strerror}; check the path, its permissions and the free space")
    fault = f"internal error of resgrid ({kind}: {error}); please report it with the output of this command"
    return Failure(UNEXPECTED, kind, f"{fault} and --debug")
