"""What the person at the terminal sees: results on standard output, everything else on standard error."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import click

from resgrid.cli.output import json_text
from resgrid.cli.progress import Progress, progress_bar


@dataclass(frozen=True)
class Report:
    """How results and progress are told.

    Attributes
    ----------
    json : bool
        Results are one JSON object instead of lines.
    quiet : bool
        No messages and no progress.
    verbose : bool
        Every stage is told when it is done.
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

    def finish(self, data: Mapping[str, Any], lines: Iterable[str]) -> None:
        """The result: one JSON object, or lines."""
        if self.json:
            click.echo(json_text(data))
            return
        for line in lines:
            click.echo(line)

    @contextmanager
    def stage(self, name: str, *, seconds: float | None = None, steps: int | None = None) -> Iterator[Progress]:
        """Show a stage that takes long, with the time that is left.

        Parameters
        ----------
        name : str
            What is being done.
        seconds : float, optional
            Estimate of the time it takes, where it cannot be seen how far it is.
        steps : int, optional
            Number of equal steps, each told by ``progress.advance()``.

        Yields
        ------
        Progress
        """
        begin = time.perf_counter()
        with progress_bar(name, seconds=seconds, steps=steps, hidden=self.quiet) as progress:
            yield progress
        self.detail(f"{name}: {time.perf_counter() - begin:.2f} s")
