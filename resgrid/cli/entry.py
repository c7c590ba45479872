"""The entry point: the group of all subcommands, and the report of errors and signals with the exit code.

A subcommand is imported when it is called.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import os
import shlex
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from typing import Any

import click
from click.shell_completion import CompletionItem

from resgrid.cli.options import is_source
from resgrid.cli.streams import prepare_streams
from resgrid.cli.terminal import (
    BROKEN_PIPE,
    INTERRUPTED,
    UNEXPECTED,
    Failure,
    end_at_once,
    failure_of,
    is_computing,
)

SUBCOMMANDS = {
    "run": "Write paths, pictures and SPICE-checked decks to a folder.",
    "compile": "Write a scene's chip as a SPICE deck.",
    "solve": "Solve a scene's resistor grid, or a resistive deck.",
    "resistance": "Compute effective resistances, and run Circuitscape jobs.",
    "path": "Compute paths along the current from starts to a goal.",
    "stream": "Plan a path for every map of a recording (a bag).",
    "plot": "Draw a scene, its potential, currents, paths or circuit.",
    "check": "Check electrical rules, and compare with a circuit simulator.",
    "chip": "Analyse a chip with its imperfections; write a report and decks.",
    "board": "Write a printed circuit board of a scene as a KiCad project.",
    "layout": "Draw a scene's resistor grid as a chip layout (GDSII, OASIS).",
    "control": "Simulate the robot in its field, with contacts and map updates.",
    "live": "Edit a scene in the browser while its grid is solved.",
    "convert": "Convert a scene, map or deck to a deck, an edge list or a graph.",
    "info": "Describe a scene, a deck, the scene format or the installation.",
    "completion": "Print the script for completion in a shell.",
}
"""All subcommands with their short help, in the usual order of work.

The subcommand is the object ``command`` of the module of its name.
"""


_GC_THRESHOLD = 50_000
"""Allocated minus freed container objects at which garbage is collected while a subcommand runs; Python's: 700."""


