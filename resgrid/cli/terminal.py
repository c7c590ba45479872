"""Output on the terminal: results, messages, progress bars, and the mapping of errors to messages and exit codes."""

from __future__ import annotations

import os
import re
import sys
import threading
import time
import traceback
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
INTERRUPTED, BROKEN_PIPE = 130, 141  # 128 + number of the signal: SIGINT, SIGPIPE

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
"""Delay between the beginning of a stage and the display of its progress bar, in seconds."""

_WORKER = "resgrid computes"
"""Prefix of the names of the threads in which `compute` runs computations."""


@dataclass(frozen=True)
class Verbosity:
    """Options of the output of results and messages, stored in the command's context.

    `json`: whether results are one JSON object instead of lines; `quiet`: whether messages and progress bars are
    omitted (errors are printed); `verbose`: whether the time of every stage and further details are printed.
    """

    json: bool = False
    quiet: bool = False
    verbose: bool = False


def verbosity() -> Verbosity:
    """Return the output options of the running subcommand; default options if no subcommand runs."""
    context = click.get_current_context(silent=True)
    return (context.find_object(Verbosity) if context else None) or Verbosity()


@contextmanager
def quietly() -> Iterator[None]:
    """Suppress messages and progress bars of the running subcommand while the context is active."""
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
    """Print a message on standard error, only if the option ``--verbose`` is given."""
    if verbosity().verbose:
        say(message)


def finish(data: Mapping[str, Any], lines: Iterable[str] = (), *, written: object = None, more: bool = False) -> None:
    """Print the result on standard output: `data` as one JSON object with the option ``--json``, otherwise `lines`.

    `written`: file that already contains the result, None without a file; "-" is standard output, after which this
    function prints nothing.  With a file, ``-q`` suppresses the lines, unless `more` is True (the lines contain more
    than the file).
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
    """Raise InputError for ``-o -`` together with ``--json``, because both write to standard output."""
    if output == "-" and verbosity().json:
        raise InputError("-o - and --json both write to standard output; remove one of them, or name a file with -o")


class Stage:
    """Progress of a stage (step) of a subcommand, from counted steps, an iteration's residual, or the estimated time.

    `seconds`: estimated time of the whole stage in seconds, None if unknown; estimates shorter than 1 s (`BAR_DELAY`)
    are ignored, because a long duration then has other causes, such as the compilation of kernels; `steps`: number of
    equal steps, None if unknown.
    """

    def __init__(self, seconds: float | None = None, steps: int | None = None) -> None:
        self._seconds = seconds if seconds is not None and seconds >= BAR_DELAY else None
        self._steps, self._done = steps, 0
        self._note = ""
        self._counted: tuple[float, int] | None = None
        self._begin = time.perf_counter()

    def advance(self) -> None:
        """Increase the number of finished steps by one."""
        self._done += 1

    def count(self, done: int, total: int, note: object = "") -> None:
        """Record the progress of the stage.

        `done`, `total`: numbers of finished steps and of all steps; `note`: intermediate result that the progress bar
        shows.
        """
        self._done, self._steps = done, total
        self._counted = self._counted or (time.perf_counter(), done)  # steps of an interrupted run took no time
        self._note = f"{note}  " if note else self._note

    def follow(self, _steps: int, residual: float, seconds_left: float | None) -> None:
        """Record the relative residual of an iteration and the estimated remaining time.

        `residual`: residual norm relative to that at the start of the iteration; `seconds_left`: remaining time in
        seconds, None if unknown; the first argument, the number of iterations, is ignored.
        """
        self._note = f"residual {residual:.0e}  "
        self._seconds = None if seconds_left is None else time.perf_counter() - self._begin + seconds_left

    def fraction(self) -> float | None:
        """Return the finished fraction of the stage, from 0 to 0.99 (a running stage is not finished).

        The result is None if neither the number of steps nor the estimated time is known.
        """
        if self._steps:
            return min(self._done / self._steps, 0.99)
        return min((time.perf_counter() - self._begin) / self._seconds, 0.99) if self._seconds else None

    def status(self) -> str:
        """Return a text for the progress bar: intermediate results and the estimated remaining time.

        If the remaining time is unknown, or the stage takes longer than estimated, the text has the elapsed time
        instead.
        """
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
    """Yield the `Stage` of a computation; on a terminal, show a progress bar if the computation takes longer than 1 s.

    `name`: name of the stage; `seconds`: estimated time in seconds, None if unknown; `steps`: number of equal steps,
    None if unknown.
    """
    running, begin = Stage(seconds, steps), time.perf_counter()
    bars: list[Progress] = []
    timer = threading.Timer(BAR_DELAY, lambda: bars.append(_started_bar(name, running)))
    timer.daemon = True
    if sys.stderr is not None and sys.stderr.isatty() and not verbosity().quiet:  # None without standard error
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
        """Progress bar that queries the progress of the stage at every redraw."""

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

    `name`: name of the stage for the progress bar; `arguments`: arguments of the function; `seconds`: estimated time of
    the call, None if unknown; `iterates`: whether the function takes a keyword ``progress``, a function of the number
    of iterations, the relative residual and the remaining seconds (or None), which it calls in every iteration.
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
    """Return whether a computation still runs after a wait of at most `patience` seconds for its end.

    Computations are those in the threads of `compute` and of the live page.
    """
    until = time.perf_counter() + patience
    while any(thread.name.startswith((_WORKER, "resgrid answers")) for thread in threading.enumerate()):
        if time.perf_counter() >= until:
            return True
        time.sleep(0.01)
    return False


def end_at_once(code: int) -> NoReturn:
    """End the process with an exit code, without the interpreter's shutdown, which would wait for compiled code."""
    weakref.finalize._exitfunc()  # type: ignore[attr-defined]  # ends child processes and removes temporary folders
    os._exit(code)


class Failure(NamedTuple):
    """Result of a failed command.

    `code`: exit code of the process: 1 for a negative answer, 2 for bad usage or input, 3 for a missing outside tool, 4
    for an exceeded limit of time or memory, 5 for a result that is not verified; others for an interrupt and for
    unexpected errors; `kind`: class name of the error; `message`: text for the user.
    """

    code: int
    kind: str
    message: str


def failure_of(error: Exception) -> Failure:
    """Return exit code, class name and message for an exception that ended a command.

    The message of an unexpected exception asks the user to report it.
    """
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
        if kind == "MissingParameter":
            message = " ".join(message.split())  # click writes the possible values on lines of their own
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
        return Failure(USAGE, kind, _refused_message(error))
    fault = f"internal error of resgrid ({kind}: {error}); please report it with the output of this command"
    return Failure(UNEXPECTED, kind, f"{fault} and --debug")


def _refused_message(error: OSError) -> str:
    """Return the message for an error of the operating system: a compiled kernel cannot be stored, or a file fails."""
    frames = traceback.walk_tb(error.__traceback__)
    if any(str(frame.f_globals.get("__name__")).startswith("numba.") for frame, _ in frames):
        remedy = "free space there, or set the variable NUMBA_CACHE_DIR to another folder"
        return f"compiled kernels cannot be stored: {error.strerror}; {remedy}"
    place = f"{error.filename}: " if error.filename else ""
    return f"{place}{error.strerror}; check the path, its permissions and the free space"
