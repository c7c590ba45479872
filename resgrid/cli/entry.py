"""The group of verbs, loaded when they are called, and the one place that turns errors into exit codes."""

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
from resgrid.cli.terminal import (
    INTERRUPTED,
    LEFT,
    TERMINATED,
    UNEXPECTED,
    Failure,
    end_at_once,
    failure_of,
    is_computing,
)

VERBS = {
    "run": "Do it all: paths, pictures, and decks checked in SPICE.",
    "compile": "Write a scene's chip as a SPICE deck.",
    "solve": "Solve a scene's resistor grid, or any resistive deck.",
    "path": "Follow the current from starts to a goal.",
    "plot": "Draw a scene, its potential, currents, paths or circuit.",
    "check": "Check rules, and ask the circuit simulator whether it agrees.",
    "chip": "Ask whether a real chip is good enough; a report with decks.",
    "control": "Move the robot by its field, feel obstacles, learn them.",
    "live": "Draw in the browser while the grid is solved.",
    "convert": "Turn a scene, map or deck into a deck, an edge list or a graph.",
    "info": "Describe a scene, the scene format, or the installation.",
    "completion": "Print the script that lets a shell complete.",
}
"""Every verb, in the order of the work, and what it is for; it is the ``command`` of the module of its name."""


_SELDOM = 50_000
"""New objects after which garbage is looked for; Python's own number is 700."""


class Verbs(click.Group):
    """The verbs, each imported only when it is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Names of the verbs."""
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """The command behind a name."""
        if cmd_name not in VERBS:
            return None
        command: click.Command = importlib.import_module(f"resgrid.cli.{cmd_name}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Write what the verbs are for."""
        with formatter.section("Commands"):
            formatter.write_dl(list(VERBS.items()))

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Verbs and options that begin so."""
        verbs = [CompletionItem(name, help=about) for name, about in VERBS.items() if name.startswith(incomplete)]
        return verbs + click.Command.shell_complete(self, ctx, incomplete)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command that the first word names; else raise an error that names the probable command."""
        if args[0] not in VERBS:
            near = get_close_matches(args[0], VERBS, 1)
            if is_source(args[0]):
                words = f"a command is missing before {args[0]!r}; type: {ctx.command_path} run {shlex.join(args)}"
                raise click.UsageError(words, ctx)
            if near:
                raise click.UsageError(f"No such command {args[0]!r}. Did you mean {near[0]!r}?", ctx)
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Call the verb; click would end a broken pipe and an interrupt with codes of its own."""
        try:
            with warnings.catch_warnings(), _patient_collector():
                warnings.showwarning = _show_warning
                result = super().invoke(ctx)
            if sys.stdout is not None:  # closed from the beginning
                sys.stdout.flush()
        except BrokenPipeError:
            _drop_stdout()
            ctx.exit(LEFT)
        except KeyboardInterrupt as interrupt:
            click.echo("resgrid: interrupted; nothing half-written is left", err=True)
            code = TERMINATED if interrupt.args == (signal.SIGTERM,) else INTERRUPTED
            if is_computing():
                end_at_once(code)
            ctx.exit(code)
        return result

    def main(self, args: Sequence[str] | None = None, *rest: Any, **extra: Any) -> Any:
        """Run a command line and exit, with one message where something is wrong."""
        words = list(sys.argv[1:] if args is None else args)
        extra["standalone_mode"] = False
        try:
            with _terminable(is_process=args is None):
                code = super().main(words, *rest, **extra)
        except Exception as error:  # the one place where every error ends
            failure = failure_of(error)
            if failure.code == UNEXPECTED and "--debug" in words:
                click.echo(traceback.format_exc(), err=True, nl=False)
            _complain(failure, as_json="--json" in words)
            sys.exit(failure.code)
        sys.exit(code if isinstance(code, int) else 0)


@contextlib.contextmanager
def _terminable(*, is_process: bool) -> Iterator[None]:
    """Let a request to terminate clean up as an interrupt does; what comes while one cleans up is not heard.

    In a process of our own nothing is heard from then on, for its end cleans up, too.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(number: int, _frame: object) -> None:
        for each in before:
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt(signal.Signals(number))

    heard = [signal.SIGTERM]
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        heard.append(signal.SIGINT)
    before = {each: signal.signal(each, interrupt) for each in heard}
    try:
        yield
    finally:
        if not (is_process and signal.getsignal(signal.SIGTERM) is signal.SIG_IGN):
            for each, handler in before.items():
                signal.signal(each, handler)


@contextlib.contextmanager
def _patient_collector() -> Iterator[None]:
    """Look for garbage seldom: imports and loops leave none, and looking takes a tenth of a short verb's time.

    At the end of the process not at all: among all that was imported it takes a quarter of that time.
    """
    atexit.unregister(gc.freeze)
    atexit.register(gc.freeze)
    before = gc.get_threshold()
    gc.set_threshold(_SELDOM)
    try:
        yield
    finally:
        gc.set_threshold(*before)


def _complain(failure: Failure, *, as_json: bool) -> None:
    if failure.kind == "NoArgsIsHelpError":  # click's way to answer a bare 'resgrid' with its help
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
    except OSError:  # standard output may be what fails; what is left in it would fail once more at the end
        _drop_stdout()


def _show_warning(message: Warning | str, *_where: object, **_more: object) -> None:
    click.echo(f"resgrid: warning: {message}", err=True)


def _drop_stdout() -> None:
    """Nobody reads any more: keep the interpreter from complaining when it flushes at its end."""
    with contextlib.suppress(OSError, ValueError):  # where no real file is behind it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@click.command(
    cls=Verbs,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    epilog="Exit codes: 0 done; 1 ran, but the answer is negative (no path, decks disagree); 2 bad usage or input; "
    "3 an outside tool is missing; 4 out of budget; 5 not verified (no simulator ran the deck itself); "
    "70 a fault of resgrid itself; 130 interrupted.",
)
@click.version_option(package_name="resgrid", message="%(prog)s %(version)s")
def main() -> None:
    """Compile robot maps into resistor grids, solve them, follow the current, and check it all in SPICE.

    A SCENE is a TOML scene, a ROS map.yaml, a MovingAI .map, a picture, an array or a link from the live page; '-' is
    standard input.
    """