class SubcommandGroup(click.Group):
    """The group of subcommands, whose modules are imported on demand."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the names of all subcommands, in the usual order of work."""
        return list(SUBCOMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Return the subcommand with the name `cmd_name`; None for unknown names."""
        if cmd_name not in SUBCOMMANDS:
            return None
        command: click.Command = importlib.import_module(f"resgrid.cli.{cmd_name}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Write the names of all subcommands with their short help."""
        with formatter.section("Commands"):
            formatter.write_dl(list(SUBCOMMANDS.items()))

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Return the completions: subcommands and options that begin with the text `incomplete`."""
        names = [CompletionItem(name, help=about) for name, about in SUBCOMMANDS.items() if name.startswith(incomplete)]
        return names + click.Command.shell_complete(self, ctx, incomplete)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Return the words after the group's options; raise UsageError for an option that belongs to a subcommand."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            path = importlib.import_module("resgrid.cli.path").command  # has the options of all scenes and outputs
            if any(error.option_name in each.opts for each in path.params):
                words = f"{ctx.command_path} run SCENE {error.option_name}"
                raise click.UsageError(f"options follow the command, as in: {words}", ctx) from None
            raise

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return name, subcommand and remaining words of a command line.

        Raises UsageError, with a suggestion, if the first word is not a subcommand.
        """
        if args[0] not in SUBCOMMANDS:
            near = get_close_matches(args[0], SUBCOMMANDS, 1)
            if is_source(args[0]):
                words = f"a command is missing before {args[0]!r}; type: {ctx.command_path} run {shlex.join(args)}"
                raise click.UsageError(words, ctx)
            if near:
                raise click.UsageError(f"No such command {args[0]!r}. Did you mean {near[0]!r}?", ctx)
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Call the subcommand and return its exit code.

        A broken pipe or an interrupt ends the command here, because click would end it with other exit codes.
        """
        try:
            with warnings.catch_warnings(), _rare_garbage_collection():
                warnings.showwarning = _show_warning
                result = super().invoke(ctx)
            if sys.stdout is not None:  # None if the process was started without standard output
                sys.stdout.flush()
        except BrokenPipeError:
            _drop_stdout()
            ctx.exit(BROKEN_PIPE)
        except KeyboardInterrupt as interrupt:
            with contextlib.suppress(OSError):  # the terminal may be closed
                click.echo("resgrid: interrupted; incomplete files were removed", err=True)
            code = 128 + interrupt.args[0] if interrupt.args else INTERRUPTED
            if is_computing():
                end_at_once(code)
            ctx.exit(code)
        return result

    def main(self, args: Sequence[str] | None = None, *rest: Any, **extra: Any) -> Any:
        """Run a command line and exit the process with its exit code; an error is reported as one message.

        `args`: words of the command line, by default those of the process.
        """
        words = list(sys.argv[1:] if args is None else args)
        if args is None:
            prepare_streams()
        extra["standalone_mode"] = False
        try:
            with _interrupt_on_signals(is_process=args is None):
                code = super().main(words, *rest, **extra)
        except Exception as error:  # all errors of the command line end here
            failure = failure_of(error)
            if failure.code == UNEXPECTED and "--debug" in words:
                click.echo(traceback.format_exc(), err=True, nl=False)
            _print_failure(failure, as_json="--json" in words)
            sys.exit(failure.code)
        sys.exit(code if isinstance(code, int) else 0)


@contextlib.contextmanager
def _interrupt_on_signals(*, is_process: bool) -> Iterator[None]:
    """Raise KeyboardInterrupt for SIGINT, SIGTERM and SIGHUP (a closed terminal) inside the context.

    After the first signal, further ones are ignored, so that they do not disturb the cleanup.

    `is_process`: whether the process ends after the command; if so, signals stay ignored until the end of the process.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(number: int, _frame: object) -> None:
        for each in before:
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt(signal.Signals(number))

    handled = [signal.SIGTERM]
    hangup = getattr(signal, "SIGHUP", None)  # absent on Windows; ignored below nohup
    if hangup is not None and signal.getsignal(hangup) is signal.SIG_DFL:
        handled.append(hangup)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        handled.append(signal.SIGINT)
    before = {each: signal.signal(each, interrupt) for each in handled}
    try:
        yield
    finally:
        if not (is_process and signal.getsignal(signal.SIGTERM) is signal.SIG_IGN):
            for each, handler in before.items():
                signal.signal(each, handler)


@contextlib.contextmanager
def _rare_garbage_collection() -> Iterator[None]:
    """Collect garbage less often inside the context; with Python's default, it takes 10 % of a short command's time.

    Imports and kernels produce little garbage.  At the end of the process there is no collection, because a collection
    over all imported modules would take a quarter of the time of the shutdown.
    """
    atexit.unregister(gc.freeze)
    atexit.register(gc.freeze)
    before = gc.get_threshold()
    gc.set_threshold(_GC_THRESHOLD)
    try:
        yield
    finally:
        gc.set_threshold(*before)


def _print_failure(failure: Failure, *, as_json: bool) -> None:
    """Print the message of a failure on standard error.

    `as_json`: whether to print a JSON object on standard output, too, with the keys ``error`` (message), ``kind`` and
    ``exit_code``.
    """
    if failure.kind == "NoArgsIsHelpError":  # for a bare 'resgrid', click raises this error with the help as message
        click.echo(failure.message, err=True)
        return
    colour = False if os.environ.get("NO_COLOR") else None
    click.secho("resgrid: error: ", fg="red", nl=False, err=True, color=colour)
    click.echo(failure.message, err=True, color=colour)
    try:
        if as_json:
            from resgrid.io.tables import json_text

            click.echo(json_text({"error": failure.message, "kind": failure.kind, "exit_code": failure.code}))
        elif sys.stdout is not None:
            sys.stdout.flush()
    except OSError:  # standard output is broken; its buffer would fail again at the end of the process
        _drop_stdout()


def _show_warning(message: Warning | str, *_where: object, **_more: object) -> None:
    click.echo(f"resgrid: warning: {message}", err=True)


def _drop_stdout() -> None:
    """Redirect a broken standard output to the null device, so that flushing it at exit raises no error."""
    with contextlib.suppress(OSError, ValueError):  # standard output may be an object without file descriptor
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@click.command(
    cls=SubcommandGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    epilog="Exit codes: 0 done; 1 negative answer (no path, disagreement with the simulator); 2 invalid usage or "
    "input; 3 an external tool is missing; 4 not enough memory or time; 5 not verified (the simulator did not run the "
    "deck itself); 70 internal error of resgrid; 130 interrupted.",
)
@click.version_option(package_name="resgrid", message="%(prog)s %(version)s")
def main() -> None:
    """Plan robot paths with resistor grids: compile maps to circuits, solve them, follow the current, check in SPICE.

    A SCENE is a TOML scene, a ROS map.yaml, a MovingAI .map, a picture, a NumPy array, an OctoMap, a point cloud, a
    link of the live page, or the name of a shipped scene; '-' is standard input.
    """
