"""What the person at the terminal sees: results on standard output, everything else on standard error."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar, cast

import click

from resgrid.cli.output import json_text
from resgrid.cli.progress import Progress, progress_bar

Value = TypeVar("Value")
_WORKER = "resgrid computes"


@dataclass(frozen=True)
class Report:
    """How results and progress are told.

    `json`: results are one JSON object instead of lines; `quiet`: no messages and no progress; `verbose`: every stage
    is told when it is done.
    """

    json: bool = False
    quiet: bool = False
    verbose: bool = False

    def say(self, message: str) -> None:
        """A message for people."""
        if not self.quiet:
            click.echo(message, err=True)

    def detail(self, message: str) -> None:
        """A message for people who want to know more."""
        if self.verbose and not self.quiet:
            click.echo(message, err=True)

    def finish(self, data: Mapping[str, Any], lines: Iterable[str], *, written: bool = False) -> None:
        """The result: one JSON object, or lines; no lines where it is in a file and nothing but that was asked for."""
        if self.json:
            click.echo(json_text(data))
            return
        if written and self.quiet:
            return
        for line in lines:
            click.echo(line)

    @contextmanager
    def stage(self, name: str, *, seconds: float | None = None, steps: int | None = None) -> Iterator[Progress]:
        """Show a stage that takes long, with the time that is left."""
        begin = time.perf_counter()
        with progress_bar(name, seconds=seconds, steps=steps, hidden=self.quiet) as progress:
            yield progress
        self.detail(f"{name}: {time.perf_counter() - begin:.2f} s")

    def compute(
        self, name: str, function: Callable[..., Value], *arguments: Any, seconds: float, iterates: bool = False
    ) -> Value:
        """A stage that is one long call of the library, which an interrupt need not wait for."""
        outcome: list[tuple[Value | None, BaseException | None]] = []

        def work(options: dict[str, Any]) -> None:
            try:
                outcome.append((function(*arguments, **options), None))
            except BaseException as error:  # carried over to the thread that waits
                outcome.append((None, error))

        with self.stage(name, seconds=seconds) as progress:
            options = {"progress": progress.follow} if iterates else {}
            worker = threading.Thread(target=work, args=(options,), name=_WORKER, daemon=True)
            worker.start()
            worker.join()
        value, error = outcome[0]
        if error is not None:
            raise error
        return cast("Value", value)


def is_computing() -> bool:
    """Whether a call made by `Report.compute` has been left behind, still busy."""
    return any(thread.name == _WORKER for thread in threading.enumerate())
